"""Faces drawn to points that a person set, where the search followed something else.

Around the points a face is expected where kriging puts it: between the points and the face around them, which is known
from the search. What lies there within its error stays as it was found. The other columns are searched again close to
the expected place, for an edge whose levels are free, because an inclusion has levels of its own. The face is the
mean of this edge and the expected place, each weighted by its variance; where the image shows no edge it is the
expected place. Its standard error follows.
"""

from __future__ import annotations

import hashlib
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.errors import InputError
from planish.core.frame import Frame
from planish.core.grid import pitch
from planish.core.status import Status
from planish.core.tiles import Engine, Tile
from planish.core.typing import Bools, Floats
from planish.surface import _draw_kernels
from planish.surface.columns import FRINGE_PX, Columns, GreyScale, Guide, oriented, voxel_pitch
from planish.surface.params import FACES, Corrections, Face, Stretch

UNCHANGED, IMAGE, INTERPOLATED = 0, 1, 2
"""A column's face was left as it was found, found again in the image, or interpolated."""

RING_UM = 25.0
"""Least width of the face around a stretch that it is interpolated from."""
_KNOWN = 160  # heights at most that stand for the face around
_CLICK = 0.5  # voxels: standard error of a point, and of a face that was found
_SURE = 2.0  # standard errors within which an edge is sought
_WRONG = 3.0  # standard errors beyond which it is not
_BAND = (2.0, 8.0)  # voxels: how far from the expected place an edge is sought, at least and at most
_MISFIT = 0.03  # of the base's contrast: no column is a staircase to within less
_LEAST, _LEAST_INNER = 0.15, 0.3  # of the step of the base, or of the interface: smaller ones are texture
_GAIN = 25.0  # an edge of five standard errors
_EDGE = 1.0  # voxels by which an edge may be off where something misled the search: it has levels of its own
_NEVER = (Status.NO_SHEET, Status.LEAVES_VOLUME)


def draw_faces(surfaces: xr.Dataset, columns: Columns, corrections: Corrections, engine: Engine) -> Drawing:
    """Draw the faces of surfaces, as they were found, to the points of all stretches, one after the other."""
    drawing = Drawing(surfaces, columns, engine)
    for stretch in corrections.stretches:
        for face in FACES:
            if stretch.of(face):
                drawing.draw(stretch, face)
    return drawing


class _Edges(NamedTuple):
    """Job of the search of edges in n columns; depths count from the outer end."""

    columns: Columns
    scale: GreyScale
    guide: Guide
    high: bool  # whether the outer end is the high one
    places: NDArray[np.intp]  # (2, n): rows and columns
    depths: Floats  # (4, n): the depth expected, its error, how far from it an edge may be, and the other depth
    rides: bool
    sign: float
    blur: float
    noise: float
    least: float
    fringe: float
    ratio: float


