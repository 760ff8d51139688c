"""All arrangements of one set of marks on another, and how likely chance would offer each.

Pairs of marks on one side are laid on all pairs of like length on the other; the marks that then
agree are counted, and the best are refitted with a little stretch allowed.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import comb, log10
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from planish.core.typing import Bools, Complexes, Floats, Ints, Pair

# Arrangements whose marks lie this many tolerances off are followed, so that a slightly displaced
# rival is noticed.
REACH = 1.6
# Largest difference of stretch between two directions that the search follows: humidity, a lens.
STRETCH = 0.005
# Scales so far outside the tolerance are still followed: they are named, and they stop worse ones
# being taken.
SCALE_SPARE = 0.01
_MOST_REFINED = 400  # hypotheses
# A chance agreement as good as the one accepted is expected in fewer than 10**-3 of all searches.
ACCEPTED = -3.0


class Arrangements(NamedTuple):
    """Refined hypotheses between the smaller set ``a`` and the larger set ``b``, one a row."""

    # (h, n): mark of ``b`` within :data:`REACH` tolerances of each mark of ``a``; -1 where there is
    # none.
    partner: NDArray[np.int32]
    squares: Floats  # (h, n), in um2: squared distance to it; infinite where there is none
    inliers: Ints  # (h,): marks within the tolerance
    # (h,): log10 of the number of arrangements as good that are expected where the marks are
    # scattered at random.
    log_chance: Floats
    # (h,): ``w = alpha z + gamma conj(z) + beta``, with x of ``a`` reversed where ``mirrored``.
    alpha: Complexes
    gamma: Complexes
    beta: Complexes
    freedom: Floats  # (h,): marks' worth of freedom that the fit had: 2 without stretch, up to 3
    landed: Complexes  # (h, n), in um: marks of ``a`` in the frame of ``b``
    mirrored: Bools  # (h,)
    tests: Ints  # (h,): hypotheses tried, the same in all rows

    def take(self, rows: Ints | Bools | np.intp) -> Arrangements:
        """Return some of the rows, or a single one, whose columns lack the first axis."""
        return Arrangements._make(column[rows] for column in self)


def search(
    a: Complexes,
    b: Complexes,
    scale_tolerance: float,
    tolerance_um: float,
    *,
    hands: Sequence[bool],
) -> Arrangements:
    """Try every two-point hypothesis and refine those at which most marks agree, three at least.

    ``a`` (n,) is the smaller set, ``b`` (m,) the larger, ``x + iy`` in um; of the ``hands`` True
    reverses the x of ``a``. The scale may be :data:`SCALE_SPARE` outside of its tolerance. Refined
    is what reaches 60 % of the best count, or, where a set is laid on itself, 30 % of its marks.
    """
    from planish.register import _kernels

    is_self = a is b
    most_count = 25_000 if is_self else 40_000
    scale_reach = scale_tolerance + SCALE_SPARE
    hypotheses, seeds = _hypotheses(a, b, scale_reach, tolerance_um, most_count)
    tests = len(seeds) * len(hands)
    # A hypothesis that two marks fix lands the others farther off than a fit to many of them.
    reach = REACH * tolerance_um
    x0, x1, y0, y1 = bounds_of(b)
    diagonal_um = float(np.hypot(x1 - x0, y1 - y0))
    wide_reach = reach + 0.5 * STRETCH * diagonal_um
    raster = _raster(b, wide_reach)
    cells = _cells(b, wide_reach)
    middle_reach = 0.5 * (wide_reach + reach)
    reaches = np.array([wide_reach, middle_reach, reach, reach, reach])
    # Localisation error that the stretch is weighed against, as a share of the tolerance.
    ridge = (0.16 * tolerance_um / (0.5 * STRETCH)) ** 2
    soft = (0.5 * tolerance_um) ** 2
    count_share, self_count = (0.0, 0.3 * len(a)) if is_self else (0.6, 0.0)
    hand_arrangements: list[Arrangements] = []
    for hand in hands:
        points = -np.conj(a) if hand else a
        counts = _kernels.count_near(points, b, *hypotheses, raster, count_share)
        least_count = max(self_count, count_share * counts.max(initial=0))
        if is_self and not hand:
            # These leave every mark where it is.
            is_same = (seeds[:, :2] == seeds[:, 2:]).all(axis=1)
            counts[is_same] = 0
        best_rows = np.flatnonzero(counts >= max(3, int(least_count)))
        if len(best_rows) > _MOST_REFINED:
            best_counts = counts[best_rows].astype(np.intp)
            order = np.argsort(-best_counts, kind="stable")
            best_rows = np.sort(best_rows[order[:_MOST_REFINED]])
        refined = _kernels.refine(seeds[best_rows], points, b, reaches, soft, ridge, *cells)
        distinct = _distinct(refined, scale_reach)
        hand_arrangements.append(
            _arrangements(distinct, points, b, tolerance_um, ridge, hand, tests)
        )
    columns = zip(*hand_arrangements, strict=True)
    return Arrangements._make(map(np.concatenate, columns))


def _distinct(refined: tuple[Any, ...], scale_reach: float) -> list[Any]:
    """Take the possible rows of what the kernel `refine` returns, each set of partners once.

    The scale may be off 1 by ``scale_reach``.
    """
    partner, _, alpha, gamma, *_ = refined
    scale = np.abs(alpha)
    is_possible = (np.abs(scale - 1.0) <= scale_reach) & (scale >= 0.45)
    # Largest stretch that an arrangement may have; a wrong one often needs more.
    is_possible &= np.abs(gamma) <= 0.5 * 0.012 * scale
    is_possible &= np.count_nonzero(partner >= 0, axis=1) >= 3
    _, first_rows = np.unique(partner[is_possible], axis=0, return_index=True)
    rows = np.flatnonzero(is_possible)[first_rows]
    return [column[rows] for column in refined]


def _arrangements(
    refined: list[Any],
    points: Complexes,
    b: Complexes,
    tolerance_um: float,
    ridge: float,
    hand: bool,
    tests: int,
) -> Arrangements:
    """Judge refined hypotheses, of which ``tests`` were tried.

    ``points`` (n,) are the marks of ``a`` as this ``hand`` shows them; ``ridge`` is that of the
    kernel `refine`.
    """
    partner, squares, alpha, gamma, beta, power = refined
    pair_counts = np.count_nonzero(partner >= 0, axis=1)
    # Of three marks the kernel fits no stretch.
    freedom = np.where(pair_counts > 3, 2.0 + power / (power + ridge), 2.0)
    turned = np.outer(alpha, points)
    stretched = np.outer(gamma, np.conj(points))
    landed = turned + stretched + beta[:, None]
    return Arrangements(
        partner=partner,
        squares=squares,
        inliers=np.count_nonzero(squares <= tolerance_um**2, axis=1),
        log_chance=log_chance(squares, b, tests, tolerance_um, freedom, power),
        alpha=alpha,
        gamma=gamma,
        beta=beta,
        freedom=freedom,
        landed=landed,
        mirrored=np.full(len(partner), hand),
        tests=np.full(len(partner), tests),
    )


_Bounds = tuple[float, float, float, float]  # least and largest x, least and largest y, in um
_Raster = tuple[float, float, float, int, int]  # x0, y0, side of a cell (um), rows, columns


def bounds_of(b: Complexes, margin: float = 0.0) -> _Bounds:
    """Least and largest x and y of marks, and a margin around, in um."""
    x = b.real
    y = b.imag
    low_x = x.min() - margin
    low_y = y.min() - margin
    return low_x, x.max() + margin, low_y, y.max() + margin


def extents(b: Complexes) -> Pair:
    """Long and short side of the field of the marks along its own axes, in um."""
    x = b.real
    y = b.imag
    offsets = [x - x.mean(), y - y.mean()]
    centred = np.stack(offsets, axis=1)
    _, own_axes = np.linalg.eigh(centred.T @ centred)
    sides_um = np.ptp(centred @ own_axes, axis=0)
    short_um, long_um = sorted(sides_um.tolist())
    return long_um, short_um


def share_within(radius: Floats | float, b: Complexes, tolerance_um: float) -> Floats:
    """Probability that a point anywhere in the field lies within ``radius`` of a mark of ``b``.

    On a line of marks the field is as wide as the discs; it is as long as a tolerance at least.
    """
    long_side, short_side = extents(b)
    # A disc is as long as its diameter, and on average pi / 4 of that wide.
    along = np.minimum(1.0, 2 * radius / max(long_side, tolerance_um))
    mean_width = np.pi / 2 * radius
    across = np.minimum(1.0, mean_width / max(short_side, 1e-300))
    return np.minimum(1.0, len(b) * along * across)


def marks_needed(n: int, b: Complexes, tests: int, tolerance_um: float) -> int:
    """Smallest number of ``n`` marks whose close agreement chance would not offer.

    ``n + 1`` where none is enough. ``tests`` is the number of hypotheses tried against ``b``.
    """
    share_near = float(share_within(0.3 * tolerance_um, b, tolerance_um))
    log_trials = log10(max(tests, 1) * (n - 2))
    for k in range(3 if n == 3 else 4, n + 1):
        log_tests = log_trials + log10(comb(n - 2, k - 2))
        if log_tests + (k - 2) * log10(share_near) <= ACCEPTED:
            return k
    return n + 1


def _hypotheses(
    a: Complexes, b: Complexes, scale_tolerance: float, tolerance: float, most_count: int
) -> tuple[tuple[Ints, Ints, Ints, Ints], Ints]:
    """Lay each pair of ``a`` on the pairs of ``b`` that are as long within ``scale_tolerance``.

    Either end comes first.

    Gives ``base``, ``first``, ``start`` and ``target`` as the kernel takes them; and of each
    hypothesis the marks ``i, j`` of ``a`` and ``k, q`` of ``b``: (h, 4). Beyond ``most_count``,
    pairs of ``a`` are thinned out evenly.
    """
    base, base_lengths = _by_length(a)
    # Shorter pairs fix the turn too poorly.
    is_long = base_lengths >= 3.0 * tolerance
    base = base[is_long]
    base_lengths = base_lengths[is_long]
    target, target_lengths = _by_length(b)
    slack = 0.6 * tolerance
    shortest = (1.0 - scale_tolerance) * base_lengths - slack
    longest = (1.0 + scale_tolerance) * base_lengths + slack
    first = np.searchsorted(target_lengths, shortest)
    stop = np.searchsorted(target_lengths, longest, "right")
    tried_count = 2 * int(np.sum(stop - first))
    if tried_count > most_count:
        base_count = max(1, len(base) * most_count // tried_count)
        sample = np.linspace(0, len(base) - 1, base_count).astype(np.intp)
        sample = np.unique(sample)
        base = base[sample]
        first = first[sample]
        stop = stop[sample]
    counts = 2 * (stop - first)
    start = np.append(0, np.cumsum(counts))
    base_rows = np.repeat(np.arange(len(base)), counts)
    # Of the hypotheses of one base pair, each target comes twice, the second time turned.
    number = np.arange(start[-1]) - start[base_rows]
    target_index, is_turned = np.divmod(number, 2)
    target_pairs = target[first[base_rows] + target_index]
    turned_rows = np.flatnonzero(is_turned)
    target_pairs[turned_rows] = target_pairs[turned_rows, ::-1]
    seeds = np.concatenate([base[base_rows], target_pairs], axis=1)
    return (base, first, start, target), seeds


def _by_length(points: Complexes) -> tuple[Ints, Floats]:
    """All pairs of points (k, 2), the shortest first, and their lengths (k,)."""
    pairs = np.stack(np.triu_indices(len(points), 1), axis=1)
    i, j = pairs.T
    lengths = np.abs(points[j] - points[i])
    order = np.argsort(lengths, kind="stable")
    return pairs[order], lengths[order]


def _raster(b: Complexes, reach: float) -> tuple[float, float, float, NDArray[np.uint8]]:
    """Raster of the cells within ``reach`` (um) of a mark, roughly: ``x0, y0, size, near``.

    ``near`` (rows, columns) is 1 there, 0 elsewhere and on its border.
    """
    bounds = x0, x1, y0, y1 = bounds_of(b, reach)
    width = x1 - x0
    height = y1 - y0
    # Never more than about 1.5 million cells, and 20 000 along a side.
    largest_raster = np.sqrt(width * height / 1_500_000)
    size = max(reach / 3.0, largest_raster, width / 20000.0, height / 20000.0)
    (x0, y0, _, rows, columns), row, column = _on_raster(b, bounds, size)
    near = np.zeros((rows, columns), np.uint8)
    cells = int(reach / size) + 2
    steps = np.arange(-cells, cells + 1)
    row = row[:, None] + steps
    column = column[:, None] + steps
    dx = x0 + (column + 0.5) * size - b.real[:, None]
    dy = y0 + (row + 0.5) * size - b.imag[:, None]
    # A cell counts where its middle does, or a little beyond, so that no cell with a good place is
    # lost.
    squares = dy[:, :, None] ** 2 + dx[:, None, :] ** 2
    mark, r, c = np.nonzero(squares <= (reach + 0.5 * size) ** 2)
    near_rows = np.clip(row[mark, r], 1, rows - 2)
    near_columns = np.clip(column[mark, c], 1, columns - 2)
    near[near_rows, near_columns] = 1
    return x0, y0, size, near


def _on_raster(b: Complexes, bounds: _Bounds, size: float) -> tuple[_Raster, Ints, Ints]:
    """Lay a raster over bounds, with two cells more around; give each mark's row and column too."""
    x0, x1, y0, y1 = bounds
    x0 -= 2 * size
    y0 -= 2 * size
    rows = int((y1 - y0) / size) + 3
    columns = int((x1 - x0) / size) + 3
    row = ((b.imag - y0) / size).astype(np.intp)
    column = ((b.real - x0) / size).astype(np.intp)
    return (x0, y0, size, rows, columns), row, column


