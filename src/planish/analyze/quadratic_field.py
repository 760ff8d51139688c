"""A quadratic field of x and y over an image, such as an uneven light."""

from dataclasses import dataclass

import numpy as np

from planish.core.grid import Grid
from planish.core.typing import Bools, Floats, Shape, pair_of


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class QuadraticField:
    """A quadratic field over an image, less its mean over the points it was fitted to."""

    weights: Floats  # of 1, x, y, x², xy and y²
    points: Grid  # along which x and y run from -1 to 1

    def on(self, grid: Grid) -> Floats:
        """Its values (rows, cols) on some pixels."""
        y = _scaled(grid.y_um, self.points.y_um)
        x = _scaled(grid.x_um, self.points.x_um)
        return _terms_of(y, x) @ self.weights


def _scaled(places_um: Floats, points_um: Floats) -> Floats:
    """Places along an axis, so that the first point is at -1 and the last one at 1."""
    return 2 * (places_um - points_um[0]) / np.ptp(points_um) - 1


def points_of(grid: Grid, shape: Shape, point_um: float) -> Grid:
    """So many points (rows, cols), which begin with the pixels of a grid."""
    half_pixels_um = np.divide(grid.pixel_um[::-1], 2)
    origin_um = pair_of(np.add(grid.origin_um, point_um / 2) - half_pixels_um)
    return Grid.regular((shape[0], shape[1]), point_um, origin_um)


def terms_of_points(is_valid: Bools) -> Floats:
    """1, x, y, x², xy and y² at the points that are valid: (points, 6)."""
    y, x = (np.linspace(-1.0, 1.0, n) for n in is_valid.shape)
    return _terms_of(y, x)[is_valid]


def _terms_of(y: Floats, x: Floats) -> Floats:
    y, x = np.meshgrid(y, x, indexing="ij")
    return np.stack([np.ones(x.shape), x, y, x * x, x * y, y * y], axis=-1)
