"""Point-wise correlation of two maps on one grid, and how sure it is (Hirn et al. 2009, sections 3.3 and 3.4)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydantic import Field

from planish.analyze.covariance import Lags, PairCovariances
from planish.analyze.detrend import shared_trend
from planish.analyze.distributions import normal_quantile, ranks, student_quantile, student_tail
from planish.core.area import AreaMeans
from planish.core.arrays import step_um
from planish.core.bands import Rows, band_of, bands
from planish.core.errors import InputError, SizeError
from planish.core.facts import NULL, Interval, ResultModel, Value
from planish.core.typing import Bools, Floats

LEAST_CLAIMED = 10.0
"""Independent points below which nothing is claimed: no p and no interval."""

BANDWIDTH = 0.15
"""Share of the shorter side: how far points are taken to add to r together in the second opinion."""

_LEAST = 3
_FEW = 30.0
_MOST_CELLS = 2**20
_SAME = 0.9  # share of the points that have one value, from which on a map says little
_CHANCE = 0.95
_UNEQUAL = 1.4  # standard error of the second opinion over that of the model


class Correlation(ResultModel):
    """Correlation of b with a over points of one size, and how sure it is.

    r is NaN with fewer than 3 points or a constant map; p and interval are, where fewer than 10 points are independent.
    The line of a perfect relation lies between both lines of least squares; they cross at the means.
    """

    point_um: float = Field(description="Edge of the squares over which both maps are averaged.")
    n: int = Field(description="Points that are valid in both. Neighbours resemble each other: n is no sample size.")
    r: Value = Field(description="Pearson's correlation.")
    r2: Value = Field(description="Its square.")
    rho: Value = Field(default=NULL, description="Spearman's rank correlation.")
    slope: Value = Field(description="Least squares of b on a.")
    intercept: Value = Field(description="Of the line of b on a.")
    slope_x_on_y: Value = Field(default=NULL, description="Least squares of a on b: a per b.")
    mean_a: Value = Field(default=NULL, description="Mean of a over the points.")
    mean_b: Value = Field(default=NULL, description="Mean of b over the points.")
    n_eff: Value = Field(default=NULL, description="Independent points that would test r = 0 as well.")
    p: Value = Field(
        default=NULL, description="Of the test of r = 0; none where fewer than 10 independent points say nothing."
    )
    interval: Interval = Field(default=NULL, description="In which r lies with 95 %.")
    n_eff_interval: Value = Field(default=NULL, description="Independent points that would give this interval.")
    warnings: tuple[str, ...] = Field(default=(), description="What to be careful about.")

    @property
    def support_um(self) -> float:
        """Edge of a point."""
        return self.point_um

    @property
    def direction(self) -> int:
        """1 or -1 where the interval of r excludes 0, else 0."""
        low, high = self.interval
        return 1 if low > 0 else -1 if high < 0 else 0


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
        is_valid = np.isfinite(x) & np.isfinite(y)
        n = int(np.count_nonzero(is_valid))
        if n == 0:
            return
        parts = np.empty((3, n))
        parts[0], parts[1] = x[is_valid], y[is_valid]
        np.subtract(parts[1], parts[0], out=parts[2])
        mean = parts.mean(axis=1)
        parts -= mean[:, None]
        off = mean - self._mean
        self._square += parts @ parts.T + np.outer(off, off) * (self.n * n / (self.n + n))
        self._mean += off * (n / (self.n + n))
        self.n += n

    @property
    def means(self) -> tuple[float, float]:
        """Of x and of y."""
        return float(self._mean[0]), float(self._mean[1])

    @property
    def variances(self) -> tuple[float, float]:
        """Of x and of y."""
        return float(self._square[0, 0]) / max(self.n, 1), float(self._square[1, 1]) / max(self.n, 1)

    @property
    def constant(self) -> tuple[bool, bool]:
        """Whether x, and whether y, is constant up to rounding: then it has no correlation."""
        return tuple(
            float(self._square[k, k]) <= self.n * (1e-12 * max(abs(float(self._mean[k])), 1e-300)) ** 2 for k in (0, 1)
        )  # type: ignore[return-value]

    @property
    def r(self) -> float:
        """Pearson's correlation coefficient; NaN with fewer than 3 places or a constant map."""
        if self.n < _LEAST or any(self.constant):
            return math.nan
        (saa, sab), (_, sbb) = self._square[0, :2], self._square[1, :2]
        return float(np.clip(sab / math.sqrt(saa * sbb), -1.0, 1.0))

    @property
    def lines(self) -> tuple[float, float, float]:
        """Slope and intercept of least squares of y on x, and the slope of x on y."""
        if math.isnan(self.r):
            return math.nan, math.nan, math.nan
        slope = float(self._square[0, 1] / self._square[0, 0])
        return slope, float(self._mean[1] - slope * self._mean[0]), float(self._square[0, 1] / self._square[1, 1])

    @property
    def difference(self) -> tuple[float, float]:
        """Mean and standard deviation of y - x; NaN where there are too few places."""
        mean = float(self._mean[2]) if self.n else math.nan
        return mean, math.sqrt(self._square[2, 2] / (self.n - 1)) if self.n > 1 else math.nan


