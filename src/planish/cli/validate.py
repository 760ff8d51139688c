"""The command that calibrates the program itself: synthetic specimens with known answers, and an error ledger."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from planish.cli.options import json_option
from planish.cli.show import table

if TYPE_CHECKING:
    from planish.validate.certify import Certificate
    from planish.validate.scenario import Scenario
    from planish.validate.sensitivity import Sensitivity

_DEFAULT = "small"


@click.command()
@click.option(
    "--scenario",
    "scenarios",
    multiple=True,
    metavar="NAME|FILE",
    help=f"What is made and measured, of --list or a TOML file; may be given again. {_DEFAULT} where not given.",
)
@click.option("--seeds", type=click.IntRange(min=1), help="Number of specimens; the scenario's own where not given.")
@click.option(
    "--like",
    type=click.Path(path_type=Path),
    metavar="RUN",
    help="Make specimens like those of a run: its paper, warp, voxels, blur and noise.",
)
@click.option("--sensitivity", "alone", is_flag=True, help="Also run with each nuisance alone: which stage suffers.")
@click.option(
    "--out",
    "-o",
    type=click.Path(path_type=Path),
    help="Folder to make for certificate.html, .md and .json, one in it for each of several scenarios.",
)
@click.option("--list", "listed", is_flag=True, help="Name the scenarios and end.")
@json_option
def validate(
    scenarios: tuple[str, ...],
    seeds: int | None,
    like: Path | None,
    alone: bool,
    out: Path | None,
    listed: bool,
    as_json: bool,
) -> int:
    """Calibrate planish: make specimens with known answers, run on their files, tell the error of every stage.

    Prints an error ledger in um against the truth. Ends with 4 when a limit of the scenario is missed.
    """
    from planish.io.run_folder import new_folder, refuse_existing
    from planish.validate.certify import run_scenario
    from planish.validate.scenario import read_scenario
    from planish.validate.sensitivity import sensitivity
    from planish.validate.table import as_json as data_of

    if listed:
        return _list(as_json=as_json)
    # All of them are read before the first is run: a wrong name should not cost the time of the others.
    chosen, notes = [read_scenario(name) for name in scenarios or (_DEFAULT,)], ()
    if len({scenario.name for scenario in chosen}) < len(chosen):
        raise click.UsageError("--scenario: the same scenario is given twice.")
    if out is not None:
        refuse_existing(out)
    if like is not None:
        chosen, notes = _like(like, chosen)

    def tell(stage: str, detail: str) -> None:
        click.echo(f"{stage}: {detail}", err=True)

    results: list[tuple[Certificate, Sensitivity | None]] = []
    for scenario in chosen:
        certificate = run_scenario(scenario, seeds, progress=tell)
        certificate = _noted(certificate, notes)
        grown = sensitivity(scenario, 1, progress=tell) if alone and scenario.kind == "line" else None
        results.append((certificate, grown))
        if not as_json:
            _show(certificate, grown)
    if as_json:
        found = [data_of(certificate, grown) for certificate, grown in results]
        click.echo(json.dumps(found[0] if len(found) == 1 else found, indent=2, allow_nan=False))
    if out is not None:
        with new_folder(out) as folder:
            for certificate, grown in results:
                _write(folder if len(results) == 1 else folder / certificate.scenario.name, certificate, grown)
        click.echo(f"certificate: {out}", err=True)
    return 0 if all(certificate.passed for certificate, _ in results) else 4


def _list(*, as_json: bool) -> int:
    from planish.validate.scenario import read_scenario, scenario_names

    found = [read_scenario(name) for name in scenario_names()]
    if as_json:
        click.echo(json.dumps([{"name": s.name, "title": s.title, "seeds": s.seeds} for s in found], indent=2))
        return 0
    table("Scenarios", ("name", "title", "seeds"), [(s.name, s.title, str(s.seeds)) for s in found])
    return 0


def _like(run: Path, scenarios: list[Scenario]) -> tuple[list[Scenario], tuple[str, ...]]:
    """Put the paper and the instruments of a run into each scenario."""
    from planish.validate.like import like_run

    if any(scenario.kind != "line" for scenario in scenarios):
        raise click.UsageError("--like goes with scenarios that run the whole line, not with a mesh or a pair.")
    found = like_run(run)
    notes = (*(f"Taken: {s}" for s in found.taken), *(f"Assumed: {s}" for s in found.assumed))
    for note in notes:
        click.echo(note, err=True)
    return [found.scenario(scenario) for scenario in scenarios], notes


def _noted(certificate: Certificate, notes: tuple[str, ...]) -> Certificate:
    from dataclasses import replace

    return replace(certificate, notes=notes)


def _show(certificate: Certificate, grown: Sensitivity | None) -> None:
    from planish.validate.table import COLUMNS, plain, sensitivity_rows, terminal_rows
    from planish.validate.words import check_sentence, row_sentence, sum_sentence, summary, verdict

    table(certificate.scenario.title, COLUMNS, terminal_rows(certificate))
    if grown is not None:
        head, rows = sensitivity_rows(grown)
        table("What each nuisance alone adds, in squares", head, rows)
        for sentence in (
            *(row_sentence(row) for row in grown.rows),
            *(sum_sentence(stage, grown) for stage in grown.keys),
        ):
            click.echo(plain(sentence))
    click.echo(plain(f"{verdict(certificate)} {summary(certificate)}"))
    for entry in certificate.entries:
        for sentence in (entry.refusal, *entry.gates):
            if sentence is not None:
                click.echo(f"planish: seed {entry.seed}: {sentence}", err=True)
    for check in certificate.checks():
        if not check.met:
            click.echo(f"planish: {plain(check_sentence(check))}", err=True)


def _write(folder: Path, certificate: Certificate, grown: Sensitivity | None) -> None:
    from planish.io.run_folder import write_json
    from planish.validate.page import write_page
    from planish.validate.table import as_json, markdown

    folder.mkdir(exist_ok=True)
    data: dict[str, Any] = as_json(certificate, grown)
    write_json(folder / "certificate.json", data)
    (folder / "certificate.md").write_text(markdown(certificate, grown), encoding="utf-8", newline="\n")
    write_page(folder / "certificate.html", certificate, grown)
