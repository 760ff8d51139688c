"""From the faces of single columns to the result: sheet, rim and hole, centre surface, presence of material, status."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core._envelope_kernels import rolled
from planish.core.errors import VolumeError
from planish.core.grid import filled
from planish.core.status import Status, status_flags
from planish.core.tiles import Engine, Tile
from planish.core.typing import Bools, Floats, Pair
from planish.surface import _kernels
from planish.surface.centre import gaussian_regression, slice_smoothed
from planish.surface.columns import Columns, join_tiles, voxel_pitch
from planish.surface.faces import Faces
from planish.surface.params import SurfaceParams
from planish.surface.regions import half_closed, regions

Variable = tuple[tuple[str, str], NDArray[np.generic], dict[str, object]]

_SHORTER = 0.625  # of the cut-off: 250 for 400 um


_TITLES = {
    "top": "Top face", "bottom": "Bottom face", "interface_top": "Interface between top coating and base",
    "interface_bottom": "Interface between bottom coating and base",
}  # fmt: skip


class ColumnStates(NamedTuple):
    """Columns with both faces, where the sheet touches another or leaves the volume, and below attached particles."""

    has_faces: Bools
    touching: Bools
    runs_out: Bools
    stuck: Bools

    @classmethod
    def of(cls, has_faces: Bools, stuck: Bools, may_touch: Bools, may_run_out: Bools) -> ColumnStates:
        """Decide between what the fit and the coarse search say."""
        runs_out = may_run_out & ~has_faces
        touching = may_touch & ~runs_out
        has_faces = has_faces & ~touching
        return cls(has_faces, touching, runs_out, stuck & ~(has_faces | touching | runs_out))

    @property
    def is_sheet(self) -> Bools:
        """Columns with a sheet that does not run out of the volume."""
        return self.has_faces | self.touching | self.stuck

    def status(self, sheet: Bools, rim: Bools, has_centre: Bools) -> NDArray[np.uint8]:
        """Give the status of each column."""
        status = np.select(
            [~(has_centre & sheet), rim, self.has_faces, self.stuck],
            [Status.NO_SHEET, Status.RIM, Status.MEASURED, Status.PARTICLE], Status.FACE_NOT_FOUND,
        )  # fmt: skip
        status[self.touching & sheet] = Status.TOUCHING
        status[self.runs_out & (status > 0)] = Status.LEAVES_VOLUME
        return status.astype(np.uint8)


def assemble(
    columns: Columns, params: SurfaceParams, faces: Faces, doubt: tuple[Bools, Bools], levels: Pair,
    engine: Engine,
) -> xr.Dataset:  # fmt: skip
    """Build the result of :func:`planish.surface.find_surfaces` but for the grey levels in its attributes.

    ``doubt``: columns in which the sheet touches another or itself, and in which it may run out of the volume;
    ``levels``: grey of air and base.
    """
    pitch, up = columns.pitch[:2], columns.frame.sign
    states = ColumnStates.of(up * (faces.heights["top"] - faces.heights["bottom"]) > 0, faces.stuck, *doubt)
    if not states.has_faces.any():
        raise VolumeError(
            "There is no sheet in the volume: no column shows two faces. Check --through and --sheet-grey."
        )
    heights = {name: np.where(states.has_faces, faces.heights[name], np.nan) for name in _TITLES}
    thickness = float(np.median((up * (heights["top"] - heights["bottom"]))[states.has_faces]))
    sheet, rim, outline = regions(states.is_sheet, states.runs_out, pitch, params.rim_um)
    middle = np.where(sheet & ~rim, 0.5 * (heights["top"] + heights["bottom"]), np.nan)
    if not np.isfinite(middle).any():
        raise VolumeError(
            f"The sheet is {thickness:.3g} um thick and consists of holes and their rims of {params.rim_um:g} um only. "
            "Is the voxel size in um? Check --voxel-um, --rim-um and --sheet-grey."
        )
    centre, cutoff_used = centre_surface(middle, outline, pitch, params)
    variables = {name: _variable(height, _TITLES[name]) for name, height in heights.items()}
    variables["centre"] = _variable(centre, "Centre surface")
    if params.envelope_um is not None:
        variables |= _envelopes(heights, up, pitch, params.envelope_um)
    between = 0.5 * (heights["interface_top"] + heights["interface_bottom"]) - middle
    variables |= {
        name: _variable(height.astype(np.float32), title)
        for name, (height, title) in alternative_surfaces(between, middle, centre, outline, pitch, params).items()
    }
    variables |= {
        name: _variable(share, f"Material {_PLACES[name]}", "1", layer=list(LAYERS[name]))
        for name, share in find_presence(columns, centre, thickness, up, levels, engine).items()
    }
    is_bridged = cutoff_used > params.cutoff_um
    if is_bridged.any():
        variables["centre_cutoff_um"] = _variable(
            cutoff_used.astype(np.float32), "Cut-off of the centre surface, wider than stated across gaps"
        )
    status = states.status(sheet, rim, np.isfinite(centre))
    variables["status"] = ("y", "x"), status, status_flags()
    off_rims = is_bridged[(status != Status.NO_SHEET) & (status != Status.RIM)]
    holes, lateral_um = half_closed(states.is_sheet, states.runs_out, pitch), columns.lateral_um()
    attrs = columns.frame.attrs() | {
        "thickness_um": thickness,
        "cutoff_um": params.cutoff_um,
        "bridged_share": float(np.count_nonzero(is_bridged) / np.count_nonzero(np.isfinite(centre))),
        "bridged_off_rims_share": float(off_rims.mean()) if off_rims.size else 0.0,
        "rim_um": params.rim_um,
        "voxel_um": [voxel_pitch(columns.volume, axis) for axis in ("z", "y", "x")],
        "particles_removed": faces.particles,
        "half_closed_holes": len(holes),
        "half_closed_at_um": [
            float(np.interp(k, np.arange(um.size), um))
            for hole in holes for k, um in zip(hole, lateral_um, strict=True)
        ],
    } | ({} if params.method == "profile" else {"method": params.method})  # fmt: skip
    return xr.Dataset(
        variables, {axis: (axis, um, {"units": "um"}) for axis, um in zip("yx", lateral_um, strict=True)}, attrs
    )


def _envelopes(heights: dict[str, Floats], up: float, pitch: Pair, radius_um: float) -> dict[str, Variable]:
    """Faces below a ball that rolls over them."""
    variables: dict[str, Variable] = {}
    for name, outward in (("top", up), ("bottom", -up)):
        ball = np.where(np.isfinite(heights[name]), rolled(filled(outward * heights[name]), pitch, radius_um), np.nan)
        variables[f"{name}_envelope"] = _variable(outward * ball, f"{_TITLES[name]} below a ball of {radius_um:g} um")
    return variables


def _variable(field: NDArray[np.generic], title: str, units: str = "um", **attrs: object) -> Variable:
    return ("y", "x"), field, {"units": units, "long_name": title, **attrs}


def alternative_surfaces(
    between: Floats, middle: Floats, centre: Floats, outline: Bools, pitch: Pair, params: SurfaceParams
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
_PLACES = dict(zip(LAYERS, ("below the top face", "around the centre surface", "above the bottom face"), strict=True))


def find_presence(
    columns: Columns, centre: Floats, thickness: float, up: float, levels: Pair, engine: Engine
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

    def job(tile: Tile) -> tuple[Columns, list[Floats], float, Pair]:
        return columns, [field[tile.rows, tile.cols] for field in (depth, *normals)], thickness, levels

    parts = engine.map("layers", _tile_presence, job, columns.tiles(engine))
    return dict(zip(LAYERS, join_tiles(parts, np.full((len(LAYERS), *columns.shape[:2]), np.nan)), strict=True))


def _tile_presence(job: tuple[Columns, list[Floats], float, Pair], tile: Tile) -> Floats:
    """Give the presence in a tile, (layers, rows, cols)."""
    columns, fields, thickness, levels = job
    depths, out = columns.shape[2], np.full((len(LAYERS), *tile.shape), np.nan)
    depth, rows, cols, along = (np.ascontiguousarray(a) for a in fields)
    is_sheet = np.isfinite(depth) & np.isfinite(along)
    if not is_sheet.any():
        return out
    # Places along the normal, and which of them each layer is the mean of: the centre's layer takes the two places of
    # either neighbour that lie in it, and three of its own.
    outer = np.linspace(_FROM, _TO, _STEPS)
    inner = 2 * outer[0] - outer[1]
    offsets = thickness * np.concatenate([outer, -outer, [0.0, inner, -inner]])
    centre = [0, 1, _STEPS, _STEPS + 1, *range(2 * _STEPS, offsets.size)]
    layers = np.array([range(_STEPS), centre, range(_STEPS, 2 * _STEPS)])
    # Only what the normals pass through is read.
    ends = [depth[is_sheet] + s * along[is_sheet] for s in (offsets.min(), offsets.max())]
    low, high = float(np.min(ends)), float(np.max(ends))
    if high < 0 or low > depths - 1:
        return out
    first = min(max(int(np.floor(low)), 0), depths - 2)
    lead = [int(np.ceil(np.abs(offsets).max() * float(np.abs(n[is_sheet]).max()))) + 1 for n in (rows, cols)]
    outside = tile.grown(lead[0], lead[1], columns.shape[:2])
    grey = columns.grey(outside, depth=slice(first, min(int(np.ceil(high)) + 2, depths)))
    _kernels.presence(
        grey, first, depths, *tile.within(outside)[::2], depth, rows, cols, along, offsets, layers, *levels, out
    )
    return out
