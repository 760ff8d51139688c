"""The app as one ASGI application.

What the server lets in, the files of its page, and the server of a session.
"""

import hmac
import logging
import secrets
import socket
import threading
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, dataclass
from functools import partial
from importlib.resources import files
from urllib.parse import unquote

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from planish.app import marks_routes, snap, view_routes
from planish.app.answers import Answer
from planish.app.apply import Applying
from planish.app.served import Served
from planish.app.session import Session, Stale
from planish.core.errors import FileError, PlanishError, ResourceError
from planish.register.by_texture.search import Undecided

MOST_BYTES = 2_000_000
"""Of one request: what a person changes is small."""

_TOO_LARGE = f"A request may have {MOST_BYTES} bytes."
HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
        "connect-src 'self'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cache-control": "no-store",
}
_log = logging.getLogger("planish.app")


class Refused(Exception):
    """A request that is not let in: status and text of the answer, and further fields of it."""


@dataclass(frozen=True, slots=True, eq=False)
class Guard:
    """Middleware that refuses another host, a missing token, and writes that are not the page's.

    421 for another host, 401 without the token, 403, 415, 413 for such writes; 409 for those of a
    window that shows another run than the one that is served.
    """

    app: ASGIApp
    token: str  # wanted of every request of data, as ``Authorization: Bearer``
    hosts: Sequence[str]  # names with port under which the server is called

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:  # noqa: C901
        """Let a request in, or answer it."""
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        if scope["type"] != "http":  # web sockets: there are none
            await send({"type": "websocket.close", "code": 1008})
            return
        is_started = False
        received_bytes = 0

        async def limited() -> Message:
            nonlocal received_bytes
            message = await receive()
            received_bytes += len(message.get("body", b""))
            if received_bytes > MOST_BYTES:  # whatever its headers said
                raise Refused(413, _TOO_LARGE)
            return message

        async def answer(message: Message) -> None:
            nonlocal is_started
            if message["type"] == "http.response.start":
                is_started = True
                headers = MutableHeaders(scope=message)
                for name, text in HEADERS.items():
                    headers.setdefault(name, text)
            await send(message)

        # What is served may be another run before this request ends.
        served: Served = scope["app"].state.served
        scope.setdefault("state", {})["served"] = served
        try:
            self._check(scope, served.run)
            await self.app(scope, limited, answer)
        except Exception as error:
            more: dict[str, str] = {}
            if isinstance(error, Refused):
                status, text, *fields = error.args
                more = dict(*fields)
            else:
                _log.exception("A fault in planish")
                status = 500
                fault = f"A fault in planish: {type(error).__name__}."
                text = f"{fault} The terminal in which it was started says more."
            if is_started:
                raise
            await Answer({"error": text} | more, status)(scope, receive, answer)

    def _check(self, scope: Scope, served_run: str) -> None:
        """Raise Refused for a request that is not let in."""
        headers = Headers(raw=[(name.lower(), text) for name, text in scope["headers"]])
        single = partial(_single, headers)
        host = single("host")
        if host not in self.hosts:
            raise Refused(421, "This server is not called by that name.")
        # All but the files of the page, and a report, whose address is a secret itself.
        is_data = f"{scope['path']}/".startswith("/api/")
        authorization = single("authorization").encode()
        if is_data and not hmac.compare_digest(authorization, f"Bearer {self.token}".encode()):
            raise Refused(
                401, "The token of this start is missing. Open the address that planish printed."
            )
        if scope["method"] in ("GET", "HEAD"):
            return
        if scope["method"] != "POST" or not is_data:
            raise Refused(405, "Nothing can be written at this address.")
        _check_write(single, host, served_run)


def _check_write(single: Callable[[str], str], host: str, served_run: str) -> None:
    """Raise Refused for a change that is not that of the page that is served."""
    if single("origin") != f"http://{host}":
        raise Refused(403, "Another page cannot change anything here.")
    if single("content-type").partition(";")[0].strip().lower() != "application/json":
        raise Refused(415, "JSON is needed, as application/json.")
    length = single("content-length") or "0"
    if not length.isdecimal() or len(length) > 12 or int(length) > MOST_BYTES:
        raise Refused(413, _TOO_LARGE)
    shown_run = unquote(single("planish-run"))
    if shown_run and shown_run != served_run:
        raise Refused(
            409,
            f"This window shows {shown_run}, and planish serves {served_run} now. Nothing was"
            f" changed in either. Reload the page to go on with {served_run}.",
            {"served": served_run},
        )


