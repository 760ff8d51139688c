r"""Error of a registration by the marks, predicted before a hole is burnt.

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
from numpy.typing import ArrayLike

from planish.core.typing import Floats
from planish.marks.design.params import ImagingParams
from planish.marks.design.pattern import Pattern

# Ratio of the error that 95 % stay below to the rms, where both axes err alike and independently.
P95 = float(np.sqrt(-np.log(0.05)))
_PIXEL_SHARE = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Predicted:
    """Error that a pattern allows.

    Attributes
    ----------
    fle_um : float
        Error of one hole's position in one map against the other, rms in the plane.
    holes_um, field_um : ndarray, (n, 2) and (5, 2)
        Holes, and the middle and corners of the field, stage coordinates.
    """

    fle_um: float
    holes_um: Floats
    field_um: Floats

    @property
    def radius_um(self) -> float:
        """Rms distance of the holes from their centroid."""
        return float(np.sqrt(np.mean(np.sum((self.holes_um - self.holes_um.mean(axis=0)) ** 2, axis=1))))

    @property
    def centre_um(self) -> float:
        """Error of the map, rms, in the middle of the field."""
        return float(self.at(self.field_um[0]))

    @property
    def corner_um(self) -> float:
        """Error of the map, rms, in the field's worst corner."""
        return float(self.at(self.field_um[1:]).max())

    def at(self, points_um: ArrayLike) -> Floats:
        """Predict the rms error, in um, at points (..., 2) in stage coordinates."""
        away = np.sum((np.asarray(points_um, dtype=np.float64) - self.holes_um.mean(axis=0)) ** 2, axis=-1)
        return np.asarray(self.fle_um / np.sqrt(len(self.holes_um)) * np.sqrt(1 + away / self.radius_um**2))

    def sentence(self) -> str:
        """Write the error in a line."""
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
    shares = np.array([[0.5, 0.5], [0, 0], [1, 0], [1, 1], [0, 1]])
    return Predicted(
        fle_um=hole_error_um(pattern.diameter_um, imaging),
        holes_um=pattern.points_um,
        field_um=np.array(pattern.field_low_um) + np.array(pattern.field_um) * shares,
    )
