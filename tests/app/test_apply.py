"""Apply: what a session changed becomes a run of its own, and nothing else is done again."""

from __future__ import annotations

import json
import os
import shutil
import time
from contextlib import contextmanager

import pytest

from planish.app.apply import STAGED, Before, order_of, place_of
from planish.app.changes import change_of
from planish.app.session import Session
from planish.core.results import Results
from planish.pipeline import open_run, run_study
from planish.study import read_study

UNCHANGED = ("surfaces", "flat", "strain", "maps", "slices", "overviews/maps")


@pytest.fixture
def run(linked_run, specimen_files, tmp_path):
    """The small link beside its files, to be worked on."""
    shutil.copytree(linked_run, tmp_path / "made" / "run")
    at_home(linked_run, tmp_path / "made" / "run")
    return tmp_path / "made" / "run"


def at_home(old, new):
    """Let the study of a copied run find its files."""
    from planish import __version__
    from planish.study import write_study

    write_study(read_study(old / "run.toml"), new, home=new, version=__version__)


@contextmanager
def opened(run, image=None, **more):
    session = Session.open(run, image, **more)
    try:
        yield session
    finally:
        session.close()


def do(session, **change):
    return session.change(change_of(json.dumps(change)))


def ordered(session):
    return order_of(Before.of(session), session.state, session.folder / STAGED)


def made(session):
    """Apply in this process: the new run."""
    order, staged = ordered(session), session.folder / STAGED
    out = place_of(session.folder, linked=session.image_params is not None)
    staged.mkdir(parents=True, exist_ok=True)
    for name, text in order.files.items():
        (staged / name).write_text(text)
    run_study(order.study, out, old=session.folder)
    shutil.rmtree(staged)
    return out


