"""PLY, binary: nodes with colour and all maps as properties, and quadrilaterals."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from planish.writers.content import History
from planish.writers.mesh import Surface, mesh_of
from planish.writers.params import ExportParams


def write(surface: Surface, path: Path, history: History, params: ExportParams) -> None:
    """Write a surface; what it is, and where it comes from, stands in comments."""
    mesh = mesh_of(surface, params)
    fields: list[tuple[str, str, str]] = [(axis, "float", "<f4") for axis in "xyz"]
    if mesh.colours is not None:
        fields += [(colour, "uchar", "u1") for colour in ("red", "green", "blue")]
    fields += [(name, "float", "<f4") for name in mesh.values]
    nodes = np.empty(len(mesh.points), dtype=[(name, kind) for name, _, kind in fields])
    for k, axis in enumerate("xyz"):
        nodes[axis] = mesh.points[:, k]
    if mesh.colours is not None:
        for k, colour in enumerate(("red", "green", "blue")):
            nodes[colour] = mesh.colours[:, k]
    for name, values in mesh.values.items():
        nodes[name] = values
    cells = np.empty(len(mesh.quads), dtype=[("count", "u1"), ("nodes", "<i4", (4,))])
    cells["count"], cells["nodes"] = 4, mesh.quads
    head = [
        "ply", "format binary_little_endian 1.0", f"comment {mesh.about}", f"comment {history.json()}",
        f"element vertex {len(nodes)}", *(f"property {kind} {name}" for name, kind, _ in fields),
        f"element face {len(cells)}", "property list uchar int vertex_indices", "end_header",
    ]  # fmt: skip
    with path.open("wb") as file:
        file.write(("\n".join(head) + "\n").encode("ascii"))
        file.write(nodes.data)
        file.write(cells.data)
