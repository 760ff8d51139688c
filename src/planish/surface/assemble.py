"""From the faces of single columns to the result: what is sheet, rim and hole, the centre surface, the reasons."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core._envelope_kernels import rolled
from planish.core.checks import POSITION, Check
from planish.core.errors import VolumeError
from planish.core.frame import Frame
from planish.core.grid import filled
from planish.core.status import Status, status_flags
from planish.core.tiles import Engine
from planish.core.typing import Bools, Floats
from planish.surface.centre import gaussian_regression, slice_smoothed
from planish.surface.columns import Columns, voxel_pitch
from planish.surface.faces import Faces
from planish.surface.params import SurfaceParams
from planish.surface.presence import LAYERS, TITLES, find_presence
from planish.surface.regions import Hole, half_closed, regions

Variable = tuple[tuple[str, str], NDArray[np.generic], dict[str, object]]

_SHORTER = 0.625  # of the cut-off: 250 for 400 um
_MOST_BRIDGED = 0.02  # of the columns away from holes and rims


def assemble(
    columns: Columns, params: SurfaceParams, faces: Faces, doubt: tuple[Bools, Bools], levels: tuple[float, float],
    engine: Engine,
) -> xr.Dataset:  # fmt: skip
    """Build the result of :func:`planish.surface.find_surfaces` but for the grey levels in its attributes.

    ``doubt``: columns in which the sheet touches another or itself, and in which it may run out of the volume;
    ``levels``: grey of air and base.
    """
    pitch, up = columns.pitch[:2], columns.frame.sign
    f = _orient(faces, doubt, columns.frame)
    thickness = float(np.nanmedian(up * (f.top - f.bottom))) if f.has_faces.any() else float("nan")
    if not np.isfinite(thickness):
        raise VolumeError(
            "There is no sheet in the volume: no column shows two faces. Check --through and --sheet-grey."
        )
    is_sheet = f.has_faces | f.touching | f.stuck
    sheet, rim, outline = regions(is_sheet, f.runs_out, pitch, params.rim_um)
    middle = np.where(sheet & ~rim & f.has_faces, 0.5 * (f.top + f.bottom), np.nan)
    if not np.isfinite(middle).any():
        raise VolumeError(
            f"The sheet is {thickness:.3g} um thick and consists of holes and their rims of {params.rim_um:g} um only; "
            "nothing is left to measure. Is the voxel size in um? Check --voxel-um, --rim-um and --sheet-grey."
        )
    centre, cutoff_used = centre_surface(middle, outline, pitch, params)
    status = _status(centre, sheet, rim, f)
    variables = _face_variables(f, pitch, up, params.envelope_um, centre)
    between = 0.5 * (f.interface_top + f.interface_bottom) - middle
    alternatives = alternative_surfaces(between, middle, centre, outline, pitch, params)
    variables |= {name: _variable(height.astype(np.float32), title) for name, (height, title) in alternatives.items()}
    presence = find_presence(columns, centre, thickness, up, levels, engine)
    variables |= {
        name: _variable(share, TITLES[name], "1", layer=list(LAYERS[name])) for name, share in presence.items()
    }
    is_bridged = cutoff_used > params.cutoff_um
    if is_bridged.any():
        variables["centre_cutoff_um"] = _variable(
            cutoff_used.astype(np.float32), "Cut-off of the centre surface, wider than stated across gaps"
        )
    variables["status"] = ("y", "x"), status.astype(np.uint8), status_flags()
    attrs = columns.frame.attrs() | {
        "thickness_um": thickness,
        "cutoff_um": params.cutoff_um,
        **_bridged_shares(is_bridged, centre, status),
        "rim_um": params.rim_um,
        "voxel_um": [voxel_pitch(columns.volume, axis) for axis in ("z", "y", "x")],
        "particles_removed": faces.particles,
        **_half_closed_holes(half_closed(is_sheet, f.runs_out, pitch), *columns.lateral_um()),
        **({} if params.method == "profile" else {"method": params.method}),
    }
    coords = {axis: ((axis,), um, {"units": "um"}) for axis, um in zip("yx", columns.lateral_um(), strict=True)}
    return xr.Dataset(variables, coords=coords, attrs=attrs)


class _Oriented(NamedTuple):
    """Faces by the side of the sheet, NaN where a column does not show both, and what such columns are."""

    top: Floats
    bottom: Floats
    interface_top: Floats
    interface_bottom: Floats
    has_faces: Bools
    stuck: Bools
    touching: Bools
    runs_out: Bools


def _orient(faces: Faces, doubt: tuple[Bools, Bools], frame: Frame) -> _Oriented:
    """Name the faces by the side of the sheet, and sort the columns that do not show both."""
    top, inner_top = faces.high, faces.interface_high
    bottom, inner_bottom = faces.low, faces.interface_low
    if frame.top == "low":
        (top, inner_top), (bottom, inner_bottom) = (bottom, inner_bottom), (top, inner_top)
    has_faces = np.isfinite(top) & np.isfinite(bottom) & (frame.sign * (top - bottom) > 0)
    runs_out = doubt[1] & ~has_faces
    touching = doubt[0] & ~runs_out
    has_faces &= ~touching
    top, bottom, inner_top, inner_bottom = (
        np.where(has_faces, height, np.nan) for height in (top, bottom, inner_top, inner_bottom)
    )
    stuck = faces.stuck & ~has_faces & ~touching & ~runs_out
    return _Oriented(top, bottom, inner_top, inner_bottom, has_faces, stuck, touching, runs_out)


def _face_variables(
    f: _Oriented, pitch: tuple[float, float], up: float, envelope_um: float | None, centre: Floats
) -> dict[str, Variable]:
    """Give faces, interfaces and centre surface, and the envelopes below balls of a radius, as variables."""
    variables = {
        "top": _variable(f.top, "Top face"),
        "bottom": _variable(f.bottom, "Bottom face"),
        "interface_top": _variable(f.interface_top, "Interface between top coating and base"),
        "interface_bottom": _variable(f.interface_bottom, "Interface between bottom coating and base"),
        "centre": _variable(centre, "Centre surface"),
    }
    if envelope_um is not None:
        for name, face, outward in (("top", f.top, up), ("bottom", f.bottom, -up)):
            envelope = outward * np.where(f.has_faces, rolled(filled(outward * face), pitch, envelope_um), np.nan)
            title = f"{name.capitalize()} face below a ball of {envelope_um:g} um"
            variables[f"{name}_envelope"] = _variable(envelope, title)
    return variables


def _variable(field: NDArray[np.generic], title: str, units: str = "um", **attrs: object) -> Variable:
    return ("y", "x"), field, {"units": units, "long_name": title, **attrs}


def _bridged_shares(is_bridged: Bools, centre: Floats, status: NDArray[np.int64]) -> dict[str, float]:
    """Give the shares of the columns whose centre surface has a wider cut-off than stated."""
    off_rims = (status != Status.NO_SHEET) & (status != Status.RIM)
    return {
        "bridged_share": float(np.count_nonzero(is_bridged) / np.count_nonzero(np.isfinite(centre))),
        "bridged_off_rims_share": float(is_bridged[off_rims].mean()) if off_rims.any() else 0.0,
    }


def _half_closed_holes(holes: list[Hole], rows: Floats, cols: Floats) -> dict[str, object]:
    """Give the number of holes that are half closed, and their places one after the other, um."""
    places = [(k, um) for hole in holes for k, um in ((hole.row, rows), (hole.col, cols))]
    return {
        "half_closed_holes": len(holes),
        "half_closed_at_um": [float(np.interp(k, np.arange(um.size), um)) for k, um in places],
    }


def cutoff_check(surfaces: xr.Dataset) -> Check:
    """Judge the cut-off of the centre surface: the stated one wherever it was measured."""
    share, cutoff = float(surfaces.attrs.get("bridged_off_rims_share", 0.0)), float(surfaces.attrs["cutoff_um"])
    return Check.at_most(
        "cut-off", share, look=_MOST_BRIDGED,
        sentence=f"The centre surface has the stated cut-off of {cutoff:g} um in {100 * (1 - share):.1f} % of the "
        "columns away from holes and rims"
        + (", and twice or four times as much in the alternatives." if share > 0 else "."),
        advice="Choose a longer --cutoff-um, or a smaller --rim-um if the rims take the sheet away.",
        figures=(POSITION,),
    )  # fmt: skip


def _status(centre: Floats, sheet: Bools, rim: Bools, f: _Oriented) -> NDArray[np.int64]:
    """Say for each column that it was measured, or why not."""
    outside = ~np.isfinite(centre) | ~sheet
    status = np.select(
        [outside, rim, f.has_faces], [Status.NO_SHEET, Status.RIM, Status.MEASURED], Status.FACE_NOT_FOUND
    )
    status[f.stuck & (status == Status.FACE_NOT_FOUND)] = Status.PARTICLE
    status[f.touching & sheet] = Status.TOUCHING
    status[f.runs_out & (status > 0)] = Status.LEAVES_VOLUME
    return status


def alternative_surfaces(
    between: Floats, middle: Floats, centre: Floats, outline: Bools, pitch: tuple[float, float], params: SurfaceParams
) -> dict[str, tuple[Floats, str]]:
    """Give the heights over the centre surface of alternatives that could stand for it, smoothed alike and carried on.

    ``between``: from the mean of the faces to the middle of the base; left out where an interface is missing.
    """
    shorter = params.model_copy(update={"cutoff_um": _SHORTER * params.cutoff_um})
    surfaces = {
        "centre_shorter": (
            centre_surface(middle, outline, pitch, shorter)[0] - centre,
            f"Centre surface of {_SHORTER:g} of the cut-off, over the centre surface",
        )
    }
    if np.isfinite(between).mean() >= 0.5 * np.isfinite(middle).mean():
        base_middle = centre_surface(between, outline, pitch, params)[0]
        surfaces["base_middle"] = base_middle, "Middle of the base, over the centre surface"
    has_centre = np.isfinite(centre)
    return {name: (np.where(has_centre, filled(height), np.nan), title) for name, (height, title) in surfaces.items()}


def centre_surface(
    middle: Floats, outline: Bools, pitch: tuple[float, float], params: SurfaceParams
) -> tuple[Floats, Floats]:
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
