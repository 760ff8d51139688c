"""A model of several maps, pooled over sheets, with the spread between sheets."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from pydantic import Field

from planish.analyze.differences import holm
from planish.analyze.distributions import p_of
from planish.analyze.explain import Coefficient, CoefficientFacts, Explained, ModelFacts, strongest
from planish.analyze.pooled import effects_of_sheets
from planish.analyze.sheets import Fields, RandomEffects, SheetMean, over_sheets
from planish.core.typing import Floats


class PooledCoefficient(CoefficientFacts):
    """What one predictor adds: mean over the sheets of a series, with the interval of that."""

    between_sheets: RandomEffects | None = None
    """How much sheets differ."""
    reason: str = ""
    """Why there is no interval."""


class ExplainedSeries(ModelFacts):
    """A response explained by several maps: means over the sheets of a series."""

    sheets: int
    """Sheets that count."""
    fields: int
    """Specimens that count; each is a field of a sheet."""
    coefficients: dict[str, PooledCoefficient]
    """By predictor."""
    specimens: dict[str, Explained]
    """The model of each specimen."""
    left_out: dict[str, str] = Field(default={})
    """Specimens without a model, and why there is none."""


def explained_over_sheets(
    models: Mapping[str, Explained], sheets: Mapping[str, str], left_out: Mapping[str, str]
) -> ExplainedSeries:
    """Pool models of specimens over sheets, each of which counts once.

    ``models`` by the names of the specimens, at least one; ``sheets`` the name of each specimen's
    sheet, empty where it is of a sheet of its own; ``left_out`` why other specimens have no model.
    """
    of_models = list(models.values())
    first = of_models[0]
    sheet_of_model = [sheets[name] or name for name in models]
    coefficients = _pooled_coefficients(of_models, sheet_of_model)
    lead = _lead_over_sheets(coefficients, of_models, sheet_of_model)
    declared = {model.declared for model in of_models}
    n = sum(model.n for model in of_models)
    n_eff = sum(model.n_eff for model in of_models)
    names = ("response", "title", "units", "of", "cell_um", "corrected")
    declaration = {name: getattr(first, name) for name in names}
    r2 = over_sheets(_fields("r2", of_models, sheet_of_model))
    r2_out = over_sheets(_fields("r2_out", of_models, sheet_of_model))
    return ExplainedSeries(
        **declaration,
        declared=first.declared if len(declared) == 1 else False,
        sheets=len(set(sheet_of_model)),
        fields=len(models),
        n=n,
        n_eff=n_eff,
        r2=r2.mean,
        r2_out=r2_out.mean,
        coefficients=coefficients,
        lead=lead.mean,
        lead_interval=lead.interval,
        specimens=dict(models),
        left_out=dict(left_out),
    )


def _fields(figure: str, parts: Sequence[Explained | Coefficient], sheets: Sequence[str]) -> Fields:
    """A figure of models, or of coefficients, each of a field."""
    return Fields([getattr(part, figure) for part in parts], sheets)


def _pooled_coefficients(
    models: Sequence[Explained], sheets: Sequence[str]
) -> dict[str, PooledCoefficient]:
    """Those that all models have, by predictor, with p of all together (Holm).

    ``sheets`` are the names of the sheets of the models, in the same order.
    """
    pooled: dict[str, PooledCoefficient] = {}
    for name in models[0].coefficients:
        if all(name in model.coefficients for model in models):
            of_models = [model.coefficients[name] for model in models]
            pooled[name] = _pooled_coefficient(of_models, sheets)
    p_of_set = holm([coefficient.p for coefficient in pooled.values()])
    for (name, coefficient), p in zip(pooled.items(), p_of_set, strict=True):
        pooled[name] = coefficient.model_copy(update={"p_of_set": p})
    return pooled


def _lead_over_sheets(
    coefficients: Mapping[str, PooledCoefficient],
    models: Sequence[Explained],
    sheets: Sequence[str],
) -> SheetMean:
    """How far the largest pooled coefficient leads the next one; nothing where there is one."""
    if len(coefficients) < 2:
        return SheetMean(sheets=0, fields=0)
    sizes: list[Floats] = []
    for name in strongest(coefficients)[:2]:
        sign = math.copysign(1.0, coefficients[name].standardised)
        of_models = [m.coefficients[name].standardised for m in models]
        sizes.append(sign * np.array(of_models))
    return over_sheets(Fields(sizes[0] - sizes[1], sheets))


def _pooled_coefficient(
    of_models: Sequence[Coefficient], sheets: Sequence[str]
) -> PooledCoefficient:
    """One coefficient of all models: means over sheets, and how much sheets differ.

    p is Student's, of the mean of standardised ones over its error; NaN without an interval.
    """
    fields = _fields("standardised", of_models, sheets)
    mean = over_sheets(fields)
    plain = over_sheets(_fields("plain", of_models, sheets))
    variances = Fields([c.standard_error**2 for c in of_models], sheets)
    p = math.nan
    if not mean.reason:
        p = p_of(mean.mean / mean.standard_error, mean.sheets - 1)
    return PooledCoefficient(
        title=of_models[0].title,
        units=of_models[0].units,
        standardised=mean.mean,
        interval=mean.interval,
        plain=plain.mean,
        plain_interval=plain.interval,
        p=p,
        between_sheets=effects_of_sheets(fields, variances),
        reason=mean.reason,
    )
