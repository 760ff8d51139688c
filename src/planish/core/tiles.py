"""Work that is done tile by tile.

On threads or on a cluster, in order, and kept so that a killed run goes on.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Executor, Future
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from itertools import count, product
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from planish.core.files import move
from planish.core.threads import count_threads, thread_pool
from planish.core.typing import Array, Shape2D

Job = TypeVar("Job")
Result = Array
Listener = Callable[[str, float], None]
_listeners: list[Listener] = []


@contextmanager
def tiles_told(listener: Listener) -> Generator[None]:
    """Tell ``listener`` the step of each tile that is done, and the share of the step's tiles."""
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)


class Tile(NamedTuple):
    """Rows ``r0`` to ``r1`` and columns ``c0`` to ``c1`` of a grid, the ends not included."""

    r0: int
    r1: int
    c0: int
    c1: int

    @property
    def rows(self) -> slice:
        """Its rows."""
        return slice(self.r0, self.r1)

    @property
    def cols(self) -> slice:
        """Its columns."""
        return slice(self.c0, self.c1)

    def within(self, outer: Tile) -> Tile:
        """Return the same tile, counted from the first row and column of another that holds it."""
        r = outer.r0
        c = outer.c0
        return Tile(self.r0 - r, self.r1 - r, self.c0 - c, self.c1 - c)

    def grown(self, rows: int, cols: int, shape: Shape2D) -> Tile:
        """Return the tile with so many more rows and columns on every side.

        It grows only as far as a grid of ``shape`` reaches.
        """
        r0 = max(self.r0 - rows, 0)
        r1 = min(self.r1 + rows, shape[0])
        c0 = max(self.c0 - cols, 0)
        c1 = min(self.c1 + cols, shape[1])
        return Tile(r0, r1, c0, c1)

    @property
    def shape(self) -> Shape2D:
        """Number of rows and columns."""
        return self.r1 - self.r0, self.c1 - self.c0


def tiles_of(shape: Shape2D, size: Shape2D) -> list[Tile]:
    """Cover a grid of ``shape`` with tiles of ``size``, row by row.

    The last ones of an axis may be smaller.
    """
    rows, cols = shape
    tile_rows, tile_cols = size
    tiles: list[Tile] = []
    for r0, c0 in product(range(0, rows, tile_rows), range(0, cols, tile_cols)):
        r1 = min(r0 + tile_rows, rows)
        c1 = min(c0 + tile_cols, cols)
        tiles.append(Tile(r0, r1, c0, c1))
    return tiles


@dataclass(frozen=True, slots=True, kw_only=True)
class Engine:
    """Threads, memory or cluster that tiles are worked on with; no result depends on it."""

    # Local ones; as :func:`planish.core.threads.count_threads` says where not given.
    threads: int | None = None
    memory_bytes: int = 2**31  # what the tiles that are in memory at the same time may take
    executor: Executor | None = None  # another one than local threads, such as that of a cluster
    workers: int | None = None  # tiles that this executor works on at a time
    # For the results of single tiles: what a run finds there it does not work out again.
    folder: Path | None = None

    @property
    def at_once(self) -> int:
        """Tiles that are worked on at the same time."""
        if self.executor is None:
            return count_threads(self.threads)
        return self.workers or 1

    def map(
        self,
        step: str,
        work: Callable[[Job, Tile], Result],
        job: Callable[[Tile], Job],
        tiles: Sequence[Tile],
    ) -> Iterator[tuple[Tile, Result]]:
        """Give every tile and its result, in the order of ``tiles``.

        ``step`` names the results that are kept.

        ``work``, a function of a module, gets the tile and what it needs to know for it, which
        ``job`` gives and which is sent to an executor of other processes; it returns one array.
        """
        waiting: deque[tuple[Tile, Future[Result] | Result]] = deque()

        n_taken = count(1)

        def take() -> tuple[Tile, Result]:
            tile, future = waiting.popleft()
            is_stored = isinstance(future, np.ndarray)
            result = future if is_stored else future.result()
            for listener in _listeners:
                listener(step, next(n_taken) / len(tiles))
            if not is_stored and (result_path := self._result_path(step, tile)):
                result_path.parent.mkdir(parents=True, exist_ok=True)
                partial_path = result_path.with_suffix(".part")
                with partial_path.open("wb") as file:
                    np.save(file, result)
                    file.flush()
                    os.fsync(file.fileno())
                move(partial_path, result_path, over=True)
            return tile, result

        with (
            thread_pool(self.threads) if self.executor is None else nullcontext(self.executor)
        ) as pool:
            try:
                for tile in tiles:
                    path = self._result_path(step, tile)
                    if path is not None and path.is_file():
                        waiting.append((tile, np.load(path)))
                    else:
                        waiting.append((tile, pool.submit(work, job(tile), tile)))
                    # Two wait for their turn, beside those that are worked on.
                    if len(waiting) >= self.at_once + 2:
                        yield take()
                while waiting:
                    yield take()
            finally:
                for _, future in waiting:
                    if not isinstance(future, np.ndarray):
                        future.cancel()

    def _result_path(self, step: str, tile: Tile) -> Path | None:
        if self.folder is None:
            return None
        # Named by what it covers: with another memory or number of threads the tiles are others.
        return self.folder / step / ("-".join(map(str, tile)) + ".npy")
