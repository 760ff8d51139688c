"""What every reader of volumes promises, checked for all of them alike."""

import pickle
import re
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from xarray.core.indexing import LazilyIndexedArray

from formats_written import CASES, CUBE, NAME, VALUES
from planish.core.errors import FileError, InputError, ResourceError, SizeError, VolumeError
from planish.io import describe, fingerprint, read_volume

LITTLE = 2500
"""Memory that lets a slice or a chunk be decoded, but not the volume."""

REMEDY = re.compile(
    r"\b(copy|export|give|add|save|check|correct|remove|move|leave|choose|put|run)\b", re.IGNORECASE
)

every_format = pytest.mark.parametrize("kind", CASES)
lazy_formats = pytest.mark.parametrize("kind", [kind for kind, case in CASES.items() if case.lazy])


def expected(case):
    return (VALUES >> 8).astype(np.uint8) if case.dtype == "uint8" else VALUES


def written(kind, tmp_path, *, size=True):
    """Write a case into a folder of its own; return it with its path, its folder, and what has to
    be given."""
    case = CASES[kind]
    folder = tmp_path / "Prüfling – Maß µ 1"
    folder.mkdir()
    path = case.write(folder, expected(case), case.voxel if size else None)
    return case, path, folder, {} if case.states_size else {"voxel_um": case.voxel}


def check_sentence(error):
    """A message names a file, tells a fault and ends with a remedy, in sentences."""
    message = str(error)
    assert NAME in message or "Núria" in message, message
    assert REMEDY.search(message), message
    assert message.endswith((".", '"')), message
    assert "\n" not in message


@every_format
def test_values_type_size_and_description_come_back_also_from_read_only_files(tmp_path, kind):
    case, path, folder, given = written(kind, tmp_path)
    volume = read_volume(path, **given)
    assert (volume.dims, volume.dtype) == (("z", "y", "x"), case.dtype)
    np.testing.assert_array_equal(volume.values, expected(case))
    assert volume.attrs["voxel_um"] == pytest.approx(case.voxel, rel=1e-5)
    assert case.source in volume.attrs["voxel_um_source"]
    for axis, step in zip("zyx", case.voxel, strict=True):
        np.testing.assert_allclose(volume[axis], np.arange(volume.sizes[axis]) * step, rtol=1e-5)
    assert volume.attrs["file_bytes"] > 0
    assert volume.attrs["full_scale"] == np.iinfo(case.dtype).max
    told = describe(path, **given)
    assert (told["kind"], told["shape"]) == ("volume", list(VALUES.shape))
    assert (told["min"], told["max"]) == (expected(case).min(), expected(case).max())
    assert told["size_um"] == pytest.approx(case.voxel, rel=1e-5)
    assert told["run_bytes"] > 1e8
    assert told["sampled"] is None
    assert re.fullmatch("[0-9a-f]{64}", fingerprint(path))
    before = {p: p.stat().st_mtime_ns for p in folder.rglob("*")}
    for p in sorted(folder.rglob("*"), reverse=True):
        p.chmod(0o555 if p.is_dir() else 0o444)
    folder.chmod(0o555)
    try:
        np.testing.assert_array_equal(read_volume(path, **given).values, expected(case))
        assert {p: p.stat().st_mtime_ns for p in folder.rglob("*")} == before
    finally:
        for p in (folder, *folder.rglob("*")):
            p.chmod(0o755)


