"""Curves through points: textbook formulas, known layers, and intervals that hold the truth."""

import numpy as np
import pytest
from scipy import optimize, stats

from analyze.fields import gaussian_maps
from folders import refused
from planish.analyze import (
    bland_altman,
    correlate,
    fit_kubelka_munk,
    independent_points,
    straight_or_curved,
)
from planish.core.errors import CannotMeasure, InputError
from planish.core.reflectance import layer_over


@pytest.fixture
def x():
    return np.random.default_rng(0).normal(17.0, 4.5, 1000).clip(0.5)


def bright(x, s=0.15, ratio=0.002, backing=0.794):
    return layer_over(backing, s, s * ratio, x)


def with_noise(x, sd=0.017, seed=1):
    return bright(x) + np.random.default_rng(seed).normal(0.0, sd, x.size)


def test_with_independent_points_it_is_the_textbook(x):
    y = with_noise(x)
    found = straight_or_curved(x, y, n_eff=x.size)
    for degree, value, (low, high) in [
        (1, found.slope, found.slope_interval),
        (2, found.curvature, found.interval),
    ]:
        about, covariance = np.polyfit(x - x.mean(), y, degree, cov=True)
        width = stats.t.ppf(0.975, x.size - degree - 1) * np.sqrt(covariance[0, 0])
        assert (value, low, high) == pytest.approx(
            (about[0], about[0] - width, about[0] + width), rel=1e-9
        )
    assert found.r2_line == pytest.approx(np.corrcoef(x, y)[0, 1] ** 2)


def test_fewer_independent_points_widen_and_missing_points_do_not_count(x):
    y = with_noise(x)
    wide, narrow = (straight_or_curved(x, y, n_eff=n) for n in (100, 1000))
    ratio = np.ptp(wide.interval) / np.ptp(narrow.interval)
    assert ratio == pytest.approx(
        np.sqrt(997 / 97) * stats.t.ppf(0.975, 97) / stats.t.ppf(0.975, 997), rel=1e-9
    )
    assert wide.curvature == narrow.curvature
    both = straight_or_curved(x, y, n_eff=100, n_eff_square=1000)
    assert (both.slope_interval, both.interval) == (wide.slope_interval, narrow.interval)
    holed_x, holed_y = x.copy(), y.copy()
    holed_x[:100], holed_y[100:150] = np.nan, np.inf
    assert straight_or_curved(holed_x, holed_y, n_eff=50) == straight_or_curved(
        x[150:], y[150:], n_eff=50
    )
    assert fit_kubelka_munk(holed_x, holed_y, n_eff=50) == fit_kubelka_munk(
        x[150:], y[150:], n_eff=50
    )


@pytest.mark.parametrize(
    ("curve", "words"),
    [
        (lambda x: np.sqrt(x), "curved, saturating"),
        (lambda x: -np.sqrt(x), "curved, saturating"),
        (lambda x: x**2, "curved, growing"),
        (lambda x: 3 - 2 * x, "not distinguishable from a straight line"),
    ],
)
def test_words(x, curve, words):
    scatter = 0.01 * np.random.default_rng(3).normal(size=x.size)
    assert straight_or_curved(x, curve(x) + scatter, n_eff=200).words == words


def test_shift_and_scale_carry_over_and_a_valley_has_no_slope(x):
    y = with_noise(x)
    one, other = (
        straight_or_curved(x, y, n_eff=100),
        straight_or_curved(10 * x + 5, 3 - 2 * y, n_eff=100),
    )
    assert (other.slope, other.curvature) == (
        pytest.approx(-one.slope / 5),
        pytest.approx(-one.curvature / 50),
    )
    assert other.interval == pytest.approx(tuple(-v / 50 for v in one.interval[::-1]))
    assert other.words == one.words
    # Its straight line is level.
    y = (x - x.mean()) ** 2 - np.mean((x - x.mean()) ** 3) / x.var() * x
    assert straight_or_curved(x, y, n_eff=200).words == "curved, without a slope"


@pytest.mark.parametrize(
    ("s", "ratio", "backing"),
    [(0.15, 0.002, 0.794), (0.05, 0.01, 0.0), (0.24, 0.0, 0.3), (0.1, 0.5, 0.9)],
)
def test_a_layer_without_noise_is_found(x, s, ratio, backing):
    y = bright(x, s, ratio, backing)
    found = fit_kubelka_munk(x, y, n_eff=100, absorption_over_scattering=ratio)
    assert (found.scattering, found.backing) == (
        pytest.approx(s, rel=0.02),
        pytest.approx(backing, abs=0.02),
    )
    assert found(x) == pytest.approx(y, abs=1e-6)
    assert found.rms < 1e-6


