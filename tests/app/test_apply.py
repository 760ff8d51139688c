"""Apply: what a session changed becomes a run of its own, and nothing else is done again."""

import json
import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import quote

import numpy as np
import pytest
import tifffile

from app.asgi import HOST, TOKEN, Client
from app.conftest import beside
from folders import bytes_of, disc_image, write_image
from planish.app import Session, changes, create_app
from planish.app import order as orders
from planish.app.apply import Applying, Progress
from planish.core.errors import FileError, SizeError
from planish.io.params import ImageParams
from planish.run import changed, open_run, read_study, run_study

UNCHANGED = ("surfaces", "flat", "strain", "maps", "slices", "overviews/maps")
OFF_PX = 1.5
"""Farthest that a click misses its place, in image pixels."""


def opened(run, image=None):
    return closing(Session.open(run, image))


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


# --- the study ------------------------------------------------------------------------------------
def test_a_session_without_changes_or_with_them_undone_is_the_study_of_its_run(made_copy):
    with opened(made_copy) as session:
        order = ordered(session)
        do(session, do="use", id=session.state.of(None)[0].id, used=False)
        session.undo()
        assert ordered(session).files == {}
    assert (order.study, order.files) == (read_study(made_copy / "run.toml"), {})


def test_models_do_not_freeze_marks_and_labels_of_holes_are_their_own(made_copy):
    with opened(made_copy) as session:
        do(session, do="model", model="similarity")
        order = ordered(session)
    assert (order.files, order.study.registration.model) == ({}, "similarity")
    assert order.study.registration.marks is None
    with opened(made_copy) as session:
        first, second, *_ = session.state.of(None)
        do(session, do="delete", id=second.id)
        do(session, do="label", id=first.id, label="fixed 1")
        labels = [one["label"] for one in json.loads(ordered(session).files["marks.json"])["marks"]]
    assert len(labels) == len(set(labels))
    assert {"fixed 1", "fixed 2", "moving 1"} <= set(labels)


def test_marks_keep_what_is_known_of_them(made_copy):
    """An end that did not move keeps covariance, diameter and source; a moved one is a person's;
    the hole is masked."""
    before = json.loads((made_copy / "marks.json").read_text())["marks"]
    with opened(made_copy) as session:
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
        "x": x + 3.0,
        "y": y,
        "source": "clicked",
        "diameter_um": old[first.label]["at"]["fixed"]["diameter_um"],
    }
    assert marks[second.label]["used"] is False
    assert marks[second.label]["at"] == old[second.label]["at"]
    assert marks["mine"]["at"] == {
        "moving": {"x": 333.0, "y": 222.0, "source": "clicked", "diameter_um": 200.0}
    }
    assert third.label not in marks
    for side in ("moving", "fixed"):  # what was burnt is still there
        alone = [
            one["at"]
            for one in marks.values()
            if one["at"].keys() == {side} and one["label"] != "mine"
        ]
        assert alone == [{side: old[third.label]["at"][side]}]
    assert order.study.registration.marks == str(made_copy / orders.STAGING / "marks.json")


def test_regions_stand_in_the_order_as_they_were_drawn(made_copy):
    with opened(made_copy) as session:
        corners = [[300.0, 300.0], [500.0, 300.0], [500.0, 450.0]]
        do(session, do="region", name="spot", author="A", reason="grease", polygon=corners)
        order = ordered(session)
    (feature,) = json.loads(order.files["regions.geojson"])["features"]
    assert feature["properties"] == {"name": "spot", "author": "A", "reason": "grease"}
    assert feature["geometry"]["coordinates"] == [[*corners, corners[0]]]
    assert order.study.correlate.regions == str(made_copy / orders.STAGING / "regions.geojson")
    assert order.study.registration.marks is None


