"""Which properties a run measures beside the six of the faces, and the numbers that are no maps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, fields
from typing import Any

import numpy as np
import xarray as xr

from planish.compute import Compute
from planish.core.errors import CannotMeasure
from planish.core.grid import pitch
from planish.measure import (
    PROPERTIES,
    Densities,
    RayOptions,
    depth_profiles,
    measure_along_rays,
    roughness_numbers,
    scale_limited,
    thin_fraction,
    two_sidedness,
)
from planish.study import PropertiesSection

ALWAYS = ("warp", "tilt")
"""Maps that cost no look at the volume and need no number from the user."""

_PARTS = ("fibre_cos2", "fibre_sin2")  # an angle has no mean; its two parts do


def ray_options(section: PropertiesSection) -> RayOptions:
    """Return what the study says as the stage wants it.

    Raises
    ------
    CannotMeasure
        If a number is none.
    """
    told = section.model_dump()
    densities = Densities(**{f.name: told[f.name] for f in fields(Densities)})
    return RayOptions(densities=densities, **{f.name: told[f.name] for f in fields(RayOptions) if f.name in told})


def chosen_maps(section: PropertiesSection, surfaces: xr.Dataset) -> list[str]:
    """Name the maps that are measured: those that cost nothing, those whose numbers are given, those asked for."""
    coated = [side for side in ("top", "bottom") if np.isfinite(surfaces[f"interface_{side}"].values).any()]
    weighed = {"top": section.coat_weight_top_g_m2, "bottom": section.coat_weight_bottom_g_m2}
    names: list[str] = [*ALWAYS]
    names += [f"coat_weight_{side}" for side in coated if section.coating_g_cm3 or weighed[side]]
    phases = section.base_g_cm3 is not None and (not coated or section.coating_g_cm3 is not None)
    if section.grammage_g_m2 is not None or phases:
        names += ["grammage", "apparent_density"]
    if section.solid_grey is not None or section.void_grey is not None:
        names.append("porosity")
    if section.filler_grey is not None:
        names.append("filler")
    if section.ink_grey is not None:
        names += ["ink_depth_50", "ink_depth_90", "ink_depth_95"]
    names += section.maps
    if "fibre_angle" in names:
        names += _PARTS
    return [name for name in dict.fromkeys(names) if name not in PROPERTIES]


def measure_more(
    volume: xr.DataArray,
    surfaces: xr.Dataset,
    section: PropertiesSection,
    compute: Compute,
    tell: Callable[[str, str], None],
) -> xr.Dataset:
    """Measure the maps of :func:`chosen_maps`; returns them with their standard errors and reasons.

    Raises
    ------
    CannotMeasure
        If a map is unknown, or needs a number that is not given.
    """
    names = chosen_maps(section, surfaces)
    tell("properties", ", ".join(names))
    return measure_along_rays(
        volume, surfaces, names=names, options=ray_options(section), rays=section.rays,
        memory_bytes=compute.memory // 4, threads=compute.threads,
    )  # fmt: skip


def further_maps(surfaces: xr.Dataset) -> list[str]:
    """Names of the maps in a dataset beside the six of the faces, and of their standard errors where there are any."""
    maps = [str(name) for name, data in surfaces.data_vars.items() if "support_um" in data.attrs]
    errors = [f"{name}_se" for name in maps if f"{name}_se" in surfaces]
    return maps + [name for name in errors if np.isfinite(surfaces[name].values).any()]


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


def number_results(volume: xr.DataArray, surfaces: xr.Dataset, section: PropertiesSection) -> dict[str, Any]:
    """What describes the sheet in numbers: thin and bare shares, roughness, two-sidedness, profiles in depth."""
    out: dict[str, Any] = {}
    options = ray_options(section)
    step = pitch(surfaces)
    for side in ("top", "bottom"):
        coating = surfaces[f"coating_{side}"]
        if np.isfinite(coating.values).any():
            found = thin_fraction(coating.assign_attrs(support_um=float(np.sqrt(step[0] * step[1]))))
            out[f"thin_{side}"] = {
                "thinner_than_um": [float(v) for v in found["marked"].values],
                "share": [float(v) for v in found["marked_share"].values],
                "support_um": float(found.attrs["support_um"]),
                "warning": found.attrs.get("warning"),
            }
        filters = {"s_filter_um": options.s_filter_um, "l_filter_um": options.l_filter_um}
        try:
            limited = scale_limited(surfaces[f"topography_{side}"].values, step, **filters)
            numbers = asdict(roughness_numbers(limited, step, **filters))
            out[f"roughness_{side}"] = {k: _plain(v) for k, v in numbers.items()}
        except CannotMeasure as reason:
            # A field smaller than the filters has no roughness; that is said, and is no fault of the run.
            out[f"roughness_{side}"] = {"reason": str(reason)}
    out["two_sides"] = {k: _plain(v) for k, v in two_sidedness(surfaces).items()}
    profiled = [name for name in ("porosity", "filler") if name in surfaces]
    if profiled:
        found = depth_profiles(volume, surfaces, names=profiled, options=options, rays=section.rays)
        out["profiles"] = {"depth": [float(v) for v in found["depth"].values]} | {
            name: [_plain(float(v)) for v in found[name].values] for name in profiled
        }
    return out


def _plain(value: Any) -> Any:
    return (float(value) if np.isfinite(value) else None) if isinstance(value, (float, np.floating)) else value
