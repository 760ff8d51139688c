"""What the routes of the marks answer."""

import asyncio
import base64
import io
import json
import zipfile
from types import SimpleNamespace

import numpy as np
import pytest

from app.asgi import HOST, TOKEN, Client, run_apart
from planish.app import Session, create_app, marks_routes
from planish.core.errors import FileError
from planish.io import ImageParams
from planish.run import open_run


def served(session):
    return Client(create_app(session, token=TOKEN, hosts=(HOST,)))


@pytest.fixture
def client(session):
    found = served(session)
    yield found
    found.app.state.served.applying.close()


def test_a_session_says_what_there_is(client, session):
    found = client.get("/api/session").json()
    holes = open_run(session.folder).registrations[session.layers[0]]
    assert found["models"][-1] == "auto"
    assert {"similarity", "affine", "tps"} <= set(found["models"])
    assert [len(found["holes"][side]) for side in ("moving", "fixed")] == [
        holes.count("moving"),
        holes.count("fixed"),
    ]
    assert {p["plane"] for p in found["pictures"]} == {"moving", "fixed"}
    assert found["layers"][0]["headline"] == session.results.layers[0].headline == "coating_top"
    assert (found["read_only"], found["linked"]) == (False, True)


def test_one_change_after_the_other(client, session):
    first = client.get("/api/state").json()
    count = len(first["marks"])
    one = client.post(
        "/api/change", {"change": {"do": "add", "moving": [500, 400]}, "version": first["version"]}
    ).json()
    mark = one["marks"][-1]
    assert (mark["fixed"], mark["residual_um"], list(mark["predicted"])) == (None, None, ["fixed"])
    layer = session.layers[0]
    wanted = session.registrations[layer]([500.0, 400.0])
    # um: the shown fit is that of the run or near it.
    assert np.hypot(*(mark["predicted"]["fixed"] - wanted)) < 0.5
    two = client.post(
        "/api/change", {"change": {"do": "move", "id": mark["id"], "fixed": wanted.tolist()}}
    ).json()
    assert two["marks"][-1]["residual_um"] is not None
    assert client.post("/api/undo").json()["marks"][-1]["fixed"] is None
    assert (len(client.post("/api/undo").json()["marks"]), client.post("/api/undo").status) == (
        count,
        400,
    )
    assert client.post("/api/redo").json()["can_redo"] is True


def test_stale_changes_and_files_without_marks_are_refused(client):
    seen = client.get("/api/state").json()["version"]
    client.post("/api/change", {"change": {"do": "model", "model": "affine"}})
    answer = client.post(
        "/api/change", {"change": {"do": "use", "id": "m0-1", "used": False}, "version": seen}
    )
    assert (answer.status, answer.json()["model"]) == (409, "affine")
    assert answer.json()["marks"][0]["used"] is True
    answer = client.post("/api/marks/import", {"name": "notes.csv", "text": "a,b\n1,2\n"})
    assert answer.status == 400
    assert "BigWarp" in answer.json()["error"]


@pytest.mark.parametrize("form", ["json", "csv", "bigwarp", "slicer", "matlab", "elastix"])
def test_marks_come_back_from_every_format(client, session, form):
    before = session.state.of(None)
    answer = client.get(f"/api/marks/export?format={form}")
    assert answer.status == 200
    name = answer.headers["content-disposition"].partition('filename="')[2].rstrip('"')
    files = {name: answer.body}
    if name.endswith(".zip"):
        with zipfile.ZipFile(io.BytesIO(answer.body)) as packed:
            files = {one: packed.read(one) for one in sorted(packed.namelist(), reverse=True)}
    given = [
        {"name": one, "base64": base64.b64encode(data).decode()} for one, data in files.items()
    ]
    body = given[0] | ({"second": given[1]} if len(given) > 1 else {})
    answer = client.post("/api/marks/import", body)
    assert answer.status == 200, answer.body
    for old, new in zip(before, session.state.of(None), strict=True):
        for side in ("moving", "fixed"):
            assert getattr(new, side).xy == pytest.approx(getattr(old, side).xy, abs=1e-3)
    if form == "json":
        assert [m.moving for m in before] == [m.moving for m in session.state.of(None)]
    client.post("/api/undo")
    assert session.state.of(None) == before


def test_a_change_that_the_disk_does_not_take_is_not_shown(client, monkeypatch):
    def full(_file, _data):
        raise OSError(28, "No space left on device")

    before = client.get("/api/state").json()["marks"]
    monkeypatch.setattr("planish.app.journal._write_all", full)
    answer = client.post("/api/change", {"change": {"do": "use", "id": "m0-1", "used": False}})
    assert answer.status == 507
    assert "disk is full" in answer.json()["error"]
    assert client.get("/api/state").json()["marks"][0]["used"] == before[0]["used"] is True


def test_every_window_hears_of_a_change(client, session):
    """A line at once, one for the change, and a heartbeat each half second."""

    async def listen():
        served_run = SimpleNamespace(served=client.app.state.served)
        request = SimpleNamespace(app=client.app, state=served_run)
        lines = (await marks_routes.get_events(request)).body_iterator
        found = [json.loads(await anext(lines))]
        session.publish()
        found += [json.loads(await asyncio.wait_for(anext(lines), 2)) for _ in range(2)]
        await lines.aclose()
        return found

    first = session.version
    assert [line["version"] for line in run_apart(listen())] == [first, first + 1, first + 1]


def test_a_link_takes_no_other_image(made_run, tmp_path):
    with pytest.raises(FileError, match="already"):
        Session.open(made_run, ImageParams(path=str(tmp_path / "image.tif")))
