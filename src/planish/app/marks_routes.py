"""Routes of what is changed.

The session, its marks, undo and redo, news for every window, and Apply.
"""

import asyncio
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import anyio
from anyio.to_thread import run_sync
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response, StreamingResponse

from planish.app.answers import Answer
from planish.app.apply import Busy, Progress
from planish.app.changes import FARTHEST_UM, Change, ChangeError, Id, Import, Layer
from planish.app.exchange import MarkFile, exported, imported
from planish.app.picture import PLANES, finite_or_none
from planish.app.served import Served, open_new_run, served_of
from planish.app.session import Session, Stale, pairs_of
from planish.app.snap import not_snapped, snapped
from planish.app.view_routes import required_point, route
from planish.core.tables import naming_faults
from planish.core.transform import Similarity
from planish.core.typing import Entries, Pair
from planish.io.map_groups import read_group
from planish.marks.exchange import FORMATS
from planish.marks.exchange.formats import TARGETS
from planish.marks.exchange.lists import Part
from planish.register import RegistrationParams
from planish.run import register_texture
from planish.run.run import MAPS
from planish.run.study import changed


class _Body(Part):
    """The version that the page has seen: all that undo and redo need."""

    version: int | None = None


class _ChangeBody(_Body):
    change: Change


class _SnapBody(_Body):
    id: Id
    layer: Layer | None = None


class _ImportBody(MarkFile, _Body):
    layer: Layer | None = None
    second: MarkFile | None = None


class _TextureBody(_Body):
    layer: Layer | None = None
    near: Pair | None = None
    place: Similarity | None = None


def get_session(request: Request) -> Response:
    """Give what does not change while the server runs."""
    served = served_of(request)
    session = served.session
    checks = session.results.checks
    marks_checks = (check for check in checks if check.name == "marks" and check.layers)
    limits_um = {check.layers[0]: finite_or_none(check.limit) for check in marks_checks}
    layers = [_layer_facts(session, name, limits_um.get(name)) for name in session.layers]
    return Answer(
        {
            "run": served.run,
            "said": served.message,
            "read_only": session.read_only,
            "reason": session.reason,
            "linked": session.results.is_link,
            "layers": layers,
            "holes": layers[0]["holes"],
            "models": RegistrationParams.model_json_schema()["properties"]["model"]["enum"],
            "export_formats": [{"name": name, "title": FORMATS[name].title} for name in TARGETS],
            "pictures": [picture.described() for picture in session.pictures],
        }
    )


def _layer_facts(session: Session, layer: str, limit_um: float | None) -> Entries:
    """Where a layer is shown, and its holes as circles (x, y, diameter) in um, by plane.

    ``limit_um``: the limit of the check of its marks; None where it was not checked.
    """
    circles: Entries = {}
    shown: dict[str, dict[str, str]] = {}
    for plane, holes in session.holes(layer).items():
        numbers = holes[["x", "y", "diameter"]].to_array()
        circles[plane] = numbers.values.T.tolist()
    for plane in PLANES:
        shown_plane, shown_layer = session.shown_by(layer, plane)
        shown[plane] = {"plane": shown_plane, "layer": shown_layer}
    return {
        "name": layer,
        "to": session.target(layer),
        "headline": session.results.layer(layer).headline,
        "holes": circles,
        "names": session.view_names(layer),
        "shown": shown,
        "limit_um": limit_um,
    }


def _layer_name(request: Request) -> str:
    return request.query_params.get("layer") or served_of(request).session.state.first_layer


def _state_of(request: Request) -> Entries:
    return served_of(request).live.shown(_layer_name(request))


async def get_events(request: Request) -> Response:
    """Send one line of JSON for each new version, and one each half second.

    By the latter a lost server is noticed, and another run that is served now.
    """
    session = served_of(request).session
    new_version = anyio.Event()
    loop = asyncio.get_running_loop()

    async def lines() -> AsyncIterator[bytes]:
        nonlocal new_version
        # From any thread.
        stop_listening = session.listen(
            lambda: loop.call_soon_threadsafe(lambda: new_version.set()) and None
        )
        try:
            while True:
                served_now: Served = request.app.state.served
                news = {"version": session.version, "run": served_now.run}
                yield json.dumps(news).encode() + b"\n"
                with anyio.move_on_after(0.5):
                    await new_version.wait()
                new_version = anyio.Event()
        finally:
            stop_listening()

    return StreamingResponse(lines(), media_type="application/x-ndjson")


def _changing(
    model: type[_Body], action: Callable[[Session, Any], str | None]
) -> Callable[..., Awaitable[Response]]:
    """Handle what changes the session.

    ``model`` is what a request holds, ``action`` makes the change of it, and may give a sentence to
    show. The answer is the state after it, also where it came too late.
    """

    async def handle(request: Request) -> Response:
        with naming_faults("This cannot be read", error=ChangeError):
            body = model.model_validate_json(await request.body() or b"{}")

        def act() -> Response:
            try:
                message = action(served_of(request).session, body)
            except Stale as error:
                return Answer({"error": error.text} | _state_of(request), 409)
            message_field = {"said": message} if message else {}
            return Answer(_state_of(request) | message_field)

        return await run_sync(act)

    return handle


