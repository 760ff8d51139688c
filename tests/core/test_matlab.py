"""MATLAB files of every version give what scipy and h5py read from them, and damage is named."""

import io

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from folders import refused
from planish.core import matlab

HELD = {
    "V": (np.arange(6 * 5 * 4) % 251).astype(np.uint8).reshape(6, 5, 4),
    "wide": np.array([[1.0, 2.0], [3.5, -4.0], [300.0, 0.25]]),
    "whole": np.array([[1.0, 2.0, 3.0]]),  # MATLAB stores such doubles as bytes
    "single": np.float32([[0.5, 1.5]]),
    "deep": np.array([[-7, 2**40]], np.int64),
}


def file_of(version, held):
    file = io.BytesIO()
    if version == "7.3":
        with h5py.File(file, "w", userblock_size=512) as made:
            for name, values in held.items():
                made[name] = values.T
                word = {"f8": "double", "f4": "single"}.get(values.dtype.str[1:], values.dtype.name)
                made[name].attrs["MATLAB_class"] = np.bytes_(word)
        return file
    savemat(file, held, format="4" if version == "4" else "5", do_compression=version == "7")
    return file


@pytest.mark.parametrize("version", ["6", "7", "7.3"])
def test_values_and_types_come_back(version):
    file = file_of(version, HELD)
    found = {v.name: v for v in matlab.variables(file)}
    assert found.keys() == HELD.keys()
    for name, values in HELD.items():
        assert (found[name].shape, matlab.NUMBERS[found[name].kind]) == (values.shape, values.dtype)
        read = matlab.values(file, found[name])
        assert read.dtype == values.dtype
        np.testing.assert_array_equal(read, values)


@pytest.mark.parametrize("order", ["<", ">"])
def test_version_4(order):
    file = file_of("4", {"A": HELD["wide"], "note": "text"})
    if order == ">":
        data = file.getvalue()
        start = 22  # five numbers and a name of two bytes
        head = np.frombuffer(data[:20], "<i4").copy()
        head[0] += 1000
        values = np.frombuffer(data[start : start + 48], "<f8").astype(">f8").tobytes()
        file = io.BytesIO(head.astype(">i4").tobytes() + data[20:start] + values)
    first, *others = matlab.variables(file)
    np.testing.assert_array_equal(matlab.values(file, first), HELD["wide"])
    assert [v.kind for v in others] == (["char"] if order == "<" else [])


def test_what_is_no_real_array_is_named_and_damaged_compression_noticed():
    held = {"c": np.ones((2, 2)) + 1j, "l": np.array([[True, False]]), "s": {"a": 1}, "t": "text"}
    file = file_of("7", held)
    found = {v.name: v for v in matlab.variables(file)}
    assert {name: v.kind for name, v in found.items()} == {
        "c": "complex",
        "l": "logical",
        "s": "struct",
        "t": "char",
    }
    assert not any(v.real for v in found.values())
    refused(ValueError, "no full real array", matlab.values, file, found["c"])
    file = file_of(
        "7", {"V": np.random.default_rng(0).integers(0, 255, (40, 50, 60)).astype(np.uint8)}
    )
    (variable,) = matlab.variables(file)
    data = bytearray(file.getvalue())
    data[70_000:70_100] = bytes(100)
    with pytest.raises(matlab.Damaged):
        matlab.values(io.BytesIO(bytes(data)), variable)


@pytest.mark.parametrize("version", ["6", "7"])
def test_a_file_that_was_cut_is_damaged(version):
    data = file_of(version, {"V": HELD["V"]}).getvalue()
    refused(matlab.Damaged, "longer than the file", matlab.variables, io.BytesIO(data[:-8]))
    refused(matlab.Damaged, "it is empty", matlab.variables, io.BytesIO(b""))
