"""One page from one run, whatever was linked: a section appears where there is something to show."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.arrays import check_path, not_taken
from planish.core.facts import is_known
from planish.core.files import write_whole
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
)  # fmt: skip
from planish.report.draw import FULL, HALF, Picture
from planish.report.files import write_figures
from planish.report.groups import Groups
from planish.results import CorrelationRow, EvidenceFacts, LayerFacts, RegistrationFacts, Results

if TYPE_CHECKING:
    from jinja2 import Template

_HOLE_UM = (100.0, 300.0)
_THIN_UM = 5.0
_SHEET_PARTS = ("surfaces", "flat", "strain", "maps", "slices")
_FILTERS: dict[str, Any] = {"is_known": is_known, "length_um": text.length, "limit": text.with_unit} | {
    name: getattr(text, name)
    for name in ("capital", "count", "fixed", "in_words", "number", "percent", "the", "typeset", "unit")
}
"""How templates write numbers and words."""


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
    check: summary.Check | None
    pictures: list[Picture]
    linked: list[Picture]
    outlined: bool


class _Light(NamedTuple):
    """What light makes of the coating of a pair of layers, where it was asked for: figures and what may be said."""

    of: str
    shown: bool
    pictures: list[Picture]
    sentences: list[str]


class _Distances(NamedTuple):
    """How the maps of a pair vary with distance: of which layers, figures and what may be said."""

    of: str
    shown: bool
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
        given: Any = run
        groups, results = given.groups, given.results
        marks = {name: registration.pairs() for name, registration in given.registrations.items()}
    assert groups is not None
    assert results is not None
    page, pictures = _render(groups, marks or {}, results)
    write_whole(place, page.encode())
    if figures is not None:
        write_figures(Path(figures), pictures)


def render_report(*, groups: Mapping[str, xr.Dataset], marks: Mapping[str, xr.Dataset], results: Results) -> str:
    """Return the page of :func:`write_report` as text."""
    return _render(groups, marks, results)[0]


def _render(
    groups: Mapping[str, xr.Dataset], marks: Mapping[str, xr.Dataset], results: Results
) -> tuple[str, list[Picture]]:  # fmt: skip
    """Return the page as text, and its figures in their order."""
    data = Groups(results, groups)
    sheets = [s for layer in results.layers if (s := _sheet(data, layer))]
    points = _points(data.linked, results)
    lead, without = summary.lead_pair(results), text.left_out(results.regions)
    leading = first.draw_first(
        data.drawn, results, data.titles, points.get(_pair_of(lead[0])) if lead else None, without=without
    )  # fmt: skip
    shown = _Shown()
    page = report_template().render(
        results=results, layers=results.layers, reference=results.reference, titles=data.titles, tables=tables,
        summary=summary, statement=statement, text=text, first=first, shown=shown, sheets=sheets,
        leading=leading or [picture for s in sheets[:1] for picture in s.leading if not results.is_link],
        blocks=[b for layer in results.moving if (b := _block(layer, data.drawn, marks.get(layer.name), results))],
        pairs=_pairs(data.linked, results, data.titles, points), scales=_scales(results, data.titles), scale=scale,
        lights=[d for found in results.evidence if (d := _light(found, results, data.titles, points)).shown],
        distances=[d for found in results.evidence if (d := _distances(found, results, data.titles)).shown],
        light=light,
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
    found = template("planish.report", "report.html.j2")
    for part in ("parts.html.j2", "style.css"):
        found.environment.get_template(part)
    return found


def template(package: str, name: str) -> Template:
    """Return a template of a package, which may use those of the report and its filters."""
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    loader = ChoiceLoader([PackageLoader(package), PackageLoader("planish.report")])
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )  # fmt: skip
    environment.filters.update(_FILTERS)
    return environment.get_template(name)


def _sheet(groups: Groups, layer: LayerFacts) -> _Sheet | None:
    """Draw all that is shown of a sheet; None for an image, and for a sheet whose groups are elsewhere."""
    facts = layer.sheet
    parts = {name: data for name in _SHEET_PARTS if (data := groups.part(layer, name)) is not None}
    if facts is None or len(parts) < len(_SHEET_PARTS):
        return None
    surfaces, rim_um = parts["surfaces"], facts.surfaces.rim_um or 0.0
    height = surfaces["centre"].values
    return _Sheet(
        layer=layer,
        warp_um=float(np.nanmax(height) - np.nanmin(height)),
        slices=slices.draw_slices(parts["slices"], surfaces),
        warp=flattening.draw_flattening(surfaces, parts["flat"], parts["strain"], facts.flatten.curvature),
        progress=[flattening.draw_progress(parts["strain"])],
        maps=maps.draw_maps(parts["maps"], facts.properties, headline=layer.headline, rim_um=rim_um),
        leading=maps.draw_leading(parts["maps"], facts.properties, headline=layer.headline, rim_um=rim_um),
    )


def _block(
    layer: LayerFacts, linked: Mapping[str, xr.Dataset], marks: xr.Dataset | None, results: Results
) -> _Block | None:  # fmt: skip
    """Draw all that is shown of the registration of a layer."""
    r, base = layer.registration, results.reference
    data, onto = linked.get(layer.name), linked.get(base.name)
    if r is None or data is None or onto is None:
        return None
    own, other = data[layer.headline], onto[base.headline]
    first, second = _named(own, layer), _named(other, base)
    without = text.left_out(results.regions)
    outlined = base.kind == "image" and layer.kind == "sheet"
    if outlined:
        both = data.assign(image=other, valid=data["valid"] & onto["valid"] if "valid" in onto else data["valid"])
        thin_um = _choice(results, "correlate", "thin_um", _THIN_UM)
        shown = maps.draw_outlines(both, name=layer.headline, thin_um=float(thin_um), without=without)
    else:
        rows = summary.headline_pair(results, layer)
        shared = bool(rows) and rows[0].same_quantity
        beside = _valid(data, layer.headline), _valid(onto, base.headline)
        shown = [maps.draw_beside(beside, names=(layer.name, base.name), shared=shared, without=without)]
    name = "image-based check" if len(results.layers) == 2 else f"image-based check of {layer.name}"
    return _Block(
        layer=layer,
        marks=marks if marks is not None and marks.sizes["mark"] else None,
        check=summary.lag_check(r.lag, first=first, second=second, name=name),
        pictures=_registration(r, data, onto[base.headline], marks, results, words=(layer.name, first, second)),
        linked=shown,
        outlined=outlined,
    )


def _registration(
    r: RegistrationFacts, data: xr.Dataset, other: xr.DataArray, marks: xr.Dataset | None, results: Results, *,
    words: tuple[str, str, str],
) -> list[Picture]:  # fmt: skip
    """Draw the residuals of a layer's marks, its expected error, and the lags of its tiles.

    ``words`` are the name of the layer, and its map and that of the reference in words.
    """
    base, two, (name, first, second) = results.reference, len(results.layers) == 2, words
    hole_um = float(sum(_choice(results, "holes", "hole_um", _HOLE_UM)) / 2)
    window = data["valid"].values.astype(bool) if "valid" in data and base.kind == "image" else None
    placed = next(n for n in ("u", "image", "thickness", *data.data_vars) if n in data)
    ground = registration.ground_of(
        other, of=base.name, valid=window, edge=np.isfinite(data[placed].values), edge_of=name
    )  # fmt: skip
    out: list[Picture | None] = []
    if marks is not None and marks.sizes["mark"]:
        blank = registration.blank_ground(registration.points(marks, "fixed"), of=r.to)
        own = ground if r.to == base.name else blank
        axis = registration.machine_direction(r, name)
        out.append(registration.draw_registration(
            own, marks, hole_um=hole_um, title=f"Marks in {text.the(r.to)} and their residuals", source=name, axis=axis,
            width=FULL if two else HALF,
        ))  # fmt: skip
    lags = registration.draw_lags(r.lag, ground, first=first, second=second, width=HALF)
    if "expected_error" in data:
        # Alone it takes the whole width, beside another figure half of it.
        out.append(registration.draw_expected_error(
            data["expected_error"], marks if r.to == base.name else None, hole_um=hole_um,
            width=FULL if two and lags is None else HALF, of=base.name, shown=name,
        ))  # fmt: skip
    return [picture for picture in (*out, lags) if picture is not None]


def _pair_of(row: CorrelationRow) -> tuple[str, str, str, str]:
    return row.a, row.a_map, row.b, row.b_map


def _drawn_pairs(linked: Mapping[str, xr.Dataset], results: Results) -> Iterator[list[CorrelationRow]]:
    """Give the pairs of maps that stand for two layers, and all maps of the same quantity, where both are there."""
    headlines = {layer.name: layer.headline for layer in results.layers}
    for rows in summary.by_pair(results):
        row = rows[0]
        a, b = linked.get(row.a), linked.get(row.b)
        if a is None or b is None or row.a_map not in a or row.b_map not in b:
            continue
        if row.same_quantity or (headlines[row.a], headlines[row.b]) == (row.a_map, row.b_map):
            yield rows


def _points(
    linked: Mapping[str, xr.Dataset], results: Results
) -> dict[tuple[str, str, str, str], relation.Points]:  # fmt: skip
    """Average every pair of maps that is drawn over the largest points of its correlation."""
    out: dict[tuple[str, str, str, str], relation.Points] = {}
    for rows in _drawn_pairs(linked, results):
        row = relation.largest(rows)
        a, b = linked[row.a], linked[row.b]
        valid = [data["valid"] for data in (a, b) if "valid" in data]
        out[_pair_of(row)] = relation.block_means(a[row.a_map], b[row.b_map], point_um=row.point_um, valid=valid)
    return out


def _pairs(
    linked: Mapping[str, xr.Dataset], results: Results, titles: summary.Titles,
    points: Mapping[tuple[str, str, str, str], relation.Points],
) -> list[Picture]:  # fmt: skip
    """Draw the pairs of maps that stand for two layers, and all maps of the same quantity."""
    out: list[Picture] = []
    for rows in _drawn_pairs(linked, results):
        row, (a, b) = rows[0], (linked[rows[0].a], linked[rows[0].b])
        names = (titles[row.a, row.a_map], titles[row.b, row.b_map])
        if len(results.layers) > 2 or row.same_quantity:
            names = (f"{names[0]}, {row.a}", f"{names[1]}, {row.b}")
        valid = [data["valid"] for data in (a, b) if "valid" in data]
        without = text.left_out(results.regions)
        out.append(relation.draw_pair(
            a[row.a_map], b[row.b_map], rows, names=names, valid=valid, without=without, points=points[_pair_of(row)],
            density=summary.density_of(results, row),
        ))  # fmt: skip
    return out


def _scales(results: Results, titles: summary.Titles) -> list[Picture]:
    """Draw at which scale the maps that stand for each layer and the reference go together."""
    out: list[Picture] = []
    for found in results.evidence:
        if found.sizes or found.bands:
            names = (text.in_words(titles.get(key, key[1])) for key in ((found.a, found.a_map), (found.b, found.b_map)))
            pair = next(names), next(names)
            out.append(scale.draw_scale(found, names=pair, regions=results.regions is not None))
    return out


def _distances(found: EvidenceFacts, results: Results, titles: summary.Titles) -> _Distances:
    """Draw how the maps of a pair vary with distance, and say what that means."""
    keys, regions = [(one.layer, one.map) for one in found.variograms], results.regions is not None
    same = found.a_map == found.b_map
    named = [titles.get(key, key[1]) + (f", {key[0]}" if same else "") for key in keys]
    alone, twice, agreement = list[Picture](), list[Picture](), list[str]()
    if found.variograms:
        alone.append(distance.draw_variograms(found, titles=named, regions=regions))
    if found.correlogram is not None:
        pair = [titles.get(key, key[1]) for key in ((found.a, found.a_map), (found.b, found.b_map))]
        names = text.in_words(pair[0]), text.in_words(pair[1])
        names = (f"{names[0]} of {found.a}", f"that of {found.b}") if same else names
        alone.append(distance.draw_correlogram(found.correlogram, names=names, regions=regions))
    if found.twice is not None:
        name, layers = text.in_words(titles.get((found.a, found.a_map), found.a_map)), (found.a, found.b)
        if found.twice.rings:
            twice.append(distance.draw_rings(found.twice, name=name, layers=layers, regions=regions))
        agreement = distance.of_twice(found.twice, layers)
    return _Distances(
        of=f"{found.a} and {found.b}", shown=bool(alone or twice or agreement), alone=alone,
        sentences=distance.of_each(found, named), twice=twice, agreement=agreement,
    )  # fmt: skip


def _light(
    found: EvidenceFacts, results: Results, titles: summary.Titles,
    points: Mapping[tuple[str, str, str, str], relation.Points],
) -> _Light:  # fmt: skip
    """Draw Kubelka and Munk's curve where there is one, and say what light makes of the coating."""
    pictures, curve, key = list[Picture](), found.kubelka_munk, (found.a, found.a_map, found.b, found.b_map)
    rows = [row for group in summary.by_pair(results) for row in group if _pair_of(row) == key]
    if curve is not None and is_known(curve.scattering) and rows and key in points:
        names = tuple(titles.get(one, one[1]) for one in (key[:2], key[2:]))
        unit_x = "g/m²" if found.a_map.startswith("coat_weight") else "µm"
        pictures.append(light.draw_kubelka_munk(
            found, curve, points[key], relation.largest(rows), titles=(names[0], names[1]), unit_x=unit_x,
            regions=results.regions is not None,
        ))  # fmt: skip
    said = light.sentences(found)
    return _Light(of=f"{found.a} and {found.b}", shown=bool(said), pictures=pictures, sentences=said)


def _valid(data: xr.Dataset, name: str) -> xr.DataArray:
    """Return a map, NaN where it is not valid."""
    use: NDArray[np.bool_] | bool = data["valid"].values.astype(bool) if "valid" in data else True
    return data[name].copy(data=np.where(use, data[name].values.astype(np.float64), np.nan))


def _named(data: xr.DataArray, layer: LayerFacts) -> str:
    if layer.kind == "image":
        return text.the(layer.name)
    title = text.in_words(text.title_of(data))
    return title if text.the(layer.name) != layer.name else f"{title} of {layer.name}"


def _choice(results: Results, section: str, name: str, default: Any) -> Any:
    """Return a parameter of the run."""
    return results.parameters.get(section, {}).get(name, default)
