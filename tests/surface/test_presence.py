"""Share of material in three layers of the sheet."""

import numpy as np
import pytest
from scipy import ndimage

from planish.core.frame import Frame
from planish.core.tiles import Engine
from planish.surface import LabelParams, SurfaceParams, assemble, columns, find_surfaces
from surface.sheets import VOXEL, Sheet, slab, volume
from surface.test_tiles import lazy

AIR, BASE = 20.0, 180.0
THICKNESS = 80.0
ONE = Engine(threads=1, memory_bytes=2**31)


def wavy(shape=(60, 70, 90), slope=(0.1, -0.2), seed=0):
    """Grey noise, and a centre surface through it that leaves the volume at one end."""
    rng = np.random.default_rng(seed)
    grey = rng.integers(0, 200, shape).astype(np.uint8)
    y, x = np.mgrid[: shape[1], : shape[2]] * VOXEL
    centre = (
        0.5 * shape[0] * VOXEL
        + slope[0] * (y - y.mean())
        + slope[1] * (x - x.mean())
        + 4 * np.sin(x / 60)
    )
    centre[rng.random(centre.shape) < 0.02] = np.nan
    return grey, centre


def along_normals(grey, centre, places):
    """Mean share at some places along the normal, by scipy's linear interpolation."""
    slope = np.gradient(centre, VOXEL)
    long = np.sqrt(1 + slope[0] ** 2 + slope[1] ** 2)
    rows, cols = np.indices(centre.shape)
    found = []
    for s in np.asarray(places) * THICKNESS:
        at = (
            centre / VOXEL + s / long / VOXEL,
            rows - s * slope[0] / long / VOXEL,
            cols - s * slope[1] / long / VOXEL,
        )
        inside = np.all(
            [(a >= 0) & (a <= n - 1) for a, n in zip(at, grey.shape, strict=True)], axis=0
        )
        value = ndimage.map_coordinates(
            grey.astype(float), [np.where(inside, a, 0) for a in at], order=1
        )
        found.append(np.where(inside, np.clip((value - AIR) / (BASE - AIR), 0, 1), np.nan))
    known = np.isfinite(found).any(axis=0)
    return np.where(
        known, np.nansum(found, axis=0) / np.maximum(np.isfinite(found).sum(axis=0), 1), np.nan
    )


def presence(data, centre, *, frame=None, up=1.0, engine=ONE):
    sheet = columns.Columns(volume=data, frame=frame or Frame())
    return assemble.find_presence(sheet, centre, THICKNESS, up, (AIR, BASE), engine)


@pytest.mark.parametrize("slope", [(0.1, -0.2), (0.4, 0.9)])
@pytest.mark.parametrize("through", ["z", "x"])
def test_the_layers_are_means_along_the_normals(slope, through):
    grey, centre = wavy(slope=slope)
    data = volume(np.moveaxis(grey, 0, "zyx".index(through)))
    found = presence(data, centre, frame=Frame(through=through))
    assert list(found) == ["presence", "presence_centre", "presence_bottom"]
    step = 0.32 / 6
    places = {
        "presence": 0.1 + step * np.arange(7),
        "presence_centre": [0, 0.1 - step, step - 0.1, 0.1, -0.1, 0.1 + step, -0.1 - step],
        "presence_bottom": -0.1 - step * np.arange(7),
    }
    for name, at in places.items():
        assert (min(at), max(at)) == pytest.approx(assemble.LAYERS[name])
        np.testing.assert_allclose(found[name], along_normals(grey, centre, at), atol=1e-9)


def test_turned_over_the_top_is_the_bottom_and_missing_voxels_stay_missing():
    grey, centre = wavy()
    high, low = (presence(volume(grey), centre, up=up) for up in (1.0, -1.0))
    assert high["presence"].tobytes() == low["presence_bottom"].tobytes()
    assert high["presence_bottom"].tobytes() == low["presence"].tobytes()
    np.testing.assert_allclose(high["presence_centre"], low["presence_centre"], atol=1e-12)
    grey = np.full((60, 40, 40), BASE, np.float32)
    grey[:, 10, 10] = np.nan
    centre = np.full((40, 40), 12.0)
    found = presence(volume(grey), centre)
    # 12 um above the volume's low end, the bottom's layer is seen in part: what is there counts.
    assert np.isnan(found["presence"][10, 10])
    assert found["presence"][30, 30] == found["presence_bottom"][30, 30] == 1.0
    below = presence(volume(grey), centre - 8.0)
    assert np.isnan(below["presence_bottom"]).all()
    assert np.isfinite(below["presence_centre"][30, 30])


def test_the_volume_is_read_once_for_all_layers():
    grey, _ = wavy(shape=(60, 120, 130))
    centre = np.full((120, 130), 30 * VOXEL + 0.3)
    data, asked = lazy(grey)
    found = presence(data, centre, engine=Engine(threads=2, memory_bytes=2**22))
    assert len(asked.sizes) > 1
    # Of the depth only what the layers reach, and a voxel or two around each tile.
    reach = 2 * 0.42 * THICKNESS / VOXEL + 3
    assert sum(asked.sizes) < 1.2 * reach / 60 * grey.size
    whole = presence(volume(grey), centre)
    assert all(found[name].tobytes() == whole[name].tobytes() for name in assemble.LAYERS)


@pytest.mark.ci
@pytest.mark.parametrize("top", ["high", "low"])
def test_the_surfaces_carry_all_three(top):
    """A hole burnt from the top down to the centre surface, and one that goes through."""
    grey, middle, _ = slab(shape=(70, 90, 104), noise=1.0)
    z, y, x = np.meshgrid(*(np.arange(n) * VOXEL for n in grey.shape), indexing="ij")
    grey[(np.hypot(x - 90, y - 135) < 40) & (z > middle) | (np.hypot(x - 225, y - 135) < 40)] = 40.0
    data = volume(np.rint(grey if top == "high" else grey[::-1]).astype(np.uint8))
    found = find_surfaces(data, frame=Frame(top=top))
    places = [45, 45, 5], [30, 75, 52]  # in the blind hole, in the other one, in the sheet
    # The blind hole's floor draws the centre surface down by some micrometres: more than half of
    # its layer is there.
    for name, values in {
        "presence": (0, 0, 1),
        "presence_centre": (0.7, 0, 1),
        "presence_bottom": (1, 0, 1),
    }.items():
        np.testing.assert_allclose(found[name].values[places], values, atol=0.1)
        assert (found[name].dtype, found[name].attrs["units"]) == (found["presence"].dtype, "1")
        assert found[name].attrs["layer"] == list(assemble.LAYERS[name])
    assert len({found[name].attrs["long_name"] for name in assemble.LAYERS}) == 3


def test_labels_carry_all_three():
    sheet = Sheet(lateral=(50, 56), thickness=60.0, margin=15.0, coats=(14.0, 0.0))
    labels = sheet.labels()
    labels.values[:, 20:30, 20:30] = 0
    found = find_surfaces(labels, params=SurfaceParams(rim_um=5.0, labels=LabelParams()))
    for name in assemble.LAYERS:
        assert (found[name].values[25, 25], found[name].values[5, 5]) == (0.0, 1.0)
