"""Marks that are tiles of texture: places without a diameter, which the app takes for no holes."""

import json

import pytest

from app.asgi import HOST, TOKEN, Client
from app.marks_page import expect
from planish.app import Session, changes, create_app
from planish.app import order as orders


@pytest.fixture
def tiled(made_copy):
    """The made run, its pairs tiles as a link by texture gives them; the last one stays a hole."""
    path = made_copy / "marks.json"
    file = json.loads(path.read_text())
    pairs = [mark for mark in file["marks"] if len(mark["at"]) == 2]
    for mark in pairs[:-1]:
        for plane, end in mark["at"].items():
            known = {name: end[name] for name in ("x", "y", "covariance_um2") if name in end}
            mark["at"][plane] = known | {"source": "tile"}
    path.write_text(json.dumps(file | {"marks": pairs}))
    return made_copy


@pytest.fixture
def session(tiled):
    session = Session.open(tiled)
    yield session
    session.close()


def test_a_circle_is_drawn_around_holes_alone_and_no_tile_is_snapped(session):
    client = Client(create_app(session, token=TOKEN, hosts=(HOST,)))
    *tiles, hole = client.get("/api/state").json()["marks"]
    for plane, circles in client.get("/api/session").json()["holes"].items():
        assert [(x, y) for x, y, _ in circles] == [tuple(hole[plane])]
        assert 100.0 < circles[0][2] < 300.0
    refused = client.post("/api/snap", {"id": tiles[0]["id"]})
    assert (refused.status, refused.json()["error"].partition(":")[0]) == (
        400,
        f"{tiles[0]['label']} is a tile of texture and no hole",
    )
    assert client.post("/api/snap", {"id": hole["id"]}).status == 200
    client.app.state.served.applying.close()


def test_apply_writes_tiles_without_a_diameter_and_forgets_those_that_were_deleted(session):
    before = {
        mark["label"]: mark["at"]
        for mark in json.loads((session.folder / "marks.json").read_text())["marks"]
    }
    first, second, third, *_, hole = session.state.of(None)
    x, y = second.fixed.xy
    for change in (
        {"do": "use", "id": first.id, "used": False},
        {"do": "move", "id": second.id, "fixed": [x + 3.0, y]},
        {"do": "delete", "id": third.id},
    ):
        session.change(changes.change_of(json.dumps(change)))
    _, files = orders.order_of(session, session.folder / orders.STAGING)
    after = {mark["label"]: mark["at"] for mark in json.loads(files["marks.json"])["marks"]}
    moved = {
        second.label: before[second.label] | {"fixed": {"x": x + 3.0, "y": y, "source": "clicked"}}
    }
    assert after == {label: at for label, at in before.items() if label != third.label} | moved
    assert {end["diameter_um"] > 100.0 for end in after[hole.label].values()} == {True}


@pytest.mark.nightly
def test_the_page_says_what_tiles_are(serve, window, kinds):
    shown = window(serve(kinds("no-holes"), "--read-only"))
    expect(shown.page.get_by_text("Tiles are pieces of the map's texture")).to_be_visible()
