"""The page for everybody: names, roles, contrast and focus; small windows; keys alone."""

import json
import re
import shutil

import pytest

from app.marks_page import IMAGE, VOLUME, ends, expect, message, settled

APPLY_MS = 180_000
"""Apply computes a run: it may take a minute on a loaded machine."""

NAMED = (
    "button|checkbox|combobox|textbox|spinbutton|slider|tab|link"
    "|application|table|progressbar|columnheader|img"
)

CONTRAST = """() => {
  const rgb = (text) => (text.match(/[\\d.]+/g) ?? []).map(Number);
  const light = ([r, g, b]) => [r, g, b].map((v) => v / 255)
    .map((v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
  const over = (top, [r, g, b]) => {
    const a = top.length > 3 ? top[3] : 1;
    return [r, g, b].map((v, i) => a * top[i] + (1 - a) * v);
  };
  const behind = (element) => {
    const stack = [];
    for (let e = element; e; e = e.parentElement) {
      stack.push(rgb(getComputedStyle(e).backgroundColor));
    }
    return stack.reverse().reduce((under, top) => over(top, under), [255, 255, 255]);
  };
  const poor = [];
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  let seen = 0;
  for (let node; (node = walk.nextNode()); ) {
    const e = node.parentElement;
    if (!node.textContent.trim() || !e.checkVisibility()) continue;
    // On a picture, unseen, or not to be used.
    if (e.closest(":disabled, .sr, .scale, noscript, option")) continue;
    seen += 1;
    const ink = getComputedStyle(e)[e.namespaceURI.endsWith("svg") ? "fill" : "color"];
    const [a, b] = [light(over(rgb(ink), behind(e))), light(behind(e))];
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (ratio < 4.5) poor.push(`${node.textContent.trim().slice(0, 40)}: ${ratio.toFixed(2)}`);
  }
  return { seen, poor };
}"""

FOCUS = """() => {
  const e = document.activeElement;
  if (!e || e === document.body) return null;
  const style = getComputedStyle(e);
  const name = e.getAttribute("aria-label") ?? e.id ?? "";
  return { what: e.tagName + " " + name + " " + e.textContent.slice(0, 20),
           seen: style.outlineStyle !== "none" && parseFloat(style.outlineWidth) >= 2 };
}"""

BROKEN = """() => {
  const ids = [...document.querySelectorAll("[id]")].map((e) => e.id);
  const names = ["aria-controls", "aria-labelledby", "for"];
  const refs = [...document.querySelectorAll("[aria-controls], [aria-labelledby], label[for]")]
    .flatMap((e) => names.map((n) => e.getAttribute(n)).filter(Boolean));
  return { twice: ids.filter((id, i) => ids.indexOf(id) !== i),
           lost: refs.filter((id) => !ids.includes(id)),
           lang: document.documentElement.lang, title: document.title };
}"""


TABS = {  # what a tab shows when it is ready
    "Surfaces": ("img", "Slice"),
    "Maps": ("application", "Scatter"),
    "Flattening": ("img", "Sheet in space"),
}


def accessible(shown, *, controls):
    """Every control has a name, every text its contrast, every step of the Tab key shows where it
    is."""
    snapshot = shown.page.locator("body").aria_snapshot()
    roles = re.findall(rf'^\s*- ({NAMED})\b(?: "([^"]*)")?', snapshot, flags=re.MULTILINE)
    assert len(roles) > controls
    assert [role for role, name in roles if not name.strip()] == []

    broken = shown.page.evaluate(BROKEN)
    assert broken["twice"] == broken["lost"] == []
    assert broken["lang"] == "en"
    assert shown.server.run.name in broken["title"]

    contrast = shown.page.evaluate(CONTRAST)
    assert contrast["seen"] > controls
    assert contrast["poor"] == []

    shown.role("tab", "Marks").focus()
    found = []
    for _ in range(120):
        shown.page.keyboard.press("Tab")
        focus = shown.page.evaluate(FOCUS)
        if focus is None:
            break
        found.append(focus)
    assert len(found) > 0.4 * controls, "Tab goes through the whole page"
    assert [one["what"] for one in found if not one["seen"]] == []


@pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=pytest.mark.nightly)])
def test_names_roles_contrast_and_focus(served, window, scheme):
    shown = window(served, color_scheme=scheme)
    rows = settled(shown)
    shown.role("button", rows[0][0]).click()
    shown.field(f"Use {rows[1][0]}").uncheck()
    shown.field("View").select_option("blend")
    accessible(shown, controls=50)
    for tab, ready in TABS.items():
        shown.role("tab", tab).click()
        expect(shown.role(*ready)).to_be_visible()
        shown.page.wait_for_timeout(500)  # values and histograms follow
        accessible(shown, controls=10)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("width", "height"), [(390, 844), (683, 384), (1366, 768)], ids=["390", "200 %", "1366"]
)
def test_every_tab_fits_small_windows_which_scroll_one_way_only(served, window, width, height):
    shown = window(served, width=width, height=height)
    settled(shown)
    wide, high = shown.page.evaluate(
        "[document.documentElement.scrollWidth, document.documentElement.scrollHeight]"
    )
    assert wide <= width
    assert width < 1366 or high <= height, "a laptop shows all at once"
    shown.role("application", VOLUME).scroll_into_view_if_needed()
    box = shown.role("application", VOLUME).bounding_box()
    assert box["width"] >= 250
    assert box["height"] >= 230
    shown.click(VOLUME, 100.0, 120.0, 1.0)
    shown.click(IMAGE, 300.0, 320.0)
    expect(shown.role("table", "Marks").get_by_role("row")).to_have_count(7)

    for tab, (role, name) in TABS.items():
        shown.role("tab", tab).click()
        picture = shown.role(role, name)
        expect(picture).to_be_visible()
        picture.scroll_into_view_if_needed()
        box = picture.bounding_box()
        assert box["width"] >= 250, tab
        assert box["height"] >= 150, tab
        assert shown.page.evaluate("document.documentElement.scrollWidth") <= width, tab


def test_keys_alone_correct_a_mark_cancel_a_run_and_open_the_report_of_the_next(served, window):
    shown = window(served)
    before = settled(shown)
    press = shown.page.keyboard.press

    def tab_to(role, name, key="Tab"):
        wanted = shown.role(role, name)
        for _ in range(90):
            if wanted.evaluate("e => e === document.activeElement"):
                return
            press(key)
        pytest.fail(f"{name} is not reached with {key}")

    tab_to("button", before[0][0])
    press("Enter")
    tab_to("application", IMAGE, "Shift+Tab")
    press("Shift+ArrowRight")
    expect(message(shown)).to_contain_text("Saved")
    assert ends(shown.rows())[0, 2] > ends(before)[0, 2]
    tab_to("button", "Apply", "Shift+Tab")
    press("Enter")
    expect(shown.page.get_by_role("progressbar")).to_be_visible()
    shown.role("button", "Cancel").click()
    expect(message(shown)).to_contain_text("cancelled")
    assert [path.name for path in served.run.parent.iterdir()] == [served.run.name]
    expect(shown.role("button", "Apply")).to_be_enabled()
    shown.role("button", "Apply").press("Enter")
    link = shown.page.get_by_role("link", name=re.compile("report"))
    expect(link).to_be_visible(timeout=APPLY_MS)
    made = served.run.with_name("run-2")
    assert json.loads((made / "marks.json").read_text())
    tab_to("link", link.inner_text(), "Shift+Tab")
    with shown.page.context.expect_page() as report:
        press("Enter")
    expect(report.value.locator("h1")).to_be_visible()
    expect(shown.page.get_by_text("This page still shows the run before.")).to_be_visible()
    shutil.rmtree(made)


def test_a_window_that_missed_the_switch_changes_nothing_and_offers_to_reload(
    run_copy, serve, window
):
    """Its news are held back; the other window has the report, and says what is not in the run."""
    served = serve(run_copy)
    first, other = window(served), window(served)
    settled(first)
    settled(other)
    first.field("Model").select_option("similarity")
    expect(message(first)).to_contain_text("Saved")
    first.role("button", "Apply").click()
    link = first.page.get_by_role("link", name="Open report of run-2")
    expect(link).to_be_visible(timeout=APPLY_MS)
    lacks = first.page.get_by_text("run-2 lacks what was changed since")
    expect(lacks).to_be_hidden()
    # Without news, but for the next one, until the page is loaded again.
    other.page.evaluate(
        "() => { const ask = window.fetch; window.fetch = (path, init) =>"
        " `${path}`.endsWith('events') ? new Promise(() => {}) : ask(path, init);"
        " ReadableStreamDefaultReader.prototype.read = () => new Promise(() => {}); }"
    )
    first.field("Model").select_option("affine")
    expect(lacks).to_be_visible()
    first.role("button", "Undo").click()
    expect(lacks).to_be_hidden()
    first.role("button", "Redo").click()
    expect(lacks).to_be_visible()

    first.role("button", "Open the new run").click()
    expect(first.page).to_have_title("run-2 – planish")
    expect(message(first)).to_contain_text("What was changed after Apply is in run only")
    expect(link).to_be_visible()
    expect(first.role("button", "Open the new run")).to_be_hidden()
    assert first.field("Model").input_value() == "similarity"

    expect(other.page).to_have_title("run – planish")
    other.field("Model").select_option("rigid")
    expect(other.page.get_by_role("alert")).to_contain_text(
        "This window shows run, and planish serves"
    )
    other.faults = [fault for fault in other.faults if "409" not in fault]
    assert first.field("Model").input_value() == "similarity"
    other.role("button", "Reload the page").click()
    expect(other.page).to_have_title("run-2 – planish")
    assert other.field("Model").input_value() == "similarity"
