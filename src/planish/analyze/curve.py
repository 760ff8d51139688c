"""Does brightness saturate as a layer grows? A parabola beside the straight line, and Kubelka and Munk's curve.

Neighbouring points resemble each other, so both count independent points, which the caller takes from
:func:`planish.analyze.independent_points`, or from ``correlate`` of x and what the straight line leaves of y. Neither
curve is chosen over the line: over the weights of one field, a line carries nearly all of the variance of a curve that
saturates.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field
from scipy import optimize

from planish.analyze.chance import student_quantile
from planish.analyze.correlation import LEAST_CLAIMED
from planish.core.errors import CannotMeasure, InputError
from planish.core.facts import NULL, Facts, Interval, Pair, Unsaved, Value
from planish.core.light import layer_over

Array = NDArray[np.float64]
_QUANTILE = 0.975
_LEAST_VALUES = 3  # different ones of x: two do not show a curve
_EXACT = 1e-9  # rms of what the curve leaves, of a reflectance, below which the fit has no error
_ENDLESS = 1e6  # S times the mean of x, where a layer hides everything
_BRACKET = 1e-6
_KG_PER_G, _G_PER_KG = 1e-3, 1000.0


class Curvature(Facts):
    """A parabola through points, ``y = a + b (x - mean) + curvature (x - mean)^2``, beside the straight line.

    The slope changes by twice the curvature per x. r2 of the parabola is never smaller, and says nothing by that.
    """

    n: int = Field(description="Points that are valid in both.")
    n_eff: Value = Field(description="Independent points.")
    n_eff_square: Unsaved = Field(
        default=NULL, exclude=True, description="Independent points that the interval of the curvature counts."
    )
    mean_x: Unsaved = Field(default=NULL, exclude=True, description="Mean of x.")
    slope: Value = Field(description="Slope of the straight line.")
    slope_interval: Interval = Field(description="In which the slope lies with 95 %.")
    curvature: Value = Field(description="Coefficient of the square.")
    interval: Interval = Field(description="In which the curvature lies with 95 %.")
    r2_line: Value = Field(description="r2 of the straight line.")
    r2_parabola: Value = Field(description="r2 of the parabola.")
    words: str = Field(description="The same in words.")


def straight_or_curved(
    x: ArrayLike, y: ArrayLike, *, n_eff: float, n_eff_square: float | None = None
) -> Curvature:  # fmt: skip
    """Whether y bends over x.

    Parameters
    ----------
    x : array_like
        Thickness or weight of points; NaN is missing.
    y : array_like, shape of x
        Relative grey or reflectance of the same points.
    n_eff : float
        Independent points, of :func:`planish.analyze.independent_points`.
    n_eff_square : float, optional
        The same of the bend. The square of a map varies faster than the map, so there are more;
        ``n_eff`` without it, which makes the interval of the curvature too wide.

    Returns
    -------
    Curvature

    Raises
    ------
    InputError
        If the arrays differ in shape, or n_eff is no number of points.
    CannotMeasure
        If fewer than 10 points are independent, or x has fewer than 3 values.

    Notes
    -----
    Ordinary least squares; the standard errors are multiplied by ``sqrt(n / n_eff)`` and Student's t has n_eff less the
    number of coefficients for degrees of freedom, so that with n_eff = n all is as in textbooks. Of 200 fields with a
    straight line, the interval of the curvature holds 0 in .99 to 1.00 without n_eff_square and in .96 to .99 with it
    (``python -m benchmarks optics``).
    """
    at, values, count = _points(x, y, n_eff)
    squares = count if n_eff_square is None else _points(x, y, n_eff_square)[2]
    mean, scale = float(at.mean()), float(at.std())
    u = (at - mean) / scale
    line, line_error, line_left = _least_squares(np.stack([np.ones(at.size), u], axis=1), values, count)
    bent, bent_error, bent_left = _least_squares(np.stack([np.ones(at.size), u, u * u], axis=1), values, squares)
    variance = float(values.var())
    shares = [1 - left / variance if variance > 0 else math.nan for left in (line_left, bent_left)]
    slope, slope_width = float(line[1]) / scale, float(line_error[1]) / scale
    curvature, width = float(bent[2]) / scale**2, float(bent_error[2]) / scale**2
    slopes, curvatures = (slope - slope_width, slope + slope_width), (curvature - width, curvature + width)
    if curvatures[0] <= 0 <= curvatures[1]:
        words = "not distinguishable from a straight line"
    elif slopes[0] <= 0 <= slopes[1]:
        words = "curved, without a slope"
    else:  # a curve saturates where its slope, up or down, loses steepness as x grows
        words = "curved, saturating" if curvature * slope < 0 else "curved, growing"
    return Curvature(
        n=at.size, n_eff=count, n_eff_square=squares, mean_x=mean, slope=slope, slope_interval=slopes,
        curvature=curvature, interval=curvatures, r2_line=shares[0], r2_parabola=shares[1], words=words,
    )  # fmt: skip


class KubelkaMunk(Facts):
    """Kubelka and Munk's curve through points; called with x, it gives y."""

    ratio: float = Field(description="Absorption over scattering, as it was given.")
    n: int | None = Field(default=None, description="Points that are valid in both maps.")
    n_eff: Value = Field(default=NULL, description="Independent points.")
    weight: bool = Field(
        default=False, description="Whether the coating is in g/m2, and S in m2/kg; otherwise um and 1/um."
    )
    scattering: Value = Field(default=NULL, description="Coefficient S of the coating.")
    scattering_interval: Interval = Field(
        default=NULL, description="In which S lies with 95 %; none where it has no end."
    )
    backing: Value = Field(default=NULL, description="Reflectance below the coating, extrapolated.")
    backing_interval: Interval = Field(default=NULL, description="In which it lies with 95 %.")
    backing_at_ends: Interval = Field(
        default=NULL, description="Backing that fits best with each end of the interval of S."
    )
    rms: Value = Field(default=NULL, description="Of what the curve leaves of the reflectance.")

    def __call__(self, x: ArrayLike) -> Array:
        """Reflectance of the layer at thicknesses or weights x."""
        return self.reflectance(x, self.scattering, self.backing)

    def reflectance(self, x: ArrayLike, scattering: float, backing: float) -> Array:
        """Reflectance of a layer with the same K / S, over thicknesses in um or weights in g/m2."""
        per_x = scattering * _KG_PER_G if self.weight else scattering
        return layer_over(backing, per_x, per_x * self.ratio, x)

    @property
    def absorption_over_scattering(self) -> float:
        """K / S, as it was given."""
        return self.ratio


