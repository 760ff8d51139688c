"""Values, labels and their support from the nodes of a mesh to the pixels located in it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import SurfaceError
from planish.core.typing import Bools, Floats
from planish.resample._kernels import sample
from planish.resample.places import Places, each_band

Label = TypeVar("Label", bound=np.integer[Any] | np.bool_)


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


def resample_labels(labels: NDArray[Label], places: Places, *, fill: int = 0) -> NDArray[Label]:
    """Labels of the mesh's nodes on the grid, in their own type and never mixed.

    A point of the mesh has the label of the nearest node, counted in rows and columns of the mesh: each node holds the
    cell that reaches half a step to all sides. (Delaunay's triangles know no rows and columns: there it is the corner
    of greatest weight.) A pixel that is cut into sub-pixels takes the most frequent label of the known ones; of equally
    frequent labels, the one met first, row by row.

    Parameters
    ----------
    labels : (rows, cols)
        Whole numbers or truth values.
    places : Places
        From :func:`find_places`, of a mesh of (rows, cols).
    fill : int
        What stands where less than half of the pixel's area is known.

    Returns
    -------
    (rows, cols) of the grid, type of ``labels``

    Raises
    ------
    SurfaceError
        The labels are not whole numbers or truth values, ``fill`` is not of their type, or their shape is not the
        mesh's.
    """
    if labels.dtype.kind not in "iub":
        raise SurfaceError(
            f"Labels of type {labels.dtype} given; whole numbers or truth values are needed. Use resample for values."
        )
    limits = None if labels.dtype.kind == "b" else np.iinfo(labels.dtype.str)
    low, high = (limits.min, limits.max) if limits else (0, 1)
    if not low <= fill <= high:
        raise SurfaceError(f"The fill value {fill} does not fit into {labels.dtype} labels. Choose another one.")
    _check_mesh(labels, places)
    fine, cells = places.fine, int(np.prod(places.shape))
    # Sub-pixels one pixel after the other.
    is_inside, node = (
        a.reshape(places.shape[0], fine, places.shape[1], fine).swapaxes(1, 2).reshape(cells, -1)
        for a in (places.triangle >= 0, _nearest_nodes(places))
    )
    pixel = np.repeat(np.arange(cells), is_inside.sum(axis=1))
    sub_labels = labels.reshape(-1)[node[is_inside]]
    order = np.lexsort((sub_labels, pixel))
    changed = (np.diff(pixel[order], prepend=-1) != 0) | (sub_labels[order] != np.roll(sub_labels[order], 1))
    start = np.flatnonzero(changed)
    # Each pixel's labels, the most frequent first, then the one met first.
    best = np.lexsort((order[start], -np.diff(start, append=sub_labels.size), pixel[order[start]]))
    labelled, first = np.unique(pixel[order[start]][best], return_index=True)
    out = np.full(cells, fill, dtype=labels.dtype)
    out[labelled] = sub_labels[order[start]][best][first]
    out[2 * is_inside.sum(axis=1) < fine * fine] = fill
    return out.reshape(places.shape)


def _nearest_nodes(places: Places) -> NDArray[np.intp]:
    """Node in whose cell each sub-pixel lies; any one outside of the mesh."""
    number, (second, third) = places.triangle, places.weight
    if len(places.corners):
        corner = np.argmax([1.0 - second - third, second, third], axis=0)
        return places.corners[number, corner].astype(np.intp)
    node, odd = np.divmod(np.maximum(number, 0), 2)
    row = np.where(odd, second + third, third) >= 0.5
    col = np.where(odd, second, second + third) >= 0.5
    return (node + np.where(row, places.mesh[1], 0) + col).astype(np.intp)


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
