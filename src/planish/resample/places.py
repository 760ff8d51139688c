"""The places of the pixels of a regular grid in a flattened quad mesh, and values brought to them.

Hirn et al. (2009), section 2.3.4, triangulate the moved points anew (Delaunay). Here the
connectivity of the mesh is used: no triangle can bridge a gap, and overlaps are noticed. The
paper's mode can be had for comparison.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.axial import axial_angle, summable
from planish.core.errors import SurfaceError
from planish.core.facts import DescribedModel
from planish.core.grid import Grid
from planish.core.threads import count_threads, map_threads
from planish.core.transform import are_known, grid_points
from planish.core.typing import Array, Bools, Floats, Pair, Shape2D, Window, pair_of
from planish.resample._kernels import find_bends, locate, sample

Indices = NDArray[np.int32]
Method = Literal["quads", "delaunay"]
Between = Literal["cubic", "linear"]
Result = TypeVar("Result")
# Quads whose extent is known together, passed over where they touch no band of pixels.
_SEGMENT = 32
# How far the errors of neighbouring columns go together: a mean over a pixel holds it.
_OF_NODES = ("common_um", "patch_um2")
_STRAIGHT = np.empty((2, 0, 0))  # bend of places between whose nodes values are linear
_LEAST_ROWS = 32  # of a band: below that, starting a thread takes longer than the work


class Places(DescribedModel):
    """The place of each pixel of a regular grid in the mesh; good for any number of fields."""

    triangle: Indices
    """(rows * fine, cols * fine) int32: number of the triangle a sub-pixel lies in; -1 outside.
    Triangle 2 n + t is the first (t = 0) or second half of the quad whose first corner is node n,
    unless `corners` numbers them.
    """
    weight: Floats
    """(2, rows * fine, cols * fine): weights of the triangle's second and third corner, the first
    one has the rest of 1; anything outside.
    """
    bend: Floats
    """(2, rows * fine, cols * fine): how far cubic convolution of the flat coordinates leads past a
    sub-pixel, as weights of the triangle's second and third corner; NaN where one of the four by
    four nodes around is missing. Without rows for Delaunay's triangles.
    """
    corners: Indices
    """(triangles, 3) int32: nodes of each triangle, for Delaunay's; without rows for the quads."""
    mesh: Shape2D
    """Rows and columns of the mesh."""
    fine: int
    """Sub-pixels per pixel and axis; values are means over them."""
    overlaps: int
    """Sub-pixels covered by more than one quad: 0 unless the mesh is folded, and always 0 for
    Delaunay.
    """

    @property
    def shape(self) -> Shape2D:
        """Rows and columns of the grid."""
        fine_rows, fine_cols = self.triangle.shape
        return fine_rows // self.fine, fine_cols // self.fine


