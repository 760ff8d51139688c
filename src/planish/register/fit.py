"""Least-squares transformation between paired marks that agree, with its expected error."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from planish.core.errors import MarkError
from planish.core.typing import Bools, Ints
from planish.register.bent import NOTABLE, inside
from planish.register.field import DeviationField
from planish.register.models import MODELS, AveragedModel, model_named
from planish.register.pairs import COINCIDENT, Pairs, check_pairs, choose_hand, listed, weighted_rms
from planish.register.result import FittedTransform

_CHANCE = 0.01  # share of sets of marks in which a right mark is left out
_LEAST_JUDGED, _MANY = 4, 150
AVERAGED = AveragedModel()


def fit_transform(
    moving: ArrayLike,
    fixed: ArrayLike,
    *,
    model: str = "similarity",
    mirrored: bool | None = False,
    weights: ArrayLike | None = None,
    robust: bool = True,
    lowest: str = "rigid",
    inspect: bool = True,
) -> FittedTransform:
    """Fit the transformation that takes the moving marks to the fixed marks by least squares.

    Parameters
    ----------
    moving, fixed : array-like, shape (n, 2), in um
        Paired marks ``(x, y)``. With one pair more than the model needs, the residuals show the
        error.
    model : str
        One of :data:`planish.register.models.MODELS`: ``rigid``, ``similarity``, ``affine``,
        ``projective``, ``tps`` (thin-plate spline with the smoothing under which marks left out are
        missed least), ``averaged`` (similarity with as much affine and smooth deviation as the
        marks show); or ``auto``, which is ``averaged`` from 6 marks in use on, a similarity for 3
        to 5 and ``lowest`` for 2.
    mirrored : bool or None
        Whether the moving x axis runs in the opposite direction, as when the two maps show opposite
        sides of the sheet. ``None`` takes the hand that fits better.
    weights : array-like, shape (n,) or (n, 2, 2), optional
        Proportional to one over the variance of each pair, 0 leaves a pair out of the fit but
        reports its residual; or the covariance of each pair in the fixed frame, that of the moving
        mark (turned into that frame) and of the fixed mark added. Their common factor is found from
        the residuals.
    robust : bool
        Whether marks that do not agree with the others are left out: about a quarter at most, and
        from 4 marks on. Where no mark is further off than chance puts one of n once in a hundred
        times, nothing changes.
    lowest : str
        Model of ``auto`` for 2 marks.
    inspect : bool
        Whether the fit is compared with what the marks make likely, for its warnings. Without it,
        and without ``robust``, a model of few parameters is fitted in a millisecond, with the same
        numbers.

    Returns
    -------
    FittedTransform
        Residuals in the fixed frame.

    Raises
    ------
    MarkError
        If counts differ, a coordinate or weight is not finite, there are too few pairs, a mark has
        two partners, all marks of one side coincide, or the marks fit only with the other
        handedness (exchanged columns, undeclared mirror).
    CannotRegister
        If the marks leave a parameter free, as marks on one line do, or the transformation folds
        between them.

    Notes
    -----
    A pair that is given again exactly counts once. Leave-one-out errors of similarity and affine
    are ``(I - H)**-1 e`` with the block H of the hat matrix; those of rigid and projective are
    found by refitting without each mark; those of the spline hold its smoothing fixed, those of the
    averaged map its probabilities.

    References
    ----------
    Umeyama (1991), IEEE Trans. Pattern Anal. Mach. Intell. 13, 376, doi:10.1109/34.88573. Hartley
    (1997), IEEE Trans. Pattern Anal. Mach. Intell. 19, 580, doi:10.1109/34.601246. Hirn et al.
    (2009), section 2.4: control points, translation with rotation and rescaling, least squares.

    Examples
    --------
    >>> fit = fit_transform([[0, 0], [1000, 0], [0, 500]], [[10, 20], [10, 1020], [-490, 20]])
    >>> round(fit.transform.scale, 6), round(float(np.degrees(fit.transform.rotation_rad)), 6)
    (1.0, 90.0)
    """
    least = 0 if model == "auto" else model_named(model).least
    pairs, repeated_rows = check_pairs(moving, fixed, weights)
    is_used = pairs.weights > 0
    used_pairs = pairs.take(is_used)
    count = len(used_pairs)
    if count < least:
        raise MarkError(
            f"{count} pairs of marks given, a model of type {model} needs {least}. Add"
            f" {least - count} or more, away from the others, or choose a model with fewer"
            " parameters."
        )
    mirrored = choose_hand(used_pairs, mirrored)
    robust_weights = np.ones(len(pairs))
    field = None
    if robust:
        robust_weights[is_used], field = agreeing(used_pairs, mirrored)
    elif inspect or model in ("auto", AVERAGED.name):
        field = DeviationField(used_pairs, mirrored)
    weighted_pairs = replace(pairs, information=pairs.information * robust_weights[:, None, None])
    fitted_pairs = weighted_pairs.take(weighted_pairs.weights > 0)
    if model == "auto":
        model = _model_for(len(fitted_pairs), lowest)
    if field is not None and model == AVERAGED.name:
        transform = AVERAGED.of(field)
    else:
        transform = MODELS[model].fit(fitted_pairs, mirrored)
    residuals = pairs.fixed - transform(pairs.moving)
    rms = weighted_rms(np.linalg.norm(residuals, axis=1), weighted_pairs.weights)
    fit = FittedTransform(
        transform=transform,
        model=model,
        moving=pairs.moving,
        fixed=pairs.fixed,
        information=weighted_pairs.information,
        robust_weights=robust_weights,
        residuals_um=residuals,
        sentence=f"{model} from {len(fitted_pairs)} marks: residuals {rms:.3g} um rms.",
        likely=field,
    )
    model_warnings = (*_warn_of_structure(fit), *_warn_of_size(fit)) if inspect else ()
    return replace(fit, warnings=(*_warn_of_marks(fit, repeated_rows), *model_warnings))


def _model_for(count: int, lowest: str) -> str:
    """Name of the model that so many marks allow."""
    if count >= 6:
        return AVERAGED.name
    return "similarity" if count >= 3 else lowest


def agreeing(pairs: Pairs, mirrored: bool) -> tuple[Bools, DeviationField]:
    """Marks that agree, shape (n,), and the field that they make likely.

    The mark that the others expect least is taken out, up to a quarter of all and a few, and judged
    by the chance that they miss a right one by as much (Rosner 1983, Technometrics 25, 165,
    doi:10.1080/00401706.1983.10487848). All up to the last one whose chance is below one in a
    hundred sets are wrong, but for those that the marks left at the end do expect: wrong marks hide
    each other and accuse right ones. With fewer than 4 marks none can be told.
    """
    n = len(pairs)
    field = best_field = DeviationField(pairs, mirrored)
    is_right = np.ones(n, bool)
    # Rows in the order in which they are taken out; the first ``wrong_count`` are wrong.
    removed: list[int] = []
    wrong_count = 0
    # Three wrong marks may hide each other, and two right ones may be taken out before them.
    extra, hidden = (2, 3) if 2 * _LEAST_JUDGED <= n <= _MANY else (0, 1)
    most_removed = max(1, n // 4) + extra if n >= _LEAST_JUDGED else 0
    while len(removed) < most_removed and len(removed) - wrong_count < hidden + extra:
        remaining_rows = np.flatnonzero(is_right)
        _, chance = field.left_out()
        # The more marks were taken out without need, the more choices there were.
        choices = 1 + len(removed) - wrong_count
        limit = np.log(_CHANCE) - choices * np.log(remaining_rows.size)
        # Among many marks a few wrong ones accuse no right ones: all that stand out at once.
        count = 1
        if n > _MANY:
            count = max(1, int(np.count_nonzero(chance < limit)))
        outliers = np.argsort(chance, kind="stable")[:count]
        # Of marks that were taken together, the one that stands out most: it moves the mean of the
        # others.
        _, first_rows = np.unique(field.group[outliers], return_index=True)
        outliers = outliers[np.sort(first_rows)]
        removed += remaining_rows[outliers].tolist()
        is_right[removed] = False
        field = DeviationField(pairs.take(is_right), mirrored)
        if chance.min() < limit:
            wrong_count = len(removed)
            best_field = field
    is_right[:] = True
    is_right[removed[:wrong_count]] = False
    if n > _MANY:
        return is_right, best_field
    for mark in reversed(removed[:wrong_count]):
        is_right[mark] = True
        field = DeviationField(pairs.take(is_right), mirrored)
        _, chance = field.left_out()
        row = np.count_nonzero(is_right[:mark])
        if chance[row] < np.log(_CHANCE / np.count_nonzero(is_right)):
            is_right[mark] = False
        else:
            best_field = field
    return is_right, best_field


def _warn_of_marks(fit: FittedTransform, repeated_rows: Ints) -> Iterator[str]:
    """Say which marks do not count, and why, and where few are left.

    ``repeated_rows`` are the rows of pairs that repeat others.
    """
    excluded = np.flatnonzero(fit.robust_weights < 1.0)
    if excluded.size:
        distances_um = np.linalg.norm(fit.residuals_um[excluded[:8]], axis=1)
        off_text = f"off by {', '.join(f'{distance:.3g}' for distance in distances_um)} um"
        subject = f"{listed(excluded + 1)} (counted from 1)"
        if excluded.size > 1:
            yield (
                f"Marks {subject} do not agree with the others ({off_text}) and were left out."
                " Check them."
            )
        else:
            yield (
                f"Mark {subject} does not agree with the others ({off_text}) and was left out."
                " Check it."
            )
    subject = f"{listed(repeated_rows + 1)} (counted from 1)"
    if repeated_rows.size > 1:
        yield f"Pairs {subject} repeat others exactly and count once."
    elif repeated_rows.size:
        yield f"Pair {subject} repeats another one exactly and counts once."
    count = int(np.count_nonzero(fit.weights > 0))
    if count < 6:
        yield (
            f"{count} marks only: their error, and with it the expected error, is known to no"
            " better than about 40 %."
        )


def _warn_of_structure(fit: FittedTransform) -> Iterator[str]:
    """Say where the marks make another map likely than the fitted one, between them too.

    Nothing where the model is the likely map itself, or the marks leave no residual.
    """
    if fit.model == AVERAGED.name or not fit.field.freedom > 0:
        return
    points = inside(fit.moving[fit.weights > 0], 17)
    likely_images = AVERAGED.of(fit.field)(points)
    distances = np.linalg.norm(fit(points) - likely_images, axis=1)
    squares_um2 = fit.field.expected_square(points, likely_images)
    error_um = np.sqrt(np.mean(squares_um2))
    difference_um = np.sqrt(np.mean(distances**2))
    # A model is warned of where it is off by twice what the likely map is known to.
    if difference_um > 2.0 * error_um + COINCIDENT * fit.transform.scale * fit.field.size:
        yield (
            f"The {fit.model} model leaves structure: the marks show a map that differs from it by"
            f" {difference_um:.3g} um rms between them, up to {distances.max():.3g} um, and is"
            f" itself known to {error_um:.2g} um. Have the model chosen by itself."
        )


def has_other_unit(scale: float) -> bool:
    """Return whether a scale is farther off than any calibration, so that a unit is wrong."""
    return not 0.8 <= scale <= 1.25


def _warn_of_size(fit: FittedTransform) -> Iterator[str]:
    """Say where residuals, scale or local strain are larger than those of paper can be."""
    rms = fit.rms_um
    scale = fit.transform.scale
    strain = fit.strain
    spread = scale * fit.field.size
    # Residuals over the spread of the marks from which on the pairs, not their errors, are in
    # doubt.
    if rms > 0.05 * spread:
        yield (
            f"The residuals, {rms:.3g} um rms, are {100 * rms / spread:.0f} % of the spread of the"
            " marks: many pairs are wrong. Check that every row pairs the same hole on both sides."
        )
    if has_other_unit(scale):
        yield (
            f"Scale {scale:.4g}: one side is probably in pixels, or its pixel size is wrong. Give"
            " both sides in um."
        )
    if strain.largest > NOTABLE:
        (least, largest), (x, y) = strain.stretch, strain.at_um
        yield (
            f"Local strain from {100 * least:+.2g} to {100 * largest:+.2g} % between the marks,"
            f" largest near ({x:.4g}, {y:.4g}) um of the moving map. Paper strains by less than 1"
            " %: check the marks there."
        )
