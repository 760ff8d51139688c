"""Uncertainty of a value.

The noise of an integral along a ray, and what noise leaves open about a fitted layer.

Errors of neighbouring columns are not independent: the lateral blur and the interpolation between
columns share them out (autocorrelation 0.74, 0.41, 0.19 at one, two, three columns on specimens of
several makers). The mean of N columns has about N / 14 independent values, fewer where the noise is
correlated or columns were averaged before the fit. What pores at the faces, blur and levels leave
is common to all.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy import special

from planish.core.facts import SIDES, Side
from planish.core.robust import mad_sd
from planish.core.typing import Floats, Pair
from planish.measure.greys import Greys
from planish.measure.rays import RayFrame

# Spread of the coating's and the base's level from place to place, as a share of their contrast.
_LEVELS = (0.05, 0.10)
_NODES = 61
# Columns of one voxel that an independent value stands for: the sum of the errors' autocorrelation.
_SHARED = 14.0


def ray_noise(volume: xr.DataArray, frame: RayFrame) -> float:
    """Variance of the grey's integral over one um of ray, from the noise alone; grey^2 um.

    White noise of standard deviation sigma in voxels of v um has sigma^2 v. Noise that neighbours
    share has more: the scatter of means over L um of air, beside the faces of some rows, is read as
    well, var(mean) L; the larger is taken.
    """
    white_noise = frame.greys.noise**2 * frame.voxel_um
    rows = np.flatnonzero((frame.status == 0).any(axis=1))
    sampled_rows = rows[np.unique(np.linspace(0, rows.size - 1, min(6, rows.size)).astype(int))]
    margin_um, length_um = 3 * frame.greys.blur_um + frame.voxel_um, 3.0 * frame.voxel_um
    air_means: list[Floats] = []
    for row in sampled_rows:
        rays = frame.tile(volume, slice(int(row), int(row) + 1))
        if not (rays.status == 0).any():
            continue
        room_um = min(
            float(rays.s_um[-1] - np.nanmax(rays.top)), float(np.nanmin(rays.bottom) - rays.s_um[0])
        )
        if room_um - margin_um < length_um:
            continue
        for lower in (rays.top + margin_um, rays.bottom - margin_um - length_um):
            means = rays.mean(lower, lower + length_um)
            air_means.append(means[np.isfinite(means)])
    if not air_means or sum(means.size for means in air_means) < 200:
        return white_noise
    # Each side and row about its own median: shading of the air is no noise.
    deviations = np.concatenate(
        [np.abs(means - np.median(means)) for means in air_means if means.size]
    )
    return max(white_noise, mad_sd(deviations, 0.0) ** 2 * length_um)


@dataclass(frozen=True, slots=True, kw_only=True)
class SharedNoise:
    """Noise and error that a sheet's columns have in common."""

    # Variance of the grey's integral over one um of a column as the fit saw it; grey^2 um.
    noise_um: float
    # Error of each thickness and height that averaging does not lessen.
    common_um: Mapping[str, float]
    # The same with what differs from place to place: a column of voxels that are longer across than
    # along it takes in more of the boundary's detail.
    local_um: Mapping[str, float]
    patch_um2: float  # area that one independent value stands for

    @classmethod
    def of(
        cls,
        greys: Greys,
        *,
        voxel_um: float,
        pitch_um: Pair,
        column_px: float,
        noise_um: float = float("nan"),
    ) -> SharedNoise:
        """Work it out.

        ``voxel_um``: of a voxel along the column; ``pitch_um``: of the columns, ``column_px``
        voxels broad; ``noise_um``: of single rays, as from :func:`ray_noise`; NaN for white noise.
        """
        white_noise = (greys.single_noise * column_px) ** 2 * voxel_um
        # The integral of the noise's autocorrelation along one axis, in voxels; the same is taken
        # for all axes. Beside noise that moves no face, what scatters in the air says nothing of
        # it.
        min_noise = (0.003 * (greys.base - greys.air)) ** 2 * voxel_um
        correlation_length = (
            max(1.0, noise_um / max(white_noise, min_noise)) if np.isfinite(noise_um) else 1.0
        )
        # Voxels under the Gaussian of the averaging.
        averaged_voxels = 4 * np.pi * (greys.averaged * column_px) ** 2
        columns_per_value = _SHARED + correlation_length**2 - 1 + averaged_voxels
        column_um2 = pitch_um[0] * pitch_um[1]
        # Averaging divides the variance of white noise by 1 + averaged, but mixes the sheet's own
        # detail in: some two thirds of the gain, as a power, are left. Noise that neighbours share
        # is averaged farther, and the detail lost costs as much as is gained.
        gain = (1 + averaged_voxels) ** 0.7 if correlation_length < 1.2 else 1.0
        noise = greys.single_noise**2 * voxel_um * correlation_length / gain
        longest_um, correlation_factor = (
            max(voxel_um, max(pitch_um) / column_px),
            float(np.sqrt(correlation_length)),
        )
        return cls(
            noise_um=float(noise),
            common_um=common_errors(correlation_factor * voxel_um),
            local_um=common_errors(correlation_factor * longest_um),
            patch_um2=column_um2 * max(columns_per_value / column_px**2, 1.0),
        )


