"""``planish link``: a volume or its run to an image, two volumes, two images, or more layers to one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from planish.cli.options import Option, json_option, out_option, verb
from planish.cli.sections import (
    OUT,
    compute_from,
    compute_options,
    link_options,
    run_and_show,
    sheet_options,
    study_from,
)


@verb(
    "planish link volume.tif image.tif --out run",
    "planish link run bottom.tif --out run-bottom --image-side bottom --pixel-um 2.6",
    name="link",
)
@click.argument("layers", nargs=-1, required=True, metavar="LAYER... REFERENCE")
@out_option(OUT)
@link_options
@click.option(
    "--chain", is_flag=True, cls=Option, group="Marks and registration",
    help="Register each layer to the next one, and carry it on from there.",
)  # fmt: skip
@sheet_options
@compute_options
@json_option
def link(layers: tuple[str, ...], out: Path, chain: bool, as_json: bool, **values: Any) -> int:
    """Link layers of one specimen to the last of them: all maps on its pixels, correlation, report.

    A layer is a volume (TIFF stack, folder of slices or sections, store), the folder of a run that planish made of one,
    or an image (TIFF, PNG, JPEG); NAME=PATH gives it a name. All show the same specimen, marked with laser holes.

    'planish link VOLUME IMAGE --out RUN' is the usual case: all 3D properties on the image's own pixels. RUN gets
    maps.zarr, marks.json, results.json, report.html and run.toml. With two volumes, two images or more than two layers,
    the flattened maps and images are laid onto the last layer (docs/linking.md). Options of volumes hold for all of
    them; where two need different ones, map each first with 'planish map' and give the runs.
    """
    if len(layers) < 2:
        raise click.UsageError("Something to link it to is missing: give two layers or more, the reference last.")
    study = study_from(layers, values, chain=chain)
    return run_and_show(study, out, as_json=as_json, compute=compute_from(values))
