"""Slices through the sheet with the surfaces that were found in them."""

from dataclasses import dataclass
from string import ascii_uppercase

import numpy as np
import xarray as xr

from planish.core.numbers import count, length, plain
from planish.core.typing import Bools, Entries, Ints, Pair
from planish.report.colours import GREYS, Array, Scale, limits
from planish.report.draw import FULL, SMALL, SOFT, Axes, Canvas, Picture, pitch, pixel_of, reduced

# Colours that do not need red and green to be distinguished, and stand out from grey.
LINES = (
    ("top", "top face", "#ffb000", ""),
    ("interface_top", "coating–base, top side", "#39c5ff", ""),
    ("centre", "centre surface", "#ffffff", "7 4"),
    ("interface_bottom", "coating–base, bottom side", "#4f8bff", ""),
    ("bottom", "bottom face", "#ff5fa2", ""),
)
_MARKED = "#ff3b30"
_WINDOW_UM = 400.0
_FLATTEST = 9.0  # width over height of the longest stretch that is still drawn whole
Window = tuple[float, float, float, float]  # left, right, lowest and highest um


@dataclass(frozen=True, slots=True)
class Slice:
    """One slice: its grey values with the top side up, and the heights of the surfaces in it."""

    grey: Array
    heights: Array  # descending: the first row is the upper one
    x: Array
    lines: dict[str, Array]
    used: Bools  # columns that were measured
    place_um: float  # along the axis that it cuts across

    def window(self, left: float, right: float, margin: float) -> Window:
        """Return the part between two places along x, in um, that holds the sheet.

        It reaches a margin, in um, beyond the surfaces there, within the slice.
        """
        is_inside = (self.x >= left) & (self.x <= right)
        low, high = self.range
        face_heights = np.concatenate([v[is_inside] for v in self.lines.values()])
        face_heights = face_heights[np.isfinite(face_heights)]
        if face_heights.size:
            low = max(low, float(face_heights.min()) - margin)
            high = min(high, float(face_heights.max()) + margin)
        return left, right, low, high

    @property
    def range(self) -> Pair:
        """Lowest and highest height."""
        return float(self.heights[-1]), float(self.heights[0])


def top_sign(surfaces: xr.Dataset) -> float:
    """Return 1 where the top side has the larger coordinates, and -1 where the smaller ones."""
    return 1.0 if surfaces.attrs["top_side"] == "high" else -1.0


