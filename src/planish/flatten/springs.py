"""The eight-spring mesh of Hirn et al. (2009), section 2.3.1: springs, rest lengths and their energy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Springs:
    """Springs between known nodes of a quad grid.

    Attributes
    ----------
    first, second : (springs,)
        Node numbers, counted over the known nodes.
    rest : (springs,)
        Rest lengths in um: distances of the nodes in space.
    nodes : (rows, cols)
        Number of each node, -1 where there is none.
    """

    first: NDArray[np.intp]
    second: NDArray[np.intp]
    rest: Array
    nodes: NDArray[np.intp]


def make_springs(points: Array) -> Springs:
    """Tie every known node of ``points`` (rows, cols, 3) to its eight neighbours.

    Each spring is counted once: two axial and two diagonal families cover all eight directions.
    """
    known: NDArray[np.bool_] = np.asarray(np.isfinite(points).all(axis=-1))
    nodes = np.where(known, np.cumsum(known.ravel()).reshape(known.shape) - 1, -1)
    first, second, rest = [], [], []
    here, there = slice(None, -1), slice(1, None)
    every = slice(None)
    for a, b in (
        ((every, here), (every, there)),
        ((here, every), (there, every)),
        ((here, here), (there, there)),
        ((here, there), (there, here)),
    ):
        both = known[a] & known[b]
        first.append(nodes[a][both])
        second.append(nodes[b][both])
        rest.append(np.linalg.norm(points[b][both] - points[a][both], axis=-1))
    return Springs(first=np.concatenate(first), second=np.concatenate(second), rest=np.concatenate(rest), nodes=nodes)


def energy(springs: Springs, uv: Array) -> float:
    """Sum over all springs of (l - L)^2, the spring constant being 1 (Eq. 1 of Hirn et al. 2009)."""
    length = np.linalg.norm(uv[springs.second] - uv[springs.first], axis=1)
    return float(np.sum((length - springs.rest) ** 2))


def newton_system(springs: Springs, uv: Array) -> tuple[Array, sparse.csc_array]:
    """Return the forces (2 n,) and the stiffness (2 n, 2 n) of the mesh at ``uv`` (n, 2).

    The stiffness is the exact second derivative of the energy, k d d' + k (1 - L / l) (1 - d d'), with the second
    part cut at zero for compressed springs, where it would make the matrix indefinite.
    """
    count = uv.shape[0]
    step = uv[springs.second] - uv[springs.first]
    # Two nodes on one spot have no direction; such a spring pulls nowhere instead of to infinity.
    length = np.maximum(np.linalg.norm(step, axis=1), 1e-9 * springs.rest)
    d = step / length[:, None]
    pull = d * (length - springs.rest)[:, None]
    force = np.zeros((count, 2))
    for axis in (0, 1):
        force[:, axis] = np.bincount(springs.first, pull[:, axis], count) - np.bincount(
            springs.second, pull[:, axis], count
        )
    bend = np.maximum(1 - springs.rest / length, 0.0)
    blocks = np.empty((d.shape[0], 2, 2))
    for a in (0, 1):
        for b in (0, 1):
            blocks[:, a, b] = d[:, a] * d[:, b] * (1 - bend) + (bend if a == b else 0.0)
    rows, cols, values = [], [], []
    for i, j, sign in (
        (springs.first, springs.first, 1.0),
        (springs.second, springs.second, 1.0),
        (springs.first, springs.second, -1.0),
        (springs.second, springs.first, -1.0),
    ):
        for a in (0, 1):
            for b in (0, 1):
                rows.append(2 * i + a)
                cols.append(2 * j + b)
                values.append(sign * blocks[:, a, b])
    stiffness = sparse.coo_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(cols))), shape=(2 * count, 2 * count)
    )
    return force.ravel(), stiffness.tocsc()
