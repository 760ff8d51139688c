import math

import numpy as np
import pytest
from scipy import ndimage

from analyze.fields import gaussian_maps
from planish.analyze import bland_altman, compare_instruments, correlate, deming, independent_points
from planish.core.area import area_mean
from planish.core.errors import CannotMeasure


def measured(rng, shape=(90, 120), *, bias=0.3, blur=2.0, noise=0.3):
    """A quantity, seen by a sharp instrument and by a blurred one."""
    rng = np.random.default_rng(rng)
    truth = gaussian_maps(rng, shape, 6.0)[0]
    a = truth + noise * rng.normal(size=shape)
    b = ndimage.gaussian_filter(truth, blur) + bias + noise * rng.normal(size=shape)
    return a, b


def test_two_instruments_are_compared_over_points():
    a, b = measured(0)
    mask = np.ones(a.shape, bool)
    mask[20:40, 30:60] = False
    a[70:75, :8] = np.nan
    a = np.where(mask, a, np.nan)
    found = compare_instruments(a, b, pixel_um=5.0, point_um=20.0, error_ratio=1.0)
    known = mask & np.isfinite(a)
    one, two = (area_mean(np.where(known, m, np.nan), (4.0, 4.0)) for m in (a, b))
    assert (found.point_um, found.agreement) == (20.0, bland_altman(one, two, pixel_um=20.0))
    assert found.correlation == correlate(a, b, pixel_um=5.0, point_um=20.0)
    n_eff = independent_points(one, two, pixel_um=20.0).n_eff
    assert found.line == deming(one, two, error_ratio=1.0, n_eff=n_eff)
    assert np.array_equal(found.difference, np.where(known, b - a, np.nan), equal_nan=True)
    assert found.notes == ()


def test_the_shared_scale_is_coarser_than_the_blur_or_reported_as_missing():
    a, b = measured(1)
    found = compare_instruments(a, b, pixel_um=5.0)
    assert found.rings is not None
    assert found.shared_um == found.rings.resolution_um
    assert 20.0 < found.shared_um < 150.0  # a blur of 10 um (sd) takes 9/10 of waves of 30 um away
    assert (found.line, found.point_um) == (None, 5.0)
    a, b = measured(2, (4, 5))
    found = compare_instruments(a, b, pixel_um=1.0)
    assert (found.rings, found.shared_um) == (None, None)
    assert any("rings" in note for note in found.notes)
    assert math.isfinite(found.agreement.bias)
    with pytest.raises(CannotMeasure):
        compare_instruments(a, np.full(a.shape, np.nan), pixel_um=1.0)
