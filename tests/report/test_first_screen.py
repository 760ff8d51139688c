"""The first page: what leads and what does not, and that the whole page can be read on any
screen."""

import re

import numpy as np
import pytest

from planish.report import first_screen
from planish.report.maps import draw_maps
from planish.results import PropertyFacts
from report.pages import Page, captions_of
from report.runs import IMAGE_PAIR, a_run, page_of, results_of
from report.test_layers import layers


def first_of(html):
    """Return what stands before the list of sections."""
    return html[html.index("<header>") : html.index("<nav")] + "</header>"


@pytest.fixture(scope="module")
def layers_page():
    return page_of(layers())


def test_first_page_of_a_link_shows_the_result_and_nothing_else(link_page):
    html = first_of(link_page)
    page = Page(html)
    assert (
        "The image is lighter (grey value, uncalibrated, luminance) where coating thickness (top"
        " side) is larger: r = 0.80" in page.text("p")
    )
    assert len(re.findall(r'<dd class="value">', html)) == 3
    titles = re.findall(r"<b>Figure \d\. (.*?)\.</b>", html)
    assert titles == [
        "Coating thickness, top side",
        "Grey value, uncalibrated, luminance",
        "Points of 100\u202fµm",
    ]
    assert "What would make it more certain" in page.text("h2")
    assert "The check passed." in page.text("p")
    assert "90 % of the columns" not in page.text("header")
    assert link_page.count('id="counted"') == 1
    lines = re.findall(
        r'<path d="M[^"]*" fill="none" stroke="#b3402a"[^>]*>', html.split("<figure")[3]
    )
    assert ["stroke-dasharray" in line for line in lines] == [False, True]
    # All but the scatters, the slices, and the convergence are maps.
    maps = [f for f in link_page.split("<figure")[1:] if re.search(r"(x, y|u, v) / µm", f)]
    assert len(maps) == link_page.count("<figure") - 5


def test_both_maps_have_one_grid_and_one_mask():
    run = a_run()
    linked = run["groups"]["linked"]
    linked["image"][:30] = np.nan  # known in one of the two only: neither shows it
    html = first_of(page_of(run))
    counted = re.findall(r"</b> n = ([\d\u202f]+) pixels", html)
    both = linked["valid"] & np.isfinite(linked["image"]) & np.isfinite(linked["coating_top"])
    assert [int(n.replace("\u202f", "")) for n in counted] == [int(both.sum())] * 2
    drawn = html.split("<figure")[1:3]
    frames = [
        re.search(r'<svg x="44" y="8" (width="[\d.]+" height="[\d.]+")', svg) for svg in drawn
    ]
    assert frames[0].group(1) == frames[1].group(1)


@pytest.mark.parametrize(("state", "linked"), [("fail", False), ("look", True), ("unknown", False)])
def test_only_lights_that_are_not_green_stand_on_the_first_page(state, linked):
    run = a_run(linked=linked)
    run["results"]["checks"].append(
        {
            "name": "dust",
            "value": 30.0,
            "limit": 20.0,
            "state": state,
            "advice": "Clean the sheet.",
            "sentence": "Dust was found.",
            "figures": ["coating_top"],
        }
    )
    html = page_of(run)
    head, rest = Page(first_of(html)).text("header"), Page(html).text()
    assert f"Dust ({state}): Dust was found." in head
    assert "Coverage (pass)" not in head
    assert "Coverage (pass)" in rest
    # What to do is said once: as what would make it more certain, or beside the light.
    assert head.count("Clean the sheet.") == 1


def test_a_map_has_a_first_page_of_its_own_and_one_mean_of_a_property(map_page):
    html = first_of(map_page)
    assert re.findall(r"<b>Figure (\d)\. (.*?)\.</b>", html) == [
        ("1", "Coating thickness, top side")
    ]
    assert len(re.findall(r'<dd class="value">', html)) == 4
    assert "A second field" in Page(html).text("li")
    assert map_page.count('id="counted"') == 1
    # The results say 20 ± 2; the pixels of the map themselves spread by 2.1 about that.
    stated = [c for c in captions_of(map_page) if "standard deviation of" in c]
    assert len(stated) == 5
    for caption in stated:
        assert "20.0 ± 2.00 µm (mean ± standard deviation of n = 12\u202f000 columns)" in caption


