"""Parts of a working store's array, decoded by the threads that ask for them.

zarr makes a task for every chunk and copies all of them in one thread; here each reading thread
decodes and copies its own. The layout is that of the sharding codec of zarr 3: chunks in any order,
then an index of the place and size of each, 8 bytes little endian either, and its CRC-32C.
"""

import math
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from google_crc32c import value as crc32c
from imagecodecs import zstd_decode
from zarr.codecs import (
    BytesCodec,
    Crc32cCodec,
    ShardingCodec,
    ZstdCodec,
)

from planish.core.lazy import Where
from planish.core.typing import Array, Shape

_ABSENT = np.uint64(2**64 - 1)  # place of a chunk that holds the fill value


def is_plain(array: zarr.Array[Any]) -> bool:
    """Tell whether an array lies in shards of chunks that zstd packs and nothing else.

    The arrays of a working store do.
    """
    codecs = getattr(array.metadata, "codecs", ())
    if len(codecs) != 1 or not isinstance(codecs[0], ShardingCodec):
        return False
    (sharding,) = codecs
    plain_bytes = (BytesCodec(endian=None), BytesCodec(endian="little"))
    for codecs, second in ((sharding.codecs, ZstdCodec), (sharding.index_codecs, Crc32cCodec)):
        kinds = [type(codec) for codec in codecs]
        if kinds != [BytesCodec, second] or codecs[0] not in plain_bytes:
            return False
    is_index_last = sharding.to_dict()["configuration"]["index_location"] == "end"
    return is_index_last and array.dtype.newbyteorder("<") == array.dtype


def read_plain(folder: Path, array: zarr.Array[Any], where: Where) -> Array:
    """Read a part (slices without steps) of an array that :func:`is_plain`.

    ValueError or OSError if it is damaged.
    """
    assert array.shards is not None
    shape = [w.stop - w.start for w in where]
    values = np.zeros(shape, array.dtype)
    if array.fill_value:
        values[:] = array.fill_value
    per_shard = [s // c for s, c in zip(array.shards, array.chunks, strict=True)]
    ranges = [
        range(w.start // s, -(-w.stop // s)) for w, s in zip(where, array.shards, strict=True)
    ]
    for shard in product(*ranges):
        file = folder / array.metadata.encode_chunk_key(shard)
        if file.is_file():
            firsts = [k * n for k, n in zip(shard, per_shard, strict=True)]
            _read_shard(file, firsts, per_shard, array.chunks, where, values)
    return values


def _read_shard(
    path: Path,
    firsts: list[int],
    per_shard: list[int],
    chunk: Shape,
    where: Where,
    values: Array,
) -> None:
    """Put what lies ``where`` of the chunks of one shard into ``values``.

    ``firsts``: number of its first chunk.
    """
    index_bytes = 16 * math.prod(per_shard)
    raw_block = bytearray(math.prod(chunk) * values.itemsize)
    block = np.frombuffer(raw_block, values.dtype).reshape(chunk)
    with path.open("rb") as file:
        file.seek(-index_bytes - 4, 2)
        raw = file.read()
        if crc32c(raw[:-4]) != int.from_bytes(raw[-4:], "little"):
            raise ValueError(f"the index of {path.name} is damaged")
        index = np.frombuffer(raw, "<u8", 2 * math.prod(per_shard)).reshape(*per_shard, 2)
        spans = [
            range(max(w.start // c - first, 0), min(-(-w.stop // c) - first, n))
            for w, c, first, n in zip(where, chunk, firsts, per_shard, strict=True)
        ]
        for place in product(*spans):
            offset, size = index[place]
            if offset == _ABSENT:
                continue
            file.seek(int(offset))
            if len(zstd_decode(file.read(int(size)), out=raw_block)) != len(raw_block):
                raise ValueError(f"a chunk of {path.name} is damaged")
            target: list[slice] = []
            source: list[slice] = []
            for w, first, k, c in zip(where, firsts, place, chunk, strict=True):
                begin = (first + k) * c
                start = max(w.start, begin)
                stop = min(w.stop, begin + c)
                target.append(slice(start - w.start, stop - w.start))
                source.append(slice(start - begin, stop - begin))
            values[tuple(target)] = block[tuple(source)]