def thickness_errors(
    coatings: Mapping[Side, Floats],
    greys: Greys,
    shared_noise: SharedNoise,
    *,
    cosine: Floats,
) -> dict[str, Floats]:
    """Standard errors of thicknesses and of heights of faces along the normals, um (rows, cols).

    ``coatings``: their thicknesses; those of a side without one are ignored. ``cosine``: of the
    sheet's tilt against the columns; a tilted column holds 1 / cosine times as many voxels of the
    same blurred edge.
    """
    root, noise_um = np.sqrt(cosine), shared_noise.noise_um
    sides = {
        k: [root * e for e in layer_errors(t, greys, noise_um, k)] for k, t in coatings.items()
    }
    top, bottom = sides["top"], sides["bottom"]
    errors = {
        "coating_top": top[1],
        "coating_bottom": bottom[1],
        "base_thickness": np.hypot(top[2], bottom[2]),
        "thickness": np.hypot(top[0], bottom[0]),
    }
    for side, (face_se, _, interface_se) in sides.items():
        errors[f"half_thickness_{side}"] = errors[f"topography_{side}"] = face_se
        errors[f"base_surface_{side}"] = interface_se
    # A trial on the sheet itself has met the pores at its boundaries, but no error of the levels.
    untried = [side for side in SIDES if side not in greys.fit_errors]
    for name, se in errors.items():
        side = name.rpartition("_")[2]
        is_tried = side not in untried if side in SIDES else not untried
        combined = np.maximum if is_tried else np.hypot
        errors[name] = combined(se, shared_noise.local_um[name])
    return errors


def common_errors(unit_um: float) -> dict[str, float]:
    """Give the error of each thickness and height that averaging does not lessen, um.

    ``unit_um``: of a voxel.
    """
    # What pores at a boundary and the levels leave, besides noise, in voxels.
    face_um, interface_um = unit_um * 0.025, unit_um * 0.07
    coating_um, root2 = float(np.hypot(face_um, interface_um)), float(np.sqrt(2))
    return {
        "coating_top": coating_um,
        "coating_bottom": coating_um,
        "base_thickness": root2 * interface_um,
        "thickness": root2 * face_um,
    } | {
        f"{name}_{side}": error_um
        for name, error_um in (
            ("half_thickness", face_um),
            ("topography", face_um),
            ("base_surface", interface_um),
        )
        for side in SIDES
    }


