"""Faces drawn to points that a person set, where the search followed something else.

Kriging between the points and the face around them says where a face is expected. Columns that lie
elsewhere are searched again for an edge whose levels are free; the face is the mean of both, each
weighted by its variance.
"""

import hashlib
from itertools import pairwise
from operator import attrgetter

import numpy as np
import xarray as xr
from scipy import ndimage

from planish.core.errors import InputError
from planish.core.facts import SIDES, Side
from planish.core.frame import Frame
from planish.core.grid import blur_reach_um, pitch
from planish.core.status import Status
from planish.core.tiles import Engine, Tile
from planish.core.typing import Bools, Codes, Floats, Ints, NamedFields, Pair, TwoFields, Window
from planish.surface import _draw_kernels
from planish.surface.columns import FRINGE_PX, Columns, GreyScale, Guide, oriented, rises_px
from planish.surface.params import Corrections, Stretch
from planish.surface.sample import subsample

IMAGE, INTERPOLATED = 1, 2
"""A column's face was found again in the image, or interpolated."""

RING_UM = 25.0
"""Least width of the face around a stretch that it is interpolated from."""
_CLICK = 0.5  # voxels: standard error of a point, and of a face that was found
_WRONG = 3.0  # standard errors beyond which a face is
_MISFIT = 0.03  # of the base's contrast: no column is a staircase to within less
# Of the step of the base, or of the interface: smaller ones are texture.
_LEAST, _LEAST_INNER = 0.15, 0.3
# Voxels by which an edge may be off where something misled the search: it has levels of its own.
_EDGE = 1.0


def columns_of(surfaces: xr.Dataset, volume: xr.DataArray) -> Columns:
    """The columns of a volume in which surfaces were found."""
    frame = Frame.of(surfaces)
    voxel_um = dict(zip("zyx", map(float, surfaces.attrs["voxel_um"]), strict=True))
    voxel_area_um2 = voxel_um[frame.rows] * voxel_um[frame.cols]
    step = max(1, round(float(np.sqrt(np.prod(pitch(surfaces)) / voxel_area_um2))))
    return Columns(volume=volume, frame=frame, step=step, padding=surfaces.attrs.get("padding"))


class Patch:
    """Columns around the points of a stretch.

    ``window``: their rows and columns; ``grid`` (rows, cols, 2): their places, ``away`` (rows,
    cols): how far each is from the line through the points, um.
    """

    def __init__(self, columns: Columns, pitch: Pair, points: Floats, reach_um: float) -> None:
        """Choose the columns.

        ``pitch``: of rows and columns; ``points`` (n, 3): row, column and height of the points;
        ``reach_um``: how far from them the face may be drawn. All in um.
        """
        lateral_um = columns.lateral_um()
        self.pitch = pitch
        self.points = points
        self.voxel_um = columns.pitch[2]
        self.reach_um = reach_um
        self.far_um = reach_um + max(RING_UM, 0.5 * reach_um)
        rows = self._slice_near(lateral_um[0], points[:, 0])
        cols = self._slice_near(lateral_um[1], points[:, 1])
        self.window: Window = rows, cols
        grid = np.meshgrid(lateral_um[0][rows], lateral_um[1][cols], indexing="ij")
        self.grid = np.stack(grid, axis=-1)
        self.away = distance_to_line(self.grid, points[:, :2])

    def _slice_near(self, um: Floats, places_um: Floats) -> slice:
        start = int(np.searchsorted(um, places_um.min() - self.far_um))
        stop = int(np.searchsorted(um, places_um.max() + self.far_um, "right"))
        return slice(start, max(stop, start + 1))

    def expect(
        self,
        field: Floats,
        is_trusted: Bools,
        is_wanted: Bools,
        *,
        uses_points: bool = False,
    ) -> TwoFields | None:
        """Krige a field and its error where wanted, from trusted places and from the points.

        ``field``, ``is_trusted``, ``is_wanted`` (rows, cols) of the window, the field in um. Both
        results (n,) in um, in the order of the wanted columns; None where there is nothing to krige
        from or to.
        """
        rows, cols = subsample(np.argwhere(is_trusted), 160).T
        points = self.points if uses_points else self.points[:0]
        heights = np.concatenate([points[:, 2], field[rows, cols]])
        if not (heights.size and is_wanted.any()):
            return None
        lag_um = max(0.25 * self.reach_um, 2 * max(self.pitch))
        trusted = np.where(is_trusted, field, np.nan)
        least_um2 = (0.25 * self.voxel_um) ** 2
        slope = variogram_slope(trusted, self.pitch, lag_um, least=least_um2)
        places = np.concatenate([points[:, :2], self.grid[rows, cols]])
        variances = np.full(heights.size, (_CLICK * self.voxel_um) ** 2)
        return krige(self.grid[is_wanted], places, heights, variances, slope)


