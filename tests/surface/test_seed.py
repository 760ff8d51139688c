"""One of several objects, chosen by a point in it."""

from dataclasses import replace

import numpy as np
import pytest

from planish.core.errors import VolumeError
from planish.core.frame import Frame
from planish.surface import SurfaceParams, find_surfaces
from surface.sheets import Sheet, slab, volume

THIN = Sheet(lateral=(50, 54), thickness=40.0, coats=(0.0, 0.0), greys=(20.0, 120.0, 120.0), voxel=3.0, margin=120.0)


def stack(gap_grey=20.0, offsets=(-75.0, 0.0, 75.0), bright=1.0):
    """Sheets on top of each other, in air or in other material; the last one may be brighter."""
    single = THIN.volume().astype(float)
    middle = THIN.middle()[0][0, 0]
    z = single["z"].values[:, None, None]
    sigma = THIN.fwhm / 2.3548
    grey = np.full(single.shape, 20.0)
    from scipy.special import ndtr

    def between(low, high):
        return ndtr((z - low) / sigma) - ndtr((z - high) / sigma)

    grey += (gap_grey - 20.0) * between(middle + offsets[0] - 30, middle + offsets[-1] + 30)
    for k, offset in enumerate(offsets):
        factor = bright if k == len(offsets) - 1 else 1.0
        grey += (20 + 100.0 * factor - gap_grey) * between(middle + offset - 20, middle + offset + 20)
    grey = grey + np.random.default_rng(0).normal(0, 3, grey.shape)
    return single.copy(data=np.clip(grey, 0, 255).astype(np.uint8)), middle


def test_several_sheets_are_named_with_a_point_in_each_that_chooses_it():
    grey, middle = stack()
    with pytest.raises(VolumeError, match=r"3 separate sheets.*seed_um=\(Z, Y, X\).*Points to start from") as told:
        find_surfaces(grey)
    points = str(told.value).split("Points to start from: ")[1].rstrip(".").split("; ")
    assert len(points) == 3
    heights = []
    for point in points:
        z, y, x = (float(k) for k in point.split(","))
        found = find_surfaces(grey, params=SurfaceParams(seed_um=(z, y, x)))
        assert (found["status"].values == 0).mean() > 0.98
        assert found.attrs["thickness_um"] == pytest.approx(40.0, abs=0.5)
        heights.append(float(found["centre"].mean()) - middle)
    np.testing.assert_allclose(sorted(heights), [-75.0, 0.0, 75.0], atol=0.3)


@pytest.mark.parametrize(("gap", "offset"), [(70.0, 0.0), (95.0, 0.0), (70.0, -60.0)])
def test_the_level_outside_a_chosen_layer_is_that_of_the_gap(gap, offset):
    """Layers of which the outer ones leave the volume; a stack that stands alone in air needs its grey, too."""
    grey, middle = stack(gap_grey=gap, offsets=(-60.0, 0.0, 60.0), bright=1.8)
    seed = (middle + offset, 60.0, 60.0)
    if offset == 0:
        grey = grey.sel(z=slice(middle - 65.0, None))
        params = SurfaceParams(seed_um=seed)
    else:
        params = SurfaceParams(seed_um=seed, sheet_grey=(95.0, 160.0))
    found = find_surfaces(grey, params=params)
    error_top = found["top"].values - (middle + offset + 20)
    error_bottom = found["bottom"].values - (middle + offset - 20)
    print(f"top {np.nanmean(error_top):.2f} um, bottom {np.nanmean(error_bottom):.2f} um")
    assert (found["status"].values == 0).mean() > 0.98
    assert abs(np.nanmean(error_top)) < 0.5
    assert abs(np.nanmean(error_bottom)) < 0.5


def test_where_two_sheets_touch_nothing_is_measured():
    flat = THIN.volume()
    grey, middle = stack(offsets=(0.0, 75.0))
    joined = grey.values.copy()
    z = flat["z"].values
    between = (z > middle) & (z < middle + 75.0)
    joined[between, 20:30, 20:30] = 120
    found = find_surfaces(grey.copy(data=joined), params=SurfaceParams(seed_um=(middle, 15.0, 15.0)))
    status = found["status"].values
    assert set(np.unique(status[20:30, 20:30])) == {5}
    assert np.isnan(found["top"].values[20:30, 20:30]).all()
    assert (status[:15] == 0).all()
    assert "touching" in found["status"].attrs["flag_meanings"]
    assert abs(np.nanmean(found["top"].values) - middle - 20) < 0.3


