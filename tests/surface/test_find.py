"""The surface search on sheets whose surfaces are formulas."""

import numpy as np
import pytest
from scipy import ndimage

from folders import refused
from naive import staircase
from planish.core.errors import VolumeError
from planish.core.frame import Frame
from planish.surface import SurfaceParams, find_surfaces
from surface.sheets import VOXEL, slab, volume


@pytest.mark.parametrize("slope", [0.0, 0.5])
def test_flat_and_tilted_faces_within_a_fraction_of_a_voxel(slope):
    grey, middle, half = slab(shape=(110, 60, 100), height=165.0, slope=slope)
    found = find_surfaces(volume(np.rint(grey).astype(np.uint8)))
    inside = (slice(10, -10), slice(10, -10))
    stretch = np.hypot(1, slope)
    offsets = {"top": half, "bottom": -half, "interface_top": 27.5, "interface_bottom": -27.5, "centre": 0.0}
    for name, offset in offsets.items():
        error = (found[name].values - middle[0] - offset * stretch)[inside]
        print(f"slope {slope} {name}: bias {error.mean():.3f} um, rms {np.sqrt(np.mean(error**2)):.3f} um")
        assert abs(error.mean()) < 0.15
        assert np.sqrt(np.mean(error**2)) < 0.2 * VOXEL
    assert found.attrs["grey_coating_top"] == pytest.approx(200, abs=4)
    assert found.attrs["blur_um"] == pytest.approx(2.6, abs=0.4)


def test_flip_swaps_the_faces():
    grey, *_ = slab(coat=12.0)
    high = find_surfaces(volume(grey), frame=Frame(top="high"))
    low = find_surfaces(volume(grey), frame=Frame(top="low"))
    np.testing.assert_array_equal(high["top"], low["bottom"])
    np.testing.assert_array_equal(high["interface_bottom"], low["interface_top"])


@pytest.mark.parametrize("through", ["y", "x"])
def test_any_axis_gives_the_same_surfaces(through):
    grey, *_ = slab(wave=15.0)
    turned = volume(np.moveaxis(grey, 0, "zyx".index(through)))
    found = find_surfaces(turned, frame=Frame(through=through))
    np.testing.assert_allclose(found["top"], find_surfaces(volume(grey))["top"], atol=1e-9)


def test_inverted_greys_and_a_sheet_of_one_material():
    grey, middle, half = slab()
    found = find_surfaces(volume(255.0 - grey))
    assert found.attrs["polarity"] == -1
    assert abs(float((found["top"] - middle[0] - half).mean())) < 0.1
    grey, middle, _ = slab(coat=0.0, greys=(20.0, 120.0, 120.0))
    found = find_surfaces(volume(grey))
    assert np.isnan(found["interface_top"]).all()
    assert np.isnan(found.attrs["grey_coating_top"])
    assert abs(float((found["top"] - middle[0] - 27.5).mean())) < 0.1


def test_a_hole_is_missing_in_the_faces_and_bridged_by_the_centre():
    grey, middle, _ = slab(shape=(70, 140, 140), wave=10.0)
    y, x = np.mgrid[0:140, 0:140] * VOXEL
    hole = np.hypot(x - 210, y - 210) < 80
    grey = np.where(hole, 40.0, grey) + np.random.default_rng(1).normal(0, 1, grey.shape)
    found = find_surfaces(volume(grey))
    assert np.isnan(found["top"].values[70, 70])
    assert abs(found["centre"].values[70, 70] - middle[0, 70, 70]) < 3.0
    assert (set(np.unique(found["status"].values[60:80, 60:80])), found["status"].values[70, 103]) == ({1}, 2)
    assert found["presence"].values[70, 70] < 0.1 < 0.9 < found["presence"].values[20, 20]