@pytest.mark.parametrize(
    ("name", "linked", "there", "wanted"),
    [
        ("run", False, [], "run-2"),
        ("run", False, ["run-2"], "run-3"),
        ("run-map", True, [], "run"),
        ("run-map-2", True, ["run"], "run-2"),
        ("sheet", True, [], "sheet-2"),
        ("-map", True, [], "-map-2"),
    ],
)
def test_the_new_run_stands_beside_the_old_one(tmp_path, name, linked, there, wanted):
    for folder in (name, *there):
        (tmp_path / folder).mkdir()
    assert orders.new_run_folder(tmp_path / name, linked=linked) == tmp_path / wanted


# --- the run --------------------------------------------------------------------------------------
def test_without_a_change_every_number_is_the_same(run_copy):
    with opened(run_copy) as session:
        out = made(session)
    assert out == run_copy.with_name("run-2")
    old, new = bytes_of(run_copy), bytes_of(out)
    assert {name for name in old | new if old.get(name) != new.get(name)} <= {"edits/.lock"}


@pytest.mark.parametrize("kind", ["upright", "laid"])
def test_a_run_with_marks_regions_and_a_model_keeps_its_sheet_and_repeats_itself(
    planish, kinds, tmp_path, kind
):
    """The laid sheet is seen from its low end, in a frame of its own."""
    run = beside(kinds(kind), tmp_path)
    with opened(run) as session:
        do(session, do="use", id=session.state.of(None)[0].id, used=False)
        do(session, do="model", model="similarity")
        do(
            session,
            do="region",
            name="spot",
            polygon=[[300.0, 300.0], [600.0, 300.0], [600.0, 550.0]],
        )
        out = made(session)
    for group in UNCHANGED:
        assert held(out, group) == held(run, group), group
    chunks = [chunk.relative_to(run) for chunk in (run / "maps.zarr" / "maps").rglob("c/*/*")]
    assert chunks
    assert [chunk for chunk in chunks if not (run / chunk).samefile(out / chunk)] == []
    old, new = open_run(run), open_run(out)
    (sheet, _), (before, _) = new.results.layers, old.results.layers
    assert sheet.sheet == before.sheet
    assert sheet.registration.matched == before.registration.matched - 1
    assert (sheet.registration.model, new.results.regions.count) == ("similarity", 1)
    transforms = [one.registrations["sheet"].fit.transform for one in (old, new)]
    assert transforms[0].mirrored == transforms[1].mirrored
    assert transforms[1].scale == pytest.approx(transforms[0].scale, abs=0.02)
    assert 'marks = "marks.json"' in (out / "run.toml").read_text()
    with opened(out) as session:  # from which the next one is made
        assert [(region.name, region.id) for region in session.state.regions] == [("spot", "r0-1")]
        assert ordered(session).study.correlate.regions == str(out / "regions.geojson")
    shutil.rmtree(run)
    code, _, err = planish("run", out / "run.toml")
    assert (code in (0, 4), f"same bytes as {out}" in err) == (True, True), err


@pytest.fixture
def refused(linked_run, specimen_files, tmp_path):
    """The maps of the small run without its link, as a link leaves them that was refused, and an
    image of two holes."""
    study, run = read_study(linked_run / "run.toml"), open_run(linked_run)
    place = linked_run.parent.parent / f"refused-{tmp_path.name}"
    maps = place / "run-map"
    place.mkdir()
    run_study(changed(study, layers=study.layers[:1]), maps, old=linked_run)
    pixel_um = float(run.linked.x.values[1] - run.linked.x.values[0])
    holes = np.stack([run.marks["fixed_x"].values, run.marks["fixed_y"].values], axis=1)
    shape = tifffile.imread(specimen_files[1]).shape
    found = holes[np.isfinite(holes).all(axis=1)]
    return maps, write_image(place / "image.tif", disc_image(found[:2], shape, pixel_um), pixel_um)