class Drawing:
    """Heights as corrections leave them, (rows, cols); ``how`` and ``error_um`` by face; ``tiles`` searched again."""

    def __init__(self, surfaces: xr.Dataset, columns: Columns, engine: Engine) -> None:
        self.columns, self.engine, self.frame = columns, engine, Frame.of(surfaces)
        self.attrs, self.pitch = surfaces.attrs, pitch(surfaces)
        self.contrast = abs(self.attrs["grey_base"] - self.attrs["grey_air"])
        self.rows_um, self.cols_um = columns.lateral_um()
        self.voxel_um = voxel_pitch(columns.volume, self.frame.through)
        names = [name for face in FACES for name in (face, f"interface_{face}")]
        self.heights = {name: surfaces[name].values.astype(np.float64) for name in names}
        self.status: NDArray[np.uint8] = surfaces["status"].values
        self.centre = surfaces["centre"].values.astype(np.float64)
        self.how: dict[Face, NDArray[np.uint8]] = {face: np.zeros(self.status.shape, np.uint8) for face in FACES}
        self.error_um: dict[Face, Floats] = {face: np.full(self.status.shape, np.nan) for face in FACES}
        self.tiles: list[Tile] = []

    def draw(self, stretch: Stretch, face: Face) -> None:
        """Draw a face to the points of a stretch."""
        points = self._points(stretch, face)
        ring_um = max(RING_UM, 0.5 * stretch.reach_um)
        window = self._window(points[:, :2], stretch.reach_um + ring_um)
        grid = np.stack(np.meshgrid(self.rows_um[window.rows], self.cols_um[window.cols], indexing="ij"), axis=-1)
        away = distance_to_line(grid, points[:, :2])
        measured = self._measured(face, window)
        inside = (away <= stretch.reach_um) & ~np.isin(self.status[window.rows, window.cols], _NEVER)
        around = np.isfinite(measured) & (away > stretch.reach_um) & (away <= stretch.reach_um + ring_um)
        expect = _Expectation(
            points, grid, self.pitch, self.voxel_um, max(0.25 * stretch.reach_um, 2 * max(self.pitch))
        )
        first = expect(around, measured, inside)
        if first is None:
            return
        wrong = np.zeros_like(inside)
        off = np.abs(measured[inside] - first[0])
        wrong[inside] = ~(off <= _WRONG * first[1] + _CLICK * self.voxel_um)
        if not wrong.any():
            return
        # Beside what is wrong a face turns towards it.
        blurred = int(np.ceil(2 * self.attrs["blur_um"] / min(self.pitch))) + 1
        wrong = ndimage.binary_dilation(wrong, iterations=blurred) & inside
        near = ndimage.binary_dilation(wrong, iterations=max(2, int(np.ceil(RING_UM / min(self.pitch)))))
        right = near & ~wrong & np.isfinite(measured) & (inside | around)
        expected = expect(right if np.count_nonzero(right) >= 10 else around, measured, wrong)
        assert expected is not None
        self._redraw(face, window, wrong, expected)
        other: Face = "bottom" if face == "top" else "top"
        missing = wrong & ~np.isfinite(self.heights[other][window.rows, window.cols])
        opposite = self._measured(other, window)
        if (expected := expect(np.isfinite(opposite) & near, opposite, missing, points=False)) is not None:
            self._redraw(other, window, missing, expected)
        self._redraw_interfaces(window, near, {face: wrong, other: missing}, expect)

    def _redraw_interfaces(self, window: Tile, near: Bools, redrawn: dict[Face, Bools], expect: _Expectation) -> None:
        """Move the interfaces with the faces that were redrawn: to edges in the image, or by the coating around."""
        for face, where in redrawn.items():
            interface = self.heights[f"interface_{face}"]
            if not np.isfinite(interface).any() or not where.any():
                continue
            coating = np.abs(interface - self.heights[face])[window.rows, window.cols]
            trusted = near & ~where & np.isfinite(coating)
            if (thickness := expect(trusted, coating, where, points=False)) is None:
                continue
            outer = self.heights[face][window.rows, window.cols][where]
            inward = -self.frame.sign if face == "top" else self.frame.sign
            expected, error = outer + inward * np.maximum(thickness[0], 0.0), thickness[1]
            step = self.attrs["grey_base"] - self.attrs[f"grey_coating_{face}"]
            edges = self._edges(
                face, window, where, expected, error, self._depth(outer, face), rides=False,
                sign=1.0 if self.attrs["polarity"] * step > 0 else -1.0, least=_LEAST_INNER * abs(step),
            )  # fmt: skip
            has_edge = np.isfinite(edges) & (inward * (edges - outer) > 0)
            self._set(interface, window, where, np.where(has_edge, edges, expected))
            before = self.error_um[face][window.rows, window.cols][where]
            self._set(self.error_um[face], window, where, np.where(has_edge, before, np.hypot(before, error)))

    def _points(self, stretch: Stretch, face: Face) -> Floats:
        """Points of a face as (row, col, height) in um; InputError if one lies outside the columns."""
        order = ["zyx".index(axis) for axis in (self.frame.rows, self.frame.cols, self.frame.through)]
        points_zyx = [(point.z, point.y, point.x) for point in stretch.of(face)]
        points = np.asarray(points_zyx, dtype=np.float64)[:, order]
        depth = self.columns.depth_um
        for point, place in zip(points, points_zyx, strict=True):
            for axis, coordinate, places in zip(("rows", "cols", "through"), point, (self.rows_um, self.cols_um, depth),
                                           strict=True):  # fmt: skip
                name = getattr(self.frame, axis)
                if not places[0] - 1e-6 <= coordinate <= places[-1] + 1e-6:
                    raise InputError(
                        f"A point of correction {stretch.id}, z, y, x = {', '.join(f'{v:g}' for v in place)} um, lies "
                        f"outside the volume: its {name} goes from {places[0]:g} to {places[-1]:g} um. Move the point "
                        "or take the correction out."
                    )
        return points

    def _window(self, places: Floats, reach_um: float) -> Tile:
        """Columns within a reach of any of the points."""
        low, high = places.min(axis=0) - reach_um, places.max(axis=0) + reach_um
        (r0, r1), (c0, c1) = (
            (int(np.searchsorted(um, a)), int(np.searchsorted(um, b, "right")))
            for um, a, b in zip((self.rows_um, self.cols_um), low, high, strict=True)
        )
        return Tile(r0, max(r1, r0 + 1), c0, max(c1, c0 + 1))

    def _measured(self, face: Face, window: Tile) -> Floats:
        """Heights of a face where it was measured."""
        height = self.heights[face][window.rows, window.cols]
        return np.where(self.status[window.rows, window.cols] == Status.MEASURED, height, np.nan)

    def _redraw(self, face: Face, window: Tile, where: Bools, expected: tuple[Floats, Floats]) -> None:
        """Set a face to the edge near where it is expected, or to that place."""
        height, error = expected
        interface = self.heights[f"interface_{face}"]
        offset = np.full(height.size, np.nan)
        if np.isfinite(interface).any():
            usual = np.nanmedian(np.abs(interface - self.heights[face])[window.rows, window.cols])
            offset[:] = usual / self.voxel_um
        edges = self._edges(
            face, window, where, height, error, offset, rides=True, sign=1.0, least=_LEAST * self.contrast
        )
        has_edge = np.isfinite(edges)
        # Both say where the face is, each as sure as it is.
        share = error**2 / (error**2 + (_EDGE * self.voxel_um) ** 2)
        self._set(self.heights[face], window, where, np.where(has_edge, height + share * (edges - height), height))
        self._set(self.how[face], window, where, np.where(has_edge, IMAGE, INTERPOLATED))
        self._set(self.error_um[face], window, where, np.where(has_edge, np.sqrt(1 - share) * error, error))

    def _set(self, field: NDArray[np.generic], window: Tile, where: Bools, new: NDArray[np.generic]) -> None:
        field[window.rows, window.cols][where] = new

    def _depth(self, height: Floats, face: Face) -> Floats:
        """Depth in voxels from the outer end of a face."""
        depth = (height - float(self.columns.depth_um[0])) / self.voxel_um
        return self.columns.shape[2] - 1 - depth if self._high(face) else depth

    def _high(self, face: Face) -> bool:
        return (face == "top") == (self.frame.top == "high")

    def _edges(
        self, face: Face, window: Tile, where: Bools, height: Floats, error: Floats, other: Floats, *, rides: bool,
        sign: float, least: float,
    ) -> Floats:  # fmt: skip
        """Heights of edges near those that are expected, (n,); NaN where the image shows none."""
        attrs = self.attrs
        places = np.stack(np.nonzero(where)) + np.array([[window.r0], [window.c0]])
        scale = GreyScale(
            air=attrs["grey_air"], polarity=attrs["polarity"], blend=float(attrs.get("averaged_columns", 0.0))
        )
        guide, blur = self._guide(), attrs["blur_um"] / self.voxel_um
        fringe_px = attrs.get("fringe_um", 0.0) / self.voxel_um or FRINGE_PX
        error_px = np.maximum(error / self.voxel_um, 0.25)
        all_edges = _Edges(
            columns=self.columns, scale=scale, guide=guide, high=self._high(face), places=places,
            depths=np.stack([self._depth(height, face), error_px, np.clip(_SURE * error_px + 1, *_BAND), other]),
            rides=rides, sign=sign, blur=blur, noise=max(attrs["grey_noise"], _MISFIT * self.contrast),
            least=max(least, 4 * attrs["grey_noise"]), fringe=attrs.get("fringe", 0.0), ratio=blur / fringe_px,
        )  # fmt: skip

        def job(tile: Tile) -> _Edges:
            part, wide = _in_tile(places, tile), guide.part(scale.grown(tile, self.columns.shape[:2]))
            return all_edges._replace(guide=wide, places=places[:, part], depths=all_edges.depths[:, part])

        tiles = [t for t in self.columns.tiles(self.engine) if _in_tile(places, t).any()]
        self.tiles += [t for t in tiles if t not in self.tiles]
        depths = np.full(height.size, np.nan)
        # Named by what is asked for: a run that goes on with other corrections finds nothing of these.
        asked = hashlib.sha256(b"".join(a.tobytes() for a in (*places, height, error, other))).hexdigest()[:16]
        for tile, part in self.engine.map(f"drawn-{asked}", _search_edges, job, tiles):
            depths[_in_tile(places, tile)] = part
        if self._high(face):
            depths = self.columns.shape[2] - 1 - depths
        return float(self.columns.depth_um[0]) + self.voxel_um * depths

    def _guide(self) -> Guide:
        """Give slopes and tilt of the sheet, from its centre surface."""
        down, across = (np.where(np.isfinite(s), s, 0.0) for s in np.gradient(self.centre, *self.pitch))
        along_r, along_c = (
            s * p / self.columns.step / self.voxel_um for s, p in zip((down, across), self.pitch, strict=True)
        )
        unknown = np.full(self.centre.shape, np.nan)
        tilt = 1 / np.sqrt(1 + down**2 + across**2)
        return Guide(low=unknown, high=unknown, slope_r=along_r, slope_c=along_c, tilt=tilt)


