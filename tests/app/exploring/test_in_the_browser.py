"""The page of ``planish explore`` in a browser, opened from a file: with mouse and keys, narrow,
without a script."""

import os
import re

import numpy as np
import pytest

from app.exploring.made import Explored, put
from app.marks_page import Browsed, drag
from planish.app import explore
from report.runs import a_run

TWO_FRAMES = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
"""The page draws with the next frame; after the one that follows it has been drawn."""


class Window(Browsed):
    """A page in the browser, opened from a file."""

    def __init__(self, page, path):
        super().__init__(page)
        self.path = path
        page.on("dialog", lambda dialog: self.faults.append(f"dialog: {dialog.message}"))

    def view(self, name):
        return self.page.get_by_role("application", name=name, exact=True)

    def status(self, name):
        """A status line after the next frame."""
        self.drawn()
        return self.page.get_by_role("status", name=name, exact=True).inner_text().replace("−", "-")

    def drawn(self):
        """Wait until the page has drawn what was asked of it, however busy the machine is."""
        self.page.evaluate(TWO_FRAMES)

    def at(self, name, x_um, y_um, grid):
        """Where a point of the whole map lies on the screen."""
        self.view(name).scroll_into_view_if_needed()
        box = self.view(name).locator("canvas").bounding_box()
        wide, high = grid["cols"] * grid["dx"], grid["rows"] * grid["dy"]
        scale = max(wide / box["width"], high / box["height"])
        middle = grid["x0"] + (wide - grid["dx"]) / 2, grid["y0"] + (high - grid["dy"]) / 2
        return (
            box["x"] + box["width"] / 2 + (x_um - middle[0]) / scale,
            box["y"] + box["height"] / 2 + (y_um - middle[1]) / scale,
        )


@pytest.fixture
def opened(chromium):
    """Return a function that opens a page; what it asked for and the faults of its console fail the
    test at the end."""
    windows = []

    def begin(path, *, width=1280, height=800, before="", **options):
        context = chromium.new_context(viewport={"width": width, "height": height}, **options)
        page = context.new_page()
        window = Window(page, path)
        if before:
            page.add_init_script(before)
        page.goto(path.as_uri())
        if options.get("java_script_enabled", True) and not before:
            page.wait_for_selector("html[data-ready]", timeout=30_000)
        windows.append(window)
        return window

    yield begin
    for window in windows:
        window.page.context.close()
    assert [fault for window in windows for fault in window.faults] == []
    others = [
        one
        for window in windows
        for one in window.asked
        if not one.startswith(("data:", window.path.as_uri()))
    ]
    assert others == []


@pytest.fixture(scope="module")
def path(linked_run, tmp_path_factory):
    place = tmp_path_factory.mktemp("page") / "page.html"
    explore(linked_run, place)
    return place


def numbers(text):
    return [float(v) for v in re.findall(r"-?\d+(?:\.\d+)?", text)]


def a_pixel(linked):
    """Where a pixel lies that counts, away from the middle: x and y in um."""
    rows, cols = np.nonzero(linked["valid"].values)
    k = rows.size // 5
    return float(linked["x"].values[cols[k]]), float(linked["y"].values[rows[k]])


