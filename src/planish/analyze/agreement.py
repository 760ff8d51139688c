"""Agreement of two measurements of one quantity.

Bias, scatter and limits of agreement, the line between both, and waves in common.
"""

import math
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from planish.analyze.compared_maps import ComparedMaps
from planish.analyze.correlation import (
    LEAST,
    LEAST_CLAIMED,
    Correlation,
    check_varying,
    correlate,
    filled,
    sums_of,
    valid_pixels,
)
from planish.analyze.curve import independent_points
from planish.analyze.distributions import around, t_95
from planish.analyze.rings import RingCorrelation, ring_correlation
from planish.core.area import area_mean, square_px
from planish.core.arrays import values_of
from planish.core.errors import CannotMeasure, InputError, PlanishError
from planish.core.facts import NULL, DescribedModel, Interval, Unsaved, Value
from planish.core.typing import Array, Entries, Floats, Pair, Pixel, Texts, pair_of
from planish.texture.covariance import Lags, PairCovariances, scatter_of

LIMIT = 1.96
"""Standard deviations of differences that hold 95 % of normal ones, as Bland and Altman write
it."""

# How well the variance of a mean is known from one map, as degrees of freedom: it scatters by two
# thirds of itself however large the field (8 to 30 lengths across; measured), as lags are summed to
# a zero that scatters.
_MOST_FREE, _POINTS_A_FREE = 9.0, 6.0


class Agreement(DescribedModel):
    """Two measurements a and b of one quantity, pixel by pixel; differences are b less a.

    The line of a perfect relation lies between ``slope`` (b on a) and that of a on b.
    """

    point_um: Value = NULL
    """Edge of a point."""
    n: int | None = None
    """Points of which bias and scatter are."""
    bias: Value = NULL
    """Mean of b - a at the larger points."""
    bias_interval: Interval = NULL
    """Its 95 % interval."""
    sd: Value = NULL
    """Standard deviation of b - a."""
    sd_interval: Interval = NULL
    """95 % interval of the standard deviation of the difference."""
    limits: Interval = NULL
    """Between them lie 95 % of normal differences."""
    limit_intervals: tuple[Interval, Interval] = (NULL, NULL)
    """95 % interval of the lower and the upper limit."""
    n_eff: Unsaved = NULL
    """Independent points of the mean difference."""
    n_eff_sd: Unsaved = NULL
    """Independent points of its standard deviation."""
    slope: Unsaved = NULL
    """Least squares of b on a."""
    slope_x_on_y: Unsaved = NULL
    """Least squares of a on b: a per b."""


