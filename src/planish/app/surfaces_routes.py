"""Routes of the surfaces: what sheets there are, their slices with all that was found in them, and previews."""

from __future__ import annotations

import json
import struct
import threading
from typing import Any

import numpy as np
from anyio.to_thread import run_sync
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from planish.app.corrections import stretches_of
from planish.app.session import Session
from planish.app.slices import Direction, Sheet, Slice, sheets_of
from planish.core.errors import InputError, PlanishError
from planish.core.status import Status
from planish.surface import Corrections, Stretch
from planish.surface.params import REACH_UM

_OPENING = threading.Lock()
_MOST_TEXT = 4000  # of the points of a stretch that is not saved yet


async def get_sheets(request: Request) -> Response:
    """The sheets whose slices can be seen; what is wrong with the others."""
    return JSONResponse(await run_sync(_sheets, request))


async def get_slice(request: Request) -> Response:
    """One slice: its facts as JSON, pixels of 16 bits, and lines of 32-bit floats."""
    return Response(await run_sync(_slice, request), media_type="application/octet-stream")


def _open_sheet(request: Request, layer: str) -> Sheet:
    """The sheet of a layer, opened when it is first asked for."""
    app, session = request.app, _session(request)
    with _OPENING:
        sheets: dict[str, Sheet] = app.state.sheets
        if layer not in sheets:
            available = sheets_of(session.folder, session.study)
            if layer not in available:
                raise InputError(
                    f"There are no slices of {layer!r}; there are some of {', '.join(available) or 'none'}."
                )
            params, store = available[layer]
            sheets[layer] = Sheet.open(layer, params, store)
        return sheets[layer]


def _session(request: Request) -> Session:
    return request.app.state.session


def _sheets(request: Request) -> dict[str, Any]:
    described: list[dict[str, Any]] = []
    session = _session(request)
    for name in sheets_of(session.folder, session.study):
        try:
            sheet = _open_sheet(request, name)
        except PlanishError as error:
            described.append({"layer": name, "error": error.text})
            continue
        frame = sheet.frame
        attrs = sheet.surfaces.attrs
        axes = {
            axis: {"count": sheet.count(axis), "first_um": float(places[0]), "step_um": float(places[1] - places[0])}
            for axis in ("z", "y", "x")
            if (places := sheet.places(axis)).size > 1
        }
        rows = sheet.surfaces["y"].values
        axes["straight"] = {
            "count": sheet.count("straight"), "first_um": float(rows[0]),
            "step_um": float(rows[1] - rows[0]) if rows.size > 1 else 1.0,
        }  # fmt: skip
        described.append({
            "layer": name, "through": frame.through, "top": frame.top, "rows": frame.rows, "cols": frame.cols,
            "axes": axes, "thickness_um": float(attrs["thickness_um"]), "reach_um": REACH_UM,
            "correctable": "from_labels" not in attrs and attrs.get("method", "profile") == "profile",
        })  # fmt: skip
    reasons = {int(status): status.sentence for status in Status}
    return {"sheets": described, "status": reasons}


def _slice(request: Request) -> bytes:
    sheet = _open_sheet(request, request.path_params["layer"])
    direction: str = request.path_params["direction"]
    if direction not in ("z", "y", "x", "straight"):
        raise InputError("Slices run across z, y or x, or are straight.")
    asked: Direction = direction
    near = _number(request, "across"), _number(request, "down")
    return slice_message(
        sheet.cut(
            asked, request.path_params["index"], near_um=near, corrections=_shown_corrections(request, sheet.name)
        )
    )


def _shown_corrections(request: Request, layer: str) -> Corrections | None:
    """The corrections of a layer that are saved, and one more that is only tried; None where the run has just these."""
    session = _session(request)
    volumes = [params.name for params in session.study.layers if params.volume is not None]
    now = stretches_of(session.state.corrections, layer, volumes[0])
    tried = request.query_params.get("points", "")
    if not tried and now == stretches_of(session.first.corrections, layer, volumes[0]):
        return None
    if len(tried) > _MOST_TEXT:
        raise InputError("There are too many points for one stretch. Save it, and go on with another.")
    if not tried:
        return now
    points: list[dict[str, Any]] = []
    for text in tried.split(";"):
        z, y, x, face = ([*text.split(","), "", "", "", ""])[:4]
        points.append({"z": z, "y": y, "x": x, "face": face})
    try:
        reach = _number(request, "reach") or REACH_UM
        more = Stretch.model_validate({"id": "tried", "points": points, "reach_um": reach})
    except ValueError as error:
        raise InputError("These are no points of a face: z, y, x in um and top or bottom.") from error
    return now.model_copy(update={"stretches": (*now.stretches, more)})


def _number(request: Request, name: str) -> float | None:
    text = request.query_params.get(name)
    if text is None:
        return None
    try:
        number = float(text)
    except ValueError:
        number = float("nan")
    if not np.isfinite(number):
        raise InputError(f"{name} is no number.")
    return number


def slice_message(slice_: Slice) -> bytes:
    """A slice as one message: length of the facts, facts, pixels, lines, contours; little-endian."""
    facts = json.dumps(slice_.facts.model_dump(mode="json")).encode()
    facts += b" " * (-len(facts) % 4)
    pixels = np.ascontiguousarray(slice_.pixels, dtype="<u2").tobytes()
    parts = [struct.pack("<I", len(facts)), facts, pixels, b"\0" * (-len(pixels) % 4)]
    parts += [np.ascontiguousarray(part, dtype="<f4").tobytes() for part in (*slice_.lines, *slice_.contours)]
    return b"".join(parts)


ROUTES = [
    Route("/api/sheets", get_sheets),
    Route("/api/slices/{layer}/{direction}/{index:int}", get_slice),
]
