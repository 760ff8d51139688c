import numpy as np
import pytest

from analyze.fields import gaussian_maps
from folders import refused
from planish.analyze import region_difference
from planish.core.errors import CannotMeasure, InputError


def test_a_step_is_found_and_a_large_region_is_one_event():
    a, b = gaussian_maps(0, (60, 80), 3.0)
    inside = a < -0.8
    found = region_difference(b - 2.0 * inside, inside, pixel_um=2.0)
    assert found.share == pytest.approx(inside.mean())
    assert found.interval[0] < -2 < found.interval[1]
    assert found.interval[1] < -1
    assert found.n_eff < inside.size / 4
    b = gaussian_maps(4, (40, 50), 30.0, kind="gauss")[0]
    inside = np.zeros(b.shape, bool)
    inside[:, :25] = True
    found = region_difference(b, inside, pixel_um=1.0)
    assert np.isnan(found.interval).all() == (found.n_eff < 10)
    assert found.n_eff < 30


def test_pixels_without_resemblance_are_a_two_sample_test():
    rng = np.random.default_rng(1)
    values, inside = rng.normal(size=(80, 90)), rng.random((80, 90)) < 0.2
    found = region_difference(values, inside, pixel_um=1.0)
    error = np.sqrt(values[inside].var() / inside.sum() + values[~inside].var() / (~inside).sum())
    assert found.difference == pytest.approx(values[inside].mean() - values[~inside].mean())
    assert found.interval[1] - found.interval[0] == pytest.approx(2 * 1.96 * error, rel=0.1)


@pytest.mark.nightly
def test_the_interval_holds_the_truth():
    rng, held = np.random.default_rng(2), []
    for _ in range(150):
        a, b = gaussian_maps(rng, (60, 80), 3.0)
        low, high = region_difference(b, a < -0.8, pixel_um=1.0).interval
        held.append(low <= 0 <= high)
    assert 0.88 < np.mean(held) < 0.995


def test_missing_pixels_do_not_count_and_regions_without_pixels_are_refused():
    rng = np.random.default_rng(3)
    a, b = gaussian_maps(rng, (40, 50), 3.0)
    known = rng.random(a.shape) > 0.2
    holed = np.where(known, b, np.nan)
    found = region_difference(holed, a < 0, pixel_um=1.0)
    assert found.difference == pytest.approx(np.nanmean(holed[a < 0]) - np.nanmean(holed[a >= 0]))
    b = np.random.default_rng(5).normal(size=(20, 30))
    for inside in (np.zeros(b.shape, bool), np.ones(b.shape, bool)):
        refused(CannotMeasure, "another limit", region_difference, b, inside, pixel_um=1.0)
    refused(InputError, "onto one grid", region_difference, b, np.ones((3, 3), bool), pixel_um=1.0)
