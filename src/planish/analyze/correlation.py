"""Point-wise correlation of two maps on one grid, and how sure it is (Hirn et al.

2009, sections 3.3 and 3.4).
"""

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any, Self

import numpy as np
import xarray as xr
from scipy import special

from planish.analyze.distributions import around, p_of, ranks, sign_of, t_95
from planish.core.area import AreaMeans, square_px
from planish.core.arrays import check_missing, check_numbers, described, map_pixel_um, values_of
from planish.core.axial import refuse_axial
from planish.core.bands import Rows, read_bands
from planish.core.errors import CannotMeasure, InputError, SizeError
from planish.core.facts import NULL, DescribedModel, Interval, Value
from planish.core.typing import (
    Array,
    Bools,
    Entries,
    Floats,
    Pair,
    Pixel,
    Shape2D,
    Texts,
    TwoFields,
    pair_of,
)
from planish.texture.covariance import Lags, PairCovariances
from planish.texture.detrend import shared_trend

LEAST_CLAIMED = 10.0
"""Independent points below which nothing is claimed: no p and no interval."""

LEAST = 3
"""Pixels of a map without which it says nothing."""

UNEVEN = 1.4
"""Standard error of the Conley interval over that of the covariances, from which on maps do not
vary alike."""

_ORDER = "The first", "The second"
_MOST_CELLS = 2**20


class Correlation(DescribedModel):
    """Correlation of b with a over points of one size, and how sure it is.

    r is NaN with fewer than 3 points or a constant map; p and interval are, where fewer than 10
    points are independent. The line of a perfect relation lies between both lines of least squares;
    they cross at the means.
    """

    point_um: float
    """Edge of the squares over which both maps are averaged."""
    n: int
    """Points that are valid in both. Neighbours resemble each other: n is no sample size."""
    r: Value
    """Pearson's correlation."""
    r2: Value
    """Its square."""
    rho: Value = NULL
    """Spearman's rank correlation."""
    slope: Value
    """Least squares of b on a."""
    intercept: Value
    """Of the line of b on a."""
    slope_x_on_y: Value = NULL
    """Least squares of a on b: a per b."""
    mean_a: Value = NULL
    """Mean of a over the points."""
    mean_b: Value = NULL
    """Mean of b over the points."""
    n_eff: Value = NULL
    """Independent points that would test r = 0 as well."""
    p: Value = NULL
    """Of the test of r = 0; none where fewer than 10 independent points say nothing."""
    interval: Interval = NULL
    """95 % interval of r."""
    n_eff_interval: Value = NULL
    """Independent points that would give this interval."""
    warnings: Texts = ()
    """What to be careful about."""

    @property
    def direction(self) -> int:
        """1 or -1 where the interval of r excludes 0, else 0."""
        return sign_of(self.interval)


class PointsCorrelation(DescribedModel):
    """Correlation over points of one size that stands beside another one."""

    point_um: float
    """Edge of the points."""
    n: int | None = None
    """Points that are valid in all maps."""
    r: Value = NULL
    """Pearson's correlation."""
    n_eff: Value = NULL
    """Independent points."""
    interval: Interval = NULL
    """95 % interval of this r."""

    @classmethod
    def of(cls, row: Correlation, **extra_fields: Any) -> Self:
        """Take what stands beside another r of a correlation, and what the class has more."""
        fields = {name: getattr(row, name) for name in PointsCorrelation.model_fields}
        return cls(**fields | extra_fields)


