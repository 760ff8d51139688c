"""Slices through the sheet with the surfaces that were found in them."""

from __future__ import annotations

from dataclasses import dataclass
from string import ascii_uppercase

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.numbers import count, length, number, plain
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Slice:
    """One slice: its grey values with the top side up, and the heights of the surfaces in it."""

    grey: Array
    heights: Array  # descending: the first row is the upper one
    x: Array
    lines: dict[str, Array]
    used: NDArray[np.bool_]  # columns that were measured
    place_um: float  # along the axis that it cuts across

    def window(self, left: float, right: float, margin: float) -> Window:
        """Return the part between two places that holds the sheet."""
        inside, (low, high) = (self.x >= left) & (self.x <= right), self.range
        faces = np.concatenate([v[inside] for v in self.lines.values()])
        faces = faces[np.isfinite(faces)]
        if faces.size:
            low, high = max(low, float(faces.min()) - margin), min(high, float(faces.max()) + margin)
        return left, right, low, high

    @property
    def range(self) -> tuple[float, float]:
        """Lowest and highest height."""
        return float(self.heights[-1]), float(self.heights[0])


def draw_slices(slices: xr.Dataset, surfaces: xr.Dataset) -> list[Picture]:
    """Draw every slice (slice, height, x) in true proportions, and a magnified stretch of each."""
    cuts = [take_slice(slices, surfaces, k) for k in range(slices.sizes["slice"])]
    thickness = float(np.nanmedian(surfaces["top"].values - surfaces["bottom"].values))
    scale = limits(
        np.concatenate([c.grey.ravel()[:: max(1, c.grey.size // 200_000)] for c in cuts]), GREYS, percent=0.3
    )
    margin = 0.8 * abs(thickness)
    spans = [_span(cut, margin) for cut in cuts]
    windows = _windows(cuts, spans, 0.35 * margin)
    across = str(surfaces.attrs["row_axis"])
    zoom = _zoom(spans, FULL - 2)
    canvas, top = Canvas(FULL, sum((s[3] - s[2]) * zoom for s in spans) + 32 * len(cuts) + 30), 0.0
    for name, cut, span, (left, right, low, up) in zip(ascii_uppercase, cuts, spans, windows, strict=False):
        canvas.text(1, top + 18, f"Slice {name}", bold=True)
        canvas.text(62, top + 18, f"{across} = {plain(cut.place_um)}", colour=SOFT)
        axes = _draw(canvas, cut, span, (1, top + 26), zoom, scale, 1.1)
        axes.line([(left, low), (left, up), (right, up), (right, low), (left, low)], colour=_MARKED, width=1.4)
        axes.text(left, up, name, shift=(3, -4), size=SMALL, colour=_MARKED, halo="black", bold=True)
        top += axes.height + 32
    canvas.scale_bar(1, top - 2, width=FULL, um=FULL / zoom)
    whole = all(s[1] - s[0] >= float(c.x[-1] - c.x[0]) - 1e-6 for s, c in zip(spans, cuts, strict=True))
    part = "" if whole else f" Only a stretch of {length(spans[0][1] - spans[0][0])} is drawn, so that the sheet shows."
    overview = canvas.picture(
        title="Slices with the surfaces found",
        caption=(
            f"{len(cuts)} slices across {across}; {surfaces.attrs['through']} runs through the sheet, the top side is "
            f"up. Heights and widths have the same scale.{part} n = {count(cuts[0].x.size)} columns of "
            f"{pixel_of(cuts[0].x)} in each slice; lines in µm; mask: faces are pale where the column is left out "
            "(rims), and missing where none was found."
        ),
    )
    return [overview, _details(cuts, windows, scale)]


def _draw(
    canvas: Canvas, cut: Slice, window: Window, corner: tuple[float, float], zoom: float, scale: Scale, width: float
) -> Axes:
    """Draw a window of a slice with its surfaces."""
    left, right, low, high = window
    wide = (right - left) * zoom
    axes = canvas.axes(*corner, wide, (high - low) * zoom, window)
    cols = (cut.x >= left - 1e-6) & (cut.x <= right + 1e-6)
    rows = (cut.heights >= low - 1e-6) & (cut.heights <= high + 1e-6)
    axes.image(reduced(cut.grey[np.ix_(rows, cols)], cut.heights[rows], cut.x[cols], width=wide), scale)
    every = slice(None, None, max(1, cut.x.size // 1400))  # points of a line
    for name, _, colour, dash in LINES:
        line = np.stack([cut.x, cut.lines[name]], axis=1)
        if name == "centre":
            axes.line(line[every], colour=colour, width=0.8 * width, dash=dash)
            continue
        axes.line(line[every], colour=colour, width=0.7 * width, opacity=0.4)
        line[~cut.used] = np.nan
        axes.line(line[every], colour=colour, width=width)
    return axes


def _details(cuts: list[Slice], windows: list[Window], scale: Scale) -> Picture:
    """Draw the marked windows side by side, with the key to the lines."""
    gap, across = 22.0, max(w[1] - w[0] for w in windows)
    width = (FULL - gap * (len(cuts) - 1)) / len(cuts) if len(cuts) > 1 else 0.6 * FULL
    zoom = _zoom(windows, width - 2)
    high = max((w[3] - w[2]) * zoom for w in windows)
    canvas = Canvas(FULL, high + 92)
    for k, (cut, window) in enumerate(zip(cuts, windows, strict=True)):
        x0 = k * (width + gap) + 1
        canvas.text(x0, 18, f"Detail of slice {ascii_uppercase[k]}", bold=True)
        _draw(canvas, cut, window, (x0, 26), zoom, scale, 2.0)
    canvas.scale_bar(1, 28 + high, width=width, um=width / zoom)
    drawn = [line for line in LINES if any(np.isfinite(cut.lines[line[0]]).any() for cut in cuts)]
    canvas.box(0, high + 60, FULL, 28, fill="#2a2d30")
    for k, (_, name, colour, dash) in enumerate(drawn):
        x0 = 14 + k * 205.0
        canvas.line([(x0, high + 74), (x0 + 28, high + 74)], colour=colour, width=2.6, dash=dash)
        canvas.text(x0 + 36, high + 78, name, colour="white")
    voxel = pixel_of(cuts[0].x, cuts[0].heights[::-1])
    return canvas.picture(
        title="The layers, close up",
        caption=(
            f"The red windows, each {length(across)} wide; voxels of {voxel} as they are, lines in µm at sub-voxel "
            f"heights. n = {number(across / pitch(cuts[0].x), 3)} columns in each window; mask as above."
        ),
    )


def _zoom(windows: list[Window], width: float) -> float:
    """Return the pixels of a um with which all windows fit."""
    return min(width / max(w[1] - w[0] for w in windows), 450 / max(w[3] - w[2] for w in windows))


def _windows(cuts: list[Slice], spans: list[Window], margin: float) -> list[Window]:
    """Return a clear window of each span, all as high as the highest, so that they can stand side by side."""
    half, tight = _WINDOW_UM / 2, list[Window]()
    for cut, span in zip(cuts, spans, strict=True):
        centre = _clear_place(cut, span)
        tight.append(cut.window(centre - half, centre + half, margin))
    tall = max(high - low for _, _, low, high in tight)
    windows: list[Window] = []
    for cut, (left, right, low, high) in zip(cuts, tight, strict=True):
        floor, ceiling = cut.range
        bottom = min(max((low + high - tall) / 2, floor), max(ceiling - tall, floor))
        windows.append((max(left, float(cut.x[0])), min(right, float(cut.x[-1])), bottom, min(bottom + tall, ceiling)))
    return windows


def take_slice(slices: xr.Dataset, surfaces: xr.Dataset, k: int) -> Slice:
    """Take one slice out, turned so that the top side is up."""
    up = 1.0 if surfaces.attrs["top_side"] == "high" else -1.0
    heights = up * slices["height"].values.astype(np.float64)
    order: NDArray[np.intp] = np.argsort(-heights)
    row = int(slices["row"].values[k])
    x = slices["x"].values.astype(np.float64)
    # A column may be several voxels wide: each voxel shows the surfaces of its column.
    centres = surfaces["x"].values.astype(np.float64)
    cols = np.clip(np.rint((x - centres[0]) / pitch(centres)), 0, centres.size - 1).astype(int)
    lines = {name: up * surfaces[name].values[row, cols].astype(np.float64) for name, *_ in LINES if name in surfaces}
    return Slice(
        grey=slices["grey"].values[k].astype(np.float64)[order], heights=heights[order], x=x,
        lines={name: lines.get(name, np.full(x.shape, np.nan)) for name, *_ in LINES},
        used=np.isfinite(surfaces["thickness"].values[row, cols]), place_um=float(slices["slice"].values[k]),
    )  # fmt: skip


def _span(cut: Slice, margin: float) -> Window:
    """Return the whole slice, or its middle where the whole would be a hair line."""
    left, right = float(cut.x[0]), float(cut.x[-1])
    whole = cut.window(left, right, margin)
    if (right - left) <= _FLATTEST * (whole[3] - whole[2]):
        return whole
    # A flat sheet: more air above and below first, then less of its length.
    floor, ceiling = cut.range
    extra = max(0.0, min((right - left) / _FLATTEST, ceiling - floor) - (whole[3] - whole[2])) / 2
    low, high = max(whole[2] - extra, floor), min(whole[3] + extra, ceiling)
    longest = 2 * _FLATTEST * (high - low)
    if right - left <= longest:
        return left, right, low, high
    middle = (left + right) / 2
    return cut.window(middle - longest / 2, middle + longest / 2, margin)


def _clear_place(cut: Slice, span: Window) -> float:
    """Return the middle of the window, near the middle of the slice, in which most of the lines are there."""
    step = pitch(cut.x)
    size = max(1, min(round(_WINDOW_UM / step), cut.x.size))
    share = np.convolve(cut.used.astype(np.float64), np.ones(size) / size, mode="valid")
    middles = cut.x[: share.size] + (size - 1) / 2 * step
    inside = (middles - _WINDOW_UM / 2 >= span[0] - step) & (middles + _WINDOW_UM / 2 <= span[1] + step)
    if not inside.any():
        return (span[0] + span[1]) / 2
    distance = np.abs(middles - (span[0] + span[1]) / 2) / max(span[1] - span[0], step)
    return float(middles[int(np.argmax(np.where(inside, np.round(share, 1) - distance, -np.inf)))])
