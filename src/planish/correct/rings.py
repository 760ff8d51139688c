"""Rings: what is added at a radius all around the axis, separated from the structure of the sheet there.

Each material is compared with itself: the mean grey of a part of a circle against the running median of the same part
over neighbouring radii. A ring shows alike in every part of the turn, along the axis and in every material; a layer or
a fibre that happens to follow a circle shows in some. The scatter between the parts is the error of their mean.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planish.correct.record import Ring
from planish.correct.sums import UNIT, Sums
from planish.correct.turning import Turning

Array = NDArray[np.float64]

_ROUNDS = (0.5, 0.2, 0.1, 0.0)  # of the highest ring: what is lower waits for the next round
_WINDOW, _AFTERWARDS = 49, 13  # bins of half a voxel: the running median, and the mean over it
_LEAST = 6  # voxels of a part of a circle
_INNERMOST = 6  # bins; a smaller circle has too few voxels
_CLEAR = 5.0  # standard errors: among thousands of radii chance reaches four
_LOWEST = 0.003  # of the contrast: what is lower does not matter, and a byte does not hold it
_AROUND = 81  # bins whose usual scatter is the least error of the one in their middle
_NARROWEST = 3  # bins: no ring is narrower than the blur
_FOOT = 1.5  # standard errors at which a ring ends
_PARTS = 4.0  # parts of circles that have to agree, counted by their weight
_CHI2 = 0.4549  # median of the square of a standard normal number
_SHOWN = 0.5  # of its height that a ring shows in every material
_MOST_BINS = 40  # width of a ring; what is wider is left alone


@dataclass(frozen=True, slots=True, kw_only=True)
class Rings:
    """Rings and how their heights vary along the axis."""

    found: tuple[Ring, ...]
    shapes: Array  # (ring, bin): height at each radius, as a share of the contrast
    factors: Array  # (ring, block): on the height, at the middle of each block
    profile: Array  # (bin,): mean over all parts, NaN where it is not known
    error: Array  # (bin,): its standard error

    @property
    def limit(self) -> float:
        """Median of the heights that would have been found, as a share of the contrast."""
        known = np.isfinite(self.error)
        return float(np.median(np.maximum(_CLEAR * self.error[known], _LOWEST))) if known.any() else float("nan")

    @property
    def mean(self) -> Array:
        """Height (bin,) of all rings together."""
        return self.shapes.sum(axis=0)

    def tables(self, blocks: Array, slices: NDArray[np.intp]) -> Array:
        """Height (slice, bin) as a share of the contrast; between the middles of blocks it varies linearly."""
        factors = np.stack([np.interp(slices, blocks, f) for f in self.factors]) if len(self.factors) else None
        return np.zeros((slices.size, self.profile.size)) if factors is None else factors.T @ self.shapes


def find_rings(sums: Sums, turning: Turning, contrast: float) -> Rings:
    """Find the rings that stand out from noise and structure; there may be none."""
    bins = sums.count.shape[-1]
    known = np.zeros(bins)
    residual = weight = np.zeros((0, 0, 0, bins))
    profile = error = known
    intervals: list[tuple[int, int]] = []
    for share in _ROUNDS:
        # A ring lifts the running median beside it, which makes two faint ones of the other sign. So the high ones are
        # taken off first.
        residual, weight = _residuals(sums, known)
        profile, error = _combined(residual.reshape(-1, bins), weight.reshape(-1, bins))
        profile[:_INNERMOST] = error[:_INNERMOST] = np.nan
        intervals = _intervals(profile, error, share)
        known = np.zeros(bins)
        for first, last in intervals:
            known[first : last + 1] = profile[first : last + 1]
    blocks = len(residual)
    shapes: list[Array] = []
    factors: list[Array] = []
    found: list[Ring] = []
    parts: list[tuple[Array, Array]] = []
    materials: list[tuple[Array, Array]] = []
    if intervals:
        parts = [_combined(r.reshape(-1, bins), w.reshape(-1, bins)) for r, w in zip(residual, weight, strict=True)]
        materials = [
            _combined(residual[:, :, m].reshape(-1, bins), weight[:, :, m].reshape(-1, bins)) for m in range(3)
        ]
    for first, last in intervals:
        where = slice(first, last + 1)
        heights = [_height(profile[where], p[where], e[where]) for p, e in materials]
        # What a material clearly shows less than a part of is the structure of another one.
        if any(power and factor + 3.0 / np.sqrt(power) < _SHOWN for factor, power in heights):
            continue
        shape = np.zeros(bins)
        shape[where] = profile[where]
        factor = _along(shape[where], [(p[where], e[where]) for p, e in parts]) if blocks > 1 else np.ones(1)
        crest = first + int(np.argmax(np.abs(profile[where])))
        height = float(profile[crest])
        width = np.count_nonzero(np.abs(profile[where]) >= 0.5 * abs(height)) * turning.step_um
        shapes.append(shape)
        factors.append(factor)
        ring = Ring(
            radius_um=(crest + 0.5) * turning.step_um, width_um=float(width), height=height * contrast, share=height,
            share_se=float(error[crest]), least=float(factor.min()), most=float(factor.max()),
        )  # fmt: skip
        found.append(ring)
    return Rings(
        found=tuple(found), shapes=np.array(shapes).reshape(-1, bins), factors=np.array(factors).reshape(-1, blocks),
        profile=profile, error=error,
    )  # fmt: skip


def left_over(rings: Rings, after: Rings) -> tuple[Ring, ...]:
    """What is left of each ring; its crest is weighed with its own shape."""
    found: list[Ring] = []
    for ring, shape in zip(rings.found, rings.shapes, strict=True):
        inside = (shape != 0) & np.isfinite(after.profile)
        power = float(np.sum(shape[inside] ** 2))
        share = float(np.sum(shape[inside] * after.profile[inside])) / power if power else float("nan")
        found.append(replace(ring, share_after=ring.share * share))
    return tuple(found)


def _residuals(sums: Sums, rings: Array) -> tuple[Array, Array]:
    """Mean grey (block, sector, material, bin) over its running median, and its weight: one over the variance.

    The running median is that of the grey without ``rings`` (bin,), which are known already.
    """
    count = sums.count.astype(np.float64)
    known = count >= _LEAST
    mean = np.where(known, sums.total / np.maximum(count, 1.0), np.nan) / UNIT
    residual = np.full(mean.shape, np.nan)
    for at in np.ndindex(*mean.shape[:3]):
        here = np.flatnonzero(known[at])
        if here.size < _WINDOW // 2:
            continue
        span = slice(here[0], here[-1] + 1)
        whole = np.interp(np.arange(span.start, span.stop), here, mean[at][here])
        plain = whole - rings[span]
        trend = ndimage.uniform_filter1d(ndimage.median_filter(plain, _WINDOW, mode="nearest"), _AFTERWARDS)
        residual[at][span] = np.where(known[at][span], whole - trend, np.nan)
    weight = np.zeros(mean.shape)
    for m in range(mean.shape[2]):
        here = np.isfinite(residual[:, :, m])
        if here.any():
            # Per voxel, as its mean really scatters: the texture of fibres makes neighbours alike.
            variance = float(np.median(residual[:, :, m][here] ** 2 * count[:, :, m][here])) / _CHI2
            weight[:, :, m] = np.where(here, count[:, :, m], 0.0) / max(variance, 1e-6)
    return np.nan_to_num(residual), weight


def _combined(residual: Array, weight: Array) -> tuple[Array, Array]:
    """Robust mean (bin,) over parts (part, bin) and its standard error; NaN where too few parts have values."""
    total = weight.sum(axis=0)
    sure = np.divide(total**2, np.sum(weight**2, axis=0), out=np.zeros_like(total), where=total > 0) >= min(
        _PARTS, 0.6 * len(weight)
    )
    mean = _weighted_median(residual, weight)
    held = weight
    for _ in range(5):
        off = np.abs(residual - mean) * np.sqrt(weight)
        # The scatter of the parts, but no less than that of their voxels.
        scale = np.maximum(_weighted_median(off, (weight > 0).astype(np.float64)) / np.sqrt(_CHI2), 1.0)
        held = weight * np.minimum(1.0, 2.0 * scale / np.maximum(off, 1e-12))
        mean = np.sum(held * residual, axis=0) / np.maximum(held.sum(axis=0), 1e-12)
    all_held = np.maximum(held.sum(axis=0), 1e-12)
    scatter = np.sqrt(np.sum((held * (residual - mean)) ** 2, axis=0)) / all_held
    error = np.maximum(scatter, 1.0 / np.sqrt(all_held))
    # Circles pass the rows of voxels and the layers of the sheet in ever new ways: what that does from bin to bin is
    # error too.
    usual = ndimage.median_filter(np.abs(mean) / error, _AROUND, mode="nearest") / np.sqrt(_CHI2)
    error = error * np.maximum(usual, 1.0)
    return np.where(sure, mean, np.nan), np.where(sure, error, np.nan)


def _weighted_median(values: Array, weight: Array) -> Array:
    order = np.argsort(values, axis=0, kind="stable")
    running = np.cumsum(np.take_along_axis(weight, order, axis=0), axis=0)
    at = np.argmax(running >= 0.5 * running[-1], axis=0)
    return np.take_along_axis(np.take_along_axis(values, order, axis=0), at[None], axis=0)[0]


def _intervals(profile: Array, error: Array, share: float) -> list[tuple[int, int]]:
    """First and last bin of every ring that has ``share`` of the height of the highest."""
    height = np.nan_to_num(profile)
    clarity = np.where(np.isfinite(error), np.abs(height) / np.nan_to_num(error, nan=1.0), 0.0)
    # What fills one bin only is no ring: its neighbours have to show it too.
    beside = ndimage.uniform_filter1d(np.where(clarity > 0, height, 0.0), 3) / np.where(clarity > 0, height, 1.0)
    clarity = np.minimum(clarity, beside * clarity * np.sqrt(3.0))
    clear = (clarity > _CLEAR) & (np.abs(height) > _LOWEST)
    highest = float(np.abs(height[clear]).max()) if clear.any() else 0.0
    seeds = np.flatnonzero(clear & (np.abs(height) >= share * highest))
    found: list[tuple[int, int]] = []
    for seed in seeds:
        if found and seed <= found[-1][1]:
            continue
        ends: list[int] = []
        for step in (-1, 1):
            at = int(seed)
            while 0 <= at + step < height.size and clarity[at + step] > _FOOT and height[at + step] * height[seed] > 0:
                at += step
            ends.append(at)
        if _NARROWEST <= ends[1] - ends[0] + 1 <= _MOST_BINS:
            found.append((ends[0], ends[1]))
    return found


def _height(shape: Array, profile: Array, error: Array) -> tuple[float, float]:
    """Factor on the height of a ring of a known shape, and one over its variance; 1 and 0 where nothing is known."""
    known = np.isfinite(profile) & np.isfinite(error)
    w = shape[known] / error[known] ** 2
    power = float(np.sum(w * shape[known]))
    return (float(np.sum(w * profile[known])) / power, power) if known.any() else (1.0, 0.0)


def _along(shape: Array, parts: list[tuple[Array, Array]]) -> Array:
    """Factor on a ring's height in each block; 1 everywhere where the blocks differ by no more than their errors."""
    factor, power = np.array([_height(shape, *part) for part in parts]).T
    variance = np.divide(1.0, power, out=np.full(len(parts), np.inf), where=power > 0)
    known = np.isfinite(variance)
    n = int(np.count_nonzero(known))
    if n < 2:
        return np.ones(len(parts))
    chi2 = float(np.sum((factor[known] - 1.0) ** 2 / variance[known]))
    if chi2 < n + 4.0 * np.sqrt(2.0 * n):
        return np.ones(len(parts))
    between = max(float(np.mean((factor[known] - 1.0) ** 2 - variance[known])), 0.0)
    pull = np.where(known, between / (between + np.where(known, variance, 1.0)), 0.0)
    return 1.0 + pull * (factor - 1.0)
