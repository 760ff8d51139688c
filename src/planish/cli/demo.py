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
    from planish.io.run_folder import refuse_existing
    from planish.synthetic import CameraParams, HoleParams, SpecimenParams, Warp, make_specimen, write_instruments

    folder = out or free_path(Path("planish-demo"))
    refuse_existing(folder)
    click.echo(f"specimen: a warped sheet of 1.8 x 1.3 mm, seed {seed}", err=True)
    holes = HoleParams(pattern="irregular", count=6)
    # Diffuse light and an even base: then the image shows mostly what the coating does.
    camera = CameraParams(shading=0.003, nuisance_sd=0.004)
    params = SpecimenParams(
        size_um=(1800.0, 1300.0), holes=holes, warp=Warp(wavelength_um=2000.0), camera=camera, seed=seed
    )
    files = write_instruments(make_specimen(params), folder / "specimen")
    assert files.image is not None
    return run_and_show(study_from((files.volume, files.image), {}), folder / "run", as_json=as_json, compute=Compute())
