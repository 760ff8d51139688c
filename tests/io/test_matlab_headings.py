"""What the headings of a MATLAB file declare is checked before its values are read."""

import struct
import zlib

import numpy as np
import pytest
from scipy import io as scipy_io

from folders import refused
from planish.core.errors import FileError, PlanishError, VolumeError
from planish.io import read_volume

VOLUME = (np.arange(12 * 10 * 8) % 251).astype(np.uint8).reshape(12, 10, 8)


@pytest.fixture(params=[False, True], ids=["plain", "compressed"])
def saved(request, tmp_path):
    path = tmp_path / "v.mat"
    scipy_io.savemat(
        path, {"V": VOLUME, "voxel_um": 3.0, "note": "x"}, do_compression=request.param
    )
    return path


def damaged(path, at, value):
    """Change one byte of the first variable, inside the compression where there is one."""
    data = bytearray(path.read_bytes())
    kind, size = struct.unpack_from("<II", data, 128)
    if kind == 15:
        inner = bytearray(zlib.decompress(bytes(data[136 : 136 + size])))
        inner[at] = value
        packed = zlib.compress(bytes(inner))
        data = data[:128] + struct.pack("<II", 15, len(packed)) + packed + data[136 + size :]
    else:
        data[128 + at] = value
    path.write_bytes(data)


def test_version_4_is_refused(tmp_path):
    scipy_io.savemat(tmp_path / "old.mat", {"A": VOLUME[0].astype(float)}, format="4")
    refused(FileError, "version 4", read_volume, tmp_path / "old.mat")


@pytest.mark.parametrize(
    ("at", "value", "words"),
    [
        (8, 7, "no flags"),
        (16, 99, "unknown class"),
        (24, 1, "no shape"),
        (35, 255, "negative size"),
        (32, 13, "of shape"),
        (48, 9, "no name"),
        (56, 9, "of type 9"),
        (56, 200, "of type 200"),
        (17, 8, "complex"),
    ],
)
def test_what_does_not_fit_is_named(saved, at, value, words):
    damaged(saved, at, value)
    refused((FileError, VolumeError), words, read_volume, saved)


def test_any_byte_of_the_heading(saved):
    """Values of another size than declared, or an error that names the file."""
    whole = saved.read_bytes()
    rng = np.random.default_rng(5)
    for at in range(72):
        saved.write_bytes(whole)
        damaged(saved, at, int(rng.integers(256)))
        try:
            found = read_volume(saved)
        except PlanishError:
            continue
        assert found.size == VOLUME.size
