"""The best arrangement of two sets of marks, the best different one, and whether the pattern may repeat itself."""

from __future__ import annotations

from math import comb, log10
from typing import NamedTuple

import numpy as np

from planish.core.typing import Bools, Floats, Ints
from planish.register.match_search import (
    ACCEPTED,
    REACH,
    Arrangements,
    Complexes,
    extents,
    log_chance,
    marks_needed,
    search,
    share_within,
)
from planish.register.pairs import as_complex


class BestMatch(NamedTuple):
    """The best arrangement of two sides; by default, none.

    ``pairs`` (k, 2) hold the row of the first side and of the second, sorted by the first; with fewer than ``needed``
    they may be chance. ``log_chance`` is log10 of how many such arrangements chance would offer, ``second_log_chance``
    that of the best different match, in which ``second_best`` marks agree; ``stretch`` the share by which one direction
    is longer than the other. ``landed`` and ``large`` are the marks of the smaller side, which is the second one if
    ``swapped``, and of the larger side, in the frame of the latter.
    """

    pairs: Ints = np.empty((0, 2), np.intp)
    landed: Complexes = np.empty(0, complex)
    large: Complexes = np.empty(0, complex)
    mirrored: bool = False
    needed: int = 4
    log_chance: float = 10.0
    second_log_chance: float = np.inf
    second_best: int = 0
    stretch: float = 0.0
    swapped: bool = False

    def together(self) -> tuple[Complexes, tuple[int, int]]:
        """All marks of the field that both sides show, first the pairs; and how many each side alone shows."""
        rows, columns = self.pairs.T[::-1] if self.swapped else self.pairs.T
        # Marks of a larger map are no evidence about a smaller one.
        alone = [
            points[_inside(points, self.large, 0.15) & _inside(points, self.landed, 0.15)]
            for points in (np.delete(self.landed, rows), np.delete(self.large, columns))
        ]
        return np.concatenate([self.large[columns], *alone]), (len(alone[0]), len(alone[1]))


def choose(
    source: Floats, target: Floats, scale_tolerance: float, tolerance_um: float, *, hands: tuple[bool, ...]
) -> BestMatch:
    """Return the best arrangement of three or more marks a side, (n, 2) and (m, 2) in um."""
    swapped = len(source) > len(target)
    a, b = (as_complex(p, False) for p in ((target, source) if swapped else (source, target)))
    arrangements = search(a, b, scale_tolerance, tolerance_um, hands=hands)
    if len(arrangements.inliers) == 0:
        return BestMatch()
    misfit = np.sum(np.minimum(arrangements.squares, tolerance_um**2), axis=1)
    best = int(np.lexsort((misfit, arrangements.log_chance))[0])
    # Pairs are within the tolerance, or less where the others agree much better. The median distance of a normal
    # scatter in the plane is 1.18 standard deviations.
    squares = arrangements.squares[best]
    agreeing = squares[squares <= tolerance_um * tolerance_um]
    spare = max(len(agreeing) - float(arrangements.freedom[best]), 1.0)
    scatter = np.sqrt(np.median(agreeing) * len(agreeing) / spare) / 1.18
    # A pair this many times further apart than the others are is not one, however wide the tolerance.
    rows = np.flatnonzero(squares <= float(min(tolerance_um, 5.0 * scatter + 0.1 * tolerance_um)) ** 2)
    pairs = np.stack([rows, arrangements.partner[best][rows].astype(np.intp)], axis=1)
    pairs = pairs[:, ::-1] if swapped else pairs
    landed = arrangements.landed[best]
    # Of the marks of the smaller side that lie in the field of the other, 35 % have to agree.
    in_common_field = np.count_nonzero(_inside(landed, b, 0.05))
    needed = 3 if len(a) == 3 else max(4, int(np.ceil(0.35 * in_common_field)))
    if len(pairs) < needed or arrangements.log_chance[best] > ACCEPTED:
        by_chance = marks_needed(len(a), b, int(arrangements.tests[0]), tolerance_um)
        needed = max(needed, by_chance, len(pairs) + 1)
    rival_chance, rival_count = _rival(arrangements, best, b, tolerance_um)
    return BestMatch(
        pairs=np.ascontiguousarray(pairs[np.argsort(pairs[:, 0])]),
        mirrored=bool(arrangements.mirrored[best]),
        needed=needed,
        log_chance=float(arrangements.log_chance[best]),
        second_log_chance=rival_chance,
        second_best=rival_count,
        stretch=2.0 * abs(arrangements.gamma[best]) / abs(arrangements.alpha[best]),
        swapped=swapped,
        landed=landed,
        large=b,
    )


