"""Cupping: the sheet's grey above air, as a factor that is linear in the square of the radius.

Base and coating are each compared with themselves at one depth, from histograms: their border moves
with the factor.
"""

import math
from typing import NamedTuple

import numpy as np

from planish.core.robust import running_sums
from planish.core.typing import Floats, Pair
from planish.correct.params import Cupping, Trend, Trends
from planish.correct.sums import (
    BASE,
    BRIGHT,
    COARSE,
    GREY_STEP,
    GREYS,
    MATERIALS,
    Counts,
    Levels,
    Sums,
    Turning,
)

_LEAST_RADII = 8
_CLEAR = 3.0  # standard errors
_LOWEST = 0.5  # per cent: what is less does not matter
_TOO_FEW = "Cupping: too few voxels lie inside the sheet, nothing was corrected."


class _Fit(NamedTuple):
    """Factor on the square of the share of the reach that one material shows.

    Also the loss it means, and its error.
    """

    coefficient: float
    percent: float
    se: float


def _jackknife_errors(estimates: Floats) -> Floats:
    """Standard errors (...,) from values (group, ...) with each group left out."""
    n = len(estimates)
    squares = (estimates - estimates.mean(axis=0)) ** 2
    variance = (n - 1) / n * np.sum(squares, axis=0)
    return np.sqrt(variance)


def _loss_percent(coefficient: float) -> float:
    """Loss of grey in the middle against the largest radius, by the coefficient of the factor."""
    return 100.0 * (1.0 - 1.0 / max(1.0 + coefficient, 1e-3))


def factor(powers: tuple[float, ...], share: Floats) -> Floats:
    """Factor on the grey above air at a share of the reach, 1 in the middle.

    Constant beyond the reach.

    Examples
    --------
    >>> factor((0.1,), np.array([0.0, 0.5, 1.0, 2.0])).tolist()
    [1.0, 1.025, 1.1, 1.1]
    """
    return 1.0 + powers[0] * np.minimum(share, 1.0) ** 2


def find_cupping(
    sums: Sums, turning: Turning, levels: Levels, rings: Floats
) -> tuple[Cupping | None, Trends, str]:
    """Find the factor that base and coating share, each material's trend, and what to say of it.

    ``rings`` (bin,) are still in the volume, as a share of the contrast: no part of the trend. The
    factor is None where it is not beyond its error, or the materials contradict each other.
    """
    # Of blocks along the axis and quarters of the turn: (group, radius, depth, grey).
    histograms = sums.histogram.reshape(-1, *sums.histogram.shape[2:])
    histograms = histograms[histograms.sum(axis=(1, 2, 3)) > 0]
    voxel_counts = histograms.sum(axis=(0, 2, 3))
    least_count = 0.002 * max(voxel_counts.max(), 1)
    radius_bins = np.flatnonzero(voxel_counts > least_count)
    if radius_bins.size < _LEAST_RADII:
        return None, (), _TOO_FEW
    # The largest radius at which there is some sheet.
    reach_um = float((radius_bins[-1] + 1) * turning.farthest_um / COARSE)
    # Mean height of the rings over the sheet's voxels at each radius of the histogram.
    sheet_counts = sums.count[:, :, BASE:].sum(axis=(0, 1, 2))
    radius_um = (np.arange(rings.size) + 0.5) * turning.step_um
    coarse_bin = turning.coarse_bins(radius_um)
    weights = np.maximum(np.bincount(coarse_bin, sheet_counts, COARSE), 1.0)
    offset = np.bincount(coarse_bin, sheet_counts * rings, COARSE) / weights
    share = turning.coarse_um / reach_um
    fits: list[_Fit] = []
    trends: Trends = ()
    for material in (BASE, BRIGHT):
        fit = _fit_material(histograms, material, levels, share, offset)
        if fit is not None:
            fits.append(fit)
            trend = Trend(material=MATERIALS[material], before=fit.percent, se=fit.se)
            trends += (trend,)
    if not fits:
        return None, (), _TOO_FEW
    shared, is_agreed = _join_materials(fits)
    losses = ", ".join(f"{t.material} {t.before:.1f} +- {t.se:.1f} %" for t in trends)
    why = ""
    if not is_agreed:
        why = "base and coating contradict each other"
    elif abs(shared.percent) < max(_CLEAR * shared.se, _LOWEST):
        why = "no trend against the radius beyond its error"
    if why:
        return None, trends, f"Cupping: {why} ({losses}), nothing was corrected."
    powers = (shared.coefficient,)
    cupping = Cupping(percent=shared.percent, se=shared.se, powers=powers, reach_um=reach_um)
    text = f"Cupping: {shared.percent:.1f} +- {shared.se:.1f} % in the middle corrected ({losses})."
    return cupping, trends, text


