"""Commands with known answers.

Specimens as files, and the calibration of the program itself on such specimens.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from planish.cli.console import print_json, shown, table, warn
from planish.cli.options import PATH, build_params, json_option, options, out_option, verb
from planish.core.files import write_whole
from planish.core.numbers import in_ascii
from planish.core.typing import Entries, Texts
from planish.run.compute import Compute
from planish.synthetic.presets import SpecimenOptions

if TYPE_CHECKING:
    from planish.validate.certify import Certificate, Sensitivity
    from planish.validate.scenario import Scenario

_DEFAULT = "small"


@verb(
    "planish specimen --preset wfc135 --size T0 --seed 7 --out sheet",
    "planish specimen --instrument stack --instrument image --nuisance none --out plain",
)
@options(SpecimenOptions, "Specimen")
@out_option("Folder to make; it must not exist.", required=False)
@click.option("--list", "listed", is_flag=True, help="List papers and nuisances, and exit.")
def specimen(out: Path | None, listed: bool, **values: Any) -> int:
    """Make a specimen with known answers.

    It consists of files as instruments write them, with the truth beside them.

    DIR gets scan/ (slices with the log file of NRecon), sections/ (photographs with the cut
    counter), image.ome.tif, printed.ome.tif, and truth/: maps on the pixels of the image, holes,
    poses, parameters. In scan/ and sections/ the sheet's normal runs along the rows: give --through
    y to link them.
    """
    if listed:
        from planish.synthetic import NUISANCES, PRESETS

        headings = ("name", "what it is")
        table("Papers", headings, [(name, title) for name, (title, _) in PRESETS.items()])
        table("Nuisances", headings, [(name, n.title) for name, n in NUISANCES.items()])
        return 0
    if out is None:
        raise click.UsageError("Missing option '--out' / '-o': the folder to make.")
    specimen_options = build_params(SpecimenOptions, values)
    from planish.io.run_folder import new_folder
    from planish.synthetic import write_specimen

    with new_folder(out) as folder:
        write_specimen(
            specimen_options, folder, progress=lambda name: click.echo(f"write: {name}", err=True)
        )
    click.echo(f"specimen: {out}", err=True)
    if specimen_options.size == "T0":
        click.echo(
            "Its 3 holes are too few for 'planish link': take --size T1 or larger for that.",
            err=True,
        )
    return 0


@click.command()
@click.option(
    "--scenario",
    "scenarios",
    multiple=True,
    metavar="NAME|FILE",
    help=(
        f"What is made and measured, of --list or a TOML file; repeatable. {_DEFAULT} where not"
        " given."
    ),
)
@click.option(
    "--seeds",
    type=click.IntRange(min=1),
    help="Number of specimens; default: that of the scenario.",
)
@click.option(
    "--like",
    type=PATH,
    metavar="RUN",
    help="Make specimens like those of a run: its paper, warp, voxels, blur and noise.",
)
@click.option(
    "--sensitivity",
    "alone",
    is_flag=True,
    help="Also run with each nuisance alone, to show which stage suffers.",
)
@out_option(
    "Folder to make for certificate.html, .md and .json, one in it for each of several scenarios.",
    required=False,
)
@click.option("--list", "listed", is_flag=True, help="List the scenarios, and exit.")
@options(Compute, "Resources")
@json_option
def validate(
    scenarios: Texts,
    seeds: int | None,
    like: Path | None,
    alone: bool,
    out: Path | None,
    listed: bool,
    as_json: bool,
    **values: Any,
) -> int:
    """Calibrate planish on specimens with known answers.

    It makes them, runs on their files, and reports the error of every stage.

    It prints the errors against the truth in um, and ends with 4 if a limit of the scenario is
    missed.
    """
    from dataclasses import replace

    from planish.io.run_folder import refuse_existing
    from planish.validate import table as tables
    from planish.validate.certify import run_scenario, sensitivity

    if listed:
        _list_scenarios(as_json=as_json)
        return 0
    selected = _read_scenarios(scenarios or (_DEFAULT,))
    notes = ()
    if out is not None:
        refuse_existing(out)
    if like is not None:
        selected, notes = _like_run(like, selected)
    settings: Entries = {"progress": _report, "compute": build_params(Compute, values)}
    results: list[tuple[Certificate, Sensitivity | None]] = []
    for scenario in selected:
        certificate = replace(run_scenario(scenario, seeds, **settings), notes=notes)
        nuisances = None
        if alone and scenario.kind == "line":
            nuisances = sensitivity(scenario, 1, **settings)
        results.append((certificate, nuisances))
        if not as_json:
            _show(certificate, nuisances)
    if as_json:
        certificates = [tables.as_json(*result) for result in results]
        print_json(certificates[0] if len(certificates) == 1 else certificates)
    if out is not None:
        _write(out, results)
    if all(certificate.passed for certificate, _ in results):
        return 0
    return 4


def _read_scenarios(names: Sequence[str]) -> list[Scenario]:
    """Read all scenarios before the first is run: a wrong name should not cost their time."""
    from planish.validate.scenario import read_scenario

    scenarios = [*map(read_scenario, names)]
    if len({scenario.name for scenario in scenarios}) < len(scenarios):
        raise click.UsageError("--scenario: the same scenario is given twice.")
    return scenarios


def _like_run(run: Path, scenarios: Sequence[Scenario]) -> tuple[list[Scenario], Texts]:
    """Scenarios with the paper and the instruments of a run, and what it does not tell of them."""
    from planish.validate.specimen_template import like_run

    if any(scenario.kind != "line" for scenario in scenarios):
        raise click.UsageError(
            "--like is for scenarios that run the whole line, not for a mesh or a pair."
        )
    template = like_run(run)
    for note in template.notes:
        click.echo(note, err=True)
    return [template.scenario(scenario) for scenario in scenarios], template.notes


def _report(stage: str, detail: str) -> None:
    click.echo(f"{stage}: {shown(detail)}", err=True)


def _list_scenarios(*, as_json: bool) -> None:
    from planish.validate.scenario import read_scenario, scenario_names

    scenarios = map(read_scenario, scenario_names())
    rows = [{"name": s.name, "title": s.title, "seeds": s.seeds} for s in scenarios]
    if as_json:
        print_json(rows)
    else:
        cells = [tuple(map(str, row.values())) for row in rows]
        table("Scenarios", ("name", "title", "seeds"), cells)


def _write(out: Path, results: Sequence[tuple[Certificate, Sensitivity | None]]) -> None:
    """Write the certificates of all scenarios; of several, each into a folder of its own."""
    from planish.io.run_folder import new_folder, write_json
    from planish.validate import table as tables
    from planish.validate.page import render_page

    with new_folder(out) as folder:
        for certificate, nuisances in results:
            place = folder if len(results) == 1 else folder / certificate.scenario.name
            place.mkdir(exist_ok=True)
            write_json(place / "certificate.json", tables.as_json(certificate, nuisances))
            write_whole(place / "certificate.md", tables.markdown(certificate, nuisances).encode())
            write_whole(place / "certificate.html", render_page(certificate, nuisances).encode())
    click.echo(f"certificate: {out}", err=True)


def _show(certificate: Certificate, nuisances: Sensitivity | None) -> None:
    """Print the errors of a scenario and their verdict, and warn of what failed."""
    from planish.validate import table as tables

    table(certificate.scenario.title, tables.COLUMNS, tables.terminal_rows(certificate))
    if nuisances is not None:
        headings, rows = tables.sensitivity_rows(nuisances)
        table("What each nuisance alone adds, in squares", headings, rows)
        for sentence in tables.sensitivity_sentences(nuisances):
            click.echo(in_ascii(sentence))
    click.echo(in_ascii(f"{tables.verdict(certificate)} {tables.summary(certificate)}"))
    for entry in certificate.entries:
        for fault in filter(None, (entry.refusal, *entry.failed)):
            warn(f"seed {entry.seed}: {fault}")
    for line in certificate.lines().values():
        if line.met is False:
            warn(in_ascii(tables.limit_sentence(line)))
