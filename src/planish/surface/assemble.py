"""From the faces of single columns to the result: sheet, rim and hole, centre surface, presence of material, status."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core._envelope_kernels import rolled
from planish.core.errors import VolumeError
from planish.core.frame import Frame
from planish.core.grid import filled
from planish.core.status import Status, status_flags
from planish.core.tiles import Engine, Tile
from planish.core.transform import Pair
from planish.core.typing import Bools, Floats
from planish.surface import _kernels
from planish.surface.centre import gaussian_regression, slice_smoothed
from planish.surface.columns import Columns, join_tiles, voxel_pitch
from planish.surface.faces import Faces
from planish.surface.params import SurfaceParams
from planish.surface.regions import half_closed, regions

Variable = tuple[tuple[str, str], NDArray[np.generic], dict[str, object]]

_SHORTER = 0.625  # of the cut-off: 250 for 400 um


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
    variables |= {
        name: _variable(height.astype(np.float32), title)
        for name, (height, title) in alternative_surfaces(between, middle, centre, outline, pitch, params).items()
    }
    variables |= {
        name: _variable(share, TITLES[name], "1", layer=list(LAYERS[name]))
        for name, share in find_presence(columns, centre, thickness, up, levels, engine).items()
    }
    is_bridged = cutoff_used > params.cutoff_um
    if is_bridged.any():
        variables["centre_cutoff_um"] = _variable(
            cutoff_used.astype(np.float32), "Cut-off of the centre surface, wider than stated across gaps"
        )
    variables["status"] = ("y", "x"), status.astype(np.uint8), status_flags()
    off_rims = (status != Status.NO_SHEET) & (status != Status.RIM)
    holes, lateral_um = half_closed(is_sheet, f.runs_out, pitch), columns.lateral_um()
    attrs = columns.frame.attrs() | {
        "thickness_um": thickness,
        "cutoff_um": params.cutoff_um,
        "bridged_share": float(np.count_nonzero(is_bridged) / np.count_nonzero(np.isfinite(centre))),
        "bridged_off_rims_share": float(is_bridged[off_rims].mean()) if off_rims.any() else 0.0,
        "rim_um": params.rim_um,
        "voxel_um": [voxel_pitch(columns.volume, axis) for axis in ("z", "y", "x")],
        "particles_removed": faces.particles,
        "half_closed_holes": len(holes),
        "half_closed_at_um": [
            float(np.interp(k, np.arange(um.size), um))
            for hole in holes for k, um in zip((hole.row, hole.col), lateral_um, strict=True)
        ],
        **({} if params.method == "profile" else {"method": params.method}),
    }  # fmt: skip
    return xr.Dataset(
        variables, {axis: ((axis,), um, {"units": "um"}) for axis, um in zip("yx", lateral_um, strict=True)}, attrs
    )


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


def centre_surface(middle: Floats, outline: Bools, pitch: Pair, params: SurfaceParams) -> tuple[Floats, Floats]:
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


_FROM, _TO, _STEPS = 0.1, 0.42, 7  # of the thickness, and places between; the bottom's layer mirrors the top's
_INNER = _FROM + (_TO - _FROM) / (_STEPS - 1)  # the centre's layer reaches to the second place of either neighbour

LAYERS = {"presence": (_FROM, _TO), "presence_centre": (-_INNER, _INNER), "presence_bottom": (-_TO, -_FROM)}
"""First and last place of each layer in shares of the thickness, from the centre surface towards the top."""

TITLES = {
    "presence": "Material below the top face",
    "presence_centre": "Material around the centre surface",
    "presence_bottom": "Material above the bottom face",
}


_TileJob = tuple[Columns, list[Floats], float, tuple[float, float]]  # depth and normals in voxels


def find_presence(
    columns: Columns, centre: Floats, thickness: float, up: float, levels: tuple[float, float], engine: Engine
) -> dict[str, Floats]:
    """Share of material in three layers of the sheet, along the true normals, of every column; 0 to 1.

    ``centre``: height of the centre surface, um; ``up``: +1 where heights grow towards the top; ``levels``: grey of air
    and base. Returns a map (rows, cols) for each of ``LAYERS``; NaN where there is no centre surface or the normal
    leaves the volume. The voxels are read once for all layers. The bottom's layer mirrors the top's: with the other
    side on top, the two maps change places to the last bit.
    """
    pitch = columns.pitch
    slope = [np.gradient(centre, p, axis=i) for i, p in enumerate(pitch[:2])]
    length = np.sqrt(1 + slope[0] ** 2 + slope[1] ** 2)
    normals = (-up * slope[0] / length / pitch[0], -up * slope[1] / length / pitch[1], up / length / pitch[2])
    depth = (centre - float(columns.depth_um[0])) / pitch[2]

    def job(tile: Tile) -> _TileJob:
        return columns, [field[tile.rows, tile.cols] for field in (depth, *normals)], thickness, levels

    parts = engine.map("layers", _tile_presence, job, columns.tiles(engine))
    return dict(zip(LAYERS, join_tiles(parts, np.full((len(LAYERS), *columns.shape[:2]), np.nan)), strict=True))


def _places() -> tuple[Floats, NDArray[np.int64]]:
    """Places along the normal in shares of the thickness, and which of them each layer is the mean of."""
    outer = np.linspace(_FROM, _TO, _STEPS)
    # The centre's layer takes the two places of either neighbour that lie in it, and three of its own.
    inner = np.array([0.0, 2 * outer[0] - outer[1]])
    places = np.concatenate([outer, -outer, inner, -inner[1:]])
    top = np.arange(_STEPS)
    centre = np.array([0, 1, _STEPS, _STEPS + 1, *range(2 * _STEPS, places.size)])
    return places, np.stack([top, centre, top + _STEPS]).astype(np.int64)


def _tile_presence(job: _TileJob, tile: Tile) -> Floats:
    """Give the presence in a tile, (layers, rows, cols)."""
    columns, fields, thickness, levels = job
    whole = columns.shape
    out = np.full((len(LAYERS), *tile.shape), np.nan)
    depth, rows, cols, along = (np.ascontiguousarray(a) for a in fields)
    is_sheet = np.isfinite(depth) & np.isfinite(along)
    if not is_sheet.any():
        return out
    places, layers = _places()
    offsets = places * thickness
    # Only what the normals pass through is read.
    ends = [depth[is_sheet] + s * along[is_sheet] for s in (offsets.min(), offsets.max())]
    low, high = min(float(e.min()) for e in ends), max(float(e.max()) for e in ends)
    if high < 0 or low > whole[2] - 1:
        return out
    first = min(max(int(np.floor(low)), 0), whole[2] - 2)
    lead = [int(np.ceil(np.abs(offsets).max() * float(np.abs(n[is_sheet]).max()))) + 1 for n in (rows, cols)]
    outside = tile.grown(lead[0], lead[1], whole[:2])
    inner = tile.within(outside)
    grey = columns.grey(outside, depth=slice(first, min(int(np.ceil(high)) + 2, whole[2])))
    _kernels.presence(
        grey, first, whole[2], inner.r0, inner.c0, depth, rows, cols, along, offsets, layers, *levels, out
    )
    return out
