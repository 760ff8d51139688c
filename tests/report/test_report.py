"""The page is parsed: what it shows, what it leaves out, and that nothing in it comes from
elsewhere."""

import base64
import io
import re
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr
from PIL import Image

from planish.core.numbers import count, fixed, in_words, length, number, percent, plain, to_spread
from planish.report import (
    Canvas,
    Scale,
    colours,
    draw,
    image_uri,
    limits,
    maps,
    relation,
    take_slice,
)
from planish.report.text import Basis
from report.pages import HOSTILE, Page, assert_alone, captions_of
from report.runs import PROPERTIES, a_run, page_of, text_of

OF_A_LINK = [
    "relation",
    "linked",
    "maps",
    "registration",
    "slices",
    "flattening",
    "comparison",
    "inputs",
    "checks",
    "record",
    "solver",
]
OF_A_MAP = ["maps", "slices", "flattening", "inputs", "checks", "record", "solver"]


def test_sections_stand_in_the_order_in_which_a_reader_asks(link_page, bare_page):
    assert Page(bare_page).sections == OF_A_MAP
    page = Page(link_page)
    assert page.sections == OF_A_LINK
    sections = [f"#{name}" for name in page.sections]
    assert [a for a in page.addresses if a.startswith("#")] == ["#checks", *sections, "#cite"]
    assert page.text("title") == "sheet.tif linked to image.png"


def test_the_page_names_the_source_that_made_it():
    run = a_run(linked=False)
    run["results"] |= {"code": "c0de" * 4, "versions": {"numpy": "2.4.6", "planish-lab": "0.1"}}
    assert f"Sources{'c0de' * 4}" in text_of(run)
    run["results"]["commit"] = "5eed+"
    text = text_of(run)
    assert "Commit5eed+" in text
    assert "planish-lab0.1" in text


def test_evenness_and_uncovered_area_stand_among_the_properties():
    run = a_run(linked=False)
    facts = run["results"]["layers"][0]["sheet"]
    thin = {
        "thinner_than_um": [0.0, 2.0],
        "share": [0.0312, 0.05],
        "standard_error": [0.0041, 0.01],
        "support_um": 3.0,
        "warning": None,
    }
    facts["numbers"]["thin"] = {"top": thin}
    coating = facts["properties"]["coating_top"] | {"coefficient_of_variation": 0.1234}
    facts["properties"] = facts["properties"] | {
        "coating_top": coating | {"standard_error": 0.5, "support_um": 3.0}
    }
    text = text_of(run)
    assert "20.02.0012.317.020.023.00.5003.00" in text
    assert "Uncovered area ratio, top side / %12\u202f0003.12–––––0.4103.00" in text
    facts["properties"]["coating_top"] |= {"trust": "withheld"}
    assert "Uncovered area ratio, top side" not in text_of(run)


def test_a_doubt_of_a_map_stands_at_all_numbers_that_are_made_of_it():
    run = a_run(linked=False)
    facts = run["results"]["layers"][0]["sheet"]
    thin = {"thinner_than_um": [0.0], "share": [0.03], "support_um": 3.0, "warning": None}
    rough = dict.fromkeys(("sa", "sq", "ssk", "sku", "sz", "sdq"), 1.0)
    rough |= {"s_filter_um": 5.0, "l_filter_um": 800.0}
    facts["numbers"] = {
        "thin": {"top": thin, "bottom": thin},
        "roughness": {"top": rough, "bottom": rough},
        "two_sides": {
            f"{name}_{number}": 0.5
            for name in ("coating", "topography")
            for number in ("sd_ratio", "correlation")
        },
        "profiles": {"depth": [0.5], "values": {"porosity": [0.4]}},
    }
    rows = {
        "coating_top": ("Thin coating, top side", "Coatings of the two sides"),
        "roughness_top": ("Roughness, top side",),
        "topography_top": ("Roughness, top side", "Topographies of the two sides"),
        "porosity": ("Profile of porosity, bottom to top",),
    }
    names = {name for names in rows.values() for name in names}
    names |= {"Thin coating, bottom side", "Roughness, bottom side"}
    for figure, doubted in rows.items():
        look = {"name": "x", "state": "look", "sentence": "X.", "figures": [figure]}
        text = text_of(run | {"results": run["results"] | {"checks": [look]}})
        assert {name for name in names if f"{name} (doubtful)" in text} == set(doubted)
        assert all(name in text for name in names)


def test_verdict_states_the_results_and_no_more(link_page):
    text = Page(link_page).text()
    for expected in (
        "95 %: 0.63 to 0.90; r² 0.64 (0.40 to 0.81); 31 independent points of 40",
        "r² 0.81",
        "0.51\u202fµm",
        "not on n",
        "81\u202f% are valid in all maps",
        "does not imply causation",
        (
            "image is lighter (grey value, uncalibrated, luminance) where coating thickness (top"
            " side) is larger: r = 0.80 with a"
        ),
    ):
        assert expected in text
    assert "significant" not in text


