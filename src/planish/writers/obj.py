"""Wavefront OBJ: nodes as text, with their colours behind them, and quadrilaterals."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from planish.writers.content import History
from planish.writers.mesh import Surface, mesh_of
from planish.writers.params import ExportParams

_AT_ONCE = 100_000  # lines


def write(surface: Surface, path: Path, history: History, params: ExportParams) -> None:
    """Write a surface; colours are three numbers from 0 to 1 behind each node, as MeshLab and Blender read them."""
    mesh = mesh_of(surface, params)
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(f"# {mesh.about}\n# {history.json()}\no {surface.name}\n")
        columns, form = mesh.points.astype(np.float64), "v %.9g %.9g %.9g"
        if mesh.colours is not None:
            columns, form = np.column_stack([columns, mesh.colours / 255.0]), f"{form} %.4f %.4f %.4f"
        for rows, line in ((columns, form), (mesh.quads + 1, "f %d %d %d %d")):
            for begin in range(0, len(rows), _AT_ONCE):
                part = rows[begin : begin + _AT_ONCE]
                file.write(f"{line}\n" * len(part) % tuple(part.ravel().tolist()))
