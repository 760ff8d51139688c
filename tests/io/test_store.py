"""The working store: what goes in comes out, whatever stops it half-way."""

import errno
import hashlib

import numpy as np
import pytest
import xarray as xr
import zarr

from folders import bytes_of, refused
from planish.core.errors import FileError, InputError, ResourceError
from planish.io import hashes, read_volume, store, write_store
from planish.io import store as module

VOXEL = [2.0, 1.5, 1.5]


def volume(shape=(38, 74, 200), dtype=np.uint8, seed=0):
    values = np.random.default_rng(seed).integers(0, 200, shape).astype(dtype)
    coords = {k: np.arange(n) * v for k, n, v in zip("zyx", shape, VOXEL, strict=True)}
    attrs = {"voxel_um": VOXEL, "file_name": "made", "file_bytes": values.nbytes, "full_scale": 255}
    return xr.DataArray(values, dims=("z", "y", "x"), coords=coords, attrs=attrs)


@pytest.fixture(autouse=True)
def small_shards(monkeypatch):
    monkeypatch.setattr(module, "CHUNK", (16, 24, 24))
    monkeypatch.setattr(module, "SHARD", (16, 48, 48))
    monkeypatch.setattr(module, "_SMALLEST", 60)
    monkeypatch.setattr(module, "_LEAST_DEPTH", 8)


@pytest.mark.parametrize(
    ("ome", "dtype"), [("0.5", np.uint8), ("0.4", np.uint16), ("0.5", np.float32)]
)
def test_what_goes_in_comes_out(tmp_path, ome, dtype):
    data = volume(dtype=dtype)
    write_store(data, tmp_path / "s.zarr", ome=ome)
    back = read_volume(tmp_path / "s.zarr")
    np.testing.assert_array_equal(back.values, data.values)
    assert (back.dtype, back.attrs["voxel_um"]) == (data.dtype, VOXEL)
    assert not list(tmp_path.glob(".*"))


def test_coarser_levels_are_means_also_at_odd_ends(tmp_path):
    data = volume()
    write_store(data, tmp_path / "s.zarr")
    group = zarr.open_group(tmp_path / "s.zarr", mode="r")
    assert [group[k].shape for k in sorted(group.array_keys())] == [
        (38, 74, 200),
        (19, 37, 100),
        (10, 19, 50),
    ]
    whole = data.values.reshape(19, 2, 37, 2, 100, 2).mean(axis=(1, 3, 5))
    assert np.abs(group["1"][:] - whole).max() <= 0.5
    np.testing.assert_array_equal(group["2"][:], store.halve(group["1"][:]))
    scales = [
        d["coordinateTransformations"] for d in group.attrs["ome"]["multiscales"][0]["datasets"]
    ]
    moved = {"type": "translation", "translation": [1.0, 0.75, 0.75]}
    assert scales[1] == [{"type": "scale", "scale": [4.0, 3.0, 3.0]}, moved]


def test_neither_memory_nor_threads_change_a_byte(tmp_path):
    data = volume()
    write_store(data, tmp_path / "a.zarr", memory_bytes=2**31)
    write_store(data, tmp_path / "b.zarr", memory_bytes=2**20, threads=1)
    assert bytes_of(tmp_path / "a.zarr") == bytes_of(tmp_path / "b.zarr")
    assert hashes.store_fingerprint(tmp_path / "a.zarr") == hashes.store_fingerprint(
        tmp_path / "b.zarr"
    )


class Stop(BaseException):
    pass


def raising(error):
    """A function that only raises."""

    def stop(*_args, **_more):
        raise error

    return stop


@pytest.mark.parametrize("after", [0, 3, 7])
def test_an_import_that_was_killed_goes_on(tmp_path, monkeypatch, after):
    data = volume()
    write, whole = module._write_shards, []
    monkeypatch.setattr(module, "_write_shards", lambda *a: (whole.append(a[1]), write(*a))[1])
    write_store(data, tmp_path / "whole.zarr", memory_bytes=2**20)
    done = []

    def stops(level, where, *more):
        if len(done) == after:
            raise Stop
        done.append(where)
        return write(level, where, *more)

    monkeypatch.setattr(module, "_write_shards", stops)
    with pytest.raises(Stop):
        write_store(data, tmp_path / "s.zarr", memory_bytes=2**20)
    assert not (tmp_path / "s.zarr").exists()
    again = []
    monkeypatch.setattr(module, "_write_shards", lambda *a: (again.append(a[1]), write(*a))[1])
    write_store(data, tmp_path / "s.zarr", memory_bytes=2**20)
    # A block and its half are one step: where the half was missing, on either thread, the block is
    # written again.
    assert len(again) <= len(whole) - after + 2
    assert bytes_of(tmp_path / "s.zarr") == bytes_of(tmp_path / "whole.zarr")


def test_empty_chunks_are_written_by_an_import_that_goes_on(tmp_path, monkeypatch):
    data = xr.zeros_like(volume())
    with monkeypatch.context() as patch:
        patch.setattr(module, "_write_coarser_level", raising(Stop))
        with pytest.raises(Stop):
            write_store(data, tmp_path / "s.zarr")
    for shard in (tmp_path / ".s.zarr.partial" / "0").rglob("checksums.sha256"):
        shard.write_text("")
    (tmp_path / ".s.zarr.partial" / "0" / "c" / "0" / "0" / "0.ab12.partial").write_bytes(b"half")
    write_store(data, tmp_path / "s.zarr")
    write_store(data, tmp_path / "whole.zarr")
    assert bytes_of(tmp_path / "s.zarr") == bytes_of(tmp_path / "whole.zarr")


