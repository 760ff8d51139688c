"""Kubelka and Munk's closed form against their differential equations, its limits, and published figures."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from planish.core.reflectance import layer_over
from planish.synthetic import PRESETS, PaperParams, camera

share = st.floats(0.0, 1.0)


def infinite_stack(s, k):
    """Reflectance of a layer that nothing shines through, a - b, as 1 / (a + b); 1 without absorption."""
    return s / (s + k + np.sqrt(k * (k + 2 * s)))


def grown(backing, s, k, weight):
    """Slow twin: the layer grows from its backing up, dR/dW = s - 2 (s + k) R + s R^2."""
    done = solve_ivp(
        lambda _, r: s - 2 * (s + k) * r + s * r * r, (0.0, weight), [backing], method="DOP853", rtol=1e-11, atol=1e-12
    )
    return done.y[0, -1]


@pytest.mark.parametrize("backing", [0.0, 0.8, 1.0])
@pytest.mark.parametrize(("s", "k"), [(150.0, 0.3), (45.0, 0.0), (30.0, 60.0), (0.0, 20.0), (120.0, 1e-7)])
@pytest.mark.parametrize("weight", [1e-6, 0.03, 0.2])
def test_the_closed_form_solves_the_differential_equation(backing, s, k, weight):
    assert layer_over(backing, s, k, weight) == pytest.approx(grown(backing, s, k, weight), abs=1e-8)
    assert layer_over(backing, s, k, 0.0) == backing


def test_limits_give_the_closed_form():
    # A layer that only absorbs is passed twice: exp(-2 k W).
    assert layer_over(0.6, 0.0, 5.0, 0.1) == pytest.approx(0.6 * np.exp(-1.0), abs=1e-14)
    # Over black and without absorption: s W / (1 + s W).
    assert layer_over(0.0, 50.0, 0.0, 0.04) == pytest.approx(2.0 / 3.0, abs=1e-14)
    assert layer_over(np.zeros((3, 1)), 50.0, 0.3, np.zeros(4)).shape == (3, 4)


@given(backing=share, s=st.floats(0.0, 500.0), weight=st.floats(0.0, 1.0))
def test_without_absorption_it_is_the_simple_form(backing, s, weight):
    lift = (1 - backing) * s * weight
    assert layer_over(backing, s, 0.0, weight) == pytest.approx((backing + lift) / (1 + lift), abs=1e-12)
    # A trace of absorption is no jump: it costs at most 2 k W (1 + s W)^2.
    assert abs(layer_over(backing, s, 1e-12, weight) - layer_over(backing, s, 0.0, weight)) < 1e-6


@given(backing=share, s=st.floats(1.0, 500.0), k=st.floats(0.01, 50.0))
def test_a_thick_layer_hides_its_backing(backing, s, k):
    thick = 40.0 / np.sqrt(k * (k + 2 * s))  # b s W = 40: tanh is 1 to the last digit
    assert layer_over(backing, s, k, thick) == pytest.approx(infinite_stack(s, k), abs=1e-9)
    assert layer_over(backing, s, k, 1e6 * thick) == pytest.approx(infinite_stack(s, k), abs=1e-9)


@given(backing=share, s=st.floats(0.0, 500.0), k=st.floats(0.0, 50.0), one=st.floats(0.0, 0.1), two=st.floats(0.0, 0.1))
def test_two_layers_of_the_same_are_one(backing, s, k, one, two):
    twice = layer_over(layer_over(backing, s, k, one), s, k, two)
    assert twice == pytest.approx(layer_over(backing, s, k, one + two), abs=1e-10)
    assert 0.0 <= twice <= 1.0 + 1e-12


def test_brightness_over_coat_weight_and_piles_are_as_computed_elsewhere():
    # 0 to 30 g/m2 with s 150 and k 0.3 over an infinite base with s 45 and k 1.2; figures to three digits.
    got = layer_over(infinite_stack(45.0, 1.2), 150.0, 0.3, np.array([0.0, 5.0, 10.0, 20.0, 30.0]) * 1e-3)
    np.testing.assert_allclose(got, [0.794, 0.820, 0.839, 0.866, 0.884], atol=6e-4)
    for paper in (PaperParams(), PRESETS["board"][1], PRESETS["sc50"][1]):
        one_more = camera.sheet_reflectance(
            paper, "pile", coating_top_um=paper.coating_top_um, coating_bottom_um=paper.coating_bottom_um
        )
        assert one_more == pytest.approx(camera.pile_reflectance(paper), abs=1e-12)
    assert camera.pile_reflectance(PRESETS["sc50"][1]) == pytest.approx(infinite_stack(45.0, 1.2), abs=1e-12)


def test_each_map_and_a_coating_act_on_the_brightness_in_their_own_sense():
    coating = np.linspace(0.0, 40.0, 81)
    paper = PaperParams()
    pile, black = (
        camera.sheet_reflectance(paper, backing, coating_top_um=coating, coating_bottom_um=17.4)
        for backing in ("pile", "black")
    )
    assert (np.diff(black) > 0).all()
    assert (black < pile).all()
    # Less and less: what is bright already gains less.
    assert (np.diff(pile) > 0).all()
    assert (np.diff(pile, 2) < 0).all()
    assert 0.78 < pile[0] < pile[-1] < 0.93

    def over_black(paper=paper, **more):
        given = {"coating_top_um": 17.4, "coating_bottom_um": 17.4} | more
        return camera.sheet_reflectance(paper, "black", **given)

    for more in ({"coating_density": 1.1}, {"base_mass": 1.1}, {"base_s_m2_per_kg": 50.0}, {"coating_bottom_um": 20.0}):
        assert over_black(**more) > over_black()
    heavy = replace(paper, base_um=paper.base_um * 2)
    assert over_black(heavy) == pytest.approx(over_black(base_mass=2.0), abs=1e-14)
