"""The best arrangement of two sets of marks, the best different one, and whether the pattern may repeat itself."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb, log10

import numpy as np

from planish.core.typing import Bools, Floats, Ints
from planish.register.match_search import REACH, Arrangements, Complexes, chance_without, extents, search, share_within
from planish.register.pairs import as_complex


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BestMatch:
    """The best arrangement, in row ``best`` of all that were found, of two sides, whichever of them is larger.

    ``swapped`` says that the smaller side is the second one; ``pairs`` (k, 2) hold the row of the first side and of the
    second, sorted by the first; ``log_chance`` is log10 of how many such arrangements chance would offer,
    ``second_log_chance`` that of the best different match, in which ``second_best`` marks agree.
    """

    arrangements: Arrangements
    best: int
    swapped: bool
    small: Complexes
    large: Complexes
    pairs: Ints
    log_chance: float
    second_log_chance: float
    second_best: int

    @property
    def mirrored(self) -> bool:
        """True where one side is turned over."""
        return bool(self.arrangements.mirrored[self.best])

    @property
    def needed(self) -> int:
        """Number of marks that have to agree at least."""
        if len(self.small) == 3:
            return 3
        in_common_field = np.count_nonzero(_inside(self.arrangements.landed[self.best], self.large, 0.05))
        # Of the marks of the smaller side that lie in the field of the other, this share has to agree.
        return max(4, int(np.ceil(0.35 * in_common_field)))

    def together(self) -> tuple[Complexes, tuple[int, int]]:
        """All marks of the field that both sides show, first the pairs; and how many each side alone shows."""
        landed = self.arrangements.landed[self.best]
        rows, columns = self.pairs.T[::-1] if self.swapped else self.pairs.T
        lonely, other = np.delete(landed, rows), np.delete(self.large, columns)
        # Marks of a larger map are no evidence about a smaller one.
        alone = [
            points[_inside(points, self.large, 0.15) & _inside(points, landed, 0.15)] for points in (lonely, other)
        ]
        return np.concatenate([self.large[columns], *alone]), (len(alone[0]), len(alone[1]))


def choose(
    source: Floats, target: Floats, scale_tolerance: float, tolerance_um: float, *, hands: tuple[bool, ...]
) -> BestMatch | None:
    """Return the best arrangement of three or more marks a side, (n, 2) and (m, 2) in um; None where none agree."""
    swapped = len(source) > len(target)
    a, b = (as_complex(p, False) for p in ((target, source) if swapped else (source, target)))
    arrangements = search(a, b, scale_tolerance, tolerance_um, hands=hands)
    if arrangements is None:
        return None
    misfit = np.sum(np.minimum(arrangements.squares, tolerance_um**2), axis=1)
    best = int(np.lexsort((misfit, arrangements.log_chance))[0])
    rival_chance, rival_count = _rival(arrangements, best, b, tolerance_um)
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
    return BestMatch(
        arrangements=arrangements,
        best=best,
        swapped=swapped,
        small=a,
        large=b,
        pairs=np.ascontiguousarray(pairs[np.argsort(pairs[:, 0])]),
        log_chance=float(arrangements.log_chance[best]),
        second_log_chance=rival_chance,
        second_best=rival_count,
    )


def _rival(arrangements: Arrangements, best: int, b: Complexes, tolerance: float) -> tuple[float, int]:
    """Give log10 of how often chance offers the best different arrangement, and the marks that agree in it."""
    used = arrangements.squares[best] <= tolerance * tolerance
    moved = np.max(np.abs(arrangements.landed[:, used] - arrangements.landed[best, used]), axis=1)
    turned_over = arrangements.mirrored != arrangements.mirrored[best]
    rivals = arrangements.take(turned_over | (moved > 2.0 * tolerance))
    if len(rivals.inliers) == 0:
        return np.inf, 0
    # Pairs that both arrangements share support neither, unless one of the two is turned over.
    over = (rivals.mirrored != arrangements.mirrored[best])[:, None]
    shared = (rivals.partner == arrangements.partner[best]) & used & ~over
    chance = chance_without(rivals, b, shared, tolerance)
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
    arrangements = search(
        points, points, 0.01, tolerance_um, hands=(False, True) if mirror else (False,), least_share=0.3,
        most_tried=25_000,
    )  # fmt: skip
    if arrangements is None:
        return None
    is_moved = np.abs(arrangements.landed - points).max(axis=1) > 2.0 * tolerance_um
    symmetries = arrangements.take(arrangements.mirrored | is_moved)
    if len(symmetries.inliers) == 0:
        return None
    doubt = _log_evidence(symmetries, points, count - sure, tolerance_um)
    meets = symmetries.squares <= (REACH * tolerance_um) ** 2
    met, met_of_sure = np.count_nonzero(meets, axis=1), np.count_nonzero(meets[:, :sure], axis=1)
    gone = min(0.9, 0.1 + _LOST_OF_ALONE * (count - sure + 1.0) / (count + 2.0))
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
        away = symmetries.alpha[worst] * points.mean() + symmetries.gamma[worst] * np.conj(points.mean())
        motion = f"shifted by {abs(away + symmetries.beta[worst] - points.mean()):.0f} um"
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
