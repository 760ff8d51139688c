"""What a series of specimens says, in sentences and in numbers with the digits that their intervals allow."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from planish.core.series_results import Cell, DifferenceFacts, GroupFacts, Quantity, SeriesResults
from planish.report.statement import decimals_of_r, p_text
from planish.report.summary import Tile
from planish.report.text import NONE, beside, capital, count, fixed, number, typeset, unit

_LED = 2  # differences of one quantity in the first sentences
_CLOSE, _OF_CLOSE = 0.995, 5  # r of two measurements of one quantity, and its decimals
_NAMED = 6  # specimens that are left out, in a cell
_STATES = {
    "whole": "whole", "withheld": "with a check that failed", "refused": "refused", "damaged": "damaged",
    "open": "not done yet",
}  # fmt: skip


def lead(results: SeriesResults) -> str:
    """Say what was found, in a sentence with its interval."""
    if not any(one.kind for one in results.specimens):
        return f"No specimen has a run that can be read. {states(results)}"
    if results.differences:
        first = results.differences[0]
        alike = [d for d in results.differences if d.quantity == first.quantity]
        more = f" {_among(results)}" if len(results.differences) > 1 else ""
        said = " ".join(difference(d, results) for d in alike[:_LED])
        other = f" {len(alike) - _LED} more of this quantity stand below." if len(alike) > _LED else ""
        return f"{said}{other}{more}"
    own = [g for g in results.groups if g.fields]
    if not own:
        return f"Nothing can be compared: no figure of any specimen counts. {states(results)}"
    groups = [g for g in own if g.group == own[0].group]
    shown = [g for g in groups if results.quantities[g.quantity].what in ("mean", "r")][:2]
    return " ".join(group_sentence(g, results) for g in shown)


def _among(results: SeriesResults) -> str:
    """How many of all differences are distinguishable."""
    total, seen = len(results.differences), sum(d.verdict == "differ" for d in results.differences)
    unknown = sum(d.verdict == "unknown" for d in results.differences)
    if unknown == total:
        return f"None of {total} differences can be told."
    words = "none is" if seen == 0 else "1 is" if seen == 1 else f"{seen} are"
    tail = f"; {unknown} cannot be told" if unknown else ""
    return f"Of {total} differences, {words} distinguishable after Holm{tail}."


def states(results: SeriesResults) -> str:
    """Say what became of the specimens."""
    counts, total = Counter(one.member.state for one in results.specimens), len(results.specimens)
    if counts["whole"] == total:
        return f"All {total} specimens are whole." if total > 1 else "The specimen is whole."
    parts = [f"{counts[state]} {words}" for state, words in _STATES.items() if counts[state]]
    return f"Of {total} specimens, {', '.join(parts)}."


def light_of(results: SeriesResults) -> str:
    """The colour that the first lines have: the class of the style."""
    members = results.members
    if not any(m.state == "whole" for m in members):
        return "fail"
    out = any(m.state != "whole" for m in members) or any(g.left_out for g in results.groups)
    return "look" if out else "pass"


# --- numbers -------------------------------------------------------------------------------------------------------


def value(v: float | None, q: Quantity, spread: float | None = None) -> str:
    """Write a value of a quantity: a share in per cent, r with two decimals, others by their spread."""
    if v is None:
        return NONE
    if q.what == "thin_share":
        return number(100 * v, 2) if spread is None else beside(100 * v, 100 * spread)
    if q.what == "r":
        ends = None if spread is None else (v - spread, v + spread)
        return fixed(v, _OF_CLOSE if abs(v) > _CLOSE and spread is None else decimals_of_r(ends))
    return number(v) if spread is None else beside(v, spread)


def units(q: Quantity) -> str:
    """Unit as it is written behind a value."""
    return "%" if q.what == "thin_share" else unit(q.unit)


def with_units(text: str, q: Quantity) -> str:
    """Put the unit behind a value."""
    return f"{text}\u202f{units(q)}" if units(q) and text != NONE else text


def with_points(text: str, q: Quantity) -> str:
    """Put the unit of a difference behind it: of two shares in per cent, percentage points."""
    return f"{text}\u202f% points" if q.what == "thin_share" and text != NONE else with_units(text, q)


def margin_text(margin: float, q: Quantity) -> str:
    """Write a declared margin as it was given."""
    return with_points(f"{100 * margin if q.what == 'thin_share' else margin:g}", q)


def title(q: Quantity) -> str:
    """Title of a quantity at the beginning of a line; r stays small."""
    return typeset(q.title) if q.what == "r" else capital(typeset(q.title))


def interval(limits: tuple[float, float] | None, q: Quantity) -> str:
    """Write both ends of an interval."""
    if limits is None:
        return NONE
    spread = (limits[1] - limits[0]) / 2
    return f"{value(limits[0], q, spread)} to {value(limits[1], q, spread)}"


def short(q: Quantity) -> str:
    """Heading of a column: the statistic with its unit."""
    at = "" if q.at_um is None else f"{q.at_um:g} µm"
    name = {"mean": "Mean", "sd": "Standard deviation", "thin_share": f"Below {at}" if q.at_um else "Bare",
            "r": f"r with {q.other_layer or 'the image'}, points of {at}"}[q.what]  # fmt: skip
    return f"{name} / {units(q)}" if units(q) else name


def cell_text(cell: Cell, q: Quantity) -> str:
    """Write a quantity of one specimen; r with its interval below."""
    text = value(cell.value, q)
    if q.what == "r" and cell.low is not None and cell.high is not None:
        digits = decimals_of_r((cell.low, cell.high))
        return f"{fixed(cell.value, digits)}\n{fixed(cell.low, digits)} to {fixed(cell.high, digits)}"
    return text


def label(group: Mapping[str, str]) -> str:
    """Name a group by the levels of its factors."""
    return ", ".join(level or f"{name} not given" for name, level in group.items()) or "all specimens"


def sheets_text(n: int) -> str:
    """So many sheets."""
    return "1 sheet" if n == 1 else f"{count(n)} sheets"


# --- sentences -----------------------------------------------------------------------------------------------------


def group_sentence(g: GroupFacts, results: SeriesResults) -> str:
    """State the mean over the sheets of a group."""
    q = results.quantities[g.quantity]
    of = "" if not g.group else f"{label(g.group)}: "
    over = f"{sheets_text(g.sheets)}, {g.fields} field{'s' if g.fields != 1 else ''}"
    mean = with_units(value(g.mean, q, half(g.interval)), q)
    said = f"{'' if q.what == 'r' else 'the '}{typeset(q.title)} is {mean}"
    if g.interval is None:
        said += f", without an interval: {g.reason}" if g.reason else ""
        return _begin(f"{of}{said} ({over}).")
    return _begin(f"{of}{said} (95 %: {with_units(interval(g.interval, q), q)}; {over}).")


def _begin(text: str) -> str:
    """Begin a sentence; r stays small."""
    return text if text.startswith("r of") else capital(text)


def difference(d: DifferenceFacts, results: SeriesResults) -> str:
    """State one difference, and whether it is distinguishable."""
    q, (first, second) = results.quantities[d.quantity], d.levels
    of = f"{label(d.within)}: " if d.within else ""
    of_what, names = typeset(q.title), f"{first} and {second}"
    if d.interval is None:
        return capital(f"{of}whether {names} differ in {of_what} cannot be told: {d.reason or 'no figure counts'}.")
    verdict = {"differ": "differ", "not after Holm": "are not distinguishable after Holm",
               "not distinguishable": "are not distinguishable"}[d.verdict]  # fmt: skip
    change = with_points(signed(d.difference, q, half(d.interval)), q)
    return capital(
        f"{of}{names} {verdict} in {of_what}: {second} − {first} = {change} "
        f"(95 %: {with_points(interval(d.interval, q), q)}; {sampled(d)}).{_within_margin(d, q)}"
    )


def _within_margin(d: DifferenceFacts, q: Quantity) -> str:
    """Say what a declared margin makes of a difference; empty without one."""
    e = d.equivalence
    if e is None or e.verdict == "unknown":
        return ""
    margin = margin_text(e.margin, q)
    return {"equivalent": f" They are equivalent within the declared margin of {margin}.",
            "larger": f" The difference is larger than the declared margin of {margin}.",
            "undecided": f" Smaller than the declared margin of {margin} or not: undecided."}[e.verdict]  # fmt: skip


def signed(v: float | None, q: Quantity, spread: float | None) -> str:
    """Write a difference with its sign."""
    text = value(v, q, spread)
    return f"+{text}" if v is not None and v > 0 else text


def sampled(d: DifferenceFacts) -> str:
    """How many sheets a difference is of."""
    if d.kind == "paired":
        return f"{d.sheets[0]} pair{'s' if d.sheets[0] != 1 else ''} of sheets"
    return f"{d.sheets[0]} and {sheets_text(d.sheets[1])}"


def verdict(d: DifferenceFacts) -> str:
    """The verdict on a difference, short."""
    return {
        "differ": "differ", "not after Holm": "not distinguishable after Holm",
        "not distinguishable": "not distinguishable", "unknown": d.reason or "no figure counts",
    }[d.verdict]  # fmt: skip


def left_out(names: Sequence[str]) -> str:
    """Name the specimens that do not count, the first of them where they are many."""
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more if names else "none"


def equivalent(d: DifferenceFacts, q: Quantity) -> str:
    """What a declared margin says; empty without one."""
    e = d.equivalence
    if e is None:
        return ""
    margin = margin_text(e.margin, q)
    words = {"equivalent": f"equivalent within ± {margin}", "larger": f"larger than ± {margin}",
             "undecided": f"undecided at ± {margin}", "unknown": f"± {margin}: cannot be told"}[e.verdict]  # fmt: skip
    return words if e.interval is None else f"{words} (90 %: {interval(e.interval, q)}; p {p_text(e.p)})"


def tiles(results: SeriesResults) -> list[Tile]:
    """The leading map's figures: their differences where something is compared, else their means."""
    out: list[Tile] = []
    first = results.quantities[0].map if results.quantities else ""
    for k, q in enumerate(results.quantities):
        if q.map != first or len(out) == 4:
            continue
        d = next((d for d in results.differences if d.quantity == k), None)
        g = next((g for g in results.groups if g.quantity == k and g.fields), None)
        if d is not None:
            of = f"{label(d.within)}; " if d.within else ""
            note = (
                f"{of}95 %: {interval(d.interval, q)}; {verdict(d)}" if d.interval else f"{of}no interval: {verdict(d)}"
            )
            about = f"{d.levels[1]} − {d.levels[0]}: {typeset(q.title)}"
            out.append(
                Tile(
                    signed(d.difference, q, half(d.interval)),
                    "% points" if q.what == "thin_share" else units(q),
                    about,
                    note,
                )
            )
        elif g is not None:
            note = f"95 %: {interval(g.interval, q)}" if g.interval else f"no interval: {g.reason}"
            of = f"{label(g.group)}, " if g.group else ""
            out.append(
                Tile(
                    value(g.mean, q, half(g.interval)),
                    units(q),
                    typeset(q.title),
                    f"{of}{sheets_text(g.sheets)}; {note}",
                )
            )
    return out


