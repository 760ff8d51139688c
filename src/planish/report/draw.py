"""What every figure is made of.

SVG in CSS pixels, sharp and the same each time, with maps as images, bars, axes.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from itertools import cycle
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from planish.core.area import area_mean
from planish.core.axial import summable
from planish.core.facts import ResultModel, is_known
from planish.core.numbers import count, fixed, length, plain, round_step
from planish.core.typing import Bools, Entries, Ints, Pair
from planish.report.colours import MISSING, Array, Scale, image_uri

Box = tuple[float, float, float, float]  # left edge, upper edge, width and height in CSS pixels
Ticks = Sequence[tuple[float, str]]  # values at which an axis is numbered, and their texts
# Left, right, bottom and top in um, or in the units of a plot.
Extent = tuple[float, float, float, float]
# CSS pixels: the page's column, half and a third of it
FULL = 1040.0
HALF = 510.0
THIRD = 333.0
BESIDE = 86.0  # to the right of a map on half a page: its colour bar
# To the left of a map and below it: the numbers of its axes
MARGIN = 44.0
BELOW = 18.0
# Greys of texts and lines, and the two colours of what is plotted
INK = "#22292f"
SOFT = "#66707a"
FAINT = "#c9ced3"
ACCENT = "#b3402a"
POINT = "#2f6690"
_COLOURS = (POINT, ACCENT, "#4a7c3f", "#8a6d1f", "#6b4c8f", "#3a8f8f", "#8f3a6b", SOFT)
LINE_PX = 17.0  # of their names, one below the other
# Font sizes
SMALL = 11.0
BIG = 12.0
_FONTS = (
    "font-family=\"'Source Sans 3','Segoe UI','Helvetica Neue','Liberation Sans',Arial,sans-serif\""
)
_TOP = 8.0  # above a map: half a line, for a number at the end of the colour bar
_ROWS_TOP = 14.0  # above the first of named rows
_ROW = 30.0  # height of one
LETTER_PX = 6.3  # of the name of a row
_LOWEST_BAR = 130.0  # of a colour bar beside a map that is lower than that


# Something that a figure shows as numbers, for those who plot it again: columns of one length, by
# their headings
Table = Mapping[str, Sequence[object]]


def columns(rows: Sequence[object], fields: Mapping[str, str]) -> Table:
    """Return fields of rows as the columns of a table, by their headings.

    What is not known is empty.
    """
    return {heading: or_blank(map(attrgetter(name), rows)) for heading, name in fields.items()}


def colours_of(names: Iterable[str]) -> dict[str, str]:
    """A colour for each of several names, the same in all figures of a page."""
    return dict(zip(names, cycle(_COLOURS), strict=False))


def or_blank(values: Iterable[float | None]) -> list[object]:
    """Return the numbers of a column; what is not known is empty."""
    return [value if is_known(value) else "" for value in values]


def flat_row(facts: ResultModel) -> dict[str, object]:
    """Numbers and words of a model, intervals as two of them."""
    row: dict[str, object] = {}
    for name, value in facts:
        if isinstance(value, tuple):
            prefix = name.removesuffix("interval")
            row[f"{prefix}low"], row[f"{prefix}high"] = value
        elif isinstance(value, str | float | int) and value != "":
            row[name] = value
    return row


def table_of(rows: Sequence[Mapping[str, object]]) -> Table:
    """Rows as columns; what is not known is empty."""
    table: dict[str, list[object]] = {}
    for name in dict.fromkeys(name for row in rows for name in row):
        values = [row.get(name) for row in rows]
        table[name] = ["" if v is None or v != v else v for v in values]
    return table


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure ready for the page.

    SVG, its size in CSS pixels, and what it shows with n, unit and mask.
    """

    svg: str
    width: float
    height: float
    title: str
    caption: str
    data: Mapping[str, Table] = field(default_factory=dict[str, Table])


