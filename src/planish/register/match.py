"""Find which mark of one map is which mark of the other, from their positions alone or through the designed pattern.

An arrangement is believed only if it is far better than chance and than every different arrangement. Without a design,
the pattern behind the marks must not coincide with itself in a second orientation either. With one, each side is
matched to the design and the two are joined: a side that lost some marks still has most of the design, so that two
sides which share few marks can be matched, and a symmetry that one side alone seems to have is judged by the design.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from planish.core.errors import CannotRegister, MarkError
from planish.core.transform import Similarity
from planish.core.typing import Floats, Ints, Pair
from planish.register.match_choose import BestMatch, choose, self_likeness
from planish.register.match_search import marks_needed
from planish.register.pairs import Pairs, listed, points_of
from planish.register.similarity import SimilarityModel

# A chance agreement as good as the one accepted is expected in fewer than 10**-3 of all searches.
_ACCEPTED_LOG_CHANCE = -3.0
# A different arrangement has to be this much likelier to be chance, as log10.
_MARGIN = 3.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Matched:
    """Marks that belong together.

    Attributes
    ----------
    pairs : ndarray of int, shape (k, 2)
        Row in ``moving``, row in ``fixed``; sorted by the first.
    transform : Similarity
        Least-squares fit through the pairs, moving to fixed; through the design where it identified fewer than four
        holes on both sides.
    mirrored : bool
        Whether the moving side had to be turned over.
    second_best : int
        Marks of the second-best match.
    sentence : str
        Counts, rotation, scale and residual.
    labels : tuple of str
        With a design: name of the hole of each row of ``pairs``.
    behind : bool
        With a design: whether it had to be turned over to match the fixed side.
    """

    pairs: Ints
    transform: Similarity
    mirrored: bool
    second_best: int
    sentence: str
    labels: tuple[str, ...] = ()
    behind: bool = False


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
        Two marks agree if the arrangement puts them this close. A stretch of up to 0.5 % more in one
        direction than in the other is fitted before that is judged.
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
        If there are fewer than three marks on a side, if the scale is out of range, if fewer than 4 marks or 35 % of
        those in the common field agree, if the mirror image agrees better although ``mirror`` is not set, if as good an
        agreement is expected by chance, if a different arrangement is nearly as good, or if the marks found on both
        sides together may belong to a symmetric or regular pattern. Three marks on a side are enough when all three
        agree and their distances cannot be confused.
    MarkError
        If a position is not finite or an array has another shape.

    Notes
    -----
    Chance is judged a contrario: the expected number of arrangements of randomly scattered marks that agree at ``k``
    marks within ``r`` is ``tests * C(n - 2, k - 2) * p(r)**(k - 2)``. A symmetric pattern that lost so many marks on
    one side or both that what is left shows no symmetry at all cannot be distinguished from one without symmetry.

    References
    ----------
    Hirn et al. (2009), section 2.4. Moisan and Stival (2004), Int. J. Comput. Vis. 57, 201,
    doi:10.1023/B:VISI.0000013094.38752.54 (agreement judged against chance).
    """
    source, target = _finite_points(moving, names[0]), _finite_points(fixed, names[1])
    sides = f"{len(source)} marks of the {names[0]} and {len(target)} of the {names[1]}"
    for name, points in zip(names, (source, target), strict=True):
        if len(points) < 3:
            places = f" (at {', '.join(f'({x:.0f}, {y:.0f})' for x, y in points)} um)" if len(points) else ""
            raise CannotRegister(
                f"{sides}: {len(points)} on the side of the {name}{places} cannot be matched without a hint; at least "
                "3 on each side are needed, 4 or more are better. Check that the holes are in the field and that the "
                "pixel and voxel sizes are right, widen the range of hole diameters, give the pattern that was burnt "
                "(--design) or pairs (--marks)."
            )
    tolerances = (scale_tolerance, tolerance_um)
    choice = choose(source, target, *tolerances, hands=(False, True) if mirror else (False,))
    other = None if mirror else choose(source, target, *tolerances, hands=(True,))
    best = np.inf if choice is None else choice.log_chance
    if other is not None and other.log_chance < min(best - 1.0, _ACCEPTED_LOG_CHANCE):
        raise CannotRegister(
            f"{sides}: {0 if choice is None else len(choice.pairs)} match, but {len(other.pairs)} match if one side is "
            "mirrored: one is probably viewed from the wrong side. Check --image-side, --top "
            "and --through; if the slices are numbered against the usual sense, pass --mirror."
        )
    smaller = min(len(source), len(target))
    count, needed = _agreement(choice, tolerance_um)
    if choice is None or count < needed:
        raise CannotRegister(f"{sides}: {_no_match(count, needed, smaller, mirror)}")
    matched = source[choice.pairs[:, 0]], target[choice.pairs[:, 1]]
    if smaller == 3:
        _refuse_confusable(sides, matched, 3.0 * tolerance_um)
    rival_chance = min(choice.second_log_chance, np.inf if other is None else other.log_chance)
    if rival_chance < choice.log_chance + _MARGIN:
        raise CannotRegister(
            f"{sides}: {count} match in the best arrangement, {choice.second_best} in the second-best, too close to "
            "decide: the pattern is symmetric or ambiguous. Find more of the marks (range of hole diameters), remove "
            "false ones, give the pattern that was burnt (--design) or pairs (--marks)."
            + (" Without --mirror, only one handedness competes." if mirror else "")
        )
    transform, rms = _fit_similarity(*matched, choice.mirrored)
    _refuse_scale(sides, choice, transform.scale, scale_tolerance)
    repeats = self_likeness(*choice.together(), tolerance_um=tolerance_um, mirror=mirror)
    if repeats is not None:
        raise CannotRegister(
            f"{sides}: {count} match, but the pattern may be symmetric or regular: {repeats}, and the others may be "
            "lost. Give the pattern that was burnt (--design) or pairs (--marks), or add marks "
            "that break the symmetry."
        )
    sentence = (
        f"{sides}: {count} match (rotation {np.degrees(transform.rotation_rad):.2f} deg, scale {transform.scale:.4f}"
        f"{', mirrored' if choice.mirrored else ''}, residual {rms:.1f} um rms); the second-best match has "
        f"{choice.second_best}."
    )
    return _matched(choice, transform, sentence + _reservations(choice, smaller))