# --- what it shows --------------------------------------------------------------------------------
def test_cursor_and_slice_have_the_values_under_the_mouse_and_colours_are_chosen(
    opened, path, linked
):
    data, window, at = Explored(path), opened(path), a_pixel(linked)
    window.page.mouse.move(*window.at("Left map", *at, data.data["grid"]))
    told = window.status("Cursor")
    x, y = numbers(told)[:2]
    # A pixel of the screen is larger than one of the map at most; the cursor says which one it is
    # on.
    assert max(abs(x - at[0]), abs(y - at[1])) <= 5.0
    here = linked.sel(x=x, y=y)
    place = [float(here[f"volume_{axis}"]) for axis in "xyz"]
    for one in data.data["maps"][:2]:
        name = next(
            k for k, v in linked.data_vars.items() if v.attrs.get("long_name") == one["title"]
        )
        found = float(re.search(rf"{re.escape(one['title'])} (-?[\d.]+)", told)[1])
        assert abs(found - float(here[name])) <= one["error"] + 0.5 * 10.0 ** -one["digits"] + 1e-6
    np.testing.assert_allclose(numbers(told.split("volume")[1]), place, atol=0.06)
    rows = window.page.locator("#values tr").all_inner_texts()
    assert len(rows) == len(data.data["maps"])
    assert all(re.search(r"[\d–]", one) for one in rows)

    # A click holds the cursor; the slice is the nearest one and says how far it is.
    window.page.mouse.click(*window.at("Left map", *at, data.data["grid"]))
    assert "(held)" in window.status("Cursor")
    told = window.status("Slice position")
    np.testing.assert_allclose(numbers(told)[:3], place, atol=0.06)
    [stack] = data.data["stacks"]
    k = int(np.argmin(np.abs(np.array(stack["at"]) - place["xyz".index(stack["rows"])])))
    assert f"at {stack['rows']} = {stack['at'][k]:.1f} µm" in told
    # The centre surface in the slice is where the map says that it is.
    centre = stack["sign"] * data.unpack(stack["lines"]["centre"])[k]
    column = round((place["xyz".index(stack["cols"])] - stack["points"][0]) / stack["points"][1])
    assert abs(centre[column] - place["xyz".index(stack["through"])]) < 3.0
    assert (
        np.nanmedian(
            data.unpack(stack["lines"]["top"])[k] - data.unpack(stack["lines"]["bottom"])[k]
        )
        > 0
    )
    drawn_face_lies_on_the_edge_of_the_sheet(window)
    # A click into the slice brings the cursor there.
    canvas = window.page.locator("#slice-whole")
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    wanted = stack["start"] + 0.3 * stack["size"][0]
    window.page.mouse.click(box["x"] + 0.3 * box["width"], box["y"] + 0.5 * box["height"])
    found = dict(zip("xyz", numbers(window.status("Slice position"))[:3], strict=True))
    assert np.isfinite(centre[round((wanted - stack["points"][0]) / stack["points"][1])])
    assert abs(found[stack["cols"]] - wanted) < 8.0
    assert abs(found[stack["rows"]] - stack["at"][k]) < 8.0

    window.field("Left layer").select_option(label="Sheet thickness")
    assert "Sheet thickness" in window.status("Cursor")
    window.page.locator("#left-range").fill("80, 95")
    window.page.locator("#left-range").press("Enter")
    low = window.page.get_by_role("slider", name="Left colour range, low", exact=True)
    window.drawn()
    assert low.get_attribute("aria-valuenow") == "80"
    low.press("ArrowRight")
    window.drawn()
    assert float(low.get_attribute("aria-valuenow")) > 80.0
    window.page.get_by_role("button", name="Left colour range: auto", exact=True).click()
    window.drawn()
    assert low.get_attribute("aria-valuenow") != "80"
    window.page.locator("#left-range").fill("95, 80")
    window.page.locator("#left-range").press("Enter")
    assert "smaller" in window.page.get_by_role("alert").inner_text()


GREY_BELOW_THE_FACE = """() => {
  const canvas = document.getElementById("slice-near"), pen = canvas.getContext("2d");
  const { width, height } = canvas, all = pen.getImageData(0, 0, width, height).data, out = [];
  for (let x = 4; x < width; x += 7) {
    let face = -1;
    const bright = (y) => all[4 * (y * width + x) + 2];
    for (let y = 0; y < height; y++) {
      const [r, g, b] = [0, 1, 2].map((c) => all[4 * (y * width + x) + c]);
      if (face < 0 && r > 225 && g > 150 && g < 200 && b < 60) face = y;
    }
    if (face >= 3 && face <= height - 12) out.push(bright(face + 9) - bright(face - 3));
  }
  return out;
}"""
"""In the magnified picture, column by column: by how much it is lighter below the drawn top face
than above."""


