"""Apply: what a session changed becomes a run of its own, and nothing else is done again."""

import json
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from app.asgi import HOST, TOKEN, Client
from folders import bytes_of
from planish.app import Session, changes, create_app
from planish.app import order as orders
from planish.app.apply import Applying, Busy
from planish.io.params import ImageParams
from planish.results import Results
from planish.run import open_run, read_study, run_study

UNCHANGED = ("surfaces", "flat", "strain", "maps", "slices", "overviews/maps")


@pytest.fixture
def run(linked_run, tmp_path):
    """The small link beside its files, with a study that leads to them; to be worked on."""
    from planish import __version__
    from planish.run import write_study

    folder = Path(shutil.copytree(linked_run, tmp_path / "made" / "run"))
    write_study(read_study(linked_run / "run.toml"), folder, home=folder, version=__version__)
    return folder


@contextmanager
def opened(run, image=None, **more):
    session = Session.open(run, image, **more)
    try:
        yield session
    finally:
        session.close()


def do(session, **change):
    return session.change(changes.change_of(json.dumps(change)))


def ordered(session):
    study, files = orders.order_of(session, session.folder / orders.STAGING)
    return SimpleNamespace(study=study, files=files)


def made(session):
    """Apply in this process: the new run."""
    order, staged = ordered(session), session.folder / orders.STAGING
    out = orders.new_run_folder(session.folder, linked=session.image_params is not None)
    staged.mkdir(parents=True, exist_ok=True)
    for name, text in order.files.items():
        (staged / name).write_text(text)
    run_study(order.study, out, old=session.folder)
    shutil.rmtree(staged)
    return out


def held(run, group):
    return bytes_of(run / "maps.zarr" / group)


def wait_for(done, seconds=60.0):
    end = time.monotonic() + seconds
    while not (found := done()):
        assert time.monotonic() < end
        time.sleep(0.02)
    return found


# --- the study -------------------------------------------------------------------------------------------------------
def test_a_session_without_changes_or_with_them_undone_is_the_study_of_its_run(run):
    with opened(run) as session:
        order = ordered(session)
        do(session, do="use", id=session.state.of(None)[0].id, used=False)
        session.undo()
        assert ordered(session).files == {}
    assert (order.study, order.files) == (read_study(run / "run.toml"), {})


def test_models_do_not_freeze_marks_and_labels_of_holes_are_their_own(run):
    with opened(run) as session:
        do(session, do="model", model="similarity")
        order = ordered(session)
    assert (order.files, order.study.registration.model) == ({}, "similarity")
    assert order.study.registration.marks is None
    with opened(run) as session:
        first, second, *_ = session.state.of(None)
        do(session, do="delete", id=second.id)
        do(session, do="label", id=first.id, label="fixed 1")
        labels = [one["label"] for one in json.loads(ordered(session).files["marks.json"])["marks"]]
    assert len(labels) == len(set(labels))
    assert {"fixed 1", "fixed 2", "moving 1"} <= set(labels)


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
    assert order.study.registration.marks == str(run / orders.STAGING / "marks.json")


def test_regions_stand_in_the_order_as_they_were_drawn(run):
    with opened(run) as session:
        corners = [[300.0, 300.0], [500.0, 300.0], [500.0, 450.0]]
        do(session, do="region", name="spot", author="A", reason="grease", polygon=corners)
        order = ordered(session)
    (feature,) = json.loads(order.files["regions.geojson"])["features"]
    assert feature["properties"] == {"name": "spot", "author": "A", "reason": "grease"}
    assert feature["geometry"]["coordinates"] == [[*corners, corners[0]]]
    assert order.study.correlate.regions == str(run / orders.STAGING / "regions.geojson")
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
    assert orders.new_run_folder(tmp_path / name, linked=linked) == tmp_path / wanted


# --- the run ---------------------------------------------------------------------------------------------------------
@pytest.mark.nightly
def test_without_a_change_every_number_is_the_same(run):
    with opened(run) as session:
        out = made(session)
    assert out == run.with_name("run-2")
    old, new = bytes_of(run), bytes_of(out)
    assert {name for name in old | new if old.get(name) != new.get(name)} <= {"edits/.lock"}


def test_one_mark_less_leaves_the_sheet_as_it_is(run):
    with opened(run) as session:
        do(session, do="use", id=session.state.of(None)[0].id, used=False)
        out = made(session)
    for group in UNCHANGED:
        assert held(out, group) == held(run, group), group
    store, chunks = out / "maps.zarr", (run / "maps.zarr" / "maps").rglob("c/*/*")
    same = [chunk.samefile(store / chunk.relative_to(run / "maps.zarr")) for chunk in chunks]
    assert same
    assert all(same)
    old, new = Results.read(run / "results.json"), Results.read(out / "results.json")
    assert new.layers[0].sheet == old.layers[0].sheet
    assert new.layers[0].registration.matched == old.layers[0].registration.matched - 1
    assert 'marks = "marks.json"' in (out / "run.toml").read_text()