def _reservations(choice: BestMatch, smaller: int) -> str:
    """Sentences on a match that is stretched, or of three marks only."""
    sentence = ""
    stretch = 2.0 * abs(choice.arrangements.gamma[choice.best]) / abs(choice.arrangements.alpha[choice.best])
    if stretch >= 0.001 and len(choice.pairs) >= 6:
        sentence += (
            f" One direction is stretched by {100 * stretch:.1f} % against the other: an affine fit may be better."
        )
    if smaller == 3:
        sentence += " Three marks only: all match and their distances differ, but one false mark would not be noticed."
    return sentence


def _matched(choice: BestMatch, transform: Similarity, sentence: str) -> Matched:
    return Matched(
        pairs=choice.pairs, transform=transform, mirrored=choice.mirrored, second_best=choice.second_best,
        sentence=sentence,
    )  # fmt: skip


def _no_match(count: int, need: int, smaller: int, mirror: bool) -> str:
    if smaller == 3:
        return (
            "with three marks on a side a match may be chance. Add a fourth, give the pattern that was burnt "
            "(--design), or pairs (--marks)."
        )
    needed = (
        f"about {need} have to" if need <= smaller else f"more than the {smaller} of the smaller side would have to"
    )
    turned = "" if mirror else "; if the slices are numbered against the usual sense pass --mirror"
    return (
        f"no match found: {count} agree at best, and {needed}, closer than chance would bring them. Printed dots as "
        "large as holes count as marks: give --printed, and raise the lower end of --hole-um above the largest dot. "
        "Check the pixel and voxel sizes (if they are uncertain, allow more with --scale-tolerance), --top, and "
        f"--image-side: the side that the image shows{turned}; find more of the marks, give the pattern that was burnt "
        "(--design) or pairs (--marks)."
    )


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
) -> Matched:
    """Match two sets of marks through the designed positions of the holes.

    Parameters
    ----------
    moving, fixed : array-like, shape (n, 2) and (m, 2), in um
        Mark centres ``(x, y)`` with marks missing and false marks.
    design : array-like, shape (d, 2), in um
        Designed positions of all holes, of either hand: both sides may show the sheet from behind.
    labels : sequence of str, optional
        Names of the holes; their numbers from 1 otherwise.
    scale_tolerance, tolerance_um, names
        As in :func:`match_marks`.
    mirror : bool
        Whether the moving side may be turned over against the fixed one.

    Returns
    -------
    Matched

    Raises
    ------
    CannotRegister
        If there are fewer than three marks or holes, if fewer than 4 marks or 35 % of a side agree with the design, if
        as good an agreement is expected by chance, if a different arrangement is nearly as good, as in a symmetric
        design, or if the sides show different hands although ``mirror`` is not set.
    MarkError
        If a position is not finite, an array has another shape, or there is not one label a hole.
    """
    holes = _finite_points(design, "design")
    labels = tuple(str(k + 1) for k in range(len(holes))) if labels is None else tuple(labels)
    if len(labels) != len(holes):
        raise MarkError(f"{len(labels)} labels are given for {len(holes)} designed holes. Give one for each.")
    sides = tuple(_finite_points(marks, name) for marks, name in zip((moving, fixed), names, strict=True))
    tolerances = (scale_tolerance, tolerance_um)
    choices, is_ambiguous = _choose_hands(holes, sides, tolerances, names, mirror)
    first, second = (_on_design(choices[k], sides[k], holes, tolerances, names[k]) for k in range(2))
    if is_ambiguous:
        raise CannotRegister(
            f"{first.sentence} {second.sentence} Turned over, the design fits nearly as well, so the holes cannot be "
            "identified. Give the pairs with --marks, or leave the design out."
        )
    shared, *rows = np.intersect1d(first.pairs[:, 0], second.pairs[:, 0], assume_unique=True, return_indices=True)
    pairs = np.stack([side.pairs[row, 1] for side, row in zip((first, second), rows, strict=True)], axis=1)
    order = np.argsort(pairs[:, 0])
    pairs = np.ascontiguousarray(pairs[order])
    mirrored = first.mirrored != second.mirrored
    # From so many marks on both sides on, they alone give the transformation; with fewer, the design helps.
    if len(pairs) >= 4:
        transform, rms = _fit_similarity(sides[0][pairs[:, 0]], sides[1][pairs[:, 1]], mirrored)
        basis = f"residual {rms:.1f} um rms"
    else:
        # The design's holes as both sides have them, laid on one another.
        transform = _fit_similarity(first.transform(holes), second.transform(holes), mirrored)[0]
        basis = "through the design, since fewer than 4 are on both sides"
    sentence = (
        f"{first.sentence} {second.sentence} {len(pairs)} holes are on both sides (rotation "
        f"{np.degrees(transform.rotation_rad):.2f} deg, scale {transform.scale:.4f}{', mirrored' if mirrored else ''}, "
        f"{basis})."
    )
    return Matched(
        pairs=pairs, labels=tuple(labels[k] for k in shared[order]), transform=transform, mirrored=mirrored,
        second_best=max(first.second_best, second.second_best), sentence=sentence, behind=second.mirrored,
    )  # fmt: skip


