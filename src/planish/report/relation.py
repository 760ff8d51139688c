"""The point-wise relation of two maps, at the pixel and at larger points, and how far they differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.area import area_mean
from planish.core.results import CorrelationRow
from planish.report.colours import PROPERTY, Array, Scale
from planish.report.draw import ACCENT, FULL, POINT, SMALL, SOFT, Axes, Canvas, Field, Picture, pitch
from planish.report.text import REGISTERED, beside, capital, count, in_words, number, plain, unit, unit_of

_BINS, _LEAST_BINS = 110, 24
_MANY = 5000  # points from which their density is drawn instead of each of them
_TOP, _HIGH, _WIDE = 62.0, 355.0, 400.0  # pixels of one pair of axes
_LEFT, _RIGHT = 85.0, 635.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """Two maps on one grid, NaN unless both are valid; ``a`` is drawn across and ``b`` upwards."""

    a: Array
    b: Array
    pixel_um: tuple[float, float]
    names: tuple[str, str]
    units: tuple[str, str]

    @property
    def labels(self) -> tuple[str, str]:
        """Names with units."""
        found = [f"{n} / {u}" if u else n for n, u in zip(self.names, self.units, strict=True)]
        return found[0], found[1]


def pair_of(a: xr.DataArray, b: xr.DataArray, valid: NDArray[np.bool_], *, names: tuple[str, str]) -> Pair:
    """Return two maps (y, x) on one grid as a pair with names for readers."""
    left, right = (m.values.astype(np.float64) for m in (a, b))
    both = valid & np.isfinite(left) & np.isfinite(right)
    return Pair(
        a=np.where(both, left, np.nan),
        b=np.where(both, right, np.nan),
        pixel_um=(pitch(a["y"].values), pitch(a["x"].values)),
        names=names,
        units=(unit_of(a), unit_of(b)),
    )


def block_means(pair: Pair, *, point_um: float) -> tuple[Array, Array]:
    """Average both maps over points of ``point_um``, over the pixels that are valid in both.

    Points that are less than half valid do not count; there are none where they would be smaller than pixels.
    """
    factor = (point_um / pair.pixel_um[0], point_um / pair.pixel_um[1])
    if min(factor) < 1 - 1e-9:
        return np.empty(0), np.empty(0)
    a, b = (area_mean(data, (max(factor[0], 1.0), max(factor[1], 1.0))) for data in (pair.a, pair.b))
    both = np.isfinite(a) & np.isfinite(b)
    return a[both], b[both]


def draw_pair(pair: Pair, rows: Sequence[CorrelationRow]) -> Picture:
    """Draw map b over map a: density of the pixels, and beside it larger points or the difference of the two.

    The rows go from the pixel to the largest points. The difference of two maps of the same quantity is drawn over
    their mean, with its mean and the limits that hold 95 % of normal differences (Bland and Altman 1986).
    """
    fine, coarse = rows[0], largest(rows)
    known = np.isfinite(pair.a)
    pixels, points = (pair.a[known], pair.b[known]), block_means(pair, point_um=coarse.point_um)
    same = coarse.same_quantity
    canvas = Canvas(FULL, 475)
    left = _density(canvas, _LEFT, *pixels, what="pixels")
    if same:
        span = min(left.extent[0], left.extent[2]), max(left.extent[1], left.extent[3])
        left.line([(v, v) for v in span], colour=SOFT, width=1.3, dash="6 4")
    _finish(canvas, left, fine, pair)
    _heading(canvas, _LEFT, f"Points of {plain(round(fine.point_um, 4))}", _numbers(fine, pair.units))
    if same:
        _differences(canvas, *points, coarse, pair)
    else:
        right = _points(canvas, *points)
        _finish(canvas, right, coarse, pair)
        _heading(canvas, _RIGHT, f"Points of {plain(round(coarse.point_um, 4))}", _numbers(coarse, pair.units))
    second = (
        "right, the difference (upward map minus the map across) of points of "
        f"{plain(round(coarse.point_um, 4))} over the mean of the two, with its mean and the limits of 95 % of normal "
        "differences. Dashed, left: both equal. "
        if same
        else "right, area means over the valid pixels of each larger point. "
    )
    return canvas.picture(
        title=f"{capital(in_words(pair.names[1]))} over {in_words(pair.names[0])}",
        caption=(
            f"Left, number of pixels (logarithmic colours); {second}A point counts when half of its area is valid in "
            "both maps. Lines are least squares of the upward map on the map across. The left axes span the 0.05th to "
            "the 99.95th percentile of the pixels, the right ones the points. Mask: measured, without holes and rims. "
            f"n counts points, which resemble their neighbours: it is not a sample size. {capital(REGISTERED)}."
        ),
    )


def largest(rows: Sequence[CorrelationRow]) -> CorrelationRow:
    """Return the row of the largest points that there are any of."""
    return max([row for row in rows if row.n] or rows, key=lambda row: row.point_um)


def _differences(canvas: Canvas, a: Array, b: Array, row: CorrelationRow, pair: Pair) -> None:
    """Draw the difference over the mean of the two, with its mean and limits."""
    mean, apart = (a + b) / 2, b - a
    units = unit(row.units or "") or pair.units[0]
    known = [v for v in (row.difference_mean, *(row.limits or ())) if v is not None]
    low, high = _limits(apart)
    room = 0.04 * (high - low)
    span = min(low, *known) - room if known else low, max(high, *known) + room if known else high
    axes = canvas.axes(_RIGHT, _TOP, _WIDE, _HIGH, (*_limits(mean), *span))
    across = axes.extent[:2]
    axes.line([(x, 0.0) for x in across], colour=SOFT, width=1)
    axes.dots(np.stack([mean, apart], axis=1), colour=POINT, size=3 if mean.size > 2000 else 4.4, opacity=0.5)
    for k, value in enumerate(known):
        axes.line([(x, value) for x in across], colour="white", width=4)
        axes.line([(x, value) for x in across], colour=ACCENT, width=2, dash="7 4" if k else "")
    end = f" / {units}" if units else ""
    canvas.ticks(axes, f"mean of the two{end}", f"difference{end}")
    sd, (lower, upper) = row.difference_sd, row.limits or (None, None)
    end = f" {units}" if units else ""
    text = (
        f"mean {beside(row.difference_mean, sd)}{end}\u2003s. d. {beside(sd, sd)}{end}\u2003"
        f"limits {beside(lower, sd)} to {beside(upper, sd)}{end}"
    )
    _heading(canvas, _RIGHT, f"Difference, points of {plain(round(row.point_um, 4))}", text)


def _points(canvas: Canvas, a: Array, b: Array) -> Axes:
    """Draw larger points one by one, or their density where they are many."""
    if a.size > _MANY:
        return _density(canvas, _RIGHT, a, b, what="points", wide=_WIDE - 70)
    axes = canvas.axes(_RIGHT, _TOP, _WIDE, _HIGH, (*_limits(a, 0.0), *_limits(b, 0.0)))
    many = a.size > 2000
    axes.dots(np.stack([a, b], axis=1), colour=POINT, size=3 if many else 4.6, opacity=0.5 if many else 0.7)
    return axes


def _density(canvas: Canvas, left: float, a: Array, b: Array, *, what: str, wide: float = _WIDE) -> Axes:
    """Draw how many points fall where, with the colour bar to the right."""
    box = _limits(a), _limits(b)
    bins = int(np.clip(np.sqrt(a.size) / 1.5, _LEAST_BINS, _BINS))
    counts = np.histogram2d(a, b, bins=bins, range=box)[0].T[::-1]
    scale = Scale(0.0, float(np.log10(max(counts.max(initial=1.0), 10.0))), PROPERTY)
    logs = np.where(counts > 0, np.log10(np.maximum(counts, 1.0)), np.nan)
    axes = canvas.axes(left, _TOP, wide, _HIGH, (*box[0], *box[1]))
    axes.image(Field(logs, axes.extent), scale, missing="#ffffff")
    canvas.colour_bar(left + wide + 8, _TOP, 10, _HIGH, scale, log=True)
    canvas.text(left + wide + 8, _TOP - 8, what, size=SMALL, colour=SOFT)
    return axes


def _finish(canvas: Canvas, axes: Axes, row: CorrelationRow, pair: Pair) -> None:
    """Draw the straight line of a correlation over what the axes span, and the axes."""
    if row.slope is not None and row.intercept is not None:
        line = [(x, row.intercept + row.slope * x) for x in axes.extent[:2]]
        axes.line(line, colour="white", width=4)
        axes.line(line, colour=ACCENT, width=2.2)
    canvas.ticks(axes, *pair.labels)


def _heading(canvas: Canvas, left: float, title: str, numbers: str) -> None:
    canvas.text(left, 20, title, bold=True, size=13)
    canvas.text(left, 43, numbers)


def _limits(data: Array, percent: float = 0.05) -> tuple[float, float]:
    if data.size == 0:
        return 0.0, 1.0
    low, high = (float(v) for v in np.percentile(data, [percent, 100 - percent]))
    room = 0.04 * (high - low) or 0.5
    return low - room, high + room


def _numbers(row: CorrelationRow, units: tuple[str, str]) -> str:
    if row.r is None or row.r2 is None:
        return "no correlation: too few points, or a constant map"
    per = f"{' ' + units[1] if units[1] else ''} per {units[0]}" if units[0] and units[0] != units[1] else ""
    return f"r² = {row.r2:.3f}\u2003r = {number(row.r)}\u2003n = {count(row.n)}\u2003slope {number(row.slope)}{per}"
