"""One page from one run, whatever was linked: a section appears where there is something to show."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from functools import cache, partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.arrays import check_path, not_taken
from planish.core.facts import is_known
from planish.core.files import write_whole
from planish.core.tables import table_text
from planish.report import (
    distance,
    first,
    flattening,
    light,
    maps,
    registration,
    relation,
    scale,
    slices,
    statement,
    summary,
    tables,
    text,
)
from planish.report.draw import FULL, HALF, Picture
from planish.results import CorrelationRow, EvidenceFacts, LayerFacts, RegistrationFacts, Results

if TYPE_CHECKING:
    from jinja2 import Template

FIGURES = "figures"
"""Folder of the figures in a run, or beside a page."""

_LONGEST = 50  # letters of a title in the name of a file
_HOLE_UM = (100.0, 300.0)
_THIN_UM = 5.0
_SHEET_PARTS = ("surfaces", "flat", "strain", "maps", "slices")


class _Sheet(NamedTuple):
    """What the page shows of one sheet that was measured in this run, beside its results."""

    layer: LayerFacts
    warp_um: float
    slices: list[Picture]
    warp: list[Picture]
    progress: list[Picture]
    maps: list[Picture]
    leading: list[Picture]


class _Block(NamedTuple):
    """What the page shows of the registration of one layer, beside its results."""

    layer: LayerFacts
    marks: xr.Dataset | None
    check: summary.LagVerdict | None
    pictures: list[Picture]
    linked: list[Picture]
    outlined: bool


class _MapPair(NamedTuple):
    """Two maps on one grid, masks of the pixels that count, their correlations, and means over the largest points."""

    maps: tuple[xr.DataArray, xr.DataArray]
    valid: list[xr.DataArray]
    rows: list[CorrelationRow]
    points: relation.Points


class _Light(NamedTuple):
    """What light makes of the coating of a pair of layers, where it was asked for: figures and what may be said."""

    of: str
    pictures: list[Picture]
    sentences: list[str]


class _Distances(NamedTuple):
    """How the maps of a pair vary with distance: of which layers, figures and what may be said."""

    of: str
    alone: list[Picture]
    sentences: list[str]
    twice: list[Picture]
    agreement: list[str]


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
    page, pictures = _render(groups, marks or {}, results)
    write_whole(place, page.encode())
    if figures is not None:
        _write_figures(Path(figures), pictures)


def render_report(*, groups: Mapping[str, xr.Dataset], marks: Mapping[str, xr.Dataset], results: Results) -> str:
    """Return the page of :func:`write_report` as text."""
    return _render(groups, marks, results)[0]


def _render(
    groups: Mapping[str, xr.Dataset], marks: Mapping[str, xr.Dataset], results: Results
) -> tuple[str, list[Picture]]:
    """Return the page as text, and its figures in their order."""
    data = maps.Groups(results, groups)
    sheets = [s for layer in results.layers if (s := _sheet(data, layer))]
    pairs, lead = _map_pairs(data.linked, results), summary.lead_pair(results)
    lead_points = pairs[key].points if lead and (key := summary.key_of(lead[0])) in pairs else None
    leading = first.draw_first(
        data.drawn, results, data.titles, lead_points, without=text.left_out(results.regions)
    ) or [picture for s in sheets for picture in s.leading]
    shown = _Shown()
    page = report_template().render(
        results=results, layers=results.layers, reference=results.reference, titles=data.titles, tables=tables,
        summary=summary, statement=statement, text=text, first=first, shown=shown, sheets=sheets, leading=leading,
        blocks=[b for layer in results.moving if (b := _block(layer, data.drawn, marks.get(layer.name), results))],
        pairs=_draw_pairs(pairs, results, data.titles), scales=_scales(results, data.titles), scale=scale,
        lights=[d for e in results.evidence if (d := _light(e, results, data.titles, pairs))],
        distances=[d for e in results.evidence if (d := _distances(e, results, data.titles))], light=light,
    )  # fmt: skip
    return f"{page}\n", shown.pictures


class _Shown:
    """The figures of a page in the order in which it shows them."""

    def __init__(self) -> None:
        self.pictures: list[Picture] = []

    def number(self, picture: Picture) -> int:
        """Return the number of a figure that is shown now."""
        self.pictures.append(picture)
        return len(self.pictures)


@cache
def report_template() -> Template:
    """The template of the page, which takes a second to compile together with its parts."""
    page = text.template("planish.report", "report.html.j2")
    for part in ("parts.html.j2", "style.css"):
        page.environment.get_template(part)
    return page


def _sheet(groups: maps.Groups, layer: LayerFacts) -> _Sheet | None:
    """Draw all that is shown of a sheet; None for an image, and for a sheet whose groups are elsewhere."""
    facts = layer.sheet
    parts = {name: data for name in _SHEET_PARTS if (data := groups.part(layer, name)) is not None}
    if facts is None or len(parts) < len(_SHEET_PARTS):
        return None
    surfaces, height = parts["surfaces"], parts["surfaces"]["centre"].values
    draw_maps = partial(
        maps.draw_maps, parts["maps"], facts.properties, headline=layer.headline, rim_um=facts.surfaces.rim_um or 0.0
    )
    return _Sheet(
        layer=layer, warp_um=float(np.nanmax(height) - np.nanmin(height)),
        slices=slices.draw_slices(parts["slices"], surfaces),
        warp=flattening.draw_flattening(surfaces, parts["flat"], parts["strain"], facts.flatten.curvature),
        progress=[flattening.draw_progress(parts["strain"])],
        maps=draw_maps(),
        leading=[] if groups.results.is_link else draw_maps(lead_only=True),
    )  # fmt: skip


def _block(
    layer: LayerFacts, linked: Mapping[str, xr.Dataset], marks: xr.Dataset | None, results: Results
) -> _Block | None:
    """Draw all that is shown of the registration of a layer."""
    r, base = layer.registration, results.reference
    data, reference = linked.get(layer.name), linked.get(base.name)
    if r is None or data is None or reference is None:
        return None
    other = reference[base.headline]
    first, second = _named(data[layer.headline], layer), _named(other, base)
    without = text.left_out(results.regions)
    outlined = base.kind == "image" and layer.kind == "sheet"
    if outlined:
        valid = data["valid"] & reference["valid"] if "valid" in reference else data["valid"]
        thin_um = float(results.parameters.get("correlate", {}).get("thin_um", _THIN_UM))
        with_image = data.assign(image=other, valid=valid)
        shown = maps.draw_outlines(with_image, name=layer.headline, thin_um=thin_um, without=without)
    else:
        rows = summary.headline_pair(results, layer)
        shared = bool(rows) and rows[0].same_quantity
        pair = _valid(data, layer.headline), _valid(reference, base.headline)
        shown = [maps.draw_side_by_side(pair, names=(layer.name, base.name), shared=shared, without=without)]
    return _Block(
        layer=layer, marks=marks if marks is not None and marks.sizes["mark"] else None,
        check=summary.lag_verdict(r.lag, first=first, second=second),
        pictures=_registration(r, data, other, marks, results, words=(layer.name, first, second)), linked=shown,
        outlined=outlined,
    )  # fmt: skip


def _registration(
    r: RegistrationFacts, data: xr.Dataset, other: xr.DataArray, marks: xr.Dataset | None, results: Results, *,
    words: tuple[str, str, str],
) -> list[Picture]:  # fmt: skip
    """Draw the residuals of a layer's marks, its expected error, and the lags of its tiles.

    ``words`` are the name of the layer, and its map and that of the reference in words.
    """
    base, two, (name, first, second) = results.reference, len(results.layers) == 2, words
    hole_um = float(sum(results.parameters.get("holes", {}).get("hole_um", _HOLE_UM)) / 2)
    window = data["valid"].values.astype(bool) if "valid" in data and base.kind == "image" else None
    placed = next(n for n in ("u", "image", "thickness", *data.data_vars) if n in data)
    ground = registration.ground_of(
        other, of=base.name, valid=window, edge=np.isfinite(data[placed].values), edge_of=name
    )
    pictures: list[Picture | None] = []
    if marks is not None and marks.sizes["mark"]:
        blank = registration.blank_ground(registration.points(marks, "fixed"), of=r.to)
        pictures.append(registration.draw_registration(
            r, ground if r.to == base.name else blank, marks, hole_um=hole_um, source=name,
            width=FULL if two else HALF,
        ))  # fmt: skip
    lags = registration.draw_lags(r.lag, ground, first=first, second=second)
    if "expected_error" in data:
        # Alone it takes the whole width, beside another figure half of it.
        pictures.append(registration.draw_expected_error(
            data["expected_error"], marks if r.to == base.name else None, hole_um=hole_um,
            width=FULL if two and lags is None else HALF, of=base.name, shown=name,
        ))  # fmt: skip
    return [picture for picture in (*pictures, lags) if picture is not None]


def _map_pairs(linked: Mapping[str, xr.Dataset], results: Results) -> dict[summary.PairKey, _MapPair]:
    """Give the pairs of maps that stand for two layers, and all maps of the same quantity, where both are there."""
    headlines = {layer.name: layer.headline for layer in results.layers}
    pairs: dict[summary.PairKey, _MapPair] = {}
    for rows in summary.by_pair(results):
        row = rows[0]
        a, b = linked.get(row.a), linked.get(row.b)
        if a is None or b is None or row.a_map not in a or row.b_map not in b:
            continue
        if row.same_quantity or (headlines[row.a], headlines[row.b]) == (row.a_map, row.b_map):
            p, q = a[row.a_map], b[row.b_map]
            valid = [data["valid"] for data in (a, b) if "valid" in data]
            points = relation.block_means(p, q, point_um=relation.largest(rows).point_um, valid=valid)
            pairs[summary.key_of(row)] = _MapPair((p, q), valid, rows, points)
    return pairs


def _draw_pairs(pairs: Mapping[summary.PairKey, _MapPair], results: Results, titles: summary.Titles) -> list[Picture]:
    pictures: list[Picture] = []
    for pair in pairs.values():
        row, without = pair.rows[0], text.left_out(results.regions)
        names = (titles[row.a, row.a_map], titles[row.b, row.b_map])
        if len(results.layers) > 2 or row.same_quantity:
            names = (f"{names[0]}, {row.a}", f"{names[1]}, {row.b}")
        pictures.append(relation.draw_pair(
            *pair.maps, pair.rows, names=names, valid=pair.valid, without=without, points=pair.points,
            density=summary.density_of(results, row),
        ))  # fmt: skip
    return pictures


def _scales(results: Results, titles: summary.Titles) -> list[Picture]:
    """Draw at which scale the maps that stand for each layer and the reference go together."""
    return [
        scale.draw_scale(e, names=summary.names_in_words(e, titles), regions=results.regions is not None)
        for e in results.evidence if e.sizes or e.bands
    ]  # fmt: skip


def _distances(evidence: EvidenceFacts, results: Results, titles: summary.Titles) -> _Distances | None:
    """Draw how the maps of a pair vary with distance, and say what that means; None where there is nothing to show."""
    keys, regions = [(v.layer, v.map) for v in evidence.variograms], results.regions is not None
    same = evidence.a_map == evidence.b_map
    named = [titles.get(key, key[1]) + (f", {key[0]}" if same else "") for key in keys]
    names, layers = summary.names_in_words(evidence, titles), (evidence.a, evidence.b)
    alone, twice, agreement = list[Picture](), list[Picture](), list[str]()
    if evidence.variograms:
        alone.append(distance.draw_variograms(evidence, titles=named, regions=regions))
    if evidence.correlogram is not None:
        pair = (f"{names[0]} of {evidence.a}", f"that of {evidence.b}") if same else names
        alone.append(distance.draw_correlogram(evidence.correlogram, names=pair, regions=regions))
    if evidence.twice is not None:
        if evidence.twice.rings:
            twice.append(distance.draw_rings(evidence.twice, name=names[0], layers=layers, regions=regions))
        agreement = distance.of_twice(evidence.twice, layers)
    if not (alone or twice or agreement):
        return None
    return _Distances(" and ".join(layers), alone, distance.of_each(evidence, named), twice, agreement)


def _light(
    evidence: EvidenceFacts, results: Results, titles: summary.Titles, pairs: Mapping[summary.PairKey, _MapPair]
) -> _Light | None:
    """Draw Kubelka and Munk's curve where there is one, and say what light makes of the coating; None for nothing."""
    sentences, curve, pair = light.sentences(evidence), evidence.kubelka_munk, pairs.get(summary.key_of(evidence))
    pictures: list[Picture] = []
    if curve is not None and is_known(curve.scattering) and pair is not None:
        unit_x = "g/m²" if evidence.a_map.startswith("coat_weight") else "µm"
        pictures.append(light.draw_kubelka_munk(
            evidence, curve, pair.points, relation.largest(pair.rows), titles=summary.titles_of(evidence, titles),
            unit_x=unit_x, regions=results.regions is not None,
        ))  # fmt: skip
    return _Light(f"{evidence.a} and {evidence.b}", pictures, sentences) if sentences else None


def _valid(data: xr.Dataset, name: str) -> xr.DataArray:
    """Return a map, NaN where it is not valid."""
    use: NDArray[np.bool_] | bool = data["valid"].values.astype(bool) if "valid" in data else True
    return data[name].copy(data=np.where(use, data[name].values.astype(np.float64), np.nan))


def _named(data: xr.DataArray, layer: LayerFacts) -> str:
    with_article = text.with_article(layer.name)
    if layer.kind == "image":
        return with_article
    title = text.in_words(text.title_of(data))
    return title if with_article != layer.name else f"{title} of {layer.name}"


# --- figures as files ------------------------------------------------------------------------------------------------


def _write_figures(folder: Path, pictures: Sequence[Picture]) -> None:
    """Write figures into a new folder, named by number and title; the same figures give the same bytes."""
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


def standalone(picture: Picture) -> str:
    """Return the SVG of a figure as a file of its own, with its caption, on white."""
    head, _, rest = picture.svg.partition(">")
    inside = f"<title>{escape(picture.title)}</title><desc>{escape(picture.caption)}</desc>"
    ground = '<rect width="100%" height="100%" fill="#ffffff"/>'
    start = head.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{start}>{inside}{ground}{rest}\n'
