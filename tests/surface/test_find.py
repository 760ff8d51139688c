"""The surface search on sheets whose surfaces are formulas."""

import numpy as np
import pytest

from folders import refused
from planish.core.errors import VolumeError
from planish.core.frame import Frame
from planish.surface import SurfaceParams, find_surfaces
from surface.sheets import VOXEL, slab, volume


@pytest.mark.parametrize("slope", [0.0, 0.5])
def test_flat_and_tilted_faces_within_a_fraction_of_a_voxel(slope):
    grey, middle, half = slab(shape=(110, 50, 64), height=165.0, slope=slope)
    found = find_surfaces(volume(np.rint(grey).astype(np.uint8)))
    inside = (slice(10, -10), slice(10, -10))
    stretch = np.hypot(1, slope)
    offsets = {
        "top": half,
        "bottom": -half,
        "interface_top": 27.5,
        "interface_bottom": -27.5,
        "centre": 0.0,
    }
    for name, offset in offsets.items():
        error = (found[name].values - middle[0] - offset * stretch)[inside]
        assert abs(error.mean()) < 0.15
        assert np.sqrt(np.mean(error**2)) < 0.2 * VOXEL
    for name in found.data_vars:
        assert f"``{name}``" in str(find_surfaces.__doc__)
    assert found.attrs["grey_coating_top"] == pytest.approx(200, abs=4)
    assert found.attrs["blur_um"] == pytest.approx(2.6, abs=0.4)


@pytest.mark.ci
def test_flip_swaps_the_faces_and_any_axis_gives_the_same_surfaces():
    grey, *_ = slab(wave=15.0)
    high, low = (find_surfaces(volume(grey), frame=Frame(top=top)) for top in ("high", "low"))
    np.testing.assert_array_equal(high["top"], low["bottom"])
    np.testing.assert_array_equal(high["interface_bottom"], low["interface_top"])
    turned = find_surfaces(volume(np.moveaxis(grey, 0, 2)), frame=Frame(through="x"))
    np.testing.assert_allclose(turned["top"], high["top"], atol=1e-9)


@pytest.mark.ci
def test_a_hole_is_missing_in_the_faces_and_bridged_by_the_centre():
    grey, middle, _ = slab(shape=(70, 120, 120), wave=10.0)
    y, x = np.mgrid[0:120, 0:120] * VOXEL
    hole = np.hypot(x - 180, y - 180) < 80
    found = find_surfaces(
        volume(np.where(hole, 40.0, grey) + np.random.default_rng(1).normal(0, 1, grey.shape))
    )
    assert np.isnan(found["top"].values[60, 60])
    assert abs(found["centre"].values[60, 60] - middle[0, 60, 60]) < 3.0
    assert (
        set(np.unique(found["status"].values[50:70, 50:70])),
        found["status"].values[60, 93],
    ) == ({1}, 2)
    assert found["presence"].values[60, 60] < 0.1 < 0.9 < found["presence"].values[10, 10]


@pytest.mark.ci
def test_a_burr_around_a_hole_does_not_bend_the_centre_surface():
    grey, middle, _ = slab(shape=(70, 120, 120), noise=2.0)
    y, x = np.mgrid[0:120, 0:120] * VOXEL
    from_hole = np.hypot(x - 180, y - 180) - 80
    first = int((middle[0, 0, 0] + 44.5) / VOXEL)
    grey[first : first + 8, (from_hole < 45) & (from_hole > 0)] = 200.0  # 24 um on the top face
    grey = np.where(from_hole < 0, 40.0, grey) + np.random.default_rng(1).normal(0, 1, grey.shape)
    found = find_surfaces(volume(grey))
    assert found["top"].values[60, 92] > middle[0, 60, 92] + 55
    assert np.abs(found["centre"].values - middle[0]).max() < 0.5


def test_missing_voxels_are_not_guessed():
    grey, *_ = slab()
    grey[:, 30:34, 40:44] = np.nan
    found = find_surfaces(volume(grey))
    assert np.isnan(found["top"].values[30:34, 40:44]).all()
    assert np.isfinite(found["top"].values[10, 10])
    assert found.attrs["missing_share"] == pytest.approx(16 / (50 * 56))


def test_volumes_without_a_sheet_or_across_it_are_refused():
    noise = np.random.default_rng(0).normal(50, 3, (40, 60, 60))
    refused(VolumeError, "no sheet", find_surfaces, volume(noise))
    refused(VolumeError, "no sheet", find_surfaces, volume(np.full((40, 60, 60), 7, np.uint8)))
    grey = np.random.default_rng(0).normal(50, 3, (60, 80, 80))
    grey[20:28, 30:38, 30:38] = 200
    refused(VolumeError, "no sheet", find_surfaces, volume(grey))
    grey, *_ = slab()
    refused(
        VolumeError,
        r"through=|leaves the volume|one after",
        find_surfaces,
        volume(grey),
        frame=Frame(through="x"),
    )
    refused(VolumeError, "at least 8", find_surfaces, volume(np.zeros((4, 50, 50))))


