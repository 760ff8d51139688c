"""Lengths in the flat sheet against lengths on the warped one: straight lines of the plane, traced on the surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from planish.core.facts import Facts, Value
from planish.core.typing import Bools, Floats

Index = NDArray[np.intp]

# Cell (i, j) has the corners a = (i, j), b = (i, j + 1), c = (i + 1, j + 1), d = (i + 1, j) and is cut along a-c:
# half 0 is (a, b, c), half 1 is (a, c, d). Edge k of a half runs from its corner k to its corner k + 1.
_CORNERS = np.array([[[0, 0], [0, 1], [1, 1]], [[0, 0], [1, 1], [1, 0]]], dtype=np.intp)
# Behind each edge of each half: rows down, columns across, and which half.
_BEHIND = np.array([[[-1, 0, 1], [0, 1, 1], [0, 0, 1]], [[0, 0, 0], [1, 0, 0], [0, -1, 0]]], dtype=np.intp)
_LONGEST = 20  # times rows + cols: no line crosses so many triangles unless it winds through folded cells


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshPoints:
    """Places (n,) on a mesh: cell, its half (0 above the first diagonal, 1 below), shares (n, 3) of its corners."""

    row: Index
    col: Index
    half: Index
    weights: Floats

    def on(self, nodes: Floats) -> Floats:
        """Interpolate ``nodes`` (rows, cols, k) at the places: (n, k)."""
        corner = _CORNERS[self.half]
        corner_values = nodes[self.row[:, None] + corner[..., 0], self.col[:, None] + corner[..., 1]]
        return np.einsum("nc,nck->nk", self.weights, corner_values)


class GeodesicError(Facts):
    """Relative errors of long distances: flat against along the surface."""

    p50: Value = Field(description="Median relative error.")
    p95: Value = Field(description="95th percentile of the relative error.")
    largest: Value = Field(description="Largest relative error.")
    used: int = Field(description="Lines that stay on the sheet from end to end.")
    dropped: int = Field(description="Lines that leave it through a hole or the outline.")


def geodesic_error(points: Floats, uv: Floats, *, rng: np.random.Generator, pairs: int = 1000) -> GeodesicError:
    """Compare the lengths of straight lines in the plane with the lengths of the same lines on the surface.

    Parameters
    ----------
    points : (rows, cols, 3)
        Nodes in space, um; NaN where there is no sheet.
    uv : (rows, cols, 2)
        The same nodes in the plane, um.
    rng : Generator
    pairs : int
        Number of lines. Their ends are random places in random triangles; between nodes of a regular mesh, many lines
        would run along the mesh.

    Returns
    -------
    GeodesicError

    Notes
    -----
    The line traced on the surface is not the geodesic between its ends but close to it. A geodesic is stationary: its
    length and that of the traced line differ in the second order of the strain, so that for a nearly isometric map
    the number is the error of the geodesic's length. Lengths are those of the mesh: chords of the two triangles of each
    cell, which on a surface of radius R are shorter than arcs by up to (pitch / R)^2 / 24.
    """
    whole = whole_cells(points, uv)
    error = np.empty(0)
    if whole.any():
        flat, space = trace_lines(points, uv, random_places(whole, pairs, rng), random_places(whole, pairs, rng))
        used = np.isfinite(space) & (space > 0)
        error = np.abs(flat[used] / space[used] - 1)
    p50, p95, largest = np.percentile(error, [50, 95, 100]) if error.size else (np.nan, np.nan, np.nan)
    return GeodesicError(
        p50=float(p50), p95=float(p95), largest=float(largest), used=error.size, dropped=pairs - error.size
    )


def whole_cells(points: Floats, uv: Floats) -> Bools:
    """Cells (rows - 1, cols - 1) whose four corners are known both in space and in the plane."""
    is_node: Bools = np.asarray(np.isfinite(points).all(axis=-1) & np.isfinite(uv).all(axis=-1))
    return is_node[:-1, :-1] & is_node[:-1, 1:] & is_node[1:, 1:] & is_node[1:, :-1]


def triangle_areas(grid: Floats) -> tuple[Floats, Floats]:
    """Twice the signed areas of the triangles (a, b, c) and (a, c, d) of each cell; NaN where a corner is missing."""
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]

    def area(p: Floats, q: Floats) -> Floats:
        return p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]

    return area(b - a, c - a), area(c - a, d - a)


def folded_cells(points: Floats, uv: Floats, *, side: float = 1.0, floor: float = 0.0) -> Bools:
    """Cells of ``uv`` (rows, cols, 2) with a triangle (a, b, c) or (a, c, d) that is empty or turned over.

    ``side`` is -1 where columns and rows of the grid run in the opposite sense to u and v; ``floor`` is the share of
    a cell's half area in space, from the product of its diagonals, that a triangle must exceed.
    """
    least = 0.0
    if floor:
        across, rising = points[1:, 1:] - points[:-1, :-1], points[1:, :-1] - points[:-1, 1:]
        least = floor * 0.5 * np.linalg.norm(across, axis=-1) * np.linalg.norm(rising, axis=-1)
    with np.errstate(invalid="ignore"):
        first, second = triangle_areas(uv)
        return np.minimum(side * first, side * second) <= least


def random_places(whole: Bools, count: int, rng: np.random.Generator) -> MeshPoints:
    """Draw ``count`` places: every triangle of the whole cells is as likely, and every place in it."""
    cells = np.flatnonzero(whole)
    row, col = np.divmod(cells[rng.integers(cells.size, size=count)], whole.shape[1])
    half = rng.integers(2, size=count)
    return MeshPoints(row=row, col=col, half=half, weights=rng.dirichlet(np.ones(3), size=count))


def trace_lines(points: Floats, uv: Floats, start: MeshPoints, end: MeshPoints) -> tuple[Floats, Floats]:
    """Trace straight lines of the plane through the triangles of the mesh, from inside of one to inside of another.

    Gives the lengths (n,) in the plane and on the surface, um; the latter is NaN where a line leaves the sheet.

    All lines walk at the same time, a triangle a step. Each corner lies to the left of the line or not, and a line
    leaves a triangle by the one edge that runs from its right to its left (the other way round where it starts in a
    triangle that is turned over); no intersection is ever searched, and corners on the line do no harm. In folded cells
    a line follows the sheet there and back.
    """
    inside = np.pad(whole_cells(points, uv), 1)
    first, goal = start.on(uv), end.on(points)
    along = end.on(uv) - first
    flat = np.hypot(along[:, 0], along[:, 1])
    space = np.full(flat.size, np.nan)
    target = np.stack([end.row, end.col, end.half], axis=1)
    turned = np.stack(triangle_areas(uv))[start.half, start.row, start.col] < 0

    # Lines that have not arrived: number, triangle; and last place on the surface, length so far.
    walk: Index = np.stack([np.arange(flat.size), start.row, start.col, start.half], axis=1)
    path: Floats = np.column_stack([start.on(points), np.zeros(flat.size)])
    for _ in range(_LONGEST * sum(points.shape[:2])):
        has_arrived = (walk[:, 1:] == target[walk[:, 0]]).all(axis=1)
        arrived = walk[has_arrived, 0]
        space[arrived] = path[has_arrived, 3] + np.linalg.norm(goal[arrived] - path[has_arrived, :3], axis=1)
        walk, path = walk[~has_arrived], path[~has_arrived]
        if walk.size == 0:
            break
        line = walk[:, 0]
        exits, walk, crosses = _leave_triangles(points, uv, walk, first[line], along[line], turned[line])
        path = np.column_stack([exits, path[:, 3] + np.linalg.norm(exits - path[:, :3], axis=1)])
        is_on_sheet = crosses & inside[walk[:, 1] + 1, walk[:, 2] + 1]
        walk, path = walk[is_on_sheet], path[is_on_sheet]
    return flat, space


def _leave_triangles(
    points: Floats, uv: Floats, walk: Index, first: Floats, along: Floats, turned: Bools
) -> tuple[Floats, Index, Bools]:
    """Give the points (n, 3) at which lines leave their triangles, the triangles behind, and which lines cross an edge.

    Lines begin at ``first`` (n, 2) and run ``along`` (n, 2); those ``turned`` began in a triangle that is turned over.
    """
    line, row, col, half = walk.T
    corner = row[:, None] + _CORNERS[half, :, 0], col[:, None] + _CORNERS[half, :, 1]
    x, y = np.moveaxis(uv[corner] - first[:, None], -1, 0)
    left = along[:, :1] * y - along[:, 1:] * x
    right = (left > 0) == turned[:, None]
    leaves = right & ~right[:, [1, 2, 0]]
    edge = np.argmax(leaves, axis=1)
    begin, stop = ((np.arange(line.size), (edge + k) % 3) for k in (0, 1))
    crosses = leaves.any(axis=1)  # not so where a line starts so close to an edge that rounding put it outside
    share = left[begin] / np.where(crosses, left[begin] - left[stop], 1.0)
    a = points[corner][begin]
    exits = a + share[:, None] * (points[corner][stop] - a)
    down, across, half = _BEHIND[half, edge].T
    return exits, np.stack([line, row + down, col + across, half], axis=1), crosses
