"""Values of pictures at a point, along a line and in a region.

Densities and histograms from an overview.
"""

import base64
import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.analyze import correlate
from planish.analyze.compare import CELLS
from planish.app.picture import PlanePicture, finite_or_none
from planish.app.pictures import Tiles
from planish.core.area import valid_in_all
from planish.core.axial import distribution, is_axial, summable
from planish.core.bands import read_bands
from planish.core.errors import InputError
from planish.core.facts import is_known
from planish.core.grid import Grid, centres_of, hole_mask
from planish.core.labelled import computed
from planish.core.lazy import Where
from planish.core.typing import Bools, Entries, Floats, Ints, Pair, Window
from planish.measure.registry import NEGATIVE_CONTROLS

MOST_SAMPLES = 2000
"""Pixels along a profile; a longer line is read from a coarser level."""


def cursor(tiles: Tiles, picture: PlanePicture, x: float, y: float) -> Entries:
    """Values at a point of all pictures on the pixels of one, and its place in the volume in um.

    Missing values are None.
    """
    point_um = np.array([[x, y]])
    rows, cols, (is_inside,) = _pixels(picture, point_um, 0)
    values: list[Entries] = []
    # Values by variable, by layer: its own place in a volume, or that of the first layer that has
    # one.
    of_layers: dict[str, dict[str, float | None]] = {picture.layer: {}}
    for p in tiles.pictures.on_same_pixels(picture):
        value = None
        if is_inside:
            value = finite_or_none(tiles.values_at(p, 0, rows, cols)[0])
        described = {key: getattr(p, key) for key in ("id", "layer", "name", "title", "units")}
        values.append(described | {"value": value})
        of_layers.setdefault(p.layer, {})[p.variable] = value
    volume = None
    for layer, of_layer in of_layers.items():
        position = {axis: of_layer.get(f"volume_{axis}") for axis in "xyz"}
        if None not in position.values():
            volume = {"layer": layer} | position
            break
    return {
        "x": x,
        "y": y,
        "row": int(rows[0]) if is_inside else None,
        "col": int(cols[0]) if is_inside else None,
        "values": values,
        "volume": volume,
    }


def nearest(
    tiles: Tiles, picture: PlanePicture, layer: str, place_um: dict[str, float]
) -> Pair | None:
    """Find where in a plane, (x, y) in um, the sheet of a layer lies nearest to a place.

    The place is given along some axes of the volume.
    """
    pictures = tiles.pictures.on_same_pixels(picture)
    of_layer = {p.variable: p for p in pictures if p.layer == layer or p.plane == "fixed"}
    maps = [of_layer[f"volume_{axis}"] for axis in place_um if f"volume_{axis}" in of_layer]
    if len(maps) < len(place_um):
        return None
    level, positions_um = _overview(tiles, *maps)
    wanted_um = np.array([*place_um.values()])[:, None, None]
    offsets_um = np.stack(positions_um) - wanted_um
    square_distance = np.sum(offsets_um**2, axis=0)
    if not np.isfinite(square_distance).any():
        return None
    row, col = np.unravel_index(np.nanargmin(square_distance), square_distance.shape)
    grid = Grid.of(picture.levels[level])
    return float(grid.x_um[col]), float(grid.y_um[row])


def profile(
    tiles: Tiles, pictures: list[PlanePicture], line: tuple[float, float, float, float]
) -> Entries:
    """Values along a line (x0, y0, x1, y1) in um, at ``at_um``, of pixels ``pixel_um`` wide.

    Of each picture, which are on the same pixels; None in holes and outside.
    """
    x0, y0, x1, y1 = line
    length_um = math.hypot(x1 - x0, y1 - y0)
    if length_um == 0:
        raise InputError("The line has no length. Give two places: x0, y0, x1, y1 in um.")
    grid_picture = pictures[0]
    pixel_um = min(grid_picture.grid.pixel_um)
    level = max(0, math.ceil(math.log2(length_um / pixel_um / MOST_SAMPLES)))
    level = min(level, len(grid_picture.levels) - 1)
    step_um = pixel_um * 2**level
    n_steps = min(int(length_um / step_um), 4 * MOST_SAMPLES)
    distances_um = np.linspace(0, length_um, n_steps + 1)
    shares = distances_um / length_um
    points_um = np.array([x0, y0]) + shares[:, None] * (x1 - x0, y1 - y0)
    rows, cols, is_inside = _pixels(grid_picture, points_um, level)
    lines: list[Entries] = []
    for picture in pictures:
        values = np.full(distances_um.size, np.nan)
        place = (level, rows[is_inside], cols[is_inside])
        values[is_inside] = tiles.values_at(picture, *place)
        for mask in tiles.pictures.valid_of(picture):
            is_valid = tiles.values_at(mask, *place)
            values[is_inside] = np.where(is_valid, values[is_inside], np.nan)
        described = {key: getattr(picture, key) for key in ("id", "name", "units")}
        lines.append(described | {"values": [*map(finite_or_none, values)]})
    return {"pixel_um": step_um, "at_um": distances_um.tolist(), "lines": lines}


