"""Paired marks and how much each is worth: what a fit starts from, checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from planish.core.errors import MarkError
from planish.core.transform import are_known
from planish.core.typing import Bools, Complexes, Floats, Ints

# Marks closer together than this share of their distance from the origin cannot be distinguished in
# float64.
COINCIDENT = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pairs:
    """Marks of both sides, in um, and the information on each pair."""

    moving: Floats  # (n, 2), in um: places in the two maps
    fixed: Floats
    # (n, 2, 2): inverse covariance of ``fixed - f(moving)``, up to one factor common to all; zero
    # leaves a pair out.
    information: Floats

    def __len__(self) -> int:
        """Count the pairs."""
        return len(self.moving)

    @property
    def weights(self) -> Floats:
        """Half the trace of the information, shape (n,).

        It is the weight of a pair whose error has no direction.
        """
        xx, _, _, yy = self.information.reshape(-1, 4).T
        return 0.5 * (xx + yy)

    @property
    def share(self) -> Floats:
        """Weights whose sum is 1."""
        return self.weights / np.sum(self.weights)

    @property
    def isotropic(self) -> bool:
        """True where no pair knows a direction better than the other."""
        xx = self.information[:, :1, :1]
        return np.array_equal(self.information, xx * np.eye(2))

    def take(self, which: Ints | Bools) -> Pairs:
        """Return some of the pairs, by their rows or a mask (n,)."""
        moving = self.moving[which]
        fixed = self.fixed[which]
        return Pairs(moving=moving, fixed=fixed, information=self.information[which])

    def whitening(self) -> Floats:
        """Return ``U`` of shape (n, 2, 2) with ``U.T @ U`` the information.

        ``U @ error`` has equal, free parts. ``U`` is upper triangular, as of Cholesky, which would
        refuse pairs without any information.
        """
        xx, xy, _, yy = self.information.reshape(-1, 4).T
        a = np.sqrt(xx)
        with np.errstate(invalid="ignore", divide="ignore"):
            b = np.where(a > 0, xy / a, 0.0)
        c = np.sqrt(np.maximum(yy - b * b, 0.0))
        return _blocks(a, b, 0.0 * c, c)

    def frame(self) -> tuple[Floats, float]:
        """Return middle (2,) and rms distance from it of the moving marks, in um.

        Coordinates near 1 start here.
        """
        middle = self.share @ self.moving
        squares = np.sum((self.moving - middle) ** 2, axis=1)
        return middle, float(np.sqrt(self.share @ squares))


def _blocks(a: Floats, b: Floats, c: Floats, d: Floats) -> Floats:
    """Matrices ``[[a, b], [c, d]]`` (n, 2, 2) of their elements (n,)."""
    elements = np.stack([a, b, c, d], axis=-1)
    return elements.reshape(-1, 2, 2)


def whitened(whitening: Floats, rows: Floats) -> Floats:
    """Multiply the 2 x 2 blocks (n, 2, 2) of a whitening to rows (2n, k)."""
    blocks = rows.reshape(len(whitening), 2, -1)
    return (whitening @ blocks).reshape(rows.shape)


def solved(matrices: Floats, vectors: Floats) -> Floats:
    """Solve linear equations for vectors (..., p)."""
    solutions = np.linalg.solve(matrices, vectors[..., None])
    return np.asarray(solutions[..., 0], dtype=np.float64)


def on_both_axes(rows: Floats) -> Floats:
    """Repeat rows (n, k) for x and y: (2n, 2k)."""
    repeated = np.kron(rows, np.eye(2))
    return np.asarray(repeated, dtype=np.float64)


def squared_distances(places: Floats, targets: Floats) -> Floats:
    """Squares of the distances (n, m) of places (n, 2) from targets (m, 2)."""
    offsets = places[:, None] - targets
    return np.sum(offsets**2, axis=-1)


def inverse_of(blocks: Floats) -> Floats:
    """Inverse of symmetric 2 x 2 blocks (n, 2, 2); NaN stays NaN."""
    a, b, _, c = blocks.reshape(-1, 4).T
    determinants = a * c - b * b
    return _blocks(c, -b, -b, a) / determinants[:, None, None]


def as_complex(points: Floats, mirrored: bool) -> Complexes:
    """Points as ``x + iy``, or ``-x + iy`` where mirrored."""
    x = points[..., 0]
    y = points[..., 1]
    return (-x if mirrored else x) + 1j * y


def check_pairs(
    moving: ArrayLike, fixed: ArrayLike, weights: ArrayLike | None
) -> tuple[Pairs, Ints]:
    """Bring marks and weights into one form; MarkError names all their faults.

    These: wrong shapes, unequal counts, values that are not finite, weights that are none, fewer
    than two pairs, a mark with two partners, all marks at one place. The arguments are as for
    :func:`planish.register.fit_transform`. A pair given again counts once: the rows of the others
    are returned, and their information is zero.
    """
    source = points_of(moving, "moving marks")
    target = points_of(fixed, "fixed marks")
    sides = {"moving": source, "fixed": target}
    if len(source) != len(target):
        raise MarkError(
            f"{len(source)} moving and {len(target)} fixed marks given; every mark needs its"
            " partner."
        )
    faults: list[str] = []
    information = _information(weights, len(source), faults)
    for name, points in sides.items():
        nonfinite_rows = np.flatnonzero(~are_known(points))
        if nonfinite_rows.size:
            faults.append(
                f"{name} mark{'s' * (nonfinite_rows.size > 1)} {listed(nonfinite_rows)} not finite"
            )
    if faults:
        raise MarkError(f"The marks cannot be used: {'; '.join(faults)}. Correct or remove them.")
    pairs = Pairs(moving=source, fixed=target, information=information)
    used = np.flatnonzero(pairs.weights > 0)
    if used.size < 2:
        raise MarkError(
            f"{used.size} pair{'s' * (used.size != 1)} of marks given, a transformation needs 2,"
            f" and 3 to estimate its error. Add {2 - used.size} or more, far apart."
        )
    coincidence_um: dict[str, float] = {}  # within which two marks of a side are one
    for name, points in sides.items():
        used_points = points[used]
        largest_um = max(1.0, float(np.abs(used_points).max()))
        coincidence_um[name] = COINCIDENT * largest_um
        if np.ptp(used_points, axis=0).max() <= coincidence_um[name]:
            x, y = used_points[0]
            raise MarkError(
                f"All {used.size} {name} marks lie at ({x:g}, {y:g}) um; at least two places are"
                " needed."
            )
    repeated = _repeated(sides, used, coincidence_um)
    pairs.information[repeated] = 0.0
    return pairs, repeated


def _repeated(sides: dict[str, Floats], used: Ints, coincidence_um: dict[str, float]) -> Ints:
    """Rows that repeat earlier ones; MarkError where they do so on one side alone.

    ``sides`` are the places (n, 2) by the side's name, ``used`` the rows that count, and
    ``coincidence_um`` the distances within which two marks of a side are one.
    """
    from scipy.spatial import KDTree

    repeated_rows: set[int] = set()
    for name, other_name in (("moving", "fixed"), ("fixed", "moving")):
        points = sides[name]
        partners = sides[other_name]
        coincident = KDTree(points[used]).query_pairs(coincidence_um[name])
        for a, b in sorted(coincident):
            first_row = used[a]
            second_row = used[b]
            distance = float(np.linalg.norm(partners[first_row] - partners[second_row]))
            if distance > coincidence_um[other_name]:
                x, y = points[first_row]
                raise MarkError(
                    f"Marks {first_row} and {second_row} lie at one place on the {name} side,"
                    f" ({x:g}, {y:g}) um, and {distance:.4g} um apart on the other. One of them is"
                    " wrong: correct or remove it."
                )
            repeated_rows.add(int(second_row))
    return np.array(sorted(repeated_rows), dtype=np.intp)


def listed(rows: Sequence[int] | Ints) -> str:
    """Numbers of a few marks, counted from 0, as in an array or a table without its header."""
    numbers = ", ".join(str(int(k)) for k in rows[:8])
    return numbers + ", ..." * (len(rows) > 8)


def weighted_rms(lengths: Floats, weights: Floats) -> float:
    """Root of the weighted mean square.

    What has no weight counts for nothing, also where it is NaN.
    """
    used = weights > 0
    square_sum = np.sum(weights[used] * lengths[used] ** 2)
    return float(np.sqrt(square_sum / np.sum(weights)))


def points_of(marks: ArrayLike, name: str) -> Floats:
    """Return marks as (n, 2) float64; MarkError for another shape."""
    points = np.array(marks, dtype=np.float64)
    if points.size == 0:
        return np.empty((0, 2))
    if points.ndim != 2 or points.shape[1] != 2:
        transpose = " Transpose them." * (points.ndim == 2 and points.shape[0] == 2)
        raise MarkError(
            f"The {name} have shape {points.shape}; (n, 2) is needed, one (x, y) in um a"
            f" row.{transpose}"
        )
    return points


def _information(weights: ArrayLike | None, n: int, faults: list[str]) -> Floats:
    """Information (n, 2, 2) of pairs with weights (n,) or covariances (n, 2, 2); None: all alike.

    What is wrong goes into ``faults``; the information of wrong covariances is zero.
    """
    stated = np.ones(n) if weights is None else weights
    weights = np.array(stated, dtype=np.float64)
    if weights.shape == (n,):
        if not np.all(np.isfinite(weights) & (weights >= 0.0)):
            faults.append("weights have to be finite and not negative")
        return weights[:, None, None] * np.eye(2)
    if weights.shape != (n, 2, 2):
        faults.append(
            f"the weights have shape {weights.shape}, {n} marks need ({n},), or ({n}, 2, 2) for"
            " covariances"
        )
        return np.zeros((n, 2, 2))
    a, b, c, d = weights.reshape(n, 4).T
    largest = np.maximum(a, d)
    is_covariance = np.isfinite(weights).all(axis=(1, 2))
    with np.errstate(invalid="ignore"):
        determinants = a * d - b**2
        is_covariance &= (a > 0) & (determinants > 1e-12 * largest**2)
        is_covariance &= np.abs(b - c) <= 1e-9 * largest
    bad_rows = np.flatnonzero(~is_covariance)
    if bad_rows.size:
        faults.append(f"covariance of mark {listed(bad_rows)} not symmetric and positive")
        return np.zeros((n, 2, 2))
    return inverse_of(0.5 * (weights + weights.swapaxes(1, 2)))


def choose_hand(pairs: Pairs, mirrored: bool | None) -> bool:
    """Return ``mirrored`` or, where None, whether the marks fit better with one side turned over.

    MarkError where they only fit with the other handedness: columns swapped on one side, or an
    undeclared mirror.
    """
    share = pairs.share
    w = as_complex(pairs.fixed, False)
    w = w - share @ w
    # Of either hand, the similarity that fits best and what it leaves.
    hand_rms: list[float] = []
    rotations: list[complex] = []
    for is_mirrored in (False, True):
        z = as_complex(pairs.moving, is_mirrored)
        z = z - share @ z
        product = np.sum(share * z.conj() * w)
        rotation = product / np.sum(share * np.abs(z) ** 2)
        mean_square = np.sum(share * np.abs(w - rotation * z) ** 2)
        rotations.append(rotation)
        hand_rms.append(float(np.sqrt(mean_square)))
    if mirrored is None:
        return hand_rms[True] < hand_rms[False]
    rms_um = hand_rms[mirrored]
    other_um = hand_rms[not mirrored]
    spread = np.sqrt(share @ np.abs(w) ** 2)
    # The other hand has to fit five times as well, and this one has to miss by 5 % of the marks'
    # spread, to be refused.
    if len(pairs) < 3 or rms_um < 0.05 * spread or other_um > 0.2 * rms_um:
        return mirrored
    # Exchanged columns are a mirror image that is turned by -90 degrees.
    other_rotation = rotations[not mirrored]
    rotation = other_rotation / abs(other_rotation)
    off_exchange = max(abs(rotation.real), abs(rotation.imag + 1.0))
    is_exchanged = not mirrored and off_exchange < 0.2
    exchange_text = "x and y are exchanged on one side: exchange the two columns of that table"
    declare_text = (
        "one map shows the other side: declare it as mirrored (mirrored=True, or `mirror=True`)"
    )
    if mirrored:
        declare_text = (
            "the maps are not mirrored after all: leave out mirrored=True, or `mirror=True`"
        )
    first_text = declare_text
    second_text = exchange_text
    if is_exchanged:
        first_text = exchange_text
        second_text = declare_text
    raise MarkError(
        f"The marks disagree by {rms_um:.3g} um rms as they are and by {other_um:.3g} um rms with"
        f" the handedness of one side reversed. Probably {first_text}. If not, {second_text}."
    )
