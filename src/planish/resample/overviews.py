"""Smaller copies of maps, each half as fine as the one before, for pages and viewers that show all of a large map."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

LEAST = 512  # pixels a side: what is no larger needs no overview


def overviews(maps: xr.Dataset, *, least: int = LEAST) -> Iterator[xr.Dataset]:
    """Halve maps until no side has more than ``least`` pixels.

    Parameters
    ----------
    maps : Dataset (rows, cols)
        On a regular grid.

    Yields
    ------
    Dataset (rows, cols)
        Means over the pixels that have a value, NaN where none of the four has one; of truth values, whether half of
        the four are true. Labels have no mean and are left out. Coordinates are the middles of the larger pixels.
    """
    while max(maps.sizes.values(), default=0) > least:
        maps = halved(maps)
        yield maps


def halved(maps: xr.Dataset) -> xr.Dataset:
    """Maps with pixels twice as wide; the last row and column of an odd number stand for themselves."""
    names = [str(name) for name, data in maps.data_vars.items() if data.ndim == 2 and data.dtype.kind in "fb"]
    coords = {str(dim): (dim, _middles(maps[dim].values), maps[dim].attrs) for dim in maps[names].dims}
    found = {name: (maps[name].dims, _means(maps[name].values), maps[name].attrs) for name in names}
    return xr.Dataset(found, coords=coords, attrs=maps.attrs)


def _middles(at: NDArray[np.float64]) -> NDArray[np.float64]:
    if at.size < 2:
        return at
    return at[0] + (at[1] - at[0]) * (0.5 + 2 * np.arange((at.size + 1) // 2))


def _means(values: NDArray[Any]) -> NDArray[Any]:
    known = np.isfinite(values)
    count, total = (_sums(part) for part in (known, np.where(known, values, 0)))
    if values.dtype == np.bool_:
        return 2 * total >= count
    with np.errstate(invalid="ignore"):
        return (total / np.where(count > 0, count, np.nan)).astype(values.dtype)


def _sums(values: NDArray[Any]) -> NDArray[np.float64]:
    """Sums over 2 x 2 pixels."""
    rows, cols = values.shape
    out = np.zeros(((rows + 1) // 2, (cols + 1) // 2))
    for i in range(2):
        for j in range(2):
            part = values[i::2, j::2]
            out[: part.shape[0], : part.shape[1]] += part
    return out
