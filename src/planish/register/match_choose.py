"""The best arrangement of two sets of marks, and the best different one.

Also whether the pattern may repeat itself.
"""

import math
from math import comb, log10
from typing import NamedTuple

import numpy as np
from scipy import special

from planish.core.typing import Bools, Floats, Ints
from planish.register.match_search import (
    ACCEPTED,
    REACH,
    Arrangements,
    Complexes,
    bounds_of,
    extents,
    log_chance,
    marks_needed,
    search,
    share_within,
)
from planish.register.pairs import as_complex


class BestMatch(NamedTuple):
    """The best arrangement of two sides; by default, none.

    ``pairs`` (k, 2) hold the row of the first side and of the second, sorted by the first; with
    fewer than ``needed_count`` they may be chance. ``log_chance`` is log10 of how many such
    arrangements chance would offer, ``second_log_chance`` that of the best different match, in
    which ``second_best_count`` marks agree; ``stretch`` the share by which one direction is longer
    than the other. ``small_points`` and ``large_points`` are the marks of the smaller side, which
    is the second one if ``is_swapped``, and of the larger side, in the frame of the latter.
    """

    pairs: Ints = np.empty((0, 2), np.intp)
    small_points: Complexes = np.empty(0, complex)
    large_points: Complexes = np.empty(0, complex)
    mirrored: bool = False
    needed_count: int = 4
    log_chance: float = 10.0
    second_log_chance: float = np.inf
    second_best_count: int = 0
    stretch: float = 0.0
    is_swapped: bool = False

    def together(self) -> tuple[Complexes, tuple[int, int]]:
        """All marks of the field that both sides show, first the pairs.

        And how many each side alone shows.
        """
        small_rows, large_rows = self.pairs.T
        if self.is_swapped:
            small_rows, large_rows = large_rows, small_rows
        small_alone = self._in_both(np.delete(self.small_points, small_rows))
        large_alone = self._in_both(np.delete(self.large_points, large_rows))
        paired = self.large_points[large_rows]
        points = np.concatenate([paired, small_alone, large_alone])
        return points, (len(small_alone), len(large_alone))

    def _in_both(self, points: Complexes) -> Complexes:
        """Those of some points that lie in the fields of both sides."""
        # Marks of a larger map are no evidence about a smaller one.
        is_near = _inside(points, self.large_points, 0.15)
        return points[is_near & _inside(points, self.small_points, 0.15)]


def choose(
    source: Floats,
    target: Floats,
    scale_tolerance: float,
    tolerance_um: float,
    *,
    hands: tuple[bool, ...],
) -> BestMatch:
    """Return the best arrangement of three or more marks a side, (n, 2) and (m, 2) in um.

    Marks agree within ``tolerance_um``; the scale may be off 1 by ``scale_tolerance``; of the
    ``hands`` that are tried, True turns one side over.
    """
    is_swapped = len(source) > len(target)
    smaller, larger = sorted((source, target), key=len)
    a = as_complex(smaller, False)
    b = as_complex(larger, False)
    arrangements = search(a, b, scale_tolerance, tolerance_um, hands=hands)
    if len(arrangements.inliers) == 0:
        return BestMatch()
    within_tolerance = np.minimum(arrangements.squares, tolerance_um**2)
    misfit = np.sum(within_tolerance, axis=1)
    first, *_ = np.lexsort((misfit, arrangements.log_chance))
    best = arrangements.take(first)
    # Pairs are within the tolerance, or less where the others agree much better. The median
    # distance of a normal scatter in the plane is 1.18 standard deviations.
    agreeing_squares = best.squares[best.squares <= tolerance_um * tolerance_um]
    count = len(agreeing_squares)
    free_count = max(count - float(best.freedom), 1.0)
    scatter = np.sqrt(np.median(agreeing_squares) * count / free_count) / 1.18
    # A pair this many times further apart than the others are is not one, however wide the
    # tolerance.
    largest_um = float(min(tolerance_um, 5.0 * scatter + 0.1 * tolerance_um))
    rows = np.flatnonzero(best.squares <= largest_um**2)
    sides = [rows, best.partner[rows].astype(np.intp)]
    if is_swapped:
        sides.reverse()
    pairs = np.stack(sides, axis=1)
    # Of the marks of the smaller side that lie in the field of the other, 35 % have to agree.
    common_count = np.count_nonzero(_inside(best.landed, b, 0.05))
    needed_count = 3
    if len(a) > 3:
        needed_count = max(4, math.ceil(0.35 * common_count))
    if len(pairs) < needed_count or best.log_chance > ACCEPTED:
        chance_count = marks_needed(len(a), b, int(best.tests), tolerance_um)
        needed_count = max(needed_count, chance_count, len(pairs) + 1)
    rival_chance, rival_count = _rival(arrangements, best, b, tolerance_um)
    return BestMatch(
        pairs=pairs[np.argsort(pairs[:, 0])],
        mirrored=bool(best.mirrored),
        needed_count=needed_count,
        log_chance=float(best.log_chance),
        second_log_chance=rival_chance,
        second_best_count=rival_count,
        stretch=float(2.0 * abs(best.gamma) / abs(best.alpha)),
        is_swapped=is_swapped,
        small_points=best.landed,
        large_points=b,
    )


