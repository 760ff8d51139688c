"""Sentences and numbers of a series of specimens, with the digits that their intervals allow."""

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import cast

from planish.core.facts import is_known
from planish.core.numbers import (
    NONE,
    axis_label,
    capital,
    count,
    fixed,
    interval_text,
    number,
    percent,
    to_spread,
    typeset,
    unit,
)
from planish.core.typing import Pair
from planish.report.statement import decimals_of_r, p_text
from planish.report.summary import KeyFigure
from planish.series_results import Cell, DifferenceFacts, GroupFacts, Quantity, SeriesResults

_LED = 2  # differences of one quantity in the first sentences
_CLOSE = 0.995  # r of two measurements of one quantity
_OF_CLOSE = 5  # its decimals
_NAMED = 6  # specimens that are left out, in a cell
_STATES = {
    "whole": "complete",
    "withheld": "with a check that failed",
    "refused": "refused",
    "damaged": "damaged",
    "open": "not done yet",
}


def lead(results: SeriesResults) -> str:
    """State the result of a series in a sentence with its interval.

    That is differences where something is compared, else the means of the first group.
    """
    if not any(specimen.kind for specimen in results.specimens):
        return f"No specimen has a run that can be read. {states(results)}"
    if results.differences:
        return _lead_of_differences(results)
    groups = [group for group in results.groups if group.fields]
    if not groups:
        return f"Nothing can be compared: no figure of any specimen counts. {states(results)}"
    first_groups = [group for group in groups if group.group == groups[0].group]
    main_groups = [g for g in first_groups if results.quantities[g.quantity].what in ("mean", "r")]
    return " ".join(group_sentence(group, results) for group in main_groups[:2])


def _lead_of_differences(results: SeriesResults) -> str:
    """The first differences of the first quantity, and how many of all are distinguishable."""
    first_quantity = results.differences[0].quantity
    same_quantity = [d for d in results.differences if d.quantity == first_quantity]
    sentences = [difference(d, results) for d in same_quantity[:_LED]]
    if len(same_quantity) > _LED:
        sentences.append(f"{len(same_quantity) - _LED} more of this quantity are listed below.")
    verdicts = Counter(d.verdict for d in results.differences)
    n_differences = verdicts.total()
    n_differ = verdicts["differ"]
    n_unknown = verdicts["unknown"]
    if n_unknown == n_differences > 1:
        sentences.append(f"None of {n_differences} differences is known.")
    elif n_differences > 1:
        differ_text = {0: "none is", 1: "1 is"}.get(n_differ, f"{n_differ} are")
        unknown_text = f"; {n_unknown} not known" if n_unknown else ""
        sentences.append(
            f"Of {n_differences} differences, {differ_text} distinguishable after"
            f" Holm{unknown_text}."
        )
    return " ".join(sentences)


def states(results: SeriesResults) -> str:
    """Say what became of the specimens."""
    counts = Counter(member.state for member in results.members)
    total = len(results.specimens)
    if counts["whole"] == total == 1:
        return "The specimen is complete."
    if counts["whole"] == total:
        return f"All {total} specimens are complete."
    texts = [f"{counts[state]} {text}" for state, text in _STATES.items() if counts[state]]
    return f"Of {total} specimens, {', '.join(texts)}."


def light_of(results: SeriesResults) -> str:
    """The colour that the first lines have: the class of the style."""
    states = {member.state for member in results.members}
    if "whole" not in states:
        return "fail"
    is_complete = states == {"whole"} and not any(g.left_out for g in results.groups)
    return "pass" if is_complete else "look"


def value(v: float | None, q: Quantity, limits: Pair | None = None) -> str:
    """Write a value of a quantity.

    A share is written in per cent, r with two decimals, others by the width of an interval:
    ``limits``, None where there is none.
    """
    if v is None or not is_known(v):
        return NONE
    known_limits = limits if is_known(limits) else None
    if q.what == "r":
        is_close = abs(v) > _CLOSE and known_limits is None
        return fixed(v, _OF_CLOSE if is_close else decimals_of_r(known_limits))
    factor, digits = 1, 3
    if q.what == "thin_share":
        factor, digits = 100, 2
    if known_limits is not None:
        low, high = known_limits
        return to_spread(factor * v, factor * (high - low) / 2)
    return number(factor * v, digits)


def units(q: Quantity, *, change: bool = False) -> str:
    """Unit as it is written behind a value; of a change of shares, percentage points."""
    if q.what == "thin_share":
        return "% points" if change else "%"
    return unit(q.unit)


def with_units(text: str, q: Quantity, *, change: bool = False) -> str:
    """Put the unit behind a value, or behind a change of values."""
    if text == NONE or not units(q):
        return text
    return f"{text}\u202f{units(q, change=change)}"


