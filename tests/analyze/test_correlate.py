import numpy as np
import pytest
import xarray as xr

import planish as pl
from analyze.fields import exact_n_eff, gaussian_maps, related_maps
from folders import refused
from planish.analyze import PairAtSizes, PairSums, correlate, pearson
from planish.core.errors import InputError, PlanishError, SizeError
from planish.texture import covariance


def pair(r, shape=(200, 300), seed=0):
    a, b = np.random.default_rng(seed).normal(size=(2, *shape))
    return a, r * a + np.sqrt(1 - r * r) * b


@pytest.mark.parametrize("r", [-0.7, 0.0, 0.45, 0.95])
def test_a_known_correlation_of_independent_points_is_found(r):
    found = correlate(*pair(r), pixel_um=4.0)
    standard_error = (1 - r * r) / np.sqrt(60_000)
    assert (found.r, found.r2) == (
        pytest.approx(r, abs=4 * standard_error + 1e-12),
        pytest.approx(found.r**2),
    )
    assert (found.n, found.point_um, found.n_eff) == (60_000, 4.0, pytest.approx(60_000, rel=0.05))
    assert found.n_eff_interval == pytest.approx(60_000, rel=0.12)
    low, high = found.interval
    assert high - low == pytest.approx(2 * 1.96 * (1 - found.r**2) / np.sqrt(60_000), rel=0.08)
    assert low < r < high
    assert (found.warnings, found.direction) == ((), np.sign(r))


def test_slopes_are_those_of_the_lines():
    x = np.random.default_rng(2).normal(size=(30, 40))
    found = correlate(x, 3 * x - 2, pixel_um=1)
    assert (found.slope, found.intercept, found.r, found.slope_x_on_y) == pytest.approx(
        (3, -2, 1, 1 / 3)
    )
    assert (found.interval, found.p, correlate(x, -x, pixel_um=1).interval) == (
        (found.r, found.r),
        0,
        (-1, -1),
    )
    assert pearson(np.arange(5.0), -np.arange(5.0)) == pytest.approx(-1)


def test_missing_points_do_not_count():
    a, b = pair(0.6, (20, 25))
    a[::3] = np.nan
    b[:, ::7] = np.inf
    keep = np.isfinite(a) & np.isfinite(b)
    found = correlate(a, b, pixel_um=1)
    assert (found.r, found.n) == (pytest.approx(np.corrcoef(a[keep], b[keep])[0, 1]), keep.sum())


@pytest.mark.parametrize(
    ("a", "b", "word"),
    [
        (np.full((3, 3), 5.0), np.arange(9.0).reshape(3, 3), "The first map is constant"),
        (np.arange(9.0).reshape(3, 3), np.full((3, 3), 5.0), "The second map is constant"),
        (np.array([[1.0, 2.0]]), np.array([[1.0, 2.0]]), "Only 2 points"),
        (np.zeros((0, 4)), np.zeros((0, 4)), "Only 0 points"),
    ],
)
def test_nothing_to_correlate_is_no_number(a, b, word):
    found = correlate(a, b, pixel_um=1)
    assert np.isnan([found.r, found.rho, found.slope, found.n_eff, found.p, *found.interval]).all()
    assert word in found.warnings[0]


def test_points_are_means_over_pixels_valid_in_both():
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(2, 40, 60))
    a[:, :10] = np.nan
    assert correlate(a, b, pixel_um=5.0, point_um=50.0).n == 20
    pairs = PairAtSizes((40, 60), pixel_um=(5.0, 5.0), point_um=50.0)
    pairs.add(0, a, b)
    x, y = pairs.points()
    assert (x.shape, x[1, 2]) == ((4, 6), pytest.approx(a[10:20, 20:30].mean()))
    assert np.array_equal(np.isnan(x), np.isnan(y))
    missing = rng.random(a.shape) < 0.2
    for one, other in ((a, np.where(missing, np.nan, b)), (np.where(missing, np.nan, a), b)):
        pairs = PairAtSizes((40, 60), pixel_um=(5.0, 5.0), point_um=50.0)
        pairs.add(0, one, other)
        block = np.s_[10:20, 20:30]
        for means, m in zip(pairs.points(), (a, b), strict=True):
            assert means[1, 2] == pytest.approx(m[block][~missing[block]].mean())


