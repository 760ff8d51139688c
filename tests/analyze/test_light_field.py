"""A smooth field in an image: found beside the map that explains the rest, and taken off."""

import math

import numpy as np
import pytest
from scipy import stats

from analyze.fields import related_maps
from planish.analyze import correlate, light_field
from planish.analyze.correlation_evidence import EvidenceFacts
from planish.analyze.light_field import fit_light, without_light
from planish.checks import run_checks
from planish.core.errors import CannotMeasure
from planish.core.grid import Grid

SHAPE, POINT_UM = (24, 32), 100.0


def quadratic(shape, weights=(0.4, -0.8, -1.0, 0.3, -0.6)):
    """x, y, x², xy and y² with these weights, in um from a corner."""
    y, x = np.meshgrid(*((np.arange(n) + 0.5) * POINT_UM for n in shape), indexing="ij")
    y, x = y / 2000.0, x / 2000.0
    return sum(w * term for w, term in zip(weights, (x, y, x * x, x * y, y * y), strict=True))


def by_least_squares(a, b):
    """The field by one regression of the image on the map and five powers of places in um, and r
    without it."""
    is_valid = np.isfinite(a) & np.isfinite(b)
    y, x = (k[is_valid] * POINT_UM for k in np.indices(a.shape))
    columns = [np.ones(x.size), a[is_valid], x, y, x * x, x * y, y * y]
    columns = np.stack([c / np.abs(c).max() for c in columns], axis=1)
    weights = np.linalg.lstsq(columns, b[is_valid], rcond=None)[0]
    field = columns[:, 2:] @ weights[2:]
    field -= field.mean()
    return field, np.corrcoef(a[is_valid], b[is_valid] - field)[0, 1]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_field_and_r_are_those_of_one_regression(seed):
    a, b = related_maps(seed, SHAPE, 2.0, 0.5)
    b = b + quadratic(SHAPE)
    a[5:9, 3:8], b[20:, 25:] = np.nan, np.nan
    found, field = light_field(a, b, point_um=POINT_UM)
    twin_field, twin_r = by_least_squares(a, b)
    is_valid = np.isfinite(field)
    assert np.array_equal(is_valid, np.isfinite(a) & np.isfinite(b))
    np.testing.assert_allclose(field[is_valid], twin_field, atol=1e-9)
    assert found.r == pytest.approx(twin_r, abs=1e-10)
    assert found.n == np.count_nonzero(is_valid)
    values = b[is_valid]
    assert found.share == pytest.approx(field[is_valid].var() / values.var())
    assert found.span == pytest.approx(np.ptp(field[is_valid]) / abs(values.mean()))
    assert found.r_plain == pytest.approx(np.corrcoef(a[is_valid], values)[0, 1])


def test_no_light_of_this_form_changes_what_is_left():
    a, b = related_maps(4, SHAPE, 2.0, 0.6)
    even, _ = light_field(a, b, point_um=POINT_UM)
    for strength in (0.3, 3.0, 30.0):
        found, field = light_field(a, b + strength * quadratic(SHAPE), point_um=POINT_UM)
        assert found.r == pytest.approx(even.r, abs=1e-9)
        assert found.interval == pytest.approx(even.interval, abs=1e-9)
        assert found.n_eff == pytest.approx(even.n_eff, rel=1e-9)
        assert (found.p_even < 1e-6) == (strength > 1.0)
        whole = strength * (quadratic(SHAPE) - quadratic(SHAPE).mean())
        assert np.std(field - whole) < 0.35  # what texture of length 2 gives: .2 to .28


def test_a_field_that_the_map_shares_is_not_taken_for_light():
    """A coating with a ramp, and an image that follows it: the ramp is explained."""
    a, noise = related_maps(5, SHAPE, 1.0, 0.0)
    a = a + quadratic(SHAPE)
    found, field = light_field(a, 0.8 * a + 0.6 * noise, point_um=POINT_UM)
    assert np.std(field) < 0.15
    assert found.r == pytest.approx(found.r_plain, abs=0.03)
    assert found.p_even > 0.05


def test_the_interval_is_that_of_the_partial_correlation_with_the_variance_of_the_whole_map():
    a, noise = related_maps(6, SHAPE, 0.3, 0.0)
    b = 0.5 * a + noise
    found, _ = light_field(a, b, point_um=POINT_UM)
    plain = correlate(a, b, pixel_um=POINT_UM)
    # White maps without a trend: five of 768 degrees of freedom are used up, and no more.
    width = math.sqrt((plain.n_eff - 3) / (plain.n_eff - 8))
    assert np.ptp(found.interval) == pytest.approx(width * np.ptp(plain.interval), rel=0.02)
    assert found.n_eff == pytest.approx(plain.n_eff - 5, rel=0.02)
    # A map that is mostly a ramp has few independent points beside the field.
    ramp = a + 3.0 * np.linspace(-1.0, 1.0, SHAPE[1])
    with_ramp, _ = light_field(ramp, 0.5 * ramp + noise, point_um=POINT_UM)
    low, high = (math.atanh(limit) for limit in with_ramp.interval)
    assert high - low > 1.5 * np.ptp([math.atanh(limit) for limit in found.interval])
    assert with_ramp.interval[0] < with_ramp.r < with_ramp.interval[1]