def layer_errors(
    thickness: Floats, greys: Greys, noise_um: float, side: Side
) -> tuple[Floats, Floats, Floats]:
    """Standard errors in um of a fitted staircase air-coating-base.

    Those of its face, its thickness and its interface.

    The least variance that an unbiased fit can have, the inverse of the Fisher matrix of the
    blurred staircase

        g(s) = a + (c - a) P((s - h) / w) + (b - c) P((s - h - t) / w)

    for the four unknowns h, t, c, b: F_ij = integral of (dg/dp_i)(dg/dp_j) ds / noise_um, plus 1 /
    spread^2 for the levels, which vary by 5 % (coating) and 10 % (base) of their contrast from
    place to place. Where a side has no coating there are h and b only, and ``thickness``, (rows,
    cols) of the layer in um, is ignored. ``noise_um`` is as from :func:`ray_noise`. As t goes to 0,
    h and t cannot be told apart and the matrix becomes singular; below the thickness that equals
    its own standard error, that error is given. It says nothing about a wrong model: fringes, burnt
    rims, fillers at the interface. Walls and pores of the base are no part of the staircase either:
    what they scatter beyond the noise below an interface is added as it acts on the fit, F^-1 (F +
    G) F^-1 with G the same integral of their surplus.
    """
    blur_um = max(greys.blur_um, 1e-3)
    coating_level, base_level = greys.coating(side), greys.base
    # Without any noise the matrix has no inverse; a hundred-thousandth of the contrast is nothing.
    noise_um = max(noise_um, 1e-10 * (base_level - greys.air) ** 2 * blur_um)
    if not np.isfinite(coating_level):
        # A face has air on one side, walls and pores on the other.
        noise_um = 0.5 * (noise_um + max(noise_um, greys.texture_um))
        face_se = float(np.sqrt(noise_um * 2 * np.sqrt(np.pi) * blur_um)) / abs(
            base_level - greys.air
        )
        face_map = np.full(thickness.shape, face_se)
        return face_map, np.full(thickness.shape, np.nan), face_map
    is_missing = ~np.isfinite(thickness)
    if side in greys.fit_errors:  # a trial on this sheet, which knows more than the formula
        classes_um, *class_errors = greys.fit_errors[side]
        errors_um = (np.interp(thickness, classes_um, se_um) for se_um in class_errors)
        return tuple(np.where(is_missing, np.nan, v) for v in errors_um)  # type: ignore[return-value]
    # Layers thicker than 12 blurs have two edges that know nothing of each other.
    nodes_um = np.linspace(0.02, 12.0, _NODES) * blur_um
    levels = coating_level - greys.air, base_level - greys.air
    se_table = np.array(
        [_layer_errors_at(t, blur_um, *levels, noise_um, greys.texture_um) for t in nodes_um]
    )
    se_table[:] = se_table[
        np.maximum(np.arange(_NODES), int(np.argmax(se_table[:, 1] <= nodes_um)))
    ]
    layer_um = np.clip(thickness, 0.0, nodes_um[-1])
    face_se, thickness_se, interface_se = (
        np.interp(layer_um, nodes_um, se_table[:, k]) for k in range(3)
    )
    return tuple(np.where(is_missing, np.nan, v) for v in (face_se, thickness_se, interface_se))  # type: ignore[return-value]


def _layer_errors_at(
    t: float, w: float, c: float, b: float, noise_um: float, texture_um: float
) -> tuple[float, float, float]:
    step_um = 0.05 * w
    s: Floats = np.arange(-6 * w, t + 20 * w, step_um)

    def bell(x: Floats) -> Floats:
        return np.exp(-0.5 * (x / w) ** 2) / (w * np.sqrt(2 * np.pi))

    outer, inner = special.ndtr(s / w), special.ndtr((s - t) / w)
    by_h = -c * bell(s) - (b - c) * bell(s - t)
    by_t = -(b - c) * bell(s - t)
    gradient = np.stack([by_h, by_t, outer - inner, inner])
    fisher = gradient @ gradient.T * step_um / noise_um
    fisher[2, 2] += 1 / (_LEVELS[0] * c) ** 2
    fisher[3, 3] += 1 / (_LEVELS[1] * b) ** 2
    # The fit weighs all samples alike, but below the interface walls and pores scatter more than
    # the noise.
    surplus = gradient * np.where(s > t, np.sqrt(max(texture_um - noise_um, 0.0)), 0.0) / noise_um
    inverse = np.linalg.inv(fisher)
    covariance = inverse @ (fisher + surplus @ surplus.T * step_um) @ inverse
    interface_variance = covariance[0, 0] + covariance[1, 1] + 2 * covariance[0, 1]
    return tuple(
        float(np.sqrt(max(v, 0.0)))
        for v in (covariance[0, 0], covariance[1, 1], interface_variance)
    )  # type: ignore[return-value]
