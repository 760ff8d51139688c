"""The tab Marks in a real browser: clicks, keys, the table, undo, files, other windows and a lost
server."""

import json
import re
import signal

import numpy as np
import pytest

from app.marks_page import (
    IMAGE,
    VOLUME,
    api,
    drag,
    ends,
    expect,
    forget_lost,
    message,
    pair,
    settled,
)
from planish.register import fit_transform


@pytest.fixture
def shown(served, window):
    """The page on the small run, when its marks are there."""
    found = window(served)
    expect(found.role("table", "Marks").get_by_role("row")).to_have_count(6)
    return found


def value(shown, label):
    return shown.field(label).input_value()


def numbers(shown, label):
    return [float(word) for word in value(shown, label).split(",")]


def test_clicks_and_enter_set_pairs_where_they_are_a_drag_none_and_a_double_click_one(shown):
    shown.go(VOLUME, 500, 420, 2.0)
    pair(shown, (500.25, 420.5), (640.75, 610.5))
    assert ends(shown.rows())[-1] == pytest.approx([500.25, 420.5, 640.75, 610.5], abs=0.011)
    for view, at in ((VOLUME, (220.0, 260.0)), (IMAGE, (410.0, 380.0))):
        assert len(shown.rows()) == 6, "a mark with one end is no row"
        shown.go(view, *at)
        shown.role("application", view).press("Enter")
        expect(message(shown)).to_contain_text(view)
    expect(shown.role("table", "Marks").get_by_role("row")).to_have_count(8)
    assert ends(shown.rows())[-1] == pytest.approx([220, 260, 410, 380], abs=0.011)
    made = len(api(shown, "state")["marks"])
    shown.go(VOLUME, 30.0, 40.0, 1.0)
    x, y = shown.middle(VOLUME)
    before = value(shown, f"{VOLUME} centre, um")
    drag(shown.page, (x, y), (x + 40, y + 25))
    assert value(shown, f"{VOLUME} centre, um") != before
    shown.page.wait_for_timeout(400)
    assert len(api(shown, "state")["marks"]) == made
    shown.go(VOLUME, 30.0, 40.0, 1.0)
    shown.page.mouse.dblclick(*shown.middle(VOLUME))
    expect(shown.role("status", "Predicted")).to_contain_text(IMAGE)
    shown.page.wait_for_timeout(400)
    assert sum(mark["fixed"] is None for mark in api(shown, "state")["marks"]) == 1


def test_the_chosen_mark_is_moved_by_arrows_and_dragged_and_snapped_to_its_hole(shown):
    before = ends(settled(shown))
    label = shown.rows()[1][0]
    shown.role("button", label).click()
    shown.fill(f"{IMAGE}, um per screen pixel", "0.5")
    assert value(shown, f"{IMAGE}, um per screen pixel") == "0.5"
    assert value(shown, f"{VOLUME}, um per screen pixel") != "0.5"
    for key in ("ArrowRight", "Shift+ArrowDown"):
        shown.role("application", IMAGE).press(key)
        expect(message(shown)).to_contain_text("moved")
    expect(shown.role("table", "Marks")).to_contain_text(f"{before[1, 3] + 2.5:.2f}")
    moved = ends(shown.rows()) - before
    assert moved[1] == pytest.approx([0, 0, 0.5, 2.5], abs=0.011)

    shown.page.get_by_label("Move views together").uncheck()
    shown.go(VOLUME, *before[1, :2], 2.0)
    x, y = shown.middle(VOLUME)
    drag(shown.page, (x, y), (x + 20, y - 10))
    expect(message(shown)).to_contain_text("Mark moved. Saved.")
    expect(shown.role("table", "Marks")).not_to_contain_text(f"{before[1, 0]:.2f}")
    dragged = ends(shown.rows()) - before
    # The view may be turned.
    assert np.hypot(*dragged[1, :2]) == pytest.approx(np.hypot(40, 20), abs=0.03)
    assert (dragged[1, 2:] == moved[1, 2:]).all()
    assert (np.delete(dragged, 1, axis=0) == 0).all()

    shown.role("button", "Snap").click()
    expect(message(shown)).to_contain_text("snapped")
    assert ends(settled(shown)) == pytest.approx(before, abs=0.011)


