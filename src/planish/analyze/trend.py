"""A trend over the whole field that two maps share: light, curl or drift, which is one event and not many."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SHARED = 0.25  # of the variance of both maps


@dataclass(frozen=True, slots=True)
class SharedTrend:
    """Shares of two maps' variance that a plane and a second-order surface hold, and r without them."""

    share_a: float
    share_b: float
    r: float

    @property
    def sentence(self) -> str:
        """What to be careful about."""
        return (
            f"Trends over the whole field hold {100 * self.share_a:.0f} % of map a and {100 * self.share_b:.0f} % of "
            f"map b; without them r is {self.r:.2f}."
        )


def without_trend(values: Array, known: Mask) -> Array:
    """Take the plane and second-order surface of least squares off a map (rows, cols); 0 where it is not known."""
    # Products of one polynomial along the rows and one along the columns: no term is ever as large as the map.
    rows, cols = (np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, n), 2) for n in known.shape)
    inside = np.where(known, values - values[known].mean(), 0.0)
    weights = known.astype(np.float64)
    moments = np.einsum(
        "rjl,ri,rk->ijkl", (weights @ (cols[:, :, None] * cols[:, None, :]).reshape(len(cols), 9)).reshape(-1, 3, 3),
        rows, rows,
    )  # fmt: skip
    sums = rows.T @ inside @ cols
    terms = [(i, j) for i in range(3) for j in range(3 - i)]
    matrix = np.array([[moments[i, j, k, m] for k, m in terms] for i, j in terms])
    found = np.linalg.lstsq(matrix, np.array([sums[i, j] for i, j in terms]), rcond=None)[0]
    surface = np.zeros((3, 3))
    for (i, j), value in zip(terms, found, strict=True):
        surface[i, j] = value
    return np.where(known, inside - rows @ surface @ cols.T, 0.0)


def shared_trend(x: Array, y: Array, known: Mask) -> SharedTrend | None:
    """Return what trends over the field hold of two maps; None where it is less than a quarter of either."""
    rest = [without_trend(m, known)[known] for m in (x, y)]
    shares = [1.0 - float(m.var()) / float(v[known].var()) for m, v in zip(rest, (x, y), strict=True)]
    if min(shares) < _SHARED:
        return None
    spread = math.sqrt(float(rest[0].var()) * float(rest[1].var()))
    return SharedTrend(shares[0], shares[1], float(np.mean(rest[0] * rest[1])) / spread if spread > 0 else math.nan)
