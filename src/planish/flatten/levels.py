"""The eight-spring mesh of Hirn et al.

(2009), section 2.3.1, its coarser copies, arrays of passes, and threads.
"""

import itertools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse.linalg import splu

from planish.core.errors import CannotFlatten
from planish.core.grid import corners_of
from planish.core.typing import Array, Bools, Floats, Ints, Singles
from planish.flatten._kernels import FAR
from planish.flatten._mesh_kernels import coarsen, rest_lengths

Parts = list[tuple[int, int]]  # first rows, and rows after the last, of the shares of a pass


class Team(ThreadPoolExecutor):
    """Threads that share the rows of a pass; what a pass writes does not depend on their number."""

    def __init__(self, threads: int) -> None:
        super().__init__(max(threads - 1, 1))
        self.threads = threads

    def parts(self, rows: int, cols: int) -> Parts:
        """Shares of the padded rows 1 ... rows."""
        # With fewer nodes, a second thread does not pay for being woken.
        count = min(self.threads, rows) if rows * cols >= 100_000 else 1
        borders = [1 + rows * k // count for k in range(count + 1)]
        return list(itertools.pairwise(borders))

    def run(self, kernel: Callable[..., Any], parts: Parts, *args: Any) -> None:
        """Call ``kernel(*args, r0, r1)`` for all parts."""
        self.each(kernel, [(*args, *part) for part in parts])

    def each(self, kernel: Callable[..., Any], calls: list[tuple[Any, ...]]) -> None:
        """Call ``kernel`` once with each list of arguments, and wait for all of them."""
        running = [self.submit(kernel, *call) for call in calls[1:]]
        try:
            kernel(*calls[0])
        finally:
            wait(running)  # The arrays must not be given back while a thread still writes to them.
        for done in running:
            done.result()


def padded(components: int, rows: int, cols: int, dtype: type) -> Array:
    """Zeros (components, rows + 2, width), with a ring of padding.

    Rows start on a multiple of 64 bytes: of 16 values of single precision.
    """
    width = (cols + 3 + 15) // 16 * 16
    return np.zeros((components, rows + 2, width), dtype)


def bordered(rows: int, cols: int, dtype: type) -> Array:
    """Array (2, rows + 2, width) with FAR in the padding and no values yet inside."""
    out = np.empty_like(padded(2, rows, cols, dtype))
    out[:, [0, rows + 1]] = FAR
    out[:, :, 0] = FAR
    out[:, :, cols + 1 :] = FAR
    return out


@dataclass
class Level:
    """One mesh: arrays of ``_kernels``, sums by rows, rows of threads.

    ``sums`` (rows + 2, 2) is what passes add up in each padded row; ``alone`` the empty rows beyond
    a one-thread mesh, which ``smooth`` takes as its ``edge``.
    """

    rows: int
    cols: int
    parts: Parts
    rest: Floats
    stiff: Singles

    def open(self) -> None:
        """Make the arrays of the solver.

        ``xy`` and ``near`` have no values yet except in the padding.
        """
        shape = self.rows, self.cols
        self.xy = bordered(*shape, np.float64)
        self.near = bordered(*shape, np.float32)
        self.move = padded(2, *shape, np.float32)
        self.force = padded(2, *shape, np.float32)
        self.ease = padded(1, *shape, np.float32)[0]
        self.sums = np.zeros((self.rows + 2, 2))
        self.alone = np.zeros((2, 2, self.move.shape[2]), np.float32)

    def drop_springs(self) -> None:
        """Give back the memory of the springs, which only the forces need."""
        self.rest = np.empty((4, 0, 0))

    def inside(self, padded: Array) -> Array:
        """View of an array without its padding."""
        return padded[..., 1 : self.rows + 1, 1 : self.cols + 1]

    @property
    def full_stiff(self) -> Floats:
        """Stiffness of every spring, (4, rows + 2, width)."""
        return np.broadcast_to(self.stiff, self.rest.shape).astype(np.float64)

    @property
    def nodes(self) -> Bools:
        """Mask (rows, cols) of the nodes that a spring holds."""
        row_springs, col_springs, falling_springs, rising_springs = self.rest > 0
        is_held = row_springs | col_springs | falling_springs
        is_held[:, 1:] |= row_springs[:, :-1] | rising_springs[:, :-1]
        is_held[1:] |= col_springs[:-1] | rising_springs[:-1]
        is_held[1:, 1:] |= falling_springs[:-1, :-1]
        return self.inside(is_held)


def of_springs(nodes: Array, pair: Callable[[Any, Any], Any], out: Array) -> Array:
    """Set ``out`` (4, rows, cols) to ``pair`` of the two ends of each spring.

    The four families of springs run along rows, along columns, and along both diagonals of a cell;
    the last row or column of ``out``, where a family has no spring, is left as it is.
    """
    a, b, c, d = corners_of(nodes)
    along_rows, along_cols, falling, rising = out
    along_rows[:, :-1] = pair(nodes[:, :-1], nodes[:, 1:])
    along_cols[:-1] = pair(nodes[:-1], nodes[1:])
    falling[:-1, :-1] = pair(a, c)
    rising[:-1, :-1] = pair(b, d)
    return out


def pieces_of(mask: Bools) -> tuple[Array, int]:
    """Number the pieces of a mask that hang together by sides or corners from 1, and count them."""
    labels, count = ndimage.label(mask, structure=np.ones((3, 3)))
    return labels, count


def near(mask: Bools) -> Bools:
    """Nodes of a mask and those up to two rows and columns from one."""
    return ndimage.binary_dilation(mask, np.ones((3, 3), dtype=bool), iterations=2)


def halve(level: Level, team: Team) -> Level:
    """Make the mesh of every second node.

    The last may lie one row or column beyond the fine mesh.
    """
    rows = level.rows // 2 + 1
    cols = level.cols // 2 + 1
    rest = padded(4, rows, cols, np.float64)
    stiff = padded(4, rows, cols, np.float32)
    parts = team.parts(rows, cols)
    team.run(coarsen, parts, level.rest, level.stiff, rest, stiff, level.cols, cols)
    return Level(rows, cols, parts, rest, stiff)


TRUSTED = 0.1  # share of the median weight below which a node does not count in the flattening


def mean_pitch(points: Floats) -> float:
    """Give the mean distance of neighbours along rows and columns, in the unit of ``points``.

    It is taken from some ten rows and some ten columns; from all where these hold few neighbours.
    """
    for n_lines in (10, max(points.shape)):
        row_step, col_step = (max(1, n // n_lines) for n in points.shape[:2])
        with np.errstate(invalid="ignore", over="ignore"):
            along_rows = np.diff(points[::row_step], axis=1)
            along_cols = np.diff(points[:, ::col_step], axis=0)
            vectors = np.concatenate([along_rows.reshape(-1, 3), along_cols.reshape(-1, 3)])
            lengths = np.sqrt(np.sum(vectors * vectors, axis=-1))
        lengths = lengths[np.isfinite(lengths)]
        if lengths.size > 1000:
            break
    pitch = float(lengths.mean()) if lengths.size else 0.0
    if not np.isfinite(pitch) or pitch <= 0:
        raise CannotFlatten(
            "No two neighbours of the mesh have a distance. Give a grid of points (rows, cols, 3)"
            " in um, in which neighbours in the grid are neighbours in the sheet."
        )
    return pitch


def make_springs(
    points: Floats, pitch: float, rest: Literal["arc", "chord"], team: Team
) -> tuple[Level, int, float]:
    """Tie the nodes of ``points`` (rows, cols, 3) to their neighbours; each spring is stored once.

    Gives a level with rest lengths in pitches and stiffness 1, the number of springs, and the share
    of them that kept their chord although the surface bends there, because the curvatures at their
    two ends disagree; NaN for ``rest="chord"``.
    """
    rows, cols = points.shape[:2]
    parts = team.parts(rows, cols)
    lengths = padded(4, rows, cols, np.float64)
    spring_counts = np.zeros((rows + 2, 2))
    team.run(rest_lengths, parts, points, 1 / pitch, rest == "arc", lengths, spring_counts)
    springs, n_straight = spring_counts.sum(axis=0)
    if springs == 0:
        raise CannotFlatten(
            "No two neighbours of the mesh are known. Fill the gaps or use a coarser mesh."
        )
    ones = np.ones((4, 1, lengths.shape[2]), np.float32)
    straight_share = n_straight / springs if rest == "arc" else np.nan
    return Level(rows, cols, parts, lengths, ones), int(springs), straight_share


def stiffen(level: Level, weights: Floats) -> None:
    """Give every spring the weight of its less certain end."""
    stiff = padded(4, level.rows, level.cols, np.float32)
    of_springs(weights.astype(np.float32), np.minimum, level.inside(stiff))
    stiff[level.rest == 0] = 0.0
    level.stiff = stiff


def loose_nodes(is_node: Bools) -> tuple[Bools, Ints]:
    """Find the nodes whose place the springs do not settle.

    They hang on the sheet by a single node or spring.

    A cell with three corners is stiff, and so are cells that share an edge; everything else can
    turn freely. The largest stiff part is the sheet. Gives the known nodes outside of it, and the
    number of cells of every stiff part.
    """
    is_stiff = np.sum(corners_of(is_node), axis=0) >= 3
    # Cells at odd places and the edges between them; a path may pass an edge whose two nodes are
    # known.
    rows, cols = is_node.shape
    passable = np.zeros((2 * rows - 1, 2 * cols - 1), dtype=bool)
    passable[1::2, 1::2] = is_stiff
    passable[1::2, ::2] = is_node[:-1] & is_node[1:]
    passable[::2, 1::2] = is_node[:, :-1] & is_node[:, 1:]
    labels = ndimage.label(passable)[0][1::2, 1::2]
    sizes = np.bincount(labels[is_stiff])
    if sizes.size == 0:
        return is_node.copy(), sizes
    sheet_cells = (labels == np.argmax(sizes)) & is_stiff
    is_held = np.zeros_like(is_node)
    for corner in corners_of(is_held):
        corner |= sheet_cells
    return is_node & ~is_held, sizes[sizes > 0]


def impute_nodes(
    points: Floats, weights: Floats | None, is_trusted: Bools, is_missing: Bools
) -> tuple[Floats, Floats]:
    """Lay the missing nodes of ``points`` so that rows and columns bend least.

    They get next to no weight.

    Least sum of squared second differences along rows and columns, to which trusted neighbours up
    to two nodes away contribute; nodes that are neither trusted nor missing become NaN. What is
    linear in row and column is met exactly.
    """
    weights = np.where(is_trusted, 1.0 if weights is None else weights, 0.0)
    points = np.where(is_trusted[..., None], points, np.nan)
    if not is_missing.any():
        return points, weights
    is_local = is_missing | (is_trusted & near(is_missing))
    rows, cols = np.nonzero(is_local)
    node_number = np.full(is_missing.shape, -1)
    node_number[is_local] = np.arange(rows.size)

    diff2 = _differences(node_number, (1.0, -2.0, 1.0))
    # A faint pull towards the neighbours settles what no second difference reaches.
    diff1 = _differences(node_number, (1.0, -1.0))
    is_free = is_missing[is_local]
    is_fixed = ~is_free
    # The pull acts on the deviation from a plane, which leaves linear maps alone.
    fixed_points = points[is_local][is_fixed]
    plane_basis = np.stack([np.ones(rows.size), rows, cols], axis=1)
    coefficients = np.linalg.lstsq(plane_basis[is_fixed], fixed_points, rcond=None)[0]
    plane = plane_basis @ coefficients
    bending = diff2.T @ diff2 + 1e-8 * (diff1.T @ diff1)
    matrix = bending.tocsc()[is_free]
    # A trace of a tie to the plane, for nodes that no difference reaches.
    free_matrix = matrix[:, is_free] + 1e-14 * sparse.eye_array(is_free.sum())
    pull = -(matrix[:, is_fixed] @ (fixed_points - plane[is_fixed]))
    moves = splu(free_matrix.tocsc()).solve(pull)
    points[is_missing] = plane[is_free] + moves
    # Stiff enough to hold a loose corner, too weak to steer the sheet.
    return points, np.where(is_missing, 0.01 * weights.max(), weights)


def _differences(node_number: Ints, coefficients: tuple[float, ...]) -> sparse.csr_array:
    """Sums of nodes along a row or a column with these coefficients, shape (sums, nodes).

    A sum takes as many nodes as there are coefficients, wherever all of them take part;
    ``node_number`` is -1 where none does.
    """
    order = len(coefficients)
    runs: list[Ints] = []
    for numbers in (node_number, node_number.T):
        windows = np.lib.stride_tricks.sliding_window_view(numbers, order, axis=0)
        runs.append(windows.reshape(-1, order))
    nodes = np.concatenate(runs)
    nodes = nodes[(nodes >= 0).all(axis=1)]
    # As many values in each row of the matrix.
    row_starts = np.arange(0, nodes.size + 1, order)
    values = np.tile(coefficients, len(nodes))
    shape = (len(nodes), int(node_number.max()) + 1)
    return sparse.csr_array((values, nodes.ravel(), row_starts), shape=shape)
