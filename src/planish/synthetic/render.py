"""Instruments that look at the specimen: a scanner with blur and noise, and a camera with its own pose."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.transform import Similarity
from planish.synthetic import _kernels
from planish.synthetic.sheet import Sheet
from planish.synthetic.warp import Warp

_SLAB = 32  # rows rendered together; fixed, so that the noise does not depend on the number of threads
# Kubelka-Munk without absorption, W in kg/m2: R = (Rg + (1 - Rg) s W) / (1 + (1 - Rg) s W)
_SCATTER_M2_PER_KG = 150.0
_COATING_G_PER_CM3 = 1.6
_BASE_REFLECTANCE = 0.70
_HOLE_REFLECTANCE = 0.04
_CHAR_REFLECTANCE = 0.6


def scan(
    sheet: Sheet,
    warp: Warp,
    *,
    shape: tuple[int, int, int],
    voxel_um: float,
    blur_um: float,
    noise: float,
    grey: tuple[float, float, float],
    dtype: type,
    seed: np.random.SeedSequence,
    threads: int = 2,
) -> NDArray[np.generic]:
    """Render the volume (z, y, x).

    ``noise`` is the standard deviation as a share of the coating-air contrast; ``grey`` the levels of air,
    base and coating; integers are rounded and clipped to the type's range.
    """
    volume = np.empty(shape, dtype=dtype)
    w, curve = warp.packed()
    zs, _xs = (np.arange(n) * voxel_um for n in (shape[0], shape[2]))
    half = float(np.abs(sheet.faces).max()) + 2 * voxel_um
    half = half * float(np.hypot(1.0, warp.slope)) * 1.2
    halo = int(np.ceil(4 * blur_um / voxel_um)) if blur_um > 0 else 0
    starts = range(0, shape[1], _SLAB)
    seeds = dict(zip(starts, seed.spawn(len(starts)), strict=True))

    def render(start: int) -> None:
        rows = np.arange(start - halo, min(start + _SLAB, shape[1]) + halo) * voxel_um
        # The slab reaches a halo beyond the volume on all lateral sides, as the sheet does.
        wide = (np.arange(-halo, shape[2] + halo)) * voxel_um
        under = _kernels.columns(w, curve, rows, wide)
        slab = np.full((rows.size, wide.size, shape[0]), grey[0], dtype=np.float32)
        _kernels.paint(
            slab, w, curve, rows, wide, zs, under, half, sheet.faces, sheet.texture, sheet.rim_um,
            sheet.taper_per_um, sheet.char, np.array(sheet.origin), 3.0, np.array(grey, float), voxel_um,
        )  # fmt: skip
        if halo:
            slab = ndimage.gaussian_filter(slab, blur_um / voxel_um, mode="nearest", truncate=4.0)
            slab = slab[halo:-halo, halo:-halo]
        if noise > 0:
            rng = np.random.Generator(np.random.PCG64(seeds[start]))
            slab = slab + noise * abs(grey[2] - grey[0]) * rng.standard_normal(slab.shape, dtype=np.float32)
        if np.issubdtype(dtype, np.integer):
            limits = np.iinfo(dtype)
            slab = np.clip(np.rint(slab), limits.min, limits.max)
        volume[:, start : start + _SLAB, :] = slab.astype(dtype).transpose(2, 0, 1)

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(render, starts))
    return volume


def photograph(
    sheet: Sheet,
    pose: Similarity,
    *,
    shape: tuple[int, int],
    pixel_um: float,
    nuisance_sd: float,
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    """Reflectance (y, x) of the sheet's top side as a camera sees it; ``pose`` carries (u, v) to the image in um.

    Brightness follows the coating by Kubelka and Munk over a base of varying reflectance; then a lens blur of 3 um,
    vignetting of 2 % and 0.5 % noise.
    """
    u, v = image_material(pose, shape, pixel_um)
    weight = _COATING_G_PER_CM3 * 1e-3 * np.maximum(sheet.at(sheet.faces[0] - sheet.faces[1], u, v), 0)
    grain = ndimage.gaussian_filter(rng.standard_normal(shape), 20.0 / pixel_um)
    backing = _BASE_REFLECTANCE + nuisance_sd * grain / grain.std()
    lift = (1 - backing) * _SCATTER_M2_PER_KG * weight
    reflectance = (backing + lift) / (1 + lift)
    rim = sheet.at(sheet.rim_um, u, v)
    burn = 1 - (1 - _CHAR_REFLECTANCE) * np.clip(1 - rim / sheet.params.char_um, 0, 1)
    solid = np.clip(rim / pixel_um + 0.5, 0, 1)
    reflectance = _HOLE_REFLECTANCE * (1 - solid) + reflectance * burn * solid
    reflectance = ndimage.gaussian_filter(reflectance, 3.0 / pixel_um)
    y, x = np.ogrid[-1 : 1 : shape[0] * 1j, -1 : 1 : shape[1] * 1j]
    reflectance = reflectance * (1 - 0.01 * (x * x + y * y)) + 0.005 * rng.standard_normal(shape)
    return reflectance.astype(np.float32)


def image_material(
    pose: Similarity, shape: tuple[int, int], pixel_um: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Material coordinates (u, v) in um seen by each pixel of an image."""
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]] * pixel_um
    points = pose.inverse(np.stack([x, y], axis=-1))
    return points[..., 0], points[..., 1]
