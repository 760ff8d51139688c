"""Flatten the centre surface of a sheet: choose the mesh, relax it, carry every column along."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydantic import Field

from planish.core.arrays import check_dataset
from planish.core.errors import CannotFlatten
from planish.core.facts import DescribedModel, Value
from planish.core.frame import Frame
from planish.core.grid import bilinear, corners_of, filled, pitch
from planish.core.options import params_of
from planish.core.robust import percentiles
from planish.core.typing import Bools, Floats, Ints
from planish.flatten.curvature import CurvatureVerdict, curvature_check
from planish.flatten.distortion import Distortion, cell_strain, edge_strain, measure_distortion
from planish.flatten.levels import pieces_of
from planish.flatten.params import FlattenParams
from planish.flatten.relax import Relaxed, relax_grid

Neutral = Literal["base", "faces"]
_MOST_NODES = 4_000_000  # of the mesh: half a second and half a gigabyte


class FlatteningQuality(DescribedModel):
    """How the flattening ended."""

    outcome: str
    """RESTED, HELD_OPEN and so on: how the solver ended."""
    sentence: str
    """The same in words, with what to try next."""
    steps: int
    """Steps of the solver."""
    energy_um2: float
    """Energy of the springs at the end."""
    mesh_um: float
    """Pitch of the mesh."""
    folded_cells: int
    """Cells that the springs would fold and that are held open; they are not valid."""
    edge_strain_p95: Value
    """95th percentile of the absolute strain of the springs."""
    edge_strain_max: Value
    """Largest absolute strain of a spring."""
    method: str
    """multigrid or relaxation."""
    neutral: Neutral = "faces"
    """Surface that was taken to stay unstrained."""
    springs: int
    """Number of springs."""
    straight_share: Value
    """Share of the springs measured straight through space, as the surface is rough there."""
    distortion: Distortion
    """Strain, lengths and growth."""
    # The class says the same, and the schema does not say it twice.
    curvature: CurvatureVerdict = Field(description="Whether the surface can be flat at all.")
    largest_move_um: Value
    """Largest distance of a column from its projected place."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Flattened:
    """Flat coordinates and their quality."""

    #: Dims (y, x): ``u``, ``v`` in um as seen from the top: u to the right, v downwards. NaN where
    #: there is no sheet or a folded cell. ``projected_u``, ``projected_v``: the same without
    #: flattening.
    flat: xr.Dataset
    #: Dims (row, col): strains of the mesh's cells, with their place ``y``, ``x``, as
    #: ``cell_strain`` gives them; ``gaussian_curvature`` in 1/um2 and ``needed_strain``, what a
    #: patch of paper around the cell would need to be flat; and over ``step`` the solver's
    #: progress: ``step_nodes``, ``step_energy``, ``step_move``.
    strain: xr.Dataset
    quality: FlatteningQuality  #: how the flattening ended


def flatten_sheet(surfaces: xr.Dataset, *, params: FlattenParams | None = None) -> Flattened:
    """Develop the sheet into the plane: the surface that stays unstrained where it is bent.

    That surface is taken at a distance from the centre surface, along its normals: the middle of
    the base (``base_middle``), or none for the mean of the faces. A column's place is that of the
    point below its centre.

    The mesh takes every n-th column (``params.mesh_um``): the centre surface holds no detail below
    its cut-off of 400 um, so that a mesh of 12 um loses nothing. Every column is carried along.

    Parameters
    ----------
    surfaces : Dataset, dims (y, x), in um
        ``centre`` and the frame in its attributes.
    params : FlattenParams

    Returns
    -------
    Flattened

    Raises
    ------
    CannotFlatten
        If the centre surface is too small or falls into pieces, or the middle of the base is asked
        for and not known.
    """
    check_dataset(
        surfaces,
        "centre",
        expected="surfaces",
        source="pl.find_surfaces(volume)",
        call_format="pl.flatten_sheet({})",
    )
    params = params_of(FlattenParams, params, "pl.flatten_sheet")
    frame = Frame.of(surfaces)
    has_base = "base_middle" in surfaces
    if params.neutral == "base" and not has_base:
        raise CannotFlatten(
            "The middle of the base is asked for (`neutral=base`), and its interfaces with the"
            " coatings were not found on both sides. Leave `neutral` out."
        )
    neutral = params.neutral or ("base" if has_base and "method" not in surfaces.attrs else "faces")
    mesh = sheet_mesh(surfaces, params.mesh_um)
    points = mesh.points if neutral == "faces" else mesh.raised(surfaces["base_middle"].values)
    relaxed = relax_grid(points, method=params.method, rest=params.rest, weights=mesh.weights)
    columns = _flat_columns(surfaces, mesh, relaxed, frame)
    flat = columns.assign_attrs(neutral=neutral, rest=params.rest)
    strain = cell_strain(points, relaxed.uv)
    strain.coords["y"] = "row", _middles(mesh.y_um), {"units": "um"}
    strain.coords["x"] = "col", _middles(mesh.x_um), {"units": "um"}
    # The same lines in the same sheet every time.
    rng = np.random.default_rng(0)
    distortion = measure_distortion(points, relaxed.uv, strain, rng=rng)
    curvature = curvature_check(points)
    cells = ("row", "col")
    strain["gaussian_curvature"] = cells, _at_cells(curvature.curvature), {"units": "1/um2"}
    strain["needed_strain"] = cells, _at_cells(curvature.strain)
    along_rows, along_cols = edge_strain(points, relaxed.uv)
    spring_strains = np.concatenate([along_rows.ravel(), along_cols.ravel()])
    edge_p95, edge_max = percentiles(np.abs(spring_strains), 95, 100)
    moves_u = flat["u"] - flat["projected_u"]
    moves_v = flat["v"] - flat["projected_v"]
    quality = FlatteningQuality(
        outcome=relaxed.outcome.name,
        sentence=relaxed.outcome.value,
        steps=relaxed.steps,
        energy_um2=relaxed.energy,
        mesh_um=mesh.pitch_um,
        folded_cells=relaxed.folded.sum(),
        edge_strain_p95=edge_p95,
        edge_strain_max=edge_max,
        method=params.method,
        neutral=neutral,
        springs=relaxed.springs,
        straight_share=relaxed.straight_share,
        distortion=distortion,
        curvature=CurvatureVerdict.holding(curvature),
        largest_move_um=np.nanmax(np.hypot(moves_u, moves_v)),
    )
    strain = strain.assign(_progress(relaxed))
    return Flattened(flat=flat, strain=strain, quality=quality)


