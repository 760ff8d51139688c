"""STL, binary: triangles, with a colour of 15 bits each as VisCAM has it and MeshLab reads it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planish.writers.content import History
from planish.writers.mesh import Surface, mesh_of
from planish.writers.params import ExportParams

_HEAD = 80
_TRIANGLE = [("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("colour", "<u2")]
_VALID = 1 << 15


def write(surface: Surface, path: Path, history: History, params: ExportParams) -> None:
    """Write a surface: two triangles for each cell, lengths in um.

    The head has room for 80 letters: the surface, the unit, the program and the start of the study's hash.
    """
    mesh = mesh_of(surface, params)
    corners = np.concatenate([mesh.quads[:, [0, 1, 2]], mesh.quads[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
    triangles = np.zeros(len(corners), dtype=_TRIANGLE)
    places = mesh.points[corners]
    normal = np.cross(places[:, 1] - places[:, 0], places[:, 2] - places[:, 0]).astype(np.float64)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    triangles["normal"] = normal / np.where(length > 0, length, 1.0)
    triangles["corners"] = places
    if mesh.colours is not None:
        triangles["colour"] = _packed(mesh.colours[corners].mean(axis=1))
    head = f"{history.program}, {surface.name}, um, study {history.study_sha256[:16]}".encode("ascii", "replace")
    with path.open("wb") as file:
        file.write(head[:_HEAD].ljust(_HEAD))
        file.write(len(triangles).to_bytes(4, "little"))
        file.write(triangles.data)


def _packed(colours: NDArray[np.float64]) -> NDArray[np.uint16]:
    """Red, green and blue (n, 3) of 0 to 255 in five bits each, blue the lowest; the sixteenth says that they hold."""
    red, green, blue = np.rint(colours / 255 * 31).astype(np.uint16).T
    return (_VALID | red << 10 | green << 5 | blue).astype(np.uint16)
