"""Read values behind a header, in its file or another one.

They are mapped where they lie as they are, or unpacked at once.
"""

import bz2
import math
import zlib
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from planish.core.errors import FileError, VolumeError
from planish.core.memory import PACKED_BYTES, UNPACKED_BYTES
from planish.core.typing import Array, DType, Shape, Texts
from planish.io.axes import AxisNames, extended_axes, place_axes
from planish.io.formats import ADVICE, LoadedVolume
from planish.io.guard import check_blown_up, head_of, reading, size_of_file
from planish.io.lazy import Values, mapped, reordered, whole_array
from planish.io.orientation import Orientation
from planish.io.sizes import Stated
from planish.io.tiff import damaged, size_words


class StoredAxes(NamedTuple):
    """Axes of values behind a header, slowest first, of which those of length 1 are left out."""

    shape: Shape  # of the values as they are stored
    header_axes: Shape  # numbers in the header of the axes z, y, x
    order: Shape  # which stored axes are z, y, x
    notes: Texts


class Header(NamedTuple):
    """Contents of a header."""

    path: Path  # its file
    data: Path  # file with the values
    axes: StoredAxes
    stored_dtype: DType
    offset: int  # byte at which they begin; -1 where they end with the file
    stated: list[Stated]
    packing: str = ""  # or "deflate" or "bzip2"
    skip_bytes: int = 0  # unpacked bytes before the values
    orientations: Sequence[Orientation] = ()

    @property
    def shape(self) -> Shape:
        """Lengths of the axes as they are stored, slowest first."""
        return self.axes.shape

    @property
    def needed_bytes(self) -> int:
        """Size of the values without compression."""
        return math.prod(self.shape) * self.stored_dtype.itemsize

    def volume(self, stored_values: Values) -> LoadedVolume:
        """The volume of these values."""
        return LoadedVolume(
            values=reordered(stored_values, self.axes.order),
            stated=self.stated,
            files=[self.path, self.data],
            notes=self.axes.notes,
            orientations=self.orientations,
        )


def unpacked_head(path: Path, most: int) -> bytes:
    """First bytes of a file, unpacked where the end of its name says that it is packed."""
    packing = packing_of(path)
    if not packing:
        return head_of(path, most)
    with reading(path):
        return _unpacker(packing).decompress(head_of(path, PACKED_BYTES), most)


def packing_of(path: Path) -> str:
    """Packing of a whole file by the end of its name."""
    return {".gz": "deflate", ".bz2": "bzip2"}.get(path.suffix.lower(), "")


def values_behind(header: Header) -> Values:
    """Map the values that a header declares, or leave them to be unpacked.

    FileError where the file does not hold as many bytes as declared.
    """
    data_file = header.data
    needed_bytes = header.needed_bytes
    file_bytes = size_of_file(header.data)
    offset = header.offset
    if header.offset < 0:
        offset = max(file_bytes - needed_bytes, 0)
    stored_bytes = file_bytes - offset
    if header.packing:
        check_blown_up(data_file, decoded_bytes=needed_bytes, stored_bytes=max(stored_bytes, 0))
        decode = partial(_unpacked, header)
        return whole_array(header.path, header.shape, header.stored_dtype, decode)
    if stored_bytes != needed_bytes:
        raise FileError(
            f"{header.path.name} declares {size_words(header.shape)} values of"
            f" {header.stored_dtype.itemsize} bytes, {needed_bytes} bytes; {data_file.name} has"
            f" {max(stored_bytes, 0)} from byte {offset} on. Copy or export it again, or correct"
            " the header."
        )
    return mapped(data_file, header.shape, header.stored_dtype, offset=offset)


def _unpacked(header: Header) -> Array:
    values = np.empty(header.shape, header.stored_dtype)
    unpacked_bytes = values.reshape(-1).view(np.uint8)
    start = 0
    for part in unpacked_parts(header):
        stop = start + len(part)
        unpacked_bytes[start:stop] = np.frombuffer(part, np.uint8)
        start = stop
    return values.astype(values.dtype.newbyteorder("="), copy=False)


def unpacked_parts(header: Header) -> Iterator[bytes]:
    """Unpack values bit by bit; in the end they were as many as declared, or an error is raised."""
    needed_bytes = header.needed_bytes
    is_bzip2 = header.packing == "bzip2"
    unpacker = _unpacker(header.packing)
    n_unpacked = -header.skip_bytes
    with reading(header.data), header.data.open("rb") as file:
        file.seek(header.offset)
        packed = b""
        while not unpacker.eof and n_unpacked <= needed_bytes:
            # What is unpacked at once is limited, and so some input may be left: that of deflate
            # here, that of bzip2 inside the unpacker.
            needs_input = unpacker.needs_input if is_bzip2 else not packed
            if needs_input:
                packed = file.read(PACKED_BYTES)
                if not packed:
                    break
            # A byte more than needed shows that there are too many.
            most_bytes = min(needed_bytes - n_unpacked + 1, UNPACKED_BYTES)
            part = unpacker.decompress(packed, most_bytes)
            packed = b"" if is_bzip2 else unpacker.unconsumed_tail
            n_unpacked += len(part)
            if 0 < n_unpacked <= needed_bytes:
                yield part[-n_unpacked:]
    if n_unpacked != needed_bytes or not unpacker.eof:
        amount = "more than" if n_unpacked > needed_bytes else f"{max(n_unpacked, 0)} of"
        amount_text = f"hold {amount} the {needed_bytes} bytes declared"
        raise damaged(header.path, f"the packed values in {header.data.name} {amount_text}")


def axes_of(
    extents: Shape,
    path: Path,
    namings: Sequence[AxisNames] = (),
    *,
    contents_text: str = "",
) -> StoredAxes:
    """Find the axes z, y, x of a header, whose extents and names have the fastest axis first.

    Raises
    ------
    VolumeError
        As :func:`planish.io.axes.place_axes`, and where a voxel holds more than a grey value
        (``contents_text``).
    """
    slowest_first = extents[::-1]
    stored_axes = extended_axes(slowest_first)
    is_named = any(naming.names for naming in namings)
    if contents_text or (len(stored_axes) != 3 and not is_named):
        fault_text = f"has {contents_text}" if contents_text else "is no volume"
        raise VolumeError(
            f"{path.name} {fault_text}: {size_words(extents)} (fastest axis first). {ADVICE}"
        )
    stored_namings = [AxisNames(source, names[::-1]) for source, names in namings]
    placed = place_axes(slowest_first, stored_namings, path.name)
    return StoredAxes(
        shape=tuple(slowest_first[axis] for axis in stored_axes),
        header_axes=tuple(len(extents) - 1 - axis for axis in placed.order),
        order=tuple(map(stored_axes.index, placed.order)),
        notes=placed.notes,
    )


def _unpacker(packing: str) -> Any:
    if packing == "bzip2":
        return bz2.BZ2Decompressor()
    return zlib.decompressobj(wbits=47)
