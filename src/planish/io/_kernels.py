# pyright: standard
"""Compiled inner loop of the working store: the next coarser level."""

import numpy as np

from planish.core.jit import njit


@njit(cache=True, nogil=True)
def halve(values, out, whole):
    """Means of 2 x 2 x 2 voxels into ``out``, exact to 32 bits, halves up; the last voxel of odd ends counts twice."""
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
                out[k, i, j] = np.floor(total / 8.0 + 0.5) if whole else total / 8.0