def _rival(arrangements: Arrangements, best: int, b: Complexes, tolerance: float) -> tuple[float, int]:
    """Give log10 of how often chance offers the best different arrangement, and the marks that agree in it."""
    used = arrangements.squares[best] <= tolerance * tolerance
    moved = np.max(np.abs(arrangements.landed[:, used] - arrangements.landed[best, used]), axis=1)
    turned_over = arrangements.mirrored != arrangements.mirrored[best]
    is_rival = turned_over | (moved > 2.0 * tolerance)
    if not is_rival.any():
        return np.inf, 0
    rivals = arrangements.take(is_rival)
    # Pairs that both arrangements share support neither, unless one of the two is turned over.
    shared = (rivals.partner == arrangements.partner[best]) & used & ~turned_over[is_rival, None]
    squares = np.where(shared, np.inf, rivals.squares)
    chance = log_chance(squares, b, int(rivals.tests[0]), tolerance, rivals.freedom, np.zeros(len(squares)))
    first = int(np.lexsort((-rivals.inliers, chance))[0])
    if np.isfinite(chance[first]):
        return float(chance[first]), int(rivals.inliers[first])
    return np.inf, int(rivals.inliers.max())


def _inside(points: Complexes, around: Complexes, border: float) -> Bools:
    """Mask of the points in the rectangle around others, widened by a share of its longer side."""
    x0, x1, y0, y1 = around.real.min(), around.real.max(), around.imag.min(), around.imag.max()
    extra = border * max(x1 - x0, y1 - y0)
    inside_x = (points.real >= x0 - extra) & (points.real <= x1 + extra)
    return inside_x & (points.imag >= y0 - extra) & (points.imag <= y1 + extra)


_NOT_BURNT = 0.05  # share of holes that were not burnt through
# Of the marks that one side alone shows, some are no holes at all, and no evidence of what the other side lost.
_LOST_OF_ALONE = 0.75


def self_likeness(points: Complexes, alone: tuple[int, int], *, tolerance_um: float, mirror: bool) -> str | None:
    """Return how a pattern may repeat itself, as part of a sentence, or None if it can be ruled out.

    ``points`` (u,) in um are all marks found on either side, in one frame, each once; those found on both come first,
    then those ``alone`` on either side: lost on the other, or no marks. On each side, a symmetric pattern that lost
    some marks looks like one without symmetry; together they give it away.
    """
    count, sure = len(points), len(points) - sum(alone)
    if count < 4:
        return None
    # Scales up to 1 % off: under those a pattern may repeat itself.
    arrangements = search(points, points, 0.01, tolerance_um, hands=(False, True) if mirror else (False,))
    is_moved = np.abs(arrangements.landed - points).max(axis=1) > 2.0 * tolerance_um
    symmetries = arrangements.take(arrangements.mirrored | is_moved)
    if len(symmetries.inliers) == 0:
        return None
    doubt = _log_evidence(symmetries, points, count - sure, tolerance_um)
    meets = symmetries.squares <= (REACH * tolerance_um) ** 2
    met, met_of_sure = np.count_nonzero(meets, axis=1), np.count_nonzero(meets[:, :sure], axis=1)
    gone = min(0.9, 0.1 + _LOST_OF_ALONE * (count - sure + 1.0) / (count + 2.0))
    lost = float(np.prod([_LOST_OF_ALONE * (c + 1.0) / (sure + c + 2.0) for c in alone]))
    # Where as many partners are missing as in fewer than this share of symmetric patterns, there is no symmetry.
    plausible = np.array([_at_least(count - k, count, gone) > 1e-3 for k in range(count + 1)])
    # The same for marks found on both sides, of whose partners only those lost on both are missing. A wrong arrangement
    # that agrees well makes losses look rare; the symmetry itself gives what has to be lost.
    lost_of_sure = [max(lost, (gap / max(sure + gap, 1)) ** 2) for gap in range(sure + 1)]
    of_sure = np.array([_at_least(gap, sure, _NOT_BURNT + p) > 3e-3 for gap, p in enumerate(lost_of_sure)])
    # How much better than chance a symmetry has to explain the marks before it counts: symmetric patterns are rare
    # among those that people burn, but a wrong match is worse than none. Marks on one line meet by chance so often that
    # what is plausible alone decides.
    limit = -2.0 if extents(points)[1] > 4.0 * tolerance_um else -8.0
    alike = np.array([_lost_alike(count - k, count, alone) for k in range(count + 1)])
    suspect = plausible[met] & of_sure[sure - met_of_sure] & (doubt + alike[met] > limit)
    if not np.any(suspect):
        return None
    # The most complete one is the clearest to name.
    worst = int(np.lexsort((-doubt, -met, ~suspect))[0])
    turn_deg = abs(float(np.degrees(np.angle(symmetries.alpha[worst]))))
    motion = "turned over" if symmetries.mirrored[worst] else f"turned by {turn_deg:.0f} deg"
    if not symmetries.mirrored[worst] and turn_deg < 5.0:
        middle = points.mean()
        landed = symmetries.alpha[worst] * middle + symmetries.gamma[worst] * np.conj(middle) + symmetries.beta[worst]
        motion = f"shifted by {abs(landed - middle):.0f} um"
    return f"of the {count} marks in all, {met[worst]} coincide with a mark again when the pattern is {motion}"


