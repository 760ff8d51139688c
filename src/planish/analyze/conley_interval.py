"""An interval of r that asks nothing of the maps' covariances.

It stands beside that of a correlation.

It holds where the maps vary unevenly, and is too narrow where they reach far: the first one is
used.
"""

import math

import numpy as np

from planish.analyze.compared_maps import ComparedMaps
from planish.analyze.correlation import LEAST_CLAIMED, correlate, filled, valid_pixels
from planish.analyze.distributions import around, t_95
from planish.core.area import area_mean, common_means, square_px
from planish.core.facts import NULL, DescribedModel, Interval, Unsaved, Value
from planish.core.grid import shorter_side_um
from planish.core.typing import Array, Bools, Entries, Pair, Pixel, pair_of
from planish.texture.covariance import BANDWIDTH, Lags, PairCovariances

_MOST_CELLS = 400  # of which all pairs are weighted for the critical value


class ConleyInterval(DescribedModel):
    """Interval of r that asks nothing of the covariances of the maps (Conley 1999).

    It is taken at the larger points.
    """

    point_um: float
    """Edge of a point."""
    r: Unsaved = NULL
    """Pearson's correlation."""
    interval: Interval
    """95 % interval of r."""
    standard_error: Value
    """Of Fisher's z."""
    critical: Value
    """Standard errors to either side."""
    ratio: Value
    """Standard error over that of the covariances."""


def conley_interval(
    a: Array, b: Array, *, pixel_um: Pixel, point_um: float | None = None
) -> ConleyInterval:
    """State the interval of r that a spatial standard error with critical values of its own gives.

    Parameters
    ----------
    a, b, pixel_um, point_um
        As of :func:`planish.correlate`.

    Returns
    -------
    ConleyInterval

    Raises
    ------
    InputError, SizeError
        As :func:`planish.correlate`.

    Notes
    -----
    What a point adds to z is a map of its own; products of its values up to 0.15 of the shorter
    side apart are summed with weights that fall to 0. A kernel that wide makes the standard error
    scatter and too small, which the critical value answers for: it is that of independent values on
    the same mask (after the idea of Bester et al. 2016). Correlations that reach farther than the
    kernel are missed, so the interval covers less than 95 % where the range of the maps is a
    twelfth of the side or more (docs/evidence.md).

    References
    ----------
    Conley (1999), J. Econometrics 92, 1, doi:10.1016/S0304-4076(98)00084-0.
    Bester, Conley, Hansen and Vogelsang (2016), Econometric Theory 32, 154,
    doi:10.1017/S0266466614000814.
    Satterthwaite (1946), Biometrics Bulletin 2, 110, doi:10.2307/3002019.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> a = rng.normal(size=(60, 80))
    >>> b = 0.6 * a + 0.8 * rng.normal(size=(60, 80))
    >>> [round(limit, 2) for limit in conley_interval(a, b, pixel_um=10.0).interval]
    [0.58, 0.62]
    """
    is_valid, pixel = valid_pixels(a, b, pixel_um)
    correlation = correlate(a, b, pixel_um=pixel, point_um=point_um)
    if point_um is not None:
        a, b = common_means((a, b), square_px(point_um, pixel))
        pixel = (point_um, point_um)
        is_valid = np.isfinite(a)
    x, y = filled(is_valid, (a, b), 0.0)
    r = correlation.r
    error = critical = ratio = math.nan
    if correlation.n_eff >= LEAST_CLAIMED and 1 - r * r >= 1e-14:
        pair = PairCovariances(x, y, Lags(is_valid, pixel))
        # Standard error of z from what the points add to r, and the same over the covariances'.
        spatial_error, ratio = pair.spatial_error(r)
        if spatial_error > 0:
            error = spatial_error
            critical = critical_value(is_valid, pixel)
    z = math.nan
    if critical > 0:
        z = math.atanh(r)
    limits = np.tanh(around(z, critical * error))
    return ConleyInterval(
        point_um=correlation.point_um,
        r=r,
        interval=pair_of(limits),
        standard_error=error,
        critical=critical,
        ratio=ratio,
    )


def critical_value(is_valid: Bools, pixel_um: Pair) -> float:
    """Standard errors within which the mean of independent values on a mask lies with 95 %.

    ``is_valid`` (rows, cols) are pixels of ``pixel_um`` along y and x. The standard errors are
    taken as :meth:`PairCovariances.spatial_error` estimates them, with weights that fall to 0.

    The squared standard error is a quadratic form of the values about their mean, whose expectation
    and variance follow from the weights; its distribution is taken for that of a chi-square with
    the same two (Satterthwaite 1946). The weights of every pair of places are written out, so it is
    done for cells of k x k pixels, 400 or fewer of them.
    """
    pixels_a_cell = np.count_nonzero(is_valid) / _MOST_CELLS
    k = max(1, math.ceil(math.sqrt(pixels_a_cell)))
    ones = np.where(is_valid, 1.0, np.nan)
    is_cell = np.isfinite(area_mean(ones, (k, k)))
    places_um = np.argwhere(is_cell) * np.multiply(k, pixel_um)
    bandwidth_um = BANDWIDTH * shorter_side_um(is_valid.shape, pixel_um)
    distance_um = np.linalg.norm(places_um[:, None] - places_um, axis=-1)
    weight = np.maximum(1.0 - distance_um / bandwidth_um, 0.0)
    rows = weight.mean(axis=1)
    # As values count about their mean.
    centred_weight = weight - rows - rows[:, None] + rows.mean()
    expected = np.trace(centred_weight)
    free = expected**2 / np.sum(centred_weight * centred_weight)
    return t_95(free) * math.sqrt(places_um.shape[0] / expected)


def answer_conley_interval(pair: ComparedMaps) -> Entries:
    """The Conley interval at the larger points."""
    if not pair.has_points:
        return {}
    return {"conley_interval": conley_interval(pair.x, pair.y, **pair.sizes)}
