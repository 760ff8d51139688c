"""What the page says in words and tables: every number is written here, none in the template."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from planish.report.text import NONE, count, fixed, in_words, length, number, percent, plain, size, unit

METHOD = (
    "U. Hirn, J. Kritzinger, M. Donoser, W. Bauer: Introducing a concept to link 3D paper structure to 2D paper properties. "
    "In: Advances in Pulp and Paper Research, Oxford 2009, Transactions of the XIVth Fundamental Research Symposium."
)

Row = dict[str, Any]
_FAINT = 0.02  # r2 below which no direction is named in words


@dataclass(frozen=True, slots=True, kw_only=True)
class Tile:
    """One number large, with what it is."""

    value: str
    unit: str
    label: str
    note: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """What came out, in one sentence and a few numbers."""

    sentence: str
    tiles: tuple[Tile, ...]
    passed: bool
    summary: str


def is_link(results: Row) -> bool:
    """Whether an image was linked."""
    return bool(results.get("inputs", {}).get("image"))


def long_names(groups: dict[str, xr.Dataset]) -> dict[str, str]:
    """Return the title of each property."""
    data = groups["maps"]
    return {str(k): str(v.attrs.get("long_name", k)) for k, v in data.data_vars.items()}


def verdict(results: Row, names: dict[str, str]) -> Verdict:
    """Say what came out, as far as it goes and no further."""
    gates = results["quality"]
    failed = [gate for gate in gates if not gate["passed"]]
    summary = f"All {len(gates)} quality gates are passed." if not failed else (
        f"{len(failed)} of {len(gates)} quality gates {'is' if len(failed) == 1 else 'are'} not passed; "
        "read them before using a number of this page."
    )  # fmt: skip
    sentence, tiles = _link_verdict(results, names) if is_link(results) else _map_verdict(results, names)
    return Verdict(sentence=sentence, tiles=tiles, passed=not failed, summary=summary)


def _link_verdict(results: Row, names: dict[str, str]) -> tuple[str, tuple[Tile, ...]]:
    headline = str(results["headline"])
    title = names.get(headline, headline)
    pixel, point = _pair(results["correlation"], headline)
    marks, linked = results["marks"], results["linked"]
    loo = marks["leave_one_out_rms_um"]
    what = in_words(title)
    if pixel.get("r2") is None:
        sentence = (
            f"{title} and the image could not be correlated: {count(pixel.get('n', 0))} pixels are valid in both, or one of the "
            "two is constant."
        )
    else:
        way = "higher" if pixel["r"] > 0 else "lower"
        start = f"Where {what} is larger, the image's value tends to be {way}"
        if pixel["r2"] < _FAINT:
            start = f"The image's value hardly goes along with {what}"
        sentence = f"{start}: a straight line on it accounts for {percent(pixel['r2'], 2)} of the variance over {count(pixel['n'])} pixels"
        sentence += (
            f", and for {percent(point['r2'], 2)} over points of {plain(point['point_um'])}."
            if point.get("r2") is not None
            else "."
        )
    agree = (
        f"The {marks['matched']} marks agree to {length(loo, 2)}"
        if loo is not None
        else f"{marks['matched']} marks were used"
    )
    sentence += f" {agree}{' when each is predicted from the others' if loo is not None else ''}."
    return sentence, (
        Tile(value=fixed(pixel.get("r2"), 3), unit="", label="r² at the pixel", note=_tile_note(pixel)),
        Tile(value=fixed(point.get("r2"), 3), unit="", label=f"r² at {plain(_point_um(results))}", note=_tile_note(point)),
        Tile(value=number(loo, 2), unit="µm", label="agreement of the marks",
             note=f"leave-one-out rms of {marks['matched']}; fit {number(marks['rms_um'], 2)} µm"),
        Tile(value=fixed(100 * linked["share_valid_of_sheet"], 0), unit="%", label="of the shown sheet is valid",
             note=f"{percent(results['surfaces']['share_measured'], 2)} of the columns are measured"),
    )  # fmt: skip


def _map_verdict(results: Row, names: dict[str, str]) -> tuple[str, tuple[Tile, ...]]:
    thickness, flat, surfaces = results["properties"].get("thickness"), results["flatten"], results["surfaces"]
    there = [in_words(names.get(k, k)) for k, v in results["properties"].items() if v]
    coated = any(results["properties"].get(k) for k in ("coating_top", "coating_bottom"))
    sentence = (
        f"The sheet was found in {percent(surfaces['share_measured'], 2)} of the columns and flattened; "
        f"mapped are {', '.join(there) if there else 'no properties'}. No image was linked."
    )
    if not coated:
        sentence += " No coating was found."
    return sentence, (
        Tile(value=number(thickness["mean_um"] if thickness else None), unit="µm", label="mean sheet thickness",
             note=f"standard deviation {number(thickness['sd_um'], 2)} µm" if thickness else NONE),
        Tile(value=fixed(100 * surfaces["share_measured"], 0), unit="%", label="of the columns are measured",
             note=f"of {count(surfaces['columns'])}"),
        Tile(value=number(100 * flat["edge_strain_p95"], 2), unit="%", label="edge strain", note="95th percentile of the mesh's edges"),
        Tile(value=number(flat["largest_move_um"]), unit="µm", label="largest displacement", note="between projection and flat sheet"),
    )  # fmt: skip


def _tile_note(row: Row) -> str:
    return f"r = {number(row.get('r'))}, n = {count(row.get('n'))}"


def _point_um(results: Row) -> float:
    return float(results["parameters"].get("correlate", {}).get("point_um", 100.0))


def _pair(rows: list[Row], name: str) -> tuple[Row, Row]:
    """Return the rows of one property: at the pixel, and at the larger points."""
    found = [row for row in rows if row["property"] == name]
    return (found[0] if found else {}), (found[1] if len(found) > 1 else {})


def inputs(results: Row) -> list[Row]:
    """Return what was read, one row a file."""
    out: list[Row] = []
    for kind, key, axes in (("volume", "voxel_um", "z, y, x"), ("image", "pixel_um", "y, x")):
        data = results["inputs"].get(kind)
        if not data:
            continue
        steps = [float(v) for v in data[key]]
        extent = [n * s for n, s in zip(data["shape"], steps, strict=True)]
        out.append({
            "kind": kind.capitalize(),
            "name": data["name"],
            "shape": " × ".join(count(n) for n in data["shape"]),
            "axes": axes,
            "dtype": data["dtype"],
            "step": " × ".join(f"{v:.6g}" for v in steps),
            "source": data[f"{key}_source"],
            "extent": " × ".join(number(v / 1000) for v in extent),
            "bytes": size(int(data["bytes"])),
            "sha256": data["sha256"],
            "short": f"{data['sha256'][:12]}…",
        })  # fmt: skip
    return out


def columns(results: Row) -> list[Row]:
    """Return how the volume's columns were judged, as shares of all."""
    words = (
        ("share_measured", "measured", "measured"),
        ("share_rim", "left out: rim of a hole or an edge", "rim"),
        ("share_no_sheet", "no sheet, or a hole", "none"),
        ("share_face_not_found", "a face was not found", "lost"),
        ("share_normal_leaves_sheet", "the normal leaves the sheet", "normal"),
    )
    found = [(results["surfaces"].get(key), text, kind) for key, text, kind in words]
    return [
        {"share": f"{100 * v:.3f}", "text": text, "percent": percent(v), "kind": kind} for v, text, kind in found if v
    ]


