import math
import warnings

import numpy as np
import pytest
from scipy import optimize, stats

from folders import refused
from planish.analyze import (
    Fields,
    difference_of_pooled_r,
    over_sheets,
    paired_over_sheets,
    pooled_r,
    random_effects,
    two_groups,
)
from planish.core.errors import InputError


def drawn(rng):
    k = int(rng.integers(2, 30))
    v = np.exp(rng.normal(-4, 1, k))
    return (
        0.5
        + rng.choice([0, 0.05, 0.15, 0.5]) * rng.normal(size=k)
        + np.sqrt(v) * rng.normal(size=k),
        v,
    )


def twin(y, v):
    """Mean, variance between and Q as the papers write them, the root by bisection."""

    def generalised(between):
        w = 1 / (v + between)
        return float(np.sum(w * (y - np.sum(w * y) / w.sum()) ** 2))

    between = 0.0
    if generalised(0.0) > len(y) - 1:
        between = optimize.brentq(
            lambda t: generalised(t) - (len(y) - 1), 0.0, 1e3, xtol=1e-15, rtol=1e-14
        )
    w = 1 / (v + between)
    return np.sum(w * y) / w.sum(), between, generalised(0.0)


def test_effects_are_pooled_as_bisection_does():
    rng = np.random.default_rng(0)
    for _ in range(60):
        y, v = drawn(rng)
        found = random_effects(y, v)
        assert (found.mean, found.between, found.q) == pytest.approx(twin(y, v), abs=1e-9)
        assert found.p == pytest.approx(stats.chi2.sf(found.q, y.size - 1), rel=1e-9)


def test_equally_known_effects_have_students_interval():
    rng = np.random.default_rng(1)
    y = rng.normal(size=8)
    found = random_effects(y, np.full(8, 0.01))
    assert found.between == pytest.approx(y.var(ddof=1) - 0.01, abs=1e-12)
    assert found.interval == pytest.approx(
        stats.t.interval(0.95, 7, y.mean(), stats.sem(y)), abs=1e-12
    )


@pytest.mark.nightly
def test_effects_are_pooled_as_statsmodels_does():
    from statsmodels.stats.meta_analysis import combine_effects

    rng, compared = np.random.default_rng(2), 0
    for _ in range(1000):
        y, v = drawn(rng)
        found = random_effects(y, v)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            other = combine_effects(y, v, method_re="iterated", use_t=True, atol=1e-12, maxiter=500)
        if other.tau2 == 0 and other.q > y.size - 1:
            # There rounding took the last step a hair too far, upon which statsmodels gives 0 up;
            # bisection judges.
            assert found.between == pytest.approx(twin(y, v)[1], abs=1e-9)
            continue
        compared += 1
        assert found.mean == pytest.approx(other.mean_effect_re, abs=1e-9)
        assert found.between == pytest.approx(other.tau2, abs=1e-9)
        assert found.standard_error == pytest.approx(other.sd_eff_w_re, abs=1e-9)
        assert found.q == pytest.approx(other.q, abs=1e-9)
        assert found.p == pytest.approx(other.test_homogeneity().pvalue, abs=1e-9)
        assert found.i2 == pytest.approx(max(other.i2, 0.0), abs=1e-9)
        if y.size > 2:
            assert found.interval == pytest.approx(other.conf_int(use_t=True)[3], abs=1e-9)
    print(f"{compared} of 1000 compared")
    assert compared > 800


def test_r_is_pooled_by_sheets_of_fields_with_a_value():
    r = [0.5, 0.6, 0.4, 0.7, 0.6, 0.65, 0.3]
    sheets = [*"AABBCCC"]
    found = pooled_r(Fields(r, sheets), [53, 103, 53, 53, 83, 83, 13])
    z = np.arctanh(r)
    means = np.array([z[:2].mean(), z[2:4].mean(), z[4:].mean()])
    assert math.atanh(found.mean) == pytest.approx(means.mean())
    assert np.arctanh(found.interval) == pytest.approx(
        stats.t.interval(0.95, 2, means.mean(), stats.sem(means))
    )
    own = np.array([(1 / 50 + 1 / 100) / 4, (1 / 50 + 1 / 50) / 4, (1 / 80 + 1 / 80 + 1 / 10) / 9])
    of_fields = random_effects(z, 1 / (np.array([53, 103, 53, 53, 83, 83, 13]) - 3))
    for one, two in (
        (found.between_sheets, random_effects(means, own)),
        (found.between_fields, of_fields),
    ):
        assert (one.mean, one.standard_error, one.between) == pytest.approx(
            (two.mean, two.standard_error, two.between)
        )
        assert (one.effects, one.q) == (two.effects, pytest.approx(two.q))
    found = pooled_r(
        Fields([0.5, math.nan, 0.4, 1.0, 0.6, 0.2], [*"ABBCCD"]), [50, 50, math.nan, 50, 50, 4.0]
    )
    assert (found.sheets, found.fields, found.reason) == (2, 2, "2 of at least 3 sheets")
    assert found.between_fields is not None
    none = pooled_r(Fields([math.nan], ["A"]), [50])
    assert none.between_sheets is None
    assert math.isnan(none.mean)


def test_a_difference_of_r_is_linear_in_z():
    rng = np.random.default_rng(3)
    one, two = (
        Fields(np.tanh(rng.normal(m, 0.02, 12)).tolist(), [*"AAABBBCCCDDD"]) for m in (0.4, 0.6)
    )
    for paired, compare in ((True, paired_over_sheets), (False, two_groups)):
        for squared in (False, True):
            found = difference_of_pooled_r(one, two, paired=paired, squared=squared)
            power = 2 if squared else 1
            expected = [
                math.tanh(over_sheets(Fields(np.arctanh(m.values).tolist(), m.sheets)).mean)
                ** power
                for m in (one, two)
            ]
            assert found.means == pytest.approx(expected, abs=1e-12)
            assert found.difference == pytest.approx(expected[1] - expected[0], abs=1e-12)
            direct = compare(*(Fields([v**power for v in m.values], m.sheets) for m in (one, two)))
            # r varies by .02 only, over which tanh is nearly straight.
            assert found.standard_error == pytest.approx(direct.standard_error, rel=0.1)
            assert found.free == pytest.approx(direct.free, rel=0.2)


def test_wrong_correlations_are_refused():
    refused(InputError, "1 effects and 1 variances", random_effects, [1.0], [1.0])
    refused(InputError, "above 0", random_effects, [1.0, 2.0], [1.0, 0.0])
    refused(InputError, "infinite", random_effects, [1.0, 2.0], [1.0, math.inf])
    refused(InputError, "1 correlations and 2 n_eff", pooled_r, Fields([0.1], ["A"]), [10, 20])
    refused(InputError, "beyond 1", pooled_r, Fields([1.1], ["A"]), [10])
