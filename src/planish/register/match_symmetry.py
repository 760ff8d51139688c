"""Symmetry and regularity of the pattern behind two sets of marks, with marks lost and marks that are none.

All marks found on either side are combined and laid on themselves in every other orientation. A symmetric pattern of
which each side lost some marks looks, on each side, like a pattern without symmetry; together they give it away.
"""

from __future__ import annotations

from math import comb, log10

import numpy as np

from planish.core.typing import Floats
from planish.register.match_search import REACH, Arrangements, Complexes, extents, search, share_within

# Scales under which a pattern may repeat itself.
_SCALE = 0.01
# log10 of how much better than chance a symmetry has to explain the marks before it counts: symmetric patterns are
# rare among those that people burn, but a wrong match is worse than none.
_LOG_DOUBT = -2.0
# Where as many partners are missing as in fewer than this share of symmetric patterns, there is no symmetry.
_RARE = 1e-3
# The same for marks found on both sides, of whose partners only those lost on both are missing. Their share is never
# taken to be smaller than that of holes that were not burnt through.
_RARE_OF_SURE = 3e-3
_NOT_BURNT = 0.05
# Of the marks that one side alone shows, some are no holes at all, and no evidence of what the other side lost.
_LOST_OF_ALONE = 0.75
# Marks on one line meet by chance so often that what is plausible alone decides.
_LOG_DOUBT_ON_A_LINE = -8.0
_MOST_TRIED = 25_000


def self_likeness(points: Complexes, alone: tuple[int, int], *, tolerance_um: float, mirror: bool) -> str | None:
    """Return how a pattern may repeat itself, as part of a sentence, or None if it can be ruled out.

    ``points`` (u,) in um are all marks found on either side, in one frame, each once; those found on both come first,
    then those ``alone`` on either side: lost on the other, or no marks.
    """
    count, singles = len(points), sum(alone)
    sure = count - singles
    if count < 4:
        return None
    arrangements = search(
        points, points, _SCALE, tolerance_um, hands=(False, True) if mirror else (False,), least_share=0.3,
        most_tried=_MOST_TRIED,
    )  # fmt: skip
    if arrangements is None:
        return None
    is_moved = np.abs(arrangements.landed - points).max(axis=1) > 2.0 * tolerance_um
    symmetries = arrangements.take(arrangements.mirrored | is_moved)
    if len(symmetries.inliers) == 0:
        return None
    doubt = _log_evidence(symmetries, points, singles, tolerance_um)
    meets = symmetries.squares <= (REACH * tolerance_um) ** 2
    met, met_of_sure = np.count_nonzero(meets, axis=1), np.count_nonzero(meets[:, :sure], axis=1)
    gone = min(0.9, 0.1 + _LOST_OF_ALONE * (singles + 1.0) / (count + 2.0))
    lost = float(np.prod([_LOST_OF_ALONE * (c + 1.0) / (sure + c + 2.0) for c in alone]))
    plausible = np.array([_at_least(count - k, count, gone) > _RARE for k in range(count + 1)])
    # A wrong arrangement that agrees well makes losses look rare; the symmetry itself gives what has to be lost.
    of_sure = np.array(
        [
            _at_least(gap, sure, _NOT_BURNT + max(lost, (gap / max(sure + gap, 1)) ** 2)) > _RARE_OF_SURE
            for gap in range(sure, -1, -1)
        ]
    )
    limit = _LOG_DOUBT if extents(points)[1] > 4.0 * tolerance_um else _LOG_DOUBT_ON_A_LINE
    alike = np.array([_lost_alike(count - k, count, alone) for k in range(count + 1)])
    suspect = plausible[met] & of_sure[met_of_sure] & (doubt + alike[met] > limit)
    if not np.any(suspect):
        return None
    # The most complete one is the clearest to name.
    worst = int(np.lexsort((-doubt, -met, ~suspect))[0])
    turn_deg = abs(float(np.degrees(np.angle(symmetries.alpha[worst]))))
    motion = "turned over" if symmetries.mirrored[worst] else f"turned by {turn_deg:.0f} deg"
    if not symmetries.mirrored[worst] and turn_deg < 5.0:
        motion = f"shifted by {abs(_landing(symmetries, worst, points.mean()) - points.mean()):.0f} um"
    return f"of the {count} marks in all, {met[worst]} coincide with a mark again when the pattern is {motion}"


def _landing(arrangements: Arrangements, row: int, point: complex) -> complex:
    """Place to which an arrangement takes a point."""
    return arrangements.alpha[row] * point + arrangements.gamma[row] * np.conj(point) + arrangements.beta[row]


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
