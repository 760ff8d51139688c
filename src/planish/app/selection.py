"""Values of pictures at a point, along a line and in a region; densities and histograms from an overview."""

from __future__ import annotations

import base64
import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.analyze import correlate
from planish.app.picture import Answer, PlanePicture, finite_or_none
from planish.app.pictures import Tiles
from planish.core.bands import band_of, bands
from planish.core.errors import InputError
from planish.core.lazy import LazyArray, Where, held
from planish.core.typing import Bools, Floats
from planish.pipeline.evidence import CELLS

MOST_SAMPLES = 2000
"""Pixels along a profile; a longer line is read from a coarser level."""


class ValueAt(Answer):
    """Value of one picture at a point; None where it has none."""

    id: str
    layer: str
    name: str
    title: str
    units: str
    value: float | None


class VolumePlace(Answer):
    """Place of the centre surface in the volume, in um along its axes."""

    layer: str
    x: float
    y: float
    z: float


class Cursor(Answer):
    """All values at a point (x, y) of a plane, in um, and the place in the volume that it shows."""

    x: float
    y: float
    row: int | None
    col: int | None
    values: tuple[ValueAt, ...]
    volume: VolumePlace | None


class ProfileOf(Answer):
    """Values of one picture along a line."""

    id: str
    name: str
    units: str
    values: tuple[float | None, ...]


class Profile(Answer):
    """Values along a line at ``at_um`` from its beginning, of pixels that are ``pixel_um`` wide."""

    pixel_um: float
    at_um: tuple[float, ...]
    lines: tuple[ProfileOf, ...]


def cursor(tiles: Tiles, picture: PlanePicture, x: float, y: float) -> Cursor:
    """Values of all pictures on the pixels of one, at the pixel that holds a point."""
    rows, cols, (inside,) = _pixels(picture, np.array([[x, y]]), 0)
    pictures = tiles.pictures.on_same_pixels(picture)
    value_of = {p.id: finite_or_none(tiles.values_at(p, 0, rows, cols)[0]) if inside else None for p in pictures}
    volume, places = None, {(p.layer, p.name.split("/")[-1]): value_of[p.id] for p in pictures}
    for layer in dict.fromkeys([picture.layer, *(p.layer for p in pictures)]):  # its own, or the first that has it
        place = [places.get((layer, f"volume_{axis}")) for axis in "xyz"]
        if None not in place:
            volume = VolumePlace.model_validate({"layer": layer} | dict(zip("xyz", place, strict=True)))
            break
    return Cursor(
        x=x, y=y, row=int(rows[0]) if inside else None, col=int(cols[0]) if inside else None,
        values=tuple(
            ValueAt(id=p.id, layer=p.layer, name=p.name, title=p.title, units=p.units, value=value_of[p.id])
            for p in pictures
        ),
        volume=volume,
    )  # fmt: skip


def profile(tiles: Tiles, pictures: list[PlanePicture], line: tuple[float, float, float, float]) -> Profile:
    """Values of pictures on one grid along the line from (x0, y0) to (x1, y1) in um, each of the pixel it crosses."""
    x0, y0, x1, y1 = line
    length = math.hypot(x1 - x0, y1 - y0)
    if length == 0:
        raise InputError("The line has no length. Give two places: x0, y0, x1, y1 in um.")
    first = pictures[0]
    pixel = min(first.grid.pixel_um)
    coarsest = len(first.levels) - 1
    level = min(max(0, math.ceil(math.log2(length / pixel / MOST_SAMPLES))), coarsest)
    step = pixel * 2**level
    distances_um = np.linspace(0, length, min(int(length / step), 4 * MOST_SAMPLES) + 1)
    points = np.array([x0, y0]) + (distances_um / length)[:, None] * np.array([x1 - x0, y1 - y0])
    rows, cols, inside = _pixels(first, points, level)
    lines: list[ProfileOf] = []
    for picture in pictures:
        values = np.full(distances_um.size, np.nan)
        values[inside] = tiles.values_at(picture, level, rows[inside], cols[inside])
        lines.append(
            ProfileOf(id=picture.id, name=picture.name, units=picture.units, values=tuple(map(finite_or_none, values)))
        )
    return Profile(pixel_um=step, at_um=tuple(distances_um.tolist()), lines=tuple(lines))


