"""Find which mark of one map is which mark of the other.

From their positions alone or through the designed pattern.

An arrangement is believed only if it is far better than chance and than every different
arrangement. Without a design, the pattern behind the marks must not coincide with itself in a
second orientation either. With one, each side is matched to the design and the two are joined: a
side that lost some marks still has most of the design, so that two sides which share few marks can
be matched, and a symmetry that one side alone seems to have is judged by the design.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from planish.core.errors import CannotRegister, MarkError, WrongHand
from planish.core.robust import rms_length
from planish.core.transform import Similarity, are_known
from planish.core.typing import Floats, Ints, Texts
from planish.register.match_choose import BestMatch, choose, self_likeness
from planish.register.match_search import ACCEPTED
from planish.register.pairs import Pairs, listed, points_of
from planish.register.similarity import SimilarityModel

# A different arrangement has to be this much likelier to be chance, as log10.
_MARGIN = 3.0
_HINT = "give the pattern that was burnt (`design`) or pairs (`marks`)"
_PAIRS_HINT = "give the pairs with `marks`"
_FROM_BEHIND = ", viewed from behind or drawn with its y axis upwards"
_WRONG_SIDE = (
    "one is probably viewed from the wrong side. Check `image_side`, `top` and `through`; if the"
    " slices are numbered against the usual sense, pass `mirror=True`."
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Matched:
    """Marks that belong together."""

    pairs: Ints  # (k, 2): row in `moving`, row in `fixed`; sorted by the first
    # Least-squares fit through the pairs, moving to fixed; through the design where it identified
    # fewer than four holes on both sides.
    transform: Similarity
    mirrored: bool  # whether the moving side had to be turned over
    second_best: int  # marks of the second-best match
    sentence: str  # counts, rotation, scale and residual
    # Of the rows of `pairs`: names of the holes in the design, or `hole 1`, `hole 2` ...
    labels: Texts
    # The design in a sentence, and whether it had to be turned over to match the fixed side.
    design: str | None = None


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
        Two marks agree if the arrangement puts them this close. A stretch of up to 0.5 % more in
        one direction than in the other is fitted before that is judged.
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
        If there are fewer than three marks on a side, if the scale is out of range, if fewer than 4
        marks or 35 % of those in the common field agree, if the mirror image agrees better although
        ``mirror`` is not set, if as good an agreement is expected by chance, if a different
        arrangement is nearly as good, or if the marks found on both sides together may belong to a
        symmetric or regular pattern. Three marks on a side are enough when all three agree and
        their distances cannot be confused.
    MarkError
        If a position is not finite or an array has another shape.

    Notes
    -----
    Chance is judged a contrario: the expected number of arrangements of randomly scattered marks
    that agree at ``k`` marks within ``r`` is ``tests * C(n - 2, k - 2) * p(r)**(k - 2)``. A
    symmetric pattern that lost so many marks on one side or both that what is left shows no
    symmetry at all cannot be distinguished from one without symmetry.

    References
    ----------
    Hirn et al. (2009), section 2.4. Moisan and Stival (2004), Int. J. Comput. Vis. 57, 201,
    doi:10.1023/B:VISI.0000013094.38752.54 (agreement judged against chance).
    """
    source = _usable_points(moving, f"marks of the {names[0]}", _HINT)
    target = _usable_points(fixed, f"marks of the {names[1]}", _HINT)
    sides_text = f"{len(source)} marks of the {names[0]} and {len(target)} of the {names[1]}"
    limits = (scale_tolerance, tolerance_um)
    hands = (False, True) if mirror else (False,)
    choice = choose(source, target, *limits, hands=hands)
    # Where only one hand is allowed, the other one has to be clearly worse.
    mirror_choice = BestMatch()
    if not mirror:
        mirror_choice = choose(source, target, *limits, hands=(True,))
    count = len(choice.pairs)
    smaller_count = min(len(source), len(target))
    if mirror_choice.log_chance < min(choice.log_chance - 1.0, ACCEPTED):
        raise WrongHand(
            f"{sides_text}: {count} match, but {len(mirror_choice.pairs)} match if one side is"
            f" mirrored: {_WRONG_SIDE}"
        )
    if count < choice.needed_count:
        raise CannotRegister(f"{sides_text}: {_no_match(choice, smaller_count, mirror)}")
    i, j = choice.pairs.T
    triangles = (source[i], target[j])
    if smaller_count == 3 and any(_has_alike(t, 3.0 * tolerance_um) for t in triangles):
        raise CannotRegister(
            f"{sides_text}: three marks match, but two of their three distances are alike within"
            f" {3.0 * tolerance_um:g} um, so they could be taken for one another. Add a fourth"
            f" mark, or {_HINT}."
        )
    rival_chance = min(choice.second_log_chance, mirror_choice.log_chance)
    choice = choice._replace(second_log_chance=rival_chance)
    hint_text = _HINT + ". Without `mirror=True`, only one handedness competes" * mirror
    transform, rms = _fit_choice(choice, source, target, sides_text, scale_tolerance, hint_text)
    symmetry_text = self_likeness(*choice.together(), tolerance_um=tolerance_um, mirror=mirror)
    if symmetry_text is not None:
        raise CannotRegister(
            f"{sides_text}: {count} match, but the pattern may be symmetric or regular:"
            f" {symmetry_text}, and the others may be lost. Add marks that break the symmetry, or"
            f" {_HINT}."
        )
    sentence = (
        f"{sides_text}: {count} match ({_similarity_text(transform)}, residual {rms:.1f} um rms);"
        f" the second-best match has {choice.second_best_count}.{_caution(choice, smaller_count)}"
    )
    return Matched(
        pairs=choice.pairs,
        transform=transform,
        mirrored=choice.mirrored,
        second_best=choice.second_best_count,
        sentence=sentence,
        labels=tuple(f"hole {k + 1}" for k in range(count)),
    )


