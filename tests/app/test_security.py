"""What the server lets in: its own page and nobody else's."""

import itertools
import shutil
from pathlib import Path

import pytest

from app.asgi import HOST, TOKEN, Client
from planish.app import Session, create_app
from planish.app.server import HEADERS, MOST_BYTES

READS = (
    "/api/session",
    "/api/state",
    "/api/predict?side=moving&x=1&y=2",
    "/api/marks/export?format=json",
)
WRITES = {
    "/api/change": {"change": {"do": "use", "id": "m0-1", "used": False}},
    "/api/undo": {},
    "/api/redo": {},
    "/api/snap": {"id": "m0-1"},
    "/api/marks/import": {
        "name": "marks.csv",
        "text": "label,moving_x_um,moving_y_um,fixed_x_um,fixed_y_um\n",
    },
    "/api/apply": {},
    "/api/apply/cancel": {},
}


@pytest.fixture(scope="module")
def session(made_run, tmp_path_factory):
    """Shared: what is refused changes nothing, and other tests do not mind."""
    found = Session.open(
        Path(shutil.copytree(made_run, tmp_path_factory.mktemp("security") / "run"))
    )
    yield found
    found.close()


@pytest.fixture(scope="module")
def client(session):
    app = create_app(session, token=TOKEN, hosts=(HOST, "localhost:8000"))
    yield Client(app)
    app.state.served.applying.close()


def routes(client):
    """Every method and path that there is, with something in place of its parameters."""
    found = []
    for route in client.app.routes:
        path = route.path
        for name in route.param_convertors:
            path = path.replace("{" + name + "}", "0").replace("{" + name + ":int}", "0")
        found += [(method, path) for method in sorted(route.methods - {"HEAD"})]
    return found


def test_every_route_of_data_wants_the_token(client):
    data = [(method, path) for method, path in routes(client) if path.startswith("/api/")]
    assert {path for _, path in data} >= {path.partition("?")[0] for path in (*READS, *WRITES)}
    for method, path in data:
        for wrong in (
            None,
            "",
            "Bearer",
            "Bearer x",
            f"Basic {TOKEN}",
            TOKEN,
            f"Bearer {TOKEN}x",
            "Bearer tök",
        ):
            assert client.ask(method, path, headers={"authorization": wrong}).status == 401, (
                path,
                wrong,
            )

    # Nor is it taken from anywhere else.
    assert client.get(f"/api/state?token={TOKEN}", headers={"authorization": None}).status == 401
    cookie = {"authorization": None, "cookie": f"token={TOKEN}"}
    assert client.get("/api/state", headers=cookie).status == 401


@pytest.mark.parametrize(
    "host",
    [
        "",
        "127.0.0.1",
        "127.0.0.1:8001",
        "localhost",
        "evil.example:8000",
        "127.0.0.1:8000.evil.example",
        "[::1]:8000",
    ],
)
def test_another_host_is_misdirected_even_with_the_token(client, host):
    for path in ("/", *READS):
        assert client.get(path, headers={"host": host}).status == 421
    # Of two of a kind, programs take one or the other: they count as none.
    assert client.get("/api/state", headers={"Host": host}).status == 421
    assert client.get("/api/state", headers={"host": "localhost:8000"}).status == 200


@pytest.mark.parametrize("path", WRITES)
@pytest.mark.parametrize(
    "origin",
    [
        None,
        "",
        "null",
        "http://127.0.0.1:8001",
        "http://localhost:8000",
        f"https://{HOST}",
        "http://evil.example",
    ],
)
def test_a_write_of_another_origin_is_refused_and_does_nothing(client, session, path, origin):
    before, lines = session.state, len(session.journal.lines)
    assert client.post(path, WRITES[path], headers={"origin": origin}).status == 403
    assert client.post(path, WRITES[path], headers={"authorization": None}).status == 401
    assert session.state is before
    assert len(session.journal.lines) == lines


@pytest.mark.parametrize(
    "kind", [None, "", "text/plain", "application/x-www-form-urlencoded", "multipart/form-data"]
)
def test_a_write_that_is_no_json_is_refused(client, kind):
    for path, body in WRITES.items():
        assert client.post(path, body, headers={"content-type": kind}).status == 415


def test_other_methods_and_bodies_that_turn_out_too_large_do_nothing(client):
    for method in ("PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "CONNECT"):
        assert (client.ask(method, "/api/state").status, client.ask(method, "/").status) == (
            405,
            405,
        )
    assert client.ask("OPTIONS", "/api/state", headers={"authorization": None}).status == 401
    parts = [b'{"change": "' + b"x" * 100_000] + [b"x" * 100_000] * 30
    answer = client.post(
        "/api/change", data=parts, headers={"content-length": "10", "transfer-encoding": "chunked"}
    )
    assert answer.status == 413


@pytest.mark.parametrize(
    "length", [str(MOST_BYTES + 1), "1000000000000", "9" * 5000, "-1", "many", "1e3"]
)
def test_a_body_that_says_it_is_too_large_is_not_read(client, length):
    assert client.post("/api/change", data=b"{}", headers={"content-length": length}).status == 413


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"[[[",
        b"[" * 1_000_000,
        b"{" * 1000,
        b"null",
        b"\xff\xfe",
        b'{"change": NaN}',
        b'{"change": {"do": "add"}}',
        b'{"change": {"do": "add", "moving": [NaN, 1]}}',
        b'{"change": {"do": "add", "moving": [1e999, 1]}}',
        b'{"change": {"do": "use", "id": "m0-1", "used": "yes"}}',
        b'{"change": {"do": "use", "id": "m0-1"}, "x": 1}',
        b'{"change": {"do": "add", "moving": [1, 2], "label": "\\u0000"}}',
        b'{"version": true}',
    ],
)
def test_what_is_malformed_is_refused_and_changes_nothing(client, session, data):
    before = session.state
    for path in ("/api/change", "/api/snap", "/api/marks/import"):
        answer = client.post(path, data=data)
        assert answer.status == 400, path
        assert answer.json()["error"]
    assert session.state is before


