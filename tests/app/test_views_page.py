"""What all views have: colours with limits, the same gestures, keys; and what one view shows of another."""

import re

import numpy as np
import pytest

from app.marks_page import IMAGE, VOLUME, drag, expect

pytestmark = pytest.mark.nightly


@pytest.fixture
def shown(served, window):
    shown = window(served)
    expect(shown.role("table", "Marks").get_by_role("row").nth(1)).to_be_visible()
    return shown


def number(shown, label):
    return float(shown.page.get_by_label(label, exact=True).input_value())


def test_a_view_shows_all_at_first_and_zooms_with_the_focus_and_within_limits(shown, linked):
    shape = np.array(linked.image.shape) * float(linked.x[1] - linked.x[0])
    label = f"{IMAGE}, um per screen pixel"
    box = shown.role("application", IMAGE).bounding_box()
    for width, height in ((1366, 768), (1280, 700)):  # and while the window changes
        shown.page.set_viewport_size({"width": width, "height": height})
        shown.page.wait_for_timeout(500)
        box = shown.role("application", IMAGE).bounding_box()
        assert (shape <= number(shown, label) * np.array([box["height"], box["width"]])).all()
    whole = number(shown, label)
    shown.page.mouse.move(*shown.middle(IMAGE))
    shown.page.mouse.wheel(0, -300)
    shown.page.wait_for_timeout(200)
    assert number(shown, label) == whole  # the page would scroll
    shown.page.keyboard.down("Control")
    shown.page.mouse.wheel(0, -300)
    shown.page.keyboard.up("Control")
    shown.page.wait_for_timeout(200)
    assert number(shown, label) < 0.6 * whole
    shown.role("application", IMAGE).focus()
    for _ in range(40):
        shown.page.mouse.wheel(0, 400)
    shown.page.wait_for_timeout(200)
    assert whole < number(shown, label) < 10 * whole
    shown.role("button", f"{IMAGE}: show all").click()
    assert number(shown, label) == pytest.approx(whole, rel=1e-3)
    centre = shown.page.get_by_label(f"{IMAGE} centre, um", exact=True).input_value()
    drag(shown.page, shown.middle(IMAGE), (box["x"] + 20, box["y"] + 60))
    assert shown.page.get_by_label(f"{IMAGE} centre, um", exact=True).input_value() != centre


def test_limits_of_the_colours_leave_holes_out_and_are_moved_by_mouse_keys_and_numbers(shown, linked):
    field = shown.page.get_by_label(f"{IMAGE} colour range", exact=True)
    values = linked.image.values[linked.valid.values]
    wanted = np.percentile(values, [2, 98])
    expect(shown.page.get_by_role("img", name=re.compile(r"^Histogram of image: n \d+"))).to_be_visible()
    found = [float(v) for v in field.input_value().split(",")]
    np.testing.assert_allclose(found, wanted, atol=0.05 * np.ptp(values))
    low = shown.role("slider", f"{IMAGE} colour range, low")
    low.press("ArrowRight")
    moved = float(field.input_value().split(",")[0])
    assert moved > found[0]
    box = low.bounding_box()
    at = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    drag(shown.page, at, (at[0] + 20, at[1]))
    assert float(field.input_value().split(",")[0]) > moved
    shown.role("button", f"{IMAGE} colour range: auto").click()
    assert [float(v) for v in field.input_value().split(",")] == found
    shown.fill(f"{IMAGE} colour range", "2, 1")
    expect(shown.role("status", "Message")).to_contain_text("A colour range is")


def test_errors_are_coloured_by_the_limit_of_the_check_and_keys_are_listed(shown):
    rows = shown.rows()
    shown.page.get_by_label(f"Use {rows[0][0]}", exact=True).uncheck()
    expect(shown.role("status", "Message")).to_contain_text("not used")
    assert shown.page.locator("td.error.usual").count() >= len(rows)
    assert shown.page.locator("td.error.large, td.error.very").count() == 0
    shown.role("application", VOLUME).focus()
    shown.page.keyboard.press("?")
    expect(shown.page.get_by_role("dialog")).to_be_visible()
    shown.page.keyboard.press("Escape")
    expect(shown.page.get_by_role("dialog")).to_be_hidden()


def test_map_slice_and_scatter_show_one_place(shown):
    shown.role("tab", "Maps").click()
    expect(shown.page.get_by_text(re.compile("Scatter of [0-9]+ points"))).to_be_visible()
    box = shown.role("application", "Left map").bounding_box()
    shown.page.mouse.move(box["x"] + 0.55 * box["width"], box["y"] + 0.4 * box["height"])
    expect(shown.role("status", "Cursor")).to_contain_text("volume x")
    expect(shown.role("img", "Slice")).to_be_visible()
    shown.page.wait_for_timeout(1500)
    before = shown.role("status", "Cursor").inner_text()
    cursors = "document.querySelectorAll('[role=application]').length"
    assert shown.page.evaluate(cursors) >= 3
    for name in ("Left map", "Right map", "Scatter"):
        bottom = shown.role("application", name).bounding_box()
        assert bottom["y"] + bottom["height"] <= 768
    slice_box = shown.role("img", "Slice").bounding_box()
    assert slice_box["y"] + slice_box["height"] <= 768
    shown.page.mouse.click(slice_box["x"] + 0.6 * slice_box["width"], slice_box["y"] + 0.5 * slice_box["height"])
    expect(shown.role("status", "Cursor")).not_to_have_text(before)
    expect(shown.role("button", "Show slice")).to_be_enabled()


def test_a_click_far_off_a_face_is_asked_about(shown):
    shown.role("tab", "Surfaces").click()
    canvas = shown.role("img", "Slice")
    expect(shown.page.get_by_role("img", name=re.compile("^Histogram of grey: n"))).to_be_visible()
    box = canvas.bounding_box()
    for answer, points in (("Leave it out", 0), ("Set it", 1)):
        shown.page.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.16 * box["height"])
        expect(shown.page.get_by_text(re.compile(r"lies \d+ µm from the top face"))).to_be_visible()
        shown.role("button", answer).click()
        expect(shown.page.get_by_text(re.compile("1 point, the last at"))).to_have_count(points)
    said = shown.page.evaluate(
        """async () => {
          const { Corrections } = await import("/corrections.js");
          const app = { state: { corrections: [] } }, sheet = { axes: { y: { step_um: 1 } } };
          const made = new Corrections(app, { sheet: () => sheet });
          made.draft = [{ x: 5, y: 0, z: 50, face: "top" }];
          const facts = { across: { name: "x" }, down: { name: "z", step_um: 1 }, normal: "y", at_um: 0 };
          return [30, 49].map((height) => {
            made.compare({ facts, at: () => height });
            return made.off.textContent;
          });
        }"""
    )
    assert "misses a point by 20.0 µm" in said[0]
    assert said[1] == ""
