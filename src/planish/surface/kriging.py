"""Ordinary kriging with a linear variogram: a height between known heights, and how far it may be off.

The semivariance of two heights that lie r apart is ``slope * r`` (Matheron 1963, doi:10.2113/gsecongeo.58.8.1246). Slow
trends are taken off as a plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planish.core.typing import Floats

_OF_A_MEDIAN = 0.4549  # the median of the square of a normal deviate over its variance
_AT_ONCE = 20_000  # places


@dataclass(frozen=True, slots=True, kw_only=True)
class Kriging:
    """Known heights (n,) at places (n, 2) in um, each with the variance of its own error."""

    places: Floats
    heights: Floats
    variances: Floats
    slope: float  # um2 of semivariance for one um of distance

    def __call__(self, targets: Floats) -> tuple[Floats, Floats]:
        """Height and its standard error at places (m, 2)."""
        middle, n = self.places.mean(axis=0), len(self.heights)
        plane = np.zeros(3)
        if n >= 6:
            design = np.column_stack([np.ones(n), self.places - middle])
            plane = np.linalg.lstsq(design, self.heights, rcond=1e-6)[0]
        residuals = self.heights - plane[0] - (self.places - middle) @ plane[1:]
        system = np.ones((n + 1, n + 1))
        system[:n, :n] = -self._between(self.places) + np.diag(self.variances)
        system[n, n] = 0.0
        inverse = np.linalg.inv(system)
        height, error = np.empty(len(targets)), np.empty(len(targets))
        for start in range(0, len(targets), _AT_ONCE):
            part = slice(start, start + _AT_ONCE)
            semivariances = np.ones((len(targets[part]), n + 1))
            semivariances[:, :n] = -self._between(targets[part])
            weights = semivariances @ inverse
            height[part] = weights[:, :n] @ residuals + plane[0] + (targets[part] - middle) @ plane[1:]
            error[part] = np.sqrt(np.maximum(-np.sum(weights * semivariances, axis=1), 0.0))
        return height, error

    def _between(self, targets: Floats) -> Floats:
        return self.slope * np.hypot(*(targets[:, None, k] - self.places[None, :, k] for k in (0, 1)))


def variogram_slope(heights: Floats, pitch: tuple[float, float], lag_um: float, *, least: float) -> float:
    """Slope of the linear variogram of a field (rows, cols), NaN where unknown, from pairs ``lag_um`` apart.

    ``least``: variance at that lag where no more is seen.
    """
    squares: list[Floats] = []
    for axis, step in enumerate(pitch):
        k = max(1, round(lag_um / step))
        if heights.shape[axis] > k:
            first, second = (np.take(heights, range(a, heights.shape[axis] - k + a), axis) for a in (0, k))
            pairs = (second - first)[np.isfinite(second - first)] ** 2
            squares.append(pairs * lag_um / (k * step))
    pairs = np.concatenate(squares) if squares else np.empty(0)
    usual = float(np.median(pairs)) / (2 * _OF_A_MEDIAN) if pairs.size else 0.0
    return max(usual, least) / lag_um
