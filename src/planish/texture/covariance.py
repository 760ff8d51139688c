"""Covariances of maps by lag, and how many independent points a correlation of two maps has.

Neighbouring points of a map resemble each other, so r of n points scatters like that of far fewer
independent ones. How many follows from the covariances of both maps at every lag, which masked
Fourier transforms give.
"""

import math
from collections.abc import Sequence
from itertools import combinations_with_replacement, product

import numpy as np
from scipy import fft

from planish.core.grid import shorter_side_um
from planish.core.typing import Array, Bools, Complexes, Floats, Pair, Shape2D
from planish.texture.spectra import padded_shape, padded_spectrum, wrapped_lags_um
from planish.texture.textures import centred, influence_on_r, standard

BANDWIDTH = 0.15
"""Share of the shorter side: how far points are taken to add to r together in the second
opinion."""


class Lags:
    """Sums over all pairs of known points of a mask (rows, cols).

    They are taken at every lag up to half of the field.
    """

    def __init__(self, is_valid: Bools, pixel_um: Pair) -> None:
        """Count the pairs of known points at every lag, and sort lags into rings of distance.

        Arrays over lags are wrapped: from 0 up, then the negative ones. ``inside`` holds where a
        lag is within half of the field, and ``pairs`` is 0 elsewhere.
        """
        self.is_valid = is_valid
        self.pixel_um = pixel_um
        self.n = int(np.count_nonzero(is_valid))
        reach = [int(0.5 * k) for k in is_valid.shape]  # longer lags have too few pairs of points
        self._size = padded_shape(is_valid.shape, reach)
        self.lag_um = wrapped_lags_um(self._size, pixel_um)
        down_um, across_um = self.lag_um
        down_reach_um, across_reach_um = np.multiply(reach, pixel_um)
        is_near_down = np.abs(down_um) <= down_reach_um
        is_near_across = np.abs(across_um) <= across_reach_um
        self.inside = np.logical_and.outer(is_near_down, is_near_across)
        self.distance_um = np.hypot(down_um[:, None], across_um)
        # Rings one pixel wide.
        ring = np.rint(self.distance_um / max(pixel_um))
        self._ring = ring.astype(np.intp)
        self._mask = self.transform(is_valid.astype(np.float64))
        mask_products = self._back(np.abs(self._mask) ** 2)
        # They are whole but for rounding.
        self.pairs = np.rint(mask_products) * self.inside

    def transform(self, values: Floats) -> Complexes:
        """Fourier transform of a map that is 0 where it is not known."""
        return padded_spectrum(values, self._size)

    def own_products(self, values: Array) -> Floats:
        """Sums of products of a map (rows, cols), less its mean, with itself."""
        spectrum = self.transform(centred(values, self.is_valid))
        return self.products(spectrum, spectrum)

    def products(self, a: Complexes, b: Complexes) -> Floats:
        """Sums of a at a point times b at a lag from it, for every lag (wrapped, as ``pairs``)."""
        return self._back(np.conj(a) * b) * self.inside

    def until_zero(self, products: Floats) -> Bools:
        """Lags up to the first distance at which the mean product changes its sign.

        The mean is over all directions.
        """
        ring_sums = np.bincount(self._ring[self.inside], products[self.inside])
        is_turned = ring_sums <= 0.0 if ring_sums[0] >= 0 else ring_sums >= 0.0
        turned = np.flatnonzero(is_turned)
        if not turned.size:
            return self.inside
        return self.inside & (self._ring < turned[0])

    def covariance(self, products: Floats, used: Bools) -> Floats:
        """Covariance at the lags that are used, 0 at others.

        Taking off a map's own mean takes that mean's variance off every covariance. It is put back:
        the variance of the mean that the covariances used have themselves.
        """
        pairs = np.where(used, self.pairs, 0.0)
        rest = self.n**2 - pairs.sum()
        variance_of_mean = products[used].sum() / rest if rest > 0 else 0.0
        covariance = products / np.maximum(pairs, 1.0) + variance_of_mean
        return np.where(pairs > 0, covariance, 0.0)

    def variance_of_mean(self, covariance: Floats) -> float:
        """Variance of the mean of values with this covariance over the known points."""
        return float(np.sum(self.pairs * covariance)) / self.n**2

    def sums(self, covariance: Floats) -> Floats:
        """Sum of the covariances of each known point with all known points.

        It has the shape of the mask, and is 0 outside of it.
        """
        rows, cols = self.is_valid.shape
        spectrum = fft.rfft2(covariance) * self._mask
        covariance_sums = self._back(spectrum)[:rows, :cols]
        return np.where(self.is_valid, covariance_sums, 0.0)

    def _back(self, spectrum: Complexes) -> Floats:
        return fft.irfft2(spectrum, self._size)


