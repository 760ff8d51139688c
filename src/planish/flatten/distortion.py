"""How much flattening stretched each cell of the mesh, and by how much the sheet grew against its projection."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

Array = NDArray[np.float64]


def edge_strain(points: Array, uv: Array) -> tuple[Array, Array]:
    """Relative change of length of the edges along rows and along columns.

    Parameters
    ----------
    points : (rows, cols, 3)
    uv : (rows, cols, 2)

    Returns
    -------
    (rows, cols - 1), (rows - 1, cols)
        Flat length over length in space, minus one; NaN where an end is missing.
    """
    return tuple(  # type: ignore[return-value]
        np.linalg.norm(np.diff(uv, axis=axis), axis=-1) / np.linalg.norm(np.diff(points, axis=axis), axis=-1) - 1
        for axis in (1, 0)
    )


def cell_strain(points: Array, uv: Array) -> xr.Dataset:
    """Strains of each cell between the sheet in space and the plane.

    Parameters
    ----------
    points : (rows, cols, 3)
    uv : (rows, cols, 2)

    Returns
    -------
    Dataset, dims (row, col) = (rows - 1, cols - 1)
        ``stretch_max``, ``stretch_min``: principal stretches; ``area_ratio``: their product; ``axial_u``, ``axial_v``:
        strain of the edges; ``shear``: change of the angle between them in rad. All are 1 or 0 for an isometry.
    """
    across, down = _cell_edges(points)
    flat_across, flat_down = _cell_edges(uv)
    g11, g12, g22 = (np.sum(p * q, axis=-1) for p, q in ((across, across), (across, down), (down, down)))
    f11, f12, f22 = (
        np.sum(p * q, axis=-1)
        for p, q in ((flat_across, flat_across), (flat_across, flat_down), (flat_down, flat_down))
    )
    det = g11 * g22 - g12 * g12
    # Eigenvalues of g^-1 f are the squared principal stretches.
    trace = (g22 * f11 - 2 * g12 * f12 + g11 * f22) / det
    product = (f11 * f22 - f12 * f12) / det
    root = np.sqrt(np.maximum(trace * trace / 4 - product, 0.0))
    high, low = np.sqrt(trace / 2 + root), np.sqrt(np.maximum(trace / 2 - root, 0.0))
    angle = np.arccos(np.clip(g12 / np.sqrt(g11 * g22), -1, 1)) - np.arccos(np.clip(f12 / np.sqrt(f11 * f22), -1, 1))
    values = {
        "stretch_max": high,
        "stretch_min": low,
        "area_ratio": high * low,
        "axial_u": np.sqrt(f11 / g11) - 1,
        "axial_v": np.sqrt(f22 / g22) - 1,
        "shear": angle,
    }
    return xr.Dataset({k: (("row", "col"), v) for k, v in values.items()})


def _cell_edges(nodes: Array) -> tuple[Array, Array]:
    """Mean edge of each cell along its rows and along its columns."""
    across, down = np.diff(nodes, axis=1), np.diff(nodes, axis=0)
    return 0.5 * (across[:-1] + across[1:]), 0.5 * (down[:, :-1] + down[:, 1:])