def _cells(b: Complexes, reach: float) -> tuple[_Raster, Ints, NDArray[np.int32]]:
    """Give a raster whose cells list the marks within ``reach``, in um.

    Marks ``index[start[cell]:start[cell + 1]]`` are those of a cell; cells count row by row.

    What of the field lies beyond the raster has no mark within reach.
    """
    bounds = x0, x1, y0, y1 = bounds_of(b)
    width = x1 - x0
    height = y1 - y0
    # Never more than about a million cells, however large the field.
    most_cells = np.sqrt((width + 4 * reach) * (height + 4 * reach) / 1e6)
    size = max(reach, most_cells, width / 1e5, height / 1e5)
    raster, row, column = _on_raster(b, bounds, size)
    *_, rows, columns = raster
    # A cell is as large as the reach: a mark is listed in its own cell and in those around.
    near = np.arange(-1, 2)
    near_rows = row[:, None, None] + near[:, None]
    near_columns = column[:, None, None] + near
    cell = (near_rows * columns + near_columns).ravel()
    counts = np.bincount(cell, minlength=rows * columns)
    start = np.append(0, np.cumsum(counts))
    by_cell = np.argsort(cell, kind="stable")
    index = (by_cell // near.size**2).astype(np.int32)
    return raster, start, index


def log_chance(
    squares: Floats, b: Complexes, tests: int, tolerance: float, freedom: Floats, power: Floats
) -> Floats:
    """Return log10 of the expected number of chance arrangements as good as each row.

    ``squares`` (h, n), ``freedom`` (h,) and ``power`` (h,) are those of the arrangements and of the
    kernel `refine`, in um2; ``power`` is 0 where no stretch was fitted. The marks that agree best
    are taken, as many as make chance least likely.
    """
    n = squares.shape[1]
    is_agreeing = squares <= tolerance * tolerance
    agreeing_squares = np.where(is_agreeing, squares, np.inf)
    agreeing_counts = np.count_nonzero(is_agreeing, axis=1)
    # Two marks agree by choice.
    k = np.arange(3.0, n + 1.0)
    worst_squares = np.sort(agreeing_squares, axis=1)[:, 2:]
    # Fitting makes residuals smaller; a tenth of the tolerance keeps those of exact numbers finite.
    with np.errstate(invalid="ignore"):
        inflated_squares = worst_squares * k / np.maximum(k - freedom[:, None], 0.5)
        radius = np.sqrt(inflated_squares + (0.08 * tolerance) ** 2)
        shares = share_within(radius, b, tolerance)
        # The stretch was free too: as many as can be distinguished count as tests.
        spread = np.sqrt(power / np.maximum(agreeing_counts, 1))
        largest_moves = np.where(freedom > 2.0, 0.5 * STRETCH * spread, 0.0)
        stretches = largest_moves[:, None] / radius
        log_stretches = np.log10(np.maximum(1.0, np.pi * stretches**2))
        log_choices = [log10(comb(n - 2, chosen)) for chosen in range(1, n - 1)]
        log_trials = log10(max(tests, 1) * (n - 2))
        log_tests = log_trials + np.array(log_choices)
        log_counts = log_tests + (k - 2) * np.log10(shares) + log_stretches
    log_counts[np.isinf(worst_squares)] = np.inf
    return log_counts.min(axis=1)
