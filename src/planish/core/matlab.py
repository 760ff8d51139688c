"""MATLAB files of every version: their variables, and the values of one.

Version 4 is a list of matrices, versions 5 to 7 a list of elements that may be compressed, version
7.3 an HDF5 file in which MATLAB stores the axes in reverse. scipy reads the values of versions 4 to
7, but trusts what versions 5 to 7 declare: a damaged file can end the whole process there, so that
every length and type is checked here first.
"""

import math
import struct
import zlib
from collections.abc import Container, Iterator
from dataclasses import dataclass
from typing import Any, BinaryIO, NamedTuple, cast

import numpy as np

from planish.core.typing import Array, Shape

_HDF5 = b"\x89HDF\r\n\x1a\n"
# Bytes in which flags, shape, name and the tag of the values of any variable lie.
_HEADER_BYTES = 2048
_MOST_AXES = 32
_LONGEST_NAME = 512
_COMPRESSED = 15
_MATRIX = 14
_UINT32 = 6
_INT32 = 5
_INT8 = 1
_TYPES = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
}
_CLASSES = (
    "cell",
    "struct",
    "object",
    "char",
    "sparse",
    "double",
    "single",
    "int8",
    "uint8",
    "int16",
    "uint16",
    "int32",
    "uint32",
    "int64",
    "uint64",
    "function",
    "opaque",
)
NUMBERS = {  # Classes of real numbers and their types.
    "double": np.dtype("f8"),
    "single": np.dtype("f4"),
    **{name: np.dtype(name) for name in _CLASSES if "int" in name},
}

_CLASS_OF_TYPE = {dtype: name for name, dtype in NUMBERS.items()}
_COMPLEX = 0x08
_LOGICAL = 0x02


