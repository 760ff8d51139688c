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
    """Rows and columns (n, 3) of the corners of triangles, each given by its cell and half."""
    down, across = np.moveaxis(_CORNERS[half], -1, 0)
    return row[:, None] + down, col[:, None] + across


def cross(p: Floats, q: Floats) -> Floats:
    """Cross product of vectors (..., 2): the signed area that they span."""
    return p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]


def edge_lengths(nodes: Floats, axis: int) -> Floats:
    """Distance of neighbours in a grid of ``nodes`` (rows, cols, k), along axis 0 or 1."""
    return np.linalg.norm(np.diff(nodes, axis=axis), axis=-1)


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
        flat_um, space_um = trace_lines(points, uv, start, end)
        is_traced = space_um > 0
        error = np.abs(flat_um[is_traced] / space_um[is_traced] - 1)
    p50, p95, largest = percentiles(error, 50, 95, 100)
    n_dropped = _LINES - error.size
    return GeodesicError(p50=p50, p95=p95, largest=largest, used=error.size, dropped=n_dropped)


def whole_cells(points: Floats, uv: Floats) -> Bools:
    """Cells (rows - 1, cols - 1) whose four corners are known both in space and in the plane."""
    return np.logical_and.reduce(corners_of(are_known(points) & are_known(uv)))


def triangle_areas(grid: Floats) -> tuple[Floats, Floats]:
    """Twice the signed areas of the triangles (a, b, c) and (a, c, d) of each cell.

    NaN where a corner is missing.
    """
    a, b, c, d = corners_of(grid)
    diagonal = c - a
    return cross(b - a, diagonal), cross(diagonal, d - a)


