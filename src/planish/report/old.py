"""Results as the pipeline writes them today, as models; goes when the pipeline makes the models itself."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import xarray as xr

from planish.core.results import Results
from planish.report import page

Old = dict[str, Any]


def write_report(
    path: Path, *, groups: Mapping[str, xr.Dataset], marks: Mapping[str, xr.Dataset] | xr.Dataset | None,
    results: Results | Old,
) -> None:  # fmt: skip
    """Write the report of a run, of results in either form."""
    tables = {"volume": marks} if isinstance(marks, xr.Dataset) else marks or {}
    models = results if isinstance(results, Results) else as_results(results)
    page.write_report(path, groups=groups, marks=tables, results=models)


write_layers_report = write_report


def as_results(old: Old) -> Results:
    """Return results in the form of version 2."""
    layers = [_layer(k, old) for k in old["layers"]] if "layers" in old else _two(old)
    same = {"planish": old["planish"], "versions": old.get("versions", {}), "gates": old["quality"]}
    rows: list[Old] = old.get("pairs", [])
    if "correlation" in old:
        rows = [
            {k: v for k, v in row.items() if k != "property"}
            | {"a": layers[0]["name"], "a_map": row["property"], "b": layers[1]["name"], "b_map": "image"}
            for row in old["correlation"]
        ]
    fields = {"a", "a_map", "b", "b_map", "point_um", "n", "r", "r2", "slope", "intercept", "same_quantity",
              "difference_mean", "difference_sd", "limits", "units"}  # fmt: skip
    rows = [{k: v for k, v in row.items() if k in fields} for row in rows]
    comparison = [
        {
            k: row[k]
            for k in ("registration", "property", "marks_rms_um", "point_um", "n", "r", "r2", "slope", "intercept")
        }
        for row in old.get("table", [])
    ]
    linked = old.get("linked")
    if linked:
        linked = {"share_valid_away_from_holes": 0.0, **linked}
    return Results.model_validate(
        same
        | {"layers": layers, "chain": bool(old.get("chain")), "correlations": rows, "comparison": comparison,
           "linked": linked, "refinement": old.get("refinement"), "parameters": old["parameters"]}
    )  # fmt: skip


def _source(data: Old) -> Old:
    size = "voxel_um" if "voxel_um" in data else "pixel_um"
    return {"name": data["name"], "shape": data["shape"], "dtype": data.get("dtype", ""), "bytes": data.get("bytes", 0),
            "sha256": data["sha256"], "size_um": data[size], "size_source": data.get(f"{size}_source", "")}  # fmt: skip


def _two(old: Old) -> list[Old]:
    inputs = old["inputs"]
    sheet = {"name": "volume", "kind": "sheet", "source": _source(inputs["volume"]),
             "headline": old.get("headline") or "coating_top", "sheet": _sheet(old)}  # fmt: skip
    if "image" not in inputs:
        return [sheet]
    marks = old["marks"]
    sheet["registration"] = _registration(marks, "image", ["volume", "image"], old.get("orientation"), old.get("lag"))
    return [sheet, {"name": "image", "kind": "image", "source": _source(inputs["image"]), "headline": "image"}]


def _layer(layer: Old, old: Old) -> Old:
    out = {"name": layer["name"], "kind": "image" if layer["kind"] == "image" else "sheet",
           "source": _source(layer["source"]), "headline": layer["headline"],
           "share_of_reference": layer["share_of_reference"]}  # fmt: skip
    lags = [g for g in old["lags"] if g["a"] == layer["name"] and g["b"] == old["reference"] and "sentence" in g]
    if layer["marks"]:
        lag = {k: v for k, v in lags[0].items() if k not in ("a", "b")} if lags else None
        out["registration"] = _registration(layer["marks"], layer["to"], layer["path"], layer["orientation"], lag)
        out["registration"]["expected_error"] = _error(layer["expected_error_um"])
    return out


def _error(old: Old | None) -> Old | None:
    return {"median_um": old["median"], "largest_um": old["largest"]} if old and old["median"] is not None else None


def _registration(marks: Old, to: str, path: list[str], o: Old | None, lag: Old | None) -> Old:
    found = [v for k, v in marks.items() if k.startswith("found_")] or [0, 0]
    o = o or {}
    design, tilt = marks.get("design"), marks.get("tilt")
    return {
        "to": to, "path": path, "source": marks["source"], "found_moving": found[0], "found_fixed": found[1],
        "matched": marks["matched"], "second_best": marks.get("rival_inliers"), "match_sentence": marks.get("sentence"),
        "design": design["sentence"] if design else None, "tilt": tilt if tilt and "through" in tilt else None,
        "model": marks.get("model", ""), "model_sentence": marks.get("model_sentence", ""),
        "warnings": marks.get("warnings", []), "rms_um": marks["rms_um"],
        "leave_one_out_rms_um": marks["leave_one_out_rms_um"],
        "expected_error": _error(marks.get("expected_error_um")), "scale": marks["scale"],
        "rotation_deg": marks["rotation_deg"], "shift_um": marks["shift_um"], "mirrored": marks["mirrored"],
        "orientation": {
            "image_side": o.get("image_side") or "top", "side_given": o.get("side_source") == "given",
            "mirrored_volume": bool(o.get("mirrored_volume")), "md_deg_moving": o.get("md_deg_map"),
            "md_deg_fixed": o.get("md_deg_image"), "md_deg_fixed_from_moving": o.get("md_deg_image_from_map"),
            "sentence": o.get("sentence", ""),
        },
        "lag": lag,
    }  # fmt: skip


def _sheet(old: Old) -> Old:
    surfaces = {k: v for k, v in old["surfaces"].items() if not k.startswith("share_")}
    surfaces["shares"] = {k.removeprefix("share_"): v for k, v in old["surfaces"].items() if k.startswith("share_")}
    named = {"fringe", "fringe_um", "saturated_share", "missing_share"}
    surfaces = dict.fromkeys(named) | {"particles_removed": 0, "half_closed_holes": 0} | surfaces
    keys = ("mean", "sd", "p5", "median", "p95")
    properties = {
        name: {"units": "um", "n": p["n"], **{k: p[f"{k}_um"] for k in keys}}
        for name, p in old["properties"].items()
        if p
    } | {name: p for name, p in old.get("further", {}).items() if p}
    numbers = old.get("numbers", {})
    sides = ("top", "bottom")
    profiles = numbers.get("profiles")
    return {
        "surfaces": surfaces,
        "properties": properties,
        "numbers": {
            "thin": {s: numbers[f"thin_{s}"] for s in sides if numbers.get(f"thin_{s}")},
            "roughness": {s: numbers[f"roughness_{s}"] for s in sides if numbers.get(f"roughness_{s}")},
            "two_sides": numbers.get("two_sides", {}),
            "profiles": {"depth": profiles["depth"], "values": {k: v for k, v in profiles.items() if k != "depth"}}
            if profiles else None,
        },
        "flatten": old["flatten"],
        "sections": old.get("sections"),
    }  # fmt: skip
