import math

import numpy as np
import pytest
from scipy import stats

from folders import refused
from planish.analyze import (
    Fields,
    equivalence,
    holm,
    p_of_tables,
    paired_over_sheets,
    two_groups,
)
from planish.core.errors import InputError


def fields(values, *, each=1, names=()):
    return Fields(list(values), [f"S{k // each}" for k in range(len(values))], names)


def test_two_papers_are_compared_by_the_paired_test_and_after_welch():
    rng = np.random.default_rng(0)
    one, two = rng.normal(size=(5, 3)), rng.normal(size=(5, 3)) + 1
    found = paired_over_sheets(fields(one.ravel(), each=3), fields(two.ravel(), each=3))
    before, after = one.mean(axis=1), two.mean(axis=1)
    direct = stats.ttest_rel(after, before)
    assert (found.sheets, found.difference) == (
        (5, 5),
        pytest.approx((after - before).mean(), abs=1e-12),
    )
    assert found.p == pytest.approx(direct.pvalue, rel=1e-9)
    assert found.interval == pytest.approx([*direct.confidence_interval(0.95)], abs=1e-12)
    assert found.means == pytest.approx((before.mean(), after.mean()))
    rng = np.random.default_rng(1)
    one, two = rng.normal(size=(4, 2)), 3 * rng.normal(size=(7, 2)) + 1
    found = two_groups(fields(one.ravel(), each=2), fields(two.ravel(), each=2))
    direct = stats.ttest_ind(two.mean(axis=1), one.mean(axis=1), equal_var=False)
    assert (found.sheets, found.free) == ((4, 7), pytest.approx(direct.df, rel=1e-12))
    assert found.p == pytest.approx(direct.pvalue, rel=1e-9)
    assert found.interval == pytest.approx([*direct.confidence_interval(0.95)], abs=1e-12)


def test_fields_pair_by_their_names_and_a_missing_value_takes_its_partner_along():
    before = Fields([1.0, 5.0, 2.0, 3.0], ["A", "A", "B", "C"], ["1", "2", "1", "1"])
    after = Fields([1.5, 2.8, 3.1, 9.0], ["A", "B", "C", "D"], ["1", "1", "1", "1"])
    found = paired_over_sheets(before, after)
    # Field 2 of sheet A has no partner, nor has sheet D.
    assert (found.means, found.unpaired) == (pytest.approx((2.0, (1.5 + 2.8 + 3.1) / 3)), ("D",))
    unnamed = paired_over_sheets(
        Fields(before.values, before.sheets), Fields(after.values, after.sheets)
    )
    assert unnamed.means[0] == pytest.approx((3.0 + 2.0 + 3.0) / 3)
    before = Fields([1.0, math.nan, 2.0, 3.0, 4.0], [*"ABCDE"], ["1"] * 5)
    after = Fields([2.0, 9.0, 2.5, math.nan, 6.0], [*"ABCDE"], ["1"] * 5)
    found = paired_over_sheets(before, after)
    assert (found.sheets, found.unpaired, found.means) == (
        (3, 3),
        ("B", "D"),
        pytest.approx((7 / 3, 3.5)),
    )


@pytest.mark.parametrize(
    ("one", "two", "why"),
    [
        ([1.0, 2.0], [2.0, 5.0], "2 of at least 3 sheets"),
        ([1.0, 2.0, 3.0], [1.1, 2.1, 3.1], "all sheets have the same difference"),
        ([math.nan], [1.0], "no sheet has a partner"),
    ],
)
def test_a_pair_without_interval_says_why(one, two, why):
    found = paired_over_sheets(fields(one), fields(two))
    assert (found.reason, found.distinguishable) == (why, None)
    assert math.isnan(found.smallest_seen())
    assert equivalence(found, margin=1.0).verdict == "unknown"


def test_groups_without_interval_state_the_reason_and_p_is_adjusted_for_the_table():
    assert two_groups(fields([1.0, 2.0, 3.0]), fields([1.0])).reason == "1 of at least 3 sheets"
    assert (
        two_groups(fields([2.0] * 3), fields([1.0] * 3)).reason == "all sheets have the same value"
    )
    assert (
        two_groups(fields([]), fields([1.0] * 3)).reason
        == "one of the two has no field with a value"
    )
    rng = np.random.default_rng(2)
    all_ = [
        two_groups(fields(rng.normal(size=4)), fields(rng.normal(size=4) + k)) for k in range(3)
    ]
    all_.append(two_groups(fields([1.0]), fields([2.0])))
    held = p_of_tables(all_)
    assert [d.p_of_table for d in held[:3]] == holm([d.p for d in all_])[:3]
    assert math.isnan(held[3].p_of_table)


@pytest.mark.parametrize(
    ("shift", "margin", "verdict"),
    [
        (0.3, 1.0, "equivalent"),
        (0.0, 0.05, "undecided"),
        (1.0, 1.0, "undecided"),
        (-3.0, 1.0, "larger"),
    ],
)
def test_equivalence_is_two_one_sided_tests(shift, margin, verdict):
    change = shift + 0.2 * np.array([-1.0, 0.5, 1.0, -0.5, 0.3, -0.3])
    before = np.array([1.0, 4.0, 2.0, 3.0, 5.0, 6.0])
    found = equivalence(paired_over_sheets(fields(before), fields(before + change)), margin=margin)
    sides = [
        stats.ttest_1samp(change, -margin, alternative="greater").pvalue,
        stats.ttest_1samp(change, margin, alternative="less").pvalue,
    ]
    assert (found.verdict, found.p) == (verdict, pytest.approx(max(sides), rel=1e-6))
    assert (found.p < 0.05) == (verdict == "equivalent")
    assert found.interval == pytest.approx(
        stats.t.interval(0.9, 5, change.mean(), stats.sem(change)), abs=1e-12
    )


@pytest.mark.parametrize("free", [2.0, 3.9, 4.0, 7.3, 3000.0])
def test_the_smallest_difference_that_is_seen_has_that_power_at_any_degrees_of_freedom(free):
    quantile = stats.t.ppf(0.975, free)
    found = two_groups(fields([1.0, 2.0, 4.0]), fields([1.0, 2.5, 3.1]))
    shift = found.model_copy(update={"free": free, "standard_error": 1.0}).smallest_seen()
    seen = stats.nct.sf(quantile, free, shift) + stats.nct.cdf(-quantile, free, shift)
    assert seen == pytest.approx(0.8, abs=1e-6)


def test_a_margin_of_0_is_refused():
    found = paired_over_sheets(fields([1.0, 2.0, 3.0]), fields([1.0, 2.5, 3.1]))
    refused(InputError, "margin is 0", equivalence, found, margin=0.0)
