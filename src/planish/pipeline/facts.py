"""Results of the stages, put into the models of ``results.json``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.analyze import Lag
from planish.core.checks import is_property
from planish.core.results import (
    CurvatureFacts,
    DistortionFacts,
    ExpectedError,
    FlattenFacts,
    InputFile,
    LagFacts,
    LagTile,
    LinkedArea,
    PropertyFacts,
    SectionFacts,
    SurfaceFacts,
)
from planish.flatten import Flattened
from planish.io import fingerprint
from planish.study import Study, to_dict

Array = NDArray[np.float64]


def versions() -> dict[str, str]:
    """Versions of the libraries that numbers depend on."""
    return {name: version(name) for name in ("numpy", "scipy", "numba", "xarray", "zarr", "tifffile")}


def input_file(data: xr.DataArray, path: str) -> InputFile:
    """What a file is, as its reader noted it."""
    size = "voxel_um" if "voxel_um" in data.attrs else "pixel_um"
    return InputFile(
        name=str(data.attrs["file_name"]),
        shape=tuple(int(n) for n in data.shape),
        dtype=str(data.attrs.get("stored_dtype", data.dtype)),
        bytes=int(data.attrs["file_bytes"]),
        sha256=fingerprint(path),
        size_um=tuple(float(v) for v in data.attrs[size]),
        size_source=str(data.attrs[f"{size}_source"]),
    )


def surface_facts(surfaces: xr.Dataset) -> SurfaceFacts:
    """What the surface search learnt and how much of the sheet it measured."""
    attrs, status = surfaces.attrs, surfaces["status"]
    names = str(status.attrs["flag_meanings"]).split()
    counts = {k: int(attrs.get(k, 0)) for k in ("particles_removed", "half_closed_holes")}
    plain = {"columns", "shares", *counts}
    known = {k: attrs.get(k) for k in SurfaceFacts.model_fields if k not in plain}
    shares = {name: float((status.values == k).mean()) for k, name in enumerate(names)}
    return SurfaceFacts.model_validate({"columns": int(status.size), "shares": shares, **counts, **known})


def property_facts(surfaces: xr.Dataset) -> dict[str, PropertyFacts]:
    """Distribution of each property over the columns; those that were measured nowhere are left out."""
    found: dict[str, PropertyFacts] = {}
    for name, data in surfaces.data_vars.items():
        if not is_property(data):
            continue
        values = data.values[np.isfinite(data.values)].astype(np.float64)
        if not values.size:
            continue
        p5, p50, p95 = np.percentile(values, [5, 50, 95])
        errors = surfaces[f"{name}_se"].values if f"{name}_se" in surfaces else np.empty(0)
        errors = errors[np.isfinite(errors)]
        found[str(name)] = PropertyFacts(
            units=str(data.attrs["units"]), n=int(values.size), mean=float(values.mean()), sd=float(values.std()),
            p5=float(p5), median=float(p50), p95=float(p95), support_um=data.attrs.get("support_um"),
            standard_error=float(np.median(errors)) if errors.size else None,
        )  # fmt: skip
    return found


def section_facts(sections: xr.Dataset) -> SectionFacts:
    """How serial sections were joined."""
    attrs, aligned = sections.attrs, sections["aligned"].values
    rms = {axis: float(np.sqrt(np.mean(sections[f"shift_{axis}"].values[aligned] ** 2))) for axis in ("row", "col")}
    left = [float(v) for v in attrs["jitter_left_um"]]
    return SectionFacts(
        kind=attrs["kind"], count=int(aligned.size), not_aligned=int(np.count_nonzero(~aligned)),
        missing=int(attrs["missing"]), cutoff_um=float(attrs["cutoff_um"]), fixed=tuple(map(str, attrs["fixed"])),
        pairs_used=int(attrs["pairs_used"]), pairs_refused=int(attrs["pairs_refused"]),
        gain_sd=float(np.std(sections["gain"].values[aligned])),
        shift_row_rms_um=rms["row"], shift_col_rms_um=rms["col"],
        jitter_left_row_um=left[0], jitter_left_col_um=left[1],
    )  # fmt: skip


def flatten_facts(flattened: Flattened) -> FlattenFacts:
    """How the flattening ended and how much it strained the sheet."""
    f, flat = flattened, flattened.flat
    move = np.hypot(*(flat[a].values - flat[b].values for a, b in (("u", "projected_u"), ("v", "projected_v"))))
    return FlattenFacts(
        outcome=f.outcome.name, sentence=f.outcome.value, steps=f.steps, energy_um2=f.energy, mesh_um=f.mesh_um,
        folded_cells=f.folded_cells, edge_strain_p95=f.edge_strain_p95, edge_strain_max=f.edge_strain_max,
        method=f.method, springs=f.springs, straight_share=f.straight_share,
        distortion=DistortionFacts.model_validate(f.distortion), curvature=CurvatureFacts.model_validate(f.curvature),
        largest_move_um=float(np.nanmax(move)),
    )  # fmt: skip


def lag_facts(lag: Lag, *, expected_um: float | None, name: str) -> LagFacts:
    """What two maps say of their registration by their own texture.

    Parameters
    ----------
    lag : Lag
        Of the second map against the first.
    expected_um : float or None
        Expected error of the registration over the map, rms.
    name : str
        The property of the first map.
    """
    expected = expected_um if expected_um is not None and math.isfinite(expected_um) else None
    tiles = () if lag.field is None else tuple(
        LagTile(x=float(x), y=float(y), lag_um=_both(found), distinct=bool(distinct))
        for (x, y), found, distinct in zip(lag.field.at_um, lag.field.lag_um, lag.field.distinct, strict=True)
    )  # fmt: skip
    return LagFacts(
        property=name, lag_um=_both(lag.lag_um), se_um=_both(lag.se_um), length_um=lag.length_um,
        length_se_um=lag.length_se_um, r=lag.r, r_at_zero=lag.r_at_zero, null_95=lag.null_95, null_99=lag.null_99,
        silence=lag.silence, agrees=None if expected is None else lag.agrees(expected), expected_um=expected,
        sentence=lag.sentence(expected), pixel_um=(float(lag.pixel_um[0]), float(lag.pixel_um[1])), n=lag.n,
        reach_um=float(lag.reach_um), split_um=lag.split_um,
        lags_of_bands_um=tuple(_both(part) for part in lag.lags_of_bands_um),
        tile_um=None if lag.field is None else float(lag.field.tile_um), tiles=tiles,
    )  # fmt: skip


def _both(pair: Sequence[float] | Array) -> tuple[float, float] | None:
    """A pair of numbers, None unless both are known."""
    return (float(pair[0]), float(pair[1])) if np.isfinite(pair).all() else None


def expected_error_facts(error: Array) -> ExpectedError | None:
    """Expected error of the pixels of a map; None where no pixel is known."""
    known = error[np.isfinite(error)]
    return ExpectedError(median_um=float(np.median(known)), largest_um=float(known.max())) if known.size else None


def linked_area(linked: xr.Dataset, away: NDArray[np.bool_]) -> LinkedArea:
    """How much of the reference shows the sheet, and how much of that is valid."""
    on_sheet, valid = np.isfinite(linked["u"].values), linked["valid"].values
    return LinkedArea(
        pixels=int(on_sheet.size),
        share_on_sheet=float(on_sheet.mean()),
        share_valid=float(valid.mean()),
        share_valid_of_sheet=float(valid.sum() / max(int(on_sheet.sum()), 1)),
        share_valid_away_from_holes=float(valid.sum() / max(int((on_sheet & away).sum()), 1)),
    )


def parameters(study: Study) -> dict[str, Any]:
    """All parameters but the paths of inputs, which say where files lie and not what was done."""
    return _without_paths(to_dict(study))


def _without_paths(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_paths(v) for k, v in value.items() if k not in ("path", "run", "marks")}  # type: ignore[reportUnknownVariableType]
    if isinstance(value, list):
        return [_without_paths(v) for v in value]  # type: ignore[reportUnknownVariableType]
    return value
