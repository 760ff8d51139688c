"""Mask-weighted means over areas, and smaller copies of maps for pages.

Also what a larger pixel sees of smaller ones.
"""

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import xarray as xr
from scipy import sparse

from planish.core.axial import angle_of, axial_angle, summable, summable_of
from planish.core.bands import Rows, read_bands
from planish.core.typing import Array, Bools, Floats, Pair, Shape, Shape2D


class AreaMeans:
    """Means of maps on one grid over cells of ``factor`` pixels.

    Some rows of the maps are added at a time.

    ``shape`` is that of the maps; ``factor`` height and width of a cell in pixels, which need not
    be whole. Every pixel counts with the share of its area that lies in the cell. Cells start at
    the border of the first pixel; an incomplete last one is dropped. A cell is NaN unless at least
    ``least_share`` of its area is known.
    """

    def __init__(self, shape: Shape2D, factor: Pair, *, least_share: float = 0.5) -> None:
        self._row_overlap = _overlap(shape[0], factor[0])
        self._col_overlap = _overlap(shape[1], factor[1])
        self._is_identity = factor == (1, 1)  # a cell is a pixel
        self._least_weight = least_share * factor[0] * factor[1] - 1e-9  # for what is rounded
        self._weight = np.zeros((self._row_overlap.shape[0], self._col_overlap.shape[0]))
        self._totals: list[Floats] = []

    def add(self, first_row: int, is_known: Bools, *maps: Array) -> None:
        """Add the rows from ``first_row`` on of maps, which count where ``is_known``.

        ``is_known`` and the maps are (some rows, cols); complex maps have complex means.
        """
        if not self._totals:
            dtypes = [np.result_type(np.float64, values) for values in maps]
            self._totals = [np.zeros(self._weight.shape, dtype) for dtype in dtypes]
        row_overlap = self._row_overlap[:, first_row : first_row + is_known.shape[0]]
        # Rows of cells that overlap these rows of pixels.
        touched_cells = np.flatnonzero(np.diff(row_overlap.indptr))
        if not touched_cells.size:
            return
        cells = slice(touched_cells[0], touched_cells[-1] + 1)
        cell_overlap = row_overlap[cells]
        self._weight[cells] += self._summed(cell_overlap, is_known.astype(np.float64))
        for total, values in zip(self._totals, maps, strict=True):
            total[cells] += self._summed(cell_overlap, np.where(is_known, values, 0.0))

    def means(self) -> list[Floats]:
        """The means of each map; angles where what ``summable`` makes of an axis was added."""
        is_covered = self._weight >= self._least_weight
        weight = np.maximum(self._weight, 1e-12)
        means = [np.where(is_covered, total / weight, np.nan) for total in self._totals]
        return [angle_of(m) if np.iscomplexobj(m) else m for m in means]

    def _summed(self, row_overlap: sparse.csr_array, values: Floats) -> Floats:
        if self._is_identity:
            return values
        return (self._col_overlap @ (row_overlap @ values).T).T


def square_px(edge_um: float, pixel_um: Pair) -> Pair:
    """Height and width of a square in pixels."""
    return edge_um / pixel_um[0], edge_um / pixel_um[1]


def area_mean(values: Rows, factor: Pair, *, least_share: float = 0.5) -> Floats:
    """Mean of ``values`` (rows, cols), NaN where missing, over cells as of :class:`AreaMeans`.

    ``factor`` is height and width of a cell in pixels, at least 1 and not always whole numbers:
    there are (int(rows / factor), int(cols / factor)) cells.
    """
    if not values.shape[0]:
        return np.empty((0, int(values.shape[1] / factor[1] + 1e-9)))
    return common_means([values], factor, least_share=least_share)[0]


def common_means(
    maps: Sequence[Rows], factor: Pair, *, masks: Sequence[Rows] = (), least_share: float = 0.5
) -> list[Floats]:
    """Means of maps on one grid over the pixels that count in all of them.

    Pixels count that have a value in all maps and where all masks are true.
    """
    n_rows, n_cols = maps[0].shape
    area_means = AreaMeans((n_rows, n_cols), factor, least_share=least_share)
    for rows, bands in read_bands(*maps, *masks):
        map_bands = [summable(m, band) for m, band in zip(maps, bands, strict=False)]
        area_means.add(rows.start, valid_in_all(map_bands, bands[len(maps) :]), *map_bands)
    return area_means.means()


