"""A transformation that is affine but for smooth changes around marks.

Its image, derivatives, inverse, strain and folds.
"""

from abc import abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from planish.core.errors import CannotRegister
from planish.core.threads import map_threads
from planish.core.transform import (
    Affine,
    NearSimilarity,
    Similarity,
    Transform,
    are_known,
    grid_points,
)
from planish.core.typing import Floats, Pair, pair_of

Kernel = Callable[[Floats], Floats]


def lay_out_arrays(holder: Any) -> None:
    """Lay the arrays of a dataclass out as read back from a file: sums have the same bytes."""
    for name in (f.name for f in fields(holder)):
        values = getattr(holder, name)
        if isinstance(values, np.ndarray):
            laid_out = np.array(values, dtype=np.float64, order="C")
            object.__setattr__(holder, name, laid_out)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bent(NearSimilarity):
    """``(1, p') @ affine + sum_i U(|p' - node_i|) bend_i`` for one or more ``U``.

    Here ``p' = (p - source) / size``.
    """

    source: Pair  # middle of the marks, in um
    size: float  # their rms distance from it, in um
    nodes: Floats  # places of the marks (n, 2), scaled
    affine: Floats  # constant and linear part (3, 2), in um
    # True where the local changes end beside the marks, so that the inverse has a meaning far from
    # them.
    everywhere: ClassVar[bool]

    def __post_init__(self) -> None:
        """Lay the arrays out as read back from a file."""
        lay_out_arrays(self)

    @abstractmethod
    def bends(self) -> Iterator[tuple[Kernel, Kernel, Floats]]:
        """``U`` of squared distances, its derivative by half of them, and the coefficients of each.

        The coefficients are (n, 2) in um.
        """

    def __call__(self, points: ArrayLike) -> Floats:
        """Transform points of shape ``(..., 2)``, in um; NaN stays NaN."""
        points_um = np.asarray(points, dtype=np.float64)
        scaled_points = (points_um.reshape(-1, 2) - self.source) / self.size
        out = self.affine[0] + scaled_points @ self.affine[1:]

        def add(part: slice) -> None:
            self.add_bends(scaled_points[part], out[part])

        slices = self._parts(scaled_points)
        # With fewer parts, starting threads takes longer than the work.
        map_threads(add, slices, number=1 if len(slices) < 4 else None)
        return out.reshape(points_um.shape)

    def _parts(self, scaled_points: Floats) -> list[slice]:
        """Points at once, so that their distances from the nodes fit into the cache."""
        step = max(1, (1 << 18) // len(self.nodes))
        starts = range(0, len(scaled_points), step)
        return [slice(k, k + step) for k in starts]

    def add_bends(self, scaled_points: Floats, out: Floats) -> None:
        """Add the local changes at scaled points (n, 2) to ``out`` (n, 2), in um."""
        x, y = self._offsets(scaled_points)
        squares = x**2 + y**2
        for value, _, bend in self.bends():
            if np.any(bend):
                out += value(squares) @ bend

    def _offsets(self, scaled_points: Floats) -> tuple[Floats, Floats]:
        """Differences of points from all nodes along x and y, (points, nodes) each."""
        x, y = scaled_points.T
        node_x, node_y = self.nodes.T
        return x[:, None] - node_x, y[:, None] - node_y

    def jacobian(self, points: ArrayLike) -> Floats:
        """Derivatives of the image at points ``(..., 2)``.

        The shape is ``(..., 2, 2)``: a row for x and y of the image.
        """
        points_um = np.asarray(points, dtype=np.float64)
        scaled_points = (points_um.reshape(-1, 2) - self.source) / self.size
        out = np.tile(self.affine[1:].T, (len(scaled_points), 1, 1))
        for part in self._parts(scaled_points):
            x, y = self._offsets(scaled_points[part])
            squares = x**2 + y**2
            for _, slope, bend in self.bends():
                if np.any(bend):
                    slopes = slope(squares)
                    out[part, :, 0] += (slopes * x) @ bend
                    out[part, :, 1] += (slopes * y) @ bend
        slopes = out / self.size  # a point's coordinates are scaled by its inverse
        return slopes.reshape(*points_um.shape, 2)

    @property
    def inverse(self) -> Callable[[ArrayLike], Floats]:
        """The transformation back, by Newton's method from the nearest image of a grid.

        NaN where it finds no point.
        """
        return _Inverse(self)


class _Inverse:
    """The inverse of a bent map; where Newton's method begins is worked out once."""

    def __init__(self, bent: Bent) -> None:
        """Work out the images of a grid about the nodes, at which the search begins.

        The images, derivatives and a tree of the images are kept for all later calls.
        """
        from scipy.spatial import KDTree

        nodes = bent.nodes * bent.size + np.array(bent.source)
        low = nodes.min(axis=0)
        high = nodes.max(axis=0)
        self.bent = bent
        self.around = float(np.max(high - low))  # um
        self.low = low - self.around
        self.high = high + self.around
        # The inverse begins at the nearest image of a grid that reaches one extent of the marks
        # beyond them.
        axes = np.linspace(self.low, self.high, 49).T
        self.grid = grid_points(*axes).reshape(-1, 2)
        self.images = bent(self.grid)
        self.slopes = bent.jacobian(self.grid)
        self.tree = KDTree(self.images)
        self.largest = float(np.abs(self.images).max())

    def __call__(self, points: ArrayLike) -> Floats:
        """Take points ``(..., 2)`` back, in um; NaN where there is none."""
        points_um = np.asarray(points, dtype=np.float64)
        sources = np.full(points_um.shape, np.nan)
        is_finite = are_known(points_um)
        if is_finite.any():
            sources[is_finite] = self._newton(points_um[is_finite])
        return sources

    def _newton(self, targets: Floats) -> Floats:
        """Sources (n, 2) of target points, in um; NaN where the steps lead nowhere.

        Steps are at most an eighth of the extent of the marks. Of a map that is affine far from the
        marks, the search begins at the inverse of that beyond the grid. A step that does not help
        is tried at a quarter of its length; a point is given up where that does not help either.
        """
        bent = self.bent
        longest = 0.125 * self.around  # of a step: farther off, the derivatives are others
        _, nearest = self.tree.query(targets)
        nearest = np.asarray(nearest)
        starts = self.grid[nearest]
        step = _solve(self.slopes[nearest], self.images[nearest] - targets)
        sources = starts - np.clip(step, -longest, longest)
        if bent.everywhere:
            # Beyond the grid the map is affine, and so is its inverse.
            is_border = (starts == self.low) | (starts == self.high)
            is_edge = is_border.any(axis=1)
            to_scaled = np.linalg.inv(bent.affine[1:])
            scaled = (targets[is_edge] - bent.affine[0]) @ to_scaled
            sources[is_edge] = scaled * bent.size + bent.source
        error = bent(sources) - targets
        # What rounding leaves of the sum of kernels.
        tolerance = 4e-15 * (self.largest + np.abs(targets).max())
        active = np.arange(len(targets))
        for _ in range(60):
            active_sources = sources[active]
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                step = _solve(bent.jacobian(active_sources), error[active])
            # Far from the answer a whole step may overshoot a bend.
            length = np.linalg.norm(step, axis=1, keepdims=True)
            step *= np.minimum(1.0, longest / np.maximum(length, 1e-300))
            start_errors = np.linalg.norm(error[active], axis=1)
            is_better = np.zeros(active.size, bool)
            # Where the whole step does not help, a quarter of it may.
            for step_share in (1.0, 0.25):
                is_tried = ~is_better & ((start_errors > tolerance) | (step_share == 1.0))
                rows = np.flatnonzero(is_tried)
                if not rows.size:
                    continue
                trial = active_sources[rows] - step_share * step[rows]
                trial_error = bent(trial) - targets[active[rows]]
                is_improved = np.linalg.norm(trial_error, axis=1) < start_errors[rows]
                improved_rows = rows[is_improved]
                sources[active[improved_rows]] = trial[is_improved]
                error[active[improved_rows]] = trial_error[is_improved]
                is_better[improved_rows] = True
            is_wrong = np.linalg.norm(error[active], axis=1) > tolerance
            active = active[is_better & is_wrong]
            if not active.size:
                break
        is_lost = np.linalg.norm(error, axis=1) > 100 * tolerance
        if not bent.everywhere:
            is_beyond = (sources < self.low) | (sources > self.high)
            is_lost |= is_beyond.any(axis=1)
        sources[is_lost] = np.nan
        return sources


def _solve(jacobian: Floats, error: Floats) -> Floats:
    """Solve 2 x 2 systems; a singular one gives what is not finite."""
    a, b, c, d = jacobian.reshape(-1, 4).T
    det = a * d - b * c
    error_x, error_y = error.T
    x = (d * error_x - b * error_y) / det
    y = (a * error_y - c * error_x) / det
    steps = np.stack([x, y], axis=1)
    return np.nan_to_num(steps, nan=0.0, posinf=0.0, neginf=0.0)


# Local strain from which on a fit warns.
NOTABLE = 0.01


class LocalStrain(NamedTuple):
    """Local strain between the marks, after the overall scale is taken off."""

    area: Pair  # least and largest ratio of local areas to their mean
    # Least and largest principal strain: 0.01 where a length is 1 % longer than the overall scale
    # makes it.
    stretch: Pair
    at_um: Pair  # where in the moving map the strain is largest, as (x, y) in um

    @property
    def largest(self) -> float:
        """Largest strain without its sign."""
        return max(map(abs, self.stretch))


def determinants(matrices: Floats) -> Floats:
    """Determinants (n,) of 2 x 2 matrices (n, 2, 2)."""
    a, b, c, d = matrices.reshape(-1, 4).T
    return a * d - b * c


def strain_of(transform: Transform, marks: Floats, mirrored: bool) -> LocalStrain:
    """Strain at the marks (n, 2), of the moving map in um, and on a grid in their hull.

    ``mirrored``: whether the transformation changes the hand. CannotRegister where the map folds or
    its hand is wrong.
    """
    worst_place = marks.mean(axis=0)
    if isinstance(transform, Similarity):
        return LocalStrain(area=(1.0, 1.0), stretch=(0.0, 0.0), at_um=pair_of(worst_place))
    # An affine map is strained alike everywhere.
    points = marks[:1] if isinstance(transform, Affine) else inside(marks)
    jacobians = transform.jacobian(points)
    areas = (-1.0 if mirrored else 1.0) * determinants(jacobians)
    known_areas = np.where(np.isfinite(areas), areas, -np.inf)
    worst = np.argmin(known_areas)
    if not areas[worst] > 0:
        if isinstance(transform, Affine):
            raise CannotRegister(
                "The fitted affine transformation reverses the handedness: many pairs are probably"
                " wrong. Check that every row pairs the same hole on both sides."
            )
        x, y = points[worst]
        raise CannotRegister(
            f"The fitted transformation folds the map near ({x:.5g}, {y:.5g}) um of the moving map."
            " Check the pairs there; if they are right, fit a model with fewer parameters."
        )
    mean = float(np.mean(areas))
    lengths = np.linalg.svd(jacobians, compute_uv=False)
    stretches = lengths / np.sqrt(mean) - 1.0
    if len(points) > 1:
        largest = np.abs(stretches).max(axis=1)
        worst_place = points[np.argmax(largest)]
    stretch = range_of(stretches)
    return LocalStrain(range_of(areas / mean), stretch, pair_of(worst_place))


def range_of(numbers: Floats) -> Pair:
    """The least and the largest of some numbers."""
    return float(numbers.min()), float(numbers.max())


def inside(marks: Floats, steps: int = 65) -> Floats:
    """Return the marks, and the points of a grid that lie in their hull: (k, 2) in um.

    The grid has ``steps x steps`` points over the extent of the marks. The marks come first, then
    the grid row by row. Marks on a line, or fewer than three, come back alone; none may be NaN.
    """
    from scipy.spatial import Delaunay, QhullError

    low = marks.min(axis=0)
    high = marks.max(axis=0)
    axes = np.linspace(low, high, steps).T
    grid = grid_points(*axes).reshape(-1, 2)
    middle = marks.mean(axis=0)
    try:
        hull = Delaunay(marks - middle)
    except QhullError:  # all on a line, or fewer than three
        return marks
    is_inside = hull.find_simplex(grid - middle) >= 0
    return np.concatenate([marks, grid[is_inside]])
