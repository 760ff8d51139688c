# pyright: standard
"""Compiled inner loops of fibre orientation: in-plane filters and the sums of the structure tensor."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def filtered(grey, taps, axis):
    """Correlate (rows, cols, samples) float32 with taps (odd number) along rows (0) or columns (1).

    What lies beyond the border repeats the last line.
    """
    rows, cols, count = grey.shape
    half = taps.size // 2
    out = np.zeros(grey.shape, np.float32)
    for i in range(rows):
        for j in range(cols):
            for t in range(taps.size):
                w = taps[t]
                if axis == 0:
                    a, b = min(max(i + t - half, 0), rows - 1), j
                else:
                    a, b = i, min(max(j + t - half, 0), cols - 1)
                for k in range(count):
                    out[i, j, k] += w * grey[a, b, k]
    return out


@njit(cache=True, nogil=True)
def tensor_sums(by_row, by_col, grey, s, lower, upper, level, polarity):
    """Sums over each ray of the products of the gradient, where there is matter between two places.

    Parameters
    ----------
    by_row, by_col, grey : (rows, cols, samples) float32
        Gradient along rows and columns, and the grey itself; NaN where it is not known.
    s : (samples,)
        um.
    lower, upper : (rows, cols)
        um; upper does not belong to it.
    level, polarity : float
        Matter is where polarity (grey - level) > 0.

    Returns
    -------
    (3, rows, cols)
        Of the squares along columns, along rows, and of the mixed product.
    """
    rows, cols, count = grey.shape
    out = np.zeros((3, rows, cols))
    for i in range(rows):
        for j in range(cols):
            xx, yy, xy = 0.0, 0.0, 0.0
            for k in range(count):
                if lower[i, j] <= s[k] < upper[i, j] and polarity * (float(grey[i, j, k]) - level) > 0:
                    x, y = float(by_col[i, j, k]), float(by_row[i, j, k])
                    xx += x * x
                    yy += y * y
                    xy += x * y
            out[0, i, j], out[1, i, j], out[2, i, j] = xx, yy, xy
    return out