def heterogeneous(g: GroupFacts, q: Quantity) -> str:
    """Say whether sheets differ by more than their fields' own scatter."""
    if q.what == "r":
        found = g.between_sheets
        if found is None:
            return "one sheet: nothing to compare" if g.sheets == 1 else NONE
        share = f"I² {number(100 * (found.i2 or 0.0), 2)}\u202f%, Q {number(found.q)}, p {p_text(found.p)}"
        more = "sheets differ beyond their own scatter" if (found.p or 1.0) < 0.05 else "no more than their own scatter"
        return f"{more}: {share}"
    v = g.variances
    if v is None or v.sd_within is None or v.share is None:
        return (v.reason if v else "") or NONE
    share = f"{number(100 * v.share, 2)}\u202f% of the variance"
    limits = v.share_interval
    ends = f" (95 %: {number(100 * limits[0], 2)} to {number(100 * limits[1], 2)}\u202f%)" if limits else ""
    sds = f"sd {value(v.sd_between, q)} between, {value(v.sd_within, q)} within"
    return f"{sds}; between: {share}{ends}, p {p_text(v.p)}"


def half(limits: tuple[float, float] | None) -> float | None:
    """Half the width of an interval: what digits are written by."""
    return None if limits is None else (limits[1] - limits[0]) / 2