class PairSums:
    """Sums over a pair of maps, added part by part.

    The correlation and the difference of the maps follow from them.

    Means and squares are kept about the means, and joined as Chan, Golub and LeVeque (1983), The
    American Statistician 37, 242, doi:10.1080/00031305.1983.10483115, do: nothing is lost to the
    size of a constant.
    """

    def __init__(self) -> None:
        self.n = 0
        self._mean = np.zeros(3)  # of x, y, y - x
        self._square = np.zeros((3, 3))

    def add(self, x: Array, y: Array) -> None:
        """Add the places where both are finite.

        ``off`` is how far the mean of these lies from that of all before, ``share`` their share of
        all: both means and their distance enter the sums of squares about the new mean.
        """
        is_valid = np.isfinite(x) & np.isfinite(y)
        n = int(np.count_nonzero(is_valid))
        if n == 0:
            return
        parts = np.empty((3, n))
        parts[0] = x[is_valid]
        parts[1] = y[is_valid]
        np.subtract(parts[1], parts[0], out=parts[2])
        mean = parts.mean(axis=1)
        parts -= mean[:, None]
        off = mean - self._mean
        share = n / (self.n + n)
        between = np.outer(off, off) * (self.n * share)
        self._square += parts @ parts.T + between
        self._mean += off * share
        self.n += n

    @property
    def means(self) -> Pair:
        """Of x and of y."""
        return pair_of(self._mean[:2])

    @property
    def variances(self) -> Pair:
        """Of x and of y."""
        squares = np.diag(self._square)[:2]
        return pair_of(squares / max(self.n, 1))

    @property
    def constant(self) -> list[bool]:
        """Whether x, and whether y, is constant up to rounding: then it has no correlation."""
        magnitudes = np.maximum(np.abs(self._mean[:2]), 1e-300)
        rounding = self.n * (1e-12 * magnitudes) ** 2
        return (np.diag(self._square)[:2] <= rounding).tolist()

    @property
    def r(self) -> float:
        """Pearson's correlation coefficient; NaN with fewer than 3 places or a constant map."""
        if self.n < LEAST or any(self.constant):
            return math.nan
        (saa, sab), (_, sbb) = self._square[:2, :2]
        r = sab / math.sqrt(saa * sbb)
        return float(np.clip(r, -1.0, 1.0))

    @property
    def lines(self) -> tuple[float, float, float]:
        """Slope and intercept of least squares of y on x, and the slope of x on y."""
        if math.isnan(self.r):
            return math.nan, math.nan, math.nan
        product = self._square[0, 1]
        slope = product / self._square[0, 0]
        intercept = self._mean[1] - slope * self._mean[0]
        return slope, intercept, product / self._square[1, 1]

    @property
    def difference(self) -> Pair:
        """Mean and standard deviation of y - x; NaN where there are too few places."""
        if self.n == 0:
            return math.nan, math.nan
        mean = float(self._mean[2])
        if self.n == 1:
            return mean, math.nan
        variance = self._square[2, 2] / (self.n - 1)
        return mean, math.sqrt(variance)


def sums_of(x: Array, y: Array) -> PairSums:
    """The sums over two arrays of one shape."""
    sums = PairSums()
    sums.add(x, y)
    return sums


def pearson(x: Array, y: Array) -> float:
    """Pearson's r of two arrays of one shape where both are finite.

    Parameters
    ----------
    x, y : ndarray, of one shape; NaN is missing

    Returns
    -------
    float
        NaN with fewer than 3 points or a constant.

    Examples
    --------
    >>> pearson(np.arange(4.0), np.array([1.0, 3.0, 5.0, np.nan]))
    1.0
    """
    return sums_of(values_of(x, "x"), values_of(y, "y")).r


