"""One page from one run, whatever was linked.

A section appears where there is something to show.
"""

import re
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from html import escape
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from planish.core.arrays import check_path, not_taken
from planish.core.checks import trust_of
from planish.core.facts import is_known
from planish.core.files import write_whole
from planish.core.numbers import in_words, with_article
from planish.core.tables import table_text
from planish.core.typing import Entries
from planish.io.light import LIGHT
from planish.io.run_folder import refuse_existing
from planish.marks.exchange.model import points_of
from planish.report import (
    diagnostics,
    first_screen,
    flattening,
    maps,
    reading_r,
    registration,
    slices,
    statement,
    summary,
    tables,
    text,
)
from planish.report.draw import FULL, HALF, Picture
from planish.report.explain import explained_section
from planish.report.maps import Groups, RunMaps
from planish.report.relation import MapPair, draw_pair
from planish.report.scales import scales_section
from planish.report.sentences.table import Section, sentences
from planish.report.sentences.wording import Wording
from planish.results import EvidenceFacts, LayerFacts, RegistrationFacts, Results

FIGURES = "figures"
"""Folder of the figures in a run, or beside a page."""

_LONGEST = 50  # letters of a title in the name of a file
_SHEET_PARTS = ("surfaces", "flat", "strain", "maps", "slices")


def write_report(
    path: str | Path,
    run: Any = None,
    *,
    groups: Groups | None = None,
    marks: Mapping[str, xr.Dataset] | None = None,
    results: Results | None = None,
    figures: str | Path | None = None,
) -> None:
    """Write the report of a run as one HTML file that needs nothing else.

    Parameters
    ----------
    path : path
    run : Run, optional
        A run; or its parts one by one:
    groups : mapping of name to Dataset
        Of each sheet that was measured ``surfaces`` and ``flat`` (y, x), ``strain`` (row, col),
        ``maps`` (v, u) and ``slices``, as ``layers/NAME/surfaces`` or, where there is one sheet,
        ``surfaces``. After a link the maps on the pixels of the reference (y, x): ``layers/NAME``,
        or ``linked`` of a sheet and an image.
    marks : mapping of name to Dataset (mark)
        Pairs of marks, with residuals, of each layer but the reference, by its name; ``fixed_*`` in
        its own reference.
    results : Results
    figures : path, optional
        Folder to make for the figures, each as SVG and the numbers that it shows as CSV.

    Raises
    ------
    FileError
        If the page or the folder of the figures is there already; nothing is written then.
    InputError
        If neither a run nor results and groups are given, or the path is none.

    Notes
    -----
    The same input gives the same bytes: no dates, no random names.
    """
    page_path = check_path(
        path, "the path of the page first", "pl.write_report", 'pl.write_report("page.html", run)'
    )
    if figures is not None:
        refuse_existing(Path(figures))
    if groups is None or results is None:
        if not all(hasattr(run, slug) for slug in ("groups", "results", "registrations")):
            raise not_taken(run, "a run", 'pl.write_report("page.html", run)', "pl.write_report")
        groups = run.groups
        results = run.results
        marks = {
            name: registration.with_tiles_named(r.pairs(), r.marks)
            for name, r in run.registrations.items()
        }
    assert groups is not None
    assert results is not None
    page, pictures = render_report(groups, marks or {}, results)
    write_whole(page_path, page.encode())
    if figures is not None:
        _write_figures(Path(figures), pictures)


def _write_figures(folder: Path, pictures: Sequence[Picture]) -> None:
    """Write each figure as SVG, and the numbers that it shows as CSV."""
    folder.mkdir(parents=True)
    for figure_number, picture in enumerate(pictures, 1):
        file_stem = f"{figure_number:02d}-{_slug(picture.title) or 'figure'}"
        write_whole(folder / f"{file_stem}.svg", standalone(picture).encode())
        for table_name, table in picture.data.items():
            rows = zip(*table.values(), strict=True)
            csv_text = table_text(list(table), rows)
            write_whole(folder / f"{file_stem}-{table_name}.csv", csv_text.encode())


def _slug(title: str) -> str:
    """A title as it can be part of the name of a file anywhere."""
    decomposed = unicodedata.normalize("NFKD", title.replace("µ", "u"))
    ascii_title = decomposed.encode("ascii", "ignore").decode()
    slug = re.sub(r"[^a-z0-9]+", "-", ascii_title.lower()).strip("-")
    if len(slug) <= _LONGEST:
        return slug
    whole_words = slug[: _LONGEST + 1].rpartition("-")[0]
    return whole_words or slug[:_LONGEST]


