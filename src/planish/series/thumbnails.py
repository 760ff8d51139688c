"""Small maps of the leading property of every specimen, read one after the other."""

from __future__ import annotations

import math
from itertools import count
from pathlib import Path

import numpy as np
import xarray as xr

from planish.core.errors import PlanishError
from planish.core.series_results import SeriesResults, Specimen
from planish.io.map_store import OVERVIEWS
from planish.io.run_folder import read_group
from planish.pipeline.run import MAPS
from planish.report import SmallMap, small_map

_MANY = 250  # specimens, from which on their maps are drawn with fewer pixels: the page has to stay below 10 MB
_PIXELS = 150.0  # along the longer side


def thumbnails_of(results: SeriesResults, home: Path) -> list[SmallMap]:
    """Read the map that leads of every specimen that has it, small.

    Parameters
    ----------
    results : SeriesResults
        Runs relative to ``home``.
    home : path

    Returns
    -------
    list of SmallMap
        In the order of the specimens; where a map cannot be read, its values are missing.
    """
    if not results.quantities:
        return []
    lead, found = results.quantities[0], list[SmallMap]()
    pixels = _PIXELS * min(1.0, math.sqrt(_MANY / max(len(results.specimens), 1)))
    for one in results.specimens:
        folder = one.member.folder(home)
        if one.kind is None or folder is None or one.cells[0].why_not == "not measured":
            continue
        try:
            data = _read(folder / MAPS, one, lead.map, lead.layer)
        except (PlanishError, OSError, KeyError):
            data = None
        found.append(small_map(one.member.name, data, pixels=pixels))
    return found


def _read(store: Path, one: Specimen, name: str, layer: str) -> xr.DataArray | None:
    """The map of a sheet, flat or, of two sheets, on the pixels of the reference; the smallest copy that will do."""
    for group in (f"layers/{layer}/maps", f"layers/{layer}", "maps", *(() if one.kind == "map" else ("linked",))):
        if (store / group / name).is_dir():
            smallest = group
            for k in count(1):
                if not (store / OVERVIEWS / group / str(k) / name).is_dir():
                    break
                smallest = f"{OVERVIEWS}/{group}/{k}"
            wanted = [v for v in (name, "valid") if (store / smallest / v).is_dir()]
            data = read_group(store, smallest, wanted)
            values = data[name].values.astype(np.float64)
            if "valid" in data:
                values = np.where(data["valid"].values.astype(bool), values, np.nan)
            return data[name].copy(data=values)
    return None
