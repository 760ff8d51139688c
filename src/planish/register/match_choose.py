"""The best arrangement of two sets of marks, the best different one, and the pairs of the best."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planish.core.typing import Bools, Floats
from planish.register.match_search import Arrangements, Complexes, Ints, chance_without, search
from planish.register.pairs import as_complex

# Of the marks of the smaller side that lie in the field of the other, this share has to agree.
_LEAST_SHARE = 0.35
# A pair this many times further apart than the others are is not one, however wide the tolerance.
_OUTLYING = 5.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Choice:
    """The best arrangement, in row ``best`` of all that were found, of two sides, whichever of them is larger.

    ``swapped`` says that the smaller side is the second one; ``pairs`` (k, 2) hold the row of the first side and of the
    second, sorted by the first; ``log_chance`` is log10 of how many such arrangements chance would offer,
    ``second_log_chance`` that of the best different match, in which ``second_best`` marks agree.
    """

    arrangements: Arrangements
    best: int
    swapped: bool
    small: Complexes
    large: Complexes
    pairs: Ints
    log_chance: float
    second_log_chance: float
    second_best: int

    @property
    def mirrored(self) -> bool:
        """True where one side is turned over."""
        return bool(self.arrangements.mirrored[self.best])

    @property
    def needed(self) -> int:
        """Number of marks that have to agree at least."""
        if len(self.small) == 3:
            return 3
        in_common_field = np.count_nonzero(_inside(self.arrangements.landed[self.best], self.large, 0.05))
        return max(4, int(np.ceil(_LEAST_SHARE * in_common_field)))

    def together(self) -> tuple[Complexes, tuple[int, int]]:
        """All marks of the field that both sides show, first the pairs; and how many each side alone shows."""
        landed = self.arrangements.landed[self.best]
        rows, columns = self.pairs.T[::-1] if self.swapped else self.pairs.T
        lonely, other = np.delete(landed, rows), np.delete(self.large, columns)
        # Marks of a larger map are no evidence about a smaller one.
        alone = [
            points[_inside(points, self.large, 0.15) & _inside(points, landed, 0.15)] for points in (lonely, other)
        ]
        return np.concatenate([self.large[columns], *alone]), (len(alone[0]), len(alone[1]))


def choose(
    source: Floats, target: Floats, scale_tolerance: float, tolerance_um: float, *, hands: tuple[bool, ...]
) -> Choice | None:
    """Return the best arrangement of three or more marks a side, (n, 2) and (m, 2) in um; None where none agree."""
    swapped = len(source) > len(target)
    a, b = (as_complex(p, False) for p in ((target, source) if swapped else (source, target)))
    arrangements = search(a, b, scale_tolerance, tolerance_um, hands=hands)
    if arrangements is None:
        return None
    misfit = np.sum(np.minimum(arrangements.squares, tolerance_um**2), axis=1)
    best = int(np.lexsort((misfit, arrangements.log_chance))[0])
    rival_chance, rival_count = _rival(arrangements, best, b, tolerance_um)
    squares = arrangements.squares[best]
    rows = np.flatnonzero(squares <= _gate_um(squares, float(arrangements.freedom[best]), tolerance_um) ** 2)
    pairs = np.stack([rows, arrangements.partner[best][rows].astype(np.intp)], axis=1)
    pairs = pairs[:, ::-1] if swapped else pairs
    return Choice(
        arrangements=arrangements,
        best=best,
        swapped=swapped,
        small=a,
        large=b,
        pairs=np.ascontiguousarray(pairs[np.argsort(pairs[:, 0])]),
        log_chance=float(arrangements.log_chance[best]),
        second_log_chance=rival_chance,
        second_best=rival_count,
    )


def _rival(arrangements: Arrangements, best: int, b: Complexes, tolerance: float) -> tuple[float, int]:
    """Give log10 of how often chance offers the best different arrangement, and the marks that agree in it."""
    used = arrangements.squares[best] <= tolerance * tolerance
    moved = np.max(np.abs(arrangements.landed[:, used] - arrangements.landed[best, used]), axis=1)
    turned_over = arrangements.mirrored != arrangements.mirrored[best]
    rivals = arrangements.take(turned_over | (moved > 2.0 * tolerance))
    if len(rivals.inliers) == 0:
        return np.inf, 0
    # Pairs that both arrangements share support neither, unless one of the two is turned over.
    over = (rivals.mirrored != arrangements.mirrored[best])[:, None]
    shared = (rivals.partner == arrangements.partner[best]) & used & ~over
    chance = chance_without(rivals, b, shared, tolerance)
    first = int(np.lexsort((-rivals.inliers, chance))[0])
    if np.isfinite(chance[first]):
        return float(chance[first]), int(rivals.inliers[first])
    return np.inf, int(rivals.inliers.max())


def _gate_um(squares: Floats, freedom: float, tolerance: float) -> float:
    """Distance within which marks are pairs: the tolerance, or less where the others agree much better."""
    agreeing = squares[squares <= tolerance * tolerance]
    # The median distance of a two-dimensional normal scatter is 1.18 standard deviations.
    scatter = np.sqrt(np.median(agreeing) * len(agreeing) / max(len(agreeing) - freedom, 1.0)) / 1.18
    return float(min(tolerance, _OUTLYING * scatter + 0.1 * tolerance))


def _inside(points: Complexes, around: Complexes, border: float) -> Bools:
    """Mask of the points in the rectangle around others, widened by a share of its longer side."""
    x0, x1, y0, y1 = around.real.min(), around.real.max(), around.imag.min(), around.imag.max()
    extra = border * max(x1 - x0, y1 - y0)
    inside_x = (points.real >= x0 - extra) & (points.real <= x1 + extra)
    return inside_x & (points.imag >= y0 - extra) & (points.imag <= y1 + extra)