def _rival(
    arrangements: Arrangements, best: Arrangements, b: Complexes, tolerance: float
) -> tuple[float, int]:
    """Give log10 of how often chance offers the best different arrangement.

    Also gives how many marks agree in it. ``best`` is the row of the best one; another is different
    where it moves a mark by two tolerances (um), or turns one side over. Infinite, with 0 marks,
    where there is none.
    """
    is_used = best.squares <= tolerance * tolerance
    moves = arrangements.landed[:, is_used] - best.landed[is_used]
    is_turned_over = arrangements.mirrored != best.mirrored
    moved_um = np.abs(moves).max(axis=1)
    is_rival = is_turned_over | (moved_um > 2.0 * tolerance)
    if not is_rival.any():
        return np.inf, 0
    rivals = arrangements.take(is_rival)
    # Pairs that both arrangements share support neither, unless one of the two is turned over.
    is_shared = (rivals.partner == best.partner) & is_used
    is_shared &= ~is_turned_over[is_rival, None]
    squares = np.where(is_shared, np.inf, rivals.squares)
    tests = int(rivals.tests[0])
    no_power = np.zeros(len(squares))
    log_chances = log_chance(squares, b, tests, tolerance, rivals.freedom, no_power)
    best_rival, *_ = np.lexsort((-rivals.inliers, log_chances))
    if np.isfinite(log_chances[best_rival]):
        return float(log_chances[best_rival]), int(rivals.inliers[best_rival])
    return np.inf, int(rivals.inliers.max())


def _inside(points: Complexes, field_points: Complexes, border: float) -> Bools:
    """Mask of the points in the rectangle around others, widened by a share of its longer side."""
    x0, x1, y0, y1 = bounds_of(field_points)
    margin = border * max(x1 - x0, y1 - y0)
    x = points.real
    y = points.imag
    inside_x = (x >= x0 - margin) & (x <= x1 + margin)
    return inside_x & (y >= y0 - margin) & (y <= y1 + margin)


_NOT_BURNT = 0.05  # share of holes that were not burnt through
# Of the marks that one side alone shows, some are no holes at all, and no evidence of what the
# other side lost.
_LOST_OF_ALONE = 0.75


def self_likeness(
    points: Complexes, alone_counts: tuple[int, int], *, tolerance_um: float, mirror: bool
) -> str | None:
    """Return how a pattern may repeat itself, as part of a sentence, or None if that is ruled out.

    ``points`` (u,) in um are all marks found on either side, in one frame, each once; those found
    on both come first, then those found on one side alone, ``alone_counts`` of either: lost on the
    other, or no marks. On each side, a symmetric pattern that lost some marks looks like one
    without symmetry; together they give it away.
    """
    count = len(points)
    n_common = count - sum(alone_counts)
    if count < 4:
        return None
    hands = (False, True) if mirror else (False,)
    # Scales up to 1 % off: under those a pattern may repeat itself.
    arrangements = search(points, points, 0.01, tolerance_um, hands=hands)
    moved_um = np.abs(arrangements.landed - points).max(axis=1)
    is_symmetry = arrangements.mirrored | (moved_um > 2.0 * tolerance_um)
    symmetries = arrangements.take(is_symmetry)
    if len(symmetries.inliers) == 0:
        return None
    log_evidence = _log_evidence(symmetries, points, count - n_common, tolerance_um)
    is_met = symmetries.squares <= (REACH * tolerance_um) ** 2
    n_met = np.count_nonzero(is_met, axis=1)
    n_common_met = np.count_nonzero(is_met[:, :n_common], axis=1)
    is_plausible, is_plausible_common = _plausible_gaps(n_common, alone_counts)
    # How much better than chance a symmetry has to explain the marks before it counts: symmetric
    # patterns are rare among those that people burn, but a wrong match is worse than none. Marks on
    # one line meet by chance so often that what is plausible alone decides.
    _, short_side_um = extents(points)
    evidence_limit = -2.0 if short_side_um > 4.0 * tolerance_um else -8.0
    # By the number of marks that do not meet another one.
    log_alike_by_lost = [_lost_alike(k, count, alone_counts) for k in range(count + 1)]
    log_alike = np.array(log_alike_by_lost)
    n_lost = count - n_met
    is_suspect = log_evidence + log_alike[n_lost] > evidence_limit
    is_suspect &= is_plausible[n_lost]
    is_suspect &= is_plausible_common[n_common - n_common_met]
    if not np.any(is_suspect):
        return None
    # The most complete one is the clearest to name.
    worst, *_ = np.lexsort((-log_evidence, -n_met, ~is_suspect))
    return (
        f"of the {count} marks in all, {n_met[worst]} coincide with a mark again when the pattern"
        f" is {_motion_text(symmetries.take(worst), points.mean())}"
    )


