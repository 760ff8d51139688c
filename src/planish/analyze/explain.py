"""How much of a property each of several maps explains, on cells of a stated size.

A multiple regression whose errors know that cells are neighbours, and what stands beside it: other
cell sizes, ranks, a covariance of residuals as weights, errors that predictors share.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Annotated, Any

import numpy as np
import xarray as xr
from pydantic import Field
from pydantic.json_schema import SkipJsonSchema

from planish.analyze.cells import CellColumn, columns_of, means_over_cells
from planish.analyze.correlation import LEAST_CLAIMED
from planish.analyze.differences import holm
from planish.analyze.distributions import ranks, sign_of
from planish.analyze.generalised_least_squares import ExponentialCovariance, weighed_regression
from planish.analyze.multiple_regression import Regression, out_of_sample_r2, regress
from planish.analyze.quadratic_field import points_of
from planish.analyze.shared_errors import SharedError, bare_name, covariance_of_errors, sharings_of
from planish.analyze.variograms import Variogram, variogram_of
from planish.core.bands import Rows
from planish.core.errors import CannotMeasure, InputError, SizeError
from planish.core.facts import NULL, DescribedModel, Interval, Trust, Value
from planish.core.grid import Grid
from planish.core.text import and_join
from planish.core.typing import Array, Entries, Floats, Ints, Texts
from planish.measure.registry import NEGATIVE_CONTROLS, SUMS, shared_parts
from planish.texture.covariance import Lags

COLLINEAR = 10.0
"""Variance inflation from which the field calls predictors collinear."""

_IS_SUM = 1e6  # variance inflation that no two measured maps reach: a thousandth of sd is left
_SIZES = np.array([0.25, 0.5, 1.0, 2.0, 4.0])  # of the curve, in declared cells
_LEFT = 3.0  # ranges after which a twentieth of an exponential covariance is left


class CoefficientFacts(DescribedModel):
    """What one predictor adds, the others held; of a field, or over sheets."""

    title: str = ""
    """Title of the predictor."""
    units: str = "1"
    """Unit of the predictor."""
    standardised: Value
    """Standard deviations of the response per standard deviation of the predictor."""
    interval: Interval = NULL
    """95 % interval of the standardised coefficient."""
    plain: Value
    """Units of the response per unit of the predictor."""
    plain_interval: Interval = NULL
    """95 % interval of the plain coefficient."""
    p: Value = NULL
    """Of the test that the true one is 0."""
    p_of_set: Value = NULL
    """The same after Holm, over all predictors."""

    @property
    def direction(self) -> int:
        """1 or -1 where the interval excludes 0, else 0."""
        return sign_of(self.interval)


class Coefficient(CoefficientFacts):
    """What one predictor adds in one field, the others held."""

    standard_error: Value = NULL
    """Of the standardised coefficient."""
    n_eff: Value = NULL
    """Independent cells for this coefficient."""
    vif: Value = NULL
    """Variance inflation: how much the other predictors widen the interval."""
    unique: Value = NULL
    """Share of the response's variance that it alone explains."""
    rank: Value = NULL
    """The standardised coefficient over the ranks of all maps."""
    weighed: Value = NULL
    """The standardised coefficient by generalised least squares, with the covariance of the
    residuals as weights."""
    by_errors: Value = NULL
    """What the stated errors of the maps add to the plain coefficient; it is taken off where the
    model is corrected."""


class SharedPart(DescribedModel):
    """Two maps of a model that contain the same map by construction."""

    a: str
    """First map."""
    b: str
    """Second map."""
    parts: Texts
    """The largest maps that both contain."""


class CellSizeRow(DescribedModel):
    """The model over cells of one size."""

    cell_um: float
    """Edge of a cell."""
    n: int
    """Cells."""
    n_eff: Value = NULL
    """Independent cells."""
    r2: Value = NULL
    """Share of the variance that is explained."""
    standardised: dict[str, Value] = Field(default={})
    """Coefficients by predictor."""
    intervals: dict[str, Interval] = Field(default={})
    """Their 95 % intervals."""
    reason: str = ""
    """Why there is no model of that size."""


