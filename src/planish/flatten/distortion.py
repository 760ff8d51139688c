"""Give the strain of each cell by flattening, growth against the projection, and lengths of lines.

Lines are measured flat and curved.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import xarray as xr

from planish.core.facts import DescribedModel, Value
from planish.core.grid import corners_of
from planish.core.robust import percentiles
from planish.core.transform import are_known
from planish.core.typing import Bools, Floats, Ints

# Cell (i, j) has the corners a = (i, j), b = (i, j + 1), c = (i + 1, j + 1), d = (i + 1, j) and is
# cut along a-c: half 0 is (a, b, c), half 1 is (a, c, d). Edge k of a half runs from its corner k
# to its corner k + 1.
_CORNERS = np.array([[[0, 0], [0, 1], [1, 1]], [[0, 0], [1, 1], [1, 0]]], dtype=np.intp)
# Behind each edge of each half: rows down, columns across, and which half.
_BEHIND = np.array(
    [[[-1, 0, 1], [0, 1, 1], [0, 0, 1]], [[0, 0, 0], [1, 0, 0], [0, -1, 0]]], dtype=np.intp
)

_LINES = 1000


class MeshPoints(NamedTuple):
    """Places (n,) on a mesh.

    Cell, its half (0 above the first diagonal, 1 below), and shares (n, 3) of its corners.
    """

    row: Ints
    col: Ints
    half: Ints
    weights: Floats

    def on(self, nodes: Floats) -> Floats:
        """Interpolate ``nodes`` (rows, cols, k) at the places: (n, k)."""
        corner_values = nodes[_corners(self.row, self.col, self.half)]
        return np.einsum("nc,nck->nk", self.weights, corner_values)


def _corners(row: Ints, col: Ints, half: Ints) -> tuple[Ints, Ints]:
    """Rows and columns (n, 3) of the corners of triangles."""
    down, across = np.moveaxis(_CORNERS[half], -1, 0)
    return row[:, None] + down, col[:, None] + across


class GeodesicError(DescribedModel):
    """Relative errors of long distances: flat against along the surface."""

    p50: Value
    """Median relative error."""
    p95: Value
    """95th percentile of the relative error."""
    largest: Value
    """Largest relative error."""
    used: int
    """Lines that stay on the sheet from end to end."""
    dropped: int
    """Lines that leave it through a hole or the outline."""


def geodesic_error(points: Floats, uv: Floats, *, rng: np.random.Generator) -> GeodesicError:
    """Compare the lengths of 1000 straight lines in the plane with their lengths on the surface.

    Their ends are random places in random triangles; between nodes, many would run along the mesh.

    Parameters
    ----------
    points : (rows, cols, 3); nodes in space, um; NaN where there is no sheet
    uv : (rows, cols, 2); the same nodes in the plane, um
    rng : Generator

    Returns
    -------
    GeodesicError

    Notes
    -----
    The line traced on the surface is not the geodesic between its ends but close to it. A geodesic
    is stationary: its length and that of the traced line differ in the second order of the strain,
    so that for a nearly isometric map the number is the error of the geodesic's length. Lengths are
    those of the mesh: chords of the two triangles of each cell, which on a surface of radius R are
    shorter than arcs by up to (pitch / R)^2 / 24.
    """
    whole = whole_cells(points, uv)
    error = np.empty(0)
    if whole.any():
        start, end = (random_places(whole, _LINES, rng) for _ in range(2))
        flat, space = trace_lines(points, uv, start, end)
        error = np.abs(flat[space > 0] / space[space > 0] - 1)
    p50, p95, largest = percentiles(error, 50, 95, 100)
    return GeodesicError(
        p50=p50, p95=p95, largest=largest, used=error.size, dropped=_LINES - error.size
    )


def whole_cells(points: Floats, uv: Floats) -> Bools:
    """Cells (rows - 1, cols - 1) whose four corners are known both in space and in the plane."""
    return np.logical_and.reduce(corners_of(are_known(points) & are_known(uv)))


def triangle_areas(grid: Floats) -> tuple[Floats, Floats]:
    """Twice the signed areas of the triangles (a, b, c) and (a, c, d) of each cell.

    NaN where a corner is missing.
    """
    a, *others = corners_of(grid)
    (bx, by), (cx, cy), (dx, dy) = (np.moveaxis(corner - a, -1, 0) for corner in others)
    return bx * cy - by * cx, cx * dy - cy * dx


def folded_cells(points: Floats, uv: Floats, *, side: float = 1.0, floor: float = 0.0) -> Bools:
    """Find the cells of ``uv`` (rows, cols, 2) with a triangle that is empty or turned over.

    The triangles of a cell are (a, b, c) and (a, c, d).

    ``side`` is -1 where columns and rows of the grid run in the opposite sense to u and v;
    ``floor`` is the share of a cell's half area in space, from the product of its diagonals, that a
    triangle must exceed.
    """
    least_area = 0.0
    if floor:
        a, b, c, d = corners_of(points)
        across_um = np.linalg.norm(c - a, axis=-1)
        rising_um = np.linalg.norm(d - b, axis=-1)
        least_area = floor * 0.5 * across_um * rising_um
    with np.errstate(invalid="ignore"):
        first, second = triangle_areas(uv)
        return np.minimum(side * first, side * second) <= least_area


def random_places(whole: Bools, count: int, rng: np.random.Generator) -> MeshPoints:
    """Draw ``count`` places in the whole cells.

    Every triangle of these cells is equally likely, and so is every place in it.
    """
    cells = np.argwhere(whole)
    row, col = cells[rng.integers(len(cells), size=count)].T
    half = rng.integers(2, size=count)
    weights = rng.dirichlet(np.ones(3), size=count)
    return MeshPoints(row=row, col=col, half=half, weights=weights)


def trace_lines(
    points: Floats, uv: Floats, start: MeshPoints, end: MeshPoints
) -> tuple[Floats, Floats]:
    """Trace straight lines of the plane through the triangles of the mesh.

    They run from inside of one triangle to inside of another.

    Gives the lengths (n,) in the plane and on the surface, um; the latter is NaN where a line
    leaves the sheet. All lines walk at the same time, a triangle a step. Each corner lies to the
    left of the line or not, and a line leaves a triangle by the one edge that runs from its right
    to its left (the other way round where it starts in a triangle that is turned over); no
    intersection is ever searched, and corners on the line do no harm. In folded cells a line
    follows the sheet there and back.
    """
    is_cell = np.pad(whole_cells(points, uv), 1)
    origin = start.on(uv)
    goals = end.on(points)
    vector = end.on(uv) - origin
    flat_um = np.hypot(*vector.T)
    space_um = np.full(flat_um.size, np.nan)
    end_triangle = np.stack([end.row, end.col, end.half], axis=1)
    is_turned = np.stack(triangle_areas(uv))[start.half, start.row, start.col] < 0

    # Lines that have not arrived: number, triangle; and last place on the surface, length so far.
    line = np.arange(flat_um.size)
    triangles: Ints = np.stack([line, start.row, start.col, start.half], axis=1)
    positions: Floats = np.column_stack([start.on(points), np.zeros(flat_um.size)])
    # No line crosses so many triangles unless it winds through folded cells.
    for _ in range(20 * sum(points.shape[:2])):
        has_arrived = (triangles[:, 1:] == end_triangle[triangles[:, 0]]).all(axis=1)
        arrived = triangles[has_arrived, 0]
        rest_um = np.linalg.norm(goals[arrived] - positions[has_arrived, :3], axis=1)
        space_um[arrived] = positions[has_arrived, 3] + rest_um
        triangles, positions = triangles[~has_arrived], positions[~has_arrived]
        if triangles.size == 0:
            break
        line = triangles[:, 0]
        start_turned = (origin[line], vector[line], is_turned[line])
        exits, triangles, has_exit = _leave_triangles(points, uv, triangles, *start_turned)
        way_um = np.linalg.norm(exits - positions[:, :3], axis=1)
        positions = np.column_stack([exits, positions[:, 3] + way_um])
        is_on_sheet = has_exit & is_cell[triangles[:, 1] + 1, triangles[:, 2] + 1]
        triangles, positions = triangles[is_on_sheet], positions[is_on_sheet]
    return flat_um, space_um


def _leave_triangles(
    points: Floats, uv: Floats, triangles: Ints, origin: Floats, vector: Floats, is_turned: Bools
) -> tuple[Floats, Ints, Bools]:
    """Give the points (n, 3) at which lines leave their triangles, and the triangles behind.

    Gives also which lines cross an edge.
    """
    # Those that are turned began in a triangle that is turned over.
    line, row, col, half = triangles.T
    corner = _corners(row, col, half)
    x, y = np.moveaxis(uv[corner] - origin[:, None], -1, 0)
    side = vector[:, :1] * y - vector[:, 1:] * x
    is_right = (side > 0) == is_turned[:, None]
    is_exit_edge = is_right & ~is_right[:, [1, 2, 0]]
    edge = np.argmax(is_exit_edge, axis=1)
    begin_corner, end_corner = ((np.arange(line.size), (edge + k) % 3) for k in (0, 1))
    # Not so where a line starts so close to an edge that rounding put it outside.
    has_exit = is_exit_edge.any(axis=1)
    way = np.where(has_exit, side[begin_corner] - side[end_corner], 1.0)
    exit_share = side[begin_corner] / way
    corner_points = points[corner]
    a, b = corner_points[begin_corner], corner_points[end_corner]
    down, across, half = _BEHIND[half, edge].T
    behind = np.stack([line, row + down, col + across, half], axis=1)
    return a + exit_share[:, None] * (b - a), behind, has_exit


_BLOCK = 100_000  # nodes worked on at a time, so that scratch arrays stay small beside the mesh


class Spread(DescribedModel):
    """Distribution of one strain over the mesh."""

    median: Value
    """Median over the cells."""
    p5: Value
    """5th percentile."""
    p95: Value
    """95th percentile."""
    p95_abs: Value
    """95th percentile of the absolute value."""
    max_abs: Value
    """Largest absolute value."""


class Distortion(DescribedModel):
    """How much the flattening strained the sheet."""

    area: Spread
    """Area strain: ratio of areas less 1."""
    axial_u: Spread
    """Strain of the cells' edges along the rows of the mesh."""
    axial_v: Spread
    """Strain of the cells' edges along its columns."""
    shear: Spread
    """Change of the angle between both, rad."""
    cells: int
    """Cells with four known corners."""
    inverted_cells: int
    """Cells with a triangle whose flat area is not above zero."""
    boundary_space_um: Value
    """Length of all borders in space."""
    boundary_flat_um: Value
    """Length of all borders in the plane."""
    growth_percent: Value
    """Scale from the projection to the flat sheet, less 1."""
    growth_anisotropy_percent: Value
    """How much more the sheet grows in one direction than across it."""
    growth_direction_deg: Value
    """Direction in the projection in which it grows most, from x towards y."""
    displacement_median_um: Value
    """Median distance from the projection to the flat place, after turning and shifting."""
    displacement_p95_um: Value
    """95th percentile of that distance."""
    displacement_max_um: Value
    """Largest such distance."""
    geodesics: GeodesicError | None
    """Lengths of random lines, flat against along the surface."""


