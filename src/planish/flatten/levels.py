"""A mesh and its coarser copies: the arrays that the compiled passes work on, and the threads that share the rows."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.core.typing import Bools, Floats
from planish.flatten._kernels import FAR
from planish.flatten._mesh_kernels import coarsen

Single = NDArray[np.float32]

_LEAST = 5  # meshes of fewer rows or columns are not halved any more
_WORTH = 100_000  # nodes above which a second thread pays for being woken


class Team(ThreadPoolExecutor):
    """Threads that share the rows of a pass; what a pass writes does not depend on their number."""

    def __init__(self, threads: int) -> None:
        super().__init__(max(threads - 1, 1))
        self.threads = threads

    def parts(self, rows: int, cols: int) -> list[tuple[int, int]]:
        """Shares of the padded rows 1 ... rows."""
        count = min(self.threads, rows) if rows * cols >= _WORTH else 1
        cuts = [1 + rows * k // count for k in range(count + 1)]
        return list(itertools.pairwise(cuts))

    def run(self, kernel: Callable[..., Any], parts: list[tuple[int, int]], *args: Any) -> None:
        """Call ``kernel(*args, r0, r1)`` for all parts."""
        if len(parts) == 1:
            kernel(*args, *parts[0])
            return
        self.each(kernel, [(*args, *part) for part in parts])

    def each(self, kernel: Callable[..., Any], calls: list[tuple[Any, ...]]) -> None:
        """Call ``kernel`` once with each list of arguments, and wait for all of them."""
        running = [self.submit(kernel, *call) for call in calls[1:]]
        try:
            kernel(*calls[0])
        finally:
            # The arrays must not be given back while a thread still writes to them.
            wait(running)
        for done in running:
            done.result()


def padded(components: int, rows: int, cols: int, dtype: type, make: Callable[..., Any] = np.zeros) -> NDArray[Any]:
    """Zeros (components, rows + 2, width), with a ring of padding; rows start on a multiple of 64 bytes."""
    return make((components, rows + 2, (cols + 3 + 15) // 16 * 16), dtype)


def bordered(rows: int, cols: int, dtype: type) -> NDArray[Any]:
    """Array (2, rows + 2, width) with FAR in the padding and no values yet inside."""
    out = padded(2, rows, cols, dtype, np.empty)
    out[:, [0, rows + 1]] = FAR
    out[:, :, 0] = FAR
    out[:, :, cols + 1 :] = FAR
    return out


@dataclass(slots=True)
class Level:
    """One mesh: the arrays of ``_kernels``, sums by rows, and the rows of each thread.

    ``alone`` are the empty rows above and below a mesh that one thread smooths.
    """

    rows: int
    cols: int
    parts: list[tuple[int, int]]
    rest: Floats
    stiff: Single
    xy: Floats = field(init=False)
    near: Single = field(init=False)
    ease: Single = field(init=False)
    move: Single = field(init=False)
    force: Single = field(init=False)
    sums: Floats = field(init=False)
    alone: Single = field(init=False)

    def open(self) -> None:
        """Make the arrays of the solver; ``xy`` and ``near`` have no values yet except in the padding."""
        self.xy, self.near = (bordered(self.rows, self.cols, dtype) for dtype in (np.float64, np.float32))
        self.ease = padded(1, self.rows, self.cols, np.float32)[0]
        self.move = padded(2, self.rows, self.cols, np.float32)
        self.force = padded(2, self.rows, self.cols, np.float32)
        self.sums = np.zeros((self.rows + 2, 2))
        self.alone = np.zeros((2, 2, self.move.shape[2]), np.float32)

    def drop_springs(self) -> None:
        """Give back the memory of the springs, which only the forces need."""
        self.rest = np.empty((4, 0, 0))

    @property
    def nodes(self) -> Bools:
        """Mask (rows, cols) of the nodes that a spring holds."""
        across, down, right, left = self.rest > 0
        is_held = across | down | right
        is_held[:, 1:] |= across[:, :-1] | left[:, :-1]
        is_held[1:] |= down[:-1] | left[:-1]
        is_held[1:, 1:] |= right[:-1, :-1]
        return is_held[1 : self.rows + 1, 1 : self.cols + 1]

    def clear(self) -> None:
        """Take away the places of what is not a node."""
        gone = ~self.nodes
        for places in (self.xy, self.near):
            places[:, 1 : self.rows + 1, 1 : self.cols + 1][:, gone] = FAR


def of_springs(nodes: NDArray[Any], pair: Callable[..., Any], out: NDArray[Any]) -> NDArray[Any]:
    """Set ``out`` (4, rows, cols) to ``pair`` of the two ends of each spring."""
    out[0, :, :-1] = pair(nodes[:, :-1], nodes[:, 1:])
    out[1, :-1] = pair(nodes[:-1], nodes[1:])
    out[2, :-1, :-1] = pair(nodes[:-1, :-1], nodes[1:, 1:])
    out[3, :-1, :-1] = pair(nodes[:-1, 1:], nodes[1:, :-1])
    return out


def halve(level: Level, team: Team) -> Level:
    """Make the mesh of every second node; the last may lie one row or column beyond the fine mesh."""
    rows, cols = level.rows // 2 + 1, level.cols // 2 + 1
    rest, stiff = padded(4, rows, cols, np.float64), padded(4, rows, cols, np.float32)
    parts = team.parts(rows, cols)
    team.run(coarsen, parts, level.rest, level.stiff, rest, stiff, level.cols, cols)
    return Level(rows, cols, parts, rest, stiff)


def hierarchy(level: Level, team: Team) -> list[Level]:
    """Return the level and its coarser ones, finest first."""
    levels = [level]
    while min(levels[-1].rows, levels[-1].cols) > _LEAST:
        levels.append(halve(levels[-1], team))
    return levels
