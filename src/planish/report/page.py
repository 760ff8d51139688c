"""One page from one run, whatever was linked: a section appears where there is something to show."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from functools import cache, partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.analyze.correlation_evidence import PairWords, Section, sentences
from planish.core.arrays import check_path, not_taken
from planish.core.facts import is_known
from planish.core.files import write_whole
from planish.core.numbers import in_words
from planish.core.tables import table_text
from planish.marks.exchange.model import points_of
from planish.report import diagnostics, first, flattening, maps, registration, slices, statement, summary, tables, text
from planish.report.draw import FULL, HALF, Picture
from planish.report.relation import MapPair, draw_pair
from planish.results import EvidenceFacts, LayerFacts, Results

if TYPE_CHECKING:
    from jinja2 import Template

FIGURES = "figures"
"""Folder of the figures in a run, or beside a page."""

_LONGEST = 50  # letters of a title in the name of a file
_SHEET_PARTS = ("surfaces", "flat", "strain", "maps", "slices")


def write_report(
    path: str | Path, run: Any = None, *, groups: Mapping[str, xr.Dataset] | None = None,
    marks: Mapping[str, xr.Dataset] | None = None, results: Results | None = None, figures: str | Path | None = None,
) -> None:  # fmt: skip
    """Write the report of a run as one HTML file that needs nothing else.

    Parameters
    ----------
    path : path
    run : Run, optional
        A run; or its parts one by one:
    groups : mapping of name to Dataset
        Of each sheet that was measured ``surfaces`` and ``flat`` (y, x), ``strain`` (row, col), ``maps`` (v, u) and
        ``slices``, as ``layers/NAME/surfaces`` or, where there is one sheet, ``surfaces``. After a link the maps on the
        pixels of the reference (y, x): ``layers/NAME``, or ``linked`` of a sheet and an image.
    marks : mapping of name to Dataset (mark)
        Pairs of marks of each layer but the reference with their residuals, by its name; ``fixed_*`` in the layer that
        it was registered to.
    results : Results
    figures : path, optional
        Folder to make for the figures, each as SVG and the numbers that it shows as CSV.

    Raises
    ------
    InputError
        If neither a run nor results and groups are given, or the path is none.

    Notes
    -----
    The same input gives the same bytes: no dates, no random names.
    """
    place = check_path(path, "the path of the page first", "pl.write_report", 'pl.write_report("page.html", run)')
    if groups is None or results is None:
        if not all(hasattr(run, name) for name in ("groups", "results", "registrations")):
            raise not_taken(run, "a run", 'pl.write_report("page.html", run)', "pl.write_report")
        groups, results = run.groups, run.results
        marks = {name: registration.pairs() for name, registration in run.registrations.items()}
    assert groups is not None
    assert results is not None
    page, pictures = render_report(groups, marks or {}, results)
    write_whole(place, page.encode())
    if figures is None:
        return
    folder = Path(figures)
    folder.mkdir()
    for number, picture in enumerate(pictures, 1):
        # A title as it can be part of the name of a file anywhere.
        title = unicodedata.normalize("NFKD", picture.title.replace("µ", "u")).encode("ascii", "ignore").decode()
        name = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")
        short = name if len(name) <= _LONGEST else name[: _LONGEST + 1].rpartition("-")[0] or name[:_LONGEST]
        stem = f"{number:02d}-{short or 'figure'}"
        write_whole(folder / f"{stem}.svg", standalone(picture).encode())
        for kind, table in picture.data.items():
            csv = table_text(list(table), zip(*table.values(), strict=True))
            write_whole(folder / f"{stem}-{kind}.csv", csv.encode())


def render_report(
    groups: Mapping[str, xr.Dataset], marks: Mapping[str, xr.Dataset], results: Results
) -> tuple[str, list[Picture]]:
    """Return the page of :func:`write_report` as text, and its figures in the order in which it shows them."""
    data, pictures = maps.Groups(results, groups), list[Picture]()

    def numbered(picture: Picture) -> int:
        pictures.append(picture)
        return len(pictures)

    sheets = [sheet for layer in results.layers if (sheet := _sheet(data, layer))]
    pairs = _pairs(data)
    page = report_template().render(
        results=results, layers=results.layers, reference=results.reference, titles=data.titles, tables=tables,
        summary=summary, statement=statement, text=text, first=first, diagnostics=diagnostics, numbered=numbered,
        sheets=sheets, leading=first.draw_first(data, pairs) or
        [picture for sheet in sheets for picture in sheet["leading"]],
        blocks=[block for layer in results.moving if (block := _block(data, layer, marks.get(layer.name)))],
        pairs=[_draw_pair(data, pair) for pair in pairs.values()],
        evidence=[_evidence(data, e, pairs) for e in results.evidence],
    )  # fmt: skip
    return f"{page}\n", pictures


@cache
def report_template() -> Template:
    """The template of the page, which takes a second to compile together with its parts."""
    page = text.template("planish.report", "report.html.j2")
    for part in ("parts.html.j2", "style.css"):
        page.environment.get_template(part)
    return page


def _sheet(groups: maps.Groups, layer: LayerFacts) -> dict[str, Any] | None:
    """Draw all that is shown of a sheet; None for an image, and for a sheet whose groups are elsewhere."""
    facts = layer.sheet
    parts = {name: data for name in _SHEET_PARTS if (data := groups.part(layer, name)) is not None}
    if facts is None or len(parts) < len(_SHEET_PARTS):
        return None
    surfaces, strain, height = parts["surfaces"], parts["strain"], parts["surfaces"]["centre"].values
    draw_maps = partial(
        maps.draw_maps, parts["maps"], facts.properties, headline=layer.headline, rim_um=facts.surfaces.rim_um or 0.0
    )
    return {
        "layer": layer, "warp_um": float(np.nanmax(height) - np.nanmin(height)),
        "slices": slices.draw_slices(parts["slices"], surfaces),
        "warp": flattening.draw_flattening(surfaces, parts["flat"], strain, facts.flatten.curvature),
        "progress": [flattening.draw_progress(strain)], "maps": draw_maps(),
        "leading": [] if groups.results.is_link else draw_maps(lead_only=True),
    }  # fmt: skip


def _block(groups: maps.Groups, layer: LayerFacts, marks: xr.Dataset | None) -> dict[str, Any] | None:
    """Draw all that is shown of the registration of a layer; None where it or a map is missing."""
    r, results, base = layer.registration, groups.results, groups.results.reference
    data, reference = groups.drawn.get(layer.name), groups.drawn.get(base.name)
    if r is None or data is None or reference is None:
        return None
    marks = marks if marks is not None and marks.sizes["mark"] else None
    other = reference[base.headline]
    names = _named(data[layer.headline], layer), _named(other, base)
    outlined = base.kind == "image" and layer.kind == "sheet"
    if outlined:
        valid = data["valid"] & reference["valid"] if "valid" in reference else data["valid"]
        thin_um = float(results.parameters.get("correlate", {}).get("thin_um", 5.0))
        with_image = data.assign(image=other, valid=valid)
        shown = maps.draw_outlines(with_image, name=layer.headline, thin_um=thin_um, without=groups.without)
    else:
        rows = summary.headline_pair(results, layer)
        pair = _valid(data, layer.headline), _valid(reference, base.headline)
        shown = [maps.draw_side_by_side(
            pair, names=(layer.name, base.name), shared=bool(rows) and rows[0].same_quantity, without=groups.without
        )]  # fmt: skip
    return {
        "layer": layer, "marks": marks, "check": summary.lag_verdict(r.lag, first=names[0], second=names[1]),
        "pictures": _registration(layer, data, other, marks, results, names), "linked": shown, "outlined": outlined,
    }  # fmt: skip


def _registration(
    layer: LayerFacts, data: xr.Dataset, other: xr.DataArray, marks: xr.Dataset | None, results: Results,
    names: tuple[str, str],
) -> list[Picture]:  # fmt: skip
    """Draw the residuals of a layer's marks, its expected error, and the lags of its tiles.

    ``names`` are its map and that of the reference in words.
    """
    r, base, two = layer.registration, results.reference, len(results.layers) == 2
    assert r is not None
    hole_um = float(sum(results.parameters.get("holes", {}).get("hole_um", (100.0, 300.0))) / 2)
    window = data["valid"].values.astype(bool) if "valid" in data and base.kind == "image" else None
    edge = next(data[name] for name in ("u", "image", "thickness", *data.data_vars) if name in data)
    ground = registration.ground_of(
        other, of=base.name, valid=window, edge=np.isfinite(edge.values), edge_of=layer.name
    )
    pictures: list[Picture | None] = []
    if marks is not None:
        blank = registration.blank_ground(points_of(marks, "fixed"), of=r.to)
        pictures.append(registration.draw_registration(
            r, ground if r.to == base.name else blank, marks, hole_um=hole_um, source=layer.name,
            width=FULL if two else HALF,
        ))  # fmt: skip
    lags = registration.draw_lags(r.lag, ground, first=names[0], second=names[1])
    if "expected_error" in data:
        # Alone it takes the whole width, beside another figure half of it.
        pictures.append(registration.draw_expected_error(
            data["expected_error"], marks if r.to == base.name else None, hole_um=hole_um,
            width=FULL if two and lags is None else HALF, of=base.name, shown=layer.name,
        ))  # fmt: skip
    return [picture for picture in (*pictures, lags) if picture is not None]


def _pairs(groups: maps.Groups) -> dict[summary.PairKey, MapPair]:
    """Give the pairs of maps that stand for two layers, and all maps of the same quantity, where both are at hand."""
    results, pairs = groups.results, dict[summary.PairKey, MapPair]()
    headlines = {(layer.name, layer.headline) for layer in results.layers}
    for rows in summary.by_pair(results):
        row, pair = rows[0], MapPair.of(groups.linked, rows, summary.density_of(results, rows[0]))
        if pair and (row.same_quantity or headlines >= {(row.a, row.a_map), (row.b, row.b_map)}):
            pairs[summary.key_of(row)] = pair
    return pairs


def _draw_pair(groups: maps.Groups, pair: MapPair) -> Picture:
    with_layers = len(groups.results.layers) > 2 or pair.coarse.same_quantity
    names = summary.titles_of(pair.coarse, groups.titles, with_layers=with_layers)
    return draw_pair(pair, names=names, without=groups.without)


def _evidence(groups: maps.Groups, e: EvidenceFacts, pairs: Mapping[summary.PairKey, MapPair]) -> dict[str, Any]:
    """Draw what stands beside r of the maps that stand for two layers, and say what it means, by section."""
    titles, without, same = groups.titles, groups.without, e.a_map == e.b_map
    names, pair = summary.names_in_words(e, titles), pairs.get(summary.key_of(e))
    figures: dict[Section, list[Picture]] = {"scale": [], "distance": [], "repeated": [], "light": []}
    if e.sizes or e.bands:
        figures["scale"].append(diagnostics.draw_scale(e, names=names, without=without))
    curves = [(curve.layer, curve.map) for curve in e.variograms]
    map_titles = tuple(titles.get(key, key[1]) + (f", {key[0]}" if same else "") for key in curves)
    if e.variograms:
        figures["distance"].append(diagnostics.draw_variograms(e, titles=map_titles, without=without))
    if e.correlogram is not None:
        moved = (f"{names[0]} of {e.a}", f"that of {e.b}") if same else names
        figures["distance"].append(diagnostics.draw_correlogram(e.correlogram, names=moved, without=without))
    if e.twice is not None and e.twice.rings:
        rings = diagnostics.draw_rings(e.twice, name=names[0], layers=(e.a, e.b), without=without)
        figures["repeated"].append(rings)
    if e.kubelka_munk is not None and is_known(e.kubelka_munk.scattering) and pair is not None:
        figures["light"].append(diagnostics.draw_kubelka_munk(
            e, e.kubelka_munk, pair.points, pair.coarse, titles=summary.titles_of(e, titles), without=without
        ))  # fmt: skip
    point_um = float(groups.results.parameters.get("correlate", {}).get("point_um", "nan"))
    words = PairWords(point_um, names[1], map_titles)
    text_of = {section: [*sentences(e, section, words)] for section in figures}
    return {"of": f"{e.a} and {e.b}", "figures": figures, "sentences": text_of}


def _valid(data: xr.Dataset, name: str) -> xr.DataArray:
    """Return a map, NaN where it is not valid."""
    use: NDArray[np.bool_] | bool = data["valid"].values.astype(bool) if "valid" in data else True
    return data[name].copy(data=np.where(use, data[name].values.astype(np.float64), np.nan))


def _named(data: xr.DataArray, layer: LayerFacts) -> str:
    with_article, title = text.with_article(layer.name), in_words(text.title_of(data))
    if layer.kind == "image":
        return with_article
    return title if with_article != layer.name else f"{title} of {layer.name}"


def standalone(picture: Picture) -> str:
    """Return the SVG of a figure as a file of its own, with its caption, on white."""
    head, _, rest = picture.svg.partition(">")
    inside = f"<title>{escape(picture.title)}</title><desc>{escape(picture.caption)}</desc>"
    ground = '<rect width="100%" height="100%" fill="#ffffff"/>'
    start = head.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{start}>{inside}{ground}{rest}\n'