def spans(results: SeriesResults, columns: Sequence[int]) -> list[tuple[str, int]]:
    """Headings over the columns of one map: its title, and how many there are."""
    out: list[tuple[str, int]] = []
    for k in columns:
        title = capital(results.quantities[k].map_title)
        if out and out[-1][0] == title:
            out[-1] = (title, out[-1][1] + 1)
        else:
            out.append((title, 1))
    return out


def declared(results: SeriesResults) -> list[tuple[str, str]]:
    """What was declared, and what the program took where nothing was."""
    said: Mapping[str, object] = results.declared
    margins = said.get("margin")
    rows = [
        ("Compared by", f"{results.compared_by or 'nothing: one group'}{'' if said.get('compare') else ' (usual)'}"),
        ("Groups", ", ".join(results.grouped_by) or "one"),
        ("Maps", ", ".join(dict.fromkeys(q.map for q in results.quantities)) or NONE),
        ("Margins", ", ".join(f"{k} {v:g}" for k, v in margins.items()) if isinstance(margins, dict) and margins
         else "none declared"),
        ("Doubtful figures", "take part" if said.get("doubtful") else "take part in nothing"),
        ("Sheets", "named in the table" if results.sheets_given else "not all named: see the cautions"),
    ]  # fmt: skip
    return rows


def plain_words(said: str) -> str:
    """Write a sentence for a terminal: units in ASCII, usual blanks and minus signs."""
    return said.replace("\u202f", " ").replace("µm", "um").replace("−", "-").replace("±", "+-").replace("²", "2")
