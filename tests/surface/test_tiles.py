"""The surface search in tiles, in wide columns, and on volumes that are not in memory."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from xarray.core.indexing import IndexingSupport, LazilyIndexedArray, explicit_indexing_adapter

from planish.core.frame import Frame
from planish.core.tiles import Engine
from planish.surface import LabelParams, SurfaceParams, columns, find_surfaces
from surface.sheets import VOXEL, Sheet, slab, volume

pytestmark = pytest.mark.ci


class Asked(xr.backends.BackendArray):
    """An array that notes how much of it is read at a time."""

    def __init__(self, array):
        self.array, self.shape, self.dtype, self.sizes = array, array.shape, array.dtype, []

    def __getitem__(self, key):
        return explicit_indexing_adapter(key, self.shape, IndexingSupport.BASIC, self.read)

    def read(self, key):
        part = self.array[key]
        self.sizes.append(part.size)
        return part.copy()


def lazy(array, voxel=VOXEL):
    asked = Asked(array)
    coords = {k: np.arange(n) * voxel for k, n in zip("zyx", array.shape, strict=True)}
    return (
        xr.DataArray(xr.Variable(("z", "y", "x"), LazilyIndexedArray(asked)), coords=coords),
        asked,
    )


def assert_same_bytes(one, other):
    assert list(one.data_vars) == list(other.data_vars)
    assert [
        name for name in one.data_vars if one[name].values.tobytes() != other[name].values.tobytes()
    ] == []
    np.testing.assert_equal(one.attrs, other.attrs)


def turned(through):
    grey, *_ = slab(shape=(70, 60, 75), wave=10.0, noise=20.0)
    grey = np.rint(np.clip(grey, 0, 255)).astype(np.uint8)
    return volume(np.moveaxis(grey, 0, "zyx".index(through)))


SHEET = Sheet(lateral=(50, 56), thickness=60.0, margin=15.0, coats=(14.0, 0.0))
WAYS = {
    "through z": (lambda: turned("z"), "z", SurfaceParams()),
    "through y": (lambda: turned("y"), "y", SurfaceParams()),
    "labels": (SHEET.labels, "z", SurfaceParams(labels=LabelParams())),
    "thresholds": (replace(SHEET, through="x").volume, "x", SurfaceParams(method="paper")),
}


@pytest.mark.parametrize("way", WAYS)
def test_neither_threads_nor_memory_change_a_byte(way):
    make, through, params = WAYS[way]
    data, frame = make(), Frame(through=through)
    one = find_surfaces(data, frame=frame, params=params, engine=Engine(threads=1))
    engine = Engine(threads=3, memory_bytes=2**20)
    assert len(columns.Columns(volume=data, frame=frame).tiles(engine)) > 1
    assert_same_bytes(find_surfaces(data, frame=frame, params=params, engine=engine), one)


def test_a_volume_on_disk_is_read_in_parts_and_gives_the_same():
    grey, *_ = slab(shape=(60, 210, 200), wave=10.0)
    grey = np.rint(grey).astype(np.uint8)
    data, asked = lazy(grey)
    found = find_surfaces(data, engine=Engine(threads=2, memory_bytes=2**21))
    assert max(asked.sizes) < 0.25 * grey.size
    assert_same_bytes(found, find_surfaces(volume(grey)))


@pytest.mark.parametrize(("step", "slope"), [(2, 0.5), (3, 0.0)])
def test_wide_columns_find_the_same_faces(step, slope):
    grey, middle, half = slab(shape=(110, 121, 130), height=165.0, slope=slope, noise=12.0)
    found = find_surfaces(volume(np.rint(grey).astype(np.uint8)), step=step)
    assert found.sizes == {"y": 121 // step, "x": 130 // step}
    x = found["x"].values
    assert x[0] == pytest.approx(0.5 * (step - 1) * VOXEL)
    truth = np.interp(x, np.arange(130) * VOXEL, middle[0, 0])
    inside = (slice(4, -4), slice(4, -4))
    for name, offset in {
        "top": half,
        "bottom": -half,
        "interface_top": 27.5,
        "centre": 0.0,
    }.items():
        error = (found[name].values - truth - offset * np.hypot(1, slope))[inside]
        assert abs(error.mean()) < 0.15
        assert np.sqrt(np.mean(error**2)) < 0.2 * VOXEL
    assert (found["status"].values[inside] == 0).mean() > 0.99


def test_a_run_that_stopped_goes_on_where_it_was(tmp_path):
    grey, *_ = slab(shape=(60, 100, 110))
    data = volume(grey.astype(np.float32))
    first = find_surfaces(data, engine=Engine(threads=1, memory_bytes=2**21, folder=tmp_path))
    kept = sorted(tmp_path.rglob("*.npy"))
    assert len(kept) > 6
    for path in kept[len(kept) // 2 :]:
        path.unlink()
    again = find_surfaces(data, engine=Engine(threads=2, memory_bytes=2**21, folder=tmp_path))
    assert_same_bytes(again, first)
