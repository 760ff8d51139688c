"""The small set of quantiles and tails against scipy's distributions."""

import numpy as np
import pytest
from scipy import stats

from planish.analyze import chance


@pytest.mark.parametrize("share", [1e-6, 0.01, 0.5, 0.975, 1 - 1e-9])
@pytest.mark.parametrize("free", [2.5, 8, 57.3, 1e5])
def test_quantiles_and_tails_are_those_of_the_distributions(share, free):
    assert chance.normal_quantile(share) == pytest.approx(stats.norm.ppf(share), rel=1e-12)
    assert chance.student_quantile(share, free) == pytest.approx(stats.t.ppf(share, free), rel=1e-9, abs=1e-12)
    value = stats.norm.ppf(share)
    assert chance.normal_tail(value) == pytest.approx(stats.norm.sf(value), rel=1e-12)
    assert chance.student_tail(value, free) == pytest.approx(stats.t.sf(value, free), rel=1e-9)


def test_equal_values_share_their_mean_rank_and_maxima_have_a_gumbel_tail():
    values = np.random.default_rng(3).integers(0, 40, 500).astype(float)
    np.testing.assert_array_equal(chance.ranks(values), stats.rankdata(values))
    sample = stats.gumbel_r.rvs(0.2, 0.03, size=60, random_state=5)
    expected = stats.gumbel_r.sf(0.4, *stats.gumbel_r.fit(sample))
    assert chance.largest_tail(sample, 0.4) == pytest.approx(expected, rel=1e-3)
    assert 0 < chance.largest_tail(sample, 5.0) < 1e-20
    assert chance.largest_tail(np.full(9, 0.3), 0.31) == 0