@pytest.mark.parametrize(
    ("interval", "says"),
    [
        (
            [-0.1, 0.4],
            "It is not certain that the image is related to coating thickness (top side)",
        ),
        (None, "No statement on coating thickness (top side)"),
    ],
)
def test_no_direction_is_named_that_is_not_certain(interval, says):
    text = text_of(a_run(interval=interval))
    assert says in text
    assert "lighter where" not in text
    assert "darker where" not in text


def test_ways_of_linking_are_counted():
    run = a_run()
    rows = run["results"]["comparison"]
    ways = len({row["registration"] for row in rows})
    assert f"linked in {ways} ways" in text_of(run)
    rows += [row | {"registration": "one more way"} for row in rows[:2]]
    assert f"linked in {ways + 1} ways" in text_of(run)


def test_every_figure_is_embedded_and_states_n_and_mask(link_page):
    page = Page(link_page)
    captions = captions_of(link_page)
    assert page.drawings == len(captions) == 21
    for caption in captions:
        assert re.search(r"\bn\b", caption)
        assert "mask" in caption.lower()
    assert len(page.images) > 18
    for image in page.images:
        head, data = image["href"].split(",", 1)
        assert head in {"data:image/png;base64", "data:image/jpeg;base64"}
        with Image.open(io.BytesIO(base64.b64decode(data, validate=True))) as picture:
            assert picture.width <= 1404
    # Nothing is drawn at a place that is not known.
    assert not re.search(r"[\"( ,]nan", re.sub(r'href="data:[^"]*"', "", link_page))


def test_nothing_is_fetched_and_nothing_runs(link_page):
    page = Page(link_page)
    assert_alone(page)
    assert (
        re.findall(r"https?:|//[a-z]|@import|url\(", re.sub(r'href="data:[^"]*"', "", link_page))
        == []
    )
    policy = next(
        m["content"] for m in page.metas if m.get("http-equiv") == "Content-Security-Policy"
    )
    assert policy == "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


def test_what_others_write_stays_text():
    run, registered = a_run(), "<b>registered</b>"
    for layer in run["results"]["layers"]:
        layer["source"] |= {
            "name": f"{layer['name']} {HOSTILE}",
            "size_source": HOSTILE,
            "dtype": HOSTILE,
        }
    run["results"]["parameters"][HOSTILE] = {HOSTILE: HOSTILE}
    run["results"]["checks"][0]["sentence"] = HOSTILE
    facts = run["results"]["layers"][0]["registration"]
    facts |= dict.fromkeys(("match_sentence", "design", "model_sentence"), registered) | {
        "warnings": [registered]
    }
    facts["lag"]["sentence"] = facts["orientation"]["sentence"] = registered
    run["marks"]["volume"]["label"] = ("mark", np.array([HOSTILE] * 3, dtype=object))
    for group, name in (("linked", "image"), ("linked", "coating_top"), ("maps", "coating_top")):
        run["groups"][group][name].attrs |= {"long_name": HOSTILE, "units": HOSTILE}
    page = Page(page_of(run))
    assert_alone(page)
    for tag in ("h1", "table", "figcaption", "svg"):
        assert HOSTILE in page.text(tag)
    assert page.text().count(registered) >= 6


def test_a_map_alone_and_a_link_without_coating_leave_out_what_they_lack(
    bare_page,
):
    page = Page(bare_page)
    assert "no image was linked" in page.text("h1")
    assert "No coating was found" in page.text()
    # A property that was measured nowhere has neither a line in the table nor a figure.
    assert PROPERTIES["coating_top"] not in page.text("table")
    assert "Sheet thickness" in page.text("figcaption")
    assert PROPERTIES["coating_top"] not in page.text("figcaption")
    text = Page(page_of(a_run(coated=False))).text("figcaption")
    assert "sheet thickness below" in text


@pytest.mark.ci
def test_the_page_needs_no_plotting_library():
    code = "import sys, planish.report.page; print('matplotlib' in sys.modules)"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "False"


def test_checks_are_named_the_worst_first_with_limits_and_advice():
    run = a_run(linked=False)
    for name, state in (("dust", "unknown"), ("marks", "look"), ("slices", "fail")):
        run["results"]["checks"].append(
            {
                "name": name,
                "value": 30.0,
                "limit": 20.0,
                "units": "um",
                "state": state,
                "advice": "Mend it.",
                "sentence": "4 marks agree to 30.0 um.",
                "figures": ["coating_top"],
            }
        )
    html = page_of(run)
    text = Page(html).text()
    assert "Of 4 checks, 1 failed, and what it concerns is withheld; 1 asks for a look" in text
    assert '<div class="verdict fail"' in html
    said = "30.0\u202fµm. Limit 20\u202fµm. Mend it."
    assert f"Slices (fail): 4 marks agree to {said} Withheld: coating top." in text
    assert text.index("Slices (fail)") < text.index("Marks (look)") < text.index("Coverage (pass)")


