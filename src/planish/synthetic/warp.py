"""An exact way to bend a sheet: a general cylinder, which keeps all lengths, plus an optional bump, which does not."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from planish.core.typing import Floats
from planish.synthetic.draws import Strict, drawn

_STEP_UM = 2.0
_GAUSS_X, _GAUSS_W = np.polynomial.legendre.leggauss(5)


@dataclass(frozen=True, slots=True, kw_only=True)
class Warp(Strict):
    """Centre surface ``m(u, v)`` of a bent sheet.

    The sheet is rolled along the direction ``ruling_deg`` from the u axis: its profile curve turns by
    ``psi(p) = tilt + atan(slope) sin(2 pi p / wavelength + phase)`` at arc length ``p``, so that lengths in the sheet
    are exactly those in ``(u, v)``. The bump is added in height and stretches the sheet.

    Attributes
    ----------
    slope : float
        Steepest slope of the profile against its mean plane (tangent of the angle).
    tilt_deg : float
        Tilt of the whole sheet along the profile.
    wavelength_um, phase_rad, ruling_deg : float
        Of the profile curve; the rulings stand perpendicular to ``ruling_deg``.
    bump_um, bump_u_um, bump_v_um, bump_radius_um : float
        Height, centre and Gaussian radius of the bump.
    shift_um : (float, float, float)
        Added to (x, y, z).
    reach_um : float
        Largest ``|u|`` and ``|v|`` that are asked for.
    """

    slope: float = drawn(0.5, 0.0, 0.42)
    tilt_deg: float = drawn(0.0, -7.0, 7.0)
    wavelength_um: float = drawn(3000.0, 2500.0, 15000.0)
    phase_rad: float = drawn(0.6, 0.0, 6.28)
    ruling_deg: float = drawn(20.0, -90.0, 90.0)
    bump_um: float = drawn(0.0, of=(0.0, 0.0, 50.0, 100.0, 150.0))
    bump_u_um: float = 0.0
    bump_v_um: float = 0.0
    bump_radius_um: float = drawn(800.0, 1500.0, 3000.0)
    shift_um: tuple[float, float, float] = (0.0, 0.0, 0.0)
    reach_um: float = 8000.0

    def packed(self) -> tuple[Floats, Floats]:
        """Return the parameters and the profile curve as the kernels take them."""
        return _packed(self)

    @property
    def steepest(self) -> float:
        """Steepest slope of the profile, with the tilt."""
        return float(np.tan(abs(np.deg2rad(self.tilt_deg)) + np.arctan(abs(self.slope))))

    def points(self, u: Floats, v: Floats) -> Floats:
        """Return ``m(u, v)`` as (..., 3) in the order x, y, z, in um."""
        return self._frames(u, v)[0]

    def normals(self, u: Floats, v: Floats) -> Floats:
        """Return unit normals (..., 3), pointing to the top side (+z)."""
        return self._frames(u, v)[1]

    def material(self, points: Floats) -> Floats:
        """Return ``(u, v, s)`` of points ``(..., 3)`` given as x, y, z: the exact inverse of ``m + s n``."""
        from planish.synthetic import _kernels

        flat = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
        return _kernels.materials(*self.packed(), flat).reshape(points.shape)

    def columns(self, y_um: Floats, x_um: Floats) -> Floats:
        """Return ``(u, v, z)`` of the centre surface at the columns (y, x), shape (len(y), len(x), 3)."""
        from planish.synthetic import _kernels

        return _kernels.columns(*self.packed(), np.asarray(y_um, float), np.asarray(x_um, float))

    def _frames(self, u: Floats, v: Floats) -> tuple[Floats, Floats]:
        from planish.synthetic import _kernels

        u, v = np.broadcast_arrays(u, v)
        points, normals = _kernels.frames(*self.packed(), u.ravel().astype(float), v.ravel().astype(float))
        return points.reshape(*u.shape, 3), normals.reshape(*u.shape, 3)


@lru_cache(maxsize=8)
def _packed(warp: Warp) -> tuple[Floats, Floats]:
    angle = np.deg2rad(warp.ruling_deg)
    psi, k, tilt = np.arctan(warp.slope), 2 * np.pi / warp.wavelength_um, np.deg2rad(warp.tilt_deg)
    count = int(np.ceil(2 * 1.5 * warp.reach_um / _STEP_UM)) + 1
    p0 = -(count // 2) * _STEP_UM
    # Gauss-Legendre on every step: exact to rounding, because psi is smooth over a step.
    p = p0 + _STEP_UM * (np.arange(count - 1)[:, None] + 0.5 * (1 + _GAUSS_X))
    turn = tilt + psi * np.sin(k * p + warp.phase_rad)
    steps = 0.5 * _STEP_UM * np.stack([np.cos(turn) @ _GAUSS_W, np.sin(turn) @ _GAUSS_W], axis=1)
    curve = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    curve -= curve[count // 2]
    turn = tilt + psi * np.sin(k * (p0 + _STEP_UM * np.arange(count)) + warp.phase_rad)
    curve = np.concatenate([curve, np.cos(turn)[:, None], np.sin(turn)[:, None]], axis=1)
    parameters = [np.cos(angle), np.sin(angle), psi, k, warp.phase_rad, p0, _STEP_UM, *warp.shift_um]
    parameters += [warp.bump_um, warp.bump_u_um, warp.bump_v_um, warp.bump_radius_um, tilt]
    return np.array(parameters, dtype=np.float64), curve
