# pyright: standard
"""Compiled envelopes: a paraboloid rolled over a height field.

Line by line, in time linear in the nodes.
"""

import numpy as np

from planish.core.jit import njit


def rolled(height, pitch_um, radius_um):
    """Close a height field from above with a ball, taken as the paraboloid of its curvature.

    Where gaps are narrower than half the radius it differs from the ball by less than 2 % of what
    is bridged. Of ``height``, (rows, cols) in um, outwards, and NaN where unknown, where the ball
    may dip, with a ``pitch_um`` along rows and columns: the lowest that the ball reaches, (rows,
    cols) in um; NaN where ``height`` is.
    """
    rises = [p * p / (2 * radius_um) for p in pitch_um]
    known = np.isfinite(height)
    dilated = -_lowest(np.where(known, -height, np.inf), *rises)
    return np.where(known, _lowest(dilated, *rises), np.nan)


@njit(cache=True, nogil=True)
def _lower(f, a, out, at, edge):
    """out[x] = min over y of f[y] + a (x - y)^2, the lower envelope of parabolas.

    ``f`` and ``out`` are (n,) in um, ``a`` in um per squared node; inf counts for nothing. ``at``
    and ``edge``, (n,), are room to work: the node of each parabola that is part of the envelope,
    and from which x on it is.
    """
    n = f.size
    k = -1  # the last parabola of the envelope of those up to y
    for y in range(n):
        if not np.isfinite(f[y]):
            continue
        cut = -np.inf
        # From the cut with it on, the new parabola is lower; one that begins behind is nowhere.
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
def _lowest(field, first, second):
    """Minimum over all nodes of height plus a paraboloid that rises by first i^2 + second j^2.

    ``field`` is (rows, cols) in um, ``i`` and ``j`` count rows and columns from the paraboloid's
    middle. Inf is nothing. The paraboloid is a sum, and so the minimum is one along each row and
    then one along each column.
    """
    rows, cols = field.shape
    half = np.empty(field.shape)
    turned = np.empty((cols, rows))
    at = np.empty(max(rows, cols), np.int64)
    edge = np.empty(max(rows, cols))
    for i in range(rows):
        _lower(field[i], second, half[i], at, edge)
    lines = np.ascontiguousarray(half.T)
    for j in range(cols):
        _lower(lines[j], first, turned[j], at, edge)
    return np.ascontiguousarray(turned.T)
