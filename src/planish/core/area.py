"""Mask-weighted means over areas: what a larger pixel sees of smaller ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

Array = NDArray[np.float64]


def area_mean(values: Array, factor: tuple[float, float], *, least: float = 0.5) -> Array:
    """Mean of ``values`` (rows, cols) over cells of ``factor`` pixels, which need not be whole numbers.

    Every pixel counts with the share of its area that lies in the cell. Cells start at the border of the first pixel;
    an incomplete last one is dropped.

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
    """
    down, across = (_overlap(n, f) for n, f in zip(values.shape, factor, strict=True))
    known = np.isfinite(values)
    total = (across @ (down @ np.where(known, values, 0.0)).T).T
    weight = (across @ (down @ known.astype(np.float64)).T).T
    return np.where(weight >= least * factor[0] * factor[1] - 1e-9, total / np.maximum(weight, 1e-12), np.nan)


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
