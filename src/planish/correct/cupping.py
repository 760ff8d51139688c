"""Cupping: the sheet's grey above air, as a factor that is a low-order polynomial in the square of the radius.

Base and coating are each compared with themselves, at the same depth below the face. Their border in grey moves with
the factor, so a voxel is sorted after it was corrected, again and again until nothing changes: the histogram of every
radius is kept for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planish.correct.levels import Levels
from planish.correct.record import Cupping, Trend
from planish.correct.sums import BASE, BRIGHT, COARSE, GREYS, MATERIALS, Counts, Sums
from planish.correct.turning import Turning

Array = NDArray[np.float64]

_ROUNDS = 40  # of sorting and fitting
_LEAST_VOXELS = 3000  # of a material
_LEAST_RADII = 8
_CLEAR = 3.0  # standard errors
_UNSURE = 3.0  # times the error of the other material: then a material does not count
_LOWEST = 0.5  # per cent: what is less does not matter
_PURE = 0.05  # of the voxels of a depth may be of the other material
_AGREE = 3.0  # standard errors by which base and coating may differ
_DEGREE = 1  # a second power costs more in noise than a beam hardened by a sheet of paper has


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fit:
    """Powers of one material and of each depth in it alone, from all groups and with each group left out.

    A true cupping is the same at every depth; a coating that is thinner in the middle is not.
    """

    powers: Array
    without: Array
    single: Array
    single_without: Array

    @property
    def percent(self) -> float:
        return loss(self.powers)

    @property
    def se(self) -> float:
        """Jackknife over the groups, and the scatter between depths that goes beyond it."""
        own = _jackknife(np.array([loss(p) for p in self.without])[:, None])[0]
        known = np.isfinite(self.single) & np.isfinite(self.single_without).all(axis=0)
        if np.count_nonzero(known) < 2:
            return float(own)
        each = 100.0 * self.single[known]
        se = np.maximum(100.0 * _jackknife(self.single_without[:, known]), 1e-3)
        w = 1.0 / se**2
        mean = float(np.sum(w * each) / w.sum())
        # Of the mean over the depths: they do not err alike by chance only.
        between = float(np.mean((each - mean) ** 2 - se**2))
        return float(np.sqrt(own**2 + max(between, 0.0)))


def _jackknife(values: Array) -> Array:
    """Standard errors (k,) from values (group, k) with each group left out."""
    n = len(values)
    return np.sqrt((n - 1) / n * np.sum((values - values.mean(axis=0)) ** 2, axis=0))


def loss(powers: Array) -> float:
    """Loss in the middle against the reach, in per cent."""
    return 100.0 * (1.0 - 1.0 / max(1.0 + float(np.sum(powers)), 1e-3))


def factor(powers: tuple[float, ...], share: Array) -> Array:
    """Factor on the grey above air at a share of the reach, 1 in the middle; constant beyond the reach."""
    t = np.minimum(share, 1.0) ** 2
    return 1.0 + sum((p * t ** (k + 1) for k, p in enumerate(powers)), np.zeros_like(t))


def find_cupping(
    sums: Sums, turning: Turning, levels: Levels, rings: Array
) -> tuple[Cupping | None, tuple[Trend, ...], str]:
    """Find the factor that base and coating share.

    Parameters
    ----------
    sums : Sums
    turning : Turning
    levels : Levels
    rings : (bin,)
        Rings that are still in the volume, as a share of the contrast: no part of the trend.

    Returns
    -------
    cupping : Cupping or None
        None where it is not beyond its error, or the materials contradict each other.
    trends : tuple of Trend
        Of each material, whether it was used or not.
    sentence : str
    """
    groups = _groups(sums.histogram)
    reach = _reach(groups.sum(axis=0), turning)
    radius = (np.arange(COARSE) + 0.5) * turning.farthest_um / COARSE
    offset = _mean_rings(sums, turning, rings)
    fits: dict[int, _Fit] = {}
    if reach > 0:
        for material in (BASE, BRIGHT):
            fit = _fit(groups, material, levels, radius / reach, offset)
            if fit is not None:
                fits[material] = fit
    trends = tuple(Trend(material=MATERIALS[m], before=f.percent, se=f.se) for m, f in fits.items())
    if not fits:
        return None, (), "Cupping: too few voxels lie inside the sheet, nothing was corrected."
    powers, percent, se, agree = _shared(list(fits.values()))
    each = ", ".join(f"{t.material} {t.before:.1f} +- {t.se:.1f} %" for t in trends)
    if not agree:
        return None, trends, f"Cupping: base and coating contradict each other ({each}), nothing was corrected."
    if abs(percent) < max(_CLEAR * se, _LOWEST):
        return None, trends, f"Cupping: no trend against the radius beyond its error ({each}), nothing was corrected."
    found = Cupping(percent=percent, se=se, powers=tuple(float(p) for p in powers), reach_um=reach)
    return found, trends, f"Cupping: {percent:.1f} +- {se:.1f} % in the middle corrected ({each})."


def middle_factor(sums: Sums, turning: Turning, cupping: Cupping) -> float:
    """Mean of the factor over the sheet's voxels: divided by it, the correction keeps the sheet's mean grey."""
    voxels = sums.histogram.sum(axis=(0, 1, 3, 4)).astype(np.float64)
    radius = (np.arange(COARSE) + 0.5) * turning.farthest_um / COARSE
    return float(np.sum(voxels * factor(cupping.powers, radius / cupping.reach_um)) / max(voxels.sum(), 1.0))


def _groups(histogram: Counts) -> Counts:
    """Histograms (group, radius, depth, grey): blocks along the axis, and quarters of the turn."""
    groups = histogram.reshape(-1, *histogram.shape[2:])
    return groups[groups.sum(axis=(1, 2, 3)) > 0]


def _reach(histogram: Counts, turning: Turning) -> float:
    """Largest radius in um at which there is some sheet."""
    voxels = histogram.sum(axis=(1, 2))
    held = np.flatnonzero(voxels > 0.002 * max(int(voxels.max()), 1))
    return float((held[-1] + 1) * turning.farthest_um / COARSE) if held.size >= _LEAST_RADII else 0.0


def _mean_rings(sums: Sums, turning: Turning, rings: Array) -> Array:
    """Mean height of the rings (COARSE,) over the sheet's voxels at each radius of the histogram."""
    voxels = sums.count[:, :, BASE:].sum(axis=(0, 1, 2)).astype(np.float64)
    middle = (np.arange(rings.size) + 0.5) * turning.step_um
    coarse = np.minimum((middle / turning.farthest_um * COARSE).astype(np.int64), COARSE - 1)
    held = np.bincount(coarse, voxels, COARSE)
    return np.bincount(coarse, voxels * rings, COARSE) / np.maximum(held, 1.0)


