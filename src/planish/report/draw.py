"""What every figure is made of: SVG measured in CSS pixels, maps in it as images, scale bars, colour bars, axes.

Text and lines stay sharp on screen and paper; the same numbers give the same bytes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from html import escape

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planish.core.area import area_mean
from planish.report.colours import MISSING, Array, Scale, image_uri
from planish.report.text import fixed, plain

Extent = tuple[float, float, float, float]
"""Left, right, bottom and top in um, or in the units of a plot."""

FULL, HALF = 1040.0, 510.0  # CSS pixels: the page's column, and half of it
BESIDE = 86.0  # to the right of a map on half a page: its colour bar
INK, SOFT, FAINT = "#22292f", "#66707a", "#c9ced3"
ACCENT, POINT = "#b3402a", "#2f6690"
SMALL, BIG = 11.0, 12.0  # font sizes

_DENSITY = 1.35  # pixels of an image in one CSS pixel
_TOP = 8.0  # above a map: half a line, for a number at the end of the colour bar
_HIGHEST = 480.0  # of a map on half a page
_LOWEST_BAR = 130.0  # of a colour bar beside a map that is lower than that


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A figure ready for the page: SVG, its size in CSS pixels, and what it shows with n, unit and mask."""

    svg: str
    width: float
    height: float
    title: str
    caption: str


@dataclass(frozen=True, slots=True)
class Field:
    """A map at most as fine as the figure that shows it, with its place in um (left, right, bottom, top)."""

    values: Array
    extent: Extent

    @property
    def width(self) -> float:
        """Extent across, in um."""
        return abs(self.extent[1] - self.extent[0])

    @property
    def height(self) -> float:
        """Extent down, in um."""
        return abs(self.extent[3] - self.extent[2])

    def fit(self, width: float, height: float) -> tuple[float, float]:
        """Return the largest width and height that keep its proportions."""
        ratio = self.height / self.width
        return (width, width * ratio) if width * ratio <= height else (height / ratio, height)


class Canvas:
    """A figure whose parts are placed in CSS pixels from its upper left corner."""

    def __init__(self, width: float, height: float) -> None:
        self.width, self.height = width, height
        self._parts: list[str | Axes] = []

    def axes(self, left: float, top: float, width: float, height: float, extent: Extent) -> Axes:
        """Add axes over (left, right, bottom, top) in the units of the data; what is drawn in them ends at them."""
        axes = Axes(self, left, top, width, height, extent)
        self._parts.append(axes)
        return axes

    def text(
        self, x: float, y: float, text: str, *, size: float = BIG, anchor: str = "start", bold: bool = False,
        colour: str = INK, upwards: bool = False,
    ) -> None:  # fmt: skip
        """Write a text whose base line begins, ends or has its middle at a place."""
        self._parts.append(_text(x, y, text, size=size, anchor=anchor, bold=bold, colour=colour, upwards=upwards))

    def line(self, points: ArrayLike, *, colour: str, width: float, dash: str = "") -> None:
        """Draw a line."""
        self._parts.append(_stroke(_path(np.asarray(points, dtype=np.float64)), colour, width, dash=dash))

    def box(self, left: float, top: float, width: float, height: float, *, fill: str, stroke: str = "none") -> None:
        """Draw a rectangle."""
        self._parts.append(
            f'<rect x="{_n(left)}" y="{_n(top)}" width="{_n(width)}" height="{_n(height)}" fill="{fill}" '
            f'stroke="{stroke}"/>'
        )

    def scale_bar(
        self, left: float, top: float, *, width: float, um: float, most: float = 0.3, colour: str = INK,
        label: str = "{}",
    ) -> None:  # fmt: skip
        """Draw a round length below axes that show ``um`` on so many pixels."""
        bar = round_below(most * um)
        across = bar / um * width
        self.line([(left, top + 10), (left + across, top + 10)], colour=colour, width=3)
        self.text(left + across + 7, top + 14, label.format(plain(bar)), size=SMALL)

    def colour_bar(
        self, left: float, top: float, width: float, height: float, scale: Scale, *,
        label: Callable[[float], str] | None = None, marks: Array | None = None,
    ) -> None:  # fmt: skip
        """Draw the colours of a scale with their values, upwards, or to the right where it is wider than high."""
        across = width > height
        shades = (
            np.linspace(scale.low, scale.high, 128)[None]
            if across
            else np.linspace(scale.high, scale.low, 128)[:, None]
        )
        self._parts.append(_image((left, top, width, height), shades, scale))
        ticks, step = round_ticks(
            scale.low, scale.high, most=int((width if across else height) / (58 if across else 42))
        )
        values = ticks if marks is None else marks
        write = label or _decimals(step)
        for value, share in zip(values, (values - scale.low) / (scale.high - scale.low), strict=True):
            if across:
                x = left + share * width
                self.line([(x, top + height), (x, top + height + 3)], colour=SOFT, width=0.8)
                self.text(x, top + height + 15, write(float(value)), size=SMALL, anchor="middle")
            else:
                y = top + (1 - share) * height
                self.line([(left + width, y), (left + width + 3, y)], colour=SOFT, width=0.8)
                self.text(left + width + 6, y + 4, write(float(value)), size=SMALL)

    def panel(
        self, left: float, top: float, shown: Field, box: tuple[float, float], *, scale: Scale, label: str
    ) -> Axes:  # fmt: skip
        """Put a map with its scale bar, and with its colour bar where there is a label, somewhere on the canvas."""
        axes = self.axes(left + 1, top + _TOP, *box, shown.extent)
        axes.image(shown, scale)
        self.scale_bar(left + 1, top + _TOP + box[1] + 3, width=box[0], um=shown.width)
        if label:
            high = max(box[1], _LOWEST_BAR)
            self.colour_bar(left + box[0] + 12, top + _TOP, 12, high, scale)
            self.text(left + box[0] + BESIDE - 4, top + _TOP + high / 2, label, anchor="middle", upwards=True)
        return axes

    def picture(self, *, title: str, caption: str) -> Picture:
        """Return the finished figure."""
        parts = "".join(part if isinstance(part, str) else part.svg() for part in self._parts)
        size = f'width="{_n(self.width)}" height="{_n(self.height)}" viewBox="0 0 {_n(self.width)} {_n(self.height)}"'
        svg = f'<svg {size} role="img" aria-label="{escape(title)}">{parts}</svg>'
        return Picture(svg=svg, width=self.width, height=self.height, title=title, caption=caption)


