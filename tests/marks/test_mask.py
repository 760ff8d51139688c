"""Pixels in holes."""

import numpy as np
import pytest

from planish.core.grid import Grid
from planish.marks import hole_mask
from planish.marks.exchange import MarkPlaces, make_marks
from planish.marks.exchange.model import with_holes


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


@pytest.mark.parametrize("other", ["tile", "clicked"])
def test_a_mark_in_no_hole_is_taken_for_one_unless_it_stands_beside_tiles(other):
    places = np.array([[100.0, 100.0], [700.0, 300.0], [400.0, 800.0]])
    sources = ("clicked", "clicked", other)
    marks = make_marks("abc", {"moving": MarkPlaces(um=places, source=sources)})
    hole = MarkPlaces(um=places[:1] + 20.0, extras={"diameter": np.array([180.0])})
    found = with_holes(marks, make_marks("d", {"moving": hole}), "moving", usual_um=175.0)
    assumed = np.nan if other == "tile" else 175.0
    diameters = found["moving_diameter"].values
    assert np.array_equal(diameters, [180.0, assumed, assumed], equal_nan=True)