def test_the_table_shows_the_fit_is_walked_through_and_has_a_wrong_mark_first_after_one_click(
    shown,
):
    names = [row[0] for row in settled(shown)]
    shown.role("button", "Next").click()
    shown.role("application", VOLUME).press("n")
    assert value(shown, "Label") == names[1]
    shown.role("button", "Previous").click()
    shown.role("button", "Previous").click()
    assert value(shown, "Label") == names[-1]
    assert numbers(shown, f"{VOLUME} centre, um") == pytest.approx(
        ends(shown.rows())[-1, :2], abs=0.011
    )
    shown.field("Model").select_option("similarity")
    expect(shown.page.get_by_text(re.compile("^5 pairs in use, residual .*rms"))).to_be_visible()
    rows = settled(shown)
    moving, fixed = ends(rows)[:, :2], ends(rows)[:, 2:]
    fit = fit_transform(moving, fixed, model="similarity", robust=False)
    assert [float(row[6]) for row in rows] == pytest.approx(
        np.hypot(*fit.residuals_um.T), abs=0.011
    )
    assert all(re.fullmatch(r"\d+\.\d\d", cell) for row in rows for cell in row[2:8])
    # Errors are coloured by the limit of the check.
    assert shown.page.locator("td.error.usual").count() >= len(rows)
    assert shown.page.locator("td.error.large, td.error.very").count() == 0

    shown.role("button", rows[2][0]).click()
    shown.fill(f"{IMAGE}, um per screen pixel", "2")
    for _ in range(6):
        shown.role("application", IMAGE).press("Shift+ArrowLeft")
    expect(shown.role("table", "Marks")).to_contain_text(f"{ends(rows)[2, 2] - 60:.2f}")
    shown.role("columnheader", "Leave-one-out um").click()
    assert settled(shown)[0][0] == rows[2][0]
    assert shown.role("columnheader", "Leave-one-out um").get_attribute("aria-sort") == "descending"
    expect(message(shown)).to_contain_text(rows[2][0])
    shown.role("columnheader", "Mark").click()
    assert [row[0] for row in shown.rows()] == sorted(row[0] for row in rows)


def test_changes_are_undone_and_redone_survive_a_reload_and_are_followed_by_another_window(
    shown, window
):
    first, second, *_ = settled(shown)
    twin = window(shown.server, context=shown.page.context)
    use_in_twin = twin.field(f"Use {first[0]}")
    expect(use_in_twin).to_be_checked()
    shown.field(f"Use {first[0]}").uncheck()
    expect(message(shown)).to_contain_text("not used")
    expect(use_in_twin).not_to_be_checked(timeout=2000)
    twin.page.close()
    shown.role("button", second[0]).click()
    shown.fill("Label", "corner")
    expect(shown.role("table", "Marks")).to_contain_text("corner")
    shown.role("button", "Delete").click()
    rows = shown.role("table", "Marks").get_by_role("row")
    expect(rows).to_have_count(5)
    for _ in range(3):
        shown.role("application", VOLUME).press("Control+z")
    expect(rows).to_have_count(6)
    expect(shown.role("button", "Undo")).to_be_disabled()
    assert settled(shown)[0][-1] == "True"
    shown.page.reload()
    expect(rows).to_have_count(6)
    assert "token" not in shown.page.url
    for _ in range(3):
        shown.role("application", VOLUME).press("Control+y")
    expect(rows).to_have_count(5)
    expect(shown.role("button", "Redo")).to_be_disabled()


@pytest.mark.skipif(
    not hasattr(signal, "SIGSTOP"), reason="needs a system on which a process can be halted"
)
def test_a_server_that_answers_again_is_found_and_marks_are_exported_and_imported(shown, tmp_path):
    rows = settled(shown)
    shown.server.process.send_signal(signal.SIGSTOP)
    alert = shown.page.get_by_role("alert")
    expect(alert).to_contain_text("No connection", timeout=2000)
    # As one that was started anew answers.
    shown.page.route("**/api/events", lambda route: route.fulfill(status=401))
    expect(alert).to_contain_text("Open the address")
    shown.page.unroute("**/api/events")
    shown.server.process.send_signal(signal.SIGCONT)
    expect(alert).to_be_hidden()
    expect(message(shown)).to_contain_text("back")

    with shown.page.expect_download() as download:
        shown.role("button", "Export marks").click()
    download.value.save_as(tmp_path / "given.json")
    assert json.loads((tmp_path / "given.json").read_text())
    shown.role("button", rows[0][0]).click()
    shown.role("button", "Delete").click()
    expect(shown.role("table", "Marks").get_by_role("row")).to_have_count(5)
    imported(shown, tmp_path / "given.json")
    expect(shown.role("table", "Marks").get_by_role("row")).to_have_count(6)
    assert ends(settled(shown)) == pytest.approx(ends(rows), abs=0.011)
    shown.role("button", "Undo").click()
    expect(shown.role("table", "Marks").get_by_role("row")).to_have_count(5)

    (tmp_path / "notes.json").write_text("[[[")
    imported(shown, tmp_path / "notes.json")
    expect(alert).not_to_be_empty()
    assert len(shown.rows()) == 4
    forget_lost(shown)


