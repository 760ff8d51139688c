"""A model of several maps, pooled over sheets, with the spread between sheets."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from pydantic import Field

from planish.analyze.differences import holm
from planish.analyze.distributions import student_tail
from planish.analyze.explain import Explained
from planish.analyze.pooled import random_effects
from planish.analyze.sheets import Fields, RandomEffects, SheetMean, over_sheets
from planish.core.facts import Interval, ResultModel, Value, optional


class PooledCoefficient(ResultModel):
    """What one predictor adds, over the sheets of a series."""

    title: str = Field(default="", description="Title of the predictor.")
    standardised: Value = Field(description="Mean of the sheets' standardised coefficients.")
    interval: Interval = optional("Its 95 % interval for such sheets.")
    plain: Value = Field(description="Mean of the plain coefficients.")
    plain_interval: Interval = optional("Its 95 % interval.")
    units: str = Field(default="1", description="Unit of the predictor.")
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
    title: str = Field(default="", description="Its title.")
    units: str = Field(default="1", description="Its unit.")
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
    lead: Value = optional(
        "Mean of the size of the largest coefficient less that of the next one of the means."
    )
    lead_interval: Interval = optional("Its 95 % interval for such sheets.")
    specimens: dict[str, Explained] = Field(description="The model of each specimen.")
    left_out: dict[str, str] = Field(
        default={}, description="Specimens without a model, and why there is none."
    )

    @property
    def strongest(self) -> list[str]:
        """Predictors by the size of their standardised coefficients, the largest first."""
        return sorted(self.coefficients, key=lambda k: -abs(self.coefficients[k].standardised))


def explained_over_sheets(
    models: Mapping[str, Explained], sheets: Mapping[str, str], left_out: Mapping[str, str]
) -> ExplainedSeries:
    """Pool models of specimens over sheets, each of which counts once."""
    first = next(iter(models.values()))
    sheet_of_model = [sheets[name] or name for name in models]

    def over(values: list[float]) -> SheetMean:
        return over_sheets(Fields(values, sheet_of_model))

    shared = set.intersection(*(set(model.coefficients) for model in models.values()))
    names = [name for name in first.coefficients if name in shared]
    coefficients = {name: _pooled_coefficient(name, models, sheet_of_model) for name in names}
    order = sorted(names, key=lambda name: -abs(coefficients[name].standardised))
    lead = SheetMean(sheets=0, fields=0)
    if len(order) > 1:
        first_two = order[0], order[1]
        lead = over([_difference_of_sizes(model, *first_two) for model in models.values()])
    p_of_set = holm([c.p for c in coefficients.values()])
    return ExplainedSeries(
        response=first.response,
        title=first.title,
        units=first.units,
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
        lead=lead.mean,
        lead_interval=lead.interval,
        specimens=dict(models),
        left_out=dict(left_out),
    )


def _difference_of_sizes(model: Explained, first: str, second: str) -> float:
    sizes = [abs(model.coefficients[name].standardised) for name in (first, second)]
    return sizes[0] - sizes[1]


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
        title=of_models[0].title,
        units=of_models[0].units,
        standardised=mean.mean,
        interval=mean.interval,
        plain=plain.mean,
        plain_interval=plain.interval,
        p=p,
        between_sheets=random_effects(fields.means, of_sheets) if mean.sheets > 1 else None,
        reason=mean.reason,
    )
