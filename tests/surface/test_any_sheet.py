"""The same call without any option on sheets of all kinds; the benchmark ``surfaces`` has the whole
table."""

from dataclasses import replace

import numpy as np
import pytest

from folders import refused
from planish.core.errors import VolumeError
from planish.core.frame import Frame
from planish.surface import SurfaceParams, find_surfaces, sample
from surface.sheets import Sheet

PLAIN = Sheet(lateral=(48, 52), margin=20.0, thickness=60.0)
CASES = {
    "inverted uint16": replace(PLAIN, inverted=True, dtype="uint16"),
    "inverted float32, coated below only": replace(
        PLAIN, inverted=True, dtype="float32", coats=(0.0, 12.0)
    ),
    "tilted about both axes": replace(PLAIN, tilt=(35.0, -30.0)),
    "tilted by 45 degrees, one side, top low": replace(
        PLAIN, tilt=(0.0, 45.0), coats=(12.0, 0.0), top="low"
    ),
    "through x, uncoated, textured": replace(
        PLAIN, through="x", coats=(0.0, 0.0), texture=0.2, tilt=(10.0, 0.0)
    ),
    "through y, thick, large voxels": replace(
        PLAIN, through="y", voxel=3.0, thickness=400.0, lateral=(30, 34)
    ),
    "40 um, large voxels, much noise and blur": replace(
        PLAIN, voxel=3.0, thickness=40.0, noise=0.1, fwhm=6.0
    ),
    "a base that is hardly there": replace(PLAIN, greys=(40.0, 65.0, 210.0), noise=0.1),
    "faces close to the ends": replace(PLAIN, margin=5.0),
    "a field of 30 um": replace(PLAIN, lateral=(20, 24), tilt=(45.0, 0.0)),
}


@pytest.mark.parametrize("name", CASES)
def test_faces_layers_and_coated_sides_without_an_option(name):
    sheet = CASES[name]
    frame = Frame(through=sheet.through, top=sheet.top)
    found = find_surfaces(sheet.volume(), frame=frame)
    truth = sheet.surfaces()
    ok = found["status"].values == 0
    assert ok.mean() >= 0.98
    assert found.attrs["polarity"] == (-1 if sheet.inverted else 1)
    for face in ("top", "bottom"):
        error = (found[face].values - truth[face])[ok] * sheet.cosine
        assert np.sqrt(np.mean(error**2)) < 0.5 * sheet.voxel
        inner, true_inner = found[f"interface_{face}"].values, truth[f"interface_{face}"]
        assert (
            np.isnan(inner).all()
            == np.isnan(found.attrs[f"grey_coating_{face}"])
            == np.isnan(true_inner).all()
        )
        if np.isfinite(true_inner).all():
            coating = (
                frame.sign
                * (found[face].values - inner - truth[face] + true_inner)[ok]
                * sheet.cosine
            )
            assert abs(coating.mean()) < 0.5


@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_a_volume_without_noise_is_measured_no_worse_than_a_noisy_one(dtype):
    """The paper's texture is all that is left then; it says nothing about the blur and the greys of
    the layers."""
    sheet = replace(PLAIN, texture=0.2, noise=0.0, dtype=dtype)
    truth = sheet.surfaces()
    found = find_surfaces(sheet.volume())
    assert found.attrs["blur_um"] == pytest.approx(sheet.fwhm / 2.3548, rel=0.1)
    for name in ("interface_top", "interface_bottom"):
        error = (found[name].values - truth[name])[found["status"].values == 0]
        assert np.sqrt(np.mean(error**2)) < 0.5 * sheet.voxel


def test_a_cost_that_most_columns_exceed_is_no_bound():
    """Blurs whose costs are all cut at one number could not be told apart."""
    assert sample.cost_limit(np.array([1.0, 2.0, 3.0, 1e6, np.nan])) == 400.0
    assert sample.cost_limit(np.array([5e3, 6e3, 7e3, np.nan])) > 7e3
    assert sample.cost_limit(np.array([np.nan])) == 400.0


@pytest.mark.ci
@pytest.mark.parametrize("coats", [(3.0, 3.0), (4.0, 15.0)])
def test_a_coating_that_is_nowhere_thicker_than_the_blur(coats):
    """Grey and thickness of such a layer look alike in one profile; many profiles tell them
    apart."""
    sheet = replace(PLAIN, coats=coats, lateral=(70, 70))
    found = find_surfaces(sheet.volume())
    thickness = (found["top"] - found["interface_top"]).values
    assert np.nanmedian(thickness) == pytest.approx(coats[0], abs=0.5)
    assert found.attrs["grey_coating_top"] == pytest.approx(210, abs=15)


def test_a_coating_grey_makes_thin_layers_right_and_is_refused_on_the_wrong_side_of_the_base():
    sheet = replace(PLAIN, coats=(0.5, 0.0), voxel=1.37)
    found = find_surfaces(sheet.volume(), params=SurfaceParams(coating_grey=210.0))
    assert np.nanmean((found["top"] - found["interface_top"]).values) == pytest.approx(0.5, abs=0.3)
    assert np.isnan(found["interface_bottom"]).all()
    dark = SurfaceParams(coating_grey=70.0)
    refused(VolumeError, "coating_grey=", find_surfaces, PLAIN.volume(), params=dark)


@pytest.mark.ci
def test_a_thin_layer_beside_a_thick_one_is_not_as_thick_as_the_blur():
    """A wedge from 0 to 12 um: the thick end tells the grey."""
    sheet = replace(PLAIN, lateral=(40, 120), voxel=1.37)
    wedge = np.linspace(0.0, 12.0, 120)
    strips = (replace(sheet, lateral=(40, 2), coats=(t, 12.0), seed=k) for k, t in enumerate(wedge))
    grey = np.stack([strip.volume().values[:, :, 0] for strip in strips], axis=-1)
    found = find_surfaces(sheet.volume().copy(data=grey))
    thickness = np.nanmean((found["top"] - found["interface_top"]).values, axis=0)
    for at in (0.5, 1.0, 2.0, 3.0, 6.0):
        near = np.abs(wedge - at) < 0.3
        bias = float(np.mean(thickness[near] - wedge[near]))
        assert abs(bias) < (0.5 if at < 3 else 0.3)
