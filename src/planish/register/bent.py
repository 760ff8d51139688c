"""A transformation that is affine but for smooth local changes around the marks: images, derivatives, inverse."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planish.core.threads import map_threads
from planish.core.transform import NearSimilarity

Floats = NDArray[np.float64]
Kernel = Callable[[Floats], Floats]

# Points at once, times nodes: what keeps the distances in the cache.
_AT_ONCE = 1 << 18
_FEW = 4  # parts of so many points: below that, starting threads takes longer than the work
_STEPS = 60
# The inverse begins at the nearest image of a grid that reaches this many extents of the marks beyond them.
_AROUND = 1.0
_GRID = 49


class Bent(NearSimilarity):
    """``(1, p') @ affine + sum_i U(|p' - node_i|) bend_i`` with ``p' = (p - source) / size``, for one or more ``U``.

    Attributes
    ----------
    size : float, in um
        Rms distance of the marks from their middle, ``source``.
    nodes : ndarray, shape (n, 2)
        Places of the marks, scaled.
    affine : ndarray, shape (3, 2), in um
        Constant and linear part.
    """

    __slots__ = ()
    size: float
    nodes: Floats
    affine: Floats
    everywhere: ClassVar[bool]
    """Whether the local changes end beside the marks, so that the inverse has a meaning far from them."""

    @abstractmethod
    def bends(self) -> Iterator[tuple[Kernel, Kernel, Floats]]:
        """``U`` of squared distances, its derivative by half of them, and the coefficients (n, 2) in um of each."""

    def __call__(self, points: ArrayLike) -> Floats:
        """Transform points of shape ``(..., 2)``, in um; NaN stays NaN."""
        given = np.asarray(points, dtype=np.float64)
        at = (given.reshape(-1, 2) - self.source) / self.size
        out = self.affine[0] + at @ self.affine[1:]
        step = max(1, _AT_ONCE // len(self.nodes))
        parts = [slice(k, k + step) for k in range(0, len(at), step)]

        def add(part: slice) -> None:
            self.add_bends(at[part], out[part])

        if len(parts) < _FEW:
            for part in parts:
                add(part)
        else:
            map_threads(add, parts)
        return out.reshape(given.shape)

    def add_bends(self, at: Floats, out: Floats) -> None:
        """Add the local changes at scaled points (n, 2) to ``out`` (n, 2), in um."""
        bends = [(value, bend) for value, _, bend in self.bends() if np.any(bend)]
        if bends:
            x, y = (at[:, None, i] - self.nodes[:, i] for i in range(2))
            squares = x**2 + y**2
            for value, bend in bends:
                out += value(squares) @ bend

    def jacobian(self, points: ArrayLike) -> Floats:
        """Derivatives of the image at points ``(..., 2)``: ``(..., 2, 2)``, a row for x and y of the image."""
        given = np.asarray(points, dtype=np.float64)
        at = (given.reshape(-1, 2) - self.source) / self.size
        out = np.broadcast_to(self.affine[1:].T, (len(at), 2, 2)).copy()
        step = max(1, _AT_ONCE // len(self.nodes))
        bends = [(slope, bend) for _, slope, bend in self.bends() if np.any(bend)]
        for k in range(0, len(at) if bends else 0, step):
            x, y = (at[k : k + step, None, i] - self.nodes[:, i] for i in range(2))
            squares = x**2 + y**2
            for slope, bend in bends:
                by = slope(squares)
                out[k : k + step, :, 0] += (by * x) @ bend
                out[k : k + step, :, 1] += (by * y) @ bend
        return (out / self.size).reshape(*given.shape[:-1], 2, 2)

    @property
    def inverse(self) -> Callable[[ArrayLike], Floats]:
        """The transformation back, by Newton's method from the nearest image of a grid; NaN where it finds no point."""
        return _Back(self)


class _Back:
    """The way back through a bent map: where to begin is worked out once."""

    def __init__(self, bent: Bent) -> None:
        from scipy.spatial import KDTree

        nodes = bent.nodes * bent.size + np.array(bent.source)
        low, high = nodes.min(axis=0), nodes.max(axis=0)
        self.bent, self.around = bent, _AROUND * float(np.max(high - low))
        self.low, self.high = low - self.around, high + self.around
        axes = [np.linspace(a, b, _GRID) for a, b in zip(self.low, self.high, strict=True)]
        self.grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        self.images, self.slopes = bent(self.grid), bent.jacobian(self.grid)
        self.tree, self.largest = KDTree(self.images), float(np.abs(self.images).max())

    def __call__(self, points: ArrayLike) -> Floats:
        """Take points ``(..., 2)`` back, in um; NaN where there is none."""
        given = np.asarray(points, dtype=np.float64)
        wanted = given.reshape(-1, 2)
        found = np.full(wanted.shape, np.nan)
        here = np.isfinite(wanted).all(axis=1)
        if here.any():
            found[here] = self._newton(wanted[here])
        return found.reshape(given.shape)

    def _newton(self, wanted: Floats) -> Floats:
        bent = self.bent
        nearest = np.asarray(self.tree.query(wanted)[1])
        step = _solve(self.slopes[nearest], self.images[nearest] - wanted)
        at = self.grid[nearest] - np.clip(step, -0.125 * self.around, 0.125 * self.around)
        if bent.everywhere:
            edge = np.any((self.grid[nearest] == self.low) | (self.grid[nearest] == self.high), axis=1)
            at[edge] = (wanted[edge] - bent.affine[0]) @ np.linalg.inv(bent.affine[1:]) * bent.size + bent.source
        error = bent(at) - wanted
        # What rounding leaves of the sum of kernels.
        enough = 4e-15 * (self.largest + np.abs(wanted).max())
        active = np.arange(len(wanted))
        for _ in range(_STEPS):
            now = at[active]
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                step = _solve(bent.jacobian(now), error[active])
            # Far from the answer a whole step may overshoot a bend.
            length = np.linalg.norm(step, axis=1, keepdims=True)
            step *= np.minimum(1.0, 0.125 * self.around / np.maximum(length, 1e-300))
            trial = now - step
            missed = bent(trial) - wanted[active]
            before, after = (np.linalg.norm(e, axis=1) for e in (error[active], missed))
            good = after < before
            at[active[good]], error[active[good]] = trial[good], missed[good]
            # Where the whole step does not help, a quarter of it may.
            worse = np.flatnonzero(~good & (before > enough))
            if worse.size:
                trial = now[worse] - 0.25 * step[worse]
                missed = bent(trial) - wanted[active[worse]]
                better = np.linalg.norm(missed, axis=1) < before[worse]
                at[active[worse[better]]], error[active[worse[better]]] = trial[better], missed[better]
                good[worse[better]] = True
            left = np.linalg.norm(error[active], axis=1)
            active = active[good & (left > enough)]
            if not active.size:
                break
        outside = not bent.everywhere and np.any((at < self.low) | (at > self.high), axis=1)
        at[outside | (np.linalg.norm(error, axis=1) > 100 * enough)] = np.nan
        return at


def _solve(jacobian: Floats, error: Floats) -> Floats:
    """Solve 2 x 2 systems; a singular one gives what is not finite."""
    a, b, c, d = jacobian[:, 0, 0], jacobian[:, 0, 1], jacobian[:, 1, 0], jacobian[:, 1, 1]
    det = a * d - b * c
    x = (d * error[:, 0] - b * error[:, 1]) / det
    y = (a * error[:, 1] - c * error[:, 0]) / det
    return np.nan_to_num(np.stack([x, y], axis=1), nan=0.0, posinf=0.0, neginf=0.0)