def fit_kubelka_munk(
    x: ArrayLike, y: ArrayLike, *, n_eff: float, n_eff_level: float | None = None,
    absorption_over_scattering: float = 0.0, weight: bool = False,
) -> KubelkaMunk:  # fmt: skip
    """Fit a scattering layer over a backing to the reflectance of points: a curve beside the straight line.

    Parameters
    ----------
    x : array_like
        Thickness or weight of points, not negative; NaN is missing.
    y : array_like, shape of x
        Relative reflectance of the same points, 0 to 1: grey less the dark level, over that of a white reference.
    n_eff : float
        Independent points, as for :func:`straight_or_curved`.
    n_eff_level : float, optional
        Independent points of the mean of y, of :func:`planish.analyze.independent_points`; ``n_eff`` without it, which
        makes the intervals too narrow where the rest of the brightness has long waves.
    absorption_over_scattering : float
        K / S of the layer, which one field cannot tell from S; some 0.002 for a white coating.
    weight : bool
        Whether x is in g/m2: S is in m2/kg then, and per unit of x otherwise.

    Returns
    -------
    KubelkaMunk

    Raises
    ------
    InputError
        If the arrays differ in shape, x is negative somewhere, y is not within 0 to 1, or a number means nothing.
    CannotMeasure
        If fewer than 10 points are independent, x has fewer than 3 values, or no layer fits better than none.

    Notes
    -----
    Least squares for S and the backing. The intervals are profiles: all values of the one for which the other can be
    chosen so that the sum of squares stays below its least times ``1 + t^2 / (n_eff - 2)``, t being Student's; the
    square of the mean that is left counts ``n_eff_level / n_eff`` in it. They need no symmetry, and end at what is
    possible. The ratio K / S is taken as exact: of a coating with K / S = 0.002
    over a base of 0.79, S is found 16 % too low with 0. So is x: an error of x lowers S, as it lowers the slope of a
    line.

    References
    ----------
    Bates and Watts (1988), Nonlinear Regression Analysis and Its Applications, chapter 6, doi:10.1002/9780470316757.
    """
    at, values, count = _points(x, y, n_eff)
    ratio = float(absorption_over_scattering)
    if not 0 <= ratio < math.inf:
        raise InputError(f"absorption_over_scattering is {ratio:g}. Give K / S, 0 or above; 0 takes no absorption.")
    if at.min() < 0:
        raise InputError(
            f"{np.count_nonzero(at < 0)} of {at.size} thicknesses or weights are below 0, down to {at.min():.3g}. Mask "
            "them, or check the side and the units."
        )
    beyond = int(np.count_nonzero((values < 0) | (values > 1)))
    if beyond:
        raise InputError(
            f"{beyond} of {values.size} greys are not within 0 and 1 ({values.min():.5g} to {values.max():.5g}). The "
            "curve needs relative reflectance, for which a dark and a white reference are needed: correct the image by "
            "both first, and mask glare."
        )
    level = count if n_eff_level is None else float(n_eff_level)
    if not 0 < level < math.inf:
        raise InputError(f"n_eff_level is {level:g}. Give a number above 0, or none where it is not known.")
    mean = float(at.mean())
    fit = _Fit(
        at / mean, values, ratio, math.sqrt(min(level / count, 1.0))
    )  # S times the mean of x is about 1, as the backing is
    best = fit.best()
    left = fit.squares(best)
    rms = math.sqrt(left / at.size)
    nothing = float(np.sum((values - values.mean()) ** 2))
    if best[0] <= _BRACKET or left >= nothing * (1 - 1e-9):
        raise CannotMeasure(
            f"No scattering layer of K/S = {ratio:g} fits: over {at.size} points the grey does not rise with x as it "
            "would. Look at the straight line; give absorption_over_scattering where the layer darkens what it covers."
        )
    ends: tuple[Pair, Pair] = ((best[0], best[0]), (best[1], best[1]))
    if rms > _EXACT:
        t = student_quantile(_QUANTILE, count - 2)
        limit = left * (1 + t * t / (count - 2))
        ends = fit.interval(0, best, limit), fit.interval(1, best, limit)
    beside = [fit.backing(s, best[1]) if s < math.inf else math.nan for s in ends[0]]
    scattering, low, high = (s / mean * (_G_PER_KG if weight else 1.0) for s in (best[0], *ends[0]))
    return KubelkaMunk(
        ratio=ratio, n=at.size, n_eff=count, weight=weight, scattering=scattering, scattering_interval=(low, high),
        backing=best[1], backing_interval=ends[1], backing_at_ends=(beside[0], beside[1]), rms=rms,
    )  # fmt: skip