def test_sums_of_parts_are_those_of_the_whole():
    a, b = (m.ravel() for m in pair(0.4, (50, 100)))
    a, b = 1e4 + a, b - 300
    b[::7] = np.nan
    sums = PairSums()
    for part in np.array_split(np.arange(5000), [0, 1, 40, 3000]):
        sums.add(a[part], b[part])
    known = np.isfinite(b)
    off = (b - a)[known]
    assert (sums.n, sums.r) == (
        known.sum(),
        pytest.approx(np.corrcoef(a[known], b[known])[0, 1], abs=1e-12),
    )
    assert sums.lines[:2] == pytest.approx(np.polyfit(a[known], b[known], 1), rel=1e-6)
    assert sums.lines[2] == pytest.approx(np.polyfit(b[known], a[known], 1)[0], rel=1e-6)
    assert sums.difference == pytest.approx((off.mean(), off.std(ddof=1)))


# --- independent points ---------------------------------------------------------------------------
def holed(shape, rng):
    return rng.random(shape) > 0.15


@pytest.mark.parametrize("masked", [False, True])
def test_sums_by_lag_and_n_eff_equal_those_over_all_pairs_of_points(masked):
    rng = np.random.default_rng(5)
    shape = (17, 23)
    x, y = related_maps(rng, shape, 3.0, 0.4)
    known = holed(shape, rng) if masked else np.ones(shape, bool)
    found = covariance.PairCovariances(
        np.where(known, x, 9.0), np.where(known, y, -9.0), covariance.Lags(known, (1.0, 1.0))
    )
    at = np.argwhere(known)
    lag = at[None, :] - at[:, None]
    values = [m[known] - m[known].mean() for m in (x, y)]
    n = len(at)
    inside = (np.abs(lag[..., 0]) <= shape[0] // 2) & (np.abs(lag[..., 1]) <= shape[1] // 2)
    ring = np.rint(np.hypot(lag[..., 0], lag[..., 1])).astype(int)
    matrices = []
    for v in values:
        products = np.outer(v, v)
        rings = np.bincount(ring[inside], weights=products[inside])
        used = inside & (ring < np.flatnonzero(rings <= 0)[0])
        mean = products[used].sum() / (n**2 - used.sum())
        matrix = np.zeros((n, n))
        for key in {tuple(k) for k in lag[used]}:
            same = used & (lag[..., 0] == key[0]) & (lag[..., 1] == key[1])
            matrix[same] = products[same].mean() + mean
        matrices.append(matrix - matrix.mean(axis=0) - matrix.mean(axis=1)[:, None] + matrix.mean())
    direct = np.trace(matrices[0] @ matrices[1]) / (np.trace(matrices[0]) * np.trace(matrices[1]))
    assert found.variance_of_r() == pytest.approx(direct, rel=1e-9)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("length", "kind", "hole"),
    [(2.0, "exp", False), (3.0, "gauss", False), ((1.5, 3.0), "exp", False), (3.0, "exp", True)],
)
def test_n_eff_is_that_of_the_covariance_also_around_a_hole(length, kind, hole):
    rng, known = np.random.default_rng(6), np.ones((50, 60), bool)
    known[10:40, 10:30] = not hole
    maps = [gaussian_maps(rng, known.shape, length, kind=kind) for _ in range(60)]
    found = [correlate(*pair, mask=known, pixel_um=1).n_eff for pair in maps]
    assert np.median(found) == pytest.approx(
        exact_n_eff(known.shape, length, known=known, kind=kind), rel=0.12
    )


def test_large_maps_by_cells_say_the_same():
    a, b = related_maps(9, (240, 300), 12.0, 0.5)
    whole, cells = correlate(a, b, pixel_um=2.0), correlate(a, b, pixel_um=2.0, most_cells=8000)
    assert (cells.r, cells.n_eff) == (whole.r, pytest.approx(whole.n_eff, rel=0.03))
    assert cells.interval == pytest.approx(whole.interval, abs=0.005)
    assert cells.rho == pytest.approx(whole.rho, abs=0.02)


# --- what must change nothing ---------------------------------------------------------------------

NUMBERS = ("r", "rho", "slope", "slope_x_on_y", "n_eff", "n_eff_interval")


def numbers(found):
    return np.array([*(getattr(found, name) for name in NUMBERS), *found.interval])


