"""MATLAB files of every version: their variables, and the values of one, with every length checked before it is used.

Version 4 is a list of matrices, versions 5 to 7 a list of elements that may be compressed, version 7.3 an HDF5 file in
which MATLAB stores the axes in reverse. scipy reads versions 4 to 7 too, but trusts what a file declares: a damaged one
can end the whole process there.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

_HDF5 = b"\x89HDF\r\n\x1a\n"
_HEADING = 128  # bytes of text, version and byte order before the first variable of version 5
_HEAD = 2048  # bytes in which flags, shape, name and the tag of the values of any variable lie
_MOST_AXES, _LONGEST_NAME = 32, 512
_COMPRESSED, _MATRIX, _UINT32, _INT32, _INT8 = 15, 14, 6, 5, 1
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_TYPES_4 = ("f8", "f4", "i4", "i2", "u2", "u1")
_CLASSES = (
    "cell", "struct", "object", "char", "sparse", "double", "single", "int8", "uint8", "int16", "uint16", "int32",
    "uint32", "int64", "uint64", "function", "opaque",
)  # fmt: skip
NUMBERS = {
    "double": np.dtype("f8"), "single": np.dtype("f4"), **{name: np.dtype(name) for name in _CLASSES if "int" in name}
}  # fmt: skip
"""Classes of real numbers and their types."""

_COMPLEX, _LOGICAL = 0x08, 0x02
_CHUNK = 4 * 2**20


class Damaged(ValueError):
    """A file ends early or contradicts itself; the message says how."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Variable:
    """A variable of a file.

    Attributes
    ----------
    name : str
    shape : tuple of int
        In the order of MATLAB: rows, columns, ...
    kind : str
        Class, as MATLAB names it; ``"complex"`` and ``"logical"`` for numbers of these kinds.
    stored : dtype or None
        Type of the values in the file; None for what is no full real array.
    start, size : int
        Bytes of the values, or of the compressed variable.
    inside : int
        Where the values begin in the uncompressed variable; -1 where it is not compressed.
    """

    name: str
    shape: tuple[int, ...]
    kind: str
    stored: np.dtype[Any] | None = None
    start: int = 0
    size: int = 0
    inside: int = -1

    @property
    def count(self) -> int:
        """Number of values."""
        return math.prod(self.shape)


def is_new(head: bytes) -> bool:
    """Whether a file that begins with these 520 bytes is one of version 7.3."""
    return head.startswith(_HDF5) or head[512:520] == _HDF5


def is_version_5(head: bytes) -> bool:
    """Whether a file that begins with these 128 bytes is one of version 5 to 7."""
    return head[126:128] in (b"IM", b"MI") and 0 not in head[:4]


@contextmanager
def new_file(file: BinaryIO) -> Generator[Any]:
    """Open a file of version 7.3."""
    import h5py  # pyright: ignore[reportMissingTypeStubs]

    with h5py.File(file, "r") as opened:
        yield opened


def variables(file: BinaryIO) -> list[Variable]:
    """List the variables of a file of any version, without their values.

    Raises
    ------
    Damaged
        If a length or a type does not fit. What h5py raises for version 7.3 passes.
    """
    file.seek(0)
    head = file.read(520)
    if is_new(head):
        with new_file(file) as opened:
            return list(_variables_new(opened))
    try:
        return list(_variables_5(file, head[126:128]) if is_version_5(head) else _variables_4(file))
    except (struct.error, zlib.error, ValueError, IndexError, OverflowError, MemoryError) as error:
        raise Damaged(str(error) or type(error).__name__) from error


