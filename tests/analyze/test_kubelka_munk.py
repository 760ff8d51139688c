"""A layer over a backing against the equations it solves, its limits and published figures."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from planish.core.reflectance import layer_over


def reflectance(weight, *, scattering, absorption=0.0, backing):
    """A layer over a backing, in words."""
    return layer_over(backing, scattering, absorption, weight)


def by_cotangent(weight, s, k, below):
    """The formula as it is printed; it needs s, k and W above 0."""
    a = (s + k) / s
    b = np.sqrt(a * a - 1)
    coth = 1 / np.tanh(b * s * weight)
    return (1 - below * (a - b * coth)) / (a - below + b * coth)


def test_a_coating_over_a_pile_of_its_base_in_any_units():
    q = 1.2 / 45
    base = 1 + q - np.sqrt(q * q + 2 * q)
    found = reflectance(
        np.array([0, 5, 10, 20, 30]) * 1e-3, scattering=150.0, absorption=0.3, backing=base
    )
    assert found == pytest.approx([0.794, 0.820, 0.839, 0.866, 0.884], abs=6e-4)
    # 1 um of 1.6 g/cm3 is 1.6e-3 kg/m2, so 150 m2/kg are 0.24 per um.
    um = np.array([3.0, 12.0])
    by_weight = reflectance(1.6e-3 * um, scattering=150.0, absorption=0.3, backing=0.8)
    assert reflectance(um, scattering=0.24, absorption=0.48e-3, backing=0.8) == pytest.approx(
        by_weight, abs=1e-14
    )


@pytest.mark.parametrize(("s", "k"), [(150.0, 0.3), (45.0, 1.2), (30.0, 60.0), (120.0, 1e-4)])
@pytest.mark.parametrize("below", [0.0, 0.5, 1.0])
def test_the_printed_formula_and_the_differential_equation(s, k, below):
    weight = np.array([1e-3, 0.02, 0.2])
    grown = solve_ivp(
        lambda _, r: s - 2 * (s + k) * r + s * r * r,
        (0, 0.2),
        [below],
        t_eval=weight,
        rtol=1e-10,
        atol=1e-12,
    )
    found = reflectance(weight, scattering=s, absorption=k, backing=below)
    assert found == pytest.approx(by_cotangent(weight, s, k, below), abs=1e-9)
    assert found == pytest.approx(grown.y[0], abs=1e-7)


def test_without_absorption_there_is_no_step():
    lift = (1 - 0.8) * 150 * 0.02
    exact = (0.8 + lift) / (1 + lift)
    assert reflectance(0.02, scattering=150.0, backing=0.8) == pytest.approx(exact, abs=1e-15)
    # A layer that only absorbs is passed twice: exp(-2 k W).
    only = reflectance(0.1, scattering=0.0, absorption=5.0, backing=0.6)
    assert only == pytest.approx(0.6 * np.exp(-1.0), abs=1e-14)
    k = np.logspace(-30, -3, 200)
    loss = exact - reflectance(0.02, scattering=150.0, absorption=k, backing=0.8)
    # In proportion to k where rounding allows it to be seen, and nowhere up.
    large = k > 1e-9
    assert np.ptp(loss[large] / k[large]) < 1e-3 * (loss[large] / k[large]).mean()
    assert np.all(np.diff(loss) > -1e-15)


SHARE, PART = st.floats(0.0, 1.0), st.floats(0.0, 0.1)


@given(backing=SHARE, s=st.floats(0.0, 500.0), k=st.floats(0.0, 50.0), one=PART, two=PART)
def test_two_layers_of_the_same_are_one(backing, s, k, one, two):
    def over(below, weight):
        return reflectance(weight, scattering=s, absorption=k, backing=below)

    twice = float(over(over(backing, one).clip(0, 1), two))
    assert twice == pytest.approx(float(over(backing, one + two)), abs=1e-10)
    assert 0.0 <= twice <= 1.0 + 1e-12


def test_maps_broadcast_and_what_is_missing_stays_so():
    weight = np.array([[0.0, 0.01, np.nan]])
    found = reflectance(weight, scattering=150.0, backing=np.array([[0.7], [0.8]]))
    assert (found.shape, found[:, 0]) == ((2, 3), pytest.approx([0.7, 0.8]))
    assert np.isnan(found[:, 2]).all()
    assert np.isfinite(found[:, :2]).all()
