"""Commands about many specimens.

The command study links them as one piece of work, compare says what their runs say together.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from planish.cli.console import duration, sentence, table, warn
from planish.cli.options import (
    PATH,
    Option,
    build_params,
    existing,
    json_option,
    options,
    out_option,
    page_option,
    verb,
)
from planish.core.facts import is_known
from planish.core.numbers import in_ascii
from planish.core.typing import Pair, Texts
from planish.run.compute import Compute
from planish.series.declared import Declared

if TYPE_CHECKING:
    from planish.series import PlannedSpecimen, SeriesState
    from planish.series.jobs import Estimate
    from planish.series_results import Member, SeriesResults

_STATE_TEXTS = {
    "whole": "linked",
    "withheld": "a check failed",
    "refused": "refused",
    "damaged": "not done",
}


@verb(
    "planish study specimens.csv --out series",
    "planish study series.toml --out series --jobs 2",
    "planish study specimens.csv --out series --dry-run",
    "planish study series.toml --out series --watch scans/",
    can_resume=True,
)
@existing("specimens")
@out_option("Folder of the series; one that 'planish study' made is continued.")
@click.option(
    "--set",
    "changes",
    multiple=True,
    metavar="SECTION.NAME=VALUE",
    help="Set an option of all specimens, such as volume.through=y; repeatable.",
)
@click.option(
    "--jobs",
    type=click.IntRange(1, 64),
    default=1,
    show_default=True,
    metavar="N",
    cls=Option,
    group="Resources",
    help="Specimens processed at a time; they share memory and threads.",
)
@options(Compute, "Resources")
@click.option(
    "--dry-run",
    is_flag=True,
    help="State what would be done, and its time and memory; then exit.",
)
@click.option(
    "--watch",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    metavar="FOLDER",
    help=(
        "Take new scans of FOLDER as they appear, until Ctrl-C; [watch] in the study says how"
        " volume and image pair."
    ),
)
@click.option(
    "--settle",
    type=click.FloatRange(0),
    default=30.0,
    show_default=True,
    metavar="SECONDS",
    help="With --watch: a file is taken when it has not changed for this long.",
)
@click.option(
    "--idle",
    type=click.FloatRange(0),
    metavar="SECONDS",
    help="With --watch: end if no file came for this long.",
)
@json_option
def study(
    specimens: Path,
    out: Path,
    changes: Texts,
    jobs: int,
    dry_run: bool,
    watch: Path | None,
    settle: float,
    idle: float | None,
    as_json: bool,
    **values: Any,
) -> int:
    """Link all SPECIMENS, and compare them.

    SPECIMENS is a CSV table with the columns volume and image (or layers), one row a specimen, or a
    study file of 'planish new' with a table [[specimens]] for each. Other columns are factors:
    paper, sheet, field, treatment, side or any other. A column such as volume.through is an option
    of each specimen.

    OUT gets a run of each specimen in runs/, report.html, specimens.csv, values.csv and
    results.json. The same command resumes where it stopped, and repeats only what has other files
    or options. A specimen that cannot be used is named, and stops no other.
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
    progress_lines = _ProgressLines(len(plan.specimens))
    start_s = time.monotonic()
    is_interrupted = False
    with series_folder(out):
        new_scans = None
        if watch:
            new_scans = watched(plan, watch, settle_s=settle, idle_s=idle, tell=warn)
        try:
            run_series(
                plan,
                out,
                compute=compute,
                jobs=jobs,
                tell=progress_lines,
                members=members,
                coming=new_scans,
            )
        except KeyboardInterrupt:
            is_interrupted = not watch  # a watch has no other end
        finished = list(members.values())
        results = write_series(finished, out, plan.declared, out)
    if as_json:
        click.echo(results.to_json(), nl=False)
    duration_text = f"{time.monotonic() - start_s:.0f} s"
    click.echo(f"{len(finished)} specimens: {_states_text(finished)}; {duration_text}", err=True)
    for member in finished:
        if member.state not in ("whole", "open"):
            warn(f"{member.name}: {_STATE_TEXTS[member.state]}: {member.message}")
    if is_interrupted:
        warn("interrupted; what is done is kept, and the same command goes on from there.")
        return 130
    click.echo(f"report: {out / 'report.html'}", err=as_json)
    return code_of(finished)


def _states_text(members: Sequence[Member]) -> str:
    counts = Counter(member.state for member in members)
    return ", ".join(
        f"{counts[state]} {text}" for state, text in _STATE_TEXTS.items() if counts[state]
    )


