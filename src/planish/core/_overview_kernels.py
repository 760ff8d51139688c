# pyright: standard
"""Compiled halving of maps and volumes.

Means over 2 x 2 pixels or 2 x 2 x 2 voxels, of truth values the majority.
"""

import numpy as np

from planish.core.jit import njit


@njit(cache=True, nogil=True)
def halve_values(values, out):
    """Means over the pixels that are finite; NaN where none is.

    ``values`` (rows, cols), ``out`` half as many of each, rounded up: the last row or column of an
    odd number stands alone.
    """
    # Without loops over the four, what is done for each pixel has no branch: this is seven times as
    # fast.
    rows, cols = values.shape
    for i in range(out.shape[0]):
        up = 2 * i
        pair = up + 1 < rows
        low = up + 1 if pair else up
        for j in range(cols // 2):
            a = np.float64(values[up, 2 * j])
            b = np.float64(values[up, 2 * j + 1])
            c = np.float64(values[low, 2 * j])
            d = np.float64(values[low, 2 * j + 1])
            p = np.isfinite(a)
            q = np.isfinite(b)
            r = pair and np.isfinite(c)
            s = pair and np.isfinite(d)
            total = (
                0.0 + (a if p else 0.0) + (b if q else 0.0) + (c if r else 0.0) + (d if s else 0.0)
            )
            count = p + q + r + s
            out[i, j] = total / count if count else np.nan
        if cols % 2:
            total = 0.0
            count = 0
            for y in range(up, low + 1):
                value = np.float64(values[y, cols - 1])
                if np.isfinite(value):
                    total += value
                    count += 1
            out[i, cols // 2] = total / count if count else np.nan


@njit(cache=True, nogil=True)
def halve_truth(values, out):
    """Whether half of the pixels are true; shapes as of :func:`halve_values`."""
    rows, cols = values.shape
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            true = 0
            count = 0
            for y in range(2 * i, min(2 * i + 2, rows)):
                for x in range(2 * j, min(2 * j + 2, cols)):
                    true += values[y, x]
                    count += 1
            out[i, j] = 2 * true >= count


@njit(cache=True, nogil=True)
def halve_voxels(values, out, whole):
    """Means of 2 x 2 x 2 voxels into ``out``, exact to 32 bits, halves up where ``whole``.

    ``values`` (z, y, x), ``out`` half as long along each axis, rounded up. The last voxel of odd
    ends counts twice.
    """
    depth, rows, cols = values.shape
    for k in range(out.shape[0]):
        k1 = min(2 * k + 1, depth - 1)
        for i in range(out.shape[1]):
            i1 = min(2 * i + 1, rows - 1)
            a = values[2 * k, 2 * i]
            b = values[2 * k, i1]
            c = values[k1, 2 * i]
            d = values[k1, i1]
            for j in range(out.shape[2]):
                p = 2 * j
                q = min(2 * j + 1, cols - 1)
                total = (np.float64(a[p]) + a[q] + b[p] + b[q]) + (
                    np.float64(c[p]) + c[q] + d[p] + d[q]
                )
                out[k, i, j] = np.floor(total / 8.0 + 0.5) if whole else total / 8.0