def find_places(
    uv: Floats, grid: Grid, *, least_um: float | None = None, method: Method = "quads"
) -> Places:
    """Locate the pixels of a regular grid in a mesh with flat coordinates ``uv``.

    Parameters
    ----------
    uv : (rows, cols, 2)
        Flat coordinates of the nodes in um; NaN where there is no sheet.
    grid : Grid
    least_um : float, optional
        Pitch of the mesh. A pixel wider than that is cut into sub-pixels, so that it takes the mean
        over its area and not the value at its centre.
    method : {"quads", "delaunay"}
        Through the two triangles of each known quad; or through a new triangulation of the known
        nodes (scipy, some hundred times slower), which bridges gaps and does not notice folds.

    Returns
    -------
    Places

    Raises
    ------
    SurfaceError
        The grid is empty or too large, the mesh is not (rows, cols, 2), has over 2^30 nodes or no
        triangle.

    Notes
    -----
    Where quads overlap, the first in the order of the mesh stays. A quad without one of its corners
    covers nothing.
    """
    rows, cols = grid.shape
    if min(rows, cols) < 1 or rows * cols > 2**31:
        raise SurfaceError(
            f"A grid of {rows} x {cols} pixels cannot be made. Check the pixel size."
        )
    # Two triangles per node are numbered in 32 bits.
    if uv.shape[2:] != (2,) or uv.size > 2 * 2**30:
        raise SurfaceError(
            f"The flat coordinates have the shape {uv.shape}; (rows, cols, 2) is needed, with 2^30"
            " nodes at most."
        )
    row_um, col_um = grid.pixel_um
    u, v = grid.origin_um
    fine = 1
    if least_um:
        wanted = math.ceil(max(row_um, col_um) / least_um - 1e-6)
        fine = min(max(1, wanted), 32)
    step = du, dv = col_um / fine, row_um / fine
    # The first sub-pixel's centre lies half a pixel less half a sub-pixel before the pixel's.
    first = (u - 0.5 * (col_um - du), v - 0.5 * (row_um - dv))
    size = (rows * fine, cols * fine)
    mesh = (uv.shape[0], uv.shape[1])
    uv = np.ascontiguousarray(uv, dtype=np.float64)
    corners = np.empty((0, 3), dtype=np.int32)
    overlaps = 0
    triangle = np.empty(size, np.int32)
    weight = np.empty((2, *size))
    bend = _STRAIGHT
    if method == "delaunay":
        corners = _locate_in_delaunay(uv, first, step, triangle, weight)
    else:
        low, high = _extents(uv[..., 1], first[1], dv)
        extents = (_SEGMENT, low, high)
        is_double = np.zeros(size, np.uint8)

        def band(begin: int, end: int) -> int:
            return locate(uv, first, step, *extents, triangle, weight, is_double, begin, end)

        overlaps = sum(each_band(band, size[0]))
        bend = np.empty((2, *size))
        u_nodes, v_nodes = (np.ascontiguousarray(uv[..., k]) for k in range(2))

        def bend_band(begin: int, end: int) -> None:
            find_bends(u_nodes, v_nodes, triangle, weight, bend, begin, end)

        each_band(bend_band, size[0])
    return Places(
        triangle=triangle,
        weight=weight,
        bend=bend,
        corners=corners,
        mesh=mesh,
        fine=fine,
        overlaps=overlaps,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mesh:
    """A quad mesh in which parts of a grid are located one by one.

    Its flat coordinates are ``uv`` (rows, cols, 2).
    """

    uv: Floats
    least_um: float
    # First and last u, then v, that the quads of each segment of each row reach: (2, rows - 1,
    # segments).
    _low: Floats
    _high: Floats

    @classmethod
    def of(cls, uv: Floats, *, least_um: float) -> Mesh:
        """``least_um`` is the pitch of the mesh, as for :func:`find_places`."""
        low_u, high_u = _extents(uv[..., 0], 0.0, 1.0)
        low_v, high_v = _extents(uv[..., 1], 0.0, 1.0)
        low = np.stack([low_u, low_v])
        high = np.stack([high_u, high_v])
        # Of the quads between two rows of nodes.
        quads_low = np.minimum(low[:, :-1], low[:, 1:])
        quads_high = np.maximum(high[:, :-1], high[:, 1:])
        return cls(uv=uv, least_um=least_um, _low=quads_low, _high=quads_high)

    def under(self, grid: Grid) -> tuple[Window, Places]:
        """Return the nodes under the pixels of a grid, and where each pixel lies among them.

        The nodes are a window of rows and columns of the mesh, whole segments wide; a single node
        where the mesh does not meet the grid.
        """
        row_um, col_um = grid.pixel_um
        # First and last (u, v) of the grid's pixels, and one more.
        first = np.array([grid.x_um[0] - col_um, grid.y_um[0] - row_um])
        last = np.array([grid.x_um[-1] + col_um, grid.y_um[-1] + row_um])
        begins_before = self._low <= last[:, None, None]
        ends_after = self._high >= first[:, None, None]
        touched = np.all(begins_before & ends_after, axis=0)
        nodes = np.s_[:1, :1]  # a single node covers nothing
        if touched.any():
            rows = np.flatnonzero(touched.any(axis=1)).tolist()
            segments = np.flatnonzero(touched.any(axis=0)).tolist()
            # Values between nodes need one more on either side.
            first_row = max(rows[0] - 1, 0)
            first_col = max(segments[0] * _SEGMENT - 1, 0)
            after_last = (segments[-1] + 1) * _SEGMENT + 2
            nodes = np.s_[first_row : rows[-1] + 3, first_col:after_last]
        return nodes, find_places(self.uv[nodes], grid, least_um=self.least_um)


def covering_grid(uv: Floats, pixel_um: float) -> Grid:
    """Return the grid that covers a mesh.

    Parameters
    ----------
    uv : (rows, cols, 2), in um; flat coordinates of the nodes, NaN where there is no sheet
    pixel_um : float

    Returns
    -------
    Grid; its origin (u, v) is a multiple of the pixel

    Raises
    ------
    SurfaceError
        No node is known.
    """
    points = uv[are_known(uv)]
    if not points.size:
        raise SurfaceError(
            "No node of the mesh has flat coordinates. Check the surface and how it was flattened."
        )
    low = np.floor(points.min(axis=0) / pixel_um)
    high = np.ceil(points.max(axis=0) / pixel_um)
    cols, rows = ((high - low).astype(int) + 1).tolist()
    return Grid.regular((rows, cols), pixel_um, pair_of(low * pixel_um))


def each_band(work: Callable[[int, int], Result], rows: int) -> list[Result]:
    """Call ``work(begin, end)`` for bands of ``rows`` rows on several threads.

    What the calls give is returned in order.
    """
    threads = count_threads()
    # Four a thread, so that one with an easy band takes over from one with a hard band.
    count = max(1, min(4 * threads, rows // _LEAST_ROWS))
    edges = [rows * k // count for k in range(count + 1)]
    return map_threads(work, edges[:-1], edges[1:], number=min(threads, count))


def _extents(v: Floats, first: float, step: float) -> tuple[Floats, Floats]:
    """Extent of each row's segments of nodes, both ends included, in rows of the target.

    Without the missing ones. ``v`` (rows, cols) is a flat coordinate of the nodes; the first row
    of the target lies at ``first``, ``step`` apart from the next. Gives the lowest and the highest,
    (rows, segments).
    """
    rows, cols = v.shape
    starts = np.arange(0, cols - 1, _SEGMENT)
    if not rows or not starts.size:
        return np.empty((rows, 0)), np.empty((rows, 0))
    bounds: list[Floats] = []
    for ufunc, neutral in ((np.fmin, np.inf), (np.fmax, -np.inf)):
        bound = ufunc.reduceat(v, starts, axis=1)
        # The first node of the next segment is the last of this one, too.
        bound[:, :-1] = ufunc(bound[:, :-1], v[:, starts[1:]])
        bound[np.isnan(bound)] = neutral
        bounds.append((bound - first) * (1.0 / step))  # the same sums as in `locate`
    return bounds[0], bounds[1]


def _locate_in_delaunay(
    uv: Floats, first_um: Pair, step_um: Pair, triangle: Indices, weight: Floats
) -> Indices:
    """Locate pixels in triangles made anew as in the paper.

    These triangles bridge gaps and bays, and notice no fold. Sets ``triangle`` (rows, cols) and
    ``weight`` (2, rows, cols), and gives the nodes (triangles, 3) of each triangle. ``first_um``
    and ``step_um`` are (u, v) of the first pixel, and from one to the next.
    """
    from scipy.spatial import Delaunay, QhullError

    nodes = uv.reshape(-1, 2)
    finite_nodes = np.flatnonzero(np.isfinite(nodes).all(axis=1))
    try:
        triangulation = Delaunay(nodes[finite_nodes])
    except (QhullError, ValueError) as error:
        raise SurfaceError(
            f"The {finite_nodes.size} known nodes cannot be triangulated; at least 3 are needed"
            " that do not lie in one line. Check the flat coordinates."
        ) from error
    rows, cols = triangle.shape
    u = first_um[0] + step_um[0] * np.arange(cols)
    v = first_um[1] + step_um[1] * np.arange(rows)
    for begin in range(0, v.size, _LEAST_ROWS):
        band = slice(begin, begin + _LEAST_ROWS)
        points = grid_points(u, v[band])
        triangle[band] = triangulation.find_simplex(points)
        # Weights of the first two corners; without a triangle they are not used.
        barycentric = triangulation.transform[triangle[band]]
        offsets = points - barycentric[..., 2, :]
        corner_weights = np.einsum("yxij,yxj->yxi", barycentric[..., :2, :], offsets)
        weight[0, band] = corner_weights[..., 1]
        weight[1, band] = 1.0 - corner_weights.sum(axis=-1)
    return np.ascontiguousarray(finite_nodes[triangulation.simplices], dtype=np.int32)


def resample(field: Array, places: Places, *, between: Between = "cubic") -> Floats:
    """Give the values of a mesh field on the grid.

    Between the nodes the field is that of cubic convolution (Keys 1981); linear in the triangle
    where one of the four by four nodes around is missing. A pixel gets the mean over its
    sub-pixels.

    Parameters
    ----------
    field : (rows, cols)
        Value of each node, or what ``summable`` makes of an axis; NaN is missing.
    places : Places
        From :func:`find_places`, of a mesh of (rows, cols).
    between : {"cubic", "linear"}
        ``"linear"`` is three times as fast and enough for what varies little from node to node.

    Returns
    -------
    (rows, cols) of the grid, float64
        A sub-pixel is known where the corners of its triangle are; a pixel is NaN unless half of
        its area is known.

    Raises
    ------
    SurfaceError
        The field does not have the mesh's shape.
    """
    if np.iscomplexobj(field):
        cosines = resample(np.real(field), places, between=between)
        return axial_angle(cosines, resample(np.imag(field), places, between=between))
    bend = places.bend if between == "cubic" else _STRAIGHT
    return _sampled(field, places, bend, np.empty((0, 0)))


def support(known: Bools, places: Places) -> Floats:
    """Share of each pixel's area that is known on the mesh, from 0 to 1.

    ``support(np.isfinite(field), places) >= 0.5`` is where :func:`resample` of the same field has a
    value.

    Parameters
    ----------
    known : (rows, cols)
        Nodes with a value.
    places : Places
        As for :func:`resample`.
    """
    share = np.empty(places.shape)
    _sampled(np.where(known, 0.0, np.nan), places, _STRAIGHT, share)
    return share


def resample_dataset(
    data: xr.Dataset, places: Places, *, dims: tuple[str, str], coords: Mapping[str, Array]
) -> xr.Dataset:
    """Resample every floating variable of ``data`` (rows, cols).

    Properties, and where there is a sheet, by cubic convolution; errors, coordinates and the like
    linearly. Each keeps its attributes, but those that hold for single nodes of the mesh only.

    Parameters
    ----------
    data : Dataset
        Variables on the nodes of the mesh.
    places : Places
        From :func:`find_places`.
    dims : (str, str)
        Names of the grid's rows and columns.
    coords : mapping of str to array
        Positions of the grid's rows and columns in um.
    """
    variables: dict[str, xr.Variable] = {}
    for name, variable in data.data_vars.items():
        attrs = {k: v for k, v in variable.attrs.items() if k not in _OF_NODES}
        if np.issubdtype(variable.dtype, np.floating):
            is_property = variable.attrs.get("role") == "property"
            is_fine = is_property or str(name).startswith("presence")
            between: Between = "cubic" if is_fine else "linear"
            resampled = resample(summable(variable, variable.values), places, between=between)
            variables[str(name)] = xr.Variable(dims, resampled, attrs)
    for axis, places_um in coords.items():
        variables[axis] = xr.Variable(axis, places_um, {"units": "um"})
    return xr.Dataset(variables)


def _sampled(field: Array, places: Places, bend: Floats, share: Floats) -> Floats:
    """Values; ``share`` is set to the share of each pixel that is known where it is not empty.

    ``bend`` is that of the places, or without rows for linear values.
    """
    if field.shape != places.mesh:
        raise SurfaceError(
            f"The field has the shape {field.shape}, the mesh {places.mesh}. Give a field on the"
            " nodes of that mesh."
        )
    nodes = np.ascontiguousarray(field, dtype=np.float64)
    p = places
    out = np.empty(p.shape)

    def band(begin: int, end: int) -> None:
        sample(nodes, p.triangle, p.weight, bend, p.corners, p.fine, out, share, begin, end)

    each_band(band, out.shape[0])
    return out