def middle_factor(sums: Sums, turning: Turning, cupping: Cupping) -> float:
    """Mean of the factor over the sheet's voxels.

    Divided by it, the correction keeps the sheet's mean grey.
    """
    voxel_counts = sums.histogram.sum(axis=(0, 1, 3, 4))
    factors = factor(cupping.powers, turning.coarse_um / cupping.reach_um)
    total = np.sum(voxel_counts * factors)
    return float(total / max(voxel_counts.sum(), 1))


def _fit_material(
    histograms: Counts, material: int, levels: Levels, share: Floats, offset: Floats
) -> _Fit | None:
    """Fit the factor of one material; None where there are too few of its voxels.

    ``histograms`` (group, radius, depth, grey); ``share`` and ``offset`` (radius,): the radius over
    the reach, and the mean height of the rings there, in contrasts. Its error is that of the groups
    left out one by one, and of depths that contradict each other.
    """
    if material == BRIGHT and not np.isfinite(levels.middle):
        return None
    border_grey = (levels.middle - levels.air) / levels.contrast  # In contrasts above air.
    limits = (-np.inf, border_grey) if material == BASE else (border_grey, np.inf)
    total_histogram = histograms.sum(axis=0)
    full_fit = _fit_coefficients(total_histogram, limits, share, offset)
    if full_fit is None:
        return None
    losses: list[float] = []
    replicates: list[Floats] = []
    for histogram in histograms:
        fit = _fit_coefficients(total_histogram - histogram, limits, share, offset)
        if fit is not None:
            losses.append(_loss_percent(fit[0]))
            replicates.append(fit[1])
    if len(losses) < 3:
        return None
    coefficient, depth_coefficients = full_fit
    loss_se = _jackknife_errors(np.array(losses))
    depth_variance = _variance_of_depths(depth_coefficients, np.array(replicates))
    se = math.sqrt(loss_se**2 + depth_variance)
    return _Fit(coefficient, _loss_percent(coefficient), se)


def _variance_of_depths(coefficients: Floats, replicates: Floats) -> float:
    """Variance of the losses of the depths, in per cent, beyond what the jackknife says of them.

    A true cupping is the same at every depth; a coating that is thinner in the middle is not.
    Depths do not err alike by chance only: what they scatter is an error of their mean.
    ``coefficients`` (depth,) of all voxels, ``replicates`` (group, depth) with each group left out;
    NaN where a depth has no grey.
    """
    is_valid = np.isfinite(coefficients) & np.isfinite(replicates).all(axis=0)
    if np.count_nonzero(is_valid) < 2:
        return 0.0
    losses = 100.0 * coefficients[is_valid]
    se = 100.0 * _jackknife_errors(replicates[:, is_valid])
    variance = np.maximum(se, 1e-3) ** 2
    w = 1.0 / variance
    mean_loss = np.sum(w * losses) / w.sum()
    excess_variance = np.mean((losses - mean_loss) ** 2 - variance)
    return max(float(excess_variance), 0.0)


def _fit_coefficients(
    histogram: Counts, limits: Pair, share: Floats, offset: Floats
) -> tuple[float, Floats] | None:
    """Fit 1 + p share² to the grey, less ``offset``, of a material at each depth.

    Give p, and p of each depth alone; None where there is too little of the material.
    ``histogram`` (radius, depth, grey); the material has the greys between ``limits`` in the
    middle, in contrasts above air, and its borders move with the factor.
    """
    low, high = limits
    n_depths, n_greys = histogram.shape[1:]
    # A row for each radius and depth.
    row_counts = histogram.reshape(-1, n_greys)
    row_sums = row_counts * (GREYS[:-1] + 0.5 * GREY_STEP)
    total_counts = running_sums(row_counts)
    total_greys = running_sums(row_sums)
    t = np.repeat(np.minimum(share, 1.0) ** 2, n_depths)
    offset = np.repeat(offset, n_depths)
    depth = np.tile(np.arange(n_depths), COARSE)
    # Depths at which base and coating meet: there the least shift of a face changes the grey.
    border_grey = np.full(len(row_counts), low if np.isfinite(low) else high)
    depth_counts = lower_counts = np.bincount(depth, total_counts[:, -1])
    if np.isfinite(border_grey[0]):
        lower_counts = np.bincount(depth, _sum_below(total_counts, border_grey))
    # Share of one material.
    is_mixed = np.minimum(lower_counts, depth_counts - lower_counts) > 0.05 * depth_counts
    coefficient = 0.0
    is_used = np.zeros(len(row_counts), bool)
    grey = np.zeros(len(row_counts))
    n = np.zeros(len(row_counts))
    for _ in range(40):  # of sorting and fitting
        factors = 1.0 + coefficient * t
        borders = (low * factors + offset, high * factors + offset)
        n = _sum_between(total_counts, *borders)
        grey = _sum_between(total_greys, *borders) / np.maximum(n, 1.0) - offset
        # A depth has to be there at many radii, or its level cannot be separated from the trend.
        is_used = (n > 0.02 * n.max()) & ~is_mixed[depth]
        radius_counts = np.bincount(depth, is_used, n_depths)
        is_used &= radius_counts[depth] >= _LEAST_RADII
        if n.sum() < 3000 or not is_used.any():  # of a material
            return None
        used_n = np.where(is_used, n, 0.0)
        depth_n = np.bincount(depth, used_n, n_depths)
        level = np.bincount(depth, used_n * grey / factors, n_depths) / np.maximum(depth_n, 1.0)
        if level[depth[is_used]].min() <= 0:
            return None
        step = _coefficient_step(level, depth, factors, t, grey, used_n)
        coefficient = min(max(coefficient + step, -0.5), 1.0)
        if abs(step) < 1e-5:
            break
    depths: list[float] = []
    for k in range(n_depths):
        is_of_depth = is_used & (depth == k)
        depths.append(_depth_coefficient(t[is_of_depth], grey[is_of_depth], n[is_of_depth]))
    return coefficient, np.array(depths)


