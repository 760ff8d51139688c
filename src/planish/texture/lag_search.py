"""Regression of one map on others at every lag.

The share that they explain, and what unrelated maps reach.
"""

import math

import numpy as np
from scipy import fft, optimize, special

from planish.core.typing import Array, Bools, Complexes, Floats, Pair, Shape2D
from planish.texture.ncc import LEAST_PAIRS, Peak, overlap
from planish.texture.spectra import lags_within, padded_shape, padded_spectrum
from planish.texture.textures import centred, slopes_of, tile_sums

_BOTH_AXES = ((1, 2), (1, 2))  # rows and columns of two stacks of maps, to sum over


class LagSearch:
    """Regression of y (rows, cols) on the maps x (k, rows, cols) at every lag within ``wide``.

    All maps are standardised.

    ``share`` (2 n + 1, 2 m + 1) is R² at each lag, NaN where few pairs are left; ``height`` the
    same, less where pairs are fewer, as it is compared with chance. At the lag l, ``y[p + l]`` is
    explained by ``x[p]``; lag 0 is in the middle.
    """

    def __init__(self, x: Floats, y: Floats, is_valid: Bools, wide: Shape2D) -> None:
        """Correlate all maps at all lags, and solve the regressions.

        ``wide`` is the longest lag along rows and columns, in pixels. The products of the maps x
        with each other are those of the whole field at each lag.
        """
        self._x = x
        self._y = y
        self._is_valid = is_valid
        self._wide = wide
        self._size = padded_shape(y.shape, wide)
        mask = padded_spectrum(is_valid.astype(np.float64), self._size)
        self._y_hat = padded_spectrum(y, self._size)
        self._x_hat = np.stack([padded_spectrum(m, self._size) for m in x])
        pairs = np.rint(self._lags(np.abs(mask) ** 2))
        enough = pairs >= LEAST_PAIRS * pairs.max()
        # Mean products of each x with y, (k, 2 n + 1, 2 m + 1), and of the x with each other.
        products = [self._lags(np.conj(m) * self._y_hat) for m in self._x_hat]
        self._mean_products = np.stack(products) / np.maximum(pairs, 1.0)
        n = np.count_nonzero(is_valid)
        self._inner = np.tensordot(x, x, _BOTH_AXES) / n
        self._inverse = _inverse_of(self._inner)
        g = self._mean_products
        share = np.einsum("iyx,ij,jyx->yx", g, self._inverse, g)
        self.share: Floats = np.where(enough, share, np.nan)
        height = share * pairs / max(n, 1)
        self.height: Floats = np.where(enough, height, 0.0)

    def weights(self, lag_px: Shape2D) -> Floats:
        """Weights of the maps at a lag, (k,)."""
        return self._inverse @ self._products_at(lag_px)

    def share_of(self, subset: slice, lag_px: Shape2D) -> float:
        """R² at a lag with some of the maps only."""
        g = self._products_at(lag_px)[subset]
        inverse = _inverse_of(self._inner[subset, subset])
        return float(g @ inverse @ g)

    def limit(self, reach: Shape2D) -> float:
        """Height that unrelated textures exceed within reach in 1 of 1000 cases.

        ``reach`` are the half axes of the ellipse of lags, in pixels. Infinite without any texture.
        By chance R² over the variance of r is a chi-squared field over the lags, as rough as both
        spectra make it.
        """
        # Independent combinations of the maps, each of spread 1.
        values, vectors = np.linalg.eigh(self._inner)
        use = values > 1e-6 * values[-1]
        across = (vectors[:, use] / np.sqrt(values[use])).T
        n = float(np.count_nonzero(self._is_valid))
        power_y = np.abs(self._y_hat) ** 2
        power_y[:, 1:] *= 2.0
        combined_hat = np.tensordot(across, self._x_hat, 1)
        powers = np.abs(combined_hat) ** 2 * power_y
        # As in `relate`: the variance of r of y and each combination.
        largest = np.sum(powers, axis=(1, 2)).max()
        rows, cols = self._size
        variance = largest / (rows * cols * n**3)
        power = np.sum(powers, axis=0)
        total = np.sum(power)
        if not total > 0:
            return math.inf
        # Covariance of the slopes of r by lag: second moments of the angular frequencies, 1/pixel.
        wave_y = 2 * np.pi * fft.fftfreq(rows)[:, None]
        wave_x = 2 * np.pi * fft.rfftfreq(cols)
        yy = np.sum(power * (wave_y * wave_y)) / total
        xx = np.sum(power * (wave_x * wave_x)) / total
        yx = np.sum(power * (wave_y * wave_x)) / total
        root = math.sqrt(max(yy * xx - yx**2, 0.0))
        return float(variance * _chi2_limit(len(across), reach, root))

    def covariance(self, peak: Peak, pixel_um: Pair) -> Floats:
        """Covariance of the peak's place, (2, 2) in pixels squared, from the scatter of tiles.

        The slope of R²/2 at the peak is the mean of ``(m - R² y) grad y + e x·w`` over the pixels,
        with the fitted map m, the rest e = y - m and w = G⁻¹ times the slopes of the products of x
        and y: the second part is what the weights of the maps, which are fitted as well, add. Its
        sums over tiles of 150 um count as independent of each other.
        """
        x_slices, y_slices = overlap(self._y.shape, peak.lag_px)
        is_valid = self._is_valid[x_slices] & self._is_valid[y_slices]
        x = self._x[:, *x_slices]
        y = self._y[y_slices]
        slope_y, slope_x = slopes_of(self._y)
        slopes = np.where(is_valid, (slope_y[y_slices], slope_x[y_slices]), 0.0)
        n = np.count_nonzero(is_valid)
        fitted = np.tensordot(self.weights(peak.lag_px), x, 1)
        residual = np.where(is_valid, y - fitted, 0.0)
        slope_products = np.tensordot(slopes, x, _BOTH_AXES) / n
        weight_slopes = slope_products @ self._inverse  # w, (2, k)
        scores = (fitted - peak.r * y) * slopes
        scores += residual * np.tensordot(weight_slopes, x, 1)
        centred_scores = np.stack([centred(score, is_valid) for score in scores])
        score_sums = tile_sums(centred_scores, pixel_um, 150.0).reshape(2, -1)
        score_covariance = score_sums @ score_sums.T / n**2
        inverse_curvature = np.linalg.inv(-0.5 * peak.curvature)
        return inverse_curvature @ score_covariance @ inverse_curvature

    def _products_at(self, lag_px: Shape2D) -> Floats:
        row, col = np.add(lag_px, self._wide)
        return self._mean_products[:, row, col]

    def _lags(self, spectrum: Complexes | Floats) -> Floats:
        return lags_within(spectrum, self._size, self._wide)


