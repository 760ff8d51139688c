"""Give the spring mesh as a sparse matrix.

It serves for exact steps on the coarsest mesh, for strips, and as the kernels' slow twin.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from planish.core.typing import Array, Bools, Floats, Ints
from planish.flatten.levels import Level

# Weak tie of every node to its place, in spring constants: the sheet as a whole is free to shift
# and turn.
_TIE = 1e-10
# First and second ends of the four families of springs: steps down, and steps across, from where
# the spring is stored.
_ENDS = np.array([[[0, 0, 0, 0], [0, 0, 0, 1]], [[0, 1, 1, 1], [1, 0, 1, 0]]])


class Network(NamedTuple):
    """The springs of a level as lists: ends by node number, rest lengths and stiffness."""

    mask: Bools
    first: Ints
    second: Ints
    rest: Floats
    stiff: Floats

    @classmethod
    def of(cls, level: Level) -> Network:
        """Collect the springs of ``level``; nodes are numbered row by row."""
        mask = level.nodes
        number = np.zeros(mask.shape, dtype=np.intp)
        number[mask] = np.arange(np.count_nonzero(mask))
        rest = level.inside(level.rest)
        stiff = level.inside(level.full_stiff)
        is_spring = rest > 0
        family, rows, cols = np.nonzero(is_spring)
        first, second = (
            number[rows + down[family], cols + across[family]] for down, across in _ENDS
        )
        return cls(mask, first, second, rest[is_spring], stiff[is_spring])

    def energy(self, uv: Floats) -> float:
        """Sum over the springs of k (l - L)^2 for the places ``uv`` (nodes, 2)."""
        vectors = uv[self.second] - uv[self.first]
        stretch = np.linalg.norm(vectors, axis=1) - self.rest
        return float(np.sum(self.stiff * stretch**2))

    def forces(self, uv: Floats) -> Floats:
        """Minus half the energy's gradient, (nodes, 2)."""
        vectors, lengths = self._vectors(uv)
        strain = 1 - self.rest / lengths
        pull = vectors * (self.stiff * strain)[:, None]
        force = np.empty(uv.shape)
        for axis, p in enumerate(pull.T):
            at_first = np.bincount(self.first, p, len(uv))
            at_second = np.bincount(self.second, p, len(uv))
            force[:, axis] = at_first - at_second
        return force

    def matrix(self, uv: Floats, *, exact: bool) -> sparse.csc_array:
        """Half the second derivative of the energy, (2 nodes, 2 nodes), node by node (u, v).

        The Gauss-Newton part k d d', and if ``exact`` also k (1 - L / l) (1 - d d') of the springs
        under tension; that of compressed ones would make the matrix indefinite.
        """
        d, transverse_share = self._directions(uv, exact)
        along = d.T[:, None] * d.T * (1 - transverse_share)
        across = np.eye(2)[..., None] * transverse_share
        block = self.stiff * (along + across)
        # For both axes of either end, the four pairs of ends: (2, 2, 4, springs).
        pair_signs = np.array([1.0, 1.0, -1.0, -1.0])
        values = block[:, :, None] * pair_signs[:, None]
        first, second = self.first, self.second
        ends = np.stack([first, second, first, second])
        other_ends = np.stack([first, second, second, first])
        row = 2 * ends + np.arange(2)[:, None, None, None]
        col = 2 * other_ends + np.arange(2)[:, None, None]
        row, col, _ = np.broadcast_arrays(row, col, values)
        size = 2 * len(uv)
        indices = (row.ravel(), col.ravel())
        stiffness = sparse.coo_array((values.ravel(), indices), (size, size))
        return (stiffness + _TIE * sparse.eye_array(size)).tocsc()

    def full_matrix(self, uv: Floats, *, exact: bool) -> Floats:
        """As ``matrix``, of a small network and without ties, (2 nodes, 2 nodes).

        It is the product of a matrix with its transpose: a row for each spring says how the
        spring's length changes with the places of the nodes.
        """
        d, transverse_share = self._directions(uv, exact)
        n_springs = len(self.rest)
        incidence = np.zeros((n_springs, len(uv)))
        spring_indices = np.arange(n_springs)
        incidence[spring_indices, self.first] = -1.0
        incidence[spring_indices, self.second] = 1.0
        along = d[:, None, :] * incidence[:, :, None]
        along = along.reshape(n_springs, -1)
        stiff_along = self.stiff * (1 - transverse_share)
        stiffness = along.T @ (stiff_along[:, None] * along)
        if exact:
            # Alike on u (even places) and v.
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
        """Factorise the stiffness of ``network`` at ``uv`` (nodes, 2), or set up a full matrix.

        ``exact`` adds what springs under tension resist across their own direction.
        """
        # Shifts, and the turn about the middle, at right angles to them.
        rigid = np.zeros((len(uv), 2, 3))
        u, v = (uv - uv.mean(axis=0)).T
        rigid[:, 0, 0] = rigid[:, 1, 1] = 1.0
        rigid[:, 0, 2] = -v
        rigid[:, 1, 2] = u
        moves = rigid.reshape(-1, 3)
        lengths = np.sqrt(np.sum(moves * moves, axis=0))
        self._rigid = moves / np.maximum(lengths, 1e-300)
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
        rigid_part = self._rigid @ self._rigid.T
        free = np.eye(len(rigid_part)) - rigid_part
        return free @ np.linalg.inv(self._matrix) @ free

    def __call__(self, force: Floats) -> Floats:
        """Moves (nodes, 2) under ``force`` (nodes, 2)."""
        free_force = self._without_rigid(force.ravel())
        if self._matrix is None:
            move = self._solve(free_force)
        else:
            move = np.linalg.solve(self._matrix, free_force)
        return self._without_rigid(move).reshape(-1, 2)

    def _without_rigid(self, values: Array) -> Array:
        """Forces or moves (2 nodes,) without their share in shifts and turns of the whole."""
        return values - self._rigid @ (self._rigid.T @ values)


def relax_exactly(network: Network, uv: Floats, *, tolerance: float = 1e-10) -> Floats:
    """Run Newton's method from ``uv`` (nodes, 2) until no step is over ``tolerance``.

    Its steps lower the energy: one that would not is halved, and the last places are given where
    even a small share of it would not.
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
