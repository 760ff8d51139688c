"""Warp of the centre surface: its height above a mean plane, tilt and curvatures (P-07).

They have no standard error: what matters is a slow drift of the stack, which bends the surface as a real warp does and
cannot be told from one scan.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planish.measure.registry import Sheet, sheet_property

if TYPE_CHECKING:
    from planish.measure.greys import Greys
    from planish.measure.params import MeasureParams
    from planish.measure.rays import Array

_PER_MM = 1000.0


def _always(_params: MeasureParams, _greys: Greys) -> bool:
    """It costs no look at the volume and needs no number from the user."""
    return True


@sheet_property("warp", units="um", long_name="Warp", support_um=400.0, when=_always)
def warp(sheet: Sheet) -> Array:
    """Height of the centre surface above the plane that fits it best, up towards the top."""
    height = sheet.frame.heights["centre"]
    y, x = (np.arange(n) * p for n, p in zip(height.shape, sheet.frame.pitch_um, strict=True))
    yy, xx = np.meshgrid(y - y.mean(), x - x.mean(), indexing="ij")
    known = np.isfinite(height) & sheet.valid
    terms = np.stack([np.ones(int(known.sum())), yy[known], xx[known]], axis=1)
    level, by_y, by_x = np.linalg.lstsq(terms, height[known], rcond=None)[0]
    return height - (level + by_y * yy + by_x * xx)


@sheet_property("tilt", units="deg", long_name="Tilt of the sheet", support_um=400.0, when=_always)
def tilt(sheet: Sheet) -> Array:
    """Angle between the normal and the axis through the sheet."""
    slope = sheet.frame.slopes(slice(0, sheet.frame.status.shape[0]))
    return np.rad2deg(np.arctan(np.hypot(slope[..., 0], slope[..., 1])))


@sheet_property("mean_curvature", units="1/mm", long_name="Mean curvature", support_um=400.0)
def mean_curvature(sheet: Sheet) -> Array:
    """H = ((1 + p^2) t - 2 p q s + (1 + q^2) r) / (2 (1 + p^2 + q^2)^(3/2)); positive where the sheet is a bowl.

    p, q are the slopes, r, s, t the second derivatives of the centre surface's height.
    """
    p, q, r, s, t = _derivatives(sheet)
    above = (1 + p * p) * t - 2 * p * q * s + (1 + q * q) * r
    return _PER_MM * above / (2 * (1 + p * p + q * q) ** 1.5)


@sheet_property("gaussian_curvature", units="1/mm2", long_name="Gaussian curvature", support_um=400.0)
def gaussian_curvature(sheet: Sheet) -> Array:
    """K = (r t - s^2) / (1 + p^2 + q^2)^2; 0 where the sheet can be laid flat without strain."""
    p, q, r, s, t = _derivatives(sheet)
    return _PER_MM**2 * (r * t - s * s) / (1 + p * p + q * q) ** 2


def _derivatives(sheet: Sheet) -> tuple[Array, Array, Array, Array, Array]:
    """Slopes p, q and second derivatives r, s, t along columns, mixed and along rows; NaN on the border."""
    centre = sheet.frame.heights["centre"]
    dy, dx = sheet.frame.pitch_um
    p, q, r, s, t = (np.full(centre.shape, np.nan) for _ in range(5))
    inner = (slice(1, -1), slice(1, -1))
    up, down, left, right = centre[:-2, 1:-1], centre[2:, 1:-1], centre[1:-1, :-2], centre[1:-1, 2:]
    here = centre[inner]
    p[inner], q[inner] = (right - left) / (2 * dx), (down - up) / (2 * dy)
    r[inner], t[inner] = (right - 2 * here + left) / dx**2, (down - 2 * here + up) / dy**2
    s[inner] = (centre[2:, 2:] - centre[2:, :-2] - centre[:-2, 2:] + centre[:-2, :-2]) / (4 * dx * dy)
    return p, q, r, s, t
