"""What the page of several layers says in words and tables."""

from __future__ import annotations

import xarray as xr

from planish.report import promise, tables
from planish.report.promise import Row
from planish.report.text import NONE, beside, count, fixed, in_words, length, number, percent, plain, unit
from planish.report.verdict import Tile, Verdict, summarise


def layer_row(layer: Row) -> Row:
    """Return one line of the table of layers."""
    source, error = layer["source"], layer["expected_error_um"] or {}
    steps = source.get("voxel_um") or source.get("pixel_um") or []
    marks = layer["marks"] or {}
    return {
        "name": str(layer["name"]),
        "reference": layer["to"] is None,
        "kind": "sheet" if layer["kind"] == "sheet" else "image",
        "file": str(source["name"]),
        "shape": " × ".join(count(n) for n in source["shape"]),
        "step": " × ".join(f"{float(v):.6g}" for v in steps),
        "sha256": str(source["sha256"]),
        "short": f"{str(source['sha256'])[:12]}…",
        "path": " → ".join(str(v) for v in layer["path"]),
        "marks": count(marks["matched"]) if marks else NONE,
        "error": f"{number(error.get('median'), 2)}; {number(error.get('largest'), 2)}" if error else NONE,
        "share": percent(layer["share_of_reference"], 2),
    }


def layers_verdict(results: Row, maps: dict[str, xr.Dataset]) -> Verdict:
    """Say how well the layers lie and how they compare, as far as it goes and no further."""
    layers, reference = results["layers"], str(results["reference"])
    joined = [layer for layer in layers if layer["to"] is not None]
    others = " and ".join(str(layer["name"]) for layer in joined)
    what = f"The layer {others} lies" if len(joined) == 1 else f"The layers {others} lie"
    sentence = f"{what} on the pixels of {reference}."
    errors = [layer["expected_error_um"] for layer in joined if layer["expected_error_um"]]
    medians = [float(e["median"]) for e in errors if e["median"] is not None]
    largest = [float(e["largest"]) for e in errors if e["largest"] is not None]
    if medians and largest:
        sentence += (
            f" The expected error of a place is {length(max(medians), 2)} (rms, median over the worst layer), "
            f"and {length(max(largest), 2)} where it is largest."
        )
    groups = by_pair(results["pairs"])
    rows = [at_largest(group) for group in groups]
    first = next((row for row in rows if row.get("same_quantity") and row.get("difference_mean") is not None), None)
    if first is not None:
        title, units = in_words(long_name(maps, first["a"], first["a_map"])), unit(str(first.get("units") or ""))
        low, high = first["limits"] or (None, None)
        sd = first["difference_sd"]
        sentence += (
            f" Over points of {plain(first['point_um'])}, {title} of {first['b']} less that of {first['a']} is "
            f"{beside(first['difference_mean'], sd)} {units} on average; 95 % of normal differences lie between "
            f"{beside(low, sd)} and {beside(high, sd)} {units}."
        )
    onto = [row for row in rows if reference in (row["a"], row["b"]) and row.get("r2") is not None]
    # The pair onto the reference that goes together least: one that does well says nothing of the others.
    best = min(onto, key=lambda row: float(row["r2"]), default={}) if len(joined) > 1 else next(iter(onto), {})
    note = (
        f"{best['a']} and {best['b']}: r = {number(best['r'])}, n = {count(best['n'])}; {promise.registered(results)}"
        if best
        else NONE
    )
    share = min((float(layer["share_of_reference"]) for layer in joined), default=None)
    return Verdict(
        sentence=sentence,
        tiles=(
            Tile(value=count(len(layers)), label="layers on one grid", note=f"{reference} is the reference"),
            Tile(
                value=number(max(largest, default=None), 2), unit="µm", label="largest expected error",
                note=f"median {number(max(medians, default=None), 2)} µm in the worst layer",
            ),
            Tile(
                value=NONE if share is None else fixed(100 * share, 0), unit="%", label="of the reference is covered",
                note="by the layer that covers least",
            ),
            Tile(
                value=fixed(best.get("r2"), 3),
                label=f"r² at {plain(round(float(best['point_um']), 4))}" if best else "r²",
                note=note,
            ),
        ),
        passed=all(gate["passed"] for gate in results["quality"]),
        summary=summarise(results["quality"]),
    )  # fmt: skip


def pair_rows(rows: list[Row], maps: dict[str, xr.Dataset]) -> list[Row]:
    """Return the lines of the table of pairs."""
    sizes = _point_sizes(rows)
    out: list[Row] = []
    for group in by_pair(rows):
        row = at_largest(group)
        at = {round(float(r["point_um"]), 4): r for r in group}
        blank: Row = {"n": None, "r": None, "r2": None, "slope": None}
        same = bool(row.get("same_quantity"))
        units = unit(str(row.get("units") or ""))
        low, high = row.get("limits") or (None, None)
        mean, sd = row.get("difference_mean"), row.get("difference_sd")
        names = [long_name(maps, row[side], row[f"{side}_map"]) for side in ("a", "b")]
        out.append({
            "a": f"{row['a']}: {in_words(names[0])}",
            "b": f"{row['b']}: {in_words(names[1])}",
            "cells": [tables.cells(at.get(size, blank)) for size in sizes],
            "difference": f"{beside(mean, sd)} ± {beside(sd, sd)} {units}"
            if same else NONE,
            "limits": f"{beside(low, sd)} to {beside(high, sd)} {units}" if same else NONE,
        })  # fmt: skip
    return out


def by_pair(rows: list[Row]) -> list[list[Row]]:
    """Group rows that are of the same two maps."""
    found: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        found.setdefault(tuple(str(row[key]) for key in ("a", "a_map", "b", "b_map")), []).append(row)
    return list(found.values())


def at_largest(rows: list[Row]) -> Row:
    """Return the row of the largest points that there are any of."""
    known = [row for row in rows if row["n"]] or rows
    return max(known, key=lambda row: float(row["point_um"]))


def _point_sizes(rows: list[Row]) -> list[float]:
    return sorted({round(float(row["point_um"]), 4) for row in rows})


def size_words(rows: list[Row]) -> list[str]:
    """Return the point sizes of the table of pairs as they are written."""
    return [plain(size) for size in _point_sizes(rows)]


def long_name(maps: dict[str, xr.Dataset], layer: str, name: str) -> str:
    """Return the title of a layer's map."""
    return str(maps[layer][name].attrs.get("long_name", name))