def test_first_page_of_several_layers_shows_the_weakest_pair(layers_page):
    html = first_of(layers_page)
    rows = [row for row in layers()["results"]["correlations"] if row["point_um"] == 60.0]
    weakest = min(rows, key=lambda row: row["r2"])
    tile = f"{weakest['a']} and {weakest['b']}:"
    assert tile in Page(html).text("dd")
    titles = re.findall(r"<b>Figure \d\. (.*?)\.</b>", html)
    assert [title.rpartition(", ")[2] for title in titles[:2]] == [weakest["a"], weakest["b"]]


def test_what_is_withheld_is_not_drawn_as_a_relation():
    html = first_of(page_of(a_run(trust="withheld")))
    assert "Points of" not in "".join(re.findall(r"<b>Figure.*?</b>", html))
    assert html.count("<figure") == 2


def evidence(**values):
    return [IMAGE_PAIR | {"declared": True} | values]


@pytest.mark.parametrize(
    ("interval", "given", "says", "says_not"),
    [
        (
            [0.63, 0.9],
            {},
            "four times the area would about halve the interval of r (now 0.63 to 0.90)",
            "More marks",
        ),
        ([0.78, 0.82], {}, "A second specimen", "four times"),
        (None, {}, "too few independent points for an interval", "four times"),
        (
            [0.78, 0.82],
            {"attenuation_limit": 0.9},
            "a perfect relation would show r = 0.90 and no more. What light that spreads in the"
            " paper, the blur of the lens and shading take is not in it.",
            "A second specimen",
        ),
        ([0.78, 0.82], {"attenuation_limit": 0.97}, "A second specimen", "More marks"),
        ([0.78, 0.82], {"declared": False}, "Declare the map that leads", "A second specimen"),
    ],
)
def test_what_would_make_it_surer_follows_from_the_results(interval, given, says, says_not):
    run = a_run(interval=interval)
    run["results"]["evidence"] = evidence(**given)
    found = [text for text, _ in first_screen.recommendations(results_of(run))]
    assert 1 <= len(found) <= 2
    assert says in " ".join(found)
    assert says_not not in " ".join(found)


def test_more_tiles_of_a_texture_are_not_to_be_had_but_holes_are():
    run = a_run(interval=[0.78, 0.82])
    run["results"]["layers"][0]["registration"]["source"] = "texture"
    run["results"]["evidence"] = evidence(attenuation_limit=0.9)
    (advice, _), *_ = first_screen.recommendations(results_of(run))
    assert advice.startswith("Laser holes as marks, spread over the field")


@pytest.mark.parametrize("name", ["link_page", "map_page", "layers_page"])
def test_boxes_that_scroll_are_reached_with_the_keyboard_and_drawings_have_names(name, request):
    page = Page(request.getfixturevalue(name))
    assert page.boxes
    for box in page.boxes:
        assert (box["tabindex"], box["role"]) == ("0", "region")
        assert box["aria-label"].strip()
    assert page.loose == []
    assert page.svgs
    for svg in page.svgs:
        assert svg["role"] == "img"
        assert svg["aria-label"].strip()


def colours_written(svg):
    """Return the numbers beside the colour bar of a map on half a page."""
    texts = re.findall(
        r'<text x="([\d.]+)" y="[\d.]+" font-size="11" fill="[^"]*">([^<]*)</text>', svg
    )
    return [text for x, text in texts if float(x) > 300]


def test_both_coatings_of_a_sheet_share_their_colours():
    run = a_run(linked=False)
    maps = run["groups"]["maps"].copy(deep=True)
    maps["coating_bottom"] += 30.0
    facts = PropertyFacts(units="um", n=9, mean=20.0, sd=2.0, p5=17.0, median=20.0, p95=23.0)
    drawn = draw_maps(
        maps, dict.fromkeys(maps.data_vars, facts), headline="thickness", rim_um=100.0
    )
    numbers = {p.title: colours_written(p.svg) for p in drawn if "oating" in p.title}
    top, bottom = numbers.values()
    assert top == bottom
    assert float(bottom[0]) < 25
    assert float(bottom[-1]) > 45