def _has_alike(triangle: Floats, within_um: float) -> bool:
    """Return whether two sides of a triangle (3, 2), in um, are nearly as long."""
    sides = triangle - np.roll(triangle, 1, axis=0)
    lengths = np.sort(np.linalg.norm(sides, axis=1))
    return bool(np.diff(lengths).min() < within_um)


def _caution(choice: BestMatch, smaller_count: int) -> str:
    """Say what to be careful about in a match."""
    if smaller_count == 3:
        return (
            " Three marks only: all match and their distances differ, but one false mark would not"
            " be noticed."
        )
    if choice.stretch >= 0.001 and len(choice.pairs) >= 6:
        return (
            f" One direction is stretched by {100 * choice.stretch:.1f} % against the other: an"
            " affine fit may be better."
        )
    return ""


def _no_match(choice: BestMatch, smaller_count: int, mirror: bool) -> str:
    """Say that too few marks agree, and what to do; ``mirror``: both hands were tried."""
    if smaller_count == 3:
        return f"with three marks on a side a match may be chance. Add a fourth, or {_HINT}."
    needed_text = f"about {choice.needed_count}"
    if choice.needed_count > smaller_count:
        needed_text = f"more than the {smaller_count} of the smaller side"
    mirror_text = ""
    if not mirror:
        mirror_text = "; if the slices are numbered against the usual sense, pass `mirror=True`"
    return (
        f"no match found: {max(2, len(choice.pairs))} agree at best, and {needed_text} have to,"
        " closer than chance brings them. Printed dots as large as holes count as marks: give"
        " `printed=True`, and raise the lower end of `hole_um` above them. Check the pixel and"
        " voxel sizes (if uncertain, allow more with `scale_tolerance`), `top` and"
        f" `image_side`{mirror_text}; find more of the marks, or {_HINT}."
    )