def values(file: BinaryIO, variable: Variable) -> NDArray[Any]:
    """Read the values of a variable that is a full real array, in the type of its class and the order of MATLAB.

    Raises
    ------
    Damaged
        If the values are not there.
    """
    if variable.stored is None:
        raise ValueError(f"{variable.name} is no full real array")
    file.seek(0)
    if is_new(file.read(520)):
        with new_file(file) as opened:
            return np.asarray(opened[variable.name][()]).T
    found = np.empty(variable.count, variable.stored)
    into = found.view(np.uint8)
    if variable.inside < 0:
        file.seek(variable.start)
        filled = file.readinto(into.data)  # type: ignore[attr-defined]
    else:
        filled = 0
        for part in _unpacked(file, variable, into.size):
            into[filled : filled + len(part)] = np.frombuffer(part, np.uint8)
            filled += len(part)
    if filled != into.size:
        raise Damaged(f"the values of {variable.name} end after {filled} of {into.size} bytes")
    return found.astype(NUMBERS[variable.kind], copy=False).reshape(variable.shape, order="F")


def _unpacked(file: BinaryIO, variable: Variable, needed: int) -> Iterator[bytes]:
    """Uncompressed bytes of the values, and no more."""
    file.seek(variable.start)
    unpacker, left, skip, packed = zlib.decompressobj(), variable.size, variable.inside, b""
    while needed and not unpacker.eof:
        if not packed:
            packed = file.read(min(_CHUNK, left))
            left -= len(packed)
            if not packed:
                return
        try:
            part = unpacker.decompress(packed, _CHUNK)
        except zlib.error as error:
            raise Damaged(str(error)) from error
        packed = unpacker.unconsumed_tail
        skipped = min(skip, len(part))
        skip -= skipped
        part = part[skipped : skipped + needed]
        needed -= len(part)
        if part:
            yield part


def _variables_new(file: Any) -> Iterator[Variable]:
    import h5py  # pyright: ignore[reportMissingTypeStubs]

    for key in file:
        # A link, external storage or a virtual data set could lead to any file of the machine.
        if not isinstance(file.get(key, getlink=True), h5py.HardLink):
            continue
        item: Any = file[key]
        if not isinstance(item, h5py.Dataset) or item.external or item.is_virtual or item.shape is None:
            yield Variable(name=str(key), shape=(), kind="struct" if isinstance(item, h5py.Group) else "opaque")
            continue
        word: Any = item.attrs.get("MATLAB_class", b"")
        kind = word.decode(errors="replace") if isinstance(word, bytes) else str(word)
        kind = kind or next((name for name, dtype in NUMBERS.items() if dtype == item.dtype), str(item.dtype))
        real = item.dtype.kind in "uif" and kind in NUMBERS
        shape = tuple(int(n) for n in item.shape[::-1])
        yield Variable(name=str(key), shape=shape, kind=kind, stored=item.dtype if real else None)


def _variables_5(file: BinaryIO, mark: bytes) -> Iterator[Variable]:
    order = "<" if mark == b"IM" else ">"
    end = file.seek(0, 2)
    at = _HEADING
    while at + 8 <= end:
        file.seek(at)
        kind, size = struct.unpack(f"{order}II", file.read(8))
        if at + 8 + size > end:
            raise Damaged("a variable is longer than the file")
        packed = kind == _COMPRESSED
        if packed:
            head = zlib.decompressobj().decompress(file.read(min(size, 4 * _HEAD)), _HEAD)
        elif kind == _MATRIX:
            file.seek(at)
            head = file.read(min(8 + size, _HEAD))
        else:
            raise Damaged(f"it holds an element of type {kind} where a variable should be")
        found = _variable_5(head, order)
        if found is not None:
            name, shape, word, stored, inside, length = found
            start, length = (at + 8, size) if packed else (at + inside, length)
            yield Variable(
                name=name,
                shape=shape,
                kind=word,
                stored=stored,
                start=start,
                size=length,
                inside=inside if packed else -1,
            )
        at += 8 + size