def pearson(x: NDArray[Any], y: NDArray[Any]) -> float:
    """Pearson's r of two arrays of one shape where both are finite; NaN with fewer than 3 points or a constant."""
    sums = PairSums()
    sums.add(x, y)
    return sums.r


def correlate(
    a: Rows, b: Rows, *, mask: Rows | None = None, pixel_um: float | tuple[float, float] | None = None,
    point_um: float | None = None, most_cells: int = _MOST_CELLS,
) -> Correlation:  # fmt: skip
    """Correlate map b with map a, and state how sure the correlation is.

    Parameters
    ----------
    a, b : ndarray or DataArray, shape (rows, cols)
        On one grid; NaN is missing. A map in a store is read band by band.
    mask : ndarray or DataArray of bool, shape (rows, cols), optional
        Pixels that count.
    pixel_um : float or (float, float), optional
        Along y and x; maps with coordinates in um need none.
    point_um : float, optional
        Both maps are averaged over squares of this edge first, over the pixels that are valid in both; a point counts
        when half of it is valid. 100 um is about what the eye resolves at 30 cm (Hirn et al. 2009, section 3.3.1).
    most_cells : int
        Of larger maps the covariances are those of means over k x k pixels, and every k-th pixel is ranked.

    Returns
    -------
    Correlation

    Raises
    ------
    InputError
        If the arrays are no two maps of numbers on one grid, or the mask is none of theirs.
    SizeError
        If a size is not above 0, or a point smaller than a pixel.

    Notes
    -----
    ``n_eff`` follows from the covariances of both maps at all lags up to half of the field (Clifford et al. 1989,
    Dutilleul 1993), up to the first zero of their mean over all directions, with the variance of the mean put back. The
    interval is the wider of two: Fisher's z with n_eff, and Bartlett's variance of z from the covariances of both maps
    with themselves and each other, with a quantile of Student's t. Both hold for Gaussian maps whose spread is the same
    everywhere; where the standard error of Conley (1999), which needs no such thing, is larger, the second is widened
    by it, and above 1.4 a warning says so.

    References
    ----------
    Clifford, Richardson and Hémon (1989), Biometrics 45, 123, doi:10.2307/2532039.
    Dutilleul (1993), Biometrics 49, 305, doi:10.2307/2532625.
    Roy (1989), Biometrika 76, 824, doi:10.1093/biomet/76.4.824.
    Conley (1999), J. Econometrics 92, 1, doi:10.1016/S0304-4076(98)00084-0.
    """
    pixel = on_one_grid(a, b, mask, _pitch_of(a) if pixel_um is None else pixel_um)
    if point_um is not None and not max(pixel) * (1 - 1e-9) <= point_um < math.inf:
        raise SizeError(f"A point of {point_um:g} um is smaller than a pixel of {max(pixel):g} um. Give a larger one.")
    cells = 0 if point_um is not None else most_cells
    pair = PairAtSizes((a.shape[0], a.shape[1]), pixel_um=pixel, point_um=point_um, most_cells=cells)
    for rows in bands(a.shape[0]):
        x, y = band_of(a, rows), band_of(b, rows)
        pair.add(rows.start, x if mask is None else np.where(band_of(mask, rows), x, np.nan), y)
    return pair.at_pixel() if point_um is None else pair.at_points()


def _pitch_of(maps: Rows) -> tuple[float, ...]:
    """The pixel of a map by its coordinates; SizeError where it has none."""
    steps = [step_um(maps, str(axis)) for axis in maps.dims] if isinstance(maps, xr.DataArray) else []
    pitch = tuple(step for step in steps if step is not None)
    if not pitch or len(pitch) < len(steps):
        raise SizeError(
            "The maps have no pixel size: they are no maps with coordinates in um. Give it with --pixel-um."
        )
    return pitch


