"""Make the result from the faces of single columns.

It is sheet, rim and hole, centre surface, presence of material, and status.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core._envelope_kernels import rolled
from planish.core.errors import VolumeError
from planish.core.grid import Grid, filled
from planish.core.status import Status, status_flags
from planish.core.tiles import Engine, Tile
from planish.core.typing import Bools, Codes, Entries, Floats, NamedFields, Pair, TwoFields
from planish.surface import _kernels
from planish.surface.centre import gaussian_regression, slice_smoothed
from planish.surface.columns import Columns, join_tiles, voxel_pitch
from planish.surface.faces import Faces
from planish.surface.params import SurfaceParams
from planish.surface.regions import half_closed, regions

Variable = tuple[tuple[str, str], NDArray[np.generic], dict[str, object]]
_SHORTER = 0.625  # of the cut-off: 250 for 400 um
_TITLES = {
    "top": "Top face",
    "bottom": "Bottom face",
    "interface_top": "Interface between top coating and base",
    "interface_bottom": "Interface between bottom coating and base",
}


class ColumnStates(NamedTuple):
    """Tell which columns have both faces, and which lie below attached particles.

    It also says where the sheet touches another or leaves the volume.
    """

    has_faces: Bools
    is_touching: Bools
    runs_out: Bools
    below_particle: Bools

    @classmethod
    def of(cls, faces: Faces, up_sign: float, may_touch: Bools, may_run_out: Bools) -> ColumnStates:
        """Decide between what the fit and the coarse search say."""
        has_faces = up_sign * (faces.heights["top"] - faces.heights["bottom"]) > 0
        runs_out = may_run_out & ~has_faces
        is_touching = may_touch & ~runs_out
        has_faces &= ~is_touching
        below_particle = faces.below_particle & ~(has_faces | is_touching | runs_out)
        return cls(has_faces, is_touching, runs_out, below_particle)

    @property
    def is_sheet(self) -> Bools:
        """Columns with a sheet that does not run out of the volume."""
        return self.has_faces | self.is_touching | self.below_particle

    @property
    def is_closed(self) -> Bools:
        """Columns that are no opening of the sheet."""
        return self.is_sheet | self.runs_out

    def status(self, in_sheet: Bools, in_rim: Bools, has_centre: Bools) -> Codes:
        """Give the status of each column."""
        is_outside = ~(has_centre & in_sheet)
        conditions = [is_outside, in_rim, self.has_faces, self.below_particle]
        codes = [Status.NO_SHEET, Status.RIM, Status.MEASURED, Status.PARTICLE]
        status = np.select(conditions, codes, Status.FACE_NOT_FOUND)
        status[self.is_touching & in_sheet] = Status.TOUCHING
        status[self.runs_out & (status > 0)] = Status.LEAVES_VOLUME
        return status.astype(np.uint8)


def assemble(
    columns: Columns,
    params: SurfaceParams,
    faces: Faces,
    doubt: tuple[Bools, Bools],
    levels: Pair,
    engine: Engine,
) -> xr.Dataset:
    """Build the result of :func:`planish.surface.find_surfaces`.

    The grey levels in its attributes are left out. VolumeError if no column has two faces, or none
    away from holes.

    ``doubt``: columns in which the sheet touches another or itself, and in which it may run out of
    the volume; ``levels``: grey of air and base.
    """
    pitch = columns.pitch[:2]
    sign = columns.frame.sign
    states = ColumnStates.of(faces, sign, *doubt)
    if not states.has_faces.any():
        raise VolumeError(
            "There is no sheet in the volume: no column shows two faces. Check `through` and"
            " `sheet_grey`."
        )
    heights: NamedFields = {}
    for name in _TITLES:
        heights[name] = np.where(states.has_faces, faces.heights[name], np.nan)
    sheet_um = np.abs(heights["top"] - heights["bottom"])
    thickness = float(np.median(sheet_um[states.has_faces]))
    in_sheet, in_rim, in_outline = regions(states.is_sheet, states.runs_out, pitch, params.rim_um)
    middle = 0.5 * (heights["top"] + heights["bottom"])
    face_mean = np.where(in_sheet & ~in_rim, middle, np.nan)
    if not np.isfinite(face_mean).any():
        raise VolumeError(
            f"The sheet is {thickness:.3g} um thick and consists of holes and their rims of"
            f" {params.rim_um:g} um only. Is the voxel size in um? Check `voxel_um`, `rim_um` and"
            " `sheet_grey`."
        )
    centre, cutoff_used = centre_surface(face_mean, in_outline, pitch, params)
    has_centre = np.isfinite(centre)
    variables = _face_variables(heights, faces)
    variables["centre"] = _variable(centre, "Centre surface")
    if params.envelope_um is not None:
        variables |= _envelopes(heights, sign, pitch, params.envelope_um)
    interface_mean = 0.5 * (heights["interface_top"] + heights["interface_bottom"])
    base_offset = interface_mean - face_mean
    alternatives = alternative_surfaces(base_offset, face_mean, centre, in_outline, pitch, params)
    for name, (height, title) in alternatives.items():
        variables[name] = _variable(height.astype(np.float32), title)
    shares = find_presence(columns, centre, thickness, sign, levels, engine)
    for name, share in shares.items():
        title = f"Material {_PLACES[name]}"
        variables[name] = _variable(share, title, "1", layer=list(LAYERS[name]))
    has_interface = np.isfinite([heights["interface_top"], heights["interface_bottom"]])
    if has_interface.any():
        # A coating stands out from what fills the holes where the base hardly does, as in resin.
        has_faces = np.where(has_centre, states.is_closed, np.nan)
        title = "Columns in which both faces of a coated sheet are seen"
        field = has_faces.astype(np.float32)
        variables["presence_faces"] = _variable(field, title, "1", layer=[-0.5, 0.5])
    if (cutoff_used > params.cutoff_um).any():
        title = "Cut-off of the centre surface, wider than stated across gaps"
        variables["centre_cutoff_um"] = _variable(cutoff_used.astype(np.float32), title)
    status = states.status(in_sheet, in_rim, has_centre)
    variables["status"] = ("y", "x"), status, status_flags()
    attrs = _attrs(columns, params, faces, states, thickness, cutoff_used, status)
    y_um, x_um = columns.lateral_um()
    return xr.Dataset(variables, Grid(x_um=x_um, y_um=y_um).coords, attrs)


def _attrs(
    columns: Columns,
    params: SurfaceParams,
    faces: Faces,
    states: ColumnStates,
    thickness: float,
    cutoff_used: Floats,
    status: Codes,
) -> Entries:
    """Options of the search, what was removed, bridged gaps and half-closed holes.

    ``thickness``: the median one, um; ``cutoff_used`` (rows, cols): cut-off of the centre surface,
    um, NaN beyond its outline; ``status`` (rows, cols).
    """
    is_bridged = cutoff_used > params.cutoff_um
    bridged_share = np.count_nonzero(is_bridged) / np.count_nonzero(np.isfinite(cutoff_used))
    off_rims = is_bridged[(status != Status.NO_SHEET) & (status != Status.RIM)]
    holes = half_closed(states.is_sheet, states.runs_out, columns.pitch[:2])
    places = zip(holes.T, columns.lateral_um(), strict=True)
    holes_um = [np.interp(index, np.arange(um.size), um) for index, um in places]
    attrs: Entries = {"thickness_um": thickness, "cutoff_um": params.cutoff_um}
    attrs["bridged_share"] = bridged_share
    attrs["bridged_off_rims_share"] = float(off_rims.mean()) if off_rims.size else 0.0
    attrs["rim_um"] = params.rim_um
    attrs["voxel_um"] = [voxel_pitch(columns.volume, axis) for axis in "zyx"]
    attrs["particles_removed"] = faces.particles
    attrs["half_closed_holes"] = len(holes)
    attrs["half_closed_at_um"] = np.transpose(holes_um).ravel().tolist()
    if params.method != "profile":
        attrs["method"] = params.method
    return columns.frame.attrs() | attrs


def _face_variables(heights: NamedFields, faces: Faces) -> dict[str, Variable]:
    """Faces and interfaces, and how far the wall's grey moves them."""
    variables = {name: _variable(height, _TITLES[name]) for name, height in heights.items()}
    for side, (level_error, mean_um) in faces.level_errors.items():
        title = f"Standard error of the {side} face from the wall's grey"
        field = level_error.astype(np.float32)
        variables[f"level_{side}_error"] = _variable(field, title, common_um=mean_um)
    return variables