def _pixels(picture: PlanePicture, points_um: Floats, level: int) -> tuple[Ints, Ints, Bools]:
    """Rows and columns of a level's pixels that hold points (n, 2: x, y), and which lie in it.

    Levels share corners.
    """
    dy, dx = picture.grid.pixel_um
    # Columns and rows of full resolution, 0 at the corner of the first pixel.
    places = (points_um - picture.grid.origin_um) / (dx, dy) + 0.5
    cols, rows = np.floor(places).astype(np.intp).T >> level
    n_rows, n_cols = picture.levels[level].shape
    is_inside = (rows >= 0) & (rows < n_rows) & (cols >= 0) & (cols < n_cols)
    return rows, cols, is_inside


BASE_PIXELS = 4_000_000
"""Pixels of the overview from which densities and histograms are made."""

_BINS = 128
_RIM = 0.75  # of a hole's diameter: its rim ends within


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
        grid = Grid.of(picture.levels[level])
        dy, dx = picture.grid.pixel_um
        rows = _pixels_between(grid.y_um, self.y0, self.y1, dy)
        cols = _pixels_between(grid.x_um, self.x0, self.x1, dx)
        if rows.start >= rows.stop or cols.start >= cols.stop:
            raise InputError(
                "No pixel lies in this region. Give x0, y0, x1, y1 in um, within the map."
            )
        return rows, cols


class Stopped(Exception):
    """The page does not want the answer any more."""


def density(
    tiles: Tiles, a: PlanePicture, b: PlanePicture, region: Rectangle | None = None
) -> Entries:
    """Count the points of two pictures in the plane of their values, of pixels of the stated size.

    The limits are those of all points, also where only a region is counted; ``beyond`` lie outside
    of them. ``counts`` are little-endian 32-bit numbers in base64, ``bins`` x ``bins``, rows of b
    from ``b_low`` up.
    """
    level, (x, y) = _overview(tiles, a, b)
    is_valid = np.isfinite(x) & np.isfinite(y)
    (a_low, a_high), (b_low, b_high) = (_limits(values[is_valid]) for values in (x, y))
    if region is not None:
        window = region.on(a, level)
        x = x[window]
        y = y[window]
        is_valid = is_valid[window]
    cols = _bins_of(x[is_valid], a_low, a_high)
    rows = _bins_of(y[is_valid], b_low, b_high)
    is_within = (np.minimum(rows, cols) >= 0) & (np.maximum(rows, cols) < _BINS)
    cells = (rows * _BINS + cols)[is_within]
    counts = np.bincount(cells, minlength=_BINS**2).astype("<u4")
    return {
        "pixel_um": _pixel_um(a, level),
        "n": rows.size,
        "beyond": rows.size - cells.size,
        "bins": _BINS,
        "a_low": a_low,
        "a_high": a_high,
        "b_low": b_low,
        "b_high": b_high,
        "counts": base64.b64encode(counts.tobytes()).decode("ascii"),
    }


def _bins_of(values: Floats, low: float, high: float) -> NDArray[np.int64]:
    """Numbers of the bins between two limits in which values lie; below 0, or too large, beyond."""
    bins_per_unit = _BINS / (high - low)
    return np.floor((values - low) * bins_per_unit).astype(np.int64)


def histogram(tiles: Tiles, picture: PlanePicture, *, holes: xr.Dataset | None = None) -> Entries:
    """Count the valid values of a picture, of pixels of the stated size.

    ``range``: the 2nd to the 98th percentile.

    A picture without a mask of its own is counted without its ``holes`` and their rims.
    """
    level, (values,) = _overview(tiles, picture)
    if holes is not None and not tiles.pictures.valid_of(picture):
        grid = Grid.of(picture.levels[level])
        radii_um = _RIM * holes["diameter"].values
        values[hole_mask(grid, centres_of(holes), radii_um)] = np.nan
    finite = values[np.isfinite(values)].astype(np.float64)
    low, high = _limits(finite)
    percentiles = [0.0, 1.0]
    if finite.size:
        percentiles = np.percentile(finite, [2, 98]).tolist()
    counts, _ = np.histogram(finite, bins=_BINS, range=(low, high))
    mean = sd = median = None
    if finite.size:
        summands = summable(picture.full, finite)
        mean, sd, finite = distribution(finite, summands, ddof=int(finite.size > 1))
        median = float(np.median(finite))
    return {
        "pixel_um": _pixel_um(picture, level),
        "n": finite.size,
        "beyond": finite.size - int(counts.sum()),
        "low": low,
        "high": high,
        "range": percentiles,
        "counts": counts.tolist(),
        "mean": mean,
        "sd": sd if finite.size > 1 else None,
        "median": median,
    }