def on_one_grid(a: Rows, b: Rows, mask: Rows | None, pixel_um: float | tuple[float, ...]) -> tuple[float, float]:
    """Return the pixel along y and x, or raise InputError or SizeError where two maps are not on one grid."""
    sizes = (pixel_um, pixel_um) if isinstance(pixel_um, (int, float, np.number)) else pixel_um
    try:
        pixel = tuple(float(v) for v in sizes)
    except (TypeError, ValueError):
        pixel = ()
    if len(pixel) != 2 or not all(0 < v < math.inf for v in pixel):
        raise SizeError(f"The pixel is {pixel_um!r} um. Give one number above 0, or two: along y and x.")
    named: list[tuple[str, Any]] = [("a", a), ("b", b)]
    for name, values in named if mask is None else [*named, ("mask", mask)]:
        if not isinstance(values, (np.ndarray, xr.DataArray)) or len(values.shape) != 2:
            raise InputError(f"{name} is no array of two dimensions. Give maps (rows, cols).")
        if values.dtype.kind not in ("b" if name == "mask" else "fiub"):
            wanted = "true or false" if name == "mask" else "numbers"
            raise InputError(f"{name} holds {values.dtype} values. Give an array of {wanted}.")
        if values.shape != a.shape:
            raise InputError(f"{name} has {values.shape} pixels, a has {a.shape}. Bring both onto one grid first.")
    placed = [m for m in (a, b, mask) if isinstance(m, xr.DataArray)]
    for other in placed[1:]:
        if other.dims != placed[0].dims or any(
            not np.allclose(other[k], placed[0][k]) for k in other.dims if k in other.coords and k in placed[0].coords
        ):
            raise InputError("The maps have other places. Bring both onto one grid first (planish.resample_maps).")
    return pixel[0], pixel[1]


def valid_in_both(a: NDArray[Any], b: NDArray[Any], mask: Bools | None) -> Bools:
    """Where two maps have a value, and count."""
    is_valid = np.isfinite(a) & np.isfinite(b)
    return is_valid if mask is None else is_valid & mask


class PairAtSizes:
    """Correlation of two maps per pixel and over larger points, of which some rows are added at a time.

    Larger points are means over the pixels that are valid in both, weighted by area; a point counts when half of it is
    valid. Without ``most_cells`` there is no correlation per pixel.
    """

    def __init__(
        self, shape: tuple[int, int], *, pixel_um: tuple[float, float], point_um: float | None,
        most_cells: int = _MOST_CELLS,
    ) -> None:  # fmt: skip
        self._pixel_um, self._point_um = pixel_um, point_um
        factor = (0.0, 0.0) if point_um is None else (point_um / pixel_um[0], point_um / pixel_um[1])
        self._points = AreaMeans(shape, factor) if min(factor) >= 1 - 1e-9 else None
        self._factor = max(1, math.ceil(math.sqrt(math.prod(shape) / most_cells))) if most_cells else 0
        self._cells = AreaMeans(shape, (self._factor, self._factor)) if self._factor else None
        self._sums = PairSums()
        self._ranked: list[Floats] = []

    def add(self, begin: int, x: NDArray[Any], y: NDArray[Any]) -> None:
        """Add the rows from ``begin`` on of both maps; NaN is missing."""
        is_valid = np.isfinite(x) & np.isfinite(y)
        for means in (self._cells, self._points):
            if means is not None:
                means.add(begin, is_valid, x, y)
        if not self._factor:
            return
        self._sums.add(x, y)
        k = self._factor
        thinned_maps = [m[-begin % k :: k, ::k].astype(np.float64) for m in (x, y)]
        self._ranked.append(np.stack([m[is_valid[-begin % k :: k, ::k]] for m in thinned_maps]))

    def at_pixel(self) -> Correlation:
        """The correlation per pixel."""
        cells, pitch = self.cells()
        ranked = np.concatenate(self._ranked, axis=1) if self._ranked else np.empty((2, 0))
        support_um = math.sqrt(math.prod(self._pixel_um))
        return _stated(self._sums, cells, ranked, pitch_um=pitch, support_um=support_um)

    def at_points(self) -> Correlation:
        """The correlation of the larger points; of none where they would be smaller than a pixel."""
        sums, points = self._of_points()
        size = self._point_um or math.nan
        is_valid = np.isfinite(points[0]) & np.isfinite(points[1])
        return _stated(sums, [*points], np.stack([m[is_valid] for m in points]), pitch_um=(size, size), support_um=size)

    def sizes(self) -> Iterator[tuple[Correlation, PairSums]]:
        """The correlation per pixel, and of the larger points, each with its sums."""
        yield self.at_pixel(), self._sums
        yield self.at_points(), self._of_points()[0]

    def cells(self) -> tuple[list[Floats], tuple[float, float]]:
        """The means of both maps over the cells that stand for the pixels, and the size of a cell."""
        assert self._cells is not None
        return self._cells.means(), (self._factor * self._pixel_um[0], self._factor * self._pixel_um[1])

    def points(self) -> tuple[Floats, Floats]:
        """The means of both maps; none where a point would be smaller than a pixel."""
        means = self._points.means() if self._points is not None else []
        x, y = means or [np.full((0, 0), np.nan)] * 2
        return x, y

    def _of_points(self) -> tuple[PairSums, tuple[Floats, Floats]]:
        sums, points = PairSums(), self.points()
        sums.add(*points)
        return sums, points


