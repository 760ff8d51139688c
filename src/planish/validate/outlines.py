"""Two regions compared: how much they overlap, and how far their outlines are apart."""

from __future__ import annotations

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

    Parameters
    ----------
    one, two : (rows, cols)
        NaN is missing: no line passes there.
    level : float
    pitch_um : (float, float)
        Distance of rows and columns.

    Returns
    -------
    float or None
        None where one of them has no contour.
    """
    a, b = (contour_points(m, level) * np.array(pitch_um) for m in (one, two))
    if not len(a) or not len(b):
        return None
    away = np.concatenate([KDTree(b).query(a)[0], KDTree(a).query(b)[0]])
    return float(np.median(away))


def contour_points(values: Array, level: float) -> Array:
    """Points (n, 2) as (row, col), in pixels, close together on the contour line of a map, cell by cell.

    Crossings of the level on the four edges of a cell are found by linear interpolation. A cell with two of them holds
    a straight stretch; one with four (a saddle) only its crossings.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        across = (level - values[:, :-1]) / (values[:, 1:] - values[:, :-1])
        down = (level - values[:-1]) / (values[1:] - values[:-1])
    cells = values.shape[0] - 1, values.shape[1] - 1
    row, col = np.mgrid[: cells[0], : cells[1]].astype(np.float64)
    edges = [
        (row, col + across[:-1], across[:-1]),
        (row + 1, col + across[1:], across[1:]),
        (row + down[:, :-1], col, down[:, :-1]),
        (row + down[:, 1:], col + 1, down[:, 1:]),
    ]
    points = np.stack([np.stack([r, c], axis=-1) for r, c, _ in edges])
    crossed = np.stack([(t >= 0) & (t < 1) for *_, t in edges])
    count = crossed.sum(axis=0)
    found = [points[k][crossed[k] & (count != 2)] for k in range(4)]
    two = count == 2
    if two.any():
        hit = crossed[:, two]
        first, last = hit.argmax(axis=0), 3 - hit[::-1].argmax(axis=0)
        ends = points[:, two]
        at = np.arange(hit.shape[1])
        start, end = ends[first, at], ends[last, at]
        share = (np.arange(_PARTS) + 0.5) / _PARTS
        found.append((start[:, None] + share[None, :, None] * (end - start)[:, None]).reshape(-1, 2))
    return np.concatenate(found)
