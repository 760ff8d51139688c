"""Property maps of the flattened sheet, each with its distribution beside the colour bar, and two maps side by side."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.report.colours import CYCLIC, GREYS, PROPERTY, Array, Scale, limits
from planish.report.draw import (
    ACCENT,
    BESIDE,
    FULL,
    HALF,
    SOFT,
    Canvas,
    Picture,
    panel_height,
    pitch,
    reduced,
)  # fmt: skip
from planish.report.text import count, in_words, label_of, number, plain, title_of, unit_of

_BESIDE = 162.0  # pixels for the distribution, the colour bar and its numbers
_BINS = 80


def draw_maps(maps: xr.Dataset, names: list[str], *, headline: str | None, rim_um: float) -> list[Picture]:
    """Draw every property that has values, the headline first and large; ``rim_um`` around holes is left out."""
    there = [name for name in names if name in maps and bool(np.isfinite(maps[name].values).any())]
    first = headline if headline in there else (there[0] if there else None)
    ordered = sorted(there, key=lambda name: name != first)
    return [_draw(maps[name], FULL if name == first else HALF, rim_um) for name in ordered]


def _draw(data: xr.DataArray, width: float, rim_um: float) -> Picture:
    values = data.values.astype(np.float64)
    shown = reduced(values, data["v"].values, data["u"].values, width=width - _BESIDE)
    box = shown.fit(width - _BESIDE, 640.0 if width == FULL else 480.0)
    known = values[np.isfinite(values)]
    mean, sd = float(known.mean()), float(known.std())
    scale = colours_of(data, known)
    high = panel_height(box, "colours")
    canvas = Canvas(width, high + 38)
    canvas.axes(2, 8, *box, shown.extent).image(shown, scale)
    left = box[0] + 14
    canvas.colour_bar(left, 8, 13, high, scale)
    canvas.text(box[0] + _BESIDE - 8, 8 + high / 2, label_of(data), anchor="middle", upwards=True)
    _distribution(canvas, (left + 58, 8, 62, high), known, scale, mean, sd)
    canvas.scale_bar(2, box[1] + 10, width=box[0], um=shown.width)
    return canvas.picture(
        title=title_of(data),
        caption=(
            f"{number(mean)} ± {number(sd)} {unit_of(data)} (mean ± standard deviation). "
            f"n = {count(known.size)} map pixels of {plain(round(pitch(data['v'].values), 4))}; mask: columns "
            f"with both faces found, without holes and a rim of {plain(rim_um)} around them (grey). Colours span "
            "the 1st to the 99th percentile."
        ),
    )


def colours_of(data: xr.DataArray, known: Array) -> Scale:
    """Return the colours of a map."""
    # An angle of fibres begins again at 180 degrees, and so must its colours.
    if str(data.attrs.get("units")) == "deg" and str(data.name).endswith("angle"):
        return Scale(0.0, 180.0, CYCLIC)
    return limits(known, GREYS if data.name == "image" else PROPERTY)


def draw_beside(
    maps: tuple[xr.DataArray, xr.DataArray], valid: tuple[NDArray[np.bool_], NDArray[np.bool_]], *,
    names: tuple[str, str], shared: bool,
) -> Picture:  # fmt: skip
    """Draw two maps (y, x) on one grid side by side, where each is valid; ``shared``: they have one colour scale."""
    shown = [np.where(use, m.values.astype(np.float64), np.nan) for m, use in zip(maps, valid, strict=True)]
    known = [values[np.isfinite(values)] for values in shown]
    y, x = maps[0]["y"].values, maps[0]["x"].values
    fields = [reduced(values, y, x, width=HALF - BESIDE) for values in shown]
    box = fields[0].fit(HALF - BESIDE, 480.0)
    canvas = Canvas(FULL, panel_height(box, "colours") + 64)
    for data, drawn, own, name, left in zip(maps, fields, known, names, (0.0, FULL - HALF), strict=True):
        canvas.text(left + 2, 18, name, bold=True, size=13)
        scale = colours_of(data, np.concatenate(known) if shared else own)
        canvas.panel(left, 24, drawn, box, scale=scale, label=label_of(data))
    titles = [f"{in_words(title_of(m))} of {n}" for m, n in zip(maps, names, strict=True)]
    units = [unit_of(m) or "none" for m in maps]
    return canvas.picture(
        title=f"{names[0]} on the pixels of {names[1]}",
        caption=(
            f"Left, {titles[0]}; right, {titles[1]}, at the same places. "
            f"{'Both have the same colour scale' if shared else 'Each has its own colour scale'}, from the 1st to the "
            f"99th percentile. n = {count(known[0].size)} and {count(known[1].size)} pixels of "
            f"{plain(round(pitch(x), 4))}; units: {units[0]} and {units[1]}; mask: measured, without holes and rims."
        ),
    )


def _distribution(
    canvas: Canvas, box: tuple[float, float, float, float], known: Array, scale: Scale, mean: float, sd: float
) -> None:
    """Draw the histogram along the colour bar, with mean and standard deviation."""
    low, high = scale.low, scale.high
    counts, edges = np.histogram(known, bins=_BINS, range=(low, high))
    most = max(int(counts.max()), 1)
    axes = canvas.axes(*box, (0, 1.25 * most, low, high))
    outline = np.stack([np.repeat([0, *counts, 0], 2)[1:-1], np.repeat(edges, 2)], axis=1)
    axes.area(outline, colour="#b9c0c7")
    axes.line([(0, low), (0, high)], colour=SOFT, width=1.6)
    at = 1.14 * most
    axes.line([(at, max(mean - sd, low)), (at, min(mean + sd, high))], colour=ACCENT, width=1.6)
    axes.dots([(at, min(max(mean, low), high))], colour=ACCENT, size=5)
