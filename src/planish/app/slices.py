"""Slices of a volume with the surfaces in them.

They are read by window from the volume's file and the store of the run.
"""

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
import xarray as xr
from contourpy import LineType, contour_generator
from numpy.typing import NDArray
from pydantic import Field

from planish.app.picture import Codes, layer_run
from planish.core.errors import FileError, InputError
from planish.core.facts import ResultModel
from planish.core.frame import Axis, Frame
from planish.core.grid import pitch, step_of
from planish.core.labelled import read_box
from planish.core.memory import LOOK_BYTES
from planish.core.typing import Array, Floats, Pair, Singles, Texts, Window
from planish.io import find_place, read_volume
from planish.io.map_store import stored_group
from planish.io.params import VolumeParams
from planish.io.sections import is_section_folder
from planish.measure.rays import directions, meet, slopes_of
from planish.measure.straighten import voxels_around
from planish.run.run import MAPS
from planish.run.study import Study
from planish.surface import Corrections, preview_faces, uncorrected

Direction = Literal["z", "y", "x", "straight"]
Near = tuple[float | None, float | None]
WIDEST = 2048
"""Voxels of a slice along either edge: a larger one is cut around the place that is asked for."""

HEIGHTS = ("top", "interface_top", "centre", "interface_bottom", "bottom")
_EXACT = np.dtype("u1"), np.dtype("u2")


Lines = dict[str, Floats]  # curves by name


class AxisFacts(ResultModel):
    """One edge of a slice: the place of pixel k is ``first_um + k * step_um``."""

    name: Literal["z", "y", "x", "height"]
    first_um: float
    step_um: float
    count: int


class SliceFacts(ResultModel):
    """A slice and what was found in it.

    A value of 16 bits stands for ``offset + scale * value``.
    """

    layer: str
    direction: Direction  # axis across the slice; or straightened along normals
    normal: Axis  # along which slices of this direction follow each other
    index: int
    at_um: float  # place along the normal
    across: AxisFacts
    down: AxisFacts  # the top of the sheet is up
    scale: float
    offset: float
    missing: int  # value of voxels that are missing; -1 where there are none
    lines: Texts = ()  # names; float32 each, one value a column of the surfaces
    columns: AxisFacts | None = None  # these columns along ``across``
    # Of each contour of a slice along the sheet.
    segments: dict[str, int] = Field(default_factory=dict[str, int])


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetSlice:
    """A slice as it is sent: pixels (down, across), lines (columns,) and contours (n, 4)."""

    facts: SliceFacts
    pixels: NDArray[np.uint16]
    lines: Sequence[Singles]
    contours: Sequence[Singles]


