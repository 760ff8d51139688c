"""Write a surface of the sheet as a mesh in space: PLY, OBJ, STL and VTK.

The mesh is in um of the volume, with maps and a colour.
"""

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO
from xml.sax.saxutils import escape, quoteattr

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import StudyError
from planish.core.frame import Frame
from planish.core.grid import pitch
from planish.core.typing import Array, Shape2D, Singles, Texts
from planish.exports.content import CORNERS, ExportHistory, column_of, units_of
from planish.exports.formats import ExportParams
from planish.report.colours import Scale

_GREY = (212, 214, 216)  # of missing values: MISSING of the page as red, green, blue
SURFACES = ("top", "bottom", "interface_top", "interface_bottom", "centre")
"""Names of the surfaces in the group ``surfaces``."""


@dataclass(frozen=True, slots=True)
class Surface:
    """A surface of the sheet and what it carries."""

    #: heights and maps (y, x) on the columns of the volume, in um; the frame in its attributes.
    data: xr.Dataset
    name: str  #: one of `SURFACES`
    maps: Texts  #: that its nodes carry; the first is their colour where there is one
    scales: Mapping[str, Scale]  #: limits and colours of maps, by name


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceMesh:
    """A mesh."""

    points: Singles  # (n, 3): x, y, z in um
    quads: NDArray[np.int32]  # (m, 4): nodes of each cell, anticlockwise as seen from outside
    # (n,), by name and unit (``coating_top_um``); NaN is missing.
    maps: dict[str, Singles]
    colours: NDArray[np.uint8] | None  # (n, 3): red, green, blue of the first map
    description: str  # what places and colours are, in one line


def write_ply(surface: Surface, path: Path, history: ExportHistory, params: ExportParams) -> None:
    """Write nodes with colour and all maps as properties, and quadrilaterals.

    Binary, with its history in comments.
    """
    mesh = mesh_of(surface, params)
    columns: dict[str, Array] = dict(zip("xyz", mesh.points.T, strict=True))
    if mesh.colours is not None:
        columns |= zip(("red", "green", "blue"), mesh.colours.T, strict=True)
    columns |= mesh.maps
    # A record of a node, and one of a cell, as they stand in the file.
    node_type = [(k, column.dtype.newbyteorder("<")) for k, column in columns.items()]
    nodes = np.rec.fromarrays(columns.values(), node_type)
    face_type = [("count", "u1"), ("nodes", "<i4", (4,))]
    faces = np.empty(len(mesh.quads), face_type)
    faces["count"] = 4
    faces["nodes"] = mesh.quads
    properties: list[str] = []
    for name, column in columns.items():
        ply_type = "float"
        if column.dtype == np.uint8:
            ply_type = "uchar"
        properties.append(f"property {ply_type} {name}")
    header_lines = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment {mesh.description}",
        f"comment {history.json()}",
        f"element vertex {len(nodes)}",
        *properties,
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    with path.open("wb") as file:
        file.write(("\n".join(header_lines) + "\n").encode("ascii"))
        file.write(nodes.data)
        file.write(faces.data)


def write_obj(surface: Surface, path: Path, history: ExportHistory, params: ExportParams) -> None:
    """Write nodes with their colours as text, and quadrilaterals.

    Colours stand behind the nodes as numbers from 0 to 1 (MeshLab, Blender).
    """
    mesh = mesh_of(surface, params)
    node_values = mesh.points.astype(np.float64)
    node_format = "v %.9g %.9g %.9g"
    if mesh.colours is not None:
        node_values = np.column_stack([node_values, mesh.colours / 255.0])
        node_format = f"{node_format} %.4f %.4f %.4f"
    # Nodes are counted from 1.
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(f"# {mesh.description}\n# {history.json()}\no {surface.name}\n")
        for table, row_format in ((node_values, node_format), (mesh.quads + 1, "f %d %d %d %d")):
            for start in range(0, len(table), 100_000):  # lines that are made at a time
                chunk = table[start : start + 100_000]
                file.write(f"{row_format}\n" * len(chunk) % tuple(chunk.ravel().tolist()))


