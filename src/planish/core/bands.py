"""Large maps band by band.

What is in memory at a time does not grow with the number of their rows.
"""

import math
from collections.abc import Iterator

import numpy as np
import xarray as xr

from planish.core.memory import SAMPLE_PIXELS
from planish.core.threads import read_ahead
from planish.core.typing import Array

# A map (rows, cols) of which some rows are asked for at a time; it may lie in a store.
Rows = xr.DataArray | Array
BAND = 512  # rows of a band, and of a chunk of a stored map: each chunk is read once


def bands(rows: int) -> Iterator[slice]:
    """All rows of a map, band by band."""
    for begin in range(0, rows, BAND):
        yield slice(begin, min(begin + BAND, rows))


def band_of(pixels: Rows, rows: slice) -> Array:
    """Some rows of a map."""
    return np.asarray(pixels[rows])


def read_bands(*maps: Rows) -> Iterator[tuple[slice, list[Array]]]:
    """Rows of maps on one grid, and the maps there, band by band.

    The next band is read while one is worked on.
    """
    parts = [*bands(maps[0].shape[0])]
    values = read_ahead(lambda rows: [band_of(pixels, rows) for pixels in maps], parts)
    yield from zip(parts, values, strict=True)


def any_finite(pixels: Rows, where: Rows | None = None) -> bool:
    """Return True if a map has a value where ``where`` is true."""
    return any(values.size for values in _values_in(pixels, where))


def rms_of(pixels: Rows, where: Rows | None = None) -> float | None:
    """Root mean square of a map, where ``where`` is true; None where it has no value."""
    count = 0
    square_sum = 0.0
    for values in _values_in(pixels, where):
        count += values.size
        square_sum += float(np.sum(values.astype(np.float64) ** 2))
    if count:
        return float(np.sqrt(square_sum / count))
    return None


def _values_in(pixels: Rows, where: Rows | None) -> Iterator[Array]:
    """Finite values of a map where ``where`` is true, band by band."""
    maps = [pixels] if where is None else [pixels, where]
    for _, (values, *masks) in read_bands(*maps):
        yield values[np.logical_and.reduce([np.isfinite(values), *masks])]


def thinned(*maps: Rows) -> tuple[int, list[Array]]:
    """Every k-th row and column of maps on one grid, and k, for figures and medians.

    k is 1 up to 4 million pixels.
    """
    rows, cols = maps[0].shape
    k = max(1, math.ceil(math.sqrt(rows * cols / SAMPLE_PIXELS)))
    if k == 1:
        return 1, [np.asarray(pixels) for pixels in maps]
    thin_maps: list[Array] = []
    for pixels in maps:
        # The band's own rows, so that a stored map is read chunk by chunk and once.
        parts = [band_of(pixels, band)[-band.start % k :: k, ::k] for band in bands(rows)]
        thin_maps.append(np.concatenate(parts))
    return k, thin_maps
