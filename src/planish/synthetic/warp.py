"""An exact way to bend a sheet: a general cylinder, which keeps all lengths, plus an optional bump, which does not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planish.synthetic import _kernels

Array = NDArray[np.float64]

_STEP_UM = 2.0
_GAUSS_X, _GAUSS_W = np.polynomial.legendre.leggauss(5)


@dataclass(frozen=True, slots=True, kw_only=True)
class Warp:
    """Centre surface ``m(u, v)`` of a bent sheet.

    The sheet is rolled along the direction ``ruling_deg`` from the u axis: its profile curve turns by
    ``psi(p) = atan(slope) sin(2 pi p / wavelength + phase)`` at arc length ``p``, so that lengths in the sheet
    are exactly those in ``(u, v)``. The bump is added in height and stretches the sheet.

    Attributes
    ----------
    slope : float
        Steepest slope of the profile (tangent of the angle).
    wavelength_um, phase_rad, ruling_deg : float
        Of the profile curve; the rulings stand perpendicular to ``ruling_deg``.
    bump_um, bump_u_um, bump_v_um, bump_radius_um : float
        Height, centre and Gaussian radius of the bump.
    shift_um : (float, float, float)
        Added to (x, y, z).
    reach_um : float
        Largest ``|u|`` and ``|v|`` that are asked for.
    """

    slope: float = 0.5
    wavelength_um: float = 3000.0
    phase_rad: float = 0.6
    ruling_deg: float = 20.0
    bump_um: float = 0.0
    bump_u_um: float = 0.0
    bump_v_um: float = 0.0
    bump_radius_um: float = 800.0
    shift_um: tuple[float, float, float] = (0.0, 0.0, 0.0)
    reach_um: float = 8000.0

    def packed(self) -> tuple[Array, Array]:
        """Return the parameters and the profile curve as the kernels take them."""
        angle = np.deg2rad(self.ruling_deg)
        psi, k = np.arctan(self.slope), 2 * np.pi / self.wavelength_um
        count = int(np.ceil(2 * 1.5 * self.reach_um / _STEP_UM)) + 1
        p0 = -(count // 2) * _STEP_UM
        # Gauss-Legendre on every step: exact to rounding, because psi is smooth over a step.
        p = p0 + _STEP_UM * (np.arange(count - 1)[:, None] + 0.5 * (1 + _GAUSS_X))
        turn = psi * np.sin(k * p + self.phase_rad)
        steps = 0.5 * _STEP_UM * np.stack([np.cos(turn) @ _GAUSS_W, np.sin(turn) @ _GAUSS_W], axis=1)
        curve = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
        curve -= curve[count // 2]
        turn = psi * np.sin(k * (p0 + _STEP_UM * np.arange(count)) + self.phase_rad)
        curve = np.concatenate([curve, np.cos(turn)[:, None], np.sin(turn)[:, None]], axis=1)
        parameters = [np.cos(angle), np.sin(angle), psi, k, self.phase_rad, p0, _STEP_UM, *self.shift_um]
        parameters += [self.bump_um, self.bump_u_um, self.bump_v_um, self.bump_radius_um]
        return np.array(parameters, dtype=np.float64), curve

    def points(self, u: Array, v: Array) -> Array:
        """Return ``m(u, v)`` as (..., 3) in the order x, y, z, in um."""
        u, v = np.broadcast_arrays(u, v)
        points, _ = _kernels.frames(*self.packed(), u.ravel().astype(float), v.ravel().astype(float))
        return points.reshape(*u.shape, 3)

    def normals(self, u: Array, v: Array) -> Array:
        """Return unit normals (..., 3), pointing to the top side (+z)."""
        u, v = np.broadcast_arrays(u, v)
        _, normals = _kernels.frames(*self.packed(), u.ravel().astype(float), v.ravel().astype(float))
        return normals.reshape(*u.shape, 3)

    def material(self, points: Array) -> Array:
        """Return ``(u, v, s)`` of points ``(..., 3)`` given as x, y, z: the exact inverse of ``m + s n``."""
        flat = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
        return _kernels.materials(*self.packed(), flat).reshape(points.shape)

    def columns(self, y_um: Array, x_um: Array) -> Array:
        """Return ``(u, v, z)`` of the centre surface at the columns (y, x), shape (len(y), len(x), 3)."""
        return _kernels.columns(*self.packed(), np.asarray(y_um, float), np.asarray(x_um, float))
