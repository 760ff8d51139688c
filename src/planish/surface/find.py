"""From a volume to the faces, interfaces and centre of its sheet, as heights above the volume's own columns."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.errors import VolumeError
from planish.core.frame import Frame
from planish.surface import _kernels
from planish.surface.centre import gaussian_regression
from planish.surface.coarse import CoarseSheet, block_means, coarse_sheet, to_columns
from planish.surface.levels import GreyLevels, air_level, is_coating, material, mode, spread

Array = NDArray[np.float64]

_SLAB = 16  # rows worked on together
_SAMPLE = 3000  # columns that the levels and the blur are read from
_CORE = (0.35, 0.65)  # share of the way through the sheet that counts as its core
_WIDTHS = np.geomspace(0.35, 3.2, 14)  # blur along a column that is tried, in voxels
_QUIET = 8.0  # contrast-to-noise ratio below which columns are smoothed with their neighbours
_SPIKE_UM = 3.0
_HOLE_UM = 600.0  # a gap wider than this is missing sheet, not a hole


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceParams:
    """Choices of the surface search; lengths in um.

    Attributes
    ----------
    sheet_grey : (float, float) or None
        Grey range of the sheet, where it has to be told from other material. The faces then lie where the grey has
        fallen half way from the sheet's own level to that of the air.
    cutoff_um : float
        Wavelength of the centre surface that passes by half. Hirn et al. (2009) call their centre line a smoothed mean
        of the faces and give no number; 400 um is the cut-off of a Gaussian of 75 um.
    rim_um : float
        Zone around holes and gaps that is kept out of the centre surface and of all properties: the laser burns it.
    threads : int or None
        Columns are independent; the result does not depend on it.
    """

    sheet_grey: tuple[float, float] | None = None
    cutoff_um: float = 400.0
    rim_um: float = 100.0
    threads: int | None = None


def find_surfaces(
    volume: xr.DataArray, *, frame: Frame | None = None, params: SurfaceParams | None = None
) -> xr.Dataset:
    """Find top, bottom, interfaces and centre surface of the sheet in a volume.

    Parameters
    ----------
    volume : DataArray, dims (z, y, x), coordinates in um
        Grey values; NaN is missing.
    frame : Frame
        Axis through the sheet and side of its top; z and its high end where not given.
    params : SurfaceParams

    Returns
    -------
    Dataset, dims (y, x) = rows and columns of the frame
        ``top``, ``bottom``, ``interface_top``, ``interface_bottom``, ``centre``: heights in um, coordinates along the
        axis through the sheet. NaN where there is no sheet; the interface of a side without a coating is all NaN.
        ``centre`` runs on across holes. ``presence``: share of material along the normal below the top face, 0 to 1.
        ``status``: 0 measured, 1 no sheet, 2 rim of a hole or gap, 3 face not found.
        Attributes hold the grey levels and what was seen.

    Raises
    ------
    VolumeError
        If the volume holds no sheet, several, or one that fills it from end to end.

    Notes
    -----
    Every column is fitted with a blurred staircase air-coating-base. Levels differ from place to place within a
    spread that is learnt from the same volume, which keeps thin layers from taking the width of the blur.
    """
    frame = frame or Frame()
    params = params or SurfaceParams()
    columns = frame.columns(volume)
    pitch = _pitch(volume, frame.rows), _pitch(volume, frame.cols), _pitch(volume, frame.through)
    _check_values(volume)
    coarse, first = _coarse(columns, params)
    search = _Search(columns=columns, coarse=coarse, first=first, pitch=pitch, params=params)
    levels = search.levels()
    top, inner_top = search.face(high=frame.top == "high")
    bottom, inner_bottom = search.face(high=frame.top != "high")
    if frame.top == "low":
        levels = _swapped(levels)
    up = frame.sign
    seen = np.isfinite(top) & np.isfinite(bottom) & (up * (top - bottom) > 0)
    top, bottom, inner_top, inner_bottom = (np.where(seen, f, np.nan) for f in (top, bottom, inner_top, inner_bottom))
    thickness = float(np.nanmedian(up * (top - bottom))) if seen.any() else float("nan")
    if not np.isfinite(thickness):
        raise VolumeError(
            "There is no sheet in the volume: no column shows two faces. Check --through and --sheet-grey."
        )
    sheet, rim, outline = _regions(seen, pitch[:2], params.rim_um)
    middle = np.where(sheet & ~rim, 0.5 * (top + bottom), np.nan)
    if not np.isfinite(middle).any():
        raise VolumeError(
            "The sheet consists of holes and their rims only; nothing is left to measure. Check --sheet-grey."
        )
    centre = np.where(outline, gaussian_regression(middle, pitch[:2], cutoff_um=params.cutoff_um), np.nan)
    status = np.where(~np.isfinite(centre) | ~sheet, 1, np.where(rim, 2, np.where(seen, 0, 3))).astype(np.uint8)
    present = search.presence(centre, thickness, up)
    heights = {
        "top": (top, "Top face"),
        "bottom": (bottom, "Bottom face"),
        "interface_top": (inner_top, "Interface between top coating and base"),
        "interface_bottom": (inner_bottom, "Interface between bottom coating and base"),
        "centre": (centre, "Centre surface"),
    }
    data: dict[str, tuple[tuple[str, str], NDArray[np.generic], dict[str, object]]] = {
        name: (("y", "x"), values, {"units": "um", "long_name": title}) for name, (values, title) in heights.items()
    }
    data["presence"] = (("y", "x"), present, {"units": "1", "long_name": "Material below the top face"})
    meanings = "measured no_sheet rim face_not_found"
    data["status"] = (
        ("y", "x"), status, {"long_name": "Status", "flag_values": [0, 1, 2, 3], "flag_meanings": meanings},
    )  # fmt: skip
    attrs: dict[str, object] = {
        **frame.attrs(),
        "thickness_um": thickness,
        "cutoff_um": params.cutoff_um,
        "rim_um": params.rim_um,
    }
    attrs |= {f"grey_{k}" if k in ("air", "base", "coating_top", "coating_bottom", "noise") else k: v
              for k, v in asdict(levels).items()}  # fmt: skip
    attrs |= {"voxel_um": [_pitch(volume, axis) for axis in ("z", "y", "x")]}
    attrs["saturated_share"] = search.saturated(top, bottom)
    attrs["missing_share"] = _missing_share(volume)
    coords = {"y": columns.coords[frame.rows].values, "x": columns.coords[frame.cols].values}
    return xr.Dataset(data, coords={k: ((k,), v, {"units": "um"}) for k, v in coords.items()}, attrs=attrs)


def _pitch(volume: xr.DataArray, axis: str) -> float:
    values = volume.coords[axis].values
    return float(values[1] - values[0]) if values.size > 1 else 1.0


def _check_values(volume: xr.DataArray) -> None:
    if min(volume.shape) < 8:
        raise VolumeError(
            f"The volume has the shape {' x '.join(map(str, volume.shape))} (z, y, x); at least 8 voxels "
            f"are needed along "
            "every axis. Check that this is the whole stack."
        )
    if np.issubdtype(volume.dtype, np.floating) and _missing_share(volume) > 0.9:
        raise VolumeError("More than 90 % of the volume's voxels are NaN or infinite. Check how it was exported.")


def _missing_share(volume: xr.DataArray) -> float:
    if not np.issubdtype(volume.dtype, np.floating):
        return 0.0
    bad = sum(int(np.count_nonzero(~np.isfinite(slab))) for slab in volume.values)
    return bad / volume.size


def _coarse(columns: xr.DataArray, params: SurfaceParams) -> tuple[CoarseSheet, dict[str, float]]:
    """Find the sheet in block means; return it with air, noise and polarity."""
    values = columns.values
    stride = max(1, int(np.sqrt(values.shape[0] * values.shape[1] / 40_000)))
    part = values[::stride, ::stride]
    samples = np.concatenate([part[..., :3].reshape(-1, 3), part[..., -3:].reshape(-1, 3)]).astype(np.float64)
    air, noise = air_level(samples)
    block = int(np.clip(round(np.sqrt(values.shape[0] * values.shape[1] / 40_000)), 1, 4))
    blocks = block_means(columns, block)
    if params.sheet_grey is not None:
        low, high = params.sheet_grey
        inside = (blocks >= low) & (blocks <= high)
        polarity = 1.0 if 0.5 * (low + high) >= air else -1.0
        edge = (low if polarity > 0 else high) - air
        oriented = polarity * (blocks - air)
        return coarse_sheet(oriented, inside, abs(edge), block), {"air": air, "noise": noise, "polarity": polarity}
    polarity, threshold = material(blocks, air)
    oriented = np.where(np.isfinite(blocks), polarity * (blocks - air), 0.0).astype(np.float32)
    sheet = coarse_sheet(oriented, oriented > threshold, threshold, block)
    # The core tells the base's level, and that a better threshold: half way between air and base.
    base = float(np.median(_core(oriented, sheet)))
    threshold = max(threshold * 0.7, 0.5 * base)
    sheet = coarse_sheet(oriented, oriented > threshold, threshold, block)
    return sheet, {"air": air, "noise": noise, "polarity": polarity}


def _core(blocks: NDArray[np.float32], sheet: CoarseSheet) -> Array:
    """Grey of the blocks in the core of the sheet."""
    rows, cols = np.nonzero(np.isfinite(sheet.low) & np.isfinite(sheet.high))
    if rows.size == 0:
        raise VolumeError(
            "No column of the volume shows both faces of the sheet. The sheet leaves the volume on one "
            "side, or it is not "
            "the axis through the sheet that was named with --through."
        )
    low, high = sheet.low[rows, cols], sheet.high[rows, cols]
    shares = np.linspace(*_CORE, 7)
    depth = np.rint(low[:, None] + (high - low)[:, None] * shares).astype(int)
    return blocks[rows[:, None], cols[:, None], depth].ravel().astype(np.float64)


def _swapped(levels: GreyLevels) -> GreyLevels:
    from dataclasses import replace

    return replace(levels, coating_top=levels.coating_bottom, coating_bottom=levels.coating_top)


def _regions(
    seen: NDArray[np.bool_], pitch: tuple[float, float], rim_um: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return where the sheet is, the rims of its holes, and its outline with the holes filled."""
    step = float(np.sqrt(pitch[0] * pitch[1]))
    # Single columns without a face are gaps of the measurement; only larger ones are gaps of the sheet.
    reach = max(1, round(12.0 / step)) if min(seen.shape) * step > 100 else 1
    padded = np.pad(seen, 2 * reach, mode="edge")
    inner = (slice(2 * reach, -2 * reach),) * 2
    sheet = ndimage.binary_closing(padded, _disc(reach))
    sheet = ndimage.binary_opening(sheet, _disc(reach))[inner] | ndimage.binary_erosion(sheet, _disc(1))[inner]
    gap = ~sheet
    rim = np.zeros_like(sheet)
    if gap.any():
        rim = (ndimage.distance_transform_edt(sheet, sampling=pitch) <= rim_um) & sheet
        if not rim.all() and (rim | gap).mean() > 0.98:
            rim = np.zeros_like(sheet)
    labels, count = ndimage.label(gap)
    outline = sheet.copy()
    if count:
        border = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
        area = np.bincount(labels.ravel(), minlength=count + 1) * pitch[0] * pitch[1]
        fill = area <= np.pi / 4 * _HOLE_UM**2
        small_cut = area <= np.pi / 4 * (0.5 * _HOLE_UM) ** 2
        fill[border] &= small_cut[border]
        fill[0] = False
        outline |= fill[labels]
    return sheet, rim, outline


