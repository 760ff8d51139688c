"""What flattening did to the sheet, and the lines of its mesh in the plane.

What it did is given on the pixels of the sheet's flat map.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from planish.app.picture import layer_run
from planish.core.bands import read_bands
from planish.core.frame import Frame
from planish.core.labelled import computed
from planish.core.lazy import Where
from planish.core.typing import Array, Ints, Pair
from planish.io.map_groups import read_group
from planish.io.map_store import stored_group
from planish.run.run import MAPS
from planish.run.study import Study


class StrainDisplay(NamedTuple):
    """How a variable of the group ``strain`` is shown: ``factor * (value - unstrained)``."""

    title: str
    units: str
    unstrained: float
    factor: float


STRAINS = {
    "area_ratio": StrainDisplay("Change of area", "%", 1.0, 100.0),
    "stretch_max": StrainDisplay("Largest strain", "%", 1.0, 100.0),
    "stretch_min": StrainDisplay("Smallest strain", "%", 1.0, 100.0),
    "shear": StrainDisplay("Shear", "mrad", 0.0, 1000.0),
    "needed_strain": StrainDisplay("Strain that the curvature needs", "%", 0.0, 100.0),
}
"""What is shown of the group ``strain``: all are 0 where the sheet was laid flat without any
strain."""

SPACE = ("projected_u", "projected_v", "warp")
"""Maps of where the sheet was in space, seen from its top."""

MOST_POINTS = 40_000
"""Points of the lines of a mesh that a page is given."""


def sheet_run(run: Path, study: Study, layer: str) -> Path | None:
    """Folder of the run that a layer was flattened in: this one, or one within it.

    None where it is no sheet.
    """
    sheets = [params.name for params in study.layers if params.kind != "image"]
    folder = layer_run(run, layer)
    if layer in sheets and (folder / MAPS / "strain").is_dir():
        return folder
    return None


def _on_pixels(
    cells: xr.DataArray, coordinates: tuple[xr.DataArray, xr.DataArray], where: Where
) -> Array:
    """Values of the mesh's cells in which the pixels of a part of a flat map lie.

    ``coordinates`` are the places of the map's pixels in the volume, along the mesh's rows and
    columns, in um; ``where`` is the part. NaN for pixels outside of the mesh.
    """
    indices: list[Ints] = []
    is_on_mesh = True
    for axis, coordinate in zip(("y", "x"), coordinates, strict=True):
        centres_um = np.asarray(cells[axis].values, np.float64)
        pixels_um = np.asarray(coordinate[where].values, np.float64)
        position = (pixels_um - centres_um[0]) / _mean_step(centres_um)
        is_inside = (position > -0.5) & (position < centres_um.size - 0.5)  # False where it is NaN
        nearest = np.where(is_inside, np.rint(position), 0)
        indices.append(nearest.astype(np.intp))
        is_on_mesh = is_on_mesh & is_inside
    return np.where(is_on_mesh, cells.values[tuple(indices)], np.float32(np.nan))


def strains(
    run: Path, coordinates: Mapping[str, Sequence[xr.DataArray]]
) -> Iterator[tuple[str, StrainDisplay, list[xr.DataArray]]]:
    """Each known strain of a flat map: name, how it is shown, values at every level.

    ``coordinates``: maps of the pixels' place in the volume in um, as ``volume_x``, each at every
    level.
    """
    strain = read_group(run / MAPS, "strain")
    frame = Frame.of(stored_group(run / MAPS, "surfaces"))
    rows, cols = (coordinates[f"volume_{axis}"] for axis in (frame.rows, frame.cols))
    for name, display in STRAINS.items():
        if name not in strain or min(strain[name].shape) < 2:
            continue
        shown = display.factor * (strain[name] - display.unstrained)
        cells = shown.astype(np.float32)
        if not np.isfinite(cells.values).any():
            continue
        levels: list[xr.DataArray] = []
        for places in zip(rows, cols, strict=True):
            read = partial(_on_pixels, cells, places)
            levels.append(computed(places[0], read, np.float32))
        yield name, display, levels


def _mean_step(coordinates: Array) -> float:
    """Distance of regular coordinates; 0 of a single one."""
    return (coordinates[-1] - coordinates[0]) / max(coordinates.size - 1, 1)


def mesh_lines(run: Path) -> tuple[list[list[Pair]], int]:
    """Every n-th row and column of the mesh in the plane as lines; and n.

    The lines are (u, v) in um and end where the sheet does.
    """
    flat = stored_group(run / MAPS, "flat")
    strain = read_group(run / MAPS, "strain")
    n_rows = strain.sizes["row"]
    n_cols = strain.sizes["col"]
    line_step = 1
    while 2 * (n_rows // line_step + 1) * (n_cols // line_step + 1) > MOST_POINTS:
        line_step += 1
    # Columns of the sheet that are nodes of the mesh, or nearest to them; a cell's place is its
    # middle.
    nodes: list[Ints] = []
    for axis in ("y", "x"):
        columns_um = np.asarray(flat[axis].values)
        cells_um = np.asarray(strain[axis].values)
        cell_pitch_um = _mean_step(cells_um)
        first_um = cells_um[0] - 0.5 * cell_pitch_um
        nodes_um = first_um + cell_pitch_um * np.arange(0, cells_um.size + 1, line_step)
        indices = np.rint((nodes_um - columns_um[0]) / _mean_step(columns_um))
        indices = np.clip(indices, 0, columns_um.size - 1)
        nodes.append(indices.astype(np.intp))
    node_rows, node_cols = nodes
    uv = np.empty((node_rows.size, node_cols.size, 2))
    for band, uv_band in read_bands(flat["u"], flat["v"]):
        is_in_band = (node_rows >= band.start) & (node_rows < band.stop)
        in_band = np.ix_(node_rows[is_in_band] - band.start, node_cols)
        uv[is_in_band] = np.stack(uv_band, axis=-1)[in_band]
    # Along rows and columns, from where the sheet begins to where it ends.
    lines: list[list[Pair]] = []
    for line in (*uv, *uv.transpose(1, 0, 2)):
        is_sheet = np.isfinite(line).all(axis=1)
        run_ends = np.flatnonzero(np.diff(is_sheet, prepend=False, append=False))
        for first, last in run_ends.reshape(-1, 2).tolist():
            if last - first > 1:
                segment = line[first:last].tolist()
                lines.append([(round(x, 1), round(y, 1)) for x, y in segment])
    return lines, line_step
