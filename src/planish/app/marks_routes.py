"""Routes of what is changed: the session, its marks, undo and redo, news for every window, and Apply."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import anyio
import numpy as np
from anyio.to_thread import run_sync
from pydantic import BaseModel, ConfigDict, ValidationError
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route

from planish.app.applying import Applying, Busy, Progress
from planish.app.changes import FARTHEST_UM, Change, ChangeError, Id, Layer, faults_of
from planish.app.exchange import MarkFile, exported, imported
from planish.app.live import Live
from planish.app.picture import PLANES
from planish.app.session import Session, Stale
from planish.app.snap import not_snapped, snapped
from planish.marks.exchange import FORMATS
from planish.marks.exchange.formats import TARGETS
from planish.marks.find import USUAL_UM
from planish.register import RegistrationParams

HEARTBEAT_S = 0.5


class _Body(BaseModel):
    """The version that the page has seen: all that undo and redo need."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)
    version: int | None = None


class _ChangeBody(_Body):
    change: Change


class _SnapBody(_Body):
    id: Id
    layer: Layer | None = None


class _ImportBody(MarkFile):
    layer: Layer | None = None
    second: MarkFile | None = None
    version: int | None = None


def _session(request: Request) -> Session:
    return request.app.state.session


async def _body_of(request: Request, model: type[Any]) -> Any:
    """The body of a request; ChangeError where it is no such thing."""
    try:
        return model.model_validate_json(await request.body() or b"{}")
    except ValidationError as error:
        raise ChangeError(f"This cannot be read: {faults_of(error)}.") from error


# --- what there is ---------------------------------------------------------------------------------------------------


async def get_session(request: Request) -> Response:
    """Give what does not change while the server runs."""
    session, pictures = _session(request), request.app.state.pictures

    def described() -> dict[str, Any]:
        layers: list[dict[str, Any]] = []
        for layer in session.layers:
            circles: dict[str, list[list[float]]] = {}
            for plane, holes in session.holes(layer).items():
                um = holes["diameter"].values if "diameter" in holes else np.full(holes.sizes["mark"], np.nan)
                columns = holes["x"].values, holes["y"].values, np.where(np.isfinite(um), um, USUAL_UM)
                circles[plane] = np.stack(columns, 1).tolist()
            owners = {plane: session.shown_by(layer, plane) for plane in PLANES}
            shown = {plane: {"plane": owner[0], "layer": owner[1]} for plane, owner in owners.items()}
            headline = session.results.layer(layer).headline
            layers.append(
                {"name": layer, "to": session.target(layer), "headline": headline, "holes": circles, "shown": shown}
            )
        return {
            "run": session.folder.name, "read_only": session.read_only, "reason": session.reason,
            "linked": session.results.is_link, "layers": layers, "holes": layers[0]["holes"],
            "models": RegistrationParams.model_json_schema()["properties"]["model"]["enum"],
            "export_formats": [{"name": name, "title": FORMATS[name].title} for name in TARGETS],
            "pictures": pictures.described(),
        }  # fmt: skip

    return JSONResponse(await run_sync(described))


async def get_state(request: Request) -> Response:
    """Give the state as it stands."""
    return JSONResponse(await run_sync(_state_of, request))


def _layer(request: Request) -> str:
    """The registration that is asked for; the first where none is."""
    return request.query_params.get("layer") or _session(request).state.first


def _state_of(request: Request) -> dict[str, Any]:
    live: Live = request.app.state.live
    return live.shown(_layer(request))


async def get_events(request: Request) -> Response:
    """One line of JSON for each new version, and one each half second, by which a lost server is noticed."""
    session = _session(request)
    news, loop = anyio.Event(), asyncio.get_running_loop()

    async def lines() -> AsyncIterator[bytes]:
        nonlocal news
        stop = session.listen(lambda: loop.call_soon_threadsafe(lambda: news.set()) and None)  # from any thread
        try:
            while True:
                yield json.dumps({"version": session.version}).encode() + b"\n"
                with anyio.move_on_after(HEARTBEAT_S):
                    await news.wait()
                news = anyio.Event()
        finally:
            stop()

    return StreamingResponse(lines(), media_type="application/x-ndjson")


# --- what is changed -------------------------------------------------------------------------------------------------


async def post_change(request: Request) -> Response:
    """Make a change."""
    body: _ChangeBody = await _body_of(request, _ChangeBody)
    return await _state_after(request, lambda: _session(request).change(body.change, version=body.version))


async def post_undo(request: Request) -> Response:
    """Take the last change back."""
    body: _Body = await _body_of(request, _Body)
    return await _state_after(request, lambda: _session(request).undo(version=body.version))


async def post_redo(request: Request) -> Response:
    """Make it again."""
    body: _Body = await _body_of(request, _Body)
    return await _state_after(request, lambda: _session(request).redo(version=body.version))


