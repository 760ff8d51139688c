"""Gwyddion's own files, written by gwyfile: a channel for each map, lengths in metres, a mask for what is missing."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from gwyfile.objects import GwyContainer, GwyDataField, GwySIUnit

from planish.writers.content import History, Maps
from planish.writers.params import ExportParams

_LENGTH = re.compile(r"(^|[ */])um(?=$|[0-9 */])")


def write(maps: Maps, path: Path, history: History, _params: ExportParams) -> None:
    """Write all maps as channels of one file.

    Gwyddion has no missing values. Its convention is a mask: the pixels below it hold the mean of the map, so that they
    pull on no level; masked data are left out of statistics with Mask: exclude.
    """
    file = GwyContainer()
    (down, across), (top, left), shape = maps.pixel_um, maps.origin_um, maps.shape
    place: dict[str, Any] = {
        "xreal": 1e-6 * across * shape[1], "yreal": 1e-6 * down * shape[0],
        "xoff": 1e-6 * (left - 0.5 * across), "yoff": 1e-6 * (top - 0.5 * down),
    }  # fmt: skip
    for k, name in enumerate(maps.names):
        units, factor = _in_metres(maps.units(name))
        values = np.concatenate([part for _, part in maps.bands(name, np.float64)])
        missing = ~np.isfinite(values)
        known = values[~missing]
        values[missing] = float(known.mean()) if known.size else 0.0
        file[f"/{k}/data/title"] = maps.title(name)
        file[f"/{k}/data"] = GwyDataField(
            values * factor, si_unit_xy=GwySIUnit(unitstr="m"), si_unit_z=GwySIUnit(unitstr=units), **place
        )
        if missing.any():
            file[f"/{k}/mask"] = GwyDataField(
                missing.astype(np.float64), si_unit_xy=GwySIUnit(unitstr="m"), si_unit_z=GwySIUnit(unitstr=""), **place
            )
        about = {"name": name, "planish": history.json(**maps.facts() | {"missing": "mask"})}
        file[f"/{k}/meta"] = GwyContainer(about)
        file[f"/{k}/data/visible"] = True
    with path.open("wb") as target:
        file.tofile(target)


def _in_metres(units: str) -> tuple[str, float]:
    """A unit without prefix, and what its values are multiplied by: Gwyddion chooses the prefix itself."""
    if units in ("", "1"):
        return "", 1.0
    if units == "um":
        return "m", 1e-6
    return units, 1.0