def on_film(sheet, film_um, gap_um, film_grey, half):
    """The grey of a sheet (its air is 40) at 170 um with a film below it."""
    height = 170.0 - half - gap_um - film_um / 2
    film, *_ = slab(
        shape=sheet.shape,
        height=height,
        coat=0.0,
        base=film_um,
        greys=(0.0, film_grey, 0.0),
        noise=0.0,
    )
    return sheet + film


@pytest.mark.ci
@pytest.mark.parametrize("gap_um", [15.0, 40.0])
def test_a_film_beyond_air_is_left_out_and_named_where_the_sheet_is_coated(gap_um):
    grey, _, half = slab(shape=(110, 44, 48), height=170.0)
    alone = find_surfaces(volume(grey))
    found = find_surfaces(volume(on_film(grey, 40.0, gap_um, 80.0, half)))
    for face in ("top", "bottom", "interface_bottom"):
        assert np.abs(found[face] - alone[face]).max() < 0.3
    assert "from the bottom side, in 100 % of the columns" in found.attrs["beside"]
    assert found.attrs["beside_gap_um"] == pytest.approx(gap_um, abs=1.0)
    assert "beside" not in alone.attrs


def test_a_film_thicker_than_a_sheet_without_a_coating_is_not_taken_for_the_sheet():
    grey, _, half = slab(shape=(110, 44, 48), height=170.0, coat=0.0, greys=(40.0, 90.0, 90.0))
    refused(
        VolumeError,
        r"2 separate sheets",
        find_surfaces,
        volume(on_film(grey, 80.0, 20.0, 80.0, half)),
    )


def test_two_coated_sheets_are_refused_also_where_one_is_thicker():
    grey, _, half = slab(shape=(130, 44, 60), height=190.0)
    thinner, *_ = slab(shape=(130, 44, 60), height=190.0 - half - 75.0, base=20.0, noise=0.0)
    refused(VolumeError, r"2 separate sheets", find_surfaces, volume(np.maximum(grey, thinner)))
    apart = on_film(np.where(np.arange(60) < 28, grey, 40.0), 40.0, 20.0, 80.0, half)
    apart[:, :, :32] = np.where(
        np.arange(130)[:, None, None] * VOXEL < 190.0 - half - 10.0, 40.0, apart[:, :, :32]
    )
    refused(VolumeError, r"2 separate sheets", find_surfaces, volume(apart))


def test_two_sheets_are_counted_and_one_is_chosen_by_its_grey():
    flat = {"shape": (120, 44, 48), "coat": 0.0, "base": 40.0}
    grey, *_ = slab(**flat, height=90.0, greys=(20.0, 120.0, 120.0))
    other, *_ = slab(**flat, height=260.0, greys=(20.0, 120.0, 120.0))
    refused(
        VolumeError,
        r"2 separate sheets.*sheet_grey=",
        find_surfaces,
        volume(np.maximum(grey, other)),
    )
    other, *_ = slab(**flat, height=260.0, greys=(20.0, 220.0, 220.0))
    both = volume(np.maximum(grey, other))
    bright = find_surfaces(both, params=SurfaceParams(sheet_grey=(170.0, 255.0)))
    assert float(bright["centre"].mean()) == pytest.approx(260.0, abs=0.5)
    assert bright.attrs["thickness_um"] == pytest.approx(40.0, abs=0.5)


@pytest.mark.ci
@pytest.mark.parametrize("through", ["z", "y"])
def test_the_round_field_of_view_is_not_taken_for_air(through):
    """Outside the circle of a reconstruction all voxels are 0; the air inside it is not."""
    depth, height = (120, 180.0) if through == "y" else (70, 105.0)
    grey, middle, half = slab(shape=(depth, 120, 120), height=height)
    turned = np.rint(np.moveaxis(grey, 0, "zyx".index(through))).astype(np.uint8)
    y, x = np.mgrid[0:120, 0:120] - 59.5
    turned[:, np.hypot(y, x) > 59.0] = 0
    found = find_surfaces(volume(turned), frame=Frame(through=through))
    assert (found.attrs["padding"], found.attrs["grey_air"]) == (0.0, pytest.approx(40, abs=1))
    error = (found["top"].values - middle[0] - half)[found["status"].values == 0]
    assert error.size > 1000
    assert np.abs(error).max() < 3.0


def test_air_clipped_to_one_value_is_air():
    grey, middle, half = slab(greys=(-20.0, 90.0, 200.0), noise=2.0)
    found = find_surfaces(volume(np.rint(np.clip(grey, 0, 255)).astype(np.uint8)))
    assert "padding" not in found.attrs
    assert found.attrs["grey_air"] == 0.0
    # what is clipped lies below the faces' half height; they move by a fraction of the blur
    assert abs(float((found["top"] - middle[0] - half).mean())) < 1.0


@pytest.mark.parametrize("air", [0.0, 6.0])
def test_noise_of_the_air_cut_at_zero(air):
    """An 8-bit export with dark air: a part of the air's voxels is exactly 0, their mean is not."""
    grey, middle, half = slab(greys=(air, 60.0, 240.0), noise=9.0)
    found = find_surfaces(volume(np.rint(np.clip(grey, 0, 255)).astype(np.uint8)))
    error = (found["top"].values - middle[0] - half)[found["status"].values == 0]
    assert abs(error.mean()) < 0.3
