"""Layers on one grid against each other: correlation, differences of equal quantities, other registrations."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.analyze import CorrelateParams, PairAtSizes, PairSums, holm, paired_difference
from planish.core.arrays import check_dataset
from planish.core.bands import any_finite, band_of, bands
from planish.core.errors import InputError, MarkError
from planish.core.facts import Side
from planish.core.grid import Grid, pitch, values_at
from planish.core.options import params_of
from planish.measure import PROPERTIES
from planish.pipeline.evidence import CELLS
from planish.pipeline.regions import regions_on
from planish.register import FittedTransform, fit_transform
from planish.resample import Mesh, resample
from planish.results import ComparisonRow, CorrelationRow

_LIMITS = 1.96  # standard deviations of differences that hold 95 % of normal ones (Bland and Altman 1986)
REGISTRATION_VARIANTS = (
    ("projection, no scale", ("projected_u", "projected_v"), "rigid"),
    ("projection, similarity", ("projected_u", "projected_v"), "similarity"),
    ("flattened, similarity", ("u", "v"), "similarity"),
)
"""Registrations of a sheet to an image that the paper compares: name, coordinates, model."""


def is_property(data: xr.DataArray) -> bool:
    """Whether a map is a measured property; standard errors, places and masks are none."""
    attrs = data.attrs
    return attrs.get("role") == "property" or ("support_um" in attrs and not str(data.name).endswith("_se"))


def _maps_to_correlate(maps: xr.Dataset) -> list[str]:
    """The maps of a layer that are correlated: its image, or all properties but angles and standard errors."""
    if "image" in maps and "thickness" not in maps:
        return ["image"]
    found = [str(k) for k, data in maps.data_vars.items() if is_property(data) and data.attrs.get("units") != "deg"]
    # A store gives its maps in the order of the alphabet: here they stand in one order, wherever they come from.
    usual = [*PROPERTIES]
    return sorted(found, key=lambda name: (usual.index(name) if name in usual else len(usual), name))


def correlate_maps(
    linked: xr.Dataset, *, params: CorrelateParams | None = None, names: tuple[str, str] = ("sheet", "image")
) -> tuple[CorrelationRow, ...]:  # fmt: skip
    """Correlate every property with the image, per pixel and over larger points.

    Parameters
    ----------
    linked : Dataset (y, x)
        Linked maps of :func:`planish.resample_maps`.
    params : CorrelateParams, optional
    names : (str, str)
        What the rows call the two layers.

    Returns
    -------
    tuple of CorrelationRow
        As ``results.correlations`` of a run.

    Raises
    ------
    FileError, InputError
        If ``params.regions`` are of no use, or come after a screen was taken off the image.
    """
    check_dataset(
        linked, "image", "valid", what="linked maps", call="pl.correlate_maps({})",
        maker="pl.resample_maps(measured, flat, onto=image, registration=registration)",
    )  # fmt: skip
    params = params_of(CorrelateParams, params, "pl.correlate_maps")
    regions = regions_on(params.regions, grid := Grid.of(linked))
    if regions is not None:
        if "reach_um" in linked["image"].attrs:
            raise InputError(
                "A screen was taken off the image before the regions were known, and what they hold has reached their "
                "neighbours. Give --regions to 'planish link' instead."
            )
        parts = [band_of(linked["valid"], at) & ~regions.inside(grid.part(at)) for at in bands(grid.shape[0])]
        linked = linked.assign(valid=(("y", "x"), np.concatenate(parts)))
    layers = {names[0]: linked.drop_vars("image"), names[1]: linked[["image", "valid"]]}
    return tuple(correlate_layers(*names, layers, params.point_um))


def correlate_layers(a: str, b: str, maps: dict[str, xr.Dataset], point_um: float) -> Iterator[CorrelationRow]:
    """Correlate two layers point by point, per pixel and over larger points.

    Two sheets: the same properties, with their differences. A sheet and an image: every property with the image.
    """
    first, second = maps[a], maps[b]
    names = [_maps_to_correlate(data) for data in (first, second)]
    sheets = all("image" not in n for n in names)
    pairs = [(n, n) for n in names[0] if n in names[1]] if sheets else [(m, n) for m in names[0] for n in names[1]]
    grid = Grid.of(first)
    sums = [PairAtSizes(grid.shape, pixel_um=grid.pixel_um, point_um=point_um, most_cells=CELLS) for _ in pairs]
    for rows in bands(grid.shape[0]):
        valid = band_of(first["valid"], rows) & band_of(second["valid"], rows)
        p, q = (
            {n: np.where(valid, band_of(data[n], rows), np.nan) for n in {pair[k] for pair in pairs}}
            for k, data in enumerate((first, second))
        )
        for one, (of_a, of_b) in zip(sums, pairs, strict=True):
            one.add(rows.start, p[of_a], q[of_b])
    found: list[CorrelationRow] = []
    for one, (of_a, of_b) in zip(sums, pairs, strict=True):
        at_sizes = [*one.sizes()]
        for row, own in at_sizes if at_sizes[0][0].n else []:
            more = _differences(own, str(first[of_a].attrs.get("units", "1"))) if sheets else {}
            found.append(CorrelationRow.holding(row, a=a, a_map=of_a, b=b, b_map=of_b, **more))
    for size in {row.point_um for row in found}:
        of_size = [k for k, row in enumerate(found) if row.point_um == size]
        for k, p in zip(of_size, holm([found[k].p for k in of_size]), strict=True):
            found[k] = found[k].model_copy(update={"p_of_table": p})
    yield from found


def _differences(sums: PairSums, units: str) -> dict[str, Any]:
    """Mean and spread of b - a, and the limits of agreement."""
    mean, sd = sums.difference
    limits = (mean - _LIMITS * sd, mean + _LIMITS * sd)
    return {"same_quantity": True, "difference_mean": mean, "difference_sd": sd, "limits": limits, "units": units}


def comparison_rows(
    linked: xr.Dataset, sheet: Mapping[str, xr.Dataset], fit: FittedTransform, *, name: str, point_um: float,
    away: Callable[[Grid], NDArray[np.bool_]],
) -> Iterator[ComparisonRow]:  # fmt: skip
    """The headline correlation by the registrations that the paper compares, and by that of the run.

    ``away`` says of the pixels of a grid whether they are away from holes.
    Least squares of all marks, as in the paper: marks that do not fit are what shows that a registration is wrong.
    """
    grid, measured = Grid.of(linked), sheet["surfaces"]
    ways: list[tuple[str, float, Mesh | None]] = []
    for title, names, model in REGISTRATION_VARIANTS:
        if model == fit.model and names == ("u", "v"):
            continue  # the run's own
        marks = fit.moving if names == ("u", "v") else values_at(sheet["maps"], names, fit.moving)
        if not np.isfinite(marks).all():
            raise MarkError("A mark lies outside the flattened sheet. Remove it from the table of marks.")
        way = fit_transform(marks, fit.fixed, model=model, mirrored=fit.mirrored, robust=False)
        uv = np.stack([sheet["flat"][axis].values for axis in names], axis=-1)
        ways.append((title, way.rms_um, Mesh.of(way.transform(uv), least_um=min(pitch(measured)))))
    ways.append((f"flattened, {fit.model}", fit.rms_um, None))
    sums = [PairAtSizes(grid.shape, pixel_um=grid.pixel_um, point_um=point_um, most_cells=CELLS) for _ in ways]
    for rows in bands(grid.shape[0]):
        part, image = grid.part(rows), band_of(linked["image"], rows)
        use, values = band_of(linked["valid"], rows), list[NDArray[Any]]()
        for _, _, mesh in ways:
            if mesh is None:
                values.append(band_of(linked[name], rows))
            else:
                under = mesh.under(part)
                values.append(resample(measured[name].values[under.nodes], under.places))
                use = use & away(part)
        # Rows that are compared are of the same pixels.
        use = np.logical_and.reduce([use, *(np.isfinite(v) for v in values)])
        for one, own in zip(sums, values, strict=True):
            one.add(rows.start, np.where(use, own, np.nan), image)
    (own_cells, cell_um), own_r = sums[-1].cells(), [found.r for found, _ in sums[-1].sizes()]
    own_points = sums[-1].points()
    for (title, rms_um, _), one in zip(ways, sums, strict=True):
        at_pixel, at_points = (found for found, _ in one.sizes())
        pairs = (one.cells()[0], own_cells, cell_um), (one.points(), own_points, (point_um, point_um))
        for found, r, (pair, own, pixel_um) in zip((at_pixel, at_points), own_r, pairs, strict=True):
            more: dict[str, Any] = {}
            if one is not sums[-1] and found.n:
                apart = paired_difference((pair[0], pair[1]), (own[0], own[1]), pixel_um=pixel_um)
                # The interval is told from cells, which may be larger than the pixels that r is of.
                moved = r - found.r - apart.difference
                low, high = (v + moved for v in apart.interval)
                more = {"difference": r - found.r, "difference_interval": (low, high)}
            yield ComparisonRow.holding(found, registration=title, property=name, marks_rms_um=rms_um, **more)


def headline_of(maps: xr.Dataset, side: Side = "top", wanted: str | None = None) -> str:
    """The map that stands for a layer: an image itself, what the study names, the coating that is seen, the thickness.

    Raises
    ------
    InputError
        If the study names a map that the sheet does not have.
    """
    if "thickness" not in maps:
        return "image"
    if wanted is not None:
        if wanted not in maps:
            raise InputError(f"The sheet has no map {wanted!r} to lead. It has {', '.join(_maps_to_correlate(maps))}.")
        return wanted
    coating = f"coating_{side}"
    return coating if any_finite(maps[coating]) else "thickness"
