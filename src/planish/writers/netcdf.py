"""NetCDF-4 by the CF conventions, written by h5netcdf, band by band."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np

from planish.writers.content import History, Maps, plain_type
from planish.writers.params import ExportParams

_LONG_NAMES = {
    "y": "Place of rows, downwards",
    "x": "Place of columns",
    "v": "Flat coordinate v",
    "u": "Flat coordinate u",
}


def write(maps: Maps, path: Path, history: History, _params: ExportParams) -> None:
    """Write maps in their own type: NaN is ``_FillValue``, and the coordinates are the middles of the pixels in um.

    The flat coordinates ``u`` and ``v`` of linked maps are variables of two dimensions; those of flat maps are axes.
    """
    with h5netcdf.File(path, "w", track_order=True) as file:
        file.dimensions = dict(zip(maps.dims, maps.shape, strict=True))
        for axis, at in zip(maps.dims, maps.at_um, strict=True):
            variable = file.create_variable(axis, (axis,), np.float64, data=at)
            variable.attrs.update({"units": "um", "long_name": _LONG_NAMES[axis]})
        for name in maps.names:
            attrs = _attributes(maps, name)
            dtype = plain_type(maps.data[name].dtype)
            missing: Any = dtype.type(np.nan) if dtype.kind == "f" else None
            # Every value is written: filling the space before would write it twice.
            variable = file.create_variable(name, maps.dims, dtype, fillvalue=missing, fill_time="never")
            for rows, values in maps.bands(name):
                variable[rows] = values
            variable.attrs.update(attrs)
        file.attrs.update(
            {
                "Conventions": "CF-1.11", "title": f"{maps.group} of a run of planish",
                "source": history.program, "history": history.json(**maps.facts()),
            }
        )  # fmt: skip


def _attributes(maps: Maps, name: str) -> dict[str, Any]:
    data = maps.data[name]
    found: dict[str, Any] = {"long_name": maps.title(name), "units": _udunits(maps.units(name))}
    if data.dtype.kind == "b":
        found |= {"flag_values": np.array([0, 1], np.uint8), "flag_meanings": "false true"}
    elif "flag_values" in data.attrs:
        found |= {
            "flag_values": np.asarray(data.attrs["flag_values"]).astype(data.dtype),
            "flag_meanings": str(data.attrs["flag_meanings"]),
        }
    return found


def _udunits(units: str) -> str:
    """A unit as UDUNITS has it."""
    return {"deg": "degree", "g/m2": "g m-2", "g/cm3": "g cm-3", "1/mm2": "mm-2", "um2": "um2"}.get(units, units)
