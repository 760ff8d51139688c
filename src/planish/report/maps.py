"""The property maps of the flattened sheet, each with its own distribution along the colour bar."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from numpy.typing import NDArray

from planish.report.draw import (
    ACCENT,
    BESIDE,
    FULL,
    HALF,
    HIGHEST,
    LOWEST_BAR,
    SOFT,
    Array,
    Canvas,
    Picture,
    colour_bar,
    field,
    fit_box,
    limits,
    panel,
    panel_height,
    scale_bar,
    show,
)
from planish.report.draw import pitch as step_of
from planish.report.text import count, in_figure, in_words, number, plain, unit

PROPERTY = "viridis"
CYCLIC = "twilight"
GREYS = "gray"
_BESIDE = 1.62  # inches for the distribution, the colour bar and its numbers
_BINS = 80


def draw_maps(maps: xr.Dataset, names: list[str], *, headline: str | None, rim_um: float) -> list[Picture]:
    """Draw every property that was measured anywhere, the headline first and large.

    Parameters
    ----------
    maps : Dataset, dims (v, u)
    names : list of str
        The properties, in their order.
    headline : str or None
        The property that takes the whole width.
    rim_um : float
        Width of the rim left out around holes, for the caption.
    """
    there = [name for name in names if name in maps and bool(np.isfinite(maps[name].values).any())]
    first = headline if headline in there else (there[0] if there else None)
    ordered = [name for name in there if name == first] + [name for name in there if name != first]
    return [_draw(maps, name, FULL if name == first else HALF, rim_um) for name in ordered]


def _draw(maps: xr.Dataset, name: str, width: float, rim_um: float) -> Picture:
    data = maps[name]
    values = data.values.astype(np.float64)
    rows, cols = maps["v"].values, maps["u"].values
    shown = field(values, rows, cols, width=width - _BESIDE)
    box = fit_box(shown, width - _BESIDE, 6.4 if width == FULL else 4.8)
    known = values[np.isfinite(values)]
    mean, sd = float(known.mean()), float(known.std())
    norm, colours = colours_of(data, known)
    high = max(box[1], LOWEST_BAR)
    canvas = Canvas(width, high + 0.34)
    show(canvas.axes(0.02, 0.03, *box), shown, norm=norm, cmap=colours)
    left = box[0] + 0.14
    colour_bar(canvas.axes(left, 0.03, 0.13, high), norm=norm, cmap=colours)
    label = label_of(data)
    canvas.text(box[0] + _BESIDE - 0.03, 0.03 + high / 2, label, rotation=90, va="center", ha="right", fontsize=8.5)
    _distribution(canvas.axes(left + 0.55, 0.03, 0.62, high), known, norm, mean, sd)
    scale_bar(canvas, 0.02, box[1] + 0.06, inches=box[0], um=shown.width)
    grid = f"{plain(round(step_of(rows), 4))}"
    return canvas.picture(
        kind="jpeg",
        title=str(data.attrs.get("long_name", name)),
        caption=(
            f"{number(mean)} ± {number(sd)} {unit(str(data.attrs.get('units', 'um')))} (mean ± standard deviation). "
            f"n = {count(known.size)} map pixels of {grid}; mask: columns with both faces found, holes and "
            f"{plain(rim_um)} around them left out (grey). Colours from the 1st to the 99th percentile."
        ),
    )


def colours_of(data: xr.DataArray, known: Array) -> tuple[Normalize, str]:
    """Return the colour limits of a map and the name of its colours."""
    name = str(data.name)
    # An angle of fibres begins again at 180 degrees, and so must its colours.
    if str(data.attrs.get("units")) == "deg" and name.endswith("angle"):
        return Normalize(0.0, 180.0), CYCLIC
    return limits(known), GREYS if name == "image" else PROPERTY


def label_of(data: xr.DataArray) -> str:
    """Return a map's title with its unit, as a figure can show it."""
    title = in_figure(str(data.attrs.get("long_name", data.name)))
    units = in_figure(unit(str(data.attrs.get("units", "um"))))
    return f"{title} / {units}" if units else title


def draw_beside(
    maps: tuple[xr.DataArray, xr.DataArray],
    valid: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    *,
    names: tuple[str, str],
    shared: bool,
) -> Picture:
    """Draw two maps on one grid side by side.

    Parameters
    ----------
    maps : (DataArray, DataArray), dims (y, x)
    valid : (ndarray of bool, ndarray of bool), shape (rows, cols)
        What is shown of each.
    names : (str, str)
        Whose maps they are.
    shared : bool
        Whether they have one scale of colours, as where both are of the same quantity.
    """
    shown = [np.where(use, m.values.astype(np.float64), np.nan) for m, use in zip(maps, valid, strict=True)]
    known = [values[np.isfinite(values)] for values in shown]
    both = np.concatenate(known)
    y, x = maps[0]["y"].values, maps[0]["x"].values
    fields = [field(values, y, x, width=HALF - BESIDE) for values in shown]
    box = fit_box(fields[0], HALF - BESIDE, HIGHEST)
    canvas = Canvas(FULL, panel_height(box, "colours") + 0.62)
    for data, drawn, own, name, left in zip(maps, fields, known, names, (0.0, FULL - HALF), strict=True):
        norm, colours = colours_of(data, both if shared else own)
        canvas.text(left + 0.02, 0.18, in_figure(name), fontweight="bold", fontsize=9.5, va="baseline")
        panel(canvas, left, 0.24, drawn, box, norm=norm, cmap=colours, label=label_of(data))
    titles = [f"{in_words(str(m.attrs.get('long_name', m.name)))} of {n}" for m, n in zip(maps, names, strict=True)]
    units = [unit(str(m.attrs.get("units", "um"))) or "none" for m in maps]
    return canvas.picture(
        kind="jpeg",
        title=f"{names[0]} on the pixels of {names[1]}",
        caption=(
            f"Left, {titles[0]}; right, {titles[1]}, of the same places. "
            f"{'Both have one scale of colours' if shared else 'Each has colours of its own'}, from the 1st to the "
            f"99th percentile. n = {count(known[0].size)} and {count(known[1].size)} pixels of "
            f"{plain(round(step_of(x), 4))}; units: {units[0]} and {units[1]}; mask: measured, and away from holes "
            "and their rims."
        ),
    )


def _distribution(axes: Axes, known: Array, norm: Normalize, mean: float, sd: float) -> None:
    """Draw the histogram along the colour bar, with mean and standard deviation."""
    low, high = float(norm.vmin or 0.0), float(norm.vmax or 0.0)
    counts, edges = np.histogram(known, bins=_BINS, range=(low, high))
    axes.stairs(counts, edges, orientation="horizontal", fill=True, color="#b9c0c7", linewidth=0)
    axes.set_ylim(low, high)
    axes.set_xlim(0, 1.25 * max(int(counts.max()), 1))
    at = 1.14 * max(int(counts.max()), 1)
    axes.plot([at, at], [max(mean - sd, low), min(mean + sd, high)], color=ACCENT, lw=1.2, solid_capstyle="butt")
    axes.plot([at], [min(max(mean, low), high)], marker="o", ms=3.6, color=ACCENT)
    axes.set_xticks([])
    axes.set_yticks([])
    for side in ("top", "right", "bottom"):
        axes.spines[side].set_visible(False)
    axes.spines["left"].set_color(SOFT)
