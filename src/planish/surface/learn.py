"""Learning from some columns what the fit has to know: grey levels, their spread, the blur, a phase-contrast fringe.

A staircase that is only blurred is nowhere darker than the air; a fringe makes the air beside the face darker than the
air farther away. Where that is not seen none is taken: an edge steeper than a Gaussian's may have other reasons.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import optimize

from planish.core.errors import VolumeError
from planish.core.robust import mad_sd
from planish.core.typing import Floats
from planish.surface import _fit_kernels
from planish.surface.coarse import CORE
from planish.surface.columns import FRINGE_PX, Columns, Edge, Guide, Priors, Side, Sides
from planish.surface.params import SurfaceParams
from planish.surface.sample import Sample, Sampler, Samples, most_cost
from planish.surface.survey import Survey

_WIDTHS = np.geomspace(0.35, 3.2, 14)  # blur along a column that is tried, in voxels
_THICK = 3.0  # widths of the blur: a thicker layer shows its own grey
_PLAIN, _PLAIN_SHARE = 5.5, 0.05  # widths of the blur, and share of columns: such a layer shows it beyond doubt
_TRACE = 0.15  # widths of the blur: a coating that is thinner in half of the columns is none
_COATING_RATIO = 1.25  # a layer is a coating when it stands out from the base by more than a quarter


def learn_priors(columns: Columns, guide: Guide, survey: Survey, params: SurfaceParams) -> Priors:
    """Learn the grey levels, the blur and the fringe from a sample of columns.

    Raises
    ------
    VolumeError
        If the core of the sheet does not stand out from the air.
    """
    sampler = Sampler(columns, guide, survey)
    learner = _Learner(sampler, survey, params)
    base, base_sd = learner.base(sampler.sample(high=True))
    sampler.calm(base)
    samples = {high: sampler.sample(high=high) for high in (True, False)}
    # Coarse profile per side: is there a coating, how bright, how much does it vary?
    sides = {high: learner.first_side(part, base, base_sd) for high, part in samples.items()}
    preset_fringe = 0.0 if isinstance(params.fringe, str) else params.fringe
    edge = Edge(width=learner.blur(samples, sides, preset_fringe), fringe=preset_fringe)
    has_fringe = params.fringe == "auto" and undershoots(sampler, samples, sides, edge)
    if has_fringe:
        edge, _ = with_fringe(sampler, samples, sides, edge, [])
    thin = [high for high in samples if learner.is_thin(samples[high], sides[high], edge)]
    if thin:
        quiet = sampler.quiet(samples, edge.width)
        edge, sides = (with_fringe if has_fringe else thin_levels)(sampler, quiet, sides, edge, thin)
    is_given = params.coating_grey is not None
    sides = {high: learner.narrowed(samples[high], sides[high], edge, is_given or high in thin) for high in samples}
    if is_given:
        sides = {high: learner.given_side(samples[high], side, edge, base) for high, side in sides.items()}
    return Priors(
        scale=sampler.scale, noise=sampler.noise, single_noise=sampler.single_noise, scatter=sampler.scatter,
        base=base, edge=edge, reach=sampler.reach, embedded_level=sampler.embedded_level, sides=sides,
    )  # fmt: skip


class _Learner:
    def __init__(self, sampler: Sampler, survey: Survey, params: SurfaceParams) -> None:
        self.sampler, self.params, self.survey = sampler, params, survey

    def base(self, sample: Sample) -> tuple[float, float]:
        """Level of the base above the air, and how much it varies from place to place."""
        shares = np.linspace(*CORE, 9)
        depth = np.rint(sample.outer[0][:, None] + (sample.other - sample.outer)[0][:, None] * shares).astype(int)
        core = np.take_along_axis(sample.grey[0], np.clip(depth, 0, self.sampler.depth - 1), axis=1).astype(np.float64)
        core = core[np.isfinite(core)]
        level = float(np.median(core))
        if level <= 0:
            raise VolumeError("The core of the sheet is not brighter than the air around it. Check --sheet-grey.")
        return level, float(np.sqrt(max(mad_sd(core) ** 2 - self.sampler.noise**2, (0.05 * level) ** 2)))

    def given_side(self, sample: Sample, side: Side, edge: Edge, base: float) -> Side:
        """Keep the coating whose grey was given where there is one."""
        thickness = self.sampler.fit(sample, side, edge)[1]
        if float(np.nanmedian(thickness)) > _TRACE * edge.width:
            return side
        level, spread = np.array([0.0, 0.0, 0.0, base]), np.array([0.0, 0.0, -1.0, side.spread[3]])
        return self.narrowed(sample, Side(level=level, spread=spread, coated=False), edge, is_given=True)

    def first_side(self, sample: Sample, base: float, base_sd: float) -> Side:
        """Look for a coating in the median profile below the face; wide spreads."""
        scale, embedded_level, reach = self.sampler.scale, self.sampler.embedded_level, self.sampler.reach
        if self.params.coating_grey is not None:
            grey = scale.polarity * (self.params.coating_grey - scale.air)
            if grey < 1.05 * base:
                raise VolumeError(
                    f"The coating's grey {self.params.coating_grey:g} does not stand out from the base "
                    f"({scale.polarity * base + scale.air:.4g}) on the side away from the air "
                    f"({scale.air:.4g}). Check --coating-grey."
                )
            return Side(
                level=np.array([0.0, 0.0, grey, base]),
                spread=np.array([0.0, 0.0, 0.02 * grey, max(base_sd, 0.25 * base)]), coated=True,
            )  # fmt: skip
        outer = sample.outer[0]
        start = np.array([
            _fit_kernels.nearest(g, e, reach, embedded_level) if embedded_level
            else _fit_kernels.outermost(g, max(int(e - reach), 0), int(e + reach) + 1, 0.5 * base)
            for g, e in zip(sample.grey[0], outer, strict=True)
        ])  # fmt: skip
        good = start > 0
        half = int(np.median(sample.other[0] - outer)) // 2
        inward = np.arange(max(half, 2))
        depth = np.clip(start[good][:, None] + inward, 0, self.sampler.depth - 1)
        profile = np.nanmedian(np.take_along_axis(sample.grey[0][good], depth, axis=1), axis=0)
        peak = float(profile[: max(2, int(0.8 * half))].max())
        solid = base + 1.28 * min(base_sd, 0.3 * base)
        is_separated = self.params.sheet_grey is not None or self.survey.surroundings == "material"
        coated = peak > _COATING_RATIO * (1.2 * solid if is_separated else solid)
        # Without a coating the third level is what lies outside: the air, unless the sheet was separated from other
        # material.
        outside = (1.0 if embedded_level else 0.5) * base if is_separated else -1.0
        level = np.array([0.0, 0.0, peak if coated else 0.0, base])
        wide = np.array([0.0, 0.0, 0.25 * peak if coated else outside, max(base_sd, 0.25 * base)])
        return Side(level=level, spread=wide, coated=coated)

    def blur(self, samples: Samples, sides: Sides, fringe: float) -> float:
        """Width of the blur in voxels: the one with which the staircase fits the sample best."""
        costs = np.zeros(_WIDTHS.size)
        for high, sample in samples.items():
            few = sample.thinned(4)
            edges = [Edge(width=float(width), fringe=fringe) for width in _WIDTHS]
            tried = [self.sampler.fit(few, sides[high], edge)[4] for edge in edges]
            most = min((most_cost(cost) for cost in tried if np.isfinite(cost).any()), default=0.0)
            for i, cost in enumerate(tried):
                finite_costs = cost[np.isfinite(cost)]
                # A blur so wide that it reaches the end of every column cannot be tried.
                costs[i] += float(np.mean(np.minimum(finite_costs, most))) if finite_costs.size else np.inf
        best = int(np.argmin(costs))
        if 0 < best < costs.size - 1 and np.isfinite(costs[best + 1]):
            a, b, c = costs[best - 1 : best + 2]
            shift = 0.5 * (a - c) / max(a - 2 * b + c, 1e-12)
            step = np.log(_WIDTHS[1] / _WIDTHS[0])
            return float(_WIDTHS[best] * np.exp(np.clip(shift, -1, 1) * step))
        return float(_WIDTHS[best])

    def is_thin(self, sample: Sample, side: Side, edge: Edge) -> bool:
        """Tell if no column shows the coating's own grey, because the blur reaches through all of it."""
        if not side.coated or self.params.coating_grey is not None:
            return False
        # With a grey that is too low the layer seems thicker and the blur narrower than they are, hence the margin.
        thick = self.sampler.fit(sample, side, edge)[1] * sample.tilt > _PLAIN * edge.width
        return float(np.mean(thick)) < _PLAIN_SHARE

    def narrowed(self, sample: Sample, side: Side, edge: Edge, is_given: bool) -> Side:
        """Narrow what is expected to what thick layers and the base below them show."""
        level, wide = side.level.copy(), side.spread.copy()
        for _ in range(2):
            fit = self.sampler.fit(sample, Side(level=level, spread=wide, coated=side.coated), edge)
            has_face = np.isfinite(fit[0])
            if side.coated and is_given:
                wide[2] = 0.02 * level[2]
            elif side.coated:
                thick = has_face & (fit[1] * sample.tilt > _THICK * edge.width)
                if np.count_nonzero(thick) < 50:  # columns that show it
                    thick = has_face & (fit[1] >= np.nanpercentile(fit[1], 75))
                level[2] = float(np.median(fit[2][thick]))
                wide[2] = max(1.2 * mad_sd(fit[2][thick]), 0.01 * level[2])
            level[3] = float(np.median(fit[3][has_face]))
            wide[3] = max(1.2 * mad_sd(fit[3][has_face]), 0.03 * level[3])
        return Side(level=level, spread=wide, coated=side.coated)


