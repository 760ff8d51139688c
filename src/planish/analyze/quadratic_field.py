"""A quadratic field of x and y over an image, such as an uneven light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planish.core.grid import Grid
from planish.core.typing import Bools, Floats, Pair


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class QuadraticField:
    """A quadratic field over an image, less its mean over the points it was fitted to."""

    weights: Floats  # of 1, x, y, x², xy and y²
    middle_um: Pair  # along y and x, of the points
    half_um: Pair

    def on(self, grid: Grid) -> Floats:
        """Its values (rows, cols) on some pixels."""
        places = zip((grid.y_um, grid.x_um), self.middle_um, self.half_um, strict=True)
        y, x = ((um - middle) / half for um, middle, half in places)
        return _terms_of(y, x) @ self.weights


def terms_of_points(is_valid: Bools) -> Floats:
    """1, x, y, x², xy and y² at the points that are valid: (points, 6)."""
    return _terms_of(*(np.linspace(-1.0, 1.0, n) for n in is_valid.shape))[is_valid]


def _terms_of(y: Floats, x: Floats) -> Floats:
    y, x = np.meshgrid(y, x, indexing="ij")
    return np.stack([np.ones(x.shape), x, y, x * x, x * y, y * y], axis=-1)
