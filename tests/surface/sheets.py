"""Sheets whose surfaces are formulas."""

import numpy as np
import xarray as xr
from scipy import special

VOXEL = 3.0


def volume(array, voxel=VOXEL):
    return xr.DataArray(
        array, dims=("z", "y", "x"), coords={k: np.arange(n) * voxel for k, n in zip("zyx", array.shape, strict=True)}
    )


def slab(shape=(70, 80, 90), *, height=105.0, base=55.0, coat=17.0, slope=0.0, wave=0.0, greys=(40.0, 90.0,
200.0), blur=2.6, noise=4.0, seed=0):  # fmt: skip
    """A sheet of constant normal layers along a smooth mid-surface, blurred exactly along its normal."""
    z, y, x = np.meshgrid(*(np.arange(n) * VOXEL for n in shape), indexing="ij")
    middle = height + slope * (x - x.mean()) + wave * np.sin(2 * np.pi * y / 400.0)
    steep = np.hypot(slope, wave * 2 * np.pi / 400.0 * np.cos(2 * np.pi * y / 400.0))
    s = (z - middle) / np.hypot(1, steep)
    half = base / 2 + coat

    def step(d):
        return special.ndtr(d / blur)

    inner = step(base / 2 - s) * step(s + base / 2)
    outer = step(half - s) * step(s + half)
    air, paper, coating = greys
    grey = air + (coating - air) * outer + (paper - coating) * inner
    return grey + np.random.default_rng(seed).normal(0, noise, shape), middle, half
