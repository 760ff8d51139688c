"""The chunks of a zarr array as files: which there are, and whether they are whole."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

from planish.core.errors import FileError
from planish.core.lazy import Where

METADATA = frozenset({"zarr.json", ".zarray", ".zattrs", ".zgroup", ".zmetadata"})


def stored_chunks(folder: Path) -> Iterator[tuple[int, ...]]:
    """Positions of the chunks, or shards, that lie in the folder of an array."""
    for file in folder.rglob("*"):
        if file.name in METADATA or file.name.startswith(".") or not file.is_file():
            continue
        words = ".".join(file.relative_to(folder).parts).split(".")
        numbers = words[1:] if words[0] == "c" else words
        if all(number.isdecimal() for number in numbers):
            yield tuple(int(number) for number in numbers)


def packed_by_blosc(array: Any) -> bool:
    """Whether each chunk is one block of Blosc; in shards, a checksum guards the chunks."""
    return array.shards is None and any("blosc" in type(codec).__name__.casefold() for codec in array.compressors)


def check_blosc(array: Any, where: Where, folder: Path, path: Path) -> None:
    """Compare the chunks of a part with the sizes in their first bytes; Blosc itself would read on behind their end."""
    needed = math.prod(array.chunks) * array.dtype.itemsize
    spans = [range(s.start // c, (s.stop - 1) // c + 1) for s, c in zip(where, array.chunks, strict=True)]
    for position in product(*spans):
        chunk = folder / array.metadata.encode_chunk_key(position)
        if not chunk.is_file():
            continue
        with chunk.open("rb") as file:
            head = file.read(16)
        there = chunk.stat().st_size
        unpacked, packed = struct.unpack_from("<4xIxxxxI", head) if len(head) == 16 else (0, 0)
        if (unpacked, packed) != (needed, there):
            raise FileError(
                f"{path.name}: its chunk {chunk.relative_to(path).as_posix()} is cut off or damaged: it has "
                f"{there} bytes of {packed}, for {unpacked} bytes of values, where {needed} are needed. Copy it "
                "again."
            )
