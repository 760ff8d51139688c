"""The server of a session, from its first address to its end."""

from __future__ import annotations

import logging
import secrets
import socket
from collections.abc import Callable
from contextlib import suppress

import uvicorn

from planish.app.server import create_app
from planish.app.session import Session
from planish.core.errors import FileError


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
    """What the server may be called in requests."""
    own = ["127.0.0.1", "localhost"]
    if host in own:
        return own
    if host != "0.0.0.0":
        return [host]
    name = socket.gethostname()
    try:
        addresses = sorted({str(found[4][0]) for found in socket.getaddrinfo(name, None, socket.AF_INET)})
    except OSError:
        addresses = []
    return [*own, name, *addresses]