def _pixels(picture: PlanePicture, points: Floats, level: int) -> tuple[NDArray[np.intp], NDArray[np.intp], Bools]:
    """Rows and columns of the pixels of a level that hold points (n, 2: x, y), and which lie in the picture.

    Pixels of all levels share one corner.
    """
    (x0, y0), (dy, dx) = picture.grid.origin_um, picture.grid.pixel_um
    rows = np.floor((points[:, 1] - y0) / dy + 0.5).astype(np.intp) >> level
    cols = np.floor((points[:, 0] - x0) / dx + 0.5).astype(np.intp) >> level
    height, width = picture.levels[level].shape
    return rows, cols, (rows >= 0) & (rows < height) & (cols >= 0) & (cols < width)


BASE_PIXELS = 4_000_000
"""Pixels of the overview from which densities and histograms are made."""

_BINS = 128

Window = tuple[slice, slice]


class Density(Answer):
    """How many points lie where in the plane of two quantities, of pixels of the stated size.

    ``counts`` are little-endian 32-bit numbers in base64, ``bins`` x ``bins``, rows of b from ``b_low`` up.
    """

    pixel_um: tuple[float, float]
    n: int
    beyond: int
    bins: int
    a_low: float
    a_high: float
    b_low: float
    b_high: float
    counts: str


class Histogram(Answer):
    """How the values of a picture are distributed, of pixels of the stated size; ``range``: 2nd to 98th percentile."""

    pixel_um: tuple[float, float]
    n: int
    beyond: int
    low: float
    high: float
    range: tuple[float, float]
    counts: tuple[int, ...]
    mean: float | None
    sd: float | None
    median: float | None


class Selected(Answer):
    """Pixels that were selected, at full resolution; what is said of r holds for a region, not for picked values."""

    n: int
    pixel_um: tuple[float, float]
    r: float | None = None
    n_eff: float | None = None
    interval: tuple[float, float] | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Brush:
    """Pixels of a picture whose value lies from ``low`` to ``high``."""

    picture: PlanePicture
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Rectangle:
    """Pixels whose middle lies in a rectangle, in um of the plane."""

    x0: float
    y0: float
    x1: float
    y1: float

    def on(self, picture: PlanePicture, level: int = 0) -> Window:
        """Rows and columns of a level of a picture; InputError where it holds none of them."""
        data = picture.levels[level]
        (y, x), (dy, dx) = (data[dim].values for dim in data.dims), picture.grid.pixel_um
        rows, cols = _between(y, self.y0, self.y1, dy), _between(x, self.x0, self.x1, dx)
        if rows.start >= rows.stop or cols.start >= cols.stop:
            raise InputError("No pixel lies in this region. Give x0, y0, x1, y1 in um, within the map.")
        return rows, cols


class Stopped(Exception):
    """The page does not want the answer any more."""


def density(tiles: Tiles, a: PlanePicture, b: PlanePicture, window: Rectangle | None = None) -> Density:
    """Count the points of two pictures in the plane of their values.

    The limits are those of all points, also where only a region is counted.
    """
    level, (x, y) = _overview(tiles, a, b)
    limits = [_limits(values[np.isfinite(x) & np.isfinite(y)]) for values in (x, y)]
    if window is not None:
        part = window.on(a, level)
        x, y = x[part], y[part]
    is_valid = np.isfinite(x) & np.isfinite(y)
    places = [
        np.floor((values[is_valid] - low) * (_BINS / (high - low))).astype(np.int64)
        for values, (low, high) in zip((x, y), limits, strict=True)
    ]
    shown = np.logical_and(*((at >= 0) & (at < _BINS) for at in places))
    counts = np.bincount((places[1] * _BINS + places[0])[shown], minlength=_BINS**2).astype("<u4")
    n = int(np.count_nonzero(is_valid))
    (a_low, a_high), (b_low, b_high) = limits
    return Density(
        pixel_um=_pixel(a, level), n=n, beyond=n - int(np.count_nonzero(shown)), bins=_BINS, a_low=a_low, a_high=a_high,
        b_low=b_low, b_high=b_high, counts=base64.b64encode(counts.tobytes()).decode("ascii"),
    )  # fmt: skip


def histogram(tiles: Tiles, picture: PlanePicture, window: Rectangle | None = None) -> Histogram:
    """Count the values of a picture where they are valid."""
    level, (values,) = _overview(tiles, picture)
    every = values[np.isfinite(values)]
    (low, high), usual = _limits(every), np.percentile(every, [2, 98]) if every.size else (0.0, 1.0)
    if window is not None:
        values = values[window.on(picture, level)]
    finite = values[np.isfinite(values)].astype(np.float64)
    counts, _ = np.histogram(finite, bins=_BINS, range=(low, high))
    return Histogram(
        pixel_um=_pixel(picture, level), n=finite.size, beyond=finite.size - int(counts.sum()), low=low, high=high,
        range=(float(usual[0]), float(usual[1])), counts=tuple(counts.tolist()),
        mean=float(finite.mean()) if finite.size else None,
        sd=float(finite.std(ddof=1)) if finite.size > 1 else None,
        median=float(np.median(finite)) if finite.size else None,
    )  # fmt: skip


