"""Checks of a mapped sheet, judged from what its surfaces say."""

import numpy as np
import pytest
import xarray as xr
from scipy import ndimage

from planish.checks import CHECKS
from planish.surface import find_surfaces
from surface.sheets import volume as volume_of


@pytest.mark.parametrize(("gap_um", "state"), [(30.0, "pass"), (4.0, "look"), (None, None)])
def test_a_film_that_was_left_out_is_named_and_doubted_where_the_blur_reaches_the_sheet(
    gap_um, state
):
    attrs = {"blur_um": 2.0} | (
        {} if gap_um is None else {"beside": "40 um", "beside_gap_um": gap_um}
    )
    rule = next(rule for rule in CHECKS if rule.name == "film")
    check = rule(rule.stage(facts=None, measured=xr.Dataset(attrs=attrs)))
    assert (check and check.state) == state
    assert check is None or "40 um" in check.sentence


@pytest.mark.ci
def test_tape_that_touches_a_coated_sheet_is_learnt_and_fails():
    volume = np.full((60, 40, 40), 40.0)
    volume[12:47] = 75.0  # the base
    volume[12:17], volume[42:47] = 175.0, 175.0  # both coatings
    plain, taped = volume.copy(), volume.copy()
    taped[4:12] = 80.0  # 24 um of tape below the coating
    rule, states = next(rule for rule in CHECKS if rule.name == "film"), []
    for grey in (plain, taped):
        grey = ndimage.gaussian_filter(grey, 0.6) + np.random.default_rng(0).normal(
            0.0, 6.0, grey.shape
        )
        surfaces = find_surfaces(volume_of(grey.astype(np.float32)))
        check = rule(rule.stage(facts=None, measured=surfaces))
        states.append(check and (check.state, "bottom side some 24 um" in check.sentence))
    assert states == [None, ("fail", True)]