def _log_evidence(symmetries: Arrangements, points: Complexes, singles: int, tolerance: float) -> Floats:
    """log10 of how much better a symmetry explains the marks that meet, and those that do not, than chance does."""
    count = len(points)
    paired = symmetries.partner >= 0
    moved = paired & (np.abs(symmetries.landed - points) > 2.0 * tolerance)
    back = np.take_along_axis(symmetries.partner, np.maximum(symmetries.partner, 0).astype(np.intp), axis=1)
    mutual = moved & (back == np.arange(count))
    arcs = moved.sum(axis=1)
    swaps = mutual.sum(axis=1)
    # A half turn or a mirror image exchanges marks: each couple is one coincidence, and the first fixes the symmetry.
    exchange = swaps > 0.6 * arcs
    couples = arcs - swaps / 2
    free = np.where(exchange, couples - 1, arcs - 2)
    tests = np.where(exchange, count * (count - 1) / 2, symmetries.tests)
    rms = np.sqrt(np.sum(np.where(paired, symmetries.squares, 0.0), axis=1) / np.maximum(paired.sum(axis=1), 1))
    share = share_within(1.8 * rms + 0.08 * tolerance, points, tolerance)
    gone = min(0.9, max(0.1, (singles + 1.0) / (count + 2.0)))
    missing = count - paired.sum(axis=1)
    return (
        -np.maximum(free, 0) * np.log10(share) - np.log10(np.maximum(tests, 1))
        + missing * log10(gone) + paired.sum(axis=1) * log10(1.0 - gone)
    )  # fmt: skip


def _lost_alike(gap: int, count: int, alone: tuple[int, int]) -> float:
    """log10 of the probability that both sides lost the same ``gap`` marks and no others but those found alone.

    Either by chance, among the marks that each side lost, or because these holes were never burnt through.
    """
    whole = count + gap
    lost_first, lost_second = gap + alone[1], gap + alone[0]
    chance = comb(lost_first, gap) * comb(whole - lost_first, lost_second - gap) / comb(whole, lost_second)
    never = comb(whole, gap) * _NOT_BURNT**gap * (1.0 - _NOT_BURNT) ** count
    return log10(max(chance, never, 1e-300))


def _at_least(k: int, n: int, p: float) -> float:
    """Probability of ``k`` or more of ``n``, each with probability ``p``."""
    return sum(comb(n, j) * p**j * (1.0 - p) ** (n - j) for j in range(k, n + 1))