def _envelopes(
    heights: NamedFields, sign: float, pitch: Pair, radius_um: float
) -> dict[str, Variable]:
    envelopes: dict[str, Variable] = {}
    for name, outwards in (("top", sign), ("bottom", -sign)):
        outward = outwards * heights[name]
        envelope = rolled(filled(outward), pitch, radius_um)
        envelope = np.where(np.isfinite(outward), outwards * envelope, np.nan)
        title = f"{_TITLES[name]} below a ball of {radius_um:g} um"
        envelopes[f"{name}_envelope"] = _variable(envelope, title)
    return envelopes


def _variable(
    field: NDArray[np.generic], title: str, units: str = "um", **attrs: object
) -> Variable:
    return ("y", "x"), field, {"units": units, "long_name": title, **attrs}


def alternative_surfaces(
    base_offset: Floats,
    face_mean: Floats,
    centre: Floats,
    in_outline: Bools,
    pitch: Pair,
    params: SurfaceParams,
) -> dict[str, tuple[Floats, str]]:
    """Give the heights over the centre surface of alternatives that could stand for it.

    They are smoothed alike and carried on, (rows, cols) in um, NaN beyond the outline; each with
    the title of its map.

    ``base_offset``: from the mean of the faces, ``face_mean``, to the middle of the base; NaN where
    an interface is missing, and without half of the columns there is no such alternative.
    """
    shorter_params = params.model_copy(update={"cutoff_um": _SHORTER * params.cutoff_um})
    shorter, _ = centre_surface(face_mean, in_outline, pitch, shorter_params)
    title = f"Centre surface of {_SHORTER:g} of the cut-off, over the centre surface"
    surfaces = {"centre_shorter": (shorter - centre, title)}
    if np.isfinite(base_offset).mean() >= 0.5 * np.isfinite(face_mean).mean():
        base_middle, _ = centre_surface(base_offset, in_outline, pitch, params)
        surfaces["base_middle"] = base_middle, "Middle of the base, over the centre surface"
    for name, (height, title) in surfaces.items():
        carried_on = np.where(np.isfinite(centre), filled(height), np.nan)
        surfaces[name] = carried_on, title
    return surfaces


