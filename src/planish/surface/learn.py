"""Learn from some columns what the fit has to know.

Grey levels, their spread, the blur, and a phase-contrast fringe.

Only a fringe makes the air beside the face darker than the air farther away; where that is not seen
none is taken.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy import optimize
from scipy.special import ndtri

from planish.core.errors import VolumeError
from planish.core.robust import mad_sd
from planish.core.typing import Array, Floats, Ints, Pair, Singles
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
# From the face, in widths of the blur: where an undershoot may be seen.
_NEAR = ((1.0, 2.0), (2.0, 3.2), (3.2, 4.8))
_BETWEEN = (4.8, 8.0)  # a fringe is over here; a streak along the sheet is not
_FAR = (8.0, 14.0)  # the air that it is compared with
_SIGMAS = 4.5  # that tell the undershoot from chance
_LEAST = 0.0015  # of the contrast: what else may be wrong with the air
_FEW_COLUMNS, _ROWS = 8, 5  # columns of a row, and rows, that must show the air
# Widths of the blur: the blur that is found may be wider than the one without a fringe.
_WINDOW = 1.3


def learn_priors(columns: Columns, guide: Guide, survey: Survey, params: SurfaceParams) -> Priors:
    """Learn grey levels, blur and fringe from sample columns.

    VolumeError if the core does not stand out from air.
    """
    learner = _Learner(columns, guide, survey, params)
    wall_levels = learner.bare_walls()
    if wall_levels:
        return learner.bare_priors(wall_levels)
    learner.learn_edge()
    learner.learn_lone_greys()
    thick_sides = learner.learn_thin_greys()
    return learner.priors(learner.narrowed_sides(thick_sides))


def _shows_voids(core_grey: Floats) -> bool:
    """Tell if more places of a core are as dark as voids than are as much lighter than the median.

    Pores take the grey down to the air, and nothing but filler takes it above that of a wall; where
    density varies evenly the two are the same but for chance.
    """
    median, lightest = np.percentile(core_grey, [50, 99])
    depth = median - _VOID * lightest
    dark_share = np.mean(core_grey < median - depth)
    light_share = np.mean(core_grey > median + depth)
    column_count = core_grey.size / _DEPTHS  # one value of a column counts
    chance = np.sqrt((dark_share + light_share) / column_count)
    return bool(dark_share - light_share > _SIGMAS * chance)


def _side(coating: float, base: float, coating_sd: float, base_sd: float, *, coated: bool) -> Side:
    level = np.array([0.0, 0.0, coating, base])
    spread = np.array([0.0, 0.0, coating_sd, base_sd])
    return Side(level=level, spread=spread, coated=coated)


def _with_coating(side: Side, grey: float, sd: float, lone: LoneGrey | None = None) -> Side:
    """Return a side with another grey of its coating."""
    level = side.level.copy()
    spread = side.spread.copy()
    level[2] = grey
    spread[2] = sd
    return replace(side, level=level, spread=spread, lone=lone)


def _grey_at(grey: Singles, depth_index: Ints) -> Array:
    """Grey (n, depth) at depths (n, m), or at the end of the column."""
    index_within = np.clip(depth_index, 0, grey.shape[1] - 1)
    return np.take_along_axis(grey, index_within, axis=1)


class _Learner(Sampler):
    """Sample columns of a sheet, and all that is learnt from them, step by step."""

    def __init__(
        self, columns: Columns, guide: Guide, survey: Survey, params: SurfaceParams
    ) -> None:
        """Choose the rows that are sampled, and look at them for the first time.

        ``sides``, ``edge`` and the scale, noise and samples of the base class are learnt better
        step by step; ``True`` stands for the side at the high end of the columns.
        """
        super().__init__(columns, guide, survey)
        self.params = params
        self.is_separated = params.sheet_grey is not None or survey.surroundings == "material"
        self.base_level, self.base_sd = self._base(self.sample(from_high=True))
        self.calm(self.base_level)
        self.sample_of = self.samples()
        # Coarse profile of each side and its undershoot: is there a coating, how bright is it?
        self.profiles = {k: self._profile(sample) for k, sample in self.sample_of.items()}
        if params.coating_grey is None:
            self.sides = {k: self._first_side(*profile) for k, profile in self.profiles.items()}
        else:
            self.sides = dict.fromkeys(self.profiles, self._preset_side(params.coating_grey))
        self.edge = Edge(width=1.0)
        self.has_fringe = False
        self.lone: dict[bool, LoneGrey] = {}  # greys that were seen beyond all blur
        self.level_errors: dict[bool, float] = {}  # standard errors of coatings' greys

    def priors(self, sides: Sides) -> Priors:
        """What was learnt, and what was seen on the way."""
        return Priors(
            scale=self.scale,
            noise=self.noise,
            single_noise=self.single_noise,
            scatter=self.scatter,
            base_level=self.base_level,
            base_texture=self._base_texture(),
            edge=self.edge,
            search_px=self.search_px,
            embedded_level=self.embedded_level,
            sides=sides,
            covers_px=self._covers(),
        )

    def bare_walls(self) -> dict[bool, float]:
        """Grey of a fibre's wall on each side of a base that shows pores and has no coating."""
        if self.embedded_level or self._coated_levels():
            return {}
        # Not what streaks and noise that neighbours share add: the air shows them too.
        texture = self.base_sd**2 + self.voxel_noise**2 - self.single_noise**2
        is_even = texture < (POROUS * self.base_level) ** 2
        if is_even and not _shows_voids(self._core_grey(self.sample_of[True])):
            return {}
        return self._wall_levels()

    def bare_priors(self, wall_levels: dict[bool, float]) -> Priors:
        """What is known of a bare base of walls and pores, of which no edge shows the blur."""
        self.calm(max(min(wall_levels.values()), self.base_level))
        self.sample_of = self.samples()
        walls = self._wall_levels()
        if self._undershoots():
            undershoot = max(undershoot for _, undershoot in self.profiles.values())
            fringe = undershoot / (_DARKEST * min(walls.values()))
            self.edge = replace(self.edge, fringe=fringe)
        sides: Sides = {}
        for k, side in self.sides.items():
            sides[k] = replace(side, wall_level=walls[k])
        return replace(self.priors(sides), is_blur_known=False)

    def learn_edge(self) -> None:
        """Learn blur and fringe, of columns that are averaged as far as the least step needs it.

        That is the step from the base to the coating, or from the air to the base where hardly any
        coating is left. Once that is seen at all, averaging widens the blur by a quarter at most: a
        coating in a valley between fibres must not be lost.
        """
        self._fit_blur()
        coated_levels = self._coated_levels()
        # Amid other material, a face is sought by the darkest place beside it.
        if coated_levels and not self.embedded_level:
            pitch = self.columns.pitch
            blur_columns = self.edge.width * pitch[2] / max(pitch[:2])
            least_step = min(self.base_level, min(coated_levels) - self.base_level)
            self.calm(least_step, _AVERAGED * blur_columns)
            self.sample_of = self.samples()
        self.has_fringe = self._undershoots()
        if self.has_fringe:
            self._fit_fringe(self.sample_of, [])

    def learn_lone_greys(self) -> None:
        """Learn the greys of coatings where nothing else is near, and with them the edge again.

        Sides that show their grey nowhere keep what they had. A grey that the parameters give is
        not learnt.
        """
        if not self._coated_levels():
            return
        if self.params.coating_grey is None:
            sides: Sides = {}
            for k, side in self.sides.items():
                sides[k] = self._narrowed(k, side, is_known=False)
            self.lone = lone_greys(self.columns, self.guide, self.priors(sides))
            for k, grey in self.lone.items():
                sd = max(grey.spread, 0.02 * grey.level)
                self.sides[k] = _with_coating(sides[k], grey.level, sd, grey)
                self.level_errors[k] = grey.error
        if not self.has_fringe:
            self._fit_blur()
        elif self.lone:
            self._fit_fringe(self.sample_of, [])

    def learn_thin_greys(self) -> list[bool]:
        """Learn the greys of coatings that are nowhere thick; return the sides with a thick one.

        ``True`` is the side at the high end. Coatings whose grey was set or seen alone are in
        neither. Where a fringe reaches through all of a coating, columns with their fringe show its
        grey.
        """
        unknown_sides = self._unknown_sides()
        # A thick coating is seen alone by `lone_greys`, which stays farther from the faces where a
        # fringe is wider than the blur: one may be left there.
        is_thin = {k: not self.edge.fringe or self._is_thin(k) for k in unknown_sides}
        thin_sides = [k for k in unknown_sides if is_thin[k]]
        if thin_sides:
            seen_sides = self.sides
            fit_thin = self._fit_fringe if self.has_fringe else self._fit_thin
            fit_thin(self.quiet(self.sample_of, self.edge.width), thin_sides)
            # How far a grey goes beyond what was seen of it is known to a half.
            for k in thin_sides:
                beyond_seen = self.sides[k].grey - seen_sides[k].grey
                self.level_errors[k] = 0.5 * abs(beyond_seen)
        return [k for k in unknown_sides if not is_thin[k]]

    def _unknown_sides(self) -> list[bool]:
        """Coated sides whose grey was neither set nor seen."""
        if self.params.coating_grey is not None:
            return []
        return [k for k, side in self.sides.items() if side.coated and k not in self.lone]

    def narrowed_sides(self, thick_sides: list[bool]) -> Sides:
        """Narrow all sides; the greys of coatings are known but for those of thick ones."""
        sides: Sides = {}
        for k, learnt_side in self.sides.items():
            side = self._narrowed(k, learnt_side, is_known=k not in thick_sides)
            if self.params.coating_grey is not None:
                side = self._coated_or_bare(k, side)
            level_error = self.level_errors.get(k, 0.0)
            sides[k] = replace(side, lone=self.lone.get(k), level_error=level_error)
        return sides

    def _coated_levels(self) -> list[float]:
        return [side.grey for side in self.sides.values() if side.coated]

    def _base(self, sample: Sample) -> Pair:
        """Level of the base above the air, and how much it varies from place to place."""
        core_grey = self._core_grey(sample)
        level = float(np.median(core_grey))
        if level <= 0:
            raise VolumeError(
                "The core of the sheet is not lighter than the air around it. Check `sheet_grey`."
            )
        variance = mad_sd(core_grey) ** 2 - self.noise**2
        least_variance = (0.05 * level) ** 2
        return level, float(np.sqrt(max(variance, least_variance)))

    def _core_grey(self, sample: Sample) -> Floats:
        depth_shares = np.linspace(*CORE, _DEPTHS)
        outer = sample.outer[0][:, None]
        depth = outer + (sample.opposite[0][:, None] - outer) * depth_shares
        core_grey = _grey_at(sample.grey[0], np.rint(depth).astype(int))
        return core_grey[np.isfinite(core_grey)].astype(float)

    def _base_texture(self) -> float:
        """Return the variance of the base's grey along a column, per voxel.

        It is that of a sample whose neighbours vary by themselves.

        From means of three samples side by side, in the core; what is brighter or darker as a whole
        does not count. The solid below a face is denser than the core, and varies by so much less.
        """
        sample = self.sample_of[True]
        middle = np.rint(0.5 * (sample.outer + sample.opposite))[0].astype(int)
        core_index = middle[:, None] + np.arange(-3, 3)
        grey = _grey_at(sample.grey[0], core_index).astype(float)
        halves = grey.reshape(-1, 2, 3).mean(axis=2)
        difference = halves[:, 1] - halves[:, 0]
        difference = difference[np.isfinite(difference)]
        if not difference.size:
            return 0.0
        usual = np.clip(difference, *np.percentile(difference, [1, 99]))
        # A mean of three varies by a third, and the difference of two means twice as much.
        return _BELOW_FACE * 3.0 * 0.5 * float(np.var(usual))

    def _wall_levels(self) -> dict[bool, float]:
        return {k: self._wall_level(sample) for k, sample in self.sample_of.items()}

    def _wall_level(self, sample: Sample) -> float:
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

    def _preset_side(self, coating_grey: float) -> Side:
        """Take the grey of the coating as it was set."""
        polarity, air_grey = self.scale.polarity, self.scale.air_grey
        base_level = self.base_level
        coating_level = polarity * (coating_grey - air_grey)
        if coating_level < 1.05 * base_level:
            raise VolumeError(
                f"The coating's grey {coating_grey:g} does not stand out from the base"
                f" ({polarity * base_level + air_grey:.4g}) on the side away from the air"
                f" ({air_grey:.4g}). Check `coating_grey`."
            )
        base_sd = max(self.base_sd, 0.25 * base_level)
        return _side(coating_level, base_level, 0.02 * coating_level, base_sd, coated=True)

    def _profile(self, sample: Sample) -> tuple[Floats, float]:
        """Median grey inwards from the first sample above the air, to the middle of the sheet.

        And by how much the air just outside is darker than the air.
        """
        grey = sample.grey[0]
        outer = sample.outer[0]
        start_index = np.array([*map(self._start, grey, outer)])
        has_start = start_index > 0
        half_depth = int(np.median(sample.opposite[0] - outer)) // 2
        from_start = np.arange(-_OUTSIDE, max(half_depth, 2))
        depth_index = start_index[has_start][:, None] + from_start
        profile = np.nanmedian(_grey_at(grey[has_start], depth_index), axis=0)
        # Amid other material there is no air that could be darker.
        darkest = 0.0 if self.embedded_level else float(profile[:_OUTSIDE].min())
        return profile[_OUTSIDE:], max(-darkest, 0.0)

    def _start(self, grey: Singles, expected: float) -> int:
        """First sample of a column that is no air; not above 0 for none."""
        search_px = self.search_px
        if self.embedded_level:
            return _fit_kernels.nearest(grey, expected, search_px, self.embedded_level)
        first = max(int(expected - search_px), 0)
        last = int(expected + search_px) + 1
        return _fit_kernels.outermost(grey, first, last, 0.5 * self.base_level)

    def _first_side(self, profile: Floats, undershoot: float) -> Side:
        """Look for a coating in the median profile below the face; wide spreads.

        ``profile``, ``undershoot``: as :meth:`_profile` gives them, above the air. A fringe that
        darkens the air outside lightens what lies inside by as much. What is no lighter than the
        lightest tenth of the core is its walls.
        """
        base_level = self.base_level
        base_sd = self.base_sd
        # The deepest fifth may show the other side of a thin sheet.
        outer_count = max(2, int(0.8 * profile.size))
        peak_level = float(profile[:outer_count].max())
        # A normal distribution has a tenth of its values beyond 1.28 standard deviations.
        solid_level = base_level + 1.28 * min(base_sd, 0.3 * base_level)
        # A layer is a coating when it stands out from the base by more than a quarter.
        least_level = 1.25 * (1.2 * solid_level if self.is_separated else solid_level)
        wide_sd = max(base_sd, 0.25 * base_level)
        if peak_level - undershoot > max(least_level, base_level + 1.28 * base_sd):
            return _side(peak_level, base_level, 0.25 * peak_level, wide_sd, coated=True)
        # Without a coating the third level is what lies outside: the air, unless the sheet is amid
        # other material.
        outside_sd = -1.0
        if self.is_separated:
            outside_sd = (1.0 if self.embedded_level else 0.5) * base_level
        return _side(0.0, base_level, outside_sd, wide_sd, coated=False)

    def _covers(self) -> dict[bool, float]:
        """Thickness in voxels of what covers each side; none is looked for amid other material."""
        if self.embedded_level:
            return {}
        return {k: self._cover(profile) for k, (profile, _) in self.profiles.items()}

    def _cover(self, profile: Floats) -> float:
        """Thickness in voxels of what covers a side: an even layer with a brighter one below it.

        0 for none.

        Tape, film or a mount that touches is of one grey; no coating lies below a dimmer layer.
        """
        brightest = int(np.argmax(profile))
        plateau = profile[2 : max(brightest - 2, 2)]
        plateau = plateau[: int(0.8 * plateau.size)]  # the blur of the layer below is left out
        if brightest * self.columns.pitch[2] < _LEAST_COVER_UM or plateau.size < 3:
            return 0.0
        level = np.median(plateau)
        peak_level = profile[brightest]
        is_even = float(np.ptp(plateau)) < 0.15 * float(level)
        if not is_even or level >= 0.8 * peak_level:
            return 0.0
        return float(np.argmax(profile > 0.5 * (level + peak_level)))

    def _fit_blur(self) -> None:
        """Learn the width of the blur with which the staircase fits the sample best.

        With the fringe that the parameters give, or none.
        """
        fringe = 0.0 if isinstance(self.params.fringe, str) else self.params.fringe
        trial_edges = [Edge(width=float(width), fringe=fringe) for width in _WIDTHS]
        costs_by_side = [self._mean_costs(k, trial_edges) for k in self.sample_of]
        costs = np.sum(costs_by_side, axis=0)
        best_index = int(np.argmin(costs))
        shift = 0.0
        # The lowest point of the parabola through the least cost and its neighbours.
        if 0 < best_index < costs.size - 1 and np.isfinite(costs[best_index + 1]):
            a, b, c = costs[best_index - 1 : best_index + 2]
            curvature = max(a - 2 * b + c, 1e-12)
            shift = np.clip(0.5 * (a - c) / curvature, -1, 1)
        log_step = np.log(_WIDTHS[1] / _WIDTHS[0])
        factor = np.exp(shift * log_step)
        self.edge = Edge(width=float(_WIDTHS[best_index] * factor), fringe=fringe)

    def _mean_costs(self, from_high: bool, trial_edges: list[Edge]) -> list[float]:
        """Mean cost of a column with each edge; infinite where none can be fitted.

        A blur so wide that it reaches the end of every column cannot be tried.
        """
        subset = self.sample_of[from_high].thinned(4)
        side = self.sides[from_high]
        fits = [self.fit(subset, side, edge)[4] for edge in trial_edges]
        costs = [cost[np.isfinite(cost)] for cost in fits]
        max_cost = min((cost_limit(cost) for cost in costs if cost.size), default=0.0)
        means = [np.minimum(cost, max_cost).mean() if cost.size else np.inf for cost in costs]
        return [*map(float, means)]

    def _is_thin(self, from_high: bool) -> bool:
        """Tell if hardly a column shows the coating's own grey between its two edges."""
        sample = self.sample_of[from_high]
        fit = self.fit(sample, self.sides[from_high], self.edge)
        thickness = fit[1] * sample.cos_tilt
        is_thick = thickness > 2.0 * RADII[-1] * self.edge.width
        return float(np.mean(is_thick)) < _THICK_SHARE

    def _coated_or_bare(self, from_high: bool, side: Side) -> Side:
        """Return a side whose coating's grey was set, without it where half of it is thinner.

        A wall below a coating hides a thin one, and is left out.
        """
        sample = self.sample_of[from_high]
        fit = self.fit(sample, replace(side, wall_below=0.0), self.edge)
        if float(np.nanmedian(fit[1])) > 0.15 * self.edge.width:
            return side
        bare_side = _side(0.0, self.base_level, -1.0, side.spread[3], coated=False)
        return self._narrowed(from_high, bare_side, is_known=True)

    def _narrowed(self, from_high: bool, side: Side, *, is_known: bool) -> Side:
        """Narrow what is expected of a side to what thick layers and the base below them show.

        ``is_known``: whether the coating's grey is, from elsewhere; then only its spread is
        narrowed. Spreads are those of the columns' fits by the MAD, and a fifth more.
        """
        sample = self.sample_of[from_high]
        level = side.level.copy()
        spread = side.spread.copy()
        side = replace(side, level=level, spread=spread, wall_below=0.0)
        for _ in range(2):
            fit = self.fit(sample, side, self.edge)
            has_face = np.isfinite(fit[0])
            if side.coated and is_known:
                seen_spread = spread[2] if side.lone else 0.0
                spread[2] = max(seen_spread, 0.02 * level[2])
                side = replace(side, wall_below=self._wall_below(sample, fit, side))
            elif side.coated:
                # A layer that is thicker than the blur reaches shows its own grey.
                is_thick = has_face & (fit[1] * sample.cos_tilt > 3.0 * self.edge.width)
                if np.count_nonzero(is_thick) < 50:
                    is_thick = has_face & (fit[1] >= np.nanpercentile(fit[1], 75))
                coating_grey = fit[2][is_thick]
                level[2] = np.median(coating_grey)
                spread[2] = max(1.2 * mad_sd(coating_grey), 0.01 * level[2])
            base_grey = fit[3][has_face]
            level[3] = np.median(base_grey)
            spread[3] = max(1.2 * mad_sd(base_grey), 0.03 * level[3])
        return side

    def _wall_below(self, sample: Sample, fit: Floats, side: Side) -> float:
        """By how much, in grey, what lies directly below a coating is lighter than the base.

        A base of walls and pores is solid there, and the more pores it has the more its grey varies
        from place to place. What noise adds to that is taken off. 0 for a base that varies little
        beyond it, which is even, and for one so thin that its edges blur into each other, which
        shows no pores. ``fit`` (5, 1, n): of the sample, as :meth:`fit` gives it.
        """
        width = self.edge.width
        varied = mad_sd(fit[3])
        thickness = float(np.nanmedian(fit[1]))
        sheet = (sample.opposite - sample.outer) * sample.cos_tilt
        base_px = float(np.nanmedian(sheet)) - 2.0 * thickness
        # The fit goes 3 widths below the interface, and so far reaches the blur of the other one;
        # the coarse sheet is a width larger on either side.
        if not varied > 0 or base_px < 8.0 * width:
            return 0.0
        last_sample = int(thickness + 6.0 * width) + 1
        # How a fit's base grey varies by noise: from its normal equations, which the greys of the
        # column have no part in, less the priors of the two greys.
        point = np.array([3.0 * width, thickness, *side.level[2:]])
        matrix = np.zeros((4, 4))
        column = (np.zeros(last_sample + 1, np.float32), 0, last_sample)
        blur = (0.0, self.scatter, width)  # after the level of the air
        greys = (side.level, side.spread, True)
        plain = (None, 1.0, 0.0, 0.0)  # no fringe, and no wall below the coating
        _fit_kernels.evaluate(*column, *blur, point, *greys, matrix, np.zeros(4), *plain)
        precision = matrix + np.tril(matrix, -1).T
        by_priors = np.diag([0.0, 0.0, *side.spread[2:] ** -2.0])
        inverse = np.linalg.inv(precision)
        covariance = inverse @ (precision - by_priors) @ inverse
        by_noise = float(covariance[3, 3])
        if varied**2 <= 2.0 * by_noise:
            return 0.0
        return _WALL * float(np.sqrt(varied**2 - by_noise))

    def _undershoots(self) -> bool:
        """Whether air beside the faces is darker than farther away, as a fringe makes it.

        By much more than chance, and hardly where the fringe would be over. A blur that is roughly
        right will do.
        """
        if self.params.fringe != "auto" or self.embedded_level:
            return False  # what lies beside such a sheet is no air
        # At the distances near the face, and where a fringe is over.
        total_weight = weighted_sum = np.zeros(len(_NEAR) + 1)
        for k, sample in self.sample_of.items():
            undershoots = self._undershoots_by_row(sample, self.sides[k])
            row_count = np.isfinite(undershoots).sum(axis=1)
            has_rows = row_count >= _ROWS
            undershoots = np.where(has_rows[:, None], undershoots, 0.0)
            degrees = np.maximum(row_count - 1, 1)
            error = np.nanstd(undershoots, axis=1) / np.sqrt(degrees)
            # Sides whose contrast differs are weighted by what their rows' scatter tells.
            is_clear = has_rows & (error > 0)
            precision = 1.0 / np.maximum(error, 1e-12) ** 2
            weight = np.where(is_clear, precision, 0.0)
            total_weight = total_weight + weight
            weighted_sum = weighted_sum + weight * np.nanmean(undershoots, axis=1)
        if not total_weight.all():
            return False
        *near_face, beyond_fringe = weighted_sum / total_weight
        near_error = 1.0 / np.sqrt(total_weight[:-1])
        detection_limit = -np.maximum(_LEAST, _SIGMAS * near_error)
        # No more than this share of the undershoot may be there in between.
        is_over = beyond_fringe > 0.4 * np.array(near_face)
        return bool(((near_face < detection_limit) & is_over).any())

    def _undershoots_by_row(self, sample: Sample, side: Side) -> Floats:
        """Grey of the air near the faces above that farther away, as a share of the contrast.

        (distances, rows): at the distances of ``_NEAR`` and ``_BETWEEN``, in widths of the blur
        from the face, for each sampled row; NaN where a row shows too little of the air there.
        """
        face_depth = self.fit(sample, side, self.edge)[0, 0]
        unit_px = max(self.edge.width, 1.0)
        cos_tilt = sample.cos_tilt[0]
        farthest_px = unit_px * _FAR[1] / cos_tilt
        first_index = np.nan_to_num(face_depth - farthest_px).astype(int)
        depth_count = int(np.ceil(farthest_px.max())) + 2
        depth_index = first_index[:, None] + np.arange(depth_count)
        grey = _grey_at(sample.grey[0], depth_index)
        distance = (face_depth[:, None] - depth_index) * cos_tilt[:, None] / unit_px
        is_inside = (depth_index >= 0) & (depth_index < sample.grey.shape[2])
        # What floats in the air is left out.
        is_air = is_inside & (np.abs(grey) < 5.0 * self.scatter)
        row_count = int(sample.row.max()) + 1
        row_number = np.broadcast_to(sample.row[0][:, None], grey.shape)

        def mean_grey(start: float, stop: float) -> Floats:
            in_range = is_air & (distance >= start) & (distance < stop)
            rows = row_number[in_range]
            column_count = np.bincount(rows, minlength=row_count)
            grey_sum = np.bincount(rows, grey[in_range], row_count)
            mean = grey_sum / np.maximum(column_count, 1)
            return np.where(column_count >= _FEW_COLUMNS, mean, np.nan)

        near_grey = np.array([mean_grey(*limits) for limits in (*_NEAR, _BETWEEN)])
        contrast = side.level[2 if side.coated else 3]
        return (near_grey - mean_grey(*_FAR)) / contrast

    def _fit_fringe(self, samples: Samples, thin_sides: list[bool]) -> None:
        """Learn the blur, fringe and greys with which the staircase fits the sample best.

        The greys are those of coatings that are nowhere thick, on the sides ``thin_sides``.

        All stays as it was where the best has no fringe.
        """
        sides = self.sides
        width = self.edge.width
        misfit = self._misfit(samples, thin_sides, _WINDOW * max(width, 1.0))

        # The simplex moves the logarithm of the blur over what it was, the size of the fringe, the
        # logarithm of its width over the usual one, and those of thin coatings' greys.
        def trial_of(vector: Floats) -> tuple[Edge, Sides]:
            blur_px = width * float(np.exp(vector[0]))
            fringe = max(float(vector[1]), 0.0)
            fringe_px = FRINGE_PX * float(np.exp(vector[2]))
            fringed_edge = Edge(width=blur_px, fringe=fringe, fringe_width=fringe_px)
            return fringed_edge, _brighter(sides, thin_sides, vector[3:])

        def cost(vector: Floats) -> float:
            # Where the width of the fringe shows little it is the usual one.
            width_penalty = (float(vector[2]) / 0.35) ** 2
            penalty = width_penalty + float(np.sum(vector[3:] ** 2))
            below_zero = max(-float(vector[1]), 0.0)
            return misfit(*trial_of(vector)) + 1e-4 * penalty + below_zero

        thin_count = len(thin_sides)
        steps = np.diag([0.1, 0.08, 0.25] + [0.1] * thin_count)
        # Logarithms of a thin coating's grey over the brightest that was seen.
        start_shares = (0.0, 0.2, 0.45) if thin_sides else (0.0,)
        starts = [np.array([0.1, 0.1, 0.0] + [share] * thin_count) for share in start_shares]
        optima = [_simplex(cost, start, steps, 90) for start in starts]
        best = min(optima, key=lambda optimum: float(optimum.fun))
        best_edge, best_sides = trial_of(best.x)
        if best_edge.fringe > 0.005:
            self.edge, self.sides = best_edge, best_sides

    def _fit_thin(self, samples: Samples, thin_sides: list[bool]) -> None:
        """Learn the blur and greys with which the staircase fits the sample best.

        The greys are those of coatings that are nowhere thick, on the sides ``thin_sides``.

        Grey and thickness of one thin layer can hardly be separated; the shape of many profiles
        helps a little.
        """
        sides = self.sides
        edge = self.edge
        misfit = self._misfit(samples, thin_sides, _WINDOW * edge.width)

        # The simplex moves logarithms: of the blur, and of the greys, over what they were.
        def trial_of(vector: Floats) -> tuple[Edge, Sides]:
            blur_px = edge.width * float(np.exp(vector[0]))
            blurred_edge = replace(edge, width=blur_px)
            return blurred_edge, _brighter(sides, thin_sides, vector[1:])

        def cost(vector: Floats) -> float:
            # A layer's grey is seldom far from the brightest that was seen of it.
            penalty = float(np.sum(vector**2))
            return misfit(*trial_of(vector)) + 1e-4 * penalty

        thin_count = len(thin_sides)

        def cost_of_width(log_width: float, share: float) -> float:
            return cost(np.array([log_width, *[share] * thin_count]))

        # Brighter layers with a wider blur look nearly the same: the search goes along that valley
        # first.
        least_cost = np.inf
        start = np.zeros(1 + thin_count)
        bounded = partial(optimize.minimize_scalar, bounds=(-0.2, 0.6), method="bounded")
        for share in (0.0, 0.15, 0.3, 0.45, 0.6, 0.75):
            optimum: Any = bounded(cost_of_width, args=(share,), options={"xatol": 0.01})
            if optimum.fun < least_cost:
                least_cost = float(optimum.fun)
                start = np.array([float(optimum.x), *[share] * thin_count])
        steps = np.diag([0.03, *[0.08] * thin_count])
        # The first corner goes along the valley: brighter layers with a wider blur.
        steps[0, 1:] = 0.08
        best = _simplex(cost, start, steps, 80)
        self.edge, self.sides = trial_of(best.x)

    def _misfit(
        self, samples: Samples, thin_sides: list[bool], window: float
    ) -> Callable[[Edge, Sides], float]:
        """Return the mean cost of a column as a function of edge and sides.

        Of a subset of the samples, more of them where thin coatings are learnt. No column counts
        for more than ``cost_limit`` of the fits with the present edge and sides. ``window``: width
        of the blur, in voxels, after which samples are chosen, the same for all edges.
        """
        every = 3 if thin_sides else 4
        subset = {k: sample.thinned(every) for k, sample in samples.items()}
        column_count = sum(sample.outer.size for sample in subset.values())

        def costs_of(edge: Edge, sides: Sides) -> dict[bool, Floats]:
            return {k: self.fit(sample, sides[k], edge, window)[4] for k, sample in subset.items()}

        present_costs = costs_of(self.edge, self.sides)
        max_costs = {k: cost_limit(cost) for k, cost in present_costs.items()}

        def misfit(edge: Edge, sides: Sides) -> float:
            total = 0.0
            for k, cost in costs_of(edge, sides).items():
                total += float(np.sum(np.fmin(cost, max_costs[k])))  # NaN: no fit
            return total / column_count

        return misfit


def _brighter(sides: Sides, thin_sides: list[bool], shares: Floats) -> Sides:
    """Return the sides with the greys of thin coatings multiplied by exp(share).

    From then on these greys are known.
    """
    brighter = dict(sides)
    for k, share in zip(thin_sides, shares, strict=True):
        grey = sides[k].grey * float(np.exp(share))
        brighter[k] = _with_coating(sides[k], grey, 1e-3 * grey)
    return brighter


def _simplex(
    cost: Callable[[Floats], float], start: Floats, steps: Floats, trials: int
) -> optimize.OptimizeResult:
    """Look for the least cost from a start, with so many trials at most; ``steps`` (n, n)."""
    corners = np.vstack([start, start + steps])
    options: Any = {"initial_simplex": corners, "xatol": 2e-3, "fatol": 1e-7, "maxfev": trials}
    return optimize.minimize(cost, start, method="Nelder-Mead", options=options)
