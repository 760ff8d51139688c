import math

import numpy as np
import pytest

from analyze.fields import gaussian_maps
from folders import refused
from planish.analyze import correlate, cross_correlogram, pearson
from planish.core.errors import SizeError


def moved(rng, shape, length, lag, *, kind="gauss"):
    """A map and the same map moved by whole pixels: what stands at p in the first stands at p + lag
    in the second."""
    edge = max(map(abs, lag))
    whole = gaussian_maps(rng, (shape[0] + 2 * edge, shape[1] + 2 * edge), length, kind=kind)[0]
    cut = [slice(edge - k, edge - k + n) for k, n in zip(lag, shape, strict=True)]
    return whole[edge : edge + shape[0], edge : edge + shape[1]], whole[cut[0], cut[1]]


def at_lag(a, b, lag):
    """r of the pairs a[p], b[p + lag], one by one."""
    pairs = [
        (a[i, j], b[i + lag[0], j + lag[1]])
        for i in range(a.shape[0])
        for j in range(a.shape[1])
        if 0 <= i + lag[0] < a.shape[0]
        and 0 <= j + lag[1] < a.shape[1]
        and np.isfinite(a[i, j])
        and np.isfinite(b[i + lag[0], j + lag[1]])
    ]
    return pearson(*np.array(pairs).T)


def test_every_lag_is_the_r_of_its_pairs():
    a, b = gaussian_maps(0, (14, 17), 2.0)
    a[3:5, 2:9], b[8, 4:6] = np.nan, np.nan
    found = cross_correlogram(a, b + 0.3 * np.nan_to_num(a), pixel_um=(2.0, 1.0), reach_um=4.0)
    assert (found.lag_y_um.tolist(), found.lag_x_um.tolist()) == (
        [-4, -2, 0, 2, 4],
        list(range(-4, 5)),
    )
    twin = [
        [at_lag(a, b + 0.3 * np.nan_to_num(a), (i, j)) for j in range(-4, 5)] for i in range(-2, 3)
    ]
    assert found.r == pytest.approx(np.array(twin), abs=1e-9)


def test_the_peak_is_where_the_map_was_moved_to_also_between_pixels_but_not_beyond_the_reach():
    a, b = moved(1, (90, 120), 5.0, (6, -4))
    found = cross_correlogram(a, -b, pixel_um=(2.0, 3.0), reach_um=40.0)
    assert found.lag_um == pytest.approx((12.0, -12.0), abs=0.1)
    assert (found.inner, found.beyond_chance) == (True, True)
    # The 3 x 3 parabola is a little flatter than the summit of exp(-(h / 5)^2).
    assert found.peak_r == pytest.approx(-1, abs=0.02)
    fine, other = moved(2, (240, 320), 24.0, (2, -5))
    found = cross_correlogram(fine[::4, ::4], other[::4, ::4], pixel_um=1.0, reach_um=10.0)
    assert found.lag_um == pytest.approx((0.5, -1.25), abs=0.05)
    a, b = moved(4, (60, 80), 12.0, (9, 0))
    found = cross_correlogram(a, b, pixel_um=1.0, reach_um=6.0)
    assert not found.inner
    assert found.lag_um[0] == 6.0
    assert np.isnan(found.widths_um).all()


@pytest.mark.parametrize(("length", "angle"), [((4, 9), 0.0), ((9, 4), 90.0)])
def test_widths_are_those_of_the_texture(length, angle):
    found = [
        cross_correlogram(m, m, pixel_um=2.0, reach_um=60.0)
        for m in gaussian_maps(3, (150, 200), length, kind="gauss")
    ]
    full = 2 * math.sqrt(math.log(2)) * 2.0  # of exp(-(h / l)^2), in um for one pixel of l
    assert np.mean([c.widths_um for c in found], axis=0) == pytest.approx(
        [9 * full, 4 * full], rel=0.1
    )
    assert all(np.divide(*c.widths_um) == pytest.approx(9 / 4, rel=0.15) for c in found)
    assert all(abs((c.angle_deg - angle + 90) % 180 - 90) < 6 for c in found)


def test_a_turned_texture_has_a_turned_axis():
    y, x = np.mgrid[-40:41, -40:41].astype(float)
    turn = math.radians(30)  # clockwise on the screen: towards growing rows
    along, across = (
        x * math.cos(turn) + y * math.sin(turn),
        -x * math.sin(turn) + y * math.cos(turn),
    )
    a = np.exp(-((along / 12) ** 2) - (across / 5) ** 2)
    found = cross_correlogram(a, a, pixel_um=1.0, reach_um=35.0)
    assert found.angle_deg == pytest.approx(30, abs=2)
    assert np.divide(*found.widths_um) == pytest.approx(12 / 5, rel=0.1)


def test_limits_are_those_of_r_wider_far_away_and_missing_for_long_waves():
    a, b = gaussian_maps(5, (90, 120), 4.0)
    found = cross_correlogram(a, b, pixel_um=2.0, reach_um=60.0)
    alone = correlate(a, b, pixel_um=2.0)
    assert (found.n_eff, found.r[30, 30]) == (pytest.approx(alone.n_eff), pytest.approx(alone.r))
    assert found.band_99[30, 30] == pytest.approx(2.576 / math.sqrt(found.n_eff), rel=0.02)
    assert found.band_99[0, 0] == pytest.approx(
        found.band_99[30, 30] * math.sqrt(120 * 90 / 90 / 60), rel=0.02
    )
    assert (found.band_99_of_any > 1.2 * found.band_99).all()
    a, b = gaussian_maps(6, (40, 50), 30.0, kind="gauss")
    found = cross_correlogram(a, b, pixel_um=1.0, reach_um=10.0)
    assert np.isnan(found.band_99).all()
    assert found.beyond_chance is None


def test_a_reach_of_less_than_a_pixel_is_refused():
    a = gaussian_maps(8, (30, 40), 3.0)[0]
    refused(SizeError, "reach of a pixel", cross_correlogram, a, a, pixel_um=2.0, reach_um=1.0)


@pytest.mark.nightly
@pytest.mark.parametrize(("length", "kind"), [(1.0, "gauss"), (5.0, "exp"), (12.0, "gauss")])
def test_unrelated_maps_exceed_the_limits_in_one_of_a_hundred(length, kind):
    rng, n = np.random.default_rng(9), 600
    alone, anywhere = [], []
    for _ in range(n):
        c = cross_correlogram(
            *gaussian_maps(rng, (90, 120), length, kind=kind), pixel_um=1.0, reach_um=20.0
        )
        alone.append(np.mean(np.abs(c.r) > c.band_99))
        anywhere.append(c.beyond_chance)
    print(length, kind, np.mean(alone), np.mean(anywhere))
    assert 0.003 < np.mean(alone) < 0.015
    # 1 %, of 600: 14 or more by chance in one of 100.
    assert np.count_nonzero(anywhere) < 14