async def post_snap(request: Request) -> Response:
    """Move both ends of a mark into the holes that they lie in."""
    body: _SnapBody = await _body_of(request, _SnapBody)
    session = _session(request)

    def snap() -> str:
        layer = body.layer or session.state.first
        mark = session.state.mark(layer, body.id)
        move = snapped(session, request.app.state.pictures, layer, mark)
        session.change(move, version=body.version)
        return not_snapped(mark, move)

    return await _state_after(request, snap)


async def post_import(request: Request) -> Response:
    """Take the marks of a file in place of all that are there."""
    body: _ImportBody = await _body_of(request, _ImportBody)
    session = _session(request)

    def take() -> str:
        layer = body.layer or session.state.first
        change = imported(session, request.app.state.pictures, layer, body, body.second)
        session.change(change, version=body.version)
        return f"{len(change.marks)} pairs of marks imported."

    return await _state_after(request, take)


async def _state_after(request: Request, action: Callable[[], object]) -> Response:
    """Do something, and give the state after it; with what stands now where that was seen too late."""

    def act() -> Response:
        try:
            message = action()
        except Stale as error:
            return JSONResponse({"error": error.text} | _state_of(request), 409)
        return JSONResponse(_state_of(request) | ({"said": message} if isinstance(message, str) and message else {}))

    return await run_sync(act)


# --- what is asked for ------------------------------------------------------------------------------------------------


async def get_predict(request: Request) -> Response:
    """Predict where a point of one plane lies in the other."""
    live: Live = request.app.state.live
    side, *point = (request.query_params.get(key, "") for key in ("side", "x", "y"))
    if side not in PLANES:
        raise ChangeError("A point is predicted of side=moving or side=fixed.")
    point_um = [float("nan"), float("nan")]
    for k, text in enumerate(point):
        with suppress(ValueError):
            point_um[k] = float(text)
        if not abs(point_um[k]) <= FARTHEST_UM:
            raise ChangeError(f"{text[:40]!r} is no place in um.")
    x, y = point_um
    prediction = await run_sync(lambda: live.fit(_layer(request)).predicted(side, (x, y)))
    if prediction is None:
        return JSONResponse(None)
    (other_x, other_y), error_um, words = prediction
    return JSONResponse({"x": other_x, "y": other_y, "error_um": error_um, "text": words})


async def get_export(request: Request) -> Response:
    """The marks as a file."""
    session = _session(request)
    live: Live = request.app.state.live
    layer, to = _layer(request), request.query_params.get("format", "json")

    def write() -> tuple[str, bytes]:
        return exported(session, request.app.state.pictures, layer, to, live.fit(layer))

    name, data = await run_sync(write)
    headers = {"content-disposition": f'attachment; filename="{name}"'}
    return Response(data, headers=headers, media_type="application/octet-stream")


# The page is one file that needs nothing else; it keeps no script, and none that got into it would be carried out.
_HEADERS = {
    "content-security-policy": "default-src 'none'; img-src data:; style-src 'unsafe-inline'; frame-ancestors 'none'",
    "cache-control": "no-store",
}


def _applying(request: Request) -> Applying:
    return request.app.state.applying


def _answer(progress: Progress, status: int = 200) -> Response:
    return JSONResponse(progress.model_dump(exclude_none=True), status)


async def get_apply(request: Request) -> Response:
    """Give the progress of the run that is made."""
    return _answer(_applying(request).progress)


async def post_apply(request: Request) -> Response:
    """Begin to make a run."""
    applying = _applying(request)
    try:
        return _answer(await run_sync(applying.start), 202)
    except Busy as error:
        return JSONResponse({"error": error.text} | applying.progress.model_dump(exclude_none=True), 409)


async def post_cancel(request: Request) -> Response:
    """Stop, and leave nothing."""
    return _answer(await run_sync(_applying(request).cancel))


async def get_report(request: Request) -> Response:
    """The page of a run that was made here: its address is a secret of its own."""
    path = _applying(request).reports.get(request.path_params["ticket"])
    if path is None:
        return PlainTextResponse("There is no such report.", 404)
    try:
        return Response(await run_sync(Path(path).read_bytes), headers=_HEADERS, media_type="text/html; charset=utf-8")
    except OSError:
        return PlainTextResponse("The run is not there any more.", 404)


ROUTES = [
    Route("/api/session", get_session),
    Route("/api/state", get_state),
    Route("/api/events", get_events),
    Route("/api/change", post_change, methods=["POST"]),
    Route("/api/undo", post_undo, methods=["POST"]),
    Route("/api/redo", post_redo, methods=["POST"]),
    Route("/api/snap", post_snap, methods=["POST"]),
    Route("/api/predict", get_predict),
    Route("/api/marks/import", post_import, methods=["POST"]),
    Route("/api/marks/export", get_export),
    Route("/api/apply", get_apply),
    Route("/api/apply", post_apply, methods=["POST"]),
    Route("/api/apply/cancel", post_cancel, methods=["POST"]),
    Route("/report/{ticket}", get_report),
]
