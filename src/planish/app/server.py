"""The app as one ASGI application: what the server lets in, the files of its page, and the server of a session."""

from __future__ import annotations

import hmac
import json
import logging
import secrets
import socket
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from planish.app import marks_routes, view_routes
from planish.app.applying import Applying
from planish.app.live import Live
from planish.app.pictures import Pictures, Tiles
from planish.app.session import Session, Stale
from planish.core.errors import FileError, PlanishError, ResourceError

MOST_BYTES = 2_000_000
"""Of one request: what a person changes is small."""

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
    "frame-ancestors 'none'"
)
HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cache-control": "no-store",
}
_READS = {"GET", "HEAD"}
_log = logging.getLogger("planish.app")


@dataclass(frozen=True, slots=True, kw_only=True)
class Refused(Exception):
    """A request that is not let in."""

    status: int
    text: str


class TooLarge(Exception):
    """A body that goes on beyond what is allowed, whatever its headers said."""


@dataclass(frozen=True, slots=True, eq=False)
class Guard:
    """Middleware: 421 for another host, 401 without the token, 403, 415, 413 for writes that are not the page's.

    Attributes
    ----------
    app : ASGIApp
        What is guarded.
    token : str
        Wanted of every request of data, as ``Authorization: Bearer``.
    hosts : sequence of str
        Names with port under which the server is called.
    """

    app: ASGIApp
    token: str
    hosts: Sequence[str]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request in, or answer it."""
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        if scope["type"] != "http":  # web sockets: there are none
            await send({"type": "websocket.close", "code": 1008})
            return
        started = False

        async def answer(message: Message) -> None:
            nonlocal started
            if message["type"] == "http.response.start":
                started = True
                present = {name for name, _ in message.get("headers", [])}
                extra = [(k.encode(), v.encode()) for k, v in HEADERS.items() if k.encode() not in present]
                message = {**message, "headers": [*message.get("headers", []), *extra]}
            await send(message)

        try:
            self._check(scope)
            await self.app(scope, _limited(receive), answer)
        except Refused as refused:
            await _send_error(refused.status, refused.text, answer)
        except TooLarge:
            if started:
                raise
            await _send_error(413, f"A request may have {MOST_BYTES} bytes.", answer)
        except Exception as error:
            _log.exception("A fault in planish")
            if started:
                raise
            text = f"A fault in planish: {type(error).__name__}. The terminal in which it was started says more."
            await _send_error(500, text, answer)

    def _check(self, scope: Scope) -> None:
        headers: list[tuple[bytes, bytes]] = scope["headers"]
        host = _single_header(headers, b"host")
        if host not in self.hosts:
            raise Refused(status=421, text="This server is not called by that name.")
        # All but the files of the page, and a report, whose address is a secret itself.
        data = f"{scope['path']}/".startswith("/api/")
        if data and not hmac.compare_digest(_single_header(headers, b"authorization"), f"Bearer {self.token}"):
            raise Refused(status=401, text="The token of this start is missing. Open the address that planish printed.")
        if scope["method"] in _READS:
            return
        if scope["method"] != "POST" or not data:
            raise Refused(status=405, text="There is nothing to be written so.")
        if _single_header(headers, b"origin") != f"http://{host}":
            raise Refused(status=403, text="Another page may change nothing here.")
        if _single_header(headers, b"content-type").partition(";")[0].strip().lower() != "application/json":
            raise Refused(status=415, text="JSON is needed, as application/json.")
        length = _single_header(headers, b"content-length") or "0"
        if not length.isdecimal() or len(length) > 12 or int(length) > MOST_BYTES:
            raise Refused(status=413, text=f"A request may have {MOST_BYTES} bytes.")


def _single_header(headers: list[tuple[bytes, bytes]], name: bytes) -> str:
    """The value of a header that is there once; nothing of one that is there twice, or is no text."""
    matches = [value for key, value in headers if key.lower() == name]
    try:
        return matches[0].decode("ascii") if len(matches) == 1 else ""
    except UnicodeDecodeError:
        return ""


def _limited(receive: Receive) -> Receive:
    received = 0

    async def part() -> Message:
        nonlocal received
        message = await receive()
        received += len(message.get("body", b""))
        if received > MOST_BYTES:
            raise TooLarge
        return message

    return part


async def _send_error(status: int, text: str, send: Any) -> None:
    body = json.dumps({"error": text}).encode()
    headers = [(b"content-type", b"application/json"), (b"content-length", str(len(body)).encode())]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})


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
        routes=[*_static(), *marks_routes.ROUTES, *view_routes.ROUTES],
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

                async def serve(_request: Request, data: bytes = file.read_bytes(), kind: str = kind) -> Response:
                    return Response(data, media_type=f"{kind}; charset=utf-8")

                routes.append(Route(f"{prefix}{file.name}", serve))
                if file.name == "index.html":
                    routes.append(Route("/", serve))
    return routes


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
        try:
            listening = socket.create_server((host, port))
            # Those that are accepted inherit it. Else the kernel keeps the second part of each answer back for 40 ms.
            listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError as error:
            raise FileError(
                f"Nothing can listen on {host}:{port} ({error.strerror or error}). Give another --port; 0 takes a free "
                "one."
            ) from error
        with listening as socket_:
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


def _names(host: str) -> list[str]:
    """List the names of the server in requests."""
    loopback, addresses = ["127.0.0.1", "localhost"], list[str]()
    if host != "0.0.0.0":
        return loopback if host in loopback else [host]
    name = socket.gethostname()
    with suppress(OSError):
        addresses = sorted({str(address[4][0]) for address in socket.getaddrinfo(name, None, socket.AF_INET)})
    return [*loopback, name, *addresses]
