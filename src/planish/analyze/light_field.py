"""Uneven light: a smooth field in an image that the map compared with it does not explain.

Fall-off and ramps are a quadratic field of x and y. Field and map are fitted to the image
together: a field that is fitted alone also takes off the long waves that both have in common.
"""

import math

import numpy as np
from scipy import special

from planish.analyze.compared_maps import ComparedMaps
from planish.analyze.correlation import (
    LEAST_CLAIMED,
    Correlation,
    PointsCorrelation,
    correlate,
    filled,
    pearson,
    placed,
    valid_pixels,
)
from planish.analyze.distributions import fisher_z, p_of, widened
from planish.analyze.quadratic_field import QuadraticField, points_of, terms_of_points
from planish.core.errors import CannotMeasure
from planish.core.facts import NULL, Interval, Unsaved, Value
from planish.core.grid import Grid
from planish.core.typing import Bools, Entries, Floats, Pair, pair_of
from planish.texture.covariance import Lags

_TERMS = 5  # of the field, beside its mean
_LEAST_SIDE = 3  # points that a quadratic term needs along an axis


class LightField(PointsCorrelation):
    """r with a quadratic field of x and y off the image, and how large that field is.

    The long waves of the paper that look like such a field are off as well.
    """

    r_plain: Value
    """r over the same points with the field left in."""
    interval_plain: Interval
    """Its 95 % interval."""
    share: Value
    """Share of the image's variance that the field holds."""
    share_even: Value
    """Share that the texture of the image alone gives on average, in even light."""
    p_even: Value
    """Probability of a share this large in even light."""
    span: Value
    """Largest less smallest value of the field, as a share of the image's mean."""
    inflation: Unsaved = NULL
    """Standard deviation of the map over that of what the field leaves of it."""
    declared: bool = False
    """Whether r without the field leads, as the study declared."""

    @property
    def change(self) -> float:
        """How much the field changes r."""
        return abs(self.r - self.r_plain)


def light_field(a: Floats, b: Floats, *, point_um: float) -> tuple[LightField, Floats]:
    """Fit a multiple of a map and a quadratic field of x and y to an image.

    Parameters
    ----------
    a, b : ndarray, shape (rows, cols)
        Map and image over points; NaN is missing.
    point_um : float
        Edge of a point.

    Returns
    -------
    LightField
        No interval where fewer than 10 points are independent beside the terms of the field.
    ndarray, shape (rows, cols)
        The field, less its mean, where both are known; NaN elsewhere.

    Raises
    ------
    InputError, SizeError
        As :func:`planish.correlate`.
    CannotMeasure
        If there are too few points, or map or image are a quadratic field themselves.

    Notes
    -----
    The interval is that of the partial correlation given the field, which has the same slope and
    the same rest. What the field shares with the map makes the slope less certain and does not
    count in r: with v the variance of the map over that of what the field leaves of it, the limits
    of r follow by tanh(asinh(sqrt(v) sinh z)). The terms of the field are degrees of freedom.

    In even light, the coefficients of the field come of the texture of the rest, whose covariances
    by lag give theirs; what the fit took off these is put back.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> coating = rng.normal(size=(30, 40))
    >>> fall_off = 2.0 * np.linspace(-1.0, 1.0, 40) ** 2
    >>> image = coating + fall_off + rng.normal(size=(30, 40))
    >>> light, _ = light_field(coating, image, point_um=100.0)
    >>> round(light.r_plain, 2), round(light.r, 2)
    (0.62, 0.68)
    """
    is_valid, _ = valid_pixels(a, b, point_um)
    a, b = filled(is_valid, (a, b), np.nan)
    grey_mean = b[is_valid].mean()
    x = a[is_valid] - a[is_valid].mean()
    y = b[is_valid] - grey_mean
    known_lines = [is_valid.any(axis=axis) for axis in (0, 1)]
    side = min(map(np.count_nonzero, known_lines))
    if x.size < 3 * _TERMS or side < _LEAST_SIDE:
        raise CannotMeasure(
            f"{x.size} points, {side} along the shorter side, are too few for a field of {_TERMS}"
            f" terms; {3 * _TERMS} and {_LEAST_SIDE} are needed. Take smaller points or a larger"
            " field."
        )
    terms, _ = np.linalg.qr(terms_of_points(is_valid))  # (points, 6), orthonormal
    x_rest, y_rest = (m - terms @ (terms.T @ m) for m in (x, y))
    for name, values, rest in (("map", x, x_rest), ("image", y, y_rest)):
        if not rest @ rest > 1e-10 * (values @ values):
            raise CannotMeasure(f"The {name} is a quadratic field of x and y itself. Look at it.")
    slope = x_rest @ y_rest / (x_rest @ x_rest)
    field = terms @ (terms.T @ (y - slope * x))
    field -= field.mean()  # values at the points that are known, in the units of the image
    # What the field leaves of both, as maps: their correlation is the partial one.
    rests = [placed(rest, is_valid, math.nan) for rest in (x_rest, y_rest)]
    partial_row = correlate(*rests, pixel_um=point_um)
    plain_row = correlate(a, b, pixel_um=point_um)
    inflation = math.sqrt(x @ x / (x_rest @ x_rest))
    span = math.nan
    if grey_mean:
        span = np.ptp(field) / abs(grey_mean)
    share_even, p_even = _even_light(x, y, y_rest - slope * x_rest, terms, is_valid)
    fitted = LightField(
        point_um=point_um,
        n=x.size,
        r=pearson(x, y - field),
        n_eff=partial_row.n_eff - _TERMS,
        interval=_interval(partial_row, inflation),
        inflation=inflation,
        r_plain=plain_row.r,
        interval_plain=plain_row.interval,
        share=field @ field / (y @ y),
        share_even=share_even,
        p_even=p_even,
        span=span,
    )
    return fitted, placed(field, is_valid, math.nan)


