"""Parts of a working store's array, decoded by the threads that ask for them.

zarr makes a task for every chunk and copies all of them in one thread; here each reading thread
decodes and copies its own. The layout is that of the sharding codec of zarr 3: chunks in any order,
then an index of the place and size of each, 8 bytes little endian either, and its CRC-32C.
"""

import math
from pathlib import Path

import numpy as np
from imagecodecs import zstd_decode
from zarr.codecs import (
    BytesCodec,
    Crc32cCodec,
    ShardingCodec,
    ZstdCodec,
)

from planish.core.lazy import Where, chunk_parts
from planish.core.typing import Array
from planish.io.map_chunks import StoredArray, without_sum

_ABSENT = np.uint64(2**64 - 1)  # place of a chunk that holds the fill value


def is_plain(array: StoredArray) -> bool:
    """Tell whether an array lies in shards of chunks that zstd packs and nothing else.

    The arrays of a working store do.
    """
    codecs = getattr(array.metadata, "codecs", ())
    if len(codecs) != 1 or not isinstance(codecs[0], ShardingCodec):
        return False
    (sharding,) = codecs
    plain_bytes = (BytesCodec(endian=None), BytesCodec(endian="little"))
    expected = ((sharding.codecs, ZstdCodec), (sharding.index_codecs, Crc32cCodec))
    for codecs, second in expected:
        if [*map(type, codecs)] != [BytesCodec, second] or codecs[0] not in plain_bytes:
            return False
    is_index_last = sharding.to_dict()["configuration"]["index_location"] == "end"
    return is_index_last and array.dtype.newbyteorder("<") == array.dtype


def read_plain(folder: Path, array: StoredArray, where: Where) -> Array:
    """Read a part (slices without steps) of an array that :func:`is_plain`.

    ValueError or OSError if it is damaged.
    """
    assert array.shards is not None
    values = np.zeros([w.stop - w.start for w in where], array.dtype)
    if array.fill_value:
        values[:] = array.fill_value
    for position, within, target in chunk_parts(where, array.shards):
        file = folder / array.metadata.encode_chunk_key(position)
        if file.is_file():
            _read_shard(file, array, within, values[target])
    return values


def _read_shard(path: Path, array: StoredArray, where: Where, values: Array) -> None:
    """Put what lies ``where`` of one shard, counted from its own start, into ``values``."""
    assert array.shards is not None
    chunks_shape = np.floor_divide(array.shards, array.chunks).tolist()
    n_chunks = math.prod(chunks_shape)
    raw_block = bytearray(math.prod(array.chunks) * values.itemsize)
    block = np.frombuffer(raw_block, values.dtype).reshape(array.chunks)
    with path.open("rb") as file:
        # The index is at the end: 16 bytes a chunk, and 4 of the sum.
        file.seek(-16 * n_chunks - 4, 2)
        raw_index = without_sum(file.read(), f"the index of {path.name}")
        index = np.frombuffer(raw_index, "<u8").reshape(*chunks_shape, 2)
        for position, within, target in chunk_parts(where, array.chunks):
            offset, size = index[position]
            if offset == _ABSENT:
                continue
            file.seek(int(offset))
            decoded = zstd_decode(file.read(int(size)), out=raw_block)
            if len(decoded) != len(raw_block):
                raise ValueError(f"a chunk of {path.name} is damaged")
            values[target] = block[within]
