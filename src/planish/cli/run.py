"""``planish run``: a study again."""

from __future__ import annotations

import filecmp
from pathlib import Path
from typing import Any

import click

from planish.cli.options import existing, json_option, verb
from planish.cli.sections import compute_from, compute_options, run_and_show
from planish.cli.show import free_path, run_facts


@verb("planish run run/run.toml", "planish run run/run.toml --out again --threads 2", name="run")
@existing("study")
@click.option(
    "--out", "-o", type=click.Path(path_type=Path), help="Folder to make; beside the old one where not given."
)
@compute_options
@json_option
def run(study: Path, out: Path | None, as_json: bool, **values: Any) -> int:
    """Repeat the run described by STUDY, the run.toml of a run folder.

    The result has the same bytes; files that differ from those beside STUDY are named.
    """
    from planish.study import read_study

    if study.is_dir():
        study = study / "run.toml"
    checked = read_study(study)
    old = study.absolute().parent
    target = out or free_path(old.with_name(f"{old.name}-again"))
    code = run_and_show(checked, target, as_json=as_json, compute=compute_from(values))
    before = run_facts(old)
    if before is not None and before["warning"]:
        click.echo(f"{old.name} was {before['warning']}", err=True)
    elif (old / "results.json").is_file():
        different = _different(old, target)
        text = "same bytes as" if not different else f"{', '.join(different)} differ from"
        click.echo(f"{target}: {text} {old}", err=True)
    return code


def _different(old: Path, new: Path) -> list[str]:
    """Name the files of either folder that are not the same in both."""
    files = {p.relative_to(root).as_posix() for root in (old, new) for p in root.rglob("*") if p.is_file()}
    return sorted(
        name
        for name in files
        if not (
            (old / name).is_file() and (new / name).is_file() and filecmp.cmp(old / name, new / name, shallow=False)
        )
    )