_NEAR = ((1.0, 2.0), (2.0, 3.2), (3.2, 4.8))  # from the face, in widths of the blur: where an undershoot may be seen
_BETWEEN = (4.8, 8.0)  # a fringe is over here; a streak along the sheet is not
_FAR = (8.0, 14.0)  # the air that it is compared with
_OVER = 0.4  # of the undershoot that may be left between
_SIGMAS = 4.5  # that tell the undershoot from chance
_LEAST = 0.0015  # of the contrast: what else may be wrong with the air
_FEW_COLUMNS, _ROWS = 8, 5  # columns of a row, and rows, that must show the air
_SMALLEST = 0.005  # fringe
_WINDOW = 1.3  # widths of the blur: the blur that is found may be wider than the one without a fringe
_LOOSE = 0.35  # logarithm of the fringe's width over the usual: where it shows little it is the usual
_TRIALS, _THIN_TRIALS = 90, 80  # of the searches
_SHARES = (0.0, 0.2, 0.45)  # logarithm of a thin coating's grey over the brightest that was seen
_THIN_SHARES = (0.0, 0.15, 0.3, 0.45, 0.6, 0.75)  # the same where there is no fringe


def undershoots(sampler: Sampler, samples: Samples, sides: Sides, edge: Edge) -> bool:
    """Tell if the air beside the faces is darker than the air farther away.

    The blur with which the faces are found need not be more than roughly right.
    """
    if sampler.embedded_level:
        return False  # what lies beside is no air
    depths = [_undershoot_depth(sampler, samples[high], sides[high], edge) for high in samples]
    means, errors = (np.stack(a) for a in zip(*map(_mean_error, depths), strict=True))
    # Sides whose contrast differs are weighted by what their rows' scatter tells.
    weight = np.where(np.isfinite(means) & (errors > 0), 1.0 / np.maximum(errors, 1e-12) ** 2, 0.0)
    total = weight.sum(axis=0)
    if not total.all():
        return False
    mean = np.sum(np.where(weight > 0, weight * means, 0.0), axis=0) / total
    near, between = mean[:-1], mean[-1]
    dark = (near < -_LEAST) & (near < -_SIGMAS / np.sqrt(total[:-1])) & (between > _OVER * near)
    return bool(dark.any())