@pytest.mark.nightly
def test_one_mark_less_repeats_itself_without_the_run_it_came_from(planish, run):
    with opened(run) as session:
        do(session, do="use", id=session.state.of(None)[0].id, used=False)
        out = made(session)
    shutil.rmtree(run)
    code, _, err = planish("run", out / "run.toml")
    assert (code in (0, 4), f"same bytes as {out}" in err) == (True, True), err


@pytest.mark.nightly
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
    assert (third, open_run(third).results.regions.count) == (run.with_name("run-2-2"), 1)
    for one in (out, third):
        code, _, err = planish("run", one / "run.toml", "--out", one.with_name("again"))
        assert (code in (0, 4), f"same bytes as {one}" in err) == (True, True), err
        shutil.rmtree(one.with_name("again"))


@pytest.mark.nightly
def test_a_sheet_seen_from_its_low_end_is_applied_in_its_own_frame(planish, passes, laid, tmp_path):
    passes("link", laid.volume, laid.image, "-o", tmp_path / "run", *laid.options, codes=(0, 4))
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


@pytest.mark.nightly
def test_pairs_by_hand_link_what_was_refused_for_want_of_holes(planish, refused, linked_run, tmp_path):
    """Two of the image's holes remain: the link refuses, and pairs that a person sets on the maps make a run."""
    marks = [mark for mark in json.loads((linked_run / "marks.json").read_text())["marks"] if len(mark["at"]) == 2]
    two = refused[1]
    shutil.copytree(refused[0], tmp_path / "run-map")
    code, _, err = planish("link", tmp_path / "run-map", two, "-o", tmp_path / "run")
    assert (code, "at least 3 are needed" in err) == (3, True), err
    with opened(tmp_path / "run-map", ImageParams(path=str(two))) as session:
        for one in marks:
            ends = {side: [one["at"][side]["x"], one["at"][side]["y"]] for side in ("moving", "fixed")}
            do(session, do="add", label=one["label"], **ends)
        out = made(session)
    assert out == tmp_path / "run"
    found, first = open_run(out), open_run(linked_run)
    fits = [next(iter(one.registrations.values())).fit for one in (first, found)]
    assert fits[1].rms_um == pytest.approx(fits[0].rms_um, rel=0.2)
    for group in UNCHANGED:
        assert held(out, group) == held(tmp_path / "run-map", group), group
    sources = {one["at"]["fixed"]["source"] for one in json.loads((out / "marks.json").read_text())["marks"]}
    assert sources == {"clicked"}
    code, _, err = planish("run", out / "run.toml")
    assert (code in (0, 4), f"same bytes as {out}" in err) == (True, True), err


@pytest.mark.nightly
def test_marks_of_one_of_several_layers(planish, passes, linked_run, specimen_files, tmp_path):
    """Two images of one sheet and its volume: only the layer whose marks were changed gets marks of its own."""
    image = specimen_files[1]
    passes("link", f"a={linked_run}", f"b={image}", f"c={image}", "-o", tmp_path / "run", codes=(0, 4))
    with opened(tmp_path / "run") as session:
        do(session, do="use", layer="a", id=session.state.of("a")[0].id, used=False)
        order = ordered(session)
        out = made(session)
    assert [Path(layer.marks).name if layer.marks else None for layer in order.study.layers] == [
        "marks-a.json", None, None,
    ]  # fmt: skip
    assert [layer.marks for layer in read_study(out / "run.toml").layers] == [str(out / "marks-a.json"), None, None]
    old, new = (Results.read(folder / "results.json") for folder in (tmp_path / "run", out))
    assert new.layer("a").registration.matched == old.layer("a").registration.matched - 1
    assert new.layer("b").registration == old.layer("b").registration
    code, _, err = planish("run", out / "run.toml")
    assert (code in (0, 4), f"same bytes as {out}" in err) == (True, True), err


# --- the process -----------------------------------------------------------------------------------------------------
@contextmanager
def applying(session):
    found = Applying(session)
    try:
        yield found
    finally:
        found.close()


def ended(applied):
    """How it ended."""
    wait_for(lambda: applied.progress.state != "working")
    return applied.progress


@pytest.mark.nightly
def test_a_process_makes_the_run_and_says_how_far_it_is(run):
    with opened(run) as session, applying(session) as applied:
        do(session, do="model", model="similarity")
        assert applied.progress.state == "idle"
        begun = applied.start()
        assert (begun.state, begun.share) == ("working", 0.0)
        with pytest.raises(Busy, match="being made already"):
            applied.start()
        seen = []
        wait_for(lambda: seen.append(applied.progress) or seen[-1].state != "working")
        end = seen[-1]
    assert (end.state, end.share, end.run) == ("done", 1.0, str(run.with_name("run-2"))), end.message
    shares = [one.share for one in seen]
    assert shares == sorted(shares)
    assert {"link", "correlate", "write"} <= {one.stage for one in seen}
    assert open_run(run.with_name("run-2")).results.layers[0].registration.model == "similarity"
    assert applied.reports[end.report.rpartition("/")[2]] == run.with_name("run-2") / "report.html"
    assert sorted(p.name for p in run.parent.iterdir()) == ["run", "run-2"]
    assert not (run / orders.STAGING).exists()


