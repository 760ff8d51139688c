"""NetCDF-4 by the CF conventions, written by h5netcdf, band by band."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np

from planish.exports.content import ExportHistory, Maps, plain_type
from planish.exports.params import ExportParams

_LONG_NAMES = {
    "y": "Place of rows, downwards",
    "x": "Place of columns",
    "v": "Flat coordinate v",
    "u": "Flat coordinate u",
}

_UDUNITS = {"deg": "degree", "g/m2": "g m-2", "g/cm3": "g cm-3", "1/mm2": "mm-2"}


def write(maps: Maps, path: Path, history: ExportHistory, _params: ExportParams) -> None:
    """Write maps in their own type: NaN is ``_FillValue``, and the coordinates are the middles of the pixels in um.

    The flat coordinates ``u`` and ``v`` of linked maps are variables of two dimensions; those of flat maps are axes.
    """
    with h5netcdf.File(path, "w", track_order=True) as file:
        file.dimensions = dict(zip(maps.dims, maps.shape, strict=True))
        for axis, places in zip(maps.dims, maps.at_um, strict=True):
            variable = file.create_variable(axis, (axis,), np.float64, data=places)
            variable.attrs.update({"units": "um", "long_name": _LONG_NAMES[axis]})
        for name in maps.names:
            dtype = plain_type(maps.data[name].dtype)
            missing: Any = dtype.type(np.nan) if dtype.kind == "f" else None
            # Every value is written: filling the space before would write it twice.
            variable = file.create_variable(name, maps.dims, dtype, fillvalue=missing, fill_time="never")
            for rows, band in maps.bands(name):
                variable[rows] = band
            variable.attrs.update(_attributes(maps, name))
        file.attrs.update(
            {
                "Conventions": "CF-1.11", "title": f"{maps.group} of a run of planish",
                "source": history.program, "history": history.json(**maps.facts()),
            }
        )  # fmt: skip


def _attributes(maps: Maps, name: str) -> dict[str, Any]:
    variable, units = maps.data[name], maps.units[name]
    attrs: dict[str, Any] = {"long_name": maps.titles[name], "units": _UDUNITS.get(units, units)}
    if variable.dtype.kind == "b":
        attrs |= {"flag_values": np.array([0, 1], np.uint8), "flag_meanings": "false true"}
    elif "flag_values" in variable.attrs:
        attrs |= {
            "flag_values": np.asarray(variable.attrs["flag_values"]).astype(variable.dtype),
            "flag_meanings": str(variable.attrs["flag_meanings"]),
        }
    return attrs