def _single(headers: Headers, name: str) -> str:
    """The text of a header that is there once."""
    texts = headers.getlist(name)
    if len(texts) == 1:
        return texts[0]
    return ""


def create_app(session: Session, *, token: str, hosts: Sequence[str]) -> Starlette:
    """Put the app together.

    Parameters
    ----------
    session : Session; what is served first; handlers find it with ``served_of(request)``
    token : str; without it no data are given
    hosts : sequence of str; names with port under which the server is called, such as
    ``127.0.0.1:8000``
    """
    app = Starlette(
        routes=[*_static(), *marks_routes.ROUTES, *view_routes.ROUTES],
        middleware=[Middleware(Guard, token=token, hosts=tuple(hosts))],
        exception_handlers={PlanishError: _error_response},
    )
    app.state.served = Served(session, Applying(session))
    app.state.switching = threading.Lock()
    return app


def _static() -> list[BaseRoute]:
    """Make a route for each file of the page, read once.

    No path of a request is ever looked up on the disk.
    """
    media_types = {"html": "text/html", "js": "text/javascript", "css": "text/css"}
    root = files("planish.app") / "static"
    routes: list[BaseRoute] = []
    for folder, prefix in ((root, "/"), (root / "vendor", "/vendor/")):
        for file in folder.iterdir():
            media_type = media_types.get(file.name.rpartition(".")[2])
            if file.is_file() and media_type is not None:
                response = Response(file.read_bytes(), media_type=f"{media_type}; charset=utf-8")
                routes.append(Route(f"{prefix}{file.name}", response, methods=["GET"]))
                if file.name == "index.html":
                    routes.append(Route("/", response, methods=["GET"]))
    return routes


async def _error_response(_request: Request, error: Exception) -> Response:
    status = 400
    if isinstance(error, Stale):
        status = 409
    elif isinstance(error, ResourceError):
        status = 507
    assert isinstance(error, PlanishError)
    places = error.places if isinstance(error, Undecided) else ()
    described = [
        {"place": asdict(p.place), "middle_um": p.middle_um, "text": p.sentence} for p in places
    ]
    return Answer({"error": error.text} | ({"places": described} if described else {}), status)


def serve(session: Session, *, host: str, port: int, on_open: Callable[[str], None]) -> None:
    """Serve a session until interrupted, on any port for 0; ``on_open`` gets the address.

    FileError: cannot listen.
    """
    token = secrets.token_urlsafe(32)
    with closing(session):
        try:
            listener = socket.create_server((host, port))
            # Those that are accepted inherit it. Else the kernel keeps the second part of each
            # answer back for 40 ms.
            listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError as error:
            reason = error.strerror or error
            raise FileError(
                f"Nothing can listen on {host}:{port} ({reason}). Give another `port`; 0 takes a"
                " free one."
            ) from error
        with listener:
            bound_port = int(listener.getsockname()[1])
            app = create_app(
                session, token=token, hosts=[f"{name}:{bound_port}" for name in _host_names(host)]
            )
            config = uvicorn.Config(
                app,
                log_config=None,
                access_log=False,
                server_header=False,
                date_header=False,
                lifespan="off",
                proxy_headers=False,
                timeout_graceful_shutdown=1,
                ws="none",
                http="h11",
                loop="asyncio",
            )
            logging.getLogger("uvicorn").setLevel(logging.ERROR)
            shown_host = "127.0.0.1" if host in ("127.0.0.1", "localhost", "0.0.0.0") else host
            threading.Thread(target=snap.warm, args=(session,), name="warm", daemon=True).start()
            on_open(f"http://{shown_host}:{bound_port}/#token={token}")
            # An interrupt is how a server ends.
            try:
                with suppress(KeyboardInterrupt):
                    uvicorn.Server(config).run(sockets=[listener])
            finally:
                app.state.served.close()


def _host_names(host: str) -> list[str]:
    loopback = ["127.0.0.1", "localhost"]
    if host != "0.0.0.0":
        return loopback if host in loopback else [host]
    names = [*loopback, socket.gethostname()]
    with suppress(OSError):
        addresses = socket.getaddrinfo(names[-1], None, socket.AF_INET)
        names += sorted({str(address[4][0]) for address in addresses})
    return names
