"""What a fit says of its error against its true error: a short form of ``python -m benchmarks registration``."""

import numpy as np
import pytest
from benchmarks.registration import ratio_of


@pytest.mark.parametrize("way", ["plain", "weights", "covariances", "outliers"])
@pytest.mark.parametrize(("model", "fits"), [("rigid", 30), ("similarity", 40), ("affine", 40), ("projective", 20)])
def test_expected_over_true_error(model, way, fits):
    r = ratio_of(model, 16, 3.0, way, fits)
    print(f"{model} {way}: expected {r.expected_um:.2f} um, true {r.true_um:.2f} um, ratio {r.value:.2f}")
    assert 0.8 < r.value < 1.25
    assert r.refused == 0


@pytest.mark.parametrize("way", ["plain", "weights"])
def test_expected_over_true_error_of_a_spline(way):
    """The truth is a smooth random distortion of 12 um rms, no spline."""
    r = ratio_of("tps", 16, 3.0, way, 25)
    print(f"tps {way}: expected {r.expected_um:.2f} um, true {r.true_um:.2f} um, ratio {r.value:.2f}")
    assert 0.8 < r.value < 1.25
    assert np.isfinite(r.value)
