"""The tab Flattening in a real browser: the sheet in space, and what is shown where there is no
WebGL."""

import re

import pytest

from app.marks_page import drag, expect, settled
from folders import chromium_path

COLOURS = """(canvas) => {
  const copy = document.createElement("canvas");
  [copy.width, copy.height] = [canvas.width, canvas.height];
  const context = copy.getContext("2d");
  context.drawImage(canvas, 0, 0);
  const { data } = context.getImageData(0, 0, copy.width, copy.height);
  const found = new Set();
  let covered = 0;
  for (let k = 0; k < data.length; k += 4) {
    if (data[k + 3] < 128) continue;
    covered += 1;
    found.add((data[k] >> 4 << 8) | (data[k + 1] >> 4 << 4) | (data[k + 2] >> 4));
  }
  return { colours: found.size, covered: covered / (data.length / 4) };
}"""

OFF_THE_BAR = """(canvas) => {
  const pixelsOf = (shown, above = 0) => {
    const copy = document.createElement("canvas");
    [copy.width, copy.height] = [shown.width, shown.height];
    const context = copy.getContext("2d", { willReadFrequently: true });
    context.drawImage(shown, 0, 0);
    const { data } = context.getImageData(0, above, copy.width, copy.height - above), found = [];
    for (let k = 0; k < data.length; k += 4) {
      const [r, g, b] = data.slice(k, k + 3), length = Math.hypot(r, g, b);
      if (data[k + 3] > 250 && length > 40) found.push([r / length, g / length, b / length]);
    }
    return found;
  };
  // Below its histogram.
  const bar = pixelsOf(canvas.parentElement.querySelector(".contrast canvas"), 20);
  const along = (one, other) => one[0] * other[0] + one[1] * other[1] + one[2] * other[2];
  const nearest = (one) => Math.min(1, Math.max(...bar.map((other) => along(one, other))));
  const angles = pixelsOf(canvas).filter((_, k) => k % 97 === 0)
    .map((one) => Math.acos(nearest(one)) * 180 / Math.PI);
  return angles.sort((a, b) => a - b)[Math.floor(0.5 * angles.length)];
}"""


def drawn(canvas):
    """A picture of a sheet: colours and the share that they cover."""
    found = canvas.evaluate(COLOURS)
    return found["covered"] > 0.1 and found["colours"] > 20


def test_the_sheet_is_drawn_whole_in_the_colours_of_the_bar_and_again_after_it_was_turned(
    served, window
):
    shown = window(served)
    settled(shown)
    shown.role("tab", "Flattening").click()
    canvas = shown.role("img", "Sheet in space")
    expect(canvas).to_have_attribute("data-detail", "full")
    assert drawn(canvas)
    # The direction of a colour against the nearest one of the bar, degrees in the median.
    assert canvas.evaluate(OFF_THE_BAR) < 2.5
    before = canvas.screenshot()
    box = canvas.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    drag(shown.page, (x, y), (x + 80, y + 30))
    shown.page.wait_for_timeout(500)
    expect(canvas).to_have_attribute("data-detail", "full", timeout=10_000)
    assert drawn(canvas)
    assert canvas.screenshot() != before
    assert int(canvas.get_attribute("data-triangles")) <= 1_000_000


@pytest.fixture
def without_webgl(chromium):
    """A second Chromium, which has no WebGL."""
    arguments = ["--no-sandbox", "--disable-gpu", "--disable-3d-apis"]
    browser = chromium.browser_type.launch(executable_path=chromium_path(), args=arguments)
    yield browser
    browser.close()


@pytest.mark.nightly
def test_without_webgl_the_sheet_is_shown_from_above(served, window, without_webgl):
    context = without_webgl.new_context(viewport={"width": 1366, "height": 768})
    shown = window(served, context=context)
    settled(shown)
    assert shown.page.evaluate("document.createElement('canvas').getContext('webgl2')") is None
    shown.role("tab", "Flattening").click()
    expect(
        shown.page.get_by_text(re.compile("no WebGL: the sheet is shown from above"))
    ).to_be_visible()
    canvas = shown.role("img", "Sheet in space")
    expect(canvas).to_be_visible()
    for _ in range(100):
        if drawn(canvas):
            break
        shown.page.wait_for_timeout(100)
    assert drawn(canvas)
    expect(shown.page.get_by_role("alert")).to_be_hidden()
    before = canvas.screenshot()
    shown.field("Heights").select_option("20")
    shown.page.wait_for_timeout(1000)
    assert canvas.screenshot() != before
