"""Nodes between and beside the known ones, laid without a kink."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse.linalg import splu

Array = NDArray[np.float64]


_BRACE = 0.01
"""Stiffness of springs to nodes that were made up: enough to hold a loose corner, too little to steer the sheet."""


def make_up(
    points: Array, weights: Array | None, known: NDArray[np.bool_], missing: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Lay the ``missing`` nodes of ``points`` so that rows and columns bend least, and give them next to no weight.

    Least sum of squared second differences along rows and columns, to which known neighbours up to two nodes away
    contribute; nodes that are neither known nor missing become NaN. What is linear in row and column is met exactly.
    """
    weights = np.where(known, 1.0 if weights is None else weights, 0.0)
    points = np.where(known[..., None], points, np.nan)
    if not missing.any():
        return points, weights
    part = missing | (known & ndimage.binary_dilation(missing, structure=np.ones((3, 3), dtype=bool), iterations=2))
    number = np.full(missing.shape, -1)
    number[part] = np.arange(np.count_nonzero(part))
    size = int(np.count_nonzero(part))

    def differences(weights: tuple[float, ...]) -> sparse.csr_array:
        """Sums of as many nodes in a row or a column, with these weights, wherever all of them take part."""
        count = len(weights)
        lines = [[n[k : len(n) + 1 + k - count].ravel() for k in range(count)] for n in (number, number.T)]
        nodes = np.concatenate([np.stack(line) for line in lines], axis=1)
        nodes = nodes[:, (nodes >= 0).all(axis=0)]
        place = (np.tile(np.arange(nodes.shape[1]), count), nodes.ravel())
        return sparse.csr_array((np.repeat(weights, nodes.shape[1]), place), shape=(nodes.shape[1], size))

    bend = differences((1.0, -2.0, 1.0))
    # A faint pull towards the neighbours settles what no second difference reaches.
    slope = differences((1.0, -1.0))
    free = missing[part]
    # The pull acts on the deviation from a plane, which leaves linear maps alone.
    rows, cols = np.nonzero(part)
    fixed = points[part][~free]
    basis = np.stack([np.ones(size), rows, cols], axis=1)
    plane = basis @ np.linalg.lstsq(basis[~free], fixed, rcond=None)[0]
    matrix = (bend.T @ bend + 1e-8 * (slope.T @ slope)).tocsc()
    solve = splu((matrix[free][:, free] + 1e-14 * sparse.eye_array(int(free.sum()))).tocsc()).solve
    values = solve(-(matrix[free][:, ~free] @ (fixed - plane[~free])))
    points[missing] = plane[free] + values
    return points, np.where(missing, _BRACE * weights.max(), weights)
