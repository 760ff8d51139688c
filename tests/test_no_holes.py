"""A sheet of fibres without holes, linked by its texture as a user would; and an image of another
sheet, refused."""

from __future__ import annotations

import shutil
from contextlib import closing, contextmanager

import numpy as np
import pytest

import planish as pl
from app.asgi import HOST, TOKEN, Client
from planish.app import Session, create_app
from planish.core.errors import CannotRegister
from planish.io import ImageParams

pytestmark = pytest.mark.ci


@pytest.fixture(scope="module")
def found(kinds):
    """The run of the shared specimen; where its pixels lie is in tests/test_kinds.py."""
    return pl.open_run(kinds("no-holes"))


@pytest.fixture(scope="module")
def files(kinds):
    return kinds.files("no-holes")


@pytest.fixture(scope="module")
def other_image(kinds):
    """The image of another sheet."""
    return kinds.files("demo").image


def test_checks_rest_on_the_search_and_r_is_held_out(found):
    states = {check.name: check.state for check in found.results.checks}
    assert (states["side and specimen"], states["position by texture"]) == ("pass", "unknown")
    facts = found.results.layers[0].registration
    assert (facts.source, facts.false_probability < 1e-6) == ("texture", True)
    assert facts.held_out.registration in ("refined (cross-fitted)", "refined (searched null)")
    assert 0.3 < facts.held_out.r < 0.95


def test_marks_are_tiles_and_a_run_by_them_is_that_of_the_search(found, kinds, files, tmp_path):
    registration = found.registrations["sheet"]
    registration.save(tmp_path / "marks.json")
    read = pl.Registration.read(tmp_path / "marks.json")
    assert set(read.marks["moving_source"].values) == {"tile"}
    np.testing.assert_allclose(read([[500.0, 400.0]]), registration([[500.0, 400.0]]), atol=1e-6)
    assert (read.fit.shared_um, read.false_probability) == (
        registration.fit.shared_um,
        registration.false_probability,
    )
    again = pl.link(
        kinds("no-holes"), files.image, registration={"marks": str(tmp_path / "marks.json")}
    )
    facts = again.results.layers[0].registration
    assert (facts.source, facts.false_probability) == ("texture", registration.false_probability)
    assert facts.held_out is not None
    share = [float(run.linked["valid"].mean()) for run in (found, again)]
    assert share[1] == pytest.approx(share[0], abs=0.01)
    errors = [run.results.layers[0].registration.expected_error.median_um for run in (found, again)]
    assert errors[1] == pytest.approx(errors[0], rel=0.02)


def test_holes_and_texture_are_fitted_in_one_and_compared(specimen, linked_run, specimen_files):
    run = pl.link(linked_run, specimen_files[1], registration={"by": "both"})
    facts = run.results.layers[0].registration
    marks = run.registrations[run.results.layers[0].name].marks
    assert facts.source == "both"
    assert {"tile", "detected"} <= set(marks["moving_source"].values)
    check = next(check for check in run.results.checks if check.name == "position by texture")
    assert check.state == "pass"
    assert check.value < check.limit
    maps, truth = run.linked, specimen.truth
    off_um = np.hypot(
        maps["volume_x"] - truth["volume_x"], maps["volume_y"] - truth["volume_y"]
    ).values
    assert np.median(off_um[maps["valid"].values]) < 1.0


@pytest.fixture
def mapped(kinds, tmp_path):
    """The maps of a sheet with holes, which do not count; what is edited is kept there."""
    return shutil.copytree(kinds("other-map"), tmp_path / "maps")


@contextmanager
def opened(mapped, image):
    with closing(Session.open(mapped, ImageParams(path=str(image)))) as session:
        client = Client(create_app(session, token=TOKEN, hosts=(HOST,)))
        yield session, client
        client.app.state.served.applying.close()


def test_the_app_finds_the_texture_everywhere_and_about_a_place(kinds, mapped):
    with opened(mapped, kinds.other.image) as (session, client):
        for near in (None, kinds.specimen("other").pose([[0.0, 0.0]])[0].tolist()):
            found = client.post("/api/marks/texture", {"near": near})
            assert found.status == 200
            assert "Found by texture" in found.json()["said"]
            assert {mark["source"] for mark in found.json()["marks"]} == {"tile"}
        far = client.post("/api/marks/texture", {"near": [-3000.0, 0.0]})
        assert far.status == 400
        place = found.json()["fit"]["transform"]
        given = client.post("/api/marks/texture", {"place": place})
        assert given.json()["said"].startswith("The place was given; ")
        assert len(given.json()["marks"]) >= 4
        session.undo()


def test_the_app_offers_the_best_places_where_none_is_sure(mapped, other_image):
    with opened(mapped, other_image) as (session, client):
        refused = client.post("/api/marks/texture", {})
        places = refused.json()["places"]
        assert (refused.status, len(places) > 2, session.can_undo) == (400, True, False)
        assert places[0]["text"] in refused.json()["error"]
        chosen = client.post("/api/marks/texture", {"place": places[0]["place"]})
        assert (chosen.status, "4 are needed" in chosen.json()["error"]) == (400, True)


@pytest.mark.parametrize(
    ("by", "words"), [("texture", "stands out by its texture"), ("holes", "No hole found")]
)
def test_an_image_of_another_sheet_is_refused(kinds, other_image, by, words):
    with pytest.raises(CannotRegister, match=words):
        pl.link(kinds("no-holes"), other_image, registration={"by": by})
