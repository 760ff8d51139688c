import numpy as np
import pytest

from analyze.fields import gaussian_maps, related_maps
from planish.analyze import correlate, difference_of, holm, paired_difference
from planish.core.errors import InputError


def test_the_same_pair_does_not_differ_also_with_missing_pixels():
    a, b = related_maps(0, (40, 50), 3.0, 0.5)
    found = paired_difference((a, b), (a, b), pixel_um=1)
    assert (found.difference, found.interval, found.distinguishable) == (0, (0, 0), False)
    a, b = related_maps(3, (40, 50), 3.0, 0.5)
    holed = np.where(np.random.default_rng(4).random(a.shape) < 0.3, np.nan, a)
    assert paired_difference((holed, b), (a, b), pixel_um=1).difference == 0


def test_what_two_pairs_share_makes_the_interval_narrow():
    rng = np.random.default_rng(1)
    a, b = related_maps(rng, (60, 80), 3.0, 0.6)
    worse = a + 0.3 * gaussian_maps(rng, (60, 80), 2.0)[0]
    paired = paired_difference((worse, b), (a, b), pixel_um=1)
    apart = difference_of(correlate(worse, b, pixel_um=1), correlate(a, b, pixel_um=1))
    assert paired.difference == pytest.approx(apart.difference)
    widths = [c.interval[1] - c.interval[0] for c in (paired, apart)]
    assert widths[0] < 0.5 * widths[1]
    assert paired.distinguishable
    assert not apart.distinguishable


@pytest.mark.ci
def test_the_paired_interval_holds_the_truth():
    rng, inside = np.random.default_rng(2), []
    for _ in range(200):
        a, b = related_maps(rng, (60, 80), 3.0, 0.6)
        worse = 0.8 * a + 0.6 * gaussian_maps(rng, (60, 80), 3.0)[0]
        low, high = paired_difference((worse, b), (a, b), pixel_um=1).interval
        inside.append(low <= 0.6 - 0.48 <= high)
    assert 0.89 < np.mean(inside) < 0.995


def test_points_of_other_sizes_and_planes_are_not_compared():
    a, b = related_maps(0, (40, 50), 3.0, 0.5)
    with pytest.raises(InputError, match="same point_um"):
        difference_of(correlate(a, b, pixel_um=1), correlate(a, b, pixel_um=1, point_um=5))
    rows, cols = np.mgrid[:40, :50].astype(float)
    found = paired_difference((rows, cols + rows), (cols, cols + rows), pixel_um=1)
    assert found.distinguishable is None


def test_holm():
    found = holm([0.01, 0.04, float("nan"), 0.03])
    assert found[:2] == pytest.approx([0.04, 0.09])
    assert np.isnan(found[2])
    assert (found[3], holm([0.6, 0.7])) == (pytest.approx(0.09), [1.0, 1.0])