def imported(shown, path):
    with shown.page.expect_file_chooser() as chooser:
        shown.role("button", "Import marks").click()
    chooser.value.set_files(path)


def test_views_zoom_lie_over_each_other_move_together_and_keep_their_colours(shown, linked):
    rows = settled(shown)
    limits_leave_holes_out_and_are_moved_by_mouse_keys_and_numbers(shown, linked)
    shape = np.array(linked.image.shape) * float(linked.x[1] - linked.x[0])
    pixel, centre = f"{IMAGE}, um per screen pixel", f"{IMAGE} centre, um"
    for width, height in ((1366, 768), (1280, 700)):  # and while the window changes
        shown.page.set_viewport_size({"width": width, "height": height})
        shown.page.wait_for_timeout(500)
        box = shown.role("application", IMAGE).bounding_box()
        assert (shape <= numbers(shown, pixel)[0] * np.array([box["height"], box["width"]])).all()
    whole = numbers(shown, pixel)[0]
    wheel = shown.page.mouse.wheel
    shown.page.mouse.move(*shown.middle(IMAGE))
    wheel(0, -300)
    shown.page.wait_for_timeout(200)
    assert numbers(shown, pixel)[0] == whole  # the page would scroll
    shown.page.keyboard.down("Control")
    wheel(0, -300)
    shown.page.keyboard.up("Control")
    shown.page.wait_for_timeout(200)
    assert numbers(shown, pixel)[0] < 0.6 * whole
    shown.role("application", IMAGE).focus()
    for _ in range(40):
        wheel(0, 400)
    shown.page.wait_for_timeout(200)
    assert whole < numbers(shown, pixel)[0] < 10 * whole
    shown.role("button", f"{IMAGE}: show all").click()
    assert numbers(shown, pixel)[0] == pytest.approx(whole, rel=1e-3)

    shown.field("View").focus()
    shown.page.mouse.move(0, 0)
    shown.page.wait_for_timeout(500)
    view = shown.role("application", IMAGE)
    before = view.screenshot()
    for way in ("blend", "swipe", "blink", "checkerboard"):
        shown.field("View").select_option(way)
        expect(message(shown)).to_contain_text("similarity part")
        shown.page.wait_for_timeout(500)
        assert view.screenshot() != before, way
        shown.field("View").select_option("two")
        shown.page.wait_for_timeout(300)
        assert view.screenshot() == before, way

    moving, fixed = ends(rows)[0, :2], ends(rows)[0, 2:]
    shown.go(VOLUME, *moving, 1.5)
    at = numbers(shown, centre)
    assert at == pytest.approx(fixed, abs=20.0)
    shown.page.get_by_label("Move views together").uncheck()
    shown.go(VOLUME, *(moving + 100))
    assert numbers(shown, centre) == at
    # Without a choice arrows move the view and signs zoom.
    shown.go(IMAGE, 300.0, 200.0, 2.0)
    for key in ("ArrowRight", "Shift+ArrowUp"):
        view.press(key)
    expect(shown.field(centre)).to_have_value("302.00, 190.00")
    view.press("+")
    assert numbers(shown, pixel)[0] < 2.0
    view.press("?")  # all keys are listed
    expect(shown.page.get_by_role("dialog")).to_be_visible()
    shown.page.keyboard.press("Escape")
    expect(shown.page.get_by_role("dialog")).to_be_hidden()


def limits_leave_holes_out_and_are_moved_by_mouse_keys_and_numbers(shown, linked):
    label = f"{IMAGE} colour range"
    values = linked.image.values[linked.valid.values]
    wanted = np.percentile(values, [2, 98])
    expect(
        shown.page.get_by_role("img", name=re.compile(r"^Histogram of image: n \d+"))
    ).to_be_visible()
    found = numbers(shown, label)
    np.testing.assert_allclose(found, wanted, atol=0.05 * np.ptp(values))
    low = shown.role("slider", f"{label}, low")
    low.press("ArrowRight")
    moved = numbers(shown, label)[0]
    assert moved > found[0]
    box = low.bounding_box()
    at = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    drag(shown.page, at, (at[0] + 20, at[1]))
    assert numbers(shown, label)[0] > moved
    shown.role("button", f"{label}: auto").click()
    assert numbers(shown, label) == found
    shown.fill(label, "2, 1")
    expect(message(shown)).to_contain_text("A colour range is")


@pytest.mark.nightly
def test_a_run_that_is_only_read(serve, window, linked_run):
    shown = window(serve(linked_run, "--read-only"))
    rows = settled(shown)
    expect(shown.role("button", "Apply")).to_be_disabled()
    shown.field(f"Use {rows[0][0]}").click()
    expect(shown.field(f"Use {rows[0][0]}")).to_be_checked()
    expect(shown.page.get_by_role("alert")).to_contain_text("read-only")
