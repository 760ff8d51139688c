"""Pixels in holes."""

import numpy as np

from planish.core.grid import Grid
from planish.marks import hole_mask


def test_the_mask_equals_its_slow_twin():
    grid = Grid.regular((40, 50), pixel_um=(5.0, 4.0))
    centres = np.array([[60.0, 80.0], [3.0, 190.0], [195.1, -10.3], [400.0, 400.0], [120.0, 100.0]])
    radii = np.array([33.3, 20.0, 41.7, 10.0, 40.0])
    y, x = np.meshgrid(grid.y_um, grid.x_um, indexing="ij")
    slow = np.zeros(grid.shape, dtype=bool)
    for (cx, cy), radius in zip(centres, radii, strict=True):
        slow |= np.hypot(x - cx, y - cy) <= radius
    np.testing.assert_array_equal(hole_mask(grid, centres, radii), slow)
    assert 300 < slow.sum() < 1500