def _change(session: Session, body: _ChangeBody) -> None:
    session.change(body.change, version=body.version)


def _undo(session: Session, body: _Body) -> None:
    session.undo(version=body.version)


def _redo(session: Session, body: _Body) -> None:
    session.redo(version=body.version)


def _snap(session: Session, body: _SnapBody) -> str:
    layer = body.layer or session.state.first_layer
    mark = session.state.mark(layer, body.id)
    move = snapped(session, layer, mark)
    session.change(move, version=body.version)
    return not_snapped(session, layer, mark, move)


def _import(session: Session, body: _ImportBody) -> str:
    change = imported(session, body.layer or session.state.first_layer, body, body.second)
    session.change(change, version=body.version)
    return f"{len(change.marks)} pairs of marks imported."


def _find_texture(session: Session, body: _TextureBody) -> str | None:
    """Take tiles of the texture in place of all marks.

    The tiles are about a place in the image, or where a person laid the maps.
    """
    layer = body.layer or session.state.first_layer
    if session.image is None:
        raise ChangeError(
            "This run is linked. Link it anew by its texture: planish link ... --by texture."
        )
    holes = session.holes(layer)
    registration = register_texture(
        read_group(session.folder / MAPS, "maps"),
        session.image,
        mirrored=session.mirrored(layer),
        place=body.place,
        params=changed(session.study.registration, near=body.near),
        holes=(holes["moving"], holes["fixed"]),
    )
    change = Import(layer=layer, marks=pairs_of(registration.marks))
    session.change(change, version=body.version)
    return registration.sentence


def get_predict(request: Request) -> Response:
    """Predict where a point of one plane lies in the other."""
    live = served_of(request).live
    side = request.query_params.get("side", "")
    if side not in PLANES:
        raise ChangeError("A point is predicted of side=moving or side=fixed.")
    x, y = required_point(request)
    if max(abs(x), abs(y)) > FARTHEST_UM:
        raise ChangeError(f"({x:g}, {y:g}) is not a place in um.")
    prediction = live.fit(_layer_name(request)).predicted(side, (x, y))
    if prediction is None:
        return Answer(None)
    (target_x, target_y), error_um, error_text = prediction
    return Answer({"x": target_x, "y": target_y, "error_um": error_um, "text": error_text})


def get_export(request: Request) -> Response:
    """The marks as a file."""
    layer = _layer_name(request)
    format_name = request.query_params.get("format", "json")
    served = served_of(request)
    fit = served.live.fit(layer)
    name, content = exported(served.session, layer, format_name, fit)
    headers = {"content-disposition": f'attachment; filename="{name}"'}
    return Response(content, headers=headers, media_type="application/octet-stream")


def _progress_response(progress: Progress, status: int = 200, **fields: str) -> Response:
    return Answer(fields | progress.model_dump(exclude_none=True), status)


def post_apply(request: Request) -> Response:
    """Begin to make a run."""
    applying = served_of(request).applying
    try:
        return _progress_response(applying.start(), 202)
    except Busy as error:
        return _progress_response(applying.progress, 409, error=error.text)


def post_open(request: Request) -> Response:
    """Serve the run that was made from now on."""
    return Answer({"run": open_new_run(request.app)})


def get_report(request: Request) -> Response:
    """The page of a run that was made here: its address is a secret of its own."""
    path = served_of(request).applying.reports.get(request.path_params["ticket"])
    if path is None:
        return PlainTextResponse("There is no such report.", 404)
    # The page is one file that needs nothing else; it keeps no script, and none that got into it
    # would be carried out.
    policy = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; frame-ancestors 'none'"
    headers = {"content-security-policy": policy, "cache-control": "no-store"}
    try:
        return Response(path.read_bytes(), headers=headers, media_type="text/html; charset=utf-8")
    except OSError:
        return PlainTextResponse("The run is not there any more.", 404)


ROUTES = [
    route("/api/session", get_session),
    route("/api/state", lambda r: Answer(_state_of(r))),
    route("/api/events", get_events),
    route("/api/change", _changing(_ChangeBody, _change), "POST"),
    route("/api/undo", _changing(_Body, _undo), "POST"),
    route("/api/redo", _changing(_Body, _redo), "POST"),
    route("/api/snap", _changing(_SnapBody, _snap), "POST"),
    route("/api/predict", get_predict),
    route("/api/marks/texture", _changing(_TextureBody, _find_texture), "POST"),
    route("/api/marks/import", _changing(_ImportBody, _import), "POST"),
    route("/api/marks/export", get_export),
    route("/api/apply", lambda r: _progress_response(served_of(r).applying.shown)),
    route("/api/apply", post_apply, "POST"),
    route(
        "/api/apply/cancel", lambda r: _progress_response(served_of(r).applying.cancel()), "POST"
    ),
    route("/api/apply/open", post_open, "POST"),
    route("/report/{ticket}", get_report),
]
