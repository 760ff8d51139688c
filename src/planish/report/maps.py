"""The property maps of the flattened sheet, each with its own distribution along the colour bar."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import Normalize

from planish.report.draw import (
    ACCENT,
    FULL,
    HALF,
    LOWEST_BAR,
    SOFT,
    Array,
    Canvas,
    Picture,
    colour_bar,
    field,
    fit_box,
    limits,
    scale_bar,
    show,
)
from planish.report.draw import pitch as step_of
from planish.report.text import count, in_figure, number, plain, unit

PROPERTY = "viridis"
CYCLIC = "twilight"
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
    # An angle of fibres begins again at 180 degrees, and so must its colours.
    turns = str(data.attrs.get("units")) == "deg" and name.endswith("angle")
    norm = Normalize(0.0, 180.0) if turns else limits(known)
    colours = CYCLIC if turns else PROPERTY
    title = in_figure(str(data.attrs.get("long_name", name)))
    units = in_figure(unit(str(data.attrs.get("units", "um"))))
    high = max(box[1], LOWEST_BAR)
    canvas = Canvas(width, high + 0.34)
    show(canvas.axes(0.02, 0.03, *box), shown, norm=norm, cmap=colours)
    left = box[0] + 0.14
    colour_bar(canvas.axes(left, 0.03, 0.13, high), norm=norm, cmap=colours)
    label = f"{title} / {units}" if units else title
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