def _plausible_gaps(n_common: int, alone_counts: tuple[int, int]) -> tuple[Bools, Bools]:
    """Return whether 0, 1, 2 ... partners may be missing in a symmetric pattern.

    Of all marks, (n + 1,), and of those found on both sides, (n_common + 1,). More are missing in
    fewer than a small share of such patterns.
    """
    n_alone = sum(alone_counts)
    count = n_common + n_alone
    alone_share = _LOST_OF_ALONE * (n_alone + 1.0) / (count + 2.0)
    missing_share = min(0.9, 0.1 + alone_share)
    gaps = np.arange(count + 1)
    # bdtrc(k - 1, n, p): probability of k or more of n, each with probability p.
    is_plausible = special.bdtrc(gaps - 1, count, missing_share) > 1e-3
    # The same for marks found on both sides, of whose partners only those lost on both are missing.
    alone = np.array(alone_counts)
    side_shares = _LOST_OF_ALONE * (alone + 1.0) / (n_common + alone + 2.0)
    gaps = np.arange(n_common + 1)
    # A wrong arrangement that agrees well makes losses look rare; the symmetry itself gives what
    # has to be lost.
    gap_shares = (gaps / np.maximum(n_common + gaps, 1)) ** 2
    lost_shares = _NOT_BURNT + np.maximum(side_shares.prod(), gap_shares)
    return is_plausible, special.bdtrc(gaps - 1, n_common, lost_shares) > 3e-3


def _motion_text(symmetry: Arrangements, middle: complex) -> str:
    """Say how a symmetry, one row, moves the pattern about its middle."""
    turn_deg = abs(float(np.degrees(np.angle(symmetry.alpha))))
    if symmetry.mirrored:
        return "turned over"
    if turn_deg >= 5.0:
        return f"turned by {turn_deg:.0f} deg"
    moved = symmetry.alpha * middle + symmetry.gamma * np.conj(middle) + symmetry.beta
    return f"shifted by {abs(moved - middle):.0f} um"


def _log_evidence(
    symmetries: Arrangements, points: Complexes, single_count: int, tolerance: float
) -> Floats:
    """Give log10 of how much better than chance each symmetry (h,) explains the marks (n,).

    Both those that meet a mark within the ``tolerance`` (um) and those that do not, of which
    ``single_count`` were found on one side alone.
    """
    count = len(points)
    is_paired = symmetries.partner >= 0
    is_moved = is_paired & (np.abs(symmetries.landed - points) > 2.0 * tolerance)
    columns = np.maximum(symmetries.partner, 0)
    reverse_partner = np.take_along_axis(symmetries.partner, columns, axis=1)
    is_mutual = is_moved & (reverse_partner == np.arange(count))
    moved_counts = is_moved.sum(axis=1)
    mutual_counts = is_mutual.sum(axis=1)
    # A half turn or a mirror image exchanges marks: each couple is one coincidence, and the first
    # fixes the symmetry.
    is_exchange = mutual_counts > 0.6 * moved_counts
    pair_counts = moved_counts - mutual_counts / 2
    free_counts = np.where(is_exchange, pair_counts - 1, moved_counts - 2)
    tests = np.where(is_exchange, count * (count - 1) / 2, symmetries.tests)
    paired_counts = is_paired.sum(axis=1)
    paired_squares = np.where(is_paired, symmetries.squares, 0.0)
    mean_squares = paired_squares.sum(axis=1) / np.maximum(paired_counts, 1)
    radius = 1.8 * np.sqrt(mean_squares) + 0.08 * tolerance
    meeting_shares = share_within(radius, points, tolerance)
    single_share = (single_count + 1.0) / (count + 2.0)
    missing_share = min(0.9, max(0.1, single_share))
    log_met = -np.maximum(free_counts, 0) * np.log10(meeting_shares)
    log_missing = (count - paired_counts) * log10(missing_share)
    log_paired = paired_counts * log10(1.0 - missing_share)
    return log_met - np.log10(np.maximum(tests, 1)) + log_missing + log_paired


def _lost_alike(n_lost: int, count: int, alone_counts: tuple[int, int]) -> float:
    """Give log10 of the probability that both sides lost the same ``n_lost`` marks.

    They lost no others but those found alone.

    Either by chance, among the marks that each side lost, or because these holes were never burnt
    through.
    """
    n_holes = count + n_lost
    # What one side lost, the other one shows alone.
    alone_first, alone_second = alone_counts
    n_first = n_lost + alone_second
    n_second = n_lost + alone_first
    alike_count = comb(n_first, n_lost) * comb(n_holes - n_first, alone_first)
    chance_alike = alike_count / comb(n_holes, n_second)
    chance_unburnt = comb(n_holes, n_lost) * _NOT_BURNT**n_lost * (1.0 - _NOT_BURNT) ** count
    return log10(max(chance_alike, chance_unburnt, 1e-300))
