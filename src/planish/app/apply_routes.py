"""Routes of Apply: begin, how far it is, cancel, and the page of the run that was made."""

from __future__ import annotations

from pathlib import Path

from anyio.to_thread import run_sync
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route

from planish.app.applying import Applying, Busy, Progress

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
    Route("/api/apply", get_apply),
    Route("/api/apply", post_apply, methods=["POST"]),
    Route("/api/apply/cancel", post_cancel, methods=["POST"]),
    Route("/report/{ticket}", get_report),
]