def _between(places: Floats, low: float, high: float, step: float) -> slice:
    slack = 1e-6 * step  # a border through the middle of a pixel takes it in, whatever was rounded
    return slice(
        int(np.searchsorted(places, min(low, high) - slack, "left")),
        int(np.searchsorted(places, max(low, high) + slack, "right")),
    )


def select(
    tiles: Tiles, a: PlanePicture, b: PlanePicture, *, region: Rectangle | None = None, brushes: Sequence[Brush] = (),
    stop: threading.Event | None = None,
) -> Selected:  # fmt: skip
    """Count what is selected at full resolution; of a region also say how two pictures are correlated in it.

    Raises
    ------
    Stopped
        Once ``stop`` is set.
    """
    stop, pixel = stop or threading.Event(), a.grid.pixel_um
    window: Window = (slice(None), slice(None)) if region is None else region.on(a)
    x, y = (_lazy_array(_Stoppable(p.full[window], stop), p.full[window]) for p in (a, b))
    masks = [p.full[window] for p in tiles.pictures.valid_of(a, b)]
    if brushes:
        chosen = [(brush, brush.picture.full[window]) for brush in brushes]
        n = 0
        for rows in bands(x.shape[0]):
            use = np.isfinite(band_of(x, rows)) & np.isfinite(band_of(y, rows))
            for mask in masks:
                use &= band_of(mask, rows)
            for brush, values in chosen:
                band = band_of(values, rows)
                use &= (band >= brush.low) & (band <= brush.high)
            n += int(np.count_nonzero(use))
        return Selected(n=n, pixel_um=pixel)
    every = None if not masks else masks[0] if len(masks) == 1 else _lazy_array(_AllMasks(masks), masks[0])
    row = correlate(x, y, mask=every, pixel_um=pixel, most_cells=CELLS)  # as a run does: its whole map gives its n_eff
    low, high = row.interval
    return Selected(
        n=row.n, pixel_um=pixel, r=finite_or_none(row.r), n_eff=finite_or_none(row.n_eff),
        interval=(low, high) if math.isfinite(low) and math.isfinite(high) else None, warnings=row.warnings,
    )  # fmt: skip


class _AllMasks(LazyArray):
    """True where all masks are."""

    def __init__(self, masks: Sequence[xr.DataArray]) -> None:
        self._masks, self.shape, self.dtype = masks, masks[0].shape, np.dtype(np.bool_)

    def read(self, where: Where) -> Bools:
        """Read a part."""
        return np.logical_and.reduce([mask[where].values for mask in self._masks])


class _Stoppable(LazyArray):
    """Values of which none are read any more once they are not wanted."""

    def __init__(self, values: xr.DataArray, stop: threading.Event) -> None:
        self._values, self._stop = values, stop
        self.shape, self.dtype = values.shape, values.dtype

    def read(self, where: Where) -> NDArray[np.floating]:
        """Read a part."""
        if self._stop.is_set():
            raise Stopped
        return self._values[where].values


def _lazy_array(values: LazyArray, like: xr.DataArray) -> xr.DataArray:
    return xr.DataArray(xr.Variable(like.dims, held(values)), coords=like.coords)


def _overview(tiles: Tiles, *pictures: PlanePicture) -> tuple[int, list[Floats]]:
    """A level of few pixels, and the values of pictures there; NaN where they do not count."""
    level = pictures[0].level_within(BASE_PIXELS)
    whole = tuple(slice(0, n) for n in pictures[0].levels[level].shape)
    masks = [tiles.window(p, level, whole[0], whole[1]) for p in tiles.pictures.valid_of(*pictures)]
    use = np.logical_and.reduce(masks) if masks else True
    return level, [
        np.where(use, tiles.window(p, level, whole[0], whole[1]).astype(np.float64), np.nan) for p in pictures
    ]


def _limits(values: Floats) -> tuple[float, float]:
    """Between which nearly all values lie, with a little room."""
    if values.size == 0:
        return 0.0, 1.0
    # Percentiles between which points are drawn; those beyond are counted.
    low, high = (float(v) for v in np.percentile(values, (0.1, 99.9)))
    room = 0.02 * (high - low) or 0.5
    return low - room, high + room


def _pixel(picture: PlanePicture, level: int) -> tuple[float, float]:
    down, across = picture.grid.pixel_um
    return down * 2**level, across * 2**level
