"""Rings: what is added at a radius all around the axis.

It is separated from the structure of the sheet there.

A ring shows alike in every part of the turn, along the axis and in every material: their scatter is
its error.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from planish.core.typing import Floats, Ints, Pair
from planish.correct.params import RingArtefact
from planish.correct.sums import UNIT, Sums, Turning

_WINDOW, _AFTERWARDS = 49, 13  # bins of half a voxel: the running median, and the mean over it
_LEAST = 6  # voxels of a part of a circle
_INNERMOST = 6  # bins; a smaller circle has too few voxels
_CLEAR = 5.0  # standard errors: among thousands of radii chance reaches four
_LOWEST = 0.003  # of the contrast: what is lower does not matter, and a byte does not hold it
_CHI2 = 0.4549  # median of the square of a standard normal number
_SHOWN = 0.5  # of its height that a ring shows in every material


class RingFit(NamedTuple):
    """Rings and how their heights vary along the axis."""

    rings: tuple[RingArtefact, ...]
    shapes: Floats  # (ring, bin): height at each radius, as a share of the contrast
    factors: Floats  # (ring, block): on the height, at the middle of each block
    profile: Floats  # (bin,): mean over all parts, NaN where it is not known
    error: Floats  # (bin,): its standard error

    @property
    def limit(self) -> float:
        """Median of the heights that would have been found, as a share of the contrast."""
        is_valid = np.isfinite(self.error)
        if not is_valid.any():
            return float("nan")
        heights = np.maximum(_CLEAR * self.error[is_valid], _LOWEST)
        return float(np.median(heights))

    @property
    def mean(self) -> Floats:
        """Height (bin,) of all rings together."""
        return self.shapes.sum(axis=0)

    def tables(self, blocks: Floats, slice_numbers: Ints) -> Floats:
        """Height (slice, bin) as a share of the contrast.

        Between the middles of blocks it varies linearly. ``blocks`` are these middles, and
        ``slice_numbers`` are counted from the first slice of the volume.
        """
        factors = [np.interp(slice_numbers, blocks, f) for f in self.factors]
        return np.stack(factors).T @ self.shapes


def find_rings(sums: Sums, turning: Turning, contrast: float) -> RingFit:
    """Find the rings that stand out from noise and structure; there may be none.

    ``contrast`` is the grey between air and sheet. Profiles are means over all parts of circles
    (block along the axis, sector of the turn, material), over the radius in bins of half a voxel.
    What stands out is looked for four times, each time against a running median without the rings
    found before; then each ring is dropped that a material does not show, and scaled for each
    block.
    """
    bins = sums.count.shape[-1]
    # A ring lifts the running median, so that faint ones of the other sign lie beside it: high ones
    # come off first.
    heights = np.zeros(bins)
    residual = weight = np.zeros((0, 0, 0, bins))
    profile = error = heights
    intervals: list[slice] = []
    # Of the highest ring: what is lower waits for the next round.
    for share in (0.5, 0.2, 0.1, 0.0):
        residual, weight = _residuals(sums, heights)
        profile, error = _robust_mean(residual, weight)
        profile[:_INNERMOST] = np.nan
        error[:_INNERMOST] = np.nan
        intervals = _intervals(profile, error, share)
        heights = np.zeros(bins)
        for ring_bins in intervals:
            heights[ring_bins] = profile[ring_bins]
    shapes: list[Floats] = []
    factors: list[Floats] = []
    rings: list[RingArtefact] = []
    blocks = np.zeros((0, 2, bins))  # profile and error of each
    materials = blocks
    if intervals:
        blocks = _robust_means(residual, weight)
        materials = _robust_means(np.moveaxis(residual, 2, 0), np.moveaxis(weight, 2, 0))
    for ring_bins in intervals:
        ring = profile[ring_bins]
        if _is_structure(ring, materials[..., ring_bins]):
            continue
        shape = np.zeros(bins)
        shape[ring_bins] = ring
        factor = _block_factors(ring, blocks[..., ring_bins])
        size = np.abs(ring)
        crest = ring_bins.start + int(np.argmax(size))
        height = float(profile[crest])
        n_wide = np.count_nonzero(size >= 0.5 * abs(height))
        artefact = RingArtefact(
            radius_um=(crest + 0.5) * turning.step_um,
            width_um=n_wide * turning.step_um,
            height=height * contrast,
            share=height,
            share_se=float(error[crest]),
            least=factor.min(),
            most=factor.max(),
        )
        shapes.append(shape)
        factors.append(factor)
        rings.append(artefact)
    all_shapes = np.array(shapes).reshape(-1, bins)
    all_factors = np.array(factors).reshape(-1, len(residual))
    return RingFit(tuple(rings), all_shapes, all_factors, profile, error)


def _is_structure(ring: Floats, materials: Floats) -> bool:
    """Whether a material clearly shows less than a part of a ring: it is of another one then.

    ``materials`` (material, 2, bin): profile and error.
    """
    for profile, error in materials:
        factor, weight = _height_factor(ring, profile, error)
        if weight and factor + 3.0 / np.sqrt(weight) < _SHOWN:
            return True
    return False


def remaining_rings(before: RingFit, after: RingFit) -> tuple[RingArtefact, ...]:
    """Give each ring with the share that the correction left of it.

    Its crest is weighed with its own shape.
    """
    remaining: list[RingArtefact] = []
    for ring, shape in zip(before.rings, before.shapes, strict=True):
        is_ring = (shape != 0) & np.isfinite(after.profile)
        crest = shape[is_ring]
        norm = float(np.sum(crest**2))
        height = float(np.sum(crest * after.profile[is_ring]))
        factor = height / norm if norm else float("nan")
        share_after = {"share_after": ring.share * factor}
        remaining.append(ring.model_copy(update=share_after))
    return tuple(remaining)


def _residuals(sums: Sums, rings: Floats) -> tuple[Floats, Floats]:
    """Mean grey (block, sector, material, bin) over its running median, and its weight.

    The running median is that of the grey without the rings (bin,), which are known already. The
    weight is one over the variance, 0 where a part of a circle has too few voxels.
    """
    count = sums.count.astype(np.float64)
    is_measured = count >= _LEAST
    mean = sums.total / np.maximum(count, 1.0) / UNIT
    residual = np.full(mean.shape, np.nan)
    for cell in np.ndindex(*mean.shape[:3]):
        is_valid = is_measured[cell]
        valid_bins = np.flatnonzero(is_valid)
        if valid_bins.size < _WINDOW // 2:
            continue
        first, last = valid_bins[[0, -1]]
        span = slice(first, last + 1)
        mean_grey = np.interp(np.arange(first, last + 1), valid_bins, mean[cell][valid_bins])
        medians = ndimage.median_filter(mean_grey - rings[span], _WINDOW, mode="nearest")
        trend = ndimage.uniform_filter1d(medians, _AFTERWARDS)
        above_trend = mean_grey - trend
        residual[cell][span] = np.where(is_valid[span], above_trend, np.nan)
    weight = np.zeros(mean.shape)
    for m in range(mean.shape[2]):
        is_valid = np.isfinite(residual[:, :, m])
        if is_valid.any():
            # Per voxel, as its mean really scatters: the texture of fibres makes neighbours alike.
            voxels = count[:, :, m]
            squares = residual[:, :, m][is_valid] ** 2 * voxels[is_valid]
            variance = max(np.median(squares) / _CHI2, 1e-6)
            weight[:, :, m] = np.where(is_valid, voxels, 0.0) / variance
    return np.nan_to_num(residual), weight


def _robust_means(residuals: Floats, weights: Floats) -> Floats:
    """Profile and error (n, 2, bin) of each block, or of each material."""
    return np.array([*map(_robust_mean, residuals, weights)])


def _robust_mean(residual: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Robust mean (bin,) over all parts (..., bin) and its standard error.

    NaN where too few parts have values. Weights are one over the variance; a part that is more than
    twice the usual scatter off the mean counts less (Huber).
    """
    residual, weight = (a.reshape(-1, a.shape[-1]) for a in (residual, weight))
    weight_sum = weight.sum(axis=0)
    # Parts of circles that have to agree, counted by their weight.
    square_sum = np.where(weight_sum > 0, np.sum(weight**2, axis=0), 1.0)
    n_parts = weight_sum**2 / square_sum
    has_enough = n_parts >= min(4.0, 0.6 * len(weight))
    mean = _weighted_median(residual, weight)
    robust_weight = weight
    for _ in range(5):
        scaled_residual = np.abs(residual - mean) * np.sqrt(weight)
        # The scatter of the parts, but no less than that of their voxels.
        median = _weighted_median(scaled_residual, (weight > 0).astype(np.float64))
        scale = np.maximum(median / np.sqrt(_CHI2), 1.0)
        trust = 2.0 * scale / np.maximum(scaled_residual, 1e-12)
        robust_weight = weight * np.minimum(1.0, trust)
        weight_sum = np.maximum(robust_weight.sum(axis=0), 1e-12)
        mean = np.sum(robust_weight * residual, axis=0) / weight_sum
    weighted_squares = (robust_weight * (residual - mean)) ** 2
    scatter = np.sqrt(np.sum(weighted_squares, axis=0)) / weight_sum
    error = np.maximum(scatter, 1.0 / np.sqrt(weight_sum))
    # Circles pass the rows of voxels and the layers of the sheet in ever new ways: what that does
    # from bin to bin is error too, at least the usual scatter of the bins around.
    clarity = np.abs(mean) / error
    local_scatter = ndimage.median_filter(clarity, 81, mode="nearest") / np.sqrt(_CHI2)
    error = error * np.maximum(local_scatter, 1.0)
    mean[~has_enough] = np.nan
    error[~has_enough] = np.nan
    return mean, error


