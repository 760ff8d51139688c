"""A model of several maps, pooled over sheets, with the spread between sheets."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from pydantic import Field

from planish.analyze.differences import holm
from planish.analyze.distributions import student_tail
from planish.analyze.explain import Coefficient, CoefficientFacts, Explained, ModelFacts, strongest
from planish.analyze.pooled import random_effects
from planish.analyze.sheets import Fields, RandomEffects, SheetMean, over_sheets
from planish.core.facts import optional


class PooledCoefficient(CoefficientFacts):
    """What one predictor adds: mean over the sheets of a series, with the interval of that."""

    between_sheets: RandomEffects | None = optional("How much sheets differ.")
    reason: str = Field(default="", description="Why there is no interval.")


class ExplainedSeries(ModelFacts):
    """A response explained by several maps: means over the sheets of a series."""

    sheets: int = Field(description="Sheets that count.")
    fields: int = Field(description="Specimens that count; each is a field of a sheet.")
    coefficients: dict[str, PooledCoefficient] = Field(description="By predictor.")
    specimens: dict[str, Explained] = Field(description="The model of each specimen.")
    left_out: dict[str, str] = Field(
        default={}, description="Specimens without a model, and why there is none."
    )


def explained_over_sheets(
    models: Mapping[str, Explained], sheets: Mapping[str, str], left_out: Mapping[str, str]
) -> ExplainedSeries:
    """Pool models of specimens over sheets, each of which counts once."""
    first = next(iter(models.values()))
    of_models = list(models.values())
    sheet_of_model = [sheets[name] or name for name in models]
    shared = set.intersection(*(set(model.coefficients) for model in of_models))
    coefficients = {
        name: _pooled_coefficient([model.coefficients[name] for model in of_models], sheet_of_model)
        for name in first.coefficients
        if name in shared
    }
    p_of_set = holm([c.p for c in coefficients.values()])
    lead = _lead_over_sheets(coefficients, of_models, sheet_of_model)
    declared = {model.declared for model in of_models}
    model_fields = ("response", "title", "units", "of", "cell_um", "corrected")
    r2 = Fields([model.r2 for model in of_models], sheet_of_model)
    r2_out = Fields([model.r2_out for model in of_models], sheet_of_model)
    with_p_of_set: dict[str, PooledCoefficient] = {}
    for (name, coefficient), p in zip(coefficients.items(), p_of_set, strict=True):
        with_p_of_set[name] = coefficient.model_copy(update={"p_of_set": p})
    n = sum(model.n for model in of_models)
    n_eff = sum(model.n_eff for model in of_models)
    return ExplainedSeries(
        **{name: getattr(first, name) for name in model_fields},
        declared=declared.pop() if len(declared) == 1 else False,
        sheets=len(set(sheet_of_model)),
        fields=len(models),
        n=n,
        n_eff=n_eff,
        r2=over_sheets(r2).mean,
        r2_out=over_sheets(r2_out).mean,
        coefficients=with_p_of_set,
        lead=lead.mean,
        lead_interval=lead.interval,
        specimens=dict(models),
        left_out=dict(left_out),
    )


def _lead_over_sheets(
    coefficients: Mapping[str, PooledCoefficient],
    models: Sequence[Explained],
    sheets: Sequence[str],
) -> SheetMean:
    """How far the largest pooled coefficient leads the next one; nothing where there is one."""
    if len(coefficients) < 2:
        return SheetMean(sheets=0, fields=0)
    first, second = strongest(coefficients)[:2]
    signs = [math.copysign(1.0, coefficients[name].standardised) for name in (first, second)]
    leads: list[float] = []
    for model in models:
        of_model = model.coefficients
        leads.append(
            signs[0] * of_model[first].standardised - signs[1] * of_model[second].standardised
        )
    return over_sheets(Fields(leads, sheets))


def _pooled_coefficient(
    of_models: Sequence[Coefficient], sheets: Sequence[str]
) -> PooledCoefficient:
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