@dataclass(eq=False, kw_only=True)
class SlicedSheet:
    """One sheet of a run: its volume and its surfaces, both left in their files."""

    name: str
    volume: xr.DataArray
    surfaces: xr.Dataset
    codes: Codes | None  # of values that are no whole numbers of 16 bits
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @classmethod
    def open(cls, name: str, params: VolumeParams, store: Path) -> Self:
        """Open volume and surfaces of a sheet.

        FileError where the volume is gone, damaged, or serial sections.
        """
        path = find_place(params.path).path
        if is_section_folder(path):
            raise FileError(
                f"{path.name} holds serial sections, which are no volume until they are joined. To"
                f" see slices, import them (planish import {path.name} --through {params.through}"
                f" --out {path.name}.zarr) and map that."
            )
        volume = read_volume(params.path, **params.how, memory_bytes=LOOK_BYTES)
        codes = None
        if volume.dtype not in _EXACT:
            plane = volume[volume.shape[0] // 2].values
            low, high = _ends(plane.astype(np.float64)) or (0.0, 1.0)
            codes = Codes.between(low - (high - low), high + (high - low))
        return cls(name=name, volume=volume, surfaces=stored_group(store, "surfaces"), codes=codes)

    @property
    def frame(self) -> Frame:
        """How the sheet lies in the volume."""
        return Frame.of(self.surfaces)

    @property
    def step(self) -> int:
        """Voxels along the edge of a column of the surfaces."""
        n_voxels = self.volume.sizes[self.frame.rows]
        return max(1, n_voxels // max(self.surfaces.sizes["y"], 1))

    def voxels_um(self, axis: str) -> Floats:
        """Places of the voxels along an axis, um."""
        return np.asarray(self.volume.coords[axis].values, np.float64)

    def count(self, direction: Direction) -> int:
        """Slices of a direction."""
        if direction == "straight":
            return self.surfaces.sizes["y"]
        return self.volume.sizes[direction]

    def _slice(
        self,
        direction: Direction,
        index: int,
        values: Array,
        codes: Codes | None = None,
        lines: Lines | None = None,
        contours: Lines | None = None,
        **axes: AxisFacts,
    ) -> SheetSlice:
        """A slice as the page takes it: grey in 16 bits, curves in 32, and what both mean.

        ``values`` (down, across); ``codes``, where its grey is coded otherwise than that of the
        sheet; ``lines`` and ``contours`` as of :class:`SheetSlice`; ``axes`` are the edges
        ``across`` and ``down``, and ``columns`` where it has lines.
        """
        lines = lines or {}
        contours = contours or {}
        codes = codes or self.codes
        if codes is None:
            pixels = values.astype(np.uint16)
            scale = 1.0
            offset = 0.0
        else:
            pixels = codes.of(values)
            scale = codes.scale
            offset = codes.offset - codes.scale
        normal = self.frame.rows if direction == "straight" else direction
        slices_um = self._columns_um(normal) if direction == "straight" else self.voxels_um(normal)
        facts = SliceFacts(
            layer=self.name,
            direction=direction,
            normal=normal,
            index=index,
            at_um=float(slices_um[index]),
            scale=scale,
            offset=offset,
            missing=-1 if codes is None else 0,
            lines=tuple(lines),
            segments={name: len(array) for name, array in contours.items()},
            **axes,
        )
        curves = [array.astype(np.float32) for array in lines.values()]
        segments = [array.astype(np.float32) for array in contours.values()]
        return SheetSlice(facts=facts, pixels=pixels, lines=curves, contours=segments)

    def cut(
        self,
        direction: Direction,
        index: int,
        *,
        near_um: Near = (None, None),
        corrections: Corrections | None = None,
    ) -> SheetSlice:
        """One slice; InputError where there is none.

        ``index`` is the voxel along the direction's axis, or the row of the surfaces' columns where
        it is straightened; ``near_um`` the place across and down around which a large slice is cut,
        its middle where None; ``corrections`` are seen as ``preview_top`` and ``preview_bottom``.
        """
        n_slices = self.count(direction)
        if not 0 <= index < n_slices:
            raise InputError(f"There is no slice {index} along {direction}; there are {n_slices}.")
        with self._lock:  # decoders of files are not all made for several threads
            if direction == "straight":
                return self._straight(index, near_um, corrections)
            if direction == self.frame.through:
                return self._along(index, near_um)
            return self._across(direction, index, near_um, corrections)

    def _across(
        self, direction: Axis, index: int, near_um: Near, corrections: Corrections | None
    ) -> SheetSlice:
        """One slice across the sheet, with the lines of its surfaces.

        Its edges are the axis through the sheet (down, the top first) and ``axis``, the lateral one
        along it. ``profile_index``: the row or column of the surfaces in it.
        """
        frame = self.frame
        axis: Axis = frame.cols if direction == frame.rows else frame.rows
        depth_um = self.voxels_um(frame.through)
        cols = _window(self.voxels_um(axis), near_um[0])
        planes = _window(depth_um, near_um[1])
        this_slice = slice(index, index + 1)
        box = {frame.through: planes, axis: cols, direction: this_slice}
        values = read_box(self.volume, box)[..., 0]
        depth_um = depth_um[planes]
        if frame.top == "high":
            values = values[::-1]
            depth_um = depth_um[::-1]
        profile_index = min(index // self.step, self._columns_um(direction).size - 1)
        columns = self._columns(axis, cols)
        lines = self._lines(axis, profile_index, columns, corrections)
        return self._slice(
            direction,
            index,
            values,
            lines=lines,
            across=self._edge(axis, cols),
            down=edge_of(frame.through, depth_um),
            columns=edge_of(axis, self._columns_um(axis)[columns]),
        )

    def _along(self, index: int, near_um: Near) -> SheetSlice:
        """One slice along the sheet, with the contours in which its surfaces cross it."""
        frame = self.frame
        axes = frame.cols, frame.rows
        cols, rows = map(_window, map(self.voxels_um, axes), near_um)
        this_slice = slice(index, index + 1)
        box = {frame.rows: rows, frame.cols: cols, frame.through: this_slice}
        values = read_box(self.volume, box)[..., 0]
        height_um = float(self.voxels_um(frame.through)[index])
        surface_rows = self._columns(frame.rows, rows)
        surface_cols = self._columns(frame.cols, cols)
        surfaces = self.surfaces.isel(y=surface_rows, x=surface_cols)
        x = surfaces["x"].values
        y = surfaces["y"].values
        contours = {name: contour(surfaces[name].values - height_um, x, y) for name in HEIGHTS}
        return self._slice(
            frame.through,
            index,
            values,
            contours=contours,
            across=self._edge(frame.cols, cols),
            down=self._edge(frame.rows, rows),
        )

    def _straight(self, index: int, near_um: Near, corrections: Corrections | None) -> SheetSlice:
        """One row of columns, sampled along the normals: the sheet as if it were flat.

        Its height is 0 at the centre surface; 1.5 thicknesses to either side are shown. Lines are
        heights along the normals, too.
        """
        frame = self.frame
        columns_um = self._columns_um(frame.cols)
        window = _window(columns_um, near_um[0])
        lines = self._lines(frame.cols, index, window, corrections)
        thickness_um = float(self.surfaces.attrs["thickness_um"])
        first_um, second_um = self.voxels_um(frame.through)[:2].tolist()
        voxel_um = abs(second_um - first_um)
        reach_um = 1.5 * thickness_um
        # Voxels to either side of the centre surface.
        reach = int(np.ceil(reach_um / voxel_um))
        s_um = voxel_um * np.arange(reach, -reach - 1, -1).astype(np.float64)
        values = self._sampled(index, window, lines, s_um)
        # Normals meet the faces above and below other rows, and lean by the rows beside these.
        halo_rows = int(np.ceil(reach_um / min(pitch(self.surfaces)))) + 2
        first_row = max(index - halo_rows, 0)
        rows = slice(first_row, index + halo_rows + 1)
        surfaces = self._surfaces_in(rows, window, (*HEIGHTS, "status"))
        _, faces = meet(surfaces, "normal")
        for name in HEIGHTS:
            if name != "centre":
                lines[name] = faces[name][index - first_row]
        lines["centre"] = np.zeros(columns_um[window].size)
        # These are heights in the volume.
        for name in [*lines]:
            if name.startswith(("preview", "found")):
                del lines[name]
        ends = _ends(values)
        codes = self.codes or Codes(-1.0, 1.0)
        if self.codes is None and ends is not None:
            codes = Codes.between(*ends)
        columns = edge_of(frame.cols, columns_um[window])
        return self._slice(
            "straight",
            index,
            values,
            codes,
            lines,
            across=columns,
            down=edge_of("height", s_um),
            columns=columns,
        )

    def _sampled(self, index: int, window: slice, lines: Lines, s_um: Floats) -> Floats:
        """Grey along the normals of one row, (s, columns); NaN outside the volume or the sheet.

        ``lines`` as of `_lines`, ``s_um`` are heights above the centre surface.
        """
        from scipy import ndimage

        frame = self.frame
        centre = lines["place"]
        centre_um = {
            "rows": np.full(centre.shape, self._columns_um(frame.rows)[index]),
            "cols": self._columns_um(frame.cols)[window],
            "through": centre,
        }
        is_sheet = np.isfinite(centre) & np.isfinite(lines["normal_through"])
        values = np.full((s_um.size, centre.size), np.nan)
        if not is_sheet.any():
            return values
        samples_um: Lines = {}
        for direction, um in centre_um.items():
            along_normal_um = s_um[:, None] * lines[f"normal_{direction}"][is_sheet]
            samples_um[getattr(frame, direction)] = um[is_sheet] + along_normal_um
        block, positions = voxels_around(self.volume, samples_um)
        block = block.astype(np.float32)
        values[:, is_sheet] = ndimage.map_coordinates(
            block, positions, order=1, cval=np.nan, prefilter=False
        )
        return values

    def _columns_um(self, axis: str) -> Floats:
        name = "y" if axis == self.frame.rows else "x"
        return np.asarray(self.surfaces[name].values, np.float64)

    def _edge(self, axis: Axis, window: slice) -> AxisFacts:
        return edge_of(axis, self.voxels_um(axis)[window])

    def _columns(self, axis: str, voxels: slice) -> slice:
        """The columns of the surfaces over some voxels of a lateral axis."""
        end = -(-voxels.stop // self.step)
        n_columns = self._columns_um(axis).size
        return slice(voxels.start // self.step, min(end, n_columns))

    def _surfaces_in(
        self, rows: slice, cols: slice, names: Sequence[str] | None = None
    ) -> xr.Dataset:
        """A part of the surfaces in memory; what is shown of them, where no names are given."""
        if names is None:
            stored = map(str, self.surfaces.data_vars)
            names = [k for k in stored if k in _READ_NAMES or k.startswith(_READ_PREFIXES)]
        variables = self.surfaces[[*names]]
        return variables.isel(y=rows, x=cols).load()

    def _lines(
        self, along: str, index: int, columns: slice, corrections: Corrections | None
    ) -> Lines:
        """What is known of a row or column of the surfaces, and the normals of the sheet there.

        ``along``: the lateral axis that it runs along; ``index`` counts across, ``columns`` are the
        part of it. Heights and what stands beside them by their names, NaN where unknown; ``place``
        is the centre surface; ``normal_rows``, ``normal_cols`` and ``normal_through`` make the unit
        normal, towards the top.
        """
        axis = 0 if along == self.frame.cols else 1
        neighbours = slice(max(index - 1, 0), index + 2)
        offset = index - neighbours.start
        neighbourhood = self._surfaces_in(*_in_order(neighbours, columns, axis))
        profile = neighbourhood.isel({"yx"[axis]: offset})
        lines = {str(name): data.values.astype(np.float64) for name, data in profile.items()}
        centre = self.frame.sign * neighbourhood["centre"].values.astype(np.float64)
        slopes = slopes_of(centre, pitch(self.surfaces))
        all_normals = directions(slopes, "normal")
        normals = np.take(all_normals, offset, axis=axis)
        lines["place"] = lines["centre"]
        lines["normal_rows"] = normals[:, 0]
        lines["normal_cols"] = normals[:, 1]
        lines["normal_through"] = self.frame.sign * normals[:, 2]
        # 255 where nothing was corrected.
        if "found_status" in lines:
            lines["found_status"][lines["found_status"] == 255] = np.nan
        if corrections is not None and corrections.stretches:
            window = _in_order(slice(index, index + 1), columns, axis)
            lines |= self._preview(*window, corrections)
        return lines

    def _preview(self, rows: slice, cols: slice, corrections: Corrections) -> Lines:
        """The faces of some columns as corrections would move them, in one row.

        Empty where they move nothing there.
        """
        preview = preview_faces(self.surfaces, self.volume, corrections, (rows, cols))
        if preview is None:
            return {}
        # The corrections change a window of their own, of which these columns may be a part.
        window, corrected = preview
        measured = uncorrected(self._surfaces_in(rows, cols))
        asked = (rows, cols)
        overlap = [
            slice(max(a.start, b.start), min(a.stop, b.stop))
            for a, b in zip(asked, window, strict=True)
        ]
        target = tuple(map(_relative, overlap, asked))
        source = tuple(map(_relative, overlap, window))
        faces: Lines = {}
        for face in ("top", "bottom"):
            values = measured[face].values.astype(np.float64)
            if all(s.stop > s.start for s in overlap):
                values[target] = corrected[face][source]
            faces[f"preview_{face}"] = values.ravel()
        return faces


def _in_order(across: slice, along: slice, axis: int) -> Window:
    """Rows and columns of a part that runs along rows (``axis`` 0) or along columns."""
    if axis:
        return along, across
    return across, along


_READ_NAMES = (*HEIGHTS, "status", "thickness_se")
_READ_PREFIXES = ("found_", "correction_")


def sheets_of(folder: Path, study: Study) -> dict[str, tuple[VolumeParams, Path]]:
    """Volumes of the sheets of a run, and the stores with their surfaces, by layer."""
    sheets: dict[str, tuple[VolumeParams, Path]] = {}
    for layer in study.layers:
        store = layer_run(folder, layer.name) / MAPS
        if layer.volume is not None and (store / "surfaces").is_dir():
            sheets[layer.name] = layer.volume, store
    return sheets


def _ends(values: Floats) -> Pair | None:
    """The smallest and the largest known value; None where none is known."""
    finite = values[np.isfinite(values)]
    if finite.size:
        return float(finite.min()), float(finite.max())
    return None


def contour(height: Floats, x: Floats, y: Floats) -> Floats:
    """Segments along which a field (y, x) crosses 0, linear between its nodes.

    Shape (n, 4: x0, y0, x1, y1).
    """
    if min(height.shape) < 2:
        return np.empty((0, 4))
    masked = np.ma.masked_invalid(height)
    generator = contour_generator(x, y, masked, line_type=LineType.Separate, corner_mask=False)
    # Each line (points, 2) is cut into segments from one point to the next.
    lines: Any = generator.lines(0.0)
    segments = [np.hstack([line[:-1], line[1:]]) for line in lines]
    return np.concatenate([np.empty((0, 4)), *segments])


def _relative(inner: slice, outer: slice) -> slice:
    return slice(inner.start - outer.start, inner.stop - outer.start)


def _window(coordinates: Floats, near_um: float | None) -> slice:
    """At most ``WIDEST`` places, around one of them."""
    if coordinates.size <= WIDEST:
        return slice(0, coordinates.size)
    middle = coordinates.size // 2
    if near_um is not None:
        middle = int(np.abs(coordinates - near_um).argmin())
    last_start = coordinates.size - WIDEST
    first = min(max(middle - WIDEST // 2, 0), last_start)
    return slice(first, first + WIDEST)


def edge_of(name: Literal["z", "y", "x", "height"], coordinates: Floats) -> AxisFacts:
    """Give the edge of a slice along which its pixels have these places."""
    first_um = float(coordinates[0])
    step_um = step_of(coordinates)
    return AxisFacts(name=name, first_um=first_um, step_um=step_um, count=coordinates.size)
