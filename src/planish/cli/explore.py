"""``planish explore``: a run as one page to look around in."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from planish.cli.console import sentence
from planish.cli.options import build_params, existing, json_option, options, out_option, verb
from planish.compute import Compute


@verb("planish explore run --out sheet.html", name="explore")
@existing("run")
@out_option("HTML file to write; it must not exist.")
@options(Compute, "compute", "Resources", only=("memory_bytes", "threads"))
@json_option
def explore(run: Path, out: Path, as_json: bool, **values: Any) -> None:
    """Write a RUN as one HTML file to look around in, for readers without planish.

    It shows two maps, their scatter and the slice at the cursor, in any browser since 2023, without server or network.
    The report stays what is printed and kept.
    """
    from planish.app import explore as write
    from planish.cli.show import stages

    with stages(6) as progress:
        page = write(run, out, compute=build_params(Compute, values, "compute"), progress=progress)
    if as_json:
        facts = {"out": str(out), "bytes": page.bytes, "maps": page.maps, "slices": page.slices}
        click.echo(json.dumps(facts | {"notes": list(page.notes)}, indent=2))
        return
    click.echo(f"{out}: {page.bytes / 1e6:.1f} MB, {page.maps} maps, {page.slices} slices")
    for note in page.notes:
        sentence(note)
