"""Bands of a map straight from its chunks are those that zarr reads."""

import numpy as np
import pytest
import xarray as xr
import zarr
from tests.exports.contents import maps

from planish.exports import Maps
from planish.exports.content import Chunks
from planish.io import map_store

SHAPE = (1100, 700)


def stored(tmp_path, values, **more):
    how = {"chunks": (512, 256), "compressors": map_store.CODECS, "fill_value": 0} | more
    array = zarr.create_array(tmp_path / "one", data=values, **how)
    data = xr.Dataset({"one": (("y", "x"), values.copy())}, coords=maps(SHAPE).data.coords)
    return array, Maps(data=data, group="linked", levels={"one": [tmp_path / "one"]})


def whole(content, dtype=None):
    return np.concatenate([part for _, part in content.bands("one", dtype)])


@pytest.mark.parametrize("kind", ["float32", "float64", "uint8", "bool"])
def test_chunks_give_the_values_of_the_map(tmp_path, kind):
    values = np.random.default_rng(1).integers(0, 2 if kind == "bool" else 90, SHAPE).astype(kind)
    if kind.startswith("float"):
        values[values < 9] = np.nan
    _, content = stored(tmp_path, values)
    assert Chunks.of(tmp_path / "one", SHAPE, values.dtype) is not None
    content.data["one"].values[:] = 0  # so that what comes can be from the chunks only
    np.testing.assert_array_equal(whole(content), values)
    assert whole(content).dtype == (np.uint8 if kind == "bool" else values.dtype)
    np.testing.assert_array_equal(whole(content, np.float32), values.astype(np.float32))


@pytest.mark.parametrize(
    "more",
    [
        {"chunks": (256, 256)}, {"shards": (1024, 512)},
        {"compressors": zarr.codecs.ZstdCodec(level=1, checksum=True)}, {"compressors": map_store.CODECS[:1]},
        {"compressors": None}, {"attributes": {"scale_factor": 2.0}},
        {"serializer": zarr.codecs.BytesCodec(endian="big")},
        {"filters": zarr.codecs.TransposeCodec(order=(1, 0))}, {"chunk_key_encoding": {"name": "v2", "separator": "/"}},
    ],
)  # fmt: skip
def test_another_form_is_left_to_zarr(tmp_path, more):
    values = np.random.default_rng(1).random(SHAPE, np.float32)
    _, content = stored(tmp_path, values, **more)
    assert Chunks.of(tmp_path / "one", SHAPE, values.dtype) is None
    np.testing.assert_array_equal(whole(content), values)


def test_another_type_or_size_is_left_to_zarr(tmp_path):
    stored(tmp_path, np.ones(SHAPE, np.float32))
    assert Chunks.of(tmp_path / "one", SHAPE, np.dtype(np.float64)) is None
    assert Chunks.of(tmp_path / "one", SHAPE[::-1], np.dtype(np.float32)) is None


@pytest.mark.parametrize("damage", ["gone", "short", "changed", "other"])
def test_a_damaged_chunk_is_left_to_the_reader_of_the_store(tmp_path, damage):
    """What stands there is never taken: not a chunk of another size, either."""
    array, content = stored(tmp_path, np.ones(SHAPE, np.float32))
    chunk = tmp_path / "one" / "c" / "1" / "1"
    data = bytearray(chunk.read_bytes())
    if damage == "gone":
        chunk.unlink()
    elif damage == "other":
        small = zarr.create_array(tmp_path / "two", data=np.ones((4, 4), np.float32), chunks=(4, 4))
        chunk.write_bytes((tmp_path / "two" / "c" / "0" / "0").read_bytes())
        assert small.shape == (4, 4)
    else:
        data[len(data) // 2] ^= 1
        chunk.write_bytes(data if damage == "changed" else data[: len(data) // 2])
    content.data["one"].values[:] = 7
    found = whole(content)
    assert (found[512:1024] == 7).all()
    assert (found[:512] == 1).all()
    assert array.shape == SHAPE