@dataclass(frozen=True, slots=True)
class ShownMap:
    """A map at most as fine as the figure that shows it, with its place in um.

    The place is (left, right, bottom, top).
    """

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

    def fit(self, width: float, height: float) -> Pair:
        """Return the largest width and height that keep its proportions."""
        ratio = self.height / self.width
        if width * ratio <= height:
            return width, width * ratio
        return height / ratio, height


class Axes:
    """A rectangle of a figure with coordinates of its own: um, or the units of a plot.

    Drawings end at its border.
    """

    def __init__(self, x: float, y: float, width: float, height: float, extent: Extent) -> None:
        self.x = x
        self.y = y
        self.width = width
        self.height = height
        self.extent = extent
        self.shown = ShownMap(np.empty((0, 0)), extent)
        self._elements: list[str | Axes] = []

    def svg(self, attributes: str = "") -> str:
        """Return all that was drawn."""
        size = f'width="{_n(self.width)}" height="{_n(self.height)}"'
        position = attributes or f'x="{_n(self.x)}" y="{_n(self.y)}"'
        parts = "".join(part if isinstance(part, str) else part.svg() for part in self._elements)
        return f"<svg {position} {size}>{parts}</svg>"

    def place(self, points: ArrayLike) -> Array:
        """Return points (n, 2), (x, y) in units of the extent, in pixels from the upper left."""
        left, right, bottom, top = self.extent
        data = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        shares = (data - (left, top)) / (right - left, bottom - top)
        return shares * (self.width, self.height)

    def image(self, shown: ShownMap, scale: Scale, *, missing: str = MISSING) -> None:
        """Draw a map within a thin frame; what is missing is neutral grey.

        The scale bar says how large things are.
        """
        self.shown = shown
        left, right, bottom, top = shown.extent
        corner, far_corner = self.place([(left, top), (right, bottom)])
        box = (*corner, *(far_corner - corner))
        self._elements.append(_image(box, shown.values, scale, missing))
        self._elements.append(f'<rect width="100%" height="100%" fill="none" stroke="{FAINT}"/>')

    def line(
        self,
        x: ArrayLike,
        y: ArrayLike,
        *,
        colour: str = SOFT,
        width: float = 0.8,
        dash: str = "",
        opacity: float = 1.0,
    ) -> None:
        """Draw a line through points x, y; NaN interrupts it, one number holds for all of them."""
        path_data = _path(self.place(_pairs(x, y)))
        self._stroke(path_data, colour, width, dash=dash, opacity=opacity)

    def across(self, y: float, **style: Any) -> None:
        """Draw a line over the whole width."""
        self.line(self.extent[:2], y, **style)

    def upright(self, x: float, **style: Any) -> None:
        """Draw a line over the whole height."""
        self.line(x, self.extent[2:], **style)

    def area(self, points: ArrayLike, *, colour: str, opacity: float = 1.0) -> None:
        """Fill the area within points (n, 2)."""
        path_data = _path(self.place(points))
        self._elements.append(f'<path d="{path_data}z" fill="{colour}" opacity="{opacity:g}"/>')

    def band(self, x: ArrayLike, ends: ArrayLike) -> None:
        """Shade between the ``ends`` (n, 2) of intervals at x, where they are known."""
        points = np.column_stack([x, np.asarray(ends, dtype=np.float64)])
        points = points[np.isfinite(points).all(axis=1)]
        if len(points) > 1:
            lower = points[:, [0, 1]]
            upper = points[:, [0, 2]]
            outline = np.concatenate([lower, upper[::-1]])
            self.area(outline, colour=POINT, opacity=0.2)

    def dots(
        self,
        x: ArrayLike,
        y: ArrayLike,
        *,
        colour: str,
        size: float,
        opacity: float = 1.0,
        halo: str = "",
        is_open: bool = False,
    ) -> None:
        """Draw round dots, as :meth:`line` takes their places; open ones are white inside.

        A dot is a line of no length with round ends, whose width is its ``size`` in pixels.
        """
        pixels = self.place(_pairs(x, y))
        pixels = pixels[np.isfinite(pixels).all(axis=1)]
        path_data = "".join(f"M{_n(x_px)} {_n(y_px)}h0" for x_px, y_px in pixels)
        inks = [(halo, size + 2.8), (colour, size)]
        if is_open:
            inks.append(("white", 5))
        for ink, width in inks:
            if ink and path_data:
                self._stroke(path_data, ink, width, opacity=opacity, cap="round")

    def text(
        self,
        x: float,
        y: float,
        text: str,
        *,
        anchor: str = "start",
        upwards: bool = False,
        shift: Pair = (0, 0),
        size: float = BIG,
        colour: str = INK,
        halo: str = "",
        bold: bool = False,
    ) -> None:
        """Write a text whose base line begins, ends or has its middle at a place.

        ``anchor`` says which: start, end or middle. The place, in the units of the extent, is moved
        by ``shift`` pixels to the right and down; ``halo`` is the colour of an outline.
        """
        x_px, y_px = map(_n, self.place((x, y))[0] + shift)
        attributes = f'x="{x_px}" y="{y_px}" font-size="{size:g}" fill="{colour}"'
        if bold:
            attributes += ' font-weight="600"'
        if anchor != "start":
            attributes += f' text-anchor="{anchor}"'
        if upwards:
            attributes += f' transform="rotate(-90 {x_px} {y_px})"'
        if halo:
            outline = 'stroke-width="3" paint-order="stroke" stroke-linejoin="round"'
            attributes += f' stroke="{halo}" {outline}'
        self._elements.append(f"<text {attributes}>{escape(text)}</text>")

    def arrows(
        self,
        points: ArrayLike,
        vectors: ArrayLike,
        *,
        colour: str,
        width: float,
        halo: str = "white",
    ) -> None:
        """Draw arrows that start at points and are as long as vectors.

        Both are (n, 2), in the units of the data. ``width``: of a shaft in pixels; ``halo``: colour
        of an outline, none where it is empty.
        """
        shafts = ""
        heads = ""
        ends = self.place(np.asarray(points) + np.asarray(vectors))
        for (x, y), (u, v) in zip(self.place(points), ends, strict=True):
            length_px = math.hypot(u - x, v - y)
            if not length_px > 0.3:  # too short to be seen, or missing
                continue
            # As long as 4.5 widths, or over half of a short arrow; nearly as wide as long.
            head_share = min(4.5 * width, 0.6 * length_px) / length_px
            # The head along the arrow, in pixels to the right and down; the shaft ends within it.
            c = (u - x) * head_share
            s = (v - y) * head_share
            shafts += f"M{_n(x)} {_n(y)}L{_n(u - 0.8 * c)} {_n(v - 0.8 * s)}"
            wings = [f"L{_n(u - c - k * s)} {_n(v - s + k * c)}" for k in (0.45, -0.45)]
            heads += f"M{_n(u)} {_n(v)}{''.join(wings)}z"
        # The outline is drawn first, and shows 1.2 pixels beyond the arrow on either side.
        for ink, halo_px in ((halo, 2.4), (colour, 0.0)):
            if ink and shafts:
                self._stroke(shafts, ink, width + halo_px)
                self._elements.append(
                    f'<path d="{heads}" fill="{ink}" stroke="{ink}" stroke-width="{_n(halo_px)}"/>'
                )

    def contours(self, levels: Array, *, labels: bool = False, avoided: ArrayLike = ()) -> None:
        """Draw contour lines of the map in white.

        On request with their values, away from places ``avoided`` (n, 2) in um and from each other.
        """
        from contourpy import LineType, contour_generator

        values = self.shown.values
        left, right, bottom, top = self.shown.extent
        rows, cols = values.shape
        if min(rows, cols) < 2:
            return
        x_um = left + (np.arange(cols) + 0.5) * (right - left) / cols
        y_um = top + (np.arange(rows) + 0.5) * (bottom - top) / rows
        masked = np.ma.masked_invalid(values)  # lines end where the map is missing
        generator = contour_generator(x_um, y_um, masked, line_type=LineType.Separate)
        label_pixels = self.place(avoided)
        line_width = 0.8
        opacity = 0.7
        if labels:
            line_width = 1.4
            opacity = 0.9
        is_crossed = (levels > masked.min()) & (levels < masked.max())
        for level in levels[is_crossed]:
            # Each line is an array (n, 2) of places (x, y) in um.
            lines: Any = generator.lines(level)
            path = "".join(map(_path, map(self.place, lines)))
            self._stroke(path, "white", line_width, opacity=opacity)
            if labels and lines:
                # The longest line of a level has the value, where it is farthest from others.
                line = max(lines, key=len)
                k = self._emptiest(self.place(line), label_pixels)
                label_pixels = np.vstack([label_pixels, self.place(line[k])])
                style: Entries = {"size": SMALL, "anchor": "middle", "colour": "white", "halo": INK}
                x, y = line[k]
                self.text(x, y, f"{level:g}", shift=(0, 4), **style)

    def _emptiest(self, pixels: Array, label_pixels: Array) -> int:
        """Number of the place (n, 2) in pixels that is farthest from the border and from labels."""
        size_px = (self.width, self.height)
        border_px = np.min([pixels, size_px - pixels], axis=(0, 2))
        labels_px = [np.hypot(*(pixels - label).T) for label in label_pixels]
        nearest_px = np.min([border_px, *labels_px], axis=0)
        return int(np.argmax(nearest_px))

    def outline(self, inside: xr.DataArray, *, colour: str, width: float) -> None:
        """Draw the border of a region (y, x) along the edges of its pixels."""
        y, x = axes_of(inside)
        padded = np.pad(inside.values, 1)
        borders_across = _edges(padded)
        borders_down = _edges(padded.T)[:, ::-1]  # (y, x) turned into (x, y)
        # In pixels of the map, whose first middle is 0: corner k lies before pixel k.
        corners = np.concatenate([borders_across, borders_down]) - 0.5
        corners_um = corners * (pitch(x), pitch(y)) + (x[0], y[0])
        lines = self.place(corners_um).reshape(-1, 4)  # both ends of each border
        path_data = "".join(f"M{_n(a)} {_n(b)}L{_n(c)} {_n(d)}" for a, b, c, d in lines)
        if path_data:
            self._stroke(path_data, colour, width, cap="square")

    def _stroke(
        self,
        path_data: str,
        colour: str,
        width: float,
        *,
        dash: str = "",
        opacity: float = 1.0,
        cap: str = "butt",
    ) -> None:
        stroke = f'stroke="{colour}" stroke-width="{_n(width)}" stroke-linecap="{cap}"'
        if dash:
            stroke += f' stroke-dasharray="{dash}"'
        if opacity < 1:
            stroke += f' opacity="{opacity:g}"'
        self._elements.append(f'<path d="{path_data}" fill="none" {stroke}/>')


