"""What the marks of one registration say: the fit that is shown, marks that stand out, and where a point will lie."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations
from math import comb
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from planish.app.changes import Mark
from planish.app.picture import PLANES, WHERE, Answer, Plane, finite_or_none
from planish.app.session import dataset_of
from planish.core.errors import PlanishError
from planish.core.text import and_join_few
from planish.core.transform import Similarity
from planish.core.typing import Bools, Floats
from planish.register import FittedTransform, RegistrationParams, fit_transform
from planish.register.pairs import Complexes, as_complex
from planish.run.registration import fit_marks
from planish.run.study import changed

LEAST = 5
"""Of fewer marks none can be told from the others."""
_CHANCE = 0.01  # of right marks alone, in one set of a hundred one is named
_CLEAR = 4.0  # standard deviations of one coordinate


def find_outliers(moving: Floats, fixed: Floats, mirrored: bool, *, tolerance_um: float) -> Bools:
    """Pairs that the others do not expect, shape (n,).

    Parameters
    ----------
    moving, fixed : ndarray, shape (n, 2), in um
    mirrored : bool
        Whether the moving x axis runs in the opposite direction.
    tolerance_um : float
        Two marks farther apart do not match, however few there are to tell.

    Notes
    -----
    A least trimmed squares fit of a similarity: of those through two of the pairs, the one that the best two thirds of
    all marks follow most closely, improved by refits to these. So wrong marks that agree with each other do not hide,
    unless they are more than a third. Of the rest are named those that are off by more than the tolerance and four
    standard deviations, and those that lie farther off than chance puts one of so many that were chosen from.

    References
    ----------
    Rousseeuw and Van Driessen (2006), Data Min. Knowl. Discov. 12, 29, doi:10.1007/s10618-005-0024-4.
    """
    n = len(moving)
    is_outlier = np.zeros(n, dtype=np.bool_)
    if n < LEAST:
        return is_outlier
    z, w = as_complex(moving, mirrored), as_complex(fixed, False)
    inliers = _best_inliers(z, w, n - n // 3)
    for _ in range(n):
        # How far each mark lies off a fit to the inliers, over its own error in units of theirs; their variance.
        off = np.abs(_residuals(z, w, inliers))
        away = np.abs(z - z[inliers].mean()) ** 2
        lever = 1 / inliers.size + away / max(float(np.sum(away[inliers])), 1e-300)
        spread = float(np.sum(off[inliers] ** 2)) / max(2 * inliers.size - 4, 1)
        off = off / np.sqrt(1 + lever)
        # The inliers were chosen for being close: the chance counts how many choices there were.
        limit = _CHANCE / comb(n, n - inliers.size) / max(n - inliers.size, 1)
        free = 2 * inliers.size - 4
        chance = stats.f.sf(off**2 / (2 * spread), 2, free) if spread > 0 else (off == 0).astype(np.float64)
        outside = np.setdiff1d(np.arange(n), inliers)
        if not outside.size:
            break
        nearest = outside[np.argmax(chance[outside])]
        if chance[nearest] < limit or off[nearest] > max(tolerance_um, _CLEAR * np.sqrt(spread)):
            is_outlier[outside] = True
            break
        inliers = np.append(inliers, nearest)
    return is_outlier


def _best_inliers(z: Complexes, w: Complexes, count: int) -> NDArray[np.intp]:
    """The marks that one similarity fits best."""
    if len(z) < 56:
        i, j = np.array(list(combinations(range(len(z)), 2))).T
    else:
        tries = np.tile(np.arange(len(z)), (1500, 1))  # of so many pairs a similarity is tried
        i, j = np.random.default_rng(0).permuted(tries, axis=1)[:, :2].T
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = (w[j] - w[i]) / (z[j] - z[i])
    good = np.isfinite(turn)
    turn, i = turn[good], i[good]
    if not turn.size:
        return np.arange(len(z))
    off = np.abs(w - w[i][:, None] - turn[:, None] * (z - z[i][:, None])) ** 2
    best = np.argsort(np.sum(np.partition(off, count - 1, axis=1)[:, :count], axis=1), kind="stable")[:10]
    candidates: list[tuple[float, NDArray[np.intp]]] = []
    for k in best:
        inliers = np.argsort(off[k], kind="stable")[:count]
        for _ in range(5):
            inliers = np.argsort(np.abs(_residuals(z, w, inliers)), kind="stable")[:count]
        candidates.append((float(np.sum(np.abs(_residuals(z, w, inliers)[inliers]) ** 2)), np.sort(inliers)))
    return min(candidates, key=lambda candidate: candidate[0])[1]


def _residuals(z: Complexes, w: Complexes, inliers: NDArray[np.intp]) -> Complexes:
    """Give the residuals of all marks from the similarity that fits the inliers best."""
    source, target = z[inliers].mean(), w[inliers].mean()
    away = z[inliers] - source
    turn = np.sum(away.conj() * (w[inliers] - target)) / max(float(np.sum(np.abs(away) ** 2)), 1e-300)
    return w - (target + turn * (z - source))


QUICK = ("rigid", "similarity", "affine", "projective")
"""Models that are fitted within a click."""


class FitWarning(Answer):
    """Something to be careful about: of one mark, or of all."""

    text: str
    id: str | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Fitted:
    """A fit as the page shows it.

    Attributes
    ----------
    fit : FittedTransform or None
        To the pairs in use; of a quick model while another one follows.
    pairs : tuple of Mark
        In use or not.
    residual_um, leave_one_out_um : ndarray, shape (n,)
        Of all pairs. Marks that stand out are left out of the fits to all others.
    outliers : ndarray of bool, shape (n,)
        Pairs that stand out.
    error : str
        Why there is no fit of the model; a similarity stands for it where there is one.
    pending : bool
        Whether the fit of the model is still worked out.
    warnings : tuple of FitWarning
    mirrored : bool or None
    """

    fit: FittedTransform | None
    pairs: tuple[Mark, ...]
    outliers: Bools
    residual_um: Floats
    leave_one_out_um: Floats
    error: str = ""
    pending: bool = False
    warnings: tuple[FitWarning, ...] = ()
    mirrored: bool | None = False

    @property
    def message(self) -> str:
        """Agreement of the marks, and those that stand out, in a sentence."""
        out = np.flatnonzero(self.outliers)
        if out.size and np.isfinite(self.leave_one_out_um[out]).all():  # else there is no fit, and the error says why
            far = np.argsort(-self.leave_one_out_um[out], kind="stable")
            names = and_join_few([self.pairs[k].label for k in out[far]])
            off = and_join_few([f"{self.leave_one_out_um[k]:.0f}" for k in out[far]])
            stand, they_are, them = ("stand", "they are", "them") if out.size > 1 else ("stands", "it is", "it")
            return (
                f"{names} {stand} out: {off} um off the others. Check where {they_are} set, or take {them} out of use."
            )
        if self.error:
            return self.error
        return "" if self.fit is None else self.fit.agreement([mark.label for mark in self.pairs if mark.used])

    def predicted(
        self, side: Plane, point_um: tuple[float, float]
    ) -> tuple[tuple[float, float], float | None, str] | None:
        """Place in the other plane of a point of ``side``, its expected error in um where known, and both in words."""
        used = [mark for mark in self.pairs if mark.used]
        if self.fit is not None and len(used) >= 3:
            transform, error, words = self.fit, self.fit.expected_error_um, "its error is not known"
        else:
            error = None
            transform, words = _from_few_pairs(_points(used, "moving"), _points(used, "fixed"), self.mirrored)
        if transform is None:
            return None
        point = np.array(point_um)
        counterpart_um: Floats = transform(point) if side == "moving" else transform.inverse(point)
        if not np.isfinite(counterpart_um).all():
            return None
        error_um = None if error is None else finite_or_none(error(point if side == "moving" else counterpart_um))
        if error_um is not None:
            words = f"expected error {error_um:.1f} um"
        return (float(counterpart_um[0]), float(counterpart_um[1])), error_um, words


def fitted(
    marks: Sequence[Mark], model: str, *, mirrored: bool | None, params: RegistrationParams, quick: bool = False
) -> Fitted:
    """Fit the marks as the page shows them.

    Parameters
    ----------
    marks : sequence of Mark
        Of one registration; those with one end are passed over.
    model : str
        ``auto`` is fitted as Apply will do it: robustly, with the covariances of the holes; all others by least
        squares to all marks in use.
    mirrored : bool or None
        Whether the two planes show opposite sides; None for whichever fits better.
    params : RegistrationParams
        Of the run.
    quick : bool
        Whether only what takes some milliseconds is done: of another model than `QUICK`, a similarity instead.
    """
    rows = tuple(mark for mark in marks if mark.paired)
    moving, fixed = (_points(rows, plane) for plane in PLANES)
    used = np.array([mark.used for mark in rows], dtype=np.bool_)
    is_mirrored = bool(mirrored)
    if mirrored is None:
        with suppress(PlanishError):
            is_mirrored = _least_squares(moving[used], fixed[used], "similarity", None).mirrored
    is_outlier = np.zeros(len(rows), dtype=np.bool_)
    is_outlier[used] = find_outliers(moving[used], fixed[used], is_mirrored, tolerance_um=params.tolerance_um)
    nans = np.full(len(rows), np.nan)
    warnings, error = _at_one_place(rows), ""
    if (count := int(used.sum())) < 3:
        few = f"{count} pair{'s' * (count != 1)} of marks in use: a registration needs 3, far apart, and more to say"
        warnings.append(FitWarning(text=f"{few} how good it is."))
    unfitted = Fitted(
        fit=None, pairs=rows, outliers=is_outlier, residual_um=nans, leave_one_out_um=nans, warnings=tuple(warnings),
        pending=quick and len(rows) > 1, mirrored=mirrored,
    )  # fmt: skip
    try:
        if model == "auto" and not quick:
            fit = fit_marks(dataset_of(rows), params=changed(params, model="auto"), mirrored=mirrored)
        else:
            kind = model if not quick or model in QUICK else "similarity"
            fit = _least_squares(moving[used], fixed[used], kind, mirrored, inspect=not quick)
    except PlanishError as refused:
        error = _refusal(refused, rows, used)
        try:  # there is something to look at: which marks are wrong
            fit = _least_squares(moving[used], fixed[used], "similarity", mirrored)
        except PlanishError:
            return replace(unfitted, error=error)
    residual, leave_one_out_um = np.linalg.norm(fixed - fit(moving), axis=1), nans.copy()
    leave_one_out_um[used], leave_one_out_um[~used] = fit.leave_one_out_um, residual[~used]
    if is_outlier.any():
        kind = "auto" if model == "auto" and not quick and not error else fit.model
        # Marks that stand out take part in no fit here: they would spoil the errors of the others.
        weights = (used & ~is_outlier).astype(np.float64)
        with suppress(PlanishError):  # too few are left for this model
            fit_to_others = _least_squares(moving, fixed, kind, mirrored, weights=weights)
            leave_one_out_um = fit_to_others.leave_one_out_um
    warnings += _warnings_of_marks(rows, used, is_outlier, fit, residual, leave_one_out_um)
    # Those of the fit that are about single marks stand beside them already.
    of_marks = "(counted from 0)", "marks only"
    warnings += [FitWarning(text=text) for text in fit.warnings if not any(part in text for part in of_marks)]
    return replace(
        unfitted, fit=fit, residual_um=residual, leave_one_out_um=leave_one_out_um, error=error,
        warnings=tuple(warnings),
    )  # fmt: skip


def _points(marks: Sequence[Mark], plane: Plane) -> Floats:
    return np.array([getattr(mark, plane).xy for mark in marks], dtype=np.float64).reshape(-1, 2)


def _least_squares(moving: Floats, fixed: Floats, model: str, mirrored: bool | None, **how: Any) -> FittedTransform:
    """Least squares, in which no mark is left out."""
    how = {"robust": False, "lowest": "similarity", "inspect": False} | how
    return fit_transform(moving, fixed, model=model, mirrored=mirrored, **how)


def _from_few_pairs(moving: Floats, fixed: Floats, mirrored: bool | None) -> tuple[Any, str]:
    """Fit one or two pairs: a shift, or a similarity."""
    if len(moving) == 1:
        x, y = (fixed[0] - (moving[0] * (-1.0, 1.0) if mirrored else moving[0])).tolist()
        shift = Similarity(shift_um=(x, y), mirrored=bool(mirrored))
        return shift, "from 1 mark, a shift: rotation and scale unknown"
    with suppress(PlanishError):
        if len(moving):
            fit = _least_squares(moving, fixed, "similarity", mirrored)
            return fit, f"from {len(moving)} marks, a similarity: its error is not known"
    return None, ""


def _at_one_place(rows: Sequence[Mark]) -> list[FitWarning]:
    """Marks in use at the place of another one."""
    warnings: list[FitWarning] = []
    for plane, where in WHERE.items():
        first: dict[tuple[float, float], Mark] = {}
        for mark in (m for m in rows if m.used):
            other = first.setdefault(getattr(mark, plane).xy, mark)
            if other is not mark:
                warnings.append(FitWarning(id=mark.id, text=f"Lies at the same place as {other.label} {where}."))
    return warnings


def _warnings_of_marks(
    rows: Sequence[Mark], used: Bools, is_outlier: Bools, fit: FittedTransform, residual: Floats,
    leave_one_out_um: Floats,
) -> list[FitWarning]:  # fmt: skip
    warnings: list[FitWarning] = []
    is_rejected = np.zeros(len(rows), dtype=np.bool_)
    is_rejected[used] = fit.robust_weights == 0
    for k, mark in enumerate(rows):
        if is_rejected[k]:
            text = f"{residual[k]:.0f} um off: does not agree with the others and is left out of the fit."
            warnings.append(FitWarning(id=mark.id, text=text))
        elif is_outlier[k]:
            warnings.append(FitWarning(id=mark.id, text=f"Stands out: {leave_one_out_um[k]:.0f} um off the others."))
    return warnings


def _refusal(error: PlanishError, rows: Sequence[Mark], used: Bools) -> str:
    """An error of the fit; where it is about marks at one place, with their labels."""
    twice = _at_one_place(rows)
    if twice and "at one place" in error.text:
        label = next(mark.label for mark in rows if mark.id == twice[0].id)
        return f"{label}: {twice[0].text} Move or delete one of them."
    return error.text if used.any() else ""
