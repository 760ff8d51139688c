"""The page of a series, one file that needs nothing else.

It holds the figures that it shows, and no script.

Figures are sheets and their mean in each group, and small maps of all specimens on one colour
scale.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

import numpy as np
import xarray as xr

from planish.core.facts import is_known
from planish.core.numbers import NONE, axis_label, plain, round_step
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
    Canvas,
    Picture,
    ShownMap,
    reduced,
    row_axes,
)
from planish.series_results import SeriesResults, SeriesSpecimen

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
    factors = [
        name
        for name in results.factors
        if any(name in member.factors for member in results.members)
    ]
    page = text.template("planish.report", "series.html.j2").render(
        results=results,
        words=words,
        statement=statement,
        text=text,
        factors=factors,
        columns=columns,
        lines=[
            _specimen_line(specimen, factors, columns, results) for specimen in results.specimens
        ],
        orders=_specimen_orders(results, factors),
        pictures=[picture for k in columns if (picture := draw_groups(results, k))],
        tiled=_tile_maps(maps),
        out=[specimen for specimen in results.specimens if specimen.member.state != "whole"],
        linked=any(specimen.kind not in (None, "map") for specimen in results.specimens),
    )
    return f"{page}\n"


def _specimen_line(
    specimen: SeriesSpecimen, factors: Sequence[str], columns: Sequence[int], results: SeriesResults
) -> dict[str, Any]:
    """Return what the table shows of one specimen.

    Its cells are texts, each with a word of doubt.
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
    link = "" if specimen.kind is None else f"{quote(specimen.member.run or '')}/report.html"
    return {
        "specimen": specimen,
        "link": link,
        "factors": [specimen.factor(f) for f in factors],
        "cells": cells,
    }


def _specimen_orders(results: SeriesResults, factors: Sequence[str]) -> list[tuple[str, list[int]]]:
    specimens = results.specimens
    sort_keys: list[tuple[str, list[Any]]] = [
        ("name", [natural(s.name) for s in specimens]),
        ("state", [(s.member.state != "whole", s.member.state, s.light or "") for s in specimens]),
    ]
    factor_names = sorted(factors, key=lambda name: name not in results.grouped_by)
    sort_keys += [
        (f, [(not s.factor(f), natural(s.factor(f))) for s in specimens]) for f in factor_names[:3]
    ]
    for k, q in enumerate(results.quantities):
        if q.map == results.quantities[0].map:
            title = {
                "mean": "mean",
                "sd": "standard deviation",
                "thin_share": "thin share",
                "r": "r",
            }[q.what]
            map_values = [s.cells[k].value if s.cells else None for s in specimens]
            finite_first = [
                (False, v) if v is not None and math.isfinite(v) else (True, 0.0)
                for v in map_values
            ]
            sort_keys.append((title, finite_first))
    orders = [("as listed", list(range(len(specimens))))]
    for name, sort_key in sort_keys:
        order = sorted(range(len(specimens)), key=sort_key.__getitem__)
        if len(orders) < 9 and all(order != other_order for _, other_order in orders):
            orders.append((name, order))
    return orders


def natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """Key that puts 2 before 10."""
    runs = re.findall(r"\d+|\D+", name.casefold())
    return tuple((0, int(part), "") if part.isdecimal() else (1, 0, part) for part in runs)


@dataclass(frozen=True, slots=True, kw_only=True)
class SmallMap:
    """A map of one specimen, small; None where there is none, or it cannot be read."""

    specimen: str
    shown: ShownMap | None = None
    title: str = ""
    unit: str = ""


def small_map(specimen: str, data: xr.DataArray | None, *, pixels: float) -> SmallMap:
    """Make a small map of a map (rows, cols), of at most so many pixels along its longer side."""
    if data is None:
        return SmallMap(specimen=specimen)
    y, x = (data[d].values.astype(np.float64) for d in data.dims)
    ratio = min(
        1.0, data.shape[1] * abs(float(x[1] - x[0])) / (data.shape[0] * abs(float(y[1] - y[0])))
    )
    shown = reduced(data.values, y, x, width=pixels * ratio / 1.35)
    values = np.round(shown.values.astype(np.float32), 6).astype(np.float64)  # a page needs no more
    shown = ShownMap(values, shown.extent)
    return SmallMap(
        specimen=specimen, shown=shown, title=text.title_of(data), unit=text.unit_of(data)
    )