class Damaged(ValueError):
    """A file ends early or contradicts itself; the message says how."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Variable:
    """A variable of a file.

    ``shape`` is in the order of MATLAB; ``kind`` the class as MATLAB names it, and ``complex`` or
    ``logical`` for numbers of these kinds; ``real`` marks a full real array, whose values can be
    read.
    """

    name: str
    shape: Shape
    kind: str
    real: bool = False

    @property
    def count(self) -> int:
        """Number of values."""
        return math.prod(self.shape)


def is_new(head: bytes) -> bool:
    """Return True if a file that begins with these 520 bytes is one of version 7.3."""
    return head.startswith(_HDF5) or head[512:520] == _HDF5


def is_version_5(head: bytes) -> bool:
    """Return True if a file that begins with these 128 bytes is one of version 5 to 7."""
    return head[126:128] in (b"IM", b"MI") and 0 not in head[:4]


def variables(file: BinaryIO) -> list[Variable]:
    """List a file's variables without values.

    Damaged if a length or type does not fit; h5py's errors pass for 7.3.
    """
    file.seek(0)
    head = file.read(520)
    if is_new(head):
        return list(_variables_new(file))
    try:
        return list(_variables_5(file, head[126:128]) if is_version_5(head) else _variables_4(file))
    except (
        struct.error,
        zlib.error,
        ValueError,
        TypeError,
        IndexError,
        OverflowError,
        MemoryError,
    ) as error:
        raise Damaged(str(error) or type(error).__name__) from error


def values(file: BinaryIO, variable: Variable) -> Array:
    """Read a full real array that :func:`variables` listed, in its class and MATLAB's order.

    Damaged if not there.
    """
    if not variable.real:
        raise ValueError(f"{variable.name} is no full real array")
    file.seek(0)
    if is_new(file.read(520)):
        import h5py  # pyright: ignore[reportMissingTypeStubs]

        with h5py.File(file, "r") as hdf5:
            dataset: Any = hdf5[variable.name]
            return np.asarray(dataset[()]).T
    from scipy.io import loadmat

    file.seek(0)
    try:
        array: Array = loadmat(cast("Any", file), variable_names=[variable.name])[variable.name]
    except (OSError, zlib.error, ValueError, TypeError, KeyError, OverflowError) as error:
        raise Damaged(f"the values of {variable.name} cannot be read: {error}") from error
    if array.shape != variable.shape or array.dtype.kind not in "uif":
        raise Damaged(f"the values of {variable.name} are not those of its heading")
    return array.astype(NUMBERS[variable.kind], copy=False)


def _variables_new(file: BinaryIO) -> Iterator[Variable]:
    """Variables of a file of version 7.3."""
    import h5py  # pyright: ignore[reportMissingTypeStubs]

    with h5py.File(file, "r") as hdf5:
        root: Any = hdf5
        for key in root:
            # A link, external storage or a virtual data set could lead to any file of the machine.
            if not isinstance(root.get(key, getlink=True), h5py.HardLink):
                continue
            if isinstance(root[key], h5py.Group):
                yield Variable(name=str(key), shape=(), kind="struct")
            else:
                yield _variable_new(str(key), root[key])


def _variable_new(name: str, member: Any) -> Variable:
    """The variable that a data set of HDF5 holds; *opaque* where it leads to another file."""
    shape: Any = getattr(member, "shape", None)
    if shape is None or member.external or member.is_virtual:
        return Variable(name=name, shape=(), kind="opaque")
    class_name: Any = member.attrs.get("MATLAB_class", b"")
    if isinstance(class_name, bytes):
        class_name = class_name.decode(errors="replace")
    kind = str(class_name) or _CLASS_OF_TYPE.get(member.dtype, str(member.dtype))
    is_real = member.dtype.kind in "uif" and kind in NUMBERS
    matlab_shape = tuple(map(int, shape[::-1]))
    return Variable(name=name, shape=matlab_shape, kind=kind, real=is_real)


def _variables_5(file: BinaryIO, endian_mark: bytes) -> Iterator[Variable]:
    """Variables of a file of version 5 to 7; the bytes of a long one are not all read."""
    byte_order = "<" if endian_mark == b"IM" else ">"
    file_bytes = file.seek(0, 2)
    offset = 128  # bytes of text, version and byte order
    while offset + 8 <= file_bytes:
        file.seek(offset)
        element_type, size = struct.unpack(f"{byte_order}II", file.read(8))
        if offset + 8 + size > file_bytes:
            raise Damaged("a variable is longer than the file")
        if element_type == _COMPRESSED:
            packed = file.read(min(size, 4 * _HEADER_BYTES))
            header = zlib.decompressobj().decompress(packed, _HEADER_BYTES)
        elif element_type == _MATRIX:
            file.seek(offset)
            header = file.read(min(8 + size, _HEADER_BYTES))
        else:
            raise Damaged(f"it holds an element of type {element_type} where a variable should be")
        variable = _variable_5(header, byte_order)
        if variable is not None:
            yield variable
        offset += 8 + size


def _variable_5(header: bytes, byte_order: str) -> Variable | None:
    """A variable that begins with these bytes, unpacked; None for an empty element.

    They are as many as hold all but its values.
    """
    element_type, matrix_bytes = struct.unpack_from(f"{byte_order}II", header)
    if element_type != _MATRIX:
        raise Damaged("what was compressed is no variable")
    if not matrix_bytes:
        return None
    elements = _elements(header, byte_order)
    flag_bytes = _content(next(elements), _UINT32, (8,), "flags")
    flags = struct.unpack_from(f"{byte_order}I", flag_bytes)[0]
    if not 1 <= flags & 0xFF <= len(_CLASSES):
        raise Damaged(f"a variable is of the unknown class {flags & 0xFF}")
    class_name = _CLASSES[(flags & 0xFF) - 1]
    if class_name == "opaque":
        return None  # of MATLAB's own objects only the flags are alike
    shape_bytes = _content(next(elements), _INT32, range(8, 4 * _MOST_AXES + 1, 4), "shape")
    shape = struct.unpack_from(f"{byte_order}{len(shape_bytes) // 4}i", shape_bytes)
    if min(shape) < 0:
        raise Damaged("a variable has a negative size")
    name_bytes = _content(next(elements), _INT8, range(_LONGEST_NAME + 1), "name")
    name = name_bytes.decode("utf-8", "replace")
    if class_name not in NUMBERS or not math.prod(shape):
        return Variable(name=name, shape=shape, kind=class_name, real=class_name in NUMBERS)
    _check_values(next(elements), shape, matrix_bytes)
    number_flags = (flags >> 8) & (_COMPLEX | _LOGICAL)
    if number_flags:
        class_name = "complex" if number_flags & _COMPLEX else "logical"
    return Variable(name=name, shape=shape, kind=class_name, real=not number_flags)


class _Element(NamedTuple):
    """A part of a variable: the type of its values, their bytes, and those that were read."""

    kind: int
    size: int
    content: bytes


def _elements(header: bytes, byte_order: str) -> Iterator[_Element]:
    """Parts of a variable, behind its own type and length."""
    offset = 8
    while True:
        kind, size = struct.unpack_from(f"{byte_order}II", header, offset)
        start = offset + 8
        offset = start + (size + 7) // 8 * 8
        small_size = kind >> 16
        if small_size > 4:
            raise Damaged("a small element is too long")
        if small_size:  # size and type share a word, four bytes follow
            kind = kind & 0xFFFF
            size = small_size
            offset = start
            start -= 4
        yield _Element(kind, size, header[start : start + size])


def _content(element: _Element, kind: int, sizes: Container[int], name: str) -> bytes:
    if element.kind != kind or element.size not in sizes:
        raise Damaged(f"a variable has no {name}")
    return element.content


def _check_values(element: _Element, shape: Shape, matrix_bytes: int) -> None:
    """Refuse a variable whose values do not fit its shape, or are longer than it."""
    kind, size, _ = element
    value_type = _TYPES.get(kind)
    if value_type is None or size != math.prod(shape) * np.dtype(value_type).itemsize:
        raise Damaged(f"a variable of shape {shape} holds {size} bytes of type {kind}")
    if size > matrix_bytes:
        raise Damaged("the values of a variable are longer than the variable")


def _variables_4(file: BinaryIO) -> Iterator[Variable]:
    from scipy.io import whosmat

    if not file.seek(0, 2):
        raise Damaged("it is empty")
    file.seek(0)
    for name, shape, kind in whosmat(cast("Any", file)):
        yield Variable(name=name, shape=shape, kind=kind, real=kind in NUMBERS)
