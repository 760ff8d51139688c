"""The grey levels of air, base and coating, the noise and the blur: read from the volume, never assumed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import VolumeError
from planish.core.typing import Floats

_ENOUGH = 2**21  # block means from which levels are told; of more, every so many
_SIGMAS = 6.0  # a block is material when it differs from the air by so many standard deviations
_FEWER_SIGMAS = 4.5  # where that is not enough to see the base of a sheet


def mode(values: Floats) -> float:
    """Half-sample mode: the value around which the data crowd, whatever lies beside."""
    crowd = np.sort(values[np.isfinite(values)].ravel())
    if crowd.size == 0:
        raise VolumeError("The volume holds no finite value at the ends of the axis through the sheet.")
    while crowd.size > 3:
        half = (crowd.size + 1) // 2
        width = crowd[half - 1 :] - crowd[: crowd.size - half + 1]
        narrowest = np.flatnonzero(width == width.min())
        # Integers tie: take the middle one of the ties.
        start = int(narrowest[narrowest.size // 2])
        crowd = crowd[start : start + half]
        if crowd[0] == crowd[-1]:
            break
    return float(np.mean(crowd))


def spread(values: Floats) -> float:
    """Return the standard deviation estimated from the median absolute deviation."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return float("nan")
    return float(1.4826 * np.median(np.abs(finite - np.median(finite))))


def padding_value(columns: NDArray[np.generic]) -> float | None:
    """Value that fills the volume outside the field of view, or None where the field fills the volume.

    Reconstructions are round; what lies outside their circle is set to one value, often 0, which is not the grey of the
    air. It differs from air that the export has clipped to one value by three signs, over ``columns`` (n, depth): the
    step from the padding to what lies inside is sharp, what lies inside differs from it, and something stands out from
    that in turn. Clipped air passes into the sheet through the blur, and nothing stands out from the sheet.
    """
    corner = columns[0, 0]
    same = columns == corner
    if not np.isfinite(corner) or columns[-1, -1] != corner or same.mean() < 1e-3:
        return None
    inside = ~same
    has_inside = inside.sum(axis=1) > 12
    if np.count_nonzero(has_inside) < 10:
        return None
    profiles = columns[has_inside].astype(np.float64)
    first = np.argmax(inside[has_inside], axis=1)
    last = columns.shape[1] - 1 - np.argmax(inside[has_inside][:, ::-1], axis=1)
    cut = (first > 0) | (last < columns.shape[1] - 1)
    whole = ~same.all(axis=1)
    if np.count_nonzero(cut) < 0.05 * cut.size:
        # Few columns end in the padding. If others hold nothing else, the circle lies across the columns.
        return (
            float(corner)
            if np.count_nonzero(~whole) > 0.01 * whole.size and not inside[whole][:, 0].mean() < 0.5
            else None
        )
    rows = np.flatnonzero(cut & (first > 0))
    if rows.size < 10:
        rows, first = np.flatnonzero(cut), columns.shape[1] - 1 - last
        profiles = profiles[:, ::-1]
    edge = profiles[rows, first[rows]]
    deeper = profiles[rows[:, None], np.minimum(first[rows][:, None] + np.arange(2, 6), columns.shape[1] - 1)]
    level = float(np.median(deeper))
    scatter = max(spread(deeper - level), 1e-9)
    run = (profiles[rows, :-2] + profiles[rows, 1:-1] + profiles[rows, 2:]) / 3
    run = np.where(same[has_inside][rows][:, 1:-1], level, run)
    stands_out = float(np.median(np.max(np.abs(run - level), axis=1)))
    sharp = abs(float(np.median(edge)) - level) < 0.2 * abs(level - float(corner))
    differs = abs(level - float(corner)) > 3 * scatter
    return float(corner) if sharp and differs and stands_out > 4 * scatter else None


def voxel_noise(ends: Floats, air: float) -> float:
    """Standard deviation of one voxel, from samples (n, 3) of neighbouring voxels in the air."""
    steps = np.diff(ends, axis=1).ravel()
    distance = np.abs(ends - air)
    near = np.abs(ends[:, :-1].ravel() - air) <= max(float(np.nanpercentile(distance, 60)), 1e-12)
    if not near.any():
        return 0.0
    robust = spread(steps[near]) / np.sqrt(2.0)
    return float(robust if robust > 0 else np.sqrt(np.mean(steps[near] ** 2) / 2))


def material(blocks: NDArray[np.float32], air: float, air_scatter: float | None = None) -> tuple[float, float, float]:
    """Return polarity, the threshold of a first, coarse search, and the least that noise allows, both above the air.

    ``blocks`` are block means; a sheet is what stands out from the air's own scatter, which is that of the half nearest
    to the air where ``air_scatter`` is not given.
    """
    subset = blocks.ravel()[:: 1 + blocks.size // _ENOUGH]
    deviation = subset[np.isfinite(subset)].astype(np.float64) - air
    size = np.abs(deviation)
    scatter = spread(deviation[size <= np.percentile(size, 50)]) if air_scatter is None else air_scatter
    scatter = max(scatter, 1e-3 * float(np.ptp(deviation)), 1e-9)
    bright = deviation > _SIGMAS * scatter
    dark = deviation < -_SIGMAS * scatter
    if max(np.count_nonzero(bright), np.count_nonzero(dark)) < 1e-4 * deviation.size:
        raise VolumeError(
            f"There is no sheet in the volume: all of it lies within {_SIGMAS:g} standard deviations of the air's grey "
            f"({air:.4g}). Check that this is the reconstructed volume, and --through."
        )
    polarity = 1.0 if size[bright].sum() >= size[dark].sum() else -1.0
    typical = float(np.median(size[bright if polarity > 0 else dark]))
    ends = np.concatenate([blocks[..., :3].ravel(), blocks[..., -3:].ravel()]).astype(np.float64)
    least = max(_FEWER_SIGMAS * spread(ends), 0.08 * typical)
    return polarity, max(_SIGMAS * scatter, 0.35 * typical), least
