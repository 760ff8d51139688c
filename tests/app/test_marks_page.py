"""The tab Marks in a real browser: clicks, keys, the table, undo, files, other windows and a lost server."""

import json
import re
import signal

import numpy as np
import pytest

from app.marks_page import IMAGE, VOLUME, api, drag, ends, expect, forget_lost, message, settled
from planish.register import fit_transform

pytestmark = pytest.mark.nightly


def opened(window, server):
    """The page of a server, when the marks of the small run are there."""
    found = window(server)
    expect(found.role("table", "Marks").get_by_role("row")).to_have_count(6)
    return found


@pytest.fixture
def shown(served, window):
    """The page on the small run."""
    return opened(window, served)


@pytest.fixture
def shown_alone(serve, run_copy, window):
    """The page of a server that a test may end."""
    return opened(window, serve(run_copy))


def test_the_table_shows_the_fit_of_the_run_and_is_walked_through(shown):
    names = [row[0] for row in settled(shown)]
    shown.role("button", "Next").click()
    shown.role("application", VOLUME).press("n")
    assert shown.page.get_by_label("Label", exact=True).input_value() == names[1]
    shown.role("button", "Previous").click()
    shown.role("button", "Previous").click()
    assert shown.page.get_by_label("Label", exact=True).input_value() == names[-1]
    at = [float(v) for v in shown.page.get_by_label(f"{VOLUME} centre, um", exact=True).input_value().split(",")]
    assert at == pytest.approx(ends(shown.rows())[-1, :2], abs=0.011)
    shown.page.get_by_label("Model", exact=True).select_option("similarity")
    expect(shown.page.get_by_text(re.compile("^5 pairs in use, residual .*rms"))).to_be_visible()
    rows = settled(shown)
    moving, fixed = ends(rows)[:, :2], ends(rows)[:, 2:]
    fit = fit_transform(moving, fixed, model="similarity", robust=False)
    assert [float(row[6]) for row in rows] == pytest.approx(np.hypot(*fit.residuals_um.T), abs=0.011)
    assert all(re.fullmatch(r"\d+\.\d\d", cell) for row in rows for cell in row[2:8])


def test_two_clicks_make_a_pair_where_they_were_clicked(shown):
    shown.click(VOLUME, 500.25, 420.5, pixel_um=2.0)
    expect(shown.role("status", "Predicted")).to_contain_text(IMAGE)
    assert len(shown.rows()) == 5, "a mark with one end is no row"
    shown.click(IMAGE, 640.75, 610.5)
    expect(shown.role("table", "Marks").get_by_role("row")).to_have_count(7)
    assert ends(shown.rows())[-1] == pytest.approx([500.25, 420.5, 640.75, 610.5], abs=0.011)
    expect(message(shown)).to_contain_text("Saved")


def test_a_drag_makes_no_mark_and_a_double_click_one(shown):
    x, y = shown.middle(VOLUME)
    before = shown.page.get_by_label(f"{VOLUME} centre, um", exact=True).input_value()
    drag(shown.page, (x, y), (x + 40, y + 25))
    assert shown.page.get_by_label(f"{VOLUME} centre, um", exact=True).input_value() != before
    expect(shown.role("button", "Undo")).to_be_disabled()
    shown.go(VOLUME, 30.0, 40.0, 1.0)
    shown.page.mouse.dblclick(*shown.middle(VOLUME))
    expect(shown.role("button", "Undo")).to_be_enabled()
    shown.page.wait_for_timeout(400)
    assert sum(mark["fixed"] is None for mark in api(shown, "state")["marks"]) == 1


def test_views_move_together(shown):
    rows = settled(shown)
    moving, fixed = ends(rows)[0, :2], ends(rows)[0, 2:]
    shown.go(VOLUME, *moving, 1.5)
    at = [float(v) for v in shown.page.get_by_label(f"{IMAGE} centre, um", exact=True).input_value().split(",")]
    assert at == pytest.approx(fixed, abs=20.0)
    shown.page.get_by_label("Move views together").uncheck()
    shown.go(VOLUME, *(moving + 100))
    still = [float(v) for v in shown.page.get_by_label(f"{IMAGE} centre, um", exact=True).input_value().split(",")]
    assert still == at


