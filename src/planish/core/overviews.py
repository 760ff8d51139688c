"""Smaller copies of maps, each half as fine as the one before, for pages and viewers that show all of a large map."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core._overview_kernels import halve_truth, halve_values

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
    for _ in range(count_of(tuple(maps.sizes.values()), least=least)):
        maps = halved(maps)
        yield maps


def count_of(shape: tuple[int, ...], *, least: int = LEAST) -> int:
    """Count the overviews that maps of a shape need."""
    return max(math.ceil(math.log2(max(shape, default=1) / least)), 0)


def halved(maps: xr.Dataset) -> xr.Dataset:
    """Maps with pixels twice as wide; the last row and column of an odd number stand for themselves."""
    names = [str(name) for name, data in maps.data_vars.items() if data.ndim == 2 and data.dtype.kind in "fb"]
    coords = {str(dim): (dim, middles(maps[dim].values), maps[dim].attrs) for dim in maps[names].dims}
    variables = {name: (maps[name].dims, halved_values(maps[name].values), maps[name].attrs) for name in names}
    return xr.Dataset(variables, coords=coords, attrs=maps.attrs)


def middles(centres: NDArray[np.float64]) -> NDArray[np.float64]:
    """Middles of the pixels that are twice as wide."""
    if centres.size < 2:
        return centres
    return centres[0] + (centres[1] - centres[0]) * (0.5 + 2 * np.arange((centres.size + 1) // 2))


def halved_values(values: NDArray[Any]) -> NDArray[Any]:
    """Values (rows, cols) of pixels twice as wide, as :func:`overviews` has them; floats or truth values."""
    out = np.empty(((values.shape[0] + 1) // 2, (values.shape[1] + 1) // 2), values.dtype)
    (halve_truth if values.dtype == np.bool_ else halve_values)(np.ascontiguousarray(values), out)
    return out