class _Expectation(NamedTuple):
    """Kriging between the points of a stretch, (n, 3) in um, and the face around them on a ``grid`` of places."""

    points: Floats
    grid: Floats
    pitch: tuple[float, float]
    voxel_um: float
    lag_um: float

    def __call__(
        self, trusted: Bools, field: Floats, wanted: Bools, *, points: bool = True
    ) -> tuple[Floats, Floats] | None:
        """Give a field and its standard error where it is wanted, from where it is trusted and from the points."""
        rows, cols = np.nonzero(trusted)
        # Some of the columns, spread over all of them.
        few = np.unique(np.linspace(0, rows.size - 1, min(rows.size, _KNOWN)).astype(int)) if rows.size else slice(0, 0)
        rows, cols = rows[few], cols[few]
        points_um = self.points if points else self.points[:0]
        if len(points_um) + rows.size < 1 or not wanted.any():
            return None
        slope = variogram_slope(
            np.where(trusted, field, np.nan), self.pitch, self.lag_um, least=(0.25 * self.voxel_um) ** 2
        )
        return krige(
            self.grid[wanted], places=np.concatenate([points_um[:, :2], self.grid[rows, cols]]),
            heights=np.concatenate([points_um[:, 2], field[rows, cols]]),
            variances=np.full(len(points_um) + rows.size, (_CLICK * self.voxel_um) ** 2), slope=slope,
        )  # fmt: skip


