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
    shown = {"map": name, "low": scale.low, "high": scale.high, "reduced": reduction}
    note = history.json(**maps.facts(), **shown)
    program_fields: Entries = {"Date": None, "Creator": history.program}
    if params.to == "png":
        program_fields = {"Software": history.program}
    metadata = program_fields | {"Title": maps.titles[name], "Description": note}
    with style.context(["default", _STYLE]), path.open("wb") as file:  # whatever the user has set
        figure = _figure(maps, pixels, reduction, scale)
        figure.savefig(file, format=params.to, metadata=metadata)


def colormap_of(scale: Scale) -> Colormap:
    """Return the colours of a scale; missing values are grey."""
    return mpl.colormaps[scale.colours].with_extremes(bad=MISSING)


def _reduced(maps: Maps, name: str) -> tuple[Singles, float]:
    """Give a map's values (rows, cols), at most as fine as a picture shows them.

    Also how many pixels of the map make one of them along either axis.
    """
    reduction = max(1.0, max(maps.shape) / MOST)
    if reduction > 1:
        means = area_mean(maps.data[name], (reduction, reduction))
        return means.astype(np.float32), reduction
    return maps.whole(name, np.float32), reduction


def _figure(maps: Maps, pixels: Singles, reduction: float, scale: Scale) -> Figure:
    """Lay the picture out in pixels.

    Every pixel of the map is the same number of whole pixels wide and high. ``pixels`` (rows, cols)
    are as :func:`_reduced` gives them, each ``reduction`` pixels of the map along either axis.
    """
    (name,) = maps.names
    dy_um, dx_um = maps.pixel_um
    y0, x0 = maps.origin_um
    rows, cols = pixels.shape
    pixel_aspect = dy_um / dx_um
    # A map whose longer side has fewer pixels is drawn larger, by a whole number.
    magnification = max(1, math.ceil(1000 / max(rows * pixel_aspect, cols)))
    width_px = cols * magnification
    height_px = round(rows * pixel_aspect * magnification)
    # A small map still has room for its title and the numbers of its colour bar.
    bar_px = max(height_px, 300)
    page_width = _LEFT + max(width_px, 420) + _RIGHT
    page_height = _TOP + bar_px + _BELOW
    figure = Figure(figsize=(page_width / _DPI, page_height / _DPI), dpi=_DPI, facecolor="white")

    def box(x: float, y: float, width: float, height: float) -> Any:
        """Axes at pixels from the upper left corner; matplotlib has shares from the lower one."""
        bottom = 1 - (y + height) / page_height
        return figure.add_axes((x / page_width, bottom, width / page_width, height / page_height))

    # Outer edges of the map, from the middle of its first pixel.
    left_um = x0 - dx_um / 2
    top_um = y0 - dy_um / 2
    map_um = cols * dx_um * reduction
    extent = (left_um, left_um + map_um, top_um + rows * dy_um * reduction, top_um)
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
    # Numbers along x are wider than along y are high.
    for axis, spaces in (("x", width_px // 160), ("y", height_px // 110)):
        map_axes.locator_params(nbins=max(3, min(9, spaces)), axis=axis)
    map_axes.set(xlabel=f"{maps.dims[1]} / µm", ylabel=f"{maps.dims[0]} / µm")
    bar_axes = box(_LEFT + width_px + 40, _TOP, 36, bar_px)
    colour_bar = figure.colorbar(map_image, cax=bar_axes)
    colour_bar.outline.set_linewidth(0.6)  # pyright: ignore
    colour_bar.set_label(unit(maps.units[name]))
    left = _LEFT / page_width
    title_y = 1 - 0.6 * _TOP / page_height
    title_style: Entries = {"fontsize": 10, "fontweight": "bold", "va": "center"}
    figure.text(left, title_y, maps.titles[name], **title_style)
    length_um = round_step(map_um / 4)
    y = 30 / page_height
    right = (_LEFT + length_um / map_um * width_px) / page_width
    length_line = Line2D((left, right), (y, y), color=_INK, lw=2.4, solid_capstyle="butt")
    figure.add_artist(length_line)
    length_text = f"{length_um:g} µm"
    if length_um >= 1000:
        length_text = f"{length_um / 1000:g} mm"
    figure.text(right + 18 / page_width, y, length_text, va="center")
    return figure