def match_by_design(
    moving: ArrayLike,
    fixed: ArrayLike,
    design: ArrayLike,
    *,
    labels: Sequence[str] | None = None,
    name: str = "given",
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
    name : str
        What the design is called.
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
        If there are fewer than three marks or holes, if fewer than 4 marks or 35 % of a side agree
        with the design, if as good an agreement is expected by chance, if a different arrangement
        is nearly as good, as in a symmetric design, or if the sides show different hands although
        ``mirror`` is not set.
    MarkError
        If a position is not finite, an array has another shape, or there is not one label a hole.
    """
    source = _usable_points(moving, f"marks of the {names[0]}", _PAIRS_HINT)
    target = _usable_points(fixed, f"marks of the {names[1]}", _PAIRS_HINT)
    holes = _usable_points(design, "designed holes", _PAIRS_HINT)
    numbers = [str(k + 1) for k in range(len(holes))]
    labels = numbers if labels is None else list(labels)
    if len(labels) != len(holes):
        raise MarkError(
            f"{len(labels)} labels are given for {len(holes)} designed holes. Give one for each."
        )
    limits = (scale_tolerance, tolerance_um)
    choices: list[_Hands] = []
    for side in (source, target):
        as_designed = choose(holes, side, *limits, hands=(False,))
        turned_over = choose(holes, side, *limits, hands=(True,))
        choices.append((as_designed, turned_over))
    (first_match, second_match), is_ambiguous = _choose_hands(choices, names, mirror)
    moving_name, fixed_name = names
    fit = partial(_fit_on_design, holes=holes, scale_tolerance=scale_tolerance)
    first_transform, first_sentence = fit(first_match, source, name=moving_name)
    second_transform, second_sentence = fit(second_match, target, name=fixed_name)
    sentence = f"{first_sentence} {second_sentence}"
    if is_ambiguous:
        raise CannotRegister(
            f"{sentence} Turned over, the design fits nearly as well, so the holes cannot be"
            f" identified. Leave the design out, or {_PAIRS_HINT}."
        )
    # The designed holes that both sides have, sorted by the marks of the first.
    first_holes, first_marks = first_match.pairs.T
    second_holes, second_marks = second_match.pairs.T
    shared_holes, i, j = np.intersect1d(
        first_holes, second_holes, assume_unique=True, return_indices=True
    )
    order = np.argsort(first_marks[i])
    i = first_marks[i][order]
    j = second_marks[j][order]
    mirrored = first_match.mirrored != second_match.mirrored
    # From so many marks on both sides on, they alone give the transformation; with fewer, the
    # design helps.
    if len(order) >= 4:
        transform, rms = _fit_similarity(source[i], target[j], mirrored)
        basis_text = f"residual {rms:.1f} um rms"
    else:
        # The design's holes as both sides have them, laid on one another.
        transform, _ = _fit_similarity(first_transform(holes), second_transform(holes), mirrored)
        basis_text = "through the design, since fewer than 4 are on both sides"
    design_text = (
        f"Holes identified by the pattern {name} of {len(holes)}"
        f" holes{_FROM_BEHIND * second_match.mirrored}."
    )
    sentence += (
        f" {len(order)} holes are on both sides ({_similarity_text(transform)}, {basis_text})."
    )
    return Matched(
        pairs=np.stack([i, j], axis=1),
        labels=tuple(labels[k] for k in shared_holes[order].tolist()),
        transform=transform,
        mirrored=mirrored,
        second_best=max(first_match.second_best_count, second_match.second_best_count),
        design=design_text,
        sentence=sentence,
    )


_Hands = tuple[BestMatch, BestMatch]  # of the design on one side: as designed, and turned over


def _choose_hands(
    choices: Sequence[_Hands], names: tuple[str, str], mirror: bool
) -> tuple[_Hands, bool]:
    """Choose the hand that a design has on either side.

    ``choices`` are those of the moving and the fixed side. Returns the match of either, and whether
    another choice fits nearly as well. The hand that the design has against the sheet is not known;
    both sides have the same, unless mirrored.
    """
    first, second = choices
    log_chances: list[float] = []
    allowed: list[tuple[float, bool, bool]] = []
    for i, j in product((False, True), repeat=2):
        log_chance = first[i].log_chance + second[j].log_chance
        log_chances.append(log_chance)
        if mirror or i == j:
            allowed.append((log_chance, i, j))
    (best_chance, i, j), *rivals = sorted(allowed)
    if min(log_chances) < min(best_chance, 2 * ACCEPTED) - 1.0:
        raise WrongHand(
            f"The {names[0]} and the {names[1]} both match the design, but one of them only if it"
            f" is turned over: {_WRONG_SIDE}"
        )
    is_ambiguous = any(log_chance < best_chance + _MARGIN for log_chance, *_ in rivals)
    return (first[i], second[j]), is_ambiguous


def _fit_on_design(
    choice: BestMatch, points: Floats, *, holes: Floats, scale_tolerance: float, name: str
) -> tuple[Similarity, str]:
    """Fit the designed holes (d, 2) to the marks (n, 2) of the side ``name``, in um.

    Gives the transformation from the design, and a sentence; CannotRegister where few agree.
    """
    sides_text = f"{len(points)} marks of the {name} and {len(holes)} designed holes"
    count = len(choice.pairs)
    if count < choice.needed_count:
        raise CannotRegister(
            f"{sides_text}: the design does not match the marks: {max(2, count)} agree"
            f" at best, and about {choice.needed_count} have to, closer than chance brings them."
            " Check that it is the design of this sheet, its unit (um), the pixel and voxel sizes;"
            f" find more of the marks, or {_PAIRS_HINT}."
        )
    transform, rms = _fit_choice(choice, holes, points, sides_text, scale_tolerance, _PAIRS_HINT)
    match_text = (
        f"{count} match (residual {rms:.1f} um rms); the second-best match has"
        f" {choice.second_best_count}."
    )
    return transform, f"{sides_text}: {match_text}"


def _similarity_text(transform: Similarity) -> str:
    mirrored_text = ", mirrored" * transform.mirrored
    return (
        f"rotation {np.degrees(transform.rotation_rad):.2f} deg, scale"
        f" {transform.scale:.4f}{mirrored_text}"
    )


def _fit_choice(
    choice: BestMatch,
    source: Floats,
    target: Floats,
    sides_text: str,
    scale_tolerance: float,
    hint_text: str,
) -> tuple[Similarity, float]:
    """Fit the arrangement of marks (n, 2) and (m, 2); give it and its rms residual, in um.

    Refuse one with a rival, or at a scale that is out of range; ``sides_text`` and ``hint_text``
    begin and end the message.
    """
    count = len(choice.pairs)
    if choice.second_log_chance < choice.log_chance + _MARGIN:
        raise CannotRegister(
            f"{sides_text}: {count} match in the best arrangement, {choice.second_best_count} in"
            " the second-best, too close to decide: the pattern is ambiguous, symmetric or"
            " regular, or the marks that would decide are missing. Find more of the marks (range"
            f" of hole diameters), remove false ones, or {hint_text}."
        )
    i, j = choice.pairs.T
    transform, rms = _fit_similarity(source[i], target[j], choice.mirrored)
    deviation = abs(transform.scale - 1.0)
    if deviation > scale_tolerance:
        raise CannotRegister(
            f"{sides_text}: {count} match, but at a scale of {transform.scale:.4f}, which is"
            f" {100 * deviation:.1f} % off the calibration; {100 * scale_tolerance:.3g} % are"
            " allowed. Check the pixel and voxel sizes; if they are that uncertain, allow more"
            " with `scale_tolerance`."
        )
    return transform, rms


def _fit_similarity(source: Floats, target: Floats, mirrored: bool) -> tuple[Similarity, float]:
    """Least-squares similarity through pairs ``(k, 2)`` in um, and the rms residual."""
    information = np.tile(np.eye(2), (len(source), 1, 1))
    pairs = Pairs(moving=source, fixed=target, information=information)
    transform = SimilarityModel().fit(pairs, mirrored)
    return transform, rms_length(transform(source) - target)


def _usable_points(marks: ArrayLike, name: str, hint_text: str) -> Floats:
    """Give marks as (n, 2) in um; MarkError where one is not finite, CannotRegister below three."""
    points = points_of(marks, name)
    nonfinite_rows = np.flatnonzero(~are_known(points))
    if nonfinite_rows.size:
        raise MarkError(
            f"Position of mark {listed(nonfinite_rows)} (counted from 0) among the {name} is not"
            " finite. Correct it, or leave it out."
        )
    if len(points) < 3:
        places = "".join(f" ({x:.0f}, {y:.0f}) um" for x, y in points)
        raise CannotRegister(
            f"{len(points)} {name}: at least 3 are needed to match them, 4 are"
            f" better{'; they lie at' * bool(places)}{places}. Check the field, the pixel and voxel"
            f" sizes, widen the range of hole diameters, or {hint_text}."
        )
    return points
