"""The similarity transformation between two maps: rotation, shift, one scale, and a mirror where declared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Similarity:
    """A map ``p -> scale * R(rotation) * M * p + shift`` of points ``(x, y)`` in um.

    Attributes
    ----------
    scale : float
        Ratio of lengths, target over source; positive.
    rotation_rad : float
        Angle that turns the x axis towards the y axis (clockwise on screen, where y runs down).
    shift_um : tuple of float
        ``(x, y)`` of the image of the origin.
    mirrored : bool
        Whether the source's x axis is reversed first (``M = diag(-1, 1)``).
    """

    scale: float = 1.0
    rotation_rad: float = 0.0
    shift_um: tuple[float, float] = (0.0, 0.0)
    mirrored: bool = False

    def matrix(self) -> NDArray[np.float64]:
        """Return the 2 x 2 linear part."""
        cos, sin = np.cos(self.rotation_rad), np.sin(self.rotation_rad)
        flip = -1.0 if self.mirrored else 1.0
        return self.scale * np.array([[cos * flip, -sin], [sin * flip, cos]])

    def __call__(self, points: ArrayLike) -> NDArray[np.float64]:
        """Transform points of shape ``(..., 2)``, ``(x, y)`` in um; NaN stays NaN."""
        return np.asarray(points, dtype=np.float64) @ self.matrix().T + np.asarray(self.shift_um)

    @property
    def inverse(self) -> Similarity:
        """The transformation back."""
        linear = np.linalg.inv(self.matrix())
        flip = -1.0 if self.mirrored else 1.0
        # The inverse is a similarity of the same handedness; its rotation is read off the y column, which M
        # leaves alone.
        rotation = float(np.arctan2(-linear[0, 1], linear[1, 1]))
        shift = -linear @ np.asarray(self.shift_um)
        assert np.sign(np.linalg.det(linear)) == flip
        return Similarity(
            scale=1.0 / self.scale,
            rotation_rad=rotation,
            shift_um=(float(shift[0]), float(shift[1])),
            mirrored=self.mirrored,
        )
