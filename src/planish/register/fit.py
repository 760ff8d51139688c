"""Least-squares transformation between paired marks, with what it says about its own error.

Points are complex numbers here: with ``z = x + iy`` a similarity is ``w = alpha z + beta``, least squares is ordinary
linear regression, and leverages and leave-one-out errors have closed forms.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planish.core.errors import MarkError
from planish.core.transform import Similarity

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Model = Literal["similarity", "rigid"]

# Marks closer together than this share of their distance from the origin cannot be told apart in float64.
COINCIDENT = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FittedTransform:
    """A transformation fitted to marks, and its errors.

    Call it with points ``(..., 2)``, ``(x, y)`` in um of the moving frame to get points of the fixed frame.

    Attributes
    ----------
    transform : Similarity
        The fitted map, moving to fixed.
    model : {"similarity", "rigid"}
        What was fitted; ``rigid`` keeps scale 1.
    moving, fixed : ndarray, shape (n, 2), in um
        The marks as given.
    weights : ndarray, shape (n,)
        Relative weights, 1 where none were given.
    residuals_um : ndarray, shape (n, 2), in um
        ``fixed - transform(moving)``, in the fixed frame.
    leave_one_out_um : ndarray, shape (n,), in um
        Distance by which the fit to all other marks misses each mark; NaN where the others fix no transformation.
    """

    transform: Similarity
    model: Model
    moving: Floats
    fixed: Floats
    weights: Floats
    residuals_um: Floats
    leave_one_out_um: Floats

    def __call__(self, points: ArrayLike) -> Floats:
        """Transform points of shape ``(..., 2)``, in um, from the moving to the fixed frame."""
        return self.transform(points)

    @property
    def inverse(self) -> Similarity:
        """The transformation from the fixed to the moving frame."""
        return self.transform.inverse

    @property
    def rms_um(self) -> float:
        """Root mean square length of the residuals, weighted, in um (fiducial registration error)."""
        squares = np.sum(self.residuals_um**2, axis=1)
        return float(np.sqrt(np.sum(self.weights * squares) / np.sum(self.weights)))

    @property
    def localisation_error_um(self) -> float:
        """Error of one pair of marks that the residuals speak for, rms in the plane, in um; NaN where none are left.

        ``rms**2 = (1 - 2/n) * error**2`` for a similarity and ``(1 - 3/(2n))`` for a rigid transformation.
        """
        used = int(np.count_nonzero(self.weights))
        freedom = used - (2.0 if self.model == "similarity" else 1.5)
        if used < 3:
            return float("nan")
        return self.rms_um * float(np.sqrt(used / freedom))

    def expected_error_um(self, points: ArrayLike) -> Floats:
        """Expected distance between the fitted and the true image of each point.

        Parameters
        ----------
        points : array-like, shape (..., 2), in um
            Places ``(x, y)`` in the moving frame, as taken by the transformation itself. For places of the fixed frame
            pass ``fit.inverse(points)``.

        Returns
        -------
        ndarray, shape (...), in um
            Root mean square error. All NaN with two marks: they fit exactly and say nothing of their error.

        Notes
        -----
        ``error**2 = FLE**2 / n * (1 + d**2 / f**2)`` for a similarity, ``d**2 / (2 f**2)`` for a rigid transformation,
        with ``d`` the distance from the centroid of the marks, ``f`` their rms distance from it, and ``FLE`` from
        `localisation_error_um`. With fewer than 6 marks FLE itself is known to no better than about 40 %.

        References
        ----------
        Fitzpatrick and West (2001), IEEE Trans. Med. Imaging 20, 917, doi:10.1109/42.952729.
        """
        total = np.sum(self.weights)
        centre = self.weights @ self.moving / total
        spread = np.sum(self.weights * np.sum((self.moving - centre) ** 2, axis=1)) / total
        away = np.sum((np.asarray(points, dtype=np.float64) - centre) ** 2, axis=-1)
        turn = 1.0 if self.model == "similarity" else 0.5
        # With weights, 1/n becomes the share of the centroid's variance in the variance of a mark of mean weight.
        used = np.count_nonzero(self.weights)
        return np.asarray(self.localisation_error_um * np.sqrt((1.0 + turn * away / spread) / used))

    def to_json(self) -> str:
        """Return the fit as JSON text: the transformation, its matrix, and the errors of every mark, lengths in um."""

        def plain(values: Floats) -> list[float | None]:
            return [float(value) if np.isfinite(value) else None for value in values]

        fle = self.localisation_error_um
        return json.dumps(
            {
                "model": self.model,
                "scale": self.transform.scale,
                "rotation_rad": self.transform.rotation_rad,
                "shift_um": list(self.transform.shift_um),
                "mirrored": self.transform.mirrored,
                "matrix": self.transform.matrix().tolist(),
                "rms_um": self.rms_um,
                "localisation_error_um": fle if np.isfinite(fle) else None,
                "moving_um": self.moving.tolist(),
                "fixed_um": self.fixed.tolist(),
                "weights": self.weights.tolist(),
                "residuals_um": self.residuals_um.tolist(),
                "leave_one_out_um": plain(self.leave_one_out_um),
            }
        )


def fit_transform(
    moving: ArrayLike,
    fixed: ArrayLike,
    *,
    model: Model = "similarity",
    mirrored: bool = False,
    weights: ArrayLike | None = None,
) -> FittedTransform:
    """Fit the transformation that takes the moving marks to the fixed marks by least squares.

    Parameters
    ----------
    moving, fixed : array-like, shape (n, 2), in um
        Paired marks ``(x, y)``. Two pairs fix the transformation exactly; from three on the residuals say something of
        the error.
    model : {"similarity", "rigid"}
        Rotation and shift with one scale, or without scale (scale 1).
    mirrored : bool
        Whether the moving x axis runs the other way, as when the two maps show opposite sides of the sheet.
    weights : array-like, shape (n,), optional
        Proportional to one over the variance of each pair; 0 leaves a pair out of the fit but reports its residual.

    Returns
    -------
    FittedTransform
        Residuals in the fixed frame.

    Raises
    ------
    MarkError
        If there are fewer than two pairs, counts differ, a coordinate or weight is not finite, or all marks of one side
        coincide.

    Notes
    -----
    The leave-one-out error of a similarity is ``|e| / (1 - h)`` with leverage ``h = w/sum(w) + w|z|**2/sum(w|z|**2)``;
    that of a rigid transformation is found by refitting without each mark.

    References
    ----------
    Umeyama (1991), IEEE Trans. Pattern Anal. Mach. Intell. 13, 376, doi:10.1109/34.88573.
    Hirn et al. (2009), section 2.4: control points, translation with rotation and rescaling, least squares.

    Examples
    --------
    >>> fit = fit_transform([[0, 0], [1000, 0], [0, 500]], [[10, 20], [10, 1020], [-490, 20]])
    >>> round(fit.transform.scale, 6), round(float(np.degrees(fit.transform.rotation_rad)), 6)
    (1.0, 90.0)
    """
    source, target, share = _checked(moving, fixed, weights, model)
    z = _complex(source, mirrored)
    w = _complex(target, False)
    z_mean, w_mean = np.sum(share * z) / np.sum(share), np.sum(share * w) / np.sum(share)
    zc, wc = z - z_mean, w - w_mean
    alpha = _turn(np.sum(share * zc.conj() * wc), np.sum(share * np.abs(zc) ** 2), model)
    beta = w_mean - alpha * z_mean
    left_over = wc - alpha * zc
    return FittedTransform(
        transform=Similarity(
            scale=float(abs(alpha)) if model == "similarity" else 1.0,
            rotation_rad=float(np.angle(alpha)),
            shift_um=(float(beta.real), float(beta.imag)),
            mirrored=mirrored,
        ),
        model=model,
        moving=source,
        fixed=target,
        weights=share,
        residuals_um=np.stack([left_over.real, left_over.imag], axis=1),
        leave_one_out_um=_leave_one_out(zc, wc, share, left_over, model),
    )


def _complex(points: Floats, mirrored: bool) -> Complexes:
    return (-points[:, 0] if mirrored else points[:, 0]) + 1j * points[:, 1]


def _turn(product: complex, square: float, model: Model) -> complex:
    """Return alpha from ``sum(w conj(z) w')`` and ``sum(w |z|**2)`` of centred points."""
    if square <= 0.0 or abs(product) <= COINCIDENT * square:
        raise MarkError(
            "The marks fix no rotation: the directions between them disagree completely on the two sides. "
            "Check that every row pairs the same hole on both sides."
        )
    return product / square if model == "similarity" else product / abs(product)


def _leave_one_out(zc: Complexes, wc: Complexes, share: Floats, left_over: Complexes, model: Model) -> Floats:
    total, square = np.sum(share), np.sum(share * np.abs(zc) ** 2)
    leverage = share / total + share * np.abs(zc) ** 2 / square
    # Leverage 1: without this mark the others coincide (or one alone is left), and fix nothing.
    lonely = 1.0 - leverage < COINCIDENT
    with np.errstate(divide="ignore", invalid="ignore"):
        if model == "similarity":
            errors = np.abs(left_over) / (1.0 - leverage)
        else:
            # Sums without mark i follow from the full sums of centred points, so all refits are done at once.
            rest = total - share
            z_rest, w_rest = -share * zc / rest, -share * wc / rest
            product = np.sum(share * zc.conj() * wc) - share * zc.conj() * wc - rest * z_rest.conj() * w_rest
            alpha = product / np.abs(product)
            errors = np.abs((wc - w_rest) - alpha * (zc - z_rest))
    return np.where(lonely, np.nan, errors)


def _checked(
    moving: ArrayLike, fixed: ArrayLike, weights: ArrayLike | None, model: str
) -> tuple[Floats, Floats, Floats]:
    if model not in ("similarity", "rigid"):
        raise MarkError(f"The model is {model!r}; it has to be 'similarity' or 'rigid'.")
    source, target = np.array(moving, dtype=np.float64), np.array(fixed, dtype=np.float64)
    for name, points in (("moving", source), ("fixed", target)):
        if points.size and (points.ndim != 2 or points.shape[1] != 2):
            raise MarkError(f"The {name} marks have shape {points.shape}; (n, 2) is needed, one (x, y) in um a row.")
    if len(source) != len(target):
        raise MarkError(f"{len(source)} moving and {len(target)} fixed marks given; every mark needs its partner.")
    share = np.ones(len(source)) if weights is None else np.array(weights, dtype=np.float64)
    faults: list[str] = []
    if share.shape != (len(source),):
        faults.append(f"the weights have shape {share.shape}, {len(source)} marks need ({len(source)},)")
    elif not (np.all(np.isfinite(share)) and np.all(share >= 0.0)):
        faults.append("weights have to be finite and not negative")
    for name, points in (("moving", source), ("fixed", target)):
        bad = np.flatnonzero(~np.all(np.isfinite(points), axis=-1)) if points.size else np.array([], dtype=np.intp)
        if bad.size:
            faults.append(f"{name} mark{'s' * (bad.size > 1)} {', '.join(str(i) for i in bad[:8])} not finite")
    if faults:
        raise MarkError(f"The marks cannot be used: {'; '.join(faults)}. Correct or remove them.")
    used = int(np.count_nonzero(share))
    if used < 2:
        raise MarkError(
            f"{used} pair{'s' * (used != 1)} of marks given, a transformation needs 2, and 3 to say anything of its "
            f"error. Add {2 - used} or more, far apart."
        )
    for name, points in (("moving", source), ("fixed", target)):
        here = points[share > 0]
        if np.ptp(here, axis=0).max() <= COINCIDENT * max(1.0, float(np.abs(here).max())):
            raise MarkError(
                f"All {used} {name} marks lie at ({here[0, 0]:g}, {here[0, 1]:g}) um; at least two places are needed."
            )
    return source, target, share
