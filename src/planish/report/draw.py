"""What every figure is made of: a canvas measured in inches, fields decimated by area, scale bars, colour bars.

Figures are drawn by Agg without pyplot, in matplotlib's own style and typeface and not in the user's, and encoded by
Pillow: the same numbers give the same bytes.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib import patheffects, style
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from planish.core.area import area_mean
from planish.report.text import plain

Array = NDArray[np.float64]

FULL = 10.4  # inches; one inch is 100 CSS pixels, so that a full figure fills the page's column
HALF = 5.1
BESIDE = 0.86  # to the right of a map on half a page: its colour bar
DPI = 135  # a full figure is 1404 pixels wide
INK, SOFT, FAINT = "#22292f", "#66707a", "#c9ced3"
MISSING = "#d4d6d8"
ACCENT = "#b3402a"

TOP = 0.07  # inches above a map: half a line, for a number at the end of the colour bar
HIGHEST = 4.8  # inches of a map on half a page
LOWEST_BAR = 1.3  # inches of a colour bar beside a map that is lower than that
_ENOUGH = 2_000_000  # values for a percentile

_STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "axes.labelsize": 8.5,
    "axes.edgecolor": SOFT,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.6,
    "axes.unicode_minus": True,
    "text.color": INK,
    "text.parse_math": False,  # a dollar sign in a name is a dollar sign
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 3,
    "ytick.major.size": 3,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A figure ready for the page.

    Attributes
    ----------
    uri : str
        The image itself, as a ``data:`` address.
    width, height : int
        On the page, in CSS pixels.
    title, caption : str
        What it shows; n, unit and mask.
    """

    uri: str
    width: int
    height: int
    title: str
    caption: str


@dataclass(frozen=True, slots=True)
class Field:
    """A map at most as fine as the figure that shows it, with its place in um (left, right, bottom, top)."""

    values: Array
    extent: tuple[float, float, float, float]

    @property
    def width(self) -> float:
        """Extent across, in um."""
        return abs(self.extent[1] - self.extent[0])

    @property
    def height(self) -> float:
        """Extent down, in um."""
        return abs(self.extent[3] - self.extent[2])


class Canvas:
    """A figure whose parts are placed in inches from its upper left corner."""

    def __init__(self, width: float, height: float) -> None:
        self.width, self.height = width, height
        self.figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white")
        FigureCanvasAgg(self.figure)

    def axes(self, left: float, top: float, width: float, height: float, **options: Any) -> Axes:
        """Add axes."""
        box = (left / self.width, 1 - (top + height) / self.height, width / self.width, height / self.height)
        return self.figure.add_axes(box, **options)

    def text(self, left: float, top: float, text: str, **options: Any) -> Text:
        """Write on the figure itself."""
        return self.figure.text(left / self.width, 1 - top / self.height, text, **options)

    def picture(self, *, title: str, caption: str, kind: Literal["png", "jpeg"] = "png") -> Picture:
        """Render and encode: PNG for lines, JPEG for what is as irregular as a photograph."""
        canvas = FigureCanvasAgg(self.figure)
        canvas.draw()
        image = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
        data = io.BytesIO()
        if kind == "png":
            image.save(data, format="PNG", optimize=True)
        else:
            image.save(data, format="JPEG", quality=88, subsampling=0, optimize=True)
        uri = f"data:image/{kind};base64,{base64.b64encode(data.getvalue()).decode('ascii')}"
        return Picture(
            uri=uri, width=round(100 * self.width), height=round(100 * self.height), title=title, caption=caption
        )


@contextmanager
def house_style() -> Generator[None]:
    """Draw in one style, whatever the user's settings; they are restored afterwards."""
    with style.context(["default", _STYLE]):
        yield


def field(values: ArrayLike, rows: Array, cols: Array, *, width: float) -> Field:
    """Bring a map to the resolution of axes that are ``width`` inches wide, by area-weighted means.

    Parameters
    ----------
    values : (rows, cols)
    rows, cols : arrays
        Coordinates of the pixel centres in um.
    width : float
        Inches.
    """
    data = np.asarray(values, dtype=np.float64)
    steps = (pitch(rows), pitch(cols))
    finest = max(data.shape[1] * steps[1] / (width * DPI), 1e-12)
    factor = (max(1.0, finest / steps[0]), max(1.0, finest / steps[1]))
    if max(factor) > 1:
        data = area_mean(data, factor)
    down, across = (n * f * s for n, f, s in zip(data.shape, factor, steps, strict=True))
    left, top = float(cols[0]) - steps[1] / 2, float(rows[0]) - steps[0] / 2
    return Field(data, (left, left + across, top + down, top))


def pitch(coordinates: Array) -> float:
    """Return the step of a regular axis; 1 for a single point."""
    return float(coordinates[-1] - coordinates[0]) / (len(coordinates) - 1) if len(coordinates) > 1 else 1.0


def show(axes: Axes, shown: Field, *, norm: Normalize, cmap: str) -> None:
    """Draw a field in true proportions; what is missing is neutral grey."""
    axes.set_facecolor(MISSING)
    axes.imshow(
        np.ma.masked_invalid(shown.values), extent=shown.extent, norm=norm, cmap=cmap, interpolation="nearest",
        aspect="auto", origin="upper",
    )  # fmt: skip
    frame(axes)


def frame(axes: Axes) -> None:
    """Leave a thin frame without ticks: the scale bar says how large things are."""
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_color(FAINT)