def render_report(
    groups: Groups, marks: Mapping[str, xr.Dataset], results: Results
) -> tuple[str, list[Picture]]:
    """Return the page of :func:`write_report` as text, and its figures in the order shown."""
    run_maps = RunMaps(results, groups)
    pictures: list[Picture] = []

    def numbered(picture: Picture) -> int:
        """Give a figure its number when the template comes to it."""
        pictures.append(picture)
        return len(pictures)

    sheets = [*filter(None, (_sheet_section(run_maps, layer) for layer in results.layers))]
    pairs = _map_pairs(run_maps)
    leading = first_screen.draw_first(run_maps, pairs)
    # Without a pair that leads, each sheet shows the map that stands for it.
    if not leading:
        leading = [*chain.from_iterable(sheet["leading"] for sheet in sheets)]
    blocks = [
        _registration_section(run_maps, layer, marks.get(layer.name)) for layer in results.moving
    ]
    lit_layers = [layer.name for layer in results.layers if f"{LIGHT}/{layer.name}" in groups]
    page = text.template("planish.report", "report.html.j2").render(
        results=results,
        layers=results.layers,
        reference=results.reference,
        titles=run_maps.titles,
        tables=tables,
        summary=summary,
        statement=statement,
        text=text,
        first=first_screen,
        reading=reading_r,
        diagnostics=diagnostics,
        numbered=numbered,
        sheets=sheets,
        leading=leading,
        blocks=list(filter(None, blocks)),
        pairs=[_draw_pair(run_maps, pair) for pair in pairs.values()],
        lights=[maps.draw_light(groups[f"{LIGHT}/{name}"], name) for name in lit_layers],
        evidence=[_evidence_section(run_maps, e, pairs) for e in results.evidence],
        explained=explained_section(results.explained),
        scales=scales_section(results.scales),
    )
    return f"{page}\n", pictures


def _sheet_section(run_maps: RunMaps, layer: LayerFacts) -> Entries | None:
    """Draw all that is shown of a sheet, by the names that the template has for it.

    None for an image, and for a sheet whose groups are elsewhere.
    """
    facts = layer.sheet
    parts = {name: run_maps.part(layer, name) for name in _SHEET_PARTS}
    sheet_data = {name: data for name, data in parts.items() if data is not None}
    if facts is None or len(sheet_data) < len(_SHEET_PARTS):
        return None
    surfaces = sheet_data["surfaces"]
    strain = sheet_data["strain"]
    height_um = surfaces["centre"].values
    rim_um = facts.surfaces.rim_um or 0.0
    draw_maps = partial(
        maps.draw_maps, sheet_data["maps"], facts.properties, headline=layer.headline, rim_um=rim_um
    )
    return {
        "layer": layer,
        "trust": partial(trust_of, run_maps.results.checks, (layer.name,)),
        "warp_um": float(np.nanmax(height_um) - np.nanmin(height_um)),
        "slices": slices.draw_slices(sheet_data["slices"], surfaces),
        "warp": flattening.draw_flattening(
            surfaces, sheet_data["flat"], strain, facts.flatten.curvature
        ),
        "progress": [flattening.draw_progress(strain)],
        "maps": draw_maps(),
        "leading": [] if run_maps.results.is_link else draw_maps(lead_only=True),
    }


