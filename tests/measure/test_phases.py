"""Voids, filler and ink in bases whose phases are formulas."""

import numpy as np
import pytest
from pydantic import ValidationError

from folders import refused
from planish.core.errors import CannotMeasure
from planish.measure import MeasureParams, depth_profiles


def sharp(inside, *, grey=90.0, other=40.0):
    """A bare base of 50 um with another grey where ``inside(s, u, v)``."""

    def paint(s, u, v):
        values = np.where(np.abs(s) <= 25.0, grey, 40.0)
        return np.where(inside(s, u, v) & (np.abs(s) <= 25.0), other, values)

    return paint


@pytest.mark.parametrize("slope", [0.0, 0.4])
def test_porosity_of_a_flat_void(made, slope):
    """A void of 10 um in the core of 40 um, 5 um left out at both ends: a quarter; of grey, the
    same."""
    sheet = made(
        sharp(lambda s, _u, _v: np.abs(s - 3.0) < 5.0),
        top=0.0,
        bottom=0.0,
        voxel=1.0,
        size_um=(40.0, 130.0),
        slope=(0.0, slope),
        blur=0.3,
    )
    for grey in ({}, {"solid_grey": 90.0 + 1e-6}):
        values = sheet.measured("porosity", edge_um=5.0, **grey)["porosity"].values[8:-8, 30:-30]
        # two boundaries of a voxel each: the mean over rays is nearer than one ray
        assert float(values.mean()) == pytest.approx(0.25, abs=0.01)
        np.testing.assert_allclose(values, 0.25, atol=1.0 / 40)


def test_unresolved_voids_are_seen_by_the_mean_grey_only(made):
    """Half of a solid's grey everywhere is a porosity of one half, or of none."""
    sheet = made(top=0.0, bottom=0.0)
    for solid, value in (({"solid_grey": 140.0}, 0.5), ({}, 0.0)):
        found = sheet.measured("porosity", **solid)
        assert float(found["porosity"].mean()) == pytest.approx(value, abs=1e-3)
        # the check of porosity reads there whether the grey of a wall is known
        assert found["porosity"].attrs.get("solid_grey") == solid.get("solid_grey")
    refused(CannotMeasure, "lies beyond the base", sheet.measured, "porosity", solid_grey=80.0)


def test_profile_of_a_ramp(made):
    """Grey that falls from the solid at the bottom to the air at the top: the porosity is the
    relative depth."""
    sheet = made(
        lambda s, _u, _v: np.where(np.abs(s) < 60, 40 + 100 * (25 - s) / 50, 40.0),
        top=0.0,
        bottom=0.0,
    )
    options = MeasureParams(solid_grey=140.0)
    whole, cut = (
        depth_profiles(
            sheet.volume,
            sheet.surfaces,
            names=["porosity"],
            bins=10,
            params=options,
            rows_per_tile=n,
        )
        for n in (500, 7)
    )
    # an exact ramp, interpolated linearly
    np.testing.assert_allclose(whole["porosity"], whole["depth"], atol=1e-4)
    assert whole["porosity_n"].values.min() > 1000
    assert whole.identical(cut)
    assert list(whole["blurred"].values) == [1, 0, 0, 0, 0, 0, 0, 0, 0, 1]
    refused(
        CannotMeasure,
        "no profile of ash",
        depth_profiles,
        sheet.volume,
        sheet.surfaces,
        names=["ash"],
    )


def test_filler_and_coating_that_has_run_in(made):
    """Grains on 6 of 40 um; coating that reaches 9 um below the interface is none of it."""

    def paint(s, _u, _v):
        values = np.where(np.abs(s) <= 25, 90.0, np.where((s > 25) & (s < 41), 200.0, 40.0))
        return np.where((s > 16) & (s <= 25) | (np.abs(s + 8) < 3), 200.0, values)

    sheet = made(paint, top=16.0, bottom=0.0, voxel=1.0, size_um=(30.0, 60.0), blur=0.3)
    found = sheet.measured(
        "filler", "filler_weight", edge_um=5.0, filler_grey=145.0, filler_g_cm3=2.7
    )
    share = float(np.nanmedian(found["filler"]))
    # of the 36 um from -20 to 16; grains are 6 or 7 voxels thick
    assert share == pytest.approx(6 / 36, abs=1.2 / 36)
    assert float(np.nanmedian(found["filler_weight"])) == pytest.approx(share * 50 * 2.7, rel=1e-4)
    refused(CannotMeasure, "filler_g_cm3", sheet.measured, "filler_weight")
    refused(CannotMeasure, "Give filler_grey", made(top=0.0, bottom=0.0).measured, "filler")


def test_depth_of_ink_and_its_censoring(made):
    """Ink of 10 um below the face; none on one half; too deep to tell on a stripe."""

    def ink(s, u, v):
        deep = np.where(v > 15, 40.0, 10.0)
        return 300.0 * ((s <= 41.0) & (s > 41.0 - deep) & (u < 20))

    sheet = made(extra=ink, blur=0.5, voxel=1.0, size_um=(60.0, 100.0))
    found = sheet.measured(
        "ink_depth_50", "ink_depth_90", ink_grey=(350.0, 600.0), ink_reach_um=20.0
    )
    at = (slice(10, 35), slice(10, 60))
    # the ink's lower end lies between voxels, its upper one where the face's blur passes the range
    np.testing.assert_allclose(found["ink_depth_50"].values[at], 5.0, atol=0.6)
    np.testing.assert_allclose(found["ink_depth_90"].values[at], 9.0, atol=0.7)
    reasons = found["ink_depth_50_status"]
    meaning = dict(
        zip(reasons.attrs["flag_values"], reasons.attrs["flag_meanings"].split(), strict=True)
    )
    assert (meaning[int(reasons[20, 90])], meaning[int(reasons[52, 30])]) == (
        "no_ink",
        "ink_reaches_limit",
    )
    assert np.isnan(found["ink_depth_50"].values[20, 90])
    refused(CannotMeasure, "ink_grey", sheet.measured, "ink_depth_50")
    refused(ValidationError, "give the smaller first", MeasureParams, ink_grey=(2.0, 1.0))