def valid_in_all(maps: Iterable[Array], masks: Sequence[Array] = ()) -> Bools:
    """Where all maps have a value and all masks are true."""
    are_known = [np.isfinite(values) for values in maps]
    return np.logical_and.reduce([*are_known, *(mask.astype(bool) for mask in masks)])


def _overlap(count: int, factor: float) -> sparse.csr_array:
    """Share of each of ``count`` pixels that lies in each cell: (cells, count).

    A cell is ``factor`` pixels long. The 1e-9 keep a cell that ends with a pixel from taking in the
    next one.
    """
    cells = int(count / factor + 1e-9)
    edges = np.arange(cells + 1) * factor  # in pixels
    first = np.floor(edges[:-1] + 1e-9).astype(np.intp)
    ends = np.minimum(np.ceil(edges[1:] - 1e-9), count).astype(np.intp)
    pixel_counts = ends - first
    # An entry for each pixel of each cell, cell by cell.
    rows = np.repeat(np.arange(cells), pixel_counts)
    cols = np.arange(rows.size) + (first - np.cumsum(pixel_counts) + pixel_counts)[rows]
    shares = np.minimum(cols + 1, edges[rows + 1]) - np.maximum(cols, edges[rows])
    return sparse.csr_array((shares, (rows, cols)), shape=(cells, count))


OVERVIEW_PX = 512  # pixels a side: what is no larger needs no overview


def overviews(maps: xr.Dataset, *, most_px: int = OVERVIEW_PX) -> Iterator[xr.Dataset]:
    """Halve maps (rows, cols) on a regular grid until no side has more than ``most_px`` pixels.

    Yield each copy.

    Means over the pixels that have a value, NaN where none of the four has one; of truth values,
    whether half of the four are true. Labels have no mean and are left out. Coordinates are the
    middles of the larger pixels.
    """
    for _ in range(overview_count(tuple(maps.sizes.values()), most_px=most_px)):
        maps = halved(maps)
        yield maps


def overview_count(shape: Shape, *, most_px: int = OVERVIEW_PX) -> int:
    """Count the overviews that maps of a shape need."""
    return max(math.ceil(math.log2(max(shape, default=1) / most_px)), 0)


def halved(maps: xr.Dataset) -> xr.Dataset:
    """Maps with pixels twice as wide.

    The last row and column of an odd number stand for themselves.
    """
    variables: dict[str, xr.Variable] = {}
    for name, data in maps.data_vars.items():
        if data.ndim == 2 and data.dtype.kind in "fb":
            half = halved_values(summable_of(maps, str(name)))
            variables[str(name)] = xr.Variable(data.dims, half, data.attrs)
    # In their order: a set has another one in each process.
    dims = dict.fromkeys(str(dim) for variable in variables.values() for dim in variable.dims)
    for dim in dims:
        variables[dim] = xr.Variable(dim, middles(maps[dim].values), maps[dim].attrs)
    return xr.Dataset(variables, attrs=maps.attrs)


def middles(centres: Floats) -> Floats:
    """Middles of the pixels that are twice as wide."""
    if centres.size < 2:
        return centres
    pixels = 0.5 + 2 * np.arange((centres.size + 1) // 2)
    return centres[0] + (centres[1] - centres[0]) * pixels


def halved_values(values: Array) -> Array:
    """Values (rows, cols) of pixels twice as wide, as :func:`overviews` has them.

    Floats, truth values, or what ``summable`` makes of an axis, whose angles are given then.
    """
    from planish.core._overview_kernels import halve_truth, halve_values

    if np.iscomplexobj(values):
        return axial_angle(halved_values(np.real(values)), halved_values(np.imag(values)))
    out = np.empty([(n + 1) // 2 for n in values.shape], values.dtype)
    halve = halve_truth if values.dtype == np.bool_ else halve_values
    halve(np.ascontiguousarray(values), out)
    return out
