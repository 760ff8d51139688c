import math

import numpy as np
import pytest
from scipy import optimize

from analyze.fields import gaussian_maps
from folders import refused
from planish.analyze import deming, split_reliability
from planish.core.errors import CannotMeasure, InputError


def halves(rng, noise, *, length=4.0, shape=(90, 120)):
    rng = np.random.default_rng(rng)
    signal = gaussian_maps(rng, shape, length)[0]
    return [signal + noise * gaussian_maps(rng, shape, 1.0)[0] for _ in range(2)]


def test_the_reliability_is_that_of_the_mean_of_both():
    rng = np.random.default_rng(0)
    found = [split_reliability(*halves(rng, 1.0), pixel_um=2.0) for _ in range(12)]
    # The mean of both has the signal's variance 1 and noise of 1/2.
    assert np.mean([m.value for m in found]) == pytest.approx(2 / 3, abs=0.02)
    assert np.mean([m.halves_r for m in found]) == pytest.approx(1 / 2, abs=0.02)
    assert sum(m.interval[0] < 2 / 3 < m.interval[1] for m in found) >= 10


def test_shared_errors_make_it_an_upper_bound():
    rng = np.random.default_rng(1)
    shared = gaussian_maps(rng, (90, 120), 1.0)[0]
    pair = [m + shared for m in halves(rng, 1.0)]
    found = split_reliability(*pair, pixel_um=2.0)
    # Of the mean of both, 1 is signal, 1 an error of both, 1/2 errors of their own.
    assert found.value > 1 / 2.5 + 0.2


def test_larger_points_are_more_reliable_and_halves_that_share_nothing_or_are_constant_are_not():
    pair = halves(2, 1.0)
    one, two = (split_reliability(*pair, pixel_um=2.0, point_um=size) for size in (None, 8.0))
    assert two.value > one.value + 0.1
    assert (one.point_um, two.point_um) == (2.0, 8.0)
    assert two.interval[0] < two.value < two.interval[1]
    a, b = gaussian_maps(3, (60, 80), 3.0)
    found = split_reliability(a, -a + 0.1 * b, pixel_um=1.0)
    assert (found.value, found.interval) == (0, (0, 0))
    a, _ = halves(6, 1.0)
    refused(CannotMeasure, "constant", split_reliability, a, np.ones(a.shape), pixel_um=2.0)


def cloud(rng, n, *, slope=2.0, errors=(0.5, 1.5)):
    rng = np.random.default_rng(rng)
    x = rng.normal(size=n)
    return x + errors[0] * rng.normal(size=n), slope * x + 3 + errors[1] * rng.normal(size=n)


def test_the_slope_between_two_noisy_quantities_is_the_true_one():
    x, y = cloud(7, 40_000)
    found = deming(x, y, error_ratio=9.0, n_eff=40_000)
    assert (found.slope, found.intercept) == (
        pytest.approx(2, abs=0.04),
        pytest.approx(3, abs=0.04),
    )
    assert found.interval[0] < 2 < found.interval[1]
    assert np.polyfit(x, y, 1)[0] == pytest.approx(1.6, abs=0.04)  # what least squares leave of it


@pytest.mark.parametrize("ratio", [0.2, 1.0, 9.0])
@pytest.mark.parametrize("slope", [2.0, -0.7])
def test_the_line_is_that_of_least_weighted_distance(ratio, slope):
    x, y = cloud(8, 60, slope=slope)

    def off(p):
        return float(np.sum((y - p[0] * x - p[1]) ** 2 / (ratio + p[0] ** 2)))

    twin = optimize.minimize(
        off, [slope, 3.0], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12}
    )
    found = deming(x, y, error_ratio=ratio, n_eff=60)
    assert (found.slope, found.intercept) == pytest.approx(tuple(twin.x), abs=1e-5)


def test_extreme_ratios_and_fewer_points_change_lines_and_intervals_and_missing_values_nothing():
    x, y = cloud(9, 200)
    assert deming(x, y, error_ratio=1e9, n_eff=200).slope == pytest.approx(
        np.polyfit(x, y, 1)[0], rel=1e-5
    )
    assert deming(x, y, error_ratio=1e-9, n_eff=200).slope == pytest.approx(
        1 / np.polyfit(y, x, 1)[0], rel=1e-5
    )
    there, back = (
        deming(x, y, error_ratio=4.0, n_eff=200),
        deming(y, x, error_ratio=0.25, n_eff=200),
    )
    assert back.slope == pytest.approx(1 / there.slope)
    assert back.interval == pytest.approx((1 / there.interval[1], 1 / there.interval[0]))
    x, y = cloud(10, 2000)
    wide = [np.diff(deming(x, y, error_ratio=9.0, n_eff=n).interval)[0] for n in (2000, 500)]
    assert wide[1] / wide[0] == pytest.approx(2, rel=0.03)
    assert math.isnan(deming(x, y, error_ratio=9.0, n_eff=9).interval[0])
    assert (
        deming(x, y, error_ratio=9.0, n_eff=1e9).interval
        == deming(x, y, error_ratio=9.0, n_eff=2000).interval
    )
    x, y = cloud(11, 100)
    found = deming(
        np.append(x, [np.nan, 5.0]), np.append(y, [1.0, np.nan]), error_ratio=1.0, n_eff=50
    )
    assert found == deming(x, y, error_ratio=1.0, n_eff=50)


def test_without_a_ratio_there_is_no_slope():
    x, y = cloud(12, 100)
    for ratio in (None, 0.0, -1.0, math.nan, math.inf):
        refused(InputError, "repeated measurements", deming, x, y, error_ratio=ratio, n_eff=100)
    refused(InputError, "independent points", deming, x, y, error_ratio=1.0, n_eff=None)
    refused(InputError, "shape", deming, x, y[:-1], error_ratio=1.0, n_eff=100)
    refused(CannotMeasure, "2 points", deming, x[:2], y[:2], error_ratio=1.0, n_eff=100)
    refused(CannotMeasure, "any slope", deming, x, np.ones(100), error_ratio=1.0, n_eff=100)


@pytest.mark.ci
@pytest.mark.parametrize("n", [15, 60])
def test_the_interval_of_independent_points_holds_the_slope(n):
    rng, found = np.random.default_rng(13), []
    for _ in range(2000):
        low, high = deming(*cloud(rng, n, errors=(0.3, 0.9)), error_ratio=9.0, n_eff=n).interval
        found.append(math.isnan(low) or low < 2 < high)
    print(n, np.mean(found))
    assert 0.935 < np.mean(found) < 0.97


@pytest.mark.nightly
def test_the_interval_of_the_reliability_holds_it():
    rng, found = np.random.default_rng(15), []
    for _ in range(300):
        low, high = split_reliability(*halves(rng, 1.0, shape=(60, 80)), pixel_um=1.0).interval
        found.append(low < 2 / 3 < high)
    print(np.mean(found))
    assert 0.92 < np.mean(found) < 0.99
