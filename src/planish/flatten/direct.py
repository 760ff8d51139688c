"""Give the spring mesh as a sparse matrix.

It serves for exact steps on the coarsest mesh, for strips, and as the kernels' slow twin.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from planish.core.typing import Bools, Floats, Ints
from planish.flatten.levels import Level

# Weak tie of every node to its place, in spring constants: the sheet as a whole is free to shift
# and turn.
_TIE = 1e-10
# First and second ends of the four families of springs: steps in row and column from where the
# spring is stored.
_ENDS = np.array(
    [
        [(0, 0), (0, 0), (0, 0), (0, 1)],
        [(0, 1), (1, 0), (1, 1), (1, 0)],
    ]
)


class Network(NamedTuple):
    """The springs of a level as lists: ends by node number, rest lengths and stiffness."""

    mask: Bools
    first: Ints
    second: Ints
    rest: Floats
    stiff: Floats

    @classmethod
    def of(cls, level: Level) -> Network:
        """Collect the springs of ``level``."""
        mask = level.nodes
        number = np.full((level.rows + 1, level.cols + 1), -1)
        number[:-1, :-1][mask] = np.arange(np.count_nonzero(mask))
        rest = level.inside(level.rest)
        stiff = level.inside(np.broadcast_to(level.stiff, level.rest.shape))
        springs = rest > 0
        family, rows, cols = np.nonzero(springs)
        first, second = (number[rows + step[family, 0], cols + step[family, 1]] for step in _ENDS)
        return cls(mask, first, second, rest[springs], stiff[springs].astype(np.float64))

    def energy(self, uv: Floats) -> float:
        """Sum over the springs of k (l - L)^2 for the places ``uv`` (nodes, 2)."""
        lengths = np.linalg.norm(uv[self.second] - uv[self.first], axis=1)
        return float(np.sum(self.stiff * (lengths - self.rest) ** 2))

    def forces(self, uv: Floats) -> Floats:
        """Minus half the energy's gradient, (nodes, 2)."""
        vectors, lengths = self._vectors(uv)
        pull = vectors * (self.stiff * (1 - self.rest / lengths))[:, None]
        force = np.empty(uv.shape)
        for axis, p in enumerate(pull.T):
            at_first = np.bincount(self.first, p, len(uv))
            force[:, axis] = at_first - np.bincount(self.second, p, len(uv))
        return force

    def matrix(self, uv: Floats, *, exact: bool) -> sparse.csc_array:
        """Half the second derivative of the energy, (2 nodes, 2 nodes), node by node (u, v).

        The Gauss-Newton part k d d', and if ``exact`` also k (1 - L / l) (1 - d d') of the springs
        under tension; that of compressed ones would make the matrix indefinite.
        """
        d, transverse_share = self._directions(uv, exact)
        along = d.T[:, None] * d.T * (1 - transverse_share)
        block = self.stiff * (along + np.eye(2)[..., None] * transverse_share)
        # For both axes of either end, the four pairs of ends: (2, 2, 4, springs).
        pair_signs = np.array([1.0, 1.0, -1.0, -1.0])
        values = block[:, :, None] * pair_signs[:, None]
        ends = np.stack([self.first, self.second, self.first, self.second])
        other_ends = np.stack([self.first, self.second, self.second, self.first])
        row = 2 * ends + np.arange(2)[:, None, None, None]
        col = 2 * other_ends + np.arange(2)[:, None, None]
        indices = (np.broadcast_to(k, values.shape).ravel() for k in (row, col))
        size = 2 * len(uv)
        stiffness = sparse.coo_array((values.ravel(), tuple(indices)), (size, size))
        return (stiffness + _TIE * sparse.eye_array(size)).tocsc()

    def full_matrix(self, uv: Floats, *, exact: bool) -> Floats:
        """As ``matrix``, of a small network and without ties."""
        d, transverse_share = self._directions(uv, exact)
        n_springs = len(self.rest)
        incidence = np.zeros((n_springs, len(uv)))
        spring_indices = np.arange(n_springs)
        incidence[spring_indices, self.first] = -1.0
        incidence[spring_indices, self.second] = 1.0
        along = (d[:, None, :] * incidence[:, :, None]).reshape(n_springs, -1)
        stiff_along = self.stiff * (1 - transverse_share)
        stiffness = along.T @ (stiff_along[:, None] * along)
        if exact:
            stiff_across = self.stiff * transverse_share
            across = incidence.T @ (stiff_across[:, None] * incidence)
            stiffness[::2, ::2] += across
            stiffness[1::2, 1::2] += across
        return stiffness

    def _vectors(self, uv: Floats) -> tuple[Floats, Floats]:
        """Vectors (n, 2) from the first to the second ends of the springs, and their lengths."""
        vectors = uv[self.second] - uv[self.first]
        # Two nodes on one spot have no direction; such a spring pulls nowhere instead of to
        # infinity.
        return vectors, np.maximum(np.linalg.norm(vectors, axis=1), 1e-150)

    def _directions(self, uv: Floats, exact: bool) -> tuple[Floats, Floats]:
        """Unit vectors of the springs, and the share of their stiffness that acts across them."""
        vectors, lengths = self._vectors(uv)
        transverse_share = np.zeros_like(lengths)
        if exact:
            transverse_share = np.maximum(1 - self.rest / lengths, 0.0)
        return vectors / lengths[:, None], transverse_share