def _fit(groups: Counts, material: int, levels: Levels, share: Array, offset: Array) -> _Fit | None:
    if material == BRIGHT and not np.isfinite(levels.middle):
        return None
    # In contrasts above air.
    border = (levels.middle - levels.air) / levels.contrast
    low, high = (-np.inf, border) if material == BASE else (border, np.inf)
    whole = groups.sum(axis=0)
    found = _powers(whole, low, high, share, offset)
    if found is None:
        return None
    parts = [whole - g for g in groups]
    without = [p for p in (_powers(part, low, high, share, offset) for part in parts) if p is not None]
    if len(without) < 3:
        return None
    return _Fit(
        powers=found[0], without=np.array([p for p, _ in without]), single=found[1],
        single_without=np.array([s for _, s in without]),
    )  # fmt: skip


def _powers(histogram: Counts, low: float, high: float, share: Array, offset: Array) -> tuple[Array, Array] | None:
    """Fit 1 + p1 share² + ... to the mean grey, less ``offset``, of a material at each depth against the radius."""
    rows = histogram.reshape(-1, histogram.shape[-1]).astype(np.float64)
    start = np.zeros((len(rows), 1))
    count: Array = np.concatenate([start, np.cumsum(rows, axis=1)], axis=1)
    middles = GREYS[:-1] + 0.5 * (GREYS[1] - GREYS[0])
    total: Array = np.concatenate([start, np.cumsum(rows * middles, axis=1)], axis=1)
    depths = histogram.shape[1]
    t = np.repeat(np.minimum(share, 1.0) ** 2, depths)
    offset = np.repeat(offset, depths)
    depth = np.tile(np.arange(depths), COARSE)
    # Where base and coating meet, the least shift of a face changes the grey.
    border = (low if np.isfinite(low) else high) * np.ones(len(rows))
    whole = np.bincount(depth, count[:, -1], depths)
    lower = np.bincount(depth, _between(count, -np.inf * border, border), depths) if np.isfinite(border[0]) else whole
    mixed = np.minimum(lower, whole - lower) > _PURE * whole
    powers = np.zeros(_DEGREE)
    used, grey, n = np.zeros(len(rows), bool), np.zeros(len(rows)), np.zeros(len(rows))
    for _ in range(_ROUNDS):
        curve = 1.0 + sum((p * t ** (k + 1) for k, p in enumerate(powers)), np.zeros_like(t))
        ends = low * curve + offset, high * curve + offset
        n = _between(count, *ends)
        grey = _between(total, *ends) / np.maximum(n, 1.0) - offset
        # A depth has to be there at many radii, or its level cannot be separated from the trend.
        used = (n > 0.02 * n.max()) & ~mixed[depth]
        used &= (np.bincount(depth, used, depths) >= _LEAST_RADII)[depth]
        if n.sum() < _LEAST_VOXELS or not used.any():
            return None
        level = np.bincount(depth, np.where(used, n * grey / curve, 0.0), depths)
        level /= np.maximum(np.bincount(depth, np.where(used, n, 0.0), depths), 1.0)
        if level[depth[used]].min() <= 0:
            return None
        # grey = (level + its change) (curve + change of the powers), to first order.
        design = np.zeros((int(np.count_nonzero(used)), depths + _DEGREE))
        design[np.arange(len(design)), depth[used]] = curve[used]
        for k in range(_DEGREE):
            design[:, depths + k] = level[depth[used]] * t[used] ** (k + 1)
        root = np.sqrt(n[used])
        left = grey[used] - level[depth[used]] * curve[used]
        step = np.linalg.lstsq(design * root[:, None], left * root, rcond=None)[0][depths:]
        powers = np.clip(powers + step, -0.5, 1.0)
        if np.max(np.abs(step)) < 1e-5:
            break
    single = np.full(depths, np.nan)
    for d in range(depths):
        here = used & (depth == d)
        if here.any():
            line = np.polynomial.polynomial.polyfit(t[here], grey[here], 1, w=np.sqrt(n[here]))
            single[d] = line[1] / line[0] if line[0] > 0 else np.nan
    return powers, single


