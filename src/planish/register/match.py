"""Find which mark of one map is which mark of the other, from nothing but their positions.

Every pair of marks on one side is laid on every pair of like length on the other, the marks that then agree are
counted, and an arrangement is believed only if it is far better than chance and than every different arrangement.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from math import lgamma, log, log10

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planish.core.errors import CannotRegister, MarkError
from planish.core.transform import Similarity
from planish.register import _kernels
from planish.register.fit import fit_transform

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]

# Largest number of length comparisons; beyond it, base pairs are thinned out evenly.
MOST_COMPARISONS = 50_000_000
# A chance agreement as good as the one accepted is expected in fewer than 10**-3 of all searches.
ACCEPTED_LOG_CHANCE = -3.0
# A rival with few marks that chance would offer in one search of a hundred is no rival.
PLAUSIBLE_LOG_CHANCE = -2.0
# A rival that explains nearly as many marks counts even where it is this many tolerances off: a symmetric pattern
# placed to 4 um repeats itself to 8 um rms, and its worst hole may be three times as far out.
REACH = 1.6
# Share of `tolerance_um` within which an arrangement that agrees at only part of the marks counts as a rival. Holes of
# a regular pattern, placed to 4 um, agree with their neighbours' places to some 8 um, so most stay within 20 um.
CLOSE = 0.8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Matched:
    """Marks that belong together.

    Attributes
    ----------
    pairs : ndarray of int, shape (k, 2)
        Row in ``moving``, row in ``fixed``; sorted by the first.
    transform : Similarity
        Least-squares fit through the pairs, moving to fixed.
    mirrored : bool
        Whether the moving side had to be turned over.
    inliers, rival_inliers : int
        Marks that agree in this arrangement, and in the best different one.
    sentence : str
        What was found, for people.
    """

    pairs: Ints
    transform: Similarity
    mirrored: bool
    inliers: int
    rival_inliers: int
    sentence: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Arrangements:
    """Refined hypotheses between the smaller set ``a`` and the larger set ``b``, one a row."""

    partner: NDArray[np.int32]  # within REACH tolerances; -1 where there is none
    squares: Floats
    inliers: Ints  # within the tolerance
    near: Ints  # within REACH tolerances
    close: Ints  # within CLOSE tolerances
    log_chance: Floats
    close_log_chance: Floats
    landed: NDArray[np.complex128]
    mirrored: NDArray[np.bool_]


def match_marks(
    moving: ArrayLike,
    fixed: ArrayLike,
    *,
    scale_tolerance: float = 0.03,
    tolerance_um: float = 25.0,
    mirror: bool = False,
    names: tuple[str, str] = ("moving", "fixed"),
) -> Matched:
    """Match two sets of marks whose rotation and shift are unknown.

    Parameters
    ----------
    moving, fixed : array-like, shape (n, 2) and (m, 2), in um
        Mark centres ``(x, y)``, in any order, with marks missing and false marks on both sides.
    scale_tolerance : float
        The scale between the two lies within ``1 - scale_tolerance`` and ``1 + scale_tolerance``.
    tolerance_um : float
        Two marks agree if the arrangement puts them this close.
    mirror : bool
        Whether the moving side may also be turned over. Both hands then compete.
    names : (str, str)
        What the two sides are called in messages.

    Returns
    -------
    Matched

    Raises
    ------
    CannotRegister
        If there are fewer than three marks on a side, if fewer than 4 marks or 60 % of the smaller side agree, if the
        mirror image agrees better although ``mirror`` is not set, if as
        good an agreement is expected by chance, or if a different arrangement agrees nearly as well. Three marks on a
        side are enough when all three agree and their distances cannot be confused.
    MarkError
        If a position is not finite or an array has another shape.

    Notes
    -----
    Chance is judged a contrario: the expected number of arrangements of randomly scattered marks that agree at ``k``
    marks within ``r`` is ``tests * C(n - 2, k - 2) * p(r)**(k - 2)``.

    References
    ----------
    Hirn et al. (2009), section 2.4. Moisan and Stival (2004), Int. J. Comput. Vis. 57, 201,
    doi:10.1023/B:VISI.0000013094.38752.54 (agreement judged against chance).
    """
    source, target = _points(moving, names[0]), _points(fixed, names[1])
    seen = f"{len(source)} marks of the {names[0]} and {len(target)} of the {names[1]}"
    for name, points in zip(names, (source, target), strict=True):
        if len(points) < 3:
            raise CannotRegister(_too_few(seen, name, points))
    swapped = len(source) > len(target)
    a, b = (target, source) if swapped else (source, target)
    found = _search(a, b, scale_tolerance, tolerance_um, (False, True) if mirror else (False,))
    need = max(4, int(np.ceil(0.6 * len(a)))) if len(a) > 3 else 3
    if found is None:
        raise CannotRegister(_no_match(seen, 2, need, mirror))
    best = int(np.lexsort((-found.inliers, found.log_chance))[0])
    count = int(found.inliers[best])
    if count < need or found.log_chance[best] > ACCEPTED_LOG_CHANCE:
        raise CannotRegister(_no_match(seen, int(found.inliers.max()), need, mirror))
    if not mirror and _other_hand_is_better(a, b, float(found.log_chance[best]), scale_tolerance, tolerance_um):
        raise CannotRegister(
            f"{seen}: {count} agree, but the mirror image of one side agrees better still: one is probably seen from "
            "the wrong side. Check --top and --through; if the slices are numbered against the usual sense, "
            "pass --mirror."
        )
    rival, rival_count = _best_rival(found, best, tolerance_um)
    if len(a) == 3 and _confusable(a, b[found.partner[best]], 3.0 * tolerance_um):
        raise CannotRegister(
            f"{seen}: three marks match, but two of their three distances are alike within {3 * tolerance_um:g} um, so "
            "they could be taken for one another. Add a fourth mark, or give the pairs with --marks."
        )
    if rival:
        raise CannotRegister(
            f"{seen}: the best arrangement agrees at {count} marks, a different one at {rival_count}, so the pattern "
            f"is ambiguous (symmetric or regular). Give the pairs with --marks, or add marks that break the symmetry."
            + (" Without --mirror, only one hand would compete." if mirror else "")
        )
    hand = bool(found.mirrored[best])
    if _symmetric(b, found, best, scale_tolerance, tolerance_um, mirror):
        raise CannotRegister(
            f"{seen}: {count} agree, but the pattern of all marks seen is symmetric, and another arrangement may be "
            "the true one. Give the pairs with --marks, or add marks that break the symmetry."
        )
    rows = np.flatnonzero(found.squares[best] <= tolerance_um**2)
    pairs = np.stack([rows, found.partner[best][rows].astype(np.intp)], axis=1)
    pairs = pairs[:, ::-1] if swapped else pairs
    pairs = np.ascontiguousarray(pairs[np.argsort(pairs[:, 0])])
    fit = fit_transform(source[pairs[:, 0]], target[pairs[:, 1]], mirrored=hand)
    sentence = (
        f"{seen}: {count} agree (rotation {np.degrees(fit.transform.rotation_rad):.2f} deg, scale "
        f"{fit.transform.scale:.4f}{', mirrored' if hand else ''}, residual {fit.rms_um:.1f} um rms); "
        f"the next best arrangement agrees at {rival_count}."
    )
    if len(a) == 3:
        sentence += " Three marks only: all agree and their distances differ, but one false mark would not be noticed."
    return Matched(
        pairs=pairs,
        transform=fit.transform,
        mirrored=hand,
        inliers=count,
        rival_inliers=rival_count,
        sentence=sentence,
    )


def _points(marks: ArrayLike, name: str) -> Floats:
    points = np.array(marks, dtype=np.float64)
    if points.size == 0:
        return np.empty((0, 2))
    if points.ndim != 2 or points.shape[1] != 2:
        raise MarkError(f"The {name} marks have shape {points.shape}; (n, 2) is needed, one (x, y) in um a row.")
    bad = np.flatnonzero(~np.all(np.isfinite(points), axis=1))
    if bad.size:
        raise MarkError(f"Position of {name} mark {', '.join(str(i) for i in bad[:8])} is not finite.")
    return points


def _search(
    a: Floats, b: Floats, scale_tolerance: float, tolerance: float, hands: tuple[bool, ...]
) -> _Arrangements | None:
    """Try every two-point hypothesis and refine those with at least three agreeing marks."""
    base = np.array(list(combinations(range(len(a)), 2)), dtype=np.int64)
    affordable = max(200, MOST_COMPARISONS // max(1, len(b) * len(b)))
    if len(base) > affordable:
        base = base[np.linspace(0, len(base) - 1, affordable).astype(np.intp)]
    reach = REACH * tolerance
    cells = _kernels.build_cells(b, reach)
    tests = 0
    parts: list[tuple[NDArray[np.int32], Floats, NDArray[np.complex128], bool]] = []
    for hand in hands:
        points = a * (-1.0, 1.0) if hand else a
        rows = _kernels.list_hypotheses(
            base, b, 1.0 - scale_tolerance, 1.0 + scale_tolerance, 0.6 * tolerance, points, 3.0 * tolerance
        )
        tests += len(rows)
        counts = _kernels.count_agreements(rows, points, b, reach, cells)
        enough = max(3, int(0.4 * counts.max())) if len(counts) else 3
        partner, squares, alpha, beta = _kernels.refine(rows[counts >= enough], points, b, reach, cells, 3)
        scale = np.abs(alpha)
        fine = (np.abs(scale - 1.0) <= scale_tolerance) & (np.sum(partner >= 0, axis=1) >= 3)
        _, first = np.unique(partner[fine], axis=0, return_index=True)
        chosen = np.flatnonzero(fine)[first]
        landed = alpha[chosen, None] * (points[:, 0] + 1j * points[:, 1]) + beta[chosen, None]
        parts.append((partner[chosen], squares[chosen], landed, hand))
    partner = np.concatenate([part[0] for part in parts])
    if len(partner) == 0:
        return None
    squares = np.concatenate([part[1] for part in parts])
    within = [np.where(squares <= limit * limit, squares, np.inf) for limit in (tolerance, CLOSE * tolerance)]
    log_chance, inliers = _chance(within[0], b, tests, tolerance)
    close_log_chance, close_count = _chance(within[1], b, tests, tolerance)
    return _Arrangements(
        partner=partner,
        squares=squares,
        inliers=inliers,
        near=np.sum(partner >= 0, axis=1).astype(np.intp),
        close=close_count,
        log_chance=log_chance,
        close_log_chance=close_log_chance,
        landed=np.concatenate([part[2] for part in parts]),
        mirrored=np.concatenate([np.full(len(part[0]), part[3]) for part in parts]),
    )


def _other_hand_is_better(a: Floats, b: Floats, log_chance: float, scale_tolerance: float, tolerance: float) -> bool:
    """Return whether turning one side over explains the marks better than leaving it: only to refuse, never to use."""
    other = _search(a, b, scale_tolerance, tolerance, (True,))
    return other is not None and float(other.log_chance.min()) < log_chance - 1.0


def _chance(squares: Floats, b: Floats, tests: int, tolerance: float) -> tuple[Floats, Ints]:
    """Return log10 of the expected number of chance arrangements as good as each row, and the finite counts."""
    n = squares.shape[1]
    counts = np.sum(np.isfinite(squares), axis=1)
    centred = b - b.mean(axis=0)
    axes = np.linalg.eigh(centred.T @ centred)[1]
    extents = np.ptp(centred @ axes, axis=0)
    choices = np.array([_log10_choose(n - 2, k - 2) if k >= 2 else 0.0 for k in range(n + 1)])
    largest = np.sqrt(np.max(np.where(np.isfinite(squares), squares, 0.0), axis=1))
    # Fitting shrinks residuals by 1 - 2/k on average in the square; half a pixel's error keeps zero residuals finite.
    radius = np.sqrt(largest**2 * counts / np.maximum(counts - 2, 1) + (0.08 * tolerance) ** 2)
    long_side, short_side = max(extents.max(), tolerance), extents.min()
    share = np.minimum(1.0, 2 * radius / long_side) * np.minimum(1.0, np.pi / 2 * radius / max(short_side, 1e-300))
    share = np.minimum(1.0, len(b) * share)
    result = log10(max(tests, 1)) + choices[counts] + (counts - 2) * np.log10(share)
    return np.where(counts >= 3, result, np.inf), counts.astype(np.intp)


def _log10_choose(n: int, k: int) -> float:
    return (lgamma(n + 1) - lgamma(k + 1) - lgamma(n - k + 1)) / log(10.0)


def _best_rival(found: _Arrangements, best: int, tolerance: float) -> tuple[bool, int]:
    """Return whether a different arrangement is about as good, and at how many marks the best different one agrees."""
    mine = np.where(found.squares[best] <= tolerance * tolerance, found.partner[best], -1)
    used = mine >= 0
    moved = np.max(np.abs(found.landed[:, used] - found.landed[best, used]), axis=1)
    turned_over = found.mirrored != found.mirrored[best]
    different = turned_over | (moved > 2.0 * tolerance)
    if not np.any(different):
        return False, 0
    # Pairs that both arrangements share say nothing for either, unless one of the two is turned over.
    shared = np.sum((found.partner == mine) & used, axis=1) * ~turned_over
    own = found.inliers[best] - shared
    whole = (found.near - shared) >= 0.8 * own
    partly = (found.close - shared > 0.5 * own) & (found.close_log_chance < PLAUSIBLE_LOG_CHANCE)
    refused = different & (whole | partly)
    among = refused if np.any(refused) else different
    return bool(np.any(refused)), int(found.inliers[among].max())


def _confusable(a: Floats, b: Floats, least: float) -> bool:
    """Return whether two sides of the triangle are alike within ``least``, on either side."""
    for corners in (a, b):
        sides = np.sort(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1))
        if np.diff(sides).min() < least:
            return True
    return False


def _symmetric(
    b: Floats, found: _Arrangements, best: int, scale_tolerance: float, tolerance: float, mirror: bool
) -> bool:
    """Return whether all marks seen on either side, laid together, fit onto themselves in another way."""
    lonely = found.squares[best] > tolerance * tolerance
    landed = found.landed[best][lonely]
    union = np.concatenate([b, np.stack([landed.real, landed.imag], axis=1)])
    # Only the field both sides show counts: marks of a larger map are no evidence about the smaller.
    low = np.minimum.reduce([np.stack([z.real, z.imag]).min(axis=1) for z in (found.landed[best],)]) - tolerance
    high = np.maximum.reduce([np.stack([z.real, z.imag]).max(axis=1) for z in (found.landed[best],)]) + tolerance
    union = union[np.all((union >= low) & (union <= high), axis=1)]
    if len(union) < 4:
        return False
    again = _search(union, union, scale_tolerance, tolerance, (False, True) if mirror else (False,))
    if again is None:
        return False
    still = np.max(np.abs(again.landed - (union[:, 0] + 1j * union[:, 1])), axis=1) <= 2.0 * tolerance
    return bool(np.any(~(still & ~again.mirrored) & (again.close >= (0.75 if len(union) < 8 else 0.6) * len(union))))


def _too_few(seen: str, name: str, points: Floats) -> str:
    where = ", ".join(f"({x:.0f}, {y:.0f})" for x, y in points)
    return (
        f"{seen}: {len(points)} on the side of the {name}"
        + (f" (at {where} um)" if len(points) else "")
        + " cannot be matched without a hint; at least 3 on each side are needed, 4 or more are better. "
        "Check that the holes are in the field and that the pixel and voxel sizes are right, widen the range of hole "
        "diameters, or give the pairs with --marks."
    )


def _no_match(seen: str, count: int, need: int, mirror: bool) -> str:
    if need == 3:
        return (
            f"{seen}: with three marks on a side an agreement may be chance. Add a fourth, or give pairs with --marks."
        )
    return (
        f"{seen}: no arrangement explains them: at most {count} agree, and at least {need} have to, closer than chance "
        "would bring them. Check the pixel and voxel sizes, and --top: the side that the image shows"
        + ("" if mirror else "; if the slices are numbered against the usual sense pass --mirror")
        + "; or give the pairs with --marks."
    )
