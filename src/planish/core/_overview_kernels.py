# pyright: standard
"""Compiled halving of maps: the mean over each 2 x 2 pixels, and of truth values the majority."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def halve_values(values, out):
    """Means over the pixels that are finite; NaN where none is."""
    rows, cols = values.shape
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            total, count = 0.0, 0
            for y in range(2 * i, min(2 * i + 2, rows)):
                for x in range(2 * j, min(2 * j + 2, cols)):
                    value = np.float64(values[y, x])
                    if np.isfinite(value):
                        total += value
                        count += 1
            out[i, j] = total / count if count else np.nan


@njit(cache=True, nogil=True)
def halve_truth(values, out):
    """Whether half of the pixels are true."""
    rows, cols = values.shape
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            true, count = 0, 0
            for y in range(2 * i, min(2 * i + 2, rows)):
                for x in range(2 * j, min(2 * j + 2, cols)):
                    true += values[y, x]
                    count += 1
            out[i, j] = 2 * true >= count