def _in_tile(places: NDArray[np.intp], tile: Tile) -> Bools:
    rows, cols = places
    return (rows >= tile.r0) & (rows < tile.r1) & (cols >= tile.c0) & (cols < tile.c1)


def _search_edges(edges: _Edges, tile: Tile) -> Floats:
    grey = oriented(edges.columns, tile, edges.guide, edges.scale)
    outside = edges.scale.grown(tile, edges.columns.shape[:2])
    rows, cols = edges.places
    profiles = grey[rows - tile.r0, cols - tile.c0]
    if edges.high:
        profiles = profiles[:, ::-1]
    tilt = edges.guide.tilt[rows - outside.r0, cols - outside.c0]
    depths = np.empty(len(profiles))
    _draw_kernels.draw_edges(
        np.ascontiguousarray(profiles), *edges.depths, edges.rides, edges.sign, edges.blur / tilt, edges.noise,
        edges.least, _GAIN, edges.fringe, edges.ratio, depths,
    )  # fmt: skip
    return depths


def distance_to_line(grid: Floats, places: Floats) -> Floats:
    """Distance of places (..., 2) from the line through points (n, 2), in their order."""
    away = np.hypot(*np.moveaxis(grid - places[0], -1, 0))
    for start, end in pairwise(places):
        along = end - start
        length = float(along @ along)
        share = np.clip(((grid - start) @ along) / length, 0, 1) if length > 0 else np.zeros(grid.shape[:-1])
        away = np.minimum(away, np.hypot(*np.moveaxis(grid - start - share[..., None] * along, -1, 0)))
    return away