def test_the_backing_beside_an_end_of_the_interval_leaves_least_there(x):
    y = with_noise(x)
    found = fit_kubelka_munk(x, y, n_eff=100, absorption_over_scattering=0.002)
    for s, backing in zip(found.scattering_interval, found.backing_at_ends, strict=True):
        left = [
            np.sum((bright(x, s, 0.002, backing + step) - y) ** 2) for step in (-0.003, 0.0, 0.003)
        ]
        assert left[1] == min(left)


def test_a_unit_of_x_is_a_unit_of_scattering_which_absorption_left_out_lowers(x):
    y = with_noise(x)
    one, other = fit_kubelka_munk(x, y, n_eff=100), fit_kubelka_munk(x / 1000, y, n_eff=100)
    assert other.scattering == pytest.approx(1000 * one.scattering, rel=1e-6)
    assert other.scattering_interval == pytest.approx(
        tuple(1000 * v for v in one.scattering_interval), rel=1e-4
    )
    assert other.backing_interval == pytest.approx(one.backing_interval, rel=1e-4)
    # As the docstring says. The slope of the layer is S [(1 - R)^2 - 2 R K/S].
    found = fit_kubelka_munk(x, bright(x), n_eff=100)
    assert found.scattering / 0.15 == pytest.approx(0.84, abs=0.01)


def test_little_noise_gives_the_intervals_of_a_linearised_fit(x):
    y = with_noise(x, sd=1e-4)
    found = fit_kubelka_munk(x, y, n_eff=x.size, absorption_over_scattering=0.002)
    about, covariance = optimize.curve_fit(
        lambda x, s, g: bright(x, s, 0.002, g), x, y, p0=(0.1, 0.7)
    )
    width = stats.t.ppf(0.975, x.size - 2) * np.sqrt(np.diag(covariance))
    assert (found.scattering, found.backing) == pytest.approx(tuple(about), rel=1e-4)
    for k, (low, high) in enumerate((found.scattering_interval, found.backing_interval)):
        assert (low - about[k], high - about[k]) == pytest.approx((-width[k], width[k]), rel=0.02)


def test_intervals_equal_those_of_a_grid(x):
    # Slow twin: all pairs of S and backing whose sum of squares is small enough; its step is the
    # tolerance.
    x, y = x[:100], with_noise(x[:100], sd=0.03)
    found = fit_kubelka_munk(x, y, n_eff=40, absorption_over_scattering=0.002)
    s, g = np.linspace(0, 0.6, 101), np.linspace(0.5, 1.0, 101)
    squares = np.sum((bright(x, s[:, None, None], 0.002, g[:, None]) - y) ** 2, axis=-1)
    inside = squares < np.sum((found(x) - y) ** 2) * (1 + stats.t.ppf(0.975, 38) ** 2 / 38)
    rows, cols = (np.flatnonzero(inside.any(axis=k)) for k in (1, 0))
    assert found.scattering_interval == pytest.approx((s[rows[0]], s[rows[-1]]), abs=0.007)
    assert found.backing_interval == pytest.approx((g[cols[0]], g[cols[-1]]), abs=0.007)


def test_a_level_that_is_less_sure_widens_the_intervals_and_leaves_the_fit(x):
    y = with_noise(x)
    one, other = (fit_kubelka_munk(x, y, n_eff=200, n_eff_level=n) for n in (200, 20))
    assert one == fit_kubelka_munk(x, y, n_eff=200)
    assert other.scattering == pytest.approx(one.scattering, rel=2e-3)
    assert other.rms == pytest.approx(one.rms, rel=1e-3)
    # Level and slope add as squares: dS/S = dslope/slope + 2 dR/(1 - R), R being the mean.
    width = [np.ptp(f.scattering_interval) / 2 / f.scattering for f in (one, other)]
    level = 2 * 2 * one.rms / (1 - y.mean()) * np.sqrt(1 / 20 - 1 / 200)
    assert width[1] ** 2 - width[0] ** 2 == pytest.approx(level**2, rel=0.15)


def test_independent_points_are_those_of_the_rest_with_x_with_its_square_and_alone():
    x, e = gaussian_maps(6, (50, 60), 2.0)
    x[10:20, 15:30] = np.nan
    found = independent_points(x, 2 * x + e, pixel_um=10)
    known = np.isfinite(x)
    rest = e - np.polyval(np.polyfit(x[known], e[known], 1), x)
    for n, m in ((found.n_eff, x), (found.n_eff_square, (x - x[known].mean()) ** 2)):
        assert n == pytest.approx(correlate(m, rest, pixel_um=10).n_eff, rel=1e-6)
    assert found.n_eff_level == pytest.approx(
        bland_altman(x, x + rest, pixel_um=10).n_eff, rel=1e-6
    )


