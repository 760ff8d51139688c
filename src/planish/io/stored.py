"""Values behind a header of another kind: raw bytes that are mapped, or compressed ones that are unpacked at once."""

from __future__ import annotations

import bz2
import math
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import FileError
from planish.io.guard import check_blown_up, check_memory, reading, size_of_file
from planish.io.lazy import FileArray, mapped
from planish.io.tiff import size_words

READ_BYTES = 4 * 2**20
UNPACKED_BYTES = 64 * 2**20
MOST_VOXELS = 2**50
"""No scan has more; a larger number is damage."""


def check_shape(shape: tuple[int, ...], path: Path) -> None:
    """Refuse extents that no volume has."""
    if any(n < 1 for n in shape) or math.prod(shape) > MOST_VOXELS:
        raise FileError(
            f"{path.name} declares {size_words(shape)} voxels, which no volume has. It is damaged: copy or export it "
            "again."
        )


def raw_values(
    path: Path, data: Path, shape: tuple[int, ...], stored: np.dtype[Any], *, offset: int
) -> NDArray[Any] | FileArray:
    """Map values that lie in a file as they are and fill it from an offset to its end."""
    check_shape(shape, path)
    needed = math.prod(shape) * stored.itemsize
    there = size_of_file(data) - offset
    if there != needed:
        fault = "It was cut off" if there < needed else "The header is wrong"
        raise FileError(
            f"{path.name} declares {size_words(shape)} values of {stored.itemsize} bytes, {needed} bytes; {data.name} "
            f"has {max(there, 0)} from byte {offset} on. {fault}: copy or export it again, or correct the header."
        )
    return mapped(data, shape, stored, offset=offset)


def unpacked_values(
    path: Path,
    data: Path,
    shape: tuple[int, ...],
    stored: np.dtype[Any],
    *,
    offset: int,
    packing: str,
    memory_bytes: int | None,
) -> NDArray[Any]:
    """Unpack values that fill a file from an offset to its end."""
    check_shape(shape, path)
    needed = math.prod(shape) * stored.itemsize
    stored_bytes = max(size_of_file(data) - offset, 0)
    check_blown_up(data, decoded_bytes=needed, stored_bytes=stored_bytes)
    check_memory(path, needed_bytes=needed, limit_bytes=memory_bytes)
    values = np.empty(needed, np.uint8)
    filled = 0
    for part in unpacked_parts(path, data, needed, offset=offset, packing=packing):
        values[filled : filled + len(part)] = np.frombuffer(part, np.uint8)
        filled += len(part)
    with reading(data):
        array = values.view(stored).reshape(shape)
        return array if stored == stored.newbyteorder("=") else array.astype(stored.newbyteorder("="))


def check_unpacked(path: Path, data: Path, needed: int, *, offset: int, packing: str) -> None:
    """Unpack values without keeping them, to see that they are whole."""
    for _ in unpacked_parts(path, data, needed, offset=offset, packing=packing):
        pass


def unpacked_parts(path: Path, data: Path, needed: int, *, offset: int, packing: str) -> Iterator[bytes]:
    """Unpack values bit by bit; in the end they were `needed` bytes, or an error is raised."""
    unpacker: Any = bz2.BZ2Decompressor() if packing == "bzip2" else zlib.decompressobj(wbits=47)
    filled = 0
    with reading(data), data.open("rb") as file:
        file.seek(offset)
        packed = b""
        while not unpacker.eof:
            # What is unpacked at once is limited, and so some input may be left, here or inside the unpacker.
            inside = packing == "bzip2" and not unpacker.needs_input
            if not packed and not inside:
                packed = file.read(READ_BYTES)
                if not packed:
                    break
            part = unpacker.decompress(packed, min(needed - filled + 1, UNPACKED_BYTES))
            packed = b"" if packing == "bzip2" else unpacker.unconsumed_tail
            filled += len(part)
            if filled > needed:
                raise wrong_size(path, data, f"more than the {needed} bytes declared")
            yield part
    if filled != needed or not unpacker.eof:
        raise wrong_size(path, data, f"{filled} of the {needed} bytes declared")


def wrong_size(path: Path, data: Path, found: str) -> FileError:
    """Say that header and data do not fit."""
    whose = "" if data == path else f" of {data.name}"
    return FileError(
        f"{path.name}: the packed values{whose} hold {found}. It is cut off or damaged, or its header is wrong: copy "
        "or export it again."
    )
