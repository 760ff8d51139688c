"""What a series of specimens says.

It gives means over sheets, differences between papers or treatments, and pooled r.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, combinations

import numpy as np

import planish
from planish import analyze
from planish.core.axial import angle_of, doubled, has_axes, near_axis
from planish.core.errors import InputError
from planish.core.tables import grouped
from planish.core.text import likely
from planish.core.typing import Entries, Texts
from planish.series.cautions import NEST, cautions_of, specimens_without
from planish.series.declared import Declared
from planish.series.gather import FigureRow, FigureRows, Gathered
from planish.series.quantities import cell_of, margin_of, quantities_of
from planish.series_results import (
    DifferenceFacts,
    GroupFacts,
    Quantity,
    SeriesResults,
    SeriesSpecimen,
    Specimens,
)

# A difference, and the fields of DifferenceFacts that say what it is of
LabelledDifference = tuple[Entries, analyze.SheetDifference]
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
    factors_of_members = (member.factors for member in gathered.members)
    factors = tuple(dict.fromkeys(chain.from_iterable(factors_of_members)))
    compared_by = _compared_by(gathered, factors, declared)
    separate_factors = dict.fromkeys(("paper", "treatment", "side", compared_by or "paper"))
    grouped_by = tuple(name for name in separate_factors if _varies(gathered, name))
    rows = _near_common_axes(gathered.rows_of_series())
    quantities = quantities_of(rows, gathered.runs, declared)
    specimens = _specimens(gathered, rows, quantities, declared)
    counted = [specimen for specimen in specimens if specimen.kind is not None]
    pairs = [*_pairs(counted, quantities, compared_by, grouped_by)]
    instruments = (run.instruments for run in gathered.runs.values())
    cautions = cautions_of(gathered, specimens, quantities, grouped_by, compared_by, _MOST_LEVELS)
    return SeriesResults(
        planish=planish.__version__,
        declared=declared.model_dump(mode="json"),
        quantities=quantities,
        headline_declared=bool(declared.headline),
        factors=factors,
        grouped_by=grouped_by,
        compared_by=compared_by,
        sheets_given=bool(counted) and not specimens_without("sheet", counted),
        specimens=tuple(specimens),
        groups=tuple(_groups(counted, quantities, grouped_by)),
        differences=tuple(_differences(pairs, quantities, declared)),
        instruments=tuple(chain.from_iterable(instruments)),
        cautions=tuple(cautions),
    )


def _differences(
    pairs: Sequence[LabelledDifference],
    quantities: Sequence[Quantity],
    declared: Declared,
) -> Iterator[DifferenceFacts]:
    """Differences with p of all of them together (Holm), and what their margins say.

    ``equivalence`` is None where no margin was declared for the quantity.
    """
    adjusted = analyze.p_of_tables([difference for _, difference in pairs])
    for (labels, _), difference in zip(pairs, adjusted, strict=True):
        margin = margin_of(quantities[labels["quantity"]], declared)
        equivalence = None if margin is None else analyze.equivalence(difference, margin=margin)
        smallest = difference.smallest_seen()
        yield DifferenceFacts.holding(
            difference, **labels, smallest_seen=smallest, equivalence=equivalence
        )


def _near_common_axes(rows: FigureRows) -> list[FigureRow]:
    """Give mean axes as angles near the axis of all of their map: such have means and differences.

    An axis is the same at 180 degrees more: 89 and -89 are close, though their mean is far from
    both. Such angles may pass 90 degrees. Other rows stay as they are.
    """
    axes: dict[str, list[float]] = {}  # mean axes of all specimens in degrees, by map
    for row in rows:
        if row.quantity == "mean" and row.value is not None and has_axes(row.map, row.period_deg):
            axes.setdefault(row.map, []).append(row.value)
    near_rows: list[FigureRow] = []
    for row in rows:
        value = row.value
        if row.map in axes and row.quantity == "mean" and value is not None:
            # Unit vectors at twice the angles have a mean without the jump at 90 degrees: half its
            # angle is the common axis, and the value moves by 180 degrees to within 90 of that.
            axis_deg = angle_of(np.mean(doubled(np.array(axes[row.map]))))
            value = float(near_axis(value, axis_deg))
        near_rows.append(replace(row, value=value))
    return near_rows


def _compared_by(gathered: Gathered, factors: Sequence[str], declared: Declared) -> str | None:
    """The factor that is compared: as declared, or else the first usual one that varies."""
    name = declared.compare
    if name is None:
        usual = (factor for factor in ("treatment", "paper", "side") if _varies(gathered, factor))
        return next(usual, None)
    if name not in factors:  # tables are read in small letters
        name = next((f for f in factors if f.casefold() == name.casefold()), name)
    _check_comparable(name, factors)
    return name


def _check_comparable(name: str, factors: Sequence[str]) -> None:
    """Raise InputError where a factor is not there, or tells the sample."""
    if name in NEST:
        comparable = ", ".join(factor for factor in factors if factor not in NEST)
        raise InputError(
            f"{name.capitalize()}s are the sample and are not compared with each other. Compare by"
            f" another factor: {comparable or 'the table has none yet'}."
        )
    if name not in factors:
        raise InputError(
            f"No specimen has a factor {name}; there are"
            f" {', '.join(factors) or 'none'}.{likely(name, factors)} Add such a column to the"
            " table, or compare by another factor."
        )


def _varies(gathered: Gathered, factor: str) -> bool:
    members = [member for member in gathered.members if member.name in gathered.runs]
    return len({member.factors.get(factor, "") for member in members} - {""}) > 1


def _specimens(
    gathered: Gathered,
    rows: FigureRows,
    quantities: Sequence[Quantity],
    declared: Declared,
) -> list[SeriesSpecimen]:
    """Every specimen with its sheet and its cells; those without a run have neither.

    A sheet is named by its paper and its own name, or by the first specimen of the same volume.
    """
    rows_by_specimen = grouped(rows, lambda row: row.specimen)
    first_of_volume: dict[Texts, str] = {}
    specimens: list[SeriesSpecimen] = []
    for member in gathered.members:
        run = gathered.runs.get(member.name)
        if run is None:
            specimens.append(SeriesSpecimen(member=member))
            continue
        # Without a sheet's name, the same volume is the same sheet for certain.
        sheet = f"specimen {first_of_volume.setdefault(run.volumes, member.name)}"
        if member.factors.get("sheet"):
            sheet = f"{member.factors.get('paper', '')} sheet {member.factors['sheet']}".lstrip()
        cells = [
            cell_of(rows_by_specimen[member.name], quantity, with_doubtful=declared.doubtful)
            for quantity in quantities
        ]
        fields = {"sheet": sheet, "cells": tuple(cells)}
        specimens.append(run.specimen.model_copy(update=fields))
    return specimens


def _by_levels(specimens: Specimens, factors: Sequence[str]) -> dict[Texts, list[SeriesSpecimen]]:
    """Specimens by their levels of some factors."""
    return grouped(specimens, lambda specimen: tuple(map(specimen.factor, factors)))


def _fields(specimens: Specimens, k: int, *, with_names: bool = False) -> analyze.Fields:
    """Quantity number ``k`` of some specimens with their sheets; NaN where it does not count."""
    cells = [specimen.cells[k] for specimen in specimens]
    values = [cell.value if cell.counts and cell.value is not None else math.nan for cell in cells]
    names = [specimen.factor("field") for specimen in specimens] if with_names else []
    return analyze.Fields(values, [specimen.sheet for specimen in specimens], names)


def _groups(
    specimens: Specimens, quantities: Sequence[Quantity], grouped_by: Sequence[str]
) -> Iterator[GroupFacts]:
    """The mean of each quantity over the sheets of each group."""
    for levels, members in _by_levels(specimens, grouped_by).items():
        group = dict(zip(grouped_by, levels, strict=True))
        for k, quantity in enumerate(quantities):
            mean = _mean_of(members, k, quantity)
            left_out = _left_out(members, k)
            yield GroupFacts.holding(mean, quantity=k, group=group, left_out=left_out)


def _mean_of(members: Specimens, k: int, quantity: Quantity) -> analyze.SheetMean:
    """The mean of a quantity over sheets: of r pooled, of others with the spread between sheets."""
    fields = _fields(members, k)
    if quantity.what == "r":
        n_effs = [specimen.cells[k].n_eff_interval for specimen in members]
        return analyze.pooled_r(fields, [math.nan if n is None else n for n in n_effs])
    variances = analyze.variances_of(fields)
    return analyze.over_sheets(fields).model_copy(update={"variances": variances})


def _left_out(specimens: Specimens, k: int) -> Texts:
    return tuple(specimen.name for specimen in specimens if not specimen.cells[k].counts)


def _pairs(
    specimens: Specimens,
    quantities: Sequence[Quantity],
    factor: str | None,
    grouped_by: Sequence[str],
) -> Iterator[LabelledDifference]:
    """Compare every quantity of every two levels of a factor; none without one.

    This is done within each level of the other factors that make groups. There is nothing to
    compare of one level, and of too many.
    """
    if factor is None:
        return
    levels = _levels_in_order(specimens, factor)
    if not 2 <= len(levels) <= _MOST_LEVELS:
        return
    other_factors = [name for name in grouped_by if name != factor]
    strata = _by_levels(specimens, other_factors)
    for k, quantity in enumerate(quantities):
        for stratum, members in strata.items():
            within = dict(zip(other_factors, stratum, strict=True))
            by_level = grouped(members, lambda specimen: specimen.factor(factor))
            for pair in combinations(filter(by_level.__contains__, levels), 2):
                before, after = (by_level[level] for level in pair)
                labels = {
                    "quantity": k,
                    "within": within,
                    "factor": factor,
                    "levels": pair,
                    "left_out": _left_out([*before, *after], k),
                }
                yield labels, _compare(before, after, k, quantity)


def _levels_in_order(specimens: Specimens, factor: str) -> list[str]:
    """Levels of a factor that are given, as they come; before stands before after."""
    levels = [*filter(None, dict.fromkeys(specimen.factor(factor) for specimen in specimens))]
    if [level.casefold() for level in levels] == ["after", "before"]:
        levels.reverse()
    return levels


def _compare(
    first: Specimens, second: Specimens, k: int, quantity: Quantity
) -> analyze.SheetDifference:
    """Compare two sets of specimens: paired where they have sheets in common, by named fields.

    ``k``: number of the quantity. Without names for all fields, the means of sheets pair.
    """
    paired = not {s.sheet for s in first}.isdisjoint(s.sheet for s in second)
    has_fields = paired and all(map(_have_fields, (first, second)))
    fields = [_fields(specimens, k, with_names=has_fields) for specimens in (first, second)]
    if quantity.what == "r":
        difference = analyze.difference_of_pooled_r(*fields, paired=paired)
    else:
        difference = analyze.paired_over_sheets(*fields) if paired else analyze.two_groups(*fields)
    sheets = dict.fromkeys(specimen.sheet for specimen in (*first, *second))
    unpaired = tuple(sheet for sheet in sheets if sheet in difference.unpaired)
    return difference.model_copy(update={"unpaired": unpaired})


def _have_fields(specimens: Specimens) -> bool:
    """Whether all specimens name their fields, each of a sheet once."""
    fields = [(specimen.sheet, specimen.factor("field")) for specimen in specimens]
    return all(name for _, name in fields) and len({*fields}) == len(fields)
