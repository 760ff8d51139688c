"""Routes of the maps: tiles, values at the cursor, along a line and of a region, densities and histograms."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable

import anyio
from anyio.to_thread import run_sync
from pydantic import BaseModel
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from planish.app.picture import Picture
from planish.app.probe import cursor, profile
from planish.app.selection import Brush, Rectangle, Selected, Stopped, density, histogram, select
from planish.app.tiles import Tiles
from planish.core.errors import InputError, PlanishError

_GONE_S = 0.1  # how often it is asked whether the page still waits
_FULL = anyio.CapacityLimiter(1)  # passes over whole maps, one at a time: the other core is for the screen


async def get_tile(request: Request) -> Response:
    """One tile of a picture."""
    place, tiles = request.path_params, _tiles(request)
    data = await run_sync(tiles.tile, place["id"], place["level"], place["row"], place["col"])
    return Response(data, media_type="application/octet-stream")


async def get_cursor(request: Request) -> Response:
    """All values at a point."""
    x, y = _number(request, "x"), _number(request, "y")
    picture = _picture(request, "id")
    return await _answer(lambda: cursor(_tiles(request), picture, x, y))


async def get_profile(request: Request) -> Response:
    """Values along a line."""
    line = _numbers(request, "line", 4)
    if line is None:
        raise InputError("A profile needs a line: x0, y0, x1, y1 in um.")
    pictures = [_picture(request, key) for key in ("a", "b") if key in request.query_params]
    x0, y0, x1, y1 = line
    return await _answer(lambda: profile(_tiles(request), pictures, (x0, y0, x1, y1)))


async def get_density(request: Request) -> Response:
    """Density of two pictures, or of a region of them."""
    (a, b), region = _pair(request), _region(request)
    return await _answer(lambda: density(_tiles(request), a, b, region))


async def get_histogram(request: Request) -> Response:
    """Histogram of a picture, or of a region of it."""
    picture, region = _picture(request, "id"), _region(request)
    return await _answer(lambda: histogram(_tiles(request), picture, region))


async def get_selection(request: Request) -> Response:
    """Pixels of a region or of brushes at full resolution; given up where the page goes away."""
    (a, b), region, tiles = _pair(request), _region(request), _tiles(request)
    brushes: list[Brush] = []
    for key, picture in (("brush_a", a), ("brush_b", b)):
        limits = _numbers(request, key, 2)
        if limits is not None:
            brushes.append(Brush(picture, min(limits), max(limits)))
    stop = threading.Event()

    async def watch() -> None:
        while not await request.is_disconnected():
            await anyio.sleep(_GONE_S)
        stop.set()

    def selected() -> Selected | PlanishError | None:
        """Select the pixels; a fault is a value, which the group of tasks would wrap otherwise."""
        try:
            return select(tiles, a, b, region=region, brushes=brushes, stop=stop)
        except Stopped:
            return None
        except PlanishError as error:
            return error

    answer: Selected | PlanishError | None = None
    async with anyio.create_task_group() as group:
        group.start_soon(watch)
        answer = await run_sync(selected, limiter=_FULL)
        group.cancel_scope.cancel()
    if isinstance(answer, PlanishError):
        raise answer
    text = "" if answer is None else answer.model_dump_json()
    return Response(text, 204 if answer is None else 200, media_type="application/json")


async def _answer(make: Callable[[], BaseModel]) -> Response:
    """Compute an answer in a thread and send it as JSON."""
    text = await run_sync(lambda: make().model_dump_json())
    return Response(text, media_type="application/json")


def _tiles(request: Request) -> Tiles:
    return request.app.state.tiles


def _picture(request: Request, key: str) -> Picture:
    return _tiles(request).pictures[request.query_params.get(key, "")]


def _pair(request: Request) -> tuple[Picture, Picture]:
    """Two pictures on the same pixels."""
    a, b = _picture(request, "a"), _picture(request, "b")
    if b not in _tiles(request).pictures.on_same_pixels(a):
        raise InputError(f"{a.name} and {b.name} do not lie on the same pixels. Choose two layers of one plane.")
    return a, b


def _region(request: Request) -> Rectangle | None:
    corners = _numbers(request, "region", 4)
    return None if corners is None else Rectangle(*corners)


def _number(request: Request, key: str) -> float:
    numbers = _numbers(request, key, 1)
    if numbers is None:
        raise InputError(f"{key} is missing: a number is needed.")
    return numbers[0]


def _numbers(request: Request, key: str, count: int) -> list[float] | None:
    """Finite numbers of a query, apart by commas; None where it is not given."""
    text = request.query_params.get(key)
    if text is None:
        return None
    try:
        numbers = [float(word) for word in text[:200].split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise InputError(f"{key} is {text[:40]!r}: {count} number{'s' if count > 1 else ''} needed, apart by commas.")
    return numbers


ROUTES = [
    Route("/api/tiles/{id}/{level:int}/{row:int}/{col:int}", get_tile),
    Route("/api/cursor", get_cursor),
    Route("/api/profile", get_profile),
    Route("/api/density", get_density),
    Route("/api/histogram", get_histogram),
    Route("/api/selection", get_selection),
]