def measure_distortion(
    points: Floats, uv: Floats, strain: xr.Dataset, *, rng: np.random.Generator
) -> Distortion:
    """Sum up a flattening in a few numbers.

    Parameters
    ----------
    points : (rows, cols, 3); nodes in space, um; NaN where there is no sheet
    uv : (rows, cols, 2); the same nodes in the plane, um
    strain : Dataset; ``cell_strain(points, uv)``
    rng : Generator; draws the lines whose lengths are compared

    Returns
    -------
    Distortion

    Notes
    -----
    Noise makes the surface rough and its lengths longer: white noise s on nodes of pitch p lets the
    sheet grow by some 2/3 (s / p)^2. Growth that the warp does not explain, anisotropy above all,
    points to noise or jitter of slices.
    """
    area = strain["signed_area"].values
    scale, scale_ratio, direction, displacements = _against_projection(points, uv)
    median, p95, largest = percentiles(displacements, 50, 95, 100)
    in_space, in_plane = boundary_lengths(points, uv)
    spreads = {name: _spread(strain[name].values) for name in ("axial_u", "axial_v", "shear")}
    return Distortion(
        area=_spread(strain["area_ratio"].values - 1),
        **spreads,
        cells=int(np.count_nonzero(np.isfinite(area))),
        inverted_cells=int(np.count_nonzero(area <= 0)),
        boundary_space_um=in_space,
        boundary_flat_um=in_plane,
        growth_percent=100 * (scale - 1),
        growth_anisotropy_percent=100 * (scale_ratio - 1),
        growth_direction_deg=direction,
        displacement_median_um=median,
        displacement_p95_um=p95,
        displacement_max_um=largest,
        geodesics=geodesic_error(points, uv, rng=rng),
    )