def test_arrows_move_the_chosen_mark_by_screen_pixels(shown):
    before = ends(settled(shown))
    shown.role("button", shown.rows()[1][0]).click()
    shown.fill(f"{IMAGE}, um per screen pixel", "0.5")
    pixel = float(shown.page.get_by_label(f"{IMAGE}, um per screen pixel", exact=True).input_value())
    turned = shown.page.get_by_label(f"{VOLUME}, um per screen pixel", exact=True).input_value()
    assert pixel == 0.5
    assert turned != "0.5"
    view = shown.role("application", IMAGE)
    for key in ("ArrowRight", "Shift+ArrowDown"):
        view.press(key)
        expect(message(shown)).to_contain_text("moved")
    expect(shown.role("table", "Marks")).to_contain_text(f"{before[1, 3] + 2.5:.2f}")
    moved = ends(shown.rows()) - before
    assert moved[1] == pytest.approx([0, 0, 0.5, 2.5], abs=0.011)
    assert np.delete(moved, 1, axis=0) == pytest.approx(0)


def test_the_chosen_mark_is_dragged(shown):
    before = ends(settled(shown))
    shown.page.get_by_label("Move views together").uncheck()
    shown.role("button", shown.rows()[1][0]).click()
    shown.go(VOLUME, *before[1, :2], 2.0)
    x, y = shown.middle(VOLUME)
    drag(shown.page, (x, y), (x + 20, y - 10))
    expect(message(shown)).to_contain_text("Mark moved. Saved.")
    moved = ends(shown.rows()) - before
    assert np.hypot(*moved[1, :2]) == pytest.approx(np.hypot(40, 20), abs=0.03)  # the view may be turned
    assert (moved[1, 2:] == 0).all()
    assert (np.delete(moved, 1, axis=0) == 0).all()


def test_without_a_choice_arrows_move_the_view_and_signs_zoom(shown):
    shown.go(IMAGE, 300.0, 200.0, 2.0)
    view = shown.role("application", IMAGE)
    view.press("ArrowRight")
    view.press("Shift+ArrowUp")
    expect(shown.page.get_by_label(f"{IMAGE} centre, um", exact=True)).to_have_value("302.00, 190.00")
    view.press("+")
    assert float(shown.page.get_by_label(f"{IMAGE}, um per screen pixel", exact=True).input_value()) < 2.0


def test_exclude_relabel_delete_undo_redo_and_reload(shown):
    first, second, *_ = settled(shown)
    shown.page.get_by_label(f"Use {first[0]}", exact=True).uncheck()
    expect(message(shown)).to_contain_text("not used")
    shown.role("button", second[0]).click()
    shown.fill("Label", "corner")
    expect(shown.role("table", "Marks")).to_contain_text("corner")
    shown.role("button", "Delete").click()
    expect(shown.role("table", "Marks").get_by_role("row")).to_have_count(5)
    for _ in range(3):
        shown.role("application", VOLUME).press("Control+z")
    expect(shown.role("table", "Marks").get_by_role("row")).to_have_count(6)
    expect(shown.role("button", "Undo")).to_be_disabled()
    assert settled(shown)[0][-1] == "True"
    shown.page.reload()
    expect(shown.role("table", "Marks").get_by_role("row")).to_have_count(6)
    assert "token" not in shown.page.url
    for _ in range(3):
        shown.role("application", VOLUME).press("Control+y")
    expect(shown.role("table", "Marks").get_by_role("row")).to_have_count(5)
    expect(shown.role("button", "Redo")).to_be_disabled()


def test_a_wrong_mark_stands_first_after_one_click_and_is_named(shown):
    rows = settled(shown)
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


def test_marks_are_exported_imported_and_undone_and_another_file_is_refused(shown, tmp_path):
    rows = settled(shown)
    with shown.page.expect_download() as download:
        shown.role("button", "Export marks").click()
    download.value.save_as(tmp_path / "given.json")
    assert json.loads((tmp_path / "given.json").read_text())
    shown.role("button", rows[0][0]).click()
    shown.role("button", "Delete").click()
    expect(shown.role("table", "Marks").get_by_role("row")).to_have_count(5)
    with shown.page.expect_file_chooser() as chooser:
        shown.role("button", "Import marks").click()
    chooser.value.set_files(tmp_path / "given.json")
    expect(shown.role("table", "Marks").get_by_role("row")).to_have_count(6)
    assert ends(settled(shown)) == pytest.approx(ends(rows), abs=0.011)
    shown.role("button", "Undo").click()
    expect(shown.role("table", "Marks").get_by_role("row")).to_have_count(5)

    (tmp_path / "notes.json").write_text("[[[")
    with shown.page.expect_file_chooser() as chooser:
        shown.role("button", "Import marks").click()
    chooser.value.set_files(tmp_path / "notes.json")
    expect(shown.page.get_by_role("alert")).not_to_be_empty()
    assert len(shown.rows()) == 4
    forget_lost(shown)


