"""What the marks of one registration say.

The fit that is shown, marks that stand out, and where a point will lie.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations
from math import comb
from typing import Any

import numpy as np
from scipy import stats

from planish.app.changes import Mark, Marks
from planish.app.picture import PLANES, WHERE, Plane, finite_or_none
from planish.app.session import dataset_of
from planish.core.errors import PlanishError
from planish.core.facts import ResultModel
from planish.core.text import and_join_few
from planish.core.transform import Similarity
from planish.core.typing import Bools, Complexes, Floats, Ints, Pair, pair_of
from planish.register import FittedTransform, RegistrationParams, fit_transform
from planish.register.pairs import as_complex
from planish.run.marks_registration import fit_marks
from planish.run.study import changed

LEAST = 5
"""Of fewer marks none can be told from the others."""
_SIGNIFICANCE = 0.01  # of right marks alone, in one set of a hundred one is named
_CLEAR_SDS = 4.0  # standard deviations of one coordinate


def find_outliers(moving: Floats, fixed: Floats, mirrored: bool, *, tolerance_um: float) -> Bools:
    """Pairs (n,) of ``moving`` and ``fixed`` (n, 2), in um, that the others do not expect.

    Two marks farther apart than ``tolerance_um`` do not match, however few there are to tell. A
    least trimmed squares fit of a similarity: of those through two of the pairs, the one that the
    best two thirds of all marks follow most closely, improved by refits to these. So wrong marks
    that agree with each other do not hide, unless they are more than a third. Of the rest are named
    those that are off by more than the tolerance and four standard deviations, and those that lie
    farther off than chance puts one of so many that were chosen from (Rousseeuw and Van Driessen
    2006, Data Min. Knowl. Discov. 12, 29, doi:10.1007/s10618-005-0024-4).
    """
    n = len(moving)
    is_outlier = np.zeros(n, np.bool_)
    if n < LEAST:
        return is_outlier
    # Places as complex numbers x + iy; inliers are numbers of marks.
    z = as_complex(moving, mirrored)
    w = as_complex(fixed, False)
    inliers = _best_inliers(z, w, n - n // 3)
    while inliers.size < n:
        # How far each mark lies off a fit to the inliers, over its own error in units of theirs;
        # their variance. A similarity has four numbers, a mark two.
        residual_um = np.abs(_residuals(z, w, inliers))
        distance2 = np.abs(z - z[inliers].mean()) ** 2
        spread = max(float(np.sum(distance2[inliers])), 1e-300)
        leverage = 1 / inliers.size + distance2 / spread
        dof = 2 * inliers.size - 4
        sum_of_squares = float(np.sum(residual_um[inliers] ** 2))
        variance = sum_of_squares / max(dof, 1)
        residual_um = residual_um / np.sqrt(1 + leverage)
        # The inliers were chosen for being close: the chance counts how many choices there were.
        n_excluded = n - inliers.size
        p_limit = _SIGNIFICANCE / comb(n, n_excluded) / n_excluded
        p_value = (residual_um == 0).astype(np.float64)
        if variance > 0:
            p_value = stats.f.sf(residual_um**2 / (2 * variance), 2, dof)
        excluded = np.setdiff1d(np.arange(n), inliers)
        # The most likely of them is an inlier too, or all are outliers.
        candidate = excluded[np.argmax(p_value[excluded])]
        clear_um = max(tolerance_um, _CLEAR_SDS * np.sqrt(variance))
        if p_value[candidate] < p_limit or residual_um[candidate] > clear_um:
            is_outlier[excluded] = True
            break
        inliers = np.append(inliers, candidate)
    return is_outlier


def _best_inliers(z: Complexes, w: Complexes, count: int) -> Ints:
    """The ``count`` marks that a similarity through two of them, refitted, follows most closely.

    ``z`` and ``w`` (n,) are places in both planes as complex numbers, between which a similarity is
    ``w = shift + factor * z``. Given are numbers of marks, in order.
    """
    # The pairs i, j of marks that are tried: all, or 1500 at random.
    if len(z) < 56:
        i, j = np.array(list(combinations(range(len(z)), 2))).T
    else:
        permutations = np.tile(np.arange(len(z)), (1500, 1))
        i, j = np.random.default_rng(0).permuted(permutations, axis=1)[:, :2].T
    # Marks at one place give no factor.
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = (w[j] - w[i]) / (z[j] - z[i])
    is_finite = np.isfinite(factor)
    factor = factor[is_finite]
    i = i[is_finite]
    if not factor.size:
        return np.arange(len(z))
    # Rows are pairs, columns the marks.
    offsets = z - z[i][:, None]
    predicted = w[i][:, None] + factor[:, None] * offsets
    residual2 = np.abs(w - predicted) ** 2
    smallest = np.partition(residual2, count - 1, axis=1)[:, :count]
    sums = np.sum(smallest, axis=1)
    least_sum = np.inf
    best_inliers = np.arange(count)
    # The ten best, each refitted to the marks that it follows.
    for k in np.argsort(sums, kind="stable")[:10]:
        inliers = np.argsort(residual2[k], kind="stable")[:count]
        for _ in range(5):
            distances = np.abs(_residuals(z, w, inliers))
            inliers = np.argsort(distances, kind="stable")[:count]
        of_inliers = _residuals(z, w, inliers)[inliers]
        sum_of_squares = float(np.sum(np.abs(of_inliers) ** 2))
        if sum_of_squares < least_sum:
            least_sum = sum_of_squares
            best_inliers = np.sort(inliers)
    return best_inliers


def _residuals(z: Complexes, w: Complexes, inliers: Ints) -> Complexes:
    """Residuals (n,) of all marks from the least squares similarity of some of them."""
    z_mean = z[inliers].mean()
    w_mean = w[inliers].mean()
    z_centred = z[inliers] - z_mean
    spread = max(float(np.sum(np.abs(z_centred) ** 2)), 1e-300)
    factor = np.sum(z_centred.conj() * (w[inliers] - w_mean)) / spread
    return w - (w_mean + factor * (z - z_mean))


QUICK = ("rigid", "similarity", "affine", "projective")
"""Models that are fitted within a click."""


class FitWarning(ResultModel):
    """Something to be careful about: of one mark, or of all."""

    text: str
    id: str | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Fitted:
    """A fit as the page shows it."""

    fit: FittedTransform | None  # to the pairs in use; of a quick model while another one follows
    pairs: Marks  # in use or not
    is_outlier: Bools  # (n,), pairs that stand out
    is_rejected: Bools  # (n,), pairs in use to which the fit gives no weight
    residual_um: Floats  # (n,), of all pairs
    leave_one_out_um: Floats  # (n,); marks that stand out are left out of the fits to all others
    # Why there is no fit of the model; a similarity stands for it where there is one.
    error: str = ""
    is_pending: bool = False  # whether the fit of the model is still worked out
    warnings: tuple[FitWarning, ...] = ()
    mirrored: bool | None = False

    @property
    def message(self) -> str:
        """Agreement of the marks, and those that stand out, in a sentence."""
        outliers = np.flatnonzero(self.is_outlier)
        errors_um = self.leave_one_out_um[outliers]
        # Else there is no fit, and the error says why.
        if outliers.size and np.isfinite(errors_um).all():
            order = np.argsort(-errors_um, kind="stable")
            labels = and_join_few([self.pairs[k].label for k in outliers[order]])
            um_text = and_join_few([f"{um:.0f}" for um in errors_um[order]])
            stand = "stands"
            they_are = "it is"
            them = "it"
            if outliers.size > 1:
                stand = "stand"
                they_are = "they are"
                them = "them"
            advice = f"Check where {they_are} set, or take {them} out of use."
            return f"{labels} {stand} out: {um_text} um from where the others put {them}. {advice}"
        if self.error or self.fit is None:
            return self.error
        return self.fit.agreement([mark.label for mark in self.pairs if mark.used])

    def predicted(self, side: Plane, point_um: Pair) -> tuple[Pair, float | None, str] | None:
        """Place in the other plane of a point of ``side``, and its expected error.

        The error is given in um where known, and both also in words.
        """
        used_marks = [mark for mark in self.pairs if mark.used]
        fit = self.fit if len(used_marks) >= 3 else None
        transform = fit
        error_text = "its error is not known"
        if fit is None:
            transform, error_text = _from_few_pairs(used_marks, self.mirrored)
        if transform is None:
            return None
        moving_um = point = np.array(point_um)
        counterpart_um: Floats = transform(point)
        if side == "fixed":
            moving_um = counterpart_um = transform.inverse(point)
        if not np.isfinite(counterpart_um).all():
            return None
        error_um = None if fit is None else finite_or_none(fit.expected_error_um(moving_um))
        if error_um is not None:
            error_text = f"expected error {error_um:.1f} um"
        return (float(counterpart_um[0]), float(counterpart_um[1])), error_um, error_text


def fitted(
    marks: Sequence[Mark],
    model: str,
    *,
    mirrored: bool | None,
    params: RegistrationParams,
    quick: bool = False,
    where: Mapping[Plane, str] = WHERE,
) -> Fitted:
    """Fit the marks of one registration as the page shows them; those with one end are passed over.

    The model ``auto`` is fitted as Apply will do it: robustly, with the covariances of the holes;
    all others by least squares to all marks in use. ``mirrored``: whether the two planes show
    opposite sides; None for whichever fits better. ``quick``: only what takes some milliseconds; of
    another model than `QUICK`, a similarity instead.
    """
    pairs = tuple(mark for mark in marks if mark.moving and mark.fixed)
    # Places (n, 2) in um, of all pairs; the fits are to those in use.
    moving, fixed = (_points(pairs, plane) for plane in PLANES)
    is_used = np.array([mark.used for mark in pairs], np.bool_)
    used = (moving[is_used], fixed[is_used])
    is_mirrored = bool(mirrored)
    if mirrored is None:
        with suppress(PlanishError):
            is_mirrored = _least_squares(*used, "similarity", None).mirrored
    is_outlier = np.zeros_like(is_used)
    is_outlier[is_used] = find_outliers(*used, is_mirrored, tolerance_um=params.tolerance_um)
    nans = np.full(len(pairs), np.nan)
    coincident = _coincidence_warnings(pairs, where)
    warnings = [*coincident]
    n_used = int(is_used.sum())
    if n_used < 3:
        pairs_text = f"{n_used} pair{'s' * (n_used != 1)} of marks in use"
        needed_text = "a registration needs 3, far apart, and more to say how good it is."
        warnings.append(FitWarning(text=f"{pairs_text}: {needed_text}"))
    # What is shown where nothing can be fitted.
    unfitted = Fitted(
        fit=None,
        pairs=pairs,
        is_outlier=is_outlier,
        is_rejected=np.zeros_like(is_used),
        residual_um=nans,
        leave_one_out_um=nans,
        warnings=tuple(warnings),
        is_pending=quick and len(pairs) > 1,
        mirrored=mirrored,
    )
    fit = None
    error_text = ""
    fitted_model = model if not quick or model in QUICK else "similarity"
    try:
        if fitted_model == "auto":
            auto_params = changed(params, model="auto")
            fit = fit_marks(dataset_of(pairs), params=auto_params, mirrored=mirrored)
        else:
            fit = _least_squares(*used, fitted_model, mirrored, inspect=not quick)
    except PlanishError as refusal:
        fitted_model = "similarity"
        if n_used:
            error_text = _why_none(refusal, coincident, pairs)
        with suppress(PlanishError):  # there is something to look at: which marks are wrong
            fit = _least_squares(*used, fitted_model, mirrored)
    if fit is None:
        return replace(unfitted, error=error_text)
    residual_um = np.linalg.norm(fixed - fit(moving), axis=1)
    leave_one_out_um = residual_um.copy()
    leave_one_out_um[is_used] = fit.leave_one_out_um
    if is_outlier.any():
        # Marks that stand out take part in no fit here: they would spoil the errors of the others.
        weights = (is_used & ~is_outlier).astype(np.float64)
        with suppress(PlanishError):  # too few are left for this model
            fit_to_others = _least_squares(moving, fixed, fitted_model, mirrored, weights=weights)
            leave_one_out_um = fit_to_others.leave_one_out_um
    is_rejected = np.zeros_like(is_used)
    is_rejected[is_used] = fit.robust_weights == 0
    warnings += _disagreements(pairs, is_rejected, is_outlier, residual_um, leave_one_out_um)
    # Those of the fit that are about single marks stand beside them already.
    of_marks = re.compile(r"\(counted from 1\)|marks only")
    warnings += [FitWarning(text=text) for text in fit.warnings if not of_marks.search(text)]
    return replace(
        unfitted,
        fit=fit,
        is_rejected=is_rejected,
        residual_um=residual_um,
        leave_one_out_um=leave_one_out_um,
        error=error_text,
        warnings=tuple(warnings),
    )


def _why_none(
    refusal: PlanishError, coincident: Sequence[FitWarning], pairs: Sequence[Mark]
) -> str:
    """Why a fit was refused; of marks at one place, which these are."""
    if not coincident or "at one place" not in refusal.text:
        return refusal.text
    warning = coincident[0]
    label = next(mark.label for mark in pairs if mark.id == warning.id)
    return f"{label}: {warning.text} Move or delete one of them."


def _points(marks: Sequence[Mark], plane: Plane) -> Floats:
    places = [getattr(mark, plane).xy for mark in marks]
    return np.array(places, np.float64).reshape(-1, 2)


def _least_squares(
    moving: Floats, fixed: Floats, model: str, mirrored: bool | None, **options: Any
) -> FittedTransform:
    options = {"robust": False, "lowest": "similarity", "inspect": False} | options
    return fit_transform(moving, fixed, model=model, mirrored=mirrored, **options)


def _from_few_pairs(marks: Sequence[Mark], mirrored: bool | None) -> tuple[Any, str]:
    """A transformation from one mark or two, and what is not known of it; None from no mark."""
    moving, fixed = (_points(marks, plane) for plane in PLANES)
    if len(moving) == 1:
        shift_um = fixed[0] - moving[0] * (-1.0 if mirrored else 1.0, 1.0)
        shift = Similarity(shift_um=pair_of(shift_um), mirrored=bool(mirrored))
        return shift, "from 1 mark, a shift: rotation and scale unknown"
    with suppress(PlanishError):
        if len(moving):
            fit = _least_squares(moving, fixed, "similarity", mirrored)
            return fit, f"from {len(moving)} marks, a similarity: its error is not known"
    return None, ""


def _disagreements(
    pairs: Sequence[Mark],
    is_rejected: Bools,
    is_outlier: Bools,
    residual_um: Floats,
    leave_one_out_um: Floats,
) -> Iterator[FitWarning]:
    """A warning for each pair that the fit gives no weight, or that stands out."""
    for k, mark in enumerate(pairs):
        if is_rejected[k]:
            text = (
                f"{residual_um[k]:.0f} um off: does not agree with the others, so the fit gives it"
                " no weight."
            )
            yield FitWarning(id=mark.id, text=text)
        elif is_outlier[k]:
            text = f"Stands out: {leave_one_out_um[k]:.0f} um from where the others put it."
            yield FitWarning(id=mark.id, text=text)


def _coincidence_warnings(pairs: Sequence[Mark], where: Mapping[Plane, str]) -> list[FitWarning]:
    """A warning for each mark in use at the place of one before it; ``where`` names the planes."""
    warnings: list[FitWarning] = []
    for plane, plane_text in where.items():
        mark_at: dict[Pair, Mark] = {}
        for mark in (m for m in pairs if m.used):
            earlier = mark_at.setdefault(getattr(mark, plane).xy, mark)
            if earlier is not mark:
                text = f"Lies at the same place as {earlier.label} {plane_text}."
                warnings.append(FitWarning(id=mark.id, text=text))
    return warnings
