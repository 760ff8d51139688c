"""How many independent points a curve of one map over another has: for its level, its slope and its bend."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.analyze.correlation import correlate, on_one_grid
from planish.analyze.covariance import Lags, covariance_of
from planish.core.errors import CannotMeasure

_LEAST = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class IndependentPoints:
    """Independent points of y over x; NaN where the maps do not tell.

    Attributes
    ----------
    n_eff : float
        Of the slope: Dutilleul's number for x and what the straight line leaves of y.
    n_eff_square : float
        Of the bend: the same for ``(x - mean)^2``, which varies faster than x.
    n_eff_level : float
        Of the mean of y at the mean of x: only what the line leaves counts, so there are fewer than of the slope.
    """

    n_eff: float
    n_eff_square: float
    n_eff_level: float


def independent_points(
    x: NDArray[Any], y: NDArray[Any], *, pixel_um: float | tuple[float, float], mask: NDArray[np.bool_] | None = None
) -> IndependentPoints:
    """Count the independent points of a curve of map y over map x.

    Parameters
    ----------
    x, y : ndarray, shape (rows, cols)
        On one grid; NaN is missing.
    pixel_um : float or (float, float)
        Along y and x.
    mask : ndarray of bool, shape (rows, cols), optional
        Pixels that count.

    Returns
    -------
    IndependentPoints

    Raises
    ------
    InputError
        If the arrays are no two maps of numbers on one grid, or the mask is none of theirs.
    CannotMeasure
        If fewer than 3 pixels are known in both, or x is constant.
    """
    pixel = on_one_grid(x, y, mask, pixel_um)
    known = np.isfinite(x) & np.isfinite(y)
    if mask is not None:
        known &= mask
    n = int(np.count_nonzero(known))
    off = np.where(known, x - (x[known].mean() if n else 0.0), 0.0)
    if n < _LEAST or np.ptp(x[known]) == 0:
        raise CannotMeasure(f"{n} pixels are known in both maps, or x has one value. Look at the masks.")
    y_off = np.where(known, y - y[known].mean(), 0.0)
    rest = y_off - off * (float(np.sum(off * y_off)) / float(np.sum(off * off)))
    slope, square = (correlate(m, rest, mask=known, pixel_um=pixel).n_eff for m in (off, off * off))
    covariance, variance = covariance_of(rest, Lags(known, pixel))
    level = min(float(covariance[0, 0]) / variance, float(n)) if variance > 0 else np.nan
    return IndependentPoints(n_eff=slope, n_eff_square=square, n_eff_level=level)