def covariance_of(values: Array, lags: Lags) -> Floats:
    """Covariance of a map (rows, cols) with itself by lag, up to its first zero.

    It is taken over the mask of ``lags``.
    """
    products = lags.own_products(values)
    return lags.covariance(products, lags.until_zero(products))


def scatter_of(values: Array, lags: Lags) -> tuple[float, float]:
    """Variance of a map, and the independent points of its mean.

    What the removal of the mean took is put back into the variance.
    """
    covariance = covariance_of(values, lags)
    variance = float(covariance[0, 0])
    variance_of_mean = lags.variance_of_mean(covariance)
    if not variance_of_mean > 0:
        return variance, math.nan
    return variance, min(variance / variance_of_mean, float(lags.n))


class PairCovariances:
    """Covariances of two maps (rows, cols), with themselves and with each other, by lag.

    They are taken over the mask of ``lags``.
    """

    def __init__(self, x: Floats, y: Floats, lags: Lags) -> None:
        """Take the covariances of both maps at all lags, cut where each first turns to zero.

        ``variances`` are those of the maps as they are, without what the mean took.
        """
        self.lags = lags
        self._maps = [centred(m, lags.is_valid) for m in (x, y)]
        a, b = (lags.transform(m) for m in self._maps)
        products_x = lags.products(a, a)
        products_y = lags.products(b, b)
        used_x = lags.until_zero(products_x)
        used_y = lags.until_zero(products_y)
        self.xx = lags.covariance(products_x, used_x)
        self.yy = lags.covariance(products_y, used_y)
        # For the interval all are cut alike: where r is large they nearly cancel each other.
        products = (products_x, products_y, lags.products(a, b))
        self._together = [lags.covariance(p, used_x | used_y) for p in products]
        # Of single points: the mean product at lag 0, as it is and with the variance of the mean.
        variance_x = products_x[0, 0] / lags.n
        variance_y = products_y[0, 0] / lags.n
        self.variances = (variance_x, variance_y)
        # What the covariances have got back of the variance of the mean.
        self._put_back = (self.xx[0, 0] - variance_x, self.yy[0, 0] - variance_y)

    def variance_of_r(self, variances: Pair | None = None) -> float:
        """Variance of r of unrelated maps (Dutilleul 1993).

        It is the trace of the product of both matrices of covariance, each with rows and columns
        centred, over the product of their traces. NaN where that is not positive.

        ``variances``: of single points, where maps are means.
        """
        n = self.lags.n
        # Sums over a row of each matrix: each point's covariances with all.
        rows_x = self.lags.sums(self.xx)
        rows_y = self.lags.sums(self.yy)
        sums = (rows_x.sum(), rows_y.sum())
        trace = np.sum(self.lags.pairs * self.xx * self.yy)
        trace -= 2.0 / n * np.sum(rows_x * rows_y)
        trace += math.prod(sums) / n**2
        product = math.prod(n * self._whole(variances) - np.divide(sums, n))
        return float(trace / product) if product > 0 else math.nan

    def _whole(self, variances: Pair | None) -> Floats:
        """Variances of both maps with what was put back into their covariances."""
        return np.add(variances or self.variances, self._put_back)

    def n_eff(self, n: int, variances: Pair | None = None) -> float:
        """Independent points, at most ``n``, that would give r of unrelated maps this variance.

        NaN if unknown.
        """
        variance = self.variance_of_r(variances)
        return min(1 + 1 / variance, float(n)) if variance > 0 else math.nan

    def variance_of_z(self, r: float, variances: Pair | None = None) -> float:
        """Variance of Fisher's z of r of two jointly Gaussian maps (Bartlett's formula).

        The maps have these covariances.
        """
        influence = self._influence(r, variances)
        return float(influence.sum() / self.lags.n**2)

    def spatial_error(self, r: float) -> Pair:
        """Standard error of z from what the points add to r, and the same over that of the model.

        Both are sums over lags up to ``BANDWIDTH`` with weights that fall to 0 (Conley 1999), so
        that what longer lags would add, and what the mean of a map takes off, are the same in both.
        """
        lags = self.lags
        bandwidth_um = BANDWIDTH * shorter_side_um(lags.is_valid.shape, lags.pixel_um)
        x, y = (standard(m, lags.is_valid) for m in self._maps)
        influence_hat = lags.transform(influence_on_r(x, y, r))
        weight = np.maximum(1.0 - lags.distance_um / bandwidth_um, 0.0)
        model = self._influence(r, None)
        # What the points add to r sums to 0: every pair has lost the same part of the model's sum.
        mean_weight = np.sum(weight * lags.pairs) / lags.n**2
        model_variance = np.sum(weight * model) - model.sum() * mean_weight
        observed = np.sum(weight * lags.products(influence_hat, influence_hat))
        # From r to z: dz = dr / (1 - r^2).
        observed_variance = observed / (1 - r * r) ** 2
        error = math.sqrt(max(observed_variance, 0.0))
        ratio = error / math.sqrt(model_variance) if model_variance > 0 else 1.0
        return error / lags.n, ratio

    def unevenness(self, r: float) -> float:
        """How much larger the first of these errors is than the second; not below 1."""
        if not 1 - r**2 > 1e-14:
            return 1.0
        return max(self.spatial_error(r)[1], 1.0)

    def _influence(self, r: float, variances: Pair | None) -> Floats:
        """Bartlett's terms of the variance of z at every lag, times the pairs there.

        Their sum over n² is the variance. ``variances`` are those of single points, the maps' own
        where None.
        """
        variance_x, variance_y = self._whole(variances)
        cov_xx, cov_yy, cov_xy = self._together
        xx = cov_xx / variance_x
        yy = cov_yy / variance_y
        xy = cov_xy / math.sqrt(variance_x * variance_y)
        yx = _reversed(xy)
        squares = xx**2 + yy**2 + xy**2 + yx**2
        products = xx * yy + xy * yx
        terms = products - r * (xx + yy) * (xy + yx) + r * r / 2 * squares
        return self.lags.pairs * terms / (1 - r * r) ** 2


