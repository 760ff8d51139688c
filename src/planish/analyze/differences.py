"""Whether two correlations differ: of maps on the same pixels, or of two specimens."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planish.analyze.correlation import LEAST_CLAIMED, Correlation, on_one_grid, pearson
from planish.analyze.distributions import around, is_distinguishable, t_95
from planish.core.area import valid_in_all
from planish.core.errors import InputError
from planish.core.typing import Array, Floats, Pair, Pixel, pair_of
from planish.texture.covariance import Lags, variance_of_products
from planish.texture.textures import influence_on_r, standard


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """Difference of two correlations, the second minus the first."""

    r: Pair  # the two that are compared
    difference: float  # of r
    # Its 95 % interval; (NaN, NaN) where fewer than 10 independent points say nothing.
    interval: Pair = (math.nan, math.nan)

    @property
    def distinguishable(self) -> bool | None:
        """Whether the interval excludes 0; None where there is none."""
        return is_distinguishable(self.interval)


def paired_difference(
    first: tuple[Array, Array],
    second: tuple[Array, Array],
    *,
    pixel_um: Pixel,
) -> Difference:
    """Compare the correlations of two pairs of maps on one grid, over the pixels valid in all.

    Parameters
    ----------
    first, second : (ndarray, ndarray), shape (rows, cols)
        The pairs (a, b); NaN is missing. Pairs may share a map.
    pixel_um
        As of :func:`planish.correlate`.

    Returns
    -------
    Difference

    Notes
    -----
    What each pixel adds to the difference of Fisher's z is a map of its own (the influence
    function), whose mean has the variance that its covariances by lag give. What the pairs share
    cancels in it. Of long waves that comes out too small, so the variance that Gaussian maps of
    these covariances would have is taken where it is larger.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> a = rng.normal(size=(60, 80))
    >>> b = a + rng.normal(size=(60, 80))
    >>> moved = np.roll(b, 1, axis=1)
    >>> change = paired_difference((a, moved), (a, b), pixel_um=10.0)
    >>> round(change.difference, 2), change.distinguishable
    (0.72, True)
    """
    maps = (*first, *second)
    pixel = on_one_grid(maps[0], maps[1], pixel_um)
    for m in maps[2:]:
        on_one_grid(maps[0], m, pixel_um)
    is_valid = valid_in_all(maps)
    old_a, old_b, new_a, new_b = (m[is_valid] for m in maps)
    # Of both pairs, and the difference without an interval where nothing can be claimed.
    r = (pearson(old_a, old_b), pearson(new_a, new_b))
    without_interval = Difference(r=r, difference=r[1] - r[0])
    if not all(1 - v * v >= 1e-14 for v in r):
        return without_interval
    maps = [standard(m, is_valid) for m in maps]
    old_scores = _influence_on_z(maps[0], maps[1], r[0])
    new_scores = _influence_on_z(maps[2], maps[3], r[1])
    lags = Lags(is_valid, pixel)
    # Sums of the products of all pairs of pixels at each lag; lag 0 is the sum of squares.
    products = lags.own_products(new_scores - old_scores)
    if not products[0, 0] > 0:  # the same pair twice
        return replace(without_interval, interval=around(r[1] - r[0], 0.0))
    covariance = lags.covariance(products, lags.until_zero(products))
    variance = max(lags.variance_of_mean(covariance), _gaussian_variance(maps, r, lags))
    # Independent values of what the pixels add.
    n_eff = covariance[0, 0] / variance if variance > 0 else 0.0
    if n_eff < LEAST_CLAIMED:
        return without_interval
    return _difference(r, t_95(n_eff - 1) * math.sqrt(variance))


def _influence_on_z(x: Floats, y: Floats, r: float) -> Floats:
    """What each pixel of two standardised maps adds to Fisher's z of their correlation."""
    return influence_on_r(x, y, r) / (1 - r * r)


def _gaussian_variance(maps: Sequence[Floats], r: Pair, lags: Lags) -> float:
    """Variance of the difference of z that Gaussian maps of these covariances would have.

    The four standardised maps are those of the first pair, whose z is taken off, and of the second
    one. To the first order z of a pair is a sum of products of its maps with these weights.
    """
    terms: list[tuple[int, int, float]] = []
    for a, pair_r, sign in zip((0, 2), r, (-1.0, 1.0), strict=True):
        b = a + 1
        weight = sign / (1 - pair_r * pair_r)
        weight_of_squares = -weight * pair_r / 2
        terms.append((a, b, weight))
        terms.append((a, a, weight_of_squares))
        terms.append((b, b, weight_of_squares))
    return variance_of_products(maps, terms, lags)


def difference_of(first: Correlation, second: Correlation) -> Difference:
    """Compare the correlations of two specimens, which share nothing.

    Parameters
    ----------
    first, second : Correlation
        Over points of one size.

    Returns
    -------
    Difference

    Raises
    ------
    InputError
        If the two are over points of different sizes: r depends on the size.

    Examples
    --------
    >>> row = Correlation(point_um=100.0, n=900, r=0.5, r2=0.25, slope=1.0, intercept=0.0)
    >>> weak = row.model_copy(update={"r": 0.1, "interval": (0.0, 0.2)})
    >>> strong = row.model_copy(update={"r": 0.5, "interval": (0.4, 0.6)})
    >>> difference = difference_of(weak, strong)
    >>> difference.difference, [round(limit, 2) for limit in difference.interval]
    (0.4, [0.25, 0.54])
    """
    if not math.isclose(first.point_um, second.point_um, rel_tol=0.02):
        raise InputError(
            f"One correlation is over points of {first.point_um:g} um, the other of"
            f" {second.point_um:g} um. Give both the same point_um."
        )
    r = first.r, second.r
    intervals = [first.interval, second.interval]
    if not np.all(np.abs([r, *intervals]) < 1):
        return Difference(r=r, difference=r[1] - r[0])
    half_widths = np.ptp(np.arctanh(intervals), axis=1) / 2
    return _difference(r, math.hypot(*half_widths))


def _difference(r: Pair, width: float) -> Difference:
    """The difference whose z has an interval of this half width, brought back to r."""
    first_z, second_z = np.arctanh(r)
    z_mean = (first_z + second_z) / 2
    changes = around(second_z - first_z, width)
    half_changes = np.divide(changes, 2)
    interval = np.tanh(z_mean + half_changes) - np.tanh(z_mean - half_changes)
    return Difference(r=r, difference=r[1] - r[0], interval=pair_of(interval))


def holm(p: Sequence[float]) -> list[float]:
    """Put the p of a table right for how many there are (Holm 1979, Scand.

    J. Statist. 6, 65); NaN stays and counts.

    Examples
    --------
    >>> holm([0.01, 0.04, 0.03])
    [0.03, 0.06, 0.06]
    """
    order = sorted((v, k) for k, v in enumerate(p) if not math.isnan(v))
    out = [math.nan] * len(p)
    most = 0.0
    for rank, (value, k) in enumerate(order):
        most = max(most, min(1.0, value * (len(p) - rank)))
        out[k] = most
    return out
