"""Nodes between and beside the known ones, laid without a kink."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse.linalg import splu

from planish.core.errors import CannotFlatten

Array = NDArray[np.float64]


_BRACE = 0.01
"""Stiffness of springs to nodes that were made up: enough to hold a loose corner, too little to steer the sheet."""


def make_up(
    points: Array, weights: Array | None, known: NDArray[np.bool_], missing: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Lay the ``missing`` nodes smoothly between the ``known`` ones, with next to no weight.

    Parameters
    ----------
    points : (rows, cols, 3)
    weights : (rows, cols), optional
    known, missing : (rows, cols) bool

    Returns
    -------
    points, weights
    """
    weights = np.where(known, 1.0, 0.0) if weights is None else np.where(known, weights, 0.0)
    points = np.where(known[..., None], points, np.nan)
    return fill_smoothly(points, missing), np.where(missing, _BRACE * weights.max(), weights)


def fill_smoothly(uv: Array, missing: NDArray[np.bool_]) -> Array:
    """Fill the ``missing`` nodes (rows, cols) of ``uv`` (rows, cols, values) so that rows and columns bend least.

    Least sum of squared second differences along rows and columns, to which known neighbours up to two nodes away
    contribute; nodes that are neither known nor missing stay NaN. What is linear in row and column is met exactly.
    """
    uv = uv.copy()
    if not missing.any():
        return uv
    known = np.isfinite(uv[..., 0]) & ~missing
    if not known.any():
        raise CannotFlatten("No node of the mesh is certain enough to flatten it. Check the weights.")
    part = missing | (known & ndimage.binary_dilation(missing, structure=np.ones((3, 3), dtype=bool), iterations=2))
    number = np.full(missing.shape, -1)
    number[part] = np.arange(np.count_nonzero(part))
    differences = []
    for axis in (0, 1):
        n = np.moveaxis(number, axis, 0)
        a, b, c = n[:-2], n[1:-1], n[2:]
        whole = (a >= 0) & (b >= 0) & (c >= 0)
        differences.append((a[whole], b[whole], c[whole]))
    a, b, c = (np.concatenate(k) for k in zip(*differences, strict=True))
    row = np.arange(a.size)
    size = int(np.count_nonzero(part))
    bend = sparse.csr_array(
        (np.repeat([1.0, -2.0, 1.0], a.size), (np.tile(row, 3), np.concatenate([a, b, c]))), shape=(a.size, size)
    )
    # A faint pull towards the neighbours settles what no second difference reaches.
    edges = [np.stack([np.moveaxis(number, k, 0)[:-1].ravel(), np.moveaxis(number, k, 0)[1:].ravel()]) for k in (0, 1)]
    ends = np.concatenate(edges, axis=1)
    ends = ends[:, (ends >= 0).all(axis=0)]
    line = np.arange(ends.shape[1])
    slope = sparse.csr_array(
        (np.repeat([1.0, -1.0], line.size), (np.tile(line, 2), ends.ravel())), shape=(line.size, size)
    )
    free = missing[part]
    # The pull acts on the deviation from a plane, which leaves linear maps alone.
    rows, cols = np.nonzero(part)
    fixed = uv[part][~free]
    basis = np.stack([np.ones(size), rows, cols], axis=1)
    plane = basis @ np.linalg.lstsq(basis[~free], fixed, rcond=None)[0]
    matrix = (bend.T @ bend + 1e-8 * (slope.T @ slope)).tocsc()
    solve = splu((matrix[free][:, free] + 1e-14 * sparse.eye_array(int(free.sum()))).tocsc()).solve
    values = solve(-(matrix[free][:, ~free] @ (fixed - plane[~free])))
    uv[missing] = plane[free] + values
    return uv