def _choose_hands(
    holes: Floats, sides: tuple[Floats, ...], tolerances: Pair, names: tuple[str, str], mirror: bool
) -> tuple[list[BestMatch | None], bool]:
    """Choose the arrangement of a design on either side; say whether the other hand of the design fits nearly as well.

    The hand that the design has against the sheet is not known; both sides have the same, unless mirrored.
    """
    for name, marks in (
        *((f"marks of the {n}", s) for n, s in zip(names, sides, strict=True)),
        ("designed holes", holes),
    ):
        if len(marks) < 3:
            raise CannotRegister(
                f"{len(marks)} {name}: at least 3 are needed to match them to the design, 4 or more are better. Check "
                "that the holes are in the field and that the pixel and voxel sizes are right, widen the range of hole "
                "diameters, or give the pairs with --marks."
            )
    hands = (False, True)
    choices = {
        (k, hand): choose(holes, side, *tolerances, hands=(hand,)) for k, side in enumerate(sides) for hand in hands
    }
    chance = {key: 10.0 if choice is None else choice.log_chance for key, choice in choices.items()}
    sums = {pair: chance[0, pair[0]] + chance[1, pair[1]] for pair in product(hands, repeat=2)}
    allowed = {pair: value for pair, value in sums.items() if mirror or pair[0] == pair[1]}
    best = min(allowed, key=lambda pair: (allowed[pair], pair))
    if min(sums.values()) < min(allowed[best], 2 * _ACCEPTED_LOG_CHANCE) - 1.0:
        raise CannotRegister(
            f"The {names[0]} and the {names[1]} both match the design, but one of them only if it is turned over: one "
            "is probably viewed from the wrong side. Check --top and --through; if the slices are numbered against the "
            "usual sense, pass --mirror."
        )
    is_ambiguous = any(pair != best and value < allowed[best] + _MARGIN for pair, value in allowed.items())
    return [choices[k, best[k]] for k in range(2)], is_ambiguous


