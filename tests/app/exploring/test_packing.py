"""Packed maps: values to within half a step, what lies beyond, and what is kept exactly."""

import numpy as np
import pytest

from app.exploring.made import codes_of
from planish.app.exploring.maps import packed


def unpacked(one):
    return codes_of(one.text, one.shape, one.bits, one.order)


def values(one):
    codes = unpacked(one)
    assert ((codes != 1) & (codes != 2**one.bits - 1)).all()
    return np.where(codes > 0, one.low + one.step * (codes - 2), np.nan)


@pytest.mark.parametrize("bits", [8, 16])
def test_a_value_is_within_half_a_step_and_what_is_missing_stays_missing(bits):
    rng = np.random.default_rng(1)
    data = np.sin(np.arange(60) / 9)[:, None] + rng.normal(0, 0.2, (60, 45))
    data[rng.random(data.shape) < 0.1] = np.nan
    one = packed(data, bits=bits)
    found = values(one)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(data))
    assert np.nanmax(np.abs(found - data)) <= one.error * (1 + 1e-9)
    # 253 steps, or 65 533, over the whole range.
    assert (one.step, one.beyond) == (
        pytest.approx((np.nanmax(data) - np.nanmin(data)) / (2**bits - 4)),
        0,
    )


def test_single_values_far_outside_do_not_take_the_digits_and_are_known_to_lie_beyond():
    rng = np.random.default_rng(2)
    data = rng.normal(20, 1, (200, 200))
    data[3, 4], data[9, 9] = 1e6, -1e6
    one = packed(data)
    codes = unpacked(one)
    assert (codes[3, 4], codes[9, 9]) == (255, 1)
    assert one.step < 0.05
    inside = (codes > 1) & (codes < 255)
    assert np.abs(one.low + one.step * (codes - 2) - data)[inside].max() <= one.error * (1 + 1e-9)
    # 0.05 % of 40 000 values at either end, and those two.
    assert np.count_nonzero(~inside) == one.beyond <= 42


def test_whole_numbers_of_a_camera_are_exact():
    rng = np.random.default_rng(3)
    data = 16.0 * rng.integers(1000, 4000, (40, 50))
    data[0, 0], data[0, 1] = 16_000.0, 16_016.0
    one = packed(data, bits=16)
    assert one.exact
    assert one.error == 0
    np.testing.assert_array_equal(values(one), data)


@pytest.mark.parametrize(
    "data", [np.full((3, 4), 7.5), np.full((3, 4), np.nan), np.array([[2.0, np.nan]])]
)
def test_constant_and_empty_maps(data):
    one = packed(data)
    np.testing.assert_allclose(values(one), data, atol=one.error)


@pytest.mark.parametrize(
    ("data", "order"),
    [
        (np.add.outer(np.arange(80.0) ** 2, np.arange(90.0)), 2),
        (np.random.default_rng(4).normal(size=(80, 90)), 1),
    ],
)
def test_the_shorter_differences_are_taken(data, order):
    assert packed(data, bits=16).order == order
