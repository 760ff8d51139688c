"""Slices of a volume with the surfaces in them, read by window from the volume's file and the store of the run."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydantic import Field

from planish.app.picture import Answer, Codes, layer_run
from planish.core.errors import FileError, InputError
from planish.core.frame import Axis, Frame
from planish.core.grid import pitch
from planish.core.lazy import read_box
from planish.core.memory import LOOK_BYTES
from planish.core.typing import Floats
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


class AxisFacts(Answer):
    """One edge of a slice: the place of pixel k is ``first_um + k * step_um``."""

    name: Literal["z", "y", "x", "height"]
    first_um: float
    step_um: float
    count: int


class SliceFacts(Answer):
    """A slice and what was found in it.

    Attributes
    ----------
    direction : {"z", "y", "x", "straight"}
        Axis across the slice; ``straight`` is straightened along the normals of the centre surface.
    normal : str
        Axis along which slices of this direction follow each other.
    index, at_um
        Which slice it is, and where it lies along ``normal``.
    across, down : AxisFacts
        Edges; the top of the sheet is up.
    scale, offset : float
        A value of 16 bits stands for ``offset + scale * value``.
    missing : int
        Value of voxels that are missing; -1 where there are none.
    lines : tuple of str
        Names of the lines, float32 each, one value a column of the surfaces.
    columns : AxisFacts or None
        Where these columns lie along ``across``.
    segments : dict of int
        Of a slice along the sheet: how many segments x0, y0, x1, y1 in um each contour has.
    """

    layer: str
    direction: Direction
    normal: Axis
    index: int
    at_um: float
    across: AxisFacts
    down: AxisFacts
    scale: float
    offset: float
    missing: int
    lines: tuple[str, ...] = ()
    columns: AxisFacts | None = None
    segments: dict[str, int] = Field(default_factory=dict[str, int])


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetSlice:
    """A slice as it is sent: pixels (down, across), lines (columns,) and contours (n, 4)."""

    facts: SliceFacts
    pixels: NDArray[np.uint16]
    lines: Sequence[NDArray[np.float32]]
    contours: Sequence[NDArray[np.float32]]


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
        """Open the volume and the surfaces of a sheet.

        Raises
        ------
        FileError
            If the volume is not there any more, is damaged, or is a folder of serial sections.
        """
        path = find_place(params.path).path
        if is_section_folder(path):
            raise FileError(
                f"{path.name} holds serial sections, which are no volume until they are joined. To see slices, import "
                f"them (planish import {path.name} --through {params.through} --out {path.name}.zarr) and map that."
            )
        volume = read_volume(params.path, **params.how, memory_bytes=LOOK_BYTES)
        codes = None
        if volume.dtype not in _EXACT:
            plane = volume[volume.shape[0] // 2].values
            finite = plane[np.isfinite(plane)].astype(np.float64)
            low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
            codes = Codes.between(low - (high - low), high + (high - low))
        return cls(name=name, volume=volume, surfaces=stored_group(store, "surfaces"), codes=codes)

    @property
    def frame(self) -> Frame:
        """How the sheet lies in the volume."""
        return Frame.of(self.surfaces)

    @property
    def step(self) -> int:
        """Voxels along the edge of a column of the surfaces."""
        return max(1, self.volume.sizes[self.frame.rows] // max(self.surfaces.sizes["y"], 1))

    def places(self, axis: str) -> Floats:
        """Places of the voxels along an axis, um."""
        return np.asarray(self.volume.coords[axis].values, dtype=np.float64)

    def count(self, direction: Direction) -> int:
        """Slices of a direction."""
        return self.surfaces.sizes["y"] if direction == "straight" else self.volume.sizes[direction]

    def _slice(
        self, direction: Direction, index: int, values: NDArray[Any], codes: Codes | None,
        lines: Mapping[str, Floats] | None = None, contours: Mapping[str, Floats] | None = None,
        **axes: AxisFacts,
    ) -> SheetSlice:  # fmt: skip
        """Put a slice together, its values in 16 bits."""
        lines, contours = lines or {}, contours or {}
        if codes is None:
            pixels, scale, offset = values.astype(np.uint16), 1.0, 0.0
        else:
            pixels, scale, offset = codes.of(values), codes.scale, codes.offset - codes.scale
        normal = self.frame.rows if direction == "straight" else direction
        places = self._column_places(normal) if direction == "straight" else self.places(normal)
        facts = SliceFacts(
            layer=self.name, direction=direction, normal=normal, index=index, at_um=float(places[index]), scale=scale,
            offset=offset, missing=-1 if codes is None else 0, lines=tuple(lines),
            segments={name: len(part) for name, part in contours.items()}, **axes,
        )  # fmt: skip
        floats, segments = ([part.astype(np.float32) for part in parts.values()] for parts in (lines, contours))
        return SheetSlice(facts=facts, pixels=pixels, lines=floats, contours=segments)

    def cut(
        self, direction: Direction, index: int, *, near_um: Near = (None, None),
        corrections: Corrections | None = None,
    ) -> SheetSlice:  # fmt: skip
        """One slice.

        Parameters
        ----------
        direction : {"z", "y", "x", "straight"}
        index : int
            Voxel along the direction's axis; row of the surfaces' columns where it is straightened.
        near_um : (float or None, float or None)
            Place across and down around which a large slice is cut; its middle where None.
        corrections : Corrections, optional
            What is seen as ``preview_top`` and ``preview_bottom``.

        Raises
        ------
        InputError
            If there is no such slice.
        """
        if not 0 <= index < self.count(direction):
            raise InputError(f"There is no slice {index} along {direction}; there are {self.count(direction)}.")
        with self._lock:  # decoders of files are not all made for several threads
            if direction == "straight":
                return self._straight(index, near_um, corrections)
            if direction == self.frame.through:
                return self._along(index, near_um)
            return self._across(direction, index, near_um, corrections)

    def _across(self, direction: Axis, index: int, near_um: Near, corrections: Corrections | None) -> SheetSlice:
        """A slice through the sheet, with its top up."""
        f = self.frame
        other: Axis = f.cols if direction == f.rows else f.rows
        along, down = _window(self.places(other), near_um[0]), _window(self.places(f.through), near_um[1])
        values = read_box(self.volume, {f.through: down, other: along, direction: slice(index, index + 1)})[..., 0]
        depth = self.places(f.through)[down]
        if f.top == "high":
            values, depth = values[::-1], depth[::-1]
        line = min(index // self.step, self._column_places(direction).size - 1)
        columns = self._columns(other, along)
        lines = self._lines(other, line, columns, corrections)
        return self._slice(
            direction, index, values, self.codes, lines, across=self._edge(other, along),
            down=edge_of(f.through, depth), columns=edge_of(other, self._column_places(other)[columns]),
        )  # fmt: skip

    def _along(self, index: int, near_um: Near) -> SheetSlice:
        """A slice along the sheet, with the contours of its surfaces."""
        f = self.frame
        cols, rows = _window(self.places(f.cols), near_um[0]), _window(self.places(f.rows), near_um[1])
        values = read_box(self.volume, {f.rows: rows, f.cols: cols, f.through: slice(index, index + 1)})[..., 0]
        height = float(self.places(f.through)[index])
        surfaces = self.surfaces.isel(y=self._columns(f.rows, rows), x=self._columns(f.cols, cols))
        x, y = surfaces["x"].values, surfaces["y"].values
        contours = {name: contour(surfaces[name].values - height, x, y) for name in HEIGHTS}
        return self._slice(
            f.through, index, values, self.codes, contours=contours, across=self._edge(f.cols, cols),
            down=self._edge(f.rows, rows),
        )  # fmt: skip

    def _straight(self, index: int, near_um: Near, corrections: Corrections | None) -> SheetSlice:
        """One row of columns, straightened along the normals."""
        f = self.frame
        places = self._column_places(f.cols)
        window = _window(places, near_um[0])
        lines = self._lines(f.cols, index, window, corrections)
        thickness = float(self.surfaces.attrs["thickness_um"])
        size = abs(float(np.diff(self.places(f.through)[:2])[0]))
        half = int(np.ceil(1.5 * thickness / size))  # it reaches so far to both sides of the centre surface
        s = size * np.arange(half, -half - 1, -1).astype(np.float64)
        values = self._sampled(index, window, lines, s)
        halo = int(np.ceil(1.5 * thickness / min(pitch(self.surfaces)))) + 2
        first = max(index - halo, 0)
        _, faces = meet(self._read(slice(first, index + halo + 1), window, (*HEIGHTS, "status")), "normal")
        for name in HEIGHTS:
            lines[name] = np.zeros(places[window].size) if name == "centre" else faces[name][index - first]
        lines = {name: line for name, line in lines.items() if not name.startswith(("preview", "found"))}
        finite = values[np.isfinite(values)]
        codes = self.codes or Codes(-1.0, 1.0)
        if self.codes is None and finite.size:
            codes = Codes.between(float(finite.min()), float(finite.max()))
        columns = edge_of(f.cols, places[window])
        return self._slice(
            "straight", index, values, codes, lines, across=columns, down=edge_of("height", s), columns=columns
        )

    def _sampled(self, index: int, window: slice, lines: dict[str, Floats], s: Floats) -> Floats:
        """Grey along the normals of one row, (s, columns)."""
        from scipy import ndimage

        f = self.frame
        centre = lines["place"]
        normal = {getattr(f, part): lines[f"normal_{part}"] for part in ("rows", "cols", "through")}
        row_um, cols_um = self._column_places(f.rows)[index], self._column_places(f.cols)[window]
        places = {f.rows: np.full(centre.shape, row_um), f.cols: cols_um, f.through: centre}
        is_sheet = np.isfinite(centre) & np.isfinite(normal[f.through])
        values = np.full((s.size, centre.size), np.nan)
        if not is_sheet.any():
            return values
        along = {axis: places[axis][is_sheet] + s[:, None] * normal[axis][is_sheet] for axis in places}
        block, where = voxels_around(self.volume, along)
        block = block.astype(np.float32)
        values[:, is_sheet] = ndimage.map_coordinates(block, where, order=1, cval=np.nan, prefilter=False)
        return values

    def _column_places(self, axis: str) -> Floats:
        return np.asarray(self.surfaces["y" if axis == self.frame.rows else "x"].values, dtype=np.float64)

    def _edge(self, axis: Axis, window: slice) -> AxisFacts:
        return edge_of(axis, self.places(axis)[window])

    def _columns(self, axis: str, voxels: slice) -> slice:
        """The columns of the surfaces in which voxels lie."""
        return slice(voxels.start // self.step, min(-(-voxels.stop // self.step), self._column_places(axis).size))

    def _read(self, rows: slice, cols: slice, names: Sequence[str] | None = None) -> xr.Dataset:
        """A window of the surfaces, in memory."""
        names = names or [str(n) for n in self.surfaces.data_vars if n in _READ or str(n).startswith(_READ_PREFIXES)]
        return self.surfaces[list(names)].isel(y=rows, x=cols).load()

    def _lines(self, along: str, index: int, columns: slice, corrections: Corrections | None) -> dict[str, Floats]:
        """Read one row, or column, of the surfaces, with its normals."""
        of_rows = along == self.frame.cols
        neighbours = slice(max(index - 1, 0), index + 2)
        near = self._read(*((neighbours, columns) if of_rows else (columns, neighbours)))
        profile = near.isel({"y" if of_rows else "x": index - neighbours.start})
        lines = {name: profile[name].values.astype(np.float64) for name in HEIGHTS}
        centre = self.frame.sign * near["centre"].values.astype(np.float64)
        normal = directions(slopes_of(centre, pitch(self.surfaces)), "normal")
        normals = normal[index - neighbours.start] if of_rows else normal[:, index - neighbours.start]
        lines |= {"place": lines["centre"], "normal_rows": normals[:, 0], "normal_cols": normals[:, 1]}
        lines["normal_through"] = self.frame.sign * normals[:, 2]
        for name in ("thickness_se", "status", *(n for n in profile.data_vars if str(n).startswith(_READ_PREFIXES))):
            if name in profile:
                values = profile[name].values.astype(np.float64)
                lines[str(name)] = np.where(values == 255, np.nan, values) if name == "found_status" else values
        if corrections is not None and corrections.stretches:
            row, col = (slice(index, index + 1), columns) if of_rows else (columns, slice(index, index + 1))
            lines |= self._preview(row, col, corrections)
        return lines

    def _preview(self, rows: slice, cols: slice, corrections: Corrections) -> dict[str, Floats]:
        """The faces in some columns as corrections would leave them."""
        if (preview := preview_faces(self.surfaces, self.volume, corrections, (rows, cols))) is None:
            return {}
        window, drawn = preview
        whole = uncorrected(self._read(rows, cols))
        shared = [slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in zip((rows, cols), window, strict=True)]
        target, source = (tuple(map(_within, shared, part)) for part in ((rows, cols), window))
        faces: dict[str, Floats] = {}
        for face in ("top", "bottom"):
            values = whole[face].values.astype(np.float64)
            if all(part.stop > part.start for part in shared):
                values[target] = drawn[face][source]
            faces[f"preview_{face}"] = values.ravel()
        return faces


_READ = (*HEIGHTS, "status", "thickness_se")
_READ_PREFIXES = ("found_", "correction_")


def sheets_of(folder: Path, study: Study) -> dict[str, tuple[VolumeParams, Path]]:
    """Volumes of the sheets of a run, and the stores with their surfaces, by layer."""
    sheets: dict[str, tuple[VolumeParams, Path]] = {}
    for layer in study.layers:
        store = layer_run(folder, layer.name) / MAPS
        if layer.volume is not None and (store / "surfaces").is_dir():
            sheets[layer.name] = layer.volume, store
    return sheets


def contour(height: Floats, x: Floats, y: Floats) -> Floats:
    """Segments (n, 4: x0, y0, x1, y1) along which a field (y, x) crosses 0, linear between its nodes."""
    value = np.asarray(height, dtype=np.float64)
    corners = np.stack([value[:-1, :-1], value[:-1, 1:], value[1:, 1:], value[1:, :-1]])
    above = corners >= 0
    cells = np.flatnonzero((np.isfinite(corners).all(axis=0) & above.any(axis=0) & ~above.all(axis=0)).ravel())
    rows, cols = np.unravel_index(cells, corners.shape[1:]) if cells.size else (cells, cells)
    picked = corners[:, rows, cols]
    at_x = np.stack([x[cols], x[cols + 1], x[cols + 1], x[cols]])
    at_y = np.stack([y[rows], y[rows], y[rows + 1], y[rows + 1]])
    ends: list[Floats] = []
    for k in range(4):
        n = (k + 1) % 4
        crosses = (picked[k] >= 0) != (picked[n] >= 0)
        share = np.zeros(crosses.shape)
        np.divide(picked[k], picked[k] - picked[n], out=share, where=crosses)
        place = np.stack([at_x[k] + share * (at_x[n] - at_x[k]), at_y[k] + share * (at_y[n] - at_y[k])], axis=-1)
        ends.append(np.where(crosses[:, None], place, np.nan))
    # Two edges of a cell are crossed, or at a saddle all four: its crossings then belong together in pairs.
    crossings = np.stack(ends, axis=1)
    order = np.argsort(np.isnan(crossings[..., 0]), axis=1, kind="stable")
    sorted_ends = np.take_along_axis(crossings, order[..., None], axis=1)
    first, second = sorted_ends[:, :2].reshape(-1, 4), sorted_ends[:, 2:].reshape(-1, 4)
    return np.concatenate([first, second[np.isfinite(second).all(axis=1)]])


def _within(part: slice, whole: slice) -> slice:
    return slice(part.start - whole.start, part.stop - whole.start)


def _window(places: Floats, near_um: float | None) -> slice:
    """At most ``WIDEST`` places, around one of them."""
    if places.size <= WIDEST:
        return slice(0, places.size)
    middle = places.size // 2 if near_um is None else int(np.abs(places - near_um).argmin())
    first = int(np.clip(middle - WIDEST // 2, 0, places.size - WIDEST))
    return slice(first, first + WIDEST)


def edge_of(name: Literal["z", "y", "x", "height"], places: Floats) -> AxisFacts:
    """Give the edge of a slice along which its pixels have these places."""
    step = float(places[1] - places[0]) if places.size > 1 else 1.0
    return AxisFacts(name=name, first_um=float(places[0]), step_um=step, count=places.size)