@dataclass(slots=True)
class Axes:
    """A part of a canvas with coordinates of its own: um, or the units of a plot."""

    canvas: Canvas
    left: float
    top: float
    width: float
    height: float
    extent: Extent
    parts: list[str] = field(default_factory=list[str])

    def svg(self) -> str:
        """Return all that was drawn."""
        box = f'x="{_n(self.left)}" y="{_n(self.top)}" width="{_n(self.width)}" height="{_n(self.height)}"'
        return f"<svg {box}>{''.join(self.parts)}</svg>"

    def place(self, points: ArrayLike) -> Array:
        """Return points (n, 2) in pixels of the axes."""
        x0, x1, y0, y1 = self.extent
        data = np.asarray(points, dtype=np.float64)
        return np.stack(
            [(data[:, 0] - x0) / (x1 - x0) * self.width, (data[:, 1] - y1) / (y0 - y1) * self.height], axis=1
        )

    def image(self, shown: Field, scale: Scale, *, missing: str = MISSING) -> None:
        """Fill the axes with a map within a thin frame; what is missing is neutral grey."""
        left, right, bottom, top = shown.extent
        (x0, y0), (x1, y1) = self.place([(left, top), (right, bottom)])
        self.parts.append(_image((x0, y0, x1 - x0, y1 - y0), shown.values, scale, missing))
        self.frame()

    def frame(self, colour: str = FAINT) -> None:
        """Draw a thin frame without ticks: the scale bar says how large things are."""
        self.parts.append(f'<rect width="100%" height="100%" fill="none" stroke="{colour}"/>')

    def line(
        self, points: ArrayLike, *, colour: str, width: float = 1.2, dash: str = "", opacity: float = 1.0
    ) -> None:  # fmt: skip
        """Draw a line through points (n, 2); NaN interrupts it."""
        self.parts.append(_stroke(_path(self.place(points)), colour, width, dash=dash, opacity=opacity))

    def area(self, points: ArrayLike, *, colour: str, opacity: float = 1.0) -> None:
        """Fill the area within points (n, 2)."""
        shade = f' opacity="{opacity:g}"' if opacity < 1 else ""
        self.parts.append(f'<path d="{_path(self.place(points))}z" fill="{colour}"{shade}/>')

    def dots(self, points: ArrayLike, *, colour: str, size: float, opacity: float = 1.0, halo: str = "") -> None:
        """Draw round dots."""
        at = self.place(points)
        data = "".join(f"M{_n(x)} {_n(y)}h0" for x, y in at[np.isfinite(at).all(axis=1)])
        for ink, width in ((halo, size + 2.8), (colour, size)):
            if ink and data:
                self.parts.append(_stroke(data, ink, width, opacity=opacity, cap="round"))

    def text(
        self, at: tuple[float, float], text: str, *, shift: tuple[float, float] = (0, 0), size: float = BIG,
        anchor: str = "start", colour: str = INK, halo: str = "", bold: bool = False,
    ) -> None:  # fmt: skip
        """Write at a place of the data, moved by some pixels."""
        x, y = self.place([at])[0] + shift
        self.parts.append(_text(x, y, text, size=size, anchor=anchor, bold=bold, colour=colour, halo=halo))

    def circle(self, at: tuple[float, float], diameter: float, *, colour: str) -> None:
        """Draw a circle around a place, as large as so many units across."""
        x, y = self.place([at])[0]
        radius = diameter / 2 / abs(self.extent[1] - self.extent[0]) * self.width
        self.parts.append(
            f'<circle cx="{_n(x)}" cy="{_n(y)}" r="{_n(radius)}" fill="none" stroke="{colour}" stroke-width="1.9"/>'
        )

    def arrows(self, points: ArrayLike, vectors: ArrayLike, *, colour: str, width: float, halo: str = "white") -> None:
        """Draw arrows that start at points and are as long as vectors (both (n, 2), in the units of the data)."""
        at = self.place(points)
        end = self.place(np.asarray(points) + np.asarray(vectors))
        shafts, heads = "", ""
        for (x, y), (u, v) in zip(at, end, strict=True):
            far = math.hypot(u - x, v - y)
            if not far > 0.3:
                continue
            head = min(4.5 * width, 0.6 * far)
            c, s = (u - x) / far * head, (v - y) / far * head
            shafts += f"M{_n(x)} {_n(y)}L{_n(u - 0.8 * c)} {_n(v - 0.8 * s)}"
            wings = [f"L{_n(u - c - k * s)} {_n(v - s + k * c)}" for k in (0.45, -0.45)]
            heads += f"M{_n(u)} {_n(v)}{''.join(wings)}z"
        if not shafts:
            return
        for ink, extra in ((halo, 2.4), (colour, 0.0)) if halo else ((colour, 0.0),):
            self.parts.append(_stroke(shafts, ink, width + extra))
            self.parts.append(f'<path d="{heads}" fill="{ink}" stroke="{ink}" stroke-width="{_n(extra)}"/>')

    def contours(self, shown: Field, levels: Array, *, labels: bool = False, avoid: Array | None = None) -> None:
        """Draw contour lines of a field in white, with their values on request, away from some places."""
        from contourpy import LineType, contour_generator

        rows, cols = shown.values.shape
        known = shown.values[np.isfinite(shown.values)]
        if min(rows, cols) < 2 or known.size == 0:
            return
        left, right, bottom, top = shown.extent
        x = left + (np.arange(cols) + 0.5) * (right - left) / cols
        y = top + (np.arange(rows) + 0.5) * (bottom - top) / rows
        found = contour_generator(x, y, np.ma.masked_invalid(shown.values), line_type=LineType.Separate)
        taken = [] if avoid is None else list(self.place(avoid))
        for level in levels[(levels > known.min()) & (levels < known.max())]:
            lines = [self.place(line) for line in found.lines(float(level)) if isinstance(line, np.ndarray)]
            data = "".join(_path(line) for line in lines)
            self.parts.append(_stroke(data, "white", 1.4 if labels else 0.8, opacity=0.9 if labels else 0.7))
            if labels and lines:
                at = self._roomiest(max(lines, key=len), taken)
                taken.append(at)
                self.parts.append(
                    _text(at[0], at[1] + 4, f"{level:g}", size=SMALL, anchor="middle", colour="white", halo=INK)
                )

    def _roomiest(self, line: Array, taken: list[Array]) -> Array:
        """Return the point of a line that is farthest from the border and from other labels."""
        room = np.min([line[:, 0], self.width - line[:, 0], line[:, 1], self.height - line[:, 1]], axis=0)
        for other in taken:
            room = np.minimum(room, np.hypot(*(line - other).T))
        return line[int(np.argmax(room))]

    def outline(self, inside: NDArray[np.bool_], y: Array, x: Array, *, colour: str, width: float) -> None:
        """Draw the border of a region along the edges of its pixels."""
        padded = np.pad(inside.astype(np.int8), 1)
        corners = [float(c[0]) + (np.arange(c.size + 1) - 0.5) * pitch(c) for c in (x, y)]
        x0, x1, y0, y1 = self.extent
        across, down = (corners[0] - x0) / (x1 - x0) * self.width, (corners[1] - y1) / (y0 - y1) * self.height
        data = ""
        for step, edges in (("h", np.diff(padded, axis=0)), ("v", np.diff(padded, axis=1).T)):
            ends = np.diff((edges != 0).astype(np.int8), axis=1)
            line, start = np.nonzero(ends == 1)
            stop = np.nonzero(ends == -1)[1]
            along, place = (across, down) if step == "h" else (down, across)
            for a, b, p in zip(along[start], along[stop], place[line], strict=True):
                data += f"M{_n(a)} {_n(p)}h{_n(b - a)}" if step == "h" else f"M{_n(p)} {_n(a)}v{_n(b - a)}"
        if data:
            self.parts.append(_stroke(data, colour, width, cap="square"))

    def ticks(self, x_label: str, y_label: str, *, log: bool = False) -> None:
        """Draw the left and the lower axis with round numbers and labels; ``log``: y holds powers of ten."""
        x0, x1, y0, y1 = self.extent
        bottom, canvas = self.top + self.height, self.canvas
        canvas.line(
            [(self.left, self.top), (self.left, bottom), (self.left + self.width, bottom)], colour=SOFT, width=0.8
        )
        levels, step = round_ticks(x0, x1, most=int(self.width / 62))
        write = _decimals(step)
        for value in levels:
            x = self.left + float(self.place([(value, y0)])[0, 0])
            canvas.line([(x, bottom), (x, bottom + 4)], colour=SOFT, width=0.8)
            canvas.text(x, bottom + 17, write(float(value)), size=SMALL, anchor="middle")
        if log:
            levels = np.arange(math.ceil(y0), math.floor(y1) + 1.0)
            levels = levels[:: max(1, math.ceil(len(levels) / 6))]
        else:
            levels, step = round_ticks(y0, y1, most=int(self.height / 44))
        write = _power if log else _decimals(step)
        widest = 0
        for value in levels:
            y = self.top + float(self.place([(x0, value)])[0, 1])
            label = write(float(value))
            widest = max(widest, len(label))
            canvas.line([(self.left - 4, y), (self.left, y)], colour=SOFT, width=0.8)
            canvas.text(self.left - 7, y + 4, label, size=SMALL, anchor="end")
        canvas.text(self.left + self.width / 2, bottom + 36, x_label, anchor="middle")
        canvas.text(self.left - 18 - 6.4 * widest, self.top + self.height / 2, y_label, anchor="middle", upwards=True)