@pytest.mark.parametrize(
    "query", ["side=x&x=1&y=1", "side=moving&x=NaN&y=1", "side=moving&x=1e99&y=1", "side=moving"]
)
def test_a_malformed_question_is_refused(client, query):
    assert client.get(f"/api/predict?{query}").status == 400


_CLIMBS = ("../", "..%2f", "%2e%2e/", "..\\", "....//", "/", "\0", "C:/", "file:///")
_TARGETS = ("run.toml", "etc/passwd", "edits/journal.jsonl", "server.py")


def test_no_path_leads_out(client):
    """Of every route with a parameter, every folder of the page, and every name that a client may
    send."""
    bases = ["/", "/vendor/", "/api/", "/api/tiles/", "/report/", "/api/tiles/p0/0/0/"]
    for base, climb, target in itertools.product(bases, _CLIMBS, _TARGETS):
        answer = client.get(f"{base}{climb * 3}{target}")
        assert answer.status in (400, 404), (base, climb, target)
        assert b"layers" not in answer.body
        assert b"root:" not in answer.body
    for name in ("/etc/passwd", "../../run.toml", "C:\\x.mat", "a" * 255, "\0.csv", "~/x.json"):
        answer = client.post("/api/marks/import", {"name": name, "text": "nothing"})
        assert answer.status == 400
        assert "root:" not in answer.body.decode()
    for layer in ("../x", "/etc", "no"):
        assert client.get(f"/api/state?layer={layer}").status == 400
    assert client.get("/api/marks/export?format=../json").status == 400


def test_every_answer_carries_the_headers_and_the_shell_no_secret(client, session):
    for path, how in [
        ("/", {}),
        ("/api/state", {}),
        ("/nothing", {}),
        ("/api/state", {"host": "evil"}),
        ("/api/state", {"authorization": None}),
    ]:
        answer = client.get(path, headers=how)
        assert {k: answer.headers[k] for k in HEADERS} == HEADERS, path
        assert "access-control-allow-origin" not in answer.headers
        assert "set-cookie" not in answer.headers
        assert "server" not in answer.headers
    for method, path in routes(client):
        if method == "GET" and not path.startswith(("/api/", "/report/")):
            body = client.get(path, headers={"authorization": None}).body
            assert TOKEN.encode() not in body
            assert str(session.folder).encode() not in body
    page = client.get("/").body.decode().lower()
    assert not [word for word in ("<style", "style=", " onclick") if word in page]
    assert page.count("<script") == page.count('<script type="module" src="') + page.count(
        '<script src="'
    )


def test_hostile_names_are_answered_as_json_text_alone(client):
    label = "<img src=x onerror=alert(1)>\"'&</script>"
    answer = client.post("/api/change", {"change": {"do": "label", "id": "m0-1", "label": label}})
    assert (answer.headers["content-type"], answer.json()["marks"][0]["label"]) == (
        "application/json",
        label,
    )
    region = {
        "do": "region",
        "name": label,
        "author": "=1+1",
        "reason": label,
        "polygon": [[0, 0], [9, 0], [9, 9]],
    }
    assert client.post("/api/change", {"change": region}).json()["regions"][0]["name"] == label


def test_a_fault_of_ours_says_no_more_than_its_kind(client, session, monkeypatch):
    def broken(*_a, **_k):
        raise RuntimeError("a secret of /home/somebody")

    monkeypatch.setattr(session, "undo", broken)
    answer = client.post("/api/undo")
    assert answer.status == 500
    assert "secret" not in answer.body.decode()
    assert {k: answer.headers[k] for k in HEADERS} == HEADERS


# --- the program ----------------------------------------------------------------------------------
def test_another_address_is_served_only_when_it_is_meant(made_run, planish):
    for host in ("0.0.0.0", "192.0.2.1"):
        code, _, err = planish("view", made_run, "--no-browser", "--host", host)
        assert (code, "--expose" in err) == (2, True)


def test_a_second_server_on_a_run_is_refused(session, planish):
    code, _, err = planish("view", session.folder, "--no-browser")
    assert (code, "--read-only" in err) == (3, True)


@pytest.mark.ci
def test_an_exposed_server_says_what_it_exposes_and_its_token_stands_in_no_file_and_no_log(
    serve, made_copy, tmp_path, monkeypatch
):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    log = tmp_path / "log.txt"
    with log.open("w") as errors:
        server = serve(made_copy, "--host", "0.0.0.0", "--expose", stderr=errors)
    assert server.ask("change", body=WRITES["/api/change"])["marks"][0]["used"] is False
    server.process.terminate()
    rest, _ = server.process.communicate(timeout=60)
    said = log.read_text()
    for part in (
        "exposed on 0.0.0.0",
        "token included",
        "maps and marks",
        "can change them",
        "nothing is encrypted",
    ):
        assert part in said
    assert server.token not in rest + said
    for file in (p for p in tmp_path.rglob("*") if p.is_file()):
        assert server.token.encode() not in file.read_bytes(), file
