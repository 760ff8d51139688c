import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planish.analyze import PairSums, correlate, correlate_at


def pair(r, n=60_000, seed=0):
    a, b = np.random.default_rng(seed).normal(size=(2, n))
    return a, r * a + np.sqrt(1 - r * r) * b


@pytest.mark.parametrize("r", [-0.7, 0.0, 0.45, 0.95])
def test_a_known_correlation_is_found(r):
    found = correlate(*pair(r), point_um=4.0)
    # standard error (1 - r^2) / sqrt(n)
    assert found.r == pytest.approx(r, abs=4 * (1 - r * r) / np.sqrt(60_000) + 1e-12)
    assert found.r2 == pytest.approx(found.r**2)
    assert found.n == 60_000


@given(scale=st.floats(0.01, 100), shift=st.floats(-1e3, 1e3))
def test_scale_and_shift_keep_r(scale, shift):
    a, b = pair(0.6, n=500)
    assert correlate(scale * a + shift, b, point_um=1).r == pytest.approx(correlate(a, b, point_um=1).r, abs=1e-9)


def test_slope_is_that_of_the_line():
    x = np.arange(10.0)
    found = correlate(x, 3 * x - 2, point_um=1)
    assert (found.slope, found.intercept, found.r) == pytest.approx((3, -2, 1))


def test_missing_points_do_not_count():
    a, b = pair(0.6, n=500)
    a[::3] = np.nan
    b[::7] = np.nan
    keep = np.isfinite(a) & np.isfinite(b)
    assert correlate(a, b, point_um=1).r == pytest.approx(np.corrcoef(a[keep], b[keep])[0, 1])
    assert correlate(a, b, point_um=1).n == keep.sum()


def test_nothing_to_correlate_is_no_number():
    for a, b in (([1.0, 2.0], [1.0, 2.0]), ([5.0] * 9, range(9)), ([np.nan] * 9, range(9))):
        found = correlate(np.asarray(a, float), np.asarray(list(b), float), point_um=1)
        assert np.isnan(found.r)


def test_points_are_means_over_pixels_valid_in_both():
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(2, 40, 60))
    a[:, :10] = np.nan
    found, x, y = correlate_at(a, b, pixel_um=(5.0, 5.0), point_um=50.0)
    assert x.shape == (4, 6)
    assert found.n == 20
    assert x[1, 2] == pytest.approx(a[10:20, 20:30].mean())
    assert np.array_equal(np.isnan(x), np.isnan(y))


def test_a_pixel_missing_in_either_map_counts_in_neither():
    rng = np.random.default_rng(4)
    a, b = rng.normal(size=(2, 40, 60))
    missing = rng.random(a.shape) < 0.2
    for one, other in ((a, np.where(missing, np.nan, b)), (np.where(missing, np.nan, a), b)):
        _, x, y = correlate_at(one, other, pixel_um=(5.0, 5.0), point_um=50.0)
        block = np.s_[10:20, 20:30]
        assert x[1, 2] == pytest.approx(a[block][~missing[block]].mean())
        assert y[1, 2] == pytest.approx(b[block][~missing[block]].mean())


def test_a_point_smaller_than_a_pixel_is_no_point():
    found, _, _ = correlate_at(np.ones((5, 5)), np.ones((5, 5)), pixel_um=(200.0, 200.0), point_um=100.0)
    assert found.n == 0


def test_sums_of_parts_are_those_of_the_whole():
    a, b = pair(0.4, n=5000)
    a, b = 1e4 + a, b - 300
    b[::7] = np.nan
    sums = PairSums()
    for part in np.array_split(np.arange(5000), [0, 1, 40, 3000]):
        sums.add(a[part], b[part])
    known = np.isfinite(b)
    found, off = sums.correlation(point_um=1), (b - a)[known]
    assert found.n == known.sum()
    assert found.r == pytest.approx(np.corrcoef(a[known], b[known])[0, 1], abs=1e-12)
    assert (found.slope, found.intercept) == pytest.approx(np.polyfit(a[known], b[known], 1), rel=1e-6)
    assert sums.difference == pytest.approx((off.mean(), off.std(ddof=1)))
