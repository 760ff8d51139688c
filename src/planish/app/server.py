"""The app as one ASGI application: routes of its parts, the files of the page from a fixed table, and the guard."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from importlib import import_module
from importlib.resources import files
from importlib.util import find_spec

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route

from planish.app.applying import Applying
from planish.app.guard import Guard
from planish.app.live import Live
from planish.app.pictures import Pictures
from planish.app.session import Session, Stale
from planish.app.tiles import Tiles
from planish.core.errors import PlanishError, ResourceError

PARTS = ("marks", "maps", "surfaces", "apply", "flattening")
"""Parts of the app; the module ``NAME_routes`` of each holds its ``ROUTES``."""

_KINDS = {".html": "text/html", ".js": "text/javascript", ".css": "text/css"}


def create_app(session: Session, *, token: str, hosts: Sequence[str]) -> Starlette:
    """Put the app together.

    Parameters
    ----------
    session : Session
        What is served; handlers find it as ``request.app.state.session``.
    token : str
        Without it no data are given.
    hosts : sequence of str
        Names with port under which the server is called, such as ``127.0.0.1:8000``.
    """
    app = Starlette(
        routes=[*_static(), *_routes()],
        middleware=[Middleware(Guard, token=token, hosts=tuple(hosts))],
        exception_handlers={PlanishError: _known},
    )
    app.state.session = session
    app.state.live = Live(session)
    app.state.pictures = Pictures.of(session.folder, session.image_params)
    app.state.tiles = Tiles(app.state.pictures)
    app.state.applying = Applying(session)
    return app


def _routes() -> list[BaseRoute]:
    found: list[BaseRoute] = []
    for part in PARTS:
        name = f"planish.app.{part}_routes"
        if find_spec(name) is not None:
            found += import_module(name).ROUTES
    return found


def _static() -> list[BaseRoute]:
    """A route for each file of the page, read once: no path of a request is ever looked up on the disk."""
    root = files("planish.app") / "static"
    found: list[BaseRoute] = []
    for folder, prefix in ((root, "/"), (root / "vendor", "/vendor/")):
        for file in folder.iterdir():
            kind = _KINDS.get(f".{file.name.rpartition('.')[2]}")
            if file.is_file() and kind is not None:
                serve = _file(file.read_bytes(), kind)
                found.append(Route(f"{prefix}{file.name}", serve))
                if file.name == "index.html":
                    found.append(Route("/", serve))
    return found


def _file(data: bytes, kind: str) -> Callable[[Request], Awaitable[Response]]:
    async def serve(_request: Request) -> Response:
        return Response(data, media_type=f"{kind}; charset=utf-8")

    return serve


async def _known(_request: Request, error: Exception) -> Response:
    """An error that a person can do something about."""
    status = 409 if isinstance(error, Stale) else 507 if isinstance(error, ResourceError) else 400
    assert isinstance(error, PlanishError)
    return JSONResponse({"error": error.text}, status)