@pytest.mark.ci
@lazy_formats
def test_parts_equal_the_whole_in_threads_and_in_another_process(tmp_path, kind):
    case, path, _, given = written(kind, tmp_path)
    whole = expected(case)
    volume = read_volume(path, memory_bytes=LITTLE, **given)
    assert isinstance(volume.variable._data, LazilyIndexedArray)
    for key in (
        {"z": slice(2, 7)},
        {"y": slice(3, 11), "x": slice(1, 2)},
        {"z": 5},
        {"z": -1, "y": slice(None, None, -3)},
        {"y": slice(16, 2, -2), "z": slice(1, None, 4)},
        {"x": [4, 1, 1]},
        {"z": slice(4, 4)},
        {"z": [0, 11], "y": 3},
    ):
        index = tuple(key.get(axis, slice(None)) for axis in "zyx")
        truth = whole
        for axis, k in reversed(list(enumerate(index))):  # one axis after the other, as isel does
            truth = truth[(slice(None),) * axis + (k,)]
        part = volume.isel(key)
        assert part.shape == truth.shape
        np.testing.assert_array_equal(part.values, truth, err_msg=str(key))
    np.testing.assert_array_equal(
        volume.isel(z=slice(2, 9)).isel(y=slice(4, 9)).values, whole[2:9, 4:9]
    )
    assert isinstance(volume.variable._data, LazilyIndexedArray)  # what was read is not kept
    np.testing.assert_array_equal(volume.values, whole)
    sent = pickle.loads(pickle.dumps(volume))
    rng = np.random.default_rng(5)
    parts = [
        tuple(slice(*sorted(rng.integers(0, n + 1, 2))) for n in whole.shape) for _ in range(24)
    ]
    with ThreadPoolExecutor(4) as pool:
        for source in (volume, sent):
            read = pool.map(lambda part, source=source: source[part].values, parts)
            for part, values in zip(parts, read, strict=True):
                np.testing.assert_array_equal(values, whole[part])


@pytest.mark.ci
@every_format
def test_a_cut_or_foreign_file_is_an_error_that_names_it(tmp_path, kind):
    case, path, folder, given = written(kind, tmp_path)
    data = case.data(folder)
    content = data.read_bytes()
    for share in (0.0, 0.3, 0.6, 0.97):
        data.write_bytes(content[: int(share * len(content))])
        with pytest.raises((FileError, VolumeError)) as caught:
            read_volume(path, **given)
        if not data.name.isdecimal():  # a chunk of a store has no name that a user knows
            check_sentence(caught.value)
        if case.lazy:
            with pytest.raises((FileError, VolumeError)):
                _ = read_volume(path, memory_bytes=LITTLE, **given).values
    data.write_bytes(b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n")
    with pytest.raises(InputError):
        read_volume(path, **given)
    data.unlink()
    if "Zarr" in kind:  # a chunk that is not there may be an empty one
        assert any(
            "chunks are not stored" in warning for warning in describe(path, **given)["warnings"]
        )
        return
    with pytest.raises(InputError):
        read_volume(path, **given)


@pytest.mark.parametrize("kind", [kind for kind, case in CASES.items() if case.resize is not None])
def test_a_wrong_declared_size_is_an_error(tmp_path, kind):
    case, path, folder, given = written(kind, tmp_path)
    assert case.resize is not None
    case.resize(folder)
    with pytest.raises((FileError, VolumeError)) as caught:
        read_volume(path, **given)
    check_sentence(caught.value)


@pytest.mark.parametrize("kind", [kind for kind, case in CASES.items() if case.states_size])
def test_a_size_that_contradicts_the_metadata_is_an_error(tmp_path, kind):
    _, path, _, _ = written(kind, tmp_path)
    with pytest.raises(SizeError, match=r"override_size=True") as caught:
        read_volume(path, voxel_um=7.0)
    check_sentence(caught.value)
    volume = read_volume(path, voxel_um=7.0, override_size=True)
    assert volume.attrs["voxel_um"] == [7.0] * 3
    assert "in place of" in volume.attrs["voxel_um_source"]


@every_format
def test_a_missing_voxel_size_is_an_error(tmp_path, kind):
    _, path, _, _ = written(kind, tmp_path, size=False)
    with pytest.raises(SizeError, match=r"voxel_um=") as caught:
        read_volume(path)
    check_sentence(caught.value)
    if kind != "NRecon":  # a log without its main number is not trusted
        assert read_volume(path, voxel_um=CUBE).attrs["voxel_um_source"] == "given"
        assert describe(path)["size_um"] is None


def test_not_even_a_slice_fits(tmp_path):
    for number, kind in enumerate(k for k, case in CASES.items() if case.lazy):
        place = tmp_path / str(number)
        place.mkdir()
        _, path, _, given = written(kind, place)
        if kind in ("BigTIFF pages", "NeXus", "raw"):  # rows are read where they lie
            assert (
                read_volume(path, memory_bytes=100, **given).isel(z=3, y=4).size == VALUES.shape[2]
            )
        else:
            with pytest.raises(ResourceError, match="GiB of memory"):
                read_volume(path, memory_bytes=100, **given)
