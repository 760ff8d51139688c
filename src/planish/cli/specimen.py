"""The command that makes a specimen with known answers, as files that any program can read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from pydantic import ValidationError

from planish.cli.options import given, options, verb
from planish.synthetic.presets import SpecimenOptions


@verb(
    "planish specimen --preset wfc135 --size T0 --seed 7 --out sheet",
    "planish specimen --instrument stack --instrument image --nuisance none --out plain",
    name="specimen",
)
@options(SpecimenOptions, "specimen", "Specimen")
@click.option("--out", "-o", type=click.Path(path_type=Path), help="Folder to make; it must not exist.")
@click.option("--list", "listed", is_flag=True, help="Name papers and nuisances and end.")
def specimen(out: Path | None, listed: bool, **values: Any) -> int:
    """Make a specimen with known answers: files as instruments write them, and the truth apart from them.

    DIR gets scan/ (slices with the log file of NRecon), sections/ (photographs with the cut counter), image.ome.tif,
    printed.ome.tif, and truth/: maps on the pixels of the image, holes, poses, parameters. In scan/ and sections/ the
    sheet's normal runs along the rows: give --through y to link them.
    """
    if listed:
        return _list()
    if out is None:
        raise click.UsageError("Missing option '--out' / '-o': the folder to make.")
    try:
        ordered = SpecimenOptions.model_validate(given(values, "specimen"))
    except ValidationError as error:
        faults = [f"--{e['loc'][0]}: {e['msg'].removeprefix('Value error, ')}." for e in error.errors()]
        raise click.UsageError(" ".join(faults)) from error
    from planish.io.run_folder import new_folder, refuse_existing
    from planish.synthetic import write_specimen

    refuse_existing(out)
    with new_folder(out) as folder:
        write_specimen(ordered, folder, progress=lambda name: click.echo(f"write: {name}", err=True))
    click.echo(f"specimen: {out}", err=True)
    return 0


def _list() -> int:
    from planish.cli.show import table
    from planish.synthetic import NUISANCES, PRESETS

    table("Papers", ("name", "what it is"), [(name, title) for name, (title, _) in PRESETS.items()])
    table("Nuisances", ("name", "what it is"), [(name, n.title) for name, n in NUISANCES.items()])
    return 0
