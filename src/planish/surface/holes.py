"""Holes that are half closed: their outline tells how wide they were cut, and less of it is open."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, spatial

Array = NDArray[np.float64]

_OPEN = 0.7  # share of the ellipse that must be open
_LEAST_UM = 40.0  # width of what counts as a hole at all
_MOST_UM = 600.0


class Hole(NamedTuple):
    """A hole in the sheet.

    ``row``, ``col``: middle, in columns; ``open_um2``: area without sheet; ``ellipse_um2``: area of the ellipse with
    the second moments of its convex outline.
    """

    row: float
    col: float
    open_um2: float
    ellipse_um2: float


def half_closed(seen: NDArray[np.bool_], runs_out: NDArray[np.bool_], pitch: tuple[float, float]) -> list[Hole]:
    """Find the holes of which less than 70 % is open.

    A hole is compared with its own ellipse, and where there are three or more, with the usual ellipse of all: what has
    half closed with a straight edge is a smaller ellipse of its own.

    Parameters
    ----------
    seen : (rows, cols)
        Columns with a sheet.
    runs_out : (rows, cols)
        Columns in which the sheet goes on beyond the volume.
    pitch : (float, float)
        Distance of rows and of columns, um.
    """
    holes = all_holes(seen | runs_out, pitch)
    usual = float(np.median([h.ellipse_um2 for h in holes])) if len(holes) >= 3 else 0.0
    return [h for h in holes if h.open_um2 < _OPEN * max(h.ellipse_um2, usual)]


def all_holes(sheet: NDArray[np.bool_], pitch: tuple[float, float]) -> list[Hole]:
    """Gaps of the sheet between 40 and 600 um wide that do not reach the border of the map."""
    reach = max(1, round(3.0 / float(np.sqrt(pitch[0] * pitch[1]))))
    # Fibres and flaps across a hole belong to its outline, single columns without a face do not.
    gaps = ndimage.binary_opening(~sheet, np.ones((2, 2), dtype=bool))
    around, count = ndimage.label(ndimage.binary_dilation(gaps, iterations=reach))
    out: list[Hole] = []
    for k, place in enumerate(ndimage.find_objects(around)[:count], start=1):
        if any(s.start == 0 or s.stop == n for s, n in zip(place, sheet.shape, strict=True)):
            continue
        where: Array = np.argwhere(gaps[place] & (around[place] == k)).astype(np.float64) * np.asarray(pitch)
        if where.shape[0] < 8 or np.ptp(where, axis=0).min() <= 0:
            continue
        area = where.shape[0] * pitch[0] * pitch[1]
        ellipse = _ellipse(where)
        if np.pi / 4 * _LEAST_UM**2 <= ellipse <= np.pi / 4 * _MOST_UM**2:
            middle = where.mean(axis=0) / pitch
            out.append(Hole(place[0].start + middle[0], place[1].start + middle[1], area, ellipse))
    return out


def _ellipse(points: Array) -> float:
    """Area of the ellipse with the second moments of the convex hull of ``points``."""
    try:
        hull = points[spatial.ConvexHull(points).vertices]
    except spatial.QhullError:
        return 0.0
    x, y = (hull - hull.mean(axis=0)).T
    x1, y1 = np.roll(x, -1), np.roll(y, -1)
    cross = x * y1 - x1 * y
    area = 0.5 * cross.sum()
    centre = np.array([((x + x1) * cross).sum(), ((y + y1) * cross).sum()]) / (6 * area)
    xx = ((x * x + x * x1 + x1 * x1) * cross).sum() / (12 * area) - centre[0] ** 2
    yy = ((y * y + y * y1 + y1 * y1) * cross).sum() / (12 * area) - centre[1] ** 2
    xy = ((x * y1 + 2 * x * y + 2 * x1 * y1 + x1 * y) * cross).sum() / (24 * area) - centre[0] * centre[1]
    return float(4 * np.pi * np.sqrt(max(xx * yy - xy * xy, 0.0)))