def test_pairs_by_hand_link_what_was_refused_for_want_of_holes_within_the_error_of_the_clicks(
    refused, linked_run, specimen, tmp_path
):
    """Pairs that a person sets on the maps, up to 1.5 pixels off, are kept, and make a run that the
    truth confirms."""
    maps, image = refused
    with pytest.raises(FileError, match=r"planish view .* IMAGE"):
        Session.open(maps)
    bare = tmp_path / "bare.tif"
    tifffile.imwrite(bare, tifffile.imread(image))  # states no size
    with pytest.raises(SizeError, match="pixel_um="):
        _ = Session.open(maps, ImageParams(path=str(bare)), read_only=True).image

    # Places from the run of the whole image: its five holes, of which three are gone in this one,
    # and two beside them.
    whole, pixel_um = open_run(linked_run).registrations["sheet"], specimen.params.camera.pixel_um
    holes = np.stack([whole.marks[f"moving_{axis}"].values for axis in "xy"], 1)
    moving = np.concatenate([holes, [holes[[0, 1]].mean(0), holes[[2, 3]].mean(0)]])
    draw = np.random.default_rng(3)
    turn = draw.uniform(0, 2 * np.pi, (2, len(moving)))
    away = OFF_PX * pixel_um * np.sqrt(draw.uniform(0, 1, turn.shape))
    off = away[..., None] * np.stack([np.cos(turn), np.sin(turn)], -1)
    clicked = moving + off[0], whole.fit.transform(moving) + off[1]
    with opened(maps, ImageParams(path=str(image))) as session:
        assert [holes.sizes["mark"] for holes in session.holes("sheet").values()] == [5, 2]
        assert session.state.of(None) == ()
        for one, other in zip(*clicked, strict=True):
            do(session, do="add", moving=one.tolist(), fixed=other.tolist())
        kept = session.state
    with opened(maps, ImageParams(path=str(image))) as session:
        assert session.state == kept
        out = made(session)
    assert out == maps.with_name("run")
    for group in UNCHANGED:
        assert held(out, group) == held(maps, group), group
    run = open_run(out)
    assert set(run.marks["fixed_source"].values[: len(moving)]) == {"clicked"}
    found, true = run.linked, specimen.truth
    off = np.hypot(
        found.volume_x.values - true.volume_x.values, found.volume_y.values - true.volume_y.values
    )
    measured = found.valid.values & np.isfinite(off)
    assert measured.mean() > 0.3
    said, real = (
        float(np.median(found.expected_error.values[measured])),
        float(np.sqrt(np.mean(off[measured] ** 2))),
    )
    assert real < OFF_PX * pixel_um
    assert real < 2 * said


def test_marks_of_one_of_several_layers(kinds, tmp_path):
    """A sheet, its image and another one in a chain: only the layer whose marks were changed gets
    marks of its own."""
    run = beside(kinds("chain"), tmp_path)
    with opened(run) as session:
        do(session, do="use", layer="ct", id=session.state.of("ct")[0].id, used=False)
        order = ordered(session)
        out = made(session)
    assert [Path(layer.marks).name if layer.marks else None for layer in order.study.layers] == [
        "marks-ct.json",
        None,
        None,
    ]
    assert [layer.marks for layer in read_study(out / "run.toml").layers] == [
        str(out / "marks-ct.json"),
        None,
        None,
    ]
    old, new = (open_run(folder).results for folder in (run, out))
    assert new.layer("ct").registration.matched == old.layer("ct").registration.matched - 1
    assert new.layer("near").registration == old.layer("near").registration


# --- the process ----------------------------------------------------------------------------------
def nothing_left(run):
    """Whether nothing but the run stands where it stands, and nothing of an order in it."""
    return [path.name for path in run.parent.iterdir()] == [run.name] and not (
        run / orders.STAGING
    ).exists()


def ended(applied):
    """How it ended."""
    wait_for(lambda: applied.progress.state != "working")
    return applied.progress


