"""What a reader of a series has to be careful about: what was left out, what does not match."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence

from planish.core.tables import grouped
from planish.core.text import and_join
from planish.series.gather import Gathered
from planish.series_results import FACTORS, Cell, Quantity, Specimens

NEST = ("sheet", "field")  # factors that are the sample
_MOST_NAMES = 6
_KIND_NAMES = {
    "map": "maps without an image",
    "sheet on image": "links to an image",
    "two volumes": "links of two volumes",
    "layers": "links of several layers",
}


def cautions_of(
    gathered: Gathered,
    specimens: Specimens,
    quantities: Sequence[Quantity],
    grouped_by: Sequence[str],
    compared_by: str | None,
    most_levels: int,
) -> Iterator[str]:
    """Give one sentence for each thing to be careful about, what changes a figure first.

    ``specimens`` have their sheets and, in the order of ``quantities``, their cells.
    ``grouped_by`` are the factors whose levels make groups, and ``compared_by`` is the one that is
    compared, or None; of more than ``most_levels`` levels not every two are compared.
    """
    # Those without a run have no figures and take part in nothing.
    counted = [specimen for specimen in specimens if specimen.kind is not None]
    yield from _left_out(counted, quantities)
    yield from _sheets(gathered, counted)
    yield from _same_fields(counted)
    levels = _levels(counted)
    yield from _factors(counted, levels, grouped_by)
    if compared_by is not None:
        yield from _comparison(counted, compared_by, len(levels.get(compared_by, ())), most_levels)
    yield from _kinds(counted)
    # Standard deviations over columns of unlike width are of different things.
    if any(quantity.what in ("sd", "thin_share") for quantity in quantities):
        widths_um = [gathered.runs[specimen.name].column_um for specimen in counted]
        yield from _column_widths([um for um in widths_um if um is not None])


def _kinds(counted: Specimens) -> Iterator[str]:
    """Say where runs are of different kinds, which have few maps in common."""
    kind_counts = Counter(specimen.kind for specimen in counted)
    if len(kind_counts) > 1:
        kinds_text = ", ".join(f"{n} {_KIND_NAMES[str(kind)]}" for kind, n in kind_counts.items())
        yield (
            f"The runs are of different kinds ({kinds_text}): only figures that are of the same"
            " maps meet."
        )


def _column_widths(widths_um: Sequence[float]) -> Iterator[str]:
    if widths_um and max(widths_um) > 1.05 * min(widths_um):
        yield (
            f"Columns are {min(widths_um):.3g} to {max(widths_um):.3g} um wide. Standard deviations"
            " and thin shares depend on that: compare those of one width only."
        )


def _left_out(counted: Specimens, quantities: Sequence[Quantity]) -> Iterator[str]:
    """Name specimens whose figures a check, or too little data, keeps out of means.

    A cell that is kept out says why: its ``why_not`` begins with the words that are looked for.
    """
    yield from _kept_out("withheld", "a check failed", counted, len(quantities))
    yield from _kept_out("doubtful", "a check asks for a look", counted, len(quantities))
    doubtful = _with_cell(counted, lambda cell: cell.trust == "doubtful" and cell.counts)
    if doubtful:
        yield (
            "Doubtful figures take part in means and comparisons, as was declared: those of"
            f" {listed(doubtful)}."
        )
    too_few = _with_cell(counted, lambda cell: cell.why_not.startswith("too few"))
    if too_few:
        yield (
            f"r of {listed(too_few)} takes part in nothing: there are too few independent points"
            " for an interval."
        )
    of_other_size = _with_cell(counted, lambda cell: cell.why_not.startswith("points of"))
    if of_other_size:
        yield (
            f"r of {listed(of_other_size)} is over points of another size and takes part in"
            " nothing. Link these with points of the size of the others."
        )


def _kept_out(trust: str, why: str, counted: Specimens, n_quantities: int) -> Iterator[str]:
    """Say which specimens have figures that a check keeps out, and whether these are all figures.

    ``trust``: that of the figures, withheld or doubtful; ``why``: a clause on the check.
    """
    figure_counts: dict[str, int] = {}  # by specimen: how many of its figures are kept out
    for specimen in counted:
        reasons = [cell.why_not for cell in specimen.cells]
        figure_counts[specimen.name] = sum(reason.startswith(trust) for reason in reasons)
    names = [name for name, n_figures in figure_counts.items() if n_figures]
    if names:
        is_every_figure = {*figure_counts.values()} <= {0, n_quantities}
        figures = "all figures" if is_every_figure else "some figures (marked in the table)"
        yield (
            f"{trust.capitalize()} figures take part in no mean and no comparison, because"
            f" {why}: {figures} of {listed(names)}."
        )


def _with_cell(counted: Specimens, is_meant: Callable[[Cell], bool]) -> list[str]:
    """Names of the specimens that have a cell that is meant."""
    return [specimen.name for specimen in counted if any(map(is_meant, specimen.cells))]


def _sheets(gathered: Gathered, counted: Specimens) -> Iterator[str]:
    """Say what does not match of sheets and volumes.

    A volume is known by the hash of its file. Without names of sheets, specimens of one volume are
    of one sheet, and all others of sheets of their own.
    """
    by_volumes = grouped(counted, lambda specimen: gathered.runs[specimen.name].volumes)
    without = specimens_without("sheet", counted)
    if without and len(counted) > 1:
        kind = "volume" if len(by_volumes) < len(counted) else "specimen"
        which = "The table names no sheets"
        if len(without) < len(counted):
            which = f"No sheet is named for {listed(without)}"
        yield (
            f"{which}: each {kind} counts as a sheet of its own. If some are fields of one sheet,"
            " the intervals are too narrow; if sheets were measured before and after, they do not"
            " pair. Add a column sheet."
        )
    for same in by_volumes.values():
        yield from _same_volume(same)


def _same_volume(same: Specimens) -> Iterator[str]:
    """What is odd about specimens of one volume."""
    names = listed([specimen.name for specimen in same])
    if len({specimen.sheet for specimen in same}) > 1:
        yield (
            f"{names} are of the same volume, byte by byte, and yet count as different sheets."
            " Correct the column sheet."
        )
    elif len(same) > 1 and not same[0].factor("sheet"):
        yield f"{names} are of the same volume and count as one sheet."


def _same_fields(counted: Specimens) -> Iterator[str]:
    """Name specimens that nothing but their own names tells apart."""
    with_field = [specimen for specimen in counted if specimen.factor("field")]
    by_field = grouped(with_field, lambda s: (s.sheet, *s.member.factors.values()))
    for same in by_field.values():
        if len(same) > 1:
            names = [specimen.name for specimen in same]
            yield (
                f"{listed(names)} have the same factors, sheet and field; they count as fields of"
                " one sheet."
            )


def _levels(counted: Specimens) -> dict[str, list[str]]:
    """Levels of each factor, in the order of the specimens."""
    levels: dict[str, list[str]] = {}
    for specimen in counted:
        for name, level in specimen.member.factors.items():
            levels_of_factor = levels.setdefault(name, [])
            if level and level not in levels_of_factor:
                levels_of_factor.append(level)
    return levels


def _factors(
    counted: Specimens,
    levels: Mapping[str, Sequence[str]],
    grouped_by: Sequence[str],
) -> Iterator[str]:
    """Name factors whose levels are spelled in two ways, vary within groups, or are not given.

    ``levels``: of each factor, as :func:`_levels` gives them.
    """
    for name, spellings in levels.items():
        counts = Counter(level.casefold() for level in spellings)
        alike = [level for level in spellings if counts[level.casefold()] > 1]
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
        without = specimens_without(name, counted)
        if without:
            yield (
                f"No {name} is given for {listed(without)}; they make a group of their own,"
                " compared with none."
            )


def _comparison(counted: Specimens, factor: str, n_levels: int, most_levels: int) -> Iterator[str]:
    """Say what is odd about the factor that is compared.

    ``n_levels``: how many levels it has among the specimens; ``most_levels``: as for
    :func:`cautions_of`.
    """
    if factor not in FACTORS:
        # Sheets that pair by a factor of which the program cannot know whether it is done to a
        # sheet, or tells sheets.
        levels_of_sheets: dict[str, set[str]] = {}
        for specimen in counted:
            level = specimen.factor(factor)
            if specimen.factor("sheet") and level:
                levels_of_sheets.setdefault(specimen.sheet, set()).add(level)
        paired_sheets = [sheet for sheet, levels in levels_of_sheets.items() if len(levels) > 1]
        if paired_sheets:
            yield (
                f"{listed(paired_sheets)} stand under several levels of {factor} and count as"
                " the same sheets, measured under each. If they are different ones, call the"
                " factor paper, or give each sheet a name of its own."
            )
    if n_levels < 2:
        yield (
            f"There is nothing to compare: {factor} has one level among the specimens that"
            " have a run."
        )
    if n_levels > most_levels:
        yield (
            f"{factor.capitalize()} has {n_levels} levels. Of more than {most_levels},"
            " differences of every two are not listed: compare fewer of them."
        )


def specimens_without(factor: str, counted: Specimens) -> list[str]:
    """Names of the specimens for which a factor is not given."""
    return [specimen.name for specimen in counted if not specimen.factor(factor)]


def listed(names: Sequence[str]) -> str:
    """Names in a sentence, the first ones and how many there are more."""
    n_more = len(names) - _MOST_NAMES
    return and_join([*names[:_MOST_NAMES], f"{n_more} more"] if n_more > 0 else names)