def _mean_error(depth: Floats) -> tuple[Floats, Floats]:
    """Mean over the rows and its standard error; NaN where too few rows are known."""
    count = np.isfinite(depth).sum(axis=1)
    reliable = np.where(count[:, None] >= _ROWS, depth, 0.0)
    mean, sd = np.nanmean(reliable, axis=1), np.nanstd(reliable, axis=1)
    return np.where(count >= _ROWS, mean, np.nan), sd / np.sqrt(np.maximum(count - 1, 1))


def _undershoot_depth(sampler: Sampler, sample: Sample, side: Side, edge: Edge) -> Floats:
    """Mean grey of the air near the faces above that farther away, as a share of the contrast, (distances, rows)."""
    face = sampler.fit(sample, side, edge)[0, 0]
    unit = max(edge.width, 1.0)
    contrast = side.level[2] if side.coated else side.level[3]
    first = np.where(np.isfinite(face), face - unit * _FAR[1] / sample.tilt[0], 0.0).astype(int)
    most = int(np.ceil(unit * _FAR[1] / float(sample.tilt.min()))) + 2
    depth = first[:, None] + np.arange(most)
    inside = (depth >= 0) & (depth < sample.grey.shape[2])
    grey = np.take_along_axis(sample.grey[0], np.where(inside, depth, 0), axis=1)
    away = (face[:, None] - depth) * sample.tilt[0][:, None] / unit
    # What floats in the air is left out.
    air = inside & (np.abs(grey) < 5.0 * sampler.scatter)
    rows = int(sample.row.max()) + 1
    row = np.broadcast_to(sample.row[0][:, None], grey.shape)

    def mean(first: float, last: float) -> Floats:
        use = air & (away >= first) & (away < last)
        count = np.bincount(row[use], minlength=rows)
        total = np.bincount(row[use], weights=grey[use], minlength=rows)
        return np.where(count >= _FEW_COLUMNS, total / np.maximum(count, 1), np.nan)

    far = mean(*_FAR)
    return np.stack([mean(*reach) - far for reach in (*_NEAR, _BETWEEN)]) / contrast