def drawn_face_lies_on_the_edge_of_the_sheet(window):
    window.view("Slice").scroll_into_view_if_needed()
    window.drawn()
    steps = window.page.evaluate(GREY_BELOW_THE_FACE)
    assert len(steps) > 20
    # Above the line there is air, below it the coating.
    assert np.median(steps) > 60


# --- selections -----------------------------------------------------------------------------------
def chosen(data, linked, *, region=None, brush=None):
    """n and r of what a region and a brush of the coating leave, counted plainly in the values of
    the page."""
    a, b = (data.map(str(linked[name].attrs["long_name"]))[1] for name in ("coating_top", "image"))
    use = linked["valid"].values & np.isfinite(a) & np.isfinite(b)
    if region is not None:
        x, y = np.meshgrid(linked["x"].values, linked["y"].values)
        use &= (x >= region[0]) & (x <= region[2]) & (y >= region[1]) & (y <= region[3])
    if brush is not None:
        use &= (a >= brush[0]) & (a <= brush[1])
    return int(use.sum()), float(np.corrcoef(a[use], b[use])[0, 1])


def test_angles_of_an_axis_have_no_r(opened, tmp_path):
    run = a_run()
    linked = run["groups"]["linked"]
    rng = np.random.default_rng(0)
    angle = linked["coating_top"] * 0 + rng.uniform(-90, 90, linked["coating_top"].shape)
    attrs = {"units": "deg", "long_name": "Fibre angle", "support_um": 94.0, "period_deg": 180.0}
    run["groups"]["linked"] = linked.assign(fibre_angle=angle.assign_attrs(attrs))
    path = tmp_path / "explored.html"
    explore(put(tmp_path / "run", run), path)
    window = opened(path)
    assert "r = " in window.status("Selection")
    window.field("Left layer").select_option(label="Fibre angle")
    assert window.status("Selection").endswith("; no r.")


# Pixels in full colour: the channels of pale ones differ little.
FULL_COLOURS = """() => {
  const c = document.getElementById("left-map");
  const all = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
  let full = 0;
  for (let i = 0; i < all.length; i += 4) {
    const colour = all.slice(i, i + 3);
    full += Math.max(...colour) - Math.min(...colour) > 60;
  }
  return full;
}"""


def test_regions_and_brushes_by_fields_and_mouse_leave_the_pixels_that_are_counted(
    opened, path, linked
):
    window, data = opened(path), Explored(path)
    cases = [{}, {"region": (200.0, 150.0, 900.0, 700.0)}, {"brush": (8.02, 14.03)}]
    cases.append(cases[1] | cases[2])
    for case in cases:
        window.page.get_by_role("button", name="Clear selection").click()
        if "region" in case:
            window.fill("Region, µm", ", ".join(map(str, case["region"])))
        if "brush" in case:
            window.fill("Brush Coating thickness, top side", ", ".join(map(str, case["brush"])))
        told = window.status("Selection")
        n, r = chosen(data, linked, **case)
        assert told.startswith(f"n = {n} of " if case else f"n = {n} pixels"), case
        assert abs(float(re.search(r"r = (-?[\d.]+)", told)[1].rstrip(".")) - r) <= 0.0051

    window.page.get_by_role("button", name="Clear selection").click()
    region, grid = window.field("Region, µm"), data.data["grid"]
    start, end = window.at("Left map", 300, 200, grid), window.at("Left map", 800, 600, grid)
    drag(window.page, start, end)  # moves the view
    window.drawn()
    assert region.input_value() == ""
    window.view("Left map").press("0")
    drag(window.page, start, end, key="Shift")
    window.drawn()
    box = numbers(region.input_value())
    np.testing.assert_allclose(box, [300, 200, 800, 600], atol=6)
    n, _ = chosen(data, linked, region=box)
    assert window.status("Selection").startswith(f"n = {n} of ")
    window.view("Left map").press("Escape")
    assert window.status("Selection").startswith(f"n = {chosen(data, linked)[0]} pixels")

    # A brush in the scatter dims the other pixels of the maps.
    window.view("Scatter").scroll_into_view_if_needed()
    before = window.page.evaluate(FULL_COLOURS)
    box = window.view("Scatter").bounding_box()
    at = [
        (box["x"] + box["width"] * u, box["y"] + box["height"] * v)
        for u, v in ((0.45, 0.3), (0.6, 0.5))
    ]
    drag(window.page, *at, key="Shift")
    n, of = numbers(window.status("Selection"))[:2]
    assert 0 < n < of
    # The map is drawn larger than it is, and smoothed; the cursor and the slice's trace are
    # coloured, too.
    assert window.page.evaluate(FULL_COLOURS) / before == pytest.approx(n / of, abs=0.1)
    window.view("Scatter").press("Escape")
    assert window.status("Selection").startswith(f"n = {of:.0f} pixels")