@pytest.mark.nightly
def test_what_cannot_be_applied_is_said_and_nothing_is_left(run):
    with opened(run) as session, applying(session) as applied:
        for mark in session.state.of(None)[2:]:
            do(session, do="use", id=mark.id, used=False)
        applied.start()
        end = ended(applied)
        assert (end.state, end.run) == ("failed", None)
        assert "2 pairs of marks in use" in end.message
        assert [p.name for p in run.parent.iterdir()] == ["run"]
        assert not (run / orders.STAGING).exists()


@pytest.mark.nightly
def test_the_page_begins_follows_and_reads_the_report(run):
    """By the routes: 202, then how far it is, 409 for a second one, and a report under a secret of its own."""
    with opened(run) as session:
        app = create_app(session, token=TOKEN, hosts=[HOST])
        client, stranger = Client(app), Client(app, token="")
        try:
            assert client.get("/api/apply").json() == {"state": "idle", "stage": "", "share": 0.0, "message": ""}
            assert (stranger.post("/api/apply").status, client.post("/api/apply").status) == (401, 202)
            again = client.post("/api/apply")
            assert (again.status, again.json()["state"]) == (409, "working")
            wait_for(lambda: client.get("/api/apply").json()["state"] != "working")
            end = client.get("/api/apply").json()
        finally:
            app.state.applying.close()
        assert (end["state"], end["run"]) == ("done", str(run.with_name("run-2"))), end
        page = stranger.get(end["report"])  # a new tab has no token
        assert (page.status, page.body) == (200, (run.with_name("run-2") / "report.html").read_bytes())
        assert "script-src" not in page.headers["content-security-policy"]
        assert "default-src 'none'" in page.headers["content-security-policy"]
        assert TOKEN not in end["report"]
        for wrong in ("x", end["report"].rpartition("/")[2][:-1], "..%2f..%2fresults.json", "../results.json"):
            assert stranger.get(f"/report/{wrong}").status == 404


@pytest.mark.nightly
def test_a_cancel_at_any_moment_leaves_nothing(run):
    with opened(run) as session, applying(session) as applied:
        do(session, do="use", id=session.state.of(None)[0].id, used=False)
        stages = ("", "register", "link", "write")
        for k, stage in enumerate(stages):
            applied.start()
            # A stage may be over before it is seen: then it is the next one that is cancelled.
            wait_for(lambda k=k: applied.progress.stage in stages[k:] or applied.progress.state != "working")
            begun, at = time.monotonic(), applied.progress
            end = applied.cancel()
            print(f"cancelled in {at.stage or 'the beginning'} for {stage} within {time.monotonic() - begun:.2f} s")
            assert end.state == "cancelled" or (at.stage in ("correlate", "write") and end.state == "done"), (at, end)
            if end.run is not None:
                shutil.rmtree(end.run)
            assert [p.name for p in run.parent.iterdir()] == ["run"]
            assert not (run / orders.STAGING).exists()


@pytest.mark.nightly
@pytest.mark.parametrize("stage", ["link", "write"])
def test_a_server_that_is_killed_in_mid_apply_leaves_nothing(run, stage):
    """SIGKILL to the server alone: the process that works for it notices, and clears up."""
    code = (
        "import sys, time; from pathlib import Path; from planish.app.session import Session\n"
        "from planish.app.apply import Applying; from planish.app.changes import change_of\n"
        "session = Session.open(Path(sys.argv[1])); applied = Applying(session)\n"
        'session.change(change_of(\'{"do": "use", "id": "m0-1", "used": false}\')); applied.start()\n'
        "while True:\n"
        "    print(applied.progress.stage, applied._process and applied._process.pid, flush=True)\n"
        "    time.sleep(0.01)"
    )
    with subprocess.Popen([sys.executable, "-c", code, str(run)], stdout=subprocess.PIPE, text=True) as server:
        worker = next(line.split()[1] for line in server.stdout if line.startswith(stage))
        server.send_signal(signal.SIGKILL)
        server.stdout.close()
    wait_for(lambda: not Path(f"/proc/{worker}").exists(), 20)
    assert [p.name for p in run.parent.iterdir()] == ["run"]
    assert not (run / orders.STAGING).exists()


@pytest.mark.nightly
def test_what_both_left_when_they_were_killed_goes_at_the_next_start(run):
    with opened(run) as session:
        do(session, do="use", id=session.state.of(None)[0].id, used=False)
        applied = Applying(session)
        applied.start()
        wait_for(lambda: applied.progress.stage == "correlate")
        applied._process.kill()
        end = ended(applied)
        assert end.state == "failed"
        assert "ended unexpectedly" in end.message
        assert [p.name for p in run.parent.iterdir()] == ["run"]
        # As if the server had gone first.
        (run / orders.STAGING).mkdir()
        (run / orders.STAGING / "target").write_text(str(run.with_name("run-2")))
        work = run.with_name(".run-2.work")
        work.mkdir()
        (work / "planish-work-folder").write_text("Results of single tiles")
    with opened(run) as session, applying(session):
        assert [p.name for p in run.parent.iterdir()] == ["run"]
        assert not (run / orders.STAGING).exists()
