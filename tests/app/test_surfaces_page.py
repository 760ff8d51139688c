"""The tab Surfaces in a real browser: the drawn lines lie on the surfaces, and points make a
correction."""

import re

import numpy as np
import pytest

from app.marks_page import expect
from planish.core.frame import Frame
from planish.run import open_run

TOP, PREVIEW = (255, 176, 0), (125, 255, 106)
_COLOUR = """(canvas, [x, colour]) => {
  const ratio = canvas.width / canvas.clientWidth;
  const context = canvas.getContext('2d');
  const line = context.getImageData(Math.round(x * ratio), 0, 1, canvas.height).data;
  const rows = [];
  for (let k = 0; k < canvas.height; k++) {
    const off = Math.max(...colour.map((c, i) => Math.abs(c - line[4 * k + i])));
    if (off < 60) rows.push((k + 0.5) / ratio);
  }
  return rows;
}"""


class Shown:
    """The tab with a slice through the middle of the measured part of a sheet."""

    def __init__(self, window, run):
        self.window, self.page, self.run = window, window.page, run
        self.surfaces = open_run(run).groups["surfaces"]
        self.frame = Frame.of(self.surfaces)
        rows, cols = np.nonzero(self.surfaces["status"].values == 0)
        self.row = int(np.bincount(rows).argmax())
        self.places = np.sort(cols[rows == self.row])
        window.role("tab", "Surfaces").click()
        self.canvas = window.role("img", "Slice")
        expect(self.canvas).to_be_visible()
        window.fill("Slice at, um", f"{self.surfaces['y'].values[self.row]:.2f}")
        expect(self.window.role("status", "Slice position")).to_contain_text(
            f"{self.frame.rows} {self.surfaces['y'].values[self.row]:.2f}"
        )

    def at(self, x, y):
        """What is said of a place on the canvas: x, y and z in um."""
        box = self.canvas.bounding_box()
        self.page.mouse.move(box["x"] + x, box["y"] + y)
        text = self.window.role("status", "Slice position").inner_text()
        found = re.match(r"x (-?[\d.]+), y (-?[\d.]+), z (-?[\d.]+) µm", text)
        assert found, text
        return dict(zip("xyz", map(float, found.groups()), strict=True))

    def rows_of(self, x, colour=TOP):
        return np.array(self.canvas.evaluate(_COLOUR, [x, list(colour)]))

    def along(self, x):
        """Place in um of a column of the screen."""
        return self.at(x, 5)[self.frame.cols]

    def top(self, um):
        known = np.isfinite(self.surfaces["top"].values[self.row])
        return float(
            np.interp(
                um, self.surfaces["x"].values[known], self.surfaces["top"].values[self.row][known]
            )
        )

    def clear_columns(self):
        """Columns of the screen over columns that were measured, away from holes."""
        width = self.canvas.bounding_box()["width"]
        measured = self.surfaces["x"].values[self.places]
        for x in np.linspace(30, width - 30, 60):
            um = self.along(x)
            if (
                np.abs(measured - um).min() < 5
                and np.count_nonzero(np.abs(measured - um) < 60) > 20
            ):
                yield float(x)


@pytest.fixture
def shown(served, window):
    return Shown(window(served), served.run)


def face_lies_on_the_top(shown):
    checked = 0
    for x in shown.clear_columns():
        rows = shown.rows_of(x)
        if rows.size == 0 or np.ptp(rows) > 6:  # it is hidden, or another line crosses it
            continue
        heights = [shown.at(x, row)[shown.frame.through] for row in (rows.mean(), rows.mean() + 20)]
        pixel_um = abs(heights[1] - heights[0]) / 20
        # A mouse has whole pixels: half a pixel comes on top.
        assert abs(heights[0] - shown.top(shown.along(x))) <= 1.5 * pixel_um
        checked += 1
    assert checked >= 5


def points_above(shown):
    """Six clicks a few pixels above the top face."""
    columns = list(shown.clear_columns())
    middle = columns[len(columns) // 2]
    box = shown.canvas.bounding_box()
    for k in range(6):
        rows = shown.rows_of(middle)
        shown.page.mouse.click(box["x"] + middle + (k - 3) * 6, box["y"] + rows.mean() - 14)
    return middle


def test_slices_show_the_face_and_points_become_a_correction_saved_and_undone(
    shown,
):
    face_lies_on_the_top(shown)
    middle = points_above(shown)
    expect(shown.page.get_by_text("6 points, the last at")).to_be_visible()
    for _ in range(80):
        if shown.rows_of(middle, PREVIEW).size:
            break
        shown.page.wait_for_timeout(250)
    assert shown.rows_of(middle, PREVIEW).size
    shown.window.role("button", "Correct").click()
    listed = shown.window.field("Corrections")
    expect(listed).to_contain_text("6 points on the top face, reach 60 µm")
    expect(shown.window.role("status", "Message")).to_contain_text("aved")
    shown.window.role("button", "Undo").click()
    expect(listed).to_be_empty()
    shown.window.role("button", "Redo").click()
    expect(listed).to_contain_text("6 points")
    shown.page.reload()
    shown = Shown(shown.window, shown.run)
    expect(listed).to_contain_text("6 points on the top face")
    shown.window.role("button", "Undo").click()
    expect(listed).to_be_empty()

    # By keys alone.
    shown.canvas.focus()
    for key in ("ArrowUp", "Shift+ArrowLeft", "Enter", "ArrowRight", "Enter", "Enter", "Backspace"):
        shown.page.keyboard.press(key)
    expect(shown.page.get_by_text("2 points, the last at")).to_be_visible()
    before = shown.window.field("Slice at, um").input_value()
    shown.page.keyboard.press("PageDown")
    assert shown.window.field("Slice at, um").input_value() != before
    shown.window.fill("Point, um", "300, 300, 150")
    expect(
        shown.page.get_by_text("3 points, the last at x, y, z = 300.00, 300.00, 150.00 µm")
    ).to_be_visible()
    shown.window.role("button", "Correct").press("Enter")
    expect(listed).to_contain_text("3 points")

    far_click_is_asked_about(Shown(shown.window, shown.run))
    for direction in ("z", "y", "x", "straight"):
        shown.window.field("Direction").select_option(direction)
        shown.page.wait_for_timeout(1000)
        place = shown.at(300, 200)
        assert all(np.isfinite(list(place.values())))
        pixels = "c => c.getContext('2d').getImageData(0, 0, c.width, c.height).data"
        assert shown.canvas.evaluate(f"{pixels}.some(v => v > 60)")


MISSES = """async () => {
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
"""What is said of a point that the tried face misses by 20 um, and by 1 um."""


def far_click_is_asked_about(shown):
    """A click far off a face, and by how much the tried face misses a point."""
    expect(shown.page.get_by_role("img", name=re.compile("^Histogram of grey: n"))).to_be_visible()
    box = shown.canvas.bounding_box()
    for answer, points in (("Leave it out", 0), ("Set it", 1)):
        shown.page.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.16 * box["height"])
        expect(shown.page.get_by_text(re.compile(r"lies \d+ µm from the top face"))).to_be_visible()
        shown.window.role("button", answer).click()
        expect(shown.page.get_by_text(re.compile("1 point, the last at"))).to_have_count(points)
    far, near = shown.page.evaluate(MISSES)
    assert "misses a point by 20.0 µm" in far
    assert near == ""