class ModelFacts(DescribedModel):
    """A response explained by several maps; of a field, or over sheets."""

    response: str
    """Map that is explained."""
    title: str = ""
    """Its title."""
    units: str = "1"
    """Its unit."""
    of: Texts
    """Maps that explain it."""
    cell_um: float
    """Edge of a cell."""
    corrected: bool = False
    """Whether the stated errors of the maps were taken off."""
    declared: bool | None = None
    """Whether the study of the run declared this model before it was run; none without a study."""
    n: int
    """Cells with a value in all maps. Neighbours resemble each other."""
    n_eff: Value
    """Independent cells, of the coefficient with the fewest."""
    r2: Value
    """Share of the variance that all predictors explain together."""
    r2_out: Value = NULL
    """The same of blocks that the model was not fitted to."""
    lead: Value = NULL
    """Size of the largest standardised coefficient less that of the next one."""
    lead_interval: Interval = NULL
    """Its 95 % interval."""


class Explained(ModelFacts):
    """A response explained by several maps, on cells of one size."""

    block_um: Value = NULL
    """Width of these blocks, beyond the reach of the residuals."""
    residuals: Variogram | None = None
    """How far its residuals resemble each other."""
    intercept: Value
    """Of the plain model."""
    shared: Value = NULL
    """Share of the variance that the predictors explain only together."""
    coefficients: dict[str, Coefficient]
    """By predictor."""
    sizes: tuple[CellSizeRow, ...] = ()
    """The same over other cells."""
    shared_errors: tuple[SharedError, ...] = ()
    """Predictors whose errors go together."""
    shared_parts: tuple[SharedPart, ...] = ()
    """Maps of the model that contain the same map."""
    controls: Texts = ()
    """Predictors that are no property of the sheet: negative controls."""
    trust: Trust = "ok"
    """What the checks of the run leave of it."""
    reason: str = ""
    """Why a number is missing."""
    #: Dataset (cell_y, cell_x): means over cells, residual, and each predictor freed of the others.
    cells: Annotated[SkipJsonSchema[Any], Field(exclude=True)] = None
    """Cells of the fit, for figures; only in Python."""


def strongest(coefficients: Mapping[str, CoefficientFacts]) -> list[str]:
    """Predictors by the size of their standardised coefficients, the largest first."""
    return sorted(coefficients, key=lambda name: -abs(coefficients[name].standardised))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ModelMaps:
    """The maps of a model on one grid, and what is known of their errors."""

    response: xr.DataArray
    predictors: Mapping[str, xr.DataArray]
    masks: Sequence[Rows] = ()
    grid: Grid
    #: Standard errors of the means over a cell, of maps and surfaces; by name.
    errors: Mapping[str, float] = field(default_factory=dict[str, float])
    #: All maps of the sheet, by which parts that maps share are named.
    sheet: xr.Dataset = field(default_factory=xr.Dataset)


def explain_maps(maps: ModelMaps, *, cell_um: float, corrected: bool = False) -> Explained:
    """Explain a map by others, on cells of one size.

    Parameters
    ----------
    maps : ModelMaps; response and predictors on one grid, with the errors that are stated of them
    cell_um : float, in um; edge of the cells of the model, whose other sizes stand beside it
    corrected : bool; whether the stated errors are taken off

    Returns
    -------
    Explained

    Raises
    ------
    InputError
        If a predictor is a sum of others, or the response of all of them.
    SizeError
        If a cell is smaller than a pixel, or larger than the field.
    CannotMeasure
        If there are fewer than 10 independent cells for each coefficient, a map is constant, or the
        stated errors are as large as the maps' own variation.
    """
    sizes_um = _cell_sizes(maps.grid, cell_um)
    # The response is the first column; a factor has several.
    response = CellColumn(name=str(maps.response.name), values=maps.response)
    columns = [response]
    for name, values in maps.predictors.items():
        columns += columns_of(name, values)
    pixel_um = maps.grid.pixel_um
    cells_by_size = means_over_cells(columns, maps.masks, pixel_um=pixel_um, sizes_um=sizes_um)
    means_by_size = dict(zip(sizes_um, cells_by_size, strict=True))
    cells = _Cells.of(columns, means_by_size.pop(cell_um), cell_um)
    _refuse_sums(cells)
    # (k + 1, k + 1), the response as the last; 0 where no error is stated.
    errors = covariance_of_errors([*cells.names, response.name], maps.errors)
    if corrected and not errors.any():
        raise InputError(
            "No map of this model has a stated error, so nothing can be corrected. Take maps with"
            " a standard error (NAME_se), or leave `corrected` out."
        )
    model = _bearable(cells, errors if corrected else None)
    curve = _variogram_of_residuals(cells, model)
    coefficients = _coefficients(cells, model, errors, curve, corrected=corrected)
    names = [*maps.predictors]
    controls = [name for name in names if bare_name(name) in NEGATIVE_CONTROLS]
    shared_errors = sharings_of(cells.names, errors[:-1, :-1])
    rows = [_row_of(cells, model)]
    for size_um, means in means_by_size.items():
        rows.append(_size_row(_Cells.of(columns, means, size_um)))
    rows.sort(key=lambda row: row.cell_um)
    return Explained(
        response=response.name,
        title=response.title,
        units=response.units,
        of=tuple(names),
        cell_um=cell_um,
        corrected=corrected,
        n=cells.lags.n,
        n_eff=model.n_eff.min(),
        r2=model.r2,
        intercept=model.intercept,
        shared=model.r2 - model.unique.sum(),
        coefficients=coefficients,
        sizes=tuple(rows),
        shared_errors=shared_errors,
        shared_parts=_parts_in_common(names, maps.sheet),
        controls=tuple(controls),
        cells=_dataset(cells, model, maps.grid),
        **_of_residuals(cells, curve),
        **_lead_of(model),
    )


