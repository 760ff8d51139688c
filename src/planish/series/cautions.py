"""What a reader of a series has to be careful about: what was left out, what does not match."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence

from planish.series.gather import Gathered
from planish.series_results import FACTORS, Cell, Quantity, SeriesSpecimen

NEST = ("sheet", "field")  # factors that are the sample

_MOST_NAMES = 6


def cautions_of(
    gathered: Gathered, specimens: Sequence[SeriesSpecimen], quantities: Sequence[Quantity], grouped_by: Sequence[str],
    compared_by: str | None, most_levels: int,
) -> Iterator[str]:  # fmt: skip
    """Give one sentence for each thing to be careful about, what changes a figure first."""
    counted = [specimen for specimen in specimens if specimen.kind is not None]
    yield from _left_out(counted, quantities)
    yield from _sheets(gathered, counted)
    yield from _factors(counted, grouped_by, compared_by, most_levels)
    kinds = Counter(specimen.kind for specimen in counted)
    if len(kinds) > 1:
        words = {"map": "maps without an image", "sheet on image": "links to an image", "two volumes": "links of two "
                 "volumes", "layers": "links of several layers"}  # fmt: skip
        numbers = ", ".join(f"{n} {words[str(kind)]}" for kind, n in kinds.items())
        yield f"The runs are of different kinds ({numbers}): only figures that are of the same maps meet."
    sizes = [um for specimen in counted if (um := gathered.runs[specimen.name].column_um) is not None]
    # Standard deviations of unlike supports are of different things.
    if sizes and max(sizes) > 1.05 * min(sizes) and any(q.what in ("sd", "thin_share") for q in quantities):
        yield (
            f"Columns are {min(sizes):.3g} to {max(sizes):.3g} um wide. Standard deviations and thin shares depend on "
            "that: compare those of one width only."
        )


def _left_out(counted: Sequence[SeriesSpecimen], quantities: Sequence[Quantity]) -> Iterator[str]:
    def named(is_meant: Callable[[Cell], bool]) -> list[str]:
        return [specimen.name for specimen in counted if any(map(is_meant, specimen.cells))]

    for word, meaning in (("withheld", "a check failed"), ("doubtful", "a check asks for a look")):
        numbers = {s.name: sum(cell.why_not.startswith(word) for cell in s.cells) for s in counted}
        if names := [name for name, number in numbers.items() if number]:
            is_all = all(number in (0, len(quantities)) for number in numbers.values())
            figures = "all figures" if is_all else "some figures (marked in the table)"
            yield (
                f"{word.capitalize()} figures take part in no mean and no comparison, because {meaning}: {figures} of "
                f"{listed(names)}."
            )
    if names := named(lambda cell: cell.trust == "doubtful" and cell.counts):
        yield f"Doubtful figures take part in means and comparisons, as was declared: those of {listed(names)}."
    if names := named(lambda cell: cell.why_not.startswith("too few")):
        yield f"r of {listed(names)} takes part in nothing: there are too few independent points for an interval."
    if names := named(lambda cell: cell.why_not.startswith("points of")):
        yield (
            f"r of {listed(names)} is over points of another size and takes part in nothing. Link these with the "
            "--point-um of the others."
        )


def _sheets(gathered: Gathered, counted: Sequence[SeriesSpecimen]) -> Iterator[str]:
    without = _without("sheet", counted)
    if without and len(counted) > 1:
        is_all = len(without) == len(counted)
        which = "The table names no sheets" if is_all else f"No sheet is named for {listed(without)}"
        yield (
            f"{which}: each specimen counts as a sheet of its own. If some are fields of one sheet, the intervals are "
            "too narrow; if sheets were measured before and after, they do not pair. Add a column sheet."
        )
    shared: dict[tuple[str, ...], list[SeriesSpecimen]] = {}
    for specimen in counted:
        shared.setdefault(gathered.runs[specimen.name].volumes, []).append(specimen)
    for same in shared.values():
        names = listed([specimen.name for specimen in same])
        if len({specimen.sheet for specimen in same}) > 1:
            yield (
                f"{names} are of the same volume, byte by byte, and yet count as different sheets. Correct the "
                "column sheet."
            )
        elif len(same) > 1 and not same[0].factor("sheet"):
            yield f"{names} are of the same volume and count as one sheet."
    fields: dict[tuple[str, ...], list[str]] = {}
    for specimen in counted:
        if specimen.factor("field"):
            fields.setdefault((specimen.sheet, *specimen.member.factors.values()), []).append(specimen.name)
    for names in fields.values():
        if len(names) > 1:
            yield f"{listed(names)} have the same factors, sheet and field; they count as fields of one sheet."


def _factors(
    counted: Sequence[SeriesSpecimen], grouped_by: Sequence[str], compared_by: str | None, most_levels: int
) -> Iterator[str]:
    factors = dict.fromkeys(name for specimen in counted for name in specimen.member.factors)
    levels = {f: dict.fromkeys(v for s in counted if (v := s.factor(f))) for f in factors}
    for name, spellings in levels.items():
        alike = [v for v in spellings if sum(v.casefold() == w.casefold() for w in spellings) > 1]
        if alike:
            yield f"The levels {listed(alike)} of {name} differ in capitals only and count as different ones."
        if name not in (*NEST, *grouped_by) and len(spellings) > 1:
            yield (
                f"{name.capitalize()} varies within the groups and is not held apart: means are over all its levels. "
                f"--by {name} compares them."
            )
    for name in grouped_by:
        if without := _without(name, counted):
            yield f"No {name} is given for {listed(without)}; they make a group of their own, compared with none."
    if compared_by is None:
        return
    if compared_by not in FACTORS:
        # Sheets that pair by a factor of which the program cannot know whether it is done to a sheet, or tells sheets.
        of_sheets: dict[str, set[str]] = {}
        for specimen in counted:
            if specimen.factor("sheet") and (level := specimen.factor(compared_by)):
                of_sheets.setdefault(specimen.sheet, set()).add(level)
        if paired := [sheet for sheet, of_sheet in of_sheets.items() if len(of_sheet) > 1]:
            yield (
                f"{listed(paired)} stand under several levels of {compared_by} and count as the same sheets, measured "
                "under each. If they are different ones, call the factor paper, or give each sheet a name of its own."
            )
    many = len(levels.get(compared_by, {}))
    if many < 2:
        yield f"There is nothing to compare: {compared_by} has one level among the specimens that have a run."
    if many > most_levels:
        yield (
            f"{compared_by.capitalize()} has {many} levels. Of more than {most_levels}, differences of every two "
            "are not listed: compare fewer of them."
        )


def _without(factor: str, counted: Sequence[SeriesSpecimen]) -> list[str]:
    return [specimen.name for specimen in counted if not specimen.factor(factor)]


def listed(names: Sequence[str]) -> str:
    """Names in a sentence, the first ones and how many there are more."""
    shown = [*names[:_MOST_NAMES], *([f"{len(names) - _MOST_NAMES} more"] if len(names) > _MOST_NAMES else [])]
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} and {shown[-1]}"
