"""``planish demo``: the whole line on a synthetic specimen."""

from __future__ import annotations

from pathlib import Path

import click

from planish.cli.options import json_option, verb
from planish.cli.sections import run_and_show, study_from
from planish.cli.show import free_path
from planish.compute import Compute


@verb("planish demo", "planish demo --out try --seed 2", name="demo")
@click.option("--out", "-o", type=click.Path(path_type=Path), help="Folder to make; planish-demo here where not given.")
@click.option("--seed", default=1, show_default=True, help="Another number gives another specimen.")
@json_option
def demo(out: Path | None, seed: int, as_json: bool) -> int:
    """Make a synthetic specimen with laser holes, link it, and show what comes out."""
    from dataclasses import replace

    from planish.io.run_folder import refuse_existing
    from planish.synthetic import DEMO, make_specimen, write_instruments

    folder = out or free_path(Path("planish-demo"))
    refuse_existing(folder)
    width, height = (um / 1000 for um in DEMO.size_um)
    click.echo(f"specimen: a warped sheet of {width:g} x {height:g} mm, seed {seed}", err=True)
    files = write_instruments(make_specimen(replace(DEMO, seed=seed)), folder / "specimen")
    assert files.image is not None
    return run_and_show(study_from((files.volume, files.image), {}), folder / "run", as_json=as_json, compute=Compute())
