"""What a series of specimens says: means over sheets, differences between papers or treatments, pooled r."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import planish
from planish.analyze import (
    Equivalence,
    Fields,
    PooledCorrelation,
    RandomEffects,
    SheetDifference,
    difference_of_pooled_r,
    equivalence,
    over_sheets,
    p_of_tables,
    paired_over_sheets,
    pooled_r,
    two_groups,
    variances_of,
)
from planish.core.errors import InputError
from planish.core.series_results import (
    Cell,
    DifferenceFacts,
    EquivalenceFacts,
    GroupFacts,
    HeterogeneityFacts,
    Quantity,
    SeriesResults,
    Specimen,
    VarianceFacts,
)
from planish.core.text import likely
from planish.series.cautions import cautions_of
from planish.series.declared import Declared
from planish.series.gather import Gathered
from planish.series.quantities import Layers, cells_of, margin_of, quantities_of

_NEST = ("sheet", "field")
_HELD_APART = ("paper", "treatment", "side")
_MOST_LEVELS = 8
_FIRST, _THEN = "before", "after"


class _Pair(NamedTuple):
    """One quantity of two levels of a factor, where all other factors that make groups are the same."""

    quantity: int
    within: dict[str, str]
    levels: tuple[str, str]
    found: SheetDifference
    left_out: tuple[str, ...]


def summary_of(found: Gathered, declared: Declared) -> SeriesResults:
    """Say what a series of specimens says, over sheets.

    Parameters
    ----------
    found : Gathered
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
    Specimens with one ``paper`` and ``sheet`` are fields of one sheet; a specimen without a ``sheet`` counts as a sheet
    of its own. Groups are made of the levels of ``paper``, ``treatment``, ``side`` and of the factor that is compared,
    where they vary. Two levels are compared where all other factors of the groups are the same: paired where they have
    sheets in common, else as two groups (Welch). p is put right for all differences together (Holm). A figure that is
    withheld takes part in nothing; a doubtful one does only where that was declared.
    """
    factors = tuple(dict.fromkeys(name for member in found.members for name in member.factors))
    compared_by = _compared_by(found, factors, declared)
    apart = [*_HELD_APART] if compared_by is None else [*_HELD_APART, compared_by]
    grouped_by = tuple(
        name for name in dict.fromkeys(apart)
        if name in factors and len(_levels(found, name)) > 1
    )  # fmt: skip
    quantities = quantities_of(found, declared)
    specimens = _specimens(found, quantities, declared)
    counted = [one for one in specimens if one.kind is not None]
    groups = [
        _group(counted, k, q, dict(zip(grouped_by, key, strict=True)))
        for key in dict.fromkeys(_key(one, grouped_by) for one in counted)
        for k, q in enumerate(quantities)
    ]
    pairs = _pairs(counted, quantities, compared_by, grouped_by)
    held = p_of_tables([pair.found for pair in pairs])
    differences = [
        _difference(pair._replace(found=d), compared_by or "", margin_of(quantities[pair.quantity], declared))
        for pair, d in zip(pairs, held, strict=True)
    ]
    return SeriesResults(
        planish=planish.__version__, declared=declared.model_dump(mode="json"), quantities=quantities,
        headline_declared=bool(declared.headline), factors=factors, grouped_by=grouped_by, compared_by=compared_by,
        sheets_given=bool(counted) and all(one.member.factors.get("sheet") for one in counted),
        specimens=tuple(specimens), groups=tuple(groups), differences=tuple(differences),
        instruments=tuple(one for brief in found.briefs.values() for one in brief.instruments),
        cautions=tuple(cautions_of(found, specimens, quantities, grouped_by, compared_by, _MOST_LEVELS)),
    )  # fmt: skip


def _compared_by(found: Gathered, factors: Sequence[str], declared: Declared) -> str | None:
    """The factor that is compared."""
    name = declared.compare
    if name is None:
        usual = ("treatment", "paper", "side")
        return next((f for f in usual if f in factors and len(_levels(found, f)) > 1), None)
    # Tables are read in small letters.
    alike = [f for f in factors if f.casefold() == name.casefold()]
    name = name if name in factors or not alike else alike[0]
    if name in _NEST:
        raise InputError(
            f"{name.capitalize()}s are the sample and are not compared with each other. Compare by another factor: "
            f"{', '.join(f for f in factors if f not in _NEST) or 'the table has none yet'}."
        )
    if name not in factors:
        raise InputError(
            f"No specimen has a factor {name}; there are {', '.join(factors) or 'none'}.{likely(name, factors)} Add "
            "such a column to the table, or compare by another factor."
        )
    return name


def _levels(found: Gathered, factor: str) -> list[str]:
    """Levels of a factor among the specimens with a run, in the order of the table; before comes before after."""
    there = [m.factors.get(factor, "") for m in found.members if m.name in found.briefs]
    return _ordered([level for level in dict.fromkeys(there) if level])


def _ordered(levels: list[str]) -> list[str]:
    small = [level.casefold() for level in levels]
    return levels[::-1] if small == [_THEN, _FIRST] else levels


def _specimens(found: Gathered, quantities: Sequence[Quantity], declared: Declared) -> list[Specimen]:
    layers, rows = Layers(found.briefs), dict[str, list[Any]]()
    for row in found.rows:
        rows.setdefault(row.specimen, []).append(row)
    of_volumes: dict[tuple[str, ...], str] = {}
    out: list[Specimen] = []
    for member in found.members:
        brief = found.briefs.get(member.name)
        if brief is None:
            out.append(Specimen(member=member))
            continue
        # Without a sheet's name, the same volume is the same sheet for certain.
        own = f"specimen {of_volumes.setdefault(brief.volumes, member.name)}"
        paper, sheet = member.factors.get("paper", ""), member.factors.get("sheet", "")
        out.append(
            Specimen(
                member=member,
                kind=brief.kind,
                light=brief.light,
                spoken=brief.spoken,
                marks_used=brief.marks_used,
                leave_one_out_um=brief.leave_one_out_um,
                expected_error_um=brief.expected_error_um,
                sheet=" ".join(filter(None, (paper, f"sheet {sheet}"))) if sheet else own,
                cells=cells_of(member.name, rows[member.name], quantities, layers, doubtful=declared.doubtful),
            )
        )
    return out


def _key(one: Specimen, factors: Sequence[str]) -> tuple[str, ...]:
    return tuple(one.member.factors.get(name, "") for name in factors)


def _fields(specimens: Sequence[Specimen], k: int, *, named: bool = False) -> Fields:
    """One quantity of some specimens; those that do not count are missing."""
    cells = [one.cells[k] for one in specimens]
    names = [one.member.factors.get("field", "") for one in specimens] if named else []
    return Fields([_value(c) for c in cells], [one.sheet for one in specimens], names)


def _value(cell: Cell) -> float:
    return cell.value if cell.counts and cell.value is not None else math.nan


def _names_fields(*groups: Sequence[Specimen]) -> bool:
    """Whether every field of some groups has a name, unlike all others of its sheet."""
    keys = [[(one.sheet, one.member.factors.get("field", "")) for one in specimens] for specimens in groups]
    return all(all(field for _, field in own) and len(set(own)) == len(own) for own in keys)


def _group(specimens: Sequence[Specimen], k: int, quantity: Quantity, group: Mapping[str, str]) -> GroupFacts:
    own = [one for one in specimens if _key(one, [*group]) == tuple(group.values())]
    fields = _fields(own, k)
    about: dict[str, Any] = {"quantity": k, "group": dict(group), "left_out": _left_out(own, k)}
    if quantity.what == "r":
        n_eff = [math.nan if (n := one.cells[k].n_eff_interval) is None else n for one in own]
        pooled: PooledCorrelation = pooled_r(fields, n_eff)
        return GroupFacts(
            **about, sheets=pooled.sheets, fields=pooled.fields, mean=pooled.r, interval=pooled.interval,
            reason=pooled.reason, between_sheets=_heterogeneity(pooled.between_sheets),
            between_fields=_heterogeneity(pooled.between_fields),
        )  # fmt: skip
    mean, variances = over_sheets(fields), variances_of(fields)
    return GroupFacts(
        **about, sheets=mean.sheets, fields=mean.fields, mean=mean.mean, sd=mean.sd, interval=mean.interval,
        reason=mean.reason,
        variances=VarianceFacts(
            sd_between=_root(variances.between), sd_within=_root(variances.within), share=variances.share,
            share_interval=variances.share_interval, p=variances.p, reason=variances.reason,
        ),
    )  # fmt: skip


def _root(variance: float) -> float | None:
    return math.sqrt(variance) if math.isfinite(variance) else None


def _heterogeneity(found: RandomEffects | None) -> HeterogeneityFacts | None:
    if found is None:
        return None
    return HeterogeneityFacts(
        effects=found.effects, sd_between=math.sqrt(found.between), i2=found.i2, q=found.q, p=found.q_p
    )


def _left_out(specimens: Sequence[Specimen], k: int) -> tuple[str, ...]:
    return tuple(one.member.name for one in specimens if not one.cells[k].counts)


def _pairs(
    specimens: Sequence[Specimen], quantities: Sequence[Quantity], factor: str | None, grouped_by: Sequence[str]
) -> list[_Pair]:
    """Every quantity of every two levels of a factor, within each level of the others."""
    if factor is None:
        return []
    others = [name for name in grouped_by if name != factor]
    levels = _ordered([*dict.fromkeys(level for one in specimens if (level := one.member.factors.get(factor, "")))])
    if not 2 <= len(levels) <= _MOST_LEVELS:
        return []
    out: list[_Pair] = []
    for k, quantity in enumerate(quantities):
        for key in dict.fromkeys(_key(one, others) for one in specimens):
            stratum = [one for one in specimens if _key(one, others) == key]
            within = dict(zip(others, key, strict=True))
            for i, first in enumerate(levels):
                for second in levels[i + 1 :]:
                    both = [[one for one in stratum if one.member.factors.get(factor) == v] for v in (first, second)]
                    if all(both):
                        found = _compare(both[0], both[1], k, quantity)
                        out.append(_Pair(k, within, (first, second), found, _left_out([*both[0], *both[1]], k)))
    return out


def _compare(first: Sequence[Specimen], second: Sequence[Specimen], k: int, quantity: Quantity) -> SheetDifference:
    """Compare two sets of specimens: paired where they have sheets in common."""
    paired = bool({one.sheet for one in first} & {one.sheet for one in second})
    named = paired and _names_fields(first, second)
    one, two = _fields(first, k, named=named), _fields(second, k, named=named)
    if quantity.what == "r":
        found = difference_of_pooled_r(one, two, paired=paired)
    else:
        found = paired_over_sheets(one, two) if paired else two_groups(one, two)
    return replace(found, unpaired=tuple(sorted(set(found.unpaired), key=[o.sheet for o in (*first, *second)].index)))


def _difference(pair: _Pair, factor: str, margin: float | None) -> DifferenceFacts:
    found, held = pair.found, None
    if margin is not None:
        shown: Equivalence = equivalence(found, margin=margin)
        held = EquivalenceFacts(margin=shown.margin, interval=shown.interval, p=shown.p, verdict=shown.verdict)
    return DifferenceFacts(
        quantity=pair.quantity, within=pair.within, factor=factor, levels=pair.levels, kind=found.kind,
        sheets=found.sheets, means=found.means, difference=found.difference, interval=found.interval, p=found.p,
        p_of_table=found.p_of_table, smallest_seen=found.smallest_seen(), unpaired=found.unpaired,
        left_out=pair.left_out, reason=found.reason, equivalence=held,
    )  # fmt: skip