def reduced(values: ArrayLike, rows: Array, cols: Array, *, width: float) -> Field:
    """Bring a map to the resolution of axes that are ``width`` pixels wide, by area-weighted means.

    Parameters
    ----------
    values : (rows, cols)
    rows, cols : arrays
        Coordinates of the pixel centres in um.
    width : float
        CSS pixels.
    """
    data = np.asarray(values, dtype=np.float64)
    steps = (pitch(rows), pitch(cols))
    finest = max(data.shape[1] * steps[1] / (width * _DENSITY), 1e-12)
    factor = (max(1.0, finest / steps[0]), max(1.0, finest / steps[1]))
    if max(factor) > 1:
        data = area_mean(data, factor)
    down, across = (n * f * s for n, f, s in zip(data.shape, factor, steps, strict=True))
    left, top = float(cols[0]) - steps[1] / 2, float(rows[0]) - steps[0] / 2
    return Field(data, (left, left + across, top + down, top))


def pitch(coordinates: Array) -> float:
    """Return the step of a regular axis; 1 for a single point."""
    return float(coordinates[-1] - coordinates[0]) / (len(coordinates) - 1) if len(coordinates) > 1 else 1.0


def round_below(value: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above ``value``."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(k for k in (1, 2, 5) if k * power <= value * (1 + 1e-9)))


def levels_between(low: float, high: float, *, steps: int) -> tuple[Array, float]:
    """Return round levels between two values, and their step; none where the two are next to the same."""
    if not high - low > 1e-6 * max(abs(low), abs(high)):
        return np.empty(0), 0.0
    step = round_below((high - low) / steps)
    return np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1) * step, step


