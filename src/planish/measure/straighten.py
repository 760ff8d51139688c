"""The volume straightened along the normals, on the pixels of the flat maps: every sheet lies flat in it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import StudyError, SurfaceError
from planish.core.frame import Frame
from planish.core.grid import Grid, bilinear, pitch
from planish.core.lazy import LazyArray, Where, held
from planish.core.threads import map_threads
from planish.core.tiles import Tile, tiles_of
from planish.core.typing import Floats, Pair
from planish.measure.params import MeasureParams
from planish.measure.rays import RayFrame, directions, slopes_of

_WIDE = 256  # pixels along the width of a part: its box of voxels has to be small where the sheet is steep


def straightened(
    volume: xr.DataArray, surfaces: xr.Dataset, maps: xr.Dataset, *, params: MeasureParams | None = None,
    depth_um: Pair | None = None,
) -> xr.DataArray:  # fmt: skip
    """Straighten a volume along the normals of the centre surface.

    Parameters
    ----------
    volume : DataArray, dims (z, y, x), coordinates in um
        May be lazily indexed; only the voxels under a part are read.
    surfaces : Dataset, dims (y, x), heights in um
        As :func:`planish.surface.find_surfaces` returns them for this volume.
    maps : Dataset, dims (v, u)
        Flat maps of these surfaces, with ``volume_x``, ``volume_y`` and ``volume_z``.
    params : MeasureParams, optional
    depth_um : (float, float), optional
        From where to where along the normals, from the centre surface, up to the top; from below the lowest to above
        the highest face where not given.

    Returns
    -------
    DataArray, dims (z, y, x), float32, in um
        z is the height on the normal, y and x are v and u of the maps; worked out where it is asked for. Grey values
        are interpolated once, between the eight voxels around a place. NaN is missing: beside the sheet and the volume.

    Raises
    ------
    StudyError
        The depths are out of order, or farther from the sheet than 20 of its thicknesses.
    SurfaceError
        Surfaces and volume do not belong together, or the maps have no places in the volume.
    """
    if lacking := [name for name in ("volume_x", "volume_y", "volume_z") if name not in maps]:
        raise SurfaceError(f"The maps lack {', '.join(lacking)}. Give the maps of the sheet, not those of an image.")
    frame = RayFrame.of(volume, surfaces, params or MeasureParams())
    low, high = depth_um or (frame.low * frame.step_um, frame.high * frame.step_um)
    # Beyond that the normals have long left the sheet, and cross each other.
    most = 20.0 * float(surfaces.attrs["thickness_um"])
    if not low < high or max(abs(low), abs(high)) > most:
        raise StudyError(
            f"--depth-um {low:g},{high:g}: give two heights in um from the centre surface, the lower one first, within "
            f"{most:.0f} um."
        )
    voxel = frame.voxel_um
    depths: Floats = np.arange(int(np.floor(low / voxel)), int(np.ceil(high / voxel)) + 1).astype(np.float64) * voxel
    grid = Grid.of(maps)
    straight = _Straightened(volume, surfaces, maps, depths, frame)
    coords = {k: (k, um, {"units": "um"}) for k, um in (("z", depths), ("y", grid.y_um), ("x", grid.x_um))}
    volume_along = xr.DataArray(xr.Variable(("z", "y", "x"), held(straight)), coords=coords, name="grey")
    return volume_along.assign_attrs(voxel_um=(voxel, *(round(float(p), 9) for p in grid.pixel_um)))


def voxels_around(volume: xr.DataArray, places_um: Mapping[str, Floats]) -> tuple[NDArray[Any], list[Floats]]:
    """Read the part of a volume in which places lie, and give the places in it, in voxels."""
    places: list[Floats] = []
    box: dict[str, slice] = {}
    for axis in map(str, volume.dims):
        coords = volume[axis].values
        index = (places_um[axis] - float(coords[0])) / float(coords[1] - coords[0])
        start = int(np.clip(np.floor(index.min()), 0, coords.size - 1))
        box[axis] = slice(start, int(np.clip(np.ceil(index.max()) + 1, start + 1, coords.size)))
        places.append(index - start)
    return volume.isel(box).values, places


class _Straightened(LazyArray):
    """The straightened volume, of which parts are worked out."""

    def __init__(
        self, volume: xr.DataArray, surfaces: xr.Dataset, maps: xr.Dataset, depths: Floats, frame: RayFrame
    ) -> None:
        self._volume, self._depths = volume, depths
        self._places = {axis: maps[f"volume_{axis}"] for axis in ("z", "y", "x")}
        self._frame, self._pitch = Frame.of(surfaces), pitch(surfaces)
        self._first = float(surfaces["y"].values[0]), float(surfaces["x"].values[0])
        slope = slopes_of(frame.heights["centre"], self._pitch)
        self._slopes = [np.ascontiguousarray(part) for part in np.moveaxis(slope, -1, 0)]
        self._padding = frame.greys.padding
        self.shape = (depths.size, *Grid.of(maps).shape)
        self.dtype = np.dtype(np.float32)

    def read(self, where: Where) -> NDArray[Any]:
        """Work out a part, in pieces on threads."""
        depth, rows, cols = where
        down, across = (range(n)[s] for n, s in zip(self.shape[1:], (rows, cols), strict=True))
        depths = self._depths[depth]
        out = np.empty((depths.size, len(down), len(across)), np.float32)
        high = max(1, 1_000_000 // (_WIDE * max(depths.size, 1)))  # samples that a thread works on
        tiles = tiles_of((len(down), len(across)), (high, _WIDE))
        map_threads(partial(self._fill, out, depths, (rows, cols)), tiles)
        return out

    def _fill(self, out: NDArray[np.float32], depths: Floats, where: tuple[slice, slice], tile: Tile) -> None:
        from scipy import ndimage

        part = out[:, tile.rows, tile.cols]
        part[:] = np.nan
        rows, cols = (
            slice(w.start + w.step * a, w.start + w.step * b, w.step)
            for w, a, b in zip(where, (tile.r0, tile.c0), (tile.r1, tile.c1), strict=True)
        )
        place = {axis: np.asarray(self._places[axis][rows, cols].values) for axis in ("z", "y", "x")}
        f = self._frame
        row, col = (
            (place[axis] - first) / p for axis, first, p in zip((f.rows, f.cols), self._first, self._pitch, strict=True)
        )
        slope = np.stack([bilinear(field, row, col) for field in self._slopes], axis=-1)
        along_r, along_c, up = np.moveaxis(directions(slope, "normal"), -1, 0)
        normal = {f.rows: along_r, f.cols: along_c, f.through: f.sign * up}
        is_inside = np.all([np.isfinite(place[axis]) & np.isfinite(normal[axis]) for axis in place], axis=0)
        if not is_inside.any():
            return
        along = {axis: place[axis][is_inside] + depths[:, None] * normal[axis][is_inside] for axis in place}
        block, places = voxels_around(self._volume, along)
        if block.dtype.kind != "f" or np.isfinite(self._padding):
            block = block.astype(np.float32)
        if np.isfinite(self._padding):
            block[block == np.float32(self._padding)] = np.nan
        part[:, is_inside] = ndimage.map_coordinates(
            block, places, output=np.float32, order=1, mode="constant", cval=np.nan, prefilter=False
        )
