"""Spectra of maps that are padded by zeros, and the lags that products of spectra give."""

from collections.abc import Iterable, Sequence

import numpy as np
from scipy import fft

from planish.core.typing import Array, Complexes, Floats, Pair


def padded_shape(shape: Iterable[int], reach: Iterable[int]) -> tuple[int, ...]:
    """Shape at which lags within ``reach`` do not wrap, and that is transformed quickly."""
    return tuple(fft.next_fast_len(n + r, real=True) for n, r in zip(shape, reach, strict=True))


def padded_spectrum(values: Array, shape: Sequence[int]) -> Complexes:
    """What ``fft.rfft2(values, shape)`` gives, without a copy of the map with its zeros."""
    along_rows = np.asarray(fft.rfft(values, shape[1], axis=1))
    return np.asarray(fft.fft(along_rows, shape[0], axis=0, overwrite_x=True))


def wrapped_lags_um(shape: Sequence[int], pixel_um: Pair) -> list[Floats]:
    """Lags along rows and columns of what a product of spectra gives."""
    return [fft.fftfreq(n, 1.0 / n) * step for n, step in zip(shape, pixel_um, strict=True)]


def frequencies_of(shape: Sequence[int], pixel_um: Pair) -> Floats:
    """Waves a um of each term of ``fft.rfft2(values, shape)``."""
    along_y = fft.fftfreq(shape[0], pixel_um[0])
    along_x = fft.rfftfreq(shape[1], pixel_um[1])
    return np.hypot(along_y[:, None], along_x)


def lags_within(spectrum: Array, shape: Sequence[int], reach: Sequence[int]) -> Floats:
    """Lags ``-reach ... reach`` of the circular correlation with a spectrum of ``fft.rfft2``.

    Rows of other lags are not transformed back.
    """
    rows, cols = (np.arange(-r, r + 1) % n for r, n in zip(reach, shape, strict=True))
    by_row = np.asarray(fft.ifft(spectrum, axis=0))[rows]
    return np.asarray(fft.irfft(by_row, shape[1], axis=1), dtype=np.float64)[:, cols]
