"""Light that spreads in paper: a slow twin, what stays, what is refused."""

import numpy as np
import pytest

from analyze.fields import gaussian_maps
from folders import refused
from planish.analyze import spread_light
from planish.core.errors import CannotMeasure, InputError, SizeError

WIDTH_UM = 60.0


def test_it_is_the_mean_with_an_exponential_kernel_over_the_known_pixels():
    values = gaussian_maps(0, (40, 50), 5.0)[0] + 7.0
    values[10:18, 20:31] = np.nan
    found = spread_light(values, pixel_um=10.0, width_um=WIDTH_UM)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(values))
    y, x = np.mgrid[:40, :50] * 10.0
    known = np.isfinite(values)
    for i, j in ((0, 0), (9, 25), (30, 12), (39, 49)):
        kernel = np.exp(-np.hypot(y - y[i, j], x - x[i, j]) / WIDTH_UM)[known]
        # Pixels of a sixth of the width cut the summit of the kernel: some percent of the map's
        # spread.
        assert found[i, j] == pytest.approx(np.sum(kernel * values[known]) / kernel.sum(), abs=0.02)


def test_a_constant_stays_and_a_single_pixel_becomes_an_exponential():
    flat = np.full((30, 40), 3.25)
    flat[:5, :9] = np.nan
    np.testing.assert_allclose(
        spread_light(flat, pixel_um=(8.0, 12.0), width_um=50.0)[6:], 3.25, rtol=1e-12
    )
    dot = np.zeros((201, 201))
    dot[100, 100] = 1.0
    found = spread_light(dot, pixel_um=5.0, width_um=40.0)[100, 103:150]
    far = 5.0 * np.arange(3, 50)
    np.testing.assert_allclose(found, 25.0 * np.exp(-far / 40.0) / (2 * np.pi * 40.0**2), rtol=0.02)


def test_refusals():
    values = np.random.default_rng(3).normal(size=(20, 30))
    for width_um in (0.0, -1.0, np.nan, np.inf, 200.0):
        refused(
            SizeError, "Light would spread", spread_light, values, pixel_um=10.0, width_um=width_um
        )
    with pytest.raises(CannotMeasure, match="No pixel"):
        spread_light(np.full(values.shape, np.nan), pixel_um=10.0, width_um=30.0)
    with pytest.raises(InputError):
        spread_light(values[0], pixel_um=10.0, width_um=30.0)
