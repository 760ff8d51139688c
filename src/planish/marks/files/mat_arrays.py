"""Real matrices of MATLAB files of version 4 to 7, read with every length checked.

scipy reads these files too, but a damaged one can end the whole process there; a file of marks comes from anywhere.
What is no full real matrix (structures, cells, text, sparse) is only named.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator

import numpy as np

from planish.marks.files.model import Floats

LARGEST_INFLATED = 64_000_000
LARGEST_MATRIX = 1_000_000
"""Values; larger matrices are images, and only named."""

_COMPRESSED, _MATRIX = 15, 14
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_FULL = range(6, 16)  # classes double, single, int8 ... uint64
_COMPLEX = 0x08
_NUMBERS_4 = ("f8", "f4", "i4", "i2", "u2", "u1")

Matrix = tuple[str, Floats | None]


class Damaged(ValueError):
    """The file ends early or contradicts itself."""


def matrices(data: bytes) -> dict[str, Floats | None]:
    """Variables of a file, by name: shape (rows, columns), or None for what is no small full real matrix.

    Raises
    ------
    Damaged
        If lengths do not fit, or more than 64 MB are unpacked.
    """
    try:
        if data[:6] == b"MATLAB":
            return dict(_version_5(data))
        return dict(_version_4(data))
    except (struct.error, zlib.error, ValueError, IndexError, OverflowError, MemoryError) as error:
        raise Damaged(str(error) or type(error).__name__) from error


def _version_5(data: bytes) -> Iterator[Matrix]:
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None:
        raise Damaged("the heading does not tell the order of bytes")
    at, left = 128, LARGEST_INFLATED
    while at + 8 <= len(data):
        kind, start, size, following = _element(data, at, order)
        if kind == _COMPRESSED:
            unpacked = zlib.decompressobj().decompress(data[start : start + size], left + 1)
            left -= len(unpacked)
            if left < 0:
                raise Damaged(f"it holds more than {LARGEST_INFLATED // 1_000_000} MB unpacked")
            inner_kind, inner, inner_size, _ = _element(unpacked, 0, order)
            if inner_kind == _MATRIX:
                yield _matrix(unpacked[inner : inner + inner_size], order)
            following = start + size
        elif kind == _MATRIX:
            yield _matrix(data[start : start + size], order)
        at = following


def _element(data: bytes, at: int, order: str) -> tuple[int, int, int, int]:
    """Type, start and size of the bytes of an element, and where the next one begins."""
    kind, size = struct.unpack_from(f"{order}II", data, at)
    if kind >> 16:  # a small element: size and type share a word, four bytes follow
        kind, size, start, following = kind & 0xFFFF, kind >> 16, at + 4, at + 8
        if size > 4:
            raise Damaged("a small element is too long")
    else:
        start = at + 8
        following = start + (size + 7) // 8 * 8
    if start + size > len(data):
        raise Damaged("it ends early")
    return kind, start, size, following


def _matrix(data: bytes, order: str) -> Matrix:
    kind, start, size, at = _element(data, 0, order)
    if kind != 6 or size != 8:
        raise Damaged("a variable has no flags")
    flags = struct.unpack_from(f"{order}I", data, start)[0]
    _, start, size, at = _element(data, at, order)
    shape = struct.unpack_from(f"{order}{size // 4}i", data, start)
    if any(n < 0 for n in shape):
        raise Damaged("a variable has a negative size")
    _, start, size, at = _element(data, at, order)
    name = data[start : start + size].decode("ascii", "replace")
    values = int(np.prod(shape, dtype=object)) if shape else 0
    if (flags & 0xFF) not in _FULL or (flags >> 8) & _COMPLEX or len(shape) != 2 or values > LARGEST_MATRIX:
        return name, None
    kind, start, size, _ = _element(data, at, order) if values else (9, 0, 0, 0)
    return name, _reshaped(data[start : start + size], order + _NUMBERS.get(kind, "V"), shape)


def _version_4(data: bytes) -> Iterator[Matrix]:
    at = 0
    if not data:
        raise Damaged("it is empty")
    while at < len(data):
        order = "<" if 0 <= struct.unpack_from("<i", data, at)[0] < 1000 else ">"
        kind, rows, columns, imaginary, length = struct.unpack_from(f"{order}5i", data, at)
        machine, precision, what = kind // 1000, kind // 10 % 10, kind % 10
        wrong = machine != (0 if order == "<" else 1) or kind // 100 % 10 or precision > 5 or what > 2
        if wrong or min(rows, columns) < 0 or imaginary not in (0, 1) or not 0 < length < 1000:
            raise Damaged("it does not begin as a MATLAB file")
        start = at + 20 + length
        name = data[at + 20 : start].rstrip(b"\0").decode("ascii", "replace")
        dtype = order + _NUMBERS_4[precision]
        size = rows * columns * np.dtype(dtype).itemsize
        at = start + size * (1 + imaginary)
        if at > len(data):
            raise Damaged("it ends early")
        small = not what and not imaginary and rows * columns <= LARGEST_MATRIX
        yield name, _reshaped(data[start : start + size], dtype, (rows, columns)) if small else None


def _reshaped(data: bytes, dtype: str, shape: tuple[int, ...]) -> Floats:
    if "V" in dtype:
        raise Damaged("a variable has values of an unknown type")
    with np.errstate(invalid="ignore"):
        values = np.frombuffer(data, dtype=dtype).astype(np.float64)
    return np.ascontiguousarray(values.reshape(shape, order="F"))