class Canvas(Axes):
    """A figure; its parts are placed in CSS pixels from its upper left corner."""

    def __init__(self, width: float, height: float) -> None:
        super().__init__(0.0, 0.0, width, height, (0.0, width, height, 0.0))

    def axes(self, x: float, y: float, width: float, height: float, extent: Extent) -> Axes:
        """Add axes over (left, right, bottom, top) in the units of the data."""
        axes = Axes(x, y, width, height, extent)
        self._elements.append(axes)
        return axes

    def box(self, x: float, y: float, width: float, height: float, *, fill: str) -> None:
        """Fill a rectangle."""
        box = f'x="{_n(x)}" y="{_n(y)}" width="{_n(width)}" height="{_n(height)}"'
        self._elements.append(f'<rect {box} fill="{fill}"/>')

    def scale_bar(
        self,
        x: float,
        y: float,
        *,
        width: float,
        um: float,
        max_share: float = 0.3,
        colour: str = INK,
        label: str = "{}",
    ) -> None:
        """Draw a round length below axes that show ``um`` on ``width`` pixels.

        It takes at most ``max_share`` of them; its length in words stands in place of the braces of
        ``label``.
        """
        bar_um = round_step(max_share * um)
        bar_text = label.format(plain(bar_um))
        end = x + bar_um / um * width
        self.line((x, end), y + 10, colour=colour, width=3)
        self.text(end + 7, y + 14, bar_text, size=SMALL)

    def colour_bar(
        self, x: float, y: float, width: float, height: float, scale: Scale, *, log: bool = False
    ) -> None:
        """Draw the colours of a scale with their values.

        Upwards, or to the right where it is wider than high. ``log``: values are powers of ten.
        """
        low = scale.low
        high = scale.high
        is_across = width > height
        shades = np.linspace(low, high, 128)[None]
        max_count = width / 58
        if not is_across:
            shades = np.linspace(high, low, 128)[:, None]
            max_count = height / 42
        self._elements.append(_image((x, y, width, height), shades, scale))
        for value, text in _ticks(low, high, max_count=max_count, log=log):
            share = (value - low) / (high - low)
            if is_across:
                self._tick(x + share * width, y + height, 0, 1, text)
            else:
                self._tick(x + width, y + (1 - share) * height, 1, 0, text)

    def ticks(
        self,
        axes: Axes,
        x_label: str,
        y_label: str,
        *,
        log: bool = False,
        x_ticks: Ticks | None = None,
    ) -> None:
        """Draw the left and lower axis of axes with round numbers and their labels.

        ``log``: y are exponents of ten; ``x_ticks``: places and texts in place of round numbers.
        """
        # A number needs 62 pixels across, and 44 down.
        x_min, x_max, y_min, y_max = axes.extent
        left_px = axes.x
        right_px = left_px + axes.width
        bottom_px = axes.y + axes.height
        self.line((left_px, left_px, right_px), (axes.y, bottom_px, bottom_px))
        y_ticks = _ticks(y_min, y_max, max_count=axes.height / 44, log=log)
        if x_ticks is None:
            x_ticks = _ticks(x_min, x_max, max_count=axes.width / 62)
        self.number_axes(axes, x_ticks, y_ticks)
        self.text(left_px + axes.width / 2, bottom_px + 36, x_label, anchor="middle")
        # The label of y stands beside the longest number.
        label_length = max((len(text) for _, text in y_ticks), default=0)
        x_px = left_px - 18 - 6.4 * label_length
        middle_px = axes.y + axes.height / 2
        self.text(x_px, middle_px, y_label, anchor="middle", upwards=True)

    def number_axes(self, axes: Axes, x_ticks: Ticks, y_ticks: Ticks) -> None:
        """Draw ticks with their numbers below axes and to the left of them."""
        x_min, _, y_min, _ = axes.extent
        bottom_px = axes.y + axes.height
        for value, label in x_ticks:
            x_px, _ = axes.place((value, y_min))[0]
            self._tick(axes.x + x_px, bottom_px, 0, 1, label)
        for value, label in y_ticks:
            _, y_px = axes.place((x_min, value))[0]
            self._tick(axes.x, axes.y + y_px, -1, 0, label)

    def _tick(self, x: float, y: float, right: int, down: int, text: str) -> None:
        """Draw a tick from a place of the figure in pixels, and a number behind it.

        It runs downwards (``right``, ``down`` are 0, 1), to the right (1, 0) or to the left (-1,
        0).
        """
        self.line((x, x + 3 * right), (y, y + 3 * down))
        half_px = 3.1 * len(text)  # half of the number's width: a digit is about 6.2 pixels wide
        # A long number at the end of an axis stays within the figure, and is smaller where its
        # margin is too narrow.
        if down:
            anchor = "middle"
            x_px = min(max(x, half_px), self.width - half_px)
        else:
            anchor = "start" if right > 0 else "end"
            x_px = x + 6 * right
        room_px = self.width
        if right < 0:
            room_px = x_px
        size = min(SMALL, SMALL * room_px / (2 * half_px))
        self.text(x_px, y + 4 + 12 * down, text, size=size, anchor=anchor)

    def map_axes(
        self,
        x: float,
        y: float,
        box: Pair,
        shown: ShownMap,
        scale: Scale,
        *,
        has_y_ticks: bool = True,
    ) -> Axes:
        """Draw a map with its axes in um, its upper left corner at a place.

        ``box``: width and height in pixels. The axes stand below and, on request, to the left,
        where ``MARGIN`` is needed for them.
        """
        axes = self.axes(x, y, *box, shown.extent)
        axes.image(shown, scale)
        width, height = box
        # A number needs 62 pixels across, and 44 down.
        x_min, x_max, *y_ends = shown.extent
        x_ticks = _ticks(x_min, x_max, max_count=width / 62)
        y_ticks: Ticks = []
        if has_y_ticks:
            y_ticks = _ticks(*sorted(y_ends), max_count=height / 44)
        self.number_axes(axes, x_ticks, y_ticks)
        return axes

    def draw_scale_row(
        self, axes: Axes, gap_px: float, axis_names: str = "x, y", *, max_share: float = 0.3
    ) -> None:
        """Draw a round length below a map and the numbers of its axis, and name both axes."""
        y = axes.y + axes.height + BELOW + gap_px
        self.scale_bar(axes.x, y, width=axes.width, um=axes.shown.width, max_share=max_share)
        self.draw_axis_names(axes.x + axes.width, y, axis_names)

    def draw_axis_names(self, right: float, top: float, axis_names: str = "x, y") -> None:
        """Name the axes of a map at the end of the row of its scale bar."""
        self.text(right, top + 14, f"{axis_names} / µm", size=SMALL, colour=SOFT, anchor="end")

    def panel(
        self,
        x: float,
        y: float,
        shown: ShownMap,
        box: Pair,
        *,
        scale: Scale,
        label: str,
    ) -> Axes:
        """Put a map with its axes and scale bar somewhere on the canvas, and return its axes.

        The place is the upper left corner of all of it, and ``box`` width and height of the map.
        There is a colour bar where there is a label for it.
        """
        axes = self.map_axes(x + MARGIN, y + _TOP, box, shown, scale)
        self.draw_scale_row(axes, 3)
        if label:
            right = axes.x + axes.width
            height = panel_height(box, label)
            middle = axes.y + height / 2
            self.colour_bar(right + 11, axes.y, 12, height, scale)
            self.text(right + BESIDE - 5, middle, label, anchor="middle", upwards=True)
        return axes

    def name_curves(self, titles: Iterable[str], colours: Iterable[str], xy: Pair) -> None:
        """Name curves by their colours, one below the other; the first one at ``xy``."""
        x, place = xy
        for title, colour in zip(titles, colours, strict=True):
            self.line((x, x + 18), place - 4, colour=colour, width=2.5)
            self.text(x + 26, place, title)
            place += LINE_PX

    def picture(self, title: str, caption: str, data: Mapping[str, Table] | None = None) -> Picture:
        """Return the finished figure.

        ``data`` are tables of the numbers that it shows, by what they are.
        """
        view = f'viewBox="0 0 {_n(self.width)} {_n(self.height)}"'
        svg = self.svg(f'{view} role="img" aria-label="{escape(title)}" {_FONTS}')
        return Picture(svg, self.width, self.height, title, caption, data or {})