def test_masks_scale_places_exchange_and_transposition_change_no_number():
    rng = np.random.default_rng(10)
    (a, b), known = related_maps(rng, (60, 80), 4.0, 0.5), holed((60, 80), rng)
    one = correlate(a, b, mask=known, pixel_um=1)
    for junk in (np.nan, 1e30, -np.inf):
        two = correlate(np.where(known, a, junk), np.where(known, b, -junk), mask=known, pixel_um=1)
        np.testing.assert_allclose(numbers(two), numbers(one), rtol=1e-12)
    scaled = correlate(3.7 * a, b / 11, mask=known, pixel_um=1)
    np.testing.assert_allclose(
        numbers(scaled)[[0, 1, 4, 5, 6, 7]], numbers(one)[[0, 1, 4, 5, 6, 7]], rtol=1e-12
    )
    moved = correlate(a + 1e4, b - 1e4, mask=known, pixel_um=1)
    np.testing.assert_allclose(numbers(moved), numbers(one), rtol=1e-9)
    assert moved.p == pytest.approx(one.p, rel=1e-8)
    coords = {"y": np.arange(60.0), "x": np.arange(80.0)}
    p, q, m = (xr.DataArray(v, dims=("y", "x"), coords=coords) for v in (a, b, known))
    assert pl.correlate(p, q, mask=m, pixel_um=1) == one
    one, two = correlate(a, b, mask=known, pixel_um=1), correlate(b, a, mask=known, pixel_um=1)
    np.testing.assert_allclose(numbers(two)[[0, 1, 3, 2, 4, 5, 6, 7]], numbers(one), rtol=1e-12)
    assert two.p == pytest.approx(one.p, rel=1e-9)
    one = correlate(a, b, mask=known, pixel_um=(1.0, 1.5))
    two = correlate(a.T, b.T, mask=known.T, pixel_um=(1.5, 1.0))
    np.testing.assert_allclose(numbers(two), numbers(one), rtol=1e-6)


# --- what is said ---------------------------------------------------------------------------------
def test_two_planes_say_nothing():
    rows, cols = np.mgrid[:60, :80].astype(float)
    found = correlate(rows + cols, rows + 2 * cols, pixel_um=1)
    assert found.n_eff < 10
    assert np.isnan([found.p, *found.interval]).all()
    assert found.direction == 0
    assert "nothing is claimed" in found.warnings[0]


def test_few_points_trends_and_constant_maps_are_named():
    found = [
        correlate(*gaussian_maps(np.random.default_rng(k), (60, 80), 13.0), pixel_um=1)
        for k in range(20)
    ]
    assert any("independent points" in w for c in found for w in c.warnings)
    a, b = gaussian_maps(1, (60, 80), 2.0)
    slope = np.linspace(0, 4, 80)
    found = correlate(a + slope, b + slope, pixel_um=1)
    assert found.r > 0.4
    warned = [w for w in found.warnings if "Trends over the whole field" in w]
    assert warned
    assert abs(float(warned[0].rpartition("r is ")[2].rstrip("."))) < 0.2
    assert not correlate(a + slope, b, pixel_um=1).warnings
    a, b = pair(0.5, (30, 40))
    a[np.random.default_rng(0).random(a.shape) < 0.95] = 0.0
    assert any(
        "of the first map have the same value" in w for w in correlate(a, b, pixel_um=1).warnings
    )


@pytest.mark.parametrize(
    ("change", "error", "word"),
    [
        ({"pixel_um": 0}, SizeError, "pixel is 0 um"),
        ({"pixel_um": (1, np.nan)}, SizeError, "Give one number"),
        ({"pixel_um": "2"}, SizeError, "Give one number"),
        ({"point_um": 0.5}, SizeError, "smaller than a pixel"),
        ({"b": np.zeros((4, 5))}, InputError, "onto one grid"),
        ({"b": np.full((6, 7), "x")}, InputError, "numbers"),
        ({"b": [[1.0]]}, InputError, "two dimensions"),
        ({"mask": np.zeros((6, 7))}, InputError, "true or false"),
        ({"mask": np.ones((7, 6), bool)}, InputError, "mask has"),
    ],
)
def test_wrong_input_is_a_sentence(change, error, word):
    given = {"a": np.ones((6, 7)), "b": np.ones((6, 7)), "pixel_um": 1.0} | change
    with pytest.raises(error, match=word) as raised:
        correlate(given.pop("a"), given.pop("b"), **given)
    assert isinstance(raised.value, PlanishError)


def test_maps_at_other_places_are_refused():
    a = xr.DataArray(
        np.ones((4, 5)), dims=("y", "x"), coords={"y": np.arange(4.0), "x": np.arange(5.0)}
    )
    for b in (a.assign_coords(x=np.arange(5.0) + 1), a.rename(x="u")):
        refused(InputError, "other places", correlate, a, b, pixel_um=1)
