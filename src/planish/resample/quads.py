"""Values on a flattened quad mesh to a regular grid, through the quads that are known to be neighbours.

Hirn et al. (2009), section 2.3.4, triangulate the moved points anew (Delaunay). Here the connectivity of the mesh is
used: no triangle can bridge a gap, and overlaps are noticed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.area import area_mean
from planish.core.errors import SurfaceError
from planish.resample._kernels import locate, sample

Array = NDArray[np.float64]

_MOST_PIXELS = 2**31


@dataclass(frozen=True, slots=True, kw_only=True)
class Places:
    """Where each pixel of a regular grid lies in the mesh.

    Attributes
    ----------
    place : (2, rows * fine, cols * fine)
        Fractional row and column in the mesh, NaN outside.
    fine : int
        Sub-pixels per pixel and axis; values are means over them.
    overlaps : int
        Sub-pixels covered twice: 0 unless the mesh is folded.
    """

    place: Array
    fine: int
    overlaps: int


def find_places(uv: Array, *, shape: tuple[int, int], pixel_um: tuple[float, float], origin_um: tuple[float,
float] = (0.0, 0.0), least_um: float | None = None) -> Places:  # fmt: skip
    """Locate the pixels of a regular grid in a mesh with flat coordinates ``uv``.

    Parameters
    ----------
    uv : (rows, cols, 2)
        Flat coordinates of the nodes in um; NaN where there is no sheet.
    shape : (int, int)
        Rows and columns of the grid.
    pixel_um : (float, float)
        Pitch of its rows and columns.
    origin_um : (float, float)
        (u, v) of the centre of its first pixel.
    least_um : float, optional
        Pitch of the mesh. A pixel wider than that is cut into sub-pixels, so that it takes the mean over its area
        and not the value at its centre.

    Returns
    -------
    Places
    """
    if min(shape) < 1 or shape[0] * shape[1] > _MOST_PIXELS:
        raise SurfaceError(f"A grid of {shape[0]} x {shape[1]} pixels cannot be made. Check the pixel size.")
    fine = max(1, int(np.ceil(max(pixel_um) / least_um - 1e-6))) if least_um else 1
    fine = min(fine, 32)
    step = pixel_um[0] / fine, pixel_um[1] / fine
    # The first sub-pixel's centre lies half a pixel less half a sub-pixel before the pixel's.
    first = [origin_um[1 - k] - 0.5 * (pixel_um[k] - step[k]) for k in range(2)]
    px = np.ascontiguousarray((uv[..., 0] - first[1]) / step[1])
    py = np.ascontiguousarray((uv[..., 1] - first[0]) / step[0])
    place, overlaps = locate(px, py, shape[0] * fine, shape[1] * fine)
    return Places(place=place, fine=fine, overlaps=overlaps)


def resample(field: Array, places: Places) -> Array:
    """Values of a mesh field (rows, cols) on the grid; a pixel is NaN unless half of its area is known."""
    flat = places.place.reshape(2, -1)
    out = np.empty(flat.shape[1])
    sample(np.ascontiguousarray(field, dtype=np.float64), flat, out)
    fine = out.reshape(places.place.shape[1:])
    return fine if places.fine == 1 else area_mean(fine, (places.fine, places.fine))


def resample_dataset(
    data: xr.Dataset, places: Places, *, dims: tuple[str, str], coords: Mapping[str, NDArray[Any]]
) -> xr.Dataset:
    """Resample every floating variable of ``data`` (rows, cols); units and names are set anew from the source's.

    Other variables (status) are left behind.
    """
    variables = {}
    for name, variable in data.data_vars.items():
        if np.issubdtype(variable.dtype, np.floating):
            attrs = {k: variable.attrs[k] for k in ("units", "long_name") if k in variable.attrs}
            variables[name] = (dims, resample(variable.values, places), attrs)
    return xr.Dataset(variables, coords={k: ((k,), v, {"units": "um"}) for k, v in coords.items()})


def covering_grid(uv: Array, pixel_um: float) -> tuple[tuple[int, int], tuple[float, float]]:
    """Shape and origin (u, v) of the grid that covers the mesh; the origin is a multiple of the pixel."""
    low = np.floor(np.nanmin(uv, axis=(0, 1)) / pixel_um)
    high = np.ceil(np.nanmax(uv, axis=(0, 1)) / pixel_um)
    size = (high - low).astype(int) + 1
    return (int(size[1]), int(size[0])), (float(low[0] * pixel_um), float(low[1] * pixel_um))
