"""Where the pixels of a regular grid lie in a flattened quad mesh.

Hirn et al. (2009), section 2.3.4, triangulate the moved points anew (Delaunay). Here the connectivity of the mesh is
used: no triangle can bridge a gap, and overlaps are noticed. The paper's mode can be had for comparison.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import SurfaceError
from planish.resample._kernels import extents, locate
from planish.resample.bands import each_band
from planish.resample.delaunay import triangulate

Array = NDArray[np.float64]
Indices = NDArray[np.int32]
Method = Literal["quads", "delaunay"]

_MOST_PIXELS = 2**31
_MOST_NODES = 2**30  # two triangles per node are numbered in 32 bits
_SEGMENT = 32  # quads whose extent is known together: passed over at once where they do not touch a band of pixels
_MOST_FINE = 32


@dataclass(frozen=True, slots=True, kw_only=True)
class Places:
    """Where each pixel of a regular grid lies in the mesh; good for any number of fields.

    Attributes
    ----------
    triangle : (rows * fine, cols * fine) int32
        Number of the triangle a sub-pixel lies in; -1 outside. Triangle 2 n + t is the first (t = 0) or second half of
        the quad whose first corner is node n, unless ``corners`` numbers them.
    weight : (2, rows * fine, cols * fine)
        Weights of the triangle's second and third corner, the first one has the rest of 1; anything outside.
    corners : (triangles, 3) int32
        Nodes of each triangle, for Delaunay's; without rows for the quads.
    mesh : (int, int)
        Rows and columns of the mesh.
    fine : int
        Sub-pixels per pixel and axis; values are means over them.
    overlaps : int
        Sub-pixels covered by more than one quad: 0 unless the mesh is folded, and always 0 for Delaunay.
    """

    triangle: Indices
    weight: Array
    corners: Indices
    mesh: tuple[int, int]
    fine: int
    overlaps: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the grid."""
        return self.triangle.shape[0] // self.fine, self.triangle.shape[1] // self.fine


def find_places(
    uv: Array, *, shape: tuple[int, int], pixel_um: tuple[float, float],
    origin_um: tuple[float, float] = (0.0, 0.0), least_um: float | None = None, method: Method = "quads",
    threads: int | None = None,
) -> Places:  # fmt: skip
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
    method : {"quads", "delaunay"}
        Through the two triangles of each known quad; or through a new triangulation of the known nodes (scipy, some
        hundred times slower), which bridges gaps and does not notice folds.
    threads : int, optional
        All processors, at most 8, where not given; the result does not depend on it.

    Returns
    -------
    Places

    Raises
    ------
    SurfaceError
        The grid is empty or too large, the mesh is not (rows, cols, 2) or has more than 2^30 nodes, or there is
        nothing to triangulate.

    Notes
    -----
    Where quads overlap, the first in the order of the mesh stays. A quad without one of its corners covers nothing.
    """
    if min(shape) < 1 or shape[0] * shape[1] > _MOST_PIXELS:
        raise SurfaceError(f"A grid of {shape[0]} x {shape[1]} pixels cannot be made. Check the pixel size.")
    if uv.ndim != 3 or uv.shape[2] != 2 or uv.shape[0] * uv.shape[1] > _MOST_NODES:
        raise SurfaceError(
            f"The flat coordinates have the shape {uv.shape}; (rows, cols, 2) is needed, with 2^30 nodes at most."
        )
    fine = max(1, int(np.ceil(max(pixel_um) / least_um - 1e-6))) if least_um else 1
    fine = min(fine, _MOST_FINE)
    uv = np.ascontiguousarray(uv, dtype=np.float64)
    step = pixel_um[1] / fine, pixel_um[0] / fine
    # The first sub-pixel's centre lies half a pixel less half a sub-pixel before the pixel's.
    first = origin_um[0] - 0.5 * (pixel_um[1] - step[0]), origin_um[1] - 0.5 * (pixel_um[0] - step[1])
    find = _in_quads if method == "quads" else _in_delaunay
    return find(uv, first, step, shape, fine, threads)


def _in_quads(
    uv: Array, first: tuple[float, float], step: tuple[float, float], shape: tuple[int, int], fine: int,
    threads: int | None,
) -> Places:  # fmt: skip
    rows, cols = uv.shape[:2]
    size = shape[0] * fine, shape[1] * fine
    low, high = np.empty((2, rows, max(0, -(-(cols - 1) // _SEGMENT))))
    triangle, weight, twice = np.empty(size, np.int32), np.empty((2, *size)), np.zeros(size, np.uint8)

    def bounds(begin: int, end: int) -> None:
        extents(uv, first[1], step[1], _SEGMENT, low, high, begin, end)

    def band(begin: int, end: int) -> int:
        return locate(uv, first, step, _SEGMENT, low, high, triangle, weight, twice, begin, end)

    if rows:
        each_band(bounds, rows, threads=threads)
    overlaps = sum(each_band(band, size[0], threads=threads))
    none = np.empty((0, 3), dtype=np.int32)
    return Places(triangle=triangle, weight=weight, corners=none, mesh=(rows, cols), fine=fine, overlaps=overlaps)


def _in_delaunay(
    uv: Array, first: tuple[float, float], step: tuple[float, float], shape: tuple[int, int], fine: int,
    _threads: int | None,
) -> Places:  # fmt: skip
    triangle, weight, corners = triangulate(uv, first, step, (shape[0] * fine, shape[1] * fine))
    mesh = int(uv.shape[0]), int(uv.shape[1])
    return Places(triangle=triangle, weight=weight, corners=corners, mesh=mesh, fine=fine, overlaps=0)


def covering_grid(uv: Array, pixel_um: float) -> tuple[tuple[int, int], tuple[float, float]]:
    """Shape and origin (u, v) of the grid that covers the mesh; the origin is a multiple of the pixel.

    Raises
    ------
    SurfaceError
        No node is known.
    """
    known = uv[np.isfinite(uv).all(axis=-1)]
    if not known.size:
        raise SurfaceError("No node of the mesh has flat coordinates. Check the surface and how it was flattened.")
    low, high = np.floor(known.min(axis=0) / pixel_um), np.ceil(known.max(axis=0) / pixel_um)
    size = (high - low).astype(int) + 1
    return (int(size[1]), int(size[0])), (float(low[0] * pixel_um), float(low[1] * pixel_um))
