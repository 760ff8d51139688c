"""Cupping: the sheet's grey above air, as a factor that is linear in the square of the radius.

Base and coating are each compared with themselves at one depth, from histograms: their border moves with the factor.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planish.core.transform import Pair
from planish.core.typing import Bools, Floats
from planish.correct.params import Cupping, Trend
from planish.correct.sums import BASE, BRIGHT, COARSE, GREYS, MATERIALS, Counts, Levels, Sums, Turning

_LEAST_RADII = 8
_CLEAR = 3.0  # standard errors
_LOWEST = 0.5  # per cent: what is less does not matter


class _Fit(NamedTuple):
    """Factor on the square of the share of the reach that one material shows, the loss it means, and its error."""

    power: float
    percent: float
    se: float


def _jackknife_errors(estimates: Floats) -> Floats:
    """Standard errors (k,) from values (group, k) with each group left out."""
    n = len(estimates)
    return np.sqrt((n - 1) / n * np.sum((estimates - estimates.mean(axis=0)) ** 2, axis=0))


def _loss_percent(power: float) -> float:
    """Loss in the middle against the reach, in per cent."""
    return 100.0 * (1.0 - 1.0 / max(1.0 + power, 1e-3))


def factor(powers: tuple[float, ...], share: Floats) -> Floats:
    """Factor on the grey above air at a share of the reach, 1 in the middle; constant beyond the reach."""
    return 1.0 + powers[0] * np.minimum(share, 1.0) ** 2


def find_cupping(
    sums: Sums, turning: Turning, levels: Levels, rings: Floats
) -> tuple[Cupping | None, tuple[Trend, ...], str]:
    """Find the factor that base and coating share, the trend of each material, and what to say of it.

    ``rings`` (bin,) are still in the volume, as a share of the contrast: no part of the trend. The factor is None where
    it is not beyond its error, or the materials contradict each other.
    """
    # Blocks along the axis, and quarters of the turn: (group, radius, depth, grey).
    groups = sums.histogram.reshape(-1, *sums.histogram.shape[2:])
    groups = groups[groups.sum(axis=(1, 2, 3)) > 0]
    voxels = groups.sum(axis=(0, 2, 3))
    radii = np.flatnonzero(voxels > 0.002 * max(int(voxels.max()), 1))
    # The largest radius at which there is some sheet.
    reach = float((radii[-1] + 1) * turning.farthest_um / COARSE) if radii.size >= _LEAST_RADII else 0.0
    radius = (np.arange(COARSE) + 0.5) * turning.farthest_um / COARSE
    # Mean height of the rings over the sheet's voxels at each radius of the histogram.
    weight = sums.count[:, :, BASE:].sum(axis=(0, 1, 2)).astype(np.float64)
    middle = (np.arange(rings.size) + 0.5) * turning.step_um
    coarse = np.minimum((middle / turning.farthest_um * COARSE).astype(np.int64), COARSE - 1)
    offset = np.bincount(coarse, weight * rings, COARSE) / np.maximum(np.bincount(coarse, weight, COARSE), 1.0)
    materials = (BASE, BRIGHT) if reach > 0 else ()
    all_fits = {m: _fit_material(groups, m, levels, radius / reach, offset) for m in materials}
    fits = {m: fit for m, fit in all_fits.items() if fit is not None}
    trends = tuple(Trend(material=MATERIALS[m], before=f.percent, se=f.se) for m, f in fits.items())
    if not fits:
        return None, (), "Cupping: too few voxels lie inside the sheet, nothing was corrected."
    shared, agree = _join_materials([*fits.values()])
    each = ", ".join(f"{t.material} {t.before:.1f} +- {t.se:.1f} %" for t in trends)
    if not agree:
        return None, trends, f"Cupping: base and coating contradict each other ({each}), nothing was corrected."
    if abs(shared.percent) < max(_CLEAR * shared.se, _LOWEST):
        return None, trends, f"Cupping: no trend against the radius beyond its error ({each}), nothing was corrected."
    cupping = Cupping(percent=shared.percent, se=shared.se, powers=(shared.power,), reach_um=reach)
    return cupping, trends, f"Cupping: {shared.percent:.1f} +- {shared.se:.1f} % in the middle corrected ({each})."


def middle_factor(sums: Sums, turning: Turning, cupping: Cupping) -> float:
    """Mean of the factor over the sheet's voxels: divided by it, the correction keeps the sheet's mean grey."""
    voxels = sums.histogram.sum(axis=(0, 1, 3, 4)).astype(np.float64)
    radius = (np.arange(COARSE) + 0.5) * turning.farthest_um / COARSE
    return float(np.sum(voxels * factor(cupping.powers, radius / cupping.reach_um)) / max(voxels.sum(), 1.0))


def _fit_material(groups: Counts, material: int, levels: Levels, share: Floats, offset: Floats) -> _Fit | None:
    """Fit the factor of one material; None where there are too few of its voxels."""
    if material == BRIGHT and not np.isfinite(levels.middle):
        return None
    # In contrasts above air.
    border = (levels.middle - levels.air) / levels.contrast
    limits = (-np.inf, border) if material == BASE else (border, np.inf)
    whole = groups.sum(axis=0)
    fit = _fit_powers(whole, limits, share, offset)
    without = [_fit_powers(whole - group, limits, share, offset) for group in groups if fit is not None]
    others = [other for other in without if other is not None]
    if fit is None or len(others) < 3:
        return None
    power, single = fit
    error = float(_jackknife_errors(np.array([[_loss_percent(p)] for p, _ in others]))[0])
    left_out = np.array([depths for _, depths in others])
    is_valid = np.isfinite(single) & np.isfinite(left_out).all(axis=0)
    if np.count_nonzero(is_valid) >= 2:
        # A true cupping is the same at every depth; a coating that is thinner in the middle is not. Depths do not err
        # alike by chance only: what they scatter beyond the jackknife is an error of their mean.
        each, se = 100.0 * single[is_valid], np.maximum(100.0 * _jackknife_errors(left_out[:, is_valid]), 1e-3)
        w = 1.0 / se**2
        mean = float(np.sum(w * each) / w.sum())
        between = float(np.mean((each - mean) ** 2 - se**2))
        error = float(np.sqrt(error**2 + max(between, 0.0)))
    return _Fit(power, _loss_percent(power), error)


def _fit_powers(histogram: Counts, limits: Pair, share: Floats, offset: Floats) -> tuple[float, Floats] | None:
    """Fit 1 + p share² to the grey, less ``offset``, of a material at each depth; give p, and p of each depth alone."""
    low, high = limits
    rows = histogram.reshape(-1, histogram.shape[-1]).astype(np.float64)
    greys = rows * (GREYS[:-1] + 0.5 * (GREYS[1] - GREYS[0]))
    count, total = (np.pad(np.cumsum(r, axis=1), ((0, 0), (1, 0))) for r in (rows, greys))
    depths = histogram.shape[1]
    t, offset = np.repeat(np.minimum(share, 1.0) ** 2, depths), np.repeat(offset, depths)
    depth = np.tile(np.arange(depths), COARSE)
    # Depths at which base and coating meet: there the least shift of a face changes the grey.
    border = (low if np.isfinite(low) else high) * np.ones(len(rows))
    whole = lower = np.bincount(depth, count[:, -1])
    if np.isfinite(border[0]):
        lower = np.bincount(depth, _sum_between(count, -np.inf * border, border))
    mixed = np.minimum(lower, whole - lower) > 0.05 * whole  # of the voxels of a depth may be of the other material
    power = 0.0
    used, grey, n = np.zeros(len(rows), bool), np.zeros(len(rows)), np.zeros(len(rows))
    for _ in range(40):  # of sorting and fitting
        curve = 1.0 + power * t
        n, grey = (_sum_between(sums, low * curve + offset, high * curve + offset) for sums in (count, total))
        grey = grey / np.maximum(n, 1.0) - offset
        # A depth has to be there at many radii, or its level cannot be separated from the trend.
        used = (n > 0.02 * n.max()) & ~mixed[depth]
        used &= (np.bincount(depth, used, depths) >= _LEAST_RADII)[depth]
        if n.sum() < 3000 or not used.any():  # of a material
            return None
        level = np.bincount(depth, np.where(used, n * grey / curve, 0.0), depths)
        level /= np.maximum(np.bincount(depth, np.where(used, n, 0.0), depths), 1.0)
        if level[depth[used]].min() <= 0:
            return None
        step = _power_step(level, depth[used], curve[used], t[used], grey[used], n[used])
        power = min(max(power + step, -0.5), 1.0)
        if abs(step) < 1e-5:
            break
    return power, np.array([_power_of_depth(t, grey, n, used & (depth == d)) for d in range(depths)])


def _power_step(level: Floats, depth: Counts, curve: Floats, t: Floats, grey: Floats, n: Floats) -> float:
    """Change of the power by which the greys follow from the levels best."""
    # grey = (level + its change) (curve + change of the power), to first order. A second power costs more in noise than
    # a beam hardened by a sheet of paper has.
    design = np.zeros((grey.size, level.size + 1))
    design[np.arange(grey.size), depth] = curve
    design[:, -1] = level[depth] * t
    root = np.sqrt(n)
    residual = grey - level[depth] * curve
    return float(np.linalg.lstsq(design * root[:, None], residual * root, rcond=None)[0][-1])


def _power_of_depth(t: Floats, grey: Floats, n: Floats, chosen: Bools) -> float:
    """Fit the power of one depth alone; NaN where it has no grey."""
    if not chosen.any():
        return np.nan
    line = np.polynomial.polynomial.polyfit(t[chosen], grey[chosen], 1, w=np.sqrt(n[chosen]))
    return line[1] / line[0] if line[0] > 0 else np.nan


def _sum_between(running: Floats, low: Floats, high: Floats) -> Floats:
    """Sum of each row of the histogram between two greys."""
    rows = np.arange(len(running))

    def upto(grey: Floats) -> Floats:
        x = np.clip((grey - GREYS[0]) / (GREYS[1] - GREYS[0]), 0.0, GREYS.size - 1.0)
        i = np.minimum(x.astype(np.int64), GREYS.size - 2)
        return running[rows, i] * (1 - (x - i)) + running[rows, i + 1] * (x - i)

    return upto(high) - upto(low)


def _join_materials(fits: list[_Fit]) -> tuple[_Fit, bool]:
    """Join the fits of base and coating to the one that is corrected; False where they contradict each other."""
    surest, *others = sorted(fits, key=lambda fit: fit.se)
    # A material whose error is three times that of the other does not count.
    if not others or others[0].se > 3.0 * max(surest.se, 0.3):
        return surest, True
    a, b = fits
    if abs(a.percent - b.percent) <= 3.0 * float(np.hypot(a.se, b.se)):  # standard errors by which they may differ
        w = 1.0 / np.maximum([a.se, b.se], 1e-3) ** 2
        power = float((w[0] * a.power + w[1] * b.power) / w.sum())
        return _Fit(power, _loss_percent(power), float(1.0 / np.sqrt(w.sum()))), True
    # What both share is corrected, and no more: the rest is the sheet's own.
    return min(fits, key=lambda fit: abs(fit.percent)), a.percent * b.percent > 0
