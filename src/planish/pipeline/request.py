"""What can be refused before anything is read: names, and numbers that an option needs."""

from __future__ import annotations

from planish.core.errors import InputError
from planish.measure import check_maps
from planish.pipeline.registration import read_design
from planish.study import Study


def check_request(study: Study) -> None:
    """Raise what no volume can change.

    Raises
    ------
    CannotMeasure
        If a further map is unknown or needs a number that is not given.
    InputError
        If further maps of labels are asked for, or the pattern of the holes cannot be read.
    """
    for layer in study.layers:
        if layer.kind != "volume":
            continue
        if layer.surface.labels is not None and layer.properties.maps:
            raise InputError(
                "Further maps are measured in grey values; a volume of labels has none. Leave --property out."
            )
        check_maps(layer.properties)
    read_design(study.registration)