class Drawing:
    """Heights as corrections leave them, (rows, cols).

    ``heights``: of faces and interfaces, um; ``how`` (0, IMAGE or INTERPOLATED) and ``error_um``
    (NaN where a face is as found) by face; ``tiles``: those that were searched again.
    """

    def __init__(
        self, surfaces: xr.Dataset, volume: xr.DataArray, corrections: Corrections, engine: Engine
    ) -> None:
        """Draw the faces to all stretches, one after the other.

        ``surfaces``: without corrections, of which the attributes give grey levels, noise and blur;
        ``volume``: where they were found, of which only some tiles are read.
        """
        self.columns = columns_of(surfaces, volume)
        self.engine = engine
        self.attrs = surfaces.attrs
        self.pitch = pitch(surfaces)
        self.contrast = abs(self.attrs["grey_base"] - self.attrs["grey_air"])
        blend_sd = float(self.attrs.get("averaged_columns", 0.0))
        levels = {"air_grey": self.attrs["grey_air"], "polarity": self.attrs["polarity"]}
        self.scale = GreyScale(**levels, blend_sd=blend_sd)
        self.voxel_um = self.columns.pitch[2]
        self.heights: NamedFields = {}
        self.how: dict[Side, Codes] = {}
        self.error_um: dict[Side, Floats] = {}
        self.status: Codes = surfaces["status"].values
        for face in SIDES:
            for name in (face, f"interface_{face}"):
                self.heights[name] = surfaces[name].values.astype(float)
            self.how[face] = np.zeros(self.status.shape, np.uint8)
            self.error_um[face] = np.full(self.status.shape, np.nan)
        self.tiles: set[Tile] = set()
        self.guide = self._guide(surfaces["centre"].values.astype(float))
        for stretch in corrections.stretches:
            for face in SIDES:
                if stretch.of(face):
                    self._draw(stretch, face)

    def _guide(self, centre: Floats) -> Guide:
        """Slopes and tilt of the sheet, from its centre surface."""
        slopes = np.nan_to_num(np.gradient(centre, *self.pitch))
        rise_r, rise_c = rises_px(slopes, self.pitch, self.columns)
        cosine = 1 / np.sqrt(1 + slopes[0] ** 2 + slopes[1] ** 2)
        no_depth = np.full(centre.shape, np.nan)
        return Guide(no_depth, no_depth, rise_r, rise_c, cosine)

    def _draw(self, stretch: Stretch, face: Side) -> None:
        """Draw a face to the points of a stretch, where it is wrong, and what hangs on it.

        It is wrong where it is missing, or too many standard errors off the height that the points
        and the face beyond their reach say. Then it is expected once more, from the points and the
        face right beside what is wrong. The other face is drawn where it is missing there, and the
        interfaces of both follow.
        """
        patch = Patch(self.columns, self.pitch, self._points(stretch, face), stretch.reach_um)
        measured_um = self._measured(face, patch.window)
        is_measured = np.isfinite(measured_um)
        in_reach = patch.away <= patch.reach_um
        no_face = (Status.NO_SHEET, Status.LEAVES_VOLUME)
        is_inside = in_reach & ~np.isin(self.status[patch.window], no_face)
        is_around = is_measured & ~in_reach & (patch.away <= patch.far_um)
        expected = patch.expect(measured_um, is_around, is_inside, uses_points=True)
        if expected is None:
            return
        is_wrong = np.zeros_like(is_inside)
        height, error = expected
        deviation_um = np.abs(measured_um[is_inside] - height)
        # A missing face is wrong too.
        is_wrong[is_inside] = ~(deviation_um <= _WRONG * error + _CLICK * self.voxel_um)
        if not is_wrong.any():
            return
        # Beside what is wrong a face turns towards it.
        step_um = min(self.pitch)
        two_blurs = 2 * blur_reach_um(self.attrs) / step_um
        blur_columns = int(np.ceil(two_blurs)) + 1
        ring_columns = max(2, int(np.ceil(RING_UM / step_um)))
        is_wrong = is_inside & ndimage.binary_dilation(is_wrong, iterations=blur_columns)
        is_near_wrong = ndimage.binary_dilation(is_wrong, iterations=ring_columns)
        is_right = is_near_wrong & ~is_wrong & is_measured & (is_inside | is_around)
        if np.count_nonzero(is_right) < 10:
            is_right = is_around
        expected = patch.expect(measured_um, is_right, is_wrong, uses_points=True)
        assert expected is not None
        self._redraw(face, patch.window, is_wrong, expected)
        other_face: Side = "bottom" if face == "top" else "top"
        is_missing = is_wrong & ~np.isfinite(self.heights[other_face][patch.window])
        opposite_um = self._measured(other_face, patch.window)
        is_trusted = np.isfinite(opposite_um) & is_near_wrong
        expected = patch.expect(opposite_um, is_trusted, is_missing)
        if expected is not None:
            self._redraw(other_face, patch.window, is_missing, expected)
        self._redraw_interface(face, patch, is_wrong, is_near_wrong)
        self._redraw_interface(other_face, patch, is_missing, is_near_wrong)

    def _points(self, stretch: Stretch, face: Side) -> Floats:
        """Points of a face as (row, col, height) in um.

        InputError if one lies outside the columns.
        """
        axes = self.columns.axes
        points = np.array([*map(attrgetter(*axes), stretch.of(face))], np.float64)
        coords_um = *self.columns.lateral_um(), self.columns.depth_um
        for axis, um, points_um in zip(axes, coords_um, points.T, strict=True):
            is_outside = (points_um < um[0] - 1e-6) | (points_um > um[-1] + 1e-6)
            if is_outside.any():
                point = stretch.of(face)[is_outside.argmax()]
                raise InputError(
                    f"A point of correction {stretch.id}, z, y, x = {point.z:g}, {point.y:g},"
                    f" {point.x:g} um, lies outside the volume: its {axis} goes from {um[0]:g} to"
                    f" {um[-1]:g} um. Move the point or take the correction out."
                )
        return points

    def _measured(self, face: Side, window: Window) -> Floats:
        return np.where(self.status[window] == Status.MEASURED, self.heights[face][window], np.nan)

    def _redraw(self, face: Side, window: Window, is_redrawn: Bools, expected: TwoFields) -> None:
        """Move a face to where it is expected, or between that and an edge in the image.

        ``is_redrawn``: columns of the window; ``expected``: height and its standard error in each
        of them, (n,) in um.
        """
        height, error = expected
        interface = self.heights[f"interface_{face}"]
        heights = self.heights[face]
        # The interface is the second edge of the column, as far below the face as usual here.
        offset_px = np.full(height.size, np.nan)
        if np.isfinite(interface).any():
            coating_um = np.abs(interface - heights)[window]
            offset_px[:] = np.nanmedian(coating_um) / self.voxel_um
        edge_heights = self._edges(
            face,
            window,
            is_redrawn,
            expected,
            offset_px,
            is_relative=True,
            sign=1.0,
            min_step=_LEAST * self.contrast,
        )
        has_edge = np.isfinite(edge_heights)
        # Both say where the face is, each as sure as it is.
        edge_share = error**2 / (error**2 + (_EDGE * self.voxel_um) ** 2)
        weight = np.where(has_edge, edge_share, 0.0)
        shift = np.where(has_edge, weight * (edge_heights - height), 0.0)
        heights[window][is_redrawn] = height + shift
        self.how[face][window][is_redrawn] = np.where(has_edge, IMAGE, INTERPOLATED)
        self.error_um[face][window][is_redrawn] = np.sqrt(1 - weight) * error

    def _redraw_interface(
        self, face: Side, patch: Patch, is_redrawn: Bools, is_near: Bools
    ) -> None:
        """Move an interface with its face that was redrawn.

        It is moved to edges in the image, or by the coating around. ``is_redrawn``, ``is_near``:
        columns of the patch in which the face was redrawn, and those around them too, whose coating
        says how thick it is expected. Where it is only expected, its error adds to the face's.
        """
        window = patch.window
        interface = self.heights[f"interface_{face}"]
        if not np.isfinite(interface).any() or not is_redrawn.any():
            return
        coating_um = np.abs(interface - self.heights[face])[window]
        is_trusted = is_near & ~is_redrawn & np.isfinite(coating_um)
        expected = patch.expect(coating_um, is_trusted, is_redrawn)
        if expected is None:
            return
        thickness, error = expected
        face_height = self.heights[face][window][is_redrawn]
        inward = self.columns.frame.sign * (-1 if face == "top" else 1)
        height = face_height + inward * np.maximum(thickness, 0.0)
        grey_step = self.attrs["grey_base"] - self.attrs[f"grey_coating_{face}"]
        edge_heights = self._edges(
            face,
            window,
            is_redrawn,
            (height, error),
            self._depth(face_height, face),
            is_relative=False,
            sign=1.0 if self.attrs["polarity"] * grey_step > 0 else -1.0,
            min_step=_LEAST_INNER * abs(grey_step),
        )
        has_edge = inward * (edge_heights - face_height) > 0  # not where the edge is NaN
        interface[window][is_redrawn] = np.where(has_edge, edge_heights, height)
        face_errors = self.error_um[face][window]
        added_um = np.where(has_edge, 0.0, error)
        face_errors[is_redrawn] = np.hypot(face_errors[is_redrawn], added_um)

    def _depth(self, height: Floats, face: Side) -> Floats:
        depth = (height - float(self.columns.depth_um[0])) / self.voxel_um
        return self.columns.shape[2] - 1 - depth if self._is_high(face) else depth

    def _is_high(self, face: Side) -> bool:
        return face == self.columns.frame.side_at(from_high=True)

    def _edges(
        self,
        face: Side,
        window: Window,
        is_searched: Bools,
        expected: TwoFields,
        second_edge: Floats,
        *,
        is_relative: bool,
        sign: float,
        min_step: float,
    ) -> Floats:
        """Heights of edges near those that are expected, (n,); NaN where the image shows none.

        In the columns of the window that are searched. ``expected``: height and standard error, um;
        ``second_edge``: the other edge of the column in voxels, counted from the first inwards
        where it ``is_relative`` to it, else from the end that is read from; NaN: none. ``sign``: -1
        where the grey falls inwards at the edge, which is ``min_step`` high or more.
        """
        columns = self.columns
        attrs = self.attrs
        scale = self.scale
        is_high = self._is_high(face)
        starts = [[window[0].start], [window[1].start]]
        column_indices = np.stack(np.nonzero(is_searched)) + np.array(starts)
        blur_px = blur_reach_um(attrs) / self.voxel_um
        error_px = np.maximum(expected[1] / self.voxel_um, 0.25)
        # How far from the expected place an edge is sought, in voxels.
        band_px = np.clip(2.0 * error_px + 1, 2.0, 8.0)
        depth_px = self._depth(expected[0], face)
        edge_searches = np.stack([depth_px, error_px, band_px, second_edge])
        noise = attrs["grey_noise"]
        fringe_px = attrs.get("fringe_um", 0.0) / self.voxel_um or FRINGE_PX
        # The noise; the least step, and how much it gains: an edge of five standard errors; the
        # fringe.
        misfit = max(noise, _MISFIT * self.contrast)
        fringe = attrs.get("fringe", 0.0), blur_px / fringe_px
        search_options = misfit, max(min_step, 4 * noise), 25.0, *fringe

        def job(tile: Tile) -> EdgeJob:
            in_tile = _in_tile(column_indices, tile)
            guide = self.guide.part(scale.grown(tile, columns.shape[:2]))
            return (
                (columns, guide, scale, is_high, blur_px),
                column_indices[:, in_tile],
                edge_searches[:, in_tile],
                (is_relative, sign),
                search_options,
            )

        tiles = [t for t in columns.tiles(self.engine) if _in_tile(column_indices, t).any()]
        self.tiles.update(tiles)
        # Named by what is asked for: a run that goes on with other corrections finds nothing of
        # these.
        asked_for = *column_indices, *expected, second_edge
        request = hashlib.sha256(b"".join(a.tobytes() for a in asked_for))
        step = f"drawn-{request.hexdigest()[:16]}"
        depths = np.full(column_indices.shape[1], np.nan)
        for tile, tile_depths in self.engine.map(step, _search_edges, job, tiles):
            depths[_in_tile(column_indices, tile)] = tile_depths
        if is_high:
            depths = columns.shape[2] - 1 - depths
        return float(columns.depth_um[0]) + self.voxel_um * depths


