# pyright: standard
"""Compiled inner loop on voids: the largest spheres that fit."""

import numpy as np

from planish.core.jit import njit


@njit(cache=True, nogil=True)
def inscribed(distance, step):  # noqa: C901
    """Radius of the largest sphere inside the void that holds each of its samples, um.

    0 in the solid.

    ``distance``, (rows, cols, samples) float32 as the result: to the nearest solid sample, um.
    ``step``: along the three axes, um.
    """
    rows, cols, count = distance.shape
    out = distance.copy()
    for i in range(rows):
        for j in range(cols):
            for k in range(count):
                r = distance[i, j, k]
                if r <= 0 or _swallowed(distance, i, j, k, step):
                    continue
                di = int(r / step[0])
                dj = int(r / step[1])
                first_col = max(j - dj, 0)
                last_col = min(j + dj, cols - 1)
                for a in range(max(i - di, 0), min(i + di, rows - 1) + 1):
                    left = r * r - ((a - i) * step[0]) ** 2
                    if left <= 0:
                        continue
                    for b in range(first_col, last_col + 1):
                        rest = left - ((b - j) * step[1]) ** 2
                        if rest <= 0:
                            continue
                        dk = int(np.sqrt(rest) / step[2])
                        for c in range(max(k - dk, 0), min(k + dk, count - 1) + 1):
                            if distance[a, b, c] > 0 and out[a, b, c] < r:
                                out[a, b, c] = r
    return out


@njit(cache=True, nogil=True)
def _swallowed(distance, i, j, k, step):
    """Whether the sphere about a sample lies inside that about one of its 26 neighbours.

    ``distance`` and ``step`` as for :func:`inscribed`. Such a sphere needs no look of its own.
    """
    r = distance[i, j, k]
    rows, cols, count = distance.shape
    for a in range(max(i - 1, 0), min(i + 2, rows)):
        for b in range(max(j - 1, 0), min(j + 2, cols)):
            for c in range(max(k - 1, 0), min(k + 2, count)):
                if a == i and b == j and c == k:
                    continue
                down = (a - i) * step[0]
                across = (b - j) * step[1]
                through = (c - k) * step[2]
                way = np.sqrt(down**2 + across**2 + through**2)
                if distance[a, b, c] >= r + way - 1e-6:
                    return True
    return False
