"""Learning from some columns what the fit has to know: grey levels, their spread, the blur, a phase-contrast fringe.

Only a fringe makes the air beside the face darker than the air farther away; where that is not seen none is taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

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
_PLAIN, _PLAIN_SHARE = 5.5, 0.05  # widths of the blur, and share of columns: such a layer shows its grey beyond doubt


def learn_priors(columns: Columns, guide: Guide, survey: Survey, params: SurfaceParams) -> Priors:
    """Learn the grey levels, the blur and the fringe from a sample of columns.

    Raises
    ------
    VolumeError
        If the core of the sheet does not stand out from the air.
    """
    learner = _Learner(columns, guide, survey)
    base, base_sd = learner.base(learner.sample(high=True))
    learner.calm(base)
    samples = {high: learner.sample(high=high) for high in (True, False)}
    # Coarse profile per side: is there a coating, how bright, how much does it vary?
    is_separated = params.sheet_grey is not None or survey.surroundings == "material"
    if params.coating_grey is None:
        sides = {high: learner.first_side(part, base, base_sd, is_separated) for high, part in samples.items()}
    else:
        sides = dict.fromkeys(samples, learner.preset_side(params.coating_grey, base, base_sd))
    preset_fringe = 0.0 if isinstance(params.fringe, str) else params.fringe
    edge = Edge(width=learner.blur(samples, sides, preset_fringe), fringe=preset_fringe)
    has_fringe = params.fringe == "auto" and learner.undershoots(samples, sides, edge)
    if has_fringe:
        edge, _ = learner.with_fringe(samples, sides, edge, [])
    is_preset = params.coating_grey is not None
    thin = [] if is_preset else [high for high in samples if learner.is_thin(samples[high], sides[high], edge)]
    if thin:
        search = learner.with_fringe if has_fringe else learner.thin_levels
        edge, sides = search(learner.quiet(samples, edge.width), sides, edge, thin)
    narrow: Sides = {}
    for high, sample in samples.items():
        side = learner.narrowed(sample, sides[high], edge, is_preset or high in thin)
        # A coating of a grey that was set is none where it is thinner than this in half of the columns.
        if is_preset and not float(np.nanmedian(learner.fit(sample, side, edge)[1])) > 0.15 * edge.width:
            level, spread = np.array([0.0, 0.0, 0.0, base]), np.array([0.0, 0.0, -1.0, side.spread[3]])
            side = learner.narrowed(sample, Side(level=level, spread=spread, coated=False), edge, True)
        narrow[high] = side
    return Priors(
        scale=learner.scale, noise=learner.noise, single_noise=learner.single_noise, scatter=learner.scatter,
        base=base, edge=edge, reach=learner.reach, embedded_level=learner.embedded_level, sides=narrow,
    )  # fmt: skip


_NEAR = ((1.0, 2.0), (2.0, 3.2), (3.2, 4.8))  # from the face, in widths of the blur: where an undershoot may be seen
_BETWEEN = (4.8, 8.0)  # a fringe is over here; a streak along the sheet is not
_FAR = (8.0, 14.0)  # the air that it is compared with
_SIGMAS = 4.5  # that tell the undershoot from chance
_LEAST = 0.0015  # of the contrast: what else may be wrong with the air
_FEW_COLUMNS, _ROWS = 8, 5  # columns of a row, and rows, that must show the air
_WINDOW = 1.3  # widths of the blur: the blur that is found may be wider than the one without a fringe


class _Learner(Sampler):
    """Learns the staircase from sample columns."""

    def base(self, sample: Sample) -> tuple[float, float]:
        """Level of the base above the air, and how much it varies from place to place."""
        shares = np.linspace(*CORE, 9)
        depth = np.rint(sample.outer[0][:, None] + (sample.other - sample.outer)[0][:, None] * shares).astype(int)
        last = sample.grey.shape[2] - 1
        core = np.take_along_axis(sample.grey[0], np.clip(depth, 0, last), axis=1).astype(np.float64)
        core = core[np.isfinite(core)]
        level = float(np.median(core))
        if level <= 0:
            raise VolumeError("The core of the sheet is not brighter than the air around it. Check --sheet-grey.")
        return level, float(np.sqrt(max(mad_sd(core) ** 2 - self.noise**2, (0.05 * level) ** 2)))

    def preset_side(self, coating_grey: float, base: float, base_sd: float) -> Side:
        """Take the grey of the coating as it was set."""
        scale = self.scale
        grey = scale.polarity * (coating_grey - scale.air)
        if grey < 1.05 * base:
            raise VolumeError(
                f"The coating's grey {coating_grey:g} does not stand out from the base "
                f"({scale.polarity * base + scale.air:.4g}) on the side away from the air ({scale.air:.4g}). Check "
                "--coating-grey."
            )
        spread = np.array([0.0, 0.0, 0.02 * grey, max(base_sd, 0.25 * base)])
        return Side(level=np.array([0.0, 0.0, grey, base]), spread=spread, coated=True)

    def first_side(self, sample: Sample, base: float, base_sd: float, is_separated: bool) -> Side:
        """Look for a coating in the median profile below the face; wide spreads."""
        grey, outer, reach, level = sample.grey[0], sample.outer[0], self.reach, self.embedded_level
        start = np.array([
            _fit_kernels.nearest(g, e, reach, level) if level
            else _fit_kernels.outermost(g, max(int(e - reach), 0), int(e + reach) + 1, 0.5 * base)
            for g, e in zip(grey, outer, strict=True)
        ])  # fmt: skip
        good = start > 0
        half = int(np.median(sample.other[0] - outer)) // 2
        depth = np.clip(start[good][:, None] + np.arange(max(half, 2)), 0, grey.shape[1] - 1)
        profile = np.nanmedian(np.take_along_axis(grey[good], depth, axis=1), axis=0)
        peak = float(profile[: max(2, int(0.8 * half))].max())
        solid = base + 1.28 * min(base_sd, 0.3 * base)
        # A layer is a coating when it stands out from the base by more than a quarter.
        coated = peak > 1.25 * (1.2 * solid if is_separated else solid)
        # Without a coating the third level is what lies outside: the air, unless the sheet was separated from other
        # material.
        outside = (1.0 if level else 0.5) * base if is_separated else -1.0
        spread = np.array([0.0, 0.0, 0.25 * peak if coated else outside, max(base_sd, 0.25 * base)])
        return Side(level=np.array([0.0, 0.0, peak if coated else 0.0, base]), spread=spread, coated=coated)

    def blur(self, samples: Samples, sides: Sides, fringe: float) -> float:
        """Width of the blur in voxels: the one with which the staircase fits the sample best."""
        costs = np.zeros(_WIDTHS.size)
        for high, sample in samples.items():
            few = sample.thinned(4)
            edges = [Edge(width=float(width), fringe=fringe) for width in _WIDTHS]
            fits = [self.fit(few, sides[high], edge)[4] for edge in edges]
            finite_costs = [cost[np.isfinite(cost)] for cost in fits]
            most = min((most_cost(cost) for cost in finite_costs if cost.size), default=0.0)
            # A blur so wide that it reaches the end of every column cannot be tried.
            costs += [float(np.mean(np.minimum(cost, most))) if cost.size else np.inf for cost in finite_costs]
        best = int(np.argmin(costs))
        if 0 < best < costs.size - 1 and np.isfinite(costs[best + 1]):
            a, b, c = costs[best - 1 : best + 2]
            shift = 0.5 * (a - c) / max(a - 2 * b + c, 1e-12)
            return float(_WIDTHS[best] * np.exp(np.clip(shift, -1, 1) * np.log(_WIDTHS[1] / _WIDTHS[0])))
        return float(_WIDTHS[best])

    def is_thin(self, sample: Sample, side: Side, edge: Edge) -> bool:
        """Tell if no column shows the coating's own grey, because the blur reaches through all of it."""
        if not side.coated:
            return False
        # With a grey that is too low the layer seems thicker and the blur narrower than they are, hence the margin.
        thick = self.fit(sample, side, edge)[1] * sample.tilt > _PLAIN * edge.width
        return float(np.mean(thick)) < _PLAIN_SHARE

    def narrowed(self, sample: Sample, side: Side, edge: Edge, is_preset: bool) -> Side:
        """Narrow what is expected to what thick layers and the base below them show."""
        level, spread = side.level.copy(), side.spread.copy()
        for _ in range(2):
            fit = self.fit(sample, Side(level=level, spread=spread, coated=side.coated), edge)
            has_face = np.isfinite(fit[0])
            if side.coated and is_preset:
                spread[2] = 0.02 * level[2]
            elif side.coated:
                thick = has_face & (fit[1] * sample.tilt > 3.0 * edge.width)  # shows its own grey
                if np.count_nonzero(thick) < 50:
                    thick = has_face & (fit[1] >= np.nanpercentile(fit[1], 75))
                level[2] = float(np.median(fit[2][thick]))
                spread[2] = max(1.2 * mad_sd(fit[2][thick]), 0.01 * level[2])
            level[3] = float(np.median(fit[3][has_face]))
            spread[3] = max(1.2 * mad_sd(fit[3][has_face]), 0.03 * level[3])
        return Side(level=level, spread=spread, coated=side.coated)

    def undershoots(self, samples: Samples, sides: Sides, edge: Edge) -> bool:
        """Tell if the air beside the faces is darker than the air farther away.

        The blur with which the faces are found need not be more than roughly right.
        """
        if self.embedded_level:
            return False  # what lies beside is no air
        weight, total = [], []
        for high, sample in samples.items():
            depth = self._undershoot_depth(sample, sides[high], edge)
            count = np.isfinite(depth).sum(axis=1)
            depth = np.where(count[:, None] >= _ROWS, depth, 0.0)
            error = np.nanstd(depth, axis=1) / np.sqrt(np.maximum(count - 1, 1))
            # Sides whose contrast differs are weighted by what their rows' scatter tells.
            is_clear = (count >= _ROWS) & (error > 0)
            weight.append(np.where(is_clear, 1.0 / np.maximum(error, 1e-12) ** 2, 0.0))
            total.append(np.where(is_clear, weight[-1] * np.nanmean(depth, axis=1), 0.0))
        weights = np.sum(weight, axis=0)
        if not weights.all():
            return False
        mean = np.sum(total, axis=0) / weights
        near, between = mean[:-1], mean[-1]
        # No more than this share of the undershoot may be there in between.
        dark = (near < -_LEAST) & (near < -_SIGMAS / np.sqrt(weights[:-1])) & (between > 0.4 * near)
        return bool(dark.any())

    def _undershoot_depth(self, sample: Sample, side: Side, edge: Edge) -> Floats:
        """Grey of the air near the faces above that farther away, as a share of the contrast; (distances, rows)."""
        face = self.fit(sample, side, edge)[0, 0]
        unit, tilt = max(edge.width, 1.0), sample.tilt[0]
        first = np.where(np.isfinite(face), face - unit * _FAR[1] / tilt, 0.0).astype(int)
        depth = first[:, None] + np.arange(int(np.ceil(unit * _FAR[1] / float(tilt.min()))) + 2)
        inside = (depth >= 0) & (depth < sample.grey.shape[2])
        grey = np.take_along_axis(sample.grey[0], np.where(inside, depth, 0), axis=1)
        away = (face[:, None] - depth) * tilt[:, None] / unit
        # What floats in the air is left out.
        air = inside & (np.abs(grey) < 5.0 * self.scatter)
        rows = int(sample.row.max()) + 1
        row = np.broadcast_to(sample.row[0][:, None], grey.shape)

        def mean(first: float, last: float) -> Floats:
            use = air & (away >= first) & (away < last)
            count = np.bincount(row[use], minlength=rows)
            total = np.bincount(row[use], weights=grey[use], minlength=rows)
            return np.where(count >= _FEW_COLUMNS, total / np.maximum(count, 1), np.nan)

        far = mean(*_FAR)
        return np.stack([mean(*reach) - far for reach in (*_NEAR, _BETWEEN)]) / side.level[2 if side.coated else 3]

    def with_fringe(self, samples: Samples, sides: Sides, edge: Edge, thin: list[bool]) -> tuple[Edge, Sides]:
        """Blur and fringe, and greys of coatings that are nowhere thick, with which the staircase fits the sample best.

        The edge is returned as it came where the best has no fringe.
        """
        misfit = self._misfit(samples, sides, edge, thin, _WINDOW * max(edge.width, 1.0))

        def trial_of(vector: Floats) -> tuple[Edge, Sides]:
            width, fringe_width = edge.width * float(np.exp(vector[0])), FRINGE_PX * float(np.exp(vector[2]))
            fringed = Edge(width=width, fringe=max(float(vector[1]), 0.0), fringe_width=fringe_width)
            return fringed, _brighter(sides, thin, vector[3:])

        def cost(vector: Floats) -> float:
            # Where the width of the fringe shows little it is the usual one.
            loose = (float(vector[2]) / 0.35) ** 2 + float(np.sum(vector[3:] ** 2))
            return misfit(*trial_of(vector)) + 1e-4 * loose + max(-float(vector[1]), 0.0)

        steps = np.diag([0.1, 0.08, 0.25] + [0.1] * len(thin))
        # Logarithms of a thin coating's grey over the brightest that was seen.
        shares = (0.0, 0.2, 0.45) if thin else (0.0,)
        starts = [np.array([0.1, 0.1, 0.0] + [share] * len(thin)) for share in shares]
        best = min((_simplex(cost, start, steps, 90) for start in starts), key=lambda optimum: float(optimum.fun))
        fitted, brighter = trial_of(best.x)
        return (fitted, brighter) if fitted.fringe > 0.005 else (edge, sides)

    def thin_levels(self, samples: Samples, sides: Sides, edge: Edge, thin: list[bool]) -> tuple[Edge, Sides]:
        """Blur, and greys of coatings that are nowhere thick, with which the staircase fits the sample best.

        Grey and thickness of one thin layer can hardly be separated; the shape of many profiles helps a little.
        """
        misfit = self._misfit(samples, sides, edge, thin, _WINDOW * edge.width)

        def trial_of(vector: Floats) -> tuple[Edge, Sides]:
            return replace(edge, width=edge.width * float(np.exp(vector[0]))), _brighter(sides, thin, vector[1:])

        def cost(vector: Floats) -> float:
            # A layer's grey is seldom far from the brightest that was seen of it.
            return misfit(*trial_of(vector)) + 1e-4 * float(np.sum(vector**2))

        def cost_of_width(log_width: float, share: float) -> float:
            return cost(np.array([log_width, *[share] * len(thin)]))

        # Brighter layers with a wider blur look nearly the same: the search goes along that valley first.
        valley: dict[float, Any] = {
            share: optimize.minimize_scalar(
                cost_of_width, args=(share,), bounds=(-0.2, 0.6), method="bounded", options={"xatol": 0.01}
            )
            for share in (0.0, 0.15, 0.3, 0.45, 0.6, 0.75)
        }
        share = min(valley, key=lambda k: float(valley[k].fun))
        start = np.array([float(valley[share].x), *[share] * len(thin)])
        steps = np.diag([0.03, *[0.08] * len(thin)])
        steps[0, 1:] = 0.08
        return trial_of(_simplex(cost, start, steps, 80).x)

    def _misfit(
        self, samples: Samples, sides: Sides, edge: Edge, thin: list[bool], window: float
    ) -> Callable[[Edge, Sides], float]:
        """Return the cost of a column, in the mean of both sides, as a function of the edge and the sides."""
        subset = {high: sample.thinned(3 if thin else 4) for high, sample in samples.items()}
        size = max(sum(s.outer.size for s in subset.values()), 1)
        most = {high: most_cost(self.fit(sample, sides[high], edge, window)[4]) for high, sample in subset.items()}

        def misfit(edge_of_trial: Edge, sides_of_trial: Sides) -> float:
            total = 0.0
            for high, sample in subset.items():
                cost = self.fit(sample, sides_of_trial[high], edge_of_trial, window)[4]
                total += float(np.sum(np.where(np.isfinite(cost), np.minimum(cost, most[high]), most[high])))
            return total / size

        return misfit


def _brighter(sides: Sides, thin: list[bool], shares: Floats) -> Sides:
    """Return the sides with the greys of thin coatings, from then on known, multiplied by exp(share)."""
    brighter = dict(sides)
    for high, share in zip(thin, shares, strict=True):
        level, spread = sides[high].level.copy(), sides[high].spread.copy()
        level[2] *= float(np.exp(share))
        spread[2] = 1e-3 * level[2]
        brighter[high] = Side(level=level, spread=spread, coated=True)
    return brighter


def _simplex(cost: Callable[[Floats], float], start: Floats, steps: Floats, trials: int) -> optimize.OptimizeResult:
    """Search the lowest cost with Nelder and Mead's method."""
    return optimize.minimize(
        cost, start, method="Nelder-Mead",
        options={"initial_simplex": np.vstack([start, start + steps]), "xatol": 2e-3, "fatol": 1e-7, "maxfev": trials},
    )  # fmt: skip
