"""The greys of a volume: air, sheet and its two materials, and the value of voxels that hold nothing."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.robust import MAD_TO_SD, mad_sd
from planish.core.typing import Bools, Floats

SMOOTHING_PX = 1.5  # gaussian in a slice after which a single voxel shows its material in spite of the noise
_BINS = 160
_WINDOW = 9
_SPIKE = 0.01  # of all voxels: so much padding at least
_TWO = 0.25  # a second material stands out from the base by so much of its own contrast
_CLEAR = 6.0  # the sheet stands out from air by so many scatters of the smoothed air


@dataclass(frozen=True, slots=True, kw_only=True)
class Levels:
    """Greys of a volume."""

    air: float
    sheet: float  # of the brightest material that is common: coating where there is one, or base
    split: float  # between air and sheet
    middle: float  # between base and coating; infinite where there is one material only
    padding: float  # of voxels that hold nothing; NaN for none
    air_cut: bool  # whether the export has cut off the air's noise, so that its mean is biased

    @property
    def contrast(self) -> float:
        """Grey between air and sheet."""
        return self.sheet - self.air


def smoothed(plane: NDArray[Any]) -> NDArray[np.float32]:
    """Smooth a slice; what is not finite counts as 0 and has to be masked."""
    finite = np.nan_to_num(plane.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    return ndimage.gaussian_filter(finite, SMOOTHING_PX)


def missing(plane: NDArray[Any], padding: float) -> Bools:
    """Voxels of a slice that hold nothing, and those too near to them to be smoothed."""
    empty = ~np.isfinite(plane) if plane.dtype.kind == "f" else np.zeros(plane.shape, bool)
    if np.isfinite(padding):
        empty |= _without_specks(plane == padding)
    return ndimage.maximum_filter(empty, 9) if empty.any() else empty


def find_levels(slices: list[NDArray[Any]], radius: Floats) -> Levels | None:
    """Find the greys in some slices; None where no sheet stands out from the air."""
    padding = _padding(slices, radius)
    levels = _estimate_levels(slices, padding)
    if levels is None:
        return None
    lowest = _lowest_grey(slices)
    dark = cut = 0
    for s in slices:
        below = (smoothed(s) < levels.split) & ~missing(s, padding)
        dark += np.count_nonzero(below)
        cut += np.count_nonzero(below & (s == lowest))
    # Where all of the air has the same value it has no noise: nothing was cut off.
    return replace(levels, padding=padding, air_cut=0.05 < cut / max(dark, 1) < 0.8)


def _lowest_grey(slices: list[NDArray[Any]]) -> float:
    return min((float(np.nanmin(s)) for s in slices if np.isfinite(s).any()), default=float("nan"))


def _padding(slices: list[NDArray[Any]], radius: Floats) -> float:
    """Value of the corners outside the scanner's circle: the lowest one, everywhere outside and nowhere inside."""
    lowest = _lowest_grey(slices)
    spike = np.mean([_without_specks(s == lowest) for s in slices], axis=0)
    share = float(spike.mean())
    if share < _SPIKE:
        return float("nan")
    outside = radius > np.quantile(radius, 1.0 - share)
    return lowest if spike[outside].mean() > 0.9 and spike[~outside].mean() < 0.1 * share else float("nan")


def _without_specks(mask: Bools) -> Bools:
    """Mask without the single voxels that noise has cut off: nearly all of a neighbourhood has to be in it."""
    share = ndimage.uniform_filter(mask.astype(np.float32), _WINDOW)
    return mask & (ndimage.maximum_filter(share, _WINDOW) > 0.95)


def _estimate_levels(slices: list[NDArray[Any]], padding: float) -> Levels | None:
    """Read the levels off the histogram of smoothed slices; None where no sheet stands out from the air."""
    parts = [smoothed(s)[~missing(s, padding)] for s in slices]
    greys = np.concatenate([p.ravel() for p in parts])
    if greys.size < 1000:
        return None
    low, high = (float(q) for q in np.percentile(greys, [0.02, 99.98]))
    if not high > low:
        return None
    count, edges = np.histogram(greys, _BINS, (low, high))
    first, second = _three_classes(count.astype(np.float64))
    split, middle = float(edges[first]), float(edges[second])
    air = _centre(greys[greys <= split])
    base, bright = greys[(greys > split) & (greys <= middle)], greys[greys > middle]
    if not bright.size or not base.size:
        return None
    low_level, high_level = float(np.median(base)), float(np.median(bright))
    scatter = mad_sd(greys[greys <= split], air)
    if high_level - low_level < _TWO * (low_level - air):
        middle, sheet = np.inf, float(np.median(greys[greys > split]))
    else:
        sheet = high_level
    if sheet - air < max(_CLEAR * scatter, 1e-9):
        return None
    # The lower border lies half way: a border between classes is drawn towards the wider one.
    split = 0.5 * (air + (low_level if np.isfinite(middle) else sheet))
    return Levels(air=air, sheet=sheet, split=split, middle=middle, padding=np.nan, air_cut=False)


def _centre(greys: NDArray[np.float32]) -> float:
    """Mean of what lies near the median."""
    median = float(np.median(greys))
    near = np.abs(greys - median) <= max(3 * MAD_TO_SD * float(np.median(np.abs(greys - median))), 1e-6)
    return float(np.mean(greys[near], dtype=np.float64))


def _three_classes(count: Floats) -> tuple[int, int]:
    """Borders of three classes with the largest variance between them (Otsu 1979)."""
    n = np.concatenate([[0.0], np.cumsum(count)])
    s = np.concatenate([[0.0], np.cumsum(count * np.arange(count.size))])

    def gain(a: Any, b: Any) -> Floats:
        size = n[b] - n[a]
        return np.where(size > 0, (s[b] - s[a]) ** 2 / np.maximum(size, 1.0), 0.0)

    i, j = np.triu_indices(count.size, 1)
    i, j = i[i > 0], j[i > 0]
    zero, end = np.zeros_like(i), np.full_like(i, count.size)
    best = int(np.argmax(gain(zero, i) + gain(i, j) + gain(j, end)))
    return int(i[best]), int(j[best])
