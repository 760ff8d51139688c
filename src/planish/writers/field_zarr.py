"""A registration as displacement fields in zarr, to read with xarray: documented in ``docs/export.md``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import zarr

from planish.writers.content import History
from planish.writers.field import Move, Moves, displacement
from planish.writers.params import ExportParams

FORMAT = "planish displacement 1"


def write(moves: Moves, path: Path, history: History, _params: ExportParams) -> None:
    """Write a group for each direction: ``displacement_x`` and ``displacement_y`` (y, x) in um."""
    root = zarr.open_group(path, mode="w-", zarr_format=3)
    root.attrs.update({"format": FORMAT, "model": moves.model, "history": history.json()})
    for move in (moves.forward, moves.back):
        _put(root, move)


def names(source: str, target: str, _affine: bool) -> list[str]:
    """Names of the files in a folder."""
    return [f"{source}_to_{target}.zarr"]


def write_folder(moves: Moves, folder: Path, history: History, params: ExportParams) -> None:
    """Write both directions into one store."""
    write(moves, folder / f"{moves.forward.name}.zarr", history, params)


def _put(root: zarr.Group, move: Move) -> None:
    field = displacement(move)
    group = root.create_group(move.name)
    group.attrs.update({"source": move.source, "target": move.target} | field.facts())
    for axis, at in (("y", field.y_um), ("x", field.x_um)):
        made: Any = group.create_array(axis, shape=at.shape, dtype=at.dtype, dimension_names=(axis,))
        made[:] = at
        made.attrs.update({"units": "um", "long_name": f"{axis} of {move.source}"})
    for k, axis in enumerate("xy"):
        made = group.create_array(
            f"displacement_{axis}", shape=field.values.shape[:2], dtype=field.values.dtype, dimension_names=("y", "x"),
        )  # fmt: skip
        made[:] = field.values[..., k]
        made.attrs.update({"units": "um", "long_name": f"{axis} of {move.target} minus {axis} of {move.source}"})
