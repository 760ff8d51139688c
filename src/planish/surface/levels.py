"""The grey levels of air, base and coating, the noise and the blur: read from the volume, never assumed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import VolumeError

Array = NDArray[np.float64]

_SIGMAS = 6.0  # a block is material when it differs from the air by so many standard deviations
_COATING_RATIO = 1.25  # a layer is a coating when it stands out from the base by more than a quarter


@dataclass(frozen=True, slots=True, kw_only=True)
class GreyLevels:
    """What the voxels mean.

    Attributes
    ----------
    air, base : float
        Grey levels.
    coating_top, coating_bottom : float
        NaN where that side has no coating.
    noise : float
        Standard deviation of one voxel.
    polarity : float
        +1 where the sheet is brighter than the air, -1 where it is darker.
    blur_um : float
        Standard deviation of the blur, across the faces of the sheet.
    """

    air: float
    base: float
    coating_top: float
    coating_bottom: float
    noise: float
    polarity: float
    blur_um: float


def mode(values: Array) -> float:
    """Half-sample mode: the value around which the data crowd, whatever lies beside."""
    data = np.sort(values[np.isfinite(values)].ravel())
    if data.size == 0:
        raise VolumeError("The volume holds no finite value at the ends of the axis through the sheet.")
    while data.size > 3:
        half = (data.size + 1) // 2
        width = data[half - 1 :] - data[: data.size - half + 1]
        narrowest = np.flatnonzero(width == width.min())
        # Integers tie: take the middle one of the ties.
        start = int(narrowest[narrowest.size // 2])
        data = data[start : start + half]
        if data[0] == data[-1]:
            break
    return float(np.mean(data))


def spread(values: Array) -> float:
    """Return the standard deviation estimated from the median absolute deviation."""
    data = values[np.isfinite(values)]
    if data.size == 0:
        return float("nan")
    return float(1.4826 * np.median(np.abs(data - np.median(data))))


def air_level(ends: Array) -> tuple[float, float]:
    """Return level and noise of the air, from samples (n, k) of k neighbouring voxels at both ends of the columns."""
    air = mode(ends)
    steps = np.diff(ends, axis=1).ravel()
    near = np.abs(ends[:, :-1].ravel() - air) <= max(np.nanpercentile(np.abs(ends - air), 60), 1e-12)
    noise = float(np.sqrt(np.mean(steps[near] ** 2) / 2)) if near.any() else 0.0
    robust = spread(steps[near]) / np.sqrt(2.0) if near.any() else 0.0
    return air, (robust if robust > 0 else noise)


def material(blocks: NDArray[np.float32], air: float) -> tuple[float, float]:
    """Return polarity and the threshold of a first, coarse search; both relative to the air.

    ``blocks`` are block means; a sheet is what stands out from the air's own scatter.
    """
    deviation = blocks[np.isfinite(blocks)].astype(np.float64) - air
    scatter = spread(deviation[np.abs(deviation) <= np.percentile(np.abs(deviation), 50)])
    scatter = max(scatter, 1e-3 * float(np.ptp(deviation)), 1e-9)
    bright = deviation > _SIGMAS * scatter
    dark = deviation < -_SIGMAS * scatter
    if max(np.count_nonzero(bright), np.count_nonzero(dark)) < 1e-4 * deviation.size:
        raise VolumeError(
            f"There is no sheet in the volume: all of it lies within {_SIGMAS:g} standard deviations of the air's grey "
            f"({air:.4g}). Check that this is the reconstructed volume, and --through."
        )
    polarity = 1.0 if np.abs(deviation[bright]).sum() >= np.abs(deviation[dark]).sum() else -1.0
    typical = float(np.median(np.abs(deviation[bright if polarity > 0 else dark])))
    return polarity, max(_SIGMAS * scatter, 0.35 * typical)


def is_coating(level: float, air: float, solid_base: float) -> bool:
    """Whether a layer of grey ``level`` is a coating on a base whose solid parts have grey ``solid_base``."""
    return level - air > _COATING_RATIO * (solid_base - air)
