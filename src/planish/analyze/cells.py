"""Means of several maps over cells of one size or of several, in one pass over the pixels.

A map of truth values or of labels is a factor: of each level but the first the share of the cell is
taken that has it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.area import AreaMeans, square_px, valid_in_all
from planish.core.axial import refuse_axial
from planish.core.bands import Rows, read_bands
from planish.core.errors import InputError
from planish.core.typing import Floats, Pair

MOST_LEVELS = 8
"""Levels of a factor beyond which a map of whole numbers is taken for a quantity in error."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CellColumn:
    """What one number of a cell is made of: a map, or the pixels of a map that have a label."""

    name: str
    values: xr.DataArray
    label: int | None = None  # of a factor

    @property
    def is_factor(self) -> bool:
        """Whether it is the share of a cell that has a label."""
        return self.label is not None

    @property
    def title(self) -> str:
        """The map in words."""
        if self.is_factor:
            return self.name
        return str(self.values.attrs.get("long_name", self.name.replace("_", " ")))

    @property
    def units(self) -> str:
        """Unit of the numbers."""
        return "1" if self.is_factor else str(self.values.attrs.get("units", "1"))

    def of(self, values: NDArray[Any]) -> NDArray[Any]:
        """Numbers of some pixels of the map."""
        if self.label is None:
            return values
        return (values == self.label).astype(np.float64)


def columns_of(name: str, values: xr.DataArray) -> list[CellColumn]:
    """Make the columns of a map: one of a quantity, one for each level but the first of a factor.

    A map of real numbers is a quantity, one of truth values a factor of which the true ones are a
    column, and one of whole numbers a factor.
    InputError for angles of an axis, for labels without a second level, or with too many of them.
    """
    refuse_axial(values)
    if values.dtype.kind == "f":
        return [CellColumn(name=name, values=values)]
    if values.dtype.kind == "b":
        return [CellColumn(name=name, values=values, label=1)]
    levels = np.unique(np.asarray(values))
    if not 2 <= levels.size <= MOST_LEVELS:
        raise InputError(
            f"{name} has {levels.size} different whole numbers. A factor has 2 to {MOST_LEVELS}"
            ' levels; write astype("float32") for a quantity.'
        )
    columns: list[CellColumn] = []
    for level in levels[1:]:
        column = CellColumn(name=f"{name}={level}", values=values, label=int(level))
        columns.append(column)
    return columns


def means_over_cells(
    columns: Sequence[CellColumn],
    masks: Sequence[Rows],
    *,
    pixel_um: Pair,
    sizes_um: Sequence[float],
) -> list[list[Floats]]:
    """Give the mean of each column over the cells of each size; NaN where half is not known.

    Pixels count that have a value in all maps and where all masks are true. The lists are by size,
    as ``sizes_um`` are, then by column; means are (rows, cols) of cells.
    """
    maps = [column.values for column in columns]
    n_maps = len(maps)
    rows_of_map, cols_of_map = maps[0].shape
    shape = (rows_of_map, cols_of_map)
    means_by_size = [AreaMeans(shape, square_px(size_um, pixel_um)) for size_um in sizes_um]
    for rows, bands in read_bands(*maps, *masks):
        map_bands = bands[:n_maps]
        is_valid = valid_in_all(map_bands, bands[n_maps:])
        numbers = [column.of(band) for column, band in zip(columns, map_bands, strict=True)]
        for means in means_by_size:
            means.add(rows.start, is_valid, *numbers)
    return [means.means() for means in means_by_size]