# --- without a mouse, narrow, without a script ----------------------------------------------------
def test_all_of_it_works_with_keys_and_every_control_is_reached_and_has_a_name(opened, path):
    window = opened(path)
    left, scatter, slice_ = (window.view(name) for name in ("Left map", "Scatter", "Slice"))
    brush = window.field("Brush Coating thickness, top side")
    left.focus()
    x, y = numbers(window.status("Cursor"))[:2]
    for key in ("ArrowRight", "ArrowRight", "ArrowDown", "Shift+ArrowLeft"):
        left.press(key)
    assert numbers(window.status("Cursor"))[:2] == [x - 8 * 5.0, y + 5.0]
    for key in ("Enter", "Shift+ArrowRight", "Shift+ArrowDown", "Enter"):
        left.press(key)
    window.drawn()
    region = numbers(window.field("Region, µm").input_value())
    assert region == [x - 40, y + 5, x + 10, y + 55]
    for key in ("Escape", "+", "+", "-", "0"):
        left.press(key)
    scatter.press("Enter")
    window.drawn()
    first = brush.input_value()
    scatter.press("ArrowRight")
    window.drawn()
    assert brush.input_value() != first
    assert " of " in window.status("Selection")
    scatter.press("Escape")
    before = window.status("Slice position")
    slice_.press("ArrowDown")
    after = window.status("Slice position")
    number = [int(re.search(r"slice (\d+) of", text)[1]) for text in (before, after)]
    assert number[1] == number[0] + 1
    slice_.press("Shift+ArrowRight")
    assert numbers(window.status("Slice position"))[0] > numbers(after)[0] + 30

    window, reached = opened(path), set()
    for _ in range(80):
        window.page.keyboard.press("Tab")
        reached.add(window.page.evaluate("document.activeElement.id"))
    wanted = {
        "left-layer",
        "right-layer",
        "left-view",
        "right-view",
        "left-range",
        "right-range",
        "slice",
        "scatter",
        "brush-left",
        "brush-right",
        "region",
        "clear",
    }
    assert wanted - reached == set()
    nameless = window.page.evaluate(
        """() => [...document.querySelectorAll("input, select, button, [role=application]")]
          .filter((e) => !e.labels?.length && !e.getAttribute("aria-label"))
          .filter((e) => !e.textContent.trim())
          .map((e) => e.id)"""
    )
    assert nameless == []


@pytest.mark.nightly
def test_on_a_phone_it_fits_the_screen_and_a_tap_moves_the_cursor(opened, path, linked):
    window, at = (
        opened(path, width=390, height=844, has_touch=True, is_mobile=True),
        a_pixel(linked),
    )
    assert window.page.evaluate("document.documentElement.scrollWidth") <= 390
    assert window.view("Left map").bounding_box()["width"] > 0.8 * 390
    window.page.touchscreen.tap(*window.at("Left map", *at, Explored(path).data["grid"]))
    x, y = numbers(window.status("Cursor"))[:2]
    assert max(abs(x - at[0]), abs(y - at[1])) <= 10


