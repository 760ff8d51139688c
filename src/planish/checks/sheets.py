"""One sheet, and not two or a split one; enough voxels through it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.checks.greys import Greys
from planish.core.checks import POSITION, PROPERTIES, Check
from planish.core.frame import Frame
from planish.core.grid import pitch
from planish.core.typing import Bools, Floats

BRIGHT, DARK = 0.5, 0.6  # of coating - base, of base - air
BRIGHT_SHARE, DARK_SHARE = 0.10, 0.02  # of the tiles
LEAST_VOXELS = 5.0  # 114 um are measured of 80 um with 2 voxels, 130 of 120 um with 3; with 4 it is right
_TILE_UM = 60.0
_COLUMNS = 7  # along the edge of a tile, at most
_LEAST_COLUMNS = 5  # in a tile, and
_LEAST_SHARE = 1 / 3  # of its columns: a few side by side may lie in one pore
_INNER = (0.2, 0.45)  # of the base on either side, least and most, that is left out, and
_BLURS = 2.5  # widths of the blur: there it mixes in what lies beside the base
_DEPTHS = (9, 48)  # fewest and most places across the base
_TILES = 2500  # at most
_LEAST_TILES = 10
_SURE = 3.0  # standard errors of a median; 1.86 is 1.4826 of the median deviation, 1.253 of the median
_SHEET = (PROPERTIES, POSITION)


@dataclass(frozen=True, slots=True, kw_only=True)
class Core:
    """Places in the middle part of the base, in tiles."""

    # (tiles * columns * depths, 3): voxels z, y, x; (0, 0, 0) in columns without a base
    points: NDArray[np.signedinteger[Any]]
    shape: tuple[int, int, int]  # tiles, columns, depths
    is_base: Bools  # (tiles, columns)


def core_places(volume: xr.DataArray, measured: xr.Dataset) -> Core:
    """Choose voxels between the interfaces, or between the faces where a side has no coating."""
    frame = Frame.of(measured)
    high, low = (_base_end(measured, side) for side in ("top", "bottom"))
    good = (measured["status"].values == 0) & np.isfinite(high) & np.isfinite(low)
    r, c = _tile_columns(good.shape, pitch(measured))
    along = float(volume.attrs["voxel_um"]["zyx".index(frame.through)])
    thickness = float(np.nanmedian(np.abs(high - low)[good])) if good.any() else 0.0
    margin = float(np.clip(_BLURS * float(measured.attrs["blur_um"]) / max(thickness, along), *_INNER))
    depths = int(np.clip(np.ceil((1 - 2 * margin) * thickness / along), *_DEPTHS))
    heights = np.asarray(volume.coords[frame.through].values, dtype=np.float64)
    # Millions of places: two bytes each way are enough for most volumes.
    points = np.empty((*r.shape, depths, 3), dtype=np.int16 if max(volume.shape) < 2**15 else np.int32)
    axis = {name: k for k, name in enumerate("zyx")}
    points[..., axis[frame.rows]] = _voxel(measured, volume, "y", frame.rows)[r][..., None]
    points[..., axis[frame.cols]] = _voxel(measured, volume, "x", frame.cols)[c][..., None]
    above, below = high[r, c], low[r, c]
    for k, share in enumerate(np.linspace(margin, 1 - margin, depths)):
        index = np.rint((np.nan_to_num(above * (1 - share) + below * share) - heights[0]) / along).astype(np.int32)
        points[..., k, axis[frame.through]] = np.clip(index, 0, heights.size - 1)
    is_base = good[r, c]
    points[~is_base] = 0
    return Core(points=points.reshape(-1, 3), shape=(*r.shape, depths), is_base=is_base)


def _base_end(measured: xr.Dataset, side: str) -> Floats:
    """Give the height of the interface of a side; of its face where the interface is missing."""
    interface, face = (measured[name].values.astype(np.float64) for name in (f"interface_{side}", side))
    is_coated = np.isfinite(interface[measured["status"].values == 0]).any()
    return np.where(np.isfinite(interface), interface, face) if is_coated else face


def _tile_columns(shape: tuple[int, ...], pitch_um: tuple[float, float]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Choose tiles of the sheet and columns in each: row and column numbers, (tiles, columns)."""
    edges = [max(round(_TILE_UM / p), 1) for p in pitch_um]
    counts = [max(n // e, 1) for n, e in zip(shape, edges, strict=True)]
    rows, cols = (_of_tiles(n, e, c) for n, e, c in zip(shape, edges, counts, strict=True))
    tiles = np.stack(np.meshgrid(np.arange(counts[0]), np.arange(counts[1]), indexing="ij"), axis=-1).reshape(-1, 2)
    tiles = tiles[:: max(-(-len(tiles) // _TILES), 1)]
    return np.repeat(rows[tiles[:, 0]], cols.shape[1], axis=1), np.tile(cols[tiles[:, 1]], rows.shape[1])


def _of_tiles(n: int, edge: int, count: int) -> NDArray[np.intp]:
    """Columns that are looked at in every tile along one axis, (tiles, columns)."""
    inside = np.unique(np.linspace(0, edge - 1, min(edge, _COLUMNS)).round().astype(np.intp))
    return np.minimum(np.arange(count)[:, None] * edge + inside, n - 1)


def _voxel(measured: xr.Dataset, volume: xr.DataArray, dim: str, axis: str) -> NDArray[np.int32]:
    """Voxel in the middle of every column."""
    places = np.asarray(volume.coords[axis].values, dtype=np.float64)
    step = places[1] - places[0] if places.size > 1 else 1.0
    return np.rint((measured[dim].values - places[0]) / step).astype(np.int32)


def layers_check(core: Core, grey: NDArray[np.float32], greys: Greys, *, resolved: bool = True) -> Check:
    """Judge whether a coating, or air, lies inside the base.

    ``grey`` (points,) of the core, NaN where it was not read; ``resolved``: whether enough voxels lie across the sheet
    to tell a second coating from the first.
    """
    if not resolved:
        return Check(
            name="one sheet", state="unknown", figures=_SHEET,
            sentence="There are too few voxels across the sheet to tell one sheet from two.",
        )  # fmt: skip
    profiles = np.where(core.is_base[..., None], grey.reshape(core.shape), np.float32(np.nan))
    enough = np.isfinite(profiles).all(axis=2).sum(axis=1) >= max(_LEAST_COLUMNS, _LEAST_SHARE * core.shape[1])
    if np.count_nonzero(enough) < _LEAST_TILES:
        return Check(
            name="one sheet", state="unknown", figures=_SHEET,
            sentence=f"The base is seen in {np.count_nonzero(enough)} tiles of {_TILE_UM:g} um only, too few to tell "
            "one sheet from two.",
        )  # fmt: skip
    profiles = profiles[enough]
    count = np.isfinite(profiles).sum(axis=1)
    middle = np.nanmedian(profiles, axis=1)
    # What the scatter of a tile's columns leaves open of their median: strong noise is no gap.
    profiles -= middle[:, None]
    spread, median = np.nanmedian(np.abs(profiles, out=profiles), axis=1), middle.astype(np.float64)
    open_ = _SURE * 1.86 * spread / np.sqrt(count)
    base = float(np.median(median))
    dark = float(np.mean(((base - median - open_) / (base - greys.air)).max(axis=1) > DARK))
    # A second sheet whose coatings lie in the middle may be learnt as base; what is brighter is then told by the air.
    brighter = (greys.coating if np.isfinite(greys.coating) else 2 * base - greys.air) - base
    bright = float(np.mean(((median - base - open_) / brighter).max(axis=1) > BRIGHT))
    if bright > BRIGHT_SHARE:
        return Check(
            name="one sheet", state="fail", value=bright, limit=BRIGHT_SHARE, units="share", figures=_SHEET,
            sentence=f"In {100 * bright:.0f} % of the sheet something as dense as a coating lies in the middle of the "
            "base: a second sheet lies on the first.",
            advice="Crop the volume to one sheet, or choose it with --seed-um.",
        )  # fmt: skip
    return Check.at_most(
        "one sheet", dark, fail=DARK_SHARE, units="share", figures=_SHEET,
        sentence=f"In {100 * dark:.2g} % of the sheet there is air inside the base"
        + (": it is split, or two sheets lie on each other." if dark > DARK_SHARE else ", and nowhere a second sheet."),
        advice="Look at the slices. Crop the volume to one sheet that is whole.",
    )  # fmt: skip


def voxels_check(volume: xr.DataArray, measured: xr.Dataset) -> Check:
    """Judge whether the sheet is thick enough for the voxels along its normal."""
    frame = Frame.of(measured)
    voxel = dict(zip("zyx", (float(v) for v in volume.attrs["voxel_um"]), strict=True))
    tall = float(np.nanmedian(np.abs(measured["top"].values - measured["bottom"].values)))
    rise = (
        np.nanmedian(np.abs(np.gradient(measured["centre"].values, p, axis=i))) for i, p in enumerate(pitch(measured))
    )
    cosine = 1 / np.sqrt(1 + sum(float(s) ** 2 for s in rise))
    # Along the normal, the voxel is as long as its sides let it be.
    edge = cosine * voxel[frame.through] + (1 - cosine) * max(voxel[frame.rows], voxel[frame.cols])
    count = tall * cosine / edge
    return Check.at_least(
        "voxels through the sheet", count, look=LEAST_VOXELS, units="voxels",
        figures=("thickness", "coating_top", "coating_bottom", "base_thickness"),
        sentence=f"The sheet is {count:.1f} voxels thick."
        + (" It may be thinner: sheets of 2 or 3 voxels are measured too thick." if count < LEAST_VOXELS else ""),
        advice="Scan with smaller voxels: five through the sheet are needed, and two through a coating.",
    )  # fmt: skip
