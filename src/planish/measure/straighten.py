"""The volume straightened along the normals, on the pixels of the flat maps.

Every sheet lies flat in it.
"""

from collections.abc import Mapping
from functools import partial

import numpy as np
import xarray as xr

from planish.core.errors import StudyError, SurfaceError
from planish.core.grid import Grid, bilinear
from planish.core.labelled import variable_data
from planish.core.lazy import LazyArray, Where
from planish.core.threads import map_threads
from planish.core.tiles import Tile, tiles_of
from planish.core.typing import Array, Floats, NamedFields, Pair, Singles
from planish.measure.params import MeasureParams
from planish.measure.rays import RayFrame, directions

# Pixels along the width of a part: its box of voxels has to be small where the sheet is steep.
_WIDE = 256


def straightened(
    volume: xr.DataArray,
    surfaces: xr.Dataset,
    maps: xr.Dataset,
    *,
    params: MeasureParams,
    depth_um: Pair | None,
) -> xr.DataArray:
    """Straighten a volume along the normals of the centre surface.

    Parameters
    ----------
    volume : DataArray, dims (z, y, x), coordinates in um
        May be lazily indexed; only the voxels under a part are read.
    surfaces : Dataset, dims (y, x), heights in um
        As :func:`planish.surface.find_surfaces` returns them for this volume.
    maps : Dataset, dims (v, u)
        Flat maps of these surfaces, with ``volume_x``, ``volume_y`` and ``volume_z``.
    params : MeasureParams
    depth_um : (float, float) or None
        From where to where along the normals, from the centre surface, up to the top; from below
        the lowest to above the highest face where None.

    Returns
    -------
    DataArray, dims (z, y, x), float32, in um
        z is the height on the normal, y and x are v and u of the maps; worked out where it is asked
        for. Grey values are interpolated once, between the eight voxels around a place. NaN is
        missing: beside the sheet and the volume.

    Raises
    ------
    StudyError
        The depths are out of order, or farther from the sheet than 20 of its thicknesses.
    SurfaceError
        Surfaces and volume do not belong together, or the maps have no places in the volume.
    """
    if lacking := [name for name in ("volume_x", "volume_y", "volume_z") if name not in maps]:
        raise SurfaceError(
            f"The maps lack {', '.join(lacking)}. Give the maps of the sheet, not those of an"
            " image."
        )
    frame = RayFrame.of(volume, surfaces, params)
    rays_um = (frame.low * frame.step_um, frame.high * frame.step_um)
    low, high = depth_um or rays_um
    # Beyond that the normals have long left the sheet, and cross each other.
    max_depth_um = 20.0 * float(surfaces.attrs["thickness_um"])
    if not low < high or max(abs(low), abs(high)) > max_depth_um:
        raise StudyError(
            f"`depth_um={low:g},{high:g}`: give two heights in um from the centre surface, the"
            f" lower one first, within {max_depth_um:.0f} um."
        )
    voxel_um = frame.voxel_um
    lowest_px = int(np.floor(low / voxel_um))
    highest_px = int(np.ceil(high / voxel_um))
    depths_um = voxel_um * np.arange(lowest_px, highest_px + 1, dtype=np.float64)
    grid = Grid.of(maps)
    lazy_volume = _Straightened(volume, surfaces, maps, depths_um, frame)
    coords = {"z": ("z", depths_um, {"units": "um"})} | grid.coords
    voxel_um_zyx = (voxel_um, *(round(float(p), 9) for p in grid.pixel_um))
    attrs = {"voxel_um": voxel_um_zyx}
    variable = xr.Variable(("z", "y", "x"), variable_data(lazy_volume), attrs)
    return xr.DataArray(variable, coords=coords, name="grey")


def voxels_around(
    volume: xr.DataArray, places_um: Mapping[str, Floats]
) -> tuple[Array, list[Floats]]:
    """Read the part of a volume in which places lie, and give the places in it, in voxels.

    ``places_um``: by axis of the volume, arrays of any one shape. Places outside the volume keep
    their distance from the part that is read.
    """
    indices: list[Floats] = []
    box: dict[str, slice] = {}
    for axis in map(str, volume.dims):
        coords_um = volume[axis].values
        n = coords_um.size
        voxel_um = float(coords_um[1] - coords_um[0])
        position_px = (places_um[axis] - float(coords_um[0])) / voxel_um
        lowest_px = np.floor(position_px.min())
        highest_px = np.ceil(position_px.max())
        start_px = int(np.clip(lowest_px, 0, n - 1))
        stop_px = int(np.clip(highest_px + 1, start_px + 1, n))
        box[axis] = slice(start_px, stop_px)
        indices.append(position_px - start_px)
    return volume.isel(box).values, indices