def _pixels_between(centres_um: Floats, low_um: float, high_um: float, pixel_um: float) -> slice:
    # a border through the middle of a pixel takes it in, whatever was rounded.
    slack_um = 1e-6 * pixel_um
    first = np.searchsorted(centres_um, min(low_um, high_um) - slack_um, "left")
    end = np.searchsorted(centres_um, max(low_um, high_um) + slack_um, "right")
    return slice(int(first), int(end))


def select(
    tiles: Tiles,
    a: PlanePicture,
    b: PlanePicture,
    *,
    region: Rectangle | None = None,
    brushes: Sequence[Brush] = (),
    stop: threading.Event | None = None,
) -> Entries:
    """Count what is selected at full resolution.

    Of a region also say how two pictures are correlated in it.

    Of picked values, and of angles of an axis, nothing is said of r: ``r``, ``n_eff`` and
    ``interval`` are None. Stopped once ``stop`` is set.
    """
    stop = stop or threading.Event()
    pixel_um = a.grid.pixel_um
    window: Window = (slice(None), slice(None)) if region is None else region.on(a)
    parts = [p.full[window] for p in (a, b)]
    x, y = (computed(part, partial(_read_until, stop, part)) for part in parts)
    masks = [p.full[window] for p in tiles.pictures.valid_of(a, b)]
    if brushes or is_axial(a.full) or is_axial(b.full):
        unstated = dict.fromkeys(("r", "n_eff", "interval"))
        n = _n_selected(x, y, window, brushes, masks)
        return {"n": n, "pixel_um": pixel_um, **unstated, "warnings": []}
    # One mask, true where all are, of which parts are read as they are asked for.
    mask = None
    if masks:
        mask = computed(
            masks[0], lambda part: np.logical_and.reduce([m[part].values for m in masks])
        )
    # As a run does: its whole map gives its n_eff.
    row = correlate(x, y, mask=mask, pixel_um=pixel_um, most_cells=CELLS)
    warnings = [
        f"{p.title} is the pose of the sheet in the scanner: a negative control, no property."
        for p in (a, b)
        if p.variable in NEGATIVE_CONTROLS
    ]
    return {
        "n": row.n,
        "pixel_um": pixel_um,
        "r": finite_or_none(row.r),
        "n_eff": finite_or_none(row.n_eff),
        "interval": row.interval if is_known(row.interval) else None,
        "warnings": [*warnings, *row.warnings],
    }


def _n_selected(
    x: xr.DataArray,
    y: xr.DataArray,
    window: Window,
    brushes: Sequence[Brush],
    masks: Sequence[xr.DataArray],
) -> int:
    """Count the pixels that are valid in both pictures and within all brushes.

    ``x``, ``y`` and the masks are cut to the window already.
    """
    brush_values = [brush.picture.full[window] for brush in brushes]
    n = 0
    for _, (x_values, y_values, *bands) in read_bands(x, y, *brush_values, *masks):
        is_selected = valid_in_all((x_values, y_values), bands[len(brushes) :])
        for brush, values in zip(brushes, bands, strict=False):
            is_selected &= (values >= brush.low) & (values <= brush.high)
        n += int(np.count_nonzero(is_selected))
    return n


def _read_until(stop: threading.Event, level: xr.DataArray, window: Where) -> NDArray[np.floating]:
    if stop.is_set():
        raise Stopped
    return level[window].values


def _overview(tiles: Tiles, *pictures: PlanePicture) -> tuple[int, list[Floats]]:
    """A level of few pixels, and the values of pictures there; NaN where they do not count.

    It is the finest with at most BASE_PIXELS, or the last; the pictures are on the same pixels.
    """
    levels = pictures[0].levels
    n_larger = sum(data.size > BASE_PIXELS for data in levels)
    level = min(n_larger, len(levels) - 1)
    rows, cols = (slice(0, n) for n in levels[level].shape)
    masks = [tiles.window(p, level, rows, cols) for p in tiles.pictures.valid_of(*pictures)]
    is_valid = np.logical_and.reduce(masks) if masks else True
    windows = [tiles.window(p, level, rows, cols) for p in pictures]
    return level, [np.where(is_valid, window.astype(np.float64), np.nan) for window in windows]


def _limits(values: Floats) -> Pair:
    if values.size == 0:
        return 0.0, 1.0
    # Percentiles between which points are drawn; those beyond are counted.
    low, high = map(float, np.percentile(values, (0.1, 99.9)))
    margin = 0.02 * (high - low) or 0.5
    return low - margin, high + margin


def _pixel_um(picture: PlanePicture, level: int) -> Pair:
    dy, dx = picture.grid.pixel_um
    return dy * 2**level, dx * 2**level
