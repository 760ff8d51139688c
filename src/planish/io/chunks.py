"""Chunks that a store should have and has: those not stored read as one constant, and cut ones as anything."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Iterator
from itertools import product
from pathlib import Path
from typing import Any

from planish.core.errors import FileError
from planish.core.lazy import Where

METADATA = frozenset({"zarr.json", ".zarray", ".zattrs", ".zgroup", ".zmetadata"})
"""Files of a zarr store that are no chunks."""


def check_chunks(
    present: Iterable[tuple[int, ...]], shape: tuple[int, ...], chunk: tuple[int, ...], *, name: str
) -> tuple[str, ...]:
    """Compare the chunks of an array with those it should have.

    Writers leave out chunks that hold nothing but the fill value, so a few that are missing may be the air around a
    sample. A whole layer of the array without any is a copy that was cut off, or a wrong shape.
    """
    grid = tuple(-(-n // c) for n, c in zip(shape, chunk, strict=True))
    stored = [p for p in present if len(p) == len(grid) and all(0 <= i < n for i, n in zip(p, grid, strict=True))]
    lost, total = math.prod(grid) - len(stored), math.prod(grid)
    remedy = "It is cut off, or its shape is wrong: copy or export it again."
    if not stored:
        raise FileError(f"{name} has no values: none of its {total} chunks is stored. {remedy}")
    names = "tczyx"[-len(grid) :] if len(grid) <= 5 else range(len(grid))
    for axis, (found, n, c) in enumerate(zip(zip(*stored, strict=True), grid, chunk, strict=True)):
        places = set(found)
        missing = next((p for p in range(n) if p not in places), None)
        if missing is not None:
            raise FileError(
                f"{name} has no values for {names[axis]} from {missing * c} to "
                f"{min((missing + 1) * c, shape[axis]) - 1}: {lost} of its {total} chunks are not stored. {remedy}"
            )
    if not lost:
        return ()
    return (
        f"{lost} of its {total} chunks are not stored and read as one constant: either they are empty, or "
        "they were lost when it was copied.",
    )


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
