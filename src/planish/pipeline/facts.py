"""Results of the stages, put into the models of ``results.json``."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.analyze import LagNumbers
from planish.core.bands import band_of, bands, thinned
from planish.core.facts import InputFile, Side
from planish.core.grid import Grid, pitch
from planish.io import fingerprint
from planish.pipeline.compare import headline_of, is_property
from planish.pipeline.compared import image_facts
from planish.pipeline.layers import Layer
from planish.pipeline.position_error import error_shares
from planish.pipeline.registration import Registration
from planish.register import Chain, FittedTransform
from planish.results import (
    ExpectedError,
    LayerFacts,
    LinkedArea,
    OrientationFacts,
    PropertyFacts,
    RegistrationFacts,
    SectionFacts,
    SurfaceFacts,
)
from planish.study import Study, to_dict, with_paths

Array = NDArray[np.float64]


class Link(NamedTuple):
    """How a layer comes to the reference: its registration to the next layer of the path, and all of them composed."""

    path: list[Layer]
    registration: Registration
    chain: Chain


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
        error = surfaces.get(f"{name}_se")
        errors = np.empty(0) if error is None else error.values[np.isfinite(error.values)].astype(np.float64)
        more = {} if error is None or not errors.size else _of_mean(errors, error.attrs, pitch(surfaces))
        found[str(name)] = PropertyFacts(
            units=str(data.attrs["units"]), n=int(values.size), mean=float(values.mean()), sd=float(values.std()),
            p5=float(p5), median=float(p50), p95=float(p95), support_um=data.attrs.get("support_um"),
            standard_error=float(np.median(errors)) if errors.size else None, **more,
        )  # fmt: skip
    return found


def _of_mean(errors: Array, attrs: dict[str, Any], pitch_um: tuple[float, float]) -> dict[str, Any]:
    """How many independent values the columns have, and the standard error of their mean; both None if not known."""
    if "patch_um2" not in attrs:
        return {}
    count = max(1.0, errors.size * min(1.0, pitch_um[0] * pitch_um[1] / float(attrs["patch_um2"])))
    common = float(attrs["common_um"])
    own = float(np.mean(np.maximum(errors**2 - common**2, 0.0)))
    return {"n_independent": int(count), "mean_standard_error": float(np.sqrt(own / count + common**2))}


def section_facts(sections: xr.Dataset) -> SectionFacts:
    """How serial sections were joined."""
    attrs, aligned = sections.attrs, sections["aligned"].values
    rms = [float(np.sqrt(np.mean(sections[f"shift_{axis}"].values[aligned] ** 2))) for axis in ("row", "col")]
    row, col = (float(v) for v in attrs["jitter_left_um"])
    known = {k: v for k, v in attrs.items() if k in SectionFacts.model_fields}
    return SectionFacts.model_validate(known | {
        "count": int(aligned.size), "not_aligned": int(np.count_nonzero(~aligned)),
        "gain_sd": float(np.std(sections["gain"].values[aligned])), "shift_row_rms_um": rms[0],
        "shift_col_rms_um": rms[1], "jitter_left_row_um": row, "jitter_left_col_um": col,
    })  # fmt: skip


def layer_facts(
    layer: Layer, maps: xr.Dataset, link: Link | None, side: Side, lag: LagNumbers | None, headline: str | None
) -> LayerFacts:  # fmt: skip
    """What a layer is, how much of the reference it covers, and how it was registered.

    ``side`` is that which shows, ``headline`` the map of sheets that the study names.
    """
    shown = maps["volume_z" if layer.kind == "sheet" else "image"]
    known = sum(int(np.count_nonzero(np.isfinite(band_of(shown, rows)))) for rows in bands(shown.shape[0]))
    return LayerFacts(
        name=layer.name, kind=layer.kind, source=layer.source, headline=headline_of(maps, side, headline),
        share_of_reference=known / shown.size, sheet=layer.facts,
        image=None if layer.params.image is None else image_facts(layer.params.image),
        registration=None if link is None else _registration_facts(layer, link, maps, lag),
    )  # fmt: skip


def _registration_facts(layer: Layer, link: Link, maps: xr.Dataset, lag: LagNumbers | None) -> RegistrationFacts:
    found, fit = link.registration, link.registration.fit
    _, (error,) = thinned(maps["expected_error"])
    known = error[np.isfinite(error)]
    return RegistrationFacts(
        to=link.path[1].name, path=tuple(layer.name for layer in link.path), source=found.source,
        found_moving=found.count("moving"), found_fixed=found.count("fixed"),
        matched=int(np.count_nonzero(fit.robust_weights)), second_best=found.second_best,
        match_sentence=found.sentence, design=found.design, tilt=found.tilt, model=fit.model,
        model_sentence=fit.sentence, warnings=fit.warnings, rms_um=fit.rms_um,
        leave_one_out_rms_um=fit.leave_one_out_rms_um, scale=fit.transform.scale, mirrored=fit.mirrored,
        expected_error=ExpectedError(
            median_um=np.median(known), largest_um=known.max(), shares=error_shares(maps)
        ) if known.size else None,
        rotation_deg=float(np.rad2deg(fit.transform.rotation_rad)), shift_um=fit.transform.shift_um,
        orientation=orientation_facts(layer, link.path[1], fit), lag=lag,
    )  # fmt: skip


def orientation_facts(moving: Layer, fixed: Layer, fit: FittedTransform) -> OrientationFacts:
    """How two registered layers lie on each other: side, hand and machine direction, as given; nothing is guessed."""
    numbered_back = fit.mirrored != (moving.side != fixed.side)
    carried = None if moving.md_deg is None else _machine_direction(fit, moving.md_deg)
    words = [
        f"Side of the {layer.name} not given; top side assumed (--image-side)."
        if layer.side_given is None
        else f"The {layer.name} shows the {layer.side} side of the sheet, as given."
        for layer in (moving, fixed)
        if layer.kind == "image"
    ]
    if numbered_back:
        words.append(f"The marks fit mirrored only: the {moving.name} is numbered against the usual sense.")
    if carried is not None:
        given = "." if fixed.md_deg is None else f"; {_angle(fixed.md_deg)} was given there."
        words.append(
            f"The machine direction lies at {_angle(moving.md_deg)} in the {moving.name} and so at {_angle(carried)} "
            f"in the {fixed.name}{given}"
        )
    elif fixed.md_deg is not None:
        words.append(
            f"The machine direction lies at {_angle(fixed.md_deg)} in the {fixed.name}, as given; none was given for "
            f"the {moving.name}."
        )
    else:
        words.append("Machine direction not given (--md-deg, --image-md-deg).")
    return OrientationFacts(
        image_side=fixed.side, side_given=fixed.side_given is not None or fixed.kind == "sheet",
        mirrored_volume=numbered_back, md_deg_moving=moving.md_deg, md_deg_fixed=fixed.md_deg,
        md_deg_fixed_from_moving=carried, sentence=" ".join(words),
    )  # fmt: skip


def _machine_direction(fit: FittedTransform, md_deg: float) -> float:
    """Carry an axis (deg clockwise on screen from x) over to the fixed layer; 0 to 180."""
    angle = np.deg2rad(md_deg)
    x, y = fit.transform.matrix() @ (np.cos(angle), np.sin(angle))
    return float(np.rad2deg(np.arctan2(y, x)) % 180.0)


def _angle(deg: float | None) -> str:
    return f"{(deg or 0.0) % 180.0:.1f}".removesuffix(".0") + "°"


def linked_area(linked: xr.Dataset, away: Callable[[Grid], NDArray[np.bool_]]) -> LinkedArea:
    """How much of the reference shows the sheet, and how much of that is valid."""
    grid, on_sheet, valid, on_sheet_away = Grid.of(linked), 0, 0, 0
    for rows in bands(grid.shape[0]):
        here = np.isfinite(band_of(linked["u"], rows))
        on_sheet += int(np.count_nonzero(here))
        on_sheet_away += int(np.count_nonzero(here & away(grid.part(rows))))
        valid += int(np.count_nonzero(band_of(linked["valid"], rows)))
    pixels = grid.shape[0] * grid.shape[1]
    return LinkedArea(
        pixels=pixels, share_on_sheet=on_sheet / pixels, share_valid=valid / pixels,
        share_valid_of_sheet=valid / max(on_sheet, 1), share_valid_away_from_holes=valid / max(on_sheet_away, 1),
    )  # fmt: skip


def parameters(study: Study) -> dict[str, Any]:
    """All parameters but the paths of inputs, which say where files lie and not what was done."""
    return to_dict(with_paths(study, lambda _: None))
