"""The grey scale of a scan: cut off at the sheet's end, or another one in every slice."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.checks.windows import Window
from planish.core.checks import PROPERTIES, Check

Array = NDArray[np.float64]

SPIKE, SHARE = 3.0, 2e-4  # height of the spike over what the histogram leads to; least share of the voxels
UNSTEADY = 0.03  # of the contrast: levels of slices that jump by as much, as a standard deviation
_BINS = 256  # between the air and the end of the grey scale
_REST = range(1, 7)  # bins that the histogram is continued from
_NEAR = 1.0  # standard deviations of the noise: so near to the layer's own level, a limit moves it
_LEVELS = (5.0, 50.0, 95.0)  # percentiles of the block means of a slice
_COATINGS = ("coating_top", "coating_bottom", "base_thickness", "thickness")


@dataclass(frozen=True, slots=True)
class Greys:
    """Grey levels that the surface search learnt; NaN for a coating that is not there."""

    air: float
    base: float
    coating: float
    noise: float

    @classmethod
    def of(cls, surfaces: xr.Dataset) -> Greys:
        """Take them from the attributes of surfaces; of two coatings the one farther from the base."""
        a = surfaces.attrs
        base = float(a["grey_base"])
        coats = [c for c in (float(a["grey_coating_top"]), float(a["grey_coating_bottom"])) if np.isfinite(c)]
        coating = max(coats, key=lambda c: abs(c - base), default=float("nan"))
        return cls(air=float(a["grey_air"]), base=base, coating=coating, noise=float(a["grey_noise"]))

    @property
    def densest(self) -> float:
        """Level of the layer that is farthest from the air."""
        return self.coating if np.isfinite(self.coating) else self.base

    @property
    def polarity(self) -> float:
        """-1 where the sheet is darker than the air."""
        return 1.0 if self.base >= self.air else -1.0


def clipping(sample: NDArray[Any], greys: Greys) -> tuple[float, float, float]:
    """Look for a spike in the histogram at the sheet's end of the grey scale, whatever type and level.

    Returns
    -------
    float, float, float
        Height of the spike over what the bins beside it lead to; share of the voxels in it; its grey.
    """
    # Whole numbers are counted once: a large part of a volume is looked at.
    whole = sample.dtype.kind != "f"
    levels, counts = np.unique(sample, return_counts=True) if whole else (sample[np.isfinite(sample)], None)
    if levels.size == 0:
        return 0.0, 0.0, float("nan")
    sign = greys.polarity
    end = float(levels.max() if sign > 0 else levels.min())
    reach = abs(end - greys.air)
    width = reach / _BINS
    if whole:  # a bin holds as many steps of the scale as any other
        near = levels[np.abs(levels.astype(np.float64) - end) <= 0.25 * reach]
        step = float(np.diff(near.astype(np.float64)).min()) if near.size > 1 else 1.0
        width = max(np.ceil(width / step - 1e-9), 1.0) * step
    # Away from the end; half a step keeps rounding out of the places of the bins.
    bins = np.floor(sign * (end - levels.astype(np.float64)) / width + (1e-6 if not whole else 1e-9))
    is_near_end = bins <= _REST[-1]
    weights = None if counts is None else counts[is_near_end]
    h = np.bincount(bins[is_near_end].astype(np.int64), weights, _REST[-1] + 1).astype(np.float64)
    # Of real numbers, what was cut off lies at one value exactly; the rest of its bin is as wide as the others.
    first = float(h[0] if whole else np.count_nonzero(levels == end))
    k = np.array(_REST, dtype=np.float64)
    x = float(np.exp(np.polyfit(k, np.log(h[1:] + 0.5), 1, w=np.sqrt(h[1:] + 0.5))[1]))
    return first / (x + 3 * np.sqrt(x) + 1), first / (levels.size if counts is None else int(counts.sum())), end


def clipping_check(sample: NDArray[Any], greys: Greys) -> Check:
    """Judge whether the grey scale ends where the sheet's densest layer lies."""
    spike, share, end = clipping(sample, greys)
    name, figures = "clipped grey", _COATINGS if np.isfinite(greys.coating) else (PROPERTIES,)
    has_spike = spike > SPIKE and share > SHARE
    layer = "coating" if np.isfinite(greys.coating) else "base"
    inside = greys.polarity * (end - greys.densest) < _NEAR * greys.noise + 0.02 * abs(greys.densest - greys.air)
    crowd = f"{100 * share:.2g} % of the voxels around the sheet have the grey {end:.5g}"
    if not has_spike:
        sentence = "The grey scale does not end at the sheet: no grey is crowded at the end where the sheet lies."
    elif not inside and share < 0.02:
        sentence = f"{crowd}, where the scale was cut off; the {layer} lies well inside ({greys.densest:.4g})."
    else:
        return Check(
            name=name, state="look", value=spike, limit=SPIKE, figures=figures,
            sentence=f"{crowd}, where the scale was cut off, and the {layer} lies at {greys.densest:.4g}: its "
            "contrast is too low, and its face is displaced.",
            advice="Export the volume with a wider grey window, or as 16 bit.",
        )  # fmt: skip
    return Check(name=name, state="pass", sentence=sentence, value=spike, limit=SPIKE, figures=())


def level_jump(window: Window) -> float:
    """Standard deviation of what the levels of single slices jump by, in greys."""
    levels = np.percentile(window.blocks, _LEVELS, axis=1)
    if levels.shape[1] < 8:
        return 0.0
    bend = np.abs(np.diff(levels, n=2, axis=1))
    return float(1.4826 / np.sqrt(6) * np.median(bend, axis=1).max())


def steadiness_check(windows: Iterable[Window], greys: Greys) -> Check:
    """Judge whether all slices have one grey scale."""
    contrast = abs(greys.densest - greys.air)
    jump_by_axis = {w.axis: level_jump(w) / contrast for w in windows}
    axis = max(jump_by_axis, key=lambda a: jump_by_axis[a], default="z")
    jumps = jump_by_axis.get(axis, 0.0)
    return Check.at_most(
        "grey of the slices", jumps, look=UNSTEADY, figures=(PROPERTIES,),
        sentence=f"From slice to slice along {axis}, grey levels jump by {100 * jumps:.1f} % of the contrast between "
        "air and sheet.",
        advice="Slices were probably scaled one by one. Export all of them with one grey window.",
    )  # fmt: skip