def write_stl(surface: Surface, path: Path, history: ExportHistory, params: ExportParams) -> None:
    """Write two triangles for each cell, in binary, with a colour of 15 bits.

    The colour is as VisCAM has it and MeshLab reads it.

    The head has room for 80 letters: the surface, the unit, the program and the start of the
    study's hash.
    """
    mesh = mesh_of(surface, params)
    halves_of_cell = [[0, 1, 2], [0, 2, 3]]  # its corners in each of two triangles
    corners = mesh.quads[:, halves_of_cell].reshape(-1, 3)
    # A triangle in the file: its normal, three corners (x, y, z), and its colour.
    record = [("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("colour", "<u2")]
    triangles = np.zeros(len(corners), record)
    vertices = mesh.points[corners]
    first_edges = vertices[:, 1] - vertices[:, 0]
    second_edges = vertices[:, 2] - vertices[:, 0]
    normals = np.cross(first_edges, second_edges).astype(np.float64)
    norms = np.linalg.norm(normals, axis=1, keepdims=True)
    triangles["normal"] = normals / np.where(norms > 0, norms, 1.0)
    triangles["corners"] = vertices
    if mesh.colours is not None:
        # Five bits each, blue the lowest; the sixteenth says that they hold.
        shares = mesh.colours[corners].mean(axis=1) / 255
        five_bits = np.rint(shares * 31).astype(np.uint16)
        red, green, blue = five_bits.T
        triangles["colour"] = 1 << 15 | red << 10 | green << 5 | blue
    title = f"{history.program}, {surface.name}, um, study {history.study_sha256[:16]}"
    header = title.encode("ascii", "replace")
    with path.open("wb") as file:
        file.write(header[:80].ljust(80))
        file.write(len(triangles).to_bytes(4, "little"))
        file.write(triangles.data)


def write_vtu(surface: Surface, path: Path, history: ExportHistory, params: ExportParams) -> None:
    """Write an unstructured grid as XML with binary arrays.

    All maps are point data, which programs colour themselves.
    """
    mesh = mesh_of(surface, params)
    n_cells = len(mesh.quads)
    active_scalars = ""  # the map that programs show first
    if mesh.maps:
        active_scalars = f" Scalars={quoteattr(next(iter(mesh.maps)))}"
    # Two dashes would end a comment.
    comment = f"{mesh.description} {history.json()}".replace("--", "- -")
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(
            f'<?xml version="1.0"?>\n<!-- {escape(comment)} -->\n<VTKFile type="UnstructuredGrid"'
            ' version="1.0" byte_order="LittleEndian"'
            f' header_type="UInt64">\n<UnstructuredGrid><Piece NumberOfPoints="{len(mesh.points)}"'
            f' NumberOfCells="{n_cells}">\n<Points>\n'
        )
        _write_vtk_array(file, "Points", mesh.points)
        file.write("</Points>\n<Cells>\n")
        _write_vtk_array(file, "connectivity", mesh.quads)
        _write_vtk_array(file, "offsets", 4 * np.arange(1, n_cells + 1, dtype=np.int64))
        _write_vtk_array(file, "types", np.full(n_cells, 9, np.uint8))  # quadrilaterals
        file.write(f"</Cells>\n<PointData{active_scalars}>\n")
        for name, node_values in mesh.maps.items():
            _write_vtk_array(file, name, node_values)
        file.write("</PointData>\n</Piece></UnstructuredGrid>\n</VTKFile>\n")


_VTK_TYPES = {"f4": "Float32", "i4": "Int32", "i8": "Int64", "u1": "UInt8"}  # by numpy's code


def _write_vtk_array(file: IO[str], name: str, array: Array) -> None:
    """Write an array as an element of VTK's XML: its length in bytes and its bytes in base 64."""
    vtk_type = _VTK_TYPES[array.dtype.str[1:]]
    components_attr = ""
    if name == "Points":
        components_attr = ' NumberOfComponents="3"'
    file.write(
        f'<DataArray type="{vtk_type}" Name={quoteattr(name)}{components_attr} format="binary">\n'
    )
    data_bytes = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes()
    length_bytes = len(data_bytes).to_bytes(8, "little")
    encoded = base64.b64encode(length_bytes + data_bytes)
    file.write(encoded.decode("ascii"))
    file.write("\n</DataArray>\n")


def mesh_of(surface: Surface, params: ExportParams) -> SurfaceMesh:
    """Make a mesh: a node where the surface was found, and a cell where all its corners are nodes.

    Places are those in the volume, x, y and z in um, whichever axis the rows of the surface run
    along. StudyError if ``mesh_um`` is below the pitch or leaves no cell.
    """
    frame = Frame.of(surface.data)
    row_step, col_step = steps_of(surface.data, params.mesh_um)
    rows = slice(None, None, row_step)
    cols = slice(None, None, col_step)
    nodes = surface.data.isel(y=rows, x=cols)
    heights = nodes[surface.name].values
    is_node = np.isfinite(heights)
    # Places (y, x) that have a node are counted row by row: its number among the points.
    node_index = np.cumsum(is_node).reshape(is_node.shape) - 1
    # Slices (rows, cols) that give one corner of every cell: CORNERS has them row by row, here they
    # go around the cell.
    corners = [CORNERS[k] for k in (0, 1, 3, 2)]
    is_cell = np.all([is_node[corner] for corner in corners], axis=0)
    if not is_cell.any():
        raise StudyError(
            f"The surface {surface.name} has no cell at these nodes: {int(is_node.sum())} nodes are"
            " known. Give a smaller `mesh_um`, or another surface."
        )
    quads = np.stack([node_index[corner][is_cell] for corner in corners], axis=1)
    coords_um = {
        frame.rows: nodes["y"].values[:, None],
        frame.cols: nodes["x"].values[None, :],
        frame.through: heights,
    }
    columns = [np.broadcast_to(coords_um[axis], is_node.shape)[is_node] for axis in "xyz"]
    points = np.stack(columns, axis=1)
    if params.as_seen:
        points[:, 1] *= -1
    # Turning y around has turned the cells around, too.
    if _are_anticlockwise(frame, surface.name) == params.as_seen:
        quads = quads[:, ::-1]
    maps: dict[str, Singles] = {}
    for name in surface.maps:
        node_map = nodes[name]
        column = column_of(name, units_of(node_map))
        maps[column] = node_map.values[is_node].astype(np.float32)
    about = f"surface {surface.name}; um; x, y, z of the volume"
    if params.as_seen:
        about = f"surface {surface.name}; um; y of the volume with its sign turned"
    colours = None
    if surface.maps:
        colour_map = nodes[surface.maps[0]]
        scale = surface.scales[surface.maps[0]]
        colours = _colours(colour_map.values[is_node], scale)
        about += f"; colour: {colour_map.name} from {scale.low:.6g} to {scale.high:.6g}"
        about += f" {units_of(colour_map)}".removesuffix(" 1")
    points = np.ascontiguousarray(points, np.float32)
    quads = np.ascontiguousarray(quads, np.int32)
    return SurfaceMesh(points, quads, maps, colours, about)


def _are_anticlockwise(frame: Frame, name: str) -> bool:
    """True if cells of (row, col), (row, col + 1) ... run so as seen from outside of the sheet."""
    vectors = dict(zip("xyz", np.eye(3), strict=True))
    cell_normal = np.cross(vectors[frame.cols], vectors[frame.rows])
    is_upwards = float(cell_normal @ vectors[frame.through]) * frame.sign > 0
    return is_upwards != name.endswith("bottom")


def _colours(values: Array, scale: Scale) -> NDArray[np.uint8]:
    """Colours of values on a scale, grey where they are missing."""
    from planish.exports.picture import colormap_of  # matplotlib is needed for colours alone

    fractions = scale.fractions(values)
    colours = colormap_of(scale)(np.clip(fractions, 0, 1), bytes=True)
    is_known = np.isfinite(fractions)[:, None]
    return np.where(is_known, colours[:, :3], _GREY).astype(np.uint8)


def steps_of(columns: xr.Dataset, mesh_um: float | None) -> Shape2D:
    """Give how many rows and columns of the volume lie between nodes, 1 for every one.

    ``mesh_um``: distance of nodes that was asked for, None for every column. StudyError where it is
    less than a column.
    """
    if mesh_um is None:
        return 1, 1
    row_um, col_um = pitch(columns)
    column_um = max(row_um, col_um)
    if mesh_um < 0.999 * column_um:  # a pitch is rounded where it is written
        raise StudyError(
            f"`mesh_um={mesh_um:g}` is less than a column of {column_um:g} um. Give a multiple of"
            " it."
        )
    n_rows = max(1, round(mesh_um / row_um))
    n_cols = max(1, round(mesh_um / col_um))
    return n_rows, n_cols