def row_axes(
    names: Sequence[str], values: Sequence[float], label: str, *, widest_px: float
) -> tuple[Canvas, Axes]:
    """Return half a page with a named row for each of some values, and an axis below them.

    Rows are 1 high, the first begins at 0, and y runs downwards. ``values`` are all that has to
    find room, ``label`` names the axis, and names take at most ``widest_px`` pixels.
    """
    low, high = with_margin(values, least=0.05 * abs(max(values)) or 0.5)
    left = min(max(map(len, names)) * LETTER_PX + 16, widest_px)
    right = HALF - 20
    bottom = _ROWS_TOP + _ROW * len(names)
    canvas = Canvas(HALF, bottom + 50)
    extent = (low, high, float(len(names)), 0.0)
    axes = canvas.axes(left, _ROWS_TOP, right - left, bottom - _ROWS_TOP, extent)
    for row, name in enumerate(names):
        canvas.text(left - 8, _ROWS_TOP + _ROW * (row + 0.5) + 4, name, anchor="end")
    canvas.line((left, right), bottom)
    ticks = multiples(low, high, round_step((high - low) / 4))
    numbers = [f"{value + 0.0:.6g}".replace("-", "−") for value in ticks]  # 0.0: no minus zero
    canvas.number_axes(axes, list(zip(ticks, numbers, strict=True)), [])
    canvas.text((left + right) / 2, bottom + 38, label, anchor="middle")
    return canvas, axes


