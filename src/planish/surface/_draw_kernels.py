# pyright: standard
"""Compiled inner loop of the corrections.

It seeks an edge whose levels are free, close to where it is expected.
"""

from math import ceil, floor, isfinite

import numpy as np

from planish.core.jit import njit
from planish.surface._fit_kernels import _bell, _step, is_finite

_PER_VOXEL = 4  # places that are tried
_RIDGE = 1e-6


@njit(cache=True, nogil=True)
def _blurred(x, w, fringe, ratio):
    outer, _ = _step(x / w)
    if fringe > 0.0:
        y = ratio * x / w
        outer += fringe * y * _bell(y)
    return outer


@njit(cache=True, nogil=True)
def _misfit(g, lo, hi, w, at, other, fringe, ratio):
    """Squares left by levels on both sides of ``at`` and beyond ``other`` (NaN: none).

    And the rise at ``at``: the step of the level there, inwards. The levels are those that fit
    g[lo:hi+1] best, whose edges are blurred by ``w``.
    """
    m = np.zeros((3, 3))
    r = np.zeros(3)
    x = np.ones(3)
    squares = 0.0
    n = 3 if isfinite(other) else 2
    for d in range(lo, hi + 1):
        x[1] = _blurred(d - at, w, fringe, ratio)
        if n == 3:
            x[2] = _blurred(d - other, w, fringe, ratio)
        for i in range(n):
            r[i] += x[i] * g[d]
            for j in range(n):
                m[i, j] += x[i] * x[j]
        squares += g[d] * g[d]
    for i in range(n):
        m[i, i] += _RIDGE
    levels = np.linalg.solve(m[:n, :n], r[:n])
    for i in range(n):
        squares -= levels[i] * r[i]
    return max(squares, 0.0), levels[1]


@njit(cache=True, nogil=True)
def draw_edges(
    columns,
    expected,
    error,
    band,
    other,
    rides,
    sign,
    width,
    noise,
    least,
    gain,
    fringe,
    ratio,
    result,
):
    """Find one edge of every column near the place where it is expected.

    columns  : (n, depth) float32, grey above the air, read from outside to inside
    expected : (n,), depth in voxels; ``error``, its standard error; ``band``, how far from it the
    edge is sought
    other    : (n,), the second edge of the staircase: its distance where it ``rides`` on the first
    one, else its depth;
               NaN: none
    sign     : -1 where the grey falls at the edge
    width    : (n,), standard deviation of the blur along the column, in voxels
    noise    : what a sample differs by from its staircase
    least    : smallest step that counts
    gain     : by how much the sum of squared misfits over the noise has to fall
    result   : (n,), set to the depth of the edge; NaN where the image shows none there
    """
    for k in range(columns.shape[0]):
        result[k] = np.nan
        g = columns[k]
        w = width[k]
        lo = int(floor(expected[k] - band[k] - 3.0 * w))
        hi = int(ceil(expected[k] + band[k] + 3.0 * w))
        if not isfinite(expected[k]) or lo < 0 or hi > g.size - 1:
            continue
        if not is_finite(g, lo, hi):
            continue
        mean = 0.0
        for d in range(lo, hi + 1):
            mean += g[d]
        mean /= hi - lo + 1
        flat = 0.0
        for d in range(lo, hi + 1):
            flat += (g[d] - mean) ** 2
        half = int(ceil(band[k] * _PER_VOXEL))
        costs = np.empty(2 * half + 1)
        best = 0
        for i in range(2 * half + 1):
            at = expected[k] + (i - half) / _PER_VOXEL
            second = at + other[k] if rides else other[k]
            squares, rise = _misfit(g, lo, hi, w, at, second, fringe, ratio)
            drawn = ((at - expected[k]) / error[k]) ** 2
            fair = sign * rise >= least and (flat - squares) / noise**2 >= gain
            costs[i] = squares / noise**2 + drawn if fair else np.inf
            if costs[i] < costs[best]:
                best = i
        # What fits best at the end of the band is an edge beyond it.
        if best == 0 or best == 2 * half or not isfinite(costs[best]):
            continue
        a, b, c = costs[best - 1], costs[best], costs[best + 1]
        shift = 0.0
        if isfinite(a) and isfinite(c):
            shift = 0.5 * (a - c) / max(a - 2.0 * b + c, 1e-12)
        result[k] = expected[k] + (best - half + shift) / _PER_VOXEL
