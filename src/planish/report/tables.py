"""What the page says in words and tables: every number is written here, none in the template."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from planish.report.text import NONE, capital, count, fixed, length, number, percent, plain, size, typeset, unit

METHOD = (
    "U. Hirn, J. Kritzinger, M. Donoser, W. Bauer: Introducing a concept to link 3D paper structure to 2D paper "
    "properties. In: Advances in Pulp and Paper Research, Oxford 2009, Transactions of the XIVth Fundamental Research "
    "Symposium."
)

Row = dict[str, Any]


def is_link(results: Row) -> bool:
    """Whether an image was linked."""
    return bool(results.get("inputs", {}).get("image"))


def long_names(groups: dict[str, xr.Dataset]) -> dict[str, str]:
    """Return the title of each property."""
    data = groups["maps"]
    return {str(k): str(v.attrs.get("long_name", k)) for k, v in data.data_vars.items()}


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


def joined(results: Row) -> str:
    """Return a sentence on how serial sections were joined, empty where there are none."""
    told = results.get("sections")
    if not told:
        return ""
    taken = " and ".join(length(told[f"shift_{axis}_rms_um"], 2) for axis in ("row", "col"))
    left = " and ".join(length(told[f"jitter_left_{axis}_um"], 1) for axis in ("row", "col"))
    lost = told["not_aligned"]
    held = told.get("fixed", [])
    slow = (
        f"Errors that vary more slowly than over {length(told['cutoff_um'])} cannot be told from the sheet's own "
        "bend and stay."
        if not held
        else f"Slow drift was taken off ({', '.join(held)}) with the help of what lies still in the photographs."
    )
    return (
        f"{count(told['count'])} sections were aligned to their neighbours, with {taken} rms taken off along rows and "
        f"columns. By the scatter between parts of the sheet {left} are left; along the columns it may be twice as "
        f"much. {count(told['missing'])} missing sections were bridged"
        + (f", {count(lost)} of them because they fit to no neighbour" if lost else "")
        + f". {slow}"
    )


def columns(results: Row) -> list[Row]:
    """Return how the volume's columns were judged, as shares of all."""
    words = (
        ("share_measured", "measured", "measured"),
        ("share_rim", "left out: rim of a hole or an edge", "rim"),
        ("share_no_sheet", "no sheet, or a hole", "none"),
        ("share_face_not_found", "a face was not found", "lost"),
        ("share_normal_leaves_sheet", "the normal leaves the sheet", "normal"),
        ("share_touching", "the sheet touches another, or itself", "lost"),
        ("share_leaves_volume", "the sheet leaves the volume", "none"),
        ("share_particle", "a particle sticks to the sheet", "lost"),
    )
    found = [(results["surfaces"].get(key), text, kind) for key, text, kind in words]
    return [
        {"share": f"{100 * v:.3f}", "text": text, "percent": percent(v), "kind": kind} for v, text, kind in found if v
    ]


def flattening(results: Row, surfaces: xr.Dataset) -> list[tuple[str, str]]:
    """Return what flattening did, in numbers."""
    f = results["flatten"]
    height = surfaces["centre"].values
    d = f["distortion"]
    method = "dynamic relaxation" if f["method"] == "relaxation" else "multigrid"
    straight = f["straight_share"]
    return [
        ("Outcome", str(f["sentence"])),
        ("Can it be paper?", str(f["curvature"]["verdict"])),
        ("Warp of the centre surface, lowest to highest", length(float(np.nanmax(height) - np.nanmin(height)))),
        ("Largest displacement against the projection", length(f["largest_move_um"])),
        ("Displacement, median and 95 %, after turning and shifting",
         f"{length(d['displacement_median_um'])} and {length(d['displacement_p95_um'])}"),
        ("Growth against the projection", f"{number(d['growth_percent'], 3)} %"),
        ("Difference of the growth between two directions", f"{number(d['growth_anisotropy_percent'], 3)} %"),
        ("Edge strain, 95th percentile", percent(f["edge_strain_p95"], 2)),
        ("Edge strain, largest", percent(f["edge_strain_max"], 2)),
        ("Change of area, median and 95 % of its size",
         f"{percent(d['area']['median'], 2)} and {percent(d['area']['p95_abs'], 2)}"),
        ("Lengths along random lines, 50 % and 95 % wrong by less than",
         f"{percent(d['geodesics']['p50'], 2)} and {percent(d['geodesics']['p95'], 2)}"),
        ("Folded cells", count(f["folded_cells"])),
        ("Mesh", f"{count(d['cells'])} cells of {length(f['mesh_um'])}"),
        ("Springs with a straight rest length, the surface being rough there",
         percent(straight, 2) if straight else "none"),
        ("Spring energy left, for each spring", f"{number(f['energy_um2'] / max(f['springs'], 1), 3)} µm²"),
        ("Method and steps on the mesh", f"{method}, {count(f['steps'])}"),
    ]  # fmt: skip


