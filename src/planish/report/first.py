"""The first page: the maps that lead side by side on one mask, their larger points, and what would make it surer."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from planish.core.facts import is_known
from planish.report import relation
from planish.report.colours import Array, colours_of
from planish.report.draw import BELOW, MARGIN, THIRD, Canvas, Picture, n_of, pixel_of, reduced
from planish.report.relation import Points, largest
from planish.report.summary import Titles, density_of, lead_pair
from planish.report.text import HOLES, capital, fixed, label_of, title_of, typeset, unit_of, with_article
from planish.results import CorrelationRow, Results

if TYPE_CHECKING:
    from planish.core.checks import Check

_HIGHEST = 330.0  # pixels of a map
_BAR = 12.0  # from the edge of the figure to the map's right edge, and height of the colour bar
_WIDE = 0.1  # half of an interval of r from which a larger field is worth its while
_CEILING = 0.95  # r that misplacement leaves of a perfect relation


def draw_first(
    linked: Mapping[str, xr.Dataset], results: Results, titles: Titles, points: Points | None, *, without: str = HOLES
) -> list[Picture]:  # fmt: skip
    """Draw the two maps that lead, on one grid and one mask, and their larger points; nothing where they are missing.

    ``points`` are the larger points of the pair. What is withheld is not drawn as a relation.
    """
    rows = lead_pair(results)
    a, b = (linked.get(rows[0].a), linked.get(rows[0].b)) if rows else (None, None)
    if a is None or b is None or rows[0].a_map not in a or rows[0].b_map not in b:
        return []
    row = largest(rows)
    p, q = a[row.a_map], b[row.b_map]
    use = np.isfinite(p.values) & np.isfinite(q.values)
    for data in (a, b):
        use &= data["valid"].values.astype(bool) if "valid" in data else True
    values = [np.where(use, m.values.astype(np.float64), np.nan) for m in (p, q)]
    known = [v[use] for v in values]
    shown = [m.copy(data=v) for m, v in zip((p, q), values, strict=True)]
    together = np.concatenate(known) if row.same_quantity else None
    out = [
        _map(data, v, of=name, scaled=v[use] if together is None else together, without=without)
        for data, v, name in zip(shown, values, (row.a, row.b), strict=True)
    ]
    if points is not None and row.trust != "withheld":
        names = (titles[row.a, row.a_map], titles[row.b, row.b_map])
        if row.same_quantity or names[0] == names[1]:
            names = (f"{names[0]}, {row.a}", f"{names[1]}, {row.b}")
        out.append(
            relation.draw_points(
                points, row, names=names, units=(unit_of(p), unit_of(q)), height=out[0].height,
                density=density_of(results, row),
            )
        )  # fmt: skip
    return out


def _map(data: xr.DataArray, values: Array, *, of: str, scaled: Array, without: str) -> Picture:
    """Draw a map on a third of the page, with its colours below."""
    y, x = data["y"].values, data["x"].values
    room = THIRD - MARGIN - _BAR
    shown = reduced(values, y, x, width=room)
    box = shown.fit(room, _HIGHEST)
    scale = colours_of(data, scaled)
    canvas = Canvas(THIRD, box[1] + BELOW + 74)
    canvas.map_axes(MARGIN, 8, box, shown, scale)
    low = box[1] + BELOW + 8
    canvas.axes_names(MARGIN + box[0], low)
    canvas.colour_bar(MARGIN, low + 22, max(box[0], 150.0), 10, scale)
    canvas.text(MARGIN + max(box[0], 150.0) / 2, low + 62, label_of(data), anchor="middle")
    title = title_of(data) if with_article(of) != of else f"{title_of(data)}, {of}"
    return canvas.picture(
        title=title,
        caption=(
            f"n = {n_of(values)} pixels of {pixel_of(x)}; mask: valid in both maps, without {without}. Colours span "
            "the 1st to the 99th percentile."
        ),
    )


def surer(results: Results) -> list[str]:
    """Say in one or two sentences what would make the results surer."""
    return [text for text, _ in _surer(results)]


def advised(results: Results) -> list[Check]:
    """Checks whose advice is part of what would make it surer."""
    return [check for _, check in _surer(results) if check is not None]


def _surer(results: Results) -> list[tuple[str, Check | None]]:
    found: list[tuple[str, Check | None]] = [
        (f"{capital(check.name)}: {capital(typeset(check.advice))}", check)
        for check in (*results.checks_in("fail"), *results.checks_in("look")) if check.advice
    ]  # fmt: skip
    rows = lead_pair(results)
    found += [(text, None) for text in (_of_field(rows), _of_place(results), _of_study(results)) if text]
    if not found and results.is_link:
        found = [("A second specimen would show whether the relation holds beyond this one.", None)]
    if not found:
        found = [("A second field of the sheet would show how much the maps vary from place to place.", None)]
    return found[:2]


def _of_field(rows: Sequence[CorrelationRow]) -> str:
    """Say what a larger field would do to the interval of r."""
    row = largest(rows) if rows else None
    if row is None or row.trust != "ok" or not is_known(row.r):
        return ""
    if not is_known(row.interval):
        return "A larger field, or more fields: there are too few independent points for an interval of r."
    low, high = row.interval
    if (high - low) / 2 <= _WIDE and row.direction:
        return ""
    now = f"{fixed(low, 2)} to {fixed(high, 2)}"
    return f"A larger field, or more fields: four times the area would about halve the interval of r (now {now})."


def _of_place(results: Results) -> str:
    """Say what more marks would do to the correlation."""
    least = min((e.ceiling for e in results.evidence if e.ceiling is not None), default=math.inf)
    if least < _CEILING:
        return (
            f"More marks, spread over the field: with the expected error of the place, a perfect relation would show "
            f"r = {fixed(least, 2)} and no more."
        )
    for layer in results.moving:
        r = layer.registration
        if r is not None and r.leave_one_out_rms_um is None:
            return f"More marks: {r.matched} of {with_article(layer.name)} are too few for a leave-one-out error."
    return ""


def _of_study(results: Results) -> str:
    """Say that the map that leads can be declared."""
    if (
        not results.evidence
        or results.evidence[0].declared
        or all(layer.headline == "image" for layer in results.layers)
    ):
        return ""
    return "Declare the map that leads in the study (--headline) before the next specimen is looked at."
