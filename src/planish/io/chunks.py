"""Chunks that a store should have and has: those not stored read as one constant, without a word."""

from __future__ import annotations

import math
from collections.abc import Iterable

from planish.core.errors import FileError

AXES = ("z", "y", "x")


def check_chunks(
    present: Iterable[tuple[int, ...]], shape: tuple[int, ...], chunk: tuple[int, ...], *, name: str
) -> tuple[str, ...]:
    """Compare the chunks of an array with those it should have.

    Writers leave out chunks that hold nothing but the fill value, so a few that are missing may be the air around a
    sample. A whole layer of the array without any is a copy that was cut off, or a wrong shape.
    """
    grid = tuple(-(-n // c) for n, c in zip(shape, chunk, strict=True))
    seen: list[set[int]] = [set() for _ in grid]
    count = 0
    for position in present:
        if len(position) == len(grid) and all(0 <= p < n for p, n in zip(position, grid, strict=True)):
            count += 1
            for axis, p in enumerate(position):
                seen[axis].add(p)
    total = math.prod(grid)
    remedy = "It is cut off, or its shape is wrong: copy or export it again."
    if not count:
        raise FileError(f"{name} has no values: none of its {total} chunks is stored. {remedy}")
    names = ("t", "c", *AXES)[-len(grid) :] if len(grid) <= 5 else tuple(map(str, range(len(grid))))
    for axis, (found, n, c) in enumerate(zip(seen, grid, chunk, strict=True)):
        if len(found) < n:
            missing = next(p for p in range(n) if p not in found)
            raise FileError(
                f"{name} has no values for {names[axis]} from {missing * c} to "
                f"{min((missing + 1) * c, shape[axis]) - 1}: {total - count} of its {total} chunks are not stored. "
                f"{remedy}"
            )
    if count == total:
        return ()
    return (
        f"{total - count} of its {total} chunks are not stored and read as one constant: either they are empty, or "
        "they were lost when it was copied.",
    )
