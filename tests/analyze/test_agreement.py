import math

import numpy as np
import pytest

from analyze.fields import gaussian_maps
from planish.analyze import bland_altman


def measured(rng, shape, *, bias=2.0, sd=0.5, length=3.0):
    truth, error = gaussian_maps(rng, shape, length)
    return 3 * truth, 3 * truth + bias + sd * error


def test_white_differences_have_the_textbook_numbers():
    rng = np.random.default_rng(0)
    a = rng.normal(size=(60, 80))
    d = 1 + 0.5 * rng.normal(size=a.shape)
    found = bland_altman(a, a + d, pixel_um=1.0)
    n = d.size
    assert (found.n, found.bias) == (n, pytest.approx(d.mean(), abs=1e-12))
    assert found.sd == pytest.approx(d.std(ddof=1), abs=1e-12)
    assert found.limits == pytest.approx(
        [d.mean() + k * 1.96 * d.std(ddof=1) for k in (-1, 1)], abs=1e-9
    )
    assert found.n_eff == pytest.approx(n, rel=0.25)
    width = np.diff(found.bias_interval)[0] / 2
    t = 2.262  # of 9 degrees of freedom
    assert width == pytest.approx(t * found.sd / math.sqrt(found.n_eff), rel=0.01)
    assert found.sd_interval[1] / found.sd == pytest.approx(
        1 + t / math.sqrt(2 * found.n_eff_sd), rel=0.01
    )
    # Bland and Altman (1986): the standard error of a limit is about sqrt(3 / n) of the standard
    # deviation.
    wide = np.diff(found.limit_intervals[1])[0] / 2
    assert wide == pytest.approx(
        t * found.sd * math.sqrt(1 / found.n_eff + 1.96**2 / 2 / found.n_eff_sd), rel=0.01
    )


def test_lines_of_both_directions_stand_beside_and_a_swap_turns_the_sign():
    a, b = measured(1, (60, 80))
    found = bland_altman(a, b, pixel_um=1.0)
    assert found.slope == pytest.approx(np.polyfit(a.ravel(), b.ravel(), 1)[0])
    assert found.slope_x_on_y == pytest.approx(np.polyfit(b.ravel(), a.ravel(), 1)[0])
    a, b = measured(3, (60, 80))
    one, two = bland_altman(a, b, pixel_um=1.0), bland_altman(b, a, pixel_um=1.0)
    assert (two.bias, two.limits) == (
        pytest.approx(-one.bias),
        pytest.approx((-one.limits[1], -one.limits[0])),
    )
    assert two.limit_intervals[0] == pytest.approx(
        (-one.limit_intervals[1][1], -one.limit_intervals[1][0])
    )
    assert (two.slope, two.slope_x_on_y) == pytest.approx((one.slope_x_on_y, one.slope))


def test_texture_widens_the_intervals_until_nothing_is_claimed():
    rng = np.random.default_rng(2)
    rough, smooth = (
        bland_altman(*measured(rng, (90, 120), length=length), pixel_um=1.0)
        for length in (1.0, 6.0)
    )
    assert smooth.n_eff < rough.n_eff / 10
    assert np.diff(smooth.bias_interval) > 3 * np.diff(rough.bias_interval)
    # Squares vary faster than the map itself.
    assert smooth.n_eff_sd > smooth.n_eff
    rng = np.random.default_rng(6)
    a = gaussian_maps(rng, (40, 50), 3.0)[0]
    found = bland_altman(a, a + gaussian_maps(rng, a.shape, 40.0, kind="gauss")[0], pixel_um=1.0)
    assert found.n_eff < 10
    assert np.isnan([*found.bias_interval, *found.sd_interval, *found.limit_intervals[0]]).all()
    assert math.isfinite(found.bias)


def test_an_offset_alone_has_no_spread():
    a = gaussian_maps(5, (30, 40), 3.0)[0]
    found = bland_altman(a, a + 2, pixel_um=1.0)
    assert (found.sd, found.limits, found.bias_interval) == (
        0,
        pytest.approx((2, 2)),
        pytest.approx((2, 2)),
    )


@pytest.mark.nightly
@pytest.mark.parametrize("length", [1.0, 4.0, 8.0])
def test_intervals_hold_the_truth(length):
    rng, held = np.random.default_rng(7), []
    for _ in range(400):
        found = bland_altman(*measured(rng, (90, 120), length=length), pixel_um=1.0)
        truth = (2.0, 0.5, 2 - 1.96 * 0.5, 2 + 1.96 * 0.5)
        intervals = (found.bias_interval, found.sd_interval, *found.limit_intervals)
        held.append([low < v < high for v, (low, high) in zip(truth, intervals, strict=True)])
    print(length, np.mean(held, axis=0))
    # 400 maps scatter by .011.
    assert (np.mean(held, axis=0) > 0.91).all()
    assert (np.mean(held, axis=0) < 0.985).all()
