"""Learning from some columns what the fit has to know: the grey levels, how far they vary, the blur, the fringe."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import VolumeError
from planish.surface import _fit_kernels
from planish.surface.coarse import CORE
from planish.surface.columns import Columns, Guide
from planish.surface.fringe import thin_levels, undershoots, with_fringe
from planish.surface.levels import spread
from planish.surface.params import SurfaceParams
from planish.surface.priors import Edge, Priors, Side
from planish.surface.sample import Sample, Sampler, most_cost
from planish.surface.survey import Survey

Array = NDArray[np.float64]

_WIDTHS = np.geomspace(0.35, 3.2, 14)  # blur along a column that is tried, in voxels
_THICK = 3.0  # widths of the blur: a thicker layer shows its own grey
_PLAIN, _PLAIN_SHARE = 5.5, 0.05  # widths of the blur, and share of columns: such a layer shows it beyond doubt
_TRACE = 0.15  # widths of the blur: a coating that is thinner in half of the columns is none
_COATING_RATIO = 1.25  # a layer is a coating when it stands out from the base by more than a quarter
_FEW = 50  # columns that show it


def learn_priors(columns: Columns, guide: Guide, survey: Survey, params: SurfaceParams) -> Priors:
    """Learn the grey levels, the blur and the fringe from a sample of columns.

    Raises
    ------
    VolumeError
        If the core of the sheet does not stand out from the air.
    """
    return _Learner(Sampler(columns, guide, survey), survey, params).priors()


class _Learner:
    def __init__(self, sampler: Sampler, survey: Survey, params: SurfaceParams) -> None:
        self.sampler, self.params, self.survey = sampler, params, survey

    def priors(self) -> Priors:
        sampler, params = self.sampler, self.params
        base, base_sd = self._base(sampler.sample(high=True))
        sampler.calm(base)
        samples = {high: sampler.sample(high=high) for high in (True, False)}
        # Coarse profile per side: is there a coating, how bright, how much does it vary?
        sides = {high: self._first_side(part, base, base_sd) for high, part in samples.items()}
        preset_fringe = 0.0 if isinstance(params.fringe, str) else params.fringe
        edge = Edge(width=self._blur(samples, sides, preset_fringe), fringe=preset_fringe)
        has_fringe = params.fringe == "auto" and undershoots(sampler, samples, sides, edge)
        if has_fringe:
            edge, _ = with_fringe(sampler, samples, sides, edge, [])
        thin = [high for high in samples if self._is_thin(samples[high], sides[high], edge)]
        if thin:
            quiet = sampler.quiet(samples, edge.width)
            edge, sides = (with_fringe if has_fringe else thin_levels)(sampler, quiet, sides, edge, thin)
        is_given = params.coating_grey is not None
        sides = {high: self._narrowed(samples[high], sides[high], edge, is_given or high in thin) for high in samples}
        if is_given:
            sides = {high: self._given_side(samples[high], side, edge, base) for high, side in sides.items()}
        return Priors(
            scale=sampler.scale, noise=sampler.noise, single_noise=sampler.single_noise, scatter=sampler.scatter,
            base=base, edge=edge, reach=sampler.reach, embedded_level=sampler.embedded_level, sides=sides,
        )  # fmt: skip

    def _base(self, sample: Sample) -> tuple[float, float]:
        """Level of the base above the air, and how much it varies from place to place."""
        shares = np.linspace(*CORE, 9)
        depth = np.rint(sample.outer[0][:, None] + (sample.other - sample.outer)[0][:, None] * shares).astype(int)
        core = np.take_along_axis(sample.grey[0], np.clip(depth, 0, self.sampler.depth - 1), axis=1).astype(np.float64)
        core = core[np.isfinite(core)]
        level = float(np.median(core))
        if level <= 0:
            raise VolumeError("The core of the sheet is not brighter than the air around it. Check --sheet-grey.")
        return level, float(np.sqrt(max(spread(core) ** 2 - self.sampler.noise**2, (0.05 * level) ** 2)))

    def _given_side(self, sample: Sample, side: Side, edge: Edge, base: float) -> Side:
        """Keep the coating whose grey was given where there is one."""
        thickness = self.sampler.fit(sample, side, edge)[1]
        if float(np.nanmedian(thickness)) > _TRACE * edge.width:
            return side
        bare = Side(
            level=np.array([0.0, 0.0, 0.0, base]), spread=np.array([0.0, 0.0, -1.0, side.spread[3]]), coated=False
        )
        return self._narrowed(sample, bare, edge, is_given=True)

    def _first_side(self, sample: Sample, base: float, base_sd: float) -> Side:
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

    def _blur(self, samples: dict[bool, Sample], sides: dict[bool, Side], fringe: float) -> float:
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

    def _is_thin(self, sample: Sample, side: Side, edge: Edge) -> bool:
        """Tell if no column shows the coating's own grey, because the blur reaches through all of it."""
        if not side.coated or self.params.coating_grey is not None:
            return False
        # With a grey that is too low the layer seems thicker and the blur narrower than they are, hence the margin.
        thick = self.sampler.fit(sample, side, edge)[1] * sample.tilt > _PLAIN * edge.width
        return float(np.mean(thick)) < _PLAIN_SHARE

    def _narrowed(self, sample: Sample, side: Side, edge: Edge, is_given: bool) -> Side:
        """Narrow what is expected to what thick layers and the base below them show."""
        level, wide = side.level.copy(), side.spread.copy()
        for _ in range(2):
            fit = self.sampler.fit(sample, Side(level=level, spread=wide, coated=side.coated), edge)
            has_face = np.isfinite(fit[0])
            if side.coated and is_given:
                wide[2] = 0.02 * level[2]
            elif side.coated:
                thick = has_face & (fit[1] * sample.tilt > _THICK * edge.width)
                if np.count_nonzero(thick) < _FEW:
                    thick = has_face & (fit[1] >= np.nanpercentile(fit[1], 75))
                level[2] = float(np.median(fit[2][thick]))
                wide[2] = max(1.2 * spread(fit[2][thick]), 0.01 * level[2])
            level[3] = float(np.median(fit[3][has_face]))
            wide[3] = max(1.2 * spread(fit[3][has_face]), 0.03 * level[3])
        return Side(level=level, spread=wide, coated=side.coated)