def edge_strain(points: Floats, uv: Floats) -> tuple[Floats, Floats]:
    """Relative change of length of the edges along rows and along columns.

    Parameters
    ----------
    points : (rows, cols, 3)
    uv : (rows, cols, 2)

    Returns
    -------
    (rows, cols - 1), (rows - 1, cols)
        Flat length over length in space, minus one; NaN where an end is missing.
    """
    strains: list[Floats] = []
    for axis in (1, 0):
        edges = np.diff(uv, axis=axis), np.diff(points, axis=axis)
        flat, space = (np.linalg.norm(vectors, axis=-1) for vectors in edges)
        strains.append(flat / space - 1)
    return strains[0], strains[1]


def cell_strain(points: Floats, uv: Floats) -> xr.Dataset:
    """Strains of each cell between the sheet in space and the plane.

    Parameters
    ----------
    points : (rows, cols, 3)
    uv : (rows, cols, 2)

    Returns
    -------
    Dataset, dims (row, col) = (rows - 1, cols - 1)
        ``stretch_max``, ``stretch_min``: principal stretches; ``area_ratio``: their product;
        ``anisotropy``: their ratio; ``axial_u``, ``axial_v``: strain of the edges; ``shear``:
        change of the angle between them in rad, positive where the flat angle is the smaller one;
        ``signed_area``: flat area in um2 of the smaller of the two triangles of the first diagonal,
        not above zero where the cell is folded or turned over, which the others, being without
        sign, do not tell. Stretches, their product and ratio are 1 for an isometry, strains and
        shear 0. NaN where a corner is missing and, but for ``signed_area``, where the cell has no
        area in space.

    Notes
    -----
    A cell is represented by its two mean edges, which are the derivatives of its bilinear patch at
    the centre. That leaves out what bends within the cell: in a twisted or rough cell the edges are
    longer than their mean, by t^2 / (8 l^2) of their length l where the corners are t out of a
    parallelogram. Springs see that; these numbers do not. Axial strains and shear apart, because
    springs along the edges bear the former and diagonal ones the latter (Hirn et al. 2009, section
    2.3.1).
    """
    blocks = [_block_strain(points[nodes], uv[nodes]) for nodes in node_blocks(points)]
    strain = xr.Dataset()
    for name in blocks[0]:
        strain[name] = ("row", "col"), np.concatenate([block[name] for block in blocks])
    return strain