def test_a_burr_around_a_hole_does_not_bend_the_centre_surface():
    grey, middle, _ = slab(shape=(70, 140, 140), noise=2.0)
    y, x = np.mgrid[0:140, 0:140] * VOXEL
    from_hole = np.hypot(x - 210, y - 210) - 80
    for k in range(8):  # 24 um on the top face, a voxel at a time
        burr = (from_hole < 45) & (from_hole > 0)
        face = np.floor((middle[0] + 44.5) / VOXEL).astype(int)
        grey[face[burr] + k, y[burr].astype(int) // 3, x[burr].astype(int) // 3] = 200.0
    grey = np.where(from_hole < 0, 40.0, grey) + np.random.default_rng(1).normal(0, 1, grey.shape)
    found = find_surfaces(volume(grey))
    assert found["top"].values[70, 102] > middle[0, 70, 102] + 55
    assert np.abs(found["centre"].values - middle[0]).max() < 0.5


def test_missing_voxels_are_not_guessed():
    grey, *_ = slab()
    grey[:, 30:34, 40:44] = np.nan
    found = find_surfaces(volume(grey))
    assert np.isnan(found["top"].values[30:34, 40:44]).all()
    assert np.isfinite(found["top"].values[10, 10])
    assert found.attrs["missing_share"] == pytest.approx(16 / (80 * 90))


def test_volumes_without_a_sheet_or_across_it_are_refused():
    noise = np.random.default_rng(0).normal(50, 3, (40, 60, 60))
    refused(VolumeError, "no sheet", find_surfaces, volume(noise))
    refused(VolumeError, "no sheet", find_surfaces, volume(np.full((40, 60, 60), 7, np.uint8)))
    grey = np.random.default_rng(0).normal(50, 3, (60, 80, 80))
    grey[20:28, 30:38, 30:38] = 200
    refused(VolumeError, "no sheet", find_surfaces, volume(grey))
    grey, *_ = slab()
    refused(VolumeError, r"through=|leaves the volume|one after", find_surfaces, volume(grey), frame=Frame(through="x"))
    refused(VolumeError, "at least 8", find_surfaces, volume(np.zeros((4, 50, 50))))


def on_film(sheet, film_um, gap_um, film_grey, half):
    """The grey of a sheet (its air is 40) at 170 um with a film below it."""
    height = 170.0 - half - gap_um - film_um / 2
    film, *_ = slab(shape=sheet.shape, height=height, coat=0.0, base=film_um, greys=(0.0, film_grey, 0.0), noise=0.0)
    return sheet + film


@pytest.mark.parametrize("gap_um", [15.0, 40.0])
def test_a_film_beyond_air_is_left_out_and_named_where_the_sheet_is_coated(gap_um):
    grey, _, half = slab(shape=(110, 60, 60), height=170.0)
    alone = find_surfaces(volume(grey))
    found = find_surfaces(volume(on_film(grey, 40.0, gap_um, 80.0, half)))
    for face in ("top", "bottom", "interface_bottom"):
        assert np.abs(found[face] - alone[face]).max() < 0.3
    assert "from the bottom side, in 100 % of the columns" in found.attrs["beside"]
    assert found.attrs["beside_gap_um"] == pytest.approx(gap_um, abs=10.0)  # between the outer edges of the blur
    assert "beside" not in alone.attrs


def test_a_film_thicker_than_a_sheet_without_a_coating_is_not_taken_for_the_sheet():
    grey, _, half = slab(shape=(110, 60, 60), height=170.0, coat=0.0, greys=(40.0, 90.0, 90.0))
    refused(VolumeError, r"2 separate sheets", find_surfaces, volume(on_film(grey, 80.0, 20.0, 80.0, half)))


def test_two_coated_sheets_are_refused_whether_one_is_thicker_or_a_film_lies_where_the_sheet_is_not():
    grey, _, half = slab(shape=(130, 60, 60), height=190.0)
    thinner, *_ = slab(shape=(130, 60, 60), height=190.0 - half - 75.0, base=20.0, noise=0.0)
    refused(VolumeError, r"2 separate sheets", find_surfaces, volume(np.maximum(grey, thinner)))
    apart = on_film(np.where(np.arange(60) < 28, grey, 40.0), 40.0, 20.0, 80.0, half)
    apart[:, :, :32] = np.where(np.arange(130)[:, None, None] * VOXEL < 190.0 - half - 10.0, 40.0, apart[:, :, :32])
    refused(VolumeError, r"2 separate sheets", find_surfaces, volume(apart))


def test_two_sheets_are_counted_and_one_is_chosen_by_its_grey():
    grey, *_ = slab(shape=(120, 60, 60), height=90.0, coat=0.0, base=40, greys=(20.0, 120.0, 120.0))
    other, *_ = slab(shape=(120, 60, 60), height=260.0, coat=0.0, base=40, greys=(20.0, 120.0, 120.0))
    refused(VolumeError, r"2 separate sheets.*sheet_grey=", find_surfaces, volume(np.maximum(grey, other)))
    other, *_ = slab(shape=(120, 60, 60), height=260.0, coat=0.0, base=40, greys=(20.0, 220.0, 220.0))
    both = volume(np.maximum(grey, other))
    bright = find_surfaces(both, params=SurfaceParams(sheet_grey=(170.0, 255.0)))
    assert float(bright["centre"].mean()) == pytest.approx(260.0, abs=0.5)
    assert bright.attrs["thickness_um"] == pytest.approx(40.0, abs=0.5)


def test_staircase_twin_is_a_staircase():
    d = np.arange(30.0)
    g = staircase(d, (8.0, 6.0, 1.0, 0.4), 0.8, 0.0)
    assert (g[0], g[11], g[29]) == pytest.approx((0.0, 1.0, 0.4), abs=1e-3)
    assert ndimage.gaussian_filter1d(g, 1).max() < 1.001


@pytest.mark.parametrize("through", ["z", "y"])
def test_the_round_field_of_view_is_not_taken_for_air(through):
    """Outside the circle of a reconstruction all voxels are 0; the air inside it is not."""
    depth, height = (160, 240.0) if through == "y" else (90, 135.0)
    grey, middle, half = slab(shape=(depth, 160, 160), height=height)
    turned = np.rint(np.moveaxis(grey, 0, "zyx".index(through))).astype(np.uint8)
    y, x = np.mgrid[0:160, 0:160] - 79.5
    turned[:, np.hypot(y, x) > 79.0] = 0
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


@pytest.mark.parametrize("air", [0.0, 6.0, 12.0])
def test_noise_of_the_air_cut_at_zero(air):
    """An 8-bit export with dark air: a part of the air's voxels is exactly 0, their mean is not."""
    grey, middle, half = slab(greys=(air, 60.0, 240.0), noise=9.0)
    found = find_surfaces(volume(np.rint(np.clip(grey, 0, 255)).astype(np.uint8)))
    error = (found["top"].values - middle[0] - half)[found["status"].values == 0]
    print(f"air {air:g}: level {found.attrs['grey_air']:.1f}, top face {error.mean():.2f} um off")
    assert abs(error.mean()) < 0.3
