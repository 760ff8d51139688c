"""Layers on one grid against each other: correlation, differences of equal quantities, lag, ways of registering."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.analyze import Correlation, correlate, correlate_at, masked_lag
from planish.core.checks import is_property
from planish.core.errors import MarkError, SizeError
from planish.core.grid import Grid, pitch, values_at
from planish.core.results import ComparisonRow, CorrelationRow, LagFacts, Side
from planish.measure import PROPERTIES
from planish.pipeline.facts import lag_facts
from planish.pipeline.onto import FlatSheet, headline_of
from planish.pipeline.registration import Registration
from planish.register import fit_transform
from planish.resample import find_places, resample

Array = NDArray[np.float64]

_FEW = 12  # points
_LIMITS = 1.96  # standard deviations of differences that hold 95 % of normal ones (Bland and Altman 1986)
_REACH_UM, _COARSEST_UM, _TILE_UM, _SURROGATES = 150.0, 1000.0, 1000.0, 99

WAYS = (
    ("projection, no scale", ("projected_u", "projected_v"), "rigid"),
    ("projection, similarity", ("projected_u", "projected_v"), "similarity"),
    ("flattened, similarity", ("u", "v"), "similarity"),
)
"""Ways of bringing a sheet to an image that the paper compares: name, coordinates, model."""


def maps_to_correlate(maps: xr.Dataset) -> list[str]:
    """The maps of a layer that are correlated: its image, or all properties but angles and standard errors."""
    if "image" in maps and "thickness" not in maps:
        return ["image"]
    found = [str(k) for k, data in maps.data_vars.items() if is_property(data) and data.attrs.get("units") != "deg"]
    # A store gives its maps in the order of the alphabet: here they stand in one order, wherever they come from.
    usual = [*PROPERTIES]
    return sorted(found, key=lambda name: (usual.index(name) if name in usual else len(usual), name))


def correlate_layers(
    a: str, b: str, maps: dict[str, xr.Dataset], point_um: float
) -> Iterator[CorrelationRow]:  # fmt: skip
    """Correlate two layers point by point, per pixel and over larger points.

    Two sheets: the same properties, with their differences. A sheet and an image: every property with the image.
    """
    first, second = maps[a], maps[b]
    names = [maps_to_correlate(data) for data in (first, second)]
    sheets = ["image" not in n for n in names]
    pairs = [(n, n) for n in names[0] if n in names[1]] if all(sheets) else [(m, n) for m in names[0] for n in names[1]]
    valid = first["valid"].values & second["valid"].values
    pixel = Grid.of(first).pixel_um
    for of_a, of_b in pairs:
        p, q = (np.where(valid, d[n].values.astype(np.float64), np.nan) for d, n in ((first, of_a), (second, of_b)))
        if not (np.isfinite(p) & np.isfinite(q)).any():
            continue
        fine = correlate(p, q, point_um=float(np.sqrt(pixel[0] * pixel[1])))
        coarse, *means = correlate_at(p, q, pixel_um=pixel, point_um=point_um)
        for found, (u, v) in ((fine, (p, q)), (coarse, means)):
            row = CorrelationRow(a=a, a_map=of_a, b=b, b_map=of_b, **_numbers(found))
            yield _with_differences(row, u, v, str(first[of_a].attrs.get("units", "1"))) if all(sheets) else row


def _numbers(found: Correlation) -> dict[str, Any]:
    return {k: getattr(found, k) for k in ("n", "r", "r2", "slope", "intercept", "point_um")}


def _with_differences(row: CorrelationRow, a: Array, b: Array, units: str) -> CorrelationRow:
    """Mean and spread of b - a, and the limits of agreement."""
    off = (b - a)[np.isfinite(a) & np.isfinite(b)]
    mean = float(off.mean()) if off.size else None
    sd = float(off.std(ddof=1)) if off.size > 1 else None
    limits = None if mean is None or sd is None else (mean - _LIMITS * sd, mean + _LIMITS * sd)
    known = {"same_quantity": True, "difference_mean": mean, "difference_sd": sd, "limits": limits, "units": units}
    return row.model_copy(update=known)


def likeness(a: xr.Dataset, b: xr.Dataset, point_um: float) -> dict[str, float] | None:
    """How much two sheets look like one: r of their thickness, and of their coatings side by side and crosswise.

    Over points of ``point_um``, or pixels where too few of those are known. None for others than two sheets.
    """
    if "thickness" not in a or "thickness" not in b:
        return None
    pixel = Grid.of(a).pixel_um
    valid = a["valid"].values & b["valid"].values

    def r(of_a: str, of_b: str) -> float:
        p, q = (np.where(valid, d[n].values.astype(np.float64), np.nan) for d, n in ((a, of_a), (b, of_b)))
        coarse = correlate_at(p, q, pixel_um=pixel, point_um=point_um)[0]
        return coarse.r if coarse.n >= _FEW else correlate(p, q, point_um=point_um).r

    sides = ("coating_top", "coating_bottom")
    return {
        "thickness": r("thickness", "thickness"),
        "same_sides": float(np.mean([r(side, side) for side in sides])),
        "crosswise": float(np.mean([r(sides[k], sides[1 - k]) for k in (0, 1)])),
    }


def lag_of(a: xr.Dataset, b: xr.Dataset, side: Side) -> LagFacts | None:
    """Whether two layers agree by their own texture that they lie right; None where there are too few pixels."""
    name, other = headline_of(a, side), headline_of(b, side)
    valid, pixel = a["valid"].values & b["valid"].values, Grid.of(a).pixel_um
    error = a["expected_error"].values
    shown = error[np.isfinite(error) & valid].astype(np.float64)
    short = min(n * um for n, um in zip(valid.shape, pixel, strict=True))
    try:
        lag = masked_lag(
            a[name].values.astype(np.float64), b[other].values.astype(np.float64), valid, pixel,
            reach_um=min(_REACH_UM, short / 4), band_um=(None, _COARSEST_UM),
            tiles_um=_TILE_UM if short >= 2 * _TILE_UM else None, surrogates=_SURROGATES,
        )  # fmt: skip
    except SizeError:
        return None
    return lag_facts(lag, expected_um=float(np.sqrt(np.mean(shown**2))) if shown.size else None, name=name)


def comparison_rows(
    linked: xr.Dataset, sheet: FlatSheet, registration: Registration, *, name: str, point_um: float,
    away: NDArray[np.bool_],
) -> Iterator[ComparisonRow]:  # fmt: skip
    """The headline correlation by the ways that the paper compares, and by the registration of the run.

    Least squares of all marks, as in the paper: marks that do not fit are what shows that a way is wrong.
    """
    fit, grid = registration.fit, Grid.of(linked)
    brightness = linked["image"].values.astype(np.float64)
    for title, names, model in WAYS:
        if model == "similarity" and names == ("u", "v") and fit.model == "similarity":
            continue  # the run's own
        marks = fit.moving if names == ("u", "v") else _projected(sheet, fit.moving)
        way = fit_transform(marks, fit.fixed, model=model, mirrored=fit.mirrored, robust=False)
        uv = np.stack([sheet.flat[axis].values for axis in names], axis=-1)
        places = find_places(way.transform(uv), grid, least_um=min(pitch(sheet.measured)))
        prop = np.where(away, resample(sheet.measured[name].values, places), np.nan)
        yield from _rows(title, name, way.rms_um, prop, brightness, grid, point_um)
    own = np.where(linked["valid"].values, linked[name].values.astype(np.float64), np.nan)
    yield from _rows(f"flattened, {fit.model}", name, fit.rms_um, own, brightness, grid, point_um)


def _projected(sheet: FlatSheet, points: Array) -> Array:
    """Where points of the flat sheet lie in its projection."""
    assert sheet.maps is not None
    found = values_at(sheet.maps, ("projected_u", "projected_v"), points)
    if not np.isfinite(found).all():
        raise MarkError("A mark lies outside the flattened sheet. Remove it from the table of marks.")
    return found


def _rows(
    title: str, name: str, rms_um: float, a: Array, b: Array, grid: Grid, point_um: float
) -> Iterator[ComparisonRow]:  # fmt: skip
    pixel = grid.pixel_um
    for found in (
        correlate(a, b, point_um=float(np.sqrt(pixel[0] * pixel[1]))),
        correlate_at(a, b, pixel_um=pixel, point_um=point_um)[0],
    ):
        yield ComparisonRow(registration=title, property=name, marks_rms_um=rms_um, **_numbers(found))
