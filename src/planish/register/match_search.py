"""All arrangements of one set of marks on another, and how likely chance would offer each.

Pairs of marks on one side are laid on all pairs of like length on the other; the marks that then agree are counted,
and the best are refitted with a little stretch allowed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from math import lgamma, log, log10

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Ints = NDArray[np.intp]
Bools = NDArray[np.bool_]

# Arrangements whose marks lie this many tolerances off are followed, so that a slightly displaced rival is noticed.
REACH = 1.6
# Largest difference of stretch between two directions that the search follows: humidity, a lens.
STRETCH = 0.005
# Largest stretch that an arrangement may have; a wrong one often needs more.
_MOST_STRETCH = 0.012
# Scales so far outside the tolerance are still followed: they are named, and they stop worse ones being taken.
SCALE_SPARE = 0.01
# Localisation error that the stretch is weighed against, as a share of the tolerance.
_ERROR_SHARE = 0.16
# Hypotheses tried, hypotheses refined, cells of the raster.
_MOST_TRIED = 40_000
_MOST_REFINED = 400
_MOST_CELLS = 1_500_000
# Only hypotheses with this share of the best count are refined.
_SHARE = 0.6


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

    base, target, first, start = _like_lengths(a, b, scale_tolerance, tolerance_um, most_tried)
    if start[-1] == 0:
        return None
    low = np.array([b.real.min(), b.imag.min()])
    diagonal = float(np.hypot(*(np.array([b.real.max(), b.imag.max()]) - low)))
    hold = REACH * tolerance_um
    wide = hold + 0.5 * STRETCH * diagonal
    raster = _raster(b, wide)
    cells = _cells(b, wide)
    reaches = np.array([wide, 0.5 * (wide + hold), hold, hold, hold])
    ridge = (_ERROR_SHARE * tolerance_um / (0.5 * STRETCH)) ** 2
    parts: list[Arrangements] = []
    for hand in hands:
        points = -np.conj(a) if hand else a
        share = _SHARE if least_share is None else 0.0
        counts = _kernels.count_near(points, b, base, first, start, target, raster, share)
        enough = max(3, int(share * counts.max()), int((least_share or 0.0) * len(a)))
        if a is b and not hand:
            counts[_still(base, target, first, start)] = 0
        chosen = np.flatnonzero(counts >= enough)
        if len(chosen) > _MOST_REFINED:
            chosen = np.sort(chosen[np.argsort(-counts[chosen].astype(np.intp), kind="stable")[:_MOST_REFINED]])
        if len(chosen) == 0:
            continue
        row = np.searchsorted(start, chosen, side="right") - 1
        half, turned = np.divmod(chosen - start[row], 2)
        goal = target[first[row] + half]
        goal = np.where(turned[:, None] == 1, goal[:, ::-1], goal)
        seeds = np.concatenate([base[row], goal], axis=1)
        partner, squares, alpha, gamma, beta, power = _kernels.refine(
            seeds, points, b, reaches, (0.5 * tolerance_um) ** 2, ridge, *cells
        )
        scale = np.abs(alpha)
        found = np.count_nonzero(partner >= 0, axis=1)
        fine = (np.abs(scale - 1.0) <= scale_tolerance + SCALE_SPARE) & (found >= 3)
        fine &= np.abs(gamma) <= 0.5 * _MOST_STRETCH * scale
        _, once = np.unique(partner[fine], axis=0, return_index=True)
        keep = np.flatnonzero(fine)[once]
        if len(keep) == 0:
            continue
        freedom = np.where(found > 3, 2.0 + power / (power + ridge), 2.0)[keep]
        log_chance = _log_chance(squares[keep], b, int(start[-1]) * len(hands), tolerance_um, freedom, power[keep])
        parts.append(
            Arrangements(
                partner=partner[keep],
                squares=squares[keep],
                inliers=np.count_nonzero(squares[keep] <= tolerance_um**2, axis=1).astype(np.intp),
                log_chance=log_chance,
                alpha=alpha[keep],
                gamma=gamma[keep],
                beta=beta[keep],
                freedom=freedom,
                landed=alpha[keep, None] * points + gamma[keep, None] * np.conj(points) + beta[keep, None],
                mirrored=np.full(len(keep), hand),
                tests=int(start[-1]) * len(hands),
            )
        )
    if len(parts) < 2:
        return parts[0] if parts else None
    joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _ARRAYS}
    return Arrangements(tests=parts[0].tests, **joined)


def chance_without(found: Arrangements, b: Complexes, shared: Bools, tolerance_um: float) -> Floats:
    """Judge arrangements again without the marks that they share with another; ``shared (h, n)``."""
    squares = np.where(shared, np.inf, found.squares)
    return _log_chance(squares, b, found.tests, tolerance_um, found.freedom, np.zeros(len(squares)))


def extents(b: Complexes) -> tuple[float, float]:
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


def _like_lengths(
    a: Complexes, b: Complexes, scale_tolerance: float, tolerance: float, most: int
) -> tuple[Ints, Ints, Ints, Ints]:
    """Pairs of ``a``, pairs of ``b`` by length, and from where to where in the latter the lengths agree."""
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
        some = np.unique(np.linspace(0, len(base) - 1, max(1, len(base) * most // tried)).astype(np.intp))
        base, first, last = base[some], first[some], last[some]
    start = np.concatenate([[0], np.cumsum(2 * (last - first))]).astype(np.intp)
    return base, target, first.astype(np.intp), start


def _raster(b: Complexes, reach: float) -> tuple[float, float, float, NDArray[np.uint8]]:
    """Which cells of a raster lie within ``reach`` of a mark, roughly: ``x0, y0, size, near``; its border is 0."""
    x0, x1 = b.real.min() - reach, b.real.max() + reach
    y0, y1 = b.imag.min() - reach, b.imag.max() + reach
    size = float(max(reach / 3.0, np.sqrt((x1 - x0) * (y1 - y0) / _MOST_CELLS), max(x1 - x0, y1 - y0) / 20000.0))
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


def _still(base: Ints, target: Ints, first: Ints, start: Ints) -> Ints:
    """Hypotheses that leave every mark where it is, where a set is laid on itself."""
    code = target[:, 0] * (target.max() + 1) + target[:, 1]
    order = np.argsort(code)
    at = order[np.searchsorted(code[order], base[:, 0] * (target.max() + 1) + base[:, 1])]
    return (start[:-1] + 2 * (at - first)).astype(np.intp)


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
