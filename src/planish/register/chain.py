"""A chain of transformations from a map over others to a reference, composed: nothing is resampled twice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planish.core.errors import CannotRegister
from planish.core.transform import Similarity, nearest_similarity
from planish.register.result import FittedTransform

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Chain:
    """Fitted transformations, one after the other.

    Call it with points ``(..., 2)``, ``(x, y)`` in um of the first map to get points of the last one.

    Attributes
    ----------
    fits : tuple of FittedTransform
        The first is applied first; at least one.

    Raises
    ------
    CannotRegister
        Without a link.
    """

    fits: tuple[FittedTransform, ...]

    def __post_init__(self) -> None:
        """Refuse an empty chain."""
        if not self.fits:
            raise CannotRegister("A chain without a link leads nowhere. Give at least one fitted transformation.")

    def __call__(self, points: ArrayLike) -> Floats:
        """Take points ``(..., 2)`` of the first map to the last one, in um; NaN stays NaN."""
        at = np.asarray(points, dtype=np.float64)
        for fit in self.fits:
            at = fit(at)
        return at

    def inverse(self, points: ArrayLike) -> Floats:
        """Take points ``(..., 2)`` of the last map back to the first one, in um; NaN where a link finds no point."""
        at = np.asarray(points, dtype=np.float64)
        for fit in reversed(self.fits):
            at = fit.inverse(at)
        return at

    def jacobian(self, points: ArrayLike) -> Floats:
        """Derivatives of the image at points ``(..., 2)`` of the first map: ``(..., 2, 2)``."""
        at = np.asarray(points, dtype=np.float64)
        found = np.broadcast_to(np.eye(2), (*at.shape[:-1], 2, 2))
        for fit in self.fits:
            found = fit.jacobian(at) @ found
            at = fit(at)
        return np.array(found)

    @property
    def similarity(self) -> Similarity:
        """The closest similarity at the middle of the first link's marks."""
        if len(self.fits) == 1:
            t = self.fits[0].transform
            return Similarity(scale=t.scale, rotation_rad=t.rotation_rad, shift_um=t.shift_um, mirrored=t.mirrored)
        middle = self.fits[0].moving.mean(axis=0)
        return nearest_similarity(self.jacobian(middle), middle, self(middle))

    @property
    def mirrored(self) -> bool:
        """Whether handedness changes."""
        return sum(fit.mirrored for fit in self.fits) % 2 == 1

    def expected_error_um(self, points: ArrayLike) -> Floats:
        """Expected distance between the composed and the true image of each point.

        Parameters
        ----------
        points : array-like, shape (..., 2), in um
            Places in the first map.

        Returns
        -------
        ndarray, shape (...), in um of the last map
            Root mean square error: the errors of the links are independent, and each is carried on by the links after
            it, with the mean square of their stretch.
        """
        at = np.asarray(points, dtype=np.float64)
        square = np.zeros(at.shape[:-1])
        for fit in self.fits:
            stretch = 0.5 * np.sum(fit.jacobian(at) ** 2, axis=(-2, -1))
            square = square * stretch + fit.expected_error_um(at) ** 2
            at = fit(at)
        return np.sqrt(square)
