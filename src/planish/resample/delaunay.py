"""The mode of the paper: the moved nodes are triangulated anew (Hirn et al. 2009, section 2.3.4).

Delaunay's triangles know nothing of the mesh. They bridge gaps and bays of the sheet, and a fold is not noticed. This
mode is there to compare with.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, QhullError

from planish.core.errors import SurfaceError
from planish.resample.bands import each_band

Array = NDArray[np.float64]
Indices = NDArray[np.int32]


def triangulate(
    uv: Array, first: tuple[float, float], step: tuple[float, float], shape: tuple[int, int]
) -> tuple[Indices, Array, Indices]:
    """Locate the points of a regular grid in Delaunay's triangulation of the known nodes.

    Parameters
    ----------
    uv : (rows, cols, 2)
        Flat coordinates of the nodes in um; NaN where there is no sheet.
    first, step : (u, v)
        The first point, and from one to the next, in um.
    shape : (int, int)
        Rows and columns of the grid.

    Returns
    -------
    triangle : shape
        Number of the triangle, -1 outside.
    weight : (2, *shape)
        Weights of its second and third corner.
    corners : (triangles, 3)
        Nodes of each triangle, numbered row by row in the mesh.
    """
    nodes = uv.reshape(-1, 2)
    known = np.flatnonzero(np.isfinite(nodes).all(axis=1))
    try:
        found = Delaunay(nodes[known])
    except (QhullError, ValueError) as error:
        raise SurfaceError(
            f"The {known.size} known nodes cannot be triangulated; at least 3 are needed that do not lie in one line. "
            "Check the flat coordinates."
        ) from error
    corners = np.ascontiguousarray(known[found.simplices], dtype=np.int32)
    triangle = np.empty(shape, dtype=np.int32)
    weight = np.empty((2, *shape))
    u = first[0] + step[0] * np.arange(shape[1])

    def band(begin: int, end: int) -> None:
        v = first[1] + step[1] * np.arange(begin, end)
        points = np.stack(np.broadcast_arrays(u[None, :], v[:, None]), axis=-1)
        here = found.find_simplex(points)
        # Weights of the first two corners; without a triangle they are not used.
        inverse = found.transform[here]
        two = np.einsum("yxij,yxj->yxi", inverse[..., :2, :], points - inverse[..., 2, :])
        triangle[begin:end] = here
        weight[0, begin:end] = two[..., 1]
        weight[1, begin:end] = 1.0 - two.sum(axis=-1)

    # One thread: the search goes from triangle to triangle, and is not made for several at once.
    each_band(band, shape[0], threads=1)
    return triangle, weight, corners