def _coefficient_step(
    level: Floats, depth: Counts, factors: Floats, t: Floats, grey: Floats, n: Floats
) -> float:
    """Change of the coefficient that fits the greys better, with a change of each depth's level.

    ``level`` (depth,); the others of each row: number of its depth, factor, share², grey, and the
    voxels that count.
    """
    # grey = (level + its change) (factor + change of the coefficient t), to first order. A second
    # power costs more in noise than a beam hardened by a sheet of paper has.
    design = np.zeros((grey.size, level.size + 1))
    design[np.arange(grey.size), depth] = factors
    design[:, -1] = level[depth] * t
    sqrt_n = np.sqrt(n)
    residual = grey - level[depth] * factors
    weighted_design = design * sqrt_n[:, None]
    solution = np.linalg.lstsq(weighted_design, residual * sqrt_n, rcond=None)[0]
    return float(solution[-1])


def _depth_coefficient(t: Floats, grey: Floats, n: Floats) -> float:
    """Fit the coefficient of one depth alone; NaN where it has no grey."""
    if not t.size:
        return np.nan
    level, slope = np.polynomial.polynomial.polyfit(t, grey, 1, w=np.sqrt(n))
    return slope / level if level > 0 else np.nan


def _sum_between(running_sum: Floats, low: Floats, high: Floats) -> Floats:
    return _sum_below(running_sum, high) - _sum_below(running_sum, low)


def _sum_below(running_sum: Floats, grey: Floats) -> Floats:
    """Sum of each row (row,) up to a grey (row,), linear within a bin of the histogram."""
    rows = np.arange(len(running_sum))
    last = GREYS.size - 1
    x = np.clip((grey - GREYS[0]) / GREY_STEP, 0.0, last)
    i = np.minimum(x.astype(np.int64), last - 1)
    part = x - i
    lower = running_sum[rows, i]
    upper = running_sum[rows, i + 1]
    return lower * (1 - part) + upper * part


def _join_materials(fits: list[_Fit]) -> tuple[_Fit, bool]:
    """Join the fits of base and coating to the one that is corrected.

    ``fits`` are one or two. The surer counts alone where the error of the other is three times as
    large; their weighted mean is taken where they differ by no more than their errors; else the
    lesser, and False where one is a loss and the other a gain: they contradict each other.
    """
    surest_fit, *other_fits = sorted(fits, key=lambda fit: fit.se)
    # A material whose error is three times that of the other does not count.
    if not other_fits or other_fits[0].se > 3.0 * max(surest_fit.se, 0.3):
        return surest_fit, True
    a, b = fits
    # Standard errors by which they may differ.
    if abs(a.percent - b.percent) <= 3.0 * math.hypot(a.se, b.se):
        w = 1.0 / np.maximum([a.se, b.se], 1e-3) ** 2
        mean = np.average([a.coefficient, b.coefficient], weights=w)
        coefficient = float(mean)
        se = 1.0 / math.sqrt(w.sum())
        return _Fit(coefficient, _loss_percent(coefficient), se), True
    # What both share is corrected, and no more: the rest is the sheet's own.
    lower_fit = min(fits, key=lambda fit: abs(fit.percent))
    return lower_fit, a.percent * b.percent > 0
