# pyright: standard
"""Compiled inner loops of the checks: sums over pairs of neighbouring slices."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def add_pairs(part, square, product):
    """Add what a part of a window tells of how slices differ.

    Parameters
    ----------
    part : (slices, rows, cols) float32
    square : (slices - 1,)
        Sums of (a[k + 1] - a[k])²; added to.
    product : (slices - 2,)
        Sums of (a[k + 1] - a[k]) (a[k + 2] - a[k + 1]); added to.
    """
    slices, rows, cols = part.shape
    before = np.empty(cols, dtype=np.float32)
    for i in range(rows):
        before[:] = 0
        for k in range(slices - 1):
            s = 0.0
            p = 0.0
            for j in range(cols):
                u = part[k + 1, i, j] - part[k, i, j]
                s += u * u
                p += u * before[j]
                before[j] = u
            square[k] += s
            if k:
                product[k - 1] += p