def centre_surface(
    face_mean: Floats, in_outline: Bools, pitch: Pair, params: SurfaceParams
) -> TwoFields:
    """Smooth the mean of the faces and carry it across holes.

    The centre surface and the cut-off used, (rows, cols) in um; NaN beyond the outline.
    """
    cutoff_um = params.cutoff_um
    if params.method == "paper":
        centre = slice_smoothed(face_mean, pitch[1], cutoff_um=cutoff_um)
        wider_cutoffs_um = ()
    else:
        centre = gaussian_regression(face_mean, pitch, cutoff_um=cutoff_um)
        wider_cutoffs_um = (2.0 * cutoff_um, 4.0 * cutoff_um)
    used_um = np.full(centre.shape, cutoff_um)
    # A hole with its rim may be wider than a short cut-off reaches: it is bridged with a longer
    # one.
    for wider_um in wider_cutoffs_um:
        is_gap = np.isnan(centre)
        if is_gap[in_outline].any():
            bridge = gaussian_regression(face_mean, pitch, cutoff_um=wider_um)
            centre = np.where(is_gap, bridge, centre)
            used_um = np.where(is_gap, wider_um, used_um)
    centre = np.where(in_outline, centre, np.nan)
    return centre, np.where(np.isfinite(centre), used_um, np.nan)


# Of the thickness, and places between; the bottom's layer mirrors the top's.
_FROM, _TO, _STEPS = 0.1, 0.42, 7
# The centre's layer reaches to the second place of either neighbour.
_INNER = _FROM + (_TO - _FROM) / (_STEPS - 1)
LAYERS = {
    "presence": (_FROM, _TO),
    "presence_centre": (-_INNER, _INNER),
    "presence_bottom": (-_TO, -_FROM),
}
"""First and last place of each layer in shares of the thickness, from the centre surface towards
the top."""
_PLACES = {
    "presence": "below the top face",
    "presence_centre": "around the centre surface",
    "presence_bottom": "above the bottom face",
}