def test_a_seed_changes_little_in_a_single_sheet_and_is_refused_where_it_lies_nowhere():
    grey, middle, _ = slab(wave=10.0)
    plain = find_surfaces(volume(grey))
    seeded = find_surfaces(volume(grey), params=SurfaceParams(seed_um=(float(middle[0, 40, 45]), 120.0, 135.0)))
    for name in ("top", "bottom", "interface_top", "interface_bottom"):
        np.testing.assert_allclose(seeded[name], plain[name], atol=0.2)
    grey, middle = stack()
    with pytest.raises(VolumeError, match="only air"):
        find_surfaces(grey, params=SurfaceParams(seed_um=(middle + 37.0, 60.0, 60.0)))
    with pytest.raises(VolumeError, match="outside the volume"):
        find_surfaces(grey, params=SurfaceParams(seed_um=(middle, 60.0, 6000.0)))


def test_a_tilted_sheet_through_another_axis():
    sheet = replace(THIN, through="y", tilt=(20.0, 0.0), margin=30.0)
    grey = sheet.volume()
    middle = sheet.middle()[0]
    seed = (25 * 3.0, float(middle[25, 27]), 27 * 3.0)
    found = find_surfaces(grey, frame=Frame(through="y"), params=SurfaceParams(seed_um=seed))
    assert abs(np.nanmean(found["top"].values - sheet.surfaces()["top"])) < 0.2


@pytest.mark.parametrize("voxels", [3, 4, 6])
def test_a_point_in_the_only_sheet_changes_nothing(voxels):
    """However thin and sharp it is: nothing beside it has to be told apart from it."""
    z, y, x = np.ogrid[:60, :70, :80]
    middle = 30 + 8 * np.sin(x / 30) * np.cos(y / 40)
    grey = np.where(abs(z - middle) <= voxels / 2, 100.0, 40.0) + np.random.default_rng(0).normal(0, 4, (60, 70, 80))
    data = volume(np.clip(np.rint(grey), 0, 255).astype(np.uint8), 4.0)
    plain = find_surfaces(data)
    for row, col in ((35, 40), (10, 70)):
        at = (4.0 * float(middle[0, row, col]), 4.0 * row, 4.0 * col)
        found = find_surfaces(data, params=SurfaceParams(seed_um=at))
        assert (found["status"].values == plain["status"].values).mean() > 0.999
        for name in ("top", "bottom", "centre"):
            np.testing.assert_allclose(found[name], plain[name], atol=0.1)


def test_thin_sheets_on_top_of_each_other_are_told_apart_by_a_point():
    z, y, x = np.ogrid[:80, :70, :80]
    middle = 25 + 4 * np.sin(x / 30) * np.cos(y / 40)
    inside = (abs(z - middle) <= 2) | (abs(z - middle - 25) <= 2)
    grey = np.where(inside, 100.0, 40.0) + np.random.default_rng(0).normal(0, 4, inside.shape)
    data = volume(np.clip(np.rint(grey), 0, 255).astype(np.uint8), 4.0)
    for offset in (0, 25):
        at = (4.0 * float(middle[0, 35, 40] + offset), 4.0 * 35, 4.0 * 40)
        found = find_surfaces(data, params=SurfaceParams(seed_um=at))
        assert (found["status"].values == 0).mean() > 0.9
        assert abs(np.nanmedian(found["centre"].values - 4.0 * (middle[0] + offset))) < 1.0


def test_only_points_from_which_a_sheet_can_be_followed_are_listed():
    """Three sheets, of which the outermost leaves the volume at its end."""
    grey, middle = stack()
    with pytest.raises(VolumeError, match="3 separate sheets") as told:
        find_surfaces(grey.sel(z=slice(middle - 75.0, None)))
    points = str(told.value).split("Points to start from: ")[1].rstrip(".").split("; ")
    heights = sorted(float(point.split(",")[0]) for point in points)
    np.testing.assert_allclose(np.diff(heights), [75.0], atol=10.0)  # of the other two