def _between(running: Array, low: Array, high: Array) -> Array:
    """Sum of each row of the histogram between two greys."""
    rows = np.arange(len(running))

    def upto(grey: Array) -> Array:
        x = np.clip((grey - GREYS[0]) / (GREYS[1] - GREYS[0]), 0.0, GREYS.size - 1.0)
        i = np.minimum(x.astype(np.int64), GREYS.size - 2)
        return running[rows, i] * (1 - (x - i)) + running[rows, i + 1] * (x - i)

    return upto(high) - upto(low)


def _shared(fits: list[_Fit]) -> tuple[Array, float, float, bool]:
    """Powers that the materials share, their loss and its error, and whether the materials agree at all."""
    if len(fits) == 1:
        return fits[0].powers, fits[0].percent, fits[0].se, True
    a, b = fits
    for one, other in ((a, b), (b, a)):
        if other.se > _UNSURE * max(one.se, 0.3):
            return one.powers, one.percent, one.se, True
    apart = abs(a.percent - b.percent)
    if apart <= _AGREE * float(np.hypot(a.se, b.se)):
        errors = np.maximum([a.se, b.se], 1e-3)
        w = 1.0 / errors**2
        powers = (w[0] * a.powers + w[1] * b.powers) / w.sum()
        return powers, loss(powers), float(1.0 / np.sqrt(w.sum())), True
    # What both share is corrected, and no more: the rest is the sheet's own.
    if a.percent * b.percent <= 0:
        return a.powers, a.percent, a.se, False
    least = a if abs(a.percent) < abs(b.percent) else b
    return least.powers, least.percent, least.se, True
