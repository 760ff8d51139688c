"""The tab Maps with mouse and keys: cursor, brush, region, profile, artefacts; numbers are those of
``maps.zarr``."""

import re

import numpy as np
import pytest

from app.marks_page import api, drag, expect

LEFT, RIGHT = "coating_top", "image"
TAKES = {
    "Region, um": "A region is",
    "Line, um": "A line is",
    "Left colour range": "A colour range is",
    "Right map centre, um": "Right map centre is",
    "Right map, um per screen pixel": "Right map",
    f"Brush {LEFT}": "A brush is",
    "Polygon, um": "A polygon is",
}
"""Fields, and the beginning of what each says of words that it does not take."""


@pytest.fixture
def maps(served, window):
    """The page at its tab Maps."""
    shown = window(served)
    expect(shown.role("table", "Marks")).to_be_visible()
    shown.role("tab", "Maps").click()
    expect(shown.page.get_by_text(re.compile("Scatter of [0-9]+ points"))).to_be_visible()
    return shown


def selection(shown, pattern):
    line = shown.role("status", "Selection")
    expect(line).to_have_text(re.compile(pattern))
    return line.inner_text()


def count(text):
    return int(re.match(r"n (\d+)", text)[1])


def painted(shown, name):
    """Screen pixels of a map with the colour of what is chosen."""
    return shown.role("application", name).evaluate(
        """element => [...element.querySelectorAll("canvas")].reduce((sum, canvas) => {
          const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
          let found = 0;
          for (let i = 0; i < data.length; i += 4) {
            found += data[i] === 255 && data[i + 1] === 72 && data[i + 2] === 0;
          }
          return sum + found;
        }, 0)"""
    )


def known(linked, region=None, names=(LEFT, RIGHT)):
    """Values of both layers where they count."""
    part = linked.where(linked.valid)
    if region is not None:
        x0, y0, x1, y1 = region
        part = part.sel(x=slice(x0, x1), y=slice(y0, y1))
    a, b = (part[name].values for name in names)
    both = np.isfinite(a) & np.isfinite(b)
    return a[both].astype(float), b[both].astype(float)


def values_in(shown, label):
    """The numbers in a field."""
    return [float(word) for word in shown.field(label).input_value().split(",")]


def valid_pixel(linked, left=LEFT):
    """A pixel that counts."""
    row, col = np.argwhere(linked.valid.values & np.isfinite(linked[left].values))[4000]
    return linked.isel(y=row, x=col)


def place_of(pixel):
    """Its place in the volume, as the page writes it."""
    return ", ".join(f"{axis} {float(pixel[f'volume_{axis}']):.2f}" for axis in "xyz")


def cursor_gives_the_pixel(maps, linked, left=LEFT):
    """The place in the volume and the values of a pixel under the mouse are those of the file: that
    pixel."""
    pixel = valid_pixel(linked, left)
    maps.go("Left map", float(pixel.x), float(pixel.y), 1.0)
    maps.page.mouse.move(*maps.middle("Left map"))
    cursor = maps.role("status", "Cursor")
    expect(cursor).to_contain_text(f"volume {place_of(pixel)} µm")
    for name in (left, RIGHT, "thickness", "expected_error"):
        found = re.search(rf"; {name} (\S+)", cursor.inner_text())
        assert float(found[1].rstrip(";")) == pytest.approx(float(pixel[name]), rel=1e-4)
    return pixel