def _inverse_of(inner: Floats) -> Array:
    """Inverse of the mean products of maps, without the combinations that are next to nothing."""
    return np.linalg.pinv(inner, rcond=1e-6, hermitian=True)


def _chi2_limit(k: int, reach: Shape2D, root: float) -> float:
    """Height that a smooth chi-square field of k degrees exceeds in 1 of 1000 cases.

    It does so in the ellipse ``reach``.

    By its expected Euler characteristic; ``root`` is the root of the determinant of the covariance
    of the slopes of the Gaussian fields that it is made of, per pixel squared.
    """
    # The ellipse's area and half of the circumference of a circle as large, in units of the field.
    area = math.pi * reach[0] * reach[1] * root
    half_round = math.pi * math.sqrt(reach[0] * reach[1] * root)

    def excess(u: float) -> float:
        # Densities of the Euler characteristic above u of dimension 0, 1 and 2 (Worsley 1994).
        log_scale = -u / 2 - special.gammaln(k / 2) - (k - 2) / 2 * math.log(2.0)
        scale = math.exp(log_scale)
        above = special.gammaincc(k / 2, u / 2)
        along = u ** ((k - 1) / 2) * scale / math.sqrt(2 * math.pi)
        over = u ** ((k - 2) / 2) * scale * (u - (k - 1)) / (2 * math.pi)
        expected = above + half_round * along + area * over
        # Unrelated textures give a lag so often; of those that are not alike everywhere, more do.
        return float(expected - 0.001)

    return float(optimize.brentq(excess, 2.0 * k + 2.0, 400.0))
