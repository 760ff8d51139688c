"""Gwyddion's own files, written by gwyfile: a channel for each map, lengths in metres, a mask for what is missing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from gwyfile.objects import GwyContainer, GwyDataField, GwySIUnit

from planish.exports.content import ExportHistory, Maps
from planish.exports.params import ExportParams


def write(maps: Maps, path: Path, history: ExportHistory, _params: ExportParams) -> None:
    """Write all maps as channels of one file.

    Gwyddion has no missing values. Its convention is a mask: the pixels below it hold the mean of the map, so that they
    pull on no level; masked data are left out of statistics with Mask: exclude.
    """
    file = GwyContainer()
    (down, across), (y0, x0), (rows, cols) = maps.pixel_um, maps.origin_um, maps.shape
    place: dict[str, Any] = {
        "xreal": 1e-6 * across * cols, "yreal": 1e-6 * down * rows,
        "xoff": 1e-6 * (x0 - 0.5 * across), "yoff": 1e-6 * (y0 - 0.5 * down),
    }  # fmt: skip
    for k, name in enumerate(maps.names):
        # Gwyddion takes units without prefix and chooses the prefix itself.
        units, factor = {"um": ("m", 1e-6), "1": ("", 1.0)}.get(maps.units[name], (maps.units[name], 1.0))
        pixels = np.concatenate([band for _, band in maps.bands(name, np.float64)])
        missing = ~np.isfinite(pixels)
        pixels[missing] = 0.0 if missing.all() else float(pixels[~missing].mean())
        file[f"/{k}/data/title"] = maps.titles[name]
        file[f"/{k}/data"] = GwyDataField(
            pixels * factor, si_unit_xy=GwySIUnit(unitstr="m"), si_unit_z=GwySIUnit(unitstr=units), **place
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