def test_texture_alone_gives_the_share_that_is_stated():
    """Over drawn maps in even light; with a length of a twelfth of the side 5 % become 12."""
    draws = [
        light_field(*related_maps(k, SHAPE, 1.0, 0.5), point_um=POINT_UM)[0] for k in range(40)
    ]
    assert np.mean([d.share for d in draws]) == pytest.approx(
        np.mean([d.share_even for d in draws]), rel=0.3
    )
    assert np.count_nonzero([d.p_even < 0.05 for d in draws]) <= 6


def test_what_cannot_be_fitted_is_said():
    a, b = related_maps(7, (3, 4), 1.0, 0.5)
    with pytest.raises(CannotMeasure, match="12 points, 3 along the shorter side, are too few"):
        light_field(a, b, point_um=POINT_UM)
    a, b = related_maps(7, (2, 40), 1.0, 0.5)
    with pytest.raises(CannotMeasure, match="80 points, 2 along the shorter side, are too few"):
        light_field(a, b, point_um=POINT_UM)
    with pytest.raises(CannotMeasure, match="is a quadratic field"):
        light_field(quadratic(SHAPE), related_maps(8, SHAPE, 1.0, 0.5)[1], point_um=POINT_UM)


def test_an_image_of_mean_0_has_no_share_that_its_grey_changes_by():
    a, _ = related_maps(9, SHAPE, 1.0, 0.5)
    image = np.tile([[1.0, -1.0]], (SHAPE[0], SHAPE[1] // 2))
    found, _ = light_field(a, image, point_um=POINT_UM)
    assert math.isnan(found.span)
    evidence = EvidenceFacts(
        a="s", a_map="m", b="i", b_map="image", declared=False, light_field=found
    )
    (check,) = run_checks(evidence)
    assert "With it off, r over points of 100 um is" in check.sentence
    assert "nan" not in check.sentence


def test_long_waves_alone_have_no_interval_with_the_field_left_in():
    y, x = np.meshgrid(np.linspace(-1, 1, 20), np.linspace(-1, 1, 24), indexing="ij")
    a, b = np.cos(3 * x + 1) + np.sin(3 * y), np.cos(3 * x + 1) - np.sin(3.5 * y + 0.5)
    found, _ = light_field(a, b, point_um=POINT_UM)
    assert math.isnan(found.interval_plain[0])
    assert math.isfinite(found.r)


def test_the_fitted_field_is_the_same_on_points_and_on_pixels():
    a, b = related_maps(10, SHAPE, 2.0, 0.5)
    b = b + quadratic(SHAPE)
    a[:4, :7] = np.nan
    pixels = Grid.regular((SHAPE[0] * 5 + 3, SHAPE[1] * 4), (20.0, 25.0), (300.0, -50.0))
    light = fit_light(a, b, pixels, POINT_UM)
    _, field = light_field(a, b, point_um=POINT_UM)
    # Middles of the points, which begin with the border of the first pixel.
    points = Grid.regular(SHAPE, POINT_UM, (300.0 - 12.5 + 50.0, -50.0 - 10.0 + 50.0))
    on_points = light.on(points)
    is_valid = np.isfinite(field)
    np.testing.assert_allclose(on_points[is_valid], field[is_valid], atol=1e-10)
    part = light.on(pixels.part(slice(10, 30), slice(7, 9)))
    np.testing.assert_allclose(part, light.on(pixels)[10:30, 7:9], atol=1e-12)


def test_r_of_an_image_without_its_field_has_the_interval_that_the_field_leaves():
    a, b = related_maps(11, SHAPE, 2.0, 0.5)
    a = a + 0.7 * quadratic(SHAPE)
    found, field = light_field(a, b + 2.0 * quadratic(SHAPE), point_um=POINT_UM)
    image = b + 2.0 * quadratic(SHAPE) - field
    plain = correlate(a, image, pixel_um=POINT_UM)
    pixel, points = without_light(plain, plain, a, image)
    assert pixel == points
    assert points.r == pytest.approx(found.r)
    assert points.interval == pytest.approx(found.interval, abs=1e-9)
    assert points.n_eff == pytest.approx(found.n_eff)
    # p is that of the partial correlation given the field.
    y, x = (k.ravel() * 1.0 for k in np.indices(SHAPE))
    terms = np.stack([np.ones(x.size), x, y, x * x, x * y, y * y], axis=1)
    rests = [m.ravel() - terms @ np.linalg.lstsq(terms, m.ravel())[0] for m in (a, image)]
    r, free = np.corrcoef(*rests)[0, 1], points.n_eff - 2
    assert points.p == pytest.approx(2 * stats.t.sf(r * math.sqrt(free / (1 - r * r)), free))
    no_field = correlate(quadratic(SHAPE), image, pixel_um=POINT_UM)
    assert without_light(no_field, no_field, quadratic(SHAPE), image) == (no_field, no_field)
