"""One page from one run, whatever was linked: a section appears where there is something to show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.results import LayerFacts, RegistrationFacts, Results
from planish.report import flattening, maps, outlines, registration, relation, slices, summary, tables, text
from planish.report.draw import FULL, HALF, Picture
from planish.report.groups import Groups

_HOLE_UM = (100.0, 300.0)
_THIN_UM = 5.0
_SHEET_PARTS = ("surfaces", "flat", "strain", "maps", "slices")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sheet:
    """What the page shows of one sheet that was measured in this run, beside its results."""

    layer: LayerFacts
    surfaces: xr.Dataset
    slices: list[Picture]
    warp: list[Picture]
    maps: list[Picture]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Block:
    """What the page shows of the registration of one layer, beside its results."""

    layer: LayerFacts
    marks: xr.Dataset | None
    check: summary.Check | None
    pictures: list[Picture]
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
    for name in ("typeset", "count", "fixed", "number", "percent"):
        environment.filters[name] = getattr(text, name)
    several = len(results.layers) > 2
    page = environment.get_template("report.html.j2").render(
        results=results, layers=results.layers, reference=results.reference, sheets=sheets, blocks=blocks,
        titles=titles, tables=tables, summary=summary, text=text,
        gates=[(g.name if several else text.capital(g.name), g.passed, g.sentence) for g in results.gates],
        pairs=_pairs(linked, results, titles),
    )  # fmt: skip
    return f"{page}\n"


def _sheet(groups: Groups, layer: LayerFacts) -> _Sheet | None:
    """Draw and write all that is shown of a sheet; None for an image, and for a sheet whose groups are elsewhere."""
    facts = layer.sheet
    parts = {name: data for name in _SHEET_PARTS if (data := groups.part(layer, name)) is not None}
    if facts is None or len(parts) < len(_SHEET_PARTS):
        return None
    surfaces, flat, strain = parts["surfaces"], parts["flat"], parts["strain"]
    curvature, rim_um = facts.flatten.curvature, facts.surfaces.rim_um or 0.0
    curved = flattening.draw_curvature(strain, flat, patch_um=curvature.patch_um, limit=curvature.limit)
    warp = [
        *flattening.draw_warp(surfaces, flat),
        flattening.draw_strain(strain, flat),
        flattening.draw_progress(strain),
    ]
    return _Sheet(
        layer=layer,
        surfaces=surfaces,
        slices=slices.draw_slices(parts["slices"], surfaces),
        warp=[*warp, *([curved] if curved else [])],
        maps=maps.draw_maps(parts["maps"], list(facts.properties), headline=layer.headline, rim_um=rim_um),
    )


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
    outlined = base.kind == "image" and layer.kind == "sheet"
    choices = _choice(results, "correlate", "thin_um", _THIN_UM)
    if outlined:
        both = data.assign(image=other, valid=data["valid"] & onto["valid"] if "valid" in onto else data["valid"])
        shown = outlines.draw_outlines(both, name=layer.headline, thin_um=float(choices))
    else:
        rows = summary.headline_pair(results, layer)
        shared = bool(rows) and rows[0].same_quantity
        valid = _valid(data, layer.headline), _valid(onto, base.headline)
        shown = [maps.draw_beside((own, other), valid, names=(layer.name, base.name), shared=shared)]
    name = "image-based check" if len(results.layers) == 2 else f"image-based check of {layer.name}"
    return _Block(
        layer=layer,
        marks=marks,
        check=summary.lag_check(r.lag, first=first, second=second, name=name),
        pictures=_registration(layer, r, data, onto, marks, results),
        linked=shown,
        outlined=outlined,
    )


def _registration(
    layer: LayerFacts, r: RegistrationFacts, data: xr.Dataset, onto: xr.Dataset, marks: xr.Dataset | None,
    results: Results,
) -> list[Picture]:  # fmt: skip
    """Draw the residuals of a layer's marks, its expected error, and the lags of its tiles."""
    base, two = results.reference, len(results.layers) == 2
    hole_um = float(sum(_choice(results, "holes", "hole_um", _HOLE_UM)) / 2)
    direct = r.to == base.name
    if base.kind == "image":
        window = data["valid"].values.astype(bool) if "valid" in data else None
        ground = registration.image_ground(onto["image"], valid=window, edge=_known(data), edge_of=layer.name)
    else:
        ground = registration.map_ground(onto[base.headline], of=base.name, edge=_known(data), edge_of=layer.name)
    out: list[Picture] = []
    if marks is not None and marks.sizes["mark"]:
        axis = summary.machine_direction(r, moving=text.the(layer.name), fixed=text.the(r.to))
        own = ground if direct else registration.blank_ground(registration.points(marks, "fixed"), of=r.to)
        out.append(registration.draw_registration(
            own, marks, hole_um=hole_um, title=f"Marks in {text.the(r.to)} and their residuals", source=layer.name,
            axis=axis, width=FULL if two else HALF,
        ))  # fmt: skip
    first, second = _named(data[layer.headline], layer), _named(onto[base.headline], base)
    lags = registration.draw_lags(r.lag, ground, first=first, second=second, width=HALF)
    if "expected_error" in data:
        # Alone it takes the whole width, beside another figure half of it.
        width = FULL if two and lags is None else HALF
        error = registration.draw_expected_error(
            data["expected_error"], marks if direct else None, hole_um=hole_um, width=width, of=base.name,
            shown=layer.name,
        )  # fmt: skip
        out += [error] if error is not None else []
    return [*out, *([lags] if lags is not None else [])]


def _pairs(linked: Mapping[str, xr.Dataset], results: Results, titles: summary.Titles) -> list[Picture]:
    """Draw the pairs of maps that stand for two layers, and all maps of the same quantity."""
    headlines = {layer.name: layer.headline for layer in results.layers}
    out: list[Picture] = []
    for rows in summary.by_pair(results):
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
        out.append(
            relation.draw_pair(relation.pair_of(a[row.a_map], b[row.b_map], valid, names=(names[0], names[1])), rows)
        )
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
        return text.the(layer.name)
    title = text.in_words(text.title_of(data))
    return title if text.the(layer.name) != layer.name else f"{title} of {layer.name}"


def _choice(results: Results, section: str, name: str, default: Any) -> Any:
    """Return a parameter of the run."""
    return results.parameters.get(section, {}).get(name, default)
