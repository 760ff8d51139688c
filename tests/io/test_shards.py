"""Chunks of a working store, decoded by the reading threads: the values that zarr gives, and no
damaged ones."""

import numpy as np
import pytest
import zarr

import planish
from folders import refused
from planish.core.errors import FileError
from planish.io import read_volume, shards, store


@pytest.fixture(autouse=True)
def small_shards(monkeypatch):
    monkeypatch.setattr(store, "CHUNK", (16, 24, 20))
    monkeypatch.setattr(store, "SHARD", (32, 48, 40))


def made(path, dtype):
    values = np.random.default_rng(0).integers(0, 200, (70, 130, 100)).astype(dtype)
    store.write_store(planish.volume(values, voxel_um=2.0), path)
    return zarr.open_array(path, path="0", mode="r")


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_parts_are_those_that_zarr_reads(tmp_path, dtype):
    array = made(tmp_path / "a.zarr", dtype)
    assert shards.is_plain(array)
    rng = np.random.default_rng(0)
    for _ in range(30):
        ends = [np.sort(rng.choice(n + 1, 2, replace=False)).tolist() for n in array.shape]
        where = tuple(slice(start, stop, 1) for start, stop in ends)
        np.testing.assert_array_equal(
            shards.read_plain(tmp_path / "a.zarr" / "0", array, where), array[where]
        )


def test_a_shard_that_is_not_there_holds_the_fill_value_as_for_zarr(tmp_path):
    array = made(tmp_path / "a.zarr", np.uint8)
    (tmp_path / "a.zarr" / "0" / "c" / "0" / "1" / "1").unlink()
    whole = tuple(slice(0, n, 1) for n in array.shape)
    np.testing.assert_array_equal(
        shards.read_plain(tmp_path / "a.zarr" / "0", array, whole), array[whole]
    )


def test_a_shard_with_a_changed_byte_or_without_its_end_is_found(tmp_path):
    made(tmp_path / "a.zarr", np.uint8)
    shard = tmp_path / "a.zarr" / "0" / "c" / "1" / "1" / "1"
    whole = shard.read_bytes()
    for at in (20, 3000, -3, -30, "cut"):
        data = bytearray(whole)
        if at == "cut":
            del data[40:]
        else:
            data[at] ^= 0x10
        shard.write_bytes(data)
        refused(FileError, "cannot be decoded", lambda: read_volume(tmp_path / "a.zarr").values)


def test_other_codecs_and_byte_orders_are_left_to_zarr(tmp_path):
    zstd, turned = zarr.codecs.ZstdCodec(), zarr.codecs.TransposeCodec(order=(2, 1, 0))
    sharded = {"shards": (40, 48, 40)}
    for number, options in enumerate(
        (
            {"compressors": zstd},
            sharded | {"compressors": zarr.codecs.BloscCodec()},
            sharded | {"compressors": None},
            sharded | {"compressors": zstd, "filters": [turned]},
            sharded | {"compressors": zstd, "serializer": zarr.codecs.BytesCodec(endian="big")},
        )
    ):
        path = tmp_path / f"{number}.zarr"
        array = zarr.create_array(
            path, shape=(40, 48, 40), dtype="u2", chunks=(20, 24, 20), **options
        )
        assert not shards.is_plain(array)
