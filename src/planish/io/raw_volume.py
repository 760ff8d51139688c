"""Raw binary values, described by a small TOML file beside them.

::

    file = "sheet.raw"          # in the same folder; without it: the TOML's own name without .toml
    shape = [400, 1200, 900]    # z, y, x; x runs fastest
    dtype = "uint16"
    byte_order = "little"       # or "big"; needed for types of more than one byte
    offset = 0                  # bytes before the first value
    voxel_um = 1.65             # or [z, y, x]
"""

from __future__ import annotations

import tomllib
from typing import Any

import numpy as np

from planish.core.errors import FileError
from planish.io.formats import LoadedVolume, Place, referenced_file
from planish.io.guard import reading, size_of_file
from planish.io.headed import raw_values
from planish.io.sizes import Stated

TYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64", "float16", "float32", "float64")
KEYS = ("file", "shape", "dtype", "byte_order", "offset", "voxel_um")
LARGEST_HEADER = 100_000

EXAMPLE = 'shape = [z, y, x], dtype = "uint16", byte_order = "little", voxel_um = 1.65'


def load(place: Place, _channel: str | None, _memory_bytes: int | None) -> LoadedVolume:
    """Map raw values as their header says; either of the two files is given."""
    path = place.path
    header = path if path.suffix.lower() == ".toml" else path.with_name(path.name + ".toml")
    if not header.is_file() and header != path:
        size_of_file(path)
        raise FileError(
            f"{path.name} has raw values and no header. Write {header.name} beside it, with lines such as: {EXAMPLE}."
        )
    if size_of_file(header) > LARGEST_HEADER:
        raise FileError(
            f"{header.name} is larger than {LARGEST_HEADER // 1000} kB and no header. Give lines such as: {EXAMPLE}."
        )
    with reading(header), header.open("rb") as file:
        keys = tomllib.load(file)
    data = referenced_file(header.parent, str(keys.get("file", header.name[: -len(".toml")])), header)
    faults = [f"unknown key {key!r}" for key in keys if key not in KEYS]
    shape, dtype, order = keys.get("shape"), keys.get("dtype"), keys.get("byte_order")
    offset, voxel_um = keys.get("offset", 0), keys.get("voxel_um")
    if not (isinstance(shape, list) and len(shape) == 3 and all(type(n) is int and n > 0 for n in shape)):
        faults.append(f"shape is {shape!r}, needed are three whole numbers [z, y, x]")
    if dtype not in TYPES:
        faults.append(f"dtype is {dtype!r}, needed is one of {', '.join(TYPES)}")
    elif np.dtype(dtype).itemsize > 1 and order not in ("little", "big"):
        faults.append(f'byte_order is {order!r}, needed is "little" or "big"')
    if type(offset) is not int or offset < 0:
        faults.append(f"offset is {offset!r}, needed is a number of bytes")
    sizes: list[Any] = voxel_um if isinstance(voxel_um, list) else [voxel_um] * 3
    if voxel_um is not None and not (len(sizes) == 3 and all(type(v) in (int, float) and v > 0 for v in sizes)):
        faults.append(f"voxel_um is {voxel_um!r}, needed is a number or [z, y, x], in um")
    if not isinstance(keys.get("file", ""), str):
        faults.append("file is no name")
    if faults:
        raise FileError(f"{header.name}: {'; '.join(faults)}. Correct the header; it has lines such as: {EXAMPLE}.")
    stored = np.dtype(str(dtype)).newbyteorder(">" if order == "big" else "<")
    values = raw_values(header, data, tuple(int(n) for n in shape or ()), stored, offset=int(offset))
    voxel = tuple(None if v is None else float(v) for v in sizes)
    stated = Stated(source="the TOML header", um=voxel, note="" if None not in voxel else "it has no voxel_um")
    return LoadedVolume(values=values, stated=[stated], files=[header, data])