_OF_A_MEDIAN = 0.4549  # the median of the square of a normal deviate over its variance
_AT_ONCE = 20_000  # places


def krige(
    targets: Floats, *, places: Floats, heights: Floats, variances: Floats, slope: float
) -> tuple[Floats, Floats]:
    """Height and its standard error at targets (m, 2), from heights (n,) known at places (n, 2) in um.

    Ordinary kriging with a linear variogram: the semivariance of two heights that lie r apart is ``slope * r``, um2
    (Matheron 1963, doi:10.2113/gsecongeo.58.8.1246). Each known height has the variance of its own error. Slow trends
    are taken off as a plane.
    """
    middle, n = places.mean(axis=0), len(heights)
    plane = np.zeros(3)
    if n >= 6:
        plane = np.linalg.lstsq(np.column_stack([np.ones(n), places - middle]), heights, rcond=1e-6)[0]
    residuals = heights - plane[0] - (places - middle) @ plane[1:]

    def between(ends: Floats) -> Floats:
        return slope * np.hypot(*(ends[:, None, k] - places[None, :, k] for k in (0, 1)))

    system = np.ones((n + 1, n + 1))
    system[:n, :n] = -between(places) + np.diag(variances)
    system[n, n] = 0.0
    inverse = np.linalg.inv(system)
    height, error = np.empty(len(targets)), np.empty(len(targets))
    for start in range(0, len(targets), _AT_ONCE):
        part = slice(start, start + _AT_ONCE)
        semivariances = np.ones((len(targets[part]), n + 1))
        semivariances[:, :n] = -between(targets[part])
        weights = semivariances @ inverse
        height[part] = weights[:, :n] @ residuals + plane[0] + (targets[part] - middle) @ plane[1:]
        error[part] = np.sqrt(np.maximum(-np.sum(weights * semivariances, axis=1), 0.0))
    return height, error


def variogram_slope(heights: Floats, pitch: tuple[float, float], lag_um: float, *, least: float) -> float:
    """Slope of the linear variogram of a field (rows, cols), NaN where unknown, from pairs ``lag_um`` apart.

    ``least``: variance at that lag where no more is seen.
    """
    squares: list[Floats] = []
    for axis, step in enumerate(pitch):
        k = max(1, round(lag_um / step))
        if heights.shape[axis] > k:
            first, second = (np.take(heights, range(a, heights.shape[axis] - k + a), axis) for a in (0, k))
            pairs = (second - first)[np.isfinite(second - first)] ** 2
            squares.append(pairs * lag_um / (k * step))
    pairs = np.concatenate(squares) if squares else np.empty(0)
    usual = float(np.median(pairs)) / (2 * _OF_A_MEDIAN) if pairs.size else 0.0
    return max(usual, least) / lag_um
