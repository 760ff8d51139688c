# pyright: standard
"""Compiled inner loop of the working store: the next coarser level."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def halve(values, out):
    """Means of 2 x 2 x 2 voxels into ``out``; at an odd end the last voxel counts twice. Integers are rounded."""
    depth, rows, cols = values.shape
    for k in range(out.shape[0]):
        k1 = min(2 * k + 1, depth - 1)
        for i in range(out.shape[1]):
            i1 = min(2 * i + 1, rows - 1)
            a, b = values[2 * k, 2 * i], values[2 * k, i1]
            c, d = values[k1, 2 * i], values[k1, i1]
            for j in range(out.shape[2]):
                p, q = 2 * j, min(2 * j + 1, cols - 1)
                total = (np.float64(a[p]) + a[q] + b[p] + b[q]) + (np.float64(c[p]) + c[q] + d[p] + d[q])
                out[k, i, j] = total / 8.0


@njit(cache=True, nogil=True)
def halve_whole(values, out):
    """The same for integers, of up to 32 bits: exact halves are rounded up."""
    depth, rows, cols = values.shape
    for k in range(out.shape[0]):
        k1 = min(2 * k + 1, depth - 1)
        for i in range(out.shape[1]):
            i1 = min(2 * i + 1, rows - 1)
            a, b = values[2 * k, 2 * i], values[2 * k, i1]
            c, d = values[k1, 2 * i], values[k1, i1]
            for j in range(out.shape[2]):
                p, q = 2 * j, min(2 * j + 1, cols - 1)
                total = np.int64(a[p]) + np.int64(a[q]) + np.int64(b[p]) + np.int64(b[q])
                total += np.int64(c[p]) + np.int64(c[q]) + np.int64(d[p]) + np.int64(d[q])
                out[k, i, j] = (total + 4) >> 3