def reduced(data: xr.DataArray, *, width: float) -> ShownMap:
    """Reduce a map (y, x) with coordinates in um to axes so many pixels wide, by area means.

    Rows may run upwards, as heights do. A map that is coarser stays as it is.
    """
    values = data.values.astype(np.float64)
    rows, cols = axes_of(data)
    steps = np.array([pitch(rows), pitch(cols)])
    width_um = cols.size * steps[1]
    # 1.35 pixels of an image in one CSS pixel: enough for screens with finer pixels, too.
    pixel_um = max(width_um / (width * 1.35), 1e-12)
    factor = np.maximum(1.0, pixel_um / np.abs(steps))
    if factor.max() > 1:
        values = area_mean(summable(data, values), tuple(factor))
    top_um, left_um = (rows[0], cols[0]) - steps / 2
    down, across = values.shape * factor * steps
    extent = (float(left_um), float(left_um + across), float(top_um + down), float(top_um))
    return ShownMap(values, extent)


def axes_of(data: xr.DataArray) -> list[Array]:
    """Return the coordinates of the rows and columns of a map."""
    return [data[dim].values for dim in data.dims]


def draw_map(
    data: xr.DataArray, *, scale: Scale, label: str, width: float = HALF
) -> tuple[Canvas, Axes]:
    """Draw a map (y, x) in um on half a page, or as wide as given.

    With its scale bar and, where labelled, its colour bar. Returns the figure and the map's axes.
    """
    map_px = width - MARGIN - BESIDE
    shown = reduced(data, width=map_px)
    highest_px = 480.0
    if width > HALF:
        highest_px = 640.0
    box = shown.fit(map_px, highest_px)
    canvas = Canvas(width, panel_height(box, label) + _TOP + BELOW + 26)
    axes = canvas.panel(0.0, 0.0, shown, box, scale=scale, label=label)
    return canvas, axes


