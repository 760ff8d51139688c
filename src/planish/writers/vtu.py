"""VTK's unstructured grid, ``.vtu``: XML with binary arrays, all maps as point data."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import IO, Any
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from numpy.typing import NDArray

from planish.writers.content import History
from planish.writers.mesh import Surface, mesh_of
from planish.writers.params import ExportParams

_TYPES = {"f4": "Float32", "i4": "Int32", "i8": "Int64", "u1": "UInt8"}
_QUAD = 9  # VTK's number of a quadrilateral


def write(surface: Surface, path: Path, history: History, params: ExportParams) -> None:
    """Write a surface; its colours are left to the program, which has all values. Lengths are um."""
    mesh = mesh_of(surface, params)
    cells = len(mesh.quads)
    first = f" Scalars={quoteattr(next(iter(mesh.values)))}" if mesh.values else ""
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write('<?xml version="1.0"?>\n')
        # Two dashes would end a comment.
        note = f"{mesh.about} {history.json()}".replace("--", "- -")
        file.write(f"<!-- {escape(note)} -->\n")
        file.write('<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64">\n')
        file.write(f'<UnstructuredGrid><Piece NumberOfPoints="{len(mesh.points)}" NumberOfCells="{cells}">\n<Points>\n')
        _array(file, "Points", mesh.points)
        file.write("</Points>\n<Cells>\n")
        _array(file, "connectivity", mesh.quads)
        _array(file, "offsets", 4 * np.arange(1, cells + 1, dtype=np.int64))
        _array(file, "types", np.full(cells, _QUAD, np.uint8))
        file.write(f"</Cells>\n<PointData{first}>\n")
        for name, values in mesh.values.items():
            _array(file, name, values)
        file.write("</PointData>\n</Piece></UnstructuredGrid>\n</VTKFile>\n")


def _array(file: IO[str], name: str, values: NDArray[Any]) -> None:
    """Write an array: its number of bytes and its bytes, as base64."""
    kind = values.dtype.str[1:]
    parts = f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 and name == "Points" else ""
    file.write(f'<DataArray type="{_TYPES[kind]}" Name={quoteattr(name)}{parts} format="binary">\n')
    data = np.ascontiguousarray(values, values.dtype.newbyteorder("<")).tobytes()
    file.write(base64.b64encode(np.uint64(len(data)).astype("<u8").tobytes() + data).decode("ascii"))
    file.write("\n</DataArray>\n")
