"""From a volume to the faces, interfaces and centre of its sheet, as heights above the volume's own columns."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import VolumeError
from planish.core.frame import Frame
from planish.surface.centre import gaussian_regression
from planish.surface.coarse import CORE, CoarseSheet, block_means, coarse_sheet
from planish.surface.levels import GreyLevels, material, mode, padding_value, voxel_noise
from planish.surface.params import SurfaceParams
from planish.surface.regions import regions
from planish.surface.search import First, Search

Array = NDArray[np.float64]


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
    search = Search(columns=columns, coarse=coarse, first=first, pitch=pitch, params=params)
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
    sheet, rim, outline = regions(seen, pitch[:2], params.rim_um)
    middle = np.where(sheet & ~rim, 0.5 * (top + bottom), np.nan)
    if not np.isfinite(middle).any():
        raise VolumeError(
            f"The sheet is {thickness:.3g} um thick and consists of holes and their rims of {params.rim_um:g} um only; "
            "nothing is left to measure. Is the voxel size in um? Check --voxel-um, --rim-um and --sheet-grey."
        )
    centre = gaussian_regression(middle, pitch[:2], cutoff_um=params.cutoff_um)
    # A hole with its rim may be wider than a short cut-off reaches: it is bridged with a longer one.
    for wider in (2.0, 4.0):
        if np.isnan(centre[outline]).any():
            bridge = gaussian_regression(middle, pitch[:2], cutoff_um=wider * params.cutoff_um)
            centre = np.where(np.isnan(centre), bridge, centre)
    centre = np.where(outline, centre, np.nan)
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
    if first.padding is not None:
        attrs["padding"] = first.padding
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


def _coarse(columns: xr.DataArray, params: SurfaceParams) -> tuple[CoarseSheet, First]:
    """Find the sheet in block means; return it with air, noise and polarity."""
    values = columns.values
    stride = max(1, int(np.sqrt(values.shape[0] * values.shape[1] / 40_000)))
    part = values[::stride, ::stride]
    flat = part.reshape(-1, part.shape[-1])
    padding = padding_value(flat)
    block = int(np.clip(round(np.sqrt(values.shape[0] * values.shape[1] / 40_000)), 1, 4))
    blocks = block_means(columns, block, padding=padding)
    # The level comes from means over blocks: where the export has cut the air's noise at 0, single voxels crowd there.
    air = mode(_ends(blocks.reshape(-1, blocks.shape[-1]), np.isfinite(blocks).reshape(-1, blocks.shape[-1])))
    noise = voxel_noise(_ends(flat, np.ones(flat.shape, bool) if padding is None else flat != padding), air)
    if params.sheet_grey is not None:
        low, high = params.sheet_grey
        inside = (blocks >= low) & (blocks <= high)
        polarity = 1.0 if 0.5 * (low + high) >= air else -1.0
        edge = (low if polarity > 0 else high) - air
        oriented = polarity * (blocks - air)
        return coarse_sheet(oriented, inside, abs(edge), block), First(
            air=air, noise=noise, polarity=polarity, padding=padding
        )
    polarity, threshold = material(blocks, air)
    oriented = np.where(np.isfinite(blocks), polarity * (blocks - air), 0.0).astype(np.float32)
    sheet = coarse_sheet(oriented, oriented > threshold, threshold, block)
    # The core tells the base's level, and that a better threshold: half way between air and base.
    base = float(np.median(_core(oriented, sheet)))
    threshold = max(threshold * 0.7, 0.5 * base)
    sheet = coarse_sheet(oriented, oriented > threshold, threshold, block)
    return sheet, First(air=air, noise=noise, polarity=polarity, padding=padding)


def _ends(columns: NDArray[np.generic], inside: NDArray[np.bool_]) -> Array:
    """First and last three voxels of each column (n, depth) that lie inside the field of view; (2 n, 3)."""
    held = inside.sum(axis=1) > 12
    if not held.any():
        return np.full((1, 3), np.nan)
    kept, inside = columns[held].astype(np.float64), inside[held]
    # One voxel is skipped where the field of view begins within the column: it may be cut.
    first = np.argmax(inside, axis=1)
    last = columns.shape[1] - 1 - np.argmax(inside[:, ::-1], axis=1)
    first, last = first + (first > 0), last - (last < columns.shape[1] - 1)
    starts, stops = first[:, None] + np.arange(3), last[:, None] - np.arange(3)
    return np.concatenate([np.take_along_axis(kept, k, axis=1) for k in (starts, stops)])


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
    shares = np.linspace(*CORE, 7)
    depth = np.rint(low[:, None] + (high - low)[:, None] * shares).astype(int)
    return blocks[rows[:, None], cols[:, None], depth].ravel().astype(np.float64)


def _swapped(levels: GreyLevels) -> GreyLevels:
    return replace(levels, coating_top=levels.coating_bottom, coating_bottom=levels.coating_top)
