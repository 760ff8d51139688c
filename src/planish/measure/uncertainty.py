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
from planish.core.typing import Floats, NamedFields, Pair
from planish.measure.greys import Greys
from planish.measure.rays import RayFrame, Rays

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

    ``volume`` is read in up to six rows of the ``frame``, in which a ray meets both faces. With
    fewer than 200 means of air the noise is taken for white.
    """
    white_noise = frame.greys.noise**2 * frame.voxel_um
    rows = np.flatnonzero((frame.status == 0).any(axis=1))
    row_count = min(6, rows.size)
    spread_indices = np.linspace(0, rows.size - 1, row_count).astype(int)
    # Air begins where the blur of a face has ended.
    margin_um = 3 * frame.greys.blur_um + frame.voxel_um
    length_um = 3.0 * frame.voxel_um
    deviations: list[Floats] = []
    for row in rows[np.unique(spread_indices)].tolist():
        rays = frame.tile(volume, slice(row, row + 1))
        if not (rays.status == 0).any():
            continue
        room_above_um = float(rays.s_um[-1] - np.nanmax(rays.top))
        room_below_um = float(np.nanmin(rays.bottom) - rays.s_um[0])
        if min(room_above_um, room_below_um) - margin_um < length_um:
            continue
        for lower in (rays.top + margin_um, rays.bottom - margin_um - length_um):
            means = rays.mean(lower, lower + length_um)
            means = means[np.isfinite(means)]
            if means.size:
                # Each side and row about its own median: shading of the air is no noise.
                deviations.append(np.abs(means - np.median(means)))
    if sum(part.size for part in deviations) < 200:
        return white_noise
    air_sd = mad_sd(np.concatenate(deviations), 0.0)
    return max(white_noise, air_sd**2 * length_um)


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
        correlation_length = 1.0
        if np.isfinite(noise_um):
            correlation_length = max(1.0, noise_um / max(white_noise, min_noise))
        # Voxels under the Gaussian of the averaging.
        averaged_voxels = 4 * np.pi * (greys.averaged * column_px) ** 2
        columns_per_value = _SHARED + correlation_length**2 - 1 + averaged_voxels
        # Averaging divides the variance of white noise by 1 + averaged, but mixes the sheet's own
        # detail in: some two thirds of the gain, as a power, are left. Noise that neighbours share
        # is averaged farther, and the detail lost costs as much as is gained.
        gain = (1 + averaged_voxels) ** 0.7 if correlation_length < 1.2 else 1.0
        noise = greys.single_noise**2 * voxel_um * correlation_length / gain
        longest_um = max(voxel_um, max(pitch_um) / column_px)
        correlation_factor = float(np.sqrt(correlation_length))
        column_um2 = pitch_um[0] * pitch_um[1]
        columns_per_patch = max(columns_per_value / column_px**2, 1.0)
        return cls(
            noise_um=float(noise),
            common_um=common_errors(correlation_factor * voxel_um),
            local_um=common_errors(correlation_factor * longest_um),
            patch_um2=column_um2 * columns_per_patch,
        )


def thickness_errors(
    coatings: Mapping[Side, Floats],
    greys: Greys,
    shared_noise: SharedNoise,
    *,
    cosine: Floats,
) -> NamedFields:
    """Standard errors of thicknesses and of heights of faces along the normals, um (rows, cols).

    By the names of the maps. ``coatings``: their thicknesses in um (rows, cols); those of a side
    without one are ignored. ``cosine`` (rows, cols): of the sheet's tilt against the columns; a
    tilted column holds 1 / cosine times as many voxels of the same blurred edge.
    """
    errors: NamedFields = {}
    for side, thickness in coatings.items():
        along_column = layer_errors(thickness, greys, shared_noise.noise_um, side)
        face_se, coating_se, interface_se = np.sqrt(cosine) * along_column
        errors[f"coating_{side}"] = coating_se
        errors[f"half_thickness_{side}"] = errors[f"topography_{side}"] = face_se
        errors[f"base_surface_{side}"] = interface_se
    errors["base_thickness"] = np.hypot(errors["base_surface_top"], errors["base_surface_bottom"])
    errors["thickness"] = np.hypot(errors["topography_top"], errors["topography_bottom"])
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
    face_um = unit_um * 0.025
    interface_um = unit_um * 0.07
    root2 = float(np.sqrt(2))
    errors = {"base_thickness": root2 * interface_um, "thickness": root2 * face_um}
    for side in SIDES:
        errors[f"coating_{side}"] = float(np.hypot(face_um, interface_um))
        errors[f"half_thickness_{side}"] = errors[f"topography_{side}"] = face_um
        errors[f"base_surface_{side}"] = interface_um
    return errors


def face_errors(rays: Rays, thickness: Floats, side: Side) -> Floats:
    """Standard error along the ray of the face of a coating of so many um of ray (rows, cols)."""
    errors = layer_errors(thickness / rays.oblique, rays.greys, rays.noise_um, side)
    return rays.oblique * errors[0]


def layer_errors(thickness: Floats, greys: Greys, noise_um: float, side: Side) -> Floats:
    """Standard errors in um of a fitted staircase air-coating-base, (3, rows, cols).

    Those of its face, its thickness and its interface.

    The least variance that an unbiased fit can have, the inverse of the Fisher matrix of the
    blurred staircase

        g(s) = a + (c - a) P((s - h) / w) + (b - c) P((s - h - t) / w)

    for the four unknowns h, t, c, b: F_ij = integral of (dg/dp_i)(dg/dp_j) ds / noise_um, plus 1 /
    spread^2 for the levels, which vary by 5 % (coating) and 10 % (base) of their contrast from
    place to place: s is the depth, h the face, t the thickness and w the blur in um; a, c and b are
    the greys of air, coating and base. ``thickness``: of the layer in um (rows, cols); NaN gives
    NaN. Where a side has no coating there are h and b only: ``thickness`` is ignored, and its
    errors are NaN. ``noise_um`` is as from :func:`ray_noise`. As t goes to 0, h and t cannot be
    told apart and the matrix becomes singular; below the thickness that equals its own standard
    error, that error is given. It says nothing about a wrong model: fringes, burnt rims, fillers at
    the interface. Walls and pores of the base are no part of the staircase either: what they
    scatter beyond the noise below an interface is added as it acts on the fit, F^-1 (F + G) F^-1
    with G the same integral of their surplus.
    """
    blur_um = max(greys.blur_um, 1e-3)
    base_contrast = greys.base - greys.air
    # Without any noise the matrix has no inverse; a hundred-thousandth of the contrast is nothing.
    noise_um = max(noise_um, 1e-10 * base_contrast**2 * blur_um)
    if not greys.coated(side):
        # A face has air on one side, walls and pores on the other.
        noise_um = 0.5 * (noise_um + max(noise_um, greys.texture_um))
        crossing_noise = float(np.sqrt(noise_um * 2 * np.sqrt(np.pi) * blur_um))
        face_se = np.full(thickness.shape, crossing_noise / abs(base_contrast))
        return np.stack([face_se, np.full_like(face_se, np.nan), face_se])
    if side in greys.fit_errors:  # a trial on this sheet, which knows more than the formula
        nodes_um, *errors_um = greys.fit_errors[side]
    else:
        # Layers thicker than 12 blurs have two edges that know nothing of each other.
        nodes_um = np.linspace(0.02, 12.0, _NODES) * blur_um
        levels = greys.coating(side) - greys.air, base_contrast
        noises_um = noise_um, greys.texture_um
        se_rows = [_layer_errors_at(t, blur_um, *levels, *noises_um) for t in nodes_um]
        se_table = np.array(se_rows)
        # Thinner layers have the error of the first whose thickness is no less than its own.
        first_node = int(np.argmax(se_table[:, 1] <= nodes_um))
        errors_um = se_table[np.maximum(np.arange(_NODES), first_node)].T
    interpolated = [np.interp(thickness, nodes_um, node_errors) for node_errors in errors_um]
    errors = np.stack(interpolated)
    return np.where(np.isfinite(thickness), errors, np.nan)


def _layer_errors_at(
    t: float, w: float, c: float, b: float, noise_um: float, texture_um: float
) -> list[float]:
    """Standard errors of face, thickness and interface, um, of a layer of ``t`` um.

    ``w`` is the blur in um, ``c`` and ``b`` are the levels of coating and base above the air, as in
    :func:`layer_errors`, which explains the matrix. ``noise_um`` and ``texture_um``: variances of
    the grey's integral over one um, from noise and from walls and pores of the base; grey^2 um.
    """
    step_um = 0.05 * w
    # From six blurs outside the face to so deep in the base that its level is well known.
    s: Floats = np.arange(-6 * w, t + 20 * w, step_um)
    height = w * np.sqrt(2 * np.pi)

    def bell(x: Floats) -> Floats:
        return np.exp(-0.5 * (x / w) ** 2) / height

    outer = special.ndtr(s / w)
    inner = special.ndtr((s - t) / w)
    by_t = -(b - c) * bell(s - t)
    by_h = -c * bell(s) + by_t
    gradient = np.stack([by_h, by_t, outer - inner, inner])
    fisher = gradient @ gradient.T * step_um / noise_um
    fisher[2, 2] += 1 / (_LEVELS[0] * c) ** 2
    fisher[3, 3] += 1 / (_LEVELS[1] * b) ** 2
    # The fit weighs all samples alike, but below the interface walls and pores scatter more than
    # the noise.
    texture_sd = np.sqrt(max(texture_um - noise_um, 0.0))
    surplus = gradient * np.where(s > t, texture_sd, 0.0) / noise_um
    inverse = np.linalg.inv(fisher)
    covariance = inverse @ (fisher + surplus @ surplus.T * step_um) @ inverse
    # The interface is h + t.
    interface_variance = covariance[:2, :2].sum()
    variances = covariance[0, 0], covariance[1, 1], interface_variance
    return [float(np.sqrt(max(variance, 0.0))) for variance in variances]