def folded_cells(points: Floats, uv: Floats, *, side: float = 1.0, floor: float = 0.0) -> Bools:
    """Find the cells of ``uv`` (rows, cols, 2) with a triangle that is empty or turned over.

    The triangles of a cell are (a, b, c) and (a, c, d). ``points`` (rows, cols, 3) are the nodes in
    space; cells with a missing corner are none.

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
    # With a ring of no cells, so that a line may step over the outline.
    is_cell = np.pad(whole_cells(points, uv), 1)
    origin = start.on(uv)
    goals = end.on(points)
    vector = end.on(uv) - origin
    flat_um = np.hypot(*vector.T)
    space_um = np.full(flat_um.size, np.nan)
    end_triangle = np.stack([end.row, end.col, end.half], axis=1)
    areas = np.stack(triangle_areas(uv))
    is_turned = areas[start.half, start.row, start.col] < 0

    # Lines that have not arrived: number, triangle; and last place on the surface, length so far.
    line = np.arange(flat_um.size)
    triangles: Ints = np.stack([line, start.row, start.col, start.half], axis=1)
    positions: Floats = np.column_stack([start.on(points), np.zeros_like(flat_um)])
    # No line crosses so many triangles unless it winds through folded cells.
    for _ in range(20 * sum(points.shape[:2])):
        is_in_end = triangles[:, 1:] == end_triangle[triangles[:, 0]]
        has_arrived = is_in_end.all(axis=1)
        arrived = triangles[has_arrived, 0]
        places, lengths_um = np.split(positions[has_arrived], [3], axis=1)
        rest_um = np.linalg.norm(goals[arrived] - places, axis=1)
        space_um[arrived] = lengths_um[:, 0] + rest_um
        triangles, positions = triangles[~has_arrived], positions[~has_arrived]
        if triangles.size == 0:
            break
        line = triangles[:, 0]
        start_turned = (origin[line], vector[line], is_turned[line])
        exits, triangles, has_exit = _leave_triangles(points, uv, triangles, *start_turned)
        way_um = np.linalg.norm(exits - positions[:, :3], axis=1)
        positions = np.column_stack([exits, positions[:, 3] + way_um])
        row, col = triangles[:, 1:3].T + 1
        is_on_sheet = has_exit & is_cell[row, col]
        triangles, positions = triangles[is_on_sheet], positions[is_on_sheet]
    return flat_um, space_um


def _leave_triangles(
    points: Floats, uv: Floats, triangles: Ints, origin: Floats, vector: Floats, is_turned: Bools
) -> tuple[Floats, Ints, Bools]:
    """Give the points (n, 3) at which lines leave their triangles, and the triangles behind.

    Gives also which lines cross an edge. ``triangles`` (n, 4): number of the line, row and column
    of the cell, and its half; ``origin`` and ``vector`` (n, 2) of the lines in the plane. Those
    that are turned began in a triangle that is turned over.
    """
    line, row, col, half = triangles.T
    corner = _corners(row, col, half)
    # Of each corner (n, 3): above 0 on one side of the line, below on the other.
    side = cross(vector[:, None], uv[corner] - origin[:, None])
    is_right = (side > 0) == is_turned[:, None]
    is_exit_edge = is_right & ~is_right[:, [1, 2, 0]]
    edge = np.argmax(is_exit_edge, axis=1)
    index = np.arange(line.size)
    begin_corner = (index, edge)
    end_corner = (index, (edge + 1) % 3)
    # Not so where a line starts so close to an edge that rounding put it outside.
    has_exit = is_exit_edge.any(axis=1)
    way = np.where(has_exit, side[begin_corner] - side[end_corner], 1.0)
    exit_share = side[begin_corner] / way
    corner_points = points[corner]
    a, b = corner_points[begin_corner], corner_points[end_corner]
    exits = a + exit_share[:, None] * (b - a)
    down, across, half = _BEHIND[half, edge].T
    behind = np.stack([line, row + down, col + across, half], axis=1)
    return exits, behind, has_exit


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
    signed_area = strain["signed_area"].values
    scale, scale_ratio, direction, displacements = _against_projection(points, uv)
    median, p95, largest = percentiles(displacements, 50, 95, 100)
    boundary_space_um, boundary_flat_um = boundary_lengths(points, uv)
    return Distortion(
        area=_spread(strain["area_ratio"] - 1),
        axial_u=_spread(strain["axial_u"]),
        axial_v=_spread(strain["axial_v"]),
        shear=_spread(strain["shear"]),
        cells=np.isfinite(signed_area).sum(),
        inverted_cells=(signed_area <= 0).sum(),
        boundary_space_um=boundary_space_um,
        boundary_flat_um=boundary_flat_um,
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
    along_rows = edge_lengths(uv, 1) / edge_lengths(points, 1) - 1
    along_cols = edge_lengths(uv, 0) / edge_lengths(points, 0) - 1
    return along_rows, along_cols


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
    return xr.concat(blocks, "row")


def node_blocks(points: Floats) -> Iterator[slice]:
    """Cut the rows of a mesh into slices that share a row."""
    rows, cols = points.shape[0] - 1, points.shape[1]
    step = max(1, _BLOCK // cols)
    for first in range(0, rows, step):
        yield slice(first, min(first + step, rows) + 1)


def boundary_lengths(points: Floats, uv: Floats) -> tuple[float, float]:
    """Give the length in um, in space and in the plane, of the edges of exactly one whole cell."""
    is_cell = np.pad(whole_cells(points, uv), 1)
    row_edges = np.diff(is_cell[:, 1:-1], axis=0)  # (rows, cols - 1): edges along rows
    col_edges = np.diff(is_cell[1:-1], axis=1)  # (rows - 1, cols)
    lengths: list[float] = []
    for nodes in (points, uv):
        along_rows = edge_lengths(nodes, 1)[row_edges]
        along_cols = edge_lengths(nodes, 0)[col_edges]
        lengths.append(float(along_rows.sum() + along_cols.sum()))
    return lengths[0], lengths[1]


def _block_strain(points: Floats, uv: Floats) -> xr.Dataset:
    """Strain maps (rows - 1, cols - 1) of some rows of nodes, as of :func:`cell_strain`.

    ``points`` (rows, cols, 3) and ``uv`` (rows, cols, 2). A cell in space is its two mean edges,
    given by their products g11, g12, g22; in the plane they are (au, av) and (du, dv).
    """
    across, down = _cell_edges(points)
    flat_across, flat_down = _cell_edges(uv)
    au, av = np.moveaxis(flat_across, -1, 0)
    du, dv = np.moveaxis(flat_down, -1, 0)
    # Metric of the cell in space.
    g11 = np.einsum("ijk,ijk->ij", across, across)
    g12 = np.einsum("ijk,ijk->ij", across, down)
    g22 = np.einsum("ijk,ijk->ij", down, down)
    with np.errstate(divide="ignore", invalid="ignore"):
        side = np.sqrt(g11)
        height = np.sqrt(np.maximum(g22 - g12 * g12 / g11, 0.0))  # of the cell over its edge across
        height[height <= 1e-12 * side] = np.nan
        # The Jacobian in an orthonormal frame of the cell whose first axis is the edge across; its
        # singular values from the parts that turn and scale alike and those that do not.
        j11 = au / side
        j21 = av / side
        j12 = (du - au * g12 / g11) / height
        j22 = (dv - av * g12 / g11) / height
        conformal = np.hypot(j11 + j22, j21 - j12) / 2
        anticonformal = np.hypot(j11 - j22, j21 + j12) / 2
        high = conformal + anticonformal
        low = np.abs(conformal - anticonformal)
        area = au * dv - av * du
        angle = np.arctan2(side * height, g12)
        flat_angle = np.arctan2(np.abs(area), au * du + av * dv)
        smaller_area = 0.5 * np.minimum(*triangle_areas(uv))
        maps = {
            "stretch_max": high,
            "stretch_min": low,
            "area_ratio": high * low,
            "axial_u": np.hypot(au, av) / side - 1,
            "axial_v": np.hypot(du, dv) / np.sqrt(g22) - 1,
            "shear": angle - flat_angle,
            "signed_area": np.where(np.isfinite(g11), smaller_area, np.nan),
            "anisotropy": high / low,
        }
    return xr.Dataset({name: (("row", "col"), m) for name, m in maps.items()})


def _cell_edges(nodes: Floats) -> tuple[Floats, Floats]:
    """Mean edges (rows - 1, cols - 1, k) of each cell: along a row, and down a column."""
    across = np.diff(nodes, axis=1)
    down = np.diff(nodes, axis=0)
    mean_across = 0.5 * (across[:-1] + across[1:])
    mean_down = 0.5 * (down[:, :-1] + down[:, 1:])
    return mean_across, mean_down


def _spread(strain: xr.DataArray) -> Spread:
    median, p5, p95 = percentiles(strain.values, 50, 5, 95)
    p95_abs, max_abs = percentiles(np.abs(strain.values), 95, 100)
    return Spread(median=median, p5=p5, p95=p95, p95_abs=p95_abs, max_abs=max_abs)


def _against_projection(points: Floats, uv: Floats) -> tuple[float, float, float, Floats]:
    """Fit a similarity and an affine map from (x, y) to (u, v).

    Gives the scale of the similarity; the ratio of the affine map's singular values and the
    direction of the first one, in degrees from x towards y; and the distances (n,) in um that are
    left after the rotation and shift that make them smallest. NaN where fewer than 3 nodes, or a
    sheet on edge, do not tell.
    """
    is_node = are_known(points) & are_known(uv)
    xy, flat = points[..., :2][is_node], uv[is_node]
    if len(xy) < 3:
        return np.nan, np.nan, np.nan, np.zeros(len(xy))
    a = xy - xy.mean(axis=0)
    b = flat - flat.mean(axis=0)
    scatter = a.T @ a
    products = b.T @ a
    dot_sum = np.sum(a * b)
    cross_sum = np.sum(cross(a, b))
    scale = float(np.hypot(dot_sum, cross_sum) / np.trace(scatter))
    rotation = np.arctan2(cross_sum, dot_sum)
    cos = np.cos(rotation)
    sin = np.sin(rotation)
    turned = a @ np.array([[cos, sin], [-sin, cos]])
    residuals = np.linalg.norm(b - turned, axis=1)
    if np.linalg.cond(scatter) > 1e12:  # a sheet on edge: its projection is a line
        return scale, np.nan, np.nan, residuals
    affine = products @ np.linalg.inv(scatter)
    _, sizes, axes = np.linalg.svd(affine)
    first_x, first_y = axes[0]
    direction = np.degrees(np.arctan2(first_y, first_x)) % 180
    return scale, float(sizes[0] / sizes[1]), float(direction), residuals
