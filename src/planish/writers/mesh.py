"""A surface as a mesh in space: nodes in um of the volume, quadrilaterals between them, maps and a colour on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import StudyError
from planish.core.frame import Frame
from planish.writers.content import Display, column_of
from planish.writers.params import ExportParams

SURFACES = ("top", "bottom", "interface_top", "interface_bottom", "centre")
"""What can be a surface, of the group ``surfaces``."""

_COLOURLESS = np.array([212, 214, 216], np.uint8)


@dataclass(frozen=True, slots=True, kw_only=True)
class Surface:
    """A surface of the sheet and what it carries.

    Attributes
    ----------
    data : Dataset, dims (y, x)
        Heights and maps on the columns of the volume, in um; the frame in its attributes.
    name : str
        One of `SURFACES`.
    maps : tuple of str
        Maps that its nodes carry; the first one is their colour where the format has a colour only.
    display : dict of Display
        Colours of maps, by name.
    """

    data: xr.Dataset
    name: str
    maps: tuple[str, ...]
    display: Mapping[str, Display]

    @property
    def nodes(self) -> int:
        """Number of columns."""
        return self.data.sizes["y"] * self.data.sizes["x"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mesh:
    """A mesh.

    Attributes
    ----------
    points : (n, 3) float32
        x, y, z in um.
    quads : (m, 4) int32
        Nodes of each cell; seen from outside of the sheet they run anticlockwise.
    values : dict of (n,) float32
        Maps, by name and unit (``coating_top_um``); NaN is missing.
    colours : (n, 3) uint8 or None
        Red, green, blue of the first map.
    about : str
        What places and colours are, in one line.
    """

    points: NDArray[np.float32]
    quads: NDArray[np.int32]
    values: dict[str, NDArray[np.float32]]
    colours: NDArray[np.uint8] | None
    about: str


def mesh_of(surface: Surface, params: ExportParams) -> Mesh:
    """Make the mesh of a surface; a cell is there where all four of its corners are.

    Raises
    ------
    StudyError
        ``mesh_um`` is less than the pitch of the columns, or so large that no cell is left.
    """
    frame = Frame.of(surface.data)
    rows, cols = (surface.data[axis].values for axis in ("y", "x"))
    steps = _steps(rows, cols, params.mesh_um)
    data = surface.data.isel(y=slice(None, None, steps[0]), x=slice(None, None, steps[1]))
    heights = data[surface.name].values
    known = np.isfinite(heights)
    number = np.cumsum(known.ravel()).reshape(known.shape) - 1
    whole = known[:-1, :-1] & known[:-1, 1:] & known[1:, 1:] & known[1:, :-1]
    if not whole.any():
        raise StudyError(
            f"The surface {surface.name} has no cell at these nodes: {int(known.sum())} nodes are known. Give a "
            "smaller --mesh-um, or another surface."
        )
    corners = (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1])
    quads = np.stack([corner[whole] for corner in corners], axis=1).astype(np.int32)
    at = {frame.rows: data["y"].values[:, None], frame.cols: data["x"].values[None, :], frame.through: heights}
    points = np.stack([np.broadcast_to(at[axis], known.shape)[known] for axis in ("x", "y", "z")], axis=1)
    if params.as_seen:
        points[:, 1] *= -1
    if _turned(frame, up=not surface.name.endswith("bottom"), mirrored=params.as_seen):
        quads = quads[:, ::-1]
    values = {column_of(n, _units(data[n])): data[n].values[known].astype(np.float32) for n in surface.maps}
    first = surface.maps[0] if surface.maps else None
    shown = surface.display.get(first) if first else None
    colours = None if first is None or shown is None else _colours(data[first].values[known], shown)
    return Mesh(
        points=np.ascontiguousarray(points, np.float32), quads=np.ascontiguousarray(quads), values=values,
        colours=colours, about=_about(surface, params, first, shown),
    )  # fmt: skip


def _steps(rows: NDArray[np.float64], cols: NDArray[np.float64], mesh_um: float | None) -> tuple[int, int]:
    """Every which row and column is a node."""
    if mesh_um is None:
        return 1, 1
    pitch = float(rows[1] - rows[0]), float(cols[1] - cols[0])
    if mesh_um < 0.999 * max(pitch):
        raise StudyError(f"--mesh-um {mesh_um:g} is less than a column of {max(pitch):g} um. Give a multiple of it.")
    return max(1, round(mesh_um / pitch[0])), max(1, round(mesh_um / pitch[1]))


def _turned(frame: Frame, *, up: bool, mirrored: bool) -> bool:
    """Whether cells of (row, col), (row, col + 1) ... run clockwise as seen from outside of the sheet."""
    unit = {axis: np.eye(3)[k] for k, axis in enumerate(("x", "y", "z"))}
    outside = unit[frame.through] * frame.sign * (1 if up else -1)
    anticlockwise = float(np.cross(unit[frame.cols], unit[frame.rows]) @ outside) > 0
    return anticlockwise == mirrored


def _colours(values: NDArray[np.floating], shown: Display) -> NDArray[np.uint8]:
    from planish.writers.picture import colours_of

    share = (values.astype(np.float64) - shown.low) / (shown.high - shown.low)
    found = colours_of(shown)(np.clip(share, 0, 1), bytes=True)[:, :3]
    return np.where(np.isfinite(share)[:, None], found, _COLOURLESS).astype(np.uint8)


def _about(surface: Surface, params: ExportParams, first: str | None, shown: Display | None) -> str:
    place = "y of the volume with its sign turned" if params.as_seen else "x, y, z of the volume"
    text = f"surface {surface.name}; um; {place}"
    if first is not None and shown is not None:
        units = _units(surface.data[first])
        text += f"; colour: {first} from {shown.low:.6g} to {shown.high:.6g} {'' if units == '1' else units}".rstrip()
    return text


def _units(data: xr.DataArray) -> str:
    return str(data.attrs.get("units", "1"))
