"""Point-wise linear correlation of two maps on one grid (Hirn et al. 2009, sections 3.3 and 3.4)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.core.area import AreaMeans
from planish.core.bands import Rows, band_of, bands

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


class PairSums:
    """Sums over a pair of maps, of which parts are added at a time: their correlation and difference follow from them.

    Means and squares are kept about the means, and joined as Chan, Golub and LeVeque (1983), The American Statistician
    37, 242, doi:10.1080/00031305.1983.10483115, do: nothing is lost to the size of a constant.
    """

    def __init__(self) -> None:
        self.n = 0
        self._mean = np.zeros(3)  # of x, y, y - x
        self._square = np.zeros((3, 3))

    def add(self, x: NDArray[Any], y: NDArray[Any]) -> None:
        """Add the places where both are finite."""
        both = np.isfinite(x) & np.isfinite(y)
        n = int(np.count_nonzero(both))
        if n == 0:
            return
        a, b = x[both].astype(np.float64), y[both].astype(np.float64)
        parts = np.stack([a, b, b - a])
        mean = parts.mean(axis=1)
        parts -= mean[:, None]
        off = mean - self._mean
        self._square += parts @ parts.T + np.outer(off, off) * (self.n * n / (self.n + n))
        self._mean += off * (n / (self.n + n))
        self.n += n

    def correlation(self, *, point_um: float) -> Correlation:
        """The correlation of y with x; ``point_um`` is recorded with it."""
        n, (saa, sbb, sab) = self.n, (float(self._square[k]) for k in ((0, 0), (1, 1), (0, 1)))
        mean_a, mean_b = float(self._mean[0]), float(self._mean[1])
        # A map that is constant up to rounding has no correlation.
        constant = any(
            square <= n * (1e-12 * max(abs(mean), 1e-300)) ** 2 for square, mean in ((saa, mean_a), (sbb, mean_b))
        )
        if n < _LEAST or constant:
            return Correlation(n=n, point_um=point_um)
        r = float(np.clip(sab / math.sqrt(saa * sbb), -1.0, 1.0))
        slope = sab / saa
        return Correlation(n=n, r=r, r2=r * r, slope=slope, intercept=mean_b - slope * mean_a, point_um=point_um)

    @property
    def difference(self) -> tuple[float, float]:
        """Mean and standard deviation of y - x; NaN where there are too few places."""
        mean = float(self._mean[2]) if self.n else math.nan
        return mean, math.sqrt(self._square[2, 2] / (self.n - 1)) if self.n > 1 else math.nan


def correlate(x: NDArray[Any], y: NDArray[Any], *, point_um: float) -> Correlation:
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
    sums = PairSums()
    sums.add(x, y)
    return sums.correlation(point_um=point_um)


class PairAtSizes:
    """Correlation of two maps per pixel and over larger points, of which some rows are added at a time.

    Larger points are means over the pixels that are valid in both, weighted by area; a point counts when half of it is
    valid. 100 um is about what the eye resolves at 30 cm (Hirn et al. 2009, section 3.3.1).
    """

    def __init__(self, shape: tuple[int, int], *, pixel_um: tuple[float, float], point_um: float) -> None:
        factor = point_um / pixel_um[0], point_um / pixel_um[1]
        self._pixel_um, self._point_um = math.sqrt(pixel_um[0] * pixel_um[1]), point_um
        self._points = AreaMeans(shape, factor) if min(factor) >= 1 else None
        self._sums = PairSums()

    def add(self, begin: int, x: NDArray[Any], y: NDArray[Any]) -> None:
        """Add the rows from ``begin`` on of both maps; NaN is missing."""
        self._sums.add(x, y)
        if self._points is not None:
            self._points.add(begin, np.isfinite(x) & np.isfinite(y), x, y)

    def sizes(self) -> Iterator[tuple[Correlation, PairSums]]:
        """The correlation per pixel, and of the larger points, each with its sums."""
        points = PairSums()
        points.add(*self.points())
        for sums, point_um in ((self._sums, self._pixel_um), (points, self._point_um)):
            yield sums.correlation(point_um=point_um), sums

    def points(self) -> tuple[Array, Array]:
        """The means of both maps; none where a point would be smaller than a pixel."""
        found = self._points.means() if self._points is not None else []
        x, y = found or [np.full((0, 0), np.nan)] * 2
        return x, y


def correlate_at(
    x: Rows, y: Rows, *, pixel_um: tuple[float, float], point_um: float
) -> tuple[Correlation, Array, Array]:
    """Average both maps to points of ``point_um`` as :class:`PairAtSizes` does, then correlate.

    Both averaged maps are returned as well.
    """
    pair = PairAtSizes((x.shape[0], x.shape[1]), pixel_um=pixel_um, point_um=point_um)
    for rows in bands(x.shape[0]):
        pair.add(rows.start, band_of(x, rows), band_of(y, rows))
    cells = pair.points()
    return correlate(*cells, point_um=point_um), *cells
