"""What the checks of a scan judge.

A volume, the sheet measured in it, and what one pass over its voxels gives.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.checks.windows import Window, read_windows
from planish.core.frame import Axis, Frame
from planish.core.grid import blur_reach_um, pitch
from planish.core.typing import Array, Bools, Floats, Ints, Pair
from planish.measure.greys import Greys

TILE_UM = 60.0
_TILES, _SQUARE = 2500, 10  # tiles at most, about; tiles along an edge of a square


@dataclass(frozen=True, slots=True, kw_only=True)
class Core:
    """Places in the middle part of the base, in tiles."""

    # (tiles * columns * depths, 3): voxels z, y, x; (0, 0, 0) in columns without a base
    points: NDArray[np.signedinteger[Any]]
    shape: tuple[int, int, int]  # tiles, columns, depths
    is_base: Bools  # (tiles, columns)
    tiles: tuple[Ints, Ints]  # row and column number of each tile among all tiles of the sheet


@dataclass(frozen=True, slots=True, kw_only=True)
class ScannedSheet:
    """A volume (z, y, x) and the sheet that was measured in it (y, x)."""

    volume: xr.DataArray
    measured: xr.Dataset
    through: Axis
    # Axes along which planish put the slices together, or along which they are labels.
    assembled_axes: tuple[Axis, ...]
    windows: dict[Axis, Window]
    voxel_count: float  # through the sheet, along its normal


@dataclass(frozen=True, slots=True, kw_only=True)
class GreyScan(ScannedSheet):
    """A scan whose voxels are greys, not labels."""

    greys: Greys
    sample: Array  # as stored, of a part of the voxels around the sheet
    core: Core
    core_grey: NDArray[np.float32]  # (tiles, columns, depths), NaN where it was not read


def read_scan(
    volume: xr.DataArray, measured: xr.Dataset, *, sections: bool, labels: bool, threads: int | None
) -> ScannedSheet:
    """Read what the checks need, in one pass.

    Parameters as of :func:`planish.checks.check_scan`. A `GreyScan` unless the voxels are labels.
    """
    through = Frame.of(measured).through
    assembled_axes: tuple[Axis, ...] = ()
    if labels:
        assembled_axes = ("z", "y", "x")
    elif sections:
        assembled_axes = ("z",)
    heights = volume.coords[through].values.astype(np.float64)
    faces = np.stack([measured["top"].values, measured["bottom"].values])
    ends = np.searchsorted(heights, [np.nanmin(faces), np.nanmax(faces)])
    first, last = np.minimum(ends, heights.size - 1).tolist()
    greys = None if labels else Greys.of(measured)
    core = None if labels else core_places(volume, measured)
    reading = read_windows(
        volume,
        through=through,
        sheet_slices=(first, last),
        points=None if core is None else core.points,
        fill_grey=0.0 if greys is None else greys.air,
        threads=threads,
    )
    fields: dict[str, Any] = {
        "volume": volume,
        "measured": measured,
        "through": through,
        "assembled_axes": assembled_axes,
        "windows": {window.axis: window for window in reading.windows},
        "voxel_count": voxels_through(volume, measured),
    }
    if greys is None or core is None:
        return ScannedSheet(**fields)
    grey = reading.grey.reshape(core.shape)
    grey[~core.is_base] = np.nan
    return GreyScan(**fields, greys=greys, sample=reading.sample, core=core, core_grey=grey)


def voxels_through(volume: xr.DataArray, measured: xr.Dataset) -> float:
    """Voxels through the sheet, along its normal: medians of its height and slope stand for it."""
    frame = Frame.of(measured)
    voxel_um = dict(zip("zyx", map(float, volume.attrs["voxel_um"]), strict=True))
    heights_um = np.abs(measured["top"].values - measured["bottom"].values)
    thickness_um = float(np.nanmedian(heights_um))
    slopes = np.gradient(measured["centre"].values, *pitch(measured))
    squares = [float(np.nanmedian(np.abs(slope))) ** 2 for slope in slopes]
    cosine = 1 / np.sqrt(1 + sum(squares))
    # Along the normal, the voxel is as long as its sides let it be.
    side_um = max(voxel_um[frame.rows], voxel_um[frame.cols])
    normal_um = cosine * voxel_um[frame.through] + (1 - cosine) * side_um
    return thickness_um * cosine / normal_um


def core_places(volume: xr.DataArray, measured: xr.Dataset) -> Core:
    """Choose voxels between the interfaces, or between the faces where a side has no coating.

    In chosen columns of each tile, so many depths are spread over the middle part of the base as
    there are voxels in it, 9 at least and 48 at most; they come from the top to the bottom.
    """
    frame = Frame.of(measured)
    high, low = (_base_end(measured, side) for side in ("top", "bottom"))
    is_known = np.isfinite(high) & np.isfinite(low)
    has_base = (measured["status"].values == 0) & is_known
    r, c, tiles = _tile_columns(has_base.shape, pitch(measured))
    k_through = "zyx".index(frame.through)
    step_um = float(volume.attrs["voxel_um"][k_through])
    thickness = 0.0
    if has_base.any():
        thickness = float(np.nanmedian(np.abs(high - low)[has_base]))
    # Within 2.5 widths of the blur it mixes in what lies beside the base.
    blur_share = 2.5 * blur_reach_um(measured.attrs) / max(thickness, step_um)
    margin = float(np.clip(blur_share, 0.2, 0.45))  # share of the base left out at either end
    n_voxels = np.ceil((1 - 2 * margin) * thickness / step_um)
    depths = int(np.clip(n_voxels, 9, 48))
    heights = volume.coords[frame.through].values.astype(np.float64)
    # Millions of places: two bytes each way are enough for most volumes.
    dtype = np.int16 if max(volume.shape) < 2**15 else np.int32
    points = np.empty((*r.shape, depths, 3), dtype)
    for dim, axis, columns in (("y", frame.rows, r), ("x", frame.cols, c)):
        axis_um = volume.coords[axis].values.astype(np.float64)
        axis_step = axis_um[1] - axis_um[0] if axis_um.size > 1 else 1.0
        places = (measured[dim].values - axis_um[0]) / axis_step
        voxel_indices = np.rint(places).astype(np.int32)
        points[..., "zyx".index(axis)] = voxel_indices[columns][..., None]
    is_base = has_base[r, c]
    high = high[r, c]
    low = low[r, c]
    for k, depth_share in enumerate(np.linspace(margin, 1 - margin, depths)):
        height = np.nan_to_num(high * (1 - depth_share) + low * depth_share)
        depth_index = np.rint((height - heights[0]) / step_um).astype(np.int32)
        points[..., k, k_through] = np.clip(depth_index, 0, heights.size - 1)
    points[~is_base] = 0
    shape = (*r.shape, depths)
    return Core(points=points.reshape(-1, 3), shape=shape, is_base=is_base, tiles=tiles)


def _base_end(measured: xr.Dataset, side: str) -> Floats:
    """Give the height of the interface of a side; of its face where the interface is missing."""
    interface = measured[f"interface_{side}"].values.astype(np.float64)
    face = measured[side].values.astype(np.float64)
    is_seen = np.isfinite(interface)
    if not is_seen[measured["status"].values == 0].any():
        return face
    return np.where(is_seen, interface, face)


def _tile_columns(shape: tuple[int, ...], pitch_um: Pair) -> tuple[Ints, Ints, tuple[Ints, Ints]]:
    """Choose tiles of the sheet and columns in each.

    Gives row and column numbers, (tiles, columns), of the chosen columns on the grid of ``shape``,
    and row and column numbers (tiles,) of the tiles themselves. A tile has up to 7 x 7 columns.
    """
    columns: list[Ints] = []  # (tiles, columns) along one axis, 7 at most
    for n, step_um in zip(shape, pitch_um, strict=True):
        tile_edge = max(round(TILE_UM / step_um), 1)
        spread = np.linspace(0, tile_edge - 1, min(tile_edge, 7))
        offsets = np.unique(spread.round().astype(np.intp))
        starts = np.arange(max(n // tile_edge, 1))[:, None] * tile_edge
        columns.append(np.minimum(starts + offsets, n - 1))
    rows, cols = columns
    row, col = np.divmod(np.arange(len(rows) * len(cols)), len(cols))
    # Of a large sheet squares of tiles, so that what lies side by side is seen side by side: one
    # in so many that about `_TILES` are left.
    one_in = -(-row.size // _TILES)
    diagonal = row // _SQUARE + col // _SQUARE
    is_chosen = diagonal % one_in == 0
    row, col = row[is_chosen], col[is_chosen]
    all_rows = np.repeat(rows[row], cols.shape[1], axis=1)
    all_cols = np.tile(cols[col], rows.shape[1])
    return all_rows, all_cols, (row, col)