class SheetMesh(NamedTuple):
    """Nodes of the spring mesh on the centre surface.

    ``rows``, ``cols``: the columns that it takes, at ``y_um``, ``x_um``; ``pitch_um``: between two
    rows; ``is_sheet`` (y, x): columns of the sheet's largest piece; ``points`` (rows, cols, 3): x,
    y and height, NaN where there is no sheet; ``weights``: of the nodes, less where the surface was
    bridged.
    """

    rows: Ints
    cols: Ints
    y_um: Floats
    x_um: Floats
    pitch_um: float
    is_sheet: Bools
    points: Floats
    weights: Floats | None

    def raised(self, offset: NDArray[np.floating]) -> Floats:
        """Move nodes along the normals onto the surface that lies ``offset`` (y, x) above.

        ``offset`` is vertical, in um.
        """
        height = self.points[..., 2]
        node_offset = np.nan_to_num(offset[np.ix_(self.rows, self.cols)])
        order = 2 if min(height.shape) > 2 else 1
        down, across = np.gradient(filled(height), self.y_um, self.x_um, edge_order=order)
        normals = np.stack([-across, -down, np.ones_like(height)], axis=-1)
        # A vertical offset, along a normal that is not of unit length.
        way = node_offset / (1 + down**2 + across**2)
        return self.points + normals * way[..., None]