class _Fit:
    """Least squares of S (times the mean of x) and the backing, in this order, within what is possible.

    The mean of what is left is multiplied by ``level``. Two parameters can meet mean and slope, so the best fit is
    hardly changed by that; how far they may be off it is.
    """

    _low, _high = (0.0, 0.0), (_ENDLESS, 1.0)

    def __init__(self, x: Array, y: Array, ratio: float, level: float) -> None:
        self._x, self._y, self._ratio, self._level = x, y, ratio, level

    def squares(self, at: tuple[float, float]) -> float:
        """Sum of what is left, squared."""
        return float(np.sum(self._left(*at) ** 2))

    def best(self) -> tuple[float, float]:
        """Both free, from the straight line on: dR/dW of a layer is S [(1 - R)^2 - 2 R K/S]."""
        x, y = self._x, self._y
        slope = float(np.cov(x, y)[0, 1] / x.var(ddof=1))
        middle = float(y.mean())
        steep = (1 - middle) ** 2 - 2 * middle * self._ratio
        s = slope / steep if abs(steep) > 1e-3 else 1.0
        start = float(np.clip(s, 0.01, 100.0)), float(np.clip(middle - slope, 0.01, 0.99))
        found = self._solve(lambda v: self._left(v[0], v[1]), start, self._low, self._high)
        return float(found[0]), float(found[1])

    def backing(self, s: float, start: float) -> float:
        """The backing that fits best with a given S."""
        found = self._solve(lambda v: self._left(s, v[0]), (start,), self._low[1:], self._high[1:])
        return float(found[0])

    def interval(self, which: int, best: tuple[float, float], limit: float) -> Pair:
        """Values of one parameter for which the other can keep the sum of squares below a limit."""
        free = 1 - which

        def beyond(value: float) -> float:
            def left(v: Array) -> Array:
                return self._left(value, v[0]) if which == 0 else self._left(v[0], value)

            inner = self._solve(left, (best[free],), (self._low[free],), (self._high[free],))
            return float(np.sum(left(inner) ** 2)) - limit

        return (
            _crossing(beyond, best[which], self._low[which], self._low[which]),
            _crossing(beyond, best[which], self._high[which], math.inf if which == 0 else self._high[which]),
        )

    def _left(self, s: float, backing: float) -> Array:
        left = layer_over(backing, s, s * self._ratio, self._x) - self._y
        return left - (1.0 - self._level) * float(left.mean())

    def _solve(
        self, left: Callable[[Array], Array], start: tuple[float, ...], low: tuple[float, ...], high: tuple[float, ...]
    ) -> Array:
        inside = np.clip(start, [v + 1e-9 for v in low], [v - 1e-9 for v in high])
        done = optimize.least_squares(
            left, inside, bounds=(low, high), x_scale="jac", xtol=1e-12, ftol=1e-14, gtol=1e-14
        )
        return np.asarray(done.x, dtype=np.float64)


