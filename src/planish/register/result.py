"""A fitted transformation, and what it says about its own error."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planish.core.errors import MarkError
from planish.core.transform import Similarity
from planish.register.models import MODELS
from planish.register.pairs import Pairs
from planish.register.saved import FORMAT, as_array, as_number, parameters_of, transform_of, without_nan
from planish.register.smoothing import Smoothing
from planish.register.solve import Noise, leave_one_out
from planish.register.strain import Strain, Transform, strain_of
from planish.register.thin_plate import ThinPlate, ThinPlateInverse

Floats = NDArray[np.float64]
Rung = Literal["rigid", "similarity", "affine", "projective", "tps"]


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedTransform:
    """A transformation fitted to marks, and its errors.

    Call it with points ``(..., 2)``, ``(x, y)`` in um of the moving frame to get points of the fixed frame.

    Attributes
    ----------
    transform : Similarity, Affine, Projective or ThinPlate
        The fitted map, moving to fixed. All have ``scale``, ``rotation_rad``, ``shift_um`` and ``mirrored``, those of
        the closest similarity.
    model : {"rigid", "similarity", "affine", "projective", "tps"}
        What was fitted; ``rigid`` keeps scale 1.
    moving, fixed : ndarray, shape (n, 2), in um
        The marks as given.
    information : ndarray, shape (n, 2, 2)
        Inverse covariances of the pairs up to one factor, those of marks in doubt weighted down.
    robust_weights : ndarray, shape (n,)
        1, or less for marks that do not agree with the others; 0 leaves a mark out.
    residuals_um : ndarray, shape (n, 2), in um
        ``fixed - transform(moving)``, in the fixed frame.
    noise : Noise or None
        Variance of the marks and covariance of the parameters; None for a spline, which computes them from its marks.
    warnings : tuple of str
        What a user should know: marks in doubt, few marks, a scale far from 1, strain above 1 %.
    sentence : str
        What was fitted, how well, and for ``auto`` why this model.
    """

    transform: Transform
    model: Rung
    moving: Floats
    fixed: Floats
    information: Floats
    robust_weights: Floats
    residuals_um: Floats
    noise: Noise | None
    warnings: tuple[str, ...]
    sentence: str

    def __call__(self, points: ArrayLike) -> Floats:
        """Transform points of shape ``(..., 2)``, in um, from the moving to the fixed frame."""
        return self.transform(points)

    @property
    def inverse(self) -> Transform | ThinPlateInverse:
        """The transformation from the fixed to the moving frame; that of a spline is NaN where it finds no point."""
        return self.transform.inverse

    @property
    def mirrored(self) -> bool:
        """Whether the transformation changes handedness."""
        return self.transform.mirrored

    @property
    def weights(self) -> Floats:
        """Relative weights of the marks in the fit, shape (n,): half the trace of their information."""
        return self._pairs.weights

    @property
    def _pairs(self) -> Pairs:
        return Pairs(moving=self.moving, fixed=self.fixed, information=self.information)

    @cached_property
    def _spline(self) -> Smoothing:
        return Smoothing(self._pairs.take(self.weights > 0))

    @cached_property
    def _missed(self) -> Floats:
        if not isinstance(self.transform, ThinPlate):
            return leave_one_out(self._pairs, self.transform, MODELS[self.model])
        missed = self.residuals_um.copy()
        errors, _ = self._spline.missed(self.transform.smoothing_um2)
        missed[self.weights > 0] = np.linalg.solve(self._spline.whitening, errors[..., None])[..., 0]
        return missed

    @property
    def leave_one_out_um(self) -> Floats:
        """Distance by which the fit to all other marks misses each mark, shape (n,), in um.

        NaN where the others fix no transformation. All weights, also the robust ones, and the smoothing of a spline
        stay as they are in the fit to all marks. A mark that is left out of the fit is missed by its residual.
        """
        return np.linalg.norm(self._missed, axis=1)

    @property
    def leave_one_out_rms_um(self) -> float:
        """Root mean square of the leave-one-out errors, weighted as in the fit, in um."""
        return weighted_rms(self.leave_one_out_um, self.weights)

    @property
    def rms_um(self) -> float:
        """Root mean square length of the residuals, weighted, in um (fiducial registration error)."""
        return weighted_rms(np.linalg.norm(self.residuals_um, axis=1), self.weights)

    @property
    def localisation_error_um(self) -> float:
        """Error of one pair of marks that the residuals speak for, rms in the plane, in um; NaN where none are left.

        With weights, that of a pair of mean weight. ``rms**2 = (1 - p / (2n)) * error**2`` for a model of p parameters:
        ``1 - 2/n`` for a similarity, ``1 - 3/(2n)`` for a rigid transformation.
        """
        variance = self._spline.bendings.mark_variance if self.noise is None else self.noise.variance
        used = self.weights > 0
        return float(np.sqrt(2.0 * variance / np.mean(self.weights[used] / self.robust_weights[used])))

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
            Root mean square error. All NaN where the marks fit exactly by their number and say nothing of their error.

        Notes
        -----
        ``error**2 = trace(J C J')`` with the derivatives J of the image by the parameters and their covariance C. For a
        similarity that is ``FLE**2 / n * (1 + d**2 / f**2)``, and ``d**2 / (2 f**2)`` in place of the ratio for a rigid
        transformation, with ``d`` the distance from the centroid of the marks, ``f`` their rms distance from it, and
        ``FLE`` from `localisation_error_um`. A spline adds the bending that its marks do not see. With fewer than 6
        marks FLE itself is known to no better than about 40 %. The model is taken for true: what a similarity cannot
        describe is counted as error of the marks.

        References
        ----------
        Fitzpatrick and West (2001), IEEE Trans. Med. Imaging 20, 917, doi:10.1109/42.952729.
        """
        given = np.asarray(points, dtype=np.float64)
        at = given.reshape(-1, 2)
        if isinstance(self.transform, ThinPlate):
            squares = self._spline.expected_square(self.transform.smoothing_um2, at)
        else:
            assert self.noise is not None
            design = MODELS[self.model].design(self.transform, self.noise.frame, at)
            squares = np.einsum("kap,pq,kaq->k", design, self.noise.covariance, design, optimize=True)
        return np.sqrt(squares).reshape(given.shape[:-1])

    def jacobian(self, points: ArrayLike) -> Floats:
        """Derivatives of the image at points ``(..., 2)`` of the moving frame: ``(..., 2, 2)``, a row for x and y."""
        return self.transform.jacobian(points)

    @cached_property
    def strain(self) -> Strain:
        """Range of local strain and area between the marks, the overall scale taken off."""
        return strain_of(self.transform, self.moving[self.weights > 0], self.mirrored)

    def to_json(self) -> str:
        """Return the fit as JSON text: the transformation and the errors of every mark, lengths in um.

        `from_json` reads it back. What is not a number is null.
        """
        data: dict[str, Any] = {
            "format": FORMAT,
            "model": self.model,
            "sentence": self.sentence,
            "warnings": list(self.warnings),
            "scale": self.transform.scale,
            "rotation_rad": self.transform.rotation_rad,
            "shift_um": list(self.transform.shift_um),
            "mirrored": self.transform.mirrored,
            "matrix": self.transform.matrix().tolist(),
            "transform": parameters_of(self.transform),
            "rms_um": self.rms_um,
            "localisation_error_um": self.localisation_error_um,
            "moving_um": self.moving.tolist(),
            "fixed_um": self.fixed.tolist(),
            "weights": self.weights.tolist(),
            "information": self.information.tolist(),
            "robust_weights": self.robust_weights.tolist(),
            "residuals_um": self.residuals_um.tolist(),
            "leave_one_out_um": self.leave_one_out_um.tolist(),
        }
        if self.noise is not None:
            data["noise"] = {
                "variance": self.noise.variance,
                "covariance": self.noise.covariance.tolist(),
                "middle_um": self.noise.frame[0].tolist(),
                "size_um": self.noise.frame[1],
            }
        return json.dumps(without_nan(data), allow_nan=False)

    @staticmethod
    def from_json(text: str) -> FittedTransform:
        """Read back what `to_json` wrote.

        Raises
        ------
        MarkError
            If the text is no such fit.
        """
        try:
            data = json.loads(text)
            if data["format"] != FORMAT:
                raise MarkError(f"The transformation has the format {data['format']!r}; {FORMAT!r} is read.")
            noise = data.get("noise")
            transform = transform_of(data)
            return (FittedSimilarity if isinstance(transform, Similarity) else FittedTransform)(
                transform=transform,  # pyright: ignore[reportArgumentType]
                model=data["model"],
                moving=as_array(data["moving_um"]),
                fixed=as_array(data["fixed_um"]),
                information=as_array(data["information"]),
                robust_weights=as_array(data["robust_weights"]),
                residuals_um=as_array(data["residuals_um"]),
                noise=Noise(
                    variance=as_number(noise["variance"]),
                    covariance=as_array(noise["covariance"]),
                    frame=(as_array(noise["middle_um"]), as_number(noise["size_um"])),
                )
                if noise
                else None,
                warnings=tuple(data["warnings"]),
                sentence=data["sentence"],
            )
        except (ValueError, KeyError, TypeError, IndexError) as fault:
            raise MarkError(
                f"The text is no transformation written by planish ({fault}). Fit the marks again and save that."
            ) from fault


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedSimilarity(FittedTransform):
    """A rigid or similarity transformation fitted to marks."""

    transform: Similarity

    @property
    def inverse(self) -> Similarity:
        """The transformation from the fixed to the moving frame."""
        return self.transform.inverse


def weighted_rms(lengths: Floats, weights: Floats) -> float:
    """Root of the weighted mean square; what has no weight counts for nothing, also where it is NaN."""
    used = weights > 0
    return float(np.sqrt(np.sum(weights[used] * lengths[used] ** 2) / np.sum(weights)))
