"""One page for several layers on the pixels of one of them: how well each lies there, and how they compare in pairs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.report import promise, tables
from planish.report.draw import HALF, Picture, house_style
from planish.report.ground import Ground, blank_ground, map_ground
from planish.report.lags import draw_lags
from planish.report.layer_tables import at_largest, by_pair, layer_row, layers_verdict, long_name, pair_rows, size_words
from planish.report.maps import draw_beside
from planish.report.promise import Row
from planish.report.registration import draw_expected_error, draw_registration, points
from planish.report.relation import Pair, draw_pair, pair_of
from planish.report.template import Section, numbered, render
from planish.report.text import capital, in_words

_SECTIONS = (
    Section(name="layers", title="What went in"),
    Section(name="places", title="Layers on one grid"),
    Section(name="pairs", title="Layers in pairs, point by point"),
    Section(name="record", title="Parameters, versions, method"),
)
_HOLE_UM = (100.0, 300.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Block:
    """What the page says of one layer beside its figures."""

    name: str
    to: str
    key: str
    sentences: list[str]
    check: promise.Check | None
    facts: list[tuple[str, str]]


def write_layers_report(
    path: Path, *, groups: dict[str, xr.Dataset], marks: dict[str, xr.Dataset], results: dict[str, Any]
) -> None:
    """Write the report of linked layers as one HTML file that needs nothing else.

    Parameters
    ----------
    path : Path
    groups : dict of Dataset
        ``layers/NAME`` (y, x), all on the pixels of the reference: maps, ``valid``, and ``expected_error`` of all but
        the reference.
    marks : dict of Dataset (mark)
        Pairs of marks of each layer but the reference, by its name; ``fixed_*`` in the layer that it is joined to.
    results : dict
        The numbers of the run.

    Notes
    -----
    The same input gives the same bytes.
    """
    path.write_bytes(render_layers(groups=groups, marks=marks, results=results).encode("utf-8"))


def render_layers(*, groups: dict[str, xr.Dataset], marks: dict[str, xr.Dataset], results: dict[str, Any]) -> str:
    """Return the page of :func:`write_layers_report` as text."""
    maps = {str(layer["name"]): groups[f"layers/{layer['name']}"] for layer in results["layers"]}
    joined = [layer for layer in results["layers"] if layer["to"] is not None]
    with house_style():
        pictures = _pictures(maps, joined, marks, results)
    blocks = [_block(layer, k, maps, results) for k, layer in enumerate(joined)]
    return render(
        "layers.html.j2",
        sections=list(_SECTIONS),
        pictures=numbered(pictures),
        reference=results["reference"],
        chain=bool(results.get("chain")),
        verdict=layers_verdict(results, maps),
        gates=tables.gates(results, capitals=False),
        checks=[block.check for block in blocks if block.check is not None],
        registered=capital(promise.registered(results)),
        rows=[layer_row(layer) for layer in results["layers"]],
        blocks=blocks,
        pairs=pair_rows(results["pairs"], maps),
        point_sizes=size_words(results["pairs"]),
        parameters=tables.parameters(results),
        versions={"planish": results["planish"], **results.get("versions", {})},
        method=tables.METHOD,
    )


def _pictures(
    maps: dict[str, xr.Dataset], joined: list[Row], marks: dict[str, xr.Dataset], results: Row
) -> dict[str, list[Picture]]:
    """Draw all figures, by layer and by pair."""
    reference = str(results["reference"])
    base, base_map = maps[reference], _headline(results, reference)
    hole_um = float(sum(results["parameters"].get("registration", {}).get("hole_um", _HOLE_UM)) / 2)
    same = {
        (row["a"], row["a_map"], row["b"], row["b_map"]) for row in results["pairs"] if row.get("same_quantity")
    }  # fmt: skip
    out: dict[str, list[Picture]] = {}
    for k, layer in enumerate(joined):
        name, own = str(layer["name"]), str(layer["headline"])
        data = maps[name]
        shared = bool({(name, own, reference, base_map), (reference, base_map, name, own)} & same)
        beside = draw_beside(
            (data[own], base[base_map]), (_valid(data, own), _valid(base, base_map)), names=(name, reference),
            shared=shared,
        )  # fmt: skip
        ground = map_ground(base, base_map, of=reference, edge=np.isfinite(data[own].values), edge_of=name)
        out[f"layer {k}"] = [
            beside,
            *_places(layer, data, marks.get(name), ground, reference=reference, hole_um=hole_um),
        ]
        lags = draw_lags(
            _lag(results, name), ground, first=_title(data[own], name), second=_title(base[base_map], reference),
            width=HALF,
        )  # fmt: skip
        out[f"layer {k}"] += [lags] if lags is not None else []
    how = promise.registered(results)
    out["pairs"] = [
        draw_pair(_pair(row, maps), row, registered=how)
        # Those with a difference take the whole width: first, so that the others stand in twos.
        for row in sorted(map(at_largest, by_pair(results["pairs"])), key=lambda row: not row.get("same_quantity"))
    ]
    return out


def _places(
    layer: Row, data: xr.Dataset, marks: xr.Dataset | None, ground: Ground, *, reference: str, hole_um: float
) -> list[Picture]:
    """Draw the residuals of a layer's marks, and its expected error."""
    name, to = str(layer["name"]), str(layer["to"])
    direct = to == reference
    out: list[Picture] = []
    if marks is not None:
        out.append(
            draw_registration(
                ground if direct else blank_ground(points(marks, "fixed"), of=to), marks, hole_um=hole_um, source=name,
                width=HALF, title=f"Marks of {name} in {to}, and their residuals",
                axis=promise.axis_in_image(layer, moving=name, fixed=to),
            )
        )  # fmt: skip
    error = data.get("expected_error")
    if error is not None:
        own = marks if direct else None
        drawn = draw_expected_error(error, own, hole_um=hole_um, width=HALF, of=reference, shown=name)
        out += [drawn] if drawn is not None else []
    return out


