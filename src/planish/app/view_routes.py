"""Routes of what is seen.

Tiles, values and densities of maps, slices of sheets, the mesh of the flattening.
"""

import json
import math
import struct
import threading
from collections.abc import Callable
from typing import Any

import anyio
import numpy as np
from anyio.to_thread import run_sync
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from planish.app.answers import Answer
from planish.app.changes import stretches_of
from planish.app.picture import PlanePicture
from planish.app.pictures import Tiles
from planish.app.selection import (
    Brush,
    Rectangle,
    Stopped,
    cursor,
    density,
    histogram,
    nearest,
    profile,
    select,
)
from planish.app.served import served_of
from planish.app.slices import SheetSlice, SlicedSheet, edge_of, sheets_of
from planish.app.strain import SPACE, STRAINS, mesh_lines, sheet_run
from planish.core.errors import InputError, PlanishError
from planish.core.status import Status
from planish.core.typing import Entries, Pair
from planish.surface import Corrections, Stretch
from planish.surface.params import REACH_UM

_NO_COLOURS = ("volume_", "presence")
# Passes over whole maps, one at a time: the other core is for the screen.
_ONE_PASS = anyio.CapacityLimiter(1)


def get_tile(request: Request) -> Response:
    """One tile of a picture."""
    address = request.path_params
    tiles = _tiles(request)
    codes = tiles.tile(address["id"], address["level"], address["row"], address["col"])
    return Response(codes, media_type="application/octet-stream")


def get_cursor(request: Request) -> Response:
    """All values at a point."""
    return Answer(cursor(_tiles(request), _picture(request, "id"), *required_point(request)))


def get_pixel(request: Request) -> Response:
    """The pixel of a map that shows the sheet nearest to a place in the volume."""
    place_um = {axis: _number(request, axis) for axis in "xyz" if axis in request.query_params}
    layer = request.query_params.get("layer", "")
    point = nearest(_tiles(request), _picture(request, "id"), layer, place_um)
    return Answer(point and dict(zip("xy", point, strict=True)))


def get_profile(request: Request) -> Response:
    """Values along a line."""
    x0, y0, x1, y1 = _numbers(request, "line", 4, needed=True)
    keys = [key for key in ("a", "b") if key in request.query_params]
    pictures = [_picture(request, key) for key in keys]
    return Answer(profile(_tiles(request), pictures, (x0, y0, x1, y1)))


def get_histogram(request: Request) -> Response:
    """How the values of a picture are distributed."""
    session = served_of(request).session
    picture = _picture(request, "id")
    layer = picture.layer
    if picture.layer not in session.layers:
        layer = session.layers[0]
    holes = session.holes(layer)[picture.plane]
    return Answer(histogram(_tiles(request), picture, holes=holes))


async def get_selection(request: Request) -> Response:
    """Pixels of a region or of brushes at full resolution; given up where the page goes away."""
    a, b = _picture_pair(request)
    region = _region(request)
    tiles = _tiles(request)
    brushes: list[Brush] = []
    for key, picture in (("brush_a", a), ("brush_b", b)):
        limits = _numbers(request, key, 2)
        if limits:
            brushes.append(Brush(picture, min(limits), max(limits)))
    stop = threading.Event()

    async def watch() -> None:
        while not await request.is_disconnected():
            await anyio.sleep(0.1)  # how often it is asked whether the page still waits
        stop.set()

    def selected() -> Entries | Exception:
        """Select the pixels; a fault is a value, which the group of tasks would wrap otherwise."""
        try:
            return select(tiles, a, b, region=region, brushes=brushes, stop=stop)
        except (Stopped, PlanishError) as error:
            return error

    answer: Entries | Exception = Stopped()
    async with anyio.create_task_group() as group:
        group.start_soon(watch)
        answer = await run_sync(selected, limiter=_ONE_PASS)
        group.cancel_scope.cancel()
    if isinstance(answer, dict):
        return Answer(answer)
    if isinstance(answer, Stopped):
        return Response("", 204, media_type="application/json")
    raise answer


def _tiles(request: Request) -> Tiles:
    return served_of(request).tiles


