"""Point-wise linear correlation of two maps on one grid (Hirn et al. 2009, sections 3.3 and 3.4)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planish.core.area import area_mean

Array = NDArray[np.float64]

_LEAST = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Correlation:
    """Correlation of one pair of maps at one point size.

    Attributes
    ----------
    n : int
        Points that are valid in both maps. Neighbouring points are not independent: n is no sample size.
    r, r2 : float
        Pearson's correlation coefficient and its square; NaN with fewer than 3 points or a constant map.
    slope, intercept : float
        Least squares of y on x.
    point_um : float
        Edge of a point.
    """

    n: int
    r: float = math.nan
    r2: float = math.nan
    slope: float = math.nan
    intercept: float = math.nan
    point_um: float


def correlate(x: Array, y: Array, *, point_um: float) -> Correlation:
    """Correlate y with x where both are finite.

    Parameters
    ----------
    x, y : same shape
        NaN is missing.
    point_um : float
        Size of the points, recorded with the result.

    Returns
    -------
    Correlation
    """
    both = np.isfinite(x) & np.isfinite(y)
    n = int(np.count_nonzero(both))
    if n < _LEAST:
        return Correlation(n=n, point_um=point_um)
    a, b = x[both].astype(np.float64), y[both].astype(np.float64)
    mean_a, mean_b = a.mean(), b.mean()
    a, b = a - mean_a, b - mean_b
    saa, sbb, sab = float(a @ a), float(b @ b), float(a @ b)
    # A map that is constant up to rounding has no correlation.
    if saa <= n * (1e-12 * max(abs(mean_a), 1e-300)) ** 2 or sbb <= n * (1e-12 * max(abs(mean_b), 1e-300)) ** 2:
        return Correlation(n=n, point_um=point_um)
    r = sab / np.sqrt(saa * sbb)
    slope = sab / saa
    return Correlation(
        n=n, r=float(r), r2=float(r * r), slope=float(slope), intercept=float(mean_b - slope * mean_a),
        point_um=point_um,
    )  # fmt: skip


def correlate_at(
    x: Array, y: Array, *, pixel_um: tuple[float, float], point_um: float
) -> tuple[Correlation, Array, Array]:
    """Average both maps to points of ``point_um`` over the pixels valid in both, then correlate.

    The average is weighted by area; a point counts when half of it is valid. 100 um is about what the eye resolves at
    30 cm (Hirn et al. 2009, section 3.3.1). Both averaged maps are returned as well.
    """
    both = np.isfinite(x) & np.isfinite(y)
    factor = point_um / pixel_um[0], point_um / pixel_um[1]
    if min(factor) < 1:
        empty = np.full((0, 0), np.nan)
        return correlate(empty, empty, point_um=point_um), empty, empty
    cells = [area_mean(np.where(both, m, np.nan), factor) for m in (x, y)]
    return correlate(cells[0], cells[1], point_um=point_um), cells[0], cells[1]