EdgeJob = tuple[
    tuple[Columns, Guide, GreyScale, bool, float],
    Ints,
    Floats,
    tuple[bool, float],
    tuple[float, ...],
]
"""What the profiles of a tile are read with, whether from the high end, and their blur; rows and
columns of the edges; for each the depth expected, its error, how far from it an edge may be, and
the other depth; options of the search."""


def _in_tile(places: Ints, tile: Tile) -> Bools:
    rows, cols = places
    in_rows = (rows >= tile.r0) & (rows < tile.r1)
    return in_rows & (cols >= tile.c0) & (cols < tile.c1)


def _search_edges(job: EdgeJob, tile: Tile) -> Floats:
    """Depths of the edges of a tile, (n,) in voxels from the end that is read from; NaN: none."""
    (columns, guide, scale, is_high, blur_px), (rows, cols), searches, kind, options = job
    grey, guide = oriented(columns, tile, guide, scale)
    tile_indices = rows - tile.r0, cols - tile.c0
    profiles = grey[tile_indices]
    if is_high:
        profiles = np.ascontiguousarray(profiles[:, ::-1])
    width_px = blur_px / guide.cos_tilt[tile_indices]
    depths = np.empty(len(profiles))
    _draw_kernels.draw_edges(profiles, *searches, *kind, width_px, *options, depths)
    return depths