def _cell_sizes(grid: Grid, cell_um: float) -> list[float]:
    """Edges of the cells of the curve, from a pixel to the field; SizeError for one beyond."""
    pixel_um = max(grid.pixel_um)
    sides_um = np.multiply(grid.shape, grid.pixel_um)
    field_um = sides_um.min()
    least_um = pixel_um * (1 - 1e-9)
    if not least_um <= cell_um <= field_um:
        raise SizeError(
            f"A cell of {cell_um:g} um is smaller than a pixel of {pixel_um:g} um, or larger than"
            f" the field, {field_um:g} um. Give cells between these."
        )
    return [size_um for size_um in cell_um * _SIZES if least_um <= size_um <= field_um]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Cells:
    """Means over cells of one size."""

    columns: Sequence[CellColumn]  # the response first
    maps: Sequence[Floats]
    cell_um: float
    lags: Lags

    @classmethod
    def of(cls, columns: Sequence[CellColumn], maps: Sequence[Floats], cell_um: float) -> _Cells:
        lags = Lags(np.isfinite(maps[0]), (cell_um, cell_um))
        return cls(columns=columns, maps=maps, cell_um=cell_um, lags=lags)

    @property
    def names(self) -> list[str]:
        """Names of the predictors."""
        return [column.name for column in self.columns[1:]]

    @property
    def fault(self) -> str:
        """Why there can be no model; empty where there can."""
        least = LEAST_CLAIMED * len(self.names)
        if self.lags.n < least:
            return (
                f"{self.lags.n} cells of {self.cell_um:g} um have a value in all maps;"
                f" {least:.0f} are needed for {len(self.names)} coefficients."
            )
        for column, values in zip(self.columns, self.maps, strict=True):
            if not np.ptp(values[self.lags.is_valid]) > 0:
                return f"{column.name} is the same in all {self.lags.n} cells."
        return ""

    def fit(self, errors: Floats | None = None) -> Regression:
        """The model over these cells; CannotMeasure where there can be none."""
        if self.fault:
            raise CannotMeasure(f"{self.fault} Look at the masks, or give smaller cells.")
        response, *predictors = self.maps
        return regress(response, predictors, self.lags, errors)

    def ranked(self) -> _Cells:
        """The same with ranks in the place of all quantities; shares of a factor stay."""
        is_valid = self.lags.is_valid
        ranked_maps: list[Floats] = []
        for column, values in zip(self.columns, self.maps, strict=True):
            ranked = values.copy()
            if not column.is_factor:
                ranked[is_valid] = ranks(values[is_valid])
            ranked_maps.append(ranked)
        return replace(self, maps=ranked_maps)


def _refuse_sums(cells: _Cells) -> None:
    """Raise InputError where a map of a model is a sum of predictors; the message names it.

    Cells without a model are not looked at: the reason is another one.
    """
    if cells.fault:
        return
    columns = [m[cells.lags.is_valid] for m in cells.maps]
    values = np.stack(columns, axis=1)
    values = (values - values.mean(axis=0)) / values.std(axis=0)
    names = [column.name for column in cells.columns]
    sums = {row[0] for row in SUMS}
    # A sum goes before its parts, and the response, which is column 0, is the last.
    predictors = sorted(range(1, len(names)), key=lambda k: names[k] not in sums)
    for index in (*predictors, 0):
        parts = [names[k] for k in _parts_of(values, index)]
        if not parts:
            continue
        advice = (
            f"beside them its coefficient means nothing. Leave {names[index]}, or one of its parts,"
            " out."
        )
        if index == 0:
            advice = (
                "there is nothing to explain. Leave one of the parts out, or take another response."
            )
        raise InputError(f"{names[index]} is a sum of {and_join(parts)}: {advice}")


