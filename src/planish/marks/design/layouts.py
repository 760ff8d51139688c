"""Layouts of holes: lines along the four sides of the frame, three corners filled and one left empty.

All positions are whole steps of 50 um, and the frame's sides are whole numbers of steps. The lines run
counter-clockwise from the empty corner, which lies at the lower left; each other corner holds the first hole of a
line.

``coded``: the distances between the holes of a side are all different, so that a side is a Golomb ruler; distances that
two sides have in common are as few as can be found. ``line``: the pitch grows evenly along each line, on each side at a
rate of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from planish.core.typing import Floats

Ints = NDArray[np.int64]

STEP_UM = 50.0
_BATCH = 4000
_BATCHES = 6
_COMPARED = 400  # candidates of a side that are compared with the sides before it
RATES = (1.0, 1.5, 2.1, 2.8)  # last pitch over first pitch, less 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Ruler:
    """One side of the frame in steps.

    ``start`` and ``end`` say whether there are holes in the corners, which lie ``length`` apart; two holes keep
    ``spacing``, and ``marker`` from an empty corner. ``view``, its ``border`` and a hole's ``radius`` are lengths, too.
    """

    length: int
    start: bool
    end: bool
    spacing: int
    marker: int
    view: float
    border: float
    radius: float

    @property
    def low(self) -> int:
        """Least position of a hole that is no corner."""
        return self.spacing if self.start else self.marker

    @property
    def high(self) -> int:
        """Largest position of a hole that is no corner."""
        return self.length - (self.spacing if self.end else self.marker)

    def with_corners(self, inner: Ints) -> Ints:
        """Add the holes in the corners to positions (..., n)."""
        start = np.zeros((*inner.shape[:-1], int(self.start)), dtype=np.int64)
        end = np.full((*inner.shape[:-1], int(self.end)), self.length, dtype=np.int64)
        return np.concatenate([start, inner, end], axis=-1)


def share_holes(count: int, lengths: Sequence[float], least: int) -> list[int]:
    """Share holes out to the four sides, each at least so many, by the sides' lengths."""
    shares = [least] * 4
    for _ in range(max(0, count - 4 * least)):
        # The side on which the holes are farthest apart gets the next one.
        side = max(range(4), key=lambda k: (lengths[k] / (shares[k] + 1), -k))
        shares[side] += 1
    return shares


def coded_side(ruler: Ruler, count: int, used: set[int], rng: np.random.Generator) -> Ints | None:
    """Draw positions (count,) of the holes between the corners; None if nothing fits.

    ``used`` are the distances on the sides before.
    """
    for _ in range(_BATCHES):
        drawn = _draw_positions(ruler, count, rng)
        marks = ruler.with_corners(drawn)
        fits = np.all(np.diff(marks, axis=1) >= ruler.spacing, axis=1)
        fits &= (drawn[:, 0] >= ruler.low) & (drawn[:, -1] <= ruler.high)
        drawn, marks = drawn[fits], marks[fits]
        distances = _distances(marks)
        golomb = np.all(np.diff(np.sort(distances, axis=1), axis=1) > 0, axis=1)
        drawn, distances = drawn[golomb][:_COMPARED], distances[golomb][:_COMPARED]
        if len(drawn):
            repeated = np.isin(distances, np.fromiter(used, dtype=np.int64)).sum(axis=1)
            return drawn[int(np.argmin(repeated))]
    return None


def coded_distances(ruler: Ruler, inner: Ints) -> set[int]:
    """Return the distances between all holes of a side, in steps."""
    return set(_distances(ruler.with_corners(inner)[None])[0].tolist())


def growing_side(ruler: Ruler, count: int, rate: float) -> Ints | None:
    """Give positions (count,) with a pitch that grows evenly, by ``rate`` in all; None if the pitch gets too small."""
    pitch = 1 + rate * np.arange(count + 1) / count
    marks = np.round(ruler.length * np.cumsum(pitch) / pitch.sum()).astype(np.int64)[:-1]
    whole = ruler.with_corners(marks)
    fits = np.all(np.diff(whole) >= ruler.spacing) and marks[0] >= ruler.low and marks[-1] <= ruler.high
    return marks if fits else None


def around_frame(sides: Sequence[Ints], width: int, height: int) -> tuple[Floats, Ints]:
    """Lay the sides around the frame: positions (n, 2) in um from its lower left corner, and the side of each."""
    corners = np.array([(0, 0), (width, 0), (width, height), (0, height)])
    direction = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])
    # The first corner stays empty.
    along = [np.array([0, *inner] if side else inner, dtype=np.int64) for side, inner in enumerate(sides)]
    points = np.concatenate([corners[k] + steps[:, None] * direction[k] for k, steps in enumerate(along)])
    return STEP_UM * points, np.repeat(np.arange(4), [len(steps) for steps in along])


def _draw_positions(ruler: Ruler, count: int, rng: np.random.Generator) -> Ints:
    """Draw sorted positions (batch, count) of which at least four survive every crop that keeps the side.

    A window of 70 % of the view slides along the side. The holes in the middle 40 % are always in it; each other hole
    near the start has a partner not quite a window's length away, so that one enters before the other leaves.
    """
    middle = min(count, max(8 - count, count % 2))
    pairs = (count - middle) // 2
    window = 0.7 * ruler.view
    edge = 0.3 * ruler.view
    first = rng.uniform(ruler.low, max(edge - ruler.border, ruler.low + 1), (_BATCH, pairs))
    reach = window - 2 * ruler.radius - 1
    second = first + reach - rng.uniform(0, 0.4, (_BATCH, pairs)) ** 2 * ruler.view
    low, high = edge - ruler.border + ruler.radius, window - ruler.border - ruler.radius
    third = rng.uniform(low, max(high, low + 1), (_BATCH, middle))
    return np.sort(np.round(np.concatenate([first, second, third], axis=1)).astype(np.int64), axis=1)


def _distances(marks: Ints) -> Ints:
    """Return all distances (batch, n (n - 1) / 2) between positions (batch, n) but that from corner to corner."""
    n = marks.shape[1]
    pairs = [pair for pair in combinations(range(n), 2) if pair != (0, n - 1)]
    first, last = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
    return marks[:, last] - marks[:, first]
