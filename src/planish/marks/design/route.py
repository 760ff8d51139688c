"""The order in which the stage visits the holes: nearest neighbour first, then no two stretches that cross."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.intp]


def short_route(points_um: ArrayLike, start_um: tuple[float, float]) -> Ints:
    """Order of the points (n, 2) on a short path that begins and ends at ``start_um``.

    The path is built to the nearest point left each time, then stretches of it are turned round as long as that
    shortens it (2-opt). Same points, same order.
    """
    points = np.asarray(points_um, dtype=np.float64).reshape(-1, 2)
    places = np.vstack([np.array(start_um, dtype=np.float64)[None], points])
    apart = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
    tour = _nearest(apart)
    n = len(tour)
    shorter = n > 3
    while shorter:
        shorter = False
        for i in range(n - 1):
            # Turn round what lies between i + 1 and j: two stretches are replaced.
            j = np.arange(i + 1, n)
            ends = tour[(j + 1) % n]
            gain = apart[tour[i], tour[i + 1]] + apart[tour[j], ends]
            gain = gain - apart[tour[i], tour[j]] - apart[tour[i + 1], ends]
            best = int(np.argmax(gain))
            if gain[best] > 1e-6:
                tour[i + 1 : i + 2 + best] = tour[i + 1 : i + 2 + best][::-1]
                shorter = True
    return tour[1:] - 1


def path_um(points_um: ArrayLike, order: Ints, start_um: tuple[float, float]) -> float:
    """Length of the path from ``start_um`` through the points in this order and back."""
    start = np.array(start_um, dtype=np.float64)[None]
    path = np.concatenate([start, np.asarray(points_um, dtype=np.float64)[order], start])
    return float(np.sum(np.hypot(*np.diff(path, axis=0).T)))


def _nearest(apart: Array) -> Ints:
    """Return a tour from place 0, always to the nearest place that is left."""
    left = np.ones(len(apart), dtype=np.bool_)
    left[0] = False
    tour = [0]
    while left.any():
        following = int(np.argmin(np.where(left, apart[tour[-1]], np.inf)))
        left[following] = False
        tour.append(following)
    return np.array(tour, dtype=np.intp)
