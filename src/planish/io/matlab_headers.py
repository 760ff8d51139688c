"""Headings of MATLAB files of version 5 to 7, checked before scipy reads them.

scipy trusts what a file says of itself, and a damaged one can end the whole process. What a heading declares has to
fit: types that exist, sizes that hold the values of the shape.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from planish.core.errors import FileError

_HEADING = 128  # bytes of text, version and byte order before the first variable
_HEAD = 2048  # bytes in which flags, shape, name and the tag of the values of any variable lie
_MOST_AXES, _LONGEST_NAME = 32, 512
_COMPRESSED, _MATRIX, _UINT32, _INT32, _INT8 = 15, 14, 6, 5, 1
_BYTES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}  # of the types of numbers
_FULL = range(6, 16)  # classes double, single, int8 to uint64
_CLASSES = range(1, 18)
_COMPLEX = 0x08


def check_headings(path: Path) -> None:
    """Check every variable of a file of version 5 to 7.

    Raises
    ------
    FileError
        If the file is of version 4, or a heading contradicts itself.
    """
    with path.open("rb") as file:
        heading = file.read(_HEADING)
        order = {b"IM": "<", b"MI": ">"}.get(heading[126:128])
        if order is None:
            raise FileError(
                f"{path.name} is no MATLAB file of version 5 or later; version 4 holds no volumes. Save it with '-v7'."
            )
        try:
            for head in _heads(file, path.stat().st_size, order):
                _check(head, order)
        except (struct.error, zlib.error, ValueError) as error:
            raise FileError(f"{path.name} is damaged: {error}. Save it again, or copy it once more.") from error


def _heads(file: BinaryIO, end: int, order: str) -> Iterator[bytes]:
    """First bytes of every variable, from its tag on, uncompressed."""
    at = _HEADING
    while at + 8 <= end:
        file.seek(at)
        kind, size = struct.unpack(f"{order}II", file.read(8))
        if at + 8 + size > end:
            raise ValueError("a variable is longer than the file")
        if kind == _COMPRESSED:
            head = zlib.decompressobj().decompress(file.read(min(size, 4 * _HEAD)), _HEAD)
            at += 8 + size
        elif kind == _MATRIX:
            file.seek(at)
            head = file.read(min(8 + size, _HEAD))
            at += 8 + size
        else:
            raise ValueError(f"it holds an element of type {kind} where a variable should be")
        yield head


def _check(head: bytes, order: str) -> None:
    """Flags, shape, name, and whether the values fit to them."""
    kind, whole = struct.unpack_from(f"{order}II", head)
    if kind != _MATRIX:
        raise ValueError("what was compressed is no variable")
    if not whole:
        return
    kind, start, size, at = _element(head, 8, order)
    if (kind, size) != (_UINT32, 8):
        raise ValueError("a variable has no flags")
    flags = struct.unpack_from(f"{order}I", head, start)[0]
    what = flags & 0xFF
    if what not in _CLASSES:
        raise ValueError(f"a variable is of the unknown class {what}")
    if what == _CLASSES[-1]:
        return  # of MATLAB's own objects only the flags are alike
    kind, start, size, at = _element(head, at, order)
    if kind != _INT32 or size % 4 or not 8 <= size <= 4 * _MOST_AXES:
        raise ValueError("a variable has no shape")
    shape = struct.unpack_from(f"{order}{size // 4}i", head, start)
    if min(shape) < 0:
        raise ValueError("a variable has a negative size")
    kind, _, size, at = _element(head, at, order)
    if kind != _INT8 or size > _LONGEST_NAME:
        raise ValueError("a variable has no name")
    if what not in _FULL or not math.prod(shape):
        return
    if (flags >> 8) & _COMPLEX and sum(n > 1 for n in shape) >= 3:
        raise ValueError("the volume holds complex values")
    kind, _, size, _ = _element(head, at, order)
    if kind not in _BYTES or size != math.prod(shape) * _BYTES[kind]:
        raise ValueError(f"a variable of shape {shape} holds {size} bytes of type {kind}")
    if size > whole:
        raise ValueError("the values of a variable are longer than the variable")


def _element(head: bytes, at: int, order: str) -> tuple[int, int, int, int]:
    """Type, start and size of an element's bytes, and where the next one begins."""
    kind, size = struct.unpack_from(f"{order}II", head, at)
    if kind >> 16:  # a small one: size and type share a word, four bytes follow
        kind, size = kind & 0xFFFF, kind >> 16
        if size > 4:
            raise ValueError("a small element is too long")
        return kind, at + 4, size, at + 8
    return kind, at + 8, size, at + 8 + (size + 7) // 8 * 8
