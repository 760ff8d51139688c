"""What the registration can promise: its words and lights, where lags are drawn, what the results hold of a lag."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import xarray as xr

from planish.analyze import Lag, LagField, Registration
from planish.report import promise
from planish.report.draw import FULL, HALF, house_style, levels_between
from planish.report.ground import blank_ground
from planish.report.lags import draw_lags, lag_places
from planish.report.page import render_report
from planish.report.registration import draw_expected_error
from planish.report.text import capital, typeset
from planish.results import lag_results
from report.pages import Page
from report.runs import a_run

NAN = math.nan
NOWHERE = (NAN, NAN)
MICRO = "\u202fµm"


def a_lag(*, silence: Any = None, tiles: bool = True) -> Lag:
    """Return a lag of (3, -4) um, known to 0.6 and 0.8 um, or one that says nothing."""
    field = LagField(
        at_um=np.array([[100.0, 200.0], [300.0, 200.0]]), lag_um=np.array([[1.0, 2.0], [NAN, NAN]]),
        covariance_um2=np.full((2, 2, 2), 0.25), r=np.array([0.6, 0.1]), distinct=np.array([True, False]),
        tile_um=400.0,
    )  # fmt: skip
    quiet = silence is not None
    return Lag(
        lag_um=NOWHERE if quiet else (3.0, -4.0),
        covariance_um2=np.full((2, 2), NAN) if quiet else np.diag([0.36, 0.64]),
        r=-0.5, r_at_zero=-0.4, null_95=0.1, null_99=0.15, rival_r=0.1, silence=silence,
        split_um=NAN if quiet else 90.0,
        lags_of_bands_um=(NOWHERE, NOWHERE) if quiet else ((3.0, -4.0), NOWHERE), reach_um=150.0, pixel_um=(8.0, 8.0),
        n=5000, field=field if tiles else None,
    )  # fmt: skip


def test_results_of_a_lag_are_ready_for_json() -> None:
    found = lag_results(a_lag(), expected_um=4.0, headline="coating_top")
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert (found["lag_um"], found["se_um"], found["length_um"]) == ([3.0, -4.0], [0.6, 0.8], 5.0)
    # Along (3, -4) / 5: sqrt(0.6² 0.36 + 0.8² 0.64).
    assert found["length_se_um"] == pytest.approx(math.sqrt(0.36 * 0.36 + 0.64 * 0.64))
    # 5 um is less than 1.73 sqrt(16 + 0.36 + 0.64).
    assert found["agrees"] is True
    assert found["sentence"] == a_lag().sentence(4.0)
    assert found["lags_of_bands_um"] == [[3.0, -4.0], None]
    assert found["tiles"] == [
        {"x": 100.0, "y": 200.0, "lag_um": [1.0, 2.0], "distinct": True},
        {"x": 300.0, "y": 200.0, "lag_um": None, "distinct": False},
    ]
    assert lag_results(a_lag(), expected_um=1.0, headline="thickness")["agrees"] is False


def test_results_of_a_lag_that_says_nothing_are_none() -> None:
    found = lag_results(a_lag(silence="texture", tiles=False), expected_um=4.0, headline="coating_top")
    json.dumps(found, allow_nan=False)
    assert [found[k] for k in ("lag_um", "se_um", "length_um", "agrees", "split_um", "tile_um")] == [None] * 6
    assert found["tiles"] == []
    assert found["silence"] == "texture"
    for missing in (None, NAN):
        assert lag_results(a_lag(), expected_um=missing, headline="coating_top")["expected_um"] is None


@pytest.mark.parametrize(
    ("silence", "expected_um", "state", "meaning"),
    [
        (None, 4.0, "agrees", "finds nothing wrong"),
        (None, 1.0, "amber", f"known to about 5.0{MICRO} and no better"),
        (None, None, "grey", "no expected error of the marks"),
        ("texture", 4.0, "grey", "neither for nor against the registration"),
    ],
)
def test_a_check_is_green_amber_or_grey_but_never_red(
    silence: Any, expected_um: float | None, state: str, meaning: str
) -> None:
    told = lag_results(a_lag(silence=silence), expected_um=expected_um, headline="coating_top")
    check = promise.lag_check(told, first="coating thickness", second="the image")
    assert check is not None
    assert check.state == state
    assert meaning in check.meaning
    assert check.sentence.endswith(".")
    assert " um" not in check.sentence


def test_maps_that_know_less_than_the_marks_say_so() -> None:
    told = lag_results(a_lag(), expected_um=0.9, headline="coating_top") | {"agrees": True}
    check = promise.lag_check(told, first="coating thickness", second="the image")
    assert check is not None
    assert f"up to about 2.0{MICRO} would not be noticed" in check.meaning
    assert promise.lag_check(None, first="a", second="b") is None


def test_words_of_the_registration_are_those_of_the_analysis() -> None:
    assert promise.MARKS_ONLY == promise.registered({}) == Registration.MARKS.sentence
    for kind in Registration:
        assert promise.registered({"registration_kind": kind.sentence}) == kind.sentence
        assert promise.registered({"registration_kind": kind.value}) == kind.sentence


def test_the_axis_given_for_the_image_comes_first() -> None:
    told: dict[str, Any] = {"md_deg_image": 10.0, "md_deg_image_from_map": 12.0}
    assert promise.axis_in_image({"orientation": told}) == (10.0, "given for the image")
    told["md_deg_image"] = None
    assert promise.axis_in_image({"orientation": told}) == (12.0, "carried over from the volume")
    assert promise.axis_in_image({}) is promise.axis_in_image({"orientation": None}) is None


def test_tiles_lie_where_their_pixels_do() -> None:
    # Pixels of 8 um are means of 2 x 2 pixels of 4 um: the middle of the first is 2 um from that of the small one.
    ground = blank_ground(np.array([[0.0, 0.0], [1000.0, 600.0]]), of="image")
    ground = replace(ground, y=4.0 * np.arange(200.0), x=10 + 4.0 * np.arange(300.0))
    at, lag, silent = lag_places(lag_results(a_lag(), expected_um=4.0, headline="a"), ground)
    np.testing.assert_allclose(at, [[112.0, 202.0]])
    np.testing.assert_allclose(lag, [[1.0, 2.0]])
    np.testing.assert_allclose(silent, [[312.0, 202.0]])


def test_no_figure_of_lags_unless_one_is_distinct() -> None:
    ground = blank_ground(np.array([[0.0, 0.0], [400.0, 400.0]]), of="image")
    told = lag_results(a_lag(), expected_um=4.0, headline="a")
    told["tiles"] = told["tiles"][1:]
    for none in (None, {}, told, lag_results(a_lag(tiles=False), expected_um=4.0, headline="a")):
        assert draw_lags(none, ground, first="a", second="b", width=HALF) is None


def test_expected_error_says_its_range_and_needs_values() -> None:
    y, x = 5.0 * np.arange(40), 5.0 * np.arange(60)
    error = xr.DataArray(np.tile(np.linspace(1.0, 3.0, 60), (40, 1)), {"y": y, "x": x}, ("y", "x"))
    with house_style():
        drawn = draw_expected_error(error, None, hole_um=200.0, width=FULL)
        assert drawn is not None
        assert f"1.0{MICRO} to 3.0{MICRO}, median 2.0{MICRO}" in drawn.caption
        assert f"Contour lines every 0.2{MICRO}" in drawn.caption
        even = draw_expected_error(error * 0 + 1.5, None, hole_um=200.0, width=HALF)
        assert even is not None
        assert "Contour" not in even.caption
        assert draw_expected_error(error * NAN, None, hole_um=200.0, width=HALF) is None


def test_levels_are_round_and_inside() -> None:
    levels, step = levels_between(0.93, 2.17, steps=5)
    np.testing.assert_allclose(levels, [1.0, 1.2, 1.4, 1.6, 1.8, 2.0])
    assert step == pytest.approx(0.2)
    assert levels_between(1.0, 1.0, steps=5)[0].size == 0


def test_page_says_what_the_registration_can_promise() -> None:
    run = a_run()
    run["results"]["marks"] |= {"design": {"file": "d.json", "sentence": "The design d.json is met within 8 um."},
                                "tilt": {"sentence": "Holes lean by 1.2 deg."}}  # fmt: skip
    run["results"]["lag"] |= {"agrees": False, "sentence": "lag 9 ± 0.3 um: more than the marks allow"}
    html = render_report(**run)
    page = Page(html)
    text = page.text()
    for expected in (
        "Expected error of a place.",
        "What the maps say of their place, part by part.",
        f"Lag 9 ± 0.3{MICRO}: more than the marks allow.",
        "The machine direction lies at 20° in the image.",
        "20° from x clockwise (carried over from the volume)",
        f"The design d.json is met within 8{MICRO}.",
        "Holes lean by 1.2°.",
    ):
        assert expected in text
    # Shown amber, and no gate: the gates are passed as before.
    assert re.search(r'<li class="amber">', html)
    assert re.search(r'<p class="check amber">', html)
    assert "The quality gate is passed." in text
    # Beside each r²: the verdict's sentence and two numbers, the figure of the relation, two tables.
    assert len(re.findall("registration: marks only", text, flags=re.IGNORECASE)) == 3 + 1 + 2


def test_what_others_write_stays_text() -> None:
    hostile = "<script>alert('x')</script>"
    run = a_run()
    run["results"]["lag"]["sentence"] = run["results"]["orientation"]["sentence"] = hostile
    run["results"]["registration_kind"] = hostile
    run["results"]["marks"] |= {"design": {"file": hostile, "sentence": hostile}, "tilt": {"sentence": hostile}}
    page = Page(render_report(**run))
    assert "script" not in page.tags
    assert page.text().count(hostile) >= 6


def test_units_of_sentences_are_typeset_and_names_left_alone() -> None:
    assert typeset("lag 2 um, 3 deg; a column") == f"lag 2{MICRO}, 3°; a column"
    assert typeset("an umbrella of degrees") == "an umbrella of degrees"
    assert capital("maps of A") == "Maps of A"
