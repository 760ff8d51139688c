"""Slices through the sheet with the surfaces that were found in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from planish.report.draw import (
    FULL,
    SOFT,
    Array,
    Canvas,
    Field,
    Picture,
    field,
    frame,
    halo,
    limits,
    pitch,
    scale_bar,
    show,
)
from planish.report.text import count, length, number, plain

# Colours that are told apart without red and green, and stand out from grey.
LINES = (
    ("top", "top face", "#ffb000", "-"),
    ("interface_top", "coating–base, top side", "#39c5ff", "-"),
    ("centre", "centre surface", "#ffffff", (0, (5, 3))),
    ("interface_bottom", "coating–base, bottom side", "#4f8bff", "-"),
    ("bottom", "bottom face", "#ff5fa2", "-"),
)
_WINDOW_UM = 400.0
_FLATTEST = 9.0  # width over height of the longest stretch that is still drawn whole


@dataclass(frozen=True, slots=True, kw_only=True)
class Slice:
    """One slice: its grey values with the top side up, and the heights of the surfaces in it."""

    grey: Array
    heights: Array  # ascending, top side up
    x: Array
    lines: dict[str, Array]
    used: NDArray[np.bool_]  # columns that were measured
    at: float

    def window(self, left: float, right: float, margin: float) -> tuple[float, float, float, float]:
        """Left, right, lowest and highest um of the part between two places that holds the sheet."""
        inside = (self.x >= left) & (self.x <= right)
        found = np.concatenate([v[inside] for v in self.lines.values()])
        found = found[np.isfinite(found)]
        low, high = float(self.heights[0]), float(self.heights[-1])
        if found.size:
            low, high = max(low, float(found.min()) - margin), min(high, float(found.max()) + margin)
        return left, right, low, high

    def cut(self, window: tuple[float, float, float, float], width: float) -> Field:
        """Grey values of a window, for axes so many inches wide."""
        left, right, low, high = window
        cols = (self.x >= left - 1e-6) & (self.x <= right + 1e-6)
        rows = (self.heights >= low - 1e-6) & (self.heights <= high + 1e-6)
        # The first row of a picture is its upper one: heights run down, so that they are turned here.
        grey, heights = self.grey[np.ix_(rows, cols)][::-1], self.heights[rows]
        shown = field(grey, heights, self.x[cols], width=width)
        top = float(heights[-1]) + pitch(heights) / 2
        return Field(shown.values, (shown.extent[0], shown.extent[1], top - shown.height, top))


def draw_slices(slices: xr.Dataset, surfaces: xr.Dataset) -> list[Picture]:
    """Draw every slice in true proportions, and a stretch of each in which the layers are seen.

    Parameters
    ----------
    slices : Dataset, dims (slice, height, x)
        ``grey``, and ``row``: where each slice lies in ``surfaces``.
    surfaces : Dataset, dims (y, x), in um
    """
    cuts = [take_slice(slices, surfaces, k) for k in range(slices.sizes["slice"])]
    thickness = float(np.nanmedian(surfaces["top"].values - surfaces["bottom"].values))
    norm = limits(np.concatenate([c.grey.ravel()[:: max(1, c.grey.size // 200_000)] for c in cuts]), percent=0.3)
    margin = 0.8 * abs(thickness)
    spans = [_span(cut, margin) for cut in cuts]
    centres = [_clear_place(cut, span) for cut, span in zip(cuts, spans, strict=True)]
    windows = _windows(cuts, centres, 0.35 * margin)
    rows, through = str(surfaces.attrs["row_axis"]), str(surfaces.attrs["through"])
    scale = min(FULL / max(s[1] - s[0] for s in spans), 4.5 / max(s[3] - s[2] for s in spans))
    heights = [(s[3] - s[2]) * scale for s in spans]
    canvas = Canvas(FULL, sum(heights) + 0.32 * len(cuts) + 0.3)
    top = 0.0
    for k, (cut, span, high) in enumerate(zip(cuts, spans, heights, strict=True)):
        canvas.text(0, top + 0.18, f"Slice {_letter(k)}", fontweight="bold", va="baseline")
        canvas.text(0.62, top + 0.18, f"{rows} = {plain(cut.at)}", color=SOFT, va="baseline")
        axes = canvas.axes(0, top + 0.26, (span[1] - span[0]) * scale, high)
        show(axes, cut.cut(span, (span[1] - span[0]) * scale), norm=norm, cmap="gray")
        _lines(axes, cut, span, 0.8)
        left, right, low, up = windows[k]
        axes.add_patch(Rectangle((left, low), right - left, up - low, fill=False, ec="#ff3b30", lw=1.0))
        axes.text(
            left, up, f" {_letter(k)}", color="#ff3b30", fontsize=8, fontweight="bold", va="bottom",
            path_effects=halo(1.6, "black"), clip_on=True,
        )  # fmt: skip
        top += high + 0.32
    scale_bar(canvas, 0, top - 0.02, inches=FULL, um=FULL / scale)
    whole = all(s[1] - s[0] >= float(c.x[-1] - c.x[0]) - 1e-6 for s, c in zip(spans, cuts, strict=True))
    part = (
        ""
        if whole
        else f" Only a stretch of {length(spans[0][1] - spans[0][0])} is drawn, so that the sheet can be seen."
    )
    overview = canvas.picture(
        kind="jpeg",
        title="Slices with the surfaces found",
        caption=(
            f"{len(cuts)} slices across {rows}; {through} runs through the sheet, the top side is up. Heights and "
            f"widths have the same scale.{part} n = {count(cuts[0].x.size)} columns of {plain(pitch(cuts[0].x))} in "
            "each slice; lines in µm; mask: faces are pale where the column is left out (rims), and missing where none "
            "was found."
        ),
    )
    return [overview, _details(cuts, windows, norm)]


def _windows(cuts: list[Slice], centres: list[float], margin: float) -> list[tuple[float, float, float, float]]:
    """Return the windows around the given places: as high as the highest, so that they can stand side by side."""
    half = _WINDOW_UM / 2
    found = [cut.window(c - half, c + half, margin) for cut, c in zip(cuts, centres, strict=True)]
    tall = max(high - low for _, _, low, high in found)
    out: list[tuple[float, float, float, float]] = []
    for cut, (left, right, low, high) in zip(cuts, found, strict=True):
        floor, ceiling = float(cut.heights[0]), float(cut.heights[-1])
        bottom = min(max((low + high - tall) / 2, floor), max(ceiling - tall, floor))
        out.append((max(left, float(cut.x[0])), min(right, float(cut.x[-1])), bottom, min(bottom + tall, ceiling)))
    return out


def _details(cuts: list[Slice], windows: list[tuple[float, float, float, float]], norm: Normalize) -> Picture:
    """Draw the marked windows side by side, with the key to the lines."""
    gap = 0.22
    width = (FULL - gap * (len(cuts) - 1)) / len(cuts) if len(cuts) > 1 else 0.6 * FULL
    across = max(w[1] - w[0] for w in windows)
    scale = min(width / across, 4.5 / max(w[3] - w[2] for w in windows))
    high = max((w[3] - w[2]) * scale for w in windows)
    canvas = Canvas(FULL, high + 0.9)
    for k, (cut, window) in enumerate(zip(cuts, windows, strict=True)):
        left = k * (width + gap)
        canvas.text(left, 0.18, f"Detail of slice {_letter(k)}", fontweight="bold", va="baseline")
        box = ((window[1] - window[0]) * scale, (window[3] - window[2]) * scale)
        axes = canvas.axes(left, 0.26, *box)
        show(axes, cut.cut(window, box[0]), norm=norm, cmap="gray")
        _lines(axes, cut, window, 1.5)
    scale_bar(canvas, 0, 0.28 + high, inches=width, um=width / scale)
    drawn = [line for line in LINES if any(np.isfinite(cut.lines[line[0]]).any() for cut in cuts)]
    handles = [Line2D([], [], color=colour, ls=dash, lw=2.2) for _, _, colour, dash in drawn]
    key = canvas.axes(0, high + 0.6, FULL, 0.28, facecolor="#2a2d30")
    frame(key)
    key.legend(
        handles, [name for _, name, _, _ in drawn], loc="center left", ncols=len(drawn), frameon=False,
        bbox_to_anchor=(0.01, 0.5), borderaxespad=0, borderpad=0, labelcolor="white",
        handlelength=2.8, columnspacing=2.2,
    )  # fmt: skip
    sampling = f"{plain(pitch(cuts[0].x))} × {plain(pitch(cuts[0].heights))}"
    return canvas.picture(
        kind="jpeg",
        title="The layers, close up",
        caption=(
            f"The red windows, each {length(across)} wide; voxels of {sampling} shown as they are, lines in µm at "
            f"sub-voxel heights. n = {number(across / pitch(cuts[0].x), 3)} columns a window; mask as above."
        ),
    )


def take_slice(slices: xr.Dataset, surfaces: xr.Dataset, k: int) -> Slice:
    """Take one slice out, turned so that heights ascend towards the top side."""
    up = 1.0 if surfaces.attrs["top_side"] == "high" else -1.0
    heights = up * slices["height"].values.astype(np.float64)
    order: NDArray[np.intp] = np.argsort(heights)
    row = int(slices["row"].values[k])
    x = slices["x"].values.astype(np.float64)
    # A column may be several voxels wide: each voxel shows the surfaces of its column.
    centres = surfaces["x"].values.astype(np.float64)
    at = np.clip(np.rint((x - centres[0]) / pitch(centres)), 0, centres.size - 1).astype(int)
    lines = {name: up * surfaces[name].values[row, at].astype(np.float64) for name, *_ in LINES if name in surfaces}
    return Slice(
        grey=slices["grey"].values[k].astype(np.float64)[order],
        heights=heights[order],
        x=x,
        lines={name: lines.get(name, np.full(x.shape, np.nan)) for name, *_ in LINES},
        used=np.isfinite(surfaces["thickness"].values[row, at]),
        at=float(slices["slice"].values[k]),
    )


def _span(cut: Slice, margin: float) -> tuple[float, float, float, float]:
    """Return the whole slice, or its middle where the whole would be a hair line."""
    left, right = float(cut.x[0]), float(cut.x[-1])
    whole = cut.window(left, right, margin)
    if (right - left) <= _FLATTEST * (whole[3] - whole[2]):
        return whole
    # A flat sheet: more air above and below first, then less of its length.
    air = min((right - left) / _FLATTEST, float(cut.heights[-1] - cut.heights[0]))
    extra = max(0.0, air - (whole[3] - whole[2])) / 2
    low, high = max(whole[2] - extra, float(cut.heights[0])), min(whole[3] + extra, float(cut.heights[-1]))
    longest = 2 * _FLATTEST * (high - low)
    if right - left <= longest:
        return left, right, low, high
    middle = (left + right) / 2
    return cut.window(middle - longest / 2, middle + longest / 2, margin)


def _clear_place(cut: Slice, span: tuple[float, float, float, float]) -> float:
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


def _lines(axes: Axes, cut: Slice, window: tuple[float, float, float, float], width: float) -> None:
    """Draw the surfaces over the grey values."""
    for name, _, colour, dash in LINES:
        if name == "centre":
            axes.plot(cut.x, cut.lines[name], color=colour, ls=dash, lw=0.8 * width)
            continue
        axes.plot(cut.x, cut.lines[name], color=colour, ls=dash, lw=0.7 * width, alpha=0.4)
        axes.plot(cut.x, np.where(cut.used, cut.lines[name], np.nan), color=colour, ls=dash, lw=width)
    axes.set_xlim(window[0], window[1])
    axes.set_ylim(window[2], window[3])
    frame(axes)


def _letter(k: int) -> str:
    return chr(ord("A") + k)
