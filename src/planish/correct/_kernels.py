# pyright: standard
"""Compiled inner loop: the correction of a block."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def corrected(values, out, tables, at, cup, air, missing, low, high, whole):
    """Correct a block into ``out`` and return how many of its voxels had to be clipped.

    Parameters
    ----------
    values, out : (a, p, q)
        The first axis is the axis of rotation.
    tables : (a, bins)
        Grey to take off at a radius, for each slice.
    at : (p, q)
        Radius in bins, counted from the middle of the first.
    cup : (p, q)
        Factor on what is above ``air``.
    missing : float
        Value that stays as it is; NaN for none.
    low, high : float
        Range of the type.
    whole : bool
        Whether values are rounded.
    """
    clipped = 0
    last = tables.shape[1] - 1
    for k in range(values.shape[0]):
        for i in range(values.shape[1]):
            for j in range(values.shape[2]):
                v = np.float64(values[k, i, j])
                if v == missing or not np.isfinite(v):
                    out[k, i, j] = values[k, i, j]
                    continue
                x = min(max(at[i, j], 0.0), np.float64(last))
                b = min(int(x), last - 1)
                f = x - b
                ring = tables[k, b] * (1.0 - f) + tables[k, b + 1] * f
                v = air + (v - ring - air) / cup[i, j]
                if whole:
                    v = np.rint(v)
                if v < low:
                    v = low
                    clipped += 1
                elif v > high:
                    v = high
                    clipped += 1
                out[k, i, j] = v
    return clipped
