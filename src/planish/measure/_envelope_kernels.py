# pyright: standard
"""Compiled envelopes: a paraboloid rolled over a height field, line by line, in time linear in the nodes."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def _lower(f, a, out, at, edge):
    """out[x] = min over y of f[y] + a (x - y)^2, the lower envelope of parabolas; inf counts for nothing."""
    n = f.size
    k = -1
    for y in range(n):
        if not np.isfinite(f[y]):
            continue
        cut = -np.inf
        while k >= 0:
            v = at[k]
            cut = ((f[y] + a * y * y) - (f[v] + a * v * v)) / (2 * a * (y - v))
            if cut > edge[k]:
                break
            k -= 1
        k += 1
        at[k] = y
        edge[k] = cut if k > 0 else -np.inf
    if k < 0:
        out[:] = np.inf
        return
    last = k
    k = 0
    for x in range(n):
        while k < last and edge[k + 1] < x:
            k += 1
        d = x - at[k]
        out[x] = f[at[k]] + a * d * d


@njit(cache=True, nogil=True)
def lowest(field, first, second):
    """Minimum over all nodes of height plus a paraboloid.

    Parameters
    ----------
    field : (rows, cols)
        inf where there is nothing.
    first, second : float
        The paraboloid rises by first * i^2 + second * j^2 over i rows and j columns.

    Returns
    -------
    (rows, cols)
    """
    rows, cols = field.shape
    half = np.empty(field.shape)
    out = np.empty(field.shape)
    at, edge = np.empty(max(rows, cols), np.int64), np.empty(max(rows, cols))
    for i in range(rows):
        _lower(field[i], second, half[i], at, edge)
    line, result = np.empty(rows), np.empty(rows)
    for j in range(cols):
        for i in range(rows):
            line[i] = half[i, j]
        _lower(line, first, result, at, edge)
        for i in range(rows):
            out[i, j] = result[i]
    return out
