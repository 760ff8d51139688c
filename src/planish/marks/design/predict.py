r"""How far maps will be off each other, predicted before a hole is burnt.

The centre of a hole is found from its outline. A rim whose radius varies by :math:`\sigma` over a length
:math:`\ell` has :math:`n = \pi d / \ell` independent arcs; a circle through them is off by :math:`2 \sigma / \sqrt{n}`
(rms, in the plane). The pixels add 0.1 pixel along each axis. Both count once for each of the two maps, since the two
instruments do not see the same rim: what they have in common makes the truth better than this.

The error of the map at a distance r from the centroid of N holes with the rms radius f follows from that for a
similarity [1]_: :math:`TRE^2 = FLE^2 / N \; (1 + r^2 / f^2)`.

References
----------
.. [1] J. M. Fitzpatrick, J. B. West, C. R. Maurer, "Predicting error in rigid-body point-based registration", IEEE
   Transactions on Medical Imaging 17 (1998) 694-702, https://doi.org/10.1109/42.736021. With a free scale the second
   term of two dimensions doubles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planish.marks.design.params import ImagingParams
from planish.marks.design.pattern import Pattern

Array = NDArray[np.float64]

P95 = float(np.sqrt(-np.log(0.05)))
"""Ratio of the error that 95 % stay below to the rms, where both axes err alike and independently."""
_PIXEL_SHARE = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Predicted:
    """Error that a pattern allows.

    Attributes
    ----------
    fle_um : float
        Error of one hole's position in one map against the other, rms in the plane.
    centroid_um : (x, y)
        Of the holes, stage coordinates.
    radius_um : float
        Their rms distance from it.
    holes : int
    centre_um, corner_um : float
        Error of the map, rms, in the middle of the field and in its worst corner.
    """

    fle_um: float
    centroid_um: tuple[float, float]
    radius_um: float
    holes: int
    centre_um: float
    corner_um: float

    def at(self, points_um: ArrayLike) -> Array:
        """Predict the rms error, in um, at points (..., 2) in stage coordinates."""
        away = np.sum((np.asarray(points_um, dtype=np.float64) - np.array(self.centroid_um)) ** 2, axis=-1)
        return np.asarray(self.fle_um / np.sqrt(self.holes) * np.sqrt(1 + away / self.radius_um**2))

    def sentence(self) -> str:
        """Say it in a line."""
        return (
            f"predicted error: {self.centre_um:.2f} um rms in the middle of the field, {self.corner_um:.2f} um in its "
            f"worst corner (95 % below {P95 * self.corner_um:.2f} um), from {self.fle_um:.2f} um for a hole"
        )


def hole_error_um(diameter_um: float, imaging: ImagingParams | None = None) -> float:
    """Predict the error of one hole's position in one map against the other, rms in the plane, in um."""
    imaging = imaging or ImagingParams()
    arcs = max(np.pi * diameter_um / imaging.rim_length_um, 3.0)  # fewer fix no circle
    rim = 4 * imaging.roughness_um**2 / arcs
    return float(np.sqrt(sum(rim + 2 * (_PIXEL_SHARE * pixel) ** 2 for pixel in imaging.pixel_um)))


def predict(pattern: Pattern, imaging: ImagingParams | None = None) -> Predicted:
    """Predict the error of a registration by a similarity over the pattern's field."""
    points = pattern.points_um
    centroid = points.mean(axis=0)
    radius = float(np.sqrt(np.mean(np.sum((points - centroid) ** 2, axis=1))))
    fle = hole_error_um(pattern.burn.diameter_um, imaging)
    low, size = np.array(pattern.field_low_um), np.array(pattern.field_um)
    places = low + size * np.array([[0.5, 0.5], [0, 0], [1, 0], [1, 1], [0, 1]])
    away = np.sum((places - centroid) ** 2, axis=1)
    errors = fle / np.sqrt(len(points)) * np.sqrt(1 + away / radius**2)
    return Predicted(
        fle_um=fle, centroid_um=(float(centroid[0]), float(centroid[1])), radius_um=radius, holes=len(points),
        centre_um=float(errors[0]), corner_um=float(errors[1:].max()),
    )  # fmt: skip
