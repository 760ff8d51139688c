"""One of several objects, chosen by a point in it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import special

from folders import refused
from planish.core.errors import VolumeError
from planish.core.frame import Frame
from planish.surface import SurfaceParams, find_surfaces
from surface.sheets import Sheet, slab, volume

THIN = Sheet(
    lateral=(40, 44),
    thickness=40.0,
    coats=(0.0, 0.0),
    greys=(20.0, 120.0, 120.0),
    voxel=3.0,
    margin=120.0,
)


def stack(gap_grey=20.0, offsets=(-75.0, 0.0, 75.0), bright=1.0):
    """Sheets on top of each other, in air or in other material; the last one may be lighter."""
    single = THIN.volume().astype(float)
    middle = THIN.middle()[0][0, 0]
    z = single["z"].values[:, None, None]
    sigma = THIN.fwhm / 2.3548
    grey = np.full(single.shape, 20.0)

    def between(low, high):
        return special.ndtr((z - low) / sigma) - special.ndtr((z - high) / sigma)

    grey += (gap_grey - 20.0) * between(middle + offsets[0] - 30, middle + offsets[-1] + 30)
    for k, offset in enumerate(offsets):
        factor = bright if k == len(offsets) - 1 else 1.0
        grey += (20 + 100.0 * factor - gap_grey) * between(
            middle + offset - 20, middle + offset + 20
        )
    grey = grey + np.random.default_rng(0).normal(0, 3, grey.shape)
    return single.copy(data=np.clip(grey, 0, 255).astype(np.uint8)), middle


def points_named(grey):
    """Points (z, y, x) that the refusal of three sheets lists."""
    with pytest.raises(
        VolumeError, match=r"3 separate sheets.*seed_um=\(Z, Y, X\).*Points to start from"
    ) as told:
        find_surfaces(grey)
    points = str(told.value).split("Points to start from: ")[1].rstrip(".").split("; ")
    return [tuple(map(float, point.split(","))) for point in points]


@pytest.mark.ci
def test_several_sheets_are_named_with_a_point_in_each_that_chooses_it():
    grey, middle = stack()
    points = points_named(grey)
    assert len(points) == 3
    heights = []
    for point in points:
        found = find_surfaces(grey, params=SurfaceParams(seed_um=point))
        assert (found["status"].values == 0).mean() > 0.98
        assert found.attrs["thickness_um"] == pytest.approx(40.0, abs=0.5)
        heights.append(float(found["centre"].mean()) - middle)
    np.testing.assert_allclose(sorted(heights), [-75.0, 0.0, 75.0], atol=0.3)


@pytest.mark.parametrize(("gap", "offset"), [(70.0, 0.0), (95.0, 0.0), (70.0, -60.0)])
def test_the_level_outside_a_chosen_layer_is_that_of_the_gap(gap, offset):
    """Layers of which the outer ones leave the volume; a stack that stands alone in air needs its
    grey, too."""
    grey, middle = stack(gap_grey=gap, offsets=(-60.0, 0.0, 60.0), bright=1.8)
    seed = (middle + offset, 60.0, 60.0)
    params = SurfaceParams(seed_um=seed, sheet_grey=(95.0, 160.0) if offset else None)
    found = find_surfaces(grey if offset else grey.sel(z=slice(middle - 65.0, None)), params=params)
    assert (found["status"].values == 0).mean() > 0.98
    for face, half in (("top", 20), ("bottom", -20)):
        assert abs(np.nanmean(found[face].values - (middle + offset + half))) < 0.5


def test_where_two_sheets_touch_nothing_is_measured():
    flat = THIN.volume()
    grey, middle = stack(offsets=(0.0, 75.0))
    joined = grey.values.copy()
    z = flat["z"].values
    between = (z > middle) & (z < middle + 75.0)
    joined[between, 20:30, 20:30] = 120
    found = find_surfaces(
        grey.copy(data=joined), params=SurfaceParams(seed_um=(middle, 15.0, 15.0))
    )
    status = found["status"].values
    assert set(np.unique(status[20:30, 20:30])) == {5}
    assert np.isnan(found["top"].values[20:30, 20:30]).all()
    assert (status[:15] == 0).all()
    assert "touching" in found["status"].attrs["flag_meanings"]
    assert abs(np.nanmean(found["top"].values) - middle - 20) < 0.3


def test_a_seed_changes_little_in_a_single_sheet_and_is_refused_where_it_lies_nowhere():
    grey, middle, _ = slab(wave=10.0)
    plain = find_surfaces(volume(grey))
    seeded = find_surfaces(
        volume(grey), params=SurfaceParams(seed_um=(float(middle[0, 20, 30]), 60.0, 90.0))
    )
    for name in ("top", "bottom", "interface_top", "interface_bottom"):
        np.testing.assert_allclose(seeded[name], plain[name], atol=0.2)
    grey, middle = stack()
    for words, seed in (
        ("only air", (middle + 37.0, 60.0, 60.0)),
        ("outside the volume", (middle, 60.0, 6000.0)),
    ):
        refused(VolumeError, words, find_surfaces, grey, params=SurfaceParams(seed_um=seed))


def test_a_tilted_sheet_through_another_axis():
    sheet = replace(THIN, through="y", tilt=(20.0, 0.0), margin=30.0)
    grey = sheet.volume()
    middle = sheet.middle()[0]
    seed = (25 * 3.0, float(middle[25, 27]), 27 * 3.0)
    found = find_surfaces(grey, frame=Frame(through="y"), params=SurfaceParams(seed_um=seed))
    assert abs(np.nanmean(found["top"].values - sheet.surfaces()["top"])) < 0.2


def wavy(voxels, *others):
    """A thin and sharp sheet, perhaps with others above it; the height of its middle, both in
    voxels of 4 um."""
    z, y, x = np.ogrid[:66, :48, :56]
    middle = 22 + 8 * np.sin(x / 30) * np.cos(y / 40)
    inside = np.any([abs(z - middle - other) <= voxels / 2 for other in (0, *others)], axis=0)
    grey = np.where(inside, 100.0, 40.0) + np.random.default_rng(0).normal(0, 4, inside.shape)
    return volume(np.clip(np.rint(grey), 0, 255).astype(np.uint8), 4.0), middle[0]


def in_wavy(data, middle, row, col, offset=0):
    seed = (4.0 * float(middle[row, col] + offset), 4.0 * row, 4.0 * col)
    return find_surfaces(data, params=SurfaceParams(seed_um=seed))


@pytest.mark.parametrize("voxels", [3, 6])
def test_a_point_in_the_only_sheet_changes_nothing(voxels):
    """However thin and sharp it is: nothing beside it has to be told apart from it."""
    data, middle = wavy(voxels)
    plain = find_surfaces(data)
    found = in_wavy(data, middle, 8, 48)
    assert (found["status"].values == plain["status"].values).mean() > 0.999
    for name in ("top", "bottom", "centre"):
        np.testing.assert_allclose(found[name], plain[name], atol=0.1)


def test_thin_sheets_on_top_of_each_other_are_told_apart_by_a_point():
    data, middle = wavy(4, 25)
    for offset in (0, 25):
        found = in_wavy(data, middle, 25, 30, offset)
        assert (found["status"].values == 0).mean() > 0.9
        assert abs(np.nanmedian(found["centre"].values - 4.0 * (middle + offset))) < 1.0


def test_only_points_from_which_a_sheet_can_be_followed_are_listed():
    """Three sheets, of which the outermost leaves the volume at its end."""
    grey, middle = stack()
    heights = sorted(z for z, _y, _x in points_named(grey.sel(z=slice(middle - 75.0, None))))
    np.testing.assert_allclose(np.diff(heights), [75.0], atol=10.0)  # of the other two
