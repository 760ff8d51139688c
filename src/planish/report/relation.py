"""The point-wise relation of two maps, at the pixel and larger points, and how far they differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from planish.core.area import common_means, valid_in_all
from planish.core.bands import thinned
from planish.core.facts import is_known
from planish.core.numbers import (
    axis_label,
    capital,
    count,
    in_words,
    number,
    to_spread,
    unit,
)
from planish.core.typing import Pair
from planish.report.colours import Array, Scale
from planish.report.draw import (
    ACCENT,
    FULL,
    POINT,
    SMALL,
    SOFT,
    THIRD,
    Axes,
    Box,
    Canvas,
    Picture,
    ShownMap,
    Table,
    axes_of,
    pitch,
)
from planish.report.statement import point_of, r_sentence
from planish.report.text import Basis, TwoTexts, unit_of
from planish.results import ComparisonRow, CorrelationRow

Row = TypeVar("Row", CorrelationRow, ComparisonRow)
Points = tuple[Array, Array]  # values of two maps at the same larger points
# Cells of a plot of densities along either axis
_BINS = 110
_LEAST_BINS = 24
# Pixels of two pairs of axes, side by side: left edges of both, width, upper edge and height.
LEFT = 85.0
RIGHT = 635.0
WIDE = 400.0
_TOP = 62.0
_HIGH = 355.0


@dataclass(frozen=True)
class MapPair:
    """Two maps (y, x) on one grid, correlations from the pixel up, masks.

    ``density`` (g/cm3) turns map a into g/m2.
    """

    a: xr.DataArray
    b: xr.DataArray
    rows: Sequence[CorrelationRow]
    valid: Sequence[xr.DataArray] = ()
    density: float | None = None

    @classmethod
    def of(
        cls,
        linked: Mapping[str, xr.Dataset],
        rows: Sequence[CorrelationRow],
        density: float | None = None,
    ) -> MapPair | None:
        """Take both maps of correlations; None where one is not at hand."""
        row = rows[0]
        a = linked.get(row.a, {})
        b = linked.get(row.b, {})
        if row.a_map not in a or row.b_map not in b:
            return None
        masks = [maps["valid"] for maps in (a, b) if "valid" in maps]
        return cls(a[row.a_map], b[row.b_map], rows, masks, density)

    @property
    def coarse(self) -> CorrelationRow:
        """Correlation of the larger points."""
        return largest(self.rows)

    @cached_property
    def points(self) -> Points:
        """Means over the larger points."""
        return block_means(self.a, self.b, point_um=self.coarse.point_um, valid=self.valid)


def block_means(
    a: xr.DataArray, b: xr.DataArray, *, point_um: float, valid: Sequence[xr.DataArray] = ()
) -> Points:
    """Average two maps (y, x) on one grid over points of ``point_um``.

    The averages, two arrays (n,), are over the pixels that are known in both.

    ``valid`` are masks of pixels that count. Points less than half known do not count; there are
    none where they would be smaller than pixels.
    """
    down, across = (point_um / pitch(values) for values in axes_of(a))  # pixels of a point
    if min(down, across) < 1 - 1e-9:
        return np.empty(0), np.empty(0)
    factor = (max(down, 1.0), max(across, 1.0))
    first, second = common_means((a, b), factor, masks=valid)  # NaN where less than half is known
    is_valid = np.isfinite(first) & np.isfinite(second)
    return first[is_valid], second[is_valid]


def draw_pair(
    pair: MapPair,
    *,
    names: TwoTexts,
    basis: Basis,
) -> Picture:
    """Draw map b over map a as the density of the pixels.

    Beside it are larger points or the difference of the two.

    The difference of two maps of the same quantity is drawn over their mean, with its mean and the
    limits that hold 95 % of normal differences (Bland and Altman 1986). ``names``: titles of both
    maps.
    """
    stride, (p, q, *masks) = thinned(pair.a, pair.b, *pair.valid)  # pixels of a, b and the masks
    is_valid = valid_in_all((p, q), masks)
    units = (unit_of(pair.a), unit_of(pair.b))
    rows = (pair.rows[0], pair.coarse)  # of the pixels, and of the larger points
    points, (fine, coarse), units, labels = as_drawn(pair.points, rows, names, units, pair.density)
    if pair.density is not None:
        p = p * pair.density
    pixels = (p[is_valid].astype(np.float64), q[is_valid].astype(np.float64))
    canvas = Canvas(FULL, 475)
    axes = _draw_density(canvas, (LEFT, _TOP, WIDE, _HIGH), pixels, counted_text="pixels")
    panels = [(axes, fine)]
    right_text = "right, area means over the valid pixels of each larger point. "
    # Of one quantity how far both differ says more than another cloud of points.
    if coarse.same_quantity:
        ends = min(axes.extent), max(axes.extent)
        axes.line(ends, ends, width=1.3, dash="6 4")
        _draw_differences(canvas, *points, coarse, units[0])
        right_text = (
            "right, the difference (map on the vertical axis minus map on the horizontal one) of"
            f" points of {point_of(coarse)} over the mean of the two, with its mean"
            " and the limits of 95 % of normal differences. Dashed, left: both equal. "
        )
    else:
        right_axes = draw_dots(canvas, points, (RIGHT, _TOP, WIDE, _HIGH), bar_px=70)
        panels.append((right_axes, coarse))
    for axes, row in panels:
        _draw_lines(axes, row)
        canvas.ticks(axes, *labels)
        numbers_text = _correlation_text(row, units)
        _draw_heading(canvas, axes.x, f"Points of {point_of(row)}", numbers_text)
    stride_text = ""
    if stride > 1:
        stride_text = f", one in {stride} of each row and column"
    caption = (
        f"Left, number of pixels{stride_text} (logarithmic colours); {right_text}A point counts"
        " when half of its area is valid in both maps. Lines are least squares: solid, y on x;"
        " dashed, x on y; a perfect relation without errors would lie between them. The left"
        " axes span the 0.05th to the 99.95th percentile of the pixels, the right ones the"
        f" points. Mask: measured, without {basis.excluded}. n counts points, which resemble"
        f" their neighbours; the interval rests on independent ones. {capital(basis.registered)}."
    )
    title = f"{capital(in_words(names[1]))} over {in_words(names[0])}"
    return canvas.picture(title, caption, {"points": points_table(points, labels)})


def draw_points(pair: MapPair, *, names: TwoTexts, height: float, registered: str) -> Picture:
    """Draw the larger points of two maps on a third of the page, with both least-squares lines.

    ``names``: titles of both maps; ``height``: of the figure in pixels, at least; ``registered``:
    what registered the maps, in words.
    """
    units = (unit_of(pair.a), unit_of(pair.b))
    rows = (pair.coarse,)
    points, (row,), _, labels = as_drawn(pair.points, rows, names, units, pair.density)
    canvas = Canvas(THIRD, max(height, 300.0))
    size_text = point_of(row)
    box = (76.0, 42.0, THIRD - 82, canvas.height - 92)
    axes = draw_dots(canvas, points, box, bar_px=55)
    _draw_lines(axes, row)
    canvas.ticks(axes, *labels)
    heading = r_sentence(row) if is_known(row.r) else "no correlation"
    canvas.text(axes.x, 18, heading, bold=True)
    canvas.text(axes.x, 34, f"n = {count(row.n)} points of {size_text}", size=SMALL, colour=SOFT)
    n_eff_text = ""
    if is_known(row.n_eff):
        n_eff_text = f", {count(round(row.n_eff))} of them independent"
    doubt_text = ""
    if row.trust == "doubtful":
        doubt_text = " Doubtful: see the checks."
    caption = (
        f"n = {count(row.n)} squares of {size_text}{n_eff_text}; mask: at least half valid in"
        " both maps. Lines of least squares: solid, y on x; dashed, x on y."
        f" {capital(registered)}.{doubt_text}"
    )
    tables = {"points": points_table(points, labels)}
    return canvas.picture(f"Points of {size_text}", caption, tables)


def as_drawn(
    points: Points,
    rows: Sequence[CorrelationRow],
    titles: TwoTexts,
    units: TwoTexts,
    density: float | None,
) -> tuple[Points, Sequence[CorrelationRow], TwoTexts, list[str]]:
    """Return points, correlations and units of two maps as the axes of a figure have them.

    Also returns the labels of its axes, from the titles.

    With a density (g/cm3), which its label states, the first map, a thickness in um, is a weight:
    um x g/cm3 = g/m2. Without one all is returned as it is.
    """
    if density is not None:
        weight_title = titles[0].replace("Coating thickness", "Coating")
        points = (points[0] * density, points[1])
        titles = (f"{weight_title}, at {density:.3g} g/cm³", titles[1])
        units = ("g/m²", units[1])
        rows = [_with_weight(row, density) for row in rows]
    return points, rows, units, [*map(axis_label, titles, units)]


def _with_weight(row: CorrelationRow, density: float) -> CorrelationRow:
    """Return the correlation of a thickness as that of its weight."""
    slope = row.slope / density
    slope_x_on_y = row.slope_x_on_y * density
    mean_a = row.mean_a * density
    return row.model_copy(update={"slope": slope, "slope_x_on_y": slope_x_on_y, "mean_a": mean_a})


def points_table(points: Points, labels: Sequence[str]) -> Table:
    """Return the larger points as columns; two maps of one title are told apart."""
    x_label, y_label = labels
    if x_label == y_label:
        x_label, y_label = f"{x_label} (x)", f"{y_label} (y)"
    return {x_label: points[0].tolist(), y_label: points[1].tolist()}


def _draw_lines(axes: Axes, row: CorrelationRow) -> None:
    """Draw the line of least squares of b on a, and dashed that of a on b, within the axes."""
    draw_slope(axes, row)
    slope = row.slope_x_on_y
    if slope and is_known(row.slope) and is_known(slope) and is_known(row.mean_a):
        y = np.array(axes.extent[2:])
        x = row.mean_a + slope * (y - row.mean_b)
        draw_fit(axes, x, y, dash="7 4")


def draw_slope(axes: Axes, row: CorrelationRow) -> None:
    """Draw the line of least squares of b on a over the width of the axes, if it is known."""
    if is_known(row.slope):
        x = np.array(axes.extent[:2])
        draw_fit(axes, x, row.intercept + row.slope * x)


def draw_fit(
    axes: Axes,
    x: ArrayLike,
    y: ArrayLike,
    *,
    colour: str = ACCENT,
    width: float = 2.2,
    dash: str = "",
) -> None:
    """Draw a line that stands out from the points below it."""
    axes.line(x, y, colour="white", width=4)
    axes.line(x, y, colour=colour, width=width, dash=dash)


def largest(rows: Sequence[Row]) -> Row:
    """Return the row of the largest points that there are any of; without points, of all rows."""
    rows_with_points = [row for row in rows if row.n]
    return max(rows_with_points or rows, key=lambda row: row.point_um)


def _draw_differences(canvas: Canvas, a: Array, b: Array, row: CorrelationRow, units: str) -> None:
    """Draw the differences of two maps of one quantity by their mean, with bias and limits.

    ``a``, ``b`` (n,): both maps at the same points; ``row`` holds the statistics of b less a, and
    ``units`` are theirs where the row names none.
    """
    means = (a + b) / 2
    differences = b - a
    units = unit(row.units or "") or units
    line_levels = [v for v in (row.difference_mean, *row.limits) if is_known(v)]
    low, high = _axis_limits(differences)
    if line_levels:
        margin = 0.04 * (high - low)
        low = min(low, *line_levels) - margin
        high = max(high, *line_levels) + margin
    extent = (*_axis_limits(means), low, high)
    axes = canvas.axes(RIGHT, _TOP, WIDE, _HIGH, extent)
    axes.across(0.0, width=1)
    size = 3 if means.size > 2000 else 4.4
    axes.dots(means, differences, colour=POINT, size=size, opacity=0.5)
    for value, dash in zip(line_levels, ("", "7 4", "7 4"), strict=False):
        draw_fit(axes, axes.extent[:2], value, dash=dash, width=2)
    canvas.ticks(axes, axis_label("mean of the two", units), axis_label("difference", units))
    mean, spread, lower, upper = written_difference(row)
    unit_text = f" {units}".rstrip()
    numbers_text = (
        f"mean {mean}{unit_text}\u2003s. d. {spread}{unit_text}\u2003limits {lower} to"
        f" {upper}{unit_text}"
    )
    _draw_heading(canvas, RIGHT, f"Difference, points of {point_of(row)}", numbers_text)


def written_difference(row: CorrelationRow) -> tuple[str, ...]:
    """Return mean, standard deviation and limits of a difference.

    All are given to two digits of the standard deviation.
    """
    numbers = (row.difference_mean, row.difference_sd, *row.limits)
    return tuple(to_spread(v, row.difference_sd) for v in numbers)


def draw_dots(
    canvas: Canvas, points: Points, box: Box, *, bar_px: float = 0.0, colour: str = POINT
) -> Axes:
    """Draw larger points one by one.

    Where they are many and there is room for a colour bar, of ``bar_px`` to the right of the axes,
    their density.
    """
    if bar_px and points[0].size > 5000:
        x, y, width, height = box
        box = (x, y, width - bar_px, height)
        return _draw_density(canvas, box, points, counted_text="points")
    x_limits, y_limits = (_axis_limits(values, 0.0) for values in points)
    axes = canvas.axes(*box, (*x_limits, *y_limits))
    dot_px, opacity = 4.6, 0.7
    if points[0].size > 2000:
        dot_px, opacity = 3, 0.5
    axes.dots(*points, colour=colour, size=dot_px, opacity=opacity)
    return axes


def _draw_density(canvas: Canvas, box: Box, points: Points, *, counted_text: str) -> Axes:
    """Draw how many points fall into each cell of a plot, on logarithmic colours.

    ``counted_text``: what is counted, above the colour bar.
    """
    x_limits, y_limits = map(_axis_limits, points)
    left_px, top_px, width, height = box
    bins = int(np.clip(np.sqrt(points[0].size) / 1.5, _LEAST_BINS, _BINS))
    columns, *_ = np.histogram2d(*points, bins=bins, range=(x_limits, y_limits))
    counts = columns.T[::-1]  # (y, x), as rows of an image from the largest y on
    highest_log = float(np.log10(counts.max(initial=10.0)))
    scale = Scale(0.0, highest_log)
    logs = np.full_like(counts, np.nan)
    np.log10(counts, out=logs, where=counts > 0)
    axes = canvas.axes(*box, (*x_limits, *y_limits))
    axes.image(ShownMap(logs, axes.extent), scale, missing="#ffffff")
    bar_px = left_px + width + 8
    canvas.colour_bar(bar_px, top_px, 10, height, scale, log=True)
    canvas.text(bar_px, top_px - 8, counted_text, size=SMALL, colour=SOFT)
    return axes


def _draw_heading(canvas: Canvas, left_px: float, title: str, numbers_text: str) -> None:
    canvas.text(left_px, 20, title, bold=True, size=13)
    canvas.text(left_px, 43, numbers_text)


def _axis_limits(values: Array, percent: float = 0.05) -> Pair:
    """Ends of an axis over all values but ``percent`` of them at either end, with a margin."""
    if values.size == 0:
        return 0.0, 1.0
    low, high = np.percentile(values, [percent, 100 - percent]).tolist()
    margin = 0.04 * (high - low) or 0.5
    return low - margin, high + margin


def _correlation_text(row: CorrelationRow, units: TwoTexts) -> str:
    """Write r, n and the slope of y on x, which is without a unit where both have the same."""
    if not is_known(row.r):
        return "no correlation: too few points, or a constant map"
    x_unit, y_unit = units
    unit_text = ""
    if x_unit and x_unit != y_unit:
        unit_text = f" {y_unit}".rstrip() + f" per {x_unit}"
    return f"{r_sentence(row)}\u2003n = {count(row.n)}\u2003slope {number(row.slope)}{unit_text}"
