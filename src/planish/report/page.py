"""One page from one run, whatever was linked: a section appears where there is something to show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.results import LayerFacts, RegistrationFacts, Results, SheetFacts
from planish.report import tables
from planish.report.draw import FULL, HALF, Picture
from planish.report.flattening import draw_curvature, draw_progress, draw_strain, draw_warp
from planish.report.groups import Groups
from planish.report.maps import draw_beside, draw_maps
from planish.report.outlines import draw_outlines
from planish.report.registration import (
    blank_ground,
    draw_expected_error,
    draw_lags,
    draw_registration,
    image_ground,
    map_ground,
    points,
)  # fmt: skip
from planish.report.relation import draw_pair, pair_of
from planish.report.slices import draw_slices
from planish.report.summary import (
    Check,
    Titles,
    by_pair,
    headline_pair,
    lag_check,
    machine_direction,
    match_sentences,
    refinement_sentences,
    summarise,
)  # fmt: skip
from planish.report.text import REGISTERED, capital, in_words, the, title_of, typeset

_HOLE_UM = (100.0, 300.0)
_THIN_UM = 5.0
_SHEET_PARTS = ("surfaces", "flat", "strain", "maps", "slices")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sheet:
    """What the page shows of one sheet that was measured in this run."""

    layer: LayerFacts
    facts: SheetFacts
    view: str
    joined: str
    columns: list[dict[str, str]]
    slices: list[Picture]
    warp: list[Picture]
    flattening: tables.Facts
    maps: list[Picture]
    properties: list[tables.Line]
    numbers: tables.Facts
    greys: tables.Facts


@dataclass(frozen=True, slots=True, kw_only=True)
class _Block:
    """What the page shows of the registration of one layer."""

    name: str
    to: str
    sentences: list[str]
    check: Check | None
    pictures: list[Picture]
    facts: tables.Facts
    marks: list[tables.Line]
    linked: list[Picture]
    outlined: bool


def write_report(
    path: Path, *, groups: Mapping[str, xr.Dataset], marks: Mapping[str, xr.Dataset], results: Results
) -> None:
    """Write the report of a run as one HTML file that needs nothing else.

    Parameters
    ----------
    path : Path
    groups : mapping of name to Dataset
        Of each sheet that was measured ``surfaces`` and ``flat`` (y, x), ``strain`` (row, col), ``maps`` (v, u) and
        ``slices``, as ``layers/NAME/surfaces`` or, where there is one sheet, ``surfaces``. After a link the maps on the
        pixels of the reference (y, x): ``layers/NAME``, or ``linked`` of a sheet and an image.
    marks : mapping of name to Dataset (mark)
        Pairs of marks of each layer but the reference with their residuals, by its name; ``fixed_*`` in the layer that
        it was registered to.
    results : Results

    Notes
    -----
    The same input gives the same bytes: no dates, no random names.
    """
    path.write_bytes(render_report(groups=groups, marks=marks, results=results).encode("utf-8"))


def render_report(*, groups: Mapping[str, xr.Dataset], marks: Mapping[str, xr.Dataset], results: Results) -> str:
    """Return the page of :func:`write_report` as text."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    data = Groups(results, groups)
    linked, titles = data.linked, data.titles
    sheets = [s for layer in results.layers if (s := _sheet(data, layer)) is not None]
    blocks = [b for layer in results.moving if (b := _block(layer, linked, marks.get(layer.name), results)) is not None]
    environment = Environment(
        loader=PackageLoader("planish.report"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    text = environment.get_template("report.html.j2").render(
        results=results, layers=results.layers, reference=results.reference, sheets=sheets, blocks=blocks,
        summary=summarise(results, titles),
        gates=[(capital(g.name), g.passed, typeset(g.sentence)) for g in results.gates],
        checks=[b.check for b in blocks if b.check is not None],
        inputs=tables.inputs(results),
        refinement=refinement_sentences(results),
        pairs=_pairs(linked, results, titles),
        correlations=tables.correlations(results, titles),
        differences=any(row.same_quantity for row in results.correlations),
        point_sizes=tables.point_sizes(results.correlations),
        comparison=tables.comparison(results),
        comparison_sizes=tables.point_sizes(results.comparison),
        comparison_sentence=tables.comparison_sentence(results),
        parameters=tables.parameters(results.parameters),
        versions={"planish": results.planish, **results.versions},
        registered=capital(REGISTERED), method=tables.METHOD, bland_altman=tables.BLAND_ALTMAN,
    )  # fmt: skip
    return f"{text}\n"


def _sheet(groups: Groups, layer: LayerFacts) -> _Sheet | None:
    """Draw and write all that is shown of a sheet; None for an image, and for a sheet whose groups are elsewhere."""
    facts = layer.sheet
    parts = {name: data for name in _SHEET_PARTS if (data := groups.part(layer, name)) is not None}
    if facts is None or len(parts) < len(_SHEET_PARTS):
        return None
    surfaces, flat, strain = parts["surfaces"], parts["flat"], parts["strain"]
    curvature = facts.flatten.curvature
    curved = draw_curvature(strain, flat, patch_um=curvature.patch_um, limit=curvature.limit)
    rim_um = facts.surfaces.rim_um or 0.0
    return _Sheet(
        layer=layer,
        facts=facts,
        view=tables.view(facts.surfaces),
        joined=tables.joined(facts.sections) if facts.sections else "",
        columns=tables.columns(facts.surfaces),
        slices=draw_slices(parts["slices"], surfaces),
        warp=[
            *draw_warp(surfaces, flat), draw_strain(strain, flat), draw_progress(strain), *([curved] if curved else [])
        ],
        flattening=tables.flattening(facts, surfaces),
        maps=draw_maps(parts["maps"], list(facts.properties), headline=layer.headline, rim_um=rim_um),
        properties=tables.properties(layer, groups.titles),
        numbers=tables.numbers(facts),
        greys=tables.greys(facts.surfaces),
    )  # fmt: skip


def _block(
    layer: LayerFacts, linked: Mapping[str, xr.Dataset], marks: xr.Dataset | None, results: Results
) -> _Block | None:  # fmt: skip
    """Draw and write all that is shown of the registration of a layer."""
    r, base = layer.registration, results.reference
    data, onto = linked.get(layer.name), linked.get(base.name)
    if r is None or data is None or onto is None:
        return None
    own, other = data[layer.headline], onto[base.headline]
    first, second = (_named(m, one) for m, one in ((own, layer), (other, base)))
    two = len(results.layers) == 2
    outlined = base.kind == "image" and layer.kind == "sheet"
    choices = _choice(results, "correlate", "thin_um", _THIN_UM)
    if outlined:
        both = data.assign(image=other, valid=data["valid"] & onto["valid"] if "valid" in onto else data["valid"])
        shown = draw_outlines(both, name=layer.headline, thin_um=float(choices))
    else:
        rows = headline_pair(results, layer)
        shared = bool(rows) and rows[0].same_quantity
        valid = _valid(data, layer.headline), _valid(onto, base.headline)
        shown = [draw_beside((own, other), valid, names=(layer.name, base.name), shared=shared)]
    return _Block(
        name=layer.name,
        to=r.to,
        sentences=match_sentences(r),
        check=lag_check(r.lag, first=first, second=second,
                        name="image-based check" if two else f"image-based check of {layer.name}"),
        pictures=_registration(layer, r, data, onto, marks, results),
        facts=tables.registration(r, moving=layer.name, fixed_layer=r.to),
        marks=tables.mark_rows(marks) if marks is not None else [],
        linked=shown,
        outlined=outlined,
    )  # fmt: skip


def _registration(
    layer: LayerFacts, r: RegistrationFacts, data: xr.Dataset, onto: xr.Dataset, marks: xr.Dataset | None,
    results: Results,
) -> list[Picture]:  # fmt: skip
    """Draw the residuals of a layer's marks, its expected error, and the lags of its tiles."""
    base, two = results.reference, len(results.layers) == 2
    hole_um = float(sum(_choice(results, "registration", "hole_um", _HOLE_UM)) / 2)
    direct = r.to == base.name
    if base.kind == "image":
        window = data["valid"].values.astype(bool) if "valid" in data else None
        ground = image_ground(onto["image"], valid=window, edge=_known(data), edge_of=layer.name)
    else:
        ground = map_ground(onto[base.headline], of=base.name, edge=_known(data), edge_of=layer.name)
    out: list[Picture] = []
    if marks is not None and marks.sizes["mark"]:
        out.append(draw_registration(
            ground if direct else blank_ground(points(marks, "fixed"), of=r.to), marks, hole_um=hole_um,
            title=f"Marks in {the(r.to)} and their residuals", source=layer.name,
            axis=machine_direction(r, moving=the(layer.name), fixed=the(r.to)), width=FULL if two else HALF,
        ))  # fmt: skip
    first, second = _named(data[layer.headline], layer), _named(onto[base.headline], base)
    lags = draw_lags(r.lag, ground, first=first, second=second, width=HALF)
    if "expected_error" in data:
        # Alone it takes the whole width, beside another figure half of it.
        width = FULL if two and lags is None else HALF
        error = draw_expected_error(
            data["expected_error"], marks if direct else None, hole_um=hole_um, width=width, of=base.name,
            shown=layer.name,
        )  # fmt: skip
        out += [error] if error is not None else []
    return [*out, *([lags] if lags is not None else [])]


def _pairs(linked: Mapping[str, xr.Dataset], results: Results, titles: Titles) -> list[Picture]:
    """Draw the pairs of maps that stand for two layers, and all maps of the same quantity."""
    headlines = {layer.name: layer.headline for layer in results.layers}
    out: list[Picture] = []
    for rows in by_pair(results):
        row = rows[0]
        a, b = linked.get(row.a), linked.get(row.b)
        if a is None or b is None or row.a_map not in a or row.b_map not in b:
            continue
        if not (row.same_quantity or (headlines[row.a], headlines[row.b]) == (row.a_map, row.b_map)):
            continue
        names = [titles[row.a, row.a_map], titles[row.b, row.b_map]]
        if len(results.layers) > 2 or row.same_quantity:
            names = [f"{name}, {layer}" for name, layer in zip(names, (row.a, row.b), strict=True)]
        valid = _valid(a, row.a_map) & _valid(b, row.b_map)
        out.append(draw_pair(pair_of(a[row.a_map], b[row.b_map], valid, names=(names[0], names[1])), rows))
    return out


def _valid(data: xr.Dataset, name: str) -> NDArray[np.bool_]:
    known = np.isfinite(data[name].values)
    return known & data["valid"].values.astype(bool) if "valid" in data else known


def _known(data: xr.Dataset) -> NDArray[np.bool_]:
    """Return where a layer lies on the reference."""
    name = next(n for n in ("u", "image", "thickness", *data.data_vars) if n in data)
    return np.isfinite(data[name].values)


def _named(data: xr.DataArray, layer: LayerFacts) -> str:
    if layer.kind == "image":
        return the(layer.name)
    title = in_words(title_of(data))
    return title if the(layer.name) != layer.name else f"{title} of {layer.name}"


def _choice(results: Results, section: str, name: str, default: Any) -> Any:
    """Return a parameter of the run."""
    return results.parameters.get(section, {}).get(name, default)
