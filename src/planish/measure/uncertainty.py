"""How sure a value is: the noise of an integral along a ray, and what noise leaves open about a fitted layer."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import special

from planish.measure.greys import Greys
from planish.measure.ray_frame import RayFrame
from planish.measure.rays import Array

_ROWS = 6  # of the sheet, from which the noise is read
_LEVELS = (0.05, 0.10)  # spread of the coating's and the base's level from place to place, as a share of their contrast
_NODES = 61
_LARGEST = 12.0  # layers thicker than so many blurs have two edges that know nothing of each other


def ray_noise(volume: xr.DataArray, frame: RayFrame) -> float:
    """Variance of the grey's integral over one um of ray, from the noise alone; grey^2 um.

    White noise of standard deviation sigma in voxels of v um has sigma^2 v. Noise that neighbours share has more: the
    scatter of means over a stretch of air of length L, beside the faces of some rows, is read as well, var(mean) L,
    and the larger of the two is taken.
    """
    white = frame.greys.noise**2 * frame.voxel_um
    rows = np.flatnonzero((frame.status == 0).any(axis=1))
    picked = rows[np.unique(np.linspace(0, rows.size - 1, min(_ROWS, rows.size)).astype(int))]
    beside = 3 * frame.greys.blur_um
    found: list[Array] = []
    length = 0.0
    for row in picked:
        rays = frame.tile(volume, slice(int(row), int(row) + 1))
        room = min(float(rays.s_um[-1] - np.nanmax(rays.top)), float(np.nanmin(rays.bottom) - rays.s_um[0])) \
            if (rays.status == 0).any() else 0.0  # fmt: skip
        if room - beside < 3 * frame.voxel_um:
            continue
        length = 3.0 * frame.voxel_um
        for lower in (rays.top + beside, rays.bottom - beside - length):
            means = rays.mean(lower, lower + length)
            found.append(means[np.isfinite(means)])
    if not found or sum(f.size for f in found) < 200:
        return white
    # Each side and row about its own median: shading of the air is no noise.
    steps = np.concatenate([np.abs(f - np.median(f)) for f in found if f.size])
    return max(white, float((1.4826 * np.median(steps)) ** 2) * length)


def layer_errors(thickness: Array, greys: Greys, noise_um: float, side: str) -> tuple[Array, Array, Array]:
    """Standard errors of a fitted staircase air-coating-base: of its face, its thickness and its interface, um.

    The least variance that an unbiased fit can have, the inverse of the Fisher matrix of the blurred staircase

        g(s) = a + (c - a) P((s - h) / w) + (b - c) P((s - h - t) / w)

    for the four unknowns h, t, c, b: F_ij = integral of (dg/dp_i)(dg/dp_j) ds / noise_um, plus 1 / spread^2 for the
    levels, which vary by 5 % (coating) and 10 % (base) of their contrast from place to place. Where a side has no
    coating there are h and b only. As t goes to 0, h and t cannot be told apart and the matrix becomes singular; below
    the thickness that equals its own standard error, that error is given. It says nothing about a wrong model: fringes,
    burnt rims, fillers at the interface.

    Parameters
    ----------
    thickness : (rows, cols)
        Of the layer, um; ignored without a coating.
    noise_um : float
        As from :func:`ray_noise`.
    side : {"top", "bottom"}
    """
    blur = max(greys.blur_um, 1e-3)
    coat, base = greys.coating(side), greys.base
    # Without any noise the matrix has no inverse; a hundred-thousandth of the contrast is nothing.
    noise_um = max(noise_um, 1e-10 * (base - greys.air) ** 2 * blur)
    if not np.isfinite(coat):
        face = float(np.sqrt(noise_um * 2 * np.sqrt(np.pi) * blur)) / abs(base - greys.air)
        flat = np.full(thickness.shape, face)
        return flat, np.full(thickness.shape, np.nan), flat
    nodes = np.linspace(0.02, _LARGEST, _NODES) * blur
    table = np.array([_one_layer(t, blur, coat - greys.air, base - greys.air, noise_um) for t in nodes])
    table[:] = table[np.maximum(np.arange(_NODES), int(np.argmax(table[:, 1] <= nodes)))]
    at = np.clip(thickness, 0.0, nodes[-1])
    face, own, inner = (np.interp(at, nodes, table[:, k]) for k in range(3))
    missing = ~np.isfinite(thickness)
    return tuple(np.where(missing, np.nan, v) for v in (face, own, inner))  # type: ignore[return-value]


def _one_layer(t: float, w: float, c: float, b: float, noise_um: float) -> tuple[float, float, float]:
    step = 0.05 * w
    s: NDArray[np.float64] = np.arange(-6 * w, t + 20 * w, step)

    def bell(x: Array) -> Array:
        return np.exp(-0.5 * (x / w) ** 2) / (w * np.sqrt(2 * np.pi))

    outer, inner = special.ndtr(s / w), special.ndtr((s - t) / w)
    by_h = -c * bell(s) - (b - c) * bell(s - t)
    by_t = -(b - c) * bell(s - t)
    gradient = np.stack([by_h, by_t, outer - inner, inner])
    fisher = gradient @ gradient.T * step / noise_um
    fisher[2, 2] += 1 / (_LEVELS[0] * c) ** 2
    fisher[3, 3] += 1 / (_LEVELS[1] * b) ** 2
    covariance = np.linalg.inv(fisher)
    of_inner = covariance[0, 0] + covariance[1, 1] + 2 * covariance[0, 1]
    return tuple(float(np.sqrt(max(v, 0.0))) for v in (covariance[0, 0], covariance[1, 1], of_inner))  # type: ignore[return-value]