@pytest.mark.nightly
def test_without_a_script_in_an_old_browser_or_damaged_it_says_so_and_shows_the_leading_map(
    opened, path, tmp_path
):
    text = path.read_text(encoding="utf-8")
    at = text.index('id="m0">') + 40
    damaged = tmp_path / "damaged.html"
    damaged.write_text(text[:at] + "AAAAAAAA" + text[at + 8 :], encoding="utf-8")
    for words, window in (
        ("the script of this page does not run here", opened(path, java_script_enabled=False)),
        ("too old", opened(path, before="delete window.DecompressionStream")),
        ("damaged", opened(damaged, before="0")),
    ):
        window.page.wait_for_selector(f"#why:has-text('{words}')")
        assert window.page.locator("#still img").is_visible()
        assert not window.page.locator("#desk").is_visible()


# --- other runs -----------------------------------------------------------------------------------
def test_a_relation_that_is_withheld_is_not_drawn(opened, tmp_path):
    run = a_run()
    run["results"]["checks"].append(
        {
            "name": "mirror",
            "state": "fail",
            "figures": ["correlation"],
            "sentence": "It may be mirrored.",
        }
    )
    path = tmp_path / "page.html"
    explore(put(tmp_path / "run", run), path)
    window = opened(path)
    assert "r is withheld (mirror)" in window.status("Selection")
    window.fill("Region, µm", "0, 0, 300, 300")
    assert "r is withheld (mirror)" in window.status("Selection")
    greys = window.page.evaluate("""() => {
          const c = document.getElementById("scatter-plot");
          return [...c.getContext("2d").getImageData(c.width / 2, c.height / 2, 1, 1).data];
        }""")
    assert greys[3] == 0


CURSOR = """async () => {
  const view = document.getElementById("left-view"), box = view.getBoundingClientRect(), times = [];
  const frame = window.requestAnimationFrame;
  let job = null;
  window.requestAnimationFrame = (draw) => { job = draw; return 1; };
  for (let k = 0; k < 60; k++) {
    const x = box.left + box.width * (0.2 + 0.6 * (((k * 37) % 60) / 60));
    const y = box.top + box.height * (0.2 + 0.6 * (((k * 23) % 60) / 60));
    const begin = performance.now(), move = { clientX: x, clientY: y, pointerType: "mouse" };
    view.dispatchEvent(new PointerEvent("pointermove", move));
    if (job) { const draw = job; job = null; draw(0); }
    document.body.getBoundingClientRect();
    times.push(performance.now() - begin);
  }
  window.requestAnimationFrame = frame;
  return times;
}"""
"""Sixty moves of the mouse, each over to another slice: from the event until all is drawn and laid
out."""


@pytest.mark.nightly
def test_first_picture_within_a_second_and_the_cursor_within_thirty_milliseconds(
    opened, path, tmp_path, kinds
):
    page = tmp_path / "demo.html"
    explore(kinds("demo"), page)
    assert page.stat().st_size <= 5_000_000
    opened(path)  # the browser is warm
    window = opened(page)
    first = window.page.evaluate("performance.getEntriesByType('paint')[0].startTime")
    ready = float(window.page.evaluate("document.documentElement.dataset.ready"))
    times = np.array(window.page.evaluate(CURSOR))
    load = os.getloadavg()[0] / (os.cpu_count() or 1)
    print(
        f"{page.stat().st_size / 1e6:.2f} MB; first picture {first:.0f} ms, script to all drawn"
        f" {ready:.0f} ms"
    )
    print(
        f"cursor: median {np.median(times):.1f} ms, 95 % {np.percentile(times, 95):.1f} ms; load"
        f" {load:.1f} a core"
    )
    assert first <= 1000 * max(1.0, load)
    assert np.median(times) <= 30