def margin_text(margin: float, q: Quantity) -> str:
    """Write a declared margin as it was given."""
    return with_units(f"{100 * margin if q.what == 'thin_share' else margin:g}", q, change=True)


def title(q: Quantity) -> str:
    """Title of a quantity at the beginning of a line; r stays small."""
    text = typeset(q.title)
    return text if q.what == "r" else capital(text)


def interval(limits: Pair | None, q: Quantity) -> str:
    """Write both ends of an interval."""
    if limits is None or not is_known(limits):
        return NONE
    return f"{value(limits[0], q, limits)} to {value(limits[1], q, limits)}"


def short(q: Quantity) -> str:
    """Heading of a column: the statistic with its unit."""
    size_text = "" if q.at_um is None else f"{q.at_um:g} µm"
    name = {
        "mean": "Mean",
        "sd": "Standard deviation",
        "thin_share": f"Below {size_text}" if q.at_um else "Uncovered area",
        "r": f"r with {q.other_layer or 'the image'}, points of {size_text}",
    }[q.what]
    return axis_label(name, units(q))


def cell_text(cell: Cell, q: Quantity) -> str:
    """Write a quantity of one specimen; r with its interval below."""
    if q.what == "r" and cell.low is not None and cell.high is not None:
        limits = (cell.low, cell.high)
        digits = decimals_of_r(limits)
        return f"{fixed(cell.value, digits)}\n{interval_text(limits, digits)}"
    return value(cell.value, q)


def label(group: Mapping[str, str]) -> str:
    """Name a group by the levels of its factors."""
    levels = [level or f"{name} not given" for name, level in group.items()]
    return ", ".join(levels) or "all specimens"


def sheets_text(n: int) -> str:
    """So many sheets."""
    return "1 sheet" if n == 1 else f"{count(n)} sheets"


def group_sentence(g: GroupFacts, results: SeriesResults) -> str:
    """State the mean over the sheets of a group, with its interval or why there is none."""
    q = results.quantities[g.quantity]
    group_text = f"{label(g.group)}: " if g.group else ""
    count_text = f"{sheets_text(g.sheets)}, {g.fields} field{'s' if g.fields != 1 else ''}"
    mean_text = with_units(value(g.mean, q, g.interval), q)
    sentence = f"{group_text}{'' if q.what == 'r' else 'the '}{typeset(q.title)} is {mean_text}"
    if is_known(g.interval):
        sentence += f" (95 %: {with_units(interval(g.interval, q), q)}; {count_text})."
    else:
        sentence += f"{f', without an interval: {g.reason}' if g.reason else ''} ({count_text})."
    return sentence if sentence.startswith("r of") else capital(sentence)  # r stays small


def difference(d: DifferenceFacts, results: SeriesResults) -> str:
    """State one difference, and whether it is distinguishable.

    Where a margin was declared, whether the levels are equivalent, too.
    """
    q = results.quantities[d.quantity]
    first, second = d.levels
    group_text = f"{label(d.within)}: " if d.within else ""
    quantity_text = typeset(q.title)
    names = f"{first} and {second}"
    if not is_known(d.interval):
        unknown_text = f"it is not known whether {names} differ in {quantity_text}"
        return capital(f"{group_text}{unknown_text}: {d.reason or 'no figure counts'}.")
    verb = "differ" if d.verdict == "differ" else f"are {verdict(d)}"
    change_text = with_units(signed(d, q), q, change=True)
    equivalence_text = ""
    if d.equivalence is not None and d.equivalence.verdict != "unknown":
        declared_text = f"the declared margin of {margin_text(d.equivalence.margin, q)}"
        equivalence_text = {
            "equivalent": f" They are equivalent within {declared_text}.",
            "larger": f" The difference is larger than {declared_text}.",
            "undecided": f" Smaller than {declared_text} or not: undecided.",
        }[d.equivalence.verdict]
    return capital(
        f"{group_text}{names} {verb} in {quantity_text}: {second} − {first} = {change_text} (95 %:"
        f" {with_units(interval(d.interval, q), q, change=True)}; {sampled(d)}).{equivalence_text}"
    )


def signed(d: DifferenceFacts, q: Quantity) -> str:
    """Write a difference with its sign."""
    text = value(d.difference, q, d.interval)
    return f"+{text}" if d.difference > 0 else text


def sampled(d: DifferenceFacts) -> str:
    """How many sheets a difference is of."""
    if d.kind == "paired":
        return f"{d.sheets[0]} pair{'s' if d.sheets[0] != 1 else ''} of sheets"
    return f"{d.sheets[0]} and {sheets_text(d.sheets[1])}"


def verdict(d: DifferenceFacts) -> str:
    """The verdict on a difference, short."""
    if d.verdict == "unknown":
        return d.reason or "no figure counts"
    return "not distinguishable after Holm" if d.verdict == "not after Holm" else d.verdict