def _block(layer: Row, k: int, maps: dict[str, xr.Dataset], results: Row) -> _Block:
    name, reference = str(layer["name"]), str(results["reference"])
    told = _lag(results, name)
    check = promise.lag_check(
        told, first=_title(maps[name][str(layer["headline"])], name),
        second=_title(maps[reference][_headline(results, reference)], reference), name=f"{name} against {reference}",
    )  # fmt: skip
    facts = tables.transform(layer["marks"], names=(name, str(layer["to"]))) if layer["marks"] else []
    told_of = promise.orientation(layer)
    return _Block(
        name=name,
        to=str(layer["to"]),
        key=f"layer {k}",
        sentences=[*promise.match_sentences(layer["marks"]), *([told_of] if told_of else [])],
        check=check,
        facts=[*facts, *promise.lag_rows(told)],
    )


def _pair(row: Row, maps: dict[str, xr.Dataset]) -> Pair:
    a, b = maps[row["a"]], maps[row["b"]]
    names = [f"{long_name(maps, row[side], row[f'{side}_map'])}, {row[side]}" for side in ("a", "b")]
    valid = _valid(a, row["a_map"]) & _valid(b, row["b_map"])
    return pair_of(a[row["a_map"]], b[row["b_map"]], valid, names=(names[0], names[1]))


def _valid(data: xr.Dataset, name: str) -> NDArray[np.bool_]:
    known = np.isfinite(data[name].values)
    return known & data["valid"].values.astype(bool) if "valid" in data else known


def _headline(results: Row, name: str) -> str:
    return next(str(layer["headline"]) for layer in results["layers"] if layer["name"] == name)


def _lag(results: Row, name: str) -> Row | None:
    """Return the lag of a layer against the reference, None where none was found."""
    found = (lag for lag in results.get("lags", []) if lag["a"] == name and lag["b"] == results["reference"])
    told = next(found, None)
    return told if told is not None and "sentence" in told else None


def _title(data: xr.DataArray, layer: str) -> str:
    return f"{in_words(str(data.attrs.get('long_name', data.name)))} of {layer}"
