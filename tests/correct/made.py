"""Sheets with rings and cupping that are formulas."""

import numpy as np
from scipy import special

from planish.correct import CorrectParams, correct_volume
from surface import sheets

VOXEL = 3.0
AIR, BASE, COATING = 400.0, 900.0, 2000.0
CONTRAST = COATING - AIR


def radius_um(shape, axis="y", centre_um=None):
    """Distance of each voxel (z, y, x) from the axis of rotation."""
    parts = []
    plane = [a for a in "zyx" if a != axis]
    for k, name in enumerate(plane):
        n = shape["zyx".index(name)]
        at = 0.5 * (n - 1) * VOXEL if centre_um is None else centre_um[k]
        form = [1, 1, 1]
        form["zyx".index(name)] = n
        parts.append((np.arange(n) * VOXEL - at).reshape(form))
    return np.hypot(*parts)


def ring(shape, at_um, share, *, width_um=3.0, **where):
    """A ring of Gaussian section, its height a share of the contrast."""
    return CONTRAST * share * np.exp(-0.5 * ((radius_um(shape, **where) - at_um) / width_um) ** 2)


def sheet(shape=(60, 100, 200), *, tilt_deg=0.0, base_um=60.0, coat_um=24.0, coating=COATING):
    """Grey (z, y, x) above air of a sheet across z; lengths may vary over (y, x), ``coating`` over
    the volume."""
    z, y, x = np.meshgrid(*(np.arange(n) * VOXEL for n in shape), indexing="ij", sparse=True)
    slope = np.tan(np.deg2rad(tilt_deg))
    s = (z - z.mean() - slope * (x - x.mean()) + 0 * y) * np.cos(np.deg2rad(tilt_deg))

    def between(low, high):
        return special.ndtr((s - low) / 2.5) - special.ndtr((s - high) / 2.5)

    half, coat = 0.5 * np.asarray(base_um), np.asarray(coat_um)
    grey = (BASE - AIR) * between(-half, half)
    return grey + (coating - AIR) * (between(half, half + coat) + between(-half - coat, -half))


def volume(above_air, *, noise=0.08, seed=0, dtype=np.uint16, rings=0.0):
    grey = AIR + above_air + rings
    grey = grey + np.random.default_rng(seed).normal(0.0, noise * CONTRAST, grey.shape)
    if np.dtype(dtype).kind == "u":
        limits = np.iinfo(dtype)
        grey = np.clip(np.rint(grey), limits.min, limits.max)
    return as_volume(grey.astype(dtype))


def as_volume(values):
    return sheets.volume(values, VOXEL).assign_attrs(
        voxel_um=[VOXEL] * 3, file_name="made", file_bytes=values.nbytes
    )


def correct(given, *, rings=True, cupping=True, axis="y", centre_um=None, **more):
    params = CorrectParams(rings=rings, cupping=cupping, axis=axis, centre_um=centre_um)
    return correct_volume(given, params=params, **more)