def distance_to_line(grid: Floats, places: Floats) -> Floats:
    """Distance of places (..., 2) from the line through points (n, 2), in their order."""
    distance = _length(grid - places[0])
    for start, end in pairwise(places):
        segment = end - start
        length = float(segment @ segment)
        if length > 0:
            share = np.clip(((grid - start) @ segment) / length, 0, 1)
            from_nearest = grid - start - share[..., None] * segment
            distance = np.minimum(distance, _length(from_nearest))
    return distance


def _length(vectors: Floats) -> Floats:
    return np.hypot(vectors[..., 0], vectors[..., 1])


def krige(
    targets: Floats, places: Floats, heights: Floats, variances: Floats, slope: float
) -> TwoFields:
    """Return height and its standard error at targets, (m,) in um, from heights known at places.

    The targets are (m, 2) and the places (n, 2): row and column in um. The heights (n,) are in um,
    their ``variances`` (n,) in um2, and ``slope`` in um2 of semivariance for each um of distance.

    Ordinary kriging with a linear variogram: the semivariance of two heights that lie r apart is
    ``slope * r``, um2 (Matheron 1963, doi:10.2113/gsecongeo.58.8.1246). Heights have their own
    variances; a plane takes slow trends off.
    """
    n = len(heights)
    centroid = places.mean(axis=0)
    plane = np.zeros(3)
    if n >= 6:
        terms = np.column_stack([np.ones(n), places - centroid])
        plane = np.linalg.lstsq(terms, heights, rcond=1e-6)[0]
    residuals = heights - plane[0] - (places - centroid) @ plane[1:]

    def semivariance(points: Floats) -> Floats:
        return slope * _length(points[:, None] - places[None])

    # Its last row and column make the weights of each target sum to 1.
    system = np.ones((n + 1, n + 1))
    system[:n, :n] = -semivariance(places) + np.diag(variances)
    system[n, n] = 0.0
    inverse = np.linalg.inv(system)
    height = np.empty(len(targets))
    error = np.empty(len(targets))
    for start in range(0, len(targets), 20_000):
        chunk = slice(start, start + 20_000)
        points = targets[chunk]
        semivariances = np.ones((len(points), n + 1))
        semivariances[:, :n] = -semivariance(points)
        weights = semivariances @ inverse
        offsets = points - centroid
        height[chunk] = weights[:, :n] @ residuals + plane[0] + offsets @ plane[1:]
        variance = -np.sum(weights * semivariances, axis=1)
        error[chunk] = np.sqrt(np.maximum(variance, 0.0))
    return height, error


def variogram_slope(heights: Floats, pitch: Pair, lag_um: float, *, least: float) -> float:
    """Return the slope of the linear variogram of a field, from pairs ``lag_um`` apart.

    In um2 for each um. The field is (rows, cols) in um, NaN where unknown; ``pitch``: of rows and
    columns, um.

    ``least``: semivariance at that lag where no more is seen, um2.
    """
    squared_differences = [np.empty(0)]
    for field, step in zip((heights, heights.T), pitch, strict=True):
        k = max(1, round(lag_um / step))
        difference = (field[k:] - field[:-k]).ravel()
        squares = difference[np.isfinite(difference)] ** 2
        squared_differences.append(squares * lag_um / (k * step))
    squares_at_lag = np.concatenate(squared_differences)
    if not squares_at_lag.size:
        return least / lag_um
    # The median of the square of a normal deviate is 0.4549 of its variance.
    typical_variance = float(np.median(squares_at_lag)) / (2 * 0.4549)
    return max(typical_variance, least) / lag_um
