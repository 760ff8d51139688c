"""The small set of tails and ranks against scipy's distributions."""

import numpy as np
import pytest
from scipy import stats

from planish.analyze import distributions


@pytest.mark.parametrize("share", [1e-6, 0.01, 0.5, 0.975, 1 - 1e-9])
@pytest.mark.parametrize("free", [2.5, 8, 57.3, 1e5])
def test_tails_are_those_of_the_distributions(share, free):
    value = stats.norm.ppf(share)
    assert distributions.normal_tail(value) == pytest.approx(stats.norm.sf(value), rel=1e-12)
    assert distributions.student_tail(value, free) == pytest.approx(
        stats.t.sf(value, free), rel=1e-9
    )


@pytest.mark.parametrize("free", [2.5, 8, 57.3, 1e5])
def test_t_95_is_the_quantile_of_students_distribution(free):
    assert distributions.t_95(free) == pytest.approx(stats.t.ppf(0.975, free), rel=1e-9)


def test_equal_values_share_their_mean_rank():
    values = np.random.default_rng(3).integers(0, 40, 500).astype(float)
    np.testing.assert_array_equal(distributions.ranks(values), stats.rankdata(values))


def test_the_tail_of_maxima_is_that_of_a_fitted_gumbel():
    sample = stats.gumbel_r.rvs(0.2, 0.03, size=60, random_state=5)
    expected = stats.gumbel_r.sf(0.4, *stats.gumbel_r.fit(sample))
    assert distributions.largest_tail(sample, 0.4) == pytest.approx(expected, rel=1e-3)
    assert 0 < distributions.largest_tail(sample, 5.0) < 1e-20
    assert distributions.largest_tail(np.full(9, 0.3), 0.31) == 0
