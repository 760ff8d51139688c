"""Fit Kubelka and Munk's theory of scattering layers to the brightness of a coating.

Light goes straight down and up in it; what scatters sideways is left out. A map of points below
some 0.2 mm is blurred by that, and its brightness follows the coating less than the theory says.
"""

import math
from collections.abc import Callable

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy import optimize

from planish.analyze.compared_maps import ComparedMaps
from planish.analyze.curve import independent_points, known_points
from planish.analyze.distributions import t_95
from planish.core.errors import CannotMeasure, InputError, PlanishError
from planish.core.facts import NULL, DescribedModel, Interval, Value
from planish.core.reflectance import layer_over
from planish.core.typing import Entries, Floats, Pair, TwoFields, pair_of

# S times the mean of x, up to where a layer hides everything, and the backing.
_LOW = np.array([0.0, 0.0])
_HIGH = np.array([1e6, 1.0])


class KubelkaMunk(DescribedModel):
    """Kubelka and Munk's curve through points; called with x, it gives y."""

    point_um: Value = NULL
    """Edge of a point."""
    ratio: float
    """Absorption over scattering, as it was given."""
    n: int | None = None
    """Points that are valid in both maps."""
    n_eff: Value = NULL
    """Independent points."""
    weight: bool = False
    """Whether the coating is in g/m2, and S in m2/kg; otherwise um and 1/um."""
    scattering: Value = NULL
    """Coefficient S of the coating."""
    scattering_interval: Interval = NULL
    """95 % interval of S; none where it has no end."""
    backing: Value = NULL
    """Reflectance below the coating, extrapolated."""
    backing_interval: Interval = NULL
    """Its 95 % interval."""
    backing_at_ends: Interval = NULL
    """Backing that fits best with each end of the interval of S."""
    rms: Value = NULL
    """Of what the curve leaves of the reflectance."""
    reason: str | None = None
    """Why there is no curve."""

    def __call__(self, x: ArrayLike) -> Floats:
        """Reflectance of the layer at thicknesses or weights x."""
        return self.reflectance(x, self.scattering, self.backing)

    def reflectance(self, x: ArrayLike, scattering: float, backing: float) -> Floats:
        """Reflectance of a layer with the same K / S, over thicknesses in um or weights in g/m2."""
        scattering_per_x = scattering * 1e-3 if self.weight else scattering  # kg to g
        return layer_over(backing, scattering_per_x, scattering_per_x * self.ratio, x)


def fit_kubelka_munk(
    x: ArrayLike,
    y: ArrayLike,
    *,
    n_eff: float,
    n_eff_level: float | None = None,
    absorption_over_scattering: float = 0.0,
    weight: bool = False,
) -> KubelkaMunk:
    """Fit a scattering layer over a backing to the reflectance of points.

    The fit is a curve beside the straight line.

    Parameters
    ----------
    x : array_like; thickness or weight of points, not negative; NaN is missing
    y : array_like, shape of x
        Relative reflectance of the same points, 0 to 1: grey less the dark level, over that of a
        white reference.
    n_eff : float; independent points, as for :func:`straight_or_curved`
    n_eff_level : float
        Independent points of the mean of y, of :func:`planish.analyze.independent_points`;
        ``n_eff`` without it, which makes the intervals too narrow where the rest of the brightness
        has long waves.
    absorption_over_scattering : float
        K / S of the layer, which one field cannot tell from S; some 0.002 for a white coating.
    weight : bool; whether x is in g/m2: S is in m2/kg then, and per unit of x otherwise

    Returns
    -------
    KubelkaMunk

    Raises
    ------
    InputError
        If the arrays differ in shape, x is negative somewhere, y is not within 0 to 1, or a number
        means nothing.
    CannotMeasure
        If fewer than 10 points are independent, x has fewer than 3 values, or no layer fits better
        than none.

    Notes
    -----
    Least squares for S and the backing. The intervals are profiles: all values of the one for which
    the other can be
    chosen so that the sum of squares stays below its least times ``1 + t^2 / (n_eff - 2)``, t being
    Student's; the
    square of the mean that is left counts ``n_eff_level / n_eff`` in it. They need no symmetry, and
    end at what is
    possible. The ratio K / S is taken as exact: of a coating with K / S = 0.002
    over a base of 0.79, S is found 16 % too low with 0. So is x: an error of x lowers S, as it
    lowers the slope of a
    line.

    References
    ----------
    Bates and Watts (1988), Nonlinear Regression Analysis and Its Applications, chapter 6,
    doi:10.1002/9780470316757.

    Examples
    --------
    >>> x = np.linspace(2.0, 20.0, 50)
    >>> fit = fit_kubelka_munk(x, layer_over(0.7, 0.05, 0.0, x), n_eff=50)
    >>> round(fit.scattering, 3), round(fit.backing, 2)
    (0.05, 0.7)
    """
    xs, ys, n_slope = known_points(x, y, n_eff)
    ratio = float(absorption_over_scattering)
    n_level = n_slope
    if n_eff_level is not None:
        n_level = float(n_eff_level)
    _check_layer(xs, ys, ratio, n_level)
    x_mean = xs.mean()
    level_share = min(n_level / n_slope, 1.0)
    # S times the mean of x is about 1, as the backing is.
    fit = _Fit(xs / x_mean, ys, ratio, math.sqrt(level_share))
    best = fit.best()
    sum_of_squares = fit.squares(*best)
    rms = math.sqrt(sum_of_squares / xs.size)
    squares_without_layer = np.sum((ys - ys.mean()) ** 2)
    # S is 0 where the grey does not rise with x.
    if best[0] <= 1e-6 or sum_of_squares >= squares_without_layer * (1 - 1e-9):
        raise CannotMeasure(
            f"No scattering layer of K/S = {ratio:g} fits: over {xs.size} points the grey does not"
            " rise with x as it would. Look at the straight line; give absorption_over_scattering"
            " where the layer darkens what it covers."
        )
    # Of S and of the backing; both ends are the best value where the fit has no error.
    intervals: list[Pair] = [*zip(best, best, strict=True)]
    if rms > 1e-9:
        free = n_slope - 2
        limit = sum_of_squares * (1 + t_95(free) ** 2 / free)
        intervals = [fit.interval(k, best, limit) for k in (0, 1)]
    s_low, s_high = intervals[0]
    low_backing = fit.refit(0, s_low, best)
    high_backing = math.nan
    if s_high < math.inf:
        high_backing = fit.refit(0, s_high, best)
    per_x = (1000.0 if weight else 1.0) / x_mean  # g to kg
    return KubelkaMunk(
        ratio=ratio,
        n=xs.size,
        n_eff=n_slope,
        weight=weight,
        scattering=best[0] * per_x,
        backing=best[1],
        rms=rms,
        scattering_interval=(s_low * per_x, s_high * per_x),
        backing_interval=intervals[1],
        backing_at_ends=(low_backing, high_backing),
    )


