"""The unit of the solvers' times: one evaluation of all eight-neighbour spring forces in float64, node by node."""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numba import njit


@njit(nogil=True, cache=True, error_model="numpy")
def _pull(x0, y0, x, y, rest):
    dx, dy = x - x0, y - y0
    s = 1.0 - rest / math.sqrt(dx * dx + dy * dy)
    return s * dx, s * dy


@njit(nogil=True, cache=True, error_model="numpy")
def spring_forces(x, y, rest0, rest1, rest2, rest3, fx, fy, r0, r1):
    """Forces of the inner nodes of the rows r0 <= i < r1; arrays (rows, cols)."""
    for i in range(max(1, r0), min(x.shape[0] - 1, r1)):
        for j in range(1, x.shape[1] - 1):
            a, b = x[i, j], y[i, j]
            f, g = _pull(a, b, x[i, j + 1], y[i, j + 1], rest0[i, j])
            p, q = _pull(a, b, x[i, j - 1], y[i, j - 1], rest0[i, j - 1])
            f, g = f + p, g + q
            p, q = _pull(a, b, x[i + 1, j], y[i + 1, j], rest1[i, j])
            f, g = f + p, g + q
            p, q = _pull(a, b, x[i - 1, j], y[i - 1, j], rest1[i - 1, j])
            f, g = f + p, g + q
            p, q = _pull(a, b, x[i + 1, j + 1], y[i + 1, j + 1], rest2[i, j])
            f, g = f + p, g + q
            p, q = _pull(a, b, x[i - 1, j - 1], y[i - 1, j - 1], rest2[i - 1, j - 1])
            f, g = f + p, g + q
            p, q = _pull(a, b, x[i + 1, j - 1], y[i + 1, j - 1], rest3[i, j - 1])
            f, g = f + p, g + q
            p, q = _pull(a, b, x[i - 1, j + 1], y[i - 1, j + 1], rest3[i - 1, j])
            fx[i, j], fy[i, j] = f + p, g + q


class Unit:
    """All spring forces of a grid, once, shared among threads; call it to evaluate them."""

    def __init__(self, rows, cols, threads):
        rng = np.random.default_rng(0)
        y, x = np.mgrid[:rows, :cols].astype(float)
        self._arrays = [x + 0.05 * rng.normal(size=x.shape), y, *(np.full(x.shape, s) for s in (1, 1, 1.4, 1.4))]
        self._arrays += [np.zeros_like(x), np.zeros_like(x)]
        self._cuts = [rows * k // threads for k in range(threads + 1)]
        self._pool = ThreadPoolExecutor(threads)

    def __call__(self):
        parts = zip(self._cuts[:-1], self._cuts[1:], strict=True)
        if len(self._cuts) == 2:
            spring_forces(*self._arrays, *self._cuts)
        else:
            list(self._pool.map(lambda part: spring_forces(*self._arrays, *part), parts))