def correlate(
    a: Rows,
    b: Rows,
    *,
    mask: Rows | None = None,
    pixel_um: Pixel | None = None,
    point_um: float | None = None,
    most_cells: int = _MOST_CELLS,
) -> Correlation:
    """Correlate map b with map a, and state how sure the correlation is.

    Parameters
    ----------
    a, b : ndarray or DataArray, shape (rows, cols)
        On one grid; NaN is missing. A map in a store is read band by band.
    mask : ndarray or DataArray of bool, shape (rows, cols)
        Pixels that count.
    pixel_um : float or (float, float)
        Along y and x; maps with coordinates in um need none.
    point_um : float
        Both maps are averaged over squares of this edge first, over the pixels that are valid in
        both; a point counts when half of it is valid. 100 um is about what the eye resolves at 30
        cm (Hirn et al. 2009, section 3.3.1).
    most_cells : int
        Of larger maps the covariances are those of means over k x k pixels, and every k-th pixel is
        ranked.

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
    ``n_eff`` follows from the covariances of both maps at all lags up to half of the field
    (Clifford et al. 1989, Dutilleul 1993), up to the first zero of their mean over all directions,
    with the variance of the mean put back. The interval is the wider of two: Fisher's z with n_eff,
    and Bartlett's variance of z from the covariances of both maps with themselves and each other,
    with a quantile of Student's t. Both hold for Gaussian maps whose spread is the same everywhere;
    where the standard error of Conley (1999), which needs no such thing, is larger, the second is
    widened by it, and above 1.4 a warning says so.

    References
    ----------
    Clifford, Richardson and Hémon (1989), Biometrics 45, 123, doi:10.2307/2532039.
    Dutilleul (1993), Biometrics 49, 305, doi:10.2307/2532625.
    Roy (1989), Biometrika 76, 824, doi:10.1093/biomet/76.4.824.
    Conley (1999), J. Econometrics 92, 1, doi:10.1016/S0304-4076(98)00084-0.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> coating = rng.normal(size=(60, 80))
    >>> image = 0.6 * coating + 0.8 * rng.normal(size=(60, 80))
    >>> row = correlate(coating, image, pixel_um=10.0)
    >>> row.n, round(row.r, 2), [round(limit, 2) for limit in row.interval]
    (4800, 0.6, [0.58, 0.62])
    """
    pixel = on_one_grid(a, b, pixel_um, mask)
    least_um = max(pixel) * (1 - 1e-9)
    if point_um is not None and not least_um <= point_um < math.inf:
        raise SizeError(
            f"A point of {point_um:g} um is smaller than a pixel of {max(pixel):g} um. Give a"
            " larger one."
        )
    shape = (a.shape[0], a.shape[1])
    if point_um is not None:
        most_cells = 0  # no correlation per pixel
    pair = PairAtSizes(shape, pixel_um=pixel, point_um=point_um, most_cells=most_cells)
    masks = [] if mask is None else [mask]
    pair.add_maps(a, b, *masks)
    if point_um is None:
        return pair.at_pixel()
    return pair.at_points()


def on_one_grid(a: Rows, b: Rows, pixel_um: Pixel | None, mask: Rows | None = None) -> Pair:
    """Return the pixel along y and x, in um, of two maps (rows, cols) on one grid.

    It is ``pixel_um``, or that of the first map with coordinates. A map that is no DataArray lies
    where the others do.

    Raises InputError or SizeError where they are not on one grid, hold no numbers, or state another
    pixel than ``pixel_um``.
    """
    stated_um = None if pixel_um is None else _pair_um(pixel_um)
    maps: Entries = {"a": a, "b": b}
    if mask is not None:
        maps["mask"] = mask
    for name, values in maps.items():
        _check_map(name, values, like=a)
        map_um = map_pixel_um(name, values, stated_um)
        stated_um = stated_um or map_um
    if stated_um is None:
        raise SizeError(
            "The maps have no pixel size: they are no maps with coordinates in um. Give it with"
            " `pixel_um`."
        )
    with_places = [m for m in maps.values() if isinstance(m, xr.DataArray)]
    if not all(_lie_alike(with_places[0], m) for m in with_places[1:]):
        raise InputError(
            "The maps have other places. Bring both onto one grid first (planish.resample_maps)."
        )
    return stated_um


