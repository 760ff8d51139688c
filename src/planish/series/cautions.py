"""What a reader of a series has to be careful about: what was left out, what does not match."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence

from planish.series.gather import Gathered
from planish.series_results import FACTORS, Cell, Quantity, SeriesSpecimen

NEST = ("sheet", "field")  # factors that are the sample
_MOST_NAMES = 6


def cautions_of(
    gathered: Gathered,
    specimens: Sequence[SeriesSpecimen],
    quantities: Sequence[Quantity],
    grouped_by: Sequence[str],
    compared_by: str | None,
    most_levels: int,
) -> Iterator[str]:
    """Give one sentence for each thing to be careful about, what changes a figure first."""
    counted = [specimen for specimen in specimens if specimen.kind is not None]
    yield from _left_out(counted, quantities)
    yield from _sheets(gathered, counted)
    yield from _factors(counted, grouped_by, compared_by, most_levels)
    kind_counts = Counter(specimen.kind for specimen in counted)
    if len(kind_counts) > 1:
        kind_names = {
            "map": "maps without an image",
            "sheet on image": "links to an image",
            "two volumes": "links of two volumes",
            "layers": "links of several layers",
        }
        kinds_text = ", ".join(f"{n} {kind_names[str(kind)]}" for kind, n in kind_counts.items())
        yield (
            f"The runs are of different kinds ({kinds_text}): only figures that are of the same"
            " maps meet."
        )
    widths_um = [
        um for specimen in counted if (um := gathered.runs[specimen.name].column_um) is not None
    ]
    # Standard deviations of unlike supports are of different things.
    if (
        widths_um
        and max(widths_um) > 1.05 * min(widths_um)
        and any(q.what in ("sd", "thin_share") for q in quantities)
    ):
        yield (
            f"Columns are {min(widths_um):.3g} to {max(widths_um):.3g} um wide. Standard deviations"
            " and thin shares depend on that: compare those of one width only."
        )


def _left_out(counted: Sequence[SeriesSpecimen], quantities: Sequence[Quantity]) -> Iterator[str]:
    def named(is_meant: Callable[[Cell], bool]) -> list[str]:
        return [specimen.name for specimen in counted if any(map(is_meant, specimen.cells))]

    for word, meaning in (("withheld", "a check failed"), ("doubtful", "a check asks for a look")):
        figure_counts = {
            s.name: sum(cell.why_not.startswith(word) for cell in s.cells) for s in counted
        }
        if names := [name for name, n_figures in figure_counts.items() if n_figures]:
            is_every_figure = all(
                n_figures in (0, len(quantities)) for n_figures in figure_counts.values()
            )
            figures_text = (
                "all figures" if is_every_figure else "some figures (marked in the table)"
            )
            yield (
                f"{word.capitalize()} figures take part in no mean and no comparison, because"
                f" {meaning}: {figures_text} of {listed(names)}."
            )
    if names := named(lambda cell: cell.trust == "doubtful" and cell.counts):
        yield (
            "Doubtful figures take part in means and comparisons, as was declared: those of"
            f" {listed(names)}."
        )
    if names := named(lambda cell: cell.why_not.startswith("too few")):
        yield (
            f"r of {listed(names)} takes part in nothing: there are too few independent points for"
            " an interval."
        )
    if names := named(lambda cell: cell.why_not.startswith("points of")):
        yield (
            f"r of {listed(names)} is over points of another size and takes part in nothing. Link"
            " these with points of the size of the others."
        )


def _sheets(gathered: Gathered, counted: Sequence[SeriesSpecimen]) -> Iterator[str]:
    shared: dict[tuple[str, ...], list[SeriesSpecimen]] = {}
    for specimen in counted:
        shared.setdefault(gathered.runs[specimen.name].volumes, []).append(specimen)
    without = _without("sheet", counted)
    if without and len(counted) > 1:
        is_every_specimen, kind = (
            len(without) == len(counted),
            "volume" if len(shared) < len(counted) else "specimen",
        )
        which = (
            "The table names no sheets"
            if is_every_specimen
            else f"No sheet is named for {listed(without)}"
        )
        yield (
            f"{which}: each {kind} counts as a sheet of its own. If some are fields of one sheet,"
            " the intervals are too narrow; if sheets were measured before and after, they do not"
            " pair. Add a column sheet."
        )
    for same in shared.values():
        names = listed([specimen.name for specimen in same])
        if len({specimen.sheet for specimen in same}) > 1:
            yield (
                f"{names} are of the same volume, byte by byte, and yet count as different sheets."
                " Correct the column sheet."
            )
        elif len(same) > 1 and not same[0].factor("sheet"):
            yield f"{names} are of the same volume and count as one sheet."
    names_of_field: dict[tuple[str, ...], list[str]] = {}
    for specimen in counted:
        if specimen.factor("field"):
            names_of_field.setdefault(
                (specimen.sheet, *specimen.member.factors.values()), []
            ).append(specimen.name)
    for names in names_of_field.values():
        if len(names) > 1:
            yield (
                f"{listed(names)} have the same factors, sheet and field; they count as fields of"
                " one sheet."
            )


def _factors(  # noqa: C901
    counted: Sequence[SeriesSpecimen],
    grouped_by: Sequence[str],
    compared_by: str | None,
    most_levels: int,
) -> Iterator[str]:
    factors = dict.fromkeys(name for specimen in counted for name in specimen.member.factors)
    levels = {f: dict.fromkeys(v for s in counted if (v := s.factor(f))) for f in factors}
    for name, spellings in levels.items():
        alike = [v for v in spellings if sum(v.casefold() == w.casefold() for w in spellings) > 1]
        if alike:
            yield (
                f"The levels {listed(alike)} of {name} differ in capitals only and count as"
                " different ones."
            )
        if name not in (*NEST, *grouped_by) and len(spellings) > 1:
            yield (
                f"{name.capitalize()} varies within the groups and is not held apart: means are"
                f" over all its levels. Groups by {name} compare them."
            )
    for name in grouped_by:
        if without := _without(name, counted):
            yield (
                f"No {name} is given for {listed(without)}; they make a group of their own,"
                " compared with none."
            )
    if compared_by is None:
        return
    if compared_by not in FACTORS:
        # Sheets that pair by a factor of which the program cannot know whether it is done to a
        # sheet, or tells sheets.
        levels_of_sheets: dict[str, set[str]] = {}
        for specimen in counted:
            if specimen.factor("sheet") and (level := specimen.factor(compared_by)):
                levels_of_sheets.setdefault(specimen.sheet, set()).add(level)
        if paired_sheets := [
            sheet for sheet, levels_of_sheet in levels_of_sheets.items() if len(levels_of_sheet) > 1
        ]:
            yield (
                f"{listed(paired_sheets)} stand under several levels of {compared_by} and count as"
                " the same sheets, measured under each. If they are different ones, call the"
                " factor paper, or give each sheet a name of its own."
            )
    n_levels = len(levels.get(compared_by, {}))
    if n_levels < 2:
        yield (
            f"There is nothing to compare: {compared_by} has one level among the specimens that"
            " have a run."
        )
    if n_levels > most_levels:
        yield (
            f"{compared_by.capitalize()} has {n_levels} levels. Of more than {most_levels},"
            " differences of every two are not listed: compare fewer of them."
        )


def _without(factor: str, counted: Sequence[SeriesSpecimen]) -> list[str]:
    return [specimen.name for specimen in counted if not specimen.factor(factor)]


def listed(names: Sequence[str]) -> str:
    """Names in a sentence, the first ones and how many there are more."""
    shown = [
        *names[:_MOST_NAMES],
        *([f"{len(names) - _MOST_NAMES} more"] if len(names) > _MOST_NAMES else []),
    ]
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} and {shown[-1]}"
