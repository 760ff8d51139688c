"""Requests to an ASGI application in this process: no port, no client library."""

import asyncio
import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeVar

HOST = "127.0.0.1:8000"
TOKEN = "the-token-of-this-test"


T = TypeVar("T")


def run_apart(task):
    """Run a task in a loop of its own: the browser of other tests has one in this thread."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(asyncio.run, task).result()


@dataclass(frozen=True)
class Answer:
    """Status, headers and body of an answer."""

    status: int
    headers: dict[str, str]
    body: bytes

    def json(self):
        return json.loads(self.body)


@dataclass(frozen=True)
class Client:
    """Asks an application as its own page does, unless told otherwise."""

    app: Any
    token: str = TOKEN
    host: str = HOST

    def get(self, path, **how):
        return self.ask("GET", path, **how)

    def post(self, path, body=None, **how):
        return self.ask(
            "POST", path, body={} if body is None and "data" not in how else body, **how
        )

    def ask(
        self,
        method,
        path,
        *,
        body=None,
        data=None,
        headers=None,
    ):
        """Send one request; a header of None is left out, ``data`` are raw parts of a body."""
        parts = [data] if isinstance(data, bytes) else list(data or [])
        if body is not None:
            parts = [json.dumps(body).encode()]
        usual = {"host": self.host, "authorization": f"Bearer {self.token}"}
        if method == "POST":
            usual |= {"origin": f"http://{self.host}", "content-type": "application/json"}
            usual["content-length"] = str(sum(map(len, parts)))
        sent = {k: v for k, v in (usual | dict(headers or {})).items() if v is not None}
        where, _, query = path.partition("?")
        scope = {
            "type": "http",
            "http_version": "1.1",
            "method": method,
            "scheme": "http",
            "path": where,
            "raw_path": where.encode(),
            "query_string": query.encode(),
            "root_path": "",
            "client": ("127.0.0.1", 1),
            "headers": [(k.encode(), v.encode()) for k, v in sent.items()],
            "server": ("127.0.0.1", 8000),
        }
        return run_apart(self._exchange(scope, parts))

    async def _exchange(self, scope, parts):
        waiting, head, body = [*parts], {}, bytearray()

        async def receive():
            if waiting:
                part = waiting.pop(0)
                return {"type": "http.request", "body": part, "more_body": bool(waiting)}
            return {"type": "http.request", "body": b"", "more_body": False}

        async def send(message):
            if message["type"] == "http.response.start":
                head.update(message)
            else:
                body.extend(message.get("body", b""))

        await self.app(scope, receive, send)
        return Answer(
            head["status"], {k.decode(): v.decode() for k, v in head["headers"]}, bytes(body)
        )
