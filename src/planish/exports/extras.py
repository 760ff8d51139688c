"""Formats of the extra ``export``: NetCDF by h5netcdf, Gwyddion by gwyfile, RO-Crate by rocrate."""

import hashlib
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from planish.core.errors import InputError
from planish.exports.content import ExportHistory, Maps
from planish.exports.formats import ExportParams


def write_netcdf(maps: Maps, path: Path, history: ExportHistory, _params: ExportParams) -> None:
    """Write maps in their own type.

    NaN is ``_FillValue``, and the coordinates are the middles of the pixels in um.

    The flat coordinates ``u`` and ``v`` of linked maps are variables of two dimensions; those of
    flat maps are axes.
    """
    import h5netcdf

    udunits = {"deg": "degree", "g/m2": "g m-2", "g/cm3": "g cm-3", "1/mm2": "mm-2"}
    long_names = {
        "y": "Place of rows, downwards",
        "x": "Place of columns",
        "v": "Flat coordinate v",
        "u": "Flat coordinate u",
    }
    with h5netcdf.File(path, "w", track_order=True) as file:
        file.dimensions = dict(zip(maps.dims, maps.shape, strict=True))
        for axis, coords_um in zip(maps.dims, maps.at_um, strict=True):
            dataset = file.create_variable(axis, (axis,), np.float64, data=coords_um)
            dataset.attrs.update({"units": "um", "long_name": long_names[axis]})
        for name in maps.names:
            dtype = maps.dtype_of(name)
            fill_value: Any = None
            if dtype.kind == "f":
                fill_value = dtype.type(np.nan)
            # Every value is written: filling the space before would write it twice.
            dataset = file.create_variable(
                name, maps.dims, dtype, fillvalue=fill_value, fill_time="never"
            )
            for rows, band in maps.bands(name):
                dataset[rows] = band
            units = maps.units[name]
            dataset.attrs["long_name"] = maps.titles[name]
            dataset.attrs["units"] = udunits.get(units, units)
            attrs = maps.data[name].attrs
            if maps.data[name].dtype.kind == "b":
                attrs = {"flag_values": [0, 1], "flag_meanings": "false true"}
            # Codes, such as those of the status of columns, say what they mean.
            if "flag_values" in attrs:
                dataset.attrs["flag_values"] = np.asarray(attrs["flag_values"], dtype)
                dataset.attrs["flag_meanings"] = str(attrs["flag_meanings"])
        file.attrs.update(
            {
                "Conventions": "CF-1.11",
                "title": f"{maps.group} of a run of planish",
                "source": history.program,
                "history": history.json(**maps.facts()),
            }
        )


_SI_UNITS = {"um": ("m", 1e-6), "1": ("", 1.0)}  # with what turns numbers into it


def write_gwyddion(maps: Maps, path: Path, history: ExportHistory, _params: ExportParams) -> None:
    """Write all maps as channels of one file.

    Gwyddion has no missing values. Its convention is a mask: the pixels below it hold the mean of
    the map, so that they pull on no level; masked data are left out of statistics with Mask:
    exclude.
    """
    from gwyfile.objects import GwyContainer, GwyDataField, GwySIUnit

    file = GwyContainer()
    note = history.json(**maps.facts() | {"missing": "mask"})
    dy_um, dx_um = maps.pixel_um
    y0, x0 = maps.origin_um
    rows, cols = maps.shape
    extent_m: dict[str, Any] = {
        "xreal": 1e-6 * dx_um * cols,
        "yreal": 1e-6 * dy_um * rows,
        "xoff": 1e-6 * (x0 - 0.5 * dx_um),
        "yoff": 1e-6 * (y0 - 0.5 * dy_um),
    }
    for k, name in enumerate(maps.names):
        # Gwyddion takes units without prefix and chooses the prefix itself.
        map_unit = maps.units[name]
        si_unit, si_factor = _SI_UNITS.get(map_unit, (map_unit, 1.0))
        pixels = maps.whole(name, np.float64)
        is_missing = ~np.isfinite(pixels)
        pixels[is_missing] = 0.0
        if not is_missing.all():
            pixels[is_missing] = pixels[~is_missing].mean()
        file[f"/{k}/data/title"] = maps.titles[name]
        data_fields = [("data", pixels * si_factor, si_unit)]
        if is_missing.any():
            data_fields.append(("mask", is_missing.astype(np.float64), ""))
        for field_key, values, unit in data_fields:
            file[f"/{k}/{field_key}"] = GwyDataField(
                values,
                si_unit_xy=GwySIUnit(unitstr="m"),
                si_unit_z=GwySIUnit(unitstr=unit),
                **extent_m,
            )
        file[f"/{k}/meta"] = GwyContainer({"name": name, "planish": note})
        file[f"/{k}/data/visible"] = True
    with path.open("wb") as stream:
        file.tofile(stream)