def draw_slices(slices: xr.Dataset, surfaces: xr.Dataset) -> list[Picture]:
    """Draw every slice (slice, height, x) in true proportions, and a magnified stretch of each.

    The stretch is framed in the first figure, whose slices have one scale, and fills the second.
    """
    cuts = [take_slice(slices, surfaces, k) for k in range(slices.sizes["slice"])]
    thickness = float(np.nanmedian(surfaces["top"].values - surfaces["bottom"].values))
    stride = max(1, cuts[0].grey.size // 200_000)  # of each slice as many values do for limits
    greys = [cut.grey.ravel()[::stride] for cut in cuts]
    scale = limits(np.concatenate(greys), GREYS, percent=0.3)
    # In um above and below the sheet; the details come closer to it.
    margin = 0.8 * abs(thickness)
    spans = [_overview_window(cut, margin) for cut in cuts]
    windows = _detail_windows(cuts, spans, 0.35 * margin)
    cut_axis = str(surfaces.attrs["row_axis"])
    zoom = _px_per_um(spans, FULL - 2)
    height_um = sum(high - low for _, _, low, high in spans)
    canvas = Canvas(FULL, height_um * zoom + 32 * len(cuts) + 30)
    top_px = 0.0
    for letter, cut, span, window in zip(ascii_uppercase, cuts, spans, windows, strict=False):
        left, right, low, high = window
        canvas.text(1, top_px + 18, f"Slice {letter}", bold=True)
        canvas.text(62, top_px + 18, f"{cut_axis} = {plain(cut.place_um)}", colour=SOFT)
        axes = _draw_window(canvas, cut, span, (1, top_px + 26), zoom, scale, 1.1)
        border_x = (left, left, right, right, left)
        border_y = (low, high, high, low, low)
        axes.line(border_x, border_y, colour=_MARKED, width=1.4)
        style: Entries = {"size": SMALL, "colour": _MARKED, "halo": "black", "bold": True}
        axes.text(left, high, letter, shift=(3, -4), **style)
        top_px += axes.height + 32
    canvas.scale_bar(1, top_px - 2, width=FULL, um=FULL / zoom)
    stretch_text = ""
    for cut, (left, right, _, _) in zip(cuts, spans, strict=True):
        if right - left < float(cut.x[-1] - cut.x[0]) - 1e-6:
            stretch_um = spans[0][1] - spans[0][0]
            stretch_text = (
                f" Only a stretch of {length(stretch_um)} is drawn, so that the sheet shows."
            )
    caption = (
        f"{len(cuts)} slices across {cut_axis}; {surfaces.attrs['through']} runs through the"
        f" sheet, the top side is up. Heights and widths have the same scale.{stretch_text} n ="
        f" {count(cuts[0].x.size)} columns of {pixel_of(cuts[0].x)} in each slice; lines in µm;"
        " mask: faces are pale where the column is left out (rims), and missing where none was"
        " found."
    )
    overview = canvas.picture("Slices with the surfaces found", caption)
    return [overview, _draw_details(cuts, windows, scale)]


def _draw_window(
    canvas: Canvas,
    cut: Slice,
    window: Window,
    corner_px: Pair,
    zoom: float,
    scale: Scale,
    width: float,
) -> Axes:
    """Draw the grey values and the lines of a part of a slice, its upper left corner at a place.

    ``zoom``: pixels of the figure for a um; ``width``: of the lines in pixels.
    """
    left, right, low, high = window
    width_px = (right - left) * zoom
    height_px = (high - low) * zoom
    axes = canvas.axes(*corner_px, width_px, height_px, window)
    # A window may end at the middle of a voxel; 1e-6 um is beyond the rounding of places.
    cols = (cut.x >= left - 1e-6) & (cut.x <= right + 1e-6)
    rows = (cut.heights >= low - 1e-6) & (cut.heights <= high + 1e-6)
    coordinates = [("height", cut.heights[rows]), ("x", cut.x[cols])]
    grey = xr.DataArray(cut.grey[np.ix_(rows, cols)], coordinates)
    axes.image(reduced(grey, width=width_px), scale)
    stride = max(1, cut.x.size // 1400)  # more points do not show on the page
    x = cut.x[::stride]
    for name, _, colour, dash in LINES:
        line = cut.lines[name][::stride]
        if name == "centre":
            axes.line(x, line, colour=colour, width=0.8 * width, dash=dash)
            continue
        # Pale all along, and strong where the column was measured.
        axes.line(x, line, colour=colour, width=0.7 * width, opacity=0.4)
        measured = np.where(cut.used[::stride], line, np.nan)
        axes.line(x, measured, colour=colour, width=width)
    return axes


def _draw_details(cuts: list[Slice], windows: list[Window], scale: Scale) -> Picture:
    """Draw a window of each slice, side by side, and say which line is which.

    Lines that no slice has are not named.
    """
    gap = 22.0  # pixels between two windows
    widest_um, highest_um = _largest(windows)
    width = 0.6 * FULL  # of one window in pixels; several share the page
    if len(cuts) > 1:
        width = (FULL + gap) / len(cuts) - gap
    zoom = _px_per_um(windows, width - 2)
    height_px = highest_um * zoom
    canvas = Canvas(FULL, height_px + 92)
    for k, (cut, window) in enumerate(zip(cuts, windows, strict=True)):
        left_px = k * (width + gap) + 1
        canvas.text(left_px, 18, f"Detail of slice {ascii_uppercase[k]}", bold=True)
        _draw_window(canvas, cut, window, (left_px, 26), zoom, scale, 2.0)
    canvas.scale_bar(1, 28 + height_px, width=width, um=width / zoom)
    canvas.box(0, height_px + 60, FULL, 28, fill="#2a2d30")
    left_px = 14.0
    for name, title, colour, dash in LINES:
        if any(np.isfinite(cut.lines[name]).any() for cut in cuts):
            ends = (left_px, left_px + 28)
            canvas.line(ends, height_px + 74, colour=colour, width=2.6, dash=dash)
            canvas.text(left_px + 36, height_px + 78, title, colour="white")
            left_px += 205.0
    voxel = pixel_of(cuts[0].x, cuts[0].heights[::-1])
    caption = (
        f"The red windows, each {length(widest_um)} wide; voxels of {voxel} as they are, lines"
        f" in µm at sub-voxel heights. n = {count(round(widest_um / pitch(cuts[0].x)))} columns"
        " in each window; mask as above."
    )
    return canvas.picture("The layers, close up", caption)


def _px_per_um(windows: list[Window], width: float) -> float:
    """Pixels for a um with which windows are at most so wide, in pixels, and 450 high."""
    widest_um, highest_um = _largest(windows)
    return min(width / widest_um, 450 / highest_um)


def _largest(windows: list[Window]) -> Pair:
    """Largest width and height of some windows."""
    left, right, low, high = np.transpose(windows)
    return float(max(right - left)), float(max(high - low))


def _detail_windows(cuts: list[Slice], spans: list[Window], margin: float) -> list[Window]:
    """Return a clear window of each span, all as high as the highest.

    They can thus stand side by side. ``margin``, in um, is that of :meth:`Slice.window`.
    """
    half_um = _WINDOW_UM / 2
    tight_windows = list[Window]()
    for cut, span in zip(cuts, spans, strict=True):
        centre_um = _clear_place(cut, span)
        window = cut.window(centre_um - half_um, centre_um + half_um, margin)
        tight_windows.append(window)
    _, height_um = _largest(tight_windows)
    windows: list[Window] = []
    for cut, (left, right, low, high) in zip(cuts, tight_windows, strict=True):
        # As much is added above as below, within the slice.
        floor, ceiling = cut.range
        highest = max(ceiling - height_um, floor)
        bottom = min(max((low + high - height_um) / 2, floor), highest)
        top = min(bottom + height_um, ceiling)
        left = max(left, float(cut.x[0]))
        right = min(right, float(cut.x[-1]))
        windows.append((left, right, bottom, top))
    return windows


def take_slice(slices: xr.Dataset, surfaces: xr.Dataset, k: int) -> Slice:
    """Take one slice out, turned so that the top side is up.

    Parameters
    ----------
    slices : Dataset, dims (slice, height, x), in um
        As a run keeps them, each with the ``row`` of the surfaces that it lies in.
    surfaces : Dataset, dims (y, x), in um
    k : int
        Number of the slice.

    Returns
    -------
    Slice
    """
    sign = top_sign(surfaces)
    heights = sign * slices["height"].values.astype(np.float64)
    order: Ints = np.argsort(-heights)
    row = int(slices["row"].values[k])
    x = slices["x"].values.astype(np.float64)
    # A column may be several voxels wide: each voxel shows the surfaces of its column.
    centres = surfaces["x"].values.astype(np.float64)
    steps = np.rint((x - centres[0]) / pitch(centres))
    cols = np.clip(steps, 0, centres.size - 1).astype(int)
    lines: dict[str, Array] = {}
    for name, *_ in LINES:
        lines[name] = np.full(x.shape, np.nan)
        if name in surfaces:
            lines[name] = sign * surfaces[name].values[row, cols].astype(np.float64)
    grey = slices["grey"].values[k].astype(np.float64)
    is_used = np.isfinite(surfaces["thickness"].values[row, cols])
    place_um = float(slices["slice"].values[k])
    return Slice(grey[order], heights[order], x, lines, is_used, place_um)


def _overview_window(cut: Slice, margin: float) -> Window:
    """Return the whole slice, or its middle where the whole would be a hair line.

    ``margin``, in um, is that of :meth:`Slice.window`.
    """
    left = float(cut.x[0])
    right = float(cut.x[-1])
    *_, low, high = cut.window(left, right, margin)
    width_um = right - left
    # A flat sheet: more air above and below first, then less of its length.
    floor, ceiling = cut.range
    height_um = min(width_um / _FLATTEST, ceiling - floor)
    extra_um = max(0.0, height_um - (high - low)) / 2
    low = max(low - extra_um, floor)
    high = min(high + extra_um, ceiling)
    max_width_um = 2 * _FLATTEST * (high - low)
    if width_um <= max_width_um:
        return left, right, low, high
    centre_um = (left + right) / 2
    half_um = max_width_um / 2
    return cut.window(centre_um - half_um, centre_um + half_um, margin)


def _clear_place(cut: Slice, span: Window) -> float:
    """The middle of the window in a span that was measured best, of several the most central.

    It is a place along x in um, the middle of the span where that is narrower than a window.
    """
    step = pitch(cut.x)
    left, right, *_ = span
    middle_um = (left + right) / 2
    n_columns = max(1, min(round(_WINDOW_UM / step), cut.x.size))
    weights = np.ones(n_columns) / n_columns
    measured_share = np.convolve(cut.used.astype(np.float64), weights, mode="valid")
    centres_um = cut.x[: measured_share.size] + (n_columns - 1) / 2 * step
    is_left_inside = centres_um - _WINDOW_UM / 2 >= left - step
    is_right_inside = centres_um + _WINDOW_UM / 2 <= right + step
    is_inside = is_left_inside & is_right_inside
    if not is_inside.any():
        return middle_um
    # Shares that differ by less than a tenth count alike; the distance in spans is at most a half.
    distance = np.abs(centres_um - middle_um) / max(right - left, step)
    score = np.where(is_inside, np.round(measured_share, 1) - distance, -np.inf)
    return float(centres_um[np.argmax(score)])
