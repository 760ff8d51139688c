"""Rows of an array shared out among threads, for kernels that write their own rows only."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from planish.core.threads import count_threads, map_threads

Result = TypeVar("Result")

_LEAST_ROWS = 32  # of a band: below that, starting a thread takes longer than the work
_BANDS = 4  # per thread, so that one with an easy band takes over from one with a hard band


def each_band(work: Callable[[int, int], Result], rows: int, *, threads: int | None = None) -> list[Result]:
    """Call ``work(begin, end)`` for bands of ``rows`` rows and return what it gives, in order.

    Parameters
    ----------
    work : callable
        Does the rows from ``begin`` up to ``end``; has to give up the interpreter's lock for threads to be of use.
    rows : int
        At least 1.
    threads : int, optional
        All processors, at most 8, where not given.
    """
    threads = count_threads(threads)
    count = max(1, min(_BANDS * threads, rows // _LEAST_ROWS))
    edges = [rows * k // count for k in range(count + 1)]
    return map_threads(work, edges[:-1], edges[1:], number=min(threads, count))