def test_a_process_makes_the_run_says_how_far_it_is_or_why_it_is_not_made_and_serves_the_report(
    run_copy,
):
    """By the routes: 202, then how far it is, 409 for a second one, and a report under a secret of
    its own."""
    new = run_copy.with_name("run-2")
    with opened(run_copy) as session:
        app = create_app(session, token=TOKEN, hosts=[HOST])
        client, stranger, applied = Client(app), Client(app, token=""), app.state.served.applying
        try:
            assert client.get("/api/apply").json() == {
                "state": "idle",
                "stage": "",
                "share": 0.0,
                "message": "",
            }
            for mark in session.state.of(None)[2:]:
                do(session, do="use", id=mark.id, used=False)
            assert (stranger.post("/api/apply").status, client.post("/api/apply").status) == (
                401,
                202,
            )
            failed = ended(applied)
            assert (failed.state, failed.run) == ("failed", None)
            assert "2 pairs of marks in use" in failed.message
            assert nothing_left(run_copy)

            while session.can_undo:
                session.undo()
            do(session, do="model", model="similarity")
            begun = applied.start()
            assert (begun.state, begun.share) == ("working", 0.0)
            again = client.post("/api/apply")
            assert (again.status, again.json()["state"]) == (409, "working")
            seen = []
            wait_for(lambda: seen.append(applied.progress) or seen[-1].state != "working")
            end = client.get("/api/apply").json()
        finally:
            applied.close()
        assert (end["state"], end["share"], end["run"]) == ("done", 1.0, str(new)), end
        shares = [one.share for one in seen]
        assert shares == sorted(shares)
        assert {"link", "correlate", "write"} <= {one.stage for one in seen}
        page = stranger.get(end["report"])  # a new tab has no token
        assert (page.status, page.body) == (200, (new / "report.html").read_bytes())
        assert "script-src" not in page.headers["content-security-policy"]
        assert "default-src 'none'" in page.headers["content-security-policy"]
        assert TOKEN not in end["report"]
        for wrong in (
            "x",
            end["report"].rpartition("/")[2][:-1],
            "..%2f..%2fresults.json",
            "../results.json",
        ):
            assert stranger.get(f"/report/{wrong}").status == 404
    assert open_run(new).results.layers[0].registration.model == "similarity"

    assert stranger.post("/api/apply/open").status == 401
    assert client.post("/api/apply/open").json() == {"run": "run-2"}
    assert client.get("/api/session").json()["run"] == "run-2"
    with closing(
        app.state.served.session
    ) as session:  # the new run is changed, the old one is free
        assert (session.folder, session.can_undo) == (new, False)
        do(session, do="model", model="affine")
        assert client.get("/api/state").json()["model"] == "affine"
        opened(run_copy).thing.close()
    assert stranger.get(end["report"]).status == 200  # its window may be open still
    app.state.served.applying.close()
    shutil.rmtree(new)
    assert nothing_left(run_copy)


