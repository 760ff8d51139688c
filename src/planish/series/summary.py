"""What a series of specimens says.

It gives means over sheets, differences between papers or treatments, and pooled r.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

import planish
from planish import analyze
from planish.core.axial import angle_of, doubled, has_axes, near_axis
from planish.core.errors import InputError
from planish.core.text import likely
from planish.series.cautions import NEST, cautions_of
from planish.series.declared import Declared
from planish.series.gather import FigureRow, Gathered
from planish.series.quantities import cell_of, margin_of, quantities_of
from planish.series_results import (
    DifferenceFacts,
    GroupFacts,
    Quantity,
    SeriesResults,
    SeriesSpecimen,
)

_MOST_LEVELS = 8


def summary_of(gathered: Gathered, declared: Declared) -> SeriesResults:
    """Say what a series of specimens says, over sheets.

    Parameters
    ----------
    gathered : Gathered
    declared : Declared

    Returns
    -------
    SeriesResults

    Raises
    ------
    InputError
        If the factor or a map that was declared is not there.

    Notes
    -----
    Specimens with one ``paper`` and ``sheet`` are fields of one sheet; a specimen without a
    ``sheet`` counts as a sheet of its own. Groups are made of the levels of ``paper``,
    ``treatment``, ``side`` and of the factor that is compared, where they vary. Two levels are
    compared where all other factors of the groups are the same: paired where they have sheets in
    common, else as two groups (Welch). p is corrected for all differences together (Holm). A figure
    that is withheld takes part in nothing; a doubtful one does only where that was declared.
    """
    factors = tuple(dict.fromkeys(name for member in gathered.members for name in member.factors))
    compared_by = _compared_by(gathered, factors, declared)
    separate_factors = [
        "paper",
        "treatment",
        "side",
        *([] if compared_by is None else [compared_by]),
    ]
    grouped_by = tuple(f for f in dict.fromkeys(separate_factors) if _varies(gathered, f))
    rows = _near_common_axes(gathered.rows_of_series())
    quantities = quantities_of(rows, gathered.runs, declared)
    specimens = _specimens(gathered, rows, quantities, declared)
    counted = [specimen for specimen in specimens if specimen.kind is not None]
    groups = [
        _group(counted, k, q, dict(zip(grouped_by, levels, strict=True)))
        for levels in dict.fromkeys(_levels_of(specimen, grouped_by) for specimen in counted)
        for k, q in enumerate(quantities)
    ]
    pairs = [] if compared_by is None else [*_pairs(counted, quantities, compared_by, grouped_by)]
    adjusted = analyze.p_of_tables([difference for _, difference in pairs])
    return SeriesResults(
        planish=planish.__version__,
        declared=declared.model_dump(mode="json"),
        quantities=quantities,
        headline_declared=bool(declared.headline),
        factors=factors,
        grouped_by=grouped_by,
        compared_by=compared_by,
        sheets_given=bool(counted) and all(specimen.factor("sheet") for specimen in counted),
        specimens=tuple(specimens),
        groups=tuple(groups),
        differences=tuple(
            DifferenceFacts.holding(
                difference,
                **labels,
                smallest_seen=difference.smallest_seen(),
                equivalence=(
                    None if margin is None else analyze.equivalence(difference, margin=margin)
                ),
            )
            for (labels, _), difference in zip(pairs, adjusted, strict=True)
            for margin in (margin_of(quantities[labels["quantity"]], declared),)
        ),
        instruments=tuple(facts for run in gathered.runs.values() for facts in run.instruments),
        cautions=tuple(
            cautions_of(gathered, specimens, quantities, grouped_by, compared_by, _MOST_LEVELS)
        ),
    )


def _near_common_axes(rows: Sequence[FigureRow]) -> list[FigureRow]:
    """Give mean axes as angles near the axis of all of their map: such have means and differences.

    They may pass 90 degrees.
    """
    axes: dict[str, list[float]] = {}
    near_rows: list[FigureRow] = []
    for row in rows:
        if row.quantity != "mean" or row.value is None:
            continue
        if has_axes(row.map, row.period_deg):
            axes.setdefault(row.map, []).append(row.value)
    for row in rows:
        if row.map in axes and row.quantity == "mean" and row.value is not None:
            axis_deg = angle_of(np.mean(doubled(np.array(axes[row.map]))))
            near_rows.append(replace(row, value=float(near_axis(row.value, axis_deg))))
        else:
            near_rows.append(row)
    return near_rows


def _compared_by(gathered: Gathered, factors: Sequence[str], declared: Declared) -> str | None:
    name = declared.compare
    if name is None:
        return next(
            (factor for factor in ("treatment", "paper", "side") if _varies(gathered, factor)), None
        )
    if name not in factors:  # tables are read in small letters
        name = next((f for f in factors if f.casefold() == name.casefold()), name)
    if name in NEST:
        raise InputError(
            f"{name.capitalize()}s are the sample and are not compared with each other. Compare by"
            " another factor:"
            f" {', '.join(f for f in factors if f not in NEST) or 'the table has none yet'}."
        )
    if name not in factors:
        raise InputError(
            f"No specimen has a factor {name}; there are"
            f" {', '.join(factors) or 'none'}.{likely(name, factors)} Add such a column to the"
            " table, or compare by another factor."
        )
    return name


def _varies(gathered: Gathered, factor: str) -> bool:
    levels = {
        member.factors.get(factor, "")
        for member in gathered.members
        if member.name in gathered.runs
    }
    return len(levels - {""}) > 1


def _specimens(
    gathered: Gathered,
    rows: Sequence[FigureRow],
    quantities: Sequence[Quantity],
    declared: Declared,
) -> list[SeriesSpecimen]:
    rows_by_specimen, first_of_volume = dict[str, list[FigureRow]](), dict[tuple[str, ...], str]()
    for row in rows:
        rows_by_specimen.setdefault(row.specimen, []).append(row)
    specimens: list[SeriesSpecimen] = []
    for member in gathered.members:
        run = gathered.runs.get(member.name)
        if run is None:
            specimens.append(SeriesSpecimen(member=member))
            continue
        # Without a sheet's name, the same volume is the same sheet for certain.
        volume_name = f"specimen {first_of_volume.setdefault(run.volumes, member.name)}"
        paper, sheet = member.factors.get("paper", ""), member.factors.get("sheet", "")
        specimens.append(
            run.specimen.model_copy(
                update={
                    "sheet": (
                        " ".join(filter(None, (paper, f"sheet {sheet}"))) if sheet else volume_name
                    ),
                    "cells": tuple(
                        cell_of(rows_by_specimen[member.name], q, with_doubtful=declared.doubtful)
                        for q in quantities
                    ),
                }
            )
        )
    return specimens


def _levels_of(specimen: SeriesSpecimen, factors: Sequence[str]) -> tuple[str, ...]:
    return tuple(specimen.factor(name) for name in factors)


def _fields(
    specimens: Sequence[SeriesSpecimen], k: int, *, with_names: bool = False
) -> analyze.Fields:
    """One quantity of some specimens; those that do not count are missing."""
    cells = [specimen.cells[k] for specimen in specimens]
    values = [cell.value if cell.counts and cell.value is not None else math.nan for cell in cells]
    names = [specimen.factor("field") for specimen in specimens] if with_names else []
    return analyze.Fields(values, [specimen.sheet for specimen in specimens], names)


def _group(
    specimens: Sequence[SeriesSpecimen], k: int, quantity: Quantity, group: Mapping[str, str]
) -> GroupFacts:
    members = [
        s for s in specimens if all(s.factor(name) == level for name, level in group.items())
    ]
    fields = _fields(members, k)
    if quantity.what == "r":
        n_effs = [specimen.cells[k].n_eff_interval for specimen in members]
        mean = analyze.pooled_r(fields, [math.nan if n_eff is None else n_eff for n_eff in n_effs])
    else:
        mean = analyze.over_sheets(fields).model_copy(
            update={"variances": analyze.variances_of(fields)}
        )
    return GroupFacts.holding(mean, quantity=k, group=dict(group), left_out=_left_out(members, k))


def _left_out(specimens: Sequence[SeriesSpecimen], k: int) -> tuple[str, ...]:
    return tuple(specimen.name for specimen in specimens if not specimen.cells[k].counts)


def _pairs(
    specimens: Sequence[SeriesSpecimen],
    quantities: Sequence[Quantity],
    factor: str,
    grouped_by: Sequence[str],
) -> Iterator[tuple[dict[str, Any], analyze.SheetDifference]]:
    """Compare every quantity of every two levels of a factor.

    This is done within each level of the other factors that make groups.
    """
    other_factors = [name for name in grouped_by if name != factor]
    levels = [*dict.fromkeys(level for specimen in specimens if (level := specimen.factor(factor)))]
    if [level.casefold() for level in levels] == ["after", "before"]:
        levels.reverse()
    if not 2 <= len(levels) <= _MOST_LEVELS:
        return
    strata = dict[tuple[str, ...], dict[str, list[SeriesSpecimen]]]()
    for specimen in specimens:
        specimens_by_level = strata.setdefault(_levels_of(specimen, other_factors), {})
        specimens_by_level.setdefault(specimen.factor(factor), []).append(specimen)
    for k, quantity in enumerate(quantities):
        for stratum, specimens_by_level in strata.items():
            for first, second in combinations(
                (level for level in levels if level in specimens_by_level), 2
            ):
                before, after = specimens_by_level[first], specimens_by_level[second]
                yield (
                    {
                        "quantity": k,
                        "within": dict(zip(other_factors, stratum, strict=True)),
                        "factor": factor,
                        "levels": (first, second),
                        "left_out": _left_out([*before, *after], k),
                    },
                    _compare(before, after, k, quantity),
                )


def _compare(
    first: Sequence[SeriesSpecimen], second: Sequence[SeriesSpecimen], k: int, quantity: Quantity
) -> analyze.SheetDifference:
    """Compare two sets of specimens: paired where they have sheets in common, by named fields."""
    paired = not {s.sheet for s in first}.isdisjoint(s.sheet for s in second)
    field_keys = [
        [(s.sheet, s.factor("field")) for s in specimens] for specimens in (first, second)
    ]
    has_fields = paired and all(
        all(field for _, field in set_keys) and len({*set_keys}) == len(set_keys)
        for set_keys in field_keys
    )
    fields = [_fields(specimens, k, with_names=has_fields) for specimens in (first, second)]
    if quantity.what == "r":
        difference = analyze.difference_of_pooled_r(*fields, paired=paired)
    else:
        difference = analyze.paired_over_sheets(*fields) if paired else analyze.two_groups(*fields)
    sheets = dict.fromkeys(specimen.sheet for specimen in (*first, *second))
    return difference.model_copy(
        update={"unpaired": tuple(sheet for sheet in sheets if sheet in difference.unpaired)}
    )
