"""The Conley interval of a correlation: its critical value against drawn ones, and where it
differs."""

import math

import numpy as np
import pytest

from analyze.fields import gaussian_maps, related_maps
from planish.analyze import conley_interval, correlate
from planish.analyze.conley_interval import critical_value
from planish.texture import covariance


def drawn_critical(known, draws=4000):
    """How many estimated standard errors the mean of independent values is off in 5 %."""
    rng, lags = np.random.default_rng(0), covariance.Lags(known, (1.0, 1.0))
    weight = np.maximum(1 - lags.distance_um / (covariance.BANDWIDTH * min(known.shape)), 0.0)
    found = []
    for _ in range(draws):
        values = np.where(known, rng.normal(size=known.shape), 0.0)
        mean = values[known].mean()
        moved = lags.transform(np.where(known, values - mean, 0.0))
        square = float(np.sum(weight * lags.products(moved, moved))) / lags.n**2
        found.append(abs(mean) / math.sqrt(square))
    return float(np.quantile(found, 0.95))


def test_the_critical_value_is_that_of_drawn_values():
    known = np.ones((18, 24), bool)
    known[3:9, 5:14] = False
    # Of 4000 draws the quantile scatters by .035.
    assert critical_value(known, (1.0, 1.0)) == pytest.approx(drawn_critical(known), abs=0.09)
    large = np.ones((90, 120), bool)
    large[15:45, 25:70] = False
    assert critical_value(large, (1.0, 1.0)) == pytest.approx(
        critical_value(known, (1.0, 1.0)), abs=0.02
    )


def test_both_opinions_agree_on_even_maps_and_the_second_is_wider_on_uneven_ones():
    a, b = related_maps(1, (100, 130), 2.0, 0.5)
    first, second = correlate(a, b, pixel_um=3.0), conley_interval(a, b, pixel_um=3.0)
    assert second.r == pytest.approx(first.r)
    assert np.diff(second.interval) == pytest.approx(np.diff(first.interval), rel=0.3)
    assert 0.7 < second.ratio < 1.3
    assert not first.warnings
    rng = np.random.default_rng(2)
    a, b = related_maps(rng, (100, 130), 1.5, 0.5)
    level = np.exp(1.2 * gaussian_maps(rng, a.shape, 25.0, kind="gauss")[0])
    first, second = (f(a * level, b * level, pixel_um=3.0) for f in (correlate, conley_interval))
    assert second.ratio > 1.4
    assert any("vary unevenly" in text for text in first.warnings)


def test_points_masks_and_what_is_withheld():
    a, b = related_maps(3, (80, 100), 3.0, 0.6)
    mask = np.ones(a.shape, bool)
    mask[20:40, 30:60] = False
    at_points = conley_interval(a, np.where(mask, b, np.nan), pixel_um=5.0, point_um=20.0)
    assert at_points.r == pytest.approx(correlate(a, b, mask=mask, pixel_um=5.0, point_um=20.0).r)
    assert at_points.interval[0] < at_points.r < at_points.interval[1]
    y, x = np.mgrid[:40, :50]
    assert math.isnan(conley_interval(y + 0.0, x + y + 0.0, pixel_um=1.0).interval[0])
    assert conley_interval(a, 2 * a, pixel_um=5.0).r == pytest.approx(1.0)
