"""The fine search: learn the grey levels and the blur from some columns, then fit every column of the volume."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.errors import VolumeError
from planish.surface import _kernels
from planish.surface.centre import gaussian_regression
from planish.surface.coarse import CORE, CoarseSheet, to_columns
from planish.surface.levels import GreyLevels, is_coating, spread
from planish.surface.params import SurfaceParams

Array = NDArray[np.float64]

_SLAB = 16  # rows worked on together
_SAMPLE = 3000  # columns that the levels and the blur are read from
_WIDTHS = np.geomspace(0.35, 3.2, 14)  # blur along a column that is tried, in voxels
_QUIET = 8.0  # contrast-to-noise ratio below which columns are smoothed with their neighbours
_CORRELATED = 1.15  # noise over that of neighbouring voxels' differences, from which on it is no longer white
_BLENDS = (0.5, 0.75, 1.0, 1.5, 2.0)  # voxels
_BESIDE_UM = 15.0  # from the face into the air
_SPIKE_UM = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class First:
    """What the coarse search learnt: level and noise of the air, polarity, and the value outside the field of view."""

    air: float
    noise: float
    polarity: float
    padding: float | None


class Search:
    """The fine search: every column of the volume, in slabs of rows."""

    def __init__(
        self,
        *,
        columns: xr.DataArray,
        coarse: CoarseSheet,
        first: First,
        pitch: tuple[float, float, float],
        params: SurfaceParams,
    ) -> None:
        self.values = columns.values
        self.depth_um = columns.coords[columns.dims[2]].values
        self.air, self.polarity, self.padding = first.air, first.polarity, first.padding
        self.pitch, self.params = pitch, params
        shape = self.values.shape[:2]
        self.low = to_columns(coarse.low, coarse.block, shape)
        self.high = to_columns(coarse.high, coarse.block, shape)
        smooth = gaussian_regression(
            0.5 * (self.low + self.high) * pitch[2], (pitch[0], pitch[1]),
            cutoff_um=max(8 * coarse.block * max(pitch[:2]), 2 * float(np.nanmedian(self.high - self.low)) * pitch[2]),
        )  # fmt: skip
        slope_r, slope_c = (np.gradient(smooth, p, axis=i) for i, p in enumerate(pitch[:2]))
        cosine = 1 / np.sqrt(1 + slope_r**2 + slope_c**2)
        self.tilt = np.where(np.isfinite(cosine), cosine, 1.0)
        # How far the block's face may lie from a column's own: a block's slope and the roughness.
        self.reach = 2.0 + 1.5 * coarse.block * max(pitch[:2]) / pitch[2]
        self.noise = max(first.noise, 1e-6 * abs(self.air) + 1e-9)
        self.blend = 0.0

    def slab(self, start: int, stop: int, *, high: bool) -> NDArray[np.float32]:
        """Grey above the air of some rows, read from one end of the columns: (rows, cols, depth)."""
        halo = int(np.ceil(3 * self.blend)) if self.blend else 0
        lo, hi = max(start - halo, 0), min(stop + halo, self.values.shape[0])
        part = np.array(self.values[lo:hi], dtype=np.float32)
        self._drop_padding(part)
        part -= np.float32(self.air)
        if self.polarity < 0:
            part *= np.float32(-1)
        if halo:
            part = ndimage.gaussian_filter(part, (self.blend, self.blend, 0), mode="nearest", truncate=3.0)
            part = part[start - lo : part.shape[0] - (hi - stop)]
        return np.ascontiguousarray(part[:, :, ::-1] if high else part)

    def _drop_padding(self, slab: NDArray[np.float32]) -> None:
        if self.padding is not None:
            slab[slab == self.padding] = np.nan

    def expected(self, rows: slice, *, high: bool) -> tuple[Array, Array]:
        """Depth of the outer and the opposite face in the direction of reading."""
        last = self.values.shape[2] - 1
        outer, other = (self.high, self.low) if high else (self.low, self.high)
        outer, other = outer[rows], other[rows]
        return (last - outer, last - other) if high else (outer, other)

    def levels(self) -> GreyLevels:
        """Learn the grey levels and the blur from a sample of columns."""
        both = np.isfinite(self.low) & np.isfinite(self.high)
        rows = np.flatnonzero(both.any(axis=1))
        rows = rows[np.unique(np.linspace(0, rows.size - 1, min(rows.size, 24)).astype(int))]
        sample = {high: self._sampled(rows, high=high) for high in (True, False)}
        slab, outer, other = sample[True][:3]
        self.base, base_sd = self._base(slab, outer, other)
        self._calm(rows)
        if self.blend:
            sample = {high: self._sampled(rows, high=high) for high in (True, False)}
        # Coarse profile per side: is there a coating, how bright, how much does it vary?
        self.prior: dict[bool, tuple[Array, Array, bool]] = {}
        for high, (slab, outer, other, _tilt) in sample.items():
            self.prior[high] = self._first_prior(slab, outer, other, base_sd)
        self.width_um = self._blur(sample)
        for high in sample:
            self.prior[high] = self._learnt(sample[high], self.prior[high])
        greys = {high: float(self.polarity * prior[0][2] + self.air) if prior[2] else float("nan")
                 for high, prior in self.prior.items()}  # fmt: skip
        return GreyLevels(
            air=self.air, base=self.polarity * self.base + self.air, coating_top=greys[True],
            coating_bottom=greys[False], noise=self.noise, polarity=self.polarity, blur_um=self.width_um,
        )  # fmt: skip

    def _calm(self, rows: NDArray[np.intp]) -> None:
        """Choose how far columns are averaged with their neighbours, and what noise that leaves."""
        whole = self._air_noise(rows)
        if not whole > _CORRELATED * self.noise:
            cnr = self.base / self.noise
            if cnr < _QUIET:
                # Averaging over a Gaussian of s voxels divides white noise by 2 sqrt(pi) s.
                self.blend = min(_QUIET / cnr / (2 * np.sqrt(np.pi)), 1.5)
                self.noise /= max(1.0, 2 * np.sqrt(np.pi) * self.blend)
            return
        # Neighbouring voxels share their noise, or streaks lie in the air: averaging helps less, so it is tried out.
        self.noise = whole
        for blend in _BLENDS:
            if self.base / self.noise >= _QUIET:
                return
            self.blend = blend
            self.noise = self._air_noise(rows)

    def _air_noise(self, rows: NDArray[np.intp]) -> float:
        """Standard deviation of the air just outside the faces, as the fit will see it; NaN where there is none."""
        found: list[NDArray[np.float32]] = []
        beside = int(np.ceil(_BESIDE_UM / self.pitch[2]))
        for r in rows:
            for high in (True, False):
                outer = self.expected(slice(r, r + 1), high=high)[0][0]
                slab = self.slab(int(r), int(r) + 1, high=high)[0]
                first = np.where(np.isfinite(outer), outer - self.reach, -1.0).astype(int) - beside
                for at in (first, first - beside):
                    held = np.flatnonzero(at >= 0)
                    found.append(slab[held, at[held]])
        return spread(np.concatenate(found).astype(np.float64))

    def _sampled(self, rows: NDArray[np.intp], *, high: bool) -> tuple[NDArray[np.float32], Array, Array, Array]:
        """Columns of some rows as one slab of a single row: (1, n, depth), with expected faces and tilt."""
        per_row = max(1, _SAMPLE // rows.size)
        parts: list[tuple[NDArray[np.float32], Array, Array, Array]] = []
        for r in rows:
            outer, other = self.expected(slice(r, r + 1), high=high)
            good = np.flatnonzero(np.isfinite(outer[0]) & np.isfinite(other[0]))
            good = good[np.unique(np.linspace(0, good.size - 1, min(good.size, per_row)).astype(int))]
            slab = self.slab(int(r), int(r) + 1, high=high)
            parts.append((slab[0, good], outer[0, good], other[0, good], self.tilt[r, good]))
        slab = np.concatenate([p[0] for p in parts])[None]
        outer = np.concatenate([p[1] for p in parts])[None]
        other = np.concatenate([p[2] for p in parts])[None]
        tilt = np.concatenate([p[3] for p in parts])[None]
        return slab, outer, other, tilt

    def _base(self, slab: NDArray[np.float32], outer: Array, other: Array) -> tuple[float, float]:
        """Level of the base above the air, and how much it varies from place to place."""
        shares = np.linspace(*CORE, 9)
        depth = np.rint(outer[0][:, None] + (other - outer)[0][:, None] * shares).astype(int)
        core = np.take_along_axis(slab[0], np.clip(depth, 0, slab.shape[2] - 1), axis=1).astype(np.float64)
        core = core[np.isfinite(core)]
        level = float(np.median(core))
        if level <= 0:
            raise VolumeError("The core of the sheet is not brighter than the air around it. Check --sheet-grey.")
        return level, float(np.sqrt(max(spread(core) ** 2 - self.noise**2, (0.05 * level) ** 2)))

    def _first_prior(
        self, slab: NDArray[np.float32], outer: Array, other: Array, base_sd: float
    ) -> tuple[Array, Array, bool]:
        """Look for a coating in the median profile below the face; wide spreads."""
        start = np.array([_kernels.outermost(g, max(int(e - self.reach), 0), int(e + self.reach) + 1, 0.5 * self.base)
                          for g, e in zip(slab[0], outer[0], strict=True)])  # fmt: skip
        good = start > 0
        half = int(np.median((other - outer)[0])) // 2
        inward = np.arange(max(half, 2))
        depth = np.clip(start[good][:, None] + inward, 0, slab.shape[2] - 1)
        profile = np.nanmedian(np.take_along_axis(slab[0][good], depth, axis=1), axis=0)
        peak = float(profile[: max(2, int(0.8 * half))].max())
        solid = self.base + 1.28 * min(base_sd, 0.3 * self.base)
        coated = self.params.sheet_grey is None and is_coating(peak, 0.0, solid)
        coated = coated or (self.params.sheet_grey is not None and is_coating(peak, 0.0, 1.2 * solid))
        # Without a coating the third level is what lies outside: the air, unless the sheet was told from other
        # material.
        outside = -1.0 if self.params.sheet_grey is None else 0.5 * self.base
        prior = np.array([0.0, 0.0, peak if coated else 0.0, self.base])
        wide = np.array([0.0, 0.0, 0.25 * peak if coated else outside, max(base_sd, 0.25 * self.base)])
        return prior, wide, coated

    def _fit(
        self, sample: tuple[NDArray[np.float32], Array, Array, Array], prior: tuple[Array, Array, bool], width: float
    ) -> Array:
        slab, outer, other, tilt = sample
        result = np.empty((5, *outer.shape))
        level, wide, coated = prior
        _kernels.fit_faces(slab, outer, other, tilt, 0.0, width, self.noise, level, wide, coated, self.reach, result)
        return result

    def _blur(self, sample: dict[bool, tuple[NDArray[np.float32], Array, Array, Array]]) -> float:
        """Width of the blur in um: the one with which the staircase fits the sample best."""
        costs = np.zeros(_WIDTHS.size)
        for i, width in enumerate(_WIDTHS):
            for high, part in sample.items():
                thin = tuple(a[:, ::4] for a in part)
                costs[i] += float(np.nanmean(np.minimum(self._fit(thin, self.prior[high], width)[4], 400.0)))  # type: ignore[arg-type]
        best = int(np.nanargmin(costs))
        if 0 < best < costs.size - 1:
            a, b, c = costs[best - 1 : best + 2]
            shift = 0.5 * (a - c) / max(a - 2 * b + c, 1e-12)
            step = np.log(_WIDTHS[1] / _WIDTHS[0])
            return float(_WIDTHS[best] * np.exp(np.clip(shift, -1, 1) * step)) * self.pitch[2]
        return float(_WIDTHS[best]) * self.pitch[2]

    def _learnt(
        self, sample: tuple[NDArray[np.float32], Array, Array, Array], prior: tuple[Array, Array, bool]
    ) -> tuple[Array, Array, bool]:
        """Narrow the prior to what thick layers and the base below them show."""
        level, wide, coated = (prior[0].copy(), prior[1].copy(), prior[2])
        width = self.width_um / self.pitch[2]
        for _ in range(2):
            fit = self._fit(sample, (level, wide, coated), width)
            known = np.isfinite(fit[0])
            if coated:
                thick = known & (fit[1] * sample[3] > 3.0 * width)
                if np.count_nonzero(thick) < 50:
                    thick = known & (fit[1] >= np.nanpercentile(fit[1], 75))
                level[2] = float(np.median(fit[2][thick]))
                wide[2] = max(1.2 * spread(fit[2][thick]), 0.01 * level[2])
            level[3] = float(np.median(fit[3][known]))
            wide[3] = max(1.2 * spread(fit[3][known]), 0.03 * level[3])
        return level, wide, coated

    def face(self, *, high: bool) -> tuple[Array, Array]:
        """Heights in um of one face and of the interface below it, of every column."""
        shape = self.values.shape[:2]
        level, wide, coated = self.prior[high]
        found = np.empty((5, *shape))

        def work(start: int) -> None:
            stop = min(start + _SLAB, shape[0])
            rows = slice(start, stop)
            outer, other = self.expected(rows, high=high)
            part = np.empty((5, stop - start, shape[1]))
            _kernels.fit_faces(
                self.slab(start, stop, high=high), np.ascontiguousarray(outer), np.ascontiguousarray(other),
                np.ascontiguousarray(self.tilt[rows]), 0.0, self.width_um / self.pitch[2], self.noise, level, wide,
                coated, self.reach, part,
            )  # fmt: skip
            found[:, rows] = part

        self._each(work, range(0, shape[0], _SLAB))
        outer = self._without_spikes(found[0])
        inner = np.where(np.isfinite(outer), found[0] + found[1], np.nan)
        last = self.values.shape[2] - 1
        first_um, step = float(self.depth_um[0]), self.pitch[2]
        to_um: Callable[[Array], Array] = (
            (lambda d: first_um + step * (last - d)) if high else (lambda d: first_um + step * d)
        )
        return to_um(outer), (to_um(inner) if coated else np.full(shape, np.nan))

    def _without_spikes(self, height: Array) -> Array:
        """Drop columns whose face stands far off its neighbours': dust, and fits that went astray."""
        known = np.isfinite(height)
        if not known.any():
            return height
        nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
        around = ndimage.median_filter(height[tuple(nearest)], size=5, mode="nearest")
        off = np.abs(height - around)
        limit = max(8.0 * spread(off[known]) + 1.0, _SPIKE_UM / self.pitch[2], 3.0)
        return np.where(known & (off <= limit), height, np.nan)

    def presence(self, centre: Array, thickness: float, up: float) -> Array:
        """Share of material in the upper third of the sheet, along the true normals, of every column."""
        shape = centre.shape
        slope = [np.gradient(centre, p, axis=i) for i, p in enumerate(self.pitch[:2])]
        length = np.sqrt(1 + slope[0] ** 2 + slope[1] ** 2)
        normal = [-up * slope[0] / length / self.pitch[0], -up * slope[1] / length / self.pitch[1]]
        normal.append(up / length / self.pitch[2])
        depth = (centre - float(self.depth_um[0])) / self.pitch[2]
        offsets = np.linspace(0.1, 0.42, 7) * thickness
        lead = int(np.ceil(0.5 * thickness / self.pitch[0])) + 1
        out = np.full(shape, np.nan)
        low, high = self.air, self.polarity * self.base + self.air

        def work(start: int) -> None:
            stop = min(start + _SLAB, shape[0])
            lo, hi = max(start - lead, 0), min(stop + lead, shape[0])
            slab = np.array(self.values[lo:hi], dtype=np.float32)
            self._drop_padding(slab)
            part = np.empty((stop - start, shape[1]))
            rows = slice(start, stop)
            _kernels.presence(
                slab, start - lo, depth[rows], normal[0][rows], normal[1][rows], normal[2][rows], offsets, low, high,
                part,
            )  # fmt: skip
            out[rows] = part

        self._each(work, range(0, shape[0], _SLAB))
        return out

    def saturated(self, top: Array, bottom: Array) -> float:
        """Share of the sheet's voxels at the largest value of their type (or at its smallest for a dark sheet)."""
        if not np.issubdtype(self.values.dtype, np.integer):
            return 0.0
        limits = np.iinfo(self.values.dtype)
        limit = limits.max if self.polarity > 0 else limits.min
        stride = max(1, int(np.sqrt(self.values.shape[0] * self.values.shape[1] / 40_000)))
        part = self.values[::stride, ::stride]
        depth = self.depth_um[None, None, :]
        lower = np.fmin(top, bottom)[::stride, ::stride, None]
        upper = np.fmax(top, bottom)[::stride, ::stride, None]
        inside = (depth >= lower) & (depth <= upper)
        return float(np.mean(part[inside] == limit)) if inside.any() else 0.0

    def _each(self, work: Callable[[int], None], starts: range) -> None:
        with ThreadPoolExecutor(self.params.threads or min(os.cpu_count() or 1, 8)) as pool:
            list(pool.map(work, starts))