def _picture(request: Request, key: str) -> PlanePicture:
    return _tiles(request).pictures[request.query_params.get(key, "")]


def _picture_pair(request: Request) -> tuple[PlanePicture, PlanePicture]:
    a = _picture(request, "a")
    b = _picture(request, "b")
    if b not in _tiles(request).pictures.on_same_pixels(a):
        raise InputError(
            f"{a.name} and {b.name} do not lie on the same pixels. Choose two layers of one plane."
        )
    return a, b


def _region(request: Request) -> Rectangle | None:
    corners = _numbers(request, "region", 4)
    return Rectangle(*corners) if corners else None


def required_point(request: Request) -> Pair:
    """The place (x, y) of a query; InputError where it is missing."""
    return _number(request, "x"), _number(request, "y")


def _number(request: Request, key: str) -> float:
    return _numbers(request, key, 1, needed=True)[0]


def _numbers(request: Request, key: str, count: int, *, needed: bool = False) -> list[float]:
    """Finite numbers of a query, apart by commas.

    Where it is not given, none, or InputError where they are ``needed``.
    """
    text = request.query_params.get(key)
    needed_text = f"{count} number{'s' * (count > 1)} needed"
    if text is None:
        if needed:
            raise InputError(f"{key} is missing: {needed_text}.")
        return []
    try:
        numbers = [float(word) for word in text[:200].split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise InputError(f"{key} is {text[:40]!r}: {needed_text}, apart by commas.")
    return numbers


_OPENING = threading.Lock()


def get_sheets(request: Request) -> Response:
    """The sheets whose slices can be seen; what is wrong with the others."""
    sheets: list[Entries] = []
    session = served_of(request).session
    for name in sheets_of(session.folder, session.study):
        try:
            sheet = _open_sheet(request, name)
        except PlanishError as error:
            sheets.append({"layer": name, "error": error.text})
            continue
        frame = sheet.frame
        attrs = sheet.surfaces.attrs
        places_um = {axis: sheet.voxels_um(axis) for axis in "zyx"}
        places_um["straight"] = sheet.surfaces["y"].values
        axes: Entries = {}
        for direction, um in places_um.items():
            axes[direction] = edge_of("height", um).model_dump(exclude={"name"})
        is_by_profile = "from_labels" not in attrs and attrs.get("method", "profile") == "profile"
        sheets.append(
            {
                "layer": name,
                "through": frame.through,
                "top": frame.top,
                "rows": frame.rows,
                "cols": frame.cols,
                "axes": axes,
                "thickness_um": float(attrs["thickness_um"]),
                "reach_um": REACH_UM,
                "correctable": is_by_profile,
            }
        )
    status_texts = {int(status): status.sentence for status in Status}
    return Answer({"sheets": sheets, "status": status_texts})


def get_slice(request: Request) -> Response:
    """One slice: its facts as JSON, pixels of 16 bits, and lines of 32-bit floats."""
    sheet = _open_sheet(request, request.path_params["layer"])
    direction = request.path_params["direction"]
    if direction not in ("z", "y", "x", "straight"):
        raise InputError("Slices run across z, y or x, or are straight.")
    across_um = next(iter(_numbers(request, "across", 1)), None)
    down_um = next(iter(_numbers(request, "down", 1)), None)
    corrections = _shown_corrections(request, sheet.name)
    index = request.path_params["index"]
    cut = sheet.cut(direction, index, near_um=(across_um, down_um), corrections=corrections)
    return Response(slice_message(cut), media_type="application/octet-stream")


def _open_sheet(request: Request, layer: str) -> SlicedSheet:
    served = served_of(request)
    session = served.session
    sheets = served.sheets
    with _OPENING:
        if layer not in sheets:
            available = sheets_of(session.folder, session.study)
            if layer not in available:
                names = ", ".join(available) or "none"
                raise InputError(f"There are no slices of {layer!r}; there are some of {names}.")
            sheets[layer] = SlicedSheet.open(layer, *available[layer])
        return sheets[layer]


def _shown_corrections(request: Request, layer: str) -> Corrections | None:
    """The corrections of a layer that are saved, and one more that is only tried.

    None where the run has just these.
    """
    session = served_of(request).session
    first_sheet = next(params.name for params in session.study.layers if params.volume is not None)
    saved = stretches_of(session.state.corrections, layer, first_sheet)
    points_text = request.query_params.get("points", "")
    if not points_text:
        original = stretches_of(session.first.corrections, layer, first_sheet)
        return None if saved == original else saved
    if len(points_text) > 4000:
        raise InputError(
            "There are too many points for one stretch. Save it, and go on with another."
        )
    # What is missing in a point is empty, and refused with it.
    coordinates = ([*text.split(","), "", "", "", ""] for text in points_text.split(";"))
    points = [dict(zip(("z", "y", "x", "face"), point, strict=False)) for point in coordinates]
    reach_um = next(iter(_numbers(request, "reach", 1)), 0.0) or REACH_UM
    try:
        trial = Stretch.model_validate({"id": "tried", "points": points, "reach_um": reach_um})
    except ValueError as error:
        raise InputError(
            "These are not points of a face: z, y, x in um and top or bottom."
        ) from error
    return saved.model_copy(update={"stretches": (*saved.stretches, trial)})


def slice_message(sheet_slice: SheetSlice) -> bytes:
    """A slice as one message: length of the facts, facts, pixels, lines, contours.

    Little-endian.
    """
    header = json.dumps(sheet_slice.facts.model_dump(mode="json")).encode()
    header += b" " * (-len(header) % 4)
    pixels = np.ascontiguousarray(sheet_slice.pixels, "<u2").tobytes()
    padding = b"\0" * (-len(pixels) % 4)  # what follows begins at a multiple of 4 bytes
    blocks = [struct.pack("<I", len(header)), header, pixels, padding]
    curves = (*sheet_slice.lines, *sheet_slice.contours)
    blocks += [np.ascontiguousarray(curve, "<f4").tobytes() for curve in curves]
    return b"".join(blocks)


def flattening(request: Request) -> Response:
    """Give pictures of the strain, of the sheet's places in space, and of what may colour it.

    Null for none.
    """
    session = served_of(request).session
    layer = request.query_params.get("layer", "")
    if sheet_run(session.folder, session.study, layer) is None:
        return Answer(None)
    ids = {p.variable: p.id for p in session.pictures.on("moving", layer)}
    colours = ids.keys() - {*SPACE, *STRAINS, "valid"}
    preferred = [session.results.layer(layer).headline, "thickness"]
    names = [name for name in ids if name in colours and not name.startswith(_NO_COLOURS)]
    names.sort(key=lambda name: (*preferred, name).index(name))
    return Answer(
        {
            "strain": [ids[name] for name in STRAINS if name in ids],
            "space": [ids[name] for name in SPACE],
            "colours": [ids[name] for name in names],
        }
    )


def mesh(request: Request) -> Response:
    """Lines of the mesh, each a list of (u, v) in um, and that they are every n-th."""
    session = served_of(request).session
    layer = request.query_params.get("layer", "")
    run = sheet_run(session.folder, session.study, layer)
    lines, line_step = ([], 1) if run is None else mesh_lines(run)
    return Answer({"lines": lines, "every": line_step})


def route(path: str, endpoint: Callable[[Request], Any], method: str = "GET") -> Route:
    """A route to a function of the request, such as a lambda."""
    return Route(path, endpoint, methods=[method])


ROUTES = [
    route("/api/tiles/{id}/{level:int}/{row:int}/{col:int}", get_tile),
    route("/api/cursor", get_cursor),
    route("/api/pixel", get_pixel),
    route("/api/profile", get_profile),
    route("/api/density", lambda r: Answer(density(_tiles(r), *_picture_pair(r), _region(r)))),
    route("/api/histogram", get_histogram),
    route("/api/selection", get_selection),
    route("/api/sheets", get_sheets),
    route("/api/slices/{layer}/{direction}/{index:int}", get_slice),
    route("/api/flattening", flattening),
    route("/api/mesh", mesh),
]