def _stated(
    sums: PairSums, cells: list[Floats], ranked: Floats, *, pitch_um: tuple[float, float], support_um: float
) -> Correlation:
    """Say how sure the correlation is that stands in the sums; ``cells`` are both maps, as they are or averaged."""
    r = sums.r
    if math.isnan(r):
        constant = [f"Map {name} is constant." for name, same in zip("ab", sums.constant, strict=True) if same]
        few = f"Only {sums.n} points are valid in both maps."
        return Correlation(
            point_um=support_um, n=sums.n, r=r, r2=r, slope=r, intercept=r,
            warnings=(few,) if sums.n < _LEAST else tuple(constant),
        )  # fmt: skip
    slope, intercept, other = sums.lines
    n_eff, p, width, warnings = _certainty(r, sums, cells, pitch_um)
    rho = pearson(ranks(ranked[0]), ranks(ranked[1])) if ranked.size else math.nan
    return Correlation(
        point_um=support_um, n=sums.n, r=r, r2=r * r, rho=rho, slope=slope, intercept=intercept,
        slope_x_on_y=other, mean_a=sums.means[0], mean_b=sums.means[1], n_eff=n_eff, p=p, interval=_interval(r, width),
        n_eff_interval=(normal_quantile((1 + _CHANCE) / 2) / width) ** 2 + 3 if width > 0 else math.nan,
        warnings=(*_nearly_constant(ranked), *warnings),
    )  # fmt: skip


def _certainty(
    r: float, sums: PairSums, cells: list[Floats], pitch_um: tuple[float, float]
) -> tuple[float, float, float, list[str]]:
    """Give n_eff, p, half of the width of the interval of z, and what to be careful about."""
    is_valid = np.isfinite(cells[0]) & np.isfinite(cells[1])
    if np.count_nonzero(is_valid) < _LEAST:
        return math.nan, math.nan, math.nan, ["The maps are too small to tell how many points are independent."]
    x, y = (np.where(is_valid, m, 0.0) for m in cells)
    pair = PairCovariances(x, y, Lags(is_valid, pitch_um))
    variance = pair.variance_of_r(sums.variances)
    n_eff = min(1 + 1 / variance, float(sums.n)) if variance > 0 else math.nan
    if not n_eff >= LEAST_CLAIMED:
        few = f"{n_eff:.0f}" if n_eff >= 1 else "No"
        return n_eff, math.nan, math.nan, [f"{few} independent points: nothing is claimed. Measure a larger field."]
    warnings = [f"Only {n_eff:.0f} independent points. Measure a larger field."] if n_eff < _FEW else []
    if 1 - r * r < 1e-14:
        return n_eff, 0.0, 0.0, warnings
    p = 2 * student_tail(abs(r) * math.sqrt((n_eff - 2) / (1 - r * r)), n_eff - 2)
    within = PairSums()
    within.add(x[is_valid], y[is_valid])
    ratio = 1.0
    if 1 - within.r**2 > 1e-14:
        reach = BANDWIDTH * min(k * p for k, p in zip(is_valid.shape, pitch_um, strict=True))
        ratio = max(pair.spatial_error(within.r, reach)[1], 1.0)
    if ratio > _UNEQUAL:
        warnings.append(
            f"The maps do not vary alike everywhere, which makes the interval {ratio:.1f} times as wide. Look at them, "
            "and mask what does not belong."
        )
    of_z = ratio**2 * pair.variance_of_z(r, sums.variances)
    quantile = (1 + _CHANCE) / 2
    width = normal_quantile(quantile) / math.sqrt(n_eff - 3)
    if 0 < of_z < 1 / _LEAST:
        width = max(width, student_quantile(quantile, 1 / of_z - 2) * math.sqrt(of_z))
    if trend := shared_trend(x, y, is_valid):
        warnings.append(trend)
    return n_eff, p, width, warnings


def _interval(r: float, width: float) -> tuple[float, float]:
    if width == 0:
        return r, r
    z = math.atanh(r) if abs(r) < 1 else math.nan
    return math.tanh(z - width), math.tanh(z + width)


def _nearly_constant(ranked: Floats) -> Iterator[str]:
    for name, values in zip("ab", ranked, strict=True):
        share = float(np.mean(values == np.median(values))) if values.size else 0.0
        if share > _SAME:
            yield f"{100 * share:.0f} % of the points of map {name} have one value."
