# pyright: standard
"""Compiled inner loops on voids: chords in the plane of the sheet, and the largest spheres that fit.

All look no further than a limit, so that a voxel's answer depends on its neighbourhood only and not on the tile.
"""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def chords(void, most):
    """Sum over the void samples of each ray of the run of void through them, along the rows' axis and the columns'.

    Parameters
    ----------
    void : (rows, cols, samples) uint8
    most : (int, int)
        Steps to each side after which a run ends, along the first and the second axis.

    Returns
    -------
    along_first, along_second : (rows, cols)
        In steps.
    """
    rows, cols, count = void.shape
    out = np.zeros((2, rows, cols))
    before = np.zeros(void.shape, dtype=np.int16)
    run = np.zeros(count, dtype=np.int16)
    for i in range(rows):
        for j in range(cols):
            for k in range(count):
                if void[i, j, k]:
                    before[i, j, k] = min(before[i - 1, j, k] + 1, most[0]) if i > 0 else 1
    for j in range(cols):
        run[:] = 0
        for i in range(rows - 1, -1, -1):
            total = 0
            for k in range(count):
                run[k] = min(run[k] + 1, most[0]) if void[i, j, k] else 0
                if void[i, j, k]:
                    total += before[i, j, k] + run[k] - 1
            out[0, i, j] = total
    for i in range(rows):
        run[:] = 0
        for j in range(cols):
            for k in range(count):
                run[k] = min(run[k] + 1, most[1]) if void[i, j, k] else 0
                before[i, j, k] = run[k]
        run[:] = 0
        for j in range(cols - 1, -1, -1):
            total = 0
            for k in range(count):
                run[k] = min(run[k] + 1, most[1]) if void[i, j, k] else 0
                if void[i, j, k]:
                    total += before[i, j, k] + run[k] - 1
            out[1, i, j] = total
    return out[0], out[1]


@njit(cache=True, nogil=True)
def distances(void, step, most):
    """Distance of each void sample to the nearest solid one, no more than ``most``.

    Parameters
    ----------
    void : (rows, cols, samples) uint8
        What lies outside the array is not there; the caller gives a halo.
    step : (float, float, float)
        um.
    most : float
        um.

    Returns
    -------
    (rows, cols, samples) float32
        um; 0 in the solid.
    """
    rows, cols, count = void.shape
    far = np.float32(most * most)
    a = np.empty(void.shape, dtype=np.float32)
    reach = int(most / step[2]) + 1
    # Exact squared distances, axis by axis: the least over the line of what the axes before gave plus the way there.
    for i in range(rows):
        for j in range(cols):
            for k in range(count):
                best = far if void[i, j, k] else np.float32(0.0)
                if best > 0:
                    for d in range(1, reach + 1):
                        way = np.float32((d * step[2]) ** 2)
                        if way >= best:
                            break
                        if (k - d >= 0 and not void[i, j, k - d]) or (k + d < count and not void[i, j, k + d]):
                            best = way
                            break
                a[i, j, k] = best
    b = np.empty(void.shape, dtype=np.float32)
    reach = int(most / step[1]) + 1
    for i in range(rows):
        for j in range(cols):
            for k in range(count):
                best = a[i, j, k]
                if best > 0:
                    for d in range(1, reach + 1):
                        way = np.float32((d * step[1]) ** 2)
                        if way >= best:
                            break
                        if j - d >= 0:
                            best = min(best, a[i, j - d, k] + way)
                        if j + d < cols:
                            best = min(best, a[i, j + d, k] + way)
                b[i, j, k] = best
    reach = int(most / step[0]) + 1
    for i in range(rows):
        for j in range(cols):
            for k in range(count):
                best = b[i, j, k]
                if best > 0:
                    for d in range(1, reach + 1):
                        way = np.float32((d * step[0]) ** 2)
                        if way >= best:
                            break
                        if i - d >= 0:
                            best = min(best, b[i - d, j, k] + way)
                        if i + d < rows:
                            best = min(best, b[i + d, j, k] + way)
                a[i, j, k] = np.sqrt(best)
    return a


@njit(cache=True, nogil=True)
def inscribed(distance, step):
    """Radius of the largest sphere inside the void that holds each of its samples.

    Parameters
    ----------
    distance : (rows, cols, samples) float32
        To the nearest solid sample, um.
    step : (float, float, float)
        um.

    Returns
    -------
    (rows, cols, samples) float32
        um; 0 in the solid.
    """
    rows, cols, count = distance.shape
    out = distance.copy()
    for i in range(rows):
        for j in range(cols):
            for k in range(count):
                r = distance[i, j, k]
                if r <= 0 or _swallowed(distance, i, j, k, step):
                    continue
                di, dj = int(r / step[0]), int(r / step[1])
                for a in range(max(i - di, 0), min(i + di, rows - 1) + 1):
                    left = r * r - ((a - i) * step[0]) ** 2
                    if left <= 0:
                        continue
                    for b in range(max(j - dj, 0), min(j + dj, cols - 1) + 1):
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
    """Whether a neighbour's sphere holds this one."""
    r = distance[i, j, k]
    for a in range(max(i - 1, 0), min(i + 2, distance.shape[0])):
        for b in range(max(j - 1, 0), min(j + 2, distance.shape[1])):
            for c in range(max(k - 1, 0), min(k + 2, distance.shape[2])):
                if a == i and b == j and c == k:
                    continue
                way = np.sqrt(((a - i) * step[0]) ** 2 + ((b - j) * step[1]) ** 2 + ((c - k) * step[2]) ** 2)
                if distance[a, b, c] >= r + way - 1e-6:
                    return True
    return False
