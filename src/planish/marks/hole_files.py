"""Holes in files: JSON, which keeps everything to the last bit, and a CSV table to read."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import xarray as xr
from pydantic import Field, TypeAdapter

from planish.core.errors import FileError, MarkError
from planish.core.files import write_whole
from planish.core.tables import naming_faults, raise_faults, read_text
from planish.core.typing import Entries
from planish.marks.exchange.csv_marks import holes_text, table_of_holes
from planish.marks.exchange.lists import Part, json_file, json_text, read_object

FORMAT, VERSION = "planish-holes", 1
_REMEDY = "Find the holes again, or correct these parts."


class _Variable(Part):
    type: Literal["float64", "int64", "uint8", "bool", "str"]
    attributes: Entries
    values: list[Any]


class _File(Part):
    format: Literal["planish-holes"]
    version: Literal[1]
    units: Literal["um"]
    plane: str | None
    attributes: Entries
    variables: dict[str, _Variable]


_COLUMN_TYPES: Entries = {
    "float64": list[Annotated[float | None, Field(allow_inf_nan=False)]],
    "int64": list[Annotated[int, Field(ge=-(2**63), lt=2**63)]],
    "uint8": list[Annotated[int, Field(ge=0, le=255)]],
    "bool": list[bool],
    "str": list[str],
}


def holes_to_json(holes: xr.Dataset) -> Entries:
    """Make a JSON object of holes that :func:`holes_from_json` turns back into the same dataset.

    Parameters
    ----------
    holes : Dataset, dims (mark)
        Of :func:`planish.marks.find_holes` or :func:`planish.marks.find_sheet_holes`, with any
        further variables and attributes. ``attrs["plane"]`` names the map or image in which they
        lie.

    Returns
    -------
    dict
        ``format``, ``version``, ``units``, ``plane``, ``attributes`` and ``variables``. Floats are
        exact; NaN is null.

    Raises
    ------
    MarkError
        If a variable or an attribute has no place in JSON.
    """
    faults: list[str] = []
    variables: Entries = {}
    for name, variable in holes.variables.items():
        kind = "str" if variable.dtype.kind == "U" else str(variable.dtype)
        if variable.dims != ("mark",) or kind not in _COLUMN_TYPES:
            faults.append(f"{name} has dims {variable.dims} and type {kind}")
            continue
        attributes = _plain(variable.attrs, str(name), faults)
        values = _plain(variable.values, str(name), faults)
        variables[str(name)] = {"type": kind, "attributes": attributes, "values": values}
    attributes = _plain(holes.attrs, "the holes", faults)
    remedy = f"Types are {', '.join(_COLUMN_TYPES)}, along 'mark'."
    raise_faults("The holes cannot be written", faults, remedy, error=MarkError)
    return {
        "format": FORMAT,
        "version": VERSION,
        "units": "um",
        "plane": attributes.pop("plane", None),
        "attributes": attributes,
        "variables": variables,
    }


def holes_from_json(content: Mapping[str, Any], name: str = "The JSON") -> xr.Dataset:
    """Make holes of a JSON object of :func:`holes_to_json`.

    Parameters
    ----------
    content : mapping
    name : str
        What it was read from, for messages.

    Raises
    ------
    MarkError
        If it holds no holes, is of a later version, or a part is missing or malformed; all faults
        are named.
    """
    if content.get("format") != FORMAT:
        raise MarkError(f"{name} holds no '{FORMAT}'. Give a file of 'planish holes'.")
    version = content.get("version")
    if version != VERSION:
        raise MarkError(
            f"{name} has version {version!r} of the format; this planish reads version {VERSION}."
            " Update planish, or find the holes again."
        )
    variables: Entries = {}
    with naming_faults(name, _REMEDY, error=MarkError):
        file = _File.model_validate(dict(content))
    for key, variable in file.variables.items():
        column_type = TypeAdapter(_COLUMN_TYPES[variable.type])
        with naming_faults(name, _REMEDY, error=MarkError, key_prefix=("variables", key, "values")):
            checked_values = column_type.validate_python(variable.values, strict=True)
        column = np.array(_missing_as_nan(checked_values), dtype=variable.type)
        variables[key] = ("mark", column, _missing_as_nan(variable.attributes))
    counts = sorted({len(variable.values) for variable in file.variables.values()})
    faults = [f"no {key}" for key in "xy" if key not in variables]
    if len(counts) > 1:
        faults.append(
            f"variables have {', '.join(map(str, counts))} values; as many of each are needed"
        )
    raise_faults(name, faults, _REMEDY, error=MarkError)
    plane = {} if file.plane is None else {"plane": file.plane}
    return xr.Dataset(variables, attrs=_missing_as_nan(file.attributes) | plane)


def write_holes(holes: xr.Dataset, path: str | Path) -> None:
    """Write holes into a new file.

    Parameters
    ----------
    holes : Dataset, dims (mark)
    path : str or Path
        ``.json`` keeps everything; ``.csv`` is the table to read: ``label, x_um, y_um,
        diameter_um``.

    Raises
    ------
    FileError
        If something stands there already, it cannot be written, or the suffix is another.
    MarkError
        If a variable or an attribute has no place in JSON.
    """
    file = Path(path)
    if _checked_suffix(file) == ".csv":
        text = holes_text(holes, [f"hole {k + 1}" for k in range(holes.sizes["mark"])])
    else:
        content = holes_to_json(holes)
        variables = content.pop("variables")
        entries = [
            f"{json_text(key)}: {json_text(variable)}" for key, variable in variables.items()
        ]
        text = json_file(content, "variables", "{}", entries)
    write_whole(file, text.encode())


def read_holes(path: str | Path) -> xr.Dataset:
    """Read holes that :func:`write_holes` wrote.

    Parameters
    ----------
    path : str or Path
        ``.json`` gives the dataset that was written; of a table, ``.csv``, the columns ``x_um,
        y_um`` and, where it is there, ``diameter_um`` are read and others passed over.

    Raises
    ------
    FileError
        If the file cannot be read.
    MarkError
        If something is missing or malformed; all faults are named.
    """
    file = Path(path)
    name = file.name
    if _checked_suffix(file) == ".json":
        content = read_object(read_text(file, what="file of holes"), name)
        return holes_from_json(content, name)
    text = read_text(file, what="table of holes")
    table, points, diameters = table_of_holes(text, name, kind="hole")
    columns = {"x": points[:, 0], "y": points[:, 1]}
    if "diameter_um" in table.header:
        columns["diameter"] = diameters
    um = {"units": "um"}
    return xr.Dataset({key: ("mark", column, um) for key, column in columns.items()})


def _checked_suffix(file: Path) -> str:
    suffix = file.suffix.lower()
    if suffix not in (".json", ".csv"):
        raise FileError(
            f"{file.name} is no file of holes: .json keeps everything, .csv is the table to read."
        )
    return suffix


def _plain(value: Any, where: str, faults: list[str]) -> Any:
    """Turn a value into what JSON has; what has no place there is a fault.

    ``where`` says in ``faults`` what the value belongs to. NaN becomes None.
    """
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(k): _plain(v, f"{k} of {where}", faults) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v, where, faults) for v in value]
    if isinstance(value, float) and math.isnan(value):
        return None
    if not isinstance(value, (str, int, float)) or value in (math.inf, -math.inf):
        faults.append(f"{where} is {value!r}")
    return value


def _missing_as_nan(value: Any) -> Any:
    if isinstance(value, list):
        return [_missing_as_nan(v) for v in value]
    if isinstance(value, dict):
        return {k: _missing_as_nan(v) for k, v in value.items()}
    return math.nan if value is None else value
