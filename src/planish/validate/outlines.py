"""Two regions compared: how much they overlap, and how far their outlines are apart."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_PARTS = 4  # points on the stretch of an outline within one cell: so close that the nearest one is as good as the line


def dice(one: Mask, two: Mask) -> float | None:
    """Twice the common area over the sum of both; None where both are empty."""
    total = int(one.sum()) + int(two.sum())
    return 2.0 * int((one & two).sum()) / total if total else None


def outline_lag(one: Array, two: Array, level: float, pitch_um: tuple[float, float]) -> float | None:
    """Median distance in um between the contour lines of two maps at ``level``, taken from both sides.

    No line passes where a map is NaN; None where one of them has no contour. ``pitch_um`` is that of rows and columns.
    """
    a, b = (contour_points(m, level) * np.array(pitch_um) for m in (one, two))
    if not len(a) or not len(b):
        return None
    away = np.concatenate([KDTree(b).query(a)[0], KDTree(a).query(b)[0]])
    return float(np.median(away))


def contour_points(values: Array, level: float) -> Array:
    """Points (n, 2) as (row, col), in pixels, close together on the contour lines of a map."""
    from contourpy import LineType, contour_generator

    lines = contour_generator(z=np.ma.masked_invalid(values), line_type=LineType.Separate).lines(level)
    share = (np.arange(_PARTS) + 0.5)[:, None] / _PARTS
    points = [start + share * (end - start) for line in lines for start, end in pairwise(np.asarray(line))]
    return np.concatenate(points)[:, ::-1] if points else np.empty((0, 2))