def properties(results: Row, names: dict[str, str]) -> list[Row]:
    """Return the distribution of each property over the columns; a dash where there is none."""
    keys = ("mean_um", "sd_um", "p5_um", "median_um", "p95_um")
    out: list[Row] = []
    for name, data in results["properties"].items():
        cells = [number(data[key]) if data else NONE for key in keys]
        out.append({"name": names.get(name, name), "n": count(data["n"]) if data else NONE, "cells": cells})
    return out


def further(results: Row, names: dict[str, str]) -> list[Row]:
    """Return the distribution of each further property, with its unit and standard error."""
    keys = ("mean", "sd", "p5", "median", "p95", "standard_error")
    out: list[Row] = []
    for name, data in results.get("further", {}).items():
        cells = [number(data[key]) if data else NONE for key in keys]
        units = unit(str(data["units"])) if data else ""
        support = number(data["support_um"]) if data else NONE
        title = names.get(name, name)
        out.append({"name": f"{title} / {units}" if units else title, "n": count(data["n"]) if data else NONE,
                    "cells": [*cells, support]})  # fmt: skip
    return out


_ROUGHNESS = {"sa": " µm", "sq": " µm", "ssk": "", "sku": "", "sz": " µm", "sdq": ""}
_SIDES = {"top": "top side", "bottom": "bottom side"}


def numbers(results: Row) -> list[tuple[str, str]]:
    """Return what describes the sheet in numbers, as pairs of name and value."""
    told = results.get("numbers", {})
    out: list[tuple[str, str]] = []
    for side, words in _SIDES.items():
        thin = told.get(f"thin_{side}")
        if thin:
            shares = ", ".join(
                f"{percent(share)} below {number(x)} µm" if x else f"{percent(share)} bare"
                for x, share in zip(thin["thinner_than_um"], thin["share"], strict=True)
            )
            out.append((f"Thin coating, {words}", f"{shares}, at columns of {length(thin['support_um'])}"))
            if thin["warning"]:
                out.append(("", typeset(str(thin["warning"]))))
        rough = told.get(f"roughness_{side}", {})
        if "reason" in rough:
            out.append((f"Roughness, {words}", typeset(str(rough["reason"]))))
        elif rough:
            values = ", ".join(f"{key.capitalize()} {number(rough[key])}{units}" for key, units in _ROUGHNESS.items())
            filters = f"S-filter {length(rough['s_filter_um'])}, L-filter {length(rough['l_filter_um'])}"
            out.append((f"Roughness, {words}", f"{values} ({filters})"))
    for pair, words in (("coating", "Coatings"), ("topography", "Topographies")):
        sides = told.get("two_sides", {})
        if sides.get(f"{pair}_correlation") is not None:
            out.append((
                f"{words} of the two sides",
                f"top less bottom {number(sides[f'{pair}_difference_um'])} µm, ratio of the standard deviations "
                f"{number(sides[f'{pair}_sd_ratio'])}, correlation {number(sides[f'{pair}_correlation'])}",
            ))  # fmt: skip
    for name in ("porosity", "filler"):
        if name in told.get("profiles", {}):
            values = " ".join(number(v, 2) for v in told["profiles"][name])
            out.append((f"Profile of {name}, bottom to top", values))
    return out


def mark_rows(marks: xr.Dataset) -> list[Row]:
    """Return one row a mark, numbered as in the figure."""
    keys = ("moving_x", "moving_y", "fixed_x", "fixed_y")
    return [
        {
            "number": k + 1,
            "label": str(marks["label"].values[k]) if "label" in marks else "",
            "places": [fixed(float(marks[key].values[k]), 1) for key in keys],
            "errors": [number(float(marks[key].values[k]), 2) for key in ("residual", "leave_one_out")],
        }
        for k in range(marks.sizes["mark"])
    ]


