"""Matching where the designed positions are known: each side is matched to the design, and the two are joined.

A side that lost some marks still has most of the design, so that two sides which share few marks can be matched; and a
symmetry that one side alone seems to have is judged by the design.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planish.core.errors import CannotRegister, MarkError
from planish.core.transform import Similarity
from planish.register.match import Matched
from planish.register.match_choose import (
    ACCEPTED_LOG_CHANCE,
    MARGIN,
    Choice,
    checked_points,
    choose,
    fit_similarity,
)
from planish.register.match_search import marks_needed

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]

# From so many marks on both sides on, they alone give the transformation; with fewer, the design helps.
_ENOUGH_SHARED = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MatchedToDesign:
    """Marks of one side and the designed holes that they are.

    Attributes
    ----------
    pairs : ndarray of int, shape (k, 2)
        Row in the marks, row in the design; sorted by the second.
    labels : tuple of str
        Names of those holes.
    transform : Similarity
        Least-squares fit through the pairs, design to marks.
    mirrored : bool
        Whether the design had to be turned over.
    second_best : int
        Marks that agree in the best different arrangement.
    log_chance : float
        log10 of how many such agreements chance would offer.
    missing : tuple of str
        Names of the designed holes that were not found.
    sentence : str
        Counts and residual.
    """

    pairs: Ints
    labels: tuple[str, ...]
    transform: Similarity
    mirrored: bool
    second_best: int
    log_chance: float
    missing: tuple[str, ...]
    sentence: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MatchedByDesign(Matched):
    """Marks of two sides that are the same designed hole.

    ``pairs`` are the holes found on both sides; ``transform`` goes through them where there are at least four, and
    through the design otherwise.

    Attributes
    ----------
    labels : tuple of str
        Name of the hole of each row of ``pairs``.
    moving, fixed : MatchedToDesign
        Match of each side to the design.
    """

    labels: tuple[str, ...]
    moving: MatchedToDesign
    fixed: MatchedToDesign


def match_to_design(
    marks: ArrayLike,
    design: ArrayLike,
    *,
    labels: Sequence[str] | None = None,
    scale_tolerance: float = 0.03,
    tolerance_um: float = 25.0,
    mirror: bool = False,
    name: str = "map",
) -> MatchedToDesign:
    """Find which designed hole each mark is.

    Parameters
    ----------
    marks : array-like, shape (n, 2), in um
        Mark centres ``(x, y)`` with marks missing and false marks.
    design : array-like, shape (d, 2), in um
        Designed positions of all holes, as an image shows them: y down, or ``mirror`` is needed.
    labels : sequence of str, optional
        Names of the holes; their numbers from 1 otherwise.
    scale_tolerance, tolerance_um : float
        As in :func:`match_marks`.
    mirror : bool
        Whether the design may be turned over.
    name : str
        What the side is called in messages.

    Returns
    -------
    MatchedToDesign

    Raises
    ------
    CannotRegister
        If there are fewer than three marks or holes, if fewer than 4 marks or 35 % agree, if as good an agreement is
        expected by chance, or if a different arrangement is nearly as good, as in a symmetric design.
    MarkError
        If a position is not finite, an array has another shape, or there is not one label a hole.
    """
    points, holes, names = _checked(marks, design, labels, name)
    hands = (False, True) if mirror else (False,)
    found = choose(holes, points, scale_tolerance=scale_tolerance, tolerance_um=tolerance_um, hands=hands)
    return _settle(found, points, holes, names, (scale_tolerance, tolerance_um), name)


def match_by_design(
    moving: ArrayLike,
    fixed: ArrayLike,
    design: ArrayLike,
    *,
    labels: Sequence[str] | None = None,
    scale_tolerance: float = 0.03,
    tolerance_um: float = 25.0,
    mirror: bool = False,
    names: tuple[str, str] = ("moving", "fixed"),
) -> MatchedByDesign:
    """Match two sets of marks through the designed positions of the holes.

    Parameters
    ----------
    moving, fixed : array-like, shape (n, 2) and (m, 2), in um
        Mark centres ``(x, y)``.
    design : array-like, shape (d, 2), in um
        Designed positions of all holes, of either hand: both sides may show the sheet from behind.
    labels, scale_tolerance, tolerance_um, names
        As in :func:`match_to_design` and :func:`match_marks`.
    mirror : bool
        Whether the moving side may be turned over against the fixed one.

    Returns
    -------
    MatchedByDesign

    Raises
    ------
    CannotRegister
        As :func:`match_to_design`, for either side; or if the sides show different hands although ``mirror`` is not
        set.
    MarkError
        As :func:`match_to_design`.
    """
    source, holes, called = _checked(moving, design, labels, names[0])
    target, _, _ = _checked(fixed, design, labels, names[1])
    sides = ((source, names[0]), (target, names[1]))
    found = {
        (k, hand): choose(holes, points, scale_tolerance=scale_tolerance, tolerance_um=tolerance_um, hands=(hand,))
        for k, (points, _) in enumerate(sides)
        for hand in (False, True)
    }
    # Which hand the design has against the sheet is not known; both sides have the same, unless mirrored.
    sums = {
        pair: sum(_chance(found[k, hand]) for k, hand in enumerate(pair)) for pair in product((False, True), repeat=2)
    }
    allowed = {pair: value for pair, value in sums.items() if mirror or pair[0] == pair[1]}
    best = min(allowed, key=lambda pair: (allowed[pair], pair))
    others = [pair for pair in allowed if pair != best and allowed[pair] < allowed[best] + MARGIN]
    if min(sums.values()) < min(allowed[best], 2 * ACCEPTED_LOG_CHANCE) - 1.0:
        raise CannotRegister(
            f"The {names[0]} and the {names[1]} both match the design, but one of them only if it is turned over: one "
            "is probably viewed from the wrong side. Check --top and --through; if the slices are numbered against the "
            "usual sense, pass --mirror."
        )
    allowed_off = (scale_tolerance, tolerance_um)
    one, two = (_settle(found[k, best[k]], sides[k][0], holes, called, allowed_off, sides[k][1]) for k in range(2))
    if others:
        raise CannotRegister(
            f"{one.sentence} {two.sentence} Turned over, the design fits nearly as well, so the holes cannot be "
            "identified. Give the pairs with --marks, or leave the design out."
        )
    where = {int(hole): int(row) for row, hole in two.pairs}
    pairs = np.array([(row, where[int(hole)], hole) for row, hole in one.pairs if int(hole) in where], dtype=np.intp)
    pairs = pairs.reshape(-1, 3)
    pairs = pairs[np.argsort(pairs[:, 0])]
    mirrored = one.mirrored != two.mirrored
    enough = len(pairs) >= _ENOUGH_SHARED
    # Through the design: its holes as both sides have them, laid on one another.
    via = (one.transform(holes), two.transform(holes))
    ends = (source[pairs[:, 0]], target[pairs[:, 1]]) if enough else via
    transform, rms = fit_similarity(*ends, mirrored=mirrored)
    how = f"residual {rms:.1f} um rms" if enough else "through the design, since fewer than 4 are on both sides"
    sentence = (
        f"{one.sentence} {two.sentence} {len(pairs)} holes are on both sides (rotation "
        f"{np.degrees(transform.rotation_rad):.2f} deg, scale {transform.scale:.4f}{', mirrored' if mirrored else ''}, "
        f"{how})."
    )
    return MatchedByDesign(
        pairs=np.ascontiguousarray(pairs[:, :2]),
        labels=tuple(called[k] for k in pairs[:, 2]),
        transform=transform,
        mirrored=mirrored,
        inliers=len(pairs),
        second_best=max(one.second_best, two.second_best),
        sentence=sentence,
        moving=one,
        fixed=two,
    )


def _chance(found: Choice | None) -> float:
    return 10.0 if found is None else found.log_chance


def _settle(
    found: Choice | None,
    points: Floats,
    holes: Floats,
    labels: tuple[str, ...],
    allowed_off: tuple[float, float],
    name: str,
) -> MatchedToDesign:
    """Accept the best arrangement of a design on one side, or refuse it; tolerances of the scale and in um."""
    sides = f"{len(points)} marks of the {name} and {len(holes)} designed holes"
    if found is None:
        raise CannotRegister(_no_match(sides, 2, 4))
    count = len(found.pairs)
    if count < found.needed or found.log_chance > ACCEPTED_LOG_CHANCE:
        least = marks_needed(len(found.small), found.large, found.found.tests, allowed_off[1], ACCEPTED_LOG_CHANCE)
        raise CannotRegister(_no_match(sides, count, max(found.needed, least)))
    if found.second_log_chance < found.log_chance + MARGIN:
        raise CannotRegister(
            f"{sides}: {count} match in the best arrangement, {found.second_best} in the second-best, which is too "
            "close to decide: the design is symmetric or regular, or the marks that would decide are missing. Find "
            "more of the marks (range of hole diameters), or give the pairs with --marks."
        )
    transform, rms = fit_similarity(holes[found.pairs[:, 0]], points[found.pairs[:, 1]], mirrored=found.mirrored)
    if fault := found.scale_fault(transform.scale, allowed_off[0]):
        raise CannotRegister(f"{sides}: {fault}")
    taken = set(found.pairs[:, 0].tolist())
    missing = tuple(label for k, label in enumerate(labels) if k not in taken)
    return MatchedToDesign(
        pairs=np.ascontiguousarray(found.pairs[:, ::-1]),
        labels=tuple(labels[k] for k in found.pairs[:, 0]),
        transform=transform,
        mirrored=found.mirrored,
        second_best=found.second_best,
        log_chance=found.log_chance,
        missing=missing,
        sentence=f"{sides}: {count} match (residual {rms:.1f} um rms); the second-best match has {found.second_best}.",
    )


def _checked(
    marks: ArrayLike, design: ArrayLike, labels: Sequence[str] | None, name: str
) -> tuple[Floats, Floats, tuple[str, ...]]:
    points, holes = checked_points(marks, name), checked_points(design, "design")
    called = tuple(str(k + 1) for k in range(len(holes))) if labels is None else tuple(labels)
    if len(called) != len(holes):
        raise MarkError(f"{len(called)} labels are given for {len(holes)} designed holes. Give one for each.")
    for what, some in ((f"marks of the {name}", points), ("designed holes", holes)):
        if len(some) < 3:
            raise CannotRegister(
                f"{len(some)} {what}: at least 3 are needed to match them to the design, 4 or more are better. Check "
                "that the holes are in the field and that the pixel and voxel sizes are right, widen the range of hole "
                "diameters, or give the pairs with --marks."
            )
    return points, holes, called


def _no_match(sides: str, count: int, need: int) -> str:
    return (
        f"{sides}: the design does not match the marks: {count} agree at best, and about {need} have to, closer than "
        "chance would bring them. Check that it is the design of this sheet, its unit (um), the pixel and voxel sizes; "
        "find more of the marks, or give the pairs with --marks."
    )