def _check_layer(x: Floats, y: Floats, ratio: float, n_level: float) -> None:
    """Raise InputError where the points are no layer over a backing, or a number means nothing."""
    if not 0 <= ratio < math.inf:
        raise InputError(
            f"absorption_over_scattering is {ratio:g}. Give K / S, 0 or above; 0 takes no"
            " absorption."
        )
    if x.min() < 0:
        raise InputError(
            f"{np.count_nonzero(x < 0)} of {x.size} thicknesses or weights are below 0, down to "
            f"{x.min():.3g}. Mask them, or check the side and the units."
        )
    n_outside = int(np.count_nonzero((y < 0) | (y > 1)))
    if n_outside:
        raise InputError(
            f"{n_outside} of {y.size} greys are not within 0 and 1 ({y.min():.5g} to"
            f" {y.max():.5g}). The curve needs relative reflectance, for which a dark and a white"
            " reference are needed: correct the image by both first, and mask glare."
        )
    if not 0 < n_level < math.inf:
        raise InputError(
            f"n_eff_level is {n_level:g}. Give a number above 0, or none where it is not known."
        )


class _Fit:
    """Least squares of S (times the mean of x) and the backing, in this order.

    Both stay within what is possible: parameter 0 is S, parameter 1 the backing. ``x`` is over its
    mean, ``y`` the reflectance of the same points, ``ratio`` K / S.

    The mean of what is left is multiplied by ``level``. Two parameters can meet mean and slope, so
    the best fit is hardly changed by that; how far they may be off it is.
    """

    def __init__(self, x: Floats, y: Floats, ratio: float, level: float) -> None:
        self._x = x
        self._y = y
        self._ratio = ratio
        self._level = level

    def squares(self, s: float, backing: float) -> float:
        """Sum of what is left, squared."""
        return np.sum(self._residuals(s, backing) ** 2)

    def best(self) -> Pair:
        """Both free, from the straight line on: dR/dW of a layer is S [(1 - R)^2 - 2 R K/S].

        S follows from the slope of the line at the mean reflectance, 1 where that bears none; the
        backing is where the line meets x = 0.
        """
        slope = np.polyfit(self._x, self._y, 1)[0]
        y_mean = self._y.mean()
        slope_of_s = (1 - y_mean) ** 2 - 2 * y_mean * self._ratio
        s = 1.0
        if abs(slope_of_s) > 1e-3:
            s = slope / slope_of_s
        backing = y_mean - slope
        start = np.clip([s, backing], [0.01, 0.01], [100.0, 0.99])
        best = _solved(lambda v: self._residuals(v[0], v[1]), start, slice(2))
        return pair_of(best)

    def refit(self, k: int, fixed: float, best: Pair) -> float:
        """Find the other parameter, near that of the best fit, that fits best with one fixed."""
        free = slice(1 - k, 2 - k)

        def residuals(v: Floats) -> Floats:
            return self._residuals(*_parameters(k, fixed, v[0]))

        return _solved(residuals, best[free], free)[0]

    def interval(self, k: int, best: Pair, limit: float) -> Pair:
        """Values of one parameter for which the other can keep the sum of squares below a limit."""

        def excess(value: float) -> float:
            other_value = self.refit(k, value, best)
            return self.squares(*_parameters(k, value, other_value)) - limit

        low = _LOW[k]
        high = _HIGH[k]
        unlimited = math.inf if k == 0 else high
        start = _crossing(excess, best[k], low, low)
        return start, _crossing(excess, best[k], high, unlimited)

    def _residuals(self, s: float, backing: float) -> Floats:
        residuals = layer_over(backing, s, s * self._ratio, self._x) - self._y
        return residuals - (1.0 - self._level) * residuals.mean()