def round_ticks(low: float, high: float, *, most: int) -> tuple[Array, float]:
    """Return at most so many round values between two others, and their step."""
    smallest = (high - low) / max(most, 2)
    power = 10.0 ** math.floor(math.log10(smallest))
    step = power * next(k for k in (1, 2, 5, 10) if k * power >= smallest * (1 - 1e-9))
    return np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1) * step, step


def half_page(shown: Field, *, scale: Scale, label: str, width: float = HALF) -> tuple[Canvas, Axes]:
    """Half a page, or as wide as given: a map, its colour bar to the right unless there is no label, its scale bar."""
    box = shown.fit(width - BESIDE, _HIGHEST if width <= HALF else 640.0)
    canvas = Canvas(width, panel_height(box, label) + _TOP + 26)
    return canvas, canvas.panel(0.0, 0.0, shown, box, scale=scale, label=label)


def panel_height(box: tuple[float, float], label: str) -> float:
    """Return the height of a panel without its scale bar: a colour bar needs room for its numbers."""
    return max(box[1], _LOWEST_BAR if label else 0.0)


def _decimals(step: float) -> Callable[[float], str]:
    """Return a function that writes multiples of a step."""
    places = max(0, -math.floor(math.log10(step) + 1e-9)) if step > 0 else 0
    return lambda value: fixed(value, places)