def test_a_window_of_the_run_before_changes_nothing_in_the_run_that_is_served(made_copy):
    """Each write names the run that its window shows; a request in flight keeps its own run."""
    new = Path(shutil.copytree(made_copy, made_copy.with_name("rün 2")))
    app = create_app(Session.open(made_copy), token=TOKEN, hosts=[HOST])
    client, before = Client(app), app.state.served
    use = {"change": {"do": "use", "id": before.session.state.of(None)[0].id, "used": False}}
    window = {"planish-run": made_copy.name}
    assert client.post("/api/change", use, headers=window).status == 200
    applying = before.applying
    applying._begun_state, applying.reports["secret"] = before.session.state, new / "report.html"
    applying.progress = Progress(state="done", run=str(new), report="/report/secret")
    assert "outdated" not in client.get("/api/apply").json()
    model = {"change": {"do": "model", "model": "similarity"}}
    assert client.post("/api/change", model, headers=window).status == 200
    assert client.get("/api/apply").json()["outdated"] is True
    assert client.post("/api/undo", headers=window).status == 200
    assert "outdated" not in client.get("/api/apply").json()  # as it stood when it was begun
    assert client.post("/api/redo", headers=window).status == 200

    with ThreadPoolExecutor(8) as pool:  # all of them ask at once, and one switches
        opened_runs = list(pool.map(lambda _: client.post("/api/apply/open").json(), range(8)))
    assert opened_runs == [{"run": new.name}] * 8
    after = app.state.served
    assert (after.session.folder, before.session.journal.path.parent.parent) == (new, made_copy)
    session, now = client.get("/api/session").json(), client.get("/api/apply").json()
    assert session["run"] == new.name
    assert session["said"] == "rün 2 is open. What was changed after Apply is in run only."
    assert (now["state"], now["report"], now["run"]) == ("idle", "/report/secret", str(new))
    for path, body in (
        ("change", use),
        ("undo", {}),
        ("redo", {}),
        ("snap", {"id": "x"}),
        ("apply", {}),
        ("apply/cancel", {}),
        ("apply/open", {}),
        ("marks/import", {}),
    ):
        answer = client.post(f"/api/{path}", body, headers=window)
        assert (answer.status, answer.json()["served"]) == (409, new.name), path
        assert "This window shows run, and planish serves rün 2 now." in answer.json()["error"]
    assert after.session.state is after.session.first
    ours = {"planish-run": quote(new.name)}
    assert client.post("/api/change", use, headers=ours).status == 200
    assert not after.session.state.of(None)[0].used
    # A change that was on its way to the run before is not made there any more, nor in the new one.
    with pytest.raises(FileError, match="Nothing was changed"):
        do(before.session, do="model", model="affine")
    assert after.session.state.model != "affine"
    with opened(made_copy) as session:
        assert session.state.model == "similarity"
    after.close()


def test_a_request_sees_one_run_from_its_start_to_its_end(made_copy, monkeypatch):
    new = Path(shutil.copytree(made_copy, made_copy.with_name("run-2")))
    app = create_app(Session.open(made_copy), token=TOKEN, hosts=[HOST])
    client, before = Client(app), app.state.served
    before.applying.progress = Progress(state="done", run=str(new))
    change = Session.change

    def switched(session, asked, *, version=None):
        """The change, and another run that is served before it is answered."""
        state = change(session, asked, version=version)
        assert client.post("/api/apply/open").json() == {"run": "run-2"}
        return state

    monkeypatch.setattr(Session, "change", switched)
    body = {"change": {"do": "model", "model": "similarity"}}
    answer = client.post("/api/change", body, headers={"planish-run": "run"})
    assert (answer.status, answer.json()["model"]) == (200, "similarity")
    after = app.state.served
    assert (after.run, after.session.state.model) == ("run-2", after.session.first.model)
    assert after.session.first.model != "similarity"
    after.close()


def test_a_cancel_leaves_nothing(run_copy):
    with opened(run_copy) as session, closing(Applying(session)) as applied:
        do(session, do="use", id=session.state.of(None)[0].id, used=False)
        applied.start()
        wait_for(lambda: applied.progress.stage)
        assert applied.cancel().state == "cancelled"
        assert nothing_left(run_copy)


def test_a_worker_that_is_killed_is_said(run_copy):
    with opened(run_copy) as session, closing(Applying(session)) as applied:
        do(session, do="use", id=session.state.of(None)[0].id, used=False)
        applied.start()
        wait_for(lambda: applied.progress.stage == "correlate")
        applied._process.kill()
        end = ended(applied)
        assert end.state == "failed"
        assert "ended unexpectedly" in end.message
        assert nothing_left(run_copy)


def test_what_both_left_when_they_were_killed_goes_at_the_next_start(made_copy):
    (made_copy / orders.STAGING).mkdir(parents=True)
    (made_copy / orders.STAGING / "target").write_text(str(made_copy.with_name("run-2")))
    work = made_copy.with_name(".run-2.work")
    work.mkdir()
    (work / "planish-work-folder").write_text("Results of single tiles")
    with opened(made_copy) as session, closing(Applying(session)):
        assert nothing_left(made_copy)
