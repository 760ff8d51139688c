"""The page of a series, one file that needs nothing else.

It holds the figures that it shows, and no script.

Figures are sheets and their mean in each group, and small maps of all specimens on one colour
scale.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

import numpy as np
import xarray as xr

from planish.core.facts import is_known
from planish.core.numbers import NONE, axis_label, plain, round_step
from planish.core.typing import Entries
from planish.report import series_words as words
from planish.report import statement, text
from planish.report.colours import image_uri, limits
from planish.report.draw import (
    ACCENT,
    HALF,
    INK,
    LETTER_PX,
    POINT,
    SMALL,
    Axes,
    Canvas,
    Picture,
    ShownMap,
    Table,
    axes_of,
    pitch,
    reduced,
    row_axes,
)
from planish.series_results import GroupFacts, SeriesResults, SeriesSpecimen

_WIDEST_NAME = 190.0  # pixels
_WIDE = 150.0  # CSS pixels of the widest small map
_LEAST = 24.0


def series_page(results: SeriesResults, maps: Sequence[SmallMap]) -> str:
    """Return the page of a series as HTML.

    Parameters
    ----------
    results : SeriesResults
        Runs relative to the folder of the page.
    maps : sequence of SmallMap
        Of the map that leads, in the order of the specimens.

    Returns
    -------
    str
        The same input gives the same text.
    """
    # Quantities of the table of specimens, and of figures.
    columns = list(range(min(len(results.quantities), 8)))
    given_factors = {name for member in results.members for name in member.factors}
    factors = [name for name in results.factors if name in given_factors]
    lines = [_specimen_line(s, factors, columns, results) for s in results.specimens]
    page = text.template("planish.report", "series.html.j2").render(
        results=results,
        words=words,
        statement=statement,
        text=text,
        factors=factors,
        columns=columns,
        lines=lines,
        orders=_specimen_orders(results, factors),
        pictures=[*filter(None, (draw_groups(results, k) for k in columns))],
        tiled=_tile_maps(maps),
        out=[specimen for specimen in results.specimens if specimen.member.state != "whole"],
        linked=any(specimen.kind not in (None, "map") for specimen in results.specimens),
    )
    return f"{page}\n"


def _specimen_line(
    specimen: SeriesSpecimen, factors: Sequence[str], columns: Sequence[int], results: SeriesResults
) -> Entries:
    """Return what the table shows of one specimen, by the names that the template has for it.

    ``columns``: numbers of the quantities that have a column. Cells are texts, each with a word of
    doubt; the link leads to the specimen's own page and is empty where there is no run.
    """
    cells = [(NONE, "")] * len(columns)
    for k, cell in enumerate(specimen.cells[: len(columns)]):
        # A word below a figure that is not used like the others.
        doubt_text = ""
        if cell.trust != "ok":
            doubt_text = cell.trust
        elif cell.why_not.startswith(("too few", "points of")):
            doubt_text = cell.why_not
        cells[k] = words.cell_text(cell, results.quantities[k]), doubt_text
    link = ""
    if specimen.kind is not None:
        link = f"{quote(specimen.member.run or '')}/report.html"
    return {
        "specimen": specimen,
        "link": link,
        "factors": [specimen.factor(f) for f in factors],
        "cells": cells,
    }


def _values(results: SeriesResults, group: GroupFacts) -> list[tuple[str, float]]:
    """Sheet and value of every specimen of a group that counts."""
    values: list[tuple[str, float]] = []
    for specimen in results.specimens:
        cell = specimen.cells[group.quantity] if specimen.cells else None
        is_member = all(specimen.factor(name) == level for name, level in group.group.items())
        if cell is not None and cell.counts and is_member:
            values.append((specimen.sheet, float(cell.value or 0.0)))
    return values


_STATISTICS = {"mean": "mean", "sd": "standard deviation", "thin_share": "thin share", "r": "r"}


def _specimen_orders(results: SeriesResults, factors: Sequence[str]) -> list[tuple[str, list[int]]]:
    """Orders of the table of specimens, each with its name; those that change nothing are out.

    An order is the numbers of the specimens, from the first row on; there are nine at most.
    """
    orders = [("as listed", list(range(len(results.specimens))))]
    for name, keys in _sort_keys(results, factors):
        order = sorted(range(len(results.specimens)), key=keys.__getitem__)
        if len(orders) < 9 and all(order != earlier for _, earlier in orders):
            orders.append((name, order))
    return orders


def _sort_keys(
    results: SeriesResults, factors: Sequence[str]
) -> Iterator[tuple[str, Sequence[Any]]]:
    """What specimens can be sorted by: a name, and a key of each specimen.

    Specimens without a level, a value or a whole run come last. There are three factors at most,
    those that make groups first, and the statistics of the map that leads.
    """
    specimens = results.specimens
    yield "name", [natural(s.name) for s in specimens]
    yield "state", [(s.member.state != "whole", s.member.state, s.light or "") for s in specimens]
    for factor in sorted(factors, key=lambda name: name not in results.grouped_by)[:3]:
        levels = [specimen.factor(factor) for specimen in specimens]
        yield factor, [(not level, natural(level)) for level in levels]
    for k, q in enumerate(results.quantities):
        if q.map == results.quantities[0].map:
            values = [s.cells[k].value if s.cells else None for s in specimens]
            yield _STATISTICS[q.what], [v if is_known(v) else math.inf for v in values]


def natural(name: str) -> list[Any]:
    """Key that puts 2 before 10: texts and numbers by turns."""
    parts: list[Any] = re.split(r"(\d+)", name.casefold())
    parts[1::2] = map(int, parts[1::2])
    return parts


@dataclass(frozen=True, slots=True)
class SmallMap:
    """A map of one specimen, small; None where there is none, or it cannot be read."""

    specimen: str
    shown: ShownMap | None = None
    title: str = ""
    unit: str = ""


def small_map(specimen: str, data: xr.DataArray | None, *, pixels: float) -> SmallMap:
    """Make a small map of a map.

    Parameters
    ----------
    specimen : str
    data : DataArray, dims (rows, cols), coords in um, optional
        None where there is none.
    pixels : float
        Most pixels along the longer side.

    Returns
    -------
    SmallMap
    """
    if data is None:
        return SmallMap(specimen)
    height_um, width_um = (np.size(axis) * abs(pitch(axis)) for axis in axes_of(data))
    ratio = min(1.0, width_um / height_um)
    shown = reduced(data, width=pixels * ratio / 1.35)  # of 1.35 pixels in one CSS pixel
    values = np.round(shown.values.astype(np.float32), 6).astype(np.float64)  # a page needs no more
    shown = ShownMap(values, shown.extent)
    return SmallMap(specimen, shown, text.title_of(data), text.unit_of(data))


def _tile_maps(maps: Sequence[SmallMap]) -> Entries:
    """Colour small maps by one scale, and on one scale of lengths.

    The colours go from the 1st to the 99th percentile of all of them.

    Of what is given, ``images`` are specimen, address, width and height in CSS pixels, ``missing``
    the specimens without a map, and ``bar`` the figure of both scales, where there are images.
    """
    shown_maps: dict[str, ShownMap] = {}
    missing: list[str] = []
    label = ""
    for m in maps:
        if m.shown is None or not np.isfinite(m.shown.values).any():
            missing.append(m.specimen)
            continue
        shown_maps[m.specimen] = m.shown
        label = label or axis_label(m.title, m.unit)
    if not shown_maps:
        return {"images": [], "missing": missing}
    scale = limits(np.concatenate([m.values.ravel() for m in shown_maps.values()]))
    um_per_px = max(max(m.width, m.height) for m in shown_maps.values()) / _WIDE
    images: list[tuple[str, str, float, float]] = []
    for name, m in shown_maps.items():
        width_px = max(m.width / um_per_px, _LEAST)
        height_px = max(m.height / um_per_px, _LEAST)
        images.append((name, image_uri(m.values, scale), width_px, height_px))
    # The colours of all small maps, and a length on them.
    canvas = Canvas(HALF, 62)
    canvas.colour_bar(8, 6, 300, 12, scale)
    canvas.text(8, 54, label)
    bar_um = round_step(0.5 * _WIDE * um_per_px)
    canvas.line((350, 350 + bar_um / um_per_px), 12, colour=INK, width=3)
    canvas.text(350, 32, plain(bar_um), size=SMALL)
    bar = canvas.picture("Colours and scale of all maps", "")
    return {"bar": bar, "images": images, "missing": missing}


def draw_groups(results: SeriesResults, k: int) -> Picture | None:
    """Draw one quantity of every sheet, by group, with the mean over sheets and its interval.

    ``k``: number of the quantity. None where fewer than two fields have it.
    """
    q = results.quantities[k]
    groups = [group for group in results.groups if group.quantity == k and group.fields]
    if sum(group.fields for group in groups) < 2:
        return None
    factor = 1.0
    if q.what == "thin_share":
        factor = 100.0  # per cent
    values = [_values(results, group) for group in groups]
    plotted = [value for group_values in values for _, value in group_values]
    for group in groups:
        plotted += filter(is_known, group.interval)
    title = words.title(q)
    names = [_short_label(group.group) for group in groups]
    x_label = axis_label(title, words.units(q))
    scaled = [value * factor for value in plotted]
    canvas, axes = row_axes(names, scaled, x_label, widest_px=_WIDEST_NAME)
    rows: list[tuple[str, str, float]] = []
    means: list[str] = []
    for i, (group, group_values) in enumerate(zip(groups, values, strict=True)):
        _draw_group(axes, group, group_values, i + 0.5, factor)
        label = words.label(group.group)
        rows += [(label, *sheet_and_value) for sheet_and_value in group_values]
        means.append(f"{label} {words.value(group.mean, q)} ({words.sheets_text(group.sheets)})")
    caption = (
        "Pale: single specimens; blue: sheets; red: mean over sheets with its 95 % interval,"
        f" where there are 3 sheets. Means: {'; '.join(means)}."
    )
    columns = map(list, zip(*rows, strict=True))
    table: Table = dict(zip(("group", "sheet", "value"), columns, strict=True))
    return canvas.picture(title, caption, {"sheets": table})


def _draw_group(
    axes: Axes, group: GroupFacts, values: Sequence[tuple[str, float]], y: float, factor: float
) -> None:
    """Draw the specimens, the sheets and the mean of a group, one below the other.

    ``values``: sheet and value of each specimen; ``y``: middle of the row, which is 1 high;
    ``factor`` turns values into the unit of the axis.
    """
    sheets: dict[str, list[float]] = {}
    for sheet, value in values:
        sheets.setdefault(sheet, []).append(value * factor)
    means = [*map(np.mean, sheets.values())]
    axes.dots([value * factor for _, value in values], y - 0.18, colour="#9db4c6", size=4)
    axes.dots(means, y + 0.06, colour=POINT, size=6)
    if is_known(group.interval):
        axes.line(np.multiply(group.interval, factor), y + 0.3, colour=ACCENT, width=2)
    if is_known(group.mean):
        axes.dots(group.mean * factor, y + 0.3, colour=ACCENT, size=7)


def _short_label(group: Mapping[str, str]) -> str:
    """Name a group beside its row: where that is too long, by the beginnings of its levels."""
    full_label = words.label(group)
    max_letters = int((_WIDEST_NAME - 16) / LETTER_PX)
    if len(full_label) <= max_letters:
        return full_label
    # Of each level, and what shorter ones leave over.
    letters = max(max_letters // len(group) - 3, 4)
    letters += sum(max(letters - len(level), 0) for level in group.values())
    short_levels = dict(group)
    for factor, level in group.items():
        if len(level) > letters:
            short_levels[factor] = f"{level[: letters - 1]}…"
    return words.label(short_levels)
