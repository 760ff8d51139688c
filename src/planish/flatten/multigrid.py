"""Find the minimum spring energy by nested iteration with Gauss-Newton steps.

Each step is solved by one multigrid cycle.

The mesh of every second node is itself a mesh of springs (in two dimensions a spring constant does
not depend on the mesh's size), so each coarser level is relaxed first and gives the next its start.
Forces are balanced in double precision; corrections come from a V-cycle in single precision over
the linearised springs of all levels (Brandt 1977, doi:10.1090/S0025-5718-1977-0431719-X), with
Chebyshev smoothing (Adams et al. 2003, doi:10.1016/S0021-9991(03)00194-3).
"""

import itertools
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from scipy import ndimage

from planish.core.status import Outcome
from planish.core.transform import grid_points
from planish.core.typing import Floats, Singles
from planish.flatten._kernels import (
    FAR,
    advance,
    descend,
    forces,
    prepare,
    restrict,
    smooth,
    survey,
)
from planish.flatten._mesh_kernels import hold_open, interpolate
from planish.flatten.direct import Network, StiffnessSolver, relax_exactly
from planish.flatten.levels import Level, Team, halve

# Smoothing works on the part of the spectrum that the coarser mesh does not see: a node's own
# stiffness divides its matrix so that eigenvalues reach 2 (a little more near borders); those of
# waves shorter than four nodes begin at 1/2.
_LOW, _HIGH = 0.42, 2.0


def _weights(steps: int, low: float) -> tuple[np.float32, ...]:
    """Give the weights of steps that together are the Chebyshev polynomial on [low, _HIGH].

    They are the inverse of its roots.
    """
    angles = np.pi * (2 * np.arange(steps) + 1) / (2 * steps)
    doubled_roots = _HIGH + low + (_HIGH - low) * np.cos(angles)
    return tuple((2 / doubled_roots).astype(np.float32))


(_ONCE,) = _weights(1, _LOW)
_TWICE = _weights(2, _LOW)
_FOUR = _weights(4, 0.15)
_STILL = 3e-6  # mean error of places, in pitches, below which a mesh is at rest whatever its energy
_SLOW = 0.25  # share of the gain before, above which steps are made conjugate
OPEN = 0.02  # share of its area at rest down to which a step may close a cell
_HALVINGS = 40  # of a step that would close a cell, or raise the energy


@dataclass(frozen=True, slots=True)
class Step:
    """One step of the solver.

    Nodes of the mesh, energy before the step, what it expects to gain, and the mean move.
    """

    nodes: int
    energy: float
    gain: float
    move: float


def _dot(a: Singles, b: Singles) -> float:
    """Sum of the products.

    Numpy's own order of summation, where BLAS would share it out among its threads.
    """
    return float(np.sum(a * b, dtype=np.float64))


# Forces, move and their product at a step.
_Direction = tuple[Singles, Singles, float]


def _make_conjugate(level: Level, previous: _Direction | None) -> _Direction:
    """Make the move conjugate to the one before it (Polak and Ribiere), and give its direction.

    A cycle deals badly with a few movements only, of parts that hang together by a strip, or near
    many holes; these are what the method collects.
    """
    work = _dot(level.force, level.move)
    if previous is not None:
        previous_force, previous_move, previous_work = previous
        if previous_work > 0:
            beta = max((work - _dot(previous_force, level.move)) / previous_work, 0.0)
            level.move += np.float32(beta) * previous_move
    return level.force.copy(), level.move.copy(), work