def _tile_maps(maps: Sequence[SmallMap]) -> dict[str, Any]:
    """Colour small maps by one scale, and on one scale of lengths.

    The colours go from the 1st to the 99th percentile of all of them.

    ``images`` are specimen, address, width and height in CSS pixels; ``missing`` the specimens
    without.
    """
    shown_maps = {
        m.specimen: m.shown
        for m in maps
        if m.shown is not None and bool(np.isfinite(m.shown.values).any())
    }
    missing_names = [m.specimen for m in maps if m.specimen not in shown_maps]
    if not shown_maps:
        return {"images": [], "missing": missing_names}
    scale = limits(np.concatenate([m.values.ravel() for m in shown_maps.values()]))
    um_per_px = max(max(m.width, m.height) for m in shown_maps.values()) / _WIDE
    images = [
        (
            name,
            image_uri(m.values, scale),
            max(m.width / um_per_px, _LEAST),
            max(m.height / um_per_px, _LEAST),
        )
        for name, m in shown_maps.items()
    ]
    # The colours of all small maps, and a length on them.
    canvas = Canvas(HALF, 62)
    first_map = next(m for m in maps if m.specimen in shown_maps)
    canvas.colour_bar(8, 6, 300, 12, scale)
    canvas.text(8, 54, axis_label(first_map.title, first_map.unit))
    bar_um = round_step(0.5 * _WIDE * um_per_px)
    canvas.line([(350, 12), (350 + bar_um / um_per_px, 12)], colour=INK, width=3)
    canvas.text(350, 32, plain(bar_um), size=SMALL)
    bar_picture = canvas.picture(title="Colours and scale of all maps", caption="")
    return {"bar": bar_picture, "images": images, "missing": missing_names}


def draw_groups(results: SeriesResults, k: int) -> Picture | None:
    """Draw one quantity of every sheet, by group, with the mean over sheets and its interval."""
    q, groups = results.quantities[k], [g for g in results.groups if g.quantity == k and g.fields]
    if sum(g.fields for g in groups) < 2:
        return None
    factor = 100.0 if q.what == "thin_share" else 1.0
    fields = [  # sheet and value of every specimen of a group that counts
        [
            (s.sheet, float(s.cells[k].value or 0.0))
            for s in results.specimens
            if s.cells and s.cells[k].counts and all(s.factor(f) == v for f, v in g.group.items())
        ]
        for g in groups
    ]
    plotted = [v * factor for group_fields in fields for _, v in group_fields]
    plotted += [v * factor for g in groups for v in g.interval if is_known(v)]
    names = [_short_label(g.group) for g in groups]
    label = axis_label(words.title(q), words.units(q))
    canvas, axes = row_axes(names, plotted, label, widest_px=_WIDEST_NAME)
    for i, (g, group_fields) in enumerate(zip(groups, fields, strict=True)):
        y = i + 0.5
        sheets = dict[str, list[float]]()
        axes.dots([(v * factor, y - 0.18) for _, v in group_fields], colour="#9db4c6", size=4)
        for sheet, v in group_fields:
            sheets.setdefault(sheet, []).append(v * factor)
        axes.dots([(float(np.mean(v)), y + 0.06) for v in sheets.values()], colour=POINT, size=6)
        if is_known(g.interval):
            axes.line([(v * factor, y + 0.3) for v in g.interval], colour=ACCENT, width=2)
        if is_known(g.mean):
            axes.dots([(g.mean * factor, y + 0.3)], colour=ACCENT, size=7)
    rows = [
        (words.label(g.group), *field)
        for g, of_group in zip(groups, fields, strict=True)
        for field in of_group
    ]
    means = [
        f"{words.label(g.group)} {words.value(g.mean, q)} ({words.sheets_text(g.sheets)})"
        for g in groups
    ]
    return canvas.picture(
        title=words.title(q),
        caption=(
            "Pale: single specimens; blue: sheets; red: mean over sheets with its 95 % interval,"
            f" where there are 3 sheets. Means: {'; '.join(means)}."
        ),
        data={
            "sheets": dict(
                zip(("group", "sheet", "value"), map(list, zip(*rows, strict=True)), strict=True)
            )
        },
    )


def _short_label(group: Mapping[str, str]) -> str:
    """Name a group beside its row: where that is too long, by the beginnings of its levels."""
    full_label = words.label(group)
    max_letters = int((_WIDEST_NAME - 16) / LETTER_PX)
    if len(full_label) <= max_letters:
        return full_label
    # Of each level, and what shorter ones leave over.
    letters = max(max_letters // len(group) - 3, 4)
    letters += sum(max(letters - len(level), 0) for level in group.values())
    return words.label(
        {f: v if len(v) <= letters else f"{v[: letters - 1]}…" for f, v in group.items()}
    )