def _check_map(name: str, values: Any, like: Rows) -> None:
    """Raise InputError where a map, or a mask, is no array of numbers on the pixels of another.

    Angles of an axis are refused: an angle and its opposite would be averaged. Arrays that are no
    numbers, such as text, go to ``check_numbers`` first, whose message says more.
    """
    if isinstance(getattr(values, "dtype", None), np.dtype):
        check_numbers(values, name, kinds="b" if name == "mask" else "fiub")
    n_axes = len(getattr(values, "shape", ()))
    if not isinstance(values, (np.ndarray, xr.DataArray)) or n_axes != 2:
        fix = f"Write np.asarray({name})" if n_axes == 2 else "Give maps (rows, cols)"
        raise InputError(
            f"{name} is no array of two dimensions in memory, but {described(values)}. {fix}."
        )
    check_missing(values, name)
    refuse_axial(values)
    if values.shape != like.shape:
        raise InputError(
            f"{name} has {values.shape} pixels, a has {like.shape}. Bring both onto one grid first."
        )


def _lie_alike(a: xr.DataArray, b: xr.DataArray) -> bool:
    """Whether two maps have the same axes, and the same coordinates where both have some."""
    if a.dims != b.dims:
        return False
    shared_axes = [k for k in a.dims if k in a.coords and k in b.coords]
    return all(np.allclose(a[k], b[k]) for k in shared_axes)


def _pair_um(pixel_um: Pixel) -> Pair:
    pitch_um = (pixel_um, pixel_um) if isinstance(pixel_um, (int, float, np.number)) else pixel_um
    try:
        pixel = tuple(float(v) for v in pitch_um)
    except (TypeError, ValueError):
        pixel = ()
    if len(pixel) != 2 or not all(0 < v < math.inf for v in pixel):
        raise SizeError(
            f"The pixel is {pixel_um!r} um. Give one number above 0, or two: along y and x."
        )
    return pixel[0], pixel[1]


def valid_pixels(
    a: Array, b: Array, pixel_um: Pixel, mask: Bools | None = None
) -> tuple[Bools, Pair]:
    """Pixels that count and have a value in both maps, and their size along y and x.

    Errors as of ``on_one_grid``.
    """
    pixel = on_one_grid(a, b, pixel_um, mask)
    is_valid = np.isfinite(np.asarray(a)) & np.isfinite(np.asarray(b))
    if mask is not None:
        is_valid &= np.asarray(mask)
    return is_valid, pixel


def filled(is_valid: Bools, maps: Sequence[Array], value: float) -> list[Floats]:
    """Maps in double precision, with a value where a pixel does not count."""
    return [np.where(is_valid, m, value).astype(np.float64) for m in maps]


def placed(values: Floats, is_valid: Bools, missing: float) -> Floats:
    """Values of the valid pixels as a map (rows, cols)."""
    out = np.full(is_valid.shape, missing)
    out[is_valid] = values
    return out


def check_varying(is_valid: Bools, **maps: Array) -> None:
    """Raise CannotMeasure where fewer than 3 pixels are valid, or a map is constant over them."""
    n = int(np.count_nonzero(is_valid))
    if n < LEAST:
        raise CannotMeasure(
            f"{n} pixels are known in all maps, {LEAST} are needed. Look at the masks."
        )
    for name, values in maps.items():
        if not np.ptp(values[is_valid]) > 0:
            raise CannotMeasure(
                f"Over {n} known pixels, map {name} is constant. Look at the masks."
            )


