"""What the page says of a registration: its check with its light, its lags and its expected
error."""

import re
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from planish.analyze import LagNumbers, RegistrationBasis
from planish.core.numbers import capital, typeset
from planish.report import draw, registration, summary
from planish.report.text import REGISTERED
from planish.results import RegistrationFacts
from report.pages import Page
from report.runs import a_run, lag_of, page_of, registration_of, text_of

MICRO = "\u202fµm"
SILENT = {
    "reason": "texture",
    "agrees": None,
    "lag_um": None,
    "se_um": None,
    "length_um": None,
    "sentence": "No shared fine texture",
}


def a_lag(**values):
    """Return a lag of (3, -4) um, known to 0.6 and 0.8 um."""
    given = {
        "lag_um": (3.0, -4.0),
        "se_um": (0.6, 0.8),
        "length_um": 5.0,
        "pixel_um": (8.0, 8.0),
        "tile_um": 400.0,
        "tiles": [
            {"x": 100.0, "y": 200.0, "lag_um": (1.0, 2.0), "distinct": True},
            {"x": 300.0, "y": 200.0, "lag_um": None, "distinct": False},
        ],
    }
    return LagNumbers.model_validate(lag_of(**given) | values)


@pytest.mark.parametrize(
    ("values", "state", "meaning"),
    [
        (
            {"agrees": True, "expected_um": 4.0},
            "agrees",
            "within the error expected from the marks",
        ),
        (
            {"agrees": True, "expected_um": 0.9},
            "agrees",
            f"up to about 2.0{MICRO} would not be noticed",
        ),
        (
            {"agrees": False, "expected_um": 1.0},
            "amber",
            f"known to about 5.0{MICRO} and no better",
        ),
        ({"agrees": None, "expected_um": None}, "grey", "no expected error"),
        (SILENT, "grey", "neither for nor against the registration"),
    ],
)
def test_a_check_is_green_amber_or_grey_but_never_red(values, state, meaning):
    check = summary.lag_verdict(a_lag(**values), ("coating thickness", "the image"))
    assert check.state == state
    assert meaning in check.meaning
    assert check.sentence.endswith(".")
    assert " um" not in check.sentence
    assert summary.lag_verdict(None, ("a", "b")) is None


def test_words_units_and_levels_are_the_same_everywhere():
    assert RegistrationBasis.MARKS.sentence == REGISTERED
    assert typeset("lag 2 um, 3 deg; a column") == f"lag 2{MICRO}, 3°; a column"
    assert (typeset("an umbrella of degrees"), capital("maps of A")) == (
        "an umbrella of degrees",
        "Maps of A",
    )
    levels, step = draw.levels_between(0.93, 2.17, steps=5)
    np.testing.assert_allclose(levels, [1.0, 1.2, 1.4, 1.6, 1.8, 2.0])
    assert (step, draw.levels_between(1.0, 1.0, steps=5)[0].size) == (pytest.approx(0.2), 0)


def test_the_axis_given_for_the_image_comes_first():
    def found(**angles):
        facts = registration_of("volume", "image")
        facts["orientation"] = facts["orientation"] | angles
        return registration.machine_direction(RegistrationFacts.model_validate(facts), "volume")

    assert found(md_deg_fixed=10.0, md_deg_fixed_from_moving=12.0) == (10.0, "given for the image")
    assert (found(md_deg_fixed_from_moving=12.0), found()) == (
        (12.0, "carried over from the volume"),
        None,
    )


def test_lags_lie_where_their_pixels_do_and_are_drawn_if_distinct():
    # Pixels of 8 um are means of 2 x 2 pixels of 4 um: the middle of the first is 2 um from that of
    # the small one.
    ground = registration.blank_ground(np.array([[0.0, 0.0], [1000.0, 600.0]]), layer="image")
    axes = [("y", 4.0 * np.arange(200.0)), ("x", 10 + 4.0 * np.arange(300.0))]
    ground = replace(ground, data=xr.DataArray(np.nan, axes))
    at, lag, silent = registration.lag_places(a_lag(), ground)
    np.testing.assert_allclose(at, [[112.0, 202.0]])
    np.testing.assert_allclose(lag, [[1.0, 2.0]])
    np.testing.assert_allclose(silent, [[312.0, 202.0]])
    ground = registration.blank_ground(np.array([[0.0, 0.0], [400.0, 400.0]]), layer="image")
    silent = a_lag().model_copy(update={"tiles": a_lag().tiles[1:]})
    for none in (None, silent, a_lag(tiles=[], tile_um=None)):
        assert registration.draw_lags(none, ground, map_texts=("a", "b")) is None


