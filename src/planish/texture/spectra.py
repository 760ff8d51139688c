"""Spectra of maps that are padded by zeros, and the lags that products of spectra give."""

from collections.abc import Sequence

import numpy as np
from scipy import fft

from planish.core.typing import Array, Complexes, Floats, Pair, Shape


def padded_shape(shape: Sequence[int], reach: Sequence[int]) -> Shape:
    """Shape at which lags within ``reach`` do not wrap, and that is transformed quickly.

    Both are rows and columns, in pixels.
    """
    lengths = np.add(shape, reach).tolist()
    return tuple(fft.next_fast_len(n, real=True) for n in lengths)


def padded_spectrum(values: Array, shape: Sequence[int]) -> Complexes:
    """What ``fft.rfft2(values, shape)`` gives, without a copy of the map with its zeros."""
    along_rows = fft.rfft(values, shape[1], axis=1)
    return fft.fft(along_rows, shape[0], axis=0, overwrite_x=True)


def wrapped_lags_um(shape: Sequence[int], pixel_um: Pair) -> list[Floats]:
    """Lags along rows and columns of what a product of spectra gives.

    First those from 0 up, then the negative ones.
    """
    axes = zip(shape, pixel_um, strict=True)
    return [fft.fftfreq(n, 1.0 / n) * pitch_um for n, pitch_um in axes]


def frequencies_of(shape: Sequence[int], pixel_um: Pair) -> Floats:
    """Waves a um of each term of ``fft.rfft2(values, shape)``."""
    along_y = fft.fftfreq(shape[0], pixel_um[0])
    along_x = fft.rfftfreq(shape[1], pixel_um[1])
    return np.hypot(along_y[:, None], along_x)


def lags_within(spectrum: Array, shape: Sequence[int], reach: Sequence[int]) -> Floats:
    """Lags ``-reach ... reach`` of the circular correlation with a spectrum of ``fft.rfft2``.

    Rows of other lags are not transformed back. ``shape`` is that of the padded maps, longer than
    the reach. Gives (2 reach + 1, 2 reach + 1) with lag 0 in the middle.
    """
    # Negative lags stand at the end, where negative indices find them.
    down, across = (np.arange(-r, r + 1) for r in reach)
    by_row = fft.ifft(spectrum, axis=0)[down]
    lags = fft.irfft(by_row, shape[1], axis=1)[:, across]
    return lags.astype(np.float64)
