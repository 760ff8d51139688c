"""Find which mark of one map is which mark of the other, from nothing but their positions.

An arrangement is believed only if it is far better than chance and than every different arrangement, and if the
pattern behind the marks cannot be laid on itself in a second orientation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planish.core.errors import CannotRegister
from planish.core.transform import Similarity
from planish.register.match_choose import ACCEPTED_LOG_CHANCE, MARGIN, Choice, checked_points, choose, fit_similarity
from planish.register.match_search import Complexes, marks_needed
from planish.register.match_symmetry import self_likeness

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]

# Scales under which a pattern may repeat itself.
_SELF_SCALE = 0.01
# A stretch that is reported.
_NOTABLE_STRETCH = 0.001


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
    inliers, second_best : int
        Marks that match, and those of the second-best match.
    sentence : str
        Counts, rotation, scale and residual.
    """

    pairs: Ints
    transform: Similarity
    mirrored: bool
    inliers: int
    second_best: int
    sentence: str


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
    source, target = checked_points(moving, names[0]), checked_points(fixed, names[1])
    sides = f"{len(source)} marks of the {names[0]} and {len(target)} of the {names[1]}"
    for name, points in zip(names, (source, target), strict=True):
        if len(points) < 3:
            raise CannotRegister(_too_few(sides, name, points))
    found = choose(
        source, target, scale_tolerance=scale_tolerance, tolerance_um=tolerance_um,
        hands=(False, True) if mirror else (False,),
    )  # fmt: skip
    other = None
    if not mirror:
        other = choose(source, target, scale_tolerance=scale_tolerance, tolerance_um=tolerance_um, hands=(True,))
    best = np.inf if found is None else found.log_chance
    if other is not None and other.log_chance < min(best - 1.0, ACCEPTED_LOG_CHANCE):
        raise CannotRegister(
            f"{sides}: {0 if found is None else len(found.pairs)} match, but {len(other.pairs)} match if one side is "
            "mirrored: one is probably viewed from the wrong side. Check --image-side, --top "
            "and --through; if the slices are numbered against the usual sense, pass --mirror."
        )
    if found is None:
        raise CannotRegister(_no_match(sides, 2, 4, mirror, min(len(source), len(target))))
    count, rival = len(found.pairs), found.second_best
    if count < found.needed or found.log_chance > ACCEPTED_LOG_CHANCE:
        least = marks_needed(len(found.small), found.large, found.found.tests, tolerance_um, ACCEPTED_LOG_CHANCE)
        raise CannotRegister(_no_match(sides, count, max(found.needed, least), mirror, len(found.small)))
    if len(found.small) == 3:
        _refuse_confusable(sides, source[found.pairs[:, 0]], target[found.pairs[:, 1]], 3.0 * tolerance_um)
    rival_chance = min(found.second_log_chance, np.inf if other is None else other.log_chance)
    if rival_chance < found.log_chance + MARGIN:
        raise CannotRegister(
            f"{sides}: {count} match in the best arrangement, {rival} in the second-best, too close to decide: "
            "the pattern is symmetric or ambiguous. Find more of the marks (range of hole diameters), remove false "
            "ones, give the pattern that was burnt (--design) or pairs (--marks)."
            + (" Without --mirror, only one handedness competes." if mirror else "")
        )
    transform, rms = fit_similarity(source[found.pairs[:, 0]], target[found.pairs[:, 1]], mirrored=found.mirrored)
    if fault := found.scale_fault(transform.scale, scale_tolerance):
        raise CannotRegister(f"{sides}: {fault}")
    _refuse_symmetric(sides, count, *found.together(), tolerance_um, mirror)
    sentence = (
        f"{sides}: {count} match (rotation {np.degrees(transform.rotation_rad):.2f} deg, scale {transform.scale:.4f}"
        f"{', mirrored' if found.mirrored else ''}, residual {rms:.1f} um rms); the second-best match has "
        f"{rival}." + _stretch(found)
    )
    if len(found.small) == 3:
        sentence += " Three marks only: all match and their distances differ, but one false mark would not be noticed."
    return Matched(
        pairs=found.pairs,
        transform=transform,
        mirrored=found.mirrored,
        inliers=count,
        second_best=rival,
        sentence=sentence,
    )


def _stretch(found: Choice) -> str:
    """Sentence where the sheet is notably stretched more in one direction than in the other."""
    stretch = 2.0 * abs(found.found.gamma[found.best]) / abs(found.found.alpha[found.best])
    if stretch < _NOTABLE_STRETCH or len(found.pairs) < 6:
        return ""
    return f" One direction is stretched by {100 * stretch:.1f} % against the other: an affine fit may be better."


def _refuse_confusable(sides: str, a: Floats, b: Floats, least_um: float) -> None:
    """Three marks are not enough where two sides of the triangle are alike, on either side."""
    for corners in (a, b):
        lengths = np.sort(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1))
        if np.diff(lengths).min() < least_um:
            raise CannotRegister(
                f"{sides}: three marks match, but two of their three distances are alike within {least_um:g} um, so "
                "they could be taken for one another. Add a fourth mark, give the pattern that was burnt (--design) or "
                "pairs (--marks)."
            )


def _refuse_symmetric(
    sides: str, count: int, points: Complexes, alone: tuple[int, int], tolerance_um: float, mirror: bool
) -> None:
    like = self_likeness(
        points, alone, scale_tolerance=_SELF_SCALE, tolerance_um=tolerance_um, mirror=mirror
    )  # fmt: skip
    if like is None:
        return
    raise CannotRegister(
        f"{sides}: {count} match, but the pattern may be symmetric or regular: of the {like.marks} marks in all, "
        f"{like.repeated} coincide with a mark again when the pattern is {like.describe()}, and the others may be "
        "lost. Give the pattern that was burnt (--design) or pairs (--marks), or add marks "
        "that break the symmetry."
    )


def _too_few(sides: str, name: str, points: Floats) -> str:
    where = ", ".join(f"({x:.0f}, {y:.0f})" for x, y in points)
    return (
        f"{sides}: {len(points)} on the side of the {name}"
        + (f" (at {where} um)" if len(points) else "")
        + " cannot be matched without a hint; at least 3 on each side are needed, 4 or more are better. "
        "Check that the holes are in the field and that the pixel and voxel sizes are right, widen the range of hole "
        "diameters, give the pattern that was burnt (--design) or pairs (--marks)."
    )


def _no_match(sides: str, count: int, need: int, mirror: bool, of: int) -> str:
    if of == 3:
        return (
            f"{sides}: with three marks on a side a match may be chance. Add a fourth, give the pattern that was "
            "burnt (--design), or pairs (--marks)."
        )
    needed = f"about {need} have to" if need <= of else f"more than the {of} of the smaller side would have to"
    return (
        f"{sides}: no match found: {count} agree at best, and {needed}, closer than chance would bring "
        "them. Printed dots as large as holes count as marks: raise the lower end of --hole-um. Check the "
        "pixel and voxel sizes, --top, and --image-side: the side that the image shows"
        + ("" if mirror else "; if the slices are numbered against the usual sense pass --mirror")
        + "; find more of the marks, give the pattern that was burnt (--design) or pairs (--marks)."
    )
