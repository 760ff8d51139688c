"""Chunks of a working store, decoded by the reading threads: the values that zarr gives, and no damaged ones."""

from pathlib import Path

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


def made(path: Path, dtype) -> zarr.Array:
    values = np.random.default_rng(0).integers(0, 200, (70, 130, 100)).astype(dtype)
    store.write_store(planish.volume(values, voxel_um=2.0), path)
    return zarr.open_array(path, path="0", mode="r")


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_parts_are_those_that_zarr_reads(tmp_path, dtype):
    array = made(tmp_path / "a.zarr", dtype)
    assert shards.is_plain(array)
    rng = np.random.default_rng(0)
    for _ in range(60):
        ends = [np.sort(rng.choice(n + 1, 2, replace=False)).tolist() for n in array.shape]
        where = tuple(slice(start, stop, 1) for start, stop in ends)
        np.testing.assert_array_equal(shards.read_plain(tmp_path / "a.zarr" / "0", array, where), array[where])


def test_a_shard_that_is_not_there_holds_the_fill_value_as_for_zarr(tmp_path):
    array = made(tmp_path / "a.zarr", np.uint8)
    (tmp_path / "a.zarr" / "0" / "c" / "0" / "1" / "1").unlink()
    whole = tuple(slice(0, n, 1) for n in array.shape)
    np.testing.assert_array_equal(shards.read_plain(tmp_path / "a.zarr" / "0", array, whole), array[whole])


@pytest.mark.parametrize("at", [20, 3000, -3, -30])
def test_a_byte_that_changed_is_found(tmp_path, at):
    made(tmp_path / "a.zarr", np.uint8)
    shard = tmp_path / "a.zarr" / "0" / "c" / "1" / "1" / "1"
    data = bytearray(shard.read_bytes())
    data[at] ^= 0x10
    shard.write_bytes(data)
    refused(FileError, "cannot be decoded", lambda: read_volume(tmp_path / "a.zarr").values)


def test_a_shard_that_was_cut_is_found(tmp_path):
    made(tmp_path / "a.zarr", np.uint8)
    shard = tmp_path / "a.zarr" / "0" / "c" / "1" / "1" / "1"
    shard.write_bytes(shard.read_bytes()[:40])
    refused(FileError, "cannot be decoded", lambda: read_volume(tmp_path / "a.zarr").values)


def test_other_codecs_are_left_to_zarr(tmp_path):
    zstd, turned = zarr.codecs.ZstdCodec(), zarr.codecs.TransposeCodec(order=(2, 1, 0))
    sharded = {"shards": (40, 48, 40)}
    for number, options in enumerate((
        {"compressors": zstd}, sharded | {"compressors": zarr.codecs.BloscCodec()}, sharded | {"compressors": None},
        sharded | {"compressors": zstd, "filters": [turned]},
    )):  # fmt: skip
        path = tmp_path / f"{number}.zarr"
        array = zarr.create_array(path, shape=(40, 48, 40), dtype="u1", chunks=(20, 24, 20), **options)
        assert not shards.is_plain(array)


def test_another_byte_order_reads_as_zarr_reads_it(tmp_path):
    values = np.arange(40 * 48 * 40, dtype=np.uint16).reshape(40, 48, 40)
    array = zarr.create_array(
        tmp_path / "big.zarr", shape=values.shape, dtype="u2", chunks=(20, 24, 20), shards=(40, 48, 40),
        serializer=zarr.codecs.BytesCodec(endian="big"), compressors=zarr.codecs.ZstdCodec(),
    )  # fmt: skip
    array[...] = values
    assert not shards.is_plain(zarr.open_array(tmp_path / "big.zarr", mode="r"))
