"""What the fit has to know, learnt from some columns: the grey levels, how far they vary, the blur, the noise."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from planish.core.errors import VolumeError
from planish.core.tiles import Tile
from planish.surface import _kernels
from planish.surface.coarse import CORE
from planish.surface.columns import Columns
from planish.surface.levels import GreyLevels, is_coating, spread
from planish.surface.oriented import Guide, Scale, oriented
from planish.surface.params import SurfaceParams
from planish.surface.survey import Survey

Array = NDArray[np.float64]

_ROWS = 24  # rows that are read for it
_WIDTH = 1024  # columns of each of them
_COLUMNS = 3000  # columns that are fitted
_WIDTHS = np.geomspace(0.35, 3.2, 14)  # blur along a column that is tried, in voxels
_QUIET = 8.0  # contrast-to-noise ratio below which columns are smoothed with their neighbours
_CORRELATED = 1.15  # noise over that of neighbouring voxels' differences, from which on it is no longer white
_BLENDS = (0.5, 0.75, 1.0, 1.5, 2.0)  # voxels
_BESIDE_UM = 15.0  # from the face into the air
_THICK = 3.0  # widths of the blur: a thicker layer shows its own grey
_PLAIN, _PLAIN_SHARE = 5.5, 0.05  # widths of the blur, and share of columns: such a layer shows it beyond doubt
_TRACE = 0.15  # widths of the blur: a coating that is thinner in half of the columns is none
_QUIET_BLEND = 2.0  # columns
_TRIALS = 80  # of the search for the grey of coatings that are nowhere thick
_SHARES = (0.0, 0.15, 0.3, 0.45, 0.6, 0.75)  # logarithm of their grey over the brightest that was seen
_FEW = 50  # columns that show it


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """What is known of the layers on one side before a column is looked at.

    Attributes
    ----------
    level, spread : (4,)
        Of face, thickness, grey of the coating (or of what lies outside), grey of the base: the value expected, and
        how far a column may differ. Only those of the greys are used.
    coated : bool
    """

    level: Array
    spread: Array
    coated: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Learnt:
    """All that the fit of a column needs beside the column.

    Attributes
    ----------
    scale : Scale
    noise : float
        Standard deviation of what the fit sees in the air.
    base : float
        Level of the base above the air.
    width : float
        Standard deviation of the blur along a column that the sheet crosses at a right angle, in voxels.
    reach : float
        How far outside the expected face the search starts, in voxels.
    amid : float
        Grey at which a sheet amid other material was told from it; 0 where air lies beside the sheet.
    high, low : Side
        The side at the high and at the low end of the columns.
    """

    scale: Scale
    noise: float
    base: float
    width: float
    reach: float
    amid: float
    high: Side
    low: Side

    def side(self, *, high: bool) -> Side:
        """Return the side at one end of the columns."""
        return self.high if high else self.low

    def levels(self, pitch_um: float) -> GreyLevels:
        """Return the levels as grey values of the volume."""
        air, polarity = self.scale.air, self.scale.polarity
        high, low = (
            float(polarity * side.level[2] + air) if side.coated else float("nan") for side in (self.high, self.low)
        )
        return GreyLevels(
            air=air, base=polarity * self.base + air, coating_top=high, coating_bottom=low, noise=self.noise,
            polarity=polarity, blur_um=self.width * pitch_um,
        )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sample:
    """Columns read from one end, as one row: (1, n, depth), with expected faces and tilt (1, n)."""

    grey: NDArray[np.float32]
    outer: Array
    other: Array
    tilt: Array

    def thinned(self, every: int) -> _Sample:
        return _Sample(
            grey=self.grey[:, ::every], outer=self.outer[:, ::every], other=self.other[:, ::every],
            tilt=self.tilt[:, ::every],
        )  # fmt: skip


def learn(columns: Columns, guide: Guide, survey: Survey, params: SurfaceParams) -> Learnt:
    """Learn the grey levels and the blur from a sample of columns.

    Raises
    ------
    VolumeError
        If the core of the sheet does not stand out from the air.
    """
    return _Learner(columns, guide, survey, params).learnt()


class _Learner:
    def __init__(self, columns: Columns, guide: Guide, survey: Survey, params: SurfaceParams) -> None:
        self.columns, self.guide, self.params, self.survey = columns, guide, params, survey
        self.amid = survey.coarse.threshold if params.seed_um is not None else 0.0
        self.depth = columns.shape[2]
        self.pitch = columns.pitch
        self.scale = Scale(air=survey.air, polarity=survey.polarity)
        # How far the block's face may lie from a column's own: a block's slope and the roughness.
        self.reach = 2.0 + 1.5 * survey.coarse.block * max(self.pitch[:2]) / self.pitch[2]
        self.noise = max(survey.noise / columns.step, 1e-6 * abs(survey.air) + 1e-9)
        self.rows = self._chosen_rows()
        self.kept: dict[tuple[Tile, float], NDArray[np.float32]] = {}

    def learnt(self) -> Learnt:
        sample = self._sample(high=True)
        base, base_sd = self._base(sample)
        self._calm(base)
        samples = {high: self._sample(high=high) for high in (True, False)}
        # Coarse profile per side: is there a coating, how bright, how much does it vary?
        sides = {high: self._first_side(part, base, base_sd) for high, part in samples.items()}
        width = self._blur(samples, sides)
        thin = [high for high in samples if self._is_thin(samples[high], sides[high], width)]
        if thin:
            width, sides = self._thin_levels(self._quiet_samples(samples, width), sides, width, thin)
        told = self.params.coating_grey is not None
        sides = {high: self._narrowed(samples[high], sides[high], width, told or high in thin) for high in samples}
        if told:
            sides = {high: self._told_side(samples[high], side, width, base) for high, side in sides.items()}
        return Learnt(
            scale=self.scale, noise=self.noise, base=base, width=width, reach=self.reach, amid=self.amid,
            high=sides[True], low=sides[False],
        )  # fmt: skip

    def _chosen_rows(self) -> list[Tile]:
        """Pieces of rows, spread over the sheet."""
        guide, (_, cols, _) = self.guide, self.columns.shape
        both = np.isfinite(guide.low) & np.isfinite(guide.high)
        rows = np.flatnonzero(both.any(axis=1))
        rows = rows[np.unique(np.linspace(0, rows.size - 1, min(rows.size, _ROWS)).astype(int))]
        wide = min(cols, _WIDTH)
        # Starts that are far apart from one row to the next: multiples of the golden section.
        starts = ((np.arange(rows.size) * 0.6180339887498949) % 1.0 * (cols - wide + 1)).astype(int)
        return [Tile(int(r), int(r) + 1, int(c), int(c) + wide) for r, c in zip(rows, starts, strict=True)]

    def _read(self, tile: Tile, *, high: bool) -> NDArray[np.float32]:
        # The same columns are looked at several times.
        key = (tile, self.scale.blend)
        if key not in self.kept:
            if any(blend != self.scale.blend for _, blend in self.kept):
                self.kept.clear()
            guide = self.guide.part(self.scale.grown(tile, self.columns.shape[:2]))
            self.kept[key] = oriented(self.columns, tile, guide, self.scale)[0]
        part = self.kept[key]
        return np.ascontiguousarray(part[:, ::-1]) if high else part

    def _sample(self, *, high: bool) -> _Sample:
        per_row = max(1, _COLUMNS // len(self.rows))
        parts: list[tuple[NDArray[np.float32], Array, Array, Array]] = []
        for tile in self.rows:
            guide = self.guide.part(tile)
            outer, other = (a[0] for a in guide.faces(self.depth, high=high))
            good = np.flatnonzero(np.isfinite(outer) & np.isfinite(other))
            good = good[np.unique(np.linspace(0, good.size - 1, min(good.size, per_row)).astype(int))]
            if good.size:
                parts.append((self._read(tile, high=high)[good], outer[good], other[good], guide.tilt[0, good]))
        if not parts:
            raise VolumeError("No column of the volume shows both faces of the sheet. Check --through.")
        grey, outer, other, tilt = (np.concatenate([p[n] for p in parts])[None] for n in range(4))
        return _Sample(grey=grey, outer=outer, other=other, tilt=tilt)  # type: ignore[arg-type]

    def _base(self, sample: _Sample) -> tuple[float, float]:
        """Level of the base above the air, and how much it varies from place to place."""
        shares = np.linspace(*CORE, 9)
        depth = np.rint(sample.outer[0][:, None] + (sample.other - sample.outer)[0][:, None] * shares).astype(int)
        core = np.take_along_axis(sample.grey[0], np.clip(depth, 0, self.depth - 1), axis=1).astype(np.float64)
        core = core[np.isfinite(core)]
        level = float(np.median(core))
        if level <= 0:
            raise VolumeError("The core of the sheet is not brighter than the air around it. Check --sheet-grey.")
        return level, float(np.sqrt(max(spread(core) ** 2 - self.noise**2, (0.05 * level) ** 2)))

    def _calm(self, base: float) -> None:
        """Choose how far columns are averaged with their neighbours, and what noise that leaves."""
        whole = self._air_noise()
        if not whole > _CORRELATED * self.noise:
            cnr = base / self.noise
            if cnr < _QUIET:
                # Averaging over a Gaussian of s voxels divides white noise by 2 sqrt(pi) s.
                blend = min(_QUIET / cnr / (2 * np.sqrt(np.pi)), 1.5)
                self.scale = replace(self.scale, blend=blend)
                self.noise /= max(1.0, 2 * np.sqrt(np.pi) * blend)
            return
        # Neighbouring voxels share their noise, or streaks lie in the air: averaging helps less, so it is tried out.
        self.noise = whole
        for blend in _BLENDS:
            if base / self.noise >= _QUIET:
                return
            self.scale = replace(self.scale, blend=blend)
            self.noise = self._air_noise()

    def _air_noise(self) -> float:
        """Standard deviation of the air just outside the faces, as the fit will see it; NaN where there is none."""
        if self.amid:
            return float("nan")  # what lies beside is no air
        return spread(np.concatenate([*self._beside()]).astype(np.float64))

    def _beside(self) -> Iterator[NDArray[np.float32]]:
        beside = int(np.ceil(_BESIDE_UM / self.pitch[2]))
        for tile in self.rows:
            part = self._read(tile, high=False)
            for high in (True, False):
                outer = self.guide.part(tile).faces(self.depth, high=high)[0][0]
                grey = part[:, ::-1] if high else part
                first = np.where(np.isfinite(outer), outer - self.reach, -1.0).astype(int) - beside
                for at in (first, first - beside):
                    held = np.flatnonzero(at >= 0)
                    yield grey[held, at[held]]

    def _told_side(self, sample: _Sample, side: Side, width: float, base: float) -> Side:
        """Keep the coating whose grey was told where there is one."""
        thickness = self._fit(sample, side, width)[1]
        if float(np.nanmedian(thickness)) > _TRACE * width:
            return side
        bare = Side(
            level=np.array([0.0, 0.0, 0.0, base]), spread=np.array([0.0, 0.0, -1.0, side.spread[3]]), coated=False
        )
        return self._narrowed(sample, bare, width, told=True)

    def _first_side(self, sample: _Sample, base: float, base_sd: float) -> Side:
        """Look for a coating in the median profile below the face; wide spreads."""
        if self.params.coating_grey is not None:
            grey = self.scale.polarity * (self.params.coating_grey - self.scale.air)
            if grey < 1.05 * base:
                raise VolumeError(
                    f"The coating's grey {self.params.coating_grey:g} does not stand out from the base "
                    f"({self.scale.polarity * base + self.scale.air:.4g}) on the side away from the air "
                    f"({self.scale.air:.4g}). Check --coating-grey."
                )
            return Side(
                level=np.array([0.0, 0.0, grey, base]),
                spread=np.array([0.0, 0.0, 0.02 * grey, max(base_sd, 0.25 * base)]), coated=True,
            )  # fmt: skip
        outer = sample.outer[0]
        start = np.array([
            _kernels.nearest(g, e, self.reach, self.amid) if self.amid
            else _kernels.outermost(g, max(int(e - self.reach), 0), int(e + self.reach) + 1, 0.5 * base)
            for g, e in zip(sample.grey[0], outer, strict=True)
        ])  # fmt: skip
        good = start > 0
        half = int(np.median(sample.other[0] - outer)) // 2
        inward = np.arange(max(half, 2))
        depth = np.clip(start[good][:, None] + inward, 0, self.depth - 1)
        profile = np.nanmedian(np.take_along_axis(sample.grey[0][good], depth, axis=1), axis=0)
        peak = float(profile[: max(2, int(0.8 * half))].max())
        solid = base + 1.28 * min(base_sd, 0.3 * base)
        told = self.params.sheet_grey is not None or self.survey.amid
        coated = is_coating(peak, 0.0, 1.2 * solid if told else solid)
        # Without a coating the third level is what lies outside: the air, unless the sheet was told from other
        # material.
        outside = (1.0 if self.amid else 0.5) * base if told else -1.0
        level = np.array([0.0, 0.0, peak if coated else 0.0, base])
        wide = np.array([0.0, 0.0, 0.25 * peak if coated else outside, max(base_sd, 0.25 * base)])
        return Side(level=level, spread=wide, coated=coated)

    def _fit(self, sample: _Sample, side: Side, width: float, window: float = 0.0) -> Array:
        result = np.empty((5, *sample.outer.shape))
        _kernels.fit_faces(
            sample.grey, sample.outer, sample.other, sample.tilt, 0.0, width, self.noise, side.level, side.spread,
            side.coated, self.reach, result, window, self.amid,
        )  # fmt: skip
        return result

    def _blur(self, samples: dict[bool, _Sample], sides: dict[bool, Side]) -> float:
        """Width of the blur in voxels: the one with which the staircase fits the sample best."""
        costs = np.zeros(_WIDTHS.size)
        for i, width in enumerate(_WIDTHS):
            for high, sample in samples.items():
                cost = self._fit(sample.thinned(4), sides[high], width)[4]
                cost = cost[np.isfinite(cost)]
                # A blur so wide that it reaches the end of every column cannot be tried.
                costs[i] += float(np.mean(np.minimum(cost, 400.0))) if cost.size else np.inf
        best = int(np.argmin(costs))
        if 0 < best < costs.size - 1 and np.isfinite(costs[best + 1]):
            a, b, c = costs[best - 1 : best + 2]
            shift = 0.5 * (a - c) / max(a - 2 * b + c, 1e-12)
            step = np.log(_WIDTHS[1] / _WIDTHS[0])
            return float(_WIDTHS[best] * np.exp(np.clip(shift, -1, 1) * step))
        return float(_WIDTHS[best])

    def _is_thin(self, sample: _Sample, side: Side, width: float) -> bool:
        """Whether no column shows the coating's own grey, because the blur reaches through all of it."""
        if not side.coated or self.params.coating_grey is not None:
            return False
        # With a grey that is too low the layer seems thicker and the blur narrower than they are, hence the margin.
        thick = self._fit(sample, side, width)[1] * sample.tilt > _PLAIN * width
        return float(np.mean(thick)) < _PLAIN_SHARE

    def _quiet_samples(self, samples: dict[bool, _Sample], width: float) -> dict[bool, _Sample]:
        """Sample columns that are means over their neighbours, as far as the sheet's slope does not widen the blur."""
        guide, kept = self.guide, self.scale
        steep = float(np.nanpercentile(np.hypot(guide.slope_r, guide.slope_c), 90)) * self.columns.step
        blend = min(_QUIET_BLEND, 0.3 * width / max(steep, 1e-3))
        if blend <= max(kept.blend, 0.3):
            return samples
        self.scale = replace(kept, blend=blend)
        quiet = {high: self._sample(high=high) for high in samples}
        self.scale = kept
        return quiet

    def _thin_levels(
        self, samples: dict[bool, _Sample], sides: dict[bool, Side], width: float, thin: list[bool]
    ) -> tuple[float, dict[bool, Side]]:
        """Blur, and greys of coatings that are nowhere thick, with which the staircase fits the sample best.

        Grey and thickness of one thin layer can hardly be told apart; the shape of many profiles tells a little.
        """
        few = {high: sample.thinned(3) for high, sample in samples.items()}
        size = max(sum(s.outer.size for s in few.values()), 1)

        def put(at: Array) -> tuple[float, dict[bool, Side]]:
            put_to = dict(sides)
            for high, share in zip(thin, at[1:], strict=True):
                level, wide = sides[high].level.copy(), sides[high].spread.copy()
                level[2] *= np.exp(share)
                wide[2] = 1e-3 * level[2]
                put_to[high] = Side(level=level, spread=wide, coated=True)
            return width * float(np.exp(at[0])), put_to

        def cost(at: Array) -> float:
            tried, put_to = put(at)
            total = 0.0
            for high, sample in few.items():
                found = self._fit(sample, put_to[high], tried, 1.3 * width)[4]
                total += float(np.sum(np.where(np.isfinite(found), np.minimum(found, 400.0), 400.0)))
            # A layer's grey is seldom far from the brightest that was seen of it.
            return total / size + 1e-4 * float(np.sum(at**2))

        def with_width(share: float) -> tuple[float, Array]:
            """Best width for coatings that are so much brighter."""

            def of(log_width: float) -> float:
                return cost(np.array([log_width, *[share] * len(thin)]))

            best = optimize.minimize_scalar(of, bounds=(-0.2, 0.6), method="bounded", options={"xatol": 0.01})
            return float(best.fun), np.array([float(best.x), *[share] * len(thin)])

        # Brighter layers with a wider blur look nearly the same: the search goes along that valley first.
        _, at = min((with_width(share) for share in _SHARES), key=lambda found: found[0])
        along = np.array([0.03, *[0.08] * len(thin)])
        steps = np.vstack([along, np.diag(np.where(np.arange(along.size) > 0, 0.08, 0.03))[1:]])
        best = optimize.minimize(
            cost, at, method="Nelder-Mead",
            options={"initial_simplex": np.vstack([at, at + steps]), "xatol": 2e-3, "fatol": 1e-7, "maxfev": _TRIALS},
        )  # fmt: skip
        at = np.asarray(best.x, dtype=np.float64)
        return put(at)

    def _narrowed(self, sample: _Sample, side: Side, width: float, told: bool) -> Side:
        """Narrow what is expected to what thick layers and the base below them show."""
        level, wide = side.level.copy(), side.spread.copy()
        for _ in range(2):
            fit = self._fit(sample, Side(level=level, spread=wide, coated=side.coated), width)
            known = np.isfinite(fit[0])
            if side.coated and told:
                wide[2] = 0.02 * level[2]
            elif side.coated:
                thick = known & (fit[1] * sample.tilt > _THICK * width)
                if np.count_nonzero(thick) < _FEW:
                    thick = known & (fit[1] >= np.nanpercentile(fit[1], 75))
                level[2] = float(np.median(fit[2][thick]))
                wide[2] = max(1.2 * spread(fit[2][thick]), 0.01 * level[2])
            level[3] = float(np.median(fit[3][known]))
            wide[3] = max(1.2 * spread(fit[3][known]), 0.03 * level[3])
        return Side(level=level, spread=wide, coated=side.coated)
