"""Commands about many specimens: study links them as one piece of work, compare says what their runs say together."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from planish.cli.console import sentence, table, warn
from planish.cli.options import PATH, Option, build_params, existing, json_option, options, out_option, verb
from planish.core.facts import is_known
from planish.core.numbers import in_ascii
from planish.run.compute import Compute
from planish.series.declared import Declared

if TYPE_CHECKING:
    from planish.series import PlannedSpecimen, SeriesState
    from planish.series_results import Member, SeriesResults

_WORDS = {"whole": "linked", "withheld": "a check failed", "refused": "refused", "damaged": "not done"}


@verb(
    "planish study specimens.csv --out series",
    "planish study series.toml --out series --jobs 2",
    "planish study specimens.csv --out series --dry-run",
    "planish study series.toml --out series --watch scans/",
    goes_on=True,
)
@existing("specimens")
@out_option("Folder of the series; one that 'planish study' made goes on where it stood.")
@click.option(
    "--set", "changes", multiple=True, metavar="SECTION.NAME=VALUE",
    help="Set an option of all specimens, such as volume.through=y; may be given again.",
)  # fmt: skip
@click.option(
    "--jobs", type=click.IntRange(1, 64), default=1, show_default=True, metavar="N", cls=Option, group="Resources",
    help="Specimens that are worked on at a time; memory and threads are shared out among them.",
)  # fmt: skip
@options(Compute, "Resources")
@click.option("--dry-run", is_flag=True, help="Say what would be done, how long it takes and how much it needs; end.")
@click.option(
    "--watch", type=click.Path(path_type=Path, file_okay=False, exists=True), metavar="FOLDER",
    help="Take new scans of FOLDER as they appear, until Ctrl-C; [watch] in the study says how volume and image pair.",
)  # fmt: skip
@click.option(
    "--settle", type=click.FloatRange(0), default=30.0, show_default=True, metavar="SECONDS",
    help="With --watch: a file is taken when it has not changed for so long.",
)  # fmt: skip
@click.option(
    "--idle", type=click.FloatRange(0), metavar="SECONDS", help="With --watch: end when nothing came so long."
)
@json_option
def study(
    specimens: Path, out: Path, changes: tuple[str, ...], jobs: int, dry_run: bool, watch: Path | None,
    settle: float, idle: float | None, as_json: bool, **values: Any,
) -> int:  # fmt: skip
    """Link all SPECIMENS, and say what they say together.

    SPECIMENS is a CSV table with the columns volume and image (or layers), one row a specimen, or a study file of
    'planish new' with a table [[specimens]] for each. Other columns are factors: paper, sheet, field, treatment, side
    or any other. A column such as volume.through is an option of each specimen.

    OUT gets a run of each specimen in runs/, report.html, specimens.csv, values.csv and results.json. What is done is
    kept: the same command goes on where it stood, and does again only what has other files or options. A specimen that
    cannot be used is named, and stops no other.
    """
    from planish.series import SeriesState, read_plan
    from planish.series.jobs import series_folder
    from planish.series.pages import write_series
    from planish.series.quantities import check_maps_known
    from planish.series.watch import watched
    from planish.series.workers import run_series

    plan = read_plan(specimens, changes)
    check_maps_known(plan.declared)
    compute = build_params(Compute, values)
    if dry_run:
        return _dry_run(SeriesState(out, plan), plan.specimens, compute, jobs)
    members: dict[str, Member] = {}
    report, begin, interrupted = _ProgressLines(len(plan.specimens)), time.monotonic(), False
    with series_folder(out):
        coming = None
        if watch is not None:
            coming = watched(plan, watch, settle_s=settle, idle_s=idle, tell=warn)
        try:
            run_series(plan, out, compute=compute, jobs=jobs, tell=report, members=members, coming=coming)
        except KeyboardInterrupt:
            interrupted = watch is None  # a watch has no other end
        finished = list(members.values())
        results = write_series(finished, out, plan.declared, out)
    if as_json:
        click.echo(results.to_json(), nl=False)
    counts = Counter(member.state for member in finished)
    states = ", ".join(f"{counts[state]} {words}" for state, words in _WORDS.items() if counts[state])
    click.echo(f"{len(finished)} specimens: {states}; {time.monotonic() - begin:.0f} s", err=True)
    for member in finished:
        if member.state not in ("whole", "open"):
            warn(f"{member.name}: {_WORDS[member.state]}: {member.message}")
    if interrupted:
        warn("interrupted; what is done is kept, and the same command goes on from there.")
        return 130
    click.echo(f"report: {out / 'report.html'}", err=as_json)
    return code_of(finished)


def code_of(members: Sequence[Member]) -> int:
    """0 where all are whole, 3 where none is, else 4."""
    whole = sum(member.state == "whole" for member in members)
    if whole == len(members) and members:
        return 0
    return 4 if whole or any(member.state == "withheld" for member in members) else 3


class _ProgressLines:
    """Lines as specimens are done, with the time that is left."""

    def __init__(self, total: int) -> None:
        self.total, self.count, self.worked, self.begin = total, 0, 0, time.monotonic()

    def __call__(self, member: Member, seconds: float | None) -> None:
        """Say what became of a specimen; one that was done before took no time."""
        self.count += 1
        words, remaining = _WORDS[member.state], ""
        if seconds is None and member.state in ("whole", "withheld"):
            words = f"{words}, kept"
        elif seconds is not None:
            self.worked += 1
            words = f"{words} in {seconds:.0f} s"
            if self.total > self.count:
                rate = (time.monotonic() - self.begin) / self.worked
                remaining = f", about {_time((self.total - self.count) * rate)} left"
        of = f"/{self.total}" if self.total else ""
        sentence(f"[{self.count}{of}] {member.name}: {words}{remaining}", err=True)


def _dry_run(state: SeriesState, specimens: Sequence[PlannedSpecimen], compute: Compute, jobs: int) -> int:
    """A table of what would be done; nothing is written."""
    estimates = [(specimen, state.estimate(specimen, compute)) for specimen in specimens]
    rows: list[tuple[str, ...]] = []
    for specimen, need in estimates:
        figures = "-", "-", "-"
        if need.seconds is not None:
            figures = _time(need.seconds), f"{need.memory_bytes / 1e9:.1f} GB", f"{need.disk_bytes / 1e9:.2f} GB"
        rows.append((specimen.name, need.words, *figures))
    table("What would be done", ("specimen", "", "time", "memory", "disk"), rows)
    needs = [need for _, need in estimates if need.seconds is not None]
    time_ = _time(sum(need.seconds or 0.0 for need in needs) / jobs)
    memory = jobs * max((need.memory_bytes for need in needs), default=0.0)
    disk = sum(need.disk_bytes for need in needs)
    figures = f"about {time_}, {memory / 1e9:.1f} GB of memory, {disk / 1e9:.2f} GB of disk"
    click.echo(f"{len(needs)} of {len(estimates)} to do: {figures}. Nothing was written.")
    return 0 if needs or any(need.words.startswith("kept") for _, need in estimates) else 3


def _time(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


_CLOSE = 0.995  # r of two measurements of one quantity, of which more decimals are written


def _margin(_context: click.Context, _parameter: click.Parameter, assignments: tuple[str, ...]) -> dict[str, float]:
    """Margins of ``MAP=UM``."""
    margins: dict[str, float] = {}
    for assignment in assignments:
        name, _, number = assignment.partition("=")
        try:
            margin = float(number)
        except ValueError:
            margin = 0.0
        if not name.strip() or not 0 < margin < float("inf"):
            raise click.BadParameter(
                f"{assignment!r} is no margin. Write MAP=UM, MAP.sd=UM, MAP.thin_share=SHARE or r=NUMBER, above 0."
            )
        margins[name.strip()] = margin
    return margins


@verb(
    "planish compare run-1 run-2 run-3",
    "planish compare runs/* --table specimens.csv --by treatment --out compared",
    "planish compare --table specimens.csv --margin coating_top=0.5 --margin r=0.1 --out compared",
)
@click.argument("runs", nargs=-1, type=PATH)
@click.option(
    "--table", "file", type=PATH, metavar="CSV",
    help="Factors of the runs: a column run (or name) and paper, sheet, field, treatment, side or any other.",
)  # fmt: skip
@options(Declared, "What is compared")
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
    from planish.core.errors import InputError
    from planish.io.run_folder import new_folder
    from planish.series.gather import gather
    from planish.series.members import members_of
    from planish.series.pages import write_series
    from planish.series.summary import summary_of

    declared = build_params(Declared, values, margin=margin)
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
            warn(f"{member.name}: {member.state}: {member.message}")
    for caution in results.cautions:
        warn(caution)
    if out is not None:
        click.echo(f"report: {out / 'report.html'}", err=as_json)
    return 0 if all(member.state == "whole" for member in results.members) else 4


def _show(results: SeriesResults) -> None:
    """Print the specimens, the means over sheets and the differences."""
    from planish.report import series_words as words

    quantities = results.quantities
    names: list[str] = []
    for q in quantities:
        what = "thin" if q.what == "thin_share" else q.what
        names.append(" ".join(filter(None, (q.layer, q.map, what, q.other_layer))))
    columns = ["", *results.factors, "checks", *names]
    rows: list[list[str]] = []
    for row in results.specimens:
        cells = ["-"] * len(quantities)
        if row.cells:
            cells = [_cell(row.cells[k], q.what) for k, q in enumerate(quantities)]
        factors = [row.member.factors.get(factor, "") for factor in results.factors]
        rows.append([row.member.name, *factors, row.light or row.member.state, *cells])
    table("Specimens (sd: standard deviation; *: takes part in no mean)", columns, rows)
    means: list[list[str]] = []
    for g in sorted(results.groups, key=lambda g: g.quantity):
        q = quantities[g.quantity]
        interval = g.reason or _ends(g.interval, q.what)
        counts = str(g.sheets), str(g.fields)
        means.append([in_ascii(q.title), words.label(g.group), *counts, _number(g.mean, q.what), interval])
    if means:
        table("Means over sheets", ("", "group", "sheets", "fields", "mean", "95 %"), means)
    if results.differences:
        lines: list[list[str]] = []
        for d in results.differences:
            q = quantities[d.quantity]
            within = f"{words.label(d.within)}: " if d.within else ""
            interval = _ends(d.interval, q.what)
            p = f"{d.p_of_table:.2g}" if is_known(d.p_of_table) else "-"
            levels, difference = f"{within}{d.levels[1]} - {d.levels[0]}", _number(d.difference, q.what)
            lines.append([in_ascii(q.title), levels, difference, interval, p, words.verdict(d)])
        table("Differences (p after Holm)", ("", "levels", "difference", "95 %", "p", ""), lines)
    for pair in results.instruments:
        bias, limits = _number(pair.bias, "mean"), _ends(pair.limits, "mean")
        sentence(
            f"{pair.specimen}: {pair.b} less {pair.a}, {pair.map}: bias {bias} {pair.unit}, limits {limits} "
            f"{pair.unit}. {pair.sentence}".rstrip()
        )
    sentence(in_ascii(words.lead(results)))


def _number(value: float | None, statistic: str) -> str:
    digits = 4 if statistic == "thin_share" else 5 if statistic == "r" and abs(value or 0.0) > _CLOSE else 3
    return "-" if value is None or not is_known(value) else f"{value:.{digits}f}"


def _ends(limits: tuple[float, float], statistic: str) -> str:
    return " to ".join(_number(v, statistic) for v in limits) if is_known(limits) else "-"


def _cell(cell: Any, statistic: str) -> str:
    text = _number(cell.value, statistic)
    if statistic == "r" and cell.low is not None:
        digits = 5 if cell.low > _CLOSE else 2
        text += f" ({cell.low:.{digits}f} to {cell.high:.{digits}f})"
    return text if cell.counts or cell.value is None else f"{text} *"