def test_cursor_brush_and_region_are_those_of_the_maps_and_a_pixel_leads_to_its_slice(maps, linked):
    assert maps.field("Left layer").input_value() == LEFT
    assert maps.field("Right layer").input_value() == RIGHT
    expect(maps.role("status", "Whole maps")).to_contain_text("95 % interval")
    cursor_gives_the_pixel(maps, linked)
    expect(maps.role("table", "Values at the cursor")).to_be_visible()
    one, other = (values_in(maps, f"{side} map centre, um") for side in ("Left", "Right"))
    assert one == pytest.approx(other, abs=0.01)  # both maps move together
    # Values picked by the fields: painted in both maps, counted over all pixels.
    a, b = known(linked)
    low, high = (float(v) for v in np.percentile(a, [30, 60]).round(2))
    maps.fill(f"Brush {LEFT}", f"{low}, {high}")
    assert count(selection(maps, r"^n \d+;")) == np.count_nonzero((a >= low) & (a <= high))
    below = round(float(np.median(b)))
    maps.fill(f"Brush {RIGHT}", f"0, {below}")
    expected = np.count_nonzero((a >= low) & (a <= high) & (b <= below))
    expect(maps.role("status", "Selection")).to_have_text(re.compile(f"^n {expected};"))
    for name in ("Left map", "Right map"):
        assert painted(maps, name) > 100
    maps.role("button", "Clear selection").click()
    expect(maps.role("status", "Selection")).to_have_text("n 0: nothing is selected.")
    assert painted(maps, "Left map") == 0
    # A region: its points, n and r.
    region = (float(linked.x[60]), float(linked.y[50]), float(linked.x[200]), float(linked.y[150]))
    maps.fill("Region, um", ", ".join(map(str, region)))
    said = selection(maps, r"^n \d+; r")
    a, b = known(linked, region)
    assert count(said) == a.size
    assert float(re.search(r"r (-?[0-9.]+);", said)[1]) == pytest.approx(
        np.corrcoef(a, b)[0, 1], abs=1e-3
    )
    assert re.search(r"95 % interval -?0\.\d+ to -?0\.\d+; n_eff \d", said)
    # The slice beside the maps goes to the pixel that is clicked, and the cursor to the place
    # clicked in it.
    pixel = valid_pixel(linked)
    maps.click("Left map", float(pixel.x), float(pixel.y), 1.0)
    expect(maps.role("status", "Slice position")).to_have_text(f"{place_of(pixel)} µm")
    expect(maps.role("button", "Show slice")).to_be_enabled()
    for name in ("Left map", "Right map", "Scatter"):
        box = maps.role("application", name).bounding_box()
        assert box["y"] + box["height"] <= 768, name
    box = maps.role("img", "Slice").bounding_box()
    assert box["y"] + box["height"] <= 768, "maps, scatter and slice stand on one screen"
    before = maps.role("status", "Cursor").inner_text()
    maps.page.mouse.click(box["x"] + 0.6 * box["width"], box["y"] + 0.5 * box["height"])
    expect(maps.role("status", "Cursor")).not_to_have_text(before)


def test_a_rectangle_in_the_scatter_fills_the_brushes_and_no_tile_is_asked_for_twice(maps, linked):
    scatter = maps.role("application", "Scatter")
    scatter.scroll_into_view_if_needed()
    box = scatter.bounding_box()
    at = [
        (box["x"] + box["width"] * u, box["y"] + box["height"] * v)
        for u, v in ((0.4, 0.3), (0.7, 0.6))
    ]
    drag(maps.page, *at)  # moves the points
    expect(maps.role("status", "Selection")).to_have_text("n 0: nothing is selected.")
    scatter.press("0")
    expect(maps.page.get_by_role("img", name=re.compile("^Histogram of image"))).to_be_visible()
    asked = []
    maps.page.on(
        "request",
        lambda request: asked.append(request.url) if "/api/tiles/" in request.url else None,
    )
    drag(maps.page, *at, key="Shift")
    said = selection(maps, r"^n \d+;")
    (a0, a1), (b0, b1) = (values_in(maps, f"Brush {n}") for n in (LEFT, RIGHT))
    a, b = known(linked)
    assert count(said) == np.count_nonzero((a >= a0) & (a <= a1) & (b >= b0) & (b <= b1)) > 0
    maps.fill("Left colour range", "5, 30")
    maps.field("Left colours").select_option("magma")
    maps.fill(f"Brush {LEFT}", "12, 20")
    selection(maps, r"^n \d+;")
    shown = [url.rpartition("/api/")[2] for url in asked]
    assert len(shown) == len(set(shown))
    (mask,) = (
        p["id"]
        for p in api(maps, "session")["pictures"]
        if (p["plane"], p["name"]) == ("fixed", "valid")
    )
    assert {path.split("/")[1] for path in shown} <= {mask}  # which no map has shown before
    scatter.focus()
    maps.page.keyboard.press("Escape")
    expect(maps.role("status", "Selection")).to_have_text("n 0: nothing is selected.")


