"""Where the rays of a sheet lie and meet its faces, and the volume straightened along them, tile by tile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import CannotMeasure, SizeError, SurfaceError
from planish.core.frame import Frame
from planish.core.grid import pitch
from planish.core.status import Status
from planish.measure import _ray_kernels
from planish.measure._kernels import along_normals
from planish.measure.greys import Greys
from planish.measure.params import MeasureParams
from planish.measure.rays import FACES, Array, Direction, Grey, Rays, oblique_factor

_FARTHEST = 1.5  # sheet thicknesses from the centre surface: a face beyond is not this ray's
_TILE = 256  # rows whose geometry is worked out together


@dataclass(frozen=True, slots=True, kw_only=True)
class RayFrame:
    """Where the rays of a whole sheet lie and meet its faces; what a tile needs to be cut out of the volume.

    Attributes
    ----------
    heights : dict
        ``centre`` and the faces (rows, cols), um, up towards the top.
    faces : dict
        Signed distances along the rays (rows, cols), um.
    status : (rows, cols) uint8
    low, high : int
        First and last sample; sample k lies at k * step_um.
    wide : int
        Voxels along the edge of a column of the surfaces.
    """

    frame: Frame
    heights: dict[str, Array]
    faces: dict[str, Array]
    status: NDArray[np.uint8]
    pitch_um: tuple[float, float]
    voxel_um: float
    step_um: float
    low: int
    high: int
    greys: Greys
    params: MeasureParams
    mean_stretch: tuple[float, float]
    wide: int = 1
    noise_um: float = float("nan")

    @classmethod
    def of(
        cls, volume: xr.DataArray, surfaces: xr.Dataset, params: MeasureParams, *, step_um: float | None = None
    ) -> RayFrame:
        """Find where every ray meets the faces.

        Parameters
        ----------
        volume : DataArray, dims (z, y, x)
            Only its size and coordinates are looked at.
        surfaces : Dataset, dims (y, x), heights in um
        params : MeasureParams
            ``rays``: along the normals of the centre surface, or along the axis through the sheet for comparison: a
            vertical thickness is too large by 1 / cos of the tilt.
        step_um : float
            At most half a voxel, which is the default.

        Raises
        ------
        SurfaceError, SizeError, CannotMeasure
        """
        lacking = [name for name in (*FACES, "centre", "status") if name not in surfaces]
        if lacking:
            raise SurfaceError(f"The surfaces lack {', '.join(lacking)}. Make them with 'planish surface'.")
        voxel_um, wide = _column(volume, surfaces)
        if step_um is not None and not 0 < step_um <= 0.5 * voxel_um * (1 + 1e-9):
            raise SizeError(
                f"A ray is sampled every {step_um:g} um; the voxels are {voxel_um:g} um high, and more than half of "
                f"that loses what they show. Give a step of at most {0.5 * voxel_um:g} um."
            )
        step = step_um or 0.5 * voxel_um
        greys = Greys.of(surfaces)
        margin = 3 * greys.blur_um + 6 * voxel_um  # beyond the faces
        frame = Frame.of(surfaces)
        heights = {name: frame.sign * surfaces[name].values.astype(np.float64) for name in (*FACES, "centre")}
        pitch_um = pitch(surfaces)
        status = surfaces["status"].values.astype(np.uint8)
        faces, stretch = _meet(heights, pitch_um, params.rays)
        known = np.isfinite(faces["top"]) & np.isfinite(faces["bottom"]) & (status == 0)
        thick = float(np.median((faces["top"] - faces["bottom"])[known])) if known.any() else float("nan")
        whole = known & (np.abs(faces["top"]) < _FARTHEST * thick) & (np.abs(faces["bottom"]) < _FARTHEST * thick)
        for name in ("interface_top", "interface_bottom"):
            if np.isfinite(heights[name]).any():
                whole &= np.isfinite(faces[name])
            else:
                faces[name] = faces[name.removeprefix("interface_")]
        if not whole.any():
            raise CannotMeasure("No ray of the centre surface meets both faces. Look at the surfaces in the report.")
        status[(status == 0) & ~whole] = Status.NORMAL_LEAVES_SHEET
        low = int(np.floor((float(faces["bottom"][whole].min()) - margin) / step))
        high = int(np.ceil((float(faces["top"][whole].max()) + margin) / step))
        return cls(
            frame=frame, heights=heights, faces=faces, status=status, pitch_um=pitch_um, voxel_um=voxel_um,
            step_um=step, low=low, high=high, greys=greys, params=params, mean_stretch=stretch,
            wide=wide,
        )  # fmt: skip

    @property
    def samples(self) -> int:
        """Samples of a ray."""
        return self.high - self.low + 1

    def slopes(self, rows: slice) -> Array:
        """Slope of the centre surface along rows and columns (rows, cols, 2)."""
        return np.stack(_slopes(self.heights["centre"], self.pitch_um, rows), axis=-1)

    def tile(self, volume: xr.DataArray, rows: slice) -> Rays:
        """Straighten some rows; only the voxels that they need are read."""
        start, stop, _ = rows.indices(self.status.shape[0])
        rows = slice(start, stop)
        slope = self.slopes(rows)
        stretch = np.sqrt(1 + slope**2)
        normals = _directions(slope, self.params.rays)
        status = self.status[rows].copy()
        grey = self._grey(volume, rows, normals, status == 0)
        faces = {name: np.where(status == 0, values[rows], np.nan) for name, values in self.faces.items()}
        samples: Array = np.arange(self.low, self.high + 1).astype(np.float64) * self.step_um
        tile = Rays(
            grey=grey, s_um=samples, top=faces["top"], bottom=faces["bottom"],
            interface_top=faces["interface_top"], interface_bottom=faces["interface_bottom"], normals=normals,
            stretch=stretch, slope=slope, oblique=oblique_factor(slope, self.params.rays), status=status,
            pitch_um=self.pitch_um, voxel_um=self.voxel_um, greys=self.greys, params=self.params,
            noise_um=self.noise_um, mirrored=self.frame.mirrored, mean_stretch=self.mean_stretch,
        )  # fmt: skip
        whole = tile.integral(tile.bottom, tile.top)
        status[(status == 0) & ~np.isfinite(whole)] = Status.RAY_LEAVES_VOLUME
        contrast = self.greys.base - self.greys.air
        with np.errstate(invalid="ignore"):
            faint = whole / np.maximum(tile.top - tile.bottom, 1e-9) / contrast < 0.25
        status[(status == 0) & faint] = Status.LOW_CONTRAST
        return tile

    def _grey(self, volume: xr.DataArray, rows: slice, normals: Array, wanted: NDArray[np.bool_]) -> Grey:
        f = self.frame
        through = volume.coords[f.through].values
        size = float(through[1] - through[0])
        depth = (f.sign * self.heights["centre"][rows] - float(through[0])) / size
        k = self.wide
        along_r, along_c = (normals[..., axis] * k / self.pitch_um[axis] for axis in (0, 1))
        steps = (along_r, along_c, f.sign * normals[..., 2] / size)
        out = np.full((*wanted.shape, self.samples), np.nan, dtype=np.float32)
        if not wanted.any():
            return out
        # The box around both ends of all rays, in voxels.
        middle = 0.5 * (k - 1)
        down = k * np.arange(rows.start, rows.stop)[:, None] + middle
        starts = np.broadcast_to(down, wanted.shape), k * np.arange(wanted.shape[1]) + middle
        ends = [
            np.stack([(at + end * self.step_um * step)[wanted] for end in (self.low, self.high)])
            for at, step in zip((*starts, depth), steps, strict=True)
        ]
        sizes = volume.sizes[f.rows], volume.sizes[f.cols], volume.sizes[f.through]
        box = [
            slice(min(max(int(np.floor(e.min())), 0), n - 1), max(min(int(np.ceil(e.max())) + 2, n), 1))
            for e, n in zip(ends, sizes, strict=True)
        ]
        part = volume.isel(dict(zip((f.rows, f.cols, f.through), box, strict=True)))
        # Turned only after it was read: what is read lazily may not know how to turn.
        turned = part.values.transpose([part.get_axis_num(axis) for axis in (f.rows, f.cols, f.through)])
        block = np.ascontiguousarray(turned)
        corner = np.array([b.start for b in box])
        padded = bool(np.isfinite(self.greys.padding))
        _ray_kernels.resample_rays(
            block, corner, rows.start, k, depth, *steps, wanted, self.low, self.step_um, self.greys.padding, padded, out
        )
        return out


def straighten(
    volume: xr.DataArray, surfaces: xr.Dataset, rows: slice, *, step_um: float | None = None,
    params: MeasureParams | None = None,
) -> Rays:  # fmt: skip
    """Resample the volume along the rays of some rows of the centre surface.

    Parameters
    ----------
    volume : DataArray, dims (z, y, x), coordinates in um
        May be lazily indexed: only what the rows need is read.
    surfaces : Dataset, dims (y, x), heights in um
        As :func:`planish.surface.find_surfaces` returns them.
    rows : slice
        Rows of the surfaces.
    step_um, params
        As in :meth:`RayFrame.of`.

    Returns
    -------
    Rays
        The same values whatever other rows are asked for.

    Raises
    ------
    SurfaceError, SizeError, CannotMeasure
    """
    return RayFrame.of(volume, surfaces, params or MeasureParams(), step_um=step_um).tile(volume, rows)


def _column(volume: xr.DataArray, surfaces: xr.Dataset) -> tuple[float, int]:
    """Voxel size along the axis through the sheet, and voxels along the edge of a column of the surfaces."""
    frame = Frame.of(surfaces)
    have = volume.sizes[frame.rows], volume.sizes[frame.cols]
    want = surfaces.sizes["y"], surfaces.sizes["x"]
    wide = max(have[0] // max(want[0], 1), 1)
    if (have[0] // wide, have[1] // wide) != want:
        raise SurfaceError(
            f"The volume has {have[0]} x {have[1]} columns and the surfaces have {want[0]} x {want[1]}: they do not "
            "belong together. Find the surfaces in this volume."
        )
    values = volume.coords[frame.through].values
    return abs(float(values[1] - values[0])), wide


def _slopes(centre: Array, pitch: tuple[float, float], rows: slice) -> tuple[Array, Array]:
    """Central differences of some rows, the same as those of the whole field."""
    lo, hi = max(rows.start - 1, 0), min(rows.stop + 1, centre.shape[0])
    while hi - lo < 2:
        lo, hi = max(lo - 1, 0), min(hi + 1, centre.shape[0])
    along = [np.gradient(centre[lo:hi], p, axis=i) for i, p in enumerate(pitch)]
    return along[0][rows.start - lo : rows.stop - lo], along[1][rows.start - lo : rows.stop - lo]


def _directions(slope: Array, rays: Direction) -> Array:
    if rays == "vertical":
        upright = np.where(np.isfinite(slope[..., :1]) & np.isfinite(slope[..., 1:]), [0.0, 0.0, 1.0], np.nan)
        return upright
    length = np.sqrt(1 + slope[..., 0] ** 2 + slope[..., 1] ** 2)
    return np.stack([-slope[..., 0] / length, -slope[..., 1] / length, 1 / length], axis=-1)


def _meet(
    heights: dict[str, Array], pitch: tuple[float, float], rays: Direction
) -> tuple[dict[str, Array], tuple[float, float]]:
    """Distances to the faces along all rays, and the mean stretch along rows and columns."""
    centre = heights["centre"]
    if rays == "vertical":
        faces = {name: heights[name] - centre for name in FACES}
    else:
        faces = {name: np.full(centre.shape, np.nan) for name in FACES}
    sums: list[tuple[float, float, int]] = []
    for start in range(0, centre.shape[0], _TILE):
        rows = slice(start, min(start + _TILE, centre.shape[0]))
        slope = _slopes(centre, pitch, rows)
        known = np.isfinite(slope[0]) & np.isfinite(slope[1])
        part = [np.sqrt(1 + s[known] ** 2) for s in slope]
        sums.append((float(part[0].sum()), float(part[1].sum()), int(known.sum())))
        if rays == "normal":
            directions = _directions(np.stack(slope, -1), rays)
            nr, nc, nh = (np.ascontiguousarray(directions[..., k]) for k in range(3))
            for name in FACES:
                if np.isfinite(heights[name]).any():
                    faces[name][rows] = along_normals(heights[name], centre, nr, nc, nh, *pitch, start)
    count = max(sum(n for _, _, n in sums), 1)
    return faces, (sum(a for a, _, _ in sums) / count, sum(b for _, b, _ in sums) / count)
