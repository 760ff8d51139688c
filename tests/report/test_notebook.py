"""What a notebook shows of runs: key numbers, failed checks, small maps; names stay text."""

from planish.report import map_html, results_html, run_html
from report.pages import HOSTILE, Page
from report.runs import a_run, results_of


def test_a_link_shows_its_numbers_and_both_maps():
    run = a_run()
    html = run_html(results_of(run), run["groups"])
    page = Page(html)
    for expected in (
        "sheet.tif · image.png",
        "r² 0.81",
        "r² 0.64 (0.40 to 0.81)",
        "0.51",
        "The check passed.",
        "volume: Coating thickness, top side / µm",
        "image: Grey value, uncalibrated, luminance",
    ):
        assert expected in page.text("div")
    assert len(page.addresses) == 2
    assert all(address.startswith("data:image/png;base64,") for address in page.addresses)
    assert len(html) < 200_000


def test_a_map_shows_the_sheet_in_its_proportions():
    run = a_run(linked=False)
    page = Page(run_html(results_of(run), run["groups"]))
    assert "mean sheet thickness" in page.text("th")
    assert page.text("figcaption").startswith("Coating thickness, top side / µm, colours from")
    assert page.text("figcaption").endswith("0.857 × 0.54 mm")
    data = a_run()["groups"]["linked"]["thickness"]
    page = Page(map_html(data, title="sheet"))
    # 140 x 90 pixels are drawn 300 pixels wide.
    assert 'width="300" height="193"' in map_html(data)
    assert page.text("figcaption").startswith("sheet: Sheet thickness / µm")


def test_failed_checks_are_named_and_names_stay_text():
    run = a_run()
    run["results"]["checks"][0] |= {"state": "fail", "sentence": HOSTILE}
    run["groups"]["linked"]["coating_top"].attrs["long_name"] = HOSTILE
    run["results"]["layers"][0]["source"]["name"] = HOSTILE
    results = results_of(run)
    page = Page(run_html(results, run["groups"]) + results_html(results))
    assert "script" not in page.tags
    assert page.text("li").count(HOSTILE) == 2
    assert HOSTILE in page.text("figcaption")