def transform(m: Row, *, names: tuple[str, str] = ("volume", "image")) -> list[tuple[str, str]]:
    """Return a transformation in numbers, from what the results say of its marks."""
    loo = m["leave_one_out_rms_um"]
    found = [
        ("Scale", f"{m['scale']:.5f}"),
        ("Rotation, x towards y", f"{fixed(m['rotation_deg'], 3)}°"),
        ("Shift (x, y)", f"({fixed(m['shift_um'][0], 1)}, {fixed(m['shift_um'][1], 1)}) µm"),
        ("Mirrored", "yes" if m["mirrored"] else "no"),
        ("Residual, rms", f"{number(m['rms_um'], 2)} µm"),
        ("Leave-one-out, rms", f"{number(loo, 2)} µm" if loo is not None else NONE),
    ]
    if "model_sentence" in m:  # runs of planish before it chose a model have none
        found.insert(0, ("Model", typeset(m["model_sentence"])))
        error = m["expected_error_um"]
        words = NONE
        if error is not None and error["median"] is not None:
            words = f"{number(error['median'], 2)} µm (median), {number(error['largest'], 2)} µm at most"
        found.append(("Expected error of a pixel, rms", words))
        found += [("Warning", typeset(text)) for text in m["warnings"]]
    if m.get("source") == "file":
        return [("Marks", f"{m['matched']} pairs from a table"), *found]
    found_in = [m.get(f"found_{name}", NONE) for name in names]
    articles = ["the " if name in ("volume", "image") else "" for name in names]
    seen = (
        f"{m['matched']} matched, of {found_in[0]} holes in {articles[0]}{names[0]} and {found_in[1]} in "
        f"{articles[1]}{names[1]}"
    )
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
            "pairs": [cells(row) for row in found],
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
        pairs = [cells(row) for row in rows if row["property"] == name]
        out.append({"name": names.get(name, name), "pairs": pairs, "best": name == results["headline"]})
    return out


def cells(row: Row) -> Row:
    """Return one correlation as a table shows it."""
    return {
        "n": count(row["n"]),
        "r": fixed(row["r"], 3),
        "r2": fixed(row["r2"], 3),
        "slope": number(row["slope"]),
        "bar": f"{100 * (row['r2'] or 0.0):.1f}",
    }


def point_sizes(rows: list[Row]) -> list[str]:
    """Return the point sizes of the two halves of a table of correlations."""
    return list(dict.fromkeys(plain(round(float(row["point_um"]), 4)) for row in rows))


def gates(results: Row, *, capitals: bool = True) -> list[Row]:
    """Return the quality gates: name, light and sentence with typeset units."""
    return [
        {
            "name": capital(str(g["name"])) if capitals else str(g["name"]),
            "passed": bool(g["passed"]),
            "sentence": typeset(str(g["sentence"])),
        }
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
    if s.get("fringe") is not None:
        out.append(("Phase-contrast fringe, share of an edge", number(s["fringe"], 2) if s["fringe"] else "none"))
    if s.get("polarity") is not None:
        out.append(("Sheet against air", "brighter" if s["polarity"] > 0 else "darker"))
    return out


def _grey(value: float | None, key: str) -> str:
    return length(value) if key.endswith("_um") else number(value, 4)


def parameters(results: Row) -> list[tuple[str, list[tuple[str, str]]]]:
    """Return every parameter, by section."""
    out: list[tuple[str, list[tuple[str, str]]]] = []
    loose: list[tuple[str, str]] = []
    for section, values in results["parameters"].items():
        if isinstance(values, dict):
            out.append((str(section), _flat(values)))
        elif isinstance(values, list) and values and all(isinstance(v, dict) for v in values):
            out += [(f"{section}, {v.get('name', k + 1)}", _flat(v)) for k, v in enumerate(values)]
        else:
            loose.append((str(section), _parameter(values, str(section))))
    if loose:
        out.append(("others", loose))
    return [(name, rows) for name, rows in out if rows]


def _flat(values: Row, before: str = "") -> list[tuple[str, str]]:
    """Write a section of parameters; what lies in a section of its own has that one's name before it."""
    rows: list[tuple[str, str]] = []
    for key, value in values.items():
        if isinstance(value, dict):
            rows += _flat(value, f"{before}{key}.")
        else:
            rows.append((f"{before}{key}", _parameter(value, str(key))))
    return rows


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