def _weighted_median(values: Floats, weight: Floats) -> Floats:
    """Median (bin,) of the values (part, bin) of each bin, each with its weight."""
    order = np.argsort(values, axis=0, kind="stable")
    ordered_weight = np.take_along_axis(weight, order, axis=0)
    running_weight = np.cumsum(ordered_weight, axis=0)
    median_index = np.argmax(running_weight >= 0.5 * running_weight[-1], axis=0)
    ordered = np.take_along_axis(values, order, axis=0)
    return np.take_along_axis(ordered, median_index[None], axis=0)[0]


def _intervals(profile: Floats, error: Floats, share: float) -> list[slice]:
    """Bins of every ring that has ``share`` of the height of the highest.

    ``profile`` and ``error`` (bin,) as shares of the contrast, NaN where they are not known. A ring
    stands out by five errors in its crest, and its neighbours show it too.
    """
    height = np.nan_to_num(profile)
    size = np.abs(height)
    # In standard errors; 0 where nothing is known.
    clarity = size / np.nan_to_num(error, nan=np.inf)
    # What fills one bin only is no ring: its neighbours have to show it too.
    mean_height = ndimage.uniform_filter1d(np.where(clarity > 0, height, 0.0), 3)
    ratio = mean_height / np.where(clarity > 0, height, 1.0)
    clarity = np.minimum(clarity, ratio * clarity * np.sqrt(3.0))
    clear = (clarity > _CLEAR) & (size > _LOWEST)
    highest = size[clear].max(initial=0.0)
    # A ring ends where it is below 1.5 standard errors or changes its sign.
    sign = np.where(clarity > 1.5, np.sign(height), 0.0)
    sign_changes = np.flatnonzero(np.diff(sign, prepend=0.0, append=0.0))
    intervals: list[slice] = []
    for start, end in pairwise(sign_changes.tolist()):
        seeds = clear[start:end] & (size[start:end] >= share * highest)
        # No ring is narrower than the blur, and what is wider is left alone.
        if seeds.any() and 3 <= end - start <= 40:
            intervals.append(slice(start, end))
    return intervals


