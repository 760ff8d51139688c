"""The thin-plate spline against scipy's, its derivatives against differences, and the way back."""

import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator

from folders import refused
from planish.core.errors import CannotRegister
from planish.register import Pairs, fit_transform
from planish.register.spline import Smoothing
from register.patterns import covariances, marks


def bent(points, size=3000.0, amount=15.0):
    x, y = np.moveaxis(points / size, -1, 0)
    return points + amount * np.stack([np.sin(2.5 * x + y), np.cos(2 * y - x)], axis=-1)


def pairs_of(moving, fixed, weights=None):
    w = np.ones(len(moving)) if weights is None else weights
    return Pairs(moving=moving, fixed=fixed, information=w[:, None, None] * np.eye(2))


@pytest.mark.parametrize("smoothing", [0.0, 3e3, 1e7])
def test_it_is_the_spline_of_scipy(smoothing):
    """An independent solver of the same equations; 1e-6 um of 3000, what its unscaled coordinates
    allow."""
    rng = np.random.default_rng(1)
    moving = marks(20)
    fixed, weights = bent(moving) + rng.normal(0, 2, (20, 2)), rng.uniform(0.5, 2, 20)
    twin = RBFInterpolator(
        moving, fixed, kernel="thin_plate_spline", degree=1, smoothing=smoothing / weights
    )
    where = marks(100, seed=2)
    ours = Smoothing(pairs_of(moving, fixed, weights)).spline(smoothing)
    np.testing.assert_allclose(ours(where), twin(where), rtol=0, atol=1e-6)


@pytest.mark.parametrize("n", [6, 30, 100])
def test_without_smoothing_it_goes_through_its_marks(n):
    """Coordinates of 20 mm: 1e-6 um."""
    moving = marks(n, size=20000.0) + 20000.0
    fixed = bent(moving, 20000.0, 60.0)
    spline = Smoothing(pairs_of(moving, fixed)).spline(0.0)
    np.testing.assert_allclose(spline(moving), fixed, rtol=0, atol=1e-6)
    inside = marks(300, 5, 20000.0) + 20000.0
    np.testing.assert_allclose(spline.inverse(spline(inside)), inside, rtol=0, atol=1e-9 * 100)


def test_leave_one_out_equals_the_fit_without_each_mark_at_the_same_smoothing():
    rng = np.random.default_rng(3)
    moving = marks(12)
    weights = covariances(12, rng)
    fit = fit_transform(
        moving, bent(moving) + rng.normal(0, 2, (12, 2)), model="tps", weights=weights, robust=False
    )
    smoothing = fit.transform.smoothing_um2
    assert 0 < smoothing < np.inf
    for k in range(12):
        others = np.arange(12) != k
        pairs = Pairs(moving=moving, fixed=fit.fixed, information=fit.information).take(others)
        twin = np.linalg.norm(Smoothing(pairs).spline(smoothing)(moving[k]) - fit.fixed[k])
        assert fit.leave_one_out_um[k] == pytest.approx(twin, rel=0, abs=1e-9)


def test_the_smoothing_is_the_one_that_misses_marks_left_out_least():
    rng = np.random.default_rng(4)
    moving = marks(20)
    system = Smoothing(pairs_of(moving, bent(moving) + rng.normal(0, 3, (20, 2))))

    def cost(smoothing):
        return np.sum(system.missed(smoothing) ** 2)

    best = cost(system.choose())
    assert all(best <= cost(s) * (1 + 1e-6) for s in [0.0, *np.logspace(0, 12, 200), np.inf])


def test_derivatives_are_differences_and_the_inverse_is_nan_where_there_is_none():
    moving = marks(15)
    spline = Smoothing(pairs_of(moving, bent(moving))).spline(1e3)
    where, step = marks(40, seed=6), 1e-3
    for axis in (0, 1):
        off = step * np.eye(2)[axis]
        slope = (spline(where + off) - spline(where - off)) / (2 * step)
        np.testing.assert_allclose(spline.jacobian(where)[..., axis], slope, rtol=0, atol=1e-8)
    spline = Smoothing(pairs_of(moving, bent(moving))).spline(0.0)
    inside = spline([[1000.0, 1200.0]])[0]
    found = spline.inverse([inside, [9e5, 0.0], [np.nan, 1.0]])
    np.testing.assert_allclose(found[0], [1000.0, 1200.0], rtol=0, atol=1e-9)
    assert np.isnan(found[1:]).all()
    assert spline.inverse(np.full((3, 4, 2), np.nan)).shape == (3, 4, 2)


def test_a_fold_is_refused_with_its_place_and_a_strain_of_one_per_cent_reported():
    moving = np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0)), axis=-1).reshape(-1, 2) * 500
    fixed = moving.copy()
    # Two neighbours have changed places, exactly enough in number that no spline of the others
    # passes them by.
    fixed[moving[:, 0] == 1000.0] += [700.0, 0.0]
    fixed[moving[:, 0] == 1500.0] -= [700.0, 0.0]
    refused(
        CannotRegister,
        "folds the map near",
        fit_transform,
        moving,
        fixed,
        model="tps",
        robust=False,
    )
    moving = marks(20)
    assert "Local strain" not in str(
        fit_transform(moving, bent(moving, amount=5.0), model="tps").warnings
    )
    fit = fit_transform(moving, bent(moving, amount=60.0), model="tps")
    assert "Local strain" in fit.warnings[-1]
    assert fit.strain.largest > 0.01
    assert fit.strain.area[0] < 1 < fit.strain.area[1]