def _registration_section(
    run_maps: RunMaps, layer: LayerFacts, marks: xr.Dataset | None
) -> Entries | None:
    """Draw how a layer lies on the reference, by the names that the template has for it.

    None where it is not known, or maps are elsewhere. ``marks`` are those of
    :func:`write_report`, None where the layer has none.
    """
    r = registration.judged(layer.registration)
    results = run_maps.results
    reference_layer = results.reference
    layer_maps = run_maps.drawn.get(layer.name)
    reference_maps = run_maps.drawn.get(reference_layer.name)
    if r is None or layer_maps is None or reference_maps is None:
        return None
    if marks is not None and not marks.sizes["mark"]:  # registered by texture alone
        marks = None
    reference_map = reference_maps[reference_layer.headline]
    map_texts = (
        _map_in_words(layer_maps[layer.headline], layer),
        _map_in_words(reference_map, reference_layer),
    )
    # Where a coating is thin shows on an image; other layers stand side by side.
    is_outlined = reference_layer.kind == "image" and layer.kind == "sheet"
    basis = run_maps.basis
    if is_outlined:
        valid = layer_maps["valid"]
        if "valid" in reference_maps:
            valid = valid & reference_maps["valid"]
        options = results.parameters.get("correlate", {})
        thin_um = float(options.get("thin_um", 5.0))
        with_image = layer_maps.assign(image=reference_map, valid=valid)
        linked_pictures = maps.draw_outlines(
            with_image, name=layer.headline, thin_um=thin_um, basis=basis
        )
    else:
        pair_rows = summary.headline_pair(results, layer)
        same_scale = bool(pair_rows) and pair_rows[0].same_quantity
        layers = (layer.name, reference_layer.name)
        map_pair = (
            _valid_values(layer_maps, layer.headline),
            _valid_values(reference_maps, reference_layer.headline),
        )
        side_by_side = maps.draw_side_by_side(map_pair, layers, same_scale=same_scale, basis=basis)
        linked_pictures = [side_by_side]
    return {
        "layer": layer,
        "registration": r,
        "marks": marks,
        "linked": linked_pictures,
        "outlined": is_outlined,
        "check": summary.lag_verdict(r.lag, map_texts),
        "pictures": _registration_pictures(run_maps, layer, r, marks, map_texts),
    }


def _registration_pictures(
    run_maps: RunMaps,
    layer: LayerFacts,
    r: RegistrationFacts,
    marks: xr.Dataset | None,
    map_texts: text.TwoTexts,
) -> list[Picture]:
    """Draw a layer's residuals, expected error and lags of tiles, as far as they are known.

    ``map_texts``: in words, its map and the reference's.
    """
    results = run_maps.results
    reference = results.reference.name
    width = HALF
    if len(results.layers) == 2:
        width = FULL
    options = results.parameters.get("holes", {})
    least_um, most_um = options.get("hole_um", (100.0, 300.0))
    hole_um = (least_um + most_um) / 2  # diameter with which marks are drawn
    ground = _ground_of(run_maps, layer)
    lags = registration.draw_lags(r.lag, ground, map_texts=map_texts)
    pictures: list[Picture | None] = []
    # A layer may be registered to another one that is not the reference: its marks lie on that.
    is_on_reference = r.to == reference
    if marks is not None:
        marks_ground = ground
        if not is_on_reference:
            marks_ground = registration.blank_ground(points_of(marks, "fixed"), layer=r.to)
        residuals = registration.draw_registration(
            r, marks_ground, marks, hole_um=hole_um, moving_layer=layer.name, width=width
        )
        pictures.append(residuals)
    layer_maps = run_maps.drawn[layer.name]
    if "expected_error" in layer_maps:
        # Alone it takes the whole width, beside another figure half of it.
        errors = registration.draw_expected_error(
            layer_maps["expected_error"],
            marks if is_on_reference else None,
            hole_um=hole_um,
            width=width if lags is None else HALF,
            reference=reference,
            layer=layer.name,
        )
        pictures.append(errors)
    return [*filter(None, (*pictures, lags))]


def _ground_of(run_maps: RunMaps, layer: LayerFacts) -> registration.Ground:
    """The map of the reference to draw on, with the edge of a layer that lies on its pixels."""
    reference = run_maps.results.reference
    layer_maps = run_maps.drawn[layer.name]
    valid = None
    if "valid" in layer_maps and reference.kind == "image":
        valid = layer_maps["valid"].values.astype(bool)
    # The edge of a layer is that of a map that has values wherever the layer is.
    edge_names = ("u", "image", "thickness", *layer_maps.data_vars)
    edge_name = next(name for name in edge_names if name in layer_maps)
    edge = layer_maps[edge_name].notnull()
    data = run_maps.drawn[reference.name][reference.headline]
    return registration.ground_of(
        data, layer=reference.name, valid=valid, edge=edge, edge_of=layer.name
    )


def _map_pairs(run_maps: RunMaps) -> dict[summary.PairKey, MapPair]:
    """Give the pairs of maps that stand for two layers, and all of the same quantity.

    Only those of which both maps are at hand, in the order of the correlations.
    """
    results = run_maps.results
    pairs = dict[summary.PairKey, MapPair]()
    headlines = {(layer.name, layer.headline) for layer in results.layers}
    for pair_rows in summary.by_pair(results):
        row = pair_rows[0]
        pair = MapPair.of(run_maps.linked, pair_rows, summary.density_of(results, row))
        are_headlines = headlines >= {(row.a, row.a_map), (row.b, row.b_map)}
        if pair and (row.same_quantity or are_headlines):
            pairs[summary.key_of(row)] = pair
    return pairs


