"""Uncertainty of a value: the noise of an integral along a ray, and what noise leaves open about a fitted layer.

Errors of neighbouring columns are not independent: the lateral blur and the interpolation between columns share them
out (autocorrelation 0.74, 0.41, 0.19 at one, two, three columns on specimens of several makers). The mean of N columns
has about N / 14 independent values, fewer where the noise is correlated or columns were averaged before the fit. What
pores at the faces, blur and levels leave is common to all.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy import special

from planish.core.robust import mad_sd
from planish.core.typing import Floats, Pair
from planish.measure.rays import RayFrame
from planish.measure.registry import Greys, Side

_LEVELS = (0.05, 0.10)  # spread of the coating's and the base's level from place to place, as a share of their contrast
_NODES = 61
_SHARED = 14.0  # columns of one voxel that an independent value stands for: the sum of the errors' autocorrelation


def ray_noise(volume: xr.DataArray, frame: RayFrame) -> float:
    """Variance of the grey's integral over one um of ray, from the noise alone; grey^2 um.

    White noise of standard deviation sigma in voxels of v um has sigma^2 v. Noise that neighbours share has more: the
    scatter of means over a stretch of air of length L, beside the faces of some rows, is read as well, var(mean) L,
    and the larger of the two is taken.
    """
    white = frame.greys.noise**2 * frame.voxel_um
    rows = np.flatnonzero((frame.status == 0).any(axis=1))
    picked = rows[np.unique(np.linspace(0, rows.size - 1, min(6, rows.size)).astype(int))]
    margin, length = 3 * frame.greys.blur_um + frame.voxel_um, 3.0 * frame.voxel_um
    samples: list[Floats] = []
    for row in picked:
        rays = frame.tile(volume, slice(int(row), int(row) + 1))
        if not (rays.status == 0).any():
            continue
        room = min(float(rays.s_um[-1] - np.nanmax(rays.top)), float(np.nanmin(rays.bottom) - rays.s_um[0]))
        if room - margin < length:
            continue
        for lower in (rays.top + margin, rays.bottom - margin - length):
            means = rays.mean(lower, lower + length)
            samples.append(means[np.isfinite(means)])
    if not samples or sum(f.size for f in samples) < 200:
        return white
    # Each side and row about its own median: shading of the air is no noise.
    steps = np.concatenate([np.abs(f - np.median(f)) for f in samples if f.size])
    return max(white, mad_sd(steps, 0.0) ** 2 * length)


@dataclass(frozen=True, slots=True, kw_only=True)
class Shared:
    """Noise and error that a sheet's columns have in common."""

    noise_um: float  # variance of the grey's integral over one um of a column as the fit saw it; grey^2 um
    common_um: Mapping[str, float]  # error of each thickness and topography that averaging does not lessen
    # The same with what differs from place to place: a column of voxels that are longer across than along it takes in
    # more of the boundary's detail.
    place_um: Mapping[str, float]
    patch_um2: float  # area that one independent value stands for

    @classmethod
    def of(
        cls, greys: Greys, *, voxel_um: float, pitch_um: Pair, wide: float,
        noise_um: float = float("nan"),
    ) -> Shared:  # fmt: skip
        """Work it out.

        ``voxel_um``: of a voxel along the column; ``pitch_um``: of the columns, ``wide`` voxels broad; ``noise_um``: of
        single rays, as from :func:`ray_noise`; NaN for white noise.
        """
        white = (greys.single_noise * wide) ** 2 * voxel_um
        # The integral of the noise's autocorrelation along one axis, in voxels; the same is taken for all axes. Beside
        # noise that moves no face, what scatters in the air says nothing of it.
        least = (0.003 * (greys.base - greys.air)) ** 2 * voxel_um
        length = max(1.0, noise_um / max(white, least)) if np.isfinite(noise_um) else 1.0
        averaged = 4 * np.pi * (greys.averaged * wide) ** 2  # voxels under the Gaussian of the averaging
        patch = _SHARED + length**2 - 1 + averaged
        column = pitch_um[0] * pitch_um[1]
        # Averaging divides the variance of white noise by 1 + averaged, but mixes the sheet's own detail in: some two
        # thirds of the gain, as a power, are left. Noise that neighbours share is averaged farther, and the detail lost
        # costs as much as is gained.
        gain = (1 + averaged) ** 0.7 if length < 1.2 else 1.0
        noise = greys.single_noise**2 * voxel_um * length / gain
        longest, shared = max(voxel_um, max(pitch_um) / wide), float(np.sqrt(length))
        return cls(
            noise_um=float(noise), common_um=common_errors(shared * voxel_um), place_um=common_errors(shared * longest),
            patch_um2=column * max(patch / wide**2, 1.0),
        )  # fmt: skip


def thickness_errors(
    coatings: Mapping[Side, Floats], greys: Greys, shared: Shared, *, cosine: Floats | float = 1.0
) -> dict[str, Floats]:
    """Standard errors of coatings, base, sheet and topography along the normals, um (rows, cols).

    ``coatings``: their thicknesses; those of a side without one are ignored. ``cosine``: of the sheet's tilt against
    the columns; a tilted column holds 1 / cosine times as many voxels of the same blurred edge.
    """
    root = np.sqrt(cosine)
    sides = {k: [root * e for e in layer_errors(t, greys, shared.noise_um, k)] for k, t in coatings.items()}
    top, bottom = sides["top"], sides["bottom"]
    errors = {
        "coating_top": top[1], "coating_bottom": bottom[1], "base_thickness": np.hypot(top[2], bottom[2]),
        "thickness": np.hypot(top[0], bottom[0]),
    }  # fmt: skip
    errors |= {f"topography_{k}": of[0] for k, of in sides.items()}
    return {name: np.hypot(se, shared.place_um[name]) for name, se in errors.items()}


def common_errors(unit_um: float) -> dict[str, float]:
    """Give the error of each thickness and topography that averaging does not lessen, um; ``unit_um``: of a voxel."""
    # What pores at a boundary and the levels leave, besides noise, in voxels.
    face, inner = unit_um * 0.025, unit_um * 0.07
    coating, base, sheet = float(np.hypot(face, inner)), float(np.sqrt(2)) * inner, float(np.sqrt(2)) * face
    return {
        "coating_top": coating, "coating_bottom": coating, "base_thickness": base, "thickness": sheet,
        "topography_top": face, "topography_bottom": face,
    }  # fmt: skip


def layer_errors(thickness: Floats, greys: Greys, noise_um: float, side: Side) -> tuple[Floats, Floats, Floats]:
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
    # Layers thicker than 12 blurs have two edges that know nothing of each other.
    nodes = np.linspace(0.02, 12.0, _NODES) * blur
    table = np.array([_one_layer(t, blur, coat - greys.air, base - greys.air, noise_um) for t in nodes])
    table[:] = table[np.maximum(np.arange(_NODES), int(np.argmax(table[:, 1] <= nodes)))]
    layer = np.clip(thickness, 0.0, nodes[-1])
    face, thickness_se, inner = (np.interp(layer, nodes, table[:, k]) for k in range(3))
    missing = ~np.isfinite(thickness)
    return tuple(np.where(missing, np.nan, v) for v in (face, thickness_se, inner))  # type: ignore[return-value]


def _one_layer(t: float, w: float, c: float, b: float, noise_um: float) -> tuple[float, float, float]:
    step = 0.05 * w
    s: Floats = np.arange(-6 * w, t + 20 * w, step)

    def bell(x: Floats) -> Floats:
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
