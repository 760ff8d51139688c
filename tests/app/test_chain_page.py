"""Layers in a chain: the marks of each stand on the plane of the next one, not on that of the
reference."""

import re

import numpy as np
import pytest

from app.marks_page import api, expect, settled
from planish.app import Session, snap


def test_a_hole_is_searched_on_the_plane_of_the_next_layer(kinds, monkeypatch):
    session = Session.open(kinds("chain"), read_only=True)
    assert session.shown_by("ct", "fixed") == ("moving", "near")
    assert session.shown_by("near", "fixed") == ("fixed", "far")
    marks = session.state.of("ct")
    assert len(marks) >= 4
    monkeypatch.setattr(Session, "holes", lambda *_: {"moving": None, "fixed": None})
    for mark in marks:
        found = snap.hole_at(session, "ct", "fixed", mark.fixed.xy)
        np.testing.assert_allclose(found.xy, mark.fixed.xy, atol=2.0)


@pytest.mark.nightly
def test_the_image_side_shows_the_next_layer(kinds, serve, window):
    shown = window(serve(kinds("chain"), "--read-only"))
    settled(shown)
    places = {
        picture["id"]: (picture["plane"], picture["layer"])
        for picture in api(shown, "session")["pictures"]
    }
    box = shown.field("Image side shows")
    assert places[box.input_value()] == ("moving", "near")
    shown.field("Layer").select_option("near")
    # Two images: panes are called by their layers, and each shows its own.
    for name, place in (("near", ("moving", "near")), ("far", ("fixed", "far"))):
        box = shown.field(f"{name} shows")
        expect(box).to_have_value(next(k for k, one in places.items() if one == place))
    for name in ("near x um", "far y um"):
        assert shown.role("columnheader", name).is_visible()
    shown.role("tab", "Maps").click()
    expect(shown.page.get_by_text(re.compile("Scatter of [0-9]+ points"))).to_be_visible()
