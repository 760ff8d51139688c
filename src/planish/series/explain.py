"""``pl.explain``: a model of a run, of a Dataset, or of a series pooled over its sheets."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import xarray as xr
from pydantic import Field

from planish.analyze import Fields, holm, over_sheets, random_effects
from planish.analyze.distributions import student_tail
from planish.analyze.explain import Explained
from planish.analyze.params import ExplainParams
from planish.analyze.sheets import RandomEffects, SheetMean
from planish.core.arrays import not_taken
from planish.core.errors import CannotMeasure, PlanishError
from planish.core.facts import Interval, ResultModel, Value, optional
from planish.core.options import params_of
from planish.run.explain import explain_dataset, explain_run
from planish.run.run import Run, is_run, open_run
from planish.series.pages import RESULTS
from planish.series_results import SeriesResults


class PooledCoefficient(ResultModel):
    """What one predictor adds, over the sheets of a series."""

    standardised: Value = Field(description="Mean of the sheets' standardised coefficients.")
    interval: Interval = optional("Its 95 % interval for such sheets.")
    plain: Value = Field(description="Mean of the plain coefficients.")
    plain_interval: Interval = optional("Its 95 % interval.")
    p: Value = optional("Of the test that the mean of such sheets is 0.")
    p_of_set: Value = optional("The same after Holm, over all predictors.")
    between_sheets: RandomEffects | None = optional("How much sheets differ.")
    reason: str = Field(default="", description="Why there is no interval.")

    @property
    def direction(self) -> int:
        """1 or -1 where the interval excludes 0, else 0."""
        low, high = self.interval
        return int(low > 0) - int(high < 0)


class ExplainedSeries(ResultModel):
    """A response explained by several maps, pooled over the sheets of a series."""

    response: str = Field(description="Map that is explained.")
    of: tuple[str, ...] = Field(description="Maps that explain it.")
    cell_um: float = Field(description="Edge of a cell.")
    corrected: bool = Field(default=False, description="Whether stated errors were taken off.")
    sheets: int = Field(description="Sheets that count.")
    fields: int = Field(description="Specimens that count; each is a field of a sheet.")
    n: int = Field(description="Cells of all specimens.")
    n_eff: Value = Field(description="Independent cells of all specimens.")
    r2: Value = Field(description="Mean over sheets of the variance that is explained.")
    r2_out: Value = optional("The same of blocks that a model was not fitted to.")
    coefficients: dict[str, PooledCoefficient] = Field(description="By predictor.")
    specimens: dict[str, Explained] = Field(description="The model of each specimen.")
    left_out: dict[str, str] = Field(
        default={}, description="Specimens without a model, and why there is none."
    )

    @property
    def strongest(self) -> list[str]:
        """Predictors by the size of their standardised coefficients, the largest first."""
        return sorted(self.coefficients, key=lambda k: -abs(self.coefficients[k].standardised))


def explain(
    data: Run | xr.Dataset | str | Path,
    *,
    response: str,
    of: Sequence[str],
    cell_um: float = 100.0,
    corrected: bool = False,
    factors: str | Path | None = None,
) -> Explained | ExplainedSeries:
    """State how much of a map each of several others explains, on cells of a stated size.

    Parameters
    ----------
    data : Run, Dataset or path
        A run, its folder or that of a series; or maps on one grid with coordinates in um: missing
        is NaN, ``valid`` says which pixels count if it is there, and ``NAME_se`` is the standard
        error of map NAME (of surfaces, such as ``interface_top_se``, as well).
    response : str
        Map that is explained; ``LAYER.MAP`` where several layers have one of that name.
    of : sequence of str
        Maps that explain it. A map of truth values or labels is a factor.
    cell_um : float
        Edge of the cells over which all maps are averaged first.
    corrected : bool
        Take the stated errors of the maps off (:func:`planish.analyze.covariance_of_errors`).
    factors : path, optional
        Named regions, whose share of a cell is a predictor.

    Returns
    -------
    Explained or ExplainedSeries
        ``coefficients[name]`` with ``standardised``, ``interval`` (95 %), ``plain`` and ``vif``;
        ``r2``, ``r2_out``, ``n``, ``n_eff``. Of a series pooled over sheets.

    Raises
    ------
    InputError, SizeError, CannotMeasure
        If a map is missing, angles of an axis, or a sum of others; a cell smaller than a pixel; or
        the field holds fewer than 10 independent cells for each coefficient.

    Examples
    --------
    >>> model = planish.explain(run, response="image", of=["coating_top"])  # doctest: +SKIP
    >>> model.coefficients["coating_top"].interval  # doctest: +SKIP
    """
    options = {
        "response": response,
        "of": tuple(of),
        "cell_um": cell_um,
        "corrected": corrected,
        "factors": None if factors is None else str(factors),
    }
    params = params_of(ExplainParams, options, "pl.explain")
    if isinstance(data, xr.Dataset):
        return explain_dataset(data, params)
    if isinstance(data, Run):
        return explain_run(data, params)
    if not isinstance(data, str | Path):
        raise not_taken(data, "a run", 'pl.explain("run", response=..., of=[...])', "pl.explain")
    return explain_folder(Path(data), params)


def explain_folder(folder: Path, params: ExplainParams) -> Explained | ExplainedSeries:
    """The model of a run folder, or of that of a series; errors as of :func:`explain`."""
    if (folder / RESULTS).is_file() and not is_run(folder):
        return explain_series(SeriesResults.read(folder / RESULTS), folder, params)
    return explain_run(open_run(folder), params)


def explain_series(results: SeriesResults, home: Path, params: ExplainParams) -> ExplainedSeries:
    """Explain a map in each specimen of a series, and pool over sheets.

    Raises
    ------
    CannotMeasure
        If there is a model of no specimen; the message says why of the first.
    """
    models: dict[str, Explained] = {}
    left_out: dict[str, str] = {}
    for specimen in results.specimens:
        folder = specimen.member.folder(home)
        if folder is None:
            left_out[specimen.name] = specimen.member.message or "There is no run."
            continue
        try:
            model = explain_run(open_run(folder), params)
        except PlanishError as fault:
            left_out[specimen.name] = fault.text
            continue
        if model.trust == "ok":
            models[specimen.name] = model
        else:
            left_out[specimen.name] = f"A check leaves its figures {model.trust}."
    if not models:
        raise CannotMeasure(
            f"No specimen of {len(left_out)} has such a model. {next(iter(left_out.values()), '')}"
        )
    sheets = {specimen.name: specimen.sheet for specimen in results.specimens}
    return pooled(models, sheets, left_out)


def pooled(
    models: Mapping[str, Explained], sheets: Mapping[str, str], left_out: Mapping[str, str]
) -> ExplainedSeries:
    """Pool models of specimens over sheets, each of which counts once."""
    first = next(iter(models.values()))
    sheet_of_model = [sheets[name] or name for name in models]

    def over(values: list[float]) -> SheetMean:
        return over_sheets(Fields(values, sheet_of_model))

    names = [
        name for name in first.coefficients if all(name in m.coefficients for m in models.values())
    ]
    coefficients = {name: _pooled_coefficient(name, models, sheet_of_model) for name in names}
    p_of_set = holm([c.p for c in coefficients.values()])
    return ExplainedSeries(
        response=first.response,
        of=first.of,
        cell_um=first.cell_um,
        corrected=first.corrected,
        sheets=len(set(sheet_of_model)),
        fields=len(models),
        n=sum(model.n for model in models.values()),
        n_eff=sum(model.n_eff for model in models.values()),
        r2=over([model.r2 for model in models.values()]).mean,
        r2_out=over([model.r2_out for model in models.values()]).mean,
        coefficients={
            name: c.model_copy(update={"p_of_set": p})
            for (name, c), p in zip(coefficients.items(), p_of_set, strict=True)
        },
        specimens=dict(models),
        left_out=dict(left_out),
    )


def _pooled_coefficient(
    name: str, models: Mapping[str, Explained], sheets: Sequence[str]
) -> PooledCoefficient:
    of_models = [model.coefficients[name] for model in models.values()]
    fields = Fields([c.standardised for c in of_models], sheets)
    mean = over_sheets(fields)
    plain = over_sheets(Fields([c.plain for c in of_models], sheets))
    variances = Fields([c.standard_error**2 for c in of_models], sheets).by_sheet
    of_sheets = [float(v.sum()) / v.size**2 for v in variances.values()]
    p = math.nan
    if not mean.reason:
        ratio = abs(mean.mean) / mean.standard_error
        p = 2 * student_tail(ratio, mean.sheets - 1)
    return PooledCoefficient(
        standardised=mean.mean,
        interval=mean.interval,
        plain=plain.mean,
        plain_interval=plain.interval,
        p=p,
        between_sheets=random_effects(fields.means, of_sheets) if mean.sheets > 1 else None,
        reason=mean.reason,
    )
