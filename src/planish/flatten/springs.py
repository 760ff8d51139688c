"""The eight-spring mesh of Hirn et al. (2009), section 2.3.1: pitch, springs, their stiffness, and loose ends."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.errors import CannotFlatten
from planish.flatten._mesh_kernels import rest_lengths
from planish.flatten.levels import Level, Team, of_springs, padded

Array = NDArray[np.float64]

TRUSTED = 0.1
"""Share of the median weight below which a node does not count in the flattening."""


def mean_pitch(points: Array) -> float:
    """Mean distance of neighbours along rows and columns, from some ten of either, in the unit of ``points``."""
    for some in (10, max(points.shape)):
        rows, cols = (max(1, n // some) for n in points.shape[:2])
        with np.errstate(invalid="ignore", over="ignore"):
            steps = [np.diff(points[::rows], axis=1), np.diff(points[:, ::cols], axis=0)]
            long = np.concatenate([np.sqrt(np.sum(step * step, axis=-1)).ravel() for step in steps])
        long = long[np.isfinite(long)]
        if long.size > 1000:
            break
    pitch = float(long.mean()) if long.size else 0.0
    if not np.isfinite(pitch) or pitch <= 0:
        raise CannotFlatten(
            "No two neighbours of the mesh have a distance. Give a grid of points (rows, cols, 3) in um, in which "
            "neighbours in the grid are neighbours in the sheet."
        )
    return pitch


def make_springs(points: Array, pitch: float, rest: Literal["arc", "chord"], team: Team) -> tuple[Level, int, float]:
    """Tie the nodes of ``points`` (rows, cols, 3) to their neighbours; each spring is stored once.

    Gives a level with rest lengths in pitches and stiffness 1, the number of springs, and the share of them that kept
    their chord although the surface bends there, NaN for ``rest="chord"``.
    """
    rows, cols = points.shape[:2]
    parts = team.parts(rows, cols)
    lengths, counts = padded(4, rows, cols, np.float64), np.zeros((rows + 2, 2))
    team.run(rest_lengths, parts, points, 1 / pitch, rest == "arc", lengths, counts)
    springs, straight = counts.sum(axis=0)
    if springs == 0:
        raise CannotFlatten("No two neighbours of the mesh are known. Fill the gaps or use a coarser mesh.")
    even = np.ones((4, 1, lengths.shape[2]), np.float32)
    return Level(rows, cols, parts, lengths, even), int(springs), straight / springs if rest == "arc" else np.nan


def stiffen(level: Level, weights: Array) -> None:
    """Give every spring the weight of its less certain end."""
    stiff = padded(4, level.rows, level.cols, np.float32)
    of_springs(weights.astype(np.float32), np.minimum, stiff[:, 1 : level.rows + 1, 1 : level.cols + 1])
    stiff[level.rest == 0] = 0.0
    level.stiff = stiff


def loose_nodes(known: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
    """Find the nodes whose place the springs do not settle: what hangs on the sheet by a single node or spring.

    A cell with three corners is stiff, and so are cells that share an edge; everything else can turn freely. The
    largest stiff part is the sheet. Gives the known nodes outside of it, and the number of cells of every stiff part.
    """
    corners = sum(known[i : i + known.shape[0] - 1, j : j + known.shape[1] - 1].astype(np.int8)
                  for i in (0, 1) for j in (0, 1))  # fmt: skip
    # Cells at odd places and the edges between them; a path may pass an edge whose two nodes are known.
    paths = np.zeros((2 * known.shape[0] - 1, 2 * known.shape[1] - 1), dtype=bool)
    paths[1::2, 1::2] = corners >= 3
    paths[1::2, ::2] = known[:-1] & known[1:]
    paths[::2, 1::2] = known[:, :-1] & known[:, 1:]
    labels = ndimage.label(paths)[0][1::2, 1::2]
    sizes = np.bincount(labels[corners >= 3])
    if sizes.size == 0:
        return known.copy(), np.zeros(0, dtype=np.intp)
    cells = (labels == np.argmax(sizes)) & (corners >= 3)
    held = np.zeros_like(known)
    for i in (0, 1):
        for j in (0, 1):
            held[i : i + cells.shape[0], j : j + cells.shape[1]] |= cells
    return known & ~held, sizes[sizes > 0]
