"""What the server lets in: its own page and nobody else's, on this machine and by the token of this start."""

from __future__ import annotations

import hmac
import json
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from starlette.types import ASGIApp, Message, Receive, Scope, Send

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
        data = _needs_token(scope["path"])
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


def _needs_token(path: str) -> bool:
    """Tell whether a path gives data: all but the files of the page, and a report, whose address is a secret itself."""
    return path.startswith("/api/") or path == "/api"


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