class PairAtSizes:
    """Correlate two maps per pixel and over larger points, adding some rows at a time.

    Larger points are means over the pixels that are valid in both, weighted by area; a point counts
    when half of it is valid. Without ``most_cells`` there is no correlation per pixel.
    """

    def __init__(
        self,
        shape: Shape2D,
        *,
        pixel_um: Pair,
        point_um: float | None,
        most_cells: int = _MOST_CELLS,
    ) -> None:
        """Begin with no rows; ``shape`` and ``pixel_um`` (y, x) are those of both maps.

        No points without ``point_um``, or where they would be smaller than a pixel. A cell is so
        many pixels wide that there are ``most_cells`` of them at most.
        """
        self._pixel_um = pixel_um
        self._point_um = point_um or math.nan
        point_px = square_px(self._point_um, pixel_um)
        self._points = None
        if min(point_px) >= 1 - 1e-9:
            self._points = AreaMeans(shape, point_px)
        self._factor = 0  # edge of a cell that stands for pixels, in pixels
        self._cells = None
        if most_cells:
            pixels_a_cell = math.prod(shape) / most_cells
            self._factor = max(1, math.ceil(math.sqrt(pixels_a_cell)))
            self._cells = AreaMeans(shape, (self._factor, self._factor))
        self._sums = PairSums()
        self._ranked = [np.empty((2, 0))]  # every k-th pixel of both, band by band

    def add_maps(self, a: Rows, b: Rows, *masks: Rows) -> None:
        """Add all rows of both maps, where all masks are true."""
        for rows, (x, y, *mask_bands) in read_bands(a, b, *masks):
            for mask in mask_bands:
                x = np.where(mask, x, np.nan)
            self.add(rows.start, x, y)

    def add(self, begin: int, x: Array, y: Array) -> None:
        """Add the rows from ``begin`` on of both maps (rows, cols); NaN is missing.

        To the means over cells and points and, where r per pixel is wanted, to its sums and to the
        pixels that are ranked: every k-th along either axis, counted from the first row of the map.
        """
        is_valid = np.isfinite(x) & np.isfinite(y)
        for means in (self._cells, self._points):
            if means is not None:
                means.add(begin, is_valid, x, y)
        if not self._factor:
            return
        self._sums.add(x, y)
        k = self._factor
        every_kth = np.s_[-begin % k :: k, ::k]
        is_ranked = is_valid[every_kth]
        ranked = [m[every_kth][is_ranked] for m in (x, y)]
        self._ranked.append(np.array(ranked, dtype=np.float64))

    def at_pixel(self) -> Correlation:
        """The correlation per pixel."""
        cells, pitch = self.cells()
        ranked = np.concatenate(self._ranked, axis=1)
        pixel_um = math.sqrt(math.prod(self._pixel_um))
        return _stated(self._sums, cells, ranked, pitch, pixel_um)

    def at_points(self) -> Correlation:
        """The correlation of the larger points.

        Of none where they would be smaller than a pixel.
        """
        points = self.points()
        size_um = self._point_um
        is_valid = np.isfinite(points).all(axis=0)
        ranked = np.stack(points)[:, is_valid]
        return _stated(sums_of(*points), points, ranked, (size_um, size_um), size_um)

    def sizes(self) -> Iterator[tuple[Correlation, PairSums]]:
        """The correlation per pixel, and of the larger points, each with its sums."""
        yield self.at_pixel(), self._sums
        yield self.at_points(), sums_of(*self.points())

    def cells(self) -> tuple[list[Floats], Pair]:
        """Give the means of both maps over the cells that stand for pixels, and a cell's size."""
        assert self._cells is not None
        return self._cells.means(), pair_of(np.multiply(self._factor, self._pixel_um))

    def points(self) -> TwoFields:
        """The means of both maps; none where a point would be smaller than a pixel."""
        means = self._points.means() if self._points is not None else []
        x, y = means or [np.empty((0, 0))] * 2
        return x, y