def _on_design(choice: BestMatch | None, points: Floats, holes: Floats, tolerances: Pair, name: str) -> Matched:
    """Accept the best arrangement of a design on one side, or refuse it; its pairs begin with the row in the design."""
    sides = f"{len(points)} marks of the {name} and {len(holes)} designed holes"
    count, needed = _agreement(choice, tolerances[1])
    if choice is None or count < needed:
        raise CannotRegister(
            f"{sides}: the design does not match the marks: {count} agree at best, and about {needed} have to, closer "
            "than chance would bring them. Check that it is the design of this sheet, its unit (um), the pixel and "
            "voxel sizes; find more of the marks, or give the pairs with --marks."
        )
    if choice.second_log_chance < choice.log_chance + _MARGIN:
        raise CannotRegister(
            f"{sides}: {count} match in the best arrangement, {choice.second_best} in the second-best, which is too "
            "close to decide: the design is symmetric or regular, or the marks that would decide are missing. Find "
            "more of the marks (range of hole diameters), or give the pairs with --marks."
        )
    transform, rms = _fit_similarity(holes[choice.pairs[:, 0]], points[choice.pairs[:, 1]], choice.mirrored)
    _refuse_scale(sides, choice, transform.scale, tolerances[0])
    sentence = f"{sides}: {count} match (residual {rms:.1f} um rms); the second-best match has {choice.second_best}."
    return _matched(choice, transform, sentence)


def _agreement(choice: BestMatch | None, tolerance_um: float) -> tuple[int, int]:
    """Count the marks that agree, and those that have to: more than do where the agreement may be chance."""
    if choice is None:
        return 2, 4
    count = len(choice.pairs)
    if count >= choice.needed and choice.log_chance <= _ACCEPTED_LOG_CHANCE:
        return count, count
    least = marks_needed(len(choice.small), choice.large, choice.arrangements.tests, tolerance_um, _ACCEPTED_LOG_CHANCE)
    return count, max(choice.needed, least, count + 1)


def _fit_similarity(source: Floats, target: Floats, mirrored: bool) -> tuple[Similarity, float]:
    """Least-squares similarity through pairs ``(k, 2)`` in um, and the rms residual."""
    information = np.broadcast_to(np.eye(2), (len(source), 2, 2))
    transform = SimilarityModel().fit(Pairs(moving=source, fixed=target, information=information), mirrored)
    return transform, float(np.sqrt(np.mean(np.sum((transform(source) - target) ** 2, axis=1))))


def _refuse_scale(sides: str, choice: BestMatch, scale: float, tolerance: float) -> None:
    if abs(scale - 1.0) > tolerance:
        raise CannotRegister(
            f"{sides}: {len(choice.pairs)} match, but at a scale of {scale:.4f}, which is {100 * abs(scale - 1.0):.1f} "
            f"% off the calibration; {100 * tolerance:.3g} % are allowed. Check the pixel and voxel sizes; if they "
            "are that uncertain, allow more with --scale-tolerance."
        )


def _refuse_confusable(sides: str, triangles: tuple[Floats, Floats], least_um: float) -> None:
    """Three marks are not enough where two sides of the triangle are alike, on either side."""
    for corners in triangles:
        lengths = np.sort(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1))
        if np.diff(lengths).min() < least_um:
            raise CannotRegister(
                f"{sides}: three marks match, but two of their three distances are alike within {least_um:g} um, so "
                "they could be taken for one another. Add a fourth mark, give the pattern that was burnt (--design) or "
                "pairs (--marks)."
            )


def _finite_points(marks: ArrayLike, name: str) -> Floats:
    """Return marks as ``(n, 2)`` float64, or name their faults."""
    points = points_of(marks, name)
    bad = np.flatnonzero(~np.all(np.isfinite(points), axis=1))
    if bad.size:
        raise MarkError(
            f"Position of mark {listed(bad)} (counted from 0) of the {name} is not finite. Leave it out, or correct it."
        )
    return points