class _Straightened(LazyArray):
    """The straightened volume, of which parts are worked out."""

    def __init__(
        self,
        volume: xr.DataArray,
        surfaces: xr.Dataset,
        maps: xr.Dataset,
        depths_um: Floats,
        frame: RayFrame,
    ) -> None:
        """Keep what its grey values are worked out from.

        ``maps``: with the places of their pixels in the volume. ``depths_um``: heights on the
        normals at which there are samples.
        """
        self._volume = volume
        self._depths = depths_um
        self._places = {axis: maps[f"volume_{axis}"] for axis in ("z", "y", "x")}
        self._frame = frame.frame
        self._pitch = frame.pitch_um
        self._first = tuple(float(surfaces[axis].values[0]) for axis in ("y", "x"))
        slopes_first = np.moveaxis(frame.slopes(), -1, 0)
        self._slopes = np.ascontiguousarray(slopes_first)
        self._padding = frame.greys.padding
        self.shape = (depths_um.size, *Grid.of(maps).shape)
        self.dtype = np.dtype(np.float32)

    def read(self, where: Where) -> Array:
        """Work out a part, in pieces on threads."""
        depth, rows, cols = where
        row_range = range(self.shape[1])[rows]
        col_range = range(self.shape[2])[cols]
        depths_um = self._depths[depth]
        grey = np.empty((depths_um.size, len(row_range), len(col_range)), np.float32)
        # Samples that a thread works on.
        rows_per_tile = max(1, 1_000_000 // (_WIDE * max(depths_um.size, 1)))
        tiles = tiles_of((len(row_range), len(col_range)), (rows_per_tile, _WIDE))
        map_threads(partial(self._fill, grey, depths_um, row_range, col_range), tiles)
        return grey

    def _fill(
        self,
        grey: Singles,
        depths_um: Floats,
        row_range: range,
        col_range: range,
        tile: Tile,
    ) -> None:
        """Set the grey values of one tile of a part, ``grey`` (depths, rows, cols).

        ``row_range``, ``col_range``: rows and columns of the maps that the part shows.
        """
        from scipy import ndimage

        tile_grey = grey[:, tile.rows, tile.cols]
        tile_grey[:] = np.nan
        rows = row_range[tile.rows]
        cols = col_range[tile.cols]
        window = slice(rows.start, rows.stop, rows.step), slice(cols.start, cols.stop, cols.step)
        place_um = {axis: places[window].values for axis, places in self._places.items()}
        frame = self._frame
        row = (place_um[frame.rows] - self._first[0]) / self._pitch[0]
        col = (place_um[frame.cols] - self._first[1]) / self._pitch[1]
        # Of the centre surface at the place of each pixel.
        slope = np.stack([bilinear(field, row, col) for field in self._slopes], axis=-1)
        normal_r, normal_c, normal_h = np.moveaxis(directions(slope, "normal"), -1, 0)
        # Heights grow towards the top, coordinates along the axis through the sheet.
        normal = {frame.rows: normal_r, frame.cols: normal_c, frame.through: frame.sign * normal_h}
        parts = [*place_um.values(), *normal.values()]
        is_inside = np.isfinite(parts).all(axis=0)
        if not is_inside.any():
            return
        points_um: NamedFields = {}  # (depths, pixels), by axis of the volume
        for axis, um in place_um.items():
            way_um = depths_um[:, None] * normal[axis][is_inside]
            points_um[axis] = um[is_inside] + way_um
        voxels, voxel_indices = voxels_around(self._volume, points_um)
        is_padded = np.isfinite(self._padding)
        if voxels.dtype.kind != "f" or is_padded:
            voxels = voxels.astype(np.float32)
        if is_padded:
            voxels[voxels == np.float32(self._padding)] = np.nan
        tile_grey[:, is_inside] = ndimage.map_coordinates(
            voxels, voxel_indices, output=np.float32, order=1, cval=np.nan
        )
