"""``planish compare``: runs beside each other, and what they say together."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from planish.cli.console import sentence, table
from planish.cli.options import json_option, options, out_option, verb
from planish.series.declared import Declared

if TYPE_CHECKING:
    from planish.core.series_results import SeriesResults


_CLOSE = 0.995  # r of two measurements of one quantity, of which more decimals are written


def _margin(_context: click.Context, _parameter: click.Parameter, assignments: tuple[str, ...]) -> dict[str, float]:
    """Margins of ``MAP=UM``."""
    margins: dict[str, float] = {}
    for assignment in assignments:
        name, sign, number = assignment.partition("=")
        try:
            margins[name.strip()] = float(number)
        except ValueError:
            sign = ""
        if not sign or not name.strip() or not 0 < margins[name.strip()] < float("inf"):
            raise click.BadParameter(
                f"{assignment!r} is no margin. Write MAP=UM, MAP.sd=UM, MAP.thin_share=SHARE or r=NUMBER, above 0."
            )
    return margins


@verb(
    "planish compare run-1 run-2 run-3",
    "planish compare runs/* --table specimens.csv --by treatment --out compared",
    "planish compare --table specimens.csv --margin coating_top=0.5 --margin r=0.1 --out compared",
    name="compare",
)
@click.argument("runs", nargs=-1, type=click.Path(path_type=Path))
@click.option(
    "--table", "file", type=click.Path(path_type=Path), metavar="CSV",
    help="Factors of the runs: a column run (or name) and paper, sheet, field, treatment, side or any other.",
)  # fmt: skip
@options(Declared, "declared", "What is compared")
@click.option(
    "--margin", multiple=True, callback=_margin, metavar="MAP=UM",
    help="Largest difference that does not matter: of MAP's mean, or MAP.sd, MAP.thin_share, r; repeatable.",
)  # fmt: skip
@out_option("Folder to make for the page and its tables; it must not exist.", required=False)
@json_option
def compare(
    runs: tuple[Path, ...], file: Path | None, margin: dict[str, float], out: Path | None, as_json: bool, **values: Any
) -> int:
    """Compare RUNS: of each its figures, then means over sheets, differences with intervals, pooled r.

    Without --table each run counts as a sheet of its own, and nothing but its figures and their mean is stated. Without
    RUNS, all those of the table are taken. Figures that a check doubts or refutes are marked and take part in nothing.
    """
    from planish.cli.options import build_params
    from planish.core.errors import InputError
    from planish.io.run_folder import new_folder
    from planish.series.gather import gather
    from planish.series.members import members_of
    from planish.series.pages import write_series
    from planish.series.summary import summary_of

    declared = build_params(Declared, values, "declared", margin=margin)
    if declared.compare is not None and file is None:
        raise click.UsageError("--by compares the levels of a factor, which come from a table: give --table as well.")
    if file is None and len(runs) < 2:
        raise click.UsageError("Give two runs or more, or --table with a column run.")
    home = (Path.cwd() if out is None else out.absolute().parent).resolve()
    members = members_of(runs, home=home, table=file)
    gathered = gather(members, home)
    if not gathered.runs:
        raise InputError(f"None of {len(members)} runs can be read. {gathered.members[0].message}")
    results = summary_of(gathered, declared)
    if out is not None:
        with new_folder(out) as folder:
            results = write_series(members, home, declared, folder)
    if as_json:
        click.echo(results.to_json(), nl=False)
    else:
        _show(results)
    for member in results.members:
        if member.message:
            sentence(f"planish: {member.name}: {member.state}: {member.message}", err=True)
    for caution in results.cautions:
        sentence(f"planish: {caution}", err=True)
    if out is not None:
        click.echo(f"report: {out / 'report.html'}", err=as_json)
    return 0 if all(member.state == "whole" for member in results.members) else 4


def _show(results: SeriesResults) -> None:
    """Print the specimens, the means over sheets and the differences."""
    from planish.report import series_words as words

    quantities = results.quantities
    names = [" ".join(filter(None, (q.layer, q.map, _short(q.what), q.other_layer))) for q in quantities]
    columns = ["", *results.factors, "checks", *names]
    rows = [
        [row.member.name, *(row.member.factors.get(f, "") for f in results.factors), row.light or row.member.state,
         *(_cell(row.cells[k], q.what) if row.cells else "-" for k, q in enumerate(quantities))]
        for row in results.specimens
    ]  # fmt: skip
    table("Specimens (sd: standard deviation; *: takes part in no mean)", columns, rows)
    means = [
        [words.plain_words(q.title), words.label(g.group), str(g.sheets), str(g.fields), _number(g.mean, q.what),
         _ends(g.interval, q.what) if g.interval else g.reason or "-"]
        for k, q in enumerate(quantities) for g in results.groups if g.quantity == k
    ]  # fmt: skip
    if means:
        table("Means over sheets", ("", "group", "sheets", "fields", "mean", "95 %"), means)
    if results.differences:
        lines = [
            [words.plain_words(quantities[d.quantity].title),
             f"{words.label(d.within) + ': ' if d.within else ''}{d.levels[1]} - {d.levels[0]}",
             _number(d.difference, quantities[d.quantity].what),
             _ends(d.interval, quantities[d.quantity].what) if d.interval else "-",
             "-" if d.p_of_table is None else f"{d.p_of_table:.2g}", words.verdict(d)]
            for d in results.differences
        ]  # fmt: skip
        table("Differences (p after Holm)", ("", "levels", "difference", "95 %", "p", ""), lines)
    for pair in results.instruments:
        bias, limits = _number(pair.bias, "mean"), _ends(pair.limits, "mean") if pair.limits else "-"
        sentence(
            f"{pair.specimen}: {pair.b} less {pair.a}, {pair.map}: bias {bias} {pair.unit}, limits {limits} "
            f"{pair.unit}. {pair.sentence}".rstrip()
        )
    sentence(words.plain_words(words.lead(results)))


def _short(statistic: str) -> str:
    return {"thin_share": "thin"}.get(statistic, statistic)


def _number(value: float | None, statistic: str) -> str:
    digits = 4 if statistic == "thin_share" else 5 if statistic == "r" and abs(value or 0.0) > _CLOSE else 3
    return "-" if value is None else f"{value:.{digits}f}"


def _ends(limits: tuple[float, float], statistic: str) -> str:
    return " to ".join(_number(v, statistic) for v in limits)


def _cell(cell: Any, statistic: str) -> str:
    text = _number(cell.value, statistic)
    if statistic == "r" and cell.low is not None:
        digits = 5 if cell.low > _CLOSE else 2
        text += f" ({cell.low:.{digits}f} to {cell.high:.{digits}f})"
    return text if cell.counts or cell.value is None else f"{text} *"
