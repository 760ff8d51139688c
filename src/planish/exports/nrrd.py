"""NRRD: displacement fields, and maps with their size and place.

The head is written here: pynrrd puts the time of day into it.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.exports.content import ExportHistory, Maps, plain_type
from planish.exports.displacements import DirectedTransform, displacement
from planish.exports.params import ExportParams
from planish.exports.transforms import UNITS

_TYPES = {
    "float32": "float", "float64": "double", "uint8": "uint8", "int8": "int8", "uint16": "uint16", "int16": "int16",
    "int32": "int32", "int64": "int64",
}  # fmt: skip


def write(content: DirectedTransform | Maps, path: Path, history: ExportHistory, params: ExportParams) -> None:
    """Write the displacement (x, y) of every node of a field, or one map.

    Beside the field there is no displacement, so other programs take 0 there.
    """
    unit = params.unit
    if isinstance(content, DirectedTransform):
        field = displacement(content)
        title = f"displacement of points of {content.source} to {content.target}"
        dtype, components, shape = field.vectors.dtype, ["vector"], field.shape
        (x, y), (across, down) = field.origin_um, field.pitch_um
        about = {"value_unit": unit, "planish": history.json(**field.facts())}
        parts: Iterable[NDArray[Any]] = [field.vectors * UNITS[unit]]
    else:
        (name,) = content.names
        title, dtype, components, shape = content.titles[name], plain_type(content.data[name].dtype), [], content.shape
        (y, x), (down, across) = content.origin_um, content.pixel_um
        about = {"value_unit": content.units[name], "planish": history.json(**content.facts())}
        parts = (band for _, band in content.bands(name))
    x, y, across, down = (f"{v * UNITS[unit]:.12g}" for v in (x, y, across, down))
    sizes = [*("2" for _ in components), str(shape[1]), str(shape[0])]
    head = [
        "NRRD0005", f"content: {title}", f"type: {_TYPES[dtype.name]}", f"dimension: {len(sizes)}",
        "space dimension: 2", f"sizes: {' '.join(sizes)}",
        f"space directions: {'none ' * len(components)}({across},0) (0,{down})",
        f"kinds: {' '.join([*components, 'domain', 'domain'])}", "endian: little", "encoding: raw",
        f'space units: "{unit}" "{unit}"', f"space origin: ({x},{y})",
        *(f"{key}:={text}" for key, text in about.items()),
    ]  # fmt: skip
    with path.open("wb") as file:
        file.write(("\n".join(head) + "\n\n").encode())
        for part in parts:
            file.write(np.ascontiguousarray(part, part.dtype.newbyteorder("<")).data)