def code_of(members: Sequence[Member]) -> int:
    """0 where all are whole, 3 where none is, else 4."""
    states = {member.state for member in members}
    if states == {"whole"}:
        return 0
    return 4 if states & {"whole", "withheld"} else 3


class _ProgressLines:
    """Lines as specimens are done, with the time that is left."""

    def __init__(self, n_specimens: int) -> None:
        self.n_specimens = n_specimens
        self.n_done = 0
        self.n_run = 0
        self.start_s = time.monotonic()

    def __call__(self, member: Member, seconds: float | None) -> None:
        """Say what became of a specimen in how many seconds; None for one that was done before."""
        self.n_done += 1
        state_text = _STATE_TEXTS[member.state]
        remaining_text = ""
        if seconds is None and member.state in ("whole", "withheld"):
            state_text = f"{state_text}, kept"
        elif seconds is not None:
            self.n_run += 1
            state_text = f"{state_text} in {seconds:.0f} s"
            n_left = self.n_specimens - self.n_done
            if n_left > 0:
                left_s = n_left * (time.monotonic() - self.start_s) / self.n_run
                remaining_text = f", about {duration(left_s)} left"
        total_text = f"/{self.n_specimens}" if self.n_specimens else ""
        sentence(
            f"[{self.n_done}{total_text}] {member.name}: {state_text}{remaining_text}", err=True
        )


def _dry_run(
    state: SeriesState, specimens: Sequence[PlannedSpecimen], compute: Compute, jobs: int
) -> int:
    """Print a table of what would be done, and give the exit code; nothing is written.

    ``jobs`` specimens are worked on at a time.
    """
    rows: list[Texts] = []
    to_do: list[Estimate] = []
    n_kept = 0
    for specimen in specimens:
        estimate = state.estimate(specimen, compute)
        cells = ("-", "-", "-")
        if estimate.seconds is not None:
            to_do.append(estimate)
            cells = _needs(estimate.seconds, estimate.memory_bytes, estimate.disk_bytes)
        n_kept += estimate.words.startswith("kept")
        rows.append((specimen.name, estimate.words, *cells))
    table("What would be done", ("specimen", "", "time", "memory", "disk"), rows)
    seconds = sum(estimate.seconds or 0.0 for estimate in to_do) / jobs
    memory_bytes = jobs * max((estimate.memory_bytes for estimate in to_do), default=0.0)
    disk_bytes = sum(estimate.disk_bytes for estimate in to_do)
    time_text, memory_text, disk_text = _needs(seconds, memory_bytes, disk_bytes)
    needs_text = f"about {time_text}, {memory_text} of memory, {disk_text} of disk"
    click.echo(f"{len(to_do)} of {len(rows)} to do: {needs_text}. Nothing was written.")
    return 0 if to_do or n_kept else 3


def _needs(seconds: float, memory_bytes: float, disk_bytes: float) -> tuple[str, str, str]:
    return duration(seconds), f"{memory_bytes / 1e9:.1f} GB", f"{disk_bytes / 1e9:.2f} GB"


_CLOSE_R = 0.995  # r of which more decimals are written


