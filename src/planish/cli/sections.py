"""The options of a run, group by group: which verb shows which, and how they become a study."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from planish.analyze.params import CorrelateParams
from planish.cli.options import given, options, stack
from planish.cli.show import finish, stages
from planish.compute import Compute
from planish.core.errors import StudyError
from planish.flatten.params import FlattenParams
from planish.io.params import ImageParams, VolumeParams
from planish.marks.params import HoleParams
from planish.measure.params import MeasureParams
from planish.register.params import RegistrationParams
from planish.study import Study
from planish.surface.params import SurfaceParams

OUT = "Folder to make for the results; it must not exist."

volume_options = options(VolumeParams, "volume", "Volume")
image_options = options(ImageParams, "image", "Image")
surface_options = options(SurfaceParams, "surface", "Surface search")
property_options = options(MeasureParams, "properties", "Properties")
flatten_options = options(FlattenParams, "flatten", "Flattening")
hole_options = options(HoleParams, "holes", "Marks and registration")
registration_options = options(RegistrationParams, "registration", "Marks and registration")
correlate_options = options(CorrelateParams, "correlate", "Correlation")
compute_options = options(Compute, "compute", "Resources")

sheet_options = stack(volume_options, surface_options, property_options, flatten_options)
"""All that says how a volume is mapped."""

link_options = stack(image_options, hole_options, registration_options, correlate_options)
"""All that says how layers are linked."""

_SECTIONS = ("volume", "image", "surface", "properties", "flatten", "holes", "registration", "correlate")


def study_from(layers: tuple[str | Path, ...], values: dict[str, Any], *, chain: bool = False) -> Study:
    """Build a study from the command line; what is wrong with it is wrong usage."""
    from planish.pipeline.build import study_of

    sections = {name: found for name in _SECTIONS if (found := given(values, name))}
    for name in ("marks", "design"):
        if path := sections.get("registration", {}).get(name):
            sections["registration"][name] = str(Path(path).absolute())
    try:
        return study_of(layers, sections, chain=chain)
    except StudyError as error:
        raise click.UsageError(str(error)) from error


def compute_from(values: dict[str, Any]) -> Compute:
    """What a run may use, from the command line."""
    return Compute(**given(values, "compute"))


def run_and_show(study: Study, out: Path, *, as_json: bool, compute: Compute) -> int:
    """Do what a study says, show it, and return the exit code."""
    from planish.pipeline import run_study

    with stages(8 + 3 * len(study.layers)) as progress:
        run = run_study(study, out, progress=progress, compute=compute)
    return finish(run, out, as_json=as_json)
