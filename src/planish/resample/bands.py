"""Rows of an array shared out among threads, for kernels that write their own rows only."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import TypeVar

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
    threads = threads or min(os.cpu_count() or 1, 8)
    count = max(1, min(_BANDS * threads, rows // _LEAST_ROWS))
    edges = [rows * k // count for k in range(count + 1)]
    if threads == 1 or count == 1:
        return [work(begin, end) for begin, end in pairwise(edges)]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, edges[:-1], edges[1:]))
