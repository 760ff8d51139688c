"""``planish study``: many specimens as one piece of work."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from planish.cli.console import sentence, table
from planish.cli.options import Option, build_params, existing, json_option, options, out_option, verb
from planish.compute import Compute

if TYPE_CHECKING:
    from planish.core.series_results import Member
    from planish.series import Plan, PlannedSpecimen, SeriesState

_WORDS = {"whole": "linked", "withheld": "a check failed", "refused": "refused", "damaged": "not done"}


@verb(
    "planish study specimens.csv --out series",
    "planish study series.toml --out series --jobs 2",
    "planish study specimens.csv --out series --dry-run",
    "planish study series.toml --out series --watch scans/",
    name="study",
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
@options(Compute, "compute", "Resources")
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
    from planish.series.quantities import check_maps_known

    plan = read_plan(specimens, changes)
    check_maps_known(plan.declared)
    compute = build_params(Compute, values, "compute")
    if dry_run:
        return _dry_run(SeriesState(out, plan), plan.specimens, compute, jobs)
    with series_folder(out):
        return _study(plan, out, compute, jobs, watch=watch, settle=settle, idle=idle, as_json=as_json)


def _study(
    plan: Plan, out: Path, compute: Compute, jobs: int, *, watch: Path | None, settle: float, idle: float | None,
    as_json: bool,
) -> int:  # fmt: skip
    from planish.series.pages import write_series
    from planish.series.run import run_series
    from planish.series.watch import watched

    members: dict[str, Member] = {}
    report, begin, interrupted = _ProgressLines(len(plan.specimens)), time.monotonic(), False
    coming = None if watch is None else watched(
        plan, watch, settle_s=settle, idle_s=idle, tell=lambda text: sentence(f"planish: {text}", err=True)
    )  # fmt: skip
    try:
        run_series(plan, out, compute=compute, jobs=jobs, tell=report, members=members, coming=coming)
    except KeyboardInterrupt:
        interrupted = watch is None  # a watch has no other end
    finished = list(members.values())
    results = write_series(finished, out, plan.declared, out)
    if as_json:
        click.echo(results.to_json(), nl=False)
    counts = Counter(member.state for member in finished)
    click.echo(
        f"{len(finished)} specimens: " + ", ".join(f"{counts[k]} {words}" for k, words in _WORDS.items() if counts[k])
        + f"; {time.monotonic() - begin:.0f} s", err=True,
    )  # fmt: skip
    for member in finished:
        if member.state not in ("whole", "open"):
            sentence(f"planish: {member.name}: {_WORDS[member.state]}: {member.message}", err=True)
    if interrupted:
        sentence("planish: interrupted; what is done is kept, and the same command goes on from there.", err=True)
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
    rows = [
        (specimen.name, need.words, *(("-",) * 3 if need.seconds is None else (
            _time(need.seconds), f"{need.memory_bytes / 1e9:.1f} GB", f"{need.disk_bytes / 1e9:.2f} GB"
        )))
        for specimen, need in estimates
    ]  # fmt: skip
    table("What would be done", ("specimen", "", "time", "memory", "disk"), rows)
    open_ = [each for _, each in estimates if each.seconds is not None]
    seconds = sum(each.seconds or 0.0 for each in open_) / jobs
    memory = jobs * max((each.memory_bytes for each in open_), default=0.0)
    disk = sum(each.disk_bytes for each in open_)
    click.echo(
        f"{len(open_)} of {len(estimates)} to do: about {_time(seconds)}, {memory / 1e9:.1f} GB of memory, "
        f"{disk / 1e9:.2f} GB of disk. Nothing was written."
    )
    return 0 if open_ or any(each.words.startswith("kept") for _, each in estimates) else 3


def _time(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
