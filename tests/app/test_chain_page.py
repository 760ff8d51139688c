"""Layers in a chain: the marks of each stand on the plane of the next one, not on that of the reference."""

from pathlib import Path

import numpy as np
import pytest
import tifffile

from app.marks_page import api, expect, settled
from planish.app import Pictures, Session, snap

pytestmark = pytest.mark.nightly

MORE = (60, 90)
"""Rows and columns that the reference has above and left of the image before it."""


@pytest.fixture(scope="module")
def chained(linked_run, specimen_files, tmp_path_factory) -> Path:
    """A sheet, its image, and the same image with a wider border as reference."""
    from planish.cli import main

    folder = tmp_path_factory.mktemp("chained")
    image = specimen_files[1]
    with tifffile.TiffFile(image) as file:
        page = file.pages.first
        tags = {"resolution": (page.tags["XResolution"].value, page.tags["YResolution"].value)}
        wider, unit = np.pad(page.asarray(), [(n, 0) for n in MORE], mode="edge"), page.tags["ResolutionUnit"].value
    tifffile.imwrite(folder / "wider.tif", wider, resolutionunit=unit, **tags)
    layers = [f"a={linked_run}", f"b={image}", f"c={folder / 'wider.tif'}"]
    with pytest.raises(SystemExit) as end:
        main(["link", *layers, "--chain", "--out", str(folder / "run")])
    assert end.value.code in (0, 4)
    return folder / "run"


def test_a_hole_is_searched_on_the_plane_of_the_next_layer(chained, monkeypatch):
    session = Session.open(chained, read_only=True)
    try:
        pictures = Pictures.of(chained)
        marks = [mark for mark in session.state.of("a") if mark.moving and mark.fixed]
        assert session.shown_by("a", "fixed") == ("moving", "b")
        assert session.shown_by("b", "fixed") == ("fixed", "c")
        monkeypatch.setattr(Session, "holes", lambda *_: {"moving": None, "fixed": None})
        for mark in marks:
            found = snap.hole_at(session, "a", "fixed", mark.fixed.xy)
            assert found is not None
            np.testing.assert_allclose(found.xy, mark.fixed.xy, atol=2.0)
        pixel = pictures.on("moving", "b")[0].grid.pixel_um
        same = {mark.label: mark for mark in session.state.of("b")}
        shift = np.array([np.subtract(mark.moving.xy, mark.fixed.xy) for mark in same.values()])
        np.testing.assert_allclose(
            shift, np.tile([-MORE[1] * pixel[1], -MORE[0] * pixel[0]], (len(shift), 1)), atol=2.0
        )
    finally:
        session.close()


def test_the_image_side_shows_the_next_layer(chained, serve, window):
    shown = window(serve(chained, "--read-only"))
    settled(shown)
    places = {picture["id"]: (picture["plane"], picture["layer"]) for picture in api(shown, "session")["pictures"]}
    box = shown.page.get_by_label("Image side shows", exact=True)
    assert places[box.input_value()] == ("moving", "b")
    shown.page.get_by_label("Layer", exact=True).select_option("b")
    # Two images: panes are called by their layers, and each shows its own.
    expect(shown.page.get_by_label("b shows", exact=True)).to_have_value(
        next(k for k, place in places.items() if place == ("moving", "b"))
    )
    box = shown.page.get_by_label("c shows", exact=True)
    assert places[box.input_value()] == ("fixed", "c")
    for name in ("b x um", "c y um"):
        assert shown.role("columnheader", name).is_visible()