def _height_factor(shape: Floats, profile: Floats, error: Floats) -> Pair:
    """Factor on the height of a ring of a known shape, and one over its variance.

    1 and 0 where nothing is known.
    """
    is_valid = np.isfinite(profile) & np.isfinite(error)
    if not is_valid.any():
        return 1.0, 0.0
    w = shape[is_valid] / error[is_valid] ** 2
    precision = float(np.sum(w * shape[is_valid]))
    return float(np.sum(w * profile[is_valid])) / precision, precision


def _block_factors(shape: Floats, block_profiles: Floats) -> Floats:
    """Factor on a ring's height in each block, by profile and error (block, 2, bin).

    1 everywhere where the blocks differ by no more than their errors. Where they differ by more,
    each is drawn towards 1 by the share of its error in what they scatter.
    """
    pairs = [_height_factor(shape, *block) for block in block_profiles]
    factor, precision = np.array(pairs).T
    is_valid = precision > 0
    variance = 1.0 / precision[is_valid]
    n = variance.size
    excess = factor[is_valid] - 1.0
    squared_excess = excess**2
    factors = np.ones(precision.size)
    # Chi-squared of n degrees, which is beyond this in next to no case by chance.
    most = n + 4.0 * np.sqrt(2.0 * n)
    if n < 2 or np.sum(squared_excess / variance) < most:
        return factors
    between_variance = max(np.mean(squared_excess - variance), 0.0)
    shrinkage = between_variance / (between_variance + variance)
    factors[is_valid] += shrinkage * excess
    return factors
