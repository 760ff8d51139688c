"""Chunks of a map in a store, packed and unpacked by the threads that ask for them.

zarr makes a task for every chunk and hands all of them through one loop: that takes several times
as long as packing. Here each thread packs and writes its own. A chunk is packed by Blosc, and its
CRC-32C (4 bytes, little endian) follows.
"""

from pathlib import Path
from typing import Any

import numpy as np
import zarr
from google_crc32c import value as crc32c
from numcodecs import Blosc
from zarr.codecs import BloscCodec, BytesCodec, Crc32cCodec

from planish.core.lazy import Where, chunk_parts
from planish.core.typing import Array

StoredArray = zarr.Array[Any]
_BLOSC = Blosc(cname="lz4", clevel=1, shuffle=Blosc.SHUFFLE)
# Noisy maps, bytes sorted by weight, take a fifth less room than by zstd, in a fifth of the time;
# the sum tells damage.
CODECS = (BloscCodec(cname="lz4", clevel=1, shuffle="shuffle"), Crc32cCodec())


def is_ours(array: StoredArray) -> bool:
    """Whether an array is packed as the maps of a run are."""
    kinds = [*map(type, getattr(array.metadata, "codecs", ()))]
    if kinds != [BytesCodec, BloscCodec, Crc32cCodec]:
        return False
    return array.dtype.newbyteorder("<") == array.dtype


def write_chunks(folder: Path, array: StoredArray, where: Where, values: Array) -> None:
    """Write a part of an array like ``array`` into its folder.

    Where a chunk holds more than that, what was written before stays.
    """
    for position, within, source in chunk_parts(where, array.chunks):
        file = folder / array.metadata.encode_chunk_key(position)
        chunk = np.require(_unpacked(file, array), requirements="W")
        chunk[within] = values[source]
        packed = _BLOSC.encode(chunk)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(packed + crc32c(packed).to_bytes(4, "little"))


def read_chunks(folder: Path, array: StoredArray, where: Where) -> Array:
    """Read a part of an array that :func:`is_ours` from its folder.

    ValueError, RuntimeError or OSError where it is damaged.
    """
    values = np.empty([w.stop - w.start for w in where], array.dtype)
    for position, within, target in chunk_parts(where, array.chunks):
        file = folder / array.metadata.encode_chunk_key(position)
        values[target] = _unpacked(file, array)[within]
    return values


def _unpacked(file: Path, array: StoredArray) -> Array:
    """What a file holds, which cannot be written to; where there is none, missing values."""
    if not file.is_file():
        return np.full(array.chunks, array.fill_value, array.dtype)
    packed = without_sum(file.read_bytes(), f"the chunk {file.name} of {array.path}")
    values = np.frombuffer(_BLOSC.decode(packed), array.dtype)
    return values.reshape(array.chunks)


def without_sum(raw: bytes, subject: str) -> bytes:
    """Take off the CRC-32C behind some bytes; ValueError where it is not theirs."""
    content = raw[:-4]
    if crc32c(content) != int.from_bytes(raw[-4:], "little"):
        raise ValueError(f"{subject} is damaged")
    return content