def panel_height(box: Pair, label: str) -> float:
    """Return the height of a panel without its scale bar.

    A colour bar needs room for its numbers.
    """
    _, height = box
    if label:
        height = max(height, _LOWEST_BAR)
    return height


class Magnified(NamedTuple):
    """How much arrows are magnified, the length of the longest in um, and both in words."""

    times: float
    longest: float
    words: str


def magnified(vectors: Array, length_um: float) -> Magnified:
    """Return the round factor that makes the longest of some vectors (n, 2) at most so long.

    All lengths are in um; missing vectors are NaN.
    """
    lengths = np.hypot(*vectors.T)
    longest = float(lengths[np.isfinite(lengths)].max(initial=0.0))
    times = 1.0
    if longest > 1e-9:
        times = round_step(length_um / longest)
    factor = f"{times:g}"
    if times >= 1:
        factor = count(round(times))
    size = f"magnified {factor} times"
    if times == 1:
        size = "in true size"
    return Magnified(times, longest, f"{size}; the longest is {length(longest, 2)}")


def with_margin(values: Sequence[float], least: float = 0.1) -> Pair:
    """Return the ends of an axis that holds values, with a margin of 6 % of their range."""
    low = min(values)
    high = max(values)
    margin = 0.06 * (high - low) or least
    return low - margin, high + margin


