"""The thin-plate spline as a transformation: its images, derivatives and inverse."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planish.core.transform import NearSimilarity, Pair

Floats = NDArray[np.float64]

# Points at once, times nodes: what keeps the distances in the cache.
_AT_ONCE = 1 << 20
_STEPS = 60
# The inverse is searched up to this many extents of the marks beyond them.
_AROUND = 1.0
_GRID = 49


def bending(squares: Floats) -> Floats:
    """The kernel ``r**2 log r`` of squared distances."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(squares > 0, 0.5 * squares * np.log(squares), 0.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ThinPlate(NearSimilarity):
    """An affine map and smooth local changes around the marks: ``(1, p') @ affine + sum_i U(|p' - node_i|) bend_i``.

    With ``U(r) = r**2 log r`` and ``p' = (p - source) / size``.

    References
    ----------
    Wahba (1990), Spline Models for Observational Data, doi:10.1137/1.9781611970128.
    """

    source: Pair  # in um: middle of the marks
    size: float  # in um: their rms distance from it
    nodes: Floats  # (m, 2): places of the marks, scaled
    affine: Floats  # (3, 2), in um: constant and linear part
    bend: Floats  # (m, 2), in um: coefficients of the kernels
    # The parameter lambda of the spline in um**2: 0 goes through all marks, infinity is affine. It is what
    # ``scipy.interpolate.RBFInterpolator`` calls ``smoothing``.
    smoothing_um2: float

    def __post_init__(self) -> None:
        """Lay the arrays out as they are read back from a file, so that sums have the same bytes."""
        for name in ("nodes", "affine", "bend"):
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=np.float64, order="C"))

    def __call__(self, points: ArrayLike) -> Floats:
        """Transform points of shape ``(..., 2)``, in um; NaN stays NaN."""
        given = np.asarray(points, dtype=np.float64)
        at = (given.reshape(-1, 2) - self.source) / self.size
        out = self.affine[0] + at @ self.affine[1:]
        if np.any(self.bend):
            step = max(1, _AT_ONCE // len(self.nodes))
            for k in range(0, len(at), step):
                part = at[k : k + step]
                out[k : k + step] += bending(np.sum((part[:, None] - self.nodes) ** 2, axis=-1)) @ self.bend
        return out.reshape(given.shape)

    def jacobian(self, points: ArrayLike) -> Floats:
        """Derivatives of the image at points ``(..., 2)``: ``(..., 2, 2)``, a row for x and y of the image."""
        given = np.asarray(points, dtype=np.float64)
        at = (given.reshape(-1, 2) - self.source) / self.size
        out = np.broadcast_to(self.affine[1:].T, (len(at), 2, 2)).copy()
        step = max(1, _AT_ONCE // len(self.nodes))
        for k in range(0, len(at), step):
            away = at[k : k + step, None] - self.nodes
            squares = np.sum(away**2, axis=-1)
            with np.errstate(divide="ignore"):
                slope = np.where(squares > 0, np.log(squares) + 1.0, 0.0)
            out[k : k + step] += np.einsum("km,kmj,mi->kij", slope, away, self.bend)
        return (out / self.size).reshape(*given.shape[:-1], 2, 2)

    @property
    def inverse(self) -> Callable[[ArrayLike], Floats]:
        """The transformation back, by Newton's method from the nearest image of a grid; NaN where it finds no point."""
        return self._back

    def _back(self, points: ArrayLike) -> Floats:
        given = np.asarray(points, dtype=np.float64)
        wanted = given.reshape(-1, 2)
        found = np.full(wanted.shape, np.nan)
        here = np.isfinite(wanted).all(axis=1)
        if here.any():
            found[here] = self._newton(wanted[here])
        return found.reshape(given.shape)

    def _newton(self, wanted: Floats) -> Floats:
        from scipy.spatial import KDTree

        nodes = self.nodes * self.size + np.array(self.source)
        low, high = nodes.min(axis=0), nodes.max(axis=0)
        around = _AROUND * float(np.max(high - low))
        axes = [np.linspace(a - around, b + around, _GRID) for a, b in zip(low, high, strict=True)]
        grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        images = self(grid)
        at = grid[KDTree(images).query(wanted)[1]]
        error = self(at) - wanted
        # What rounding leaves of the sum of kernels.
        enough = 4e-15 * (np.abs(images).max() + np.abs(wanted).max())
        active = np.arange(len(wanted))
        for _ in range(_STEPS):
            now = at[active]
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                step = _solve(self.jacobian(now), error[active])
            # Far from the answer a whole step may overshoot a bend: no further than an eighth of the extent.
            length = np.linalg.norm(step, axis=1, keepdims=True)
            step *= np.minimum(1.0, 0.125 * around / np.maximum(length, 1e-300))
            trial = now - step
            missed = self(trial) - wanted[active]
            before, after = (np.linalg.norm(e, axis=1) for e in (error[active], missed))
            good = after < before
            at[active[good]], error[active[good]] = trial[good], missed[good]
            # Where the whole step does not help, a quarter of it may.
            worse = np.flatnonzero(~good & (before > enough))
            if worse.size:
                trial = now[worse] - 0.25 * step[worse]
                missed = self(trial) - wanted[active[worse]]
                better = np.linalg.norm(missed, axis=1) < before[worse]
                at[active[worse[better]]], error[active[worse[better]]] = trial[better], missed[better]
                good[worse[better]] = True
            left = np.linalg.norm(error[active], axis=1)
            active = active[good & (left > 0.0)]
            if not active.size:
                break
        outside = np.any((at < low - around) | (at > high + around), axis=1)
        at[outside | (np.linalg.norm(error, axis=1) > 100 * enough)] = np.nan
        return at


def _solve(jacobian: Floats, error: Floats) -> Floats:
    """Solve 2 x 2 systems; a singular one gives what is not finite."""
    a, b, c, d = jacobian[:, 0, 0], jacobian[:, 0, 1], jacobian[:, 1, 0], jacobian[:, 1, 1]
    det = a * d - b * c
    x = (d * error[:, 0] - b * error[:, 1]) / det
    y = (a * error[:, 1] - c * error[:, 0]) / det
    return np.nan_to_num(np.stack([x, y], axis=1), nan=0.0, posinf=0.0, neginf=0.0)