def _draw_pair(run_maps: RunMaps, pair: MapPair) -> Picture:
    row = pair.coarse
    with_layers = len(run_maps.results.layers) > 2 or row.a_map == row.b_map
    titles = summary.titles_of(row, run_maps.titles, with_layers=with_layers)
    return draw_pair(pair, names=titles, basis=run_maps.basis)


def _evidence_section(
    run_maps: RunMaps, e: EvidenceFacts, pairs: Mapping[summary.PairKey, MapPair]
) -> Entries:
    """Draw and say what is known of the relation of two maps beside its r, by section.

    ``pairs``: maps of which the larger points are drawn; a pair may be missing there.
    """
    is_same_map = e.a_map == e.b_map
    map_titles: list[str] = []
    for curve in e.variograms:
        map_title = run_maps.titles.get((curve.layer, curve.map), curve.map)
        if is_same_map:
            map_title = f"{map_title}, {curve.layer}"
        map_titles.append(map_title)
    names = summary.names_in_words(e, run_maps.titles)
    first_title, second_title = names
    if is_same_map:
        names = (f"{first_title} of {e.a}", f"that of {e.b}")
    sections: tuple[Section, ...] = ("scale", "distance", "repeated", "light")
    figures: dict[Section, list[Picture]] = {section: [] for section in sections}
    pair = pairs.get(summary.key_of(e))
    for section, picture in _evidence_pictures(run_maps, e, pair, names, map_titles):
        figures[section].append(picture)
    options = run_maps.results.parameters.get("correlate", {})
    point_um = float(options.get("point_um", "nan"))
    wording = Wording(point_um, second_title, tuple(map_titles))
    section_sentences = {section: [*sentences(e, section, wording)] for section in figures}
    return {"of": f"{e.a} and {e.b}", "figures": figures, "sentences": section_sentences}


def _evidence_pictures(
    run_maps: RunMaps,
    e: EvidenceFacts,
    pair: MapPair | None,
    names: text.TwoTexts,
    map_titles: Sequence[str],
) -> Iterator[tuple[Section, Picture]]:
    """Draw what is known of two maps beside their r; each figure comes with its section.

    ``names``: both maps in a sentence; ``map_titles``: titles of the maps of ``e.variograms``.
    """
    basis = run_maps.basis
    titles = summary.titles_of(e, run_maps.titles)
    if e.sizes or e.bands:
        yield "scale", diagnostics.draw_scale(e, names=names, basis=basis)
    if e.variograms:
        yield "distance", diagnostics.draw_variograms(e, titles=map_titles, basis=basis)
    if e.correlogram is not None:
        yield "distance", diagnostics.draw_correlogram(e.correlogram, names=names, basis=basis)
    if e.agreement is not None and e.agreement.rings:
        name = in_words(titles[0])
        layers = (e.a, e.b)
        rings = diagnostics.draw_rings(e.agreement, name=name, layers=layers, basis=basis)
        yield "repeated", rings
    curve = e.kubelka_munk
    if curve is not None and is_known(curve.scattering) and pair is not None:
        points = (pair.points, pair.coarse)
        light = diagnostics.draw_kubelka_munk(e, curve, *points, titles=titles, basis=basis)
        yield "light", light


def _valid_values(maps: xr.Dataset, name: str) -> xr.DataArray:
    data = maps[name].astype(np.float64)
    if "valid" not in maps:
        return data
    return data.where(maps["valid"].values.astype(bool))


def _map_in_words(map_data: xr.DataArray, layer: LayerFacts) -> str:
    """Name a map by its title, or an image by its layer; a layer's own name stands behind both."""
    layer_text = with_article(layer.name)
    if layer.kind == "image":
        return layer_text
    title = in_words(text.title_of(map_data))
    if layer_text != layer.name:
        return title
    return f"{title} of {layer.name}"


def standalone(picture: Picture) -> str:
    """Return the SVG of a figure as a file of its own, with its caption, on white."""
    svg_tag, _, content = picture.svg.partition(">")
    description = f"<title>{escape(picture.title)}</title><desc>{escape(picture.caption)}</desc>"
    background = '<rect width="100%" height="100%" fill="#ffffff"/>'
    opening_tag = svg_tag.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)
    head = '<?xml version="1.0" encoding="UTF-8"?>'
    return f"{head}\n{opening_tag}>{description}{background}{content}\n"