class StiffnessSolver:
    """Answer forces with moves by the stiffness at given places.

    The sheet as a whole stays where it is.
    """

    def __init__(self, network: Network, uv: Floats, *, exact: bool = False) -> None:
        # Shifts, and the turn about the middle, at right angles to them.
        rigid = np.tile(np.eye(2, 3), (len(uv), 1, 1))
        u, v = (uv - uv.mean(axis=0)).T
        rigid[:, 0, 2] = -v
        rigid[:, 1, 2] = u
        flat = rigid.reshape(-1, 3)
        self._rigid = flat / np.maximum(np.sqrt(np.sum(flat * flat, axis=0)), 1e-300)
        self._matrix: Floats | None = None
        if len(uv) <= 200:  # nodes up to which a full matrix is quicker than a sparse one
            # Stiff against moves of the whole, which neither forces nor moves contain.
            matrix = network.full_matrix(uv, exact=exact) + self._rigid @ self._rigid.T
            self._matrix = matrix + _TIE * np.eye(len(matrix))
        else:
            factors = splu(
                network.matrix(uv, exact=exact),
                permc_spec="MMD_AT_PLUS_A",
                options={"SymmetricMode": True},
                diag_pivot_thresh=0.0,
            )
            self._solve = factors.solve

    @cached_property
    def inverse(self) -> Floats | None:
        """Moves for unit forces, (2 nodes, 2 nodes).

        None for a network that is too large for that.
        """
        if self._matrix is None:
            return None
        free = np.eye(len(self._matrix)) - self._rigid @ self._rigid.T
        return free @ np.linalg.inv(self._matrix) @ free

    def __call__(self, force: Floats) -> Floats:
        """Moves (nodes, 2) under ``force`` (nodes, 2)."""
        flat = force.ravel()
        flat = flat - self._rigid @ (self._rigid.T @ flat)
        move = self._solve(flat) if self._matrix is None else np.linalg.solve(self._matrix, flat)
        return (move - self._rigid @ (self._rigid.T @ move)).reshape(-1, 2)


def relax_exactly(network: Network, uv: Floats, *, tolerance: float = 1e-10) -> Floats:
    """Run Newton's method from ``uv`` (nodes, 2) until no step is over ``tolerance``.

    Its steps lower the energy.
    """
    energy = network.energy(uv)
    for _ in range(60):
        move = StiffnessSolver(network, uv, exact=True)(network.forces(uv))
        if not np.isfinite(move).all():
            return uv
        share = 1.0
        largest_move = float(np.abs(move).max())
        while (trial_energy := network.energy(uv + share * move)) > energy:
            share *= 0.5
            if share < 1e-4:
                return uv
        uv, energy = uv + share * move, trial_energy
        if largest_move < tolerance:
            break
    return uv