def test_regions_lines_and_artefacts_are_drawn_typed_shown_and_undone(
    maps,
):
    for name, field in (("Draw region", "Region, um"), ("Draw line", "Line, um")):
        maps.role("button", name).click()
        clicked(maps, (-60, -30), (50, 40))
        expect(maps.field(field)).to_have_value(re.compile(r"^(-?[\d.]+, ){3}-?[\d.]+$"))
    (pixel,) = values_in(maps, "Left map, um per screen pixel")
    x0, y0, x1, y1 = values_in(maps, "Region, um")
    assert (x1 - x0, y1 - y0) == pytest.approx((110 * pixel, 70 * pixel), abs=0.2 * pixel)
    expect(maps.page.get_by_role("img", name=re.compile("^Profile over"))).to_be_visible()
    maps.role("button", "Draw line").click()
    maps.role("application", "Left map").press("Escape")  # leaves drawing
    maps.page.mouse.click(*maps.middle("Left map"))
    expect(maps.role("button", "Show slice")).to_be_enabled()  # the click took a place again

    maps.fill("Artefact: Author", "R. Hirn")
    maps.fill("Artefact: Reason", "a <b>stain</b>")
    maps.fill("Polygon, um", "100, 100; 300, 100; 200, 250")
    maps.role("button", "Declare artefact").press("Enter")
    artefacts = maps.role("list", "Declared artefacts")
    expect(artefacts).to_contain_text("a <b>stain</b>, by R. Hirn")  # inert
    maps.role("button", "Draw polygon").click()
    clicked(maps, (-40, -40), (40, -40), (0, 40), (-40, -38))  # the last one is the first corner
    expect(maps.field("Polygon, um")).to_have_value(re.compile(r"(-?[\d.]+, -?[\d.]+; ){2,}"))
    maps.role("button", "Declare artefact").click()
    expect(maps.role("status", "Message")).to_contain_text("Give it an author and a reason")
    maps.fill("Artefact: Reason", "a second one")
    maps.role("button", "Declare artefact").dblclick()  # an impatient one declares it once
    expect(artefacts.get_by_role("listitem")).to_have_count(2)
    maps.role("button", "Undo").click()
    expect(artefacts.get_by_role("listitem")).to_have_count(1)

    for field, needed in TAKES.items():
        box = maps.field(field)
        box.fill("-1" if box.get_attribute("type") == "number" else "one, two")
        box.press("Enter")
        if field.startswith("Polygon"):
            maps.role("button", "Declare artefact").click()
        expect(maps.role("status", "Message")).to_contain_text(needed)
        expect(box).to_have_attribute("aria-invalid", "true")

    maps.field("Left layer").select_option("thickness")
    expect(
        maps.page.get_by_role("img", name=re.compile("^Histogram of thickness: n [0-9]+"))
    ).to_be_visible()
    expect(maps.field("Brush thickness")).to_be_visible()
    maps.fill("Line, um", "100, 100, 700, 500")
    expect(
        maps.page.get_by_role("img", name="Profile over 721.11 um of thickness and image")
    ).to_be_visible()
    for kind, first_bytes in (("PNG", b"\x89PNG"), ("SVG", b"<svg")):
        with maps.page.expect_download() as download:
            maps.role("button", f"Profile: save as {kind}").click()
        data = download.value.path().read_bytes()
        assert data.startswith(first_bytes)
    assert b"var(" not in data  # as other programs read it
    assert "Grey value, uncalibrated" in data.decode()
    maps.field("Only valid pixels").check()
    maps.field("Layout").select_option("Blended")
    expect(maps.role("application", "Right map")).to_be_hidden()
    maps.field("Share of the right layer").fill("0.8")
    maps.field("Layout").select_option("Side by side")
    expect(maps.role("application", "Right map")).to_be_visible()


def clicked(maps, *places):
    """Click places by their distance from the middle of the left map, on the screen."""
    maps.role("application", "Left map").scroll_into_view_if_needed()
    x, y = maps.middle("Left map")
    for dx, dy in places:
        maps.page.mouse.click(x + dx, y + dy)
        maps.page.wait_for_timeout(300)  # two clicks at once would be a double click