def _parameters(k: int, fixed_value: float, free_value: float) -> Pair:
    return (fixed_value, free_value) if k == 0 else (free_value, fixed_value)


def _solved(residuals: Callable[[Floats], Floats], start: ArrayLike, free_slice: slice) -> Floats:
    """Least squares over the parameters that are free, within what is possible."""
    low = _LOW[free_slice]
    high = _HIGH[free_slice]
    inside = np.clip(start, low + 1e-9, high - 1e-9)
    accuracy: Entries = {"xtol": 1e-12, "ftol": 1e-14, "gtol": 1e-14}
    fit = optimize.least_squares(residuals, inside, bounds=(low, high), x_scale="jac", **accuracy)
    return fit.x


def _crossing(
    excess: Callable[[float], float], inside: float, end: float, fallback: float
) -> float:
    """Where ``excess`` turns positive from ``inside`` to ``end``, in doubling steps: the nearest.

    ``fallback`` where it does not. It is negative at ``inside``.
    """
    near = inside
    step = 0.05 * max(abs(inside), 0.1)
    while near != end:
        far = max(near - step, end)
        if end > inside:
            far = min(near + step, end)
        if excess(far) > 0:
            return float(optimize.brentq(excess, near, far, xtol=1e-9, rtol=1e-7))
        near = far
        step = 2 * step
    return fallback


def density_of(measured: xr.Dataset, name: str) -> float | None:
    """Density (g/cm3) of a coating: weight (g/m2) over thickness (um).

    ``name`` is the map of its thickness, beside which its weight may stand. The weight follows from
    a density that was given where both have one ratio: within 0.1 % for 99 % of the places. None
    without a weight, or where it was measured by itself.
    """
    other = name.replace("coating_", "coat_weight_")
    if other == name or other not in measured or name not in measured:
        return None
    coating = measured[name].values
    weight = measured[other].values
    is_valid = np.isfinite(coating) & np.isfinite(weight) & (coating > 0)
    if not is_valid.any():
        return None
    ratio = weight[is_valid].astype(np.float64) / coating[is_valid]
    middle = np.median(ratio)
    largest_deviation = np.percentile(np.abs(ratio - middle), 99)
    # A weight by absorption is another measurement: no one number leads to it.
    if not largest_deviation < 1e-3 * middle:
        return None
    return float(f"{middle:.6g}")


def kubelka_munk_of(
    points: TwoFields, *, point_um: float, ratio: float, density: float | None
) -> KubelkaMunk:
    """Fit reflectance at larger points, or say why not.

    ``points`` are coating and reflectance (rows, cols), ``ratio`` is K / S. ``density`` (g/cm3)
    turns a thickness in um into g/m2; it is 1 for a coating that is a weight, and None where the
    curve is to be over lengths.
    """
    is_weight = density is not None
    x = points[0] * (density or 1.0)
    y = points[1]
    try:
        count = independent_points(x, y, pixel_um=point_um)
        curve = fit_kubelka_munk(
            x,
            y,
            n_eff=count.n_eff,
            n_eff_level=count.n_eff_level,
            absorption_over_scattering=ratio,
            weight=is_weight,
        )
    except PlanishError as error:
        return KubelkaMunk(point_um=point_um, ratio=ratio, weight=is_weight, reason=error.text)
    return KubelkaMunk.holding(curve, point_um=point_um)


def answer_density(pair: ComparedMaps) -> Entries:
    """Density of a coating under an image, where the run knows it."""
    columns = pair.columns.get(pair.a[0])
    if columns is None or not pair.is_coat_on_image:
        return {}
    return {"density_g_cm3": density_of(columns.measured, pair.a[1])}


def answer_kubelka_munk(pair: ComparedMaps) -> Entries:
    """The curve of a coating under an image, in g/m2 where the run knows the density.

    Nothing where the study states no ratio K / S, or the pair is another one.
    """
    point_um = pair.point_um
    ratio = pair.params.kubelka_munk
    if ratio is None or not pair.is_coat_on_image:
        return {}
    if pair.why_no_points:
        curve = KubelkaMunk(point_um=point_um, ratio=ratio, reason=pair.why_no_points)
    else:
        density = 1.0 if pair.units[0] == "g/m2" else answer_density(pair).get("density_g_cm3")
        curve = kubelka_munk_of(pair.points, point_um=point_um, ratio=ratio, density=density)
    return {"kubelka_munk": curve}
