"""Wrong ways to lay a pattern on itself: turned, turned over, shifted or scaled.

Every pair of holes is laid on every other pair of like length; the holes that then meet a hole are counted. A matcher
that searches for the pattern meets the same wrong arrangements.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planish.core.typing import Bools, Floats

TOLERANCE_UM = 25.0  # within which two marks are taken for one
SCALE = 0.03  # how far a map's scale may be off its calibration
CODE = 4  # consecutive holes that have to identify their place
_SLACK = 1.5  # two holes fix the motion, and each may be off
_TURN_DEG = 10.0  # what still counts as a half or a quarter turn
_MOST_CELLS = 4_000_000
_MOST = 60_000  # motions that are tried; beyond it, pairs are thinned out evenly


@dataclass(frozen=True, slots=True)
class Motions:
    """Wrong arrangements of a pattern on itself.

    ``hit`` (motions, n) says which holes meet a hole; where the motion is nearly no rotation, one that meets itself
    does not count. ``kind`` (motions,) is ``half turn``, ``quarter turn``, ``mirror``, or ``shift`` for all else.
    """

    hit: Bools
    kind: NDArray[np.str_]

    def best_count(self, kind: str) -> int:
        """Count the holes that the best motion of a kind explains."""
        return int(np.sum(self.hit[self.kind == kind], axis=1).max(initial=0))

    def best_counts(self, masks: Bools) -> NDArray[np.intp]:
        """Count, for each choice of holes (choices, n), those that the best motion without a mirror explains."""
        hit = self.hit[self.kind != "mirror"].astype(np.float32)
        return np.max(hit @ masks.T.astype(np.float32), axis=0, initial=0).astype(np.intp)


def self_motions(points_um: Floats) -> Motions:
    """Lay the holes (n, 2) on themselves by every wrong motion that two pairs of holes propose."""
    z = points_um[:, 0] + 1j * points_um[:, 1]
    n = len(z)
    start, end = np.triu_indices(n, 1)
    base = np.stack([start, end], axis=1)
    length = np.abs(z[end] - z[start])
    order = np.argsort(length, kind="stable")
    targets, target_length = base[order], length[order]
    first = np.searchsorted(target_length, (1 - SCALE) * length, side="left")
    last = np.searchsorted(target_length, (1 + SCALE) * length, side="right")
    # Each target is taken in both directions and in both hands.
    step = max(1.0, 4.0 * float(np.sum(last - first)) / _MOST)
    bases = np.unique(np.arange(0, len(base), step).astype(np.intp))
    counts = (last - first)[bases]
    which = np.repeat(bases, counts)
    offset = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
    goal = targets[first[which] + offset]
    goal, which = np.concatenate([goal, goal[:, ::-1]]), np.concatenate([which, which])
    index = _HoleIndex(points_um)
    parts = [_motion_hits(z, base[which], goal, index, mirrored) for mirrored in (False, True)]
    return Motions(np.concatenate([hit for hit, _ in parts]), np.concatenate([kind for _, kind in parts]))


class _HoleIndex:
    """The hole within the tolerance of a point: a table of cells, or a tree where the table would be large."""

    def __init__(self, points_um: Floats) -> None:
        self.n, self.reach = len(points_um), _SLACK * TOLERANCE_UM
        self.z = np.append(points_um[:, 0] + 1j * points_um[:, 1], np.inf)
        self.tree = cKDTree(points_um)
        nearest = float(np.min(np.asarray(self.tree.query(points_um, k=2)[0])[:, 1]))
        # Cells so small that none belongs to two holes, and no smaller than needed.
        self.cell = min(2 * self.reach, 0.69 * (nearest / 2 - self.reach))
        self.table = None
        if self.cell < self.reach / 4:
            return
        self.low = points_um.min(axis=0) - self.reach - 2 * self.cell
        shape = np.ceil((points_um.max(axis=0) + self.reach - self.low) / self.cell).astype(np.intp) + 2
        if int(shape.prod()) > _MOST_CELLS:
            return
        self.table = np.full((int(shape[0]), int(shape[1])), self.n, dtype=np.int16)
        for k, point in enumerate(points_um):
            first, last = (((point + d - self.low) / self.cell).astype(np.intp) for d in (-self.reach, self.reach))
            self.table[first[0] : last[0] + 1, first[1] : last[1] + 1] = k

    def holes_at(self, landed: NDArray[np.complex128]) -> NDArray[np.intp]:
        """Return the number of the hole at each point, or n where there is none."""
        if self.table is None:
            flat = np.stack([landed.real.ravel(), landed.imag.ravel()], axis=1)
            nearest = self.tree.query(flat, distance_upper_bound=self.reach)[1]
            return np.asarray(nearest, dtype=np.intp).reshape(landed.shape)
        last_x, last_y = self.table.shape[0] - 1, self.table.shape[1] - 1
        # Far outside is cut off to the table's border, which is empty.
        x = np.clip((landed.real - self.low[0]) / self.cell, 0, last_x).astype(np.intp)
        y = np.clip((landed.imag - self.low[1]) / self.cell, 0, last_y).astype(np.intp)
        holes = self.table[x, y].astype(np.intp).ravel()
        near = np.flatnonzero(holes < self.n)
        holes[near[np.abs(landed.ravel()[near] - self.z[holes[near]]) > self.reach]] = self.n
        return holes.reshape(landed.shape)


def _motion_hits(
    z: NDArray[np.complex128], base: NDArray[np.intp], goal: NDArray[np.intp], index: _HoleIndex, mirrored: bool
) -> tuple[Bools, NDArray[np.str_]]:
    """Return which holes meet one under each motion, and the kind of each."""
    if not mirrored:
        moved = np.any(base != goal, axis=1)
        base, goal = base[moved], goal[moved]
    source = np.conj(z) if mirrored else z
    span = source[base[:, 1]] - source[base[:, 0]]
    is_distinct = np.abs(span) > 0
    base, goal, span = base[is_distinct], goal[is_distinct], span[is_distinct]
    alpha = (z[goal[:, 1]] - z[goal[:, 0]]) / span
    landed = alpha[:, None] * source + (z[goal[:, 0]] - alpha * source[base[:, 0]])[:, None]
    holes = index.holes_at(landed)
    hit = holes < len(z)
    if mirrored:
        return hit, np.full(len(hit), "mirror")
    turn = np.abs(np.degrees(np.angle(alpha)))
    hit &= ~((turn < _TURN_DEG)[:, None] & (holes == np.arange(len(z))))
    half, quarter = turn >= 180 - _TURN_DEG, np.abs(turn - 90) <= _TURN_DEG
    return hit, np.select([half, quarter], ["half turn", "quarter turn"], "shift")


def perimeter_order(points_um: Floats) -> NDArray[np.intp]:
    """Sort the holes (n, 2) along the rectangle around them, counter-clockwise from its lower left corner."""
    low, size = points_um.min(axis=0), np.ptp(points_um, axis=0)
    x, y = (points_um - low).T
    width, height = size
    distance = np.stack([y, width - x, height - y, x])
    along = np.stack([x, width + y, 2 * width + height - x, 2 * (width + height) - y])
    side = np.argmin(distance, axis=0)
    return np.argsort(along[side, np.arange(len(x))], kind="stable")


def code_misfit_um(points_um: Floats) -> float:
    """Return the smallest misfit (um) of any four consecutive holes with any other four, or themselves in reverse.

    The holes (n, 2) are taken in their order around the field, the last followed by the first; a turn, a shift and a
    scale within 3 % are free, and the misfit is the largest distance left.
    """
    points = points_um[perimeter_order(points_um)]
    z = points[:, 0] + 1j * points[:, 1]
    n = len(z)
    if n <= CODE:
        return 0.0
    windows = z[(np.arange(n)[:, None] + np.arange(CODE)) % n]
    windows = windows - windows.mean(axis=1, keepdims=True)
    smallest = np.inf
    for reverse in (False, True):
        goal = windows[:, ::-1] if reverse else windows
        product = np.conj(windows) @ goal.T
        power = np.sum(np.abs(windows) ** 2, axis=1)[:, None]
        scale = np.clip(np.abs(product) / power, 1 - SCALE, 1 + SCALE)
        alpha = scale * np.exp(1j * np.angle(product))
        misfit = np.abs(alpha[:, :, None] * windows[:, None, :] - goal[None, :, :]).max(axis=2)
        if not reverse:
            np.fill_diagonal(misfit, np.inf)
        smallest = min(smallest, float(misfit.min()))
    return smallest