def fit_box(shown: Field, width: float, height: float) -> tuple[float, float]:
    """Return the largest width and height in inches that keep a field's proportions."""
    ratio = shown.height / shown.width
    return (width, width * ratio) if width * ratio <= height else (height / ratio, height)


def scale_bar(
    canvas: Canvas, left: float, top: float, *, inches: float, um: float, most: float = 0.3,
    colour: str = INK, label: str = "{}",
) -> None:  # fmt: skip
    """Draw a round length below axes that show ``um`` on so many inches."""
    bar = round_below(most * um)
    across = bar / um * inches
    line = canvas.axes(left, top, inches, 0.24, facecolor="none")
    line.set_axis_off()
    line.set_xlim(0, inches)
    line.set_ylim(0, 1)
    line.plot([0, across], [0.62, 0.62], color=colour, lw=2.2, solid_capstyle="butt")
    line.text(across + 0.07, 0.58, label.format(plain(bar)), va="center", ha="left", fontsize=8)


def round_below(value: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above ``value``."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(k for k in (1, 2, 5) if k * power <= value * (1 + 1e-9)))


def half_page(
    shown: Field, *, norm: Normalize, cmap: str, label: str, width: float = HALF
) -> tuple[Canvas, Axes]:  # fmt: skip
    """Half a page, or as wide as told: a map, its colour bar to the right unless there is no label, its scale bar."""
    box = fit_box(shown, width - BESIDE, HIGHEST if width <= HALF else 6.4)
    canvas = Canvas(width, panel_height(box, label) + TOP + 0.31)
    return canvas, panel(canvas, 0.0, 0.0, shown, box, norm=norm, cmap=cmap, label=label)


def panel_height(box: tuple[float, float], label: str) -> float:
    """Return the height in inches of a panel without its scale bar: a colour bar needs room for its numbers."""
    return max(box[1], LOWEST_BAR if label else 0.0)


def panel(
    canvas: Canvas, left: float, top: float, shown: Field, box: tuple[float, float], *, norm: Normalize, cmap: str,
    label: str,
) -> Axes:  # fmt: skip
    """Put a map with its colour bar and its scale bar somewhere on a canvas."""
    high = panel_height(box, label)
    axes = canvas.axes(left + 0.02, top + TOP, *box)
    show(axes, shown, norm=norm, cmap=cmap)
    scale_bar(canvas, left + 0.02, top + TOP + box[1] + 0.03, inches=box[0], um=shown.width)
    if label:
        colour_bar(canvas.axes(left + box[0] + 0.12, top + TOP, 0.12, high), norm=norm, cmap=cmap)
        canvas.text(left + box[0] + BESIDE, top + TOP + high / 2, label, rotation=90, va="center", ha="right")
    return axes


def levels_between(low: float, high: float, *, steps: int) -> tuple[Array, float]:
    """Return round levels between two values, and their step; none where the two are next to the same."""
    if not high - low > 1e-6 * max(abs(low), abs(high)):
        return np.empty(0), 0.0
    step = round_below((high - low) / steps)
    return np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step, step


def contours(axes: Axes, shown: Field, levels: Array, *, labels: bool = False) -> None:
    """Draw contour lines of a field, with their values on request."""
    rows, cols = shown.values.shape
    left, right, bottom, top = shown.extent
    x = left + (np.arange(cols) + 0.5) * (right - left) / cols
    y = top + (np.arange(rows) + 0.5) * (bottom - top) / rows
    known = shown.values[np.isfinite(shown.values)]
    if min(rows, cols) < 2 or known.size == 0:
        return
    levels = levels[(levels > known.min()) & (levels < known.max())]
    if levels.size == 0:
        return
    lines = axes.contour(
        x, y, np.ma.masked_invalid(shown.values), levels=levels, colors="white", linewidths=1.0 if labels else 0.5,
        alpha=0.9 if labels else 0.7,
    )  # fmt: skip
    if labels:
        for text in axes.clabel(lines, fmt="%g", fontsize=8, inline=True):
            text.set_path_effects(halo(1.4, "#22292f"))


def limits(values: ArrayLike, *, percent: float = 1.0, symmetric: bool = False) -> Normalize:
    """Return colour limits from percentiles, so that single pixels do not flatten the rest."""
    data = np.asarray(values, dtype=np.float64)
    data = data[np.isfinite(data)]
    data = data[:: max(1, data.size // _ENOUGH)]
    if data.size == 0:
        return Normalize(0.0, 1.0)
    if symmetric:
        high = float(np.percentile(np.abs(data), 100 - percent))
        return Normalize(-(high or 1.0), high or 1.0)
    low, high = (float(v) for v in np.percentile(data, [percent, 100 - percent]))
    if high - low <= 1e-9 * max(abs(low), abs(high), 1e-300):
        return Normalize(low - 0.5, low + 0.5)
    return Normalize(low, high)


def colour_bar(axes: Axes, *, norm: Normalize, cmap: str, label: str = "", across: bool = False) -> None:
    """Fill axes with a colour bar that tells which colours also stand for what lies beyond."""
    bar = axes.figure.colorbar(
        ScalarMappable(norm=norm, cmap=cmap), cax=axes, orientation="horizontal" if across else "vertical"
    )
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    bar.set_label(label)
    bar.ax.tick_params(length=2.5)
    if across:
        bar.locator = MaxNLocator(5)
        bar.update_ticks()


def halo(width: float = 2.2, colour: str = "white") -> list[patheffects.AbstractPathEffect]:
    """Return an outline that keeps text and lines readable on any ground."""
    return [patheffects.withStroke(linewidth=width, foreground=colour)]
