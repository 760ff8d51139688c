"""Least-squares transformation between paired marks, with its expected error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from planish.core.errors import MarkError
from planish.core.transform import Transform
from planish.register.model import Floats
from planish.register.models import MODELS, model_named
from planish.register.pairs import Pairs, checked, listed, refuse_other_hand, rms_of_both_hands, weighted_rms
from planish.register.result import FittedTransform
from planish.register.select import select_model
from planish.register.strain import NOTABLE, Strain

_FEW = 6
_SCALES = (0.8, 1.25)
# Residuals over the spread of the marks from which on the pairs, not their errors, are in doubt.
_DISAGREE = 0.05


def fit_transform(
    moving: ArrayLike,
    fixed: ArrayLike,
    *,
    model: str = "similarity",
    mirrored: bool | None = False,
    weights: ArrayLike | None = None,
    robust: bool = True,
    lowest: str = "rigid",
) -> FittedTransform:
    """Fit the transformation that takes the moving marks to the fixed marks by least squares.

    Parameters
    ----------
    moving, fixed : array-like, shape (n, 2), in um
        Paired marks ``(x, y)``. With one pair more than the model needs, the residuals show the error.
    model : str
        One of :data:`planish.register.models.MODELS`: ``rigid``, ``similarity``, ``affine``, ``projective`` or ``tps``
        (thin-plate spline with the smoothing under which marks left out are missed least); or ``auto``, which takes
        the next model as long as marks left out are missed by over 10 % less, and by more than chance.
    mirrored : bool or None
        Whether the moving x axis runs in the opposite direction, as when the two maps show opposite sides of the
        sheet. ``None`` takes the hand that fits better.
    weights : array-like, shape (n,) or (n, 2, 2), optional
        Proportional to one over the variance of each pair, 0 leaves a pair out of the fit but reports its residual; or
        the covariance of each pair in the fixed frame, that of the moving mark (turned into that frame) and of the
        fixed mark added. Their common factor is found from the residuals.
    robust : bool
        Whether marks that do not agree with the others are weighted down. Where no mark is further off than chance puts
        the furthest of n marks once in a hundred times, all weights are exactly 1 and nothing changes.
    lowest : str
        Model at which ``auto`` begins. Two instruments hardly ever agree on the length of a micrometre, and a few marks
        cannot always prove it: a similarity is the better start there.

    Returns
    -------
    FittedTransform
        Residuals in the fixed frame.

    Raises
    ------
    MarkError
        If counts differ, a coordinate or weight is not finite, there are too few pairs, a mark is given twice, all
        marks of one side coincide, or the marks fit only with the other handedness (exchanged columns, undeclared
        mirror).
    CannotRegister
        If the marks leave a parameter free, as marks on one line do, or the transformation folds between them.

    Notes
    -----
    Leave-one-out errors of similarity and affine are ``(I - H)**-1 e`` with the block H of the hat matrix; those of
    rigid and projective are found by refitting without each mark; those of the spline hold its smoothing fixed.

    References
    ----------
    Umeyama (1991), IEEE Trans. Pattern Anal. Mach. Intell. 13, 376, doi:10.1109/34.88573.
    Hartley (1997), IEEE Trans. Pattern Anal. Mach. Intell. 19, 580, doi:10.1109/34.601246.
    Hirn et al. (2009), section 2.4: control points, translation with rotation and rescaling, least squares.

    Examples
    --------
    >>> fit = fit_transform([[0, 0], [1000, 0], [0, 500]], [[10, 20], [10, 1020], [-490, 20]])
    >>> round(fit.transform.scale, 6), round(float(np.degrees(fit.transform.rotation_rad)), 6)
    (1.0, 90.0)
    """
    least = 0 if model == "auto" else model_named(model).least
    pairs = checked(moving, fixed, weights)
    used = pairs.weights > 0
    some = pairs.take(used)
    count = len(some)
    if count < least:
        raise MarkError(
            f"{count} pairs of marks given, a model of type {model} needs {least}. Add {least - count} or more, "
            "away from the others, or choose a model with fewer parameters."
        )
    if mirrored is None:
        missed, _ = rms_of_both_hands(some)
        mirrored = missed[True] < missed[False]
    else:
        refuse_other_hand(some, mirrored)
    share, sentence = np.ones(len(pairs)), ""
    if model == "auto":
        model, share[used], sentence = select_model(some, mirrored, robust=robust, lowest=lowest)
    elif robust:
        share[used] = MODELS[model].robust_weights(some, mirrored)
    final = pairs.times(share)
    held = final.take(final.weights > 0)
    transform: Transform = MODELS[model].fit(held, mirrored)
    residuals = pairs.fixed - transform(pairs.moving)
    lengths = np.linalg.norm(residuals, axis=1)
    about = f"{model} from {len(held)} marks: residuals {weighted_rms(lengths, final.weights):.3g} um rms."
    fit = FittedTransform(
        transform=transform,
        model=model,
        moving=pairs.moving,
        fixed=pairs.fixed,
        information=final.information,
        robust_weights=share,
        residuals_um=residuals,
        sentence=f"{sentence} {about}".strip(),
    )
    # Both refuse marks that do not support the model.
    strain, _ = fit.strain, fit.errors
    return replace(fit, warnings=_warnings(final, share, lengths, transform, strain))


def _warnings(pairs: Pairs, share: Floats, lengths: Floats, transform: Transform, strain: Strain) -> tuple[str, ...]:
    found: list[str] = []
    doubted = np.flatnonzero((share < 1.0) & (lengths > 0))
    if doubted.size:
        off = ", ".join(f"{lengths[k]:.3g}" for k in doubted[:8])
        found.append(
            f"Mark{'s' * (doubted.size > 1)} {listed(doubted)} (counted from 0) do{'es' * (doubted.size == 1)} not "
            f"agree with the others (off by {off} um) and count{'s' * (doubted.size == 1)} less or not at all. "
            "Check them."
        )
    used = int(np.count_nonzero(pairs.weights > 0))
    if used < _FEW:
        found.append(
            f"{used} marks only: their error, and with it the expected error, is known to no better than about 40 %."
        )
    rms, spread = weighted_rms(lengths, pairs.weights), transform.scale * pairs.frame()[1]
    if rms > _DISAGREE * spread:
        found.append(
            f"The residuals, {rms:.3g} um rms, are {100 * rms / spread:.0f} % of the spread of the marks: many pairs "
            "are wrong. Check that every row pairs the same hole on both sides."
        )
    low, high = _SCALES
    if not low <= transform.scale <= high:
        found.append(
            f"Scale {transform.scale:.4g}: one side is probably in pixels, or its pixel size is wrong. "
            "Give both sides in um."
        )
    if strain.largest > NOTABLE:
        x, y = strain.at_um
        found.append(
            f"Local strain from {100 * strain.stretch[0]:+.2g} to {100 * strain.stretch[1]:+.2g} % between the marks, "
            f"largest near ({x:.4g}, {y:.4g}) um of the moving map. Paper strains by less than 1 %: check the marks "
            "there."
        )
    return tuple(found)
