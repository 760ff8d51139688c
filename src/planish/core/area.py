"""Mask-weighted means over areas: what a larger pixel sees of smaller ones."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from planish.core.bands import Rows, band_of, bands
from planish.core.typing import Floats


class AreaMeans:
    """Means of maps on one grid over cells of ``factor`` pixels, of which some rows are added at a time.

    Every pixel counts with the share of its area that lies in the cell. Cells start at the border of the first pixel;
    an incomplete last one is dropped. A cell is NaN unless at least ``least`` of its area is known.
    """

    def __init__(self, shape: tuple[int, int], factor: tuple[float, float], *, least: float = 0.5) -> None:
        self._down, self._across = (_overlap(n, f) for n, f in zip(shape, factor, strict=True))
        self._as_it_is = factor == (1, 1)  # a cell is a pixel
        self._enough = least * factor[0] * factor[1] - 1e-9
        self._weight = np.zeros((self._down.shape[0], self._across.shape[0]))
        self._totals: list[Floats] = []

    def add(self, begin: int, is_known: NDArray[np.bool_], *maps: NDArray[Any]) -> None:
        """Add the rows from ``begin`` on of maps, which count where ``is_known``."""
        self._totals = self._totals or [np.zeros(self._weight.shape) for _ in maps]
        down = self._down[:, begin : begin + is_known.shape[0]]
        touched = np.flatnonzero(np.diff(down.indptr))
        if not touched.size:
            return
        cells = slice(touched[0], touched[-1] + 1)
        self._weight[cells] += self._summed(down[cells], is_known.astype(np.float64))
        for total, values in zip(self._totals, maps, strict=True):
            total[cells] += self._summed(down[cells], np.where(is_known, values, 0.0))

    def means(self) -> list[Floats]:
        """The means of each map."""
        enough, weight = self._weight >= self._enough, np.maximum(self._weight, 1e-12)
        return [np.where(enough, total / weight, np.nan) for total in self._totals]

    def _summed(self, down: sparse.csr_array, values: Floats) -> Floats:
        return values if self._as_it_is else (self._across @ (down @ values).T).T


def area_mean(values: Rows, factor: tuple[float, float], *, least: float = 0.5) -> Floats:
    """Mean of ``values`` (rows, cols) over cells of ``factor`` pixels, which need not be whole numbers.

    Parameters
    ----------
    values : (rows, cols)
        NaN is missing.
    factor : (float, float)
        Height and width of a cell in pixels, at least 1.
    least : float
        A cell is NaN unless so much of its area is known.

    Returns
    -------
    (int(rows / factor), int(cols / factor))
        Cells as of :class:`AreaMeans`.
    """
    area_means = AreaMeans((values.shape[0], values.shape[1]), factor, least=least)
    for rows in bands(values.shape[0]):
        part = band_of(values, rows)
        area_means.add(rows.start, np.isfinite(part), part)
    return area_means.means()[0] if values.shape[0] else np.empty((0, int(values.shape[1] / factor[1] + 1e-9)))


def _overlap(count: int, factor: float) -> sparse.csr_array:
    """Share of each of ``count`` pixels that lies in each cell: (cells, count)."""
    cells = int(count / factor + 1e-9)
    edges = np.arange(cells + 1) * factor
    first = np.floor(edges[:-1] + 1e-9).astype(np.intp)
    many = np.minimum(np.ceil(edges[1:] - 1e-9), count).astype(np.intp) - first
    rows = np.repeat(np.arange(cells), many)
    cols = np.arange(rows.size) + (first - np.cumsum(many) + many)[rows]
    shares = np.minimum(cols + 1, edges[rows + 1]) - np.maximum(cols, edges[rows])
    return sparse.csr_array((shares, (rows, cols)), shape=(cells, count))
