"""Explain a map of a run, or of a Dataset, by others: which maps these are, and their errors."""

import math
from collections.abc import Mapping

import numpy as np
import xarray as xr

from planish.analyze.explain import Explained, ModelMaps, explain_maps
from planish.analyze.params import ExplainParams
from planish.core.bands import thinned
from planish.core.checks import CORRELATION, POSITION
from planish.core.errors import InputError, PlanishError
from planish.core.grid import Grid
from planish.core.text import and_join
from planish.core.typing import Pair
from planish.marks.regions import read_regions
from planish.resample.maps import se_of_mean
from planish.run.named_maps import (
    EXPLAINED,
    NamedMaps,
    is_declared,
    maps_of,
    maps_of_dataset,
    named,
    trust_of_maps,
    with_answer,
)
from planish.run.regions import regions_on
from planish.run.run import Run


def explain_dataset(data: xr.Dataset, params: ExplainParams) -> Explained:
    """Explain a map of a Dataset on one grid by others; errors as of :func:`explain_run`."""
    check_model(params)
    maps = maps_of_dataset(data, "explain")
    errors = _errors_in(named(maps, params.response).group, params.cell_um)
    return _explained(params, maps, errors)


def _explained(params: ExplainParams, maps: NamedMaps, errors: Mapping[str, float]) -> Explained:
    """Explain the response by the other maps, whose standard errors over cells are given."""
    model_maps = _model_maps(params, maps, errors)
    return explain_maps(model_maps, cell_um=params.cell_um, corrected=params.corrected)


def explain_run(run: Run, params: ExplainParams) -> Explained:
    """Explain a map of a run by others of it, on its pixels.

    Raises
    ------
    InputError, SizeError, CannotMeasure
        As :func:`planish.analyze.explain.explain_maps`; if the run has no such map.
    """
    check_model(params)
    maps = maps_of(run)
    of_model = [named(maps, name) for name in (params.response, *params.of)]
    layers = [run.results.layer(m.layer) for m in of_model]
    has_sheet = any(layer.sheet is not None for layer in layers)
    errors: dict[str, float] = {}
    # Maps of one name, of two sheets, share no surface.
    if has_sheet and "surfaces" in run.groups:
        errors = _errors_in(run.groups["surfaces"], params.cell_um)
    explained = _explained(params, maps, errors)
    figures = (POSITION, CORRELATION) if run.results.is_link else ()
    trust = trust_of_maps(run, of_model, *figures)
    declared = is_declared(run.study.explain, params)
    return explained.model_copy(update={"trust": trust, "declared": declared})


def check_model(params: ExplainParams) -> None:
    """Raise InputError where a model names no map that explains, or one map twice."""
    names = [params.response, *params.of]
    if not params.is_declared:
        raise InputError("No map is given that explains the response. Name one or more with `of`.")
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(f"{and_join(twice)} is given twice. Name each map of a model once.")


def with_declared_model(run: Run) -> Run:
    """The same run with the model that its study declares, and its residuals as a map.

    Where there can be none the run stands, and its results say why.
    """
    params = run.study.explain
    if not params.is_declared:
        return run
    try:
        explained = explain_run(run, params)
    except PlanishError as fault:
        return with_answer(run, explain_reason=fault.text)
    response = named(maps_of(run), params.response)
    maps = xr.Dataset({"residual": residual_map(explained, response.values)})
    return with_answer(run, {EXPLAINED: maps}, explained=explained)


def residual_map(explained: Explained, like: xr.DataArray) -> xr.DataArray:
    """Residuals of a model on the pixels of a map: each pixel has that of its cell."""
    grid = Grid.of(like)
    half_um = explained.cell_um / 2
    residuals = explained.cells["residual"].reindex(
        cell_y=grid.y_um, cell_x=grid.x_um, method="nearest", tolerance=half_um
    )
    response = explained.response.replace("_", " ")
    attrs = {"units": explained.units, "long_name": f"What the model leaves of {response}"}
    coords = {dim: like[dim] for dim in like.dims}
    return xr.DataArray(residuals.values.astype(np.float32), coords, attrs=attrs)


def _model_maps(params: ExplainParams, maps: NamedMaps, errors: Mapping[str, float]) -> ModelMaps:
    """The maps of a model, the masks of all groups that they are of, and regions as factors.

    ``errors`` are standard errors over cells, by the names of maps. The sheet is the group of the
    first map that explains.
    """
    response = named(maps, params.response)
    response_values = response.values
    grid = Grid.of(response_values)
    predictors: dict[str, xr.DataArray] = {}
    groups = [response.group]
    for name in params.of:
        predictor = named(maps, name)
        values = predictor.values
        if values.dims != response_values.dims or values.shape != grid.shape:
            raise InputError(
                f"{name} has {values.shape} pixels, {params.response} has {grid.shape}."
                " Give maps on one grid (planish.resample_maps)."
            )
        predictors[name] = values
        groups.append(predictor.group)
    masks = {id(group): group["valid"] for group in groups if "valid" in group}
    return ModelMaps(
        response=response_values.rename(params.response),
        predictors=predictors | _factors(params, response_values, grid),
        masks=[*masks.values()],
        grid=grid,
        errors=errors,
        sheet=groups[1] if params.of else xr.Dataset(),
    )


def _factors(params: ExplainParams, like: xr.DataArray, grid: Grid) -> dict[str, xr.DataArray]:
    """The named regions of a file as maps of truth values."""
    if params.factors is None:
        return {}
    regions = regions_on(read_regions(params.factors), grid, params.factors)
    masks: dict[str, xr.DataArray] = {}
    for number, region in enumerate(regions.declared, 1):
        window, inside = region.inside(grid)
        values = np.zeros(grid.shape, dtype=bool)
        values[window] = inside
        name = region.name or f"region {number}"
        masks[name] = xr.DataArray(values, dims=like.dims)
    return masks


def _errors_in(data: xr.Dataset, cell_um: float) -> dict[str, float]:
    """Standard errors over cells of all maps and surfaces of a Dataset that it states."""
    pixel_um = Grid.of(data).pixel_um
    errors: dict[str, float] = {}
    for name in map(str, data):
        if name.endswith("_se"):
            error = _error_of_cells(data[name], cell_um, pixel_um)
            if math.isfinite(error):
                errors[name.removesuffix("_se")] = error
    return errors


def _error_of_cells(standard_errors: xr.DataArray, cell_um: float, pixel_um: Pair) -> float:
    """Standard error of the mean over a cell, from those of pixels.

    Where a map does not state the area that one value speaks for, pixels count as independent.
    """
    _, (errors,) = thinned(standard_errors)
    finite = errors[np.isfinite(errors)].astype(np.float64)
    if not finite.size:
        return math.nan
    if "patch_um2" in standard_errors.attrs:
        means = se_of_mean(finite, standard_errors.attrs, cell_um)
        return float(np.sqrt(np.mean(means**2)))
    pixels = cell_um**2 / math.prod(pixel_um)
    return float(np.sqrt(np.mean(finite**2) / max(pixels, 1.0)))