def _power(value: float) -> str:
    return f"{10.0**value:g}"


def _n(value: float) -> str:
    """Write a coordinate to a tenth of a pixel."""
    return f"{round(float(value), 1) + 0.0:g}"


def _path(points: Array) -> str:
    """Return a line through points in pixels as path data; NaN interrupts it."""
    tenths = np.rint(10 * points)
    known = np.isfinite(tenths[:, 0]) & np.isfinite(tenths[:, 1])
    out: list[str] = []
    for run in np.split(np.arange(known.size), np.flatnonzero(known[1:] != known[:-1]) + 1):
        if len(run) > 1 and known[run[0]]:
            steps = np.diff(tenths[run], axis=0)
            steps = steps[np.any(steps != 0, axis=1)]
            x, y = tenths[run[0]] / 10
            out.append(f"M{x:g} {y:g}l" + " ".join([f"{v:g}" for v in (steps / 10).ravel()]))
    return "".join(out)


def _stroke(
    data: str, colour: str, width: float, *, dash: str = "", opacity: float = 1.0, cap: str = "butt"
) -> str:  # fmt: skip
    more = (f' stroke-dasharray="{dash}"' if dash else "") + (f' opacity="{opacity:g}"' if opacity < 1 else "")
    return f'<path d="{data}" fill="none" stroke="{colour}" stroke-width="{_n(width)}" stroke-linecap="{cap}"{more}/>'


def _text(
    x: float, y: float, text: str, *, size: float, anchor: str = "start", bold: bool = False, colour: str = INK,
    upwards: bool = False, halo: str = "",
) -> str:  # fmt: skip
    more = (' font-weight="600"' if bold else "") + (f' text-anchor="{anchor}"' if anchor != "start" else "")
    if upwards:
        more += f' transform="rotate(-90 {_n(x)} {_n(y)})"'
    if halo:
        more += f' stroke="{halo}" stroke-width="3" paint-order="stroke" stroke-linejoin="round"'
    return f'<text x="{_n(x)}" y="{_n(y)}" font-size="{size:g}" fill="{colour}"{more}>{escape(text)}</text>'


def _image(box: tuple[float, float, float, float], values: Array, scale: Scale, missing: str = MISSING) -> str:
    left, top, width, height = (_n(v) for v in box)
    coarse = ' style="image-rendering:pixelated"' if values.shape[1] < box[2] else ""
    return (
        f'<image x="{left}" y="{top}" width="{width}" height="{height}" preserveAspectRatio="none"{coarse} '
        f'href="{image_uri(values, scale, missing=missing)}"/>'
    )
