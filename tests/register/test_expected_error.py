"""What a fit says of its error against its true error: a short form of ``python -m benchmarks registration``."""

import numpy as np
import pytest
from benchmarks.registration import ratio_of


@pytest.mark.study
@pytest.mark.parametrize("way", ["plain", "weights", "covariances", "outliers"])
@pytest.mark.parametrize(("model", "fits"), [("rigid", 30), ("similarity", 40), ("affine", 40), ("projective", 20)])
def test_expected_over_true_error(model, way, fits):
    r = ratio_of(model, 16, 3.0, way, fits)
    print(f"{model} {way}: expected {r.expected_um:.2f} um, true {r.true_um:.2f} um, ratio {r.value:.2f}")
    assert 0.8 < r.value < 1.25
    assert r.refused == 0


@pytest.mark.study
@pytest.mark.parametrize("way", ["plain", "weights"])
def test_expected_over_true_error_of_a_spline(way):
    """The truth is a smooth random distortion of 12 um rms, no spline."""
    r = ratio_of("tps", 16, 3.0, way, 25)
    print(f"tps {way}: expected {r.expected_um:.2f} um, true {r.true_um:.2f} um, ratio {r.value:.2f}")
    assert 0.8 < r.value < 1.25
    assert np.isfinite(r.value)


@pytest.mark.parametrize(("model", "fits"), [("similarity", 15), ("affine", 15), ("tps", 4)])
def test_expected_error_is_no_smaller_than_half_the_true_one(model, fits):
    """Quick form: some 15 fits fix the ratio to 20 %."""
    assert 0.5 < ratio_of(model, 16, 3.0, "plain", fits).value < 2.0