def flattening(results: Row, strain: xr.Dataset, surfaces: xr.Dataset) -> list[tuple[str, str]]:
    """Return what flattening did, in numbers."""
    f = results["flatten"]
    height = surfaces["centre"].values
    area = float(np.nanmean(strain["area_ratio"].values)) - 1
    return [
        ("Outcome", str(f["sentence"])),
        ("Warp of the centre surface, lowest to highest", length(float(np.nanmax(height) - np.nanmin(height)))),
        ("Largest displacement against the projection", length(f["largest_move_um"])),
        ("Edge strain, 95th percentile", percent(f["edge_strain_p95"], 2)),
        ("Edge strain, largest", percent(f["edge_strain_max"], 2)),
        ("Mean change of area", percent(area, 2)),
        ("Folded cells", count(f["folded_cells"])),
        ("Pitch of the mesh", length(f["mesh_um"])),
        ("Spring energy left", f"{number(f['energy_um2'])} µm²"),
        ("Steps", count(f["steps"])),
    ]


def properties(results: Row, names: dict[str, str]) -> list[Row]:
    """Return the distribution of each property over the columns; a dash where there is none."""
    keys = ("mean_um", "sd_um", "p5_um", "median_um", "p95_um")
    out: list[Row] = []
    for name, data in results["properties"].items():
        cells = [number(data[key]) if data else NONE for key in keys]
        out.append({"name": names.get(name, name), "n": count(data["n"]) if data else NONE, "cells": cells})
    return out


def mark_rows(marks: xr.Dataset) -> list[Row]:
    """Return one row a mark, numbered as in the figure."""
    keys = ("moving_x", "moving_y", "fixed_x", "fixed_y")
    out: list[Row] = []
    for k in range(marks.sizes["mark"]):
        out.append({
            "number": k + 1,
            "label": str(marks["label"].values[k]) if "label" in marks else "",
            "places": [fixed(float(marks[key].values[k]), 1) for key in keys],
            "errors": [number(float(marks[key].values[k]), 2) for key in ("residual", "leave_one_out")],
        })  # fmt: skip
    return out