def pitch(coordinates: Array) -> float:
    """Return the step of a regular axis; 1 for a single point."""
    steps = len(coordinates) - 1
    if not steps:
        return 1.0
    return float(coordinates[-1] - coordinates[0]) / steps


def pixel_of(*axes: Array) -> str:
    """Write the pitch of one or more regular axes, in um."""
    return " × ".join(plain(round(pitch(axis), 4)) for axis in axes)


def n_of(values: ArrayLike) -> str:
    """Write how many values of a map are known."""
    return count(int(np.isfinite(values).sum()))


def multiples(low: float, high: float, step: float) -> Array:
    """Return the multiples of a step between two values."""
    first = np.ceil(low / step - 1e-9)
    last = np.floor(high / step + 1e-9)
    return np.arange(first, last + 1) * step


def levels_between(low: float, high: float, *, steps: int) -> tuple[Array, float]:
    """Return round levels between two values, and their step.

    None where the two are next to the same.
    """
    if not high - low > 1e-6 * max(abs(low), abs(high)):
        return np.empty(0), 0.0
    step = round_step((high - low) / steps)
    return multiples(low, high, step), step


def _ticks(low: float, high: float, *, max_count: float, log: bool = False) -> Ticks:
    """Return the places of ticks, about ``max_count`` at most, and what is written there.

    ``log``: the places are exponents of ten, at whole ones of which the power is written.
    """
    if log:
        # At most six numbers, of every second or third power where there are more.
        powers = multiples(low, high, 1.0)
        stride = max(1, math.ceil(len(powers) / 6))
        return [(float(k), f"{10.0**k:g}") for k in powers[::stride]]
    n_steps = max(int(max_count), 2)
    step = round_step((high - low) / n_steps, above=True)
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    values = multiples(low, high, step).tolist()
    return [(value, fixed(value, decimals)) for value in values]


