"""What the ledger has to know of a specimen and its files, and how a place in a file becomes a place in the paper."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.frame import Frame
from planish.core.grid import pitch
from planish.synthetic import InstrumentFiles, Sheet, Specimen

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FACE_ORDER = ("top", "interface_top", "interface_bottom", "bottom")
_BETWEEN = {"coating_top": (0, 1), "coating_bottom": (2, 3), "base_thickness": (1, 2), "thickness": (0, 3)}
_MOST_COLUMNS = 400_000  # more columns do not make a percentile any surer
_FINEST_UM = 4.0  # of a pixel that counts as a point: the sheet holds little below


@dataclass(frozen=True, slots=True, kw_only=True)
class Lattice:
    """A regular choice of the volume's columns with the material that their centre points show.

    Attributes
    ----------
    rows, cols : (m,), (n,) int
        Indices of the columns.
    pitch_um : (float, float)
        Distance of neighbours in the lattice along rows and columns.
    material : (m, n, 3)
        True (u, v, s) in um of the point of the centre surface that the run found; NaN where it found none.
    measured : (m, n)
        Whether the run measured the column.
    """

    rows: NDArray[np.intp]
    cols: NDArray[np.intp]
    pitch_um: tuple[float, float]
    material: Array
    measured: Mask

    def take(self, values: NDArray[Any]) -> Array:
        """Values (y, x) of the run at the lattice, as float64."""
        return np.asarray(values[np.ix_(self.rows, self.cols)], dtype=np.float64)


def make_lattice(specimen: Specimen, files: InstrumentFiles, groups: dict[str, xr.Dataset]) -> Lattice:
    """Choose at most some 400 000 columns of a run and find the material that each of them shows."""
    surfaces = groups["surfaces"]
    step = max(1, int(np.ceil(np.sqrt(surfaces["status"].size / _MOST_COLUMNS))))
    rows, cols = (np.arange(0, surfaces.sizes[d], step) for d in ("y", "x"))
    points = file_points(surfaces, surfaces["centre"].values[np.ix_(rows, cols)], rows, cols)
    down, across = pitch(surfaces)
    return Lattice(
        rows=rows,
        cols=cols,
        pitch_um=(step * down, step * across),
        material=material_at(specimen, files, points, groups.get("sections")),
        measured=surfaces["status"].values[np.ix_(rows, cols)] == 0,
    )


def file_points(surfaces: xr.Dataset, heights: Array, rows: NDArray[np.intp], cols: NDArray[np.intp]) -> Array:
    """Places (m, n, 3) as x, y, z of the file, in um, of heights (m, n) over the columns ``rows`` and ``cols``."""
    frame = Frame.of(surfaces)
    along = {
        frame.rows: surfaces["y"].values[rows][:, None],
        frame.cols: surfaces["x"].values[cols][None, :],
        frame.through: np.asarray(heights, dtype=np.float64),
    }
    return np.stack([np.broadcast_to(along[axis], heights.shape) for axis in ("x", "y", "z")], axis=-1)


def physical_at(files: InstrumentFiles, points: Array, sections: xr.Dataset | None) -> Array:
    """Physical places (..., 3) of places in the file; NaN stays NaN."""
    flat = points.reshape(-1, 3)
    known = np.isfinite(flat).all(axis=-1)
    found = np.full(flat.shape, np.nan)
    if known.any():
        found[known] = files.to_physical(flat[known], sections)
    return found.reshape(points.shape)


def material_at(specimen: Specimen, files: InstrumentFiles, points: Array, sections: xr.Dataset | None) -> Array:
    """Material (u, v, s) of places (..., 3) in the file, in um; NaN stays NaN."""
    flat = physical_at(files, points, sections).reshape(-1, 3)
    known = np.isfinite(flat).all(axis=-1)
    found = np.full(flat.shape, np.nan)
    if known.any():
        found[known] = specimen.warp.material(np.ascontiguousarray(flat[known]))
    return found.reshape(points.shape)


def true_face(sheet: Sheet, face: str, u: Array, v: Array) -> Array:
    """Signed distance of a face from the true centre surface, in um; NaN where (u, v) is."""
    return field_at(sheet, sheet.faces[FACE_ORDER.index(face)], u, v)


def true_thickness(sheet: Sheet, name: str, u: Array, v: Array) -> Array:
    """True thickness in um at material (u, v); ``name`` as the run calls it. NaN where (u, v) is."""
    outer, inner = _BETWEEN[name]
    return field_at(sheet, sheet.faces[outer] - sheet.faces[inner], u, v)


def pixel_offsets(specimen: Specimen) -> Array:
    """Offsets (k, 2) in (u, v) from the middle of an image pixel to the points that its mean is taken over.

    A pixel is an area: at 12 um it shows the mean of what fibres of 20 to 35 um do. One of 4 um is taken as a point.
    """
    truth = specimen.truth
    step = pitch(truth)
    parts = [max(1, round(s / _FINEST_UM)) for s in step]
    y, x = (s * ((np.arange(n) + 0.5) / n - 0.5) for s, n in zip(step, parts, strict=True))
    around = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    middle = np.array([float(truth[d].values.mean()) for d in ("x", "y")])
    return np.asarray(specimen.pose.inverse(middle + around) - specimen.pose.inverse(middle[None]), dtype=np.float64)


def pixel_thickness(sheet: Sheet, name: str, u: Array, v: Array, offsets: Array) -> Array:
    """True thickness in um as the mean over a pixel's area around the material (u, v)."""
    total = np.zeros(u.shape)
    for du, dv in offsets:
        total += true_thickness(sheet, name, u + du, v + dv)
    return total / len(offsets)


def field_at(sheet: Sheet, field: NDArray[np.float32], u: Array, v: Array) -> Array:
    """Value of a field of the sheet at material (u, v); NaN where that is."""
    known = np.isfinite(u) & np.isfinite(v)
    found = np.full(u.shape, np.nan)
    found[known] = sheet.at(field, u[known], v[known])
    return found