def bytes_of(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def held(run, group):
    return bytes_of(run / "maps.zarr" / group)


def wait_for(done, seconds=60.0):
    end = time.monotonic() + seconds
    while not (found := done()):
        assert time.monotonic() < end
        time.sleep(0.02)
    return found


# --- the study -------------------------------------------------------------------------------------------------------


def test_a_session_without_a_change_is_the_study_of_its_run(run):
    with opened(run) as session:
        order = ordered(session)
    assert (order.study, order.files) == (read_study(run / "run.toml"), {})


def test_a_change_that_was_taken_back_is_none(run):
    with opened(run) as session:
        mark = session.state.of(None)[0]
        do(session, do="use", id=mark.id, used=False)
        session.undo()
        assert ordered(session).files == {}


def test_a_model_does_not_freeze_the_marks(run):
    with opened(run) as session:
        do(session, do="model", model="similarity")
        order = ordered(session)
    assert order.files == {}
    assert order.study.registration.model == "similarity"
    assert order.study.registration.marks is None


def test_marks_keep_what_is_known_of_them(run):
    """An end that did not move keeps covariance, diameter and source; a moved one is a person's; the hole is masked."""
    before = json.loads((run / "marks.json").read_text())["marks"]
    with opened(run) as session:
        first, second, third, *_ = session.state.of(None)
        x, y = first.fixed.xy
        do(session, do="move", id=first.id, fixed=[x + 3.0, y])
        do(session, do="use", id=second.id, used=False)
        do(session, do="delete", id=third.id)
        do(session, do="add", label="mine", moving=[333.0, 222.0])
        order = ordered(session)
    marks = {one["label"]: one for one in json.loads(order.files["marks.json"])["marks"]}
    old = {one["label"]: one for one in before}
    moved = marks[first.label]["at"]
    assert moved["moving"] == old[first.label]["at"]["moving"]
    assert moved["fixed"] == {
        "x": x + 3.0, "y": y, "source": "clicked", "diameter_um": old[first.label]["at"]["fixed"]["diameter_um"],
    }  # fmt: skip
    assert marks[second.label]["used"] is False
    assert marks[second.label]["at"] == old[second.label]["at"]
    assert marks["mine"]["at"] == {"moving": {"x": 333.0, "y": 222.0, "source": "clicked", "diameter_um": 200.0}}
    assert third.label not in marks
    for side in ("moving", "fixed"):  # what was burnt is still there
        alone = [one["at"] for one in marks.values() if one["at"].keys() == {side} and one["label"] != "mine"]
        assert alone == [{side: old[third.label]["at"][side]}]
    assert order.study.registration.marks == str(run / STAGED / "marks.json")


def test_labels_of_holes_without_a_mark_are_their_own(run):
    with opened(run) as session:
        first, second, *_ = session.state.of(None)
        do(session, do="delete", id=second.id)
        do(session, do="label", id=first.id, label="fixed 1")
        labels = [one["label"] for one in json.loads(ordered(session).files["marks.json"])["marks"]]
    assert len(labels) == len(set(labels))
    assert {"fixed 1", "fixed 2", "moving 1"} <= set(labels)


def test_regions_stand_in_the_order_as_they_were_drawn(run):
    with opened(run) as session:
        corners = [[300.0, 300.0], [500.0, 300.0], [500.0, 450.0]]
        do(session, do="region", name="spot", author="A", reason="grease", polygon=corners)
        order = ordered(session)
    (feature,) = json.loads(order.files["regions.geojson"])["features"]
    assert feature["properties"] == {"name": "spot", "author": "A", "reason": "grease"}
    assert feature["geometry"]["coordinates"] == [[*corners, corners[0]]]
    assert order.study.correlate.regions == str(run / STAGED / "regions.geojson")
    assert order.study.registration.marks is None


@pytest.mark.parametrize(
    ("name", "linked", "there", "wanted"),
    [
        ("run", False, [], "run-2"), ("run", False, ["run-2"], "run-3"), ("run-map", True, [], "run"),
        ("run-map-2", True, ["run"], "run-2"), ("sheet", True, [], "sheet-2"), ("-map", True, [], "-map-2"),
    ],
)  # fmt: skip
def test_the_new_run_stands_beside_the_old_one(tmp_path, name, linked, there, wanted):
    for folder in (name, *there):
        (tmp_path / folder).mkdir()
    assert place_of(tmp_path / name, linked=linked) == tmp_path / wanted


# --- the run ---------------------------------------------------------------------------------------------------------


def test_without_a_change_every_number_is_the_same(run):
    with opened(run) as session:
        out = made(session)
    assert out == run.with_name("run-2")
    old, new = bytes_of(run), bytes_of(out)
    assert {name for name in old | new if old.get(name) != new.get(name)} <= {"edits/.lock"}


def test_one_mark_less_leaves_the_sheet_as_it_is(planish, run):
    """The groups of the sheet keep their bytes; the study of the new run gives its bytes again, from its own marks."""
    with opened(run) as session:
        do(session, do="use", id=session.state.of(None)[0].id, used=False)
        out = made(session)
    for group in UNCHANGED:
        assert held(out, group) == held(run, group), group
    same = [os.path.samefile(p, out / "maps.zarr" / p.relative_to(run / "maps.zarr"))
            for p in (run / "maps.zarr" / "maps").rglob("c/*/*")]  # fmt: skip
    assert same
    assert all(same)
    old, new = Results.read(run / "results.json"), Results.read(out / "results.json")
    assert new.layers[0].sheet == old.layers[0].sheet
    assert new.layers[0].registration.matched == old.layers[0].registration.matched - 1
    assert 'marks = "marks.json"' in (out / "run.toml").read_text()
    shutil.rmtree(run)  # the new one stands by itself
    code, _, err = planish("run", out / "run.toml")
    assert (code in (0, 4), f"same bytes as {out}" in err) == (True, True), err


@pytest.mark.study
def test_regions_and_a_model_give_a_run_that_repeats_itself(planish, run):
    with opened(run) as session:
        do(session, do="model", model="similarity")
        do(session, do="region", name="spot", polygon=[[300.0, 300.0], [600.0, 300.0], [600.0, 550.0]])
        out = made(session)
        do(session, do="move", id=session.state.of(None)[0].id, fixed=[290.0, 300.0])
    assert "marks =" not in (out / "run.toml").read_text()
    assert open_run(out).results.layers[0].registration.model == "similarity"
    assert open_run(out).results.regions.count == 1
    with opened(out) as session:
        do(session, do="use", id=session.state.of(None)[0].id, used=False)
        third = made(session)
    assert third == run.with_name("run-2-2")
    assert open_run(third).results.regions.count == 1
    for one in (out, third):
        code, _, err = planish("run", one / "run.toml", "--out", one.with_name("again"))
        assert (code in (0, 4), f"same bytes as {one}" in err) == (True, True), err
        shutil.rmtree(one.with_name("again"))


@pytest.mark.study
def test_a_sheet_seen_from_its_low_end_is_applied_in_its_own_frame(planish, laid, tmp_path):
    code, _, err = planish("link", laid.volume, laid.image, "-o", tmp_path / "run", *laid.options)
    assert code in (0, 4), err
    run = tmp_path / "run"
    with opened(run) as session:
        do(session, do="use", id=session.state.of(None)[-1].id, used=False)
        out = made(session)
    for group in UNCHANGED:
        assert held(out, group) == held(run, group), group
    fits = [one.registrations["sheet"].fit for one in map(open_run, (run, out))]
    assert fits[0].transform.mirrored == fits[1].transform.mirrored
    assert fits[1].transform.scale == pytest.approx(fits[0].transform.scale, abs=0.02)
    code, _, err = planish("run", out / "run.toml")
    assert (code in (0, 4), f"same bytes as {out}" in err) == (True, True), err
