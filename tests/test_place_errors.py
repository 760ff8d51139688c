"""Standard errors of linked maps: what the error of the place adds."""

import numpy as np
import pytest
import xarray as xr

from planish.run.position_error import add_place_errors

PIXEL_UM = (4.0, 2.0)


def maps_of(values, *, se=0.3, place_um=2.0):
    fields = {"coating_top": values, "coating_top_se": np.full(values.shape, se)}
    fields["expected_error"] = np.full(values.shape, place_um)
    return xr.Dataset({name: (("y", "x"), field) for name, field in fields.items()})


def test_a_slope_times_the_displacement_along_it_is_added():
    y, x = np.meshgrid(4.0 * np.arange(6), 2.0 * np.arange(7), indexing="ij")
    errors = add_place_errors(maps_of(0.3 * y + 0.4 * x), PIXEL_UM)["coating_top_se"].values
    # Along the slope of 0.5, a place that is off by 2 um rms is off by the square root of 2.
    assert errors == pytest.approx(np.hypot(0.3, 0.5 * np.sqrt(2)))


def test_a_displaced_map_differs_by_what_is_stated():
    rng = np.random.default_rng(0)
    y, x = np.meshgrid(4.0 * np.arange(150), 2.0 * np.arange(300), indexing="ij")

    def drawn(y, x):
        return np.sin(x / 13) * np.cos(y / 17)

    moved_um = rng.normal(0, 2 / np.sqrt(2), (2, *y.shape))
    true = drawn(y + moved_um[0], x + moved_um[1]) - drawn(y, x)
    stated = add_place_errors(maps_of(drawn(y, x), se=0.0), PIXEL_UM)["coating_top_se"].values
    assert np.sqrt(np.mean(stated**2)) == pytest.approx(true.std(), rel=0.03)


def test_beside_missing_pixels_the_known_side_is_taken():
    values = np.tile(np.arange(8.0), (5, 1))
    values[:, 4] = np.nan
    maps = maps_of(values)
    maps["expected_error"][2, 1] = np.nan
    errors = add_place_errors(maps, PIXEL_UM)["coating_top_se"].values
    expected = np.full(values.shape, np.sqrt(0.3**2 + 0.5 * (0.5 * 2) ** 2))
    expected[:, 4] = 0.3  # no value, no slope
    expected[2, 1] = 0.3  # the place is not known to be wrong
    np.testing.assert_allclose(errors, expected)
