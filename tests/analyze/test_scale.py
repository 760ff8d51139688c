import numpy as np
import pytest
from scipy import ndimage

from analyze.fields import gaussian_maps, related_maps
from folders import refused
from planish.analyze import coherence, correlate, size_curve
from planish.core.errors import CannotMeasure, SizeError


def test_coherence_of_unrelated_maps_is_none():
    rng, n = np.random.default_rng(0), 60
    found = [coherence(*gaussian_maps(rng, (90, 120), 5.0), pixel_um=2.0) for _ in range(n)]
    p = np.array([[band.p for band in c.bands] for c in found])
    assert p.shape[1] == 3
    assert (np.mean(p < 0.05, axis=0) < 0.15).all()
    assert np.mean([[band.coherence for band in c.bands] for c in found]) == pytest.approx(
        0, abs=0.01
    )


def test_coherence_is_that_of_the_spectra():
    rng, r, own, other = np.random.default_rng(1), 0.7, 8.0, 2.0
    found = [
        coherence(*related_maps(rng, (150, 200), own, r, noise=other), pixel_um=1.0)
        for _ in range(20)
    ]

    def power(f, length):
        return length**2 / (1 + (2 * np.pi * f * length) ** 2) ** 1.5

    for k, band in enumerate(found[0].bands):
        f = np.geomspace(1 / band.longest_um, 1 / band.shortest_um, 60)
        true = r * r * power(f, own) / (r * r * power(f, own) + (1 - r * r) * power(f, other))
        assert np.mean([c.bands[k].coherence for c in found]) == pytest.approx(
            np.average(true, weights=f * f), abs=0.03
        )


def test_a_blurred_map_has_a_gain_that_falls_and_no_phase():
    a = np.random.default_rng(2).normal(size=(120, 160))
    b = -3 * ndimage.gaussian_filter(a, 1.5, mode="wrap")
    bands = coherence(a, b, pixel_um=5.0).bands
    assert bands[0].gain == pytest.approx(-3, abs=0.4)
    assert [abs(k.gain) for k in bands] == sorted((abs(k.gain) for k in bands), reverse=True)
    assert abs(bands[-1].gain) < 0.7
    assert all(abs(abs(k.phase_deg) - 180) < 5 for k in bands)
    assert bands[0].coherence > 0.98


def test_small_fields_and_sizes_below_the_pixel_are_refused():
    refused(CannotMeasure, "larger map", coherence, np.ones((6, 6)), np.ones((6, 6)), pixel_um=1.0)
    with pytest.raises(SizeError, match="smaller than a pixel"):
        size_curve(np.ones((60, 80)), np.ones((60, 80)), pixel_um=2.0, sizes_um=[1.0, 5.0])


def test_the_curve_of_sizes_holds_the_rows_and_a_wider_band():
    a, b = related_maps(4, (90, 120), 5.0, 0.6)
    curve = size_curve(a, b, pixel_um=2.0)
    assert [row.point_um for row in curve] == pytest.approx([2 * 2 ** (k / 2) for k in range(7)])
    assert curve[2].r == correlate(a, b, pixel_um=2.0, point_um=4.0).r
    for row in curve:
        assert row.band[0] < row.interval[0] < row.r < row.interval[1] < row.band[1]
    wider = [np.ptp(np.arctanh(row.band)) / np.ptp(np.arctanh(row.interval)) for row in curve]
    assert wider == pytest.approx([wider[0]] * len(wider))
    assert 1.02 < wider[0] < 1.4
    a, b = related_maps(5, (60, 80), 4.0, 0.6)
    curve = size_curve(a, b, pixel_um=2.0, sizes_um=[10.0])
    assert curve[0].band == pytest.approx(curve[0].interval)
    # Fewer points than tiles along the shorter side.
    of_few_points = size_curve(a, b, pixel_um=(1.0, 2.0), sizes_um=[2.0, 20.0])[1]
    assert of_few_points.n == 24
    assert of_few_points.band[0] <= of_few_points.interval[0]