def transform(results: Row) -> list[tuple[str, str]]:
    """Return the similarity in numbers."""
    m = results["marks"]
    loo = m["leave_one_out_rms_um"]
    found = [
        ("Scale", f"{m['scale']:.5f}"),
        ("Rotation, x towards y", f"{fixed(m['rotation_deg'], 3)}°"),
        ("Shift (x, y)", f"({fixed(m['shift_um'][0], 1)}, {fixed(m['shift_um'][1], 1)}) µm"),
        ("Mirrored", "yes" if m["mirrored"] else "no"),
        ("Residual, rms", f"{number(m['rms_um'], 2)} µm"),
        ("Leave-one-out, rms", f"{number(loo, 2)} µm" if loo is not None else NONE),
    ]
    if m.get("source") == "file":
        return [("Marks", f"{m['matched']} pairs from a table"), *found]
    seen = f"{m['matched']} matched, of {m.get('found_volume', NONE)} holes in the volume and {m.get('found_image', NONE)} in the image"
    return [("Marks", seen), *found]


def compare(results: Row) -> list[Row]:
    """Return the ways of bringing the sheet to the image, with both point sizes in one row each."""
    out: list[Row] = []
    rows = results["table"]
    for name in dict.fromkeys(row["registration"] for row in rows):
        found = [row for row in rows if row["registration"] == name]
        out.append({
            "name": name[:1].upper() + name[1:],
            "rms": number(found[0]["marks_rms_um"], 3),
            "pairs": [_cells(row) for row in found],
            "best": row_is_flattened(name),
        })  # fmt: skip
    return out


def row_is_flattened(name: str) -> bool:
    """Whether a row of the table is the one with flattening."""
    return name.startswith("flattened")


def compare_sentence(results: Row) -> str:
    """Say what flattening gained, in numbers only."""
    at_pixel: dict[str, float] = {}
    for row in results["table"]:
        if row.get("r2") is not None:
            at_pixel.setdefault(row["registration"], row["r2"])
    flat = next((v for k, v in at_pixel.items() if row_is_flattened(k)), None)
    others = {k: v for k, v in at_pixel.items() if not row_is_flattened(k)}
    if flat is None or not others:
        return ""
    name, best = max(others.items(), key=lambda item: item[1])
    change = f"{fixed(best, 3)} to {fixed(flat, 3)}"
    way = "raises" if flat > best else "does not raise"
    return f"At the pixel, flattening {way} r²: from {change} against the better projection ({name})."


def correlations(results: Row, names: dict[str, str]) -> list[Row]:
    """Return every property's correlation with the image, both point sizes in one row each."""
    rows = results["correlation"]
    out: list[Row] = []
    for name in dict.fromkeys(row["property"] for row in rows):
        pairs = [_cells(row) for row in rows if row["property"] == name]
        out.append({"name": names.get(name, name), "pairs": pairs, "best": name == results["headline"]})
    return out


def _cells(row: Row) -> Row:
    return {
        "n": count(row["n"]),
        "r": fixed(row["r"], 3),
        "r2": fixed(row["r2"], 3),
        "slope": number(row["slope"]),
        "bar": f"{100 * (row['r2'] or 0.0):.1f}",
    }


def point_sizes(results: Row) -> list[str]:
    """Return the point sizes of the two halves of the tables."""
    return list(dict.fromkeys(plain(round(float(row["point_um"]), 4)) for row in results["correlation"]))


def gates(results: Row) -> list[Row]:
    """Return the quality gates: name, light and sentence with typeset units."""
    return [
        {"name": str(g["name"]), "passed": bool(g["passed"]), "sentence": str(g["sentence"]).replace(" um", "\u202fµm")}
        for g in results["quality"]
    ]


def greys(results: Row) -> list[tuple[str, str]]:
    """Return the grey levels that were found in the volume."""
    s = results["surfaces"]
    words = (
        ("grey_air", "Air"),
        ("grey_base", "Base paper"),
        ("grey_coating_top", "Coating, top side"),
        ("grey_coating_bottom", "Coating, bottom side"),
        ("grey_noise", "Noise, standard deviation"),
        ("blur_um", "Blur of the faces, sigma"),
    )
    out = [(text, _grey(s.get(key), key)) for key, text in words if key in s]
    if s.get("polarity") is not None:
        out.append(("Sheet against air", "brighter" if s["polarity"] > 0 else "darker"))
    return out


def _grey(value: float | None, key: str) -> str:
    return length(value) if key.endswith("_um") else number(value, 4)


def parameters(results: Row) -> list[tuple[str, list[tuple[str, str]]]]:
    """Return every parameter, by section."""
    return [
        (str(section), [(str(key), _parameter(value, str(key))) for key, value in values.items()])
        for section, values in results["parameters"].items()
        if values
    ]


def _parameter(value: Any, key: str) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, (list, tuple)):
        text = ", ".join(_parameter(v, "") for v in value)
    elif isinstance(value, (int, float)):
        text = f"{value:.6g}".replace("-", "−")
    else:
        text = str(value)
    return f"{text} {unit('um')}" if key.endswith("_um") else text
