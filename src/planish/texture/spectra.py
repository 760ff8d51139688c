"""Spectra of maps that are padded by zeros, and the lags that products of spectra give."""

from collections.abc import Iterable, Sequence

import numpy as np
from scipy import fft

from planish.core.typing import Array, Complexes, Floats


def padded_shape(shape: Iterable[int], reach: Iterable[int]) -> tuple[int, ...]:
    """Shape at which lags within ``reach`` do not wrap, and that is transformed quickly."""
    return tuple(fft.next_fast_len(n + r, real=True) for n, r in zip(shape, reach, strict=True))


def padded_spectrum(values: Array, shape: Sequence[int]) -> Complexes:
    """What ``fft.rfft2(values, shape)`` gives, without a copy of the map with its zeros."""
    along_rows = np.asarray(fft.rfft(values, shape[1], axis=1))
    return np.asarray(fft.fft(along_rows, shape[0], axis=0, overwrite_x=True))


def lags_within(spectrum: Array, shape: Sequence[int], reach: Sequence[int]) -> Floats:
    """Lags ``-reach ... reach`` of the circular correlation with a spectrum of ``fft.rfft2``.

    Rows of other lags are not transformed back.
    """
    rows, cols = (np.arange(-r, r + 1) % n for r, n in zip(reach, shape, strict=True))
    by_row = np.asarray(fft.ifft(spectrum, axis=0))[rows]
    return np.asarray(fft.irfft(by_row, shape[1], axis=1), dtype=np.float64)[:, cols]