def _parts_of(values: Floats, index: int) -> Ints:
    """Numbers of the predictors that a column of standardised cells is a sum of; none mostly.

    ``values`` (cells, columns) have the response in column 0.
    """
    numbers = np.arange(1, values.shape[1])
    predictors = numbers[numbers != index]
    column = values[:, index]
    other_columns = values[:, predictors]
    weights = np.linalg.lstsq(other_columns, column, rcond=None)[0]
    residual = column - other_columns @ weights
    is_sum = residual @ residual * _IS_SUM <= residual.size
    return predictors[is_sum & (np.abs(weights) > 1e-3)]


def _bearable(cells: _Cells, errors: Floats | None) -> Regression:
    """The model, where there are enough independent cells for its coefficients.

    ``errors`` (k + 1, k + 1) are those that are taken off; None for a model as the maps are.
    CannotMeasure where the coefficient with the fewest independent cells has too few.
    """
    model = cells.fit(errors)
    k = len(cells.names)
    n_of_coefficients = np.nan_to_num(model.n_eff)
    fewest = int(np.argmin(n_of_coefficients))
    n_eff = model.n_eff[fewest]
    least = LEAST_CLAIMED * k
    if n_eff >= least:
        return model
    factor = least / max(n_eff, 1.0)
    help_text = f"a field of {factor:.1f} times the area"
    if k > 1:
        help_text += f", or a model without {cells.names[fewest]}, which has the fewest"
    raise CannotMeasure(
        f"{max(n_eff, 0):.0f} independent cells for {k} coefficients: a model needs"
        f" {LEAST_CLAIMED:.0f} for each. What would help: {help_text}. Several specimens in a"
        " series bear it together."
    )


def _coefficients(
    cells: _Cells, model: Regression, errors: Floats, curve: Variogram | None, *, corrected: bool
) -> dict[str, Coefficient]:
    """State each coefficient, and beside it those of ranks, of weights and of the errors.

    ``errors`` (k + 1, k + 1) is the covariance of the stated errors, the response last; ``curve``
    is the variogram of the residuals, None where there is none. Each figure has k values. Weights
    by the residuals' covariance are for a model without correction alone.
    """
    rank_model = cells.ranked().fit()
    weighed = _weighed(cells, model, None if corrected else curve)
    figures: dict[str, Sequence[Any] | Array] = {
        "standardised": model.standardised,
        "interval": model.standardised_intervals,
        "plain": model.plain,
        "plain_interval": model.intervals,
        "standard_error": model.standard_errors * model.scale,
        "n_eff": model.n_eff,
        "p": model.p,
        "p_of_set": holm(model.p.tolist()),
        "vif": model.vif,
        "unique": model.unique,
        "rank": rank_model.standardised,
        "weighed": weighed,
        "by_errors": _added_by_errors(cells, model, errors, corrected=corrected),
    }
    coefficients: dict[str, Coefficient] = {}
    for index, column in enumerate(cells.columns[1:]):
        of_column: Entries = {name: values[index] for name, values in figures.items()}
        of_column |= {"title": column.title, "units": column.units}
        coefficients[column.name] = Coefficient(**of_column)
    return coefficients


def _added_by_errors(
    cells: _Cells, model: Regression, errors: Floats, *, corrected: bool
) -> Floats:
    """What the stated errors add to plain coefficients; NaN where that is not known."""
    unknown = np.full(model.plain.size, math.nan)
    if not errors.any():
        return unknown
    try:
        other_model = cells.fit(None if corrected else errors)
    except CannotMeasure:
        return unknown
    difference = model.plain - other_model.plain
    return -difference if corrected else difference


def _weighed(cells: _Cells, model: Regression, curve: Variogram | None) -> Floats:
    """Standardised coefficients (k,) by generalised least squares; NaN where there are none.

    Weights are by an exponential covariance that is read off ``curve``, the variogram of the
    residuals; there are none without it, or where the solution does not converge.
    """
    unknown = np.full(model.plain.size, math.nan)
    if curve is None:
        return unknown
    lags = cells.lags
    response, *predictors = cells.maps
    try:
        weighed = weighed_regression(
            response, predictors, lags.is_valid, lags.pixel_um, covariance_of(curve)
        )
    except CannotMeasure:
        return unknown
    return weighed.plain * model.scale


