"""Layers over a backing against the equations they solve, their limits and published figures."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from folders import refused
from planish.analyze import ScatteringLayer, pile, reflectance, stack
from planish.core.errors import InputError


def by_cotangent(weight, s, k, below):
    """The formula as it is printed; it needs s, k and W above 0."""
    a = (s + k) / s
    b = np.sqrt(a * a - 1)
    coth = 1 / np.tanh(b * s * weight)
    return (1 - below * (a - b * coth)) / (a - below + b * coth)


def test_a_coating_over_a_pile_of_its_base_in_any_units():
    base = pile(scattering=45.0, absorption=1.2)
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


def test_layers_are_put_on_from_the_bottom_up_to_a_pile():
    pre, top = (
        ScatteringLayer(weight=0.010, scattering=90.0, absorption=0.3),
        ScatteringLayer(weight=0.008, scattering=150.0),
    )
    over = reflectance(0.010, scattering=90.0, absorption=0.3, backing=0.5)
    assert stack([pre, top], 0.5) == reflectance(0.008, scattering=150.0, backing=over)
    assert stack([pre, top], 0.5) != pytest.approx(stack([top, pre], 0.5), abs=1e-4)
    halves = [ScatteringLayer(weight=0.005, scattering=90.0, absorption=0.3)] * 2
    assert (stack(halves, 0.5), stack([], 0.5)) == (pytest.approx(over, abs=1e-14), 0.5)
    known = pile(scattering=45.0, absorption=1.2)
    q = 1.2 / 45
    assert known == pytest.approx(1 + q - np.sqrt(q * q + 2 * q), abs=1e-14)
    assert reflectance(0.02, scattering=45.0, absorption=1.2, backing=known) == pytest.approx(
        known, abs=1e-14
    )
    assert stack(
        [ScatteringLayer(weight=0.1, scattering=45.0, absorption=1.2)] * 40, 0.0
    ) == pytest.approx(known, abs=1e-12)
    assert (pile(scattering=45.0, absorption=0.0), pile(scattering=0.0, absorption=1.0)) == (1, 0)


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


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: reflectance(-0.01, scattering=150.0, backing=0.8),
            "weight has 1 of 1 values that are negative",
        ),
        (
            lambda: reflectance([1.0, np.inf], scattering=-1.0, backing=0.8),
            r"weight has 1 of 2 values; scattering has",
        ),
        (
            lambda: reflectance(0.01, scattering=150.0, backing=[0.2, 131.0]),
            "backing is 131; .* white reference",
        ),
        (lambda: stack([ScatteringLayer(weight=0.01, scattering=1.0)], -0.1), "backing is -0.1"),
        (lambda: pile(scattering=0.0, absorption=0.0), "Give a scattering above 0"),
    ],
)
def test_what_cannot_be_is_refused(call, message):
    refused(InputError, message, call)