def bland_altman(a: Array, b: Array, *, pixel_um: Pixel) -> Agreement:
    """Compare two measurements of one quantity.

    Parameters
    ----------
    a, b : ndarray, shape (rows, cols), in one unit, on one grid; NaN is missing
    pixel_um
        As of :func:`planish.correlate`.

    Returns
    -------
    Agreement

    Raises
    ------
    InputError, SizeError
        As :func:`planish.correlate`.
    CannotMeasure
        If fewer than 3 pixels are valid in both.

    Notes
    -----
    The variance of the mean is the sum of the covariances of the difference map over all pairs of
    pixels; that of the variance, for Gaussian differences, the sum of their squares (as of
    :func:`planish.correlate`). Bias and scatter of Gaussian differences are independent of each
    other. A limit holds for single pixels of this size: means over larger points agree better.
    Bias, standard deviation and limits are those of a textbook; on a small field the standard
    deviation comes out too small, by a share of 1 / (2 n_eff), which the intervals about it put
    back. Their quantile is of Student's t with 9 degrees of freedom at most, as the variances are
    told from the same map (docs/series.md has how often they hold).

    References
    ----------
    Bland and Altman (1986), Lancet 327, 307, doi:10.1016/S0140-6736(86)90837-8.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> a = rng.normal(100.0, 5.0, size=(60, 80))
    >>> b = a + 2.0 + rng.normal(size=(60, 80))
    >>> agreement = bland_altman(a, b, pixel_um=10.0)
    >>> round(agreement.bias, 1), [round(limit, 1) for limit in agreement.limits]
    (2.0, [0.1, 4.0])
    """
    is_valid, pixel = valid_pixels(a, b, pixel_um)
    check_varying(is_valid)
    x, y = filled(is_valid, (a, b), 0.0)
    sums = sums_of(x[is_valid], y[is_valid])
    differences = y - x
    slope, _, slope_x_on_y = sums.lines
    known_differences = differences[is_valid]
    bias = known_differences.mean()
    sd = sums.difference[1]
    variance = 0.0
    n_eff = n_eff_sd = sums.n
    rounding = 1e-12 * np.abs([x, y]).max()
    is_constant = np.ptp(known_differences) <= rounding
    if is_constant:
        sd = 0.0
    else:
        lags = Lags(is_valid, pixel)
        # Variance of the differences, and the independent points of their mean.
        variance, n_eff = scatter_of(differences, lags)
        # Of maps with these covariances; the number for the mean is smaller, as long waves weigh
        # more in it.
        n_eff_sd = PairCovariances(differences, differences, lags).n_eff(sums.n)
    intervals: Entries = {}  # none where too few points are independent
    if is_constant or min(n_eff, n_eff_sd) >= LEAST_CLAIMED:
        free = min(n_eff / _POINTS_A_FREE, _MOST_FREE)
        quantile = t_95(free)
        sigma = math.sqrt(variance)
        # sd of Gaussian values scatters by sd / sqrt(2 df).
        share_of_sd = 1 / math.sqrt(2 * (n_eff_sd - 1))
        share_of_limit = math.hypot(1 / math.sqrt(n_eff), LIMIT * share_of_sd)
        half_width = quantile * sigma * share_of_limit
        limits = around(bias, LIMIT * sigma)
        error_of_bias = math.sqrt(variance / n_eff)
        intervals["bias_interval"] = around(bias, quantile * error_of_bias)
        factors = np.exp(around(0.0, quantile * share_of_sd))
        intervals["sd_interval"] = sigma * factors
        intervals["limit_intervals"] = tuple(around(limit, half_width) for limit in limits)
    return Agreement(
        n=sums.n,
        bias=bias,
        slope=slope,
        slope_x_on_y=slope_x_on_y,
        sd=sd,
        limits=around(bias, LIMIT * sd),
        n_eff=n_eff,
        n_eff_sd=n_eff_sd,
        **intervals,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Deming:
    """Line through two measured quantities that both have errors: ``y = slope x + intercept``."""

    slope: float  # of the line
    intercept: float  # of the line
    # 95 % interval of the slope; (NaN, NaN) where n_eff is below 10 or any direction fits.
    interval: Pair
    error_ratio: float  # variance of the errors of y over that of x, as given


def deming(x: Array, y: Array, *, error_ratio: float | None, n_eff: float | None) -> Deming:
    """Fit a line where both quantities have errors.

    Parameters
    ----------
    x, y : ndarray, any one shape; NaN is missing
    error_ratio : float
        Variance of the errors of y over that of x, in the units of both. It cannot be told from x
        and y.
    n_eff : float
        Independent points, as :func:`planish.analyze.independent_points` counts them; all where
        they are independent.

    Raises
    ------
    InputError
        If the ratio or n_eff is missing or not above 0, or x and y are not of one shape.
    CannotMeasure
        If fewer than 3 points are known, or x and y do not vary together: any slope fits.

    Notes
    -----
    In units in which both errors are alike, this is the main axis of the cloud. The interval of its
    direction is Creasy's (1956), with n_eff in place of n; the errors then count as independent
    where n_eff says so.

    References
    ----------
    Deming (1943), Statistical Adjustment of Data, Wiley, New York.
    Creasy (1956), J. R. Statist. Soc. B 18, 65.

    Examples
    --------
    >>> x = np.arange(20.0)
    >>> line = deming(x, 2 * x + 1, error_ratio=1.0, n_eff=20)
    >>> round(line.slope, 6), round(line.intercept, 6)
    (2.0, 1.0)
    """
    if error_ratio is None or not 0 < error_ratio < math.inf:
        raise InputError(
            f"The ratio of the error variances, y over x, is {error_ratio}. Give a number above 0,"
            " from repeated measurements of both: without it there is no slope between two"
            " quantities with errors."
        )
    if n_eff is None or not 0 < n_eff < math.inf:
        raise InputError(
            f"n_eff is {n_eff}. Give the number of independent points"
            " (planish.analyze.independent_points)."
        )
    if np.shape(x) != np.shape(y):
        raise InputError(
            f"x has the shape {np.shape(x)}, y {np.shape(y)}. Bring both onto one grid first."
        )
    x = values_of(x, "x")
    y = values_of(y, "y")
    is_valid = np.isfinite(x) & np.isfinite(y)
    n = int(np.count_nonzero(is_valid))
    if n < LEAST:
        raise CannotMeasure(f"{n} points are known in x and y. Give {LEAST} or more.")
    scale = math.sqrt(error_ratio)
    a = x[is_valid].astype(np.float64)
    b = y[is_valid].astype(np.float64) / scale
    a_mean = float(a.mean())
    b_mean = float(b.mean())
    xx = np.var(a)
    xy = np.mean((a - a_mean) * (b - b_mean))
    yy = np.var(b)
    eigenvalue_gap = math.hypot(yy - xx, 2 * xy)
    is_round = eigenvalue_gap < 1e-12 * (xx + yy)
    if xy == 0 or is_round or not min(xx, yy) > 0:
        raise CannotMeasure("x and y do not vary together: any slope fits. Look at the maps.")
    axis_angle = math.atan2(2 * xy, xx - yy) / 2
    slope = math.tan(axis_angle) * scale
    determinant = float(xx * yy - xy * xy)
    directions = _directions(axis_angle, determinant, eigenvalue_gap, min(n_eff, n))
    return Deming(
        slope=slope,
        intercept=b_mean * scale - slope * a_mean,
        interval=pair_of(np.tan(directions) * scale),
        error_ratio=error_ratio,
    )


def _directions(axis_angle: float, determinant: float, eigenvalue_gap: float, n_eff: float) -> Pair:
    """Creasy's interval of the direction of a main axis, in rad from the x axis.

    Determinant and gap between the eigenvalues are those of the covariance matrix of both
    quantities, in units in which their errors are alike. NaN where any direction may be right.
    """
    if not n_eff >= LEAST_CLAIMED:
        return math.nan, math.nan
    spread = math.sqrt(max(determinant, 0.0) / (n_eff - 2))
    sine = 2 * t_95(n_eff - 2) * spread / eigenvalue_gap
    half_width = math.asin(sine) / 2 if sine < 1 else math.inf
    # Beyond upright, the interval would go through infinity.
    if not abs(axis_angle) + half_width < math.pi / 2:
        return math.nan, math.nan
    return around(axis_angle, half_width)


def _line_between(points: tuple[Array, Array], pixel_um: Pixel, error_ratio: float) -> Deming:
    """Deming's line through points, with as many of them as are independent."""
    n_eff = independent_points(*points, pixel_um=pixel_um).n_eff
    if math.isnan(n_eff):
        raise CannotMeasure("The number of independent points of the line is not known.")
    return deming(*points, error_ratio=error_ratio, n_eff=n_eff)


class AgreementFacts(Agreement, RingCorrelation):
    """Agreement of two measurements of one quantity.

    Down to which wavelength they agree, and how far they differ.
    """

    units: str = "1"
    """Of the values."""
    error_ratio: Value = NULL
    """Variance of the errors of b over that of a, as it was given."""
    error_slope: Value = NULL
    """Slope of b over a where both have such errors (Deming)."""
    error_intercept: Value = NULL
    """Of the line by the ratio of errors."""
    error_interval: Interval = NULL
    """95 % interval of that slope."""


def answer_agreement(pair: ComparedMaps) -> Entries:
    """Compare two sheets with one quantity.

    Rings of waves over the cells, bias and limits over the larger points. Nothing for other pairs,
    which have no ``repeated_points``. Where a part cannot be told, it stays empty: the rings then
    say why; the line needs a ratio of errors in the study, and stays empty too where it has none.
    """
    points = pair.repeated_points
    if points is None:
        return {}
    point_um = pair.point_um
    error_ratio = pair.params.error_ratio
    units = pair.units[0]
    try:
        rings = ring_correlation(pair.x, pair.y, pixel_um=pair.cell_um)
    except PlanishError as error:
        rings = RingCorrelation(sentence=error.text)
    try:
        agreement = bland_altman(*points, pixel_um=point_um)
    except PlanishError:
        return {"agreement": AgreementFacts.holding(rings, units=units)}
    line_fields: Entries = {"error_ratio": error_ratio}
    if error_ratio is not None:
        with suppress(PlanishError):
            line = _line_between(points, point_um, error_ratio)
            line_fields["error_slope"] = line.slope
            line_fields["error_intercept"] = line.intercept
            line_fields["error_interval"] = line.interval
    facts = AgreementFacts.holding(rings, agreement, point_um=point_um, units=units, **line_fields)
    return {"agreement": facts}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Instruments:
    """Measurements a and b of one quantity on one field."""

    point_um: float  # edge of the points that bias, limits and lines are of
    # Bias, limits of agreement and both lines of least squares, with intervals; b less a.
    agreement: Agreement
    correlation: Correlation  # of both, over the same points
    rings: RingCorrelation | None  # of waves, at the pixel; None where `notes` says why
    # Both show the same in waves of this length and longer; None where the rings do not tell.
    shared_um: float | None
    # Between two measurements that both have errors; None without `error_ratio`, or where `notes`
    # says why.
    line: Deming | None
    difference: Floats  # b less a at every pixel, (rows, cols); NaN where one is missing
    notes: Texts = ()  # what could not be told, and why


def compare_instruments(
    a: Array,
    b: Array,
    *,
    pixel_um: Pixel,
    point_um: float | None = None,
    error_ratio: float | None = None,
) -> Instruments:
    """Compare what two instruments measured of one quantity.

    Parameters
    ----------
    a, b : ndarray, shape (rows, cols), in one unit, on one grid; NaN is missing
    pixel_um
        As of :func:`planish.correlate`.
    point_um : float
        Bias, limits and lines are of means over squares of this edge; of single pixels where not
        given. Means over larger points agree better.
    error_ratio : float
        Variance of the errors of b over that of a, from repeated measurements of both; gives
        ``line``.

    Returns
    -------
    Instruments

    Raises
    ------
    InputError, SizeError
        As :func:`planish.correlate`.
    CannotMeasure
        If fewer than 3 points are valid in both.

    See Also
    --------
    planish.analyze.bland_altman, planish.analyze.ring_correlation, planish.analyze.deming

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> a = rng.normal(100.0, 5.0, size=(60, 80))
    >>> b = a + rng.normal(size=(60, 80))
    >>> compared = compare_instruments(a, b, pixel_um=10.0, point_um=50.0)
    >>> compared.point_um, round(compared.correlation.r, 2), round(compared.agreement.sd, 1)
    (50.0, 0.98, 0.2)
    """
    is_valid, pixel = valid_pixels(a, b, pixel_um)
    x, y = filled(is_valid, (a, b), np.nan)
    correlation = correlate(x, y, pixel_um=pixel, point_um=point_um)
    points = (x, y)
    size = pixel
    if point_um is not None:
        factor = square_px(point_um, pixel)
        points = (area_mean(x, factor), area_mean(y, factor))
        size = (point_um, point_um)
    agreement = bland_altman(*points, pixel_um=size)
    rings: RingCorrelation | None = None
    line: Deming | None = None
    shared_um: float | None = None
    notes: list[str] = []
    try:
        rings = ring_correlation(x, y, pixel_um=pixel)
        shared_um = rings.resolution_um
    except CannotMeasure as error:
        notes.append(error.text)
    if error_ratio is not None:
        try:
            line = _line_between(points, size, error_ratio)
        except CannotMeasure as error:
            notes.append(error.text)
    return Instruments(
        point_um=correlation.point_um,
        agreement=agreement,
        correlation=correlation,
        rings=rings,
        shared_um=shared_um,
        line=line,
        difference=y - x,
        notes=tuple(notes),
    )