def _stated(
    sums: PairSums, cells: Sequence[Floats], ranked: Floats, pitch_um: Pair, support_um: float
) -> Correlation:
    """Say how sure the correlation is that stands in the sums.

    ``cells`` are both maps (rows, cols), as they are or averaged, with ``pitch_um`` along y and x:
    their covariances say how many points are independent. ``ranked`` (2, n) are the values that the
    rank correlation is of, none where it is empty; ``support_um`` is the edge of a point.
    """
    r = sums.r
    slope, intercept, slope_x_on_y = sums.lines
    fields: Entries = {"point_um": support_um, "n": sums.n, "r": r, "r2": r * r}
    fields |= {"slope": slope, "intercept": intercept, "slope_x_on_y": slope_x_on_y}
    warnings: list[str] = []
    if sums.n < LEAST:
        warnings.append(f"Only {sums.n} points are valid in both maps.")
    elif math.isnan(r):
        constant = zip(_ORDER, sums.constant, strict=True)
        warnings += [f"{which} map is constant." for which, is_constant in constant if is_constant]
    if math.isnan(r):
        return Correlation(**fields, warnings=tuple(warnings))
    rho = math.nan
    if ranked.size:
        rho = pearson(ranks(ranked[0]), ranks(ranked[1]))
        for which, values in zip(_ORDER, ranked, strict=True):
            share = float(np.mean(values == np.median(values)))
            if share > 0.9:
                warnings.append(
                    f"{100 * share:.0f} % of the points of {which.lower()} map have the same value."
                )
    mean_a, mean_b = sums.means
    fields |= {"rho": rho, "mean_a": mean_a, "mean_b": mean_b}
    fields |= _certainty(sums, cells, pitch_um, warnings)
    return Correlation(**fields, warnings=tuple(warnings))


@lru_cache(maxsize=4)  # the maps of a layer have one mask, at each point size
def _lags_of(mask_bytes: bytes, shape: Shape2D, pitch_um: Pair) -> Lags:
    return Lags(np.frombuffer(mask_bytes, dtype=bool).reshape(shape), pitch_um)


def _certainty(
    sums: PairSums, cells: Sequence[Floats], pitch_um: Pair, warnings: list[str]
) -> Entries:
    """Independent points, p and interval, as far as they may be claimed; adds to ``warnings``.

    Sums are of single points, ``cells`` both maps (rows, cols) whose covariances by lag count. The
    interval in Fisher's z is the wider of that of n_eff points and that of Bartlett's variance.
    """
    r = sums.r
    is_valid = np.isfinite(cells[0]) & np.isfinite(cells[1])
    if np.count_nonzero(is_valid) < LEAST:
        warnings.append("The maps are too small to tell how many points are independent.")
        return {}
    x, y = filled(is_valid, cells, 0.0)
    pair = PairCovariances(x, y, _lags_of(is_valid.tobytes(), is_valid.shape, pitch_um))
    n_eff = pair.n_eff(sums.n, sums.variances)
    if not n_eff >= LEAST_CLAIMED:
        points_text = f"{n_eff:.0f}" if n_eff >= 1 else "No"
        warnings.append(
            f"{points_text} independent points: nothing is claimed. Measure a larger field."
        )
        return {"n_eff": n_eff}
    if n_eff < 30:
        warnings.append(f"Only {n_eff:.0f} independent points. Measure a larger field.")
    if 1 - r * r < 1e-14:
        return {"n_eff": n_eff, "p": 0.0, "interval": (r, r)}
    # Standard error by what single points add to r over that by the covariances, 1 at least.
    error_ratio = pair.unevenness(pearson(x[is_valid], y[is_valid]))
    if error_ratio > UNEVEN:
        warnings.append(
            f"The maps vary unevenly, which makes the interval {error_ratio:.1f} times as wide."
            " Look at them, and mask what does not belong."
        )
    variance_of_z = error_ratio**2 * pair.variance_of_z(r, sums.variances)
    quantile = float(special.ndtri(0.975))
    width = quantile / math.sqrt(n_eff - 3)
    if 0 < variance_of_z < 1 / 3:  # the quantile needs degrees of freedom above 1
        quantile_of_t = t_95(1 / variance_of_z - 2)
        width = max(width, quantile_of_t * math.sqrt(variance_of_z))
    if trend := shared_trend(x, y, is_valid):
        warnings.append(trend)
    interval = pair_of(np.tanh(around(math.atanh(r), width)))
    free = n_eff - 2
    p = p_of(r * math.sqrt(free / (1 - r * r)), free)
    n_eff_interval = (quantile / width) ** 2 + 3
    return {"n_eff": n_eff, "p": p, "interval": interval, "n_eff_interval": n_eff_interval}
