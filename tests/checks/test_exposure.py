"""Images whose greys are cut off are seen, and no others."""

import numpy as np
import pytest

from planish.checks import SheetImage, run_checks

RNG = np.random.default_rng(3)
GREY = RNG.normal(120.0, 20.0, (300, 200))


@pytest.mark.parametrize(
    ("values", "state", "words"),
    [
        (np.clip(np.rint(GREY), 0, 255).astype(np.uint8), "pass", "does not end"),
        (GREY, "pass", "does not end"),
        (np.clip(np.rint(GREY), 0, 150).astype(np.uint8), "look", "as bright as"),  # 7 % above
        (np.clip(GREY, 90.0, 500.0), "look", "as dark as"),
        (np.clip(np.rint(GREY / 4), 0, 100), "pass", "does not end"),  # few levels, none crowded
        (np.where(GREY > 120, 1.0, 0.0), "pass", "does not end"),  # a mask
        (np.full((4, 4), np.nan), "pass", "does not end"),
    ],
)
def test_states(values, state, words):
    found = run_checks(SheetImage(values))[0]
    assert found.state == state
    assert words in found.sentence


def test_the_share_is_the_share_of_the_pixels_cut_off():
    found = run_checks(SheetImage(np.where(GREY > 150.0, 150.0, GREY)))[0]
    assert found.value == pytest.approx(np.mean(GREY > 150.0), abs=1e-12)