def with_fringe(sampler: Sampler, samples: Samples, sides: Sides, edge: Edge, thin: list[bool]) -> tuple[Edge, Sides]:
    """Blur and fringe, and greys of coatings that are nowhere thick, with which the staircase fits the sample best.

    The edge is returned as it came where the best has no fringe.
    """
    subset = {high: sample.thinned(3 if thin else 4) for high, sample in samples.items()}
    misfit = _misfit(sampler, subset, sides, edge, _WINDOW * max(edge.width, 1.0))

    def trial_of(vector: Floats) -> tuple[Edge, Sides]:
        edge_of_trial = Edge(
            width=edge.width * float(np.exp(vector[0])), fringe=max(float(vector[1]), 0.0),
            fringe_width=FRINGE_PX * float(np.exp(vector[2])),
        )  # fmt: skip
        return edge_of_trial, _brighter(sides, thin, vector[3:])

    def cost(vector: Floats) -> float:
        loose = (float(vector[2]) / _LOOSE) ** 2 + float(np.sum(vector[3:] ** 2))
        return misfit(*trial_of(vector)) + 1e-4 * loose + max(-float(vector[1]), 0.0)

    steps = np.diag([0.1, 0.08, 0.25] + [0.1] * len(thin))
    starts = [np.array([0.1, 0.1, 0.0] + [share] * len(thin)) for share in (_SHARES if thin else (0.0,))]
    best = min((_simplex(cost, start, steps, _TRIALS) for start in starts), key=lambda optimum: optimum[0])[1]
    fitted, brighter = trial_of(best)
    return (fitted, brighter) if fitted.fringe > _SMALLEST else (edge, sides)