def find_presence(
    columns: Columns, centre: Floats, thickness: float, up_sign: float, levels: Pair, engine: Engine
) -> NamedFields:
    """Share of material in three layers of the sheet, along the true normals, of every column.

    0 to 1.

    ``centre`` (rows, cols): height of the centre surface, um; ``thickness``: the median one of the
    sheet, um; ``up_sign``: +1 where heights grow towards the top, else -1; ``levels``: grey of air
    and base. Returns a map (rows, cols) for each of ``LAYERS``; NaN where there is no centre
    surface or the normal leaves the volume. The voxels are read once for all layers. The bottom's
    layer mirrors the top's: with the other side on top, the two maps change places to the last bit.
    """
    pitch = columns.pitch
    slope = np.gradient(centre, *pitch[:2])
    length = np.sqrt(1 + slope[0] ** 2 + slope[1] ** 2)
    upwards = -slope[0], -slope[1], 1.0
    # Columns, and voxels along them, for one um along the normal.
    normals = [up_sign * n / length / p for n, p in zip(upwards, pitch, strict=True)]
    depth = (centre - float(columns.depth_um[0])) / pitch[2]

    def job(tile: Tile) -> tuple[Columns, list[Floats], float, Pair]:
        fields = [field[tile.rows, tile.cols] for field in (depth, *normals)]
        return columns, fields, thickness, levels

    # Larger tiles have less of a border that is read twice.
    range_px = float(np.nanmax(depth) - np.nanmin(depth) + thickness / pitch[2])
    tiles = columns.tiles(engine, share=min(range_px / columns.shape[2], 1.0))
    presence_by_tile = engine.map("layers", _tile_presence, job, tiles)
    shares = np.full((len(LAYERS), *columns.shape[:2]), np.nan)
    return dict(zip(LAYERS, join_tiles(presence_by_tile, shares), strict=True))


def _tile_presence(job: tuple[Columns, list[Floats], float, Pair], tile: Tile) -> Floats:
    """Shares of material in the layers of a tile, (layers, rows, cols); NaN without a sheet.

    The job: the columns; depth of the centre surface in voxels, and the normal in columns and
    voxels for one um along it, each (rows, cols); the thickness in um; grey of air and base.
    """
    columns, depth_and_normal, thickness, grey_levels = job
    depth_count = columns.shape[2]
    shares = np.full((len(LAYERS), *tile.shape), np.nan)
    centre_depth, *normal = (np.ascontiguousarray(a) for a in depth_and_normal)
    is_sheet = np.isfinite(centre_depth) & np.isfinite(normal[2])
    if not is_sheet.any():
        return shares
    # Places along the normal, and which of them each layer is the mean of: the centre's layer takes
    # the two places of either neighbour that lie in it, and three of its own.
    top_offsets = np.linspace(_FROM, _TO, _STEPS)
    inner_offset = 2 * top_offsets[0] - top_offsets[1]
    middle_offsets = [0.0, inner_offset, -inner_offset]
    offsets = thickness * np.concatenate([top_offsets, -top_offsets, middle_offsets])
    centre_indices = [0, 1, _STEPS, _STEPS + 1, *range(2 * _STEPS, offsets.size)]
    layer_indices = np.array([range(_STEPS), centre_indices, range(_STEPS, 2 * _STEPS)])
    # Only what the normals pass through is read.
    end_offsets = np.array([[offsets.min()], [offsets.max()]])
    end_depths = centre_depth[is_sheet] + end_offsets * normal[2][is_sheet]
    min_depth = float(end_depths.min())
    max_depth = float(end_depths.max())
    if max_depth < 0 or min_depth > depth_count - 1:
        return shares
    # Two voxels at least, so that there is something to interpolate between.
    first_px = min(max(int(np.floor(min_depth)), 0), depth_count - 2)
    stop_px = min(int(np.ceil(max_depth)) + 2, depth_count)
    reach_um = np.abs(offsets).max()
    most_lateral = [np.abs(n[is_sheet]).max() for n in normal[:2]]
    row_halo, col_halo = np.ceil(np.multiply(reach_um, most_lateral)).astype(int).tolist()
    tile_with_halo = tile.grown(row_halo + 1, col_halo + 1, columns.shape[:2])
    grey = columns.grey(tile_with_halo, depth=slice(first_px, stop_px))
    lead = tile.within(tile_with_halo)[::2]
    slab = (grey, first_px, depth_count, *lead)
    layers = (offsets, layer_indices)
    _kernels.presence(*slab, centre_depth, *normal, *layers, *grey_levels, shares)
    return shares
