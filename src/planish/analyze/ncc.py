"""Pearson's r of two maps with missing places at every lag, from a few Fourier transforms."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# At a lag where less than this share of the pairs is left, or of the variance, r is meaningless.
LEAST_PAIRS = 0.2
_LEAST_VARIANCE = 1e-9


class MaskedNcc:
    """Normalised cross-correlation with a map that stays, for many maps that come.

    Notes
    -----
    At the lag ``l``, r is that of the pairs ``a[p], b[p + l]`` where both are known: sums, squares and products over
    these pairs are correlations of maps and masks (Padfield 2012), so mean and variance are those of the overlap. The
    maps are padded by ``reach``: nothing wraps around.

    References
    ----------
    Padfield (2012), IEEE Trans. Image Process. 21, 2706, doi:10.1109/TIP.2011.2181402.
    """

    def __init__(self, a: Array, *, a_valid: Mask, b_valid: Mask, reach: tuple[int, int]) -> None:
        self._reach = reach
        self._shape = tuple(fft.next_fast_len(n + r, real=True) for n, r in zip(a.shape, reach, strict=True))
        self._b_valid = b_valid
        self._a_mean, self._a_sd = _mean_and_sd(a, a_valid)
        standard = np.where(a_valid, (a - self._a_mean) / self._a_sd, 0.0)
        self._mask_a = np.conj(self._transform(a_valid.astype(np.float64)))
        self._a = np.conj(self._transform(standard))
        mask_b = self._transform(b_valid.astype(np.float64))
        self.pairs: Array = np.rint(self._lags(self._mask_a * mask_b))
        enough = self.pairs >= max(LEAST_PAIRS * float(self.pairs.max()), 3.0)
        self._n = np.where(enough, self.pairs, np.nan)
        self._sum_a = self._lags(self._a * mask_b)
        self._var_a = self._lags(np.conj(self._transform(standard**2)) * mask_b) - self._sum_a**2 / self._n

    def __call__(self, b: Array) -> Array:
        """Return r at all lags, ``(2 reach + 1, 2 reach + 1)``, lag 0 in the middle; NaN where few pairs are left."""
        mean, sd = _mean_and_sd(b, self._b_valid)
        standard = np.where(self._b_valid, (b - mean) / sd, 0.0)
        b_hat = self._transform(standard)
        sum_b = self._lags(self._mask_a * b_hat)
        var_b = self._lags(self._mask_a * self._transform(standard**2)) - sum_b**2 / self._n
        product = self._lags(self._a * b_hat) - self._sum_a * sum_b / self._n
        least = _LEAST_VARIANCE * self._n
        known = (self._var_a > least) & (var_b > least)
        spread = np.sqrt(np.where(known, self._var_a, 1.0) * np.where(known, var_b, 1.0))
        return np.where(known, np.clip(product / spread, -1.0, 1.0), np.nan)

    def _transform(self, values: Array) -> NDArray[np.complex128]:
        return np.asarray(fft.rfft2(values, self._shape), dtype=np.complex128)

    def _lags(self, spectrum: NDArray[np.complex128]) -> Array:
        return cropped(np.asarray(fft.irfft2(spectrum, self._shape), dtype=np.float64), self._reach)


def cropped(circular: Array, reach: tuple[int, int]) -> Array:
    """Lags ``-reach ... reach`` of a circular correlation whose lag 0 is the first element."""
    rows, cols = (np.arange(-r, r + 1) for r in reach)
    return circular[np.ix_(rows % circular.shape[0], cols % circular.shape[1])]


def _mean_and_sd(values: Array, valid: Mask) -> tuple[float, float]:
    known = values[valid]
    if known.size == 0:
        return 0.0, 1.0
    sd = float(known.std())
    return float(known.mean()), sd if sd > 0 else 1.0
