"""Two half measurements of a map: of the odd and of the even rows of its columns, and how far they agree.

Columns are measured one by one, so both halves are there without measuring anything twice. Thicknesses and
topographies are taken from the faces of each column itself: along normals, which cross from column to column,
neighbouring rows would share their noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.analyze import split_reliability
from planish.core.area import area_mean
from planish.core.bands import bands
from planish.core.errors import PlanishError
from planish.core.frame import Frame
from planish.core.grid import pitch
from planish.core.transform import Similarity
from planish.results import MapReliability

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_ENDS = {
    "thickness": ("top", "bottom"), "base_thickness": ("interface_top", "interface_bottom"),
    "coating_top": ("top", "interface_top"), "coating_bottom": ("interface_bottom", "bottom"),
    "topography_top": ("top", "centre"), "topography_bottom": ("centre", "bottom"),
}  # fmt: skip
"""Of each map that is a distance of two surfaces, the upper and the lower."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Columns:
    """The columns of a sheet and where they lie on a reference.

    ``measured`` and ``flat`` (y, x) are those of the sheet. ``similarity`` leads from the flat sheet to the reference:
    what the registration adds to it moves both halves alike. ``interpolated`` says whether rows were made of others.
    """

    measured: xr.Dataset
    flat: xr.Dataset
    similarity: Similarity
    interpolated: bool = False

    def part(self, rows: slice) -> Columns:
        """Some rows of columns."""
        return replace(self, measured=self.measured.isel(y=rows), flat=self.flat.isel(y=rows))

    def values(self, name: str) -> tuple[Array, bool]:
        """A map by columns, and whether each is of its column alone; NaN where it was not measured."""
        data = self.measured
        known = np.isfinite(data[name].values)
        if name not in _ENDS:
            return np.where(known, data[name].values, np.nan), False
        faces = [self._surface(end) for end in _ENDS[name]]
        slopes = np.gradient(data["centre"].values, *pitch(data))
        cosine = 1 / np.sqrt(1 + slopes[0] ** 2 + slopes[1] ** 2)
        return np.where(known, Frame.of(data).sign * (faces[0] - faces[1]) * cosine, np.nan), True

    def _surface(self, name: str) -> Array:
        """A surface; the face stands for the interface of a side without a coating."""
        values = self.measured[name].values
        if name.startswith("interface_") and not np.isfinite(values).any():
            return self.measured[name.removeprefix("interface_")].values
        return values

    def shared(self, *, alone: bool) -> str:
        """What both halves share, in words."""
        attrs, found = self.measured.attrs, ["grey levels, blur and rings of one scan"]
        if "from_labels" in attrs:
            found = ["whatever the program smoothed that made the labels"]
        if (blend := float(attrs.get("averaged_columns", 0.0))) > 0:
            found.append(f"noise, as columns were averaged with their neighbours (Gaussian of {blend:.2g} columns)")
        elif not alone:
            found.append("noise, as this map is read between columns")
        if self.interpolated:
            found.append("sections from which others were interpolated")
        return "; ".join(found)


def half_points(
    columns: Columns, name: str, known: Mask, *, origin_um: tuple[float, float], cell_um: tuple[float, float],
    point_um: float,
) -> tuple[Array, Array, bool]:  # fmt: skip
    """Means of a map over the points of a reference, of the odd and of the even rows of its columns.

    Parameters
    ----------
    columns : Columns
    name : str
        A map of the sheet.
    known : ndarray of bool, shape (rows, cols)
        Cells of the reference that count.
    origin_um : (float, float)
        x and y of the outer corner of the first cell.
    cell_um : (float, float)
        Along y and x.
    point_um : float
        Edge of a point, at least that of a cell.

    Returns
    -------
    odd, even : ndarray
        Shape of the points, which begin at the origin; NaN where less than half of a point counts, or the halves have
        no column in it.
    alone : bool
        Whether no column's value holds anything of its neighbours.
    """
    enough = np.isfinite(area_mean(np.where(known, 1.0, np.nan), (point_um / cell_um[0], point_um / cell_um[1])))
    end = (
        min(known.shape[0] * cell_um[0], enough.shape[0] * point_um),
        min(known.shape[1] * cell_um[1], enough.shape[1] * point_um),
    )
    turn, (right, down) = columns.similarity.matrix(), columns.similarity.shift_um
    count, totals, alone = np.zeros(enough.size), np.zeros((2, enough.size)), True
    for rows in bands(columns.measured.sizes["y"]):
        # Two rows more on either side, for the slopes beside and the means between rows; an even number of them.
        before = min(rows.start, 2)
        part = columns.part(slice(rows.start - before, rows.stop + 2))
        values, alone = part.values(name)
        halves = [_half(values, first)[before : before + rows.stop - rows.start].ravel() for first in (1, 0)]
        u, v = (part.flat[axis].values[before : before + rows.stop - rows.start].ravel() for axis in "uv")
        at = np.flatnonzero(np.isfinite(halves[0] + halves[1]))
        x = turn[0, 0] * u[at] + turn[0, 1] * v[at] + (right - origin_um[0])
        y = turn[1, 0] * u[at] + turn[1, 1] * v[at] + (down - origin_um[1])
        inside = (y >= 0) & (x >= 0) & (y < end[0]) & (x < end[1])
        x, y, at = x[inside], y[inside], at[inside]
        use = known[(y / cell_um[0]).astype(np.intp), (x / cell_um[1]).astype(np.intp)]
        x, y, at = x[use], y[use], at[use]
        number = (y / point_um).astype(np.intp) * enough.shape[1] + (x / point_um).astype(np.intp)
        count += np.bincount(number, minlength=enough.size)
        totals += [np.bincount(number, weights=half[at], minlength=enough.size) for half in halves]
    both = enough & (count > 0).reshape(enough.shape)
    odd, even = (np.where(both, (total / np.maximum(count, 1)).reshape(both.shape), np.nan) for total in totals)
    return odd, even, alone


def _half(values: Array, first: int) -> Array:
    """Every second row from ``first`` on; rows between hold the mean of their neighbours, NaN where one is missing.

    So both halves are known at the same places: the mean place of every second row in a point differs by up to a row
    from that of the others, and texture would look like noise.
    """
    half = np.full(values.shape, np.nan)
    half[first::2] = values[first::2]
    own = half[first::2]
    half[first + 1 : -1 : 2] = 0.5 * (own[:-1] + own[1:])
    return half


def reliability_of(
    columns: Columns, layer: str, name: str, known: Mask, *, origin_um: tuple[float, float],
    cell_um: tuple[float, float], point_um: float,
) -> MapReliability:  # fmt: skip
    """How much of a map two halves of its measurement show alike, or why that cannot be said."""
    try:
        odd, even, alone = half_points(columns, name, known, origin_um=origin_um, cell_um=cell_um, point_um=point_um)
        reliability = split_reliability(odd, even, pixel_um=point_um)
    except PlanishError as error:
        return MapReliability(layer=layer, map=name, point_um=point_um, silence=error.text)
    return MapReliability.holding(reliability, layer=layer, map=name, shared=columns.shared(alone=alone))


def noise_ceiling(halves: Sequence[MapReliability], position: float | None) -> dict[str, float]:
    """The r that a perfect relation would show by the noise of these maps, and with what misplacement leaves."""
    noise = math.sqrt(math.prod(half.value for half in halves)) if halves else math.nan
    if math.isnan(noise):
        return {}
    return {"ceiling_noise": noise} | ({} if position is None else {"ceiling_both": noise * position})
