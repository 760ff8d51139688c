"""A displacement that is a cubic B-spline on a regular mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FreeForm:
    """A map ``p -> p + sum of coefficients x cubic B-splines`` of points ``(x, y)`` in um.

    Attributes
    ----------
    coefficients_um : ndarray, shape (2, rows + 3, cols + 3), in um
        Displacements along x and y at the nodes of a mesh of ``rows x cols`` cells and of one more on every side.
    origin_um : (float, float)
        ``(x, y)`` of the first coefficient.
    mesh_um : (float, float)
        Side of a cell along x and y.

    Notes
    -----
    Outside the mesh a point moves as the nearest point of its border.
    """

    coefficients_um: Floats
    origin_um: tuple[float, float]
    mesh_um: tuple[float, float]

    def __call__(self, points: ArrayLike) -> Floats:
        """Transform points ``(..., 2)``, in um; NaN stays NaN."""
        given = np.asarray(points, dtype=np.float64)
        near, (wx, wy), _ = self._near(given.reshape(-1, 2))
        moved = np.einsum("kpab,pa,pb->pk", near, wy, wx)
        known = np.isfinite(given).all(axis=-1, keepdims=True)
        return np.where(known, given + moved.reshape(given.shape), np.nan)

    def jacobian(self, points: ArrayLike) -> Floats:
        """Derivatives of the image at points ``(..., 2)``: ``(..., 2, 2)``, a row for x and y of the image."""
        given = np.asarray(points, dtype=np.float64)
        near, (wx, wy), (dx, dy) = self._near(given.reshape(-1, 2))
        along_x = np.einsum("kpab,pa,pb->pk", near, wy, dx) / self.mesh_um[0]
        along_y = np.einsum("kpab,pa,pb->pk", near, dy, wx) / self.mesh_um[1]
        out = np.stack([along_x, along_y], axis=-1) + np.eye(2)
        out[~np.isfinite(given.reshape(-1, 2)).all(axis=1)] = np.nan
        return out.reshape(*given.shape[:-1], 2, 2)

    def _near(self, points: Floats) -> tuple[Floats, tuple[Floats, Floats], tuple[Floats, Floats]]:
        """Coefficients around the points (2, n, 4, 4), and their weights and slopes along x and y, (n, 4) each."""
        cells = np.array(self.coefficients_um.shape[:0:-1]) - 3
        place = (np.nan_to_num(points) - self.origin_um) / self.mesh_um - 1.0
        held = np.clip(place, 0.0, cells)
        cell = np.minimum(held.astype(np.int64), cells - 1)
        x, y = cell.T
        four = np.arange(4)
        near = self.coefficients_um[:, (y[:, None] + four)[:, :, None], (x[:, None] + four)[:, None, :]]
        part = held - cell
        free = (place == held).astype(np.float64)
        weights = _weights(part[:, 0]), _weights(part[:, 1])
        slopes = _slopes(part[:, 0]) * free[:, :1], _slopes(part[:, 1]) * free[:, 1:]
        return near, weights, slopes


def _weights(t: Floats) -> Floats:
    """Values of the four cubic B-splines over a cell at the places ``t`` in [0, 1]: (n, 4)."""
    s = 1.0 - t
    return np.stack([s**3, 4 - 6 * t**2 + 3 * t**3, 4 - 6 * s**2 + 3 * s**3, t**3], axis=-1) / 6.0


def _slopes(t: Floats) -> Floats:
    s = 1.0 - t
    return np.stack([-(s**2), 3 * t**2 - 4 * t, 4 * s - 3 * s**2, t**2], axis=-1) / 2.0