def _lead_of(model: Regression) -> Entries:
    """How far the largest coefficient leads; nothing where there is one alone."""
    if model.plain.size < 2:
        return {}
    second, first = np.argsort(np.abs(model.standardised))[-2:]
    lead, interval = model.difference_of_sizes(int(first), int(second))
    return {"lead": lead, "lead_interval": interval}


def _variogram_of_residuals(cells: _Cells, model: Regression) -> Variogram | None:
    """How residuals resemble each other; None where the field is too small to show it."""
    try:
        return variogram_of(model.residuals, cells.lags, None)
    except CannotMeasure:
        return None


def _of_residuals(cells: _Cells, curve: Variogram | None) -> Entries:
    """How far residuals reach, and how well blocks wider than that are predicted.

    As fields of the model. Blocks are three ranges of the residuals wide, one cell at least; the
    reason says why there is no prediction.
    """
    if curve is None:
        return {
            "reason": "No R2 out of sample: the field is too small to show how far residuals reach."
        }
    range_um = 0.0
    if math.isfinite(curve.range_um):
        range_um = curve.range_um
    block_um = max(_LEFT * range_um, cells.cell_um)
    response, *predictors = cells.maps
    r2_out = out_of_sample_r2(response, predictors, cells.lags, block_um=block_um)
    reason = ""
    if math.isnan(r2_out):
        reason = (
            f"No R2 out of sample: the field holds no 2 x 2 blocks of {block_um:.0f} um, beyond"
            " which residuals are independent."
        )
    return {"r2_out": r2_out, "block_um": block_um, "residuals": curve, "reason": reason}


def _size_row(cells: _Cells) -> CellSizeRow:
    try:
        return _row_of(cells, _bearable(cells, None))
    except CannotMeasure as fault:
        return CellSizeRow(cell_um=cells.cell_um, n=cells.lags.n, reason=fault.text)


def _row_of(cells: _Cells, model: Regression) -> CellSizeRow:
    intervals = model.standardised_intervals.tolist()
    return CellSizeRow(
        cell_um=cells.cell_um,
        n=cells.lags.n,
        n_eff=model.n_eff.min(),
        r2=model.r2,
        standardised=dict(zip(cells.names, model.standardised, strict=True)),
        intervals=dict(zip(cells.names, intervals, strict=True)),
    )


def covariance_of(curve: Variogram) -> ExponentialCovariance:
    """Read an exponential covariance off a variogram."""
    shared = curve.sill - curve.nugget
    if not (shared > 0 and math.isfinite(curve.range_um)):
        return ExponentialCovariance(shared=0.0, nugget=curve.sill, range_um=max(curve.cell_um))
    return ExponentialCovariance(shared=shared, nugget=curve.nugget, range_um=curve.range_um)


def _parts_in_common(names: Sequence[str], sheet: xr.Dataset) -> tuple[SharedPart, ...]:
    shared: list[SharedPart] = []
    for a, b in combinations(names, 2):
        parts = shared_parts(bare_name(a), bare_name(b), sheet)
        if parts:
            shared.append(SharedPart(a=a, b=b, parts=parts))
    return tuple(shared)


def _dataset(cells: _Cells, model: Regression, grid: Grid) -> xr.Dataset:
    """The cells of a model, as they go into a table and into figures.

    Dataset (cell_y, cell_x) in um of the grid: the means of response and predictors, the residual,
    and each predictor freed of the others; NaN where a cell does not count.
    """
    response, *predictors = cells.columns
    freed = [replace(column, name=f"{column.name} freed") for column in predictors]
    columns = [*cells.columns, replace(response, name="residual"), *freed]
    values = [*cells.maps, model.residuals, *model.freed]
    is_valid = cells.lags.is_valid
    places = points_of(grid, is_valid.shape, cells.cell_um)
    dataset = xr.Dataset(coords={"cell_y": places.y_um, "cell_x": places.x_um})
    for column, m in zip(columns, values, strict=True):
        of_cells = np.where(is_valid, m, np.nan)
        attrs = {"units": column.units}
        dataset[column.name] = (("cell_y", "cell_x"), of_cells, attrs)
    return dataset