class Multigrid:
    """Relaxation of a hierarchy of meshes."""

    def __init__(
        self, finest: Level, team: Team, *, gaps: bool, side: float, guarded: bool
    ) -> None:
        """Make the coarser levels, down to some five rows or columns.

        ``gaps``: whether nodes or springs are missing; ``side``: 1, or -1 where rows and columns
        run in the opposite sense to u and v; ``guarded``: whether no step may close a cell.
        """
        self.levels = [finest]
        while min(self.levels[-1].rows, self.levels[-1].cols) > 5:
            self.levels.append(halve(self.levels[-1], team))
        self.team = team
        self.gaps = gaps
        self.side = side
        self.guarded = guarded
        self.history: list[Step] = []
        # Share of the excess energy that a cycle is expected to leave, before one has been
        # observed.
        self.rate = 0.1
        self._corrects_twice = True
        self._is_rough = False
        self._previous: _Direction | None = None
        # From here on a level is the work of one thread.
        small_levels = (k for k, level in enumerate(self.levels) if k and len(level.parts) == 1)
        self._first_small = next(small_levels, len(self.levels))

    def run(self, tolerance: float) -> Outcome:
        """Relax all levels, the finest one to ``tolerance``.

        Each but the coarsest starts from the places of the one below. Gives how the finest ended.
        """
        self._start(self.levels[-1])
        outcome = Outcome.RESTED
        for k in reversed(range(len(self.levels) - 1)):
            fine, coarse = self.levels[k : k + 2]
            coarse.drop_springs()
            fine.open()
            arrays = (coarse.xy, fine.xy, fine.near)
            self.team.run(interpolate, fine.parts, *arrays, fine.cols, coarse.cols)
            if self.gaps:
                is_gone = ~fine.nodes
                fine.inside(fine.xy)[:, is_gone] = FAR
                fine.inside(fine.near)[:, is_gone] = FAR
            arrays = (fine.near, fine.stiff, fine.ease)
            self.team.run(prepare, fine.parts, *arrays, fine.cols)
            # One step, as a rule: what is left on a coarse level is less than what the finer one
            # adds.
            outcome = self.relax(k, tolerance if k == 0 else 0.1)
        return outcome

    def _start(self, level: Level) -> None:
        """Relax the coarsest mesh exactly, from the mean rest lengths between columns and rows.

        A finer mesh corrects what it leaves, so that 0.3 pitches are near enough then.
        """
        coordinates: list[Floats] = []
        # The first family of springs runs along rows, from column to column; the second down them.
        for axis in (0, 1):
            lengths = level.inside(level.rest)[axis]
            is_spring = lengths > 0
            counts = np.maximum(is_spring.sum(axis=axis), 1)
            mean_lengths = lengths.sum(axis=axis) / counts
            typical_length = lengths[is_spring].mean() if is_spring.any() else 1.0
            mean_lengths[mean_lengths == 0] = typical_length
            coordinates.append(np.concatenate([[0.0], np.cumsum(mean_lengths[:-1])]))
        level.open()
        self._network = Network.of(level)
        is_node = self._network.mask
        across, down = coordinates
        grid = grid_points(self.side * across, down)
        tolerance = 1e-10 if len(self.levels) == 1 else 0.3
        uv = relax_exactly(self._network, grid[is_node], tolerance=tolerance)
        for places in (level.xy, level.near):
            inside = level.inside(places)
            inside[:] = FAR
            inside[:, is_node] = uv.T
        self._exact = StiffnessSolver(self._network, uv)
        if self._exact.inverse is None:
            self._first_small = len(self.levels)

    def relax(self, k: int, tolerance: float) -> Outcome:
        """Step on level ``k`` until the excess of energy over the minimum is small enough.

        It is then below ``tolerance`` times the energy. Each step is one cycle. A step is slow
        where it gains more than a quarter of what the one before gained; from the first such step
        on, moves are made conjugate. A run that would fold is left, to be done again with guarded
        steps.
        """
        level = self.levels[k]
        gains: list[float] = []
        slow_steps = 0
        self._previous = None
        for step in range(300):
            energy = self.balance(level)
            is_smoothed = self._correct(k, step)
            wanted_gain, gain, mean_move = self._take(level, energy, slow_steps)
            if not np.isfinite(gain):
                return Outcome.NOT_FINITE
            if step == 0:
                # The next finer level is then taken as rough, too.
                self._is_rough = gain > 0.02 * energy
            if is_smoothed:
                continue
            gains.append(gain)
            self._observe(gains, slow_steps)
            if self._is_near(gain, mean_move, tolerance * energy):
                is_held = wanted_gain > max(100 * tolerance * energy, gain)
                return Outcome.HELD_OPEN if is_held else Outcome.RESTED
            # From the first one on all count.
            is_slow = len(gains) > 1 and gain > _SLOW * gains[-2]
            slow_steps += slow_steps > 0 or is_slow
            # Slow progress may be that of a mesh that folds.
            if self._has_folds(level, slow_steps):
                return Outcome.FOLDED
        return Outcome.OUT_OF_STEPS

    def _correct(self, k: int, step: int) -> bool:
        """Set the move on level ``k``; give whether by smoothing alone.

        That deals with it where what the coarser levels could not see, which is short, is most of
        the energy.
        """
        if k > 0 or step > 0 or not self._is_rough:
            self._corrects_twice = k > 0 or step > 1
            self._cycle(k)
            return False
        level = self.levels[k]
        self._smooth(0, level, level, *_FOUR[:2])
        for weight in _FOUR[2:]:
            self._smooth(2, level, level, weight, weight)
        return True

    def _take(self, level: Level, energy: float, slow_steps: int) -> tuple[float, float, float]:
        """Make a move; give the gain that was wanted, that which came of it, and the mean move.

        The gain wanted is 0 unless guarded. ``energy`` is that before the move.
        """
        wanted_gain = 0.0
        if self.guarded:
            wanted_gain = self._guard(level, energy)
        elif slow_steps:
            self._previous = _make_conjugate(level, self._previous)
        gain, square_move = self.advance(level)
        if slow_steps and not self.guarded:
            gain, square_move = self._reach(level, gain, square_move)
        count = level.rows * level.cols
        mean_move = float(np.sqrt(square_move / count))
        self.history.append(Step(count, energy, gain, mean_move))
        return wanted_gain, gain, mean_move

    def _observe(self, gains: list[float], slow_steps: int) -> None:
        """Take the rate of the steps to come for the largest ratio of a gain to the one before."""
        # One lucky step is no proof where progress is slow.
        last_gains = gains[-4 if slow_steps else -2 :]
        ratios = [b / a if a else 1.0 for a, b in itertools.pairwise(last_gains)]
        if ratios:
            self.rate = float(np.clip(max(ratios), 0.01, 0.95))

    def _is_near(self, gain: float, mean_move: float, least_energy: float) -> bool:
        """Return whether the excess of energy over the minimum, or the distance, is small enough.

        Both are the steps to come, summed; the distance goes with the root of the energy.
        """
        root_rate = np.sqrt(self.rate)
        distance = mean_move * (root_rate / (1 - root_rate))
        return gain * self.rate / (1 - self.rate) <= least_energy or distance <= _STILL

    def _has_folds(self, level: Level, slow_steps: int) -> bool:
        """Whether cells are folded, which is looked for after every fourth slow step."""
        if self.guarded or not slow_steps or slow_steps % 4:
            return False
        return count_folds(level, self.team, self.side)[1] > 0

    def _reach(self, level: Level, gain: float, square_move: float) -> tuple[float, float]:
        """Go on along the move just made, or back, to where the forces no longer act along it."""
        self.balance(level)
        slope = _dot(level.force, level.move)
        reach = 1.0
        if gain > slope:
            reach = float(np.clip(gain / (gain - slope), 0.1, 4.0))
        level.move *= np.float32(reach - 1)
        self.advance(level)
        return reach * gain, reach * reach * square_move

    def _guard(self, level: Level, energy: float) -> float:
        """Shorten the move where it would close a cell, and as a whole until the energy falls.

        Gives the gain that was wanted. ``energy`` is that before the move. What still closes a cell
        after all halvings does not move.
        """
        wanted_gain = _dot(level.force, level.move)
        move_share = np.ones(level.move.shape[1:], np.float32)
        for _ in range(_HALVINGS):
            mesh = (level.xy, level.rest, level.move, move_share)
            if not hold_open(*mesh, OPEN, self.side, level.cols, 1, level.rows):
                break
            # What is next to a node that is held back may not run into it.
            around = ndimage.minimum_filter(move_share, size=3)
            np.minimum(move_share, 2 * around, out=move_share)
        else:
            move_share[move_share < 1] = 0.0
        level.move *= move_share
        for _ in range(_HALVINGS):
            self.advance(level)
            moved_energy, _ = count_folds(level, self.team, self.side)
            has_risen = moved_energy > energy * (1 + 1e-12)
            # Back, and on with half of it; or, in the end, with the whole by the caller.
            level.move *= -1
            self.advance(level)
            level.move *= -0.5 if has_risen else -1.0
            if not has_risen:
                break
        return wanted_gain

    def balance(self, level: Level) -> float:
        """Set the forces of a level and give its energy."""
        arrays = (level.xy, level.rest, level.stiff, level.force, level.sums)
        self.team.run(forces, level.parts, *arrays, level.cols)
        return float(level.sums[1:-1, 0].sum())

    def advance(self, level: Level) -> tuple[float, float]:
        """Move the nodes; give force times move and the squared move, summed over the nodes."""
        arrays = (level.xy, level.near, level.move, level.force, level.sums)
        self.team.run(advance, level.parts, *arrays, level.cols)
        work, square_move = level.sums[1:-1].sum(axis=0)
        return float(work), float(square_move)

    def _cycle(self, k: int, depth: int = 0) -> None:
        """Correct level ``k`` for its forces: set its ``move``.

        By smoothing, a correction from the level below, and smoothing again. ``depth`` counts the
        levels from where the cycle began. The level below is corrected twice where it counts: else
        its own errors, and those below it, add up.
        """
        level = self.levels[k]
        if depth > 1 and k >= self._first_small:
            # ``descend`` takes eight levels, the last repeated, lest it is compiled anew; one
            # thread has no more.
            n_coarser = len(self.levels) - 1 - k
            descent_levels = [*self.levels[k:], *self.levels[-1:] * (7 - n_coarser)]
            of_levels = attrgetter("near", "stiff", "ease", "force", "move", "alone", "cols")
            arrays = zip(*map(of_levels, descent_levels), strict=True)
            node_indices = (1 + index for index in np.nonzero(self._network.mask))
            descend(*arrays, n_coarser, self._exact.inverse, *node_indices, *_TWICE, _ONCE)
            return
        if k == len(self.levels) - 1:
            is_node = self._network.mask
            node_forces = level.inside(level.force)[:, is_node].T
            move = self._exact(node_forces.astype(np.float64))
            level.inside(level.move)[:, is_node] = move.T
            return
        coarse = self.levels[k + 1]
        self._smooth(0, level, level, *_TWICE)
        for _ in range(2 if depth == 1 and self._corrects_twice else 1):
            arrays = (level.near, level.stiff, level.force, level.move, coarse.force)
            self.team.run(restrict, coarse.parts, *arrays, level.cols, coarse.cols)
            self._cycle(k + 1, depth + 1)
            self._smooth(1, level, coarse, _ONCE, _ONCE)

    def _smooth(
        self, kind: int, level: Level, coarse: Level, first: np.float32, weight: np.float32
    ) -> None:
        """Smooth the move of a level once.

        It starts from 0 (``kind`` 0), with the correction of ``coarse`` added (1), or as it is (2).
        ``first`` weighs the start of kind 0, ``weight`` the step.
        """
        fixed = (level.near, level.stiff, level.ease, level.force)
        borders = level.alone
        calls: list[tuple[object, ...]] = []
        for r0, r1 in level.parts:
            if len(level.parts) > 1:
                # Rows that two threads share are copied before either of them moves its own.
                borders = np.ascontiguousarray(level.move[:, [r0 - 1, r1]])
            moves = (coarse.move, level.move, borders)
            weights = (first, weight)
            calls.append((kind, *fixed, *moves, *weights, level.cols, r0, r1))
        self.team.each(smooth, calls)


def count_folds(level: Level, team: Team, side: float) -> tuple[float, int]:
    """Energy of a level, and how many of its cells are not upright."""
    arrays = (level.xy, level.rest, level.stiff)
    team.run(survey, level.parts, *arrays, side, level.sums, level.cols)
    energy, n_folded = level.sums[1:-1].sum(axis=0)
    return float(energy), int(n_folded)
