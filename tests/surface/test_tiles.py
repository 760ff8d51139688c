"""The surface search in tiles, in wide columns, and on volumes that are not in memory."""

import numpy as np
import pytest
import xarray as xr
from xarray.core.indexing import ExplicitIndexer, IndexingSupport, LazilyIndexedArray, explicit_indexing_adapter

from planish.core.frame import Frame
from planish.core.tiles import Engine
from planish.surface import columns, find_surfaces
from surface.sheets import VOXEL, slab, volume

NAMES = (
    "top", "bottom", "interface_top", "interface_bottom", "centre", "presence", "presence_centre", "presence_bottom",
    "status",
)  # fmt: skip


class Asked(xr.backends.BackendArray):
    """An array that notes how much of it is read at a time."""

    def __init__(self, array):
        self.array, self.shape, self.dtype, self.most = array, array.shape, array.dtype, 0

    def __getitem__(self, key: ExplicitIndexer):
        return explicit_indexing_adapter(key, self.shape, IndexingSupport.BASIC, self.read)

    def read(self, key):
        part = self.array[key]
        self.most = max(self.most, part.size)
        return part.copy()


def lazy(array, voxel=VOXEL):
    asked = Asked(array)
    coords = {k: np.arange(n) * voxel for k, n in zip("zyx", array.shape, strict=True)}
    return xr.DataArray(xr.Variable(("z", "y", "x"), LazilyIndexedArray(asked)), coords=coords), asked


@pytest.mark.parametrize("through", ["z", *(pytest.param(k, marks=pytest.mark.nightly) for k in "yx")])
def test_neither_threads_nor_memory_change_a_byte(through):
    grey, *_ = slab(shape=(70, 90, 110), wave=10.0, noise=20.0)
    data = volume(np.moveaxis(np.rint(np.clip(grey, 0, 255)).astype(np.uint8), 0, "zyx".index(through)))
    frame = Frame(through=through)
    one = find_surfaces(data, frame=frame, engine=Engine(threads=1))
    for threads, memory in ((2, 2**22), (3, 2**20)):
        engine = Engine(threads=threads, memory_bytes=memory)
        assert len(columns.Columns(volume=data, frame=frame).tiles(engine)) > 1
        other = find_surfaces(data, frame=frame, engine=engine)
        for name in NAMES:
            assert one[name].values.tobytes() == other[name].values.tobytes(), name
        assert one.attrs == other.attrs


def test_a_volume_on_disk_is_read_in_parts_and_gives_the_same():
    grey, *_ = slab(shape=(60, 120, 130), wave=10.0)
    grey = np.rint(grey).astype(np.uint8)
    data, asked = lazy(grey)
    found = find_surfaces(data, engine=Engine(threads=2, memory_bytes=2**22))
    assert asked.most < 0.25 * grey.size
    whole = find_surfaces(volume(grey))
    for name in NAMES:
        assert found[name].values.tobytes() == whole[name].values.tobytes(), name


@pytest.mark.parametrize("step", [2, 3])
@pytest.mark.parametrize("slope", [0.0, 0.5])
def test_wide_columns_find_the_same_faces(step, slope):
    grey, middle, half = slab(shape=(110, 121, 130), height=165.0, slope=slope, noise=12.0)
    found = find_surfaces(volume(np.rint(grey).astype(np.uint8)), step=step)
    assert found.sizes == {"y": 121 // step, "x": 130 // step}
    x = found["x"].values
    assert x[0] == pytest.approx(0.5 * (step - 1) * VOXEL)
    truth = np.interp(x, np.arange(130) * VOXEL, middle[0, 0])
    stretch = np.hypot(1, slope)
    inside = (slice(4, -4), slice(4, -4))
    for name, offset in {"top": half, "bottom": -half, "interface_top": 27.5, "centre": 0.0}.items():
        error = (found[name].values - truth - offset * stretch)[inside]
        print(f"step {step} slope {slope} {name}: bias {error.mean():.3f} um, rms {np.sqrt(np.mean(error**2)):.3f} um")
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
    for name in NAMES:
        assert first[name].values.tobytes() == again[name].values.tobytes(), name