def _margin(
    _context: click.Context, _parameter: click.Parameter, assignments: Texts
) -> dict[str, float]:
    """Margins by what they are of, as of ``coating_top=0.5``; anything else is wrong usage."""
    margins: dict[str, float] = {}
    for assignment in assignments:
        name, _, number = assignment.partition("=")
        try:
            margin = float(number)
        except ValueError:
            margin = 0.0
        if not name.strip() or not 0 < margin < float("inf"):
            raise click.BadParameter(
                f"{assignment!r} is no margin. Write MAP=UM, MAP.sd=UM, MAP.thin_share=SHARE or"
                " r=NUMBER, above 0."
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
    "--table",
    "file",
    type=PATH,
    metavar="CSV",
    help=(
        "Factors of the runs: a column run (or name) and paper, sheet, field, treatment, side or"
        " any other."
    ),
)
@options(Declared, "What is compared")
@click.option(
    "--margin",
    multiple=True,
    callback=_margin,
    metavar="MAP=UM",
    help=(
        "Largest difference that does not matter: of MAP's mean, or MAP.sd, MAP.thin_share, r;"
        " repeatable."
    ),
)
@page_option
@json_option
def compare(
    runs: tuple[Path, ...],
    file: Path | None,
    margin: dict[str, float],
    out: Path | None,
    as_json: bool,
    **values: Any,
) -> int:
    """Compare RUNS: figures of each, then means over sheets, differences with intervals, pooled r.

    Without --table each run counts as a sheet of its own, and only figures and their mean are
    stated. Without RUNS, all those of the table are taken. Doubtful and withheld figures are marked
    and left out.
    """
    from planish.core.errors import InputError
    from planish.io.run_folder import new_folder
    from planish.series.gather import gather
    from planish.series.members import members_of
    from planish.series.pages import write_series
    from planish.series.summary import summary_of

    declared = build_params(Declared, values, margin=margin)
    if declared.compare is not None and file is None:
        raise click.UsageError(
            "--by compares the levels of a factor, which come from a table: give --table as well."
        )
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
    """Print the figures of each specimen, the means of groups, and their differences."""
    from planish.report import series_words as words

    _show_specimens(results)
    means: list[list[str]] = []
    for group in sorted(results.groups, key=lambda group: group.quantity):
        q = results.quantities[group.quantity]
        counts = (str(group.sheets), str(group.fields))
        mean = _number_text(group.mean, q.what)
        interval = group.reason or _interval_text(group.interval, q.what)
        means.append([in_ascii(q.title), words.label(group.group), *counts, mean, interval])
    if means:
        table("Means over sheets", ("", "group", "sheets", "fields", "mean", "95 %"), means)
    differences: list[list[str]] = []
    for d in results.differences:
        q = results.quantities[d.quantity]
        within = f"{words.label(d.within)}: " if d.within else ""
        levels = f"{within}{d.levels[1]} - {d.levels[0]}"
        p = f"{d.p_of_table:.2g}" if is_known(d.p_of_table) else "-"
        difference = _number_text(d.difference, q.what)
        interval = _interval_text(d.interval, q.what)
        row = [in_ascii(q.title), levels, difference, interval, p, words.verdict(d)]
        differences.append(row)
    if differences:
        headings = ("", "levels", "difference", "95 %", "p", "")
        table("Differences (p after Holm)", headings, differences)
    for pair in results.instruments:
        bias = _number_text(pair.bias, "mean")
        limits = _interval_text(pair.limits, "mean")
        sentence(
            f"{pair.specimen}: {pair.b} less {pair.a}, {pair.map}: bias {bias} {pair.unit}, limits"
            f" {limits} {pair.unit}. {pair.sentence}".rstrip()
        )
    sentence(in_ascii(words.lead(results)))


def _show_specimens(results: SeriesResults) -> None:
    """Print a row for each specimen: its factors, its state, and its figures."""
    headings = ["", *results.factors, "checks"]
    for q in results.quantities:
        statistic = "thin" if q.what == "thin_share" else q.what
        words = (q.layer, q.map, statistic, q.other_layer)
        headings.append(" ".join(filter(None, words)))
    rows: list[list[str]] = []
    for specimen in results.specimens:
        cells = ["-"] * len(results.quantities)
        for k, cell in enumerate(specimen.cells):
            cells[k] = _cell_text(cell, results.quantities[k].what)
        factors = map(specimen.factor, results.factors)
        state = specimen.light or specimen.member.state
        rows.append([specimen.name, *factors, state, *cells])
    table("Specimens (sd: standard deviation; *: takes part in no mean)", headings, rows)


def _number_text(value: float | None, statistic: str) -> str:
    """A figure with the decimals of its kind: mean, sd, thin_share or r; a dash for none."""
    if value is None or not is_known(value):
        return "-"
    digits = 3
    if statistic == "thin_share":
        digits = 4
    elif statistic == "r" and abs(value) > _CLOSE_R:
        digits = 5
    return f"{value:.{digits}f}"


def _interval_text(limits: Pair, statistic: str) -> str:
    if is_known(limits):
        return " to ".join(_number_text(v, statistic) for v in limits)
    return "-"


def _cell_text(cell: Any, statistic: str) -> str:
    """A figure of a specimen; an r with its interval, and a star where it takes part in no mean."""
    text = _number_text(cell.value, statistic)
    if statistic == "r" and cell.low is not None:
        digits = 5 if cell.low > _CLOSE_R else 2
        text += f" ({cell.low:.{digits}f} to {cell.high:.{digits}f})"
    if cell.counts or cell.value is None:
        return text
    return f"{text} *"