def test_another_volume_does_not_go_on_with_it(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_write_finest_levels", raising(Stop))
    with pytest.raises(Stop):
        write_store(volume(), tmp_path / "s.zarr")
    refused(
        InputError,
        "another volume stopped",
        write_store,
        volume(shape=(38, 74, 201)),
        tmp_path / "s.zarr",
    )


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "full"), RuntimeError("wires crossed")])
def test_an_import_that_fails_leaves_nothing_and_blocks_nothing(tmp_path, monkeypatch, error):
    with monkeypatch.context() as patch:
        patch.setattr(module, "_write_coarser_level", raising(error))
        with pytest.raises(
            RuntimeError if isinstance(error, RuntimeError) else ResourceError
        ) as raised:
            write_store(volume(), tmp_path / "s.zarr")
        if isinstance(error, OSError):
            assert "MB are free" in str(raised.value)
            assert "it takes about" in str(raised.value)
    assert list(tmp_path.iterdir()) == []
    write_store(volume(shape=(38, 74, 201)), tmp_path / "s.zarr")
    assert [p.name for p in tmp_path.iterdir()] == ["s.zarr"]
    assert not list((tmp_path / "s.zarr").glob("*lock*"))


def test_two_imports_at_once_do_not_meet(tmp_path, monkeypatch):
    inner = module._write_finest_levels

    def second(*args, **more):
        refused(FileError, "Another planish is writing", write_store, volume(), tmp_path / "s.zarr")
        inner(*args, **more)

    monkeypatch.setattr(module, "_write_finest_levels", second)
    write_store(volume(), tmp_path / "s.zarr")
    assert [p.name for p in tmp_path.iterdir()] == ["s.zarr"]


@pytest.mark.parametrize("note", [None, "", "[1]", '{"shape": [1, 2, 3]}'])
@pytest.mark.parametrize("link", [False, True])
def test_a_folder_in_the_way_is_neither_removed_nor_written_into(tmp_path, link, note):
    real = tmp_path / ("elsewhere" if link else ".s.zarr.partial")
    real.mkdir()
    if note is not None:
        (real / "source.json").write_text(note)
    if link:
        (tmp_path / ".s.zarr.partial").symlink_to(real, target_is_directory=True)
    before = bytes_of(tmp_path)
    refused(InputError, "give another name", write_store, volume(), tmp_path / "s.zarr")
    assert real.is_dir()
    assert not (tmp_path / "s.zarr").exists()
    assert bytes_of(tmp_path) == before


def changed_shards(path):
    """What ``sha256sum -c`` names in each level."""
    found = []
    for sums in sorted(path.glob("*/checksums.sha256")):
        for line in sums.read_text(encoding="utf-8").splitlines():
            sha, name = line.split("  ")
            if hashlib.sha256((sums.parent / name).read_bytes()).hexdigest() != sha:
                found.append(f"{sums.parent.name}/{name}")
    return found


def test_a_lost_or_changed_shard_is_named(tmp_path):
    write_store(volume(), tmp_path / "s.zarr")
    assert (hashes.missing_shards(tmp_path / "s.zarr"), changed_shards(tmp_path / "s.zarr")) == (
        [],
        [],
    )
    shards = sorted((tmp_path / "s.zarr" / "0" / "c").rglob("*"))
    victim = next(p for p in shards if p.is_file())
    name = victim.relative_to(tmp_path / "s.zarr").as_posix()
    whole = victim.read_bytes()
    victim.write_bytes(whole[:50] + bytes([whole[50] ^ 1]) + whole[51:])
    assert changed_shards(tmp_path / "s.zarr") == [name]
    victim.unlink()
    assert hashes.missing_shards(tmp_path / "s.zarr") == [name]
    with pytest.raises(FileError, match=r"shard|lost|missing"):
        read_volume(tmp_path / "s.zarr").values  # noqa: B018


def test_refusals_say_what_to_do(tmp_path):
    (tmp_path / "there.zarr").mkdir()
    refused(FileError, "exists already", write_store, volume(), tmp_path / "there.zarr")
    refused(ResourceError, "memory=", write_store, volume(), tmp_path / "s.zarr", memory_bytes=1000)


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.float32])
@pytest.mark.parametrize("shape", [(5, 7, 4), (1, 2, 9)])
def test_halving_equals_its_slow_twin(dtype, shape):
    values = np.random.default_rng(1).integers(0, 200, shape).astype(dtype)
    padded = np.pad(values, [(0, n % 2) for n in shape], mode="edge").astype(np.float64)
    z, y, x = (n // 2 for n in padded.shape)
    mean = padded.reshape(z, 2, y, 2, x, 2).mean(axis=(1, 3, 5))
    wanted = mean if dtype == np.float32 else np.floor(mean + 0.5)
    np.testing.assert_allclose(store.halve(values), wanted, rtol=1e-6)
