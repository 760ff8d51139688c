"""``planish map``: one volume, without an image."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from planish.cli.options import existing, json_option, out_option, verb
from planish.cli.sections import OUT, compute_from, compute_options, run_and_show, sheet_options, study_from


@verb(
    "planish map volume.tif --out run",
    "planish map scan/ --out run --voxel-um 1.37 --through y --memory 4GB",
    name="map",
)
@existing("volume")
@out_option(OUT)
@sheet_options
@compute_options
@json_option
def map_(volume: Path, out: Path, as_json: bool, **values: Any) -> int:
    """Map VOLUME: flattened maps of all properties, without an image."""
    return run_and_show(study_from((volume,), values), out, as_json=as_json, compute=compute_from(values))