def _interval(partial_row: Correlation, inflation: float) -> Pair:
    """Interval of r from that of the partial correlation; NaN where too few points are left.

    The terms of the field are degrees of freedom, which makes it wider in Fisher's z; what they
    share with the map (``inflation``) makes the slope less certain.
    """
    if not partial_row.n_eff - _TERMS >= LEAST_CLAIMED:
        return math.nan, math.nan
    points = partial_row.n_eff_interval - 3
    if not points > _TERMS:
        return math.nan, math.nan
    widening = math.sqrt(points / (points - _TERMS))
    z = fisher_z(partial_row.r)
    limits = z + widening * (fisher_z(partial_row.interval) - z)
    z_of_r = np.arcsinh(inflation * np.sinh(limits))
    return pair_of(np.tanh(z_of_r))


def fit_light(a: Floats, b: Floats, grid: Grid, point_um: float) -> QuadraticField:
    """Fit the field to a map and an image over points, which begin with the pixels of a grid.

    CannotMeasure as of :func:`light_field`.
    """
    _, field = light_field(a, b, point_um=point_um)
    is_valid = np.isfinite(field)
    terms = terms_of_points(is_valid)
    weights = np.linalg.lstsq(terms, field[is_valid], rcond=None)[0]
    points = points_of(grid, a.shape, point_um)
    return QuadraticField(weights=np.asarray(weights, dtype=np.float64), points=points)