def node_blocks(points: Floats) -> Iterator[slice]:
    """Cut the rows of a mesh into slices that share a row."""
    rows, cols = points.shape[0] - 1, points.shape[1]
    step = max(1, _BLOCK // cols)
    return (slice(k, min(k + step, rows) + 1) for k in range(0, rows, step))


def boundary_lengths(points: Floats, uv: Floats) -> tuple[float, float]:
    """Give the length in um, in space and in the plane, of the edges of exactly one whole cell."""
    is_cell = np.pad(whole_cells(points, uv), 1)
    row_edges = is_cell[1:, 1:-1] != is_cell[:-1, 1:-1]  # (rows, cols - 1): edges along rows
    col_edges = is_cell[1:-1, 1:] != is_cell[1:-1, :-1]  # (rows - 1, cols)
    lengths: list[float] = []
    for nodes in (points, uv):
        edges = np.diff(nodes, axis=1)[row_edges], np.diff(nodes, axis=0)[col_edges]
        lengths.append(float(sum(np.linalg.norm(e, axis=1).sum() for e in edges)))
    return lengths[0], lengths[1]


def _block_strain(points: Floats, uv: Floats) -> dict[str, Floats]:
    """Strain maps (rows - 1, cols - 1) of some rows of nodes, as of :func:`cell_strain`."""
    across, down = _cell_edges(points)
    (au, av), (du, dv) = (np.moveaxis(e, -1, 0) for e in _cell_edges(uv))
    g11 = np.einsum("ijk,ijk->ij", across, across)
    g12 = np.einsum("ijk,ijk->ij", across, down)
    g22 = np.einsum("ijk,ijk->ij", down, down)
    with np.errstate(divide="ignore", invalid="ignore"):
        side = np.sqrt(g11)
        height = np.sqrt(np.maximum(g22 - g12 * g12 / g11, 0.0))  # of the cell over its edge across
        height[height <= 1e-12 * side] = np.nan
        # The Jacobian in an orthonormal frame of the cell whose first axis is the edge across; its
        # singular values from the parts that turn and scale alike and those that do not.
        j11, j21 = au / side, av / side
        j12, j22 = (du - au * g12 / g11) / height, (dv - av * g12 / g11) / height
        conformal = np.hypot(j11 + j22, j21 - j12) / 2
        anticonformal = np.hypot(j11 - j22, j21 + j12) / 2
        high = conformal + anticonformal
        low = np.abs(conformal - anticonformal)
        area = au * dv - av * du
        angle = np.arctan2(side * height, g12)
        flat_angle = np.arctan2(np.abs(area), au * du + av * dv)
        smaller_area = 0.5 * np.minimum(*triangle_areas(uv))
        return {
            "stretch_max": high,
            "stretch_min": low,
            "area_ratio": high * low,
            "axial_u": np.hypot(au, av) / side - 1,
            "axial_v": np.hypot(du, dv) / np.sqrt(g22) - 1,
            "shear": angle - flat_angle,
            "signed_area": np.where(np.isfinite(g11), smaller_area, np.nan),
            "anisotropy": high / low,
        }


def _cell_edges(nodes: Floats) -> tuple[Floats, Floats]:
    across = np.diff(nodes, axis=1)
    down = np.diff(nodes, axis=0)
    mean_across = 0.5 * (across[:-1] + across[1:])
    return mean_across, 0.5 * (down[:, :-1] + down[:, 1:])


def _spread(values: Floats) -> Spread:
    median, p5, p95 = percentiles(values, 50, 5, 95)
    p95_abs, max_abs = percentiles(np.abs(values), 95, 100)
    return Spread(median=median, p5=p5, p95=p95, p95_abs=p95_abs, max_abs=max_abs)


def _against_projection(points: Floats, uv: Floats) -> tuple[float, float, float, Floats]:
    """Fit a similarity and an affine map from (x, y) to (u, v).

    Gives the scale of the similarity, and the ratio and first direction of the affine map's
    singular values.
    """
    # And the distances (n,) in um that are left after the rotation and shift that make them
    # smallest.
    is_node = are_known(points) & are_known(uv)
    a, b = points[..., :2][is_node], uv[is_node]
    if len(a) < 3:
        return np.nan, np.nan, np.nan, np.zeros(len(a))
    a = a - a.mean(axis=0)
    b = b - b.mean(axis=0)
    scatter, cross = a.T @ a, b.T @ a
    along, across = cross[0, 0] + cross[1, 1], cross[1, 0] - cross[0, 1]
    scale = float(np.hypot(along, across) / np.trace(scatter))
    cross_sum = np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    rotation = np.arctan2(cross_sum, np.sum(a * b))
    cos = np.cos(rotation)
    sin = np.sin(rotation)
    turned = a @ np.array([[cos, sin], [-sin, cos]])
    residuals = np.linalg.norm(b - turned, axis=1)
    if np.linalg.cond(scatter) > 1e12:  # a sheet on edge: its projection is a line
        return scale, np.nan, np.nan, residuals
    _, size, axes = np.linalg.svd(cross @ np.linalg.inv(scatter))
    direction = np.degrees(np.arctan2(axes[0, 1], axes[0, 0])) % 180
    return scale, float(size[0] / size[1]), float(direction), residuals