def _n(value: float) -> str:
    return f"{round(float(value), 1) + 0.0:g}"


def _pairs(x: ArrayLike, y: ArrayLike) -> Array:
    return np.column_stack(np.broadcast_arrays(x, y))


def _edges(inside: Bools) -> Ints:
    """Return the ends (x, y) of the borders between rows of pixels (y, x), two for each border.

    They count pixels of ``inside``, whose outermost ones are all False.
    """
    is_edge = np.diff(inside, axis=0)
    ends = np.diff(is_edge.astype(np.int8), axis=1)
    line, start = np.nonzero(ends == 1)
    _, stop = np.nonzero(ends == -1)
    borders = np.stack([start, line, stop, line], axis=1)
    return borders.reshape(-1, 2)


def _path(points: Array) -> str:
    """Return a line through points (n, 2) in pixels as path data; NaN interrupts it.

    Each stretch is a place and steps from there, in tenths of a pixel; steps of 0 are left out.
    """
    tenths = np.rint(10 * points)
    is_finite = np.isfinite(tenths).all(axis=1)
    path_data = ""
    stretch_starts = np.flatnonzero(np.diff(is_finite)) + 1
    for run in np.split(tenths, stretch_starts):
        if not np.isfinite(run).all():
            continue
        steps = np.diff(run, axis=0)
        steps = steps[np.any(steps != 0, axis=1)]
        if len(steps):  # none of a line that is shorter than a tenth of a pixel
            x, y = run[0] / 10
            numbers = [f"{v:g}" for v in (steps / 10).ravel()]
            path_data += f"M{x:g} {y:g}l" + " ".join(numbers)
    return path_data


def _image(box: Box, values: Array, scale: Scale, missing: str = MISSING) -> str:
    """Return a map (rows, cols) as an image of the figure; coarse pixels have sharp edges."""
    x, y, width, height = map(_n, box)
    coarse = ""
    if values.shape[1] < box[2]:
        coarse = ' style="image-rendering:pixelated"'
    return (
        f'<image x="{x}" y="{y}" width="{width}" height="{height}"'
        f' preserveAspectRatio="none"{coarse} href="{image_uri(values, scale, missing=missing)}"/>'
    )
