"""From the faces of single columns to the result: what is sheet, rim and hole, the centre surface, the reasons."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core._envelope_kernels import rolled
from planish.core.checks import POSITION, Check
from planish.core.errors import VolumeError
from planish.core.grid import filled
from planish.core.status import Status, status_flags
from planish.core.tiles import Engine
from planish.surface.centre import gaussian_regression, slice_smoothed
from planish.surface.columns import Columns, voxel_pitch
from planish.surface.faces import Faces
from planish.surface.params import SurfaceParams
from planish.surface.presence import LAYERS, TITLES, find_presence
from planish.surface.regions import half_closed, regions

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SHORTER = 0.625  # of the cut-off: 250 for 400 um
_MOST_BRIDGED = 0.02  # of the columns away from holes and rims


def assemble(
    columns: Columns, params: SurfaceParams, faces: Faces, doubt: tuple[Mask, Mask], levels: tuple[float, float],
    engine: Engine,
) -> xr.Dataset:  # fmt: skip
    """Build the result of :func:`planish.surface.find_surfaces` but for the grey levels in its attributes.

    ``doubt``: columns in which the sheet touches another or itself, and in which it may run out of the volume;
    ``levels``: grey of air and base.
    """
    pitch, frame = columns.pitch, columns.frame
    top, inner_top = faces.high, faces.interface_high
    bottom, inner_bottom = faces.low, faces.interface_low
    if frame.top == "low":
        (top, inner_top), (bottom, inner_bottom) = (bottom, inner_bottom), (top, inner_top)
    up = frame.sign
    seen = np.isfinite(top) & np.isfinite(bottom) & (up * (top - bottom) > 0)
    runs_out = doubt[1] & ~seen
    touching = doubt[0] & ~runs_out
    seen &= ~touching
    top, bottom, inner_top, inner_bottom = (np.where(seen, f, np.nan) for f in (top, bottom, inner_top, inner_bottom))
    thickness = float(np.nanmedian(up * (top - bottom))) if seen.any() else float("nan")
    if not np.isfinite(thickness):
        raise VolumeError(
            "There is no sheet in the volume: no column shows two faces. Check --through and --sheet-grey."
        )
    stuck = faces.stuck & ~seen & ~touching & ~runs_out
    there = seen | touching | stuck
    sheet, rim, outline = regions(there, runs_out, pitch[:2], params.rim_um)
    middle = np.where(sheet & ~rim & seen, 0.5 * (top + bottom), np.nan)
    if not np.isfinite(middle).any():
        raise VolumeError(
            f"The sheet is {thickness:.3g} um thick and consists of holes and their rims of {params.rim_um:g} um only; "
            "nothing is left to measure. Is the voxel size in um? Check --voxel-um, --rim-um and --sheet-grey."
        )
    centre, cutoff_used = centre_surface(middle, outline, pitch[:2], params)
    status = _status(centre, sheet, rim, seen, stuck, touching, runs_out)
    bridged = cutoff_used > params.cutoff_um
    off_rims = (status != Status.NO_SHEET) & (status != Status.RIM)
    present = find_presence(columns, centre, thickness, up, levels, engine)
    heights = {
        "top": (top, "Top face"),
        "bottom": (bottom, "Bottom face"),
        "interface_top": (inner_top, "Interface between top coating and base"),
        "interface_bottom": (inner_bottom, "Interface between bottom coating and base"),
        "centre": (centre, "Centre surface"),
    }
    if params.envelope_um is not None:
        radius = params.envelope_um
        for name, face, outward in (("top", top, up), ("bottom", bottom, -up)):
            envelope = outward * np.where(seen, rolled(filled(outward * face), pitch[:2], radius), np.nan)
            heights[f"{name}_envelope"] = (envelope, f"{name.capitalize()} face below a ball of {radius:g} um")
    data: dict[str, tuple[tuple[str, str], NDArray[np.generic], dict[str, object]]] = {
        name: (("y", "x"), values, {"units": "um", "long_name": title}) for name, (values, title) in heights.items()
    }
    between = 0.5 * (inner_top + inner_bottom) - middle
    for name, (values, title) in _other_surfaces(between, middle, centre, outline, pitch[:2], params).items():
        data[name] = (("y", "x"), values.astype(np.float32), {"units": "um", "long_name": title})
    for name, share in present.items():
        layer: dict[str, object] = {"units": "1", "long_name": TITLES[name], "layer": list(LAYERS[name])}
        data[name] = (("y", "x"), share, layer)
    if bridged.any():
        title = "Cut-off of the centre surface, wider than stated across gaps"
        used = cutoff_used.astype(np.float32)
        data["centre_cutoff_um"] = (("y", "x"), used, {"units": "um", "long_name": title})
    data["status"] = (("y", "x"), status.astype(np.uint8), status_flags())
    closed = half_closed(there, runs_out, pitch[:2])
    rows, cols = columns.lateral_um()
    attrs: dict[str, object] = {
        **frame.attrs(),
        "thickness_um": thickness,
        "cutoff_um": params.cutoff_um,
        "bridged_share": float(np.count_nonzero(bridged) / np.count_nonzero(np.isfinite(centre))),
        "bridged_off_rims_share": float(bridged[off_rims].mean()) if off_rims.any() else 0.0,
        "rim_um": params.rim_um,
        "voxel_um": [voxel_pitch(columns.volume, axis) for axis in ("z", "y", "x")],
        "particles_removed": faces.particles,
        "half_closed_holes": len(closed),
        "half_closed_at_um": [float(np.interp(at, np.arange(c.size), c)) for h in closed
                              for at, c in ((h.row, rows), (h.col, cols))],
    }  # fmt: skip
    if params.method != "profile":
        attrs["method"] = params.method
    coords = {"y": (("y",), rows, {"units": "um"}), "x": (("x",), cols, {"units": "um"})}
    return xr.Dataset(data, coords=coords, attrs=attrs)


def cutoff_check(surfaces: xr.Dataset) -> Check:
    """Whether the centre surface has the cut-off that is stated wherever it was measured."""
    share, cutoff = float(surfaces.attrs.get("bridged_off_rims_share", 0.0)), float(surfaces.attrs["cutoff_um"])
    return Check.at_most(
        "cut-off", share, look=_MOST_BRIDGED,
        sentence=f"The centre surface has the stated cut-off of {cutoff:g} um in {100 * (1 - share):.1f} % of the "
        "columns away from holes and rims"
        + (", and twice or four times as much in the others." if share > 0 else "."),
        advice="Choose a longer --cutoff-um, or a smaller --rim-um if the rims take the sheet away.",
        figures=(POSITION,),
    )  # fmt: skip


def _status(
    centre: Array, sheet: Mask, rim: Mask, seen: Mask, stuck: Mask, touching: Mask, runs_out: Mask
) -> NDArray[np.int64]:  # fmt: skip
    """Why a column has no measurement, or that it has one."""
    outside = ~np.isfinite(centre) | ~sheet
    status = np.select([outside, rim, seen], [Status.NO_SHEET, Status.RIM, Status.MEASURED], Status.FACE_NOT_FOUND)
    status[stuck & (status == Status.FACE_NOT_FOUND)] = Status.PARTICLE
    status[touching & sheet] = Status.TOUCHING
    status[runs_out & (status > 0)] = Status.LEAVES_VOLUME
    return status


def _other_surfaces(
    between: Array, middle: Array, centre: Array, outline: Mask, pitch: tuple[float, float], params: SurfaceParams
) -> dict[str, tuple[Array, str]]:  # fmt: skip
    """How far over the centre surface other surfaces lie that could stand for it, smoothed alike and carried on.

    ``between``: from the mean of the faces to the middle of the base; left out where an interface is missing.
    """
    known = np.isfinite(centre)
    shorter = params.model_copy(update={"cutoff_um": _SHORTER * params.cutoff_um})
    found = {
        "centre_shorter": (
            centre_surface(middle, outline, pitch, shorter)[0] - centre,
            f"Centre surface of {_SHORTER:g} of the cut-off, over the centre surface",
        )
    }
    if np.isfinite(between).mean() >= 0.5 * np.isfinite(middle).mean():
        found["base_middle"] = (
            centre_surface(between, outline, pitch, params)[0],
            "Middle of the base, over the centre surface",
        )
    return {name: (np.where(known, filled(values), np.nan), title) for name, (values, title) in found.items()}


def centre_surface(
    middle: Array, outline: Mask, pitch: tuple[float, float], params: SurfaceParams
) -> tuple[Array, Array]:
    """Smooth the mean of the faces and carry it across holes; the centre surface and the cut-off used, in um."""
    cutoff_um = params.cutoff_um
    if params.method == "paper":
        centre = np.where(outline, slice_smoothed(middle, pitch[1], cutoff_um=cutoff_um), np.nan)
        return centre, np.where(np.isfinite(centre), cutoff_um, np.nan)
    centre = gaussian_regression(middle, pitch, cutoff_um=cutoff_um)
    used = np.full(centre.shape, cutoff_um)
    # A hole with its rim may be wider than a short cut-off reaches: it is bridged with a longer one.
    for wider in (2.0 * cutoff_um, 4.0 * cutoff_um):
        gap = np.isnan(centre)
        if gap[outline].any():
            bridge = gaussian_regression(middle, pitch, cutoff_um=wider)
            centre, used = np.where(gap, bridge, centre), np.where(gap, wider, used)
    return np.where(outline, centre, np.nan), np.where(outline & np.isfinite(centre), used, np.nan)
