"""Who made the page, how its r is read, and that options stand in the operator's part alone."""

import re

import pytest

from planish.report.reading_r import reading
from report.runs import IMAGE_PAIR, a_run, lag_of, page_of, results_of, text_of


def with_lag(light, lag_um):
    """A run whose largest r lies at a lag, and whose fine texture agrees with the marks."""
    run = a_run()
    run["results"]["layers"][0]["registration"]["lag"] = lag_of(light=light)
    lags_um = [-100.0, 0.0, 100.0]
    profile = {
        "lags_um": lags_um,
        "r": [0.2, 0.8, 0.2],
        "limit": [0.2] * 3,
        "limit_of_any": [0.3] * 3,
    }
    correlogram = {
        "cell_um": [6.0, 6.0],
        "reach_um": 300.0,
        "r_at_zero": 0.8,
        "peak_r": 0.85,
        "lag_um": list(lag_um),
        "inner": True,
        "widths_um": [90.0, 80.0],
        "angle_deg": 0.0,
        "n_eff": 90.0,
        "limit_of_any": 0.3,
        "beyond_chance": True,
        "along_x": profile,
        "along_y": profile,
    }
    evidence = IMAGE_PAIR | {
        "declared": True,
        "correlogram": correlogram,
        "attenuation_limit": 0.93,
    }
    run["results"]["evidence"] = [evidence]
    return run


def read(run):
    return " ".join(reading(results_of(run)))


def test_side_light_lag_and_strain_are_reconciled_beside_r():
    text = read(with_lag(0.62, (0.0, -19.0)))
    assert "A straight line explains r² = 64 % of the variance" in text
    assert (
        "A perfect relation would show an r of 0.93 here; the rest is lost to misplacement. What"
        " light that spreads in the paper, the blur of the lens and shading take is not in it."
        in text
    )
    assert "62 % of what image and sheet share follows slopes" in text
    assert "side light affects r" in text
    assert "r would be largest, 0.85, with one map shifted by 19\u202fµm." in text
    assert "the light moves the peak, and the registration stands" in text
    assert "less than the 0.5" in text
    assert '<h2 id="reading">How to read r</h2>' in page_of(with_lag(0.62, (0.0, -19.0)))


@pytest.mark.parametrize(
    ("light", "lag_um", "says", "says_not"),
    [
        (0.05, (0.0, -19.0), "the peak is broad, and the registration stands", "the light moves"),
        (0.05, (0.0, 0.2), "That is about the error of the registration", "the peak is broad"),
        (None, (0.0, -19.0), "The fine texture lies", "slopes allowed for"),
    ],
)
def test_what_moves_the_largest_r_is_named(light, lag_um, says, says_not):
    text = read(with_lag(light, lag_um))
    assert says in text
    assert says_not not in text


@pytest.mark.parametrize(
    ("r", "said"), [(0.95, "longer ones, of the sheet or of its light, lower it"), (0.8, "")]
)
def test_long_waves_that_change_r_are_named(r, said):
    run = with_lag(0.05, (0.0, 0.2))
    low, high = r - 0.03, r + 0.03
    short = {"point_um": 100.0, "r": r, "interval": [low, high], "n": 200, "n_eff": 90.0}
    run["results"]["evidence"][0] |= {"short_waves": short, "short_waves_um": 350.0}
    text = read(run)
    assert said in text
    assert ("Waves below 350" in text) == bool(said)


def test_nothing_is_read_into_an_r_that_is_withheld():
    run = a_run(trust="withheld")
    assert read(run) == ""
    assert "How to read r" not in page_of(run)


def test_options_stand_in_the_operators_part_alone():
    run = a_run()
    run["results"]["checks"].append(
        {
            "name": "dust",
            "value": 30.0,
            "limit": 20.0,
            "state": "look",
            "figures": [],
            "sentence": "Dust was found.",
            "advice": "Clean it.",
            "remedy": "Give a closer `hole_um`.",
        }
    )
    text, operator = text_of(run).split("For the operator")
    option = re.compile(r"(?<![\w-])--[a-z]+")
    assert option.findall(text) == []
    assert "`" not in f"{text}{operator}"
    assert "Dust was found." in text
    assert "Clean it." in text
    assert "--title, --author, --date, --note" in operator
    assert "Dust: Clean it. Give a closer --hole-um." in operator


def test_the_page_says_who_made_it_when_and_of_what():
    run = a_run()
    assert "not given" not in page_of(run)
    assert 'class="about"' not in page_of(run)
    run["results"]["parameters"]["about"] = {"title": "Trial 7 <b>", "author": "A. Hofer"}
    html = page_of(run)
    assert "<title>Trial 7 &lt;b&gt;: " in html
    about = re.search(r'<dl class="about">.*?</dl>', html, flags=re.DOTALL)
    assert re.findall(r"<dd>(.*?)</dd>", about[0]) == ["A. Hofer", "not given", "not given"]
    assert "How to cite" in html