def _even_light(x: Floats, y: Floats, rest: Floats, terms: Floats, is_valid: Bools) -> Pair:
    """Mean share of a field in even light, and the probability of one as large as that seen.

    ``x`` and ``y`` (points,) are map and image less their means at the points of ``is_valid``,
    ``rest`` what map and field leave of the image. Both numbers are NaN where the covariances do
    not tell.

    The rest's covariances by lag, and what the terms (points, 6) took off them, give the variance
    of each coefficient. Their sum of squares is taken for a chi-square with the same mean and
    variance (Satterthwaite 1946).
    """
    lags = Lags(is_valid, (1.0, 1.0))
    spectrum = lags.transform(placed(rest, is_valid, 0.0))
    products = lags.products(spectrum, spectrum)
    used = lags.until_zero(products)
    products = np.where(used, products, 0.0)
    used_pairs = np.where(used, lags.pairs, 0.0)
    pairs = np.maximum(used_pairs, 1e-9)
    spectra = [lags.transform(placed(term, is_valid, 0.0)) for term in terms.T]
    products_of_terms = np.stack([lags.products(m, m) for m in spectra])
    overlaps = np.where(used, products_of_terms, 0.0)
    # What a term took off the covariances depends on its own variance, which follows from them.
    taken_off = np.tensordot(overlaps / pairs, overlaps, ((1, 2), (1, 2)))
    of_rest = np.tensordot(overlaps, products / pairs, 2)
    remaining = np.eye(len(taken_off)) - taken_off
    variances = np.linalg.solve(remaining, of_rest)
    put_back = np.tensordot(variances, overlaps, 1)
    covariance = (products + put_back) / pairs
    # The terms of a field are those that neither the mean nor the map explain.
    field_terms = terms - terms.mean(axis=0)
    field_terms -= np.outer(x, x @ field_terms) / (x @ x)
    directions = np.linalg.svd(field_terms, full_matrices=False)[0]
    basis = directions[:, :_TERMS]
    spectra = [lags.transform(placed(term, is_valid, 0.0)) for term in basis.T]
    expected = np.empty((_TERMS, _TERMS))
    for row, column in np.ndindex(expected.shape):
        overlap = lags.products(spectra[row], spectra[column])
        expected[row, column] = np.sum(overlap * covariance)
    mean = np.trace(expected)
    size = np.sum((basis.T @ y) ** 2)
    if not (mean > 0 and variances.min() > 0):
        return math.nan, math.nan
    half_freedom = mean**2 / np.sum(expected * expected) / 2
    tail = special.gammaincc(half_freedom, half_freedom * size / mean)
    return mean / (y @ y), tail


def without_light(
    pixel: Correlation, points: Correlation, a: Floats, b: Floats
) -> tuple[Correlation, Correlation]:
    """Widen the intervals of r with an image that a field was taken off, by what that made unsure.

    ``a`` and ``b`` are map and image (rows, cols) over the points, ``pixel`` and ``points`` the
    correlations at both sizes. Both stay as they are where no field can be fitted.
    """
    try:
        field, _ = light_field(a, b, point_um=points.point_um)
    except CannotMeasure:
        return pixel, points
    widths = fisher_z(field.interval) - fisher_z(field.r)
    ratios = widths / (fisher_z(points.interval) - fisher_z(points.r))
    share = field.n_eff / points.n_eff
    inflation = field.inflation
    pixel = _less_sure(pixel, ratios, share, inflation)
    return pixel, _less_sure(points, ratios, share, inflation)


def _less_sure(row: Correlation, ratios: Floats, share: float, inflation: float) -> Correlation:
    """A row with its limits ``ratios`` times as far in z, and that share of its points.

    ``inflation`` is how much less certain the slope is.
    """
    n_eff = share * row.n_eff
    p = math.nan
    if n_eff >= LEAST_CLAIMED:
        slope = math.sinh(fisher_z(row.r)) / inflation
        free = n_eff - 2
        p = p_of(slope * math.sqrt(free), free)
    widening = float(ratios.mean())
    n_eff_interval = (row.n_eff_interval - 3) / widening**2 + 3
    interval = widened(row.r, row.interval, ratios)
    update = {"n_eff": n_eff, "interval": interval, "p": p, "n_eff_interval": n_eff_interval}
    return row.model_copy(update=update)


def answer_light_field(pair: ComparedMaps) -> Entries:
    """Give r with a quadratic field off the image, where a sheet is compared with an image.

    Where the study declares such a field, the run took it off the image before. It is put back
    here, at the middles of the points, so that r with and without it can be stated.
    """
    names = pair.a[1], pair.b[1]
    if not pair.has_points or names.count("image") != 1:
        return {}
    points = dict(zip(names, pair.points, strict=True))
    image = points.pop("image")
    (sheet,) = points.values()
    light = pair.light
    if light is not None:
        grid = points_of(pair.grid, image.shape, pair.point_um)
        image = image + light.on(grid)
    field, _ = light_field(sheet, image, point_um=pair.point_um)
    return {"light_field": field.model_copy(update={"declared": light is not None})}
