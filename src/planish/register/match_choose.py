"""Which arrangement of two sets of marks is the best, which different one comes next, and what the best one pairs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planish.core.errors import MarkError
from planish.core.transform import Similarity
from planish.register.match_search import Arrangements, Complexes, as_complex, chance_without, search
from planish.register.pairs import Pairs
from planish.register.similarity import SimilarityModel

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]

# A chance agreement as good as the one accepted is expected in fewer than 10**-3 of all searches.
ACCEPTED_LOG_CHANCE = -3.0
# A different arrangement has to be this much likelier to be chance, as log10.
MARGIN = 3.0
# Of the marks of the smaller side that lie in the field of the other, this share has to agree.
LEAST_SHARE = 0.35
# A pair this many times further apart than the others are is not one, however wide the tolerance.
_OUTLYING = 5.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Choice:
    """The best arrangement of two sides, whichever of them is larger.

    Attributes
    ----------
    found : Arrangements
        All of them, from the smaller side to the larger.
    best : int
        Row of the best.
    swapped : bool
        Whether the smaller side is the second one.
    small, large : ndarray of complex, in um
    pairs : ndarray of int, shape (k, 2)
        Row of the first side, row of the second; sorted by the first.
    log_chance, second_log_chance : float
        log10 of how many such arrangements chance would offer; the second is the best different match.
    second_best : int
        Marks that agree in it; 0 where there is none.
    """

    found: Arrangements
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
        """Whether one side is turned over."""
        return bool(self.found.mirrored[self.best])

    @property
    def landed(self) -> Complexes:
        """Marks of the smaller side in the frame of the larger."""
        return self.found.landed[self.best]

    @property
    def in_common_field(self) -> int:
        """How many marks of the smaller side lie in the rectangle around the marks of the larger."""
        return int(np.count_nonzero(_inside(self.landed, self.large, 0.05)))

    @property
    def needed(self) -> int:
        """How many marks have to agree at least."""
        n = len(self.small)
        return 3 if n == 3 else max(4, int(np.ceil(LEAST_SHARE * self.in_common_field)))

    def scale_fault(self, scale: float, tolerance: float) -> str:
        """Sentence where a scale is too far off; empty otherwise."""
        if abs(scale - 1.0) <= tolerance:
            return ""
        return (
            f"{len(self.pairs)} match, but at a scale of {scale:.4f}, which is {100 * abs(scale - 1.0):.1f} % off the "
            f"calibration; {100 * tolerance:.3g} % are allowed. Check the pixel and voxel sizes."
        )

    def together(self) -> tuple[Complexes, tuple[int, int]]:
        """All marks of the field that both sides show, first the pairs; and how many each side alone shows."""
        rows = self.pairs[:, 1 if self.swapped else 0]
        columns = self.pairs[:, 0 if self.swapped else 1]
        lonely = np.ones(len(self.small), dtype=np.bool_)
        lonely[rows] = False
        other = np.ones(len(self.large), dtype=np.bool_)
        other[columns] = False
        # Marks of a larger map are no evidence about a smaller one.
        alone = [
            points[_inside(points, self.large, 0.15) & _inside(points, self.landed, 0.15)]
            for points in (self.landed[lonely], self.large[other])
        ]
        return np.concatenate([self.large[columns], *alone]), (len(alone[0]), len(alone[1]))


def choose(
    source: Floats, target: Floats, *, scale_tolerance: float, tolerance_um: float, hands: tuple[bool, ...]
) -> Choice | None:
    """Return the best arrangement and its rival, or None where no three marks agree.

    Parameters
    ----------
    source, target : ndarray, shape (n, 2) and (m, 2), in um
        At least three marks each.
    """
    swapped = len(source) > len(target)
    a, b = (as_complex(p) for p in ((target, source) if swapped else (source, target)))
    found = search(a, b, scale_tolerance=scale_tolerance, tolerance_um=tolerance_um, hands=hands)
    if found is None:
        return None
    best = int(np.lexsort((np.sum(np.minimum(found.squares, tolerance_um**2), axis=1), found.log_chance))[0])
    rival_chance, rival_count = _rival(found, best, b, tolerance_um)
    squares = found.squares[best]
    rows = np.flatnonzero(squares <= _gate_um(squares, float(found.freedom[best]), tolerance_um) ** 2)
    pairs = np.stack([rows, found.partner[best][rows].astype(np.intp)], axis=1)
    pairs = pairs[:, ::-1] if swapped else pairs
    return Choice(
        found=found,
        best=best,
        swapped=swapped,
        small=a,
        large=b,
        pairs=np.ascontiguousarray(pairs[np.argsort(pairs[:, 0])]),
        log_chance=float(found.log_chance[best]),
        second_log_chance=rival_chance,
        second_best=rival_count,
    )


def fit_similarity(source: Floats, target: Floats, *, mirrored: bool) -> tuple[Similarity, float]:
    """Least-squares similarity through pairs ``(k, 2)`` in um, and the rms residual."""
    information = np.broadcast_to(np.eye(2), (len(source), 2, 2))
    transform = SimilarityModel().fit(Pairs(moving=source, fixed=target, information=information), mirrored)
    return transform, float(np.sqrt(np.mean(np.sum((transform(source) - target) ** 2, axis=1))))


def checked_points(marks: ArrayLike, name: str) -> Floats:
    """Return marks as ``(n, 2)`` float64, or name their faults."""
    points = np.array(marks, dtype=np.float64)
    if points.size == 0:
        return np.empty((0, 2))
    if points.ndim != 2 or points.shape[1] != 2:
        raise MarkError(f"The marks of the {name} have shape {points.shape}; (n, 2) is needed, one (x, y) in um a row.")
    bad = np.flatnonzero(~np.all(np.isfinite(points), axis=1))
    if bad.size:
        raise MarkError(
            f"Position of mark {', '.join(str(i) for i in bad[:8])} (counted from 0) of the {name} is not finite. "
            "Leave it out, or correct it."
        )
    return points


def _rival(found: Arrangements, best: int, b: Complexes, tolerance: float) -> tuple[float, int]:
    """How likely chance is to offer the best different arrangement, and the marks that agree in it."""
    used = found.squares[best] <= tolerance * tolerance
    moved = np.max(np.abs(found.landed[:, used] - found.landed[best, used]), axis=1)
    turned_over = found.mirrored != found.mirrored[best]
    rest = found.take(turned_over | (moved > 2.0 * tolerance))
    if len(rest.inliers) == 0:
        return np.inf, 0
    # Pairs that both arrangements share support neither, unless one of the two is turned over.
    over = (rest.mirrored != found.mirrored[best])[:, None]
    shared = (rest.partner == found.partner[best]) & used & ~over
    chance = chance_without(rest, b, shared, tolerance)
    first = int(np.lexsort((-rest.inliers, chance))[0])
    if np.isfinite(chance[first]):
        return float(chance[first]), int(rest.inliers[first])
    return np.inf, int(rest.inliers.max())


def _gate_um(squares: Floats, freedom: float, tolerance: float) -> float:
    """Distance within which marks are pairs: the tolerance, or less where the others agree much better."""
    held = squares[squares <= tolerance * tolerance]
    # The median distance of a two-dimensional normal scatter is 1.18 standard deviations.
    scatter = np.sqrt(np.median(held) * len(held) / max(len(held) - freedom, 1.0)) / 1.18
    return float(min(tolerance, _OUTLYING * scatter + 0.1 * tolerance))


def _inside(points: Complexes, around: Complexes, border: float) -> NDArray[np.bool_]:
    """Whether points lie in the rectangle around others, widened by a share of its longer side."""
    x0, x1, y0, y1 = around.real.min(), around.real.max(), around.imag.min(), around.imag.max()
    extra = border * max(x1 - x0, y1 - y0)
    inside_x = (points.real >= x0 - extra) & (points.real <= x1 + extra)
    return inside_x & (points.imag >= y0 - extra) & (points.imag <= y1 + extra)
