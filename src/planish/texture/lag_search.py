"""Regression of one map on others at every lag.

The share that they explain, and what unrelated maps reach.
"""

import math

import numpy as np
from scipy import fft, optimize, special

from planish.core.typing import Bools, Complexes, Floats, Pair, Shape2D
from planish.texture.ncc import LEAST_PAIRS, Peak, overlap
from planish.texture.spectra import lags_within, padded_shape, padded_spectrum
from planish.texture.textures import centred, tile_sums


class LagSearch:
    """Regression of y (rows, cols) on the maps x (k, rows, cols) at every lag within ``wide``.

    All maps are standardised.

    ``share`` (2 n + 1, 2 m + 1) is R² at each lag, NaN where few pairs are left; ``height`` the
    same, less where pairs are fewer, as it is compared with chance.
    """

    def __init__(self, x: Floats, y: Floats, is_valid: Bools, wide: Shape2D) -> None:
        """Correlate all maps at all lags, and solve the regressions."""
        self._x, self._y, self._is_valid, self._wide = x, y, is_valid, wide
        self._size = padded_shape(y.shape, wide)
        mask = padded_spectrum(is_valid.astype(np.float64), self._size)
        self._y_hat = padded_spectrum(y, self._size)
        self._x_hat = np.stack([padded_spectrum(m, self._size) for m in x])
        pairs = np.rint(self._lags(np.abs(mask) ** 2))
        enough = pairs >= LEAST_PAIRS * pairs.max()
        products = [self._lags(np.conj(m) * self._y_hat) for m in self._x_hat]
        self._g = np.stack(products) / np.maximum(pairs, 1.0)
        n = int(np.count_nonzero(is_valid))
        self._inner = np.tensordot(x, x, ((1, 2), (1, 2))) / n
        self._inverse = np.linalg.pinv(self._inner, rcond=1e-6, hermitian=True)
        share = np.einsum("iyx,ij,jyx->yx", self._g, self._inverse, self._g)
        self.share: Floats = np.where(enough, share, np.nan)
        self.height: Floats = np.where(enough, share * pairs / max(n, 1), 0.0)

    def weights(self, lag_px: Shape2D) -> Floats:
        """Weights of the maps at a lag, (k,)."""
        return self._inverse @ self._products_at(lag_px)

    def share_of(self, subset: slice, lag_px: Shape2D) -> float:
        """R² at a lag with some of the maps only."""
        g = self._products_at(lag_px)[subset]
        inverse = np.linalg.pinv(self._inner[subset, subset], rcond=1e-6, hermitian=True)
        return float(g @ inverse @ g)

    def limit(self, reach: Shape2D) -> float:
        """Height that unrelated textures exceed within reach in 1 of 1000 cases."""
        # Independent combinations of the maps, each of spread 1.
        values, vectors = np.linalg.eigh(self._inner)
        use = values > 1e-6 * values[-1]
        across = (vectors[:, use] / np.sqrt(values[use])).T
        n = float(np.count_nonzero(self._is_valid))
        power_y = np.abs(self._y_hat) ** 2
        power_y[:, 1:] *= 2.0
        powers = np.abs(np.tensordot(across, self._x_hat, 1)) ** 2 * power_y
        # As in `relate`.
        largest = np.sum(powers, axis=(1, 2)).max()
        rows, cols = self._size
        variance = largest / (rows * cols * n**3)
        fy = 2 * np.pi * fft.fftfreq(rows)[:, None]
        fx = 2 * np.pi * fft.rfftfreq(cols)
        power = np.sum(powers, axis=0)
        total = np.sum(power)
        if not total > 0:
            return math.inf
        yy, xx, yx = (np.sum(power * m) / total for m in (fy * fy, fx * fx, fy * fx))
        root = math.sqrt(max(yy * xx - yx**2, 0.0))
        return float(variance * _chi2_limit(len(across), reach, root))

    def covariance(self, peak: Peak, pixel_um: Pair) -> Floats:
        """Covariance of the peak's place, (2, 2) in pixels squared, from the scatter of tiles.

        The slope of R²/2 at the peak is the mean of ``(m - R² y) grad y + e x·w`` over the pixels,
        with the fitted map m, the rest e = y - m and w = G⁻¹ times the slopes of the products of x
        and y: the second part is what the weights of the maps, which are fitted as well, add.
        """
        x_slices, y_slices = overlap(self._y.shape, peak.lag_px)
        is_valid = self._is_valid[x_slices] & self._is_valid[y_slices]
        x = self._x[:, *x_slices]
        y = self._y[y_slices]
        gradients = [np.gradient(self._y, axis=axis)[y_slices] for axis in (0, 1)]
        slopes = np.where(is_valid, gradients, 0.0)
        n = int(np.count_nonzero(is_valid))
        fitted = np.tensordot(self.weights(peak.lag_px), x, 1)
        residual = np.where(is_valid, y - fitted, 0.0)
        w = np.tensordot(slopes, x, ((1, 2), (1, 2))) / n @ self._inverse  # (2, k)
        scores = (fitted - peak.r * y) * slopes + residual * np.tensordot(w, x, 1)
        scores = np.stack([centred(score, is_valid) for score in scores])
        score_sums = tile_sums(scores, pixel_um, 150.0).reshape(2, -1)
        inverse_curvature = np.linalg.inv(-0.5 * peak.curvature)
        return inverse_curvature @ (score_sums @ score_sums.T / n**2) @ inverse_curvature

    def _products_at(self, lag_px: Shape2D) -> Floats:
        row, col = np.add(lag_px, self._wide)
        return self._g[:, row, col]

    def _lags(self, spectrum: Complexes | Floats) -> Floats:
        return lags_within(spectrum, self._size, self._wide)


def _chi2_limit(k: int, reach: Shape2D, root: float) -> float:
    """Height that a smooth chi-square field of k degrees exceeds in 1 of 1000 cases.

    It does so in the ellipse ``reach``.

    By its expected Euler characteristic; ``root`` is the root of the determinant of the covariance
    of the slopes of the Gaussian fields that it is made of, per pixel squared.
    """
    area = math.pi * reach[0] * reach[1] * root
    half_round = math.pi * math.sqrt(reach[0] * reach[1] * root)

    def excess(u: float) -> float:
        scale = math.exp(-u / 2 - special.gammaln(k / 2) - (k - 2) / 2 * math.log(2.0))
        along = u ** ((k - 1) / 2) * scale / math.sqrt(2 * math.pi)
        over = u ** ((k - 2) / 2) * scale * (u - (k - 1)) / (2 * math.pi)
        expected = special.gammaincc(k / 2, u / 2) + half_round * along + area * over
        # Unrelated textures give a lag so often; of those that are not alike everywhere, more do.
        return float(expected - 0.001)

    return float(optimize.brentq(excess, 2.0 * k + 2.0, 400.0))
