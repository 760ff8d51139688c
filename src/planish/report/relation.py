"""The point-wise relation of two maps, at the pixel and at larger points, and how far they differ."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.area import AreaMeans
from planish.core.bands import band_of, bands, thinned
from planish.core.facts import is_known
from planish.report.colours import PROPERTY, Array, Scale
from planish.report.draw import ACCENT, FULL, POINT, SMALL, SOFT, THIRD, Axes, Canvas, Picture, ShownMap, Table, pitch
from planish.report.statement import r_interval_text, r_text
from planish.report.text import HOLES, REGISTERED, beside, capital, count, in_words, number, plain, unit, unit_of
from planish.results import CorrelationRow

Points = tuple[Array, Array]
"""Values of two maps at the same larger points."""

_BINS, _LEAST_BINS = 110, 24
_MANY = 5000  # points from which their density is drawn instead of each of them
_TOP, _HIGH, _WIDE = 62.0, 355.0, 400.0  # pixels of one pair of axes
_LEFT, _RIGHT = 85.0, 635.0


def block_means(
    a: xr.DataArray, b: xr.DataArray, *, point_um: float, valid: Sequence[xr.DataArray] = ()
) -> tuple[Array, Array]:  # fmt: skip
    """Average two maps (y, x) on one grid over points of ``point_um``, over the pixels that are known in both.

    ``valid`` are masks of pixels that count. Points that are less than half known do not count; there are none where
    they would be smaller than pixels.
    """
    factors = [point_um / pitch(a[axis].values) for axis in ("y", "x")]
    if min(factors) < 1 - 1e-9:
        return np.empty(0), np.empty(0)
    down, across = (max(factor, 1.0) for factor in factors)
    found = AreaMeans((a.shape[0], a.shape[1]), (down, across))
    for rows in bands(a.shape[0]):
        p, q, *masks = (band_of(data, rows) for data in (a, b, *valid))
        found.add(rows.start, _known(p, q, masks), p, q)
    first, second = found.means()
    known = np.isfinite(first) & np.isfinite(second)
    return first[known], second[known]


def _known(a: Array, b: Array, masks: Sequence[NDArray[Any]]) -> NDArray[np.bool_]:
    return np.logical_and.reduce([np.isfinite(a), np.isfinite(b), *(mask.astype(bool) for mask in masks)])


def draw_pair(
    a: xr.DataArray, b: xr.DataArray, rows: Sequence[CorrelationRow], *, names: tuple[str, str],
    valid: Sequence[xr.DataArray] = (), without: str = HOLES, points: Points | None = None,
    density: float | None = None,
) -> Picture:  # fmt: skip
    """Draw map b over map a: density of the pixels, and beside it larger points or the difference of the two.

    Both are (y, x) on one grid, NaN where they are not valid; ``valid`` are masks of the pixels that count, and
    ``without`` says in words what they leave out. The rows go from the pixel to the largest points. The difference of
    two maps of the same quantity is drawn over their mean, with its mean and the limits that hold 95 % of normal
    differences (Bland and Altman 1986). ``points`` are the larger points where they are at hand; ``density`` (g/cm3)
    turns map a, a thickness, into g/m2.
    """
    fine, coarse = rows[0], largest(rows)
    same, units, axis = coarse.same_quantity, (unit_of(a), unit_of(b)), names
    if density is not None:
        fine, coarse, units = in_grams(fine, density), in_grams(coarse, density), ("g/m²", units[1])
        axis = weighed(names[0], density), names[1]
    labels = [f"{name} / {u}" if u else name for name, u in zip(axis, units, strict=True)]
    every, (p, q, *masks) = thinned(a, b, *valid)
    known = _known(p, q, masks)
    points = block_means(a, b, point_um=coarse.point_um, valid=valid) if points is None else points
    if density is not None:
        p, points = p * density, (points[0] * density, points[1])
    canvas = Canvas(FULL, 475)
    left = _density(canvas, _LEFT, *(m[known].astype(np.float64) for m in (p, q)), what="pixels")
    if same:
        span = min(left.extent[0], left.extent[2]), max(left.extent[1], left.extent[3])
        left.line([(v, v) for v in span], colour=SOFT, width=1.3, dash="6 4")
        _differences(canvas, *points, coarse, units[0])
    drawn = [(_LEFT, left, fine)] if same else [(_LEFT, left, fine), (_RIGHT, _points(canvas, *points), coarse)]
    for at, axes, row in drawn:
        for ends, dash in _lines(row, axes.extent):
            axes.line(ends, colour="white", width=4)
            axes.line(ends, colour=ACCENT, width=2.2, dash=dash)
        canvas.ticks(axes, *labels)
        _heading(canvas, at, f"Points of {plain(round(row.point_um, 4))}", _numbers(row, units))
    second = (
        "right, the difference (upward map minus the map across) of points of "
        f"{plain(round(coarse.point_um, 4))} over the mean of the two, with its mean and the limits of 95 % of normal "
        "differences. Dashed, left: both equal. "
        if same
        else "right, area means over the valid pixels of each larger point. "
    )
    shown = f", one in {every} of each row and column" if every > 1 else ""
    return canvas.picture(
        title=f"{capital(in_words(names[1]))} over {in_words(names[0])}",
        caption=(
            f"Left, number of pixels{shown} (logarithmic colours); {second}A point counts when half of its area is "
            "valid in both maps. Lines are least squares: solid, of the upward map on the map across, dashed, the "
            "other way round; a perfect relation without errors would lie between them. The left axes span the "
            "0.05th to the 99.95th percentile of the pixels, the right ones the points. Mask: measured, without "
            f"{without}. "
            f"n counts points, which resemble their neighbours; the interval rests on independent ones. "
            f"{capital(REGISTERED)}."
        ),
        data={"points": points_table(points, labels)},
    )


def draw_points(
    points: Points, row: CorrelationRow, *, names: tuple[str, str], units: tuple[str, str], height: float = 320.0,
    density: float | None = None,
) -> Picture:  # fmt: skip
    """Draw the larger points of two maps on a third of the page, with both lines of least squares.

    ``density`` (g/cm3) turns the first, a thickness, into g/m2.
    """
    if density is not None:
        points, row = (points[0] * density, points[1]), in_grams(row, density)
        names, units = (weighed(names[0], density), names[1]), ("g/m²", units[1])
    labels = [f"{name} / {u}" if u else name for name, u in zip(names, units, strict=True)]
    canvas = Canvas(THIRD, max(height, 300.0))
    box = (76.0, 42.0, THIRD - 82, canvas.height - 92)
    size, many = plain(round(row.point_um, 4)), points[0].size > _MANY
    axes = _density(canvas, box[0], *points, what="points", wide=box[2] - 55, at=box[1], high=box[3]) if many else None
    axes = axes or points_axes(canvas, points, box)
    for ends, dash in _lines(row, axes.extent):
        axes.line(ends, colour="white", width=4)
        axes.line(ends, colour=ACCENT, width=2.2, dash=dash)
    canvas.ticks(axes, *labels)
    limits = f" (95 %: {r_interval_text(row)})" if is_known(row.interval) else ""
    canvas.text(box[0], 18, f"r = {r_text(row)}{limits}" if is_known(row.r) else "no correlation", bold=True)
    canvas.text(box[0], 34, f"n = {count(row.n)} points of {size}", size=SMALL, colour=SOFT)
    known = f", {count(round(row.n_eff))} of them independent" if is_known(row.n_eff) else ""
    doubt = " Doubtful: see the checks." if row.trust == "doubtful" else ""
    return canvas.picture(
        title=f"Points of {size}",
        caption=(
            f"n = {count(row.n)} squares of {size}{known}; mask: at least half valid in both maps. Lines of least "
            f"squares: solid, of the upward map on the map across; dashed, the other way round. {capital(REGISTERED)}."
            f"{doubt}"
        ),
        data={"points": points_table(points, labels)},
    )


def in_grams(row: CorrelationRow, density: float) -> CorrelationRow:
    """Turn the thickness of a coating in um into g/m2: 1 um of 1 g/cm3 is 1 g/m2."""
    in_weight = {
        "slope": row.slope / density, "slope_x_on_y": row.slope_x_on_y * density, "mean_a": row.mean_a * density
    }  # fmt: skip
    return row.model_copy(update=in_weight)


def weighed(name: str, density: float) -> str:
    """Name a thickness that was turned into weight, with its density: no weight is stated without it."""
    return f"{name.replace('Coating thickness', 'Coating')}, at {density:.3g} g/cm³"


def points_table(points: Points, labels: Sequence[str]) -> Table:
    """Return the larger points as columns; two maps of one title are told apart."""
    names = labels if labels[0] != labels[1] else (f"{labels[0]} (across)", f"{labels[1]} (upwards)")
    return dict(zip(names, (values.tolist() for values in points), strict=True))


def _lines(
    row: CorrelationRow, extent: tuple[float, float, float, float]
) -> Iterator[tuple[list[tuple[float, float]], str]]:
    """Give the line of least squares of b on a, and dashed that of a on b, within the axes."""
    if not is_known(row.slope):
        return
    yield [(x, row.intercept + row.slope * x) for x in extent[:2]], ""
    if row.slope_x_on_y and is_known(row.slope_x_on_y) and is_known(row.mean_a):
        yield [(row.mean_a + row.slope_x_on_y * (y - row.mean_b), y) for y in extent[2:]], "7 4"


def largest(rows: Sequence[CorrelationRow]) -> CorrelationRow:
    """Return the row of the largest points that there are any of."""
    return max([row for row in rows if row.n] or rows, key=lambda row: row.point_um)


def _differences(canvas: Canvas, a: Array, b: Array, row: CorrelationRow, units: str) -> None:
    """Draw the difference over the mean of the two, with its mean and limits."""
    mean, apart = (a + b) / 2, b - a
    units = unit(row.units or "") or units
    known = [v for v in (row.difference_mean, *row.limits) if is_known(v)]
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
    mean, spread, lower, upper = written_difference(row)
    end = f" {units}" if units else ""
    text = f"mean {mean}{end}\u2003s. d. {spread}{end}\u2003limits {lower} to {upper}{end}"
    _heading(canvas, _RIGHT, f"Difference, points of {plain(round(row.point_um, 4))}", text)


def written_difference(row: CorrelationRow) -> tuple[str, ...]:
    """Return mean, standard deviation and limits of a difference, all to two digits of the standard deviation."""
    return tuple(beside(v, row.difference_sd) for v in (row.difference_mean, row.difference_sd, *row.limits))


def _points(canvas: Canvas, a: Array, b: Array) -> Axes:
    """Draw larger points one by one, or their density where they are many."""
    if a.size > _MANY:
        return _density(canvas, _RIGHT, a, b, what="points", wide=_WIDE - 70)
    return points_axes(canvas, (a, b), (_RIGHT, _TOP, _WIDE, _HIGH))


def points_axes(canvas: Canvas, points: Points, box: tuple[float, float, float, float]) -> Axes:
    """Draw larger points one by one, and return their axes."""
    a, b = points
    axes = canvas.axes(*box, (*_limits(a, 0.0), *_limits(b, 0.0)))
    many = a.size > 2000
    axes.dots(np.stack([a, b], axis=1), colour=POINT, size=3 if many else 4.6, opacity=0.5 if many else 0.7)
    return axes


def _density(
    canvas: Canvas, left: float, a: Array, b: Array, *, what: str, wide: float = _WIDE, at: float = _TOP,
    high: float = _HIGH,
) -> Axes:  # fmt: skip
    """Draw how many points fall where, with the colour bar to the right."""
    box = _limits(a), _limits(b)
    bins = int(np.clip(np.sqrt(a.size) / 1.5, _LEAST_BINS, _BINS))
    counts = np.histogram2d(a, b, bins=bins, range=box)[0].T[::-1]
    scale = Scale(0.0, float(np.log10(max(counts.max(initial=1.0), 10.0))), PROPERTY)
    logs = np.where(counts > 0, np.log10(np.maximum(counts, 1.0)), np.nan)
    axes = canvas.axes(left, at, wide, high, (*box[0], *box[1]))
    axes.image(ShownMap(logs, axes.extent), scale, missing="#ffffff")
    canvas.colour_bar(left + wide + 8, at, 10, high, scale, log=True)
    canvas.text(left + wide + 8, at - 8, what, size=SMALL, colour=SOFT)
    return axes


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
    if not is_known(row.r):
        return "no correlation: too few points, or a constant map"
    per = f"{' ' + units[1] if units[1] else ''} per {units[0]}" if units[0] and units[0] != units[1] else ""
    limits = f" (95 %: {r_interval_text(row)})" if is_known(row.interval) else ""
    return f"r = {r_text(row)}{limits}\u2003n = {count(row.n)}\u2003slope {number(row.slope)}{per}"
