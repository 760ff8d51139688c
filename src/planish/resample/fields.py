"""Values and their support from the nodes of a mesh to the pixels located in it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import SurfaceError
from planish.core.typing import Bools, Floats
from planish.resample._kernels import sample
from planish.resample.places import Places, each_band


def resample(field: NDArray[Any], places: Places) -> Floats:
    """Values of a mesh field on the grid: linear in each triangle, the mean over a pixel's sub-pixels.

    Parameters
    ----------
    field : (rows, cols)
        Value of each node; NaN is missing.
    places : Places
        From :func:`find_places`, of a mesh of (rows, cols).

    Returns
    -------
    (rows, cols) of the grid, float64
        A sub-pixel is known where the corners of its triangle are; a pixel is NaN unless half of its area is known.

    Raises
    ------
    SurfaceError
        The field does not have the mesh's shape.
    """
    return _sampled(field, places, np.empty((0, 0)))


def support(known: Bools, places: Places) -> Floats:
    """Share of each pixel's area that is known on the mesh, from 0 to 1.

    ``support(np.isfinite(field), places) >= 0.5`` is where :func:`resample` of the same field has a value.

    Parameters
    ----------
    known : (rows, cols)
        Nodes with a value.
    places : Places
        As for :func:`resample`.
    """
    share = np.empty(places.shape)
    _sampled(np.where(known, 0.0, np.nan), places, share)
    return share


def resample_dataset(
    data: xr.Dataset, places: Places, *, dims: tuple[str, str], coords: Mapping[str, NDArray[Any]]
) -> xr.Dataset:  # fmt: skip
    """Resample every floating variable of ``data`` (rows, cols); units and names are set anew from the source's.

    Parameters
    ----------
    data : Dataset
        Variables on the nodes of the mesh.
    places : Places
        From :func:`find_places`.
    dims : (str, str)
        Names of the grid's rows and columns.
    coords : mapping of str to array
        Positions of the grid's rows and columns in um.
    """
    variables: dict[str, Any] = {}
    for name, variable in data.data_vars.items():
        attrs = {k: variable.attrs[k] for k in ("units", "long_name", "role", "support_um") if k in variable.attrs}
        if np.issubdtype(variable.dtype, np.floating):
            variables[str(name)] = (dims, resample(variable.values, places), attrs)
    return xr.Dataset(variables, coords={k: ((k,), v, {"units": "um"}) for k, v in coords.items()})


def _check_mesh(field: NDArray[Any], places: Places) -> None:
    if field.shape != places.mesh:
        raise SurfaceError(
            f"The field has the shape {field.shape}, the mesh {places.mesh}. Give a field on the nodes of that mesh."
        )


def _sampled(field: NDArray[Any], places: Places, share: Floats) -> Floats:
    """Values; ``share`` is set to the share of each pixel that is known where it is not empty."""
    _check_mesh(field, places)
    nodes = np.ascontiguousarray(field, dtype=np.float64).reshape(-1)
    out = np.empty(places.shape)

    def band(begin: int, end: int) -> None:
        sample(
            nodes, places.mesh[1], places.triangle, places.weight, places.corners, places.fine, out, share, begin, end
        )

    each_band(band, out.shape[0])
    return out