def test_a_clicked_mark_is_snapped_to_its_hole(shown):
    rows = settled(shown)
    found = ends(rows)[0]
    shown.role("button", rows[0][0]).click()
    shown.fill(f"{IMAGE}, um per screen pixel", "2")
    for key in ("Shift+ArrowRight", "ArrowDown", "ArrowDown"):
        shown.role("application", IMAGE).press(key)
    expect(shown.role("table", "Marks")).to_contain_text(f"{found[3] + 4:.2f}")
    shown.role("button", "Snap").click()
    expect(message(shown)).to_contain_text("snapped")
    assert ends(shown.rows())[0] == pytest.approx(found, abs=1.0)


@pytest.mark.parametrize("way", ["blend", "swipe", "blink", "checkerboard"])
def test_pictures_are_laid_over_each_other(shown, way):
    settled(shown)
    view = shown.role("application", IMAGE)
    shown.page.wait_for_timeout(500)
    before = view.screenshot()
    shown.page.get_by_label("View", exact=True).select_option(way)
    expect(message(shown)).to_contain_text("similarity part")
    shown.page.wait_for_timeout(500)
    assert view.screenshot() != before
    shown.page.get_by_label("View", exact=True).select_option("two")
    shown.page.wait_for_timeout(300)
    assert view.screenshot() == before


def test_another_window_follows(shown, window):
    twin = window(shown.server, context=shown.page.context)
    rows = settled(twin)
    shown.page.get_by_label(f"Use {rows[0][0]}", exact=True).uncheck()
    expect(twin.page.get_by_label(f"Use {rows[0][0]}", exact=True)).not_to_be_checked(timeout=2000)


def test_a_lost_server_is_said_and_found_again(shown_alone, serve, run_copy):
    shown = shown_alone
    rows = settled(shown)
    shown.server.kill()
    expect(shown.page.get_by_role("alert")).to_contain_text("connection", timeout=2000)
    shown.page.get_by_label(f"Use {rows[0][0]}", exact=True).click()
    expect(shown.page.get_by_label(f"Use {rows[0][0]}", exact=True)).to_be_checked()
    shown.server = serve(run_copy, "--port", str(shown.server.port))
    expect(shown.page.get_by_role("alert")).to_contain_text("address")
    shown.page.goto(shown.server.url)  # another token in the fragment: the page loads itself anew
    expect(shown.page.get_by_role("alert")).to_be_hidden()
    expect(shown.role("table", "Marks").get_by_role("row")).to_have_count(6)
    forget_lost(shown)


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="needs a system on which a process can be halted")
def test_a_server_that_answers_again_is_found(shown_alone):
    shown = shown_alone
    rows = settled(shown)
    shown.server.process.send_signal(signal.SIGSTOP)
    expect(shown.page.get_by_role("alert")).to_contain_text("connection", timeout=2000)
    shown.server.process.send_signal(signal.SIGCONT)
    expect(shown.page.get_by_role("alert")).to_be_hidden()
    expect(message(shown)).to_contain_text("back")
    shown.page.get_by_label(f"Use {rows[0][0]}", exact=True).uncheck()
    expect(message(shown)).to_contain_text("Saved")
    forget_lost(shown)


def test_a_run_that_is_only_read(serve, window, run_copy):
    shown = window(serve(run_copy, "--read-only"))
    rows = settled(shown)
    expect(shown.role("button", "Apply")).to_be_disabled()
    shown.page.get_by_label(f"Use {rows[0][0]}", exact=True).click()
    expect(shown.page.get_by_label(f"Use {rows[0][0]}", exact=True)).to_be_checked()
    expect(shown.page.get_by_role("alert")).to_contain_text("read-only")
