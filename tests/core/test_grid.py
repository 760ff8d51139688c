import numpy as np
import pytest
import xarray as xr

from planish.core.errors import SizeError
from planish.core.grid import Grid, bilinear, pitch, values_at


@pytest.mark.parametrize("dims", [("y", "x"), ("v", "u")])
def test_the_grid_of_maps(dims):
    maps = xr.Dataset(
        coords={dims[0]: 7.0 + 2.5 * np.arange(3), dims[1]: -1.0 + 4.0 * np.arange(5)}
    )
    grid = Grid.of(maps)
    assert grid.shape == (3, 5)
    assert grid.pixel_um == pitch(maps) == (2.5, 4.0)
    assert (grid.origin_um, set(grid.coords)) == ((-1.0, 7.0), {"y", "x"})


def test_values_at_points_in_um_and_a_grid_of_one_row_has_no_pitch():
    y, x = 10 + 2 * np.arange(4.0), -5 + 3 * np.arange(6.0)
    maps = xr.Dataset(
        {"a": (("v", "u"), y[:, None] + 0 * x), "b": (("v", "u"), 0 * y[:, None] + x)},
        coords={"v": y, "u": x},
    )
    points = np.array([[0.0, 11.0], [9.5, 16.0], [100.0, 11.0]])
    found = values_at(maps, ("b", "a"), points)
    assert np.allclose(found[:2], points[:2], rtol=0, atol=1e-12)
    assert np.isnan(found[2]).all()
    with pytest.raises(SizeError, match="1 x 5"):
        pitch(xr.Dataset(coords={"y": [0.0], "x": np.arange(5.0)}))


def test_bilinear_is_exact_for_bilinear_fields_on_points_and_grids_within_known_cells():
    i, j = np.mgrid[:4, :6].astype(float)
    row, col = (
        np.array([0.0, 1.25, 3.0, 2.5, -1e-9, 3.0]),
        np.array([0.0, 4.5, 5.0, 0.5, 1.0, 5.0 + 1e-9]),
    )
    known = np.array([True, True, True, True, False, False])
    values = bilinear(1 + 2 * i - 3 * j + 0.5 * i * j, row, col)
    assert np.array_equal(values[known], (1 + 2 * row - 3 * col + 0.5 * row * col)[known])
    assert np.isnan(values[~known]).all()
    field = np.random.default_rng(0).random((4, 5))
    assert np.array_equal(bilinear(field, np.arange(4.0)[:, None], np.arange(5.0)[None, :]), field)
    field = np.ones((3, 3))
    field[2, 2] = np.nan
    assert np.isnan(bilinear(field, np.array([1.5]), np.array([1.5]))).all()
    assert bilinear(field, np.array([0.5]), np.array([0.5])) == 1.0
