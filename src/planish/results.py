"""The numbers of a run: what goes into results.json."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.analyze import Lag
from planish.core.results import SheetNumbers
from planish.core.status import Status
from planish.flatten import Flattened
from planish.io import fingerprint
from planish.measure import PROPERTIES, further_maps
from planish.register import FittedTransform
from planish.study import LayersStudy, Study

Array = NDArray[np.float64]


def marks_table(labels: list[str], fit: FittedTransform) -> xr.Dataset:
    """Pairs of marks with their residuals, in um."""
    um = {"units": "um"}
    moving, fixed = fit.moving, fit.fixed
    residual = fit.residuals_um
    values = {
        "moving_x": moving[:, 0],
        "moving_y": moving[:, 1],
        "fixed_x": fixed[:, 0],
        "fixed_y": fixed[:, 1],
        "residual_x": residual[:, 0],
        "residual_y": residual[:, 1],
        "residual": np.hypot(residual[:, 0], residual[:, 1]),
        "leave_one_out": fit.leave_one_out_um,
        "weight": fit.robust_weights,
    }
    data = xr.Dataset({k: ("mark", v, um) for k, v in values.items()})
    data["weight"].attrs["units"] = "1"
    data["label"] = ("mark", np.array(labels, dtype=object))
    return data


def input_results(data: xr.DataArray, path: Path, **size: Any) -> dict[str, Any]:
    """What a file is: name, shape, size, and a hash that tells it from every other."""
    key = next(iter(size))
    return {
        "name": str(data.attrs["file_name"]),
        "shape": [int(n) for n in data.shape],
        "dtype": str(data.attrs.get("stored_dtype", data.dtype)),
        "bytes": int(data.attrs["file_bytes"]),
        "sha256": fingerprint(path),
        **size,
        f"{key}_source": str(data.attrs[f"{key}_source"]),
    }


def _plain(value: Any) -> Any:
    """Numbers as JSON knows them, in dicts of dicts."""
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}  # type: ignore[reportUnknownVariableType]
    return _finite(value) if isinstance(value, float) else value


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def surface_results(surfaces: xr.Dataset) -> dict[str, Any]:
    """What the surface search learnt and how much of the sheet it measured."""
    attrs = surfaces.attrs
    status = surfaces["status"].values
    shares = {f"share_{s.label}": float((status == s).mean()) for s in Status if s <= Status.PARTICLE}
    keys = (
        "thickness_um", "blur_um", "fringe", "fringe_um", "cutoff_um", "bridged_share", "rim_um", "saturated_share",
        "missing_share", "polarity",
    )  # fmt: skip
    greys = ("grey_air", "grey_base", "grey_coating_top", "grey_coating_bottom", "grey_noise")
    frame = {k: str(attrs[k]) for k in ("through", "top_side", "row_axis", "col_axis")}
    numbers = {k: _finite(float(attrs.get(k, np.nan))) for k in (*keys, *greys)}
    counts = {k: int(attrs.get(k, 0)) for k in ("particles_removed", "half_closed_holes")}
    return frame | numbers | {"columns": int(status.size)} | counts | shares


def section_results(sections: xr.Dataset) -> dict[str, Any]:
    """How serial sections were joined: what was taken off, and what is left of the quick errors."""
    attrs, aligned = sections.attrs, sections["aligned"].values
    taken = {f"shift_{axis}_rms_um": _rms(sections[f"shift_{axis}"].values[aligned]) for axis in ("row", "col")}
    left = dict(zip(("jitter_left_row_um", "jitter_left_col_um"), attrs["jitter_left_um"], strict=True))
    return {
        "kind": str(attrs["kind"]),
        "count": int(aligned.size),
        "not_aligned": int(np.count_nonzero(~aligned)),
        "missing": int(attrs["missing"]),
        "cutoff_um": float(attrs["cutoff_um"]),
        "fixed": [str(name) for name in attrs["fixed"]],
        "pairs_used": int(attrs["pairs_used"]),
        "pairs_refused": int(attrs["pairs_refused"]),
        "gain_sd": _finite(float(np.std(sections["gain"].values[aligned]))),
        **taken,
        **{k: _finite(float(v)) for k, v in left.items()},
    }


def _rms(values: Array) -> float | None:
    return _finite(float(np.sqrt(np.mean(values**2)))) if values.size else None


def property_results(surfaces: xr.Dataset) -> dict[str, Any]:
    """Mean, spread and percentiles of each property over the columns; None where there is none."""
    out: dict[str, Any] = {}
    for name in PROPERTIES:
        values = surfaces[name].values
        values = values[np.isfinite(values)]
        if values.size == 0:
            out[name] = None
            continue
        p5, p50, p95 = np.percentile(values, [5, 50, 95])
        out[name] = {"n": int(values.size), "mean_um": float(values.mean()), "sd_um": float(values.std()),
                     "p5_um": float(p5), "median_um": float(p50), "p95_um": float(p95)}  # fmt: skip
    return out


def further_results(surfaces: xr.Dataset) -> dict[str, Any]:
    """Mean, spread and percentiles of the further maps, in their own units; None where nothing was measured."""
    out: dict[str, Any] = {}
    for name in further_maps(surfaces):
        if name.endswith("_se"):
            continue
        data = surfaces[name]
        values = data.values[np.isfinite(data.values)].astype(np.float64)
        if not values.size:
            out[name] = None
            continue
        p5, p50, p95 = np.percentile(values, [5, 50, 95])
        errors = surfaces[f"{name}_se"].values if f"{name}_se" in surfaces else np.array([np.nan])
        known = errors[np.isfinite(errors)]
        out[name] = {
            "units": str(data.attrs["units"]), "n": int(values.size), "mean": float(values.mean()),
            "sd": float(values.std()), "p5": float(p5), "median": float(p50), "p95": float(p95),
            "standard_error": float(np.median(known)) if known.size else None,
            "support_um": float(data.attrs["support_um"]),
        }  # fmt: skip
    return out


def number_results(numbers: SheetNumbers) -> dict[str, Any]:
    """Numbers that are no maps, keyed as results.json has them."""
    out: dict[str, Any] = {}
    for side in ("top", "bottom"):
        if side in numbers.thin:
            out[f"thin_{side}"] = numbers.thin[side].model_dump(mode="json")
        out[f"roughness_{side}"] = numbers.roughness[side].model_dump(mode="json", exclude_none=True)
    out["two_sides"] = numbers.two_sides.model_dump(mode="json", exclude_unset=True)
    if numbers.profiles is not None:
        p = numbers.profiles.model_dump(mode="json")
        out["profiles"] = {"depth": p["depth"], **p["values"]}
    return out


def flatten_results(flattened: Flattened) -> dict[str, Any]:
    """How the flattening ended and how much it strained the sheet."""
    flat = flattened.flat
    move = np.hypot(*(flat[a].values - flat[b].values for a, b in (("u", "projected_u"), ("v", "projected_v"))))
    return {
        "outcome": flattened.outcome.name,
        "sentence": flattened.outcome.value,
        "steps": flattened.steps,
        "energy_um2": flattened.energy,
        "mesh_um": flattened.mesh_um,
        "folded_cells": flattened.folded_cells,
        "edge_strain_p95": flattened.edge_strain_p95,
        "edge_strain_max": flattened.edge_strain_max,
        "method": flattened.method,
        "springs": flattened.springs,
        "straight_share": _finite(flattened.straight_share),
        "distortion": {k: _plain(v) for k, v in asdict(flattened.distortion).items()},
        "curvature": {
            "patch_um": flattened.curvature.patch_um,
            "limit": flattened.curvature.limit,
            "share": _finite(flattened.curvature.share),
            "largest": _finite(flattened.curvature.largest),
            "verdict": flattened.curvature.verdict,
        },
        "largest_move_um": float(np.nanmax(move)),
    }


def mark_results(fit: FittedTransform, linked: xr.Dataset) -> dict[str, Any]:
    """The transformation, how well the marks agree, and what that says of the pixels."""
    t = fit.transform
    error = linked["expected_error"].values
    error = error[np.isfinite(error)]
    return {
        "matched": len(fit.residuals_um),
        "model": fit.model,
        "model_sentence": fit.sentence,
        "warnings": list(fit.warnings),
        "expected_error_um": {"median": _finite(float(np.median(error))), "largest": _finite(float(error.max()))}
        if error.size
        else None,
        "rms_um": float(fit.rms_um),
        "leave_one_out_rms_um": _finite(fit.leave_one_out_rms_um),
        "scale": t.scale,
        "rotation_deg": float(np.rad2deg(t.rotation_rad)),
        "shift_um": [float(v) for v in t.shift_um],
        "mirrored": t.mirrored,
    }


def lag_results(lag: Lag, *, expected_um: float | None, headline: str) -> dict[str, Any]:
    """What two maps say of their registration by their own texture; a check, and no gate.

    Parameters
    ----------
    lag : Lag
        Of the second map against the first.
    expected_um : float or None, in um
        Expected error of the registration over the map, rms; NaN is none.
    headline : str
        The property of the first map.

    Returns
    -------
    dict
        Ready for JSON: pairs are ``[x, y]``, None stands for NaN and, for a pair, where either is NaN. Tiles lie at
        ``x``, ``y`` from the middle of the first pixel of ``pixel_um`` (along y and x), which may be the mean of
        several of the maps'.
    """
    expected = None if expected_um is None else _finite(expected_um)
    field = lag.field
    tiles: list[dict[str, Any]] = []
    if field is not None:
        tiles = [
            {"x": float(x), "y": float(y), "lag_um": _both(found), "distinct": bool(distinct)}
            for (x, y), found, distinct in zip(field.at_um, field.lag_um, field.distinct, strict=True)
        ]
    return {
        "property": headline,
        "lag_um": _both(lag.lag_um),
        "se_um": _both(lag.se_um),
        "length_um": _finite(lag.length_um),
        "length_se_um": _finite(lag.length_se_um),
        "r": _finite(lag.r),
        "r_at_zero": _finite(lag.r_at_zero),
        "null_95": _finite(lag.null_95),
        "null_99": _finite(lag.null_99),
        "silence": lag.silence,
        "agrees": None if expected is None else lag.agrees(expected),
        "expected_um": expected,
        "sentence": lag.sentence(expected),
        "pixel_um": [float(v) for v in lag.pixel_um],
        "n": lag.n,
        "reach_um": float(lag.reach_um),
        "split_um": _finite(lag.split_um),
        "lags_of_bands_um": [_both(part) for part in lag.lags_of_bands_um],
        "tile_um": None if field is None else float(field.tile_um),
        "tiles": tiles,
    }


def _both(pair: Sequence[float] | Array) -> list[float] | None:
    """Return a pair of numbers, None unless both are known."""
    return [float(v) for v in pair] if np.isfinite(pair).all() else None


def linked_results(linked: xr.Dataset, away: NDArray[np.bool_]) -> dict[str, Any]:
    """How much of the image shows the sheet, and how much of that is valid."""
    on_sheet = np.isfinite(linked["u"].values)
    return {
        "pixels": int(on_sheet.size),
        "share_on_sheet": float(on_sheet.mean()),
        "share_valid": float(linked["valid"].values.mean()),
        "share_valid_of_sheet": float(linked["valid"].values.sum() / max(int(on_sheet.sum()), 1)),
        "share_valid_away_from_holes": float(linked["valid"].values.sum() / max(int((on_sheet & away).sum()), 1)),
    }


def parameter_results(study: Study | LayersStudy) -> dict[str, Any]:
    """All parameters but the paths of inputs, which say where files lie and not what was done."""
    return _without_paths(study.model_dump(mode="json", exclude_none=True))


def _without_paths(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_paths(v) for k, v in value.items() if k not in ("path", "run")}  # type: ignore[reportUnknownVariableType]
    if isinstance(value, list):
        return [_without_paths(v) for v in value]  # type: ignore[reportUnknownVariableType]
    return value
