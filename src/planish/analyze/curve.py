"""Whether brightness bends as a layer grows.

A parabola beside the straight line, with the independent points of both.

The curve is not chosen: over the weights of one field, a line carries nearly all the variance of a
saturating curve.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from planish.analyze.compared_maps import ComparedMaps
from planish.analyze.correlation import LEAST_CLAIMED, check_varying, correlate, valid_pixels
from planish.analyze.distributions import around, sign_of, t_95
from planish.core.arrays import values_of
from planish.core.errors import CannotMeasure, InputError
from planish.core.facts import NULL, DescribedModel, Interval, Unsaved, Value
from planish.core.typing import Array, Entries, Floats, Pixel
from planish.texture.covariance import Lags, scatter_of
from planish.texture.textures import centred, unexplained


@dataclass(frozen=True, slots=True, kw_only=True)
class IndependentPoints:
    """Independent points of y over x; NaN where the maps do not tell."""

    n_eff: float  # of the slope: Dutilleul's number for x and what the straight line leaves of y
    n_eff_square: float  # of the bend: the same for `(x - mean)^2`, which varies faster than x
    # Of the mean of y at the mean of x: only what the line leaves counts, so there are fewer than
    # of the slope.
    n_eff_level: float


def independent_points(x: Array, y: Array, *, pixel_um: Pixel) -> IndependentPoints:
    """Count the independent points of a curve of map y over map x.

    Parameters
    ----------
    x, y : ndarray, shape (rows, cols), on one grid; NaN is missing
    pixel_um
        As of :func:`planish.correlate`.

    Returns
    -------
    IndependentPoints

    Raises
    ------
    InputError, SizeError
        As :func:`planish.correlate`.
    CannotMeasure
        If fewer than 3 pixels are known in both, or x is constant.

    Examples
    --------
    >>> x, y = np.random.default_rng(0).normal(size=(2, 60, 80))
    >>> independent_points(x, y, pixel_um=10.0).n_eff > 0.9 * x.size
    True
    """
    is_valid, pixel = valid_pixels(x, y, pixel_um)
    check_varying(is_valid, x=x)
    dx, dy = (centred(m, is_valid) for m in (x, y))
    residuals = unexplained(dy, dx)
    of_line = correlate(dx, residuals, mask=is_valid, pixel_um=pixel)
    of_square = correlate(dx * dx, residuals, mask=is_valid, pixel_um=pixel)
    n_eff_level = scatter_of(residuals, Lags(is_valid, pixel))[1]
    return IndependentPoints(
        n_eff=of_line.n_eff, n_eff_square=of_square.n_eff, n_eff_level=n_eff_level
    )


class Curvature(DescribedModel):
    """A parabola through points, beside the straight line.

    The parabola is ``y = a + b (x - mean) + curvature (x - mean)^2``.

    The slope changes by twice the curvature per x. r2 of the parabola is never smaller, and says
    nothing by that.
    """

    point_um: Value = NULL
    """Edge of the points."""
    n: int
    """Points that are valid in both."""
    n_eff: Value
    """Independent points."""
    n_eff_square: Unsaved = NULL
    """Independent points that the interval of the curvature counts."""
    slope: Value
    """Slope of the straight line."""
    slope_interval: Interval
    """95 % interval of the slope."""
    curvature: Value
    """Coefficient of the square."""
    interval: Interval
    """95 % interval of the curvature."""
    r2_line: Value
    """r2 of the straight line."""
    r2_parabola: Value
    """r2 of the parabola."""
    words: str
    """The same in words."""


def straight_or_curved(
    x: ArrayLike, y: ArrayLike, *, n_eff: float, n_eff_square: float | None = None
) -> Curvature:
    """Whether y bends over x.

    Parameters
    ----------
    x : array_like; thickness or weight of points; NaN is missing
    y : array_like, shape of x; grey value or reflectance of the same points
    n_eff : float; independent points, of :func:`planish.analyze.independent_points`
    n_eff_square : float
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
    Ordinary least squares; the standard errors are multiplied by ``sqrt(n / n_eff)`` and Student's
    t has n_eff less the number of coefficients for degrees of freedom, so that with n_eff = n all
    is as in textbooks. Of 200 fields with a straight line, the interval of the curvature holds 0 in
    .99 to 1.00 without n_eff_square and in .96 to .99 with it (``python -m benchmarks optics``).

    Examples
    --------
    >>> x = np.linspace(0.0, 1.0, 50)
    >>> straight_or_curved(x, x - 0.4 * x**2, n_eff=50).words
    'curved, saturating'
    """
    xs, ys, n_slope = known_points(x, y, n_eff)
    n_bend = n_slope
    if n_eff_square is not None:
        n_bend = known_points(x, y, n_eff_square)[2]
    scale = xs.std()
    u = (xs - xs.mean()) / scale
    # Terms are powers of u, the highest first: so are coefficients and half widths.
    line, r2_line = _least_squares(np.vander(u, 2), ys, n_slope)
    parabola, r2_parabola = _least_squares(np.vander(u, 3), ys, n_bend)
    slope, slope_width = line[:, 0] / scale
    curvature, bend_width = parabola[:, 0] / scale**2
    slope_interval = around(slope, slope_width)
    interval = around(curvature, bend_width)
    if not sign_of(interval):
        verdict = "not distinguishable from a straight line"
    elif not sign_of(slope_interval):
        verdict = "curved, without a slope"
    else:  # a curve saturates where its slope, up or down, loses steepness as x grows
        verdict = "curved, growing"
        if curvature * slope < 0:
            verdict = "curved, saturating"
    return Curvature(
        n=xs.size,
        n_eff=n_slope,
        n_eff_square=n_bend,
        slope=slope,
        slope_interval=slope_interval,
        curvature=curvature,
        interval=interval,
        r2_line=r2_line,
        r2_parabola=r2_parabola,
        words=verdict,
    )


def known_points(x: ArrayLike, y: ArrayLike, n_eff: float) -> tuple[Floats, Floats, float]:
    """Values (n,) that are known in both, and how many are independent: ``n_eff`` as a number.

    InputError where the arrays do not fit each other, or ``n_eff`` is no number of so many points;
    CannotMeasure where too few points are independent, or x has fewer than 3 values.
    """
    arrays = (values_of(x, "x"), values_of(y, "y"))
    if np.shape(x) != np.shape(y):
        raise InputError(f"x has {np.shape(x)} points, y has {np.shape(y)}. Give one y for each x.")
    is_valid = np.isfinite(arrays).all(axis=0)
    xs, ys = (v[is_valid].astype(np.float64) for v in arrays)
    n = float(n_eff)
    _check_independent(n, xs.size)
    is_constant = xs.std() <= 1e-12 * np.abs(xs).max()
    n_distinct = 1 if is_constant else len(np.unique(xs))
    if n_distinct < 3:  # two do not show a curve
        raise CannotMeasure(
            f"x has {n_distinct} different value{'s' if n_distinct > 1 else ''}; a curve needs 3."
            " Take points whose thickness or weight differs."
        )
    return xs, ys, n


def _check_independent(n_eff: float, n: int) -> None:
    """Raise where too few points are independent for a curve, or more than there are."""
    if n < LEAST_CLAIMED or math.isnan(n_eff) or 0 < n_eff < LEAST_CLAIMED:
        independent_text = "an unknown number" if math.isnan(n_eff) else f"{min(n_eff, n):.0f}"
        raise CannotMeasure(
            f"{n} points are known in x and y, {independent_text} of them independent; a"
            f" curve needs {LEAST_CLAIMED:.0f} that are. Measure a larger field, or look at the"
            " masks."
        )
    if not 0 < n_eff <= n * (1 + 1e-9):
        raise InputError(
            f"n_eff is {n_eff:g} of {n} points. Give the independent points of "
            "planish.analyze.correlate, at most as many as there are."
        )


def _least_squares(terms: Floats, values: Floats, n_eff: float) -> tuple[Floats, float]:
    """Coefficients and half widths of their 95 % intervals, (2, terms), and r2.

    ``terms`` (points, terms) are those of the curve at each point; NaN is r2 of equal values.
    """
    coefficients = np.linalg.lstsq(terms, values, rcond=None)[0]
    residuals = values - terms @ coefficients
    mean_square = np.mean(residuals**2)
    variance = values.var()
    r2 = math.nan
    if variance > 0:
        r2 = 1 - mean_square / variance
    free = n_eff - terms.shape[1]
    inverse = np.linalg.inv(terms.T @ terms / len(values))
    spread = np.diag(inverse) * mean_square / free
    half_widths = np.sqrt(spread) * t_95(free)
    return np.array([coefficients, half_widths], dtype=np.float64), r2


def answer_curve(pair: ComparedMaps) -> Entries:
    """Whether an image bends over a property, at the larger points.

    Nothing where too few points are independent.
    """
    if not (pair.has_points and pair.is_sheet_on_image):
        return {}
    x, y = pair.points
    counts = independent_points(x, y, pixel_um=pair.point_um)
    curvature = straight_or_curved(x, y, n_eff=counts.n_eff, n_eff_square=counts.n_eff_square)
    return {"curve": Curvature.holding(curvature, point_um=pair.point_um)}
