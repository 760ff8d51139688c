"""Regular grids: their pitch, their pixels, and values between the pixels."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import SizeError, SurfaceError
from planish.core.typing import Array, Bools, Entries, Floats, Ints, Pair, Shape2D


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Grid:
    """Pixels of a map or an image: what layers are brought to."""

    y_um: Floats  # (rows,), where the middles of the pixels lie
    x_um: Floats  # (cols,)
    # Pitch of rows and columns; from the first two coordinates where None.
    step_um: Pair | None = None

    @classmethod
    def regular(cls, shape: Shape2D, pixel_um: float | Pair, origin_um: Pair = (0.0, 0.0)) -> Grid:
        """Return a grid of ``shape`` whose first pixel has its middle at ``origin_um``, (x, y)."""
        row_um, col_um = (pixel_um, pixel_um) if isinstance(pixel_um, int | float) else pixel_um
        down, across = (np.arange(n, dtype=np.float64) for n in shape)
        y = origin_um[1] + row_um * down
        x = origin_um[0] + col_um * across
        return cls(y_um=y, x_um=x, step_um=(float(row_um), float(col_um)))

    @classmethod
    def of(cls, data: xr.Dataset | xr.DataArray) -> Grid:
        """Return the grid of maps (y, x), or (v, u), or of an image that knows its size alone."""
        rows, cols = ("y", "x") if "y" in data.dims else ("v", "u")
        if rows not in data.coords and "pixel_um" in data.attrs:
            dy_um, dx_um = (float(size) for size in data.attrs["pixel_um"])
            return cls.regular((data.sizes[rows], data.sizes[cols]), (dy_um, dx_um))
        return cls(y_um=data[rows].values, x_um=data[cols].values)

    def part(self, rows: slice, cols: slice = slice(None)) -> Grid:
        """Some of its pixels, with its pitch."""
        return Grid(y_um=self.y_um[rows], x_um=self.x_um[cols], step_um=self.pixel_um)

    @property
    def shape(self) -> Shape2D:
        """Rows and columns."""
        return self.y_um.size, self.x_um.size

    @property
    def pixel_um(self) -> Pair:
        """Pitch of rows and columns; SizeError for a single row or column, which has none."""
        if self.step_um is not None:
            return self.step_um
        if min(self.shape) < 2:
            raise SizeError(
                f"The reference has {self.shape[0]} x {self.shape[1]} pixels; 2 x 2 are needed to"
                " lay a layer onto it."
            )
        return float(self.y_um[1] - self.y_um[0]), float(self.x_um[1] - self.x_um[0])

    @property
    def origin_um(self) -> Pair:
        """``(x, y)`` of the middle of the first pixel."""
        return float(self.x_um[0]), float(self.y_um[0])

    @property
    def coords(self) -> Entries:
        """Coordinates of a dataset on it."""
        return {"y": ("y", self.y_um, {"units": "um"}), "x": ("x", self.x_um, {"units": "um"})}


def pitch(data: xr.Dataset | xr.DataArray) -> Pair:
    """Distance of the rows and of the columns of maps (y, x), or (v, u), in um."""
    return Grid.of(data).pixel_um


def step_of(coordinates: Array) -> float:
    """Distance of the first two of regular coordinates, with its sign; 1 of a single one."""
    if coordinates.size > 1:
        return float(coordinates[1] - coordinates[0])
    return 1.0


def shorter_side_um(shape: Sequence[int], pixel_um: Sequence[float]) -> float:
    """Length of the shorter side of so many pixels."""
    return min(n * step for n, step in zip(shape, pixel_um, strict=True))


def check_same_grid(first: xr.Dataset, second: xr.Dataset) -> None:
    """Raise SurfaceError unless both datasets stand on the same columns of the same volume."""
    for axis in ("y", "x"):
        a = first[axis].values
        b = second[axis].values
        if a.shape != b.shape or not np.allclose(a, b, rtol=0, atol=1e-6):
            raise SurfaceError(
                f"The two stores stand on different columns: {a.size} and {b.size} along {axis}."
                " Make both from the same surfaces."
            )


def filled(field: Floats) -> Floats:
    """Return a field with the nearest known value in place of every NaN.

    One of NaN only as it is.
    """
    from scipy import ndimage

    values = field.copy()
    is_missing = ~np.isfinite(field)
    if is_missing.any() and not is_missing.all():
        nearest = ndimage.distance_transform_edt(
            is_missing, return_distances=False, return_indices=True
        )
        values[is_missing] = field[tuple(index[is_missing] for index in nearest)]
    return values


def corners_of(nodes: Array) -> tuple[Array, ...]:
    """Values of a field (rows, cols, ...) at the four corners of every cell, around the cell."""
    upper = nodes[:-1]
    lower = nodes[1:]
    return upper[:, :-1], upper[:, 1:], lower[:, 1:], lower[:, :-1]


def first_and_last(mask: Bools) -> tuple[Ints, Ints]:
    """First and last index along the last axis at which a mask is set somewhere.

    The whole length where it is not.
    """
    after_last = np.argmax(mask[..., ::-1], axis=-1)
    return np.argmax(mask, axis=-1), mask.shape[-1] - 1 - after_last


def at_index(field: Array, index: NDArray[np.integer]) -> Array:
    """Values of a field (..., n) at one index (...) along its last axis."""
    return np.take_along_axis(field, index[..., None], axis=-1)[..., 0]


def bilinear(field: Array, row: Floats, col: Floats) -> Floats:
    """Values of a field (rows, cols) at fractional rows and columns.

    NaN outside the middles of its outer pixels.
    """
    rows, cols = field.shape
    is_inside = (row >= 0) & (row <= rows - 1) & (col >= 0) & (col <= cols - 1)
    # The pixel above and to the left; outside, any will do.
    i = np.clip(np.where(is_inside, row, 0).astype(np.intp), 0, rows - 2)
    j = np.clip(np.where(is_inside, col, 0).astype(np.intp), 0, cols - 2)
    down = row - i
    right = col - j
    upper = field[i, j] * (1 - right) + field[i, j + 1] * right
    lower = field[i + 1, j] * (1 - right) + field[i + 1, j + 1] * right
    return np.where(is_inside, upper * (1 - down) + lower * down, np.nan)


def values_at(maps: xr.Dataset, names: Sequence[str], points: Floats) -> Floats:
    """Values (n, names) of maps (y, x) or (v, u) at points (n, 2), (x, y) or (u, v) in um.

    NaN outside.
    """
    grid = Grid.of(maps)
    x, y = grid.origin_um
    down, across = grid.pixel_um
    row = (points[:, 1] - y) / down
    col = (points[:, 0] - x) / across
    return np.stack([bilinear(maps[name].values, row, col) for name in names], axis=1)


def centres_of(holes: xr.Dataset) -> Floats:
    """``x, y`` (n, 2) of holes or marks."""
    return np.stack([holes["x"].values, holes["y"].values], axis=1).astype(np.float64)


def hole_mask(grid: Grid, centres_um: Floats, radii_um: Floats) -> Bools:
    """Mark the pixels of a grid that lie in a hole.

    Parameters
    ----------
    grid : Grid
    centres_um : ndarray, shape (n, 2)
        ``x, y`` of the holes.
    radii_um : ndarray, shape (n,)
        Their radii; with the burnt rim where that has to be masked, too.

    Returns
    -------
    ndarray of bool, shape of the grid
        True within a radius of a centre.
    """
    inside = np.zeros(grid.shape, bool)
    for (x, y), radius in zip(centres_um, radii_um, strict=True):
        rows = _within(grid.y_um, y, radius)
        cols = _within(grid.x_um, x, radius)
        distance_um = np.hypot(grid.x_um[None, cols] - x, grid.y_um[rows, None] - y)
        inside[rows, cols] |= distance_um <= radius
    return inside


def _within(places_um: Floats, middle_um: float, radius_um: float) -> slice:
    """Which of ascending places lie within a distance of a middle."""
    first = np.searchsorted(places_um, middle_um - radius_um)
    return slice(first, np.searchsorted(places_um, middle_um + radius_um, "right"))


def blur_reach_um(attrs: Mapping[Any, Any]) -> float:
    """Standard deviation of the scan's blur from what surfaces carry; a voxel where not known."""
    blur_um = float(attrs["blur_um"])
    if math.isnan(blur_um):
        return max(float(um) for um in attrs["voxel_um"])
    return blur_um
