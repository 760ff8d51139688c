"""The first page: the maps that lead, side by side on one mask, and their larger points.

Also what would make it certain.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from planish.core.area import valid_in_all
from planish.core.facts import is_known
from planish.core.numbers import capital, fixed, interval_text, typeset, with_article
from planish.core.parameter_words import in_terminal_words
from planish.report.colours import Array, colours_of
from planish.report.draw import BELOW, MARGIN, THIRD, Canvas, Picture, n_of, pixel_of, reduced
from planish.report.maps import RunMaps
from planish.report.relation import MapPair, draw_points, largest
from planish.report.sentences.attenuation import LEFT_OUT
from planish.report.summary import PairKey, key_of, lead_pair, titles_of
from planish.report.text import BY_TEXTURE, Basis, label_of, registered_by, title_of
from planish.results import CorrelationRow, Results

if TYPE_CHECKING:
    from planish.core.checks import Check


def draw_first(run_maps: RunMaps, pairs: Mapping[PairKey, MapPair]) -> list[Picture]:
    """Draw the two maps that lead, on one grid and mask, and larger points of ``pairs``.

    Points are those of the maps as they were compared, while the maps that are shown may be smaller
    copies. None where no pair leads; no points where their r is withheld.
    """
    rows = lead_pair(run_maps.results)
    if not rows:
        return []
    shown_pair = MapPair.of(run_maps.drawn, rows)
    if shown_pair is None:
        return []
    row = shown_pair.coarse
    maps = (shown_pair.a, shown_pair.b)
    masks = [mask.values for mask in shown_pair.valid]
    is_valid = valid_in_all([m.values for m in maps], masks)
    shown_maps = [m.astype(np.float64).where(is_valid) for m in maps]
    all_values = np.concatenate([m.values.ravel() for m in shown_maps])
    basis = run_maps.basis
    pictures: list[Picture] = []
    for m, layer in zip(shown_maps, (row.a, row.b), strict=True):
        values = all_values if row.same_quantity else m.values
        pictures.append(_draw_map(m, values, layer, basis))
    pair = pairs.get(key_of(row))
    if pair is not None and row.trust != "withheld":
        with_layers = row.same_quantity or row.a_map == row.b_map
        names = titles_of(row, run_maps.titles, with_layers=with_layers)
        height = pictures[0].height
        pictures.append(draw_points(pair, names=names, height=height, registered=basis.registered))
    return pictures


def _draw_map(data: xr.DataArray, colour_values: Array, layer: str, basis: Basis) -> Picture:
    """Draw a map of a layer on a third of the page, with its colours below.

    The colours span those of ``colour_values``.
    """
    map_px = THIRD - MARGIN - 12
    shown = reduced(data, width=map_px)
    map_size = shown.fit(map_px, 330.0)
    width, height = map_size
    scale = colours_of(data, colour_values)
    bar_px = max(width, 150.0)
    canvas = Canvas(THIRD, height + BELOW + 74)
    canvas.map_axes(MARGIN, 8, map_size, shown, scale)
    bottom_px = height + BELOW + 8
    canvas.draw_axis_names(MARGIN + width, bottom_px)
    canvas.colour_bar(MARGIN, bottom_px + 22, bar_px, 10, scale)
    canvas.text(MARGIN + bar_px / 2, bottom_px + 62, label_of(data), anchor="middle")
    title = title_of(data)
    if with_article(layer) == layer:  # a name of its own, such as ct, and not sheet or image
        title = f"{title}, {layer}"
    caption = (
        f"n = {n_of(data)} pixels of {pixel_of(data['x'].values)}; mask: valid in both maps,"
        f" without {basis.excluded}. Colours span the 1st to the 99th percentile."
    )
    return canvas.picture(title, caption)


def recommendations(results: Results) -> list[tuple[str, Check | None]]:
    """Say in one or two sentences what would make the results more certain.

    Each comes with the check whose advice it is, or None. Checks that failed come first, then those
    that ask for a look.
    """
    checks = [*results.checks_in("fail"), *results.checks_in("look")]
    advice: list[tuple[str, Check | None]] = [
        (f"{capital(check.name)}: {capital(typeset(check.advice))}", check)
        for check in checks
        if check.advice
    ]
    texts = [_field_advice(lead_pair(results)), _marks_advice(results)]
    has_leading_map = any(layer.headline != "image" for layer in results.layers)
    if results.evidence and not results.evidence[0].declared and has_leading_map:
        texts.append(
            "Declare the map that leads in the study before you look at the next specimen."
        )
    advice += [(text, None) for text in filter(None, texts)]
    usual_text = (
        "A second field of the sheet would show how much the maps vary from place to place."
    )
    if results.is_link:
        usual_text = "A second specimen would show whether the relation holds beyond this one."
    return advice[:2] or [(usual_text, None)]


def operator_notes(results: Results) -> list[str]:
    """Return what the next run can be given, by the options of the command line.

    These stand nowhere else on the page. They are remedies of checks, and what could have been
    declared and was not.
    """
    notes = [typeset(in_terminal_words(text)) for text in _remedies(results)]
    if results.evidence and not results.evidence[0].declared:
        notes.append("The map that leads is declared with --headline.")
    quantities = [layer.image.quantity for layer in results.layers if layer.image is not None]
    if "grey value, uncalibrated" in quantities:
        notes.append(
            "Reflectance in place of uncalibrated grey values: --white and --dark, pictures of a"
            " white sheet and without light; or --dark-grey and --white-grey, of two known greys."
        )
    if "about" not in results.parameters:
        notes.append(
            "Title, author, date and a note of this page: --title, --author, --date, --note."
        )
    return [*dict.fromkeys(notes)]


def _remedies(results: Results) -> Iterator[str]:
    """Remedies of checks, and of a side or direction that is not known."""
    for check in results.checks_in("fail", "look", "unknown"):
        if check.remedy:
            yield f"{capital(check.name)}: {check.advice} {check.remedy}"
    for layer in results.moving:
        if layer.registration is not None and layer.registration.orientation.remedy:
            view = layer.registration.orientation
            yield f"{view.sentence} {view.remedy}"


def _field_advice(pair_rows: Sequence[CorrelationRow]) -> str:
    """Say that a larger field narrows the interval of r; empty where that is not needed."""
    if not pair_rows:
        return ""
    row = largest(pair_rows)
    if row.trust != "ok" or not is_known(row.r):
        return ""
    if not is_known(row.interval):
        return (
            "A larger field, or more fields: there are too few independent points for an interval"
            " of r."
        )
    r_low, r_high = row.interval
    # Where half of the interval is wider, or it holds 0, a larger field is worth its while.
    if (r_high - r_low) / 2 <= 0.1 and row.direction:
        return ""
    interval = interval_text(row.interval)
    return (
        "A larger field, or more fields: four times the area would about halve the interval of r"
        f" (now {interval})."
    )


def _marks_advice(results: Results) -> str:
    """Say that more marks are needed; empty where there are enough of them."""
    more = "More marks"
    if registered_by(results) == BY_TEXTURE:
        more = "Laser holes as marks"
    r_limits = [e.attenuation_limit for e in results.evidence if e.attenuation_limit is not None]
    if r_limits and min(r_limits) < 0.95:  # r that misplacement leaves of a perfect relation
        return (
            f"{more}, spread over the field: with the expected error of the place, a perfect"
            f" relation would show r = {fixed(min(r_limits), 2)} and no more. {LEFT_OUT}"
        )
    for layer in results.moving:
        r = layer.registration
        if r is not None and r.leave_one_out_rms_um is None:
            return (
                f"More marks: {r.matched} of {with_article(layer.name)} are too few for a"
                " leave-one-out error."
            )
    return ""
