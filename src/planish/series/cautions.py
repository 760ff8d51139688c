"""What a reader of a series has to be careful about: what was left out, what does not match."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

from planish.core.series_results import FACTORS, Quantity, Specimen
from planish.series.gather import Gathered

_NEST = ("sheet", "field")
_MOST_NAMES = 6
_UNLIKE = 1.05  # ratio of supports, from which on standard deviations are of different things


def cautions_of(
    found: Gathered, specimens: Sequence[Specimen], quantities: Sequence[Quantity], grouped_by: Sequence[str],
    compared_by: str | None, most_levels: int,
) -> Iterator[str]:  # fmt: skip
    """Give one sentence for each thing to be careful about, what changes a figure first."""
    counted = [one for one in specimens if one.kind is not None]
    yield from _left_out(counted, quantities)
    yield from _sheets(found, counted)
    yield from _factors(counted, grouped_by, compared_by, most_levels)
    yield from _kinds(counted)
    yield from _supports(found, counted, quantities)


def _left_out(counted: Sequence[Specimen], quantities: Sequence[Quantity]) -> Iterator[str]:
    for word, meaning in (("withheld", "a check failed"), ("doubtful", "a check asks for a look")):
        of = {
            one.member.name: [q.title for q, c in zip(quantities, one.cells, strict=True) if c.why_not.startswith(word)]
            for one in counted
        }
        names = [name for name, titles in of.items() if titles]
        if names:
            every = all(len(titles) == len(quantities) for titles in of.values() if titles)
            what = "all figures" if every else "some figures (marked in the table)"
            yield (
                f"{word.capitalize()} figures take part in no mean and no comparison, because {meaning}: {what} of "
                f"{listed(names)}."
            )
        if word == "doubtful":
            kept = [
                one.member.name for one in counted if any(c.trust == "doubtful" and c.counts for c in one.cells)
            ]  # fmt: skip
            if kept:
                yield (
                    f"Doubtful figures take part in means and comparisons, as was declared: those of {listed(kept)}."
                )
    few = [one.member.name for one in counted if any(c.why_not.startswith("too few") for c in one.cells)]
    if few:
        yield f"r of {listed(few)} takes part in nothing: there are too few independent points for an interval."
    sizes = [one.member.name for one in counted if any(c.why_not.startswith("points of") for c in one.cells)]
    if sizes:
        yield (
            f"r of {listed(sizes)} is over points of another size and takes part in nothing. Link these with the "
            "--point-um of the others."
        )


def _sheets(found: Gathered, counted: Sequence[Specimen]) -> Iterator[str]:
    without = [one.member.name for one in counted if not one.member.factors.get("sheet")]
    if without and len(counted) > 1:
        which = (
            "The table names no sheets" if len(without) == len(counted) else f"No sheet is named for {listed(without)}"
        )
        yield (
            f"{which}: each specimen counts as a sheet of its own. If some are fields of one sheet, the intervals are "
            "too narrow; if sheets were measured before and after, they do not pair. Add a column sheet."
        )
    shared: dict[tuple[str, ...], list[Specimen]] = {}
    for one in counted:
        shared.setdefault(found.briefs[one.member.name].volumes, []).append(one)
    for same in shared.values():
        names = [one.member.name for one in same]
        if len({one.sheet for one in same}) > 1:
            yield (
                f"{listed(names)} are of the same volume, byte by byte, and yet count as different sheets. Correct the "
                "column sheet."
            )
        elif len(same) > 1 and not same[0].member.factors.get("sheet"):
            yield f"{listed(names)} are of the same volume and count as one sheet."
    both = Counter((one.sheet, *one.member.factors.values()) for one in counted if one.member.factors.get("field"))
    for key, times in both.items():
        if times > 1:
            names = [one.member.name for one in counted if (one.sheet, *one.member.factors.values()) == key]
            yield f"{listed(names)} have the same factors, sheet and field; they count as fields of one sheet."


def _factors(
    counted: Sequence[Specimen], grouped_by: Sequence[str], compared_by: str | None, most_levels: int
) -> Iterator[str]:  # fmt: skip
    factors = dict.fromkeys(name for one in counted for name in one.member.factors)
    levels = {f: [v for one in counted if (v := one.member.factors.get(f, ""))] for f in factors}
    for name in factors:
        spellings = dict.fromkeys(levels[name])
        alike = [v for v in spellings if sum(v.casefold() == w.casefold() for w in spellings) > 1]
        if alike:
            yield f"The levels {listed(alike)} of {name} differ in capitals only and count as different ones."
        if name not in (*_NEST, *grouped_by) and len(spellings) > 1:
            yield (
                f"{name.capitalize()} varies within the groups and is not held apart: means are over all its levels. "
                f"--by {name} compares them."
            )
    for name in grouped_by:
        without = [one.member.name for one in counted if not one.member.factors.get(name)]
        if without:
            yield f"No {name} is given for {listed(without)}; they make a group of their own, compared with none."
    if compared_by is not None:
        if compared_by not in FACTORS:
            yield from _pairs(counted, compared_by)
        many = len(dict.fromkeys(levels[compared_by]))
        if many < 2:
            yield f"There is nothing to compare: {compared_by} has one level among the specimens that have a run."
        if many > most_levels:
            yield (
                f"{compared_by.capitalize()} has {many} levels. Of more than {most_levels}, differences of every two "
                "are not listed: compare fewer of them."
            )


def _pairs(counted: Sequence[Specimen], factor: str) -> Iterator[str]:
    """Sheets that pair by a factor of which the program cannot know whether it is done to a sheet, or tells sheets."""
    levels: dict[str, set[str]] = {}
    for one in counted:
        if one.member.factors.get("sheet") and (level := one.member.factors.get(factor, "")):
            levels.setdefault(one.sheet, set()).add(level)
    if both := [sheet for sheet, own in levels.items() if len(own) > 1]:
        yield (
            f"{listed(both)} stand under several levels of {factor} and count as the same sheets, measured under each. "
            "If they are different ones, call the factor paper, or give each sheet a name of its own."
        )


def _kinds(counted: Sequence[Specimen]) -> Iterator[str]:
    kinds = Counter(one.kind for one in counted)
    if len(kinds) > 1:
        words = {"map": "maps without an image", "sheet on image": "links to an image", "two volumes": "links of two "
                 "volumes", "layers": "links of several layers"}  # fmt: skip
        found = ", ".join(f"{n} {words[str(kind)]}" for kind, n in kinds.items())
        yield f"The runs are of different kinds ({found}): only figures that are of the same maps meet."


def _supports(found: Gathered, counted: Sequence[Specimen], quantities: Sequence[Quantity]) -> Iterator[str]:
    """Standard deviations and thin shares depend on the size of what one value stands for."""
    sizes = [um for one in counted if (um := found.briefs[one.member.name].column_um) is not None]
    if sizes and max(sizes) > _UNLIKE * min(sizes) and any(q.what in ("sd", "thin_share") for q in quantities):
        yield (
            f"Columns are {min(sizes):.3g} to {max(sizes):.3g} um wide. Standard deviations and thin shares depend on "
            "that: compare those of one width only."
        )


def listed(names: Sequence[str]) -> str:
    """Names in a sentence, the first ones and how many there are more."""
    shown = [*names[:_MOST_NAMES], *([f"{len(names) - _MOST_NAMES} more"] if len(names) > _MOST_NAMES else [])]
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} and {shown[-1]}"