def _crossing(beyond: Callable[[float], float], inside: float, end: float, without: float) -> float:
    """Where a function turns positive between ``inside`` and ``end``; ``without`` where it does not.

    The steps from ``inside`` double, so that a far end costs little and the crossing nearest to it is found.
    """
    near, step = inside, 0.05 * max(abs(inside), 0.1)
    while near != end:
        far = min(near + step, end) if end > inside else max(near - step, end)
        if beyond(far) > 0:
            return float(optimize.brentq(beyond, near, far, xtol=1e-9, rtol=1e-7))
        near, step = far, 2 * step
    return without


def _points(x: ArrayLike, y: ArrayLike, n_eff: float) -> tuple[Array, Array, float]:
    """Values that are known in both, and how many are independent."""
    given: list[NDArray[Any]] = [np.asarray(v) for v in (x, y)]
    for name, v in zip("xy", given, strict=True):
        if v.dtype.kind not in "fiub":
            raise InputError(f"{name} holds {v.dtype} values. Give an array of numbers.")
    if given[0].shape != given[1].shape:
        raise InputError(f"x has {given[0].shape} points, y has {given[1].shape}. Give one y for each x.")
    known = np.isfinite(given[0]) & np.isfinite(given[1])
    at, values = (v[known].astype(np.float64) for v in given)
    count = float(n_eff)
    if at.size < LEAST_CLAIMED or math.isnan(count) or 0 < count < LEAST_CLAIMED:
        independent = "an unknown number" if math.isnan(count) else f"{min(count, at.size):.0f}"
        raise CannotMeasure(
            f"{at.size} points are known in x and y, {independent} of them independent; a curve needs "
            f"{LEAST_CLAIMED:.0f} that are. Measure a larger field, or look at the masks."
        )
    if not 0 < count <= at.size * (1 + 1e-9):
        raise InputError(
            f"n_eff is {count:g} of {at.size} points. Give the independent points of planish.analyze.correlate, at "
            "most as many as there are."
        )
    spread = float(at.std())
    different = 1 if spread <= 1e-12 * float(np.abs(at).max()) else len(np.unique(at))
    if different < _LEAST_VALUES:
        raise CannotMeasure(
            f"x has {different} different value{'s' if different > 1 else ''}; a curve needs {_LEAST_VALUES}. Take "
            "points whose thickness or weight differs."
        )
    return at, values, count


def _least_squares(terms: Array, values: Array, n_eff: float) -> tuple[Array, Array, float]:
    """Coefficients, half widths of their 95 % intervals, and the mean square that is left."""
    found: Array = np.linalg.lstsq(terms, values, rcond=None)[0].astype(np.float64)
    left = float(np.mean((values - terms @ found) ** 2))
    free = n_eff - terms.shape[1]
    spread = np.diag(np.linalg.inv(terms.T @ terms / len(values))) * left / free
    widths: Array = np.sqrt(spread) * student_quantile(_QUANTILE, free)
    return found, widths, left
