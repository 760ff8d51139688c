"""The app as one ASGI application, with the files of its page from a fixed table, and the server of a session."""

from __future__ import annotations

import logging
import secrets
import socket
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from importlib.resources import files

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route

from planish.app import apply_routes, flattening_routes, maps_routes, marks_routes, surfaces_routes
from planish.app.applying import Applying
from planish.app.guard import Guard
from planish.app.live import Live
from planish.app.pictures import Pictures
from planish.app.session import Session, Stale
from planish.app.tiles import Tiles
from planish.core.errors import FileError, PlanishError, ResourceError

_PARTS = (marks_routes, maps_routes, surfaces_routes, apply_routes, flattening_routes)
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
        routes=[*_static(), *(route for part in _PARTS for route in part.ROUTES)],
        middleware=[Middleware(Guard, token=token, hosts=tuple(hosts))],
        exception_handlers={PlanishError: _error_response},
    )
    app.state.session = session
    app.state.live = Live(session)
    app.state.pictures = Pictures.of(session.folder, session.image_params)
    app.state.tiles = Tiles(app.state.pictures)
    app.state.sheets = {}
    app.state.applying = Applying(session)
    return app


def _static() -> list[BaseRoute]:
    """A route for each file of the page, read once: no path of a request is ever looked up on the disk."""
    root = files("planish.app") / "static"
    routes: list[BaseRoute] = []
    for folder, prefix in ((root, "/"), (root / "vendor", "/vendor/")):
        for file in folder.iterdir():
            kind = _KINDS.get(f".{file.name.rpartition('.')[2]}")
            if file.is_file() and kind is not None:
                serve = _file(file.read_bytes(), kind)
                routes.append(Route(f"{prefix}{file.name}", serve))
                if file.name == "index.html":
                    routes.append(Route("/", serve))
    return routes


def _file(data: bytes, kind: str) -> Callable[[Request], Awaitable[Response]]:
    async def serve(_request: Request) -> Response:
        return Response(data, media_type=f"{kind}; charset=utf-8")

    return serve


async def _error_response(_request: Request, error: Exception) -> Response:
    """An error that a person can do something about."""
    status = 409 if isinstance(error, Stale) else 507 if isinstance(error, ResourceError) else 400
    assert isinstance(error, PlanishError)
    return JSONResponse({"error": error.text}, status)


def serve(session: Session, *, host: str, port: int, started: Callable[[str], None]) -> None:
    """Serve a session until the process is interrupted.

    Parameters
    ----------
    session : Session
        It is closed at the end.
    host, port
        Where to listen; any free port where 0.
    started : callable
        Called with the address, token included, when it is open.

    Raises
    ------
    FileError
        If nothing can listen there.
    """
    token = secrets.token_urlsafe(32)
    try:
        with _listening(host, port) as socket_:
            bound = int(socket_.getsockname()[1])
            app = create_app(session, token=token, hosts=[f"{name}:{bound}" for name in _names(host)])
            config = uvicorn.Config(
                app, log_config=None, access_log=False, server_header=False, date_header=False, lifespan="off",
                proxy_headers=False, timeout_graceful_shutdown=1, ws="none", http="h11", loop="asyncio",
            )  # fmt: skip
            logging.getLogger("uvicorn").setLevel(logging.ERROR)
            shown = "127.0.0.1" if host in ("127.0.0.1", "localhost", "0.0.0.0") else host
            started(f"http://{shown}:{bound}/#token={token}")
            try:
                with suppress(KeyboardInterrupt):  # how a server ends
                    uvicorn.Server(config).run(sockets=[socket_])
            finally:
                app.state.applying.close()
    finally:
        session.close()


def _listening(host: str, port: int) -> socket.socket:
    try:
        listening = socket.create_server((host, port))
        # Those that are accepted inherit it. Else the kernel keeps the second part of each answer back for 40 ms.
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return listening
    except OSError as error:
        raise FileError(
            f"Nothing can listen on {host}:{port} ({error.strerror or error}). Give another --port; 0 takes a free one."
        ) from error


def _names(host: str) -> list[str]:
    """List the names of the server in requests."""
    loopback = ["127.0.0.1", "localhost"]
    if host in loopback:
        return loopback
    if host != "0.0.0.0":
        return [host]
    name = socket.gethostname()
    try:
        addresses = sorted({str(address[4][0]) for address in socket.getaddrinfo(name, None, socket.AF_INET)})
    except OSError:
        addresses = []
    return [*loopback, name, *addresses]
