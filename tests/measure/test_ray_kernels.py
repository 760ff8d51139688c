"""Integrals, lengths, layers and depths on single profiles, beside slow twins and by hand."""

import numpy as np
import pytest

from planish.measure import _ray_kernels as kernels

S0, DS = -10.0, 0.5
S = S0 + DS * np.arange(41)


def pieces(values, lower, upper, least=0.0, most=2.0):
    """Integral, length and ends of one profile."""
    return [
        float(found[0, 0])
        for found in kernels.pieces(one(values), S0, DS, at(lower), at(upper), least, most)
    ]


def one(values):
    return np.asarray(values, dtype=np.float32)[None, None]


def at(value):
    return np.array([[float(value)]])


@pytest.mark.parametrize(("lower", "upper"), [(-3.3, 4.1), (-10.0, 10.0), (1.02, 1.07), (2.0, 2.5)])
def test_integral_and_length_equal_dense_sums(lower, upper):
    g = np.random.default_rng(1).normal(0, 1, S.size).astype(np.float32)
    dense = np.linspace(lower, upper, 400_001)
    value = np.interp(dense, S, g.astype(float))
    integral, length, ends = pieces(g, lower, upper, -0.2, 0.9)
    # a sum over 400000 places is exact to some 1e-5 of the length
    assert integral == pytest.approx(np.mean(value) * (upper - lower), abs=2e-4)
    inside = (value >= -0.2) & (value <= 0.9)
    assert length == pytest.approx(inside.mean() * (upper - lower), abs=2e-4)
    assert ends == np.count_nonzero(np.diff(inside.astype(int)))


def test_missing_values_and_missing_or_endless_layers():
    g = np.ones(S.size)
    g[20] = np.nan
    assert np.isnan(pieces(g, -1, 1)[:2]).all()
    assert pieces(g, 2, 4) == pytest.approx([2.0, 2.0, 0])
    assert np.isnan(pieces(g, -11, -5)[:2]).all()
    assert (pieces(g, 4, 3), layer(profile())[:2]) == ([0.0, 0.0, 0.0], (0.0, 0.0))
    assert layer(profile((-10.5, 6.5)))[:2] == (pytest.approx(14.0), pytest.approx(14.0))
    # bright matter deep below the face is no coating
    assert layer(profile((-4.1, -2.0)))[:2] == (0.0, 0.0)
    g = profile((1.9, 6.1))
    g[30] = np.nan
    assert np.isnan(layer(g)[0])


def profile(*pieces):
    """1 in the pieces (from, to) along s, 0 elsewhere, with the step on a sample's half way."""
    return np.sum([np.zeros(S.size), *((a < S) & (b > S) for a, b in pieces)], axis=0)


def layer(values, *, inward=-1.0, face=6.0, gap=2.0, limit=-8.0):
    g = values if inward < 0 else values[::-1]
    sign = 1.0 if inward < 0 else -1.0
    found = kernels.layers(
        one(g), S0, DS, at(sign * face), inward, 0.5, 1.0, at(1.0), gap, at(sign * limit)
    )
    return tuple(float(f[0, 0]) for f in found)


@pytest.mark.parametrize("inward", [-1.0, 1.0])
def test_a_layer_with_gaps(inward):
    """From the face at 6: coating to 2, a gap to 0.5, coating to -1, and a grain at -5."""
    values = profile((1.9, 6.1), (-1.1, 0.4), (-5.6, -4.9))
    # a step between samples crosses half way in the middle: 2 -> 1.75, 0 -> 0.25, -1 -> -1.25
    summed, outer, ends = layer(values, inward=inward)
    assert (summed, outer, ends) == (pytest.approx(4.25 + 1.5), pytest.approx(7.25), 3)
    assert layer(values, inward=inward, gap=1.0)[:2] == (pytest.approx(4.25), pytest.approx(4.25))
    assert layer(values, inward=inward, gap=9.0)[1] == pytest.approx(11.75)


def test_depths_of_shares_of_an_exact_phase():
    """Ink from 1 um to 5 um below the face: 50 % at 3, 90 % at 4.6."""
    g = np.where((S <= 5.0) & (S >= 1.0), 1.0, 0.0)
    ramp = 0.5 * DS * 0.5  # the phase reaches half way into the steps beside it
    depth, total = kernels.depths_of_shares(
        one(g), S0, DS, at(6), at(-6), 0.5, 2.0, np.array([0.5, 0.9])
    )
    assert (total[0, 0], depth[0, 0, 0]) == (
        pytest.approx(4.0 + 2 * 0.25),
        pytest.approx(3.0, abs=1e-6),
    )
    assert depth[1, 0, 0] == pytest.approx(1.0 - 0.25 + 0.9 * 4.5, abs=ramp)
    none, empty = kernels.depths_of_shares(
        one(np.zeros(S.size)), S0, DS, at(6), at(-6), 0.5, 2.0, np.array([0.5])
    )
    assert np.isnan(none[0, 0, 0])
    assert empty[0, 0] == 0