def test_a_sheet_with_its_top_at_the_low_end_is_drawn_top_up():
    run = a_run(linked=False, top="low")
    assert "top side lies at the low end" in text_of(run)
    cut = take_slice(run["groups"]["slices"], run["groups"]["surfaces"], 0)
    assert np.all(np.diff(cut.heights) < 0)
    assert np.all(cut.lines["top"] > cut.lines["bottom"])
    # Grey values are turned with their heights: the sheet is bright where its surfaces say that it
    # is.
    inside = (cut.heights[:, None] > cut.lines["bottom"] + 6) & (
        cut.heights[:, None] < cut.lines["top"] - 6
    )
    assert cut.grey[inside].mean() > 140


def test_joined_sections_and_bridged_gaps_are_described():
    run = a_run(linked=False)
    sections = {
        "kind": "photographs",
        "count": 1250,
        "not_aligned": 2,
        "missing": 5,
        "cutoff_um": 150.0,
        "fixed": [],
        "pairs_used": 9,
        "pairs_refused": 1,
        "gain_sd": 0.1,
        "shift_row_rms_um": 1.52,
        "shift_col_rms_um": 1.61,
        "jitter_left_row_um": 0.31,
        "jitter_left_col_um": 0.42,
    }
    sheet = run["results"]["layers"][0]["sheet"]
    sheet["sections"] = sections
    sheet["surfaces"]["bridged_share"] = 0.02
    text = text_of(run)
    assert (
        "1\u202f250 sections were aligned to their neighbours; shifts of 1.5\u202fµm and"
        " 1.6\u202fµm rms" in text
    )
    assert "5 missing sections were bridged, 2 of them because they match no neighbour." in text
    assert (
        "more slowly than over 150\u202fµm cannot be distinguished from the sheet's own bend"
        in text
    )
    assert "in 2.0\u202f% of the columns, were bridged" in text
    sections["fixed"] = ["tilt"]
    assert "Slow drift was removed (tilt)" in text_of(run)


def test_links_without_numbers_checks_or_expected_error_have_a_page():
    run = a_run()
    run["results"]["layers"][0]["registration"] |= {
        "leave_one_out_rms_um": None,
        "expected_error": None,
    }
    for row in (*run["results"]["correlations"], *run["results"]["comparison"]):
        row |= {"n": 2, "r": None, "r2": None, "slope": None, "intercept": None}
    text = text_of(run)
    assert "could not be correlated" in text
    assert not re.search(r"\b(nan|None|inf)\b", text)
    run["results"]["layers"][0]["registration"] |= {"lag": None, "expected_error": None}
    run["groups"]["linked"] = run["groups"]["linked"].drop_vars("expected_error")
    page = Page(page_of(run))
    assert "Leave-one-out" in page.text()
    for absent in ("Expected error of the position", "tile by tile"):
        assert absent not in page.text()
    assert page.drawings == 19


def coating_and_image(linked):
    return [linked[name].where(linked["valid"]) for name in ("coating_top", "image")]


def test_point_means_have_the_correlation_of_the_maps_and_need_two_pixels():
    # Without noise in between the image is a straight line over the coating, and so are the means.
    linked = a_run()["groups"]["linked"]
    linked["image"] = 3 * linked["coating_top"] + 5
    a, b = relation.block_means(*coating_and_image(linked), point_um=100.0)
    assert 20 < a.size <= 40  # 540 x 840 um hold 5 x 8 points, and the hole takes some
    np.testing.assert_allclose(b, 3 * a + 5, rtol=1e-6)
    assert [a.size for a in relation.block_means(*coating_and_image(linked), point_um=5.0)] == [
        0,
        0,
    ]


@pytest.mark.parametrize(
    ("thin_um", "expected"), [(18.0, "below 18\u202fµm,"), (1.0, "No valid pixel is below 1")]
)
def test_outlines_say_which_limit_they_show(thin_um, expected):
    linked = a_run()["groups"]["linked"]
    *_, outlined = maps.draw_outlines(linked, name="coating_top", thin_um=thin_um, basis=Basis())
    caption = outlined.caption
    assert expected in caption
    assert ("thinnest 5 %" in caption) == (thin_um == 1.0)
    assert "standard deviations darker" in caption


