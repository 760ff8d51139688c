"""Checks of a mapped sheet, judged from what its surfaces say."""

import pytest
import xarray as xr

from planish.checks import CHECKS


@pytest.mark.parametrize(("gap_um", "state"), [(30.0, "pass"), (4.0, "look"), (None, None)])
def test_a_film_that_was_left_out_is_named_and_doubted_where_the_blur_reaches_the_sheet(gap_um, state):
    attrs = {"blur_um": 2.0} | ({} if gap_um is None else {"beside": "40 um", "beside_gap_um": gap_um})
    rule = next(rule for rule in CHECKS if rule.name == "film")
    check = rule(rule.stage(facts=None, measured=xr.Dataset(attrs=attrs)))
    assert (check and check.state) == state
    assert check is None or "40 um" in check.sentence
