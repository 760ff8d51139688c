"""What can be refused before anything is read: names, numbers that an option needs, images beyond the memory."""

from __future__ import annotations

import math
from pathlib import Path

from planish.compute import Compute
from planish.core.errors import InputError, ResourceError
from planish.io.info import LINK_BYTES, PIXEL_BYTES
from planish.io.picture import pixels_of
from planish.marks.regions import read_regions
from planish.measure import PROPERTIES, check_maps
from planish.pipeline.registration import read_design
from planish.study import Study

# Bytes a pixel: refining holds image and map in double precision, filtered, several times; without a folder to write
# to, all linked maps are held.
_REFINED_BYTES, _HELD_BYTES = 120, 130


def check_request(study: Study, compute: Compute, *, held: bool = False) -> None:
    """Raise what no volume can change; ``held``: the results stay in memory.

    Raises
    ------
    CannotMeasure
        If a further map is unknown or needs a number that is not given.
    InputError
        If further maps of labels are asked for, a map is to lead that there will not be, or the pattern of the holes
        cannot be read.
    FileError
        If an image cannot be opened, or a file of regions is of no use.
    ResourceError
        If an image is too large for the memory.
    """
    for layer in study.layers:
        if layer.kind != "volume":
            continue
        if layer.surface.labels is not None and layer.properties.maps:
            raise InputError(
                "Further maps are measured in grey values; a volume of labels has none. Leave --property out."
            )
        check_maps(layer.properties)
        headline, known = study.correlate.headline, {*PROPERTIES, *layer.properties.maps}
        if headline is not None and headline not in known:
            raise InputError(
                f"--headline {headline}: there will be no such map. Give one of {', '.join(sorted(known))}, or ask "
                f"for it with --property {headline} as well."
            )
    read_design(study.registration)
    if study.correlate.regions is not None:
        read_regions(study.correlate.regions)
    for layer in study.layers:
        if layer.image is not None:
            rows, cols = pixels_of(Path(layer.path))
            each = PIXEL_BYTES if study.registration.refine is None else _REFINED_BYTES
            each += _HELD_BYTES if held else 0
            _check_fits(layer.name, rows * cols, each * rows * cols + LINK_BYTES, compute)


def _check_fits(name: str, pixels: int, needed: int, compute: Compute) -> None:
    if needed > compute.memory:
        enough = math.ceil(needed / 1e8) / 10  # in GB: rounded down, it would be refused again
        raise ResourceError(
            f"The {name} of {pixels / 1e6:.0f} million pixels takes {needed / 1e9:.1f} GB of memory, "
            f"{compute.memory / 1e9:.1f} GB are allowed. Give more with --memory {enough:.1f}GB, or crop or bin "
            "it."
        )
