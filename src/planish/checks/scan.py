"""What the checks of a scan judge: a volume, the sheet measured in it, and what one pass over its voxels gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.checks.windows import Window, read_windows
from planish.core.frame import Axis, Frame
from planish.core.grid import pitch
from planish.core.typing import Array, Bools, Floats, Ints, Pair
from planish.measure.registry import Greys

TILE_UM = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Core:
    """Places in the middle part of the base, in tiles."""

    # (tiles * columns * depths, 3): voxels z, y, x; (0, 0, 0) in columns without a base
    points: NDArray[np.signedinteger[Any]]
    shape: tuple[int, int, int]  # tiles, columns, depths
    is_base: Bools  # (tiles, columns)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScannedSheet:
    """A volume (z, y, x) and the sheet that was measured in it (y, x)."""

    volume: xr.DataArray
    measured: xr.Dataset
    through: Axis
    assembled: tuple[Axis, ...]  # axes along which planish put the slices together, or along which they are labels
    windows: dict[Axis, Window]
    voxels: float  # through the sheet, along its normal


@dataclass(frozen=True, slots=True, kw_only=True)
class GreyScan(ScannedSheet):
    """A scan whose voxels are greys, not labels."""

    greys: Greys
    sample: Array  # as stored, of a part of the voxels around the sheet
    core: Core
    core_grey: NDArray[np.float32]  # (tiles, columns, depths), NaN where it was not read


def read_scan(
    volume: xr.DataArray, measured: xr.Dataset, *, sections: bool, labels: bool, threads: int | None
) -> ScannedSheet:  # fmt: skip
    """Read what the checks need, in one pass; parameters as of :func:`planish.checks.check_scan`."""
    through = Frame.of(measured).through
    every: tuple[Axis, ...] = ("z", "y", "x")
    heights = np.asarray(volume.coords[through].values, dtype=np.float64)
    faces = np.stack([measured["top"].values, measured["bottom"].values])
    low, high = np.clip(np.searchsorted(heights, [np.nanmin(faces), np.nanmax(faces)]), 0, heights.size - 1)
    greys, core = (None, None) if labels else (Greys.of(measured), core_places(volume, measured))
    reading = read_windows(
        volume, through=through, sheet=(int(low), int(high)), points=None if core is None else core.points,
        missing=0.0 if greys is None else greys.air, threads=threads,
    )  # fmt: skip
    scan: dict[str, Any] = {
        "volume": volume, "measured": measured, "through": through,
        "assembled": every if labels else every[:1] if sections else (),
        "windows": {window.axis: window for window in reading.windows}, "voxels": voxels_through(volume, measured),
    }  # fmt: skip
    if greys is None or core is None:
        return ScannedSheet(**scan)
    grey = np.where(core.is_base[..., None], reading.grey.reshape(core.shape), np.float32(np.nan))
    return GreyScan(**scan, greys=greys, sample=reading.sample, core=core, core_grey=grey)


def voxels_through(volume: xr.DataArray, measured: xr.Dataset) -> float:
    """Voxels through the sheet, along its normal."""
    frame = Frame.of(measured)
    voxel = dict(zip("zyx", (float(v) for v in volume.attrs["voxel_um"]), strict=True))
    tall = float(np.nanmedian(np.abs(measured["top"].values - measured["bottom"].values)))
    rise = (
        np.nanmedian(np.abs(np.gradient(measured["centre"].values, p, axis=i))) for i, p in enumerate(pitch(measured))
    )
    cosine = 1 / np.sqrt(1 + sum(float(s) ** 2 for s in rise))
    # Along the normal, the voxel is as long as its sides let it be.
    edge = cosine * voxel[frame.through] + (1 - cosine) * max(voxel[frame.rows], voxel[frame.cols])
    return tall * cosine / edge


def core_places(volume: xr.DataArray, measured: xr.Dataset) -> Core:
    """Choose voxels between the interfaces, or between the faces where a side has no coating."""
    frame = Frame.of(measured)
    high, low = (_base_end(measured, side) for side in ("top", "bottom"))
    good = (measured["status"].values == 0) & np.isfinite(high) & np.isfinite(low)
    r, c = _tile_columns(good.shape, pitch(measured))
    along = float(volume.attrs["voxel_um"]["zyx".index(frame.through)])
    thickness = float(np.nanmedian(np.abs(high - low)[good])) if good.any() else 0.0
    # Within 2.5 widths of the blur it mixes in what lies beside the base.
    margin = float(np.clip(2.5 * float(measured.attrs["blur_um"]) / max(thickness, along), 0.2, 0.45))
    depths = int(np.clip(np.ceil((1 - 2 * margin) * thickness / along), 9, 48))
    heights = np.asarray(volume.coords[frame.through].values, dtype=np.float64)
    # Millions of places: two bytes each way are enough for most volumes.
    points = np.empty((*r.shape, depths, 3), dtype=np.int16 if max(volume.shape) < 2**15 else np.int32)
    for dim, axis, columns in (("y", frame.rows, r), ("x", frame.cols, c)):
        places = np.asarray(volume.coords[axis].values, dtype=np.float64)
        step = places[1] - places[0] if places.size > 1 else 1.0
        voxels = np.rint((measured[dim].values - places[0]) / step).astype(np.int32)
        points[..., "zyx".index(axis)] = voxels[columns][..., None]
    is_base, high, low = good[r, c], high[r, c], low[r, c]
    for k, share in enumerate(np.linspace(margin, 1 - margin, depths)):
        index = np.rint((np.nan_to_num(high * (1 - share) + low * share) - heights[0]) / along).astype(np.int32)
        points[..., k, "zyx".index(frame.through)] = np.clip(index, 0, heights.size - 1)
    points[~is_base] = 0
    return Core(points=points.reshape(-1, 3), shape=(*r.shape, depths), is_base=is_base)


def _base_end(measured: xr.Dataset, side: str) -> Floats:
    """Give the height of the interface of a side; of its face where the interface is missing."""
    interface, face = (measured[name].values.astype(np.float64) for name in (f"interface_{side}", side))
    is_coated = np.isfinite(interface[measured["status"].values == 0]).any()
    return np.where(np.isfinite(interface), interface, face) if is_coated else face


def _tile_columns(shape: tuple[int, ...], pitch_um: Pair) -> tuple[Ints, Ints]:
    """Choose tiles of the sheet and columns in each: row and column numbers, (tiles, columns)."""
    columns: list[Ints] = []  # (tiles, columns) along one axis, 7 at most
    for n, step in zip(shape, pitch_um, strict=True):
        edge = max(round(TILE_UM / step), 1)
        inside = np.unique(np.linspace(0, edge - 1, min(edge, 7)).round().astype(np.intp))
        columns.append(np.minimum(np.arange(max(n // edge, 1))[:, None] * edge + inside, n - 1))
    rows, cols = columns
    number = np.arange(len(rows) * len(cols))
    row, col = np.divmod(number[:: max(-(-number.size // 2500), 1)], len(cols))
    return np.repeat(rows[row], cols.shape[1], axis=1), np.tile(cols[col], rows.shape[1])