def thin_levels(sampler: Sampler, samples: Samples, sides: Sides, edge: Edge, thin: list[bool]) -> tuple[Edge, Sides]:
    """Blur, and greys of coatings that are nowhere thick, with which the staircase fits the sample best.

    Grey and thickness of one thin layer can hardly be separated; the shape of many profiles helps a little.
    """
    subset = {high: sample.thinned(3) for high, sample in samples.items()}
    misfit = _misfit(sampler, subset, sides, edge, _WINDOW * edge.width)

    def trial_of(vector: Floats) -> tuple[Edge, Sides]:
        return replace(edge, width=edge.width * float(np.exp(vector[0]))), _brighter(sides, thin, vector[1:])

    def cost(vector: Floats) -> float:
        # A layer's grey is seldom far from the brightest that was seen of it.
        return misfit(*trial_of(vector)) + 1e-4 * float(np.sum(vector**2))

    def with_width(share: float) -> tuple[float, Floats]:
        """Best width for coatings that are so much brighter."""

        def cost_of_width(log_width: float) -> float:
            return cost(np.array([log_width, *[share] * len(thin)]))

        best = optimize.minimize_scalar(cost_of_width, bounds=(-0.2, 0.6), method="bounded", options={"xatol": 0.01})
        return float(best.fun), np.array([float(best.x), *[share] * len(thin)])

    # Brighter layers with a wider blur look nearly the same: the search goes along that valley first.
    _, start = min((with_width(share) for share in _THIN_SHARES), key=lambda optimum: optimum[0])
    along = np.array([0.03, *[0.08] * len(thin)])
    steps = np.vstack([along, np.diag(np.where(np.arange(along.size) > 0, 0.08, 0.03))[1:]])
    return trial_of(_simplex(cost, start, steps, _THIN_TRIALS)[1])


def _misfit(
    sampler: Sampler, subset: Samples, sides: Sides, edge: Edge, window: float
) -> Callable[[Edge, Sides], float]:
    """Return the cost of a column, in the mean of both sides, as a function of the edge and the sides."""
    size = max(sum(s.outer.size for s in subset.values()), 1)
    most = {high: most_cost(sampler.fit(sample, sides[high], edge, window)[4]) for high, sample in subset.items()}

    def misfit(edge_of_trial: Edge, sides_of_trial: Sides) -> float:
        total = 0.0
        for high, sample in subset.items():
            cost = sampler.fit(sample, sides_of_trial[high], edge_of_trial, window)[4]
            total += float(np.sum(np.where(np.isfinite(cost), np.minimum(cost, most[high]), most[high])))
        return total / size

    return misfit


def _brighter(sides: Sides, thin: list[bool], shares: Floats) -> Sides:
    """Return the sides with the greys of thin coatings multiplied by exp(share)."""
    brighter = dict(sides)
    for high, share in zip(thin, shares, strict=True):
        brighter[high] = sides[high].brighter(float(np.exp(share)))
    return brighter


def _simplex(cost: Callable[[Floats], float], start: Floats, steps: Floats, trials: int) -> tuple[float, Floats]:
    """Lowest cost that Nelder and Mead's method finds, and where."""
    optimum = optimize.minimize(
        cost, start, method="Nelder-Mead",
        options={"initial_simplex": np.vstack([start, start + steps]), "xatol": 2e-3, "fatol": 1e-7, "maxfev": trials},
    )  # fmt: skip
    return float(optimum.fun), np.asarray(optimum.x, dtype=np.float64)
