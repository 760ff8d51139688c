"""A displacement that is a cubic B-spline on a regular mesh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from planish.core.typing import Bools, Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FreeForm:
    """A map ``p -> p + sum of coefficients x cubic B-splines`` of points ``(x, y)`` in um.

    Notes
    -----
    Outside the mesh a point moves as the nearest point of its border.
    """

    # (2, rows + 3, cols + 3), in um: displacements along x and y at the nodes of a mesh of ``rows x cols`` cells and
    # of one more on every side.
    coefficients_um: Floats
    origin_um: tuple[float, float]  # ``(x, y)`` of the first coefficient
    mesh_um: tuple[float, float]  # side of a cell along x and y

    def __call__(self, points: ArrayLike) -> Floats:
        """Transform points ``(..., 2)``, in um; NaN stays NaN."""
        places = np.asarray(points, dtype=np.float64)
        moved = places + self._values(self._held(places)[0], (0, 0))
        return np.where(np.isfinite(places).all(axis=-1, keepdims=True), moved, np.nan)

    def jacobian(self, points: ArrayLike) -> Floats:
        """Derivatives of the image at points ``(..., 2)``: ``(..., 2, 2)``, a row for x and y of the image."""
        places = np.asarray(points, dtype=np.float64)
        clamped, is_inside = self._held(places)
        slopes = np.stack([self._values(clamped, nu) for nu in ((0, 1), (1, 0))], axis=-1)
        out = slopes * is_inside[..., None, :] + np.eye(2)
        return np.where(np.expand_dims(np.all(np.isfinite(places), axis=-1), (-2, -1)), out, np.nan)

    def _held(self, points: Floats) -> tuple[Floats, Bools]:
        """Nearest points of the mesh, and whether they are the points themselves, along x and y."""
        cells = np.array(self.coefficients_um.shape[:0:-1]) - 3
        low = np.array(self.origin_um) + self.mesh_um
        finite = np.nan_to_num(points)
        clamped = np.clip(finite, low, low + cells * np.array(self.mesh_um))
        return clamped, np.equal(clamped, finite)

    def _values(self, points: Floats, nu: tuple[int, int]) -> Floats:
        """Displacement (..., 2) at points of the mesh, or its derivatives of the orders ``nu`` along y and x."""
        from scipy.interpolate import NdBSpline

        knots = [
            first + mesh * (np.arange(n + 4) - 2.0)
            for n, first, mesh in zip(
                self.coefficients_um.shape[1:], self.origin_um[::-1], self.mesh_um[::-1], strict=True
            )
        ]
        spline: Any = NdBSpline((knots[0], knots[1]), np.moveaxis(self.coefficients_um, 0, -1), 3)
        return np.asarray(spline(points[..., ::-1], nu=nu), dtype=np.float64)
