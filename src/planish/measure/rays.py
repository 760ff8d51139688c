"""The rays of the centre surface.

Where they meet the faces, grey values along them, integrals, lengths, means.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import CannotMeasure, SurfaceError
from planish.core.frame import Frame
from planish.core.grid import pitch
from planish.core.labelled import read_box
from planish.core.status import Status
from planish.core.typing import (
    Bools,
    Codes,
    Entries,
    Floats,
    NamedFields,
    Pair,
    Singles,
    TwoFields,
    pair_of,
)
from planish.measure import _ray_kernels
from planish.measure.greys import Greys
from planish.measure.options import Common

Ends = NDArray[np.int32]  # of a phase on each ray
Direction = Literal["normal", "vertical"]
T = TypeVar("T")
CUTOFF_UM = 400.0  # of a centre surface that does not state its own
FACES = ("top", "bottom", "interface_top", "interface_bottom")
# What the rays of a tile have in common with those of the whole sheet.
_SHARED = ("pitch_um", "voxel_um", "greys", "params", "noise_um", "mean_stretch")


@dataclass(frozen=True, slots=True, kw_only=True)
class Rays:
    """Grey values along the rays of some rows of the centre surface.

    Lengths are in um; ``s`` is the signed distance from the centre surface, the top is positive.
    """

    #: (rows, cols, s) float32; NaN outside the volume, beside missing voxels, on rays without a
    #: status of 0.
    grey: Singles
    s_um: Floats  #: (s,), the same for all rays, in equal steps
    top: Floats  #: place of the face, (rows, cols)
    bottom: Floats  #: as ``top``
    #: place of the interface, (rows, cols); of a side without a coating its face.
    interface_top: Floats
    interface_bottom: Floats  #: as ``interface_top``
    normals: Floats  #: (rows, cols, 3), directions of the rays along rows, columns and height
    #: (rows, cols, 2), length in the centre surface of a step of one um along rows and columns.
    stretch: Floats
    #: (rows, cols, 2), of the centre surface along rows and columns, up towards the top.
    slope: Floats
    #: (rows, cols), um of ray for one along the normal: 1 on normals, 1 / cos(tilt) on vertical
    #: rays.
    oblique: Floats
    status: Codes  #: (rows, cols)
    pitch_um: Pair  #: between rows and between columns, in projection
    voxel_um: float  #: along the axis through the sheet
    greys: Greys
    params: Common
    noise_um: float  #: variance of the grey's integral over one um of ray, from the noise alone
    mirrored: bool  #: whether the array shows the sheet as a mirror does
    mean_stretch: Pair
    _cache: dict[str, object] = field(default_factory=lambda: {}, init=False)

    @property
    def step_um(self) -> float:
        """Distance of two samples."""
        return float(self.s_um[1] - self.s_um[0])

    @property
    def edge_um(self) -> Floats:
        """Length left out of the base at both ends, along the ray (rows, cols)."""
        edge_um = self.params.edge_um
        if edge_um is None:
            edge_um = 2 * self.greys.blur_um
        return self.oblique * edge_um

    @property
    def core(self) -> TwoFields:
        """Lower and upper end of the base without its edges."""
        return self.interface_bottom + self.edge_um, self.interface_top - self.edge_um

    def between(self, lower: Floats, upper: Floats) -> Bools:
        """Mark the samples that lie between two places on each ray; (rows, cols, s)."""
        return (self.s_um >= lower[..., None]) & (self.s_um <= upper[..., None])

    def samples_within(self, lower: Floats, upper: Floats, *, more: int = 0) -> slice:
        """Samples that lie between two places on any of the rays, and ``more`` on both sides.

        At least one sample, even where no ray has both places.
        """
        is_finite = np.isfinite(lower) & np.isfinite(upper)
        if not is_finite.any():
            return slice(0, 1 + more)
        first = int(np.searchsorted(self.s_um, lower[is_finite].min())) - more
        stop = int(np.searchsorted(self.s_um, upper[is_finite].max(), side="right")) + more
        first = max(first, 0)
        return slice(first, max(min(stop, self.s_um.size), first + 1))

    def integral(self, lower: Floats, upper: Floats) -> Floats:
        """Integral of the grey above the air from ``lower`` to ``upper`` (rows, cols).

        Grey times um.
        """
        grey_integral, _, _ = _ray_kernels.pieces(*self.profiles, lower, upper, 0.0, 0.0)
        return grey_integral - self.greys.air * np.maximum(upper - lower, 0.0)

    @property
    def profiles(self) -> tuple[Singles, float, float]:
        """Grey along the rays, place of the first sample and step in um, as kernels take them."""
        return self.grey, float(self.s_um[0]), self.step_um

    def mean(self, lower: Floats, upper: Floats) -> Floats:
        """Mean grey above the air between two places; NaN where they are not a step apart."""
        return self.integral(lower, upper) / self.span(lower, upper)

    def span(self, lower: Floats, upper: Floats) -> Floats:
        """Length between two places in um; NaN where they are not a step apart."""
        length = upper - lower
        return np.where(length >= self.step_um, length, np.nan)

    def length(
        self, lower: Floats, upper: Floats, *, least: float, most: float
    ) -> tuple[Floats, Ends]:
        """Length in um with ``least <= grey <= most`` between two places.

        Also gives how many ends it has there.
        """
        levels = float(least), float(most)
        _, length_um, ends = _ray_kernels.pieces(*self.profiles, lower, upper, *levels)
        return length_um, ends

    def beyond(self, lower: Floats, upper: Floats, level: float) -> tuple[Floats, Ends]:
        """Length in um on which the grey is farther from the air than ``level``.

        Also gives how many ends it has.
        """
        if self.greys.polarity > 0:
            return self.length(lower, upper, least=level, most=np.inf)
        return self.length(lower, upper, least=-np.inf, most=level)

    def crossing_se(self, contrast: float) -> Floats:
        """Standard error in um of one crossing of a blurred step (rows, cols).

        It is ``sqrt(2 pi) w sigma / |contrast|``.

        A step of height C blurred with a Gaussian of standard deviation w has the slope C / (sqrt(2
        pi) w) where it is half way, and noise of standard deviation sigma moves that place by sigma
        over the slope.
        """
        blur_um = max(self.greys.blur_um, 0.5 * self.voxel_um)
        se_um = np.sqrt(2 * np.pi) * blur_um * self.greys.noise / max(abs(contrast), 1e-12)
        return self.oblique * se_um

    def crossings_se(self, ends: Ends, contrast: float) -> Floats:
        """Standard error in um of a length with so many ends on each ray, of one or more."""
        return np.sqrt(np.maximum(ends, 1)) * self.crossing_se(contrast)

    def integral_se(self, length: Floats | float) -> Floats:
        """Standard error of an integral over ``length`` um: sqrt(noise_um * length)."""
        return np.sqrt(self.noise_um * np.maximum(np.asarray(length, np.float64), 0.0))

    def cached(self, key: str, work: Callable[[], T]) -> T:
        """Return the outcome of ``work``, worked out once for these rays.

        For properties that share an inner step.
        """
        if key not in self._cache:
            self._cache[key] = work()
        return self._cache[key]  # type: ignore[return-value]

    def rows(self, part: slice) -> Rays:
        """Return some of the rows."""
        arrays = ("grey", *FACES, "normals", "stretch", "slope", "oblique", "status")
        cut: Entries = {name: getattr(self, name)[part] for name in arrays}
        return replace(self, **cut)


def meet(surfaces: xr.Dataset, rays: Direction) -> tuple[NamedFields, NamedFields]:
    """Find where the rays meet the faces.

    SurfaceError where a surface is missing or the top lies below the bottom.

    Gives the heights of ``centre`` and the faces (rows, cols), um, up towards the top, and the
    signed distances of the faces along the rays. An interface of a side without a coating is its
    face, the same array. NaN where there is no surface, or where a ray does not meet it.
    """
    names = (*FACES, "centre")
    if lacking := [name for name in (*names, "status") if name not in surfaces]:
        raise SurfaceError(
            f"The surfaces lack {', '.join(lacking)}. Make them with 'planish surface'."
        )
    # +1 where the top side lies at the high end of the axis through the sheet, else -1.
    up_sign = Frame.of(surfaces).sign
    heights = {name: up_sign * surfaces[name].values.astype(float) for name in names}
    inverted_count = np.count_nonzero(heights["top"] < heights["bottom"])
    if inverted_count:
        raise SurfaceError(
            f"The top lies below the bottom at {inverted_count} points. Check `top`."
        )
    centre_um = heights["centre"]
    pitch_um = pitch(surfaces)
    normals = directions(slopes_of(centre_um, pitch_um), rays)
    components = np.ascontiguousarray(np.moveaxis(normals, -1, 0))
    faces: NamedFields = {}
    for name in FACES:
        height_um = heights[name]
        if name.startswith("interface") and not np.isfinite(height_um).any():
            faces[name] = faces[name.removeprefix("interface_")]
        elif rays == "vertical":
            faces[name] = height_um - centre_um
        else:
            faces[name] = _ray_kernels.along_normals(height_um, centre_um, *components, *pitch_um)
    return heights, faces


@dataclass(frozen=True, slots=True, kw_only=True)
class RayFrame:
    """Where the rays of a whole sheet lie and meet its faces.

    What a tile needs to be cut out of the volume.
    """

    frame: Frame
    heights: NamedFields  # of the centre surface and the faces, as :func:`meet` gives them
    faces: NamedFields  # places of the faces along the rays, likewise
    status: Codes  # (rows, cols)
    pitch_um: Pair  # between rows and between columns of the surfaces
    voxel_um: float  # along the axis through the sheet
    step_um: float  # between samples of a ray: sample k lies at k * step_um
    low: int  # first sample, below the centre surface and so negative
    high: int  # last sample
    greys: Greys
    params: Common
    # Of a step along rows and along columns: its mean length in the centre surface over its own.
    mean_stretch: Pair
    column_px: int  # voxels along the edge of a column of the surfaces
    cutoff_um: float  # of the centre surface
    # Variance of the grey's integral over one um of ray, from the noise; NaN: not known yet.
    noise_um: float = float("nan")

    @classmethod
    def of(cls, volume: xr.DataArray, surfaces: xr.Dataset, params: Common) -> RayFrame:
        """Find where every ray meets the faces.

        Of the volume only size and coordinates are looked at. A ray that does not meet both faces
        and interfaces gets a status of its own; SurfaceError if volume and surfaces do not belong
        together, CannotMeasure if no ray meets both faces.
        """
        heights, faces = meet(surfaces, params.rays)
        frame = Frame.of(surfaces)
        volume_rows = volume.sizes[frame.rows]
        volume_cols = volume.sizes[frame.cols]
        rows, cols = surfaces["centre"].shape
        column_px = max(volume_rows // max(rows, 1), 1)
        if (volume_rows // column_px, volume_cols // column_px) != (rows, cols):
            raise SurfaceError(
                f"The volume has {volume_rows} x {volume_cols} columns and the surfaces have {rows}"
                f" x {cols}: they do not belong together. Find the surfaces in this volume."
            )
        through_um = volume.coords[frame.through].values
        voxel_um = abs(float(through_um[1] - through_um[0]))
        step_um = 0.5 * voxel_um  # a longer step loses what the voxels show
        greys = Greys.of(surfaces)
        status = surfaces["status"].values.astype(np.uint8)
        top = faces["top"]
        bottom = faces["bottom"]
        is_whole = (status == 0) & np.isfinite(top - bottom)
        if is_whole.any():
            # A face so many thicknesses from the centre surface is not this ray's.
            reach_um = 1.5 * float(np.median((top - bottom)[is_whole]))
            is_whole &= (np.abs(top) < reach_um) & (np.abs(bottom) < reach_um)
            is_whole &= np.isfinite(faces["interface_top"] - faces["interface_bottom"])
        if not is_whole.any():
            raise CannotMeasure(
                "No ray of the centre surface meets both faces. Look at the surfaces in the report."
            )
        status[(status == 0) & ~is_whole] = Status.NORMAL_LEAVES_SHEET
        # The rays go on beyond the faces until the blur has ended and air begins.
        margin_um = 3 * greys.blur_um + 6 * voxel_um
        lowest_um = float(bottom[is_whole].min()) - margin_um
        highest_um = float(top[is_whole].max()) + margin_um
        pitch_um = pitch(surfaces)
        slope = slopes_of(heights["centre"], pitch_um)
        has_slope = np.isfinite(slope).all(axis=-1)
        stretch = np.sqrt(1 + slope[has_slope] ** 2)
        return cls(
            frame=frame,
            heights=heights,
            faces=faces,
            status=status,
            pitch_um=pitch_um,
            voxel_um=voxel_um,
            step_um=step_um,
            low=int(np.floor(lowest_um / step_um)),
            high=int(np.ceil(highest_um / step_um)),
            greys=greys,
            params=params,
            column_px=column_px,
            cutoff_um=float(surfaces.attrs.get("cutoff_um", CUTOFF_UM)),
            mean_stretch=pair_of(stretch.mean(axis=0)),
        )

    @property
    def samples(self) -> int:
        """Samples of a ray."""
        return self.high - self.low + 1

    def slopes(self, rows: slice = slice(None)) -> Floats:
        """Slope of the centre surface along rows and columns (rows, cols, 2)."""
        return slopes_of(self.heights["centre"], self.pitch_um, rows)

    def oblique(self, slope: Floats) -> Floats:
        """Length of ray for one um along the normal (rows, cols)."""
        if self.params.rays == "normal":
            return np.ones(slope.shape[:-1])
        return secant(slope)

    def tile(self, volume: xr.DataArray, rows: slice) -> Rays:
        """Straighten some rows; only the voxels that they need are read.

        ``rows`` may reach beyond the sheet, which has none there. Rays that leave the volume or
        meet a voxel without a value, and those without enough contrast to be sheet, get a status.
        """
        start, stop, _ = rows.indices(self.status.shape[0])
        rows = slice(start, stop)
        slope = self.slopes(rows)
        normals = directions(slope, self.params.rays)
        status = self.status[rows].copy()
        is_whole = status == 0
        faces: NamedFields = {}
        for name, place_um in self.faces.items():
            faces[name] = np.where(is_whole, place_um[rows], np.nan)
        shared = {name: getattr(self, name) for name in _SHARED}
        tile = Rays(
            grey=self._grey(volume, rows, normals, is_whole),
            s_um=self.step_um * np.arange(self.low, self.high + 1.0),
            **faces,
            normals=normals,
            stretch=np.sqrt(1 + slope**2),
            slope=slope,
            oblique=self.oblique(slope),
            status=status,
            mirrored=self.frame.mirrored,
            **shared,
        )
        grey_integral = tile.integral(tile.bottom, tile.top)
        status[(status == 0) & ~np.isfinite(grey_integral)] = Status.RAY_LEAVES_VOLUME
        # The mean grey of the sheet on a ray is a quarter of the base's or more.
        contrast = self.greys.base - self.greys.air
        mean_grey = grey_integral / np.maximum(tile.top - tile.bottom, 1e-9)
        status[(status == 0) & (mean_grey / contrast < 0.25)] = Status.LOW_CONTRAST
        return tile

    def _grey(
        self, volume: xr.DataArray, rows: slice, normals: Floats, is_wanted: Bools
    ) -> Singles:
        """Grey values (rows, cols, samples) along the wanted rays of some rows.

        From the box of voxels around them; NaN on other rays and outside the volume. ``normals``
        (rows, cols, 3): directions of the rays along rows, columns and height. ``is_wanted`` (rows,
        cols).
        """
        grey = np.full((*is_wanted.shape, self.samples), np.nan, np.float32)
        if not is_wanted.any():
            return grey
        frame = self.frame
        column_px = self.column_px
        through_um = volume.coords[frame.through].values
        voxel_um = float(through_um[1] - through_um[0])
        # Heights grow towards the top, indices along the axis through the sheet.
        centre_um = frame.sign * self.heights["centre"][rows]
        depth_px = (centre_um - float(through_um[0])) / voxel_um
        # Voxels along each axis of the volume for one um of a ray.
        steps = [normals[..., axis] * column_px / self.pitch_um[axis] for axis in (0, 1)]
        steps.append(frame.sign * normals[..., 2] / voxel_um)
        # A ray starts in the middle of its column.
        middle_px = 0.5 * (column_px - 1)
        row_px = column_px * np.arange(rows.start, rows.stop)[:, None] + middle_px
        col_px = column_px * np.arange(is_wanted.shape[1]) + middle_px
        axes = (frame.rows, frame.cols, frame.through)
        # The box around both ends of all rays, in voxels.
        box: dict[str, slice] = {}
        for axis, start_px, step in zip(axes, (row_px, col_px, depth_px), steps, strict=True):
            ends = [start_px + k * self.step_um * step for k in (self.low, self.high)]
            ends_px = np.array(ends)[:, is_wanted]
            n = volume.sizes[axis]
            first_px = int(np.floor(ends_px.min()))
            stop_px = int(np.ceil(ends_px.max())) + 2
            start = min(max(first_px, 0), n - 1)
            box[axis] = slice(start, max(min(stop_px, n), 1))
        voxels = np.ascontiguousarray(read_box(volume, box))
        corner = np.array([part.start for part in box.values()])
        rays = (rows.start, column_px, depth_px, *steps, is_wanted)
        samples = (self.low, self.step_um)
        _ray_kernels.resample_rays(voxels, corner, *rays, *samples, self.greys.padding, grey)
        return grey


def slopes_of(heights: Floats, pitch: Pair, rows: slice = slice(None)) -> Floats:
    """Slope of a surface along rows and columns (rows, cols, 2).

    Of some rows the same as of the whole surface.
    """
    start, stop, _ = rows.indices(heights.shape[0])
    first_row = max(start - 1, 0)
    part = heights[first_row : stop + 1]
    slopes = [np.gradient(part, p, axis=axis) for axis, p in enumerate(pitch)]
    return np.stack(slopes, axis=-1)[start - first_row : stop - first_row]


def secant(slope: Floats) -> Floats:
    """Length along the vertical of one um along the normal, by the slope (rows, cols, 2)."""
    return np.sqrt(1 + slope[..., 0] ** 2 + slope[..., 1] ** 2)


def directions(slope: Floats, rays: Direction) -> Floats:
    """Unit vectors of the rays along rows, columns and height (rows, cols, 3), pointing up.

    NaN without a slope.

    Parameters
    ----------
    slope : (rows, cols, 2)
        Of the centre surface, as :func:`slopes_of` gives it.
    rays : {"normal", "vertical"}
    """
    if rays == "vertical":
        has_slope = np.isfinite(slope).all(axis=-1, keepdims=True)
        return np.where(has_slope, [0.0, 0.0, 1.0], np.nan)
    length = secant(slope)[..., None]
    return np.concatenate([-slope / length, 1 / length], axis=-1)
