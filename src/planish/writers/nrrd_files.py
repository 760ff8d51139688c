"""NRRD: displacement fields, and maps with their size and place.

The head is written here: pynrrd puts the time of day into it.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.writers.content import History, Maps, plain_type
from planish.writers.field import Move, Moves, displacement
from planish.writers.itk import UNITS
from planish.writers.params import ExportParams

_TYPES = {
    "float32": "float", "float64": "double", "uint8": "uint8", "int8": "int8", "uint16": "uint16", "int16": "int16",
    "int32": "int32", "int64": "int64",
}  # fmt: skip


def write(content: Moves | Maps, path: Path, history: History, params: ExportParams) -> None:
    """Write the field that takes points from the moving to the fixed layer, or one map."""
    if isinstance(content, Moves):
        _write_field(content.forward, path, history, params)
        return
    (name,) = content.names
    dtype = plain_type(content.data[name].dtype)
    about = {"value_unit": content.units(name), "planish": history.json(**content.facts())}
    (y, x), (down, across) = content.origin_um, content.pixel_um
    head = _head(content.title(name), dtype, [], content.shape, (x, y), (across, down), params.unit, about)
    _put(path, head, (values for _, values in content.bands(name)))


def names(source: str, target: str, _affine: bool) -> list[str]:
    """Names of the files in a folder."""
    return [f"{source}_to_{target}.nrrd", f"{target}_to_{source}.nrrd"]


def write_folder(moves: Moves, folder: Path, history: History, params: ExportParams) -> None:
    """Write both directions: one takes points from the moving to the fixed layer, the other resamples images."""
    for move in (moves.forward, moves.back):
        _write_field(move, folder / f"{move.name}.nrrd", history, params)


def _write_field(move: Move, path: Path, history: History, params: ExportParams) -> None:
    """Write the displacement (x, y) of every node; beside the field there is none, so other programs take 0 there."""
    field = displacement(move)
    about = {
        "value_unit": params.unit, "planish": history.json(**field.facts()),
    }  # fmt: skip
    title = f"displacement of points of {move.source} to {move.target}"
    shape = (field.values.shape[0], field.values.shape[1])
    head = _head(title, field.values.dtype, ["vector"], shape, field.origin_um, field.pitch_um, params.unit, about)
    _put(path, head, [field.values * UNITS[params.unit]])


def _head(
    title: str, dtype: np.dtype[Any], first: list[str], shape: tuple[int, int], origin: tuple[float, float],
    pitch: tuple[float, float], unit: str, about: dict[str, str],
) -> str:  # fmt: skip
    """The head of a file whose last two axes are x and y, behind two components of ``first``."""
    scale = UNITS[unit]
    (x, y), (across, down) = ([f"{v * scale:.12g}" for v in pair] for pair in (origin, pitch))
    sizes = [*("2" for _ in first), str(shape[1]), str(shape[0])]
    lines = [
        "NRRD0005", f"content: {title}", f"type: {_TYPES[dtype.name]}", f"dimension: {len(sizes)}",
        "space dimension: 2", f"sizes: {' '.join(sizes)}",
        f"space directions: {'none ' * len(first)}({across},0) (0,{down})",
        f"kinds: {' '.join([*first, 'domain', 'domain'])}", "endian: little", "encoding: raw",
        f'space units: "{unit}" "{unit}"', f"space origin: ({x},{y})",
        *(f"{key}:={value}" for key, value in about.items()),
    ]  # fmt: skip
    return "\n".join(lines) + "\n\n"


def _put(path: Path, head: str, parts: Iterable[NDArray[Any]]) -> None:
    with path.open("wb") as file:
        file.write(head.encode())
        for part in parts:
            file.write(np.ascontiguousarray(part, part.dtype.newbyteorder("<")).data)
