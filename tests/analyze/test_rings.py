import math

import numpy as np
import pytest
from scipy import fft

from analyze.fields import gaussian_maps
from folders import refused
from planish.analyze import half_bit, octaves, ring_correlation
from planish.core.errors import CannotMeasure

SHAPE, LENGTH, NOISE = (120, 160), 6.0, 1.0


def twice(rng):
    signal = gaussian_maps(rng, SHAPE, LENGTH)[0]
    return [signal + NOISE * rng.normal(size=SHAPE) for _ in range(2)]


def true_correlation(f):
    """Of exp(-h / l) and white noise, both seen by pixels of 1: the spectrum of samples is that of
    all its orders."""
    orders = np.arange(-6, 7)
    f2 = [(f + i) ** 2 + j**2 for i in orders for j in orders]
    power = sum(2 * np.pi * LENGTH**2 / (1 + (2 * np.pi * LENGTH) ** 2 * v) ** 1.5 for v in f2)
    return power / (power + NOISE**2)


def test_rings_are_the_ratio_of_signal_to_all():
    rng = np.random.default_rng(0)
    found = [ring_correlation(*twice(rng), pixel_um=1.0).rings for _ in range(12)]
    mean = np.array([[ring.correlation for ring in rings] for rings in found]).mean(axis=0)
    true = np.array([true_correlation(1 / ring.wavelength_um) for ring in found[0]])
    # Along a direction other than the axes the orders of a pixel lie a little differently; 12 maps
    # scatter by .03.
    assert np.abs(mean - true)[2:].max() < 0.08
    assert np.abs(mean - true)[2:].mean() < 0.02


def test_the_resolution_is_the_first_crossing():
    rng = np.random.default_rng(1)
    found = [ring_correlation(*twice(rng), pixel_um=3.0) for _ in range(12)]
    ring = found[0].rings
    below = next(
        k for k, v in enumerate(ring) if true_correlation(3.0 / v.wavelength_um) < v.threshold
    )
    seen = [c.resolution_um for c in found]
    # Ripple of a curve crosses a little early, so a little longer waves are named.
    assert np.median(seen) == pytest.approx(ring[below].wavelength_um, rel=0.12)
    assert all(f"{v:.3g} um" in c.sentence for v, c in zip(seen, found, strict=True))
    for c, v in zip(found, seen, strict=True):
        k = next(k for k, ring in enumerate(c.rings) if ring.correlation < ring.threshold)
        assert c.rings[k].wavelength_um <= v <= c.rings[k - 1].wavelength_um


def test_rings_are_sums_over_single_waves():
    rng = np.random.default_rng(2)
    a, b = twice(rng)
    a, b = a[:30, :40], b[:30, :40]
    found = ring_correlation(a, b, pixel_um=2.0).rings
    known = np.ones(a.shape, bool)
    window = octaves.window_of(known)
    one, two = (octaves.spectrum_of(m, known, window) for m in (a, b))
    joined = a.size * np.sum(window**4) / np.sum(window**2) ** 2
    width = math.sqrt(joined) / 60.0
    sums = {}
    for i, fy in enumerate(fft.fftfreq(30, 2.0)):
        for j, fx in enumerate(fft.fftfreq(40, 2.0)):
            # Of the other half of the transform each value is the conjugate of one of this half.
            x, y = (m[i, j] if j <= 20 else m[-i, 40 - j].conjugate() for m in (one, two))
            s = sums.setdefault(round(math.hypot(fy, fx) / width), [0.0, 0.0, 0.0, 0])
            s[0] += (x * y.conjugate()).real
            s[1] += abs(x) ** 2
            s[2] += abs(y) ** 2
            s[3] += 1
    assert len(found) >= 5
    for k, ring in enumerate(found, 1):
        cross, xx, yy, count = sums[k]
        # The columns of the Nyquist frequency, which have no partner, lie in no ring that is kept.
        assert ring.correlation == pytest.approx(cross / math.sqrt(xx * yy), abs=1e-9)
        assert (ring.modes, ring.threshold) == (
            pytest.approx(count / 2 / joined),
            half_bit(ring.modes),
        )


def test_the_half_bit_curve_has_the_numbers_of_the_paper():
    for n in (4.0, 50.0, 1e4):
        root = math.sqrt(n)
        assert half_bit(n) == pytest.approx(
            (0.2071 + 1.9102 / root) / (1.2071 + 0.9102 / root), abs=1e-4
        )
    assert (half_bit(1.0), half_bit(1e12)) == (pytest.approx(1.0), pytest.approx(0.1716, abs=1e-4))


def test_where_nothing_crosses_or_leakage_ends_the_curve_the_sentence_gives_the_reason():
    rng = np.random.default_rng(3)
    a = gaussian_maps(rng, SHAPE, 3.0)[0]
    same = ring_correlation(a, 2 * a + 1, pixel_um=2.0)
    assert same.resolution_um is None
    assert "down to" in same.sentence
    assert all(ring.correlation == pytest.approx(1) for ring in same.rings)
    none = ring_correlation(a, rng.normal(size=SHAPE), pixel_um=2.0)
    assert none.resolution_um is None
    assert "Not even" in none.sentence
    smooth = gaussian_maps(4, SHAPE, 20.0, kind="gauss")[0]
    found = ring_correlation(smooth, smooth, pixel_um=1.0)
    assert found.resolution_um is None
    assert "leakage" in found.sentence
    assert found.rings[-1].wavelength_um > 5  # the pixels would reach to 2


def test_a_small_map_has_no_rings():
    a = gaussian_maps(6, (6, 6), 3.0)[0]
    refused(CannotMeasure, "larger map", ring_correlation, a, a, pixel_um=1.0)
