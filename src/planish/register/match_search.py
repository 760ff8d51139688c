"""All arrangements of one set of marks on another, and how likely chance would offer each.

Pairs of marks on one side are laid on all pairs of like length on the other; the marks that then agree are counted,
and the best are refitted with a little stretch allowed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from math import lgamma, log, log10
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from planish.core.typing import Bools, Floats, Ints, Pair
from planish.register.pairs import Complexes

# Arrangements whose marks lie this many tolerances off are followed, so that a slightly displaced rival is noticed.
REACH = 1.6
# Largest difference of stretch between two directions that the search follows: humidity, a lens.
STRETCH = 0.005
# Scales so far outside the tolerance are still followed: they are named, and they stop worse ones being taken.
SCALE_SPARE = 0.01
# Hypotheses tried, hypotheses refined, cells of the raster.
_MOST_TRIED = 40_000
_MOST_REFINED = 400


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Arrangements:
    """Refined hypotheses between the smaller set ``a`` and the larger set ``b``, one a row."""

    # (h, n): mark of ``b`` within :data:`REACH` tolerances of each mark of ``a``; -1 where there is none.
    partner: NDArray[np.int32]
    squares: Floats  # (h, n), in um2: squared distance to it; infinite where there is none
    inliers: Ints  # (h,): marks within the tolerance
    # (h,): log10 of the number of arrangements as good that are expected where the marks are scattered at random.
    log_chance: Floats
    alpha: Complexes  # (h,): ``w = alpha z + gamma conj(z) + beta``, with x of ``a`` reversed where ``mirrored``
    gamma: Complexes
    beta: Complexes
    freedom: Floats  # (h,): marks' worth of freedom that the fit had: 2 without stretch, up to 3
    landed: Complexes  # (h, n), in um: marks of ``a`` in the frame of ``b``
    mirrored: Bools  # (h,)
    tests: int  # hypotheses tried

    def take(self, chosen: Ints | Bools) -> Arrangements:
        """Return some of the rows."""
        rows = {name: getattr(self, name)[chosen] for name in _ARRAYS}
        return Arrangements(tests=self.tests, **rows)


_ARRAYS = tuple(f.name for f in fields(Arrangements) if f.name != "tests")


def search(
    a: Complexes,
    b: Complexes,
    scale_tolerance: float,
    tolerance_um: float,
    *,
    hands: Sequence[bool],
    least_share: float | None = None,
    most_tried: int = _MOST_TRIED,
) -> Arrangements | None:
    """Try every two-point hypothesis and refine those at which most marks agree; None where no three do.

    ``a`` is the smaller set; of the ``hands`` True reverses its x. The scale may be :data:`SCALE_SPARE` outside of its
    tolerance. With ``least_share`` only hypotheses with that share of ``a`` are refined, instead of 60 % of the best
    count; beyond ``most_tried``, pairs of ``a`` are thinned out evenly by length.
    """
    from planish.register import _kernels

    pairs = _like_lengths(a, b, scale_tolerance, tolerance_um, most_tried)
    if pairs.start[-1] == 0:
        return None
    reach = REACH * tolerance_um
    wide = reach + 0.5 * STRETCH * float(np.hypot(np.ptp(b.real), np.ptp(b.imag)))
    raster, cells = _raster(b, wide), _cells(b, wide)
    reaches = np.array([wide, 0.5 * (wide + reach), reach, reach, reach])
    # Localisation error that the stretch is weighed against, as a share of the tolerance.
    ridge = (0.16 * tolerance_um / (0.5 * STRETCH)) ** 2
    parts: list[Arrangements] = []
    for hand in hands:
        points = -np.conj(a) if hand else a
        # Only hypotheses with this share of the best count are refined.
        share = 0.6 if least_share is None else 0.0
        counts = _kernels.count_near(points, b, pairs.base, pairs.first, pairs.start, pairs.target, raster, share)
        enough = max(3, int(share * counts.max()), int((least_share or 0.0) * len(a)))
        if a is b and not hand:
            counts[_still(pairs)] = 0
        chosen = np.flatnonzero(counts >= enough)
        if len(chosen) > _MOST_REFINED:
            chosen = np.sort(chosen[np.argsort(-counts[chosen].astype(np.intp), kind="stable")[:_MOST_REFINED]])
        if len(chosen):
            refined = _kernels.refine(
                _seeds(pairs, chosen), points, b, reaches, (0.5 * tolerance_um) ** 2, ridge, *cells
            )
            tests = int(pairs.start[-1]) * len(hands)
            parts += _arrangements(refined, points, b, scale_tolerance, tolerance_um, ridge, hand=hand, tests=tests)
    if len(parts) < 2:
        return parts[0] if parts else None
    joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _ARRAYS}
    return Arrangements(tests=parts[0].tests, **joined)


def _seeds(pairs: _LikePairs, chosen: Ints) -> Ints:
    """Marks ``i, j`` of ``a`` and ``k, q`` of ``b`` that each of the chosen hypotheses lays on one another: (h, 4)."""
    row = np.searchsorted(pairs.start, chosen, side="right") - 1
    half, turned = np.divmod(chosen - pairs.start[row], 2)
    goal = pairs.target[pairs.first[row] + half]
    goal = np.where(turned[:, None] == 1, goal[:, ::-1], goal)
    return np.concatenate([pairs.base[row], goal], axis=1)


def _arrangements(
    refined: tuple[Any, ...], points: Complexes, b: Complexes, scale_tolerance: float, tolerance_um: float,
    ridge: float, *, hand: bool, tests: int,
) -> list[Arrangements]:  # fmt: skip
    """Arrangements of the refined hypotheses whose scale and stretch are possible, each once; none or one table."""
    partner, squares, alpha, gamma, beta, power = refined
    scale = np.abs(alpha)
    count = np.count_nonzero(partner >= 0, axis=1)
    is_possible = (np.abs(scale - 1.0) <= scale_tolerance + SCALE_SPARE) & (count >= 3)
    # Largest stretch that an arrangement may have; a wrong one often needs more.
    is_possible &= np.abs(gamma) <= 0.5 * 0.012 * scale
    _, once = np.unique(partner[is_possible], axis=0, return_index=True)
    rows = np.flatnonzero(is_possible)[once]
    if len(rows) == 0:
        return []
    freedom = np.where(count > 3, 2.0 + power / (power + ridge), 2.0)[rows]
    partner, squares, alpha, gamma, beta, power = (column[rows] for column in refined)
    return [
        Arrangements(
            partner=partner,
            squares=squares,
            inliers=np.count_nonzero(squares <= tolerance_um**2, axis=1).astype(np.intp),
            log_chance=_log_chance(squares, b, tests, tolerance_um, freedom, power),
            alpha=alpha,
            gamma=gamma,
            beta=beta,
            freedom=freedom,
            landed=alpha[:, None] * points + gamma[:, None] * np.conj(points) + beta[:, None],
            mirrored=np.full(len(rows), hand),
            tests=tests,
        )
    ]


def chance_without(arrangements: Arrangements, b: Complexes, shared: Bools, tolerance_um: float) -> Floats:
    """Judge arrangements again without the marks that they share with another; ``shared (h, n)``."""
    squares = np.where(shared, np.inf, arrangements.squares)
    return _log_chance(squares, b, arrangements.tests, tolerance_um, arrangements.freedom, np.zeros(len(squares)))


def extents(b: Complexes) -> Pair:
    """Long and short side of the field of the marks along its own axes, in um."""
    centred = np.stack([b.real - b.real.mean(), b.imag - b.imag.mean()], axis=1)
    axes = np.linalg.eigh(centred.T @ centred)[1]
    sides = np.ptp(centred @ axes, axis=0)
    return float(sides.max()), float(sides.min())


def share_within(radius: Floats, b: Complexes, tolerance_um: float) -> Floats:
    """Probability that a point anywhere in the field lies within ``radius`` of a mark of ``b``."""
    long_side, short_side = extents(b)
    along = np.minimum(1.0, 2 * radius / max(long_side, tolerance_um))
    across = np.minimum(1.0, np.pi / 2 * radius / max(short_side, 1e-300))
    return np.minimum(1.0, len(b) * along * across)


def marks_needed(n: int, b: Complexes, tests: int, tolerance_um: float, log_chance: float) -> int:
    """Smallest number of ``n`` marks whose close agreement chance would not offer; ``n + 1`` where none is enough."""
    share = float(share_within(np.array([0.3 * tolerance_um]), b, tolerance_um)[0])
    for k in range(3 if n == 3 else 4, n + 1):
        value = log10(max(tests, 1) * max(n - 2, 1)) + _log10_choose(n - 2, k - 2) + (k - 2) * log10(share)
        if value <= log_chance:
            return k
    return n + 1


class _LikePairs(NamedTuple):
    """Pairs of marks of like length: row p of ``base`` is laid on rows ``first[p]`` on of ``target``.

    Either end may come first, which gives the hypotheses ``start[p]`` up to ``start[p + 1]``.
    """

    base: Ints  # (p, 2): marks of ``a``
    target: Ints  # (t, 2): marks of ``b``, by length
    first: Ints
    start: Ints


def _like_lengths(a: Complexes, b: Complexes, scale_tolerance: float, tolerance: float, most: int) -> _LikePairs:
    """Find the pairs of ``b`` that are as long as each pair of ``a``."""
    i, j = np.triu_indices(len(a), 1)
    k, q = np.triu_indices(len(b), 1)
    length = np.abs(a[j] - a[i])
    long_enough = length >= 3.0 * tolerance
    i, j, length = i[long_enough], j[long_enough], length[long_enough]
    order = np.argsort(length, kind="stable")
    base, length = np.stack([i, j], axis=1)[order], length[order]
    other = np.abs(b[q] - b[k])
    order = np.argsort(other, kind="stable")
    target, other = np.stack([k, q], axis=1)[order], other[order]
    slack, give = 0.6 * tolerance, scale_tolerance + SCALE_SPARE
    first = np.searchsorted(other, (1.0 - give) * length - slack, side="left")
    last = np.searchsorted(other, (1.0 + give) * length + slack, side="right")
    tried = 2 * int(np.sum(last - first))
    if tried > most:
        thinned = np.unique(np.linspace(0, len(base) - 1, max(1, len(base) * most // tried)).astype(np.intp))
        base, first, last = base[thinned], first[thinned], last[thinned]
    start = np.concatenate([[0], np.cumsum(2 * (last - first))]).astype(np.intp)
    return _LikePairs(base, target, first.astype(np.intp), start)


def _raster(b: Complexes, reach: float) -> tuple[float, float, float, NDArray[np.uint8]]:
    """Raster of the cells within ``reach`` of a mark, roughly: ``x0, y0, size, near``; its border is 0."""
    x0, x1 = b.real.min() - reach, b.real.max() + reach
    y0, y1 = b.imag.min() - reach, b.imag.max() + reach
    size = float(max(reach / 3.0, np.sqrt((x1 - x0) * (y1 - y0) / 1_500_000), max(x1 - x0, y1 - y0) / 20000.0))
    x0, y0 = float(x0 - 2.0 * size), float(y0 - 2.0 * size)
    near = np.zeros((int((y1 - y0) / size) + 3, int((x1 - x0) / size) + 3), np.uint8)
    steps = np.arange(-int(reach / size) - 2, int(reach / size) + 3)
    column, row = (((p - p0) / size).astype(np.intp)[:, None] + steps for p, p0 in ((b.real, x0), (b.imag, y0)))
    dx, dy = x0 + (column + 0.5) * size - b.real[:, None], y0 + (row + 0.5) * size - b.imag[:, None]
    # A cell counts where its middle does, or a little beyond, so that no cell with a good place is lost.
    mark, r, c = np.nonzero(dy[:, :, None] ** 2 + dx[:, None, :] ** 2 <= (reach + 0.5 * size) ** 2)
    near[np.clip(row[mark, r], 1, near.shape[0] - 2), np.clip(column[mark, c], 1, near.shape[1] - 2)] = 1
    return x0, y0, size, near


def _cells(b: Complexes, reach: float) -> tuple[tuple[float, float, float, int, int], Ints, NDArray[np.int32]]:
    """Raster whose cells list the marks within reach: ``x0, y0, size, rows, columns``, then ``start`` and ``index``."""
    x0, x1, y0, y1 = b.real.min(), b.real.max(), b.imag.min(), b.imag.max()
    # Never more than about a million cells, however large the field.
    size = float(max(reach, np.sqrt((x1 - x0 + 4 * reach) * (y1 - y0 + 4 * reach) / 1e6), max(x1 - x0, y1 - y0) / 1e5))
    x0, y0 = float(x0 - 2 * size), float(y0 - 2 * size)
    columns, rows = int((x1 - x0) / size) + 3, int((y1 - y0) / size) + 3
    near = np.arange(-1, 2)
    column, row = (((p - p0) / size).astype(np.intp)[:, None, None] for p, p0 in ((b.real, x0), (b.imag, y0)))
    cell = ((row + near[:, None]) * columns + column + near).reshape(-1)
    start = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=rows * columns))]).astype(np.intp)
    index = (np.argsort(cell, kind="stable") // near.size**2).astype(np.int32)
    return (x0, y0, size, rows, columns), start, index


def _still(pairs: _LikePairs) -> Ints:
    """Hypotheses that leave every mark where it is, where a set is laid on itself."""
    base, target = pairs.base, pairs.target
    code = target[:, 0] * (target.max() + 1) + target[:, 1]
    order = np.argsort(code)
    rows = order[np.searchsorted(code[order], base[:, 0] * (target.max() + 1) + base[:, 1])]
    return (pairs.start[:-1] + 2 * (rows - pairs.first)).astype(np.intp)


def _log_chance(squares: Floats, b: Complexes, tests: int, tolerance: float, freedom: Floats, power: Floats) -> Floats:
    """Return log10 of the expected number of chance arrangements as good as each row.

    The marks that agree best are taken, as many as make chance least likely.
    """
    n = squares.shape[1]
    ordered = np.sort(np.where(squares <= tolerance * tolerance, squares, np.inf), axis=1)
    k = np.arange(1.0, n + 1.0)
    # Fitting makes residuals smaller; a tenth of the tolerance keeps those of exact numbers finite.
    with np.errstate(invalid="ignore"):
        inflated = ordered * k / np.maximum(k - freedom[:, None], 0.5)
        radius = np.sqrt(inflated + (0.08 * tolerance) ** 2)
        share = share_within(radius, b, tolerance)
        # The stretch was free too: as many as can be distinguished count as tests.
        spread = np.sqrt(power / np.maximum(np.sum(np.isfinite(ordered), axis=1), 1))
        stretches = np.where(freedom > 2.0, 0.5 * STRETCH * spread, 0.0)[:, None] / radius
        choices = np.array([_log10_choose(n - 2, int(c) - 2) if c >= 2 else 0.0 for c in k])
        value = (
            log10(max(tests, 1) * max(n - 2, 1)) + choices + (k - 2) * np.log10(share)
            + np.log10(np.maximum(1.0, np.pi * stretches**2))
        )  # fmt: skip
    value = np.where((k >= 3) & np.isfinite(ordered), value, np.inf)
    return value.min(axis=1)


def _log10_choose(n: int, k: int) -> float:
    return (lgamma(n + 1) - lgamma(k + 1) - lgamma(n - k + 1)) / log(10.0)
