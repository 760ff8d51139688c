"""The first page: the maps that lead side by side on one mask, their larger points, and what would make it surer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from planish.core.facts import is_known
from planish.core.numbers import capital, fixed, interval_text, typeset
from planish.report.colours import Array, colours_of
from planish.report.draw import BELOW, MARGIN, THIRD, Canvas, Picture, n_of, pixel_of, reduced
from planish.report.maps import Groups
from planish.report.relation import MapPair, draw_points, largest
from planish.report.summary import PairKey, key_of, lead_pair, titles_of
from planish.report.text import label_of, title_of, with_article
from planish.results import CorrelationRow, Results

if TYPE_CHECKING:
    from planish.core.checks import Check


def draw_first(groups: Groups, pairs: Mapping[PairKey, MapPair]) -> list[Picture]:
    """Draw the two maps that lead, on one grid and one mask, and their larger points; nothing where they are missing.

    ``pairs`` may hold the larger points of the two. What is withheld is not drawn as a relation.
    """
    rows = lead_pair(groups.results)
    drawn = MapPair.of(groups.drawn, rows) if rows else None
    if drawn is None:
        return []
    row, maps, masks = drawn.coarse, (drawn.a, drawn.b), [mask.values.astype(bool) for mask in drawn.valid]
    use = np.logical_and.reduce([*(np.isfinite(m.values) for m in maps), *masks])
    shown = [m.copy(data=np.where(use, m.values.astype(np.float64), np.nan)) for m in maps]
    together = np.concatenate([m.values.ravel() for m in shown])
    pictures = [
        _map(m, together if row.same_quantity else m.values, of=name, without=groups.without)
        for m, name in zip(shown, (row.a, row.b), strict=True)
    ]
    pair = pairs.get(key_of(row))
    if pair is not None and row.trust != "withheld":
        names = titles_of(row, groups.titles)
        names = titles_of(row, groups.titles, with_layers=row.same_quantity or names[0] == names[1])
        pictures.append(draw_points(pair, names=names, height=pictures[0].height))
    return pictures


def _map(data: xr.DataArray, coloured: Array, *, of: str, without: str) -> Picture:
    """Draw a map on a third of the page, with its colours below, which span those of ``coloured``."""
    x, room = data["x"].values, THIRD - MARGIN - 12
    shown = reduced(data.values, data["y"].values, x, width=room)
    box = shown.fit(room, 330.0)
    scale, wide = colours_of(data, coloured), max(box[0], 150.0)
    canvas = Canvas(THIRD, box[1] + BELOW + 74)
    canvas.map_axes(MARGIN, 8, box, shown, scale)
    low = box[1] + BELOW + 8
    canvas.axes_names(MARGIN + box[0], low)
    canvas.colour_bar(MARGIN, low + 22, wide, 10, scale)
    canvas.text(MARGIN + wide / 2, low + 62, label_of(data), anchor="middle")
    return canvas.picture(
        title=title_of(data) if with_article(of) != of else f"{title_of(data)}, {of}",
        caption=(
            f"n = {n_of(data.values)} pixels of {pixel_of(x)}; mask: valid in both maps, without {without}. Colours "
            "span the 1st to the 99th percentile."
        ),
    )


def recommendations(results: Results) -> list[tuple[str, Check | None]]:
    """Say in one or two sentences what would make the results surer, each with the check whose advice it is."""
    advice: list[tuple[str, Check | None]] = [
        (f"{capital(check.name)}: {capital(typeset(check.advice))}", check)
        for check in (*results.checks_in("fail"), *results.checks_in("look")) if check.advice
    ]  # fmt: skip
    of_study = ""
    if results.evidence and not results.evidence[0].declared and any(x.headline != "image" for x in results.layers):
        of_study = "Declare the map that leads in the study (--headline) before the next specimen is looked at."
    advice += [(text, None) for text in (_of_field(lead_pair(results)), _of_place(results), of_study) if text]
    usual = (
        "A second specimen would show whether the relation holds beyond this one."
        if results.is_link
        else "A second field of the sheet would show how much the maps vary from place to place."
    )
    return advice[:2] or [(usual, None)]


def _of_field(rows: Sequence[CorrelationRow]) -> str:
    """Say what a larger field would do to the interval of r."""
    row = largest(rows) if rows else None
    if row is None or row.trust != "ok" or not is_known(row.r):
        return ""
    if not is_known(row.interval):
        return "A larger field, or more fields: there are too few independent points for an interval of r."
    low, high = row.interval
    # With a wider interval of r, a larger field is worth its while.
    if (high - low) / 2 <= 0.1 and row.direction:
        return ""
    now = interval_text(row.interval)
    return f"A larger field, or more fields: four times the area would about halve the interval of r (now {now})."


def _of_place(results: Results) -> str:
    """Say what more marks would do to the correlation."""
    ceilings = [e.ceiling for e in results.evidence if e.ceiling is not None]
    if ceilings and min(ceilings) < 0.95:  # r that misplacement leaves of a perfect relation
        return (
            f"More marks, spread over the field: with the expected error of the place, a perfect relation would show "
            f"r = {fixed(min(ceilings), 2)} and no more."
        )
    for layer in results.moving:
        r = layer.registration
        if r is not None and r.leave_one_out_rms_um is None:
            return f"More marks: {r.matched} of {with_article(layer.name)} are too few for a leave-one-out error."
    return ""
