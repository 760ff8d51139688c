"""The page is parsed: what it shows, what it leaves out, and that nothing in it comes from elsewhere."""

from __future__ import annotations

import base64
import io
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr
from PIL import Image

from planish.report import write_report
from planish.report.draw import field, house_style, round_below
from planish.report.page import render_report
from planish.report.registration import draw_outlines
from planish.report.relation import block_means
from planish.report.slices import take_slice
from planish.report.text import count, in_figure, in_words, length, number, percent, plain

PROPERTIES = {
    "coating_top": "Coating thickness, top side",
    "coating_bottom": "Coating thickness, bottom side",
    "base_thickness": "Base thickness",
    "thickness": "Sheet thickness",
}
COATING = ("coating_top", "coating_bottom", "base_thickness")
ROWS = ("projection, no scale", "projection, similarity", "flattened, similarity")
ALWAYS = ["inputs", "slices", "flattening", "maps"]
LINK_ONLY = ["registration", "outlines", "relation", "comparison"]
UM = {"units": "um"}
VOID = {"meta", "link", "img", "br"}

Run = dict[str, Any]


class Page(HTMLParser):
    """What a test asks of a page: sections, headings, figures, text, addresses; and that its tags are balanced."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.sections: list[str] = []
        self.images: list[dict[str, str]] = []
        self.addresses: list[str] = []
        self.metas: list[dict[str, str]] = []
        self.tags: set[str] = set()
        self.handlers: list[str] = []
        self.words: dict[str, list[str]] = {}
        self._open: list[str] = []
        self.feed(html)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {k: v or "" for k, v in attrs}
        self.tags.add(tag)
        self.handlers += [k for k in given if k.startswith("on")]
        self.addresses += [given[k] for k in ("src", "href", "action", "srcset", "data") if k in given]
        if tag == "section":
            self.sections.append(given["id"])
        if tag == "img":
            self.images.append(given)
        if tag == "meta":
            self.metas.append(given)
        if tag not in VOID:
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag, f"</{tag}> closes nothing"

    def handle_data(self, data: str) -> None:
        for tag in set(self._open):
            self.words.setdefault(tag, []).append(data)

    def text(self, tag: str = "body") -> str:
        return re.sub(r"[ \n]+", " ", "".join(self.words.get(tag, [])))


def a_run(*, linked: bool = True, coated: bool = True, top: str = "high", relation: float = 40.0) -> Run:
    """Return a small bent sheet, 90 um thick under a 20 um coating, and an image of it that follows the coating."""
    rng = np.random.default_rng(7)
    up = 1.0 if top == "high" else -1.0
    y, x = 6.0 * np.arange(90), 6.0 * np.arange(140)
    centre = 300 + 40 * np.sin(x / 200)[None, :] + 0 * y[:, None]
    coating = 20 + 4 * np.sin(y / 31)[:, None] * np.cos(x / 45)[None, :] + rng.normal(0, 0.5, (y.size, x.size))
    hole = np.hypot(y[:, None] - 260, x[None, :] - 300) < 90
    layers = {"coating_top": coating, "coating_bottom": coating[::-1], "base_thickness": 90 - coating - coating[::-1],
              "thickness": np.full(coating.shape, 90.0)}  # fmt: skip
    properties = {k: np.where(hole | (not coated and k in COATING), np.nan, layers[k]) for k in PROPERTIES}
    heights = {
        "top": centre + up * 45,
        "bottom": centre - up * 45,
        "interface_top": centre + up * (45 - properties["coating_top"]),
        "interface_bottom": centre - up * (45 - properties["coating_bottom"]),
        "centre": centre,
    }
    frame = {"through": "z", "top_side": top, "row_axis": "y", "col_axis": "x"}
    titles = {k: UM | {"long_name": v} for k, v in PROPERTIES.items()}
    surfaces = xr.Dataset({k: (("y", "x"), v, UM) for k, v in heights.items()}, {"y": y, "x": x}, frame)
    surfaces = surfaces.assign({k: (("y", "x"), v, titles[k]) for k, v in properties.items()})
    u, v = np.broadcast_to(1.02 * x, coating.shape), np.broadcast_to(y[:, None], coating.shape)
    flat = xr.Dataset(
        {"u": (("y", "x"), u), "v": (("y", "x"), v), "projected_u": (("y", "x"), np.broadcast_to(x, coating.shape)),
         "projected_v": (("y", "x"), v)}, {"y": y, "x": x}, frame | {"mirrored_view": int(top == "low")},
    )  # fmt: skip
    cells = (22, 34)
    strain = xr.Dataset(
        {k: (("row", "col"), at + 1e-4 * rng.normal(size=cells)) for k, at in
         {"area_ratio": 1.0, "stretch_max": 1.0, "stretch_min": 1.0, "shear": 0.0, "needed_strain": 0.001}.items()},
        {"y": ("row", 24.0 * np.arange(22)), "x": ("col", 24.0 * np.arange(34))},
    )  # fmt: skip
    strain["step_nodes"] = (("step",), np.array([80.0, 250.0, 805.0, 805.0]))
    strain["step_move"] = (("step",), np.array([3.0, 1.0, 0.3, 0.01]))
    maps = xr.Dataset({k: (("v", "u"), a, titles[k]) for k, a in properties.items()}, {"v": y, "u": 1.02 * x})
    at = np.array([20, 45, 70])
    z = 6.0 * np.arange(100)
    grey = np.where(np.abs(z[None, :, None] - centre[at][:, None, :]) < 45, 150.0, 30.0) + rng.normal(
        0, 4, (3, 100, 140)
    )
    slices = xr.Dataset(
        {"grey": (("slice", "height", "x"), grey.astype(np.float32)), "row": ("slice", at)},
        {"slice": y[at], "height": z, "x": x}, frame,
    )  # fmt: skip
    groups = {"surfaces": surfaces, "flat": flat, "strain": strain, "maps": maps, "slices": slices}
    statistics = {"n": 12_000, "mean_um": 20.0, "sd_um": 2.0, "p5_um": 17.0, "median_um": 20.0, "p95_um": 23.0}
    results: dict[str, Any] = {
        "planish": "0.1.0",
        "versions": {"numpy": "2.4.6"},
        "inputs": {"volume": {"name": "sheet.tif", "shape": [100, 90, 140], "dtype": "uint8", "bytes": 1_260_000,
                              "sha256": "ab" * 32, "voxel_um": [6.0, 6.0, 6.0], "voxel_um_source": "ImageJ metadata"}},
        "surfaces": frame | {"thickness_um": 90.0, "blur_um": 4.0, "cutoff_um": 400.0, "rim_um": 100.0, "polarity": 1.0,
                             "grey_air": 30.0, "grey_base": 150.0, "grey_coating_top": 200.0 if coated else None,
                             "grey_coating_bottom": None, "grey_noise": 4.0, "columns": 12_600, "share_measured": 0.9,
                             "share_no_sheet": 0.1, "share_rim": 0.0},
        "properties": {k: statistics if np.isfinite(properties[k]).any() else None for k in PROPERTIES},
        "flatten": {"outcome": "RESTED", "sentence": "The mesh came to rest.", "steps": 4, "energy_um2": 1e-7,
                    "mesh_um": 24.0, "folded_cells": 0, "edge_strain_p95": 4e-4, "edge_strain_max": 1e-3,
                    "largest_move_um": 16.8, "method": "multigrid", "springs": 3100, "straight_share": 0.001,
                    "curvature": {"patch_um": 1000.0, "limit": 0.005, "share": 0.0, "largest": 0.001,
                                  "verdict": "The surface can be a sheet of paper."},
                    "distortion": {"displacement_median_um": 4.0, "displacement_p95_um": 12.0, "growth_percent": 1.0,
                                   "growth_anisotropy_percent": 2.0, "area": {"median": 1e-5, "p95_abs": 2e-4},
                                   "geodesics": {"p50": 1e-5, "p95": 1e-4}, "cells": 748}},
        "quality": [{"name": "coverage", "value": 0.9, "limit": 0.5, "passed": True,
                     "sentence": "90 % of the columns are measured."}],
        "parameters": {"volume": {"voxel_um": [6.0, 6.0, 6.0], "through": "z", "top": top, "override_size": False},
                       "registration": {"hole_um": [100.0, 300.0]}, "correlate": {"point_um": 100.0, "thin_um": 5.0}},
    }  # fmt: skip
    if not linked:
        return {"groups": groups, "marks": None, "results": results}
    headline = "coating_top" if coated else "thickness"
    image = 1000 + relation * (coating - 20) + rng.normal(0, 40, coating.shape)
    groups["linked"] = xr.Dataset(
        {k: (("y", "x"), a.astype(np.float32), titles[k]) for k, a in properties.items()}, {"y": y, "x": x}
    ).assign(
        image=(("y", "x"), image.astype(np.float32), {"long_name": "Luminance", "units": "1"}), u=(("y", "x"), u),
        valid=(("y", "x"), ~hole),
    )  # fmt: skip
    fixed = np.array([[100.0, 100.0], [700.0, 120.0], [420.0, 480.0]])
    residual = np.array([[0.3, -0.2], [-0.4, 0.1], [0.1, 0.1]])
    marks = xr.Dataset(
        {k: ("mark", a) for k, a in {
            "moving_x": fixed[:, 0] + 5, "moving_y": fixed[:, 1], "fixed_x": fixed[:, 0], "fixed_y": fixed[:, 1],
            "residual_x": residual[:, 0], "residual_y": residual[:, 1], "residual": np.hypot(*residual.T),
            "leave_one_out": np.array([0.6, np.nan, 0.4]),
            "label": np.array(["hole 1", "hole 2", "hole 3"], dtype=object),
        }.items()}
    )  # fmt: skip
    row = {"n": 11_000, "r": 0.9, "r2": 0.81, "slope": 40.0, "intercept": 200.0}
    large = {"n": 40, "r": 0.8, "r2": 0.64, "slope": 41.0, "intercept": 180.0}
    results["inputs"]["image"] = {
        "name": "image.png", "shape": [90, 140], "dtype": "uint16", "bytes": 25_000, "sha256": "cd" * 32,
        "pixel_um": [6.0, 6.0], "pixel_um_source": "given",
    }  # fmt: skip
    results |= {
        "marks": {"source": "found", "found_volume": 3, "found_image": 4, "sentence": "3 of 3 marks agree to 0.3 um.",
                  "matched": 3, "model_sentence": "similarity chosen from 3 marks: 0.5 um.", "warnings": ["few marks"],
                  "expected_error_um": {"median": 0.71, "largest": 1.2}, "rms_um": 0.33, "leave_one_out_rms_um": 0.51,
                  "scale": 1.0059,
                  "rotation_deg": 0.0, "shift_um": [1.0, -2.0], "mirrored": False},
        "headline": headline,
        "table": [{"registration": name, "property": headline, "marks_rms_um": 9.0, **row, "r2": r2, "point_um": at_um}
                  for name, r2 in zip(ROWS, (0.11, 0.22, 0.81), strict=True) for at_um in (6.0, 100.0)],
        "correlation": [{"property": k, **pair, "point_um": at_um} for k in PROPERTIES if results["properties"][k]
                        for pair, at_um in ((row, 6.0), (large, 100.0))],
        "linked": {"pixels": 12_600, "share_on_sheet": 1.0, "share_valid": 0.8, "share_valid_of_sheet": 0.8},
    }  # fmt: skip
    return {"groups": groups, "marks": marks, "results": results}


@pytest.fixture(scope="module")
def link_page() -> str:
    return render_report(**a_run())


@pytest.fixture(scope="module")
def map_page() -> str:
    return render_report(**a_run(linked=False, coated=False))


def test_page_of_a_link_has_every_section(link_page: str) -> None:
    page = Page(link_page)
    assert page.sections == [*ALWAYS, *LINK_ONLY, "record"]
    assert [a for a in page.addresses if a.startswith("#")] == [f"#{name}" for name in page.sections]
    assert page.text("title") == "sheet.tif linked to image.png"


def test_verdict_states_the_results_and_no_more(link_page: str) -> None:
    text = Page(link_page).text()
    for expected in ("0.810", "0.640", "0.51 µm", "81\u202f%", "not a sample size", "not a cause"):
        assert expected in text
    assert "significant" not in text


def test_every_figure_is_embedded_and_states_n_and_mask(link_page: str) -> None:
    page = Page(link_page)
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", link_page, flags=re.DOTALL)
    assert len(page.images) == len(captions) == 16
    for caption in captions:
        assert re.search(r"\bn\b", caption)
        assert "mask" in caption.lower()
    for image in page.images:
        head, data = image["src"].split(",", 1)
        assert head in {"data:image/png;base64", "data:image/jpeg;base64"}
        with Image.open(io.BytesIO(base64.b64decode(data, validate=True))) as picture:
            assert picture.width <= 1404
            assert picture.width / picture.height == pytest.approx(int(image["width"]) / int(image["height"]), rel=0.01)


@pytest.mark.parametrize("name", ["link_page", "map_page"])
def test_nothing_is_fetched_and_nothing_runs(name: str, request: pytest.FixtureRequest) -> None:
    html = request.getfixturevalue(name)
    page = Page(html)
    assert {a.split(":")[0] for a in page.addresses if not a.startswith("#")} == {"data"}
    assert re.findall(r"https?:|//[a-z]|@import|url\(", re.sub(r'src="data:[^"]*"', "", html)) == []
    assert not page.tags & {"script", "iframe", "object", "embed", "form"}
    assert page.handlers == []
    policy = next(m["content"] for m in page.metas if m.get("http-equiv") == "Content-Security-Policy")
    assert policy == "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


def test_hostile_names_stay_text() -> None:
    hostile = "<script>alert('x')</script>\"><img src=x onerror=alert(1)> $\\frac$ 紙 {{ 7*7 }}"
    run = a_run()
    for data in run["results"]["inputs"].values():
        data["name"] = data["voxel_um_source"] = data["pixel_um_source"] = data["dtype"] = hostile
    run["results"]["parameters"][hostile] = {hostile: hostile}
    run["results"]["quality"][0]["sentence"] = run["results"]["marks"]["sentence"] = hostile
    run["marks"]["label"] = ("mark", np.array([hostile] * 3, dtype=object))
    for name in ("image", "coating_top"):
        run["groups"]["linked"][name].attrs |= {"long_name": hostile, "units": hostile}
    run["groups"]["maps"]["coating_top"].attrs |= {"long_name": hostile, "units": hostile}
    page = Page(render_report(**run))
    assert not page.tags & {"script"}
    assert page.handlers == []
    assert hostile in page.text("h1")
    assert hostile in page.text("table")
    assert hostile in page.text("figcaption")
    assert {a.split(":")[0] for a in page.addresses if not a.startswith("#")} == {"data"}


def test_map_only_leaves_out_what_needs_an_image_and_says_so(map_page: str) -> None:
    page = Page(map_page)
    assert page.sections == [*ALWAYS, "record"]
    assert "no image was linked" in page.text("h1")
    assert "No coating was found" in page.text()
    # A property that was measured nowhere has a line of dashes in the table, and no figure.
    assert PROPERTIES["coating_top"] in page.text("table")
    assert "Sheet thickness" in page.text("figcaption")
    assert PROPERTIES["coating_top"] not in page.text("figcaption")


def test_link_without_coating_outlines_the_thickness() -> None:
    text = Page(render_report(**a_run(coated=False))).text("figcaption")
    assert "sheet thickness below" in text


def test_same_input_gives_the_same_bytes_whatever_the_users_settings(tmp_path: Path, link_page: str) -> None:
    with mpl.rc_context({"font.size": 31.0, "axes.facecolor": "red", "image.origin": "lower"}):
        write_report(tmp_path / "report.html", **a_run())
        assert mpl.rcParams["font.size"] == 31.0
    assert (tmp_path / "report.html").read_bytes() == link_page.encode("utf-8")


def test_failed_gates_are_named() -> None:
    run = a_run(linked=False)
    run["results"]["quality"].append({"name": "marks", "value": 30.0, "limit": 20.0, "passed": False,
                                      "sentence": "4 marks agree to 30.0 um only."})  # fmt: skip
    text = Page(render_report(**run)).text()
    assert "1 of 2 quality gates is not passed" in text
    assert "not passed: 4 marks agree to 30.0\u202fµm only." in text


def test_a_sheet_with_its_top_at_the_low_end_is_drawn_top_up() -> None:
    run = a_run(linked=False, top="low")
    assert "top side lies at the low end" in Page(render_report(**run)).text()
    cut = take_slice(run["groups"]["slices"], run["groups"]["surfaces"], 0)
    assert np.all(np.diff(cut.heights) > 0)
    assert np.all(cut.lines["top"] > cut.lines["bottom"])
    # Grey values are turned with their heights: the sheet is bright where its surfaces say that it is.
    inside = (cut.heights[:, None] > cut.lines["bottom"] + 6) & (cut.heights[:, None] < cut.lines["top"] - 6)
    assert cut.grey[inside].mean() > 140


def test_numbers_that_are_missing_become_dashes() -> None:
    run = a_run()
    run["results"]["marks"]["leave_one_out_rms_um"] = None
    for row in (*run["results"]["correlation"], *run["results"]["table"]):
        row |= {"n": 2, "r": None, "r2": None, "slope": None, "intercept": None}
    run["results"]["marks"]["expected_error_um"] = None
    text = Page(render_report(**run)).text()
    assert "could not be correlated" in text
    assert not re.search(r"\b(nan|None|inf)\b", text)


def test_a_run_made_before_models_were_chosen_still_has_a_page() -> None:
    run = a_run()
    for name in ("model_sentence", "warnings", "expected_error_um"):
        del run["results"]["marks"][name]
    assert "Leave-one-out" in Page(render_report(**run)).text()


def test_points_outside_any_pixel_pair_are_not_drawn() -> None:
    linked = a_run()["groups"]["linked"]
    assert [a.size for a in block_means(linked, "coating_top", point_um=5.0)] == [0, 0]


def test_point_means_have_the_correlation_of_the_maps() -> None:
    # Without noise in between the image is a straight line over the coating, and so are the means.
    linked = a_run()["groups"]["linked"]
    linked["image"] = 3 * linked["coating_top"] + 5
    a, b = block_means(linked, "coating_top", point_um=100.0)
    assert 20 < a.size <= 40  # 540 x 840 um hold 5 x 8 points, and the hole takes some
    np.testing.assert_allclose(b, 3 * a + 5, rtol=1e-6)


@pytest.mark.parametrize(("thin_um", "expected"), [(18.0, "below 18\u202fµm,"), (1.0, "No valid pixel is below 1")])
def test_outlines_say_which_limit_they_show(thin_um: float, expected: str) -> None:
    with house_style():
        caption = draw_outlines(a_run()["groups"]["linked"], name="coating_top", thin_um=thin_um)[-1].caption
    assert expected in caption
    assert ("thinnest 5 %" in caption) == (thin_um == 1.0)
    assert "standard deviations darker" in caption


def test_large_maps_are_averaged_by_area_before_they_are_drawn() -> None:
    stripes = np.tile([0.0, 1.0], (40, 2000))
    shown = field(stripes, np.arange(40.0), np.arange(4000.0), width=10.0)
    assert shown.values.shape[1] == 1350
    assert shown.values.mean() == pytest.approx(0.5, abs=1e-3)
    assert shown.values.std() < 0.2  # picking every third pixel would leave 0.5
    assert shown.width == pytest.approx(4000.0, rel=1e-3)


@pytest.mark.parametrize(
    ("written", "expected"),
    [
        (number(0.99996), "1.00"),
        (number(56782.4), "56\u202f782"),
        (number(-12.04), "−12.0"),
        (number(3.21e-8, 2), "3.2·10⁻⁸"),
        (number(None), "–"),
        (number(float("nan")), "–"),
        (count(322987), "322\u202f987"),
        (percent(0.00042, 2), "0.042\u202f%"),
        (length(2345.0), "2.35\u202fmm"),
        (plain(500.0), "500\u202fµm"),
        (in_words("Coating thickness, top side"), "coating thickness (top side)"),
        (in_figure("紙 a"), "? a"),
    ],
)
def test_numbers_and_names_are_written_the_same_way_everywhere(written: str, expected: str) -> None:
    assert written == expected


@pytest.mark.parametrize(("value", "expected"), [(7.3, 5.0), (1.0, 1.0), (0.0499, 0.02), (250.0, 200.0)])
def test_scale_bars_have_round_lengths(value: float, expected: float) -> None:
    assert round_below(value) == pytest.approx(expected)
