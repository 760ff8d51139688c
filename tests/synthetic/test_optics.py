"""What brightness says about the sheet; the formula itself is tested in
`tests/analyze/test_kubelka_munk.py`."""

from dataclasses import replace

import numpy as np
import pytest

from planish.synthetic import PRESETS, PaperParams, camera


def test_one_more_sheet_on_a_pile_leaves_it_as_it_is():
    for paper in (PaperParams(), PRESETS["board"][1], PRESETS["sc50"][1]):
        one_more = camera.sheet_reflectance(
            paper,
            "pile",
            coating_top_um=paper.coating_top_um,
            coating_bottom_um=paper.coating_bottom_um,
        )
        assert one_more == pytest.approx(camera.pile_reflectance(paper), abs=1e-12)
    assert camera.pile_reflectance(PRESETS["sc50"][1]) == pytest.approx(
        1 + 1.2 / 45 - np.sqrt((1.2 / 45) ** 2 + 2 * 1.2 / 45), abs=1e-12
    )


def test_each_map_and_a_coating_act_on_the_brightness_in_their_own_sense():
    coating = np.linspace(0.0, 40.0, 81)
    paper = PaperParams()
    pile, black = (
        camera.sheet_reflectance(paper, backing, coating_top_um=coating, coating_bottom_um=17.4)
        for backing in ("pile", "black")
    )
    assert (np.diff(black) > 0).all()
    assert (black < pile).all()
    # Less and less: what is bright already gains less.
    assert (np.diff(pile) > 0).all()
    assert (np.diff(pile, 2) < 0).all()
    assert 0.78 < pile[0] < pile[-1] < 0.93

    def over_black(paper=paper, **more):
        given = {"coating_top_um": 17.4, "coating_bottom_um": 17.4} | more
        return camera.sheet_reflectance(paper, "black", **given)

    for more in (
        {"coating_density": 1.1},
        {"base_mass": 1.1},
        {"base_s_m2_per_kg": 50.0},
        {"coating_bottom_um": 20.0},
    ):
        assert over_black(**more) > over_black()
    heavy = replace(paper, base_um=paper.base_um * 2)
    assert over_black(heavy) == pytest.approx(over_black(base_mass=2.0), abs=1e-14)
