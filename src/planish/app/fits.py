"""What the marks of one registration say: the fit that is shown, marks that stand out, and where a point will lie."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.app.changes import Mark
from planish.app.picture import PLANES, Plane
from planish.app.standing_out import standing_out
from planish.core.errors import PlanishError
from planish.register import FittedTransform, RegistrationParams, fit_transform, register_marks

Floats = NDArray[np.float64]

QUICK = ("rigid", "similarity", "affine", "projective")
"""Models that are fitted within a click."""

_NUMBERED = "(counted from 0)"
_KNOWN = ("cov_xx", "cov_xy", "cov_yy")


@dataclass(frozen=True, slots=True, kw_only=True)
class Warned:
    """Something to be careful about: of one mark, or of all."""

    text: str
    id: str | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Fitted:
    """A fit as the page shows it.

    Attributes
    ----------
    model : str
        What was asked for.
    fit : FittedTransform or None
        To the pairs in use; of a quick model while another one follows.
    ids : tuple of str
        Of all pairs, in use or not.
    residual_um, leave_one_out_um : ndarray, shape (n,)
        Of all pairs. Marks that stand out are left out of the fits to all others.
    used, named : ndarray of bool, shape (n,)
        Pairs in use, and those that stand out.
    labels : tuple of str
    error : str
        Why there is no fit of the model; a similarity stands for it where there is one.
    follows : bool
        Whether the fit of the model is still worked out.
    warnings : tuple of Warned
    mirrored : bool or None
    """

    model: str
    fit: FittedTransform | None
    ids: tuple[str, ...]
    labels: tuple[str, ...]
    moving: Floats
    fixed: Floats
    used: NDArray[np.bool_]
    named: NDArray[np.bool_]
    residual_um: Floats
    leave_one_out_um: Floats
    error: str = ""
    follows: bool = False
    warnings: tuple[Warned, ...] = ()
    mirrored: bool | None = False

    @property
    def message(self) -> str:
        """How well the marks agree, and which stand out, in a sentence."""
        out = np.flatnonzero(self.named)
        if out.size and np.isfinite(self.leave_one_out_um[out]).all():  # else there is no fit, and the error says why
            far = np.argsort(-self.leave_one_out_um[out], kind="stable")
            names = _and([self.labels[int(k)] for k in out[far]])
            off = _and([f"{self.leave_one_out_um[k]:.0f}" for k in out[far]])
            some = out.size > 1
            return (
                f"{names} {'stand' if some else 'stands'} out: {off} um off the others. Check where "
                f"{'they are' if some else 'it is'} set, or take {'them' if some else 'it'} out of use."
            )
        if self.error:
            return self.error
        return "" if self.fit is None else self.fit.agreement([self.labels[k] for k in np.flatnonzero(self.used)])

    def predicted(self, side: Plane, at: tuple[float, float]) -> tuple[tuple[float, float], float | None, str] | None:
        """Place in the other plane of a point of ``side``, its expected error in um where known, and both in words."""
        transform, error, words = self._transform()
        if transform is None:
            return None
        point = np.array(at)
        there: Floats = transform(point) if side == "moving" else transform.inverse(point)
        if not np.isfinite(there).all():
            return None
        known = None if error is None else float(error(point if side == "moving" else there))
        if known is not None and np.isfinite(known):
            words = f"expected error {known:.1f} um"
        return (float(there[0]), float(there[1])), known if known is not None and np.isfinite(known) else None, words

    def _transform(self) -> tuple[Any, Callable[[Any], Any] | None, str]:
        n = int(self.used.sum())
        if self.fit is not None and n >= 3:
            return self.fit, self.fit.expected_error_um, "its error is not known"
        return _few(self.moving[self.used], self.fixed[self.used], self.mirrored)


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
    rows = [mark for mark in marks if mark.paired]
    moving, fixed = (_places(rows, plane) for plane in PLANES)
    used = np.array([mark.used for mark in rows], dtype=np.bool_)
    hand = _hand(moving[used], fixed[used]) if mirrored is None else mirrored
    named = np.zeros(len(rows), dtype=np.bool_)
    named[used] = standing_out(moving[used], fixed[used], hand, tolerance_um=params.tolerance_um)
    nothing = np.full(len(rows), np.nan)
    own: dict[str, Any] = {
        "model": model, "ids": tuple(m.id for m in rows), "labels": tuple(m.label for m in rows), "moving": moving,
        "fixed": fixed, "used": used, "mirrored": mirrored, "follows": quick and len(rows) > 1,
    }  # fmt: skip
    warned = [*_twice(rows), *_too_few(int(used.sum()))]
    error = ""
    try:
        if model == "auto" and not quick:
            fit = _as_applied([m for m in rows if m.used], mirrored, params)
        else:
            kind = model if not quick or model in QUICK else "similarity"
            fit = _plain(moving[used], fixed[used], kind, mirrored, inspect=not quick)
    except PlanishError as refused:
        error = _said(refused, rows, used)
        try:  # there is something to look at: which marks are wrong
            fit = _plain(moving[used], fixed[used], "similarity", mirrored, inspect=False)
        except PlanishError:
            return Fitted(
                **own, fit=None, named=named, residual_um=nothing, leave_one_out_um=nothing, error=error,
                warnings=tuple(warned),
            )  # fmt: skip
    residual, left = np.linalg.norm(fixed - fit(moving), axis=1), nothing.copy()
    left[used], left[~used] = fit.leave_one_out_um, residual[~used]
    if named.any():
        kind = "auto" if model == "auto" and not quick and not error else fit.model
        left = _left_by_others(kind, moving, fixed, used & ~named, mirrored, left)
    return Fitted(
        **own, fit=fit, named=named, residual_um=residual, leave_one_out_um=left, error=error,
        warnings=(*warned, *_of_rows(rows, used, named, fit, residual, left), *_of_fit(fit)),
    )  # fmt: skip


def _places(rows: Sequence[Mark], plane: Plane) -> Floats:
    return np.array([end.xy for m in rows if (end := getattr(m, plane)) is not None], dtype=np.float64).reshape(-1, 2)


def _as_applied(rows: Sequence[Mark], mirrored: bool | None, params: RegistrationParams) -> FittedTransform:
    """The fit that a run makes of given marks."""
    seen = {"moving": "bottom" if mirrored else "top", "fixed": "top"}
    both = [holes_of(rows, plane).assign_attrs(seen_from=seen[plane]) for plane in PLANES]
    params = params.model_copy(update={"model": "auto"})
    pairs = np.stack([np.arange(len(rows))] * 2, axis=1)
    return register_marks(*both, params=params, pairs=pairs).fit


def holes_of(rows: Sequence[Mark], plane: Plane) -> xr.Dataset:
    """One end of marks as holes, with covariances where those of all are known."""
    ends = [getattr(mark, plane) for mark in rows]
    names = ["x", "y"]
    if all(getattr(end, name) is not None for end in ends for name in _KNOWN):
        names += _KNOWN
    return xr.Dataset({name: ("mark", np.array([getattr(e, name) for e in ends], dtype=np.float64)) for name in names})


def _hand(moving: Floats, fixed: Floats) -> bool:
    """Whether a mirrored similarity fits better."""
    try:
        return _plain(moving, fixed, "similarity", None, inspect=False).mirrored
    except PlanishError:
        return False


def _plain(moving: Floats, fixed: Floats, model: str, mirrored: bool | None, **how: Any) -> FittedTransform:
    """Least squares, in which no mark is left out."""
    return fit_transform(moving, fixed, model=model, mirrored=mirrored, robust=False, lowest="similarity", **how)


def _left_by_others(
    model: str, moving: Floats, fixed: Floats, held: NDArray[np.bool_], mirrored: bool | None, left: Floats
) -> Floats:  # fmt: skip
    """Leave-one-out errors where the marks that stand out take part in no fit: they would spoil those of the others."""
    try:
        others = _plain(moving, fixed, model, mirrored, inspect=False, weights=held.astype(np.float64))
    except PlanishError:  # too few are left for this model
        return left
    return others.leave_one_out_um


def _few(moving: Floats, fixed: Floats, mirrored: bool | None) -> tuple[Any, None, str]:
    """What one or two pairs say: a shift, or a similarity."""
    hand = bool(mirrored)
    if len(moving) == 1:
        from planish.core.transform import Similarity

        turned = moving[0] * (-1.0, 1.0) if hand else moving[0]
        x, y = (fixed[0] - turned).tolist()
        return Similarity(shift_um=(x, y), mirrored=hand), None, "from 1 mark, a shift: rotation and scale unknown"
    if len(moving) < 2:
        return None, None, ""
    try:
        fit = _plain(moving, fixed, "similarity", mirrored, inspect=False)
    except PlanishError:
        return None, None, ""
    return fit, None, f"from {len(moving)} marks, a similarity: its error is not known"


# --- words -----------------------------------------------------------------------------------------------------------


def _twice(rows: Sequence[Mark]) -> list[Warned]:
    """Marks in use at the place of another one."""
    found: list[Warned] = []
    for plane, where in (("moving", "on the volume side"), ("fixed", "in the image")):
        first: dict[tuple[float, float], Mark] = {}
        for mark in (m for m in rows if m.used):
            other = first.setdefault(getattr(mark, plane).xy, mark)
            if other is not mark:
                found.append(Warned(id=mark.id, text=f"Lies at the same place as {other.label} {where}."))
    return found


def _too_few(count: int) -> list[Warned]:
    if count >= 3:
        return []
    marks = f"{count} pair{'s' * (count != 1)} of marks in use"
    return [Warned(text=f"{marks}: a registration needs 3, far apart, and more to say how good it is.")]


def _of_rows(
    rows: Sequence[Mark], used: NDArray[np.bool_], named: NDArray[np.bool_], fit: FittedTransform, residual: Floats,
    left: Floats,
) -> list[Warned]:  # fmt: skip
    found: list[Warned] = []
    refused = np.zeros(len(rows), dtype=np.bool_)
    refused[used] = fit.robust_weights == 0
    for k, mark in enumerate(rows):
        if refused[k]:
            text = f"{residual[k]:.0f} um off: does not agree with the others and is left out of the fit."
            found.append(Warned(id=mark.id, text=text))
        elif named[k]:
            found.append(Warned(id=mark.id, text=f"Stands out: {left[k]:.0f} um off the others."))
    return found


def _of_fit(fit: FittedTransform) -> list[Warned]:
    """What the fit says of all marks; what it says of single ones stands beside them."""
    return [Warned(text=text) for text in fit.warnings if _NUMBERED not in text and "marks only" not in text]


def _said(error: PlanishError, rows: Sequence[Mark], used: NDArray[np.bool_]) -> str:
    """An error of the fit; where it is about marks at one place, with their labels."""
    twice = _twice(rows)
    if twice and "at one place" in error.text:
        label = next(mark.label for mark in rows if mark.id == twice[0].id)
        return f"{label}: {twice[0].text} Move or delete one of them."
    return error.text if used.any() else ""


def _and(words: list[str]) -> str:
    words = words if len(words) < 10 else [*words[:8], f"{len(words) - 8} more"]
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else words[0]
