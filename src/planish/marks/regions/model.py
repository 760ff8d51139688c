"""Regions: polygons in the plane of a map or an image, each with a reason and its author.

The pixels in them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planish.core.grid import Grid
from planish.core.text import printable
from planish.core.typing import Bools, Floats, Window

Ring = Floats
MOST_REGIONS, MOST_POINTS = 1000, 1_000_000
LONGEST_TEXT = 500
_FARTHEST = 1e9  # um or pixels: nothing that is drawn on paper lies farther away


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Region:
    """One declared artefact.

    ``polygons`` are closed borders (n, 2: x, y) without a repeated point: the outer one of each,
    and those of its holes. ``reason`` and ``author`` are empty where they are not given.
    """

    name: str
    reason: str = ""
    author: str = ""
    polygons: tuple[tuple[Ring, ...], ...]

    def inside(self, grid: Grid) -> tuple[Window, Bools]:
        """Return the pixels of a grid whose centre lies in a polygon and in none of its holes.

        Decided by the even-odd rule.

        Rows and columns of a window that holds all of them, and the mask within it. A centre on a
        border counts where the region lies right of or below it, so that regions side by side share
        no pixel and leave none out.
        """
        from planish.marks.regions._kernels import flip_crossings

        points = np.concatenate([ring for rings in self.polygons for ring in rings])
        left, upper = points.min(axis=0)
        right, lower = points.max(axis=0)
        rows = slice(*np.searchsorted(grid.y_um, (upper, lower)))
        cols = slice(*np.searchsorted(grid.x_um, (left, right)))
        y = grid.y_um[rows]
        x = grid.x_um[cols]
        inside = np.zeros((y.size, x.size), dtype=bool)
        if not inside.size:
            return (rows, cols), inside
        for rings in self.polygons:
            odd = np.zeros((y.size, x.size + 1), dtype=bool)
            for ring in rings:
                flip_crossings(ring, y, x, odd)
            # A centre is inside where an odd number of crossings lies right of it.
            from_right = np.logical_xor.accumulate(odd[:, :0:-1], axis=1)
            inside |= from_right[:, ::-1]
        return (rows, cols), inside


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Regions:
    """All regions of a file, in um or in pixels.

    With ``in_pixels`` from the corner of the first pixel, as ImageJ counts.
    """

    declared: tuple[Region, ...]
    in_pixels: bool = False

    def on(self, grid: Grid) -> Regions:
        """Give the same in um of a grid, whose coordinates are those of the pixels' centres."""
        if not self.in_pixels:
            return self
        down, across = grid.pixel_um
        pixel_um = np.array([across, down])
        origin = np.array(grid.origin_um)
        regions_um: list[Region] = []
        for region in self.declared:
            polygons = tuple(_in_um(rings, pixel_um, origin) for rings in region.polygons)
            regions_um.append(replace(region, polygons=polygons))
        return Regions(declared=tuple(regions_um))

    def inside(self, grid: Grid) -> Bools:
        """Return the pixels of a grid whose centre lies in a region."""
        inside = np.zeros(grid.shape, dtype=bool)
        for region in self.declared:
            window, mask = region.inside(grid)
            inside[window] |= mask
        return inside


def _in_um(rings: Sequence[Ring], pixel_um: Floats, origin: Floats) -> tuple[Ring, ...]:
    return tuple((ring - 0.5) * pixel_um + origin for ring in rings)


def ring_of(points: NDArray[np.floating]) -> Ring:
    """Make a border of points (n, 2) as a file has them.

    ValueError, with the reason, where they are none.
    """
    ring = np.asarray(points, dtype=np.float64)
    if not (np.abs(ring) <= _FARTHEST).all():
        raise ValueError(f"a coordinate is no number, or beyond {_FARTHEST:g}")
    if len(ring) > 1 and (ring[0] == ring[-1]).all():
        ring = ring[:-1]
    count = len(np.unique(ring, axis=0))
    if count < 3:
        raise ValueError(f"a polygon has {count} different points; 3 are needed")
    return ring


def nested(rings: Sequence[Ring]) -> tuple[tuple[Ring, ...], ...]:
    """Make polygons of borders that do not cross, outer ones with their holes.

    ValueError for none or too many.
    """
    if not 0 < len(rings) <= MOST_REGIONS:
        raise ValueError(f"it has {len(rings)} borders; 1 to {MOST_REGIONS} are possible")
    enclosing = _enclosing(rings)
    polygons = {k: [ring] for k, ring in enumerate(rings) if len(enclosing[k]) % 2 == 0}
    for k, ring in enumerate(rings):
        if k not in polygons:
            outer = [j for j in enclosing[k] if j in polygons]
            innermost = max(outer, key=lambda j: len(enclosing[j]))
            polygons[innermost].append(ring)
    return tuple(map(tuple, polygons.values()))


def _enclosing(rings: Sequence[Ring]) -> list[list[int]]:
    """Numbers of the borders that lie around each.

    A list for each border (n, 2), decided at a few middles of its edges.
    """
    lows = np.array([ring.min(axis=0) for ring in rings])
    highs = np.array([ring.max(axis=0) for ring in rings])
    enclosing: list[list[int]] = []
    for k, ring in enumerate(rings):
        # Borders may touch, so that single places of one may lie on another: most of a few decide.
        edge_middles = 0.5 * (ring + np.roll(ring, -1, axis=0))
        probes = edge_middles[:: max(1, len(ring) // 5)]
        is_around = (lows <= lows[k]) & (highs >= highs[k])
        encloses = is_around.all(axis=1)
        encloses[k] = False
        candidates = np.flatnonzero(encloses).tolist()
        enclosing.append([j for j in candidates if _holds_most(rings[j], probes)])
    return enclosing


def _holds_most(ring: Ring, places: Floats) -> bool:
    """True if more than half of some places (n, 2) lie within a border."""
    edges = np.hstack([ring, np.roll(ring, -1, axis=0)])
    n_inside = 0
    for x, y in places:
        # Inside, an odd number of edges crosses the line to the right.
        is_above = edges[:, 1::2] <= y
        xa, ya, xb, yb = edges[is_above[:, 0] != is_above[:, 1]].T
        crossing_x = xa + (y - ya) * (xb - xa) / (yb - ya)
        n_inside += int(np.count_nonzero(crossing_x > x)) % 2
    return 2 * n_inside > len(places)


def text_of(value: object, title: str) -> str:
    """Clean a text of a file into one line; ValueError where it is no text, or too long."""
    if value is None:
        return ""
    if not isinstance(value, str):
        raise ValueError(f"{title} is no text")
    text = printable(" ".join(value.split()))
    if len(text) > LONGEST_TEXT:
        raise ValueError(f"{title} has {len(text)} letters; {LONGEST_TEXT} are the most")
    return text
