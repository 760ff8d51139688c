"""A map as a picture with colour bar, axes in um and scale bar: PNG, or SVG to edit."""

import math
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import style
from matplotlib.colors import Colormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from planish.core.area import area_mean
from planish.core.numbers import round_step, unit
from planish.core.typing import Entries, Singles
from planish.exports.content import ExportHistory, Maps, percentile_limits
from planish.exports.formats import ExportParams
from planish.report.colours import MISSING, Scale

MOST = 2000
"""Pixels of the longer side of a map in a picture; a larger one is brought to it by means over
areas."""

_DPI = 200
_LEFT, _TOP, _RIGHT, _BELOW = 180, 84, 260, 160  # pixels around the map
_INK, _SOFT = "#22292f", "#66707a"
_STYLE: Entries = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 8.5,
    "svg.fonttype": "none",
    "svg.hashsalt": "planish",
    "text.parse_math": False,
    "text.color": _INK,
    "axes.edgecolor": _SOFT,
    "axes.labelcolor": _INK,
    "xtick.color": _SOFT,
    "ytick.color": _SOFT,
    "xtick.labelcolor": _INK,
    "ytick.labelcolor": _INK,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "axes.unicode_minus": True,
}


def write(maps: Maps, path: Path, history: ExportHistory, params: ExportParams) -> None:
    """Draw one map as PNG, or SVG with text as text.

    Colours span its chosen limits, or the 1st to 99th percentile of the pixels that are drawn: 0 to
    1 where none has a value.
    """
    (name,) = maps.names
    pixels, reduction = _reduced(maps, name)
    scale = maps.scales.get(name) or Scale(*percentile_limits(pixels))
    note = history.json(**maps.facts(), map=name, low=scale.low, high=scale.high, reduced=reduction)
    program_fields: Entries = {"Date": None, "Creator": history.program}
    if params.to == "png":
        program_fields = {"Software": history.program}
    metadata = program_fields | {"Title": maps.titles[name], "Description": note}
    with style.context(["default", _STYLE]), path.open("wb") as file:  # whatever the user has set
        _figure(maps, pixels, reduction, scale).savefig(file, format=params.to, metadata=metadata)


def colormap_of(scale: Scale) -> Colormap:
    """Return the colours of a scale; missing values are grey."""
    return mpl.colormaps[scale.colours].with_extremes(bad=MISSING)


def _reduced(maps: Maps, name: str) -> tuple[Singles, float]:
    """Give a map's values, at most as fine as a picture shows, and how much they were reduced."""
    reduction = max(1.0, max(maps.shape) / MOST)
    if reduction > 1:
        means = area_mean(maps.data[name], (reduction, reduction))
        return means.astype(np.float32), reduction
    return maps.whole(name, np.float32), reduction


def _figure(maps: Maps, pixels: Singles, reduction: float, scale: Scale) -> Figure:
    """Lay the picture out in pixels.

    Every pixel of the map is the same number of whole pixels wide and high.
    """
    (name,) = maps.names
    (dy_um, dx_um), (y0, x0) = maps.pixel_um, maps.origin_um
    rows, cols = pixels.shape
    pixel_aspect = dy_um / dx_um
    # A map whose longer side has fewer pixels is drawn larger, by a whole number.
    magnification = max(1, math.ceil(1000 / max(rows * pixel_aspect, cols)))
    width_px = cols * magnification
    height_px = round(rows * pixel_aspect * magnification)
    size_px = (_LEFT + max(width_px, 420) + _RIGHT, _TOP + max(height_px, 300) + _BELOW)
    figure = Figure(figsize=(size_px[0] / _DPI, size_px[1] / _DPI), dpi=_DPI, facecolor="white")

    def box(x: float, y: float, w: float, h: float) -> Any:
        """Axes at pixels from the upper left corner."""
        return figure.add_axes(
            (x / size_px[0], 1 - (y + h) / size_px[1], w / size_px[0], h / size_px[1])
        )

    x0, y0 = x0 - dx_um / 2, y0 - dy_um / 2
    extent = (x0, x0 + cols * dx_um * reduction, y0 + rows * dy_um * reduction, y0)
    map_axes = box(_LEFT, _TOP, width_px, height_px)
    map_image = map_axes.imshow(
        np.ma.masked_invalid(pixels),
        cmap=colormap_of(scale),
        vmin=scale.low,
        vmax=scale.high,
        extent=extent,
        interpolation="nearest",
        aspect="auto",
    )
    map_axes.locator_params(nbins=max(3, min(9, width_px // 160)), axis="x")
    map_axes.locator_params(nbins=max(3, min(9, height_px // 110)), axis="y")
    map_axes.set(xlabel=f"{maps.dims[1]} / µm", ylabel=f"{maps.dims[0]} / µm")
    colour_bar = figure.colorbar(
        map_image, cax=box(_LEFT + width_px + 40, _TOP, 36, max(height_px, 300))
    )
    colour_bar.outline.set_linewidth(0.6)  # pyright: ignore
    colour_bar.set_label(unit(maps.units[name]))
    figure.text(
        _LEFT / size_px[0],
        1 - 0.6 * _TOP / size_px[1],
        maps.titles[name],
        fontsize=10,
        fontweight="bold",
        va="center",
    )
    map_um = cols * dx_um * reduction
    length_um = round_step(map_um / 4)
    y = 30 / size_px[1]
    bar_ends = _LEFT / size_px[0], (_LEFT + length_um / map_um * width_px) / size_px[0]
    figure.add_artist(Line2D(bar_ends, (y, y), color=_INK, lw=2.4, solid_capstyle="butt"))
    length_text = f"{length_um / 1000:g} mm" if length_um >= 1000 else f"{length_um:g} µm"
    figure.text(bar_ends[1] + 18 / size_px[0], y, length_text, va="center")
    return figure