def test_large_maps_are_averaged_by_area_and_coloured_by_their_values():
    stripes = np.tile([0.0, 1.0], (40, 2000))
    axes = [("y", np.arange(40.0)), ("x", np.arange(4000.0))]
    shown = draw.reduced(xr.DataArray(stripes, axes), width=1000.0)
    assert (shown.values.shape[1], shown.values.mean()) == (1350, pytest.approx(0.5, abs=1e-3))
    assert shown.values.std() < 0.2  # picking every third pixel would leave 0.5
    assert shown.width == pytest.approx(4000.0, rel=1e-3)
    values = np.array([[-5.0, 0.0, 1.0, np.nan]])
    with Image.open(
        io.BytesIO(base64.b64decode(image_uri(values, Scale(0.0, 1.0)).split(",")[1]))
    ) as image:
        found = np.asarray(image.convert("RGB"))[0]
    assert [bytes(c).hex() for c in found] == ["440154", "440154", "fde725", colours.MISSING[1:]]
    assert limits(np.array([3.0, 3.0]), colours.GREYS) == Scale(2.5, 3.5, colours.GREYS)
    assert limits(np.array([np.nan]), colours.GREYS) == Scale(0.0, 1.0, colours.GREYS)
    assert limits(np.array([-1.0, 3.0]), symmetric=True, percent=0.0) == Scale(-3.0, 3.0)


@pytest.mark.parametrize(
    ("written", "expected"),
    [
        (number(0.99996), "1.00"),
        (number(-56782.4), "−56\u202f782"),
        (fixed(-0.0004, 2), "0.00"),
        (to_spread(2.49817, 0.0722), "2.498"),
        (to_spread(-12.3, 45.0), "−12"),
        (number(3.21e-8, 2), "3.2·10⁻⁸"),
        (number(None), "–"),
        (number(float("nan")), "–"),
        (count(322987), "322\u202f987"),
        (percent(0.00042, 2), "0.042\u202f%"),
        (length(2345.0), "2.35\u202fmm"),
        (plain(500.0), "500\u202fµm"),
        (in_words("Coating thickness, top side"), "coating thickness (top side)"),
    ],
)
def test_numbers_and_names_are_written_the_same_way_everywhere(written, expected):
    assert written == expected


def test_scale_bars_and_ticks_are_round_and_few():
    for value, expected in ((7.3, 5.0), (1.0, 1.0), (0.0499, 0.02), (250.0, 200.0)):
        assert draw.round_step(value) == pytest.approx(expected)
    for low, high, ticks in (
        (0.0, 1.0, [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]),
        (-3.2, 7.1, [-2.0, 0.0, 2.0, 4.0, 6.0]),
    ):
        step = draw.round_step((high - low) / 6, above=True)
        np.testing.assert_allclose(draw.multiples(low, high, step), ticks, atol=1e-12)


def test_drawings_place_what_they_show():
    canvas = Canvas(200, 100)
    axes = canvas.axes(10, 20, 100, 50, (0.0, 10.0, 5.0, 0.0))
    axes.line((0.0, 10.0, np.nan, 2.0, 2.0), (0.0, 5.0, 0.0, 2.0, 3.0), colour="red")
    inside = np.array([[False, True], [False, False]])
    region = xr.DataArray(inside, [("y", [1.25, 3.75]), ("x", [2.5, 7.5])])
    axes.outline(region, colour="blue", width=1)
    svg = canvas.picture(title="a & b", caption="").svg
    assert 'd="M0 0l100 50M20 20l0 10"' in svg
    # The upper right pixel of four: 50 to 100 across and 0 to 25 down.
    assert 'd="M50 0L100 0M50 25L100 25M50 0L50 25M100 0L100 25"' in svg
    assert '<svg x="10" y="20" width="100" height="50">' in svg
    assert 'aria-label="a &amp; b"' in svg


def test_long_numbers_at_the_ends_of_axes_stay_within_the_figure():
    canvas = Canvas(333.0, 300.0)
    shown = draw.ShownMap(np.arange(4.0).reshape(2, 2), (0.0, 100_000.0, 100_000.0, 0.0))
    canvas.map_axes(44.0, 8.0, (277.0, 250.0), shown, Scale(0.0, 100_000.0, colours.PROPERTY))
    canvas.colour_bar(44.0, 270.0, 277.0, 10.0, Scale(0.0, 100_000.0, colours.PROPERTY))
    pattern = (
        r'<text x="([\d.]+)" y="[\d.]+" font-size="([\d.]+)"[^>]*?(?:text-anchor="(\w+)")?>([^<]*)<'
    )
    numbers = re.findall(pattern, canvas.svg())
    assert [text for *_, text in numbers].count("100\u202f000") == 3
    for x, size, anchor, text in numbers:
        width = 0.56 * float(size) * len(text)  # of the digits of the page's font
        left = float(x) - {"middle": width / 2, "end": width, "": 0.0}[anchor]
        assert left > -1.0, text
        assert left + width < 334.0, text