def variance_of_products(
    maps: Sequence[Floats], terms: Sequence[tuple[int, int, float]], lags: Lags
) -> float:
    """Variance of the mean of a sum of products of jointly Gaussian maps.

    It is computed from their covariances by lag.

    The maps (rows, cols) have mean 0 and variance 1 over the mask of ``lags`` and are 0 outside of
    it; ``terms`` are numbers of two maps and the weight of their product.
    """
    spectra = [lags.transform(m) for m in maps]
    covariances: dict[Shape2D, Floats] = {}
    for i, j in combinations_with_replacement(range(len(maps)), 2):
        products = lags.products(spectra[i], spectra[j])
        # Lags in opposite directions, which differ for two maps, are cut alike.
        used = lags.until_zero(products + _reversed(products))
        covariances[i, j] = lags.covariance(products, used)
        covariances[j, i] = _reversed(covariances[i, j])
    # A covariance that got its mean's variance back is not quite 1 at lag 0.
    variances = [covariances[i, i][0, 0] for i in range(len(maps))]
    sd = np.sqrt(variances)
    total = np.zeros_like(lags.pairs)
    for (i, j, v), (k, m, w) in product(terms, repeat=2):
        # Isserlis: of Gaussian maps the covariance of products is one of pairs.
        pairs = covariances[i, k] * covariances[j, m]
        pairs += covariances[i, m] * covariances[j, k]
        weight = v * w / np.prod(sd[[i, j, k, m]])
        total += weight * pairs
    return lags.variance_of_mean(total)


def _reversed(values: Floats) -> Floats:
    """Turn an array over wrapped lags: the value at minus each lag."""
    # Turned round, lag 0 is last; it goes to the front again.
    return np.roll(np.flip(values), (1, 1), (0, 1))