def sheet_mesh(surfaces: xr.Dataset, mesh_um: float | None) -> SheetMesh:
    """Choose the nodes of the mesh; :func:`flatten_sheet` says what is raised.

    Without ``mesh_um`` it is four columns wide, or as many as keep the mesh to four million nodes.
    Pieces of the surface beside the largest one are left out, both of the columns and of the mesh.
    """
    y, x, centre = (surfaces[name].values for name in ("y", "x", "centre"))
    is_sheet = _largest_piece(np.isfinite(centre))
    pitch_um = pitch(surfaces)
    area_um2 = np.count_nonzero(is_sheet) * pitch_um[0] * pitch_um[1]
    wanted_um = mesh_um or max(4 * max(pitch_um), np.sqrt(area_um2 / _MOST_NODES))
    # Columns per mesh cell, along rows and columns, so that cells are about square.
    most_steps = [max(1, (n - 1) // 2) for n in centre.shape]
    wanted_steps = np.divide(wanted_um, pitch_um).round().astype(int)
    row_step, col_step = np.clip(wanted_steps, 1, most_steps).tolist()
    rows = _mesh_indices(y.size, row_step)
    cols = _mesh_indices(x.size, col_step)
    mesh_y, mesh_x = np.meshgrid(y[rows], x[cols], indexing="ij")
    sheet_height = np.where(is_sheet, centre, np.nan)
    height = sheet_height[np.ix_(rows, cols)]
    points = np.stack([mesh_x, mesh_y, height], axis=-1)
    points[~_largest_piece(np.isfinite(height))] = np.nan
    return SheetMesh(
        rows=rows,
        cols=cols,
        y_um=y[rows],
        x_um=x[cols],
        pitch_um=row_step * pitch_um[0],
        is_sheet=is_sheet,
        points=points,
        weights=node_weights(surfaces, rows, cols),
    )


def node_weights(surfaces: xr.Dataset, rows: Ints, cols: Ints) -> Floats | None:
    """Weights of the mesh's nodes, less where the centre surface was bridged.

    None where the surfaces do not tell.
    """
    if "status" not in surfaces:
        return None
    # It holds the sheet together there, and leaves its shape to what was measured.
    status = surfaces["status"].values[np.ix_(rows, cols)]
    return np.where(status == 0, 1.0, 0.2)


def _middles(nodes_um: Floats) -> Floats:
    return 0.5 * (nodes_um[1:] + nodes_um[:-1])


def _at_cells(nodes: Floats) -> Floats:
    a, b, c, d = corners_of(nodes)
    return 0.25 * (a + b + d + c)


def _progress(relaxed: Relaxed) -> dict[str, tuple[str, Floats, dict[str, str]]]:
    """Give the history of the solver over ``step``.

    Nodes of the mesh, energy, and the mean move of a node in the step. The solver has them in mean
    pitches.
    """
    steps = [(step.nodes, step.energy, step.move) for step in relaxed.history]
    columns = np.array(steps, dtype=np.float64).reshape(-1, 3)
    nodes, energy, mean_move = columns.T
    energy_attrs = {"units": "um2", "long_name": "Spring energy"}
    move_attrs = {"units": "um", "long_name": "Mean move"}
    return {
        "step_nodes": ("step", nodes, {"long_name": "Nodes of the mesh"}),
        "step_energy": ("step", energy * relaxed.pitch**2, energy_attrs),
        "step_move": ("step", mean_move * relaxed.pitch, move_attrs),
    }


def _largest_piece(mask: Bools) -> Bools:
    """Keep the largest connected piece; fragments beside it have no place in the plane."""
    labels, count = pieces_of(mask)
    if count == 0:
        raise CannotFlatten("The centre surface is empty; there is nothing to flatten.")
    sizes = np.bincount(labels.ravel())
    return labels == 1 + np.argmax(sizes[1:])


def _mesh_indices(n_columns: int, step: int) -> Ints:
    """Every ``step``-th of n columns, and the last one."""
    indices = np.arange(0, n_columns, step)
    if indices[-1] == n_columns - 1:
        return indices
    # The last cell would be a sliver: it is widened instead.
    is_sliver = n_columns - 1 - indices[-1] < step / 2
    if is_sliver and indices.size > 2:
        indices = indices[:-1]
    return np.append(indices, n_columns - 1)


def _flat_columns(
    surfaces: xr.Dataset, mesh: SheetMesh, relaxed: Relaxed, frame: Frame
) -> xr.Dataset:
    """Carry every column of the sheet along with the mesh; NaN in its folded cells.

    Gives the variables of :class:`Flattened`'s ``flat``. Seen from the top, a mirrored sheet runs
    from right to left: u is then counted from its other end.
    """
    rows, cols = mesh.rows, mesh.cols
    y, x = np.meshgrid(surfaces["y"].values, surfaces["x"].values, indexing="ij")
    # Bilinear between the nodes of the mesh, filled by the nearest node outside.
    mesh_row = np.interp(np.arange(len(x)), rows, np.arange(rows.size))
    mesh_col = np.interp(np.arange(x.shape[1]), cols, np.arange(cols.size))
    places = np.ix_(mesh_row, mesh_col)
    node_moves = np.moveaxis(relaxed.uv - mesh.points[..., :2], -1, 0)
    u_moves, v_moves = (bilinear(filled(moves), *places) for moves in node_moves)
    is_valid = mesh.is_sheet.copy()
    for i, j in zip(*np.nonzero(relaxed.folded), strict=True):
        cell_rows = slice(rows[i], rows[i + 1] + 1)
        is_valid[cell_rows, cols[j] : cols[j + 1] + 1] = False
    projected_u, u = x, x + u_moves
    if frame.mirrored:
        mirror_um = float(x[0, -1] + x[0, 0])
        projected_u, u = mirror_um - projected_u, mirror_um - u
    values_and_titles = {
        "u": (u, "Flat coordinate u"),
        "v": (y + v_moves, "Flat coordinate v"),
        "projected_u": (projected_u, "Projected coordinate u"),
        "projected_v": (y, "Projected coordinate v"),
    }
    flat_attrs = frame.attrs() | {"mirrored_view": int(frame.mirrored)}
    flat = xr.Dataset(coords=surfaces.coords, attrs=flat_attrs)
    for name, (values, title) in values_and_titles.items():
        attrs = {"units": "um", "long_name": title}
        values = np.where(is_valid, values, np.nan)
        flat[name] = ("y", "x"), values, attrs
    return flat