def _variable_5(
    head: bytes, order: str
) -> tuple[str, tuple[int, ...], str, np.dtype[Any] | None, int, int] | None:  # fmt: skip
    """Name, shape, class, stored type, and first byte and size of the values; None for an empty element."""
    kind, whole = struct.unpack_from(f"{order}II", head)
    if kind != _MATRIX:
        raise Damaged("what was compressed is no variable")
    if not whole:
        return None
    kind, start, size, at = _element(head, 8, order)
    if (kind, size) != (_UINT32, 8):
        raise Damaged("a variable has no flags")
    flags = struct.unpack_from(f"{order}I", head, start)[0]
    if not 1 <= flags & 0xFF <= len(_CLASSES):
        raise Damaged(f"a variable is of the unknown class {flags & 0xFF}")
    word = _CLASSES[(flags & 0xFF) - 1]
    if word == "opaque":
        return None  # of MATLAB's own objects only the flags are alike
    kind, start, size, at = _element(head, at, order)
    if kind != _INT32 or size % 4 or not 8 <= size <= 4 * _MOST_AXES:
        raise Damaged("a variable has no shape")
    shape = struct.unpack_from(f"{order}{size // 4}i", head, start)
    if min(shape) < 0:
        raise Damaged("a variable has a negative size")
    kind, start, size, at = _element(head, at, order)
    if kind != _INT8 or size > _LONGEST_NAME:
        raise Damaged("a variable has no name")
    name = head[start : start + size].decode("utf-8", "replace")
    if word not in NUMBERS or not math.prod(shape):
        return name, shape, word, NUMBERS.get(word), 0, 0
    kind, start, size, _ = _element(head, at, order)
    if kind not in _TYPES or size != math.prod(shape) * np.dtype(_TYPES[kind]).itemsize:
        raise Damaged(f"a variable of shape {shape} holds {size} bytes of type {kind}")
    if size > whole:
        raise Damaged("the values of a variable are longer than the variable")
    if (flags >> 8) & (_COMPLEX | _LOGICAL):
        return name, shape, "complex" if (flags >> 8) & _COMPLEX else "logical", None, start, size
    return name, shape, word, np.dtype(order + _TYPES[kind]), start, size


def _element(head: bytes, at: int, order: str) -> tuple[int, int, int, int]:
    """Type, start and size of an element's bytes, and where the next one begins."""
    kind, size = struct.unpack_from(f"{order}II", head, at)
    if kind >> 16:  # a small one: size and type share a word, four bytes follow
        kind, size = kind & 0xFFFF, kind >> 16
        if size > 4:
            raise Damaged("a small element is too long")
        return kind, at + 4, size, at + 8
    return kind, at + 8, size, at + 8 + (size + 7) // 8 * 8


def _variables_4(file: BinaryIO) -> Iterator[Variable]:
    end = file.seek(0, 2)
    if not end:
        raise Damaged("it is empty")
    at = 0
    while at < end:
        file.seek(at)
        head = file.read(20)
        order = "<" if 0 <= struct.unpack_from("<i", head)[0] < 1000 else ">"
        kind, rows, columns, imaginary, length = struct.unpack(f"{order}5i", head)
        machine, precision, what = kind // 1000, kind // 10 % 10, kind % 10
        wrong = machine != (0 if order == "<" else 1) or kind // 100 % 10 or precision > 5 or what > 2
        if wrong or min(rows, columns) < 0 or imaginary not in (0, 1) or not 0 < length < 1000:
            raise Damaged("it does not begin as a MATLAB file")
        name = file.read(length).rstrip(b"\0").decode("ascii", "replace")
        stored = np.dtype(order + _TYPES_4[precision])
        size = rows * columns * stored.itemsize
        start, at = at + 20 + length, at + 20 + length + size * (1 + imaginary)
        if at > end:
            raise Damaged("it ends early")
        word = ("double", "char", "sparse")[what] if not imaginary else "complex"
        yield Variable(
            name=name,
            shape=(rows, columns),
            kind=word,
            stored=stored if word == "double" else None,
            start=start,
            size=size,
        )
