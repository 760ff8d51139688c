"""The phase-contrast fringe: a known one is learnt, and what was off because of it no longer is."""

from dataclasses import replace

import numpy as np
import pytest

from naive import staircase
from planish.surface import SurfaceParams, find_surfaces
from planish.surface._fit_kernels import fit_column
from surface.sheets import Sheet
from surface.test_tiles import assert_same_bytes

COARSE = Sheet(voxel=3.0, lateral=(40, 60), coats=(10.0, 6.0), thickness=90.0)
OFF = SurfaceParams(fringe="off")


def biases(found, sheet):
    """Bias in um of the top face and of both coatings."""
    truth = sheet.surfaces()
    off = {
        k: float(np.nanmean(found[k].values - truth[k]))
        for k in truth
        if not np.isnan(truth[k]).all()
    }
    top = off["top"] - off.get("interface_top", off["top"])
    return off["top"], top, off.get("interface_bottom", off["bottom"]) - off["bottom"]


@pytest.mark.ci
def test_a_known_fringe_is_learnt_and_coatings_are_right():
    """Taken for a blurred staircase alone it moves faces and interfaces by 0.1 to 0.2 um."""
    sheet = replace(COARSE, fringe=0.12)
    grey = sheet.volume()
    found, without = find_surfaces(grey), find_surfaces(grey, params=OFF)
    assert found.attrs["fringe"] == pytest.approx(0.12, abs=0.02)
    assert found.attrs["fringe_um"] == pytest.approx(1.5 * sheet.voxel, rel=0.1)
    assert found.attrs["blur_um"] == pytest.approx(4.0 / 2.3548, rel=0.04)
    assert found.attrs["grey_coating_top"] == pytest.approx(210.0, abs=1.5)
    # noise leaves 0.15 um in a column, 0.003 um in the mean
    assert np.abs(biases(found, sheet)).max() < 0.05
    assert without.attrs["fringe"] == 0.0
    assert np.abs(biases(without, sheet)).max() > 0.07


@pytest.mark.ci
def test_a_thin_coating_keeps_its_thickness_and_a_tilt_widens_the_fringe_as_the_blur():
    """4 um in voxels of 3 um: taken for a blurred staircase alone, the fringe makes them 5 um or
    more."""
    sheet = replace(COARSE, coats=(10.0, 4.0), fringe=0.3)
    found = find_surfaces(sheet.volume())
    assert found.attrs["fringe"] == pytest.approx(0.3, abs=0.02)
    assert np.abs(biases(found, sheet)).max() < 0.2
    assert biases(find_surfaces(sheet.volume(), params=OFF), sheet)[2] > 0.5
    sheet = replace(COARSE, fringe=0.2, tilt=(25.0, 0.0))
    found = find_surfaces(sheet.volume())
    assert found.attrs["fringe"] == pytest.approx(0.2, abs=0.03)
    assert np.abs(biases(found, sheet)).max() < 0.12


@pytest.mark.ci
def test_an_uncoated_sheet_with_a_fringe_has_no_coating():
    sheet = replace(COARSE, coats=(0.0, 0.0), fringe=0.3)
    found = find_surfaces(sheet.volume())
    assert np.isnan(found["interface_top"]).all()
    assert np.isnan(found["interface_bottom"]).all()
    assert found.attrs["fringe"] == pytest.approx(0.3, abs=0.02)
    assert np.abs(biases(found, sheet)).max() < 0.03


@pytest.mark.ci
@pytest.mark.parametrize(
    "sheet",
    [
        replace(COARSE, coats=(0.0, 0.0), texture=0.2),
        replace(COARSE, coats=(0.0, 8.0), inverted=True),
    ],
    ids=["uncoated, textured", "one side, inverted"],
)
def test_without_a_fringe_auto_gives_the_bytes_of_off(sheet):
    grey = sheet.volume()
    auto, off = find_surfaces(grey), find_surfaces(grey, params=OFF)
    assert auto.attrs["fringe"] == off.attrs["fringe"] == auto.attrs["fringe_um"] == 0.0
    assert_same_bytes(auto.drop_attrs(deep=False), off.drop_attrs(deep=False))


@pytest.mark.ci
def test_a_given_fringe_is_taken_and_slowly_darkening_air_is_none():
    sheet = replace(COARSE, fringe=0.12)
    found = find_surfaces(sheet.volume(), params=SurfaceParams(fringe=0.12))
    assert found.attrs["fringe"] == 0.12
    assert np.abs(biases(found, sheet)).max() < 0.04
    grey = COARSE.volume().astype(np.float64)
    middle, _ = COARSE.middle()
    away = np.abs(grey["z"].values[:, None, None] - middle) - 0.5 * COARSE.thickness
    grey = grey - 8.0 * np.exp(-np.maximum(away, 0.0) / 30.0)
    assert find_surfaces(grey).attrs["fringe"] == 0.0


def test_the_kernel_gives_back_what_made_a_profile():
    d, width, fringe, ratio = np.arange(24), 0.7, 0.2, 0.5
    truth = [9.4, 3.0, 1.0, 0.4]
    grey = staircase(d, truth, width, 0.0)
    for at, step in ((9.4, 1.0), (12.4, -0.6)):
        y = ratio * (d - at) / width
        grey = grey + step * fringe * y * np.exp(-0.5 * y * y) / np.sqrt(2 * np.pi)
    p = np.array([9.0, 2.0, 1.1, 0.35])
    none = np.zeros(4)
    fit_column(
        grey.astype(np.float32),
        0,
        23,
        0.0,
        0.04,
        width,
        p,
        none,
        none,
        True,
        np.zeros((4, 4)),
        np.zeros(4),
        fringe,
        ratio,
    )
    np.testing.assert_allclose(p, truth, atol=2e-3)


@pytest.mark.parametrize("fringe", [0.0, 1.2])
def test_the_overshoot_of_a_strong_fringe_is_no_coating(fringe):
    """It lightens the base below a face by as much as it darkens the air outside."""
    sheet = replace(COARSE, coats=(0.0, 0.0), fringe=fringe, greys=(60.0, 115.0, 210.0))
    found = find_surfaces(sheet.volume())
    assert np.isnan(found.attrs["grey_coating_top"])
    assert np.isnan(found.attrs["grey_coating_bottom"])