def test_intervals_end_at_what_is_possible(x):
    found = fit_kubelka_munk(x, with_noise(x, sd=0.05).clip(0, 1), n_eff=12)
    assert found.scattering_interval[0] == 0
    assert found.scattering_interval[1] > found.scattering
    assert 0 <= found.backing_interval[0] < found.backing < found.backing_interval[1] <= 1
    # From the first point on the layer hides its backing, so any larger S fits as well.
    x = np.linspace(5.0, 30.0, 400)
    y = bright(x, 10.0, 0.05, 0.2) + np.random.default_rng(4).normal(0, 0.01, 400)
    y -= np.polyval(np.polyfit(x, y, 1), x) - y.mean()
    y += 1e-4 * (x - x.mean())
    found = fit_kubelka_munk(x, y, n_eff=100, absorption_over_scattering=0.05)
    assert found.scattering_interval[1] == np.inf


NAN = np.full(50, np.nan)
RISE = np.linspace(1.0, 20.0, 50)


@pytest.mark.parametrize("call", [straight_or_curved, fit_kubelka_munk])
@pytest.mark.parametrize(
    ("x", "y", "n_eff", "error", "message"),
    [
        (RISE, RISE[:-1] / 30, 20, InputError, r"x has \(50,\) points, y has \(49,\)"),
        (RISE, RISE.astype(str), 20, InputError, "y has <U"),
        (RISE, RISE / 30, 51, InputError, "n_eff is 51 of 50 points"),
        (
            RISE,
            RISE / 30,
            9.4,
            CannotMeasure,
            "50 points are known .* 9 of them independent; .* 10 .* larger field",
        ),
        (RISE, RISE / 30, np.nan, CannotMeasure, "an unknown number of them"),
        (RISE, NAN, 20, CannotMeasure, "0 points are known"),
        (np.full(50, 7.0), RISE / 30, 20, CannotMeasure, "x has 1 different value;"),
        (np.repeat([5.0, 10.0], 25), RISE / 30, 20, CannotMeasure, "x has 2 different values"),
    ],
)
def test_points_that_show_no_curve_are_refused(call, x, y, n_eff, error, message):
    refused(error, message, call, x, y, n_eff=n_eff)


@pytest.mark.parametrize(
    ("x", "y", "options", "error", "message"),
    [
        (
            RISE,
            131 + RISE,
            {},
            InputError,
            r"50 of 50 greys .* \(132 to 151\).* dark and a white reference",
        ),
        (RISE, RISE / 19.5, {}, InputError, "2 of 50 greys"),
        (
            RISE - 2,
            RISE / 30,
            {},
            InputError,
            "3 of 50 thicknesses or weights are below 0, down to -1",
        ),
        (
            RISE,
            RISE / 30,
            {"absorption_over_scattering": -0.1},
            InputError,
            "absorption_over_scattering is -0.1",
        ),
        (RISE, RISE / 30, {"n_eff_level": 0}, InputError, "n_eff_level is 0"),
        (RISE, 0.8 - RISE / 100, {}, CannotMeasure, "the grey does not rise .* darkens"),
        (RISE, 0 * RISE + 0.5, {}, CannotMeasure, "No scattering layer"),
    ],
)
def test_greys_that_are_no_layer_are_refused(x, y, options, error, message):
    refused(error, message, fit_kubelka_munk, x, y, n_eff=20, **options)


@pytest.mark.nightly
def test_intervals_hold_the_truth():
    # Neighbours resemble each other; r² is .26. The binomial's own scatter of 150 fields at .95 is
    # .018.
    rng, inside, straight_is_straight = np.random.default_rng(5), [], []
    for _ in range(150):
        a, e = gaussian_maps(rng, (40, 50), 2.0)
        x = (17 + 4.5 * a).clip(0)
        curve, line = bright(x) + 0.0175 * e, 0.8 + 0.0023 * x + 0.0175 * e
        points = independent_points(x, line, pixel_um=1)
        fit = fit_kubelka_munk(
            x,
            curve,
            n_eff=points.n_eff,
            n_eff_level=points.n_eff_level,
            absorption_over_scattering=0.002,
        )
        (s, t), (g, h) = fit.scattering_interval, fit.backing_interval
        bend = straight_or_curved(x, line, n_eff=points.n_eff, n_eff_square=points.n_eff_square)
        inside.append(
            (
                s <= 0.15 <= t,
                g <= 0.794 <= h,
                bend.slope_interval[0] <= 0.0023 <= bend.slope_interval[1],
            )
        )
        straight_is_straight.append(bend.words.startswith("not"))
    print(np.mean(inside, axis=0), np.mean(straight_is_straight))
    shares = [*np.mean(inside, axis=0), np.mean(straight_is_straight)]
    assert min(shares) > 0.90
    assert max(shares) < 0.99
