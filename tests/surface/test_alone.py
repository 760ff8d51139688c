"""The grey of a coating where it is alone, on layers in valleys whose grey is known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from planish.core.frame import Frame
from planish.core.tiles import Engine
from planish.measure import measure_properties
from planish.surface import SurfaceParams, find_surfaces
from planish.surface.alone import RADII, _grey
from planish.surface.columns import Columns, make_guide
from planish.surface.learn import learn_priors
from planish.surface.survey import take_survey
from surface.sheets import Sheet, volume

AIR, BASE, COATING, VOXEL = 40.0, 90.0, 190.0, 2.0


def valleys(*, width_um=30.0, depth_um=18.0, inner=COATING, seed=3):
    """A flat sheet whose coating fills valleys of the base, 2 um thick between them; its half next
    to the base may be of another grey."""
    rng = np.random.default_rng(seed)
    rows, cols, depth = 90, 100, 60
    rough = ndimage.gaussian_filter(rng.standard_normal((rows, cols)), width_um / 2.4 / VOXEL)
    filled = depth_um * np.clip(rough / rough.std(), 0.0, 1.5) / 1.5 + 2.0
    z = (np.arange(depth) + 0.5) * VOXEL - 0.5 * depth * VOXEL
    face, sheet = 36.0, 72.0
    below = (face - z)[:, None, None] + np.zeros((depth, rows, cols))
    grey = np.where((below > 0) & (below < sheet), BASE, AIR)
    for at in (below, sheet - below):
        grey = np.where((at > 0) & (at < filled), COATING, grey)
        grey = np.where((at > 0.5 * filled) & (at < filled), inner, grey)
    grey = ndimage.gaussian_filter(grey, 1.7 / VOXEL) + rng.normal(0.0, 8.0, grey.shape)
    return volume(np.rint(grey).clip(0, 255).astype(np.uint8), VOXEL), filled


def learnt(made):
    columns = Columns(volume=made, frame=Frame())
    survey = take_survey(columns, SurfaceParams(), Engine())
    return learn_priors(columns, make_guide(survey.coarse, columns), survey, SurfaceParams())


def test_charred_places_do_not_take_the_grey_along():
    """Sixteen places, three of them charred by a laser; their mean would be 7.5 darker."""
    count = np.full(16, 100.0)
    level = np.full(16, 150.0)
    level[:3] = 110.0
    half = 0.5 * count
    fields = [count, count * level, half, half * level, half * level]
    found = _grey(np.repeat(np.array(fields)[:, None], len(RADII), axis=1))
    assert found is not None
    assert found.level == pytest.approx(150.0)
    assert found.error > 0


@pytest.mark.ci
def test_a_coating_in_valleys_has_its_own_grey():
    priors = learnt(valleys()[0])
    for side in priors.sides.values():
        assert side.lone is not None
        assert side.lone.level == pytest.approx(COATING - AIR, abs=2.0)
        assert 0 < side.lone.error < 3.0
        assert abs(side.lone.deepening) < 4.0


@pytest.mark.ci
def test_a_pre_coat_of_another_grey_is_seen():
    found = find_surfaces(valleys(depth_um=36.0, width_um=60.0, inner=160.0)[0])
    change, error = found.attrs["coating_deepens_top"]
    assert change < -3.0 * error
    assert change < -10.0


@pytest.mark.ci
def test_stated_errors_are_those_of_the_fit_in_valleys():
    made, filled = valleys()
    found = measure_properties(find_surfaces(made), volume=made)
    true = ndimage.gaussian_filter(filled, 1.7 / VOXEL)
    for side in ("top", "bottom"):
        assert len(found.attrs[f"fit_errors_{side}_um"]) == 4 * 8
        error = found[f"coating_{side}"].values - true
        stated = found[f"coating_{side}_se"].values
        is_known = np.isfinite(error) & (stated > 0)
        error = error - error[is_known].mean()
        assert 0.7 < np.sqrt(np.mean((error / stated)[is_known] ** 2)) < 1.5


@pytest.mark.ci
def test_errors_beside_a_film_are_those_without_it():
    made, _ = valleys()
    grey = made.values.copy()
    air = np.random.default_rng(5).normal(AIR, 8.0, (40, *grey.shape[1:]))
    film = np.random.default_rng(6).normal(100.0, 8.0, (14, *grey.shape[1:]))
    beside = np.concatenate([air, film, air[:4], grey, air]).clip(0, 255).astype(np.uint8)
    alone = find_surfaces(
        volume(np.concatenate([air, grey, air]).clip(0, 255).astype(np.uint8), VOXEL)
    )
    with_film = find_surfaces(volume(beside, VOXEL))
    for side in ("top", "bottom"):
        stated = np.array(with_film.attrs[f"fit_errors_{side}_um"]).reshape(4, -1)
        expected = np.array(alone.attrs[f"fit_errors_{side}_um"]).reshape(4, -1)
        np.testing.assert_allclose(stated[2].mean(), expected[2].mean(), rtol=0.2)


@pytest.mark.ci
def test_a_coating_that_is_nowhere_thick_is_alone_nowhere():
    sheet = Sheet(lateral=(40, 44), margin=20.0, thickness=60.0, coats=(5.0, 5.0))
    found = find_surfaces(sheet.volume())
    assert "coating_deepens_top" not in found.attrs
    assert found.attrs["grey_coating_top_error"] > 0
    thick = find_surfaces(replace(sheet, coats=(15.0, 15.0)).volume())
    assert thick.attrs["grey_coating_top_error"] < found.attrs["grey_coating_top_error"]


@pytest.mark.ci
def test_a_coating_that_is_even_within_its_error_has_one_class_of_error():
    """Classes of chance would make the stated error of a column chance too."""
    sheet = Sheet(lateral=(60, 64), margin=20.0, thickness=60.0, coats=(15.0, 15.0))
    found = find_surfaces(sheet.volume())
    for side in ("top", "bottom"):
        assert len(found.attrs[f"fit_errors_{side}_um"]) == 4


@pytest.mark.ci
def test_a_scan_without_noise_has_no_error_below_that_of_its_levels():
    sheet = Sheet(lateral=(60, 64), margin=20.0, thickness=60.0, coats=(15.0, 15.0), noise=0.0)
    made = sheet.volume()
    found = measure_properties(find_surfaces(made), volume=made)
    stated = found["coating_top_se"].values
    off = np.abs(np.nanmean(found["coating_top"].values) - 15.0)
    assert off < np.nanmin(stated) < 0.1 * sheet.voxel


def test_a_change_with_depth_that_one_place_shows_is_not_called_certain():
    count, half = np.full((5, 3), 400.0), np.zeros((5, 3))
    half[:, 1] = 6.0
    found = _grey(np.array([count, 150.0 * count, half, 150.0 * half, 165.0 * half]))
    assert (found.deepening, found.deepening_error) == (0.0, 0.0)
    half[:] = 6.0
    found = _grey(np.array([count, 150.0 * count, half, 150.0 * half, 165.0 * half]))
    assert found.deepening == pytest.approx(15.0)