def write_crate(run: Path, path: Path, history: ExportHistory, _params: ExportParams) -> None:
    """Copy a run folder into a crate, a new folder.

    Its date is the day on which ``results.json`` was last changed (UTC), the only one that a run
    has. The inputs are described with their hashes and not copied. InputError where the run folder
    holds a crate's description already.
    """
    from rocrate.rocrate import ROCrate

    if (run / "ro-crate-metadata.json").exists():
        raise InputError(f"{run} is an RO-Crate already.")
    crate: Any = ROCrate(version="1.1")
    crate.name = f"{run.absolute().name}: a run of planish"
    crate.description = (
        "Maps of a sheet from a volume, and their link to other layers, made by planish."
    )
    changed = datetime.fromtimestamp((run / "results.json").stat().st_mtime, UTC)
    crate.root_dataset["datePublished"] = f"{changed:%Y-%m-%d}"
    files = [_add(crate, entry) for entry in sorted(run.glob("[!.]*"))]  # without hidden ones
    program = _entity(
        crate,
        "#planish",
        "SoftwareApplication",
        name="planish",
        softwareVersion=history.planish,
        description="Links the 3D structure of a paper sheet to a 2D image of it.",
    )
    inputs = [
        _entity(
            crate,
            f"#input-{layer['layer']}",
            "CreativeWork",
            name=layer["name"],
            sha256=layer["sha256"],
        )
        for layer in history.inputs
    ]
    action = _entity(
        crate,
        "#run",
        "CreateAction",
        name="planish run",
        instrument=program,
        object=inputs,
        result=files,
    )
    crate.root_dataset["mentions"] = [action]
    crate.write(str(path))


def _entity(crate: Any, identifier: str, kind: str, **properties: Any) -> Any:
    from rocrate.model.contextentity import ContextEntity

    return crate.add(ContextEntity(crate, identifier, properties={"@type": kind} | properties))


_DESCRIPTIONS = {
    "run.toml": "Every parameter of the run; planish run repeats it",
    "results.json": "Every number of the run",
    "figures.csv": "Every figure with its error",
    "report.html": "The report, to read",
    "regions.geojson": "Regions that were declared artefacts",
    "maps.zarr": "All maps, zarr version 3; xarray.open_datatree opens it",
    "figures": "The figures of the report as SVG and CSV",
    "layers": "Whole runs of volumes that were mapped on the way",
}
_MIME_TYPES = {
    ".toml": "application/toml",
    ".json": "application/json",
    ".csv": "text/csv",
    ".html": "text/html",
    ".geojson": "application/geo+json",
}


def _add(crate: Any, entry: Path) -> Any:
    """Put a file or folder of the run into the crate and describe it; give its entity there."""
    name = entry.name
    usual_text = name
    if name.startswith("marks"):
        usual_text = "Marks and registration"
    description = _DESCRIPTIONS.get(name, usual_text)
    properties = {"name": name, "description": description}
    if entry.is_dir():
        return crate.add_dataset(str(entry), f"{name}/", properties=properties)
    content = entry.read_bytes()
    properties["contentSize"] = str(len(content))
    properties["sha256"] = hashlib.sha256(content).hexdigest()
    properties["encodingFormat"] = _MIME_TYPES.get(entry.suffix, "application/octet-stream")
    return crate.add_file(str(entry), name, properties=properties)
