import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from naive import area_mean as slow
from planish.core.area import area_mean


@given(
    rows=st.integers(1, 9),
    cols=st.integers(1, 9),
    fr=st.floats(1, 4),
    fc=st.floats(1, 4),
    seed=st.integers(0, 99),
)
def test_equals_the_slow_twin(rows, cols, fr, fc, seed):
    rng = np.random.default_rng(seed)
    values = np.where(rng.random((rows, cols)) < 0.3, np.nan, rng.normal(size=(rows, cols)))
    np.testing.assert_allclose(area_mean(values, (fr, fc)), slow(values, (fr, fc)), atol=1e-9)


def test_a_constant_stays_and_half_of_the_pixels_are_enough():
    assert np.all(area_mean(np.full((50, 70), 3.0), (8.33, 8.33)) == pytest.approx(3.0))
    values = np.ones((2, 4))
    values[:, 0] = np.nan
    values[:, 2:] = [[np.nan, np.nan], [np.nan, 1.0]]
    out = area_mean(values, (2, 2))
    assert np.isfinite(out[0, 0])
    assert np.isnan(out[0, 1])
