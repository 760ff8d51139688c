"""What all questions of two maps have in common: pixels that are missing, maps that cannot be
compared."""

import numpy as np
import pytest

from analyze.fields import related_maps
from folders import refused
from planish.analyze import (
    bland_altman,
    coherence,
    compare_instruments,
    cross_correlogram,
    independent_points,
    ring_correlation,
)
from planish.core.errors import CannotMeasure, InputError


@pytest.mark.parametrize("measure", [bland_altman, coherence, ring_correlation])
def test_missing_pixels_do_not_count(measure):
    a, b = related_maps(3, (90, 120), 5.0, 0.7)
    known = np.ones(a.shape, bool)
    known[30:50, 40:70] = False
    one = measure(np.where(known, a, np.nan), b, pixel_um=1.0)
    assert one == measure(a, np.where(known, b, np.nan), pixel_um=1.0)
    assert one != measure(a, b, pixel_um=1.0)


@pytest.mark.parametrize(
    "measure",
    [bland_altman, compare_instruments, cross_correlogram, independent_points, ring_correlation],
)
def test_maps_that_cannot_be_compared_are_refused(measure):
    a, b = related_maps(6, (30, 40), 3.0, 0.7)
    refused(InputError, "one grid", measure, a, b[1:], pixel_um=1.0)
    refused(CannotMeasure, "0 pixels", measure, a, np.full(a.shape, np.nan), pixel_um=1.0)
    if measure in (cross_correlogram, ring_correlation):
        refused(CannotMeasure, "map b is constant", measure, a, np.ones(a.shape), pixel_um=1.0)
    if measure is independent_points:
        refused(CannotMeasure, "map x is constant", measure, np.ones(a.shape), b, pixel_um=1.0)