def _disc(radius: int) -> NDArray[np.bool_]:
    y, x = np.ogrid[-radius : radius + 1, -radius : radius + 1]
    return x * x + y * y <= radius * radius + 0.5


class _Search:
    """The fine search: every column of the volume, in slabs of rows."""

    def __init__(
        self,
        *,
        columns: xr.DataArray,
        coarse: CoarseSheet,
        first: dict[str, float],
        pitch: tuple[float, float, float],
        params: SurfaceParams,
    ) -> None:
        self.values = columns.values
        self.depth_um = columns.coords[columns.dims[2]].values
        self.air, self.polarity = first["air"], first["polarity"]
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
        self.noise = max(first["noise"], 1e-6 * abs(self.air) + 1e-9)
        self.blend = 0.0

    def slab(self, start: int, stop: int, *, high: bool) -> NDArray[np.float32]:
        """Grey above the air of some rows, read from one end of the columns: (rows, cols, depth)."""
        halo = int(np.ceil(3 * self.blend)) if self.blend else 0
        lo, hi = max(start - halo, 0), min(stop + halo, self.values.shape[0])
        part = np.array(self.values[lo:hi], dtype=np.float32)
        part -= np.float32(self.air)
        if self.polarity < 0:
            part *= np.float32(-1)
        if halo:
            part = ndimage.gaussian_filter(part, (self.blend, self.blend, 0), mode="nearest", truncate=3.0)
            part = part[start - lo : part.shape[0] - (hi - stop)]
        return np.ascontiguousarray(part[:, :, ::-1] if high else part)

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
        cnr = self.base / self.noise
        if cnr < _QUIET:
            # Averaging over a Gaussian of s voxels divides white noise by 2 sqrt(pi) s.
            self.blend = min(_QUIET / cnr / (2 * np.sqrt(np.pi)), 1.5)
            self.noise /= max(1.0, 2 * np.sqrt(np.pi) * self.blend)
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
        outer, other, tilt = (np.concatenate([p[i] for p in parts])[None] for i in (1, 2, 3))
        return slab, outer, other, tilt

    def _base(self, slab: NDArray[np.float32], outer: Array, other: Array) -> tuple[float, float]:
        """Level of the base above the air, and how much it varies from place to place."""
        shares = np.linspace(*_CORE, 9)
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


__all__ = ["SurfaceParams", "find_surfaces", "mode"]
