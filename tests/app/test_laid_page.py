"""The tabs on a sheet through y whose top is at the low end, with an image of its bottom: each in
the sheet's frame."""

import re

from app.marks_page import expect, settled
from app.test_maps_page import RIGHT, cursor_gives_the_pixel
from app.test_surfaces_page import Shown, face_lies_on_the_top
from planish.run import open_run


def test_every_tab_shows_a_sheet_in_its_own_frame(kinds, serve, window):
    run = kinds("laid")
    shown = window(serve(run, "--read-only"))
    settled(shown)

    tab = Shown(shown, run)
    assert (tab.frame.rows, tab.frame.through, tab.frame.sign) == ("z", "y", -1.0)
    face_lies_on_the_top(tab)

    shown.role("tab", "Maps").click()
    expect(shown.page.get_by_text(re.compile("Scatter of [0-9]+ points"))).to_be_visible()
    left = shown.field("Left layer").input_value()
    assert (left, shown.field("Right layer").input_value()) == ("coating_bottom", RIGHT)
    cursor_gives_the_pixel(shown, open_run(run).linked, left)

    shown.role("tab", "Flattening").click()
    expect(shown.role("img", "Sheet in space")).to_have_attribute("data-detail", "full")
    expect(shown.role("application", "Flat sheet")).to_be_visible()
    expect(shown.page.get_by_role("alert")).to_be_hidden()