def test_expected_error_states_its_range_and_needs_values():
    y, x = 5.0 * np.arange(40), 5.0 * np.arange(60)
    error = xr.DataArray(np.tile(np.linspace(1.0, 3.0, 60), (40, 1)), {"y": y, "x": x}, ("y", "x"))
    given = {"hole_um": 200.0, "reference": "image", "layer": "volume"}
    drawn = registration.draw_expected_error(error, None, width=draw.FULL, **given)
    assert f"1.0{MICRO} to 3.0{MICRO}, median 2.0{MICRO}" in drawn.caption
    assert f"Contour lines every 0.2{MICRO}" in drawn.caption
    # The line of 2 um stands upright in the middle.
    assert re.search(r">2</text>", drawn.svg)
    even = registration.draw_expected_error(error * 0 + 1.5, None, width=draw.HALF, **given)
    assert "Contour" not in even.caption
    assert registration.draw_expected_error(error * np.nan, None, width=draw.HALF, **given) is None


def test_page_states_what_is_known_of_the_registration():
    run = a_run()
    facts = run["results"]["layers"][0]["registration"]
    tilt = {
        "through": 3,
        "closed": 0,
        "unclear": 0,
        "other_side_only": 0,
        "offset_count": 3,
        "offset_um": [1.0, 1.0],
        "offset_spread_um": [1.0, 1.0],
        "offset_error_um": [1.0, 1.0],
        "side": "top",
        "sentence": "Holes lean by 1.2 deg.",
    }
    facts |= {"design": "The design d.json is met within 8 um.", "tilt": tilt}
    facts["lag"] |= {"agrees": False, "sentence": "lag 9 ± 0.3 um: more than the marks allow"}
    html = page_of(run)
    text = Page(html).text()
    for expected in (
        "Expected error of the position",
        f"orange circles of 220{MICRO}",  # the middle of the diameters that were looked for
        "Image-based check, tile by tile.",
        f"Lag 9 ± 0.3{MICRO}: more than the marks allow.",
        "The machine direction lies at 20° in the image.",
        "20° from x clockwise (carried over from the volume)",
        f"The design d.json is met within 8{MICRO}.",
        "Holes lean by 1.2°.",
    ):
        assert expected in text
    assert re.search(r'<p class="check amber">', html)
    assert "The check passed." in text
    # Beside each r: the sentence, two numbers and the scatter of the first page, the figure of the
    # relation, tables.
    assert len(re.findall("registration: marks only", text, flags=re.IGNORECASE)) == 3 + 1 + 1 + 2


def tiled(source, is_tile):
    """Return the run whose marks are tiles of texture, as far as said."""
    run = a_run()
    marks = run["marks"]["volume"]
    sources = {
        f"{plane}_source": ("mark", np.where(is_tile, "tile", "detected"))
        for plane in ("moving", "fixed")
    }
    run["marks"]["volume"] = registration.with_tiles_named(marks, marks.assign(sources))
    run["results"]["layers"][0]["registration"]["source"] = source
    return run


def test_tiles_are_crosses_and_the_texture_that_placed_them_does_not_judge_them():
    html = page_of(tiled("texture", [True] * 3))
    text = Page(html).text()
    for expected in (
        "with n = 3 tiles of texture (orange crosses at their middles)",
        "3 tiles of the texture",
        "only what light from one side explains is included",
    ):
        assert expected in text
    for wrong in (
        "orange circles",
        "from a file",
        "Lag of the maps",
        "tile by tile",
        "all marks share is not",
    ):
        assert wrong not in text
    assert '<p class="check ' not in html


def test_holes_beside_tiles_keep_their_circles():
    text = text_of(tiled("both", [True, False, False]))
    assert (
        f"3 marks (orange circles of 220{MICRO}, crosses alone at the middles of tiles of texture)"
        in text
    )
    assert "3 pairs: holes, and tiles of the texture" in text
    assert "registered by the holes that they share and by their texture" in text
    assert "Image-based check, tile by tile." in text
