"""Learn from some columns what the fit has to know.

Grey levels, their spread, the blur, and a phase-contrast fringe.

Only a fringe makes the air beside the face darker than the air farther away; where that is not seen
none is taken.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import optimize
from scipy.special import ndtri

from planish.core.errors import VolumeError
from planish.core.robust import mad_sd
from planish.core.typing import Floats
from planish.surface import _fit_kernels
from planish.surface.alone import RADII, lone_greys
from planish.surface.coarse import CORE
from planish.surface.columns import (
    FRINGE_PX,
    Columns,
    Edge,
    Guide,
    LoneGrey,
    Priors,
    Side,
    Sides,
)
from planish.surface.params import SurfaceParams
from planish.surface.sample import Sample, Sampler, Samples, cost_limit
from planish.surface.survey import Survey

_WIDTHS = np.geomspace(0.35, 3.2, 14)  # blur along a column that is tried, in voxels
_OUTSIDE = 5  # voxels outside a face in which a fringe has its undershoot
_THICK_SHARE = 0.05  # of the columns: enough of them to show a layer's grey beyond doubt
_DEPTHS = 9  # places of the core in a column
_LEAST_COVER_UM = 15.0  # from a face to a brighter layer: a coating's brightest place is nearer
# Of the core's variance, what acts on a face: the solid below it is denser. By drawn fibres, and
# pores of a voxel.
_BELOW_FACE = 0.3
# Walls directly below a coating, in standard deviations of the base's grey from place to place: of
# walls that fill a half to 0.6 of the base, columns as broad as the blur hold one or two.
_WALL = 1.2
_AVERAGED = 0.75  # of the blur: Gaussians of 1 and 0.75 make one of 1.25
_DARKEST = float(np.exp(-0.5) / np.sqrt(2.0 * np.pi))  # of a fringe's size: its undershoot
_VOID = 0.3  # of the lightest grey of the core: what is darker is void for the most part
POROUS = 0.35  # spread of the core's grey over its median: where it is less, no pores show


def learn_priors(columns: Columns, guide: Guide, survey: Survey, params: SurfaceParams) -> Priors:
    """Learn grey levels, blur and fringe from sample columns.

    VolumeError if the core does not stand out from air.
    """
    learner = _Learner(columns, guide, survey)
    base_level, base_sd = learner.base_level(learner.sample(from_high=True))
    learner.calm(base_level)
    samples = learner.samples()
    # Coarse profile per side: is there a coating, how bright, how much does it vary?
    profiles = {k: learner.profile(sample, base_level) for k, sample in samples.items()}
    is_separated = params.sheet_grey is not None or survey.surroundings == "material"
    is_preset = params.coating_grey is not None
    sides = learner.first_sides(profiles, params.coating_grey, base_level, base_sd, is_separated)
    wall_levels = learner.bare_walls(samples, sides, base_level, base_sd)
    if wall_levels:
        learner.calm(max(min(wall_levels.values()), base_level))
        return learner.bare_priors(learner.samples(), sides, base_level, profiles, params)
    preset_fringe = 0.0 if isinstance(params.fringe, str) else params.fringe
    edge = Edge(width=learner.blur(samples, sides, preset_fringe), fringe=preset_fringe)
    coated_levels = [float(side.level[2]) for side in sides.values() if side.coated]
    # Amid other material, a face is sought by the darkest place beside it.
    if coated_levels and not learner.embedded_level:
        learner.calm_for(min(coated_levels), base_level, edge)
        samples = learner.samples()
    base_texture = learner.base_texture(samples[True])
    covers_px = learner.covers(profiles)
    has_fringe = params.fringe == "auto" and learner.undershoots(samples, sides, edge)
    if has_fringe:
        edge, _ = learner.with_fringe(samples, sides, edge, [])
    lone: dict[bool, LoneGrey] = {}
    if not is_preset and any(side.coated for side in sides.values()):
        narrowed_sides = {
            k: learner.narrowed(sample, sides[k], edge, False) for k, sample in samples.items()
        }
        first_priors = learner.priors(narrowed_sides, edge, base_level, base_texture, covers_px)
        lone = lone_greys(columns, guide, first_priors)
        sides |= {k: _with_grey(narrowed_sides[k], grey) for k, grey in lone.items()}
    if lone and has_fringe:
        edge, _ = learner.with_fringe(samples, sides, edge, [])
    elif coated_levels and not has_fringe:
        edge = replace(edge, width=learner.blur(samples, sides, preset_fringe))
    level_errors = {k: grey.error for k, grey in lone.items()}
    unknown_sides = [k for k in samples if sides[k].coated and not is_preset and k not in lone]
    # Where a fringe reaches through all of a coating, columns with their fringe show its grey.
    thin_sides = [
        k for k in unknown_sides if not edge.fringe or learner.is_thin(samples[k], sides[k], edge)
    ]
    if thin_sides:
        fit_thin = learner.with_fringe if has_fringe else learner.thin_levels
        seen_levels = {k: float(sides[k].level[2]) for k in thin_sides}
        edge, sides = fit_thin(learner.quiet(samples, edge.width), sides, edge, thin_sides)
        # How far a grey goes beyond what was seen of it is known to a half.
        level_errors |= {
            k: 0.5 * abs(float(sides[k].level[2]) - seen_levels[k]) for k in thin_sides
        }
    narrowed_sides: Sides = {}
    for from_high, sample in samples.items():
        is_known = from_high not in unknown_sides or from_high in thin_sides
        side = learner.narrowed(sample, sides[from_high], edge, is_known)
        if is_preset:
            side = learner.coated_or_bare(sample, side, edge, base_level)
        narrowed_sides[from_high] = replace(
            side,
            lone=lone.get(from_high),
            level_error=level_errors.get(from_high, 0.0),
        )
    return learner.priors(narrowed_sides, edge, base_level, base_texture, covers_px)


def _shows_voids(core_grey: Floats) -> bool:
    """Tell if more places of a core are as dark as voids than are as much lighter than the median.

    Pores take the grey down to the air, and nothing but filler takes it above that of a wall; where
    density varies evenly the two are the same but for chance.
    """
    median, lightest = np.percentile(core_grey, [50, 99])
    depth = median - _VOID * lightest
    dark, light = np.mean(core_grey < median - depth), np.mean(core_grey > median + depth)
    chance = np.sqrt((dark + light) / (core_grey.size / _DEPTHS))  # one value of a column counts
    return bool(dark - light > _SIGMAS * chance)


def _with_grey(side: Side, grey: LoneGrey) -> Side:
    """Return a side with the grey that its coating has where nothing else is near."""
    level, spread = side.level.copy(), side.spread.copy()
    level[2], spread[2] = grey.level, max(grey.spread, 0.02 * grey.level)
    return replace(side, level=level, spread=spread, lone=grey)


# From the face, in widths of the blur: where an undershoot may be seen.
_NEAR = ((1.0, 2.0), (2.0, 3.2), (3.2, 4.8))
_BETWEEN = (4.8, 8.0)  # a fringe is over here; a streak along the sheet is not
_FAR = (8.0, 14.0)  # the air that it is compared with
_SIGMAS = 4.5  # that tell the undershoot from chance
_LEAST = 0.0015  # of the contrast: what else may be wrong with the air
_FEW_COLUMNS, _ROWS = 8, 5  # columns of a row, and rows, that must show the air
# Widths of the blur: the blur that is found may be wider than the one without a fringe.
_WINDOW = 1.3


class _Learner(Sampler):
    def priors(
        self,
        sides: Sides,
        edge: Edge,
        base_level: float,
        base_texture: float,
        covers_px: dict[bool, float],
    ) -> Priors:
        """What was learnt, and what was seen on the way."""
        return Priors(
            scale=self.scale,
            noise=self.noise,
            single_noise=self.single_noise,
            scatter=self.scatter,
            base_level=base_level,
            base_texture=base_texture,
            edge=edge,
            search_px=self.search_px,
            embedded_level=self.embedded_level,
            sides=sides,
            covers_px=covers_px,
        )

    def bare_priors(
        self,
        samples: Samples,
        sides: Sides,
        base_level: float,
        profiles: dict[bool, tuple[Floats, float]],
        params: SurfaceParams,
    ) -> Priors:
        """What is known of a bare base of walls and pores, of which no edge shows the blur."""
        edge = Edge(width=1.0)
        walls = {k: self.wall_level(sample) for k, sample in samples.items()}
        if params.fringe == "auto" and self.undershoots(samples, sides, edge):
            undershoot = max(undershoot for _, undershoot in profiles.values())
            edge = replace(edge, fringe=undershoot / (_DARKEST * min(walls.values())))
        bare_sides = {k: replace(side, wall_level=walls[k]) for k, side in sides.items()}
        texture = self.base_texture(samples[True])
        priors = self.priors(bare_sides, edge, base_level, texture, self.covers(profiles))
        return replace(priors, is_blur_known=False)

    def calm_for(self, coating_level: float, base_level: float, edge: Edge) -> None:
        """Average columns until the least step of a coated sheet stands out.

        That is the step from the base to the coating, or from the air to the base where hardly any
        coating is left. Once that is seen at all, averaging widens the blur by a quarter at most: a
        coating in a valley between fibres must not be lost.
        """
        blur_columns = edge.width * self.columns.pitch[2] / max(self.columns.pitch[:2])
        self.calm(min(base_level, coating_level - base_level), _AVERAGED * blur_columns)

    def base_level(self, sample: Sample) -> tuple[float, float]:
        """Level of the base above the air, and how much it varies from place to place."""
        core_grey = self._core_grey(sample)
        level = float(np.median(core_grey))
        if level <= 0:
            raise VolumeError(
                "The core of the sheet is not lighter than the air around it. Check `sheet_grey`."
            )
        return level, float(
            np.sqrt(max(mad_sd(core_grey) ** 2 - self.noise**2, (0.05 * level) ** 2))
        )

    def _core_grey(self, sample: Sample) -> Floats:
        depth_shares = np.linspace(*CORE, _DEPTHS)
        outer, opposite = sample.outer[0][:, None], sample.opposite[0][:, None]
        depth_index = np.rint(outer + (opposite - outer) * depth_shares).astype(int)
        depth_index = np.clip(depth_index, 0, sample.grey.shape[2] - 1)
        core_grey = np.take_along_axis(sample.grey[0], depth_index, axis=1).astype(np.float64)
        return core_grey[np.isfinite(core_grey)]

    def base_texture(self, sample: Sample) -> float:
        """Return the variance of the base's grey along a column.

        It is that of a sample whose neighbours vary by themselves.

        From means of three samples side by side, in the core; what is brighter or darker as a whole
        does not count. The solid below a face is denser than the core, and varies by so much less.
        """
        first = np.rint(0.5 * (sample.outer + sample.opposite))[0].astype(int)[:, None] + np.arange(
            -3, 3
        )
        grey = np.take_along_axis(
            sample.grey[0], np.clip(first, 0, sample.grey.shape[2] - 1), axis=1
        )
        means = grey.astype(np.float64).reshape(-1, 2, 3).mean(axis=2)
        difference = means[:, 1] - means[:, 0]
        difference = difference[np.isfinite(difference)]
        if not difference.size:
            return 0.0
        return (
            _BELOW_FACE
            * 3.0
            * 0.5
            * float(np.var(np.clip(difference, *np.percentile(difference, [1, 99]))))
        )

    def wall_level(self, sample: Sample) -> float:
        """Grey of a fibre's wall above the air, in a base with pores.

        The more of the core is void, the fewer of its places show nothing but wall: its median does
        where it is even, its brightest where a third is void. No void is darker than air: a fringe
        that makes it so makes walls lighter by as much.
        """
        core_grey = self._core_grey(sample)
        void_share = float(np.mean(core_grey < _VOID * np.percentile(core_grey, 99)))
        share = 0.88 + 0.119 * min(void_share / 0.35, 1.0)
        darkest, median, brightest = np.quantile(core_grey, [1.0 - share, 0.5, share])
        by_noise = (ndtri(share) * self.noise) ** 2
        above = np.sqrt(max((brightest - median) ** 2 - by_noise, 0.0))
        below = np.sqrt(max((median - darkest) ** 2 - by_noise, 0.0))
        return float(median + above + min(median - below, 0.0))

    def preset_side(self, coating_grey: float, base_level: float, base_sd: float) -> Side:
        """Take the grey of the coating as it was set."""
        polarity, air_grey = self.scale.polarity, self.scale.air_grey
        coating_level = polarity * (coating_grey - air_grey)
        if coating_level < 1.05 * base_level:
            raise VolumeError(
                f"The coating's grey {coating_grey:g} does not stand out from the base"
                f" ({polarity * base_level + air_grey:.4g}) on the side away from the air"
                f" ({air_grey:.4g}). Check `coating_grey`."
            )
        spread = np.array([0.0, 0.0, 0.02 * coating_level, max(base_sd, 0.25 * base_level)])
        return Side(
            level=np.array([0.0, 0.0, coating_level, base_level]), spread=spread, coated=True
        )

    def profile(self, sample: Sample, base_level: float) -> tuple[Floats, float]:
        """Median grey inwards from the first sample above the air, to the middle of the sheet.

        And by how much the air just outside is darker than the air.
        """
        grey, outer, search_px, embedded_level = (
            sample.grey[0],
            sample.outer[0],
            self.search_px,
            self.embedded_level,
        )
        start_index = np.array(
            [
                (
                    _fit_kernels.nearest(g, e, search_px, embedded_level)
                    if embedded_level
                    else _fit_kernels.outermost(
                        g, max(int(e - search_px), 0), int(e + search_px) + 1, 0.5 * base_level
                    )
                )
                for g, e in zip(grey, outer, strict=True)
            ]
        )
        has_start = start_index > 0
        half_depth = int(np.median(sample.opposite[0] - outer)) // 2
        depth_index = np.clip(
            start_index[has_start][:, None] + np.arange(-_OUTSIDE, max(half_depth, 2)),
            0,
            grey.shape[1] - 1,
        )
        profile = np.nanmedian(np.take_along_axis(grey[has_start], depth_index, axis=1), axis=0)
        undershoot = 0.0 if embedded_level else max(-float(profile[:_OUTSIDE].min()), 0.0)
        return profile[_OUTSIDE:], undershoot

    def cover(self, profile: Floats) -> float:
        """Thickness in voxels of what covers a side: an even layer with a brighter one below it.

        0 for none.

        Tape, film or a mount that touches is of one grey; no coating lies below a dimmer layer.
        """
        brightest = int(np.argmax(profile))
        plateau = profile[2 : max(brightest - 2, 2)]
        plateau = plateau[: int(0.8 * plateau.size)]  # the blur of the layer below is left out
        if brightest * self.columns.pitch[2] < _LEAST_COVER_UM or plateau.size < 3:
            return 0.0
        is_even = float(np.ptp(plateau)) < 0.15 * float(np.median(plateau))
        passes = np.flatnonzero(profile > 0.5 * (np.median(plateau) + profile[brightest]))
        return (
            float(passes[0]) if is_even and np.median(plateau) < 0.8 * profile[brightest] else 0.0
        )

    def first_sides(
        self,
        profiles: dict[bool, tuple[Floats, float]],
        coating_grey: float | None,
        base_level: float,
        base_sd: float,
        is_separated: bool,
    ) -> Sides:
        """Sides as their profiles show them, or with a coating of the grey that was set."""
        if coating_grey is not None:
            return dict.fromkeys(profiles, self.preset_side(coating_grey, base_level, base_sd))
        return {
            k: self.first_side(*profile, base_level, base_sd, is_separated)
            for k, profile in profiles.items()
        }

    def first_side(
        self,
        profile: Floats,
        undershoot: float,
        base_level: float,
        base_sd: float,
        is_separated: bool,
    ) -> Side:
        """Look for a coating in the median profile below the face; wide spreads.

        A fringe that darkens the air outside lightens what lies inside by as much. What is no
        lighter than the lightest tenth of the core is its walls.
        """
        half_depth, embedded_level = profile.size, self.embedded_level
        peak_level = float(profile[: max(2, int(0.8 * half_depth))].max())
        solid_level = base_level + 1.28 * min(base_sd, 0.3 * base_level)
        # A layer is a coating when it stands out from the base by more than a quarter.
        least_level = 1.25 * (1.2 * solid_level if is_separated else solid_level)
        coated = peak_level - undershoot > max(least_level, base_level + 1.28 * base_sd)
        # Without a coating the third level is what lies outside: the air, unless the sheet is amid
        # other material.
        outside_level = (1.0 if embedded_level else 0.5) * base_level if is_separated else -1.0
        spread = np.array(
            [
                0.0,
                0.0,
                0.25 * peak_level if coated else outside_level,
                max(base_sd, 0.25 * base_level),
            ]
        )
        return Side(
            level=np.array([0.0, 0.0, peak_level if coated else 0.0, base_level]),
            spread=spread,
            coated=coated,
        )

    def blur(self, samples: Samples, sides: Sides, fringe: float) -> float:
        """Width of the blur in voxels: the one with which the staircase fits the sample best."""
        costs = np.zeros(_WIDTHS.size)
        for from_high, sample in samples.items():
            subset = sample.thinned(4)
            trial_edges = [Edge(width=float(width), fringe=fringe) for width in _WIDTHS]
            fits = [self.fit(subset, sides[from_high], edge)[4] for edge in trial_edges]
            finite_costs = [cost[np.isfinite(cost)] for cost in fits]
            max_cost = min((cost_limit(cost) for cost in finite_costs if cost.size), default=0.0)
            # A blur so wide that it reaches the end of every column cannot be tried.
            costs += [
                float(np.mean(np.minimum(cost, max_cost))) if cost.size else np.inf
                for cost in finite_costs
            ]
        best_index = int(np.argmin(costs))
        if 0 < best_index < costs.size - 1 and np.isfinite(costs[best_index + 1]):
            a, b, c = costs[best_index - 1 : best_index + 2]
            shift = 0.5 * (a - c) / max(a - 2 * b + c, 1e-12)
            return float(
                _WIDTHS[best_index]
                * np.exp(np.clip(shift, -1, 1) * np.log(_WIDTHS[1] / _WIDTHS[0]))
            )
        return float(_WIDTHS[best_index])

    def bare_walls(
        self, samples: Samples, sides: Sides, base_level: float, base_sd: float
    ) -> dict[bool, float]:
        """Grey of a fibre's wall on each side of a base that shows pores and has no coating."""
        if self.embedded_level or any(side.coated for side in sides.values()):
            return {}
        # Not what streaks and noise that neighbours share add: the air shows them too.
        texture = base_sd**2 + self.voxel_noise**2 - self.single_noise**2
        is_even = texture < (POROUS * base_level) ** 2
        if is_even and not _shows_voids(self._core_grey(samples[True])):
            return {}
        return {k: self.wall_level(sample) for k, sample in samples.items()}

    def coated_or_bare(self, sample: Sample, side: Side, edge: Edge, base_level: float) -> Side:
        """Return a side whose coating's grey was set, without it where half of it is thinner.

        A wall below a coating hides a thin one, and is left out.
        """
        thickness = self.fit(sample, replace(side, wall_below=0.0), edge)[1]
        if float(np.nanmedian(thickness)) > 0.15 * edge.width:
            return side
        level = np.array([0.0, 0.0, 0.0, base_level])
        spread = np.array([0.0, 0.0, -1.0, side.spread[3]])
        return self.narrowed(sample, Side(level=level, spread=spread, coated=False), edge, True)

    def covers(self, profiles: dict[bool, tuple[Floats, float]]) -> dict[bool, float]:
        """Thickness in voxels of what covers each side; none is looked for amid other material."""
        if self.embedded_level:
            return {}
        return {k: self.cover(profile) for k, (profile, _) in profiles.items()}

    def is_thin(self, sample: Sample, side: Side, edge: Edge) -> bool:
        """Tell if hardly a column shows the coating's own grey between its two edges."""
        is_thick = self.fit(sample, side, edge)[1] * sample.cos_tilt > 2.0 * RADII[-1] * edge.width
        return float(np.mean(is_thick)) < _THICK_SHARE

    def narrowed(self, sample: Sample, side: Side, edge: Edge, is_preset: bool) -> Side:
        """Narrow what is expected to what thick layers and the base below them show."""
        level, spread, wall_below = side.level.copy(), side.spread.copy(), 0.0
        for _ in range(2):
            now = Side(level=level, spread=spread, coated=side.coated, wall_below=wall_below)
            fit = self.fit(sample, now, edge)
            has_face = np.isfinite(fit[0])
            if side.coated and is_preset:
                spread[2] = max(spread[2], 0.02 * level[2]) if side.lone else 0.02 * level[2]
                wall_below = self._wall_below(sample, fit, now, edge)
            elif side.coated:
                # Shows its own grey.
                is_thick = has_face & (fit[1] * sample.cos_tilt > 3.0 * edge.width)
                if np.count_nonzero(is_thick) < 50:
                    is_thick = has_face & (fit[1] >= np.nanpercentile(fit[1], 75))
                level[2] = float(np.median(fit[2][is_thick]))
                spread[2] = max(1.2 * mad_sd(fit[2][is_thick]), 0.01 * level[2])
            level[3] = float(np.median(fit[3][has_face]))
            spread[3] = max(1.2 * mad_sd(fit[3][has_face]), 0.03 * level[3])
        return Side(level=level, spread=spread, coated=side.coated, wall_below=wall_below)

    def _wall_below(self, sample: Sample, fit: Floats, side: Side, edge: Edge) -> float:
        """By how much what lies directly below a coating is lighter than the base.

        A base of walls and pores is solid there, and the more pores it has the more its grey varies
        from place to place. What noise adds to that is taken off. A base that varies little beyond
        it is even, and one so thin that its edges blur into each other shows no pores.
        """
        varied, width = mad_sd(fit[3]), edge.width
        thickness = float(np.nanmedian(fit[1]))
        base_px = float(np.nanmedian((sample.opposite - sample.outer) * sample.cos_tilt))
        # The fit goes 3 widths below the interface, and so far reaches the blur of the other one;
        # the coarse sheet is a width larger on either side.
        if not varied > 0 or base_px - 2.0 * thickness < 8.0 * width:
            return 0.0
        samples = int(thickness + 6.0 * width) + 2
        point = np.array([3.0 * width, thickness, *side.level[2:]])
        matrix, step = np.zeros((4, 4)), np.zeros(4)
        _fit_kernels.evaluate(
            np.zeros(samples, np.float32),
            0,
            samples - 1,
            0.0,
            self.scatter,
            width,
            point,
            side.level,
            side.spread,
            True,
            matrix,
            step,
            None,
            1.0,
            0.0,
            0.0,
        )
        precision = matrix + np.tril(matrix, -1).T
        by_columns = precision - np.diag([0.0, 0.0, *side.spread[2:] ** -2.0])
        covariance = np.linalg.inv(precision) @ by_columns @ np.linalg.inv(precision)
        by_noise = float(covariance[3, 3])
        return _WALL * float(np.sqrt(varied**2 - by_noise)) if varied**2 > 2.0 * by_noise else 0.0

    def undershoots(self, samples: Samples, sides: Sides, edge: Edge) -> bool:
        """Whether air beside the faces is darker than farther away.

        A blur that is roughly right will do.
        """
        if self.embedded_level:
            return False  # what lies beside is no air
        side_weights, weighted_sums = [], []
        for from_high, sample in samples.items():
            row_undershoots = self._undershoots_by_row(sample, sides[from_high], edge)
            row_count = np.isfinite(row_undershoots).sum(axis=1)
            row_undershoots = np.where(row_count[:, None] >= _ROWS, row_undershoots, 0.0)
            undershoot_error = np.nanstd(row_undershoots, axis=1) / np.sqrt(
                np.maximum(row_count - 1, 1)
            )
            # Sides whose contrast differs are weighted by what their rows' scatter tells.
            is_clear = (row_count >= _ROWS) & (undershoot_error > 0)
            side_weights.append(
                np.where(is_clear, 1.0 / np.maximum(undershoot_error, 1e-12) ** 2, 0.0)
            )
            weighted_sums.append(
                np.where(is_clear, side_weights[-1] * np.nanmean(row_undershoots, axis=1), 0.0)
            )
        total_weight = np.sum(side_weights, axis=0)
        if not total_weight.all():
            return False
        mean_undershoot = np.sum(weighted_sums, axis=0) / total_weight
        near_face, beyond_fringe = mean_undershoot[:-1], mean_undershoot[-1]
        detection_limit = -np.maximum(_LEAST, _SIGMAS / np.sqrt(total_weight[:-1]))
        # No more than this share of the undershoot may be there in between.
        return bool(((near_face < detection_limit) & (beyond_fringe > 0.4 * near_face)).any())

    def _undershoots_by_row(self, sample: Sample, side: Side, edge: Edge) -> Floats:
        """Grey of the air near the faces above that farther away, as a share of the contrast.

        (distances, rows).
        """
        face_depth = self.fit(sample, side, edge)[0, 0]
        unit_px, cos_tilt = max(edge.width, 1.0), sample.cos_tilt[0]
        first_index = np.where(
            np.isfinite(face_depth), face_depth - unit_px * _FAR[1] / cos_tilt, 0.0
        ).astype(int)
        depth_index = first_index[:, None] + np.arange(
            int(np.ceil(unit_px * _FAR[1] / float(cos_tilt.min()))) + 2
        )
        is_inside = (depth_index >= 0) & (depth_index < sample.grey.shape[2])
        grey = np.take_along_axis(sample.grey[0], np.where(is_inside, depth_index, 0), axis=1)
        distance = (face_depth[:, None] - depth_index) * cos_tilt[:, None] / unit_px
        # What floats in the air is left out.
        is_air = is_inside & (np.abs(grey) < 5.0 * self.scatter)
        row_count = int(sample.row.max()) + 1
        row_number = np.broadcast_to(sample.row[0][:, None], grey.shape)

        def mean_grey(start: float, stop: float) -> Floats:
            in_range = is_air & (distance >= start) & (distance < stop)
            column_count = np.bincount(row_number[in_range], minlength=row_count)
            grey_sum = np.bincount(
                row_number[in_range], weights=grey[in_range], minlength=row_count
            )
            return np.where(
                column_count >= _FEW_COLUMNS, grey_sum / np.maximum(column_count, 1), np.nan
            )

        far_grey, contrast = mean_grey(*_FAR), side.level[2 if side.coated else 3]
        return (
            np.stack(
                [mean_grey(*distance_range) - far_grey for distance_range in (*_NEAR, _BETWEEN)]
            )
            / contrast
        )

    def with_fringe(
        self, samples: Samples, sides: Sides, edge: Edge, thin_sides: list[bool]
    ) -> tuple[Edge, Sides]:
        """Return the blur, fringe and greys with which the staircase fits the sample best.

        The greys are those of coatings that are nowhere thick.

        The edge is returned as it came where the best has no fringe.
        """
        misfit = self._misfit(samples, sides, edge, thin_sides, _WINDOW * max(edge.width, 1.0))

        def trial_of(vector: Floats) -> tuple[Edge, Sides]:
            width, fringe_width = (
                edge.width * float(np.exp(vector[0])),
                FRINGE_PX * float(np.exp(vector[2])),
            )
            fringed_edge = Edge(
                width=width, fringe=max(float(vector[1]), 0.0), fringe_width=fringe_width
            )
            return fringed_edge, _brighter(sides, thin_sides, vector[3:])

        def cost(vector: Floats) -> float:
            # Where the width of the fringe shows little it is the usual one.
            penalty = (float(vector[2]) / 0.35) ** 2 + float(np.sum(vector[3:] ** 2))
            return misfit(*trial_of(vector)) + 1e-4 * penalty + max(-float(vector[1]), 0.0)

        steps = np.diag([0.1, 0.08, 0.25] + [0.1] * len(thin_sides))
        # Logarithms of a thin coating's grey over the brightest that was seen.
        start_shares = (0.0, 0.2, 0.45) if thin_sides else (0.0,)
        starts = [np.array([0.1, 0.1, 0.0] + [share] * len(thin_sides)) for share in start_shares]
        optimum = min(
            (_simplex(cost, start, steps, 90) for start in starts),
            key=lambda optimum: float(optimum.fun),
        )
        fitted_edge, brighter_sides = trial_of(optimum.x)
        return (fitted_edge, brighter_sides) if fitted_edge.fringe > 0.005 else (edge, sides)

    def thin_levels(
        self, samples: Samples, sides: Sides, edge: Edge, thin_sides: list[bool]
    ) -> tuple[Edge, Sides]:
        """Return the blur and greys with which the staircase fits the sample best.

        The greys are those of coatings that are nowhere thick.

        Grey and thickness of one thin layer can hardly be separated; the shape of many profiles
        helps a little.
        """
        misfit = self._misfit(samples, sides, edge, thin_sides, _WINDOW * edge.width)

        def trial_of(vector: Floats) -> tuple[Edge, Sides]:
            return replace(edge, width=edge.width * float(np.exp(vector[0]))), _brighter(
                sides, thin_sides, vector[1:]
            )

        def cost(vector: Floats) -> float:
            # A layer's grey is seldom far from the brightest that was seen of it.
            return misfit(*trial_of(vector)) + 1e-4 * float(np.sum(vector**2))

        def cost_of_width(log_width: float, share: float) -> float:
            return cost(np.array([log_width, *[share] * len(thin_sides)]))

        # Brighter layers with a wider blur look nearly the same: the search goes along that valley
        # first.
        optimum_of_share: dict[float, Any] = {
            share: optimize.minimize_scalar(
                cost_of_width,
                args=(share,),
                bounds=(-0.2, 0.6),
                method="bounded",
                options={"xatol": 0.01},
            )
            for share in (0.0, 0.15, 0.3, 0.45, 0.6, 0.75)
        }
        share = min(optimum_of_share, key=lambda k: float(optimum_of_share[k].fun))
        start = np.array([float(optimum_of_share[share].x), *[share] * len(thin_sides)])
        steps = np.diag([0.03, *[0.08] * len(thin_sides)])
        steps[0, 1:] = 0.08
        return trial_of(_simplex(cost, start, steps, 80).x)

    def _misfit(
        self, samples: Samples, sides: Sides, edge: Edge, thin_sides: list[bool], window: float
    ) -> Callable[[Edge, Sides], float]:
        subset = {
            from_high: sample.thinned(3 if thin_sides else 4)
            for from_high, sample in samples.items()
        }
        column_count = max(sum(s.outer.size for s in subset.values()), 1)
        max_costs = {
            k: cost_limit(self.fit(sample, sides[k], edge, window)[4])
            for k, sample in subset.items()
        }

        def misfit(trial_edge: Edge, trial_sides: Sides) -> float:
            total = 0.0
            for from_high, sample in subset.items():
                cost = self.fit(sample, trial_sides[from_high], trial_edge, window)[4]
                total += float(np.sum(np.fmin(cost, max_costs[from_high])))  # NaN: no fit
            return total / column_count

        return misfit


def _brighter(sides: Sides, thin_sides: list[bool], shares: Floats) -> Sides:
    """Return the sides with the greys of thin coatings multiplied by exp(share).

    From then on these greys are known.
    """
    brighter = dict(sides)
    for from_high, share in zip(thin_sides, shares, strict=True):
        level, spread = sides[from_high].level.copy(), sides[from_high].spread.copy()
        level[2] *= float(np.exp(share))
        spread[2] = 1e-3 * level[2]
        brighter[from_high] = Side(level=level, spread=spread, coated=True)
    return brighter


def _simplex(
    cost: Callable[[Floats], float], start: Floats, steps: Floats, trials: int
) -> optimize.OptimizeResult:
    return optimize.minimize(
        cost,
        start,
        method="Nelder-Mead",
        options={
            "initial_simplex": np.vstack([start, start + steps]),
            "xatol": 2e-3,
            "fatol": 1e-7,
            "maxfev": trials,
        },
    )