def left_out(names: Sequence[str]) -> str:
    """Name the specimens that do not count, the first of them where they are many."""
    more_text = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more_text if names else "none"


def equivalent(d: DifferenceFacts, q: Quantity) -> str:
    """What a declared margin says; empty without one."""
    e = d.equivalence
    if e is None:
        return ""
    margin = margin_text(e.margin, q)
    text = {
        "equivalent": f"equivalent within ± {margin}",
        "larger": f"larger than ± {margin}",
        "undecided": f"undecided at ± {margin}",
        "unknown": f"± {margin}: not known",
    }[e.verdict]
    if is_known(e.interval):
        text += f" (90 %: {interval(e.interval, q)}; p {p_text(e.p)})"
    return text


def tiles(results: SeriesResults) -> list[KeyFigure]:
    """Give the figures of the leading map.

    They are its differences where something is compared, else its means.
    """
    figures: list[KeyFigure] = []
    for k, q in enumerate(results.quantities):
        if q.map == results.quantities[0].map:
            differences = [d for d in results.differences if d.quantity == k]
            groups = [g for g in results.groups if g.quantity == k and g.fields]
            if differences:
                figures.append(_difference_figure(differences[0], q))
            elif groups:
                figures.append(_mean_figure(groups[0], q))
    return figures[:4]


def _difference_figure(d: DifferenceFacts, q: Quantity) -> KeyFigure:
    group_text = f"{label(d.within)}; " if d.within else ""
    limits = f"95 %: {interval(d.interval, q)}; " if is_known(d.interval) else "no interval: "
    label_text = f"{d.levels[1]} − {d.levels[0]}: {typeset(q.title)}"
    note = f"{group_text}{limits}{verdict(d)}"
    return KeyFigure(signed(d, q), units(q, change=True), label_text, note)


def _mean_figure(g: GroupFacts, q: Quantity) -> KeyFigure:
    group_text = f"{label(g.group)}, " if g.group else ""
    is_stated = is_known(g.interval)
    limits = f"95 %: {interval(g.interval, q)}" if is_stated else f"no interval: {g.reason}"
    note = f"{group_text}{sheets_text(g.sheets)}; {limits}"
    return KeyFigure(value(g.mean, q, g.interval), units(q), typeset(q.title), note)


def heterogeneous(g: GroupFacts, q: Quantity) -> str:
    """Say whether sheets differ by more than their fields' own scatter."""
    if q.what == "r":
        return _heterogeneous_r(g)
    v = g.variances
    if v is None:
        return NONE
    if not is_known(v.sd_within) or not is_known(v.share):
        return v.reason or NONE
    limits_text = ""
    if is_known(v.share_interval):
        low, high = v.share_interval
        limits_text = f" (95 %: {number(100 * low, 2)} to {percent(high, 2)})"
    return (
        f"sd {value(v.sd_between, q)} between, {value(v.sd_within, q)} within; between:"
        f" {percent(v.share, 2)} of the variance{limits_text}, p {p_text(v.p)}"
    )


def _heterogeneous_r(g: GroupFacts) -> str:
    z = g.between_sheets
    if z is None:
        return "one sheet: nothing to compare" if g.sheets == 1 else NONE
    text = "sheets differ beyond" if z.p < 0.05 else "no more than"
    return f"{text} their own scatter: I² {percent(z.i2, 2)}, Q {number(z.q)}, p {p_text(z.p)}"


def spans(results: SeriesResults, columns: Sequence[int]) -> list[tuple[str, int]]:
    """Headings over the columns of one map: its title, and how many there are."""
    grouped = groupby(capital(results.quantities[k].map_title) for k in columns)
    return [(title, len([*columns_of_map])) for title, columns_of_map in grouped]


def declared(results: SeriesResults) -> list[tuple[str, str]]:
    """What was declared, and what the program took where nothing was: headings and texts."""
    options = results.declared
    compared_by = results.compared_by or "nothing: one group"
    maps = dict.fromkeys(q.map for q in results.quantities)
    margins = cast("dict[str, float]", options.get("margin", {}))
    margin_texts = [f"{name} {margin:g}" for name, margin in margins.items()]
    sheets = "named in the table" if results.sheets_given else "not all named: see the cautions"
    usual = "" if options.get("compare") else " (usual)"
    doubtful = "included" if options.get("doubtful") else "left out"
    return [
        ("Compared by", f"{compared_by}{usual}"),
        ("Groups", ", ".join(results.grouped_by) or "one"),
        ("Maps", ", ".join(maps) or NONE),
        ("Margins", ", ".join(margin_texts) or "none declared"),
        ("Doubtful figures", doubtful),
        ("Sheets", sheets),
    ]
