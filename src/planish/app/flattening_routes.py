"""Routes of the flattening: which pictures show it, and the lines of its mesh in the plane."""

from __future__ import annotations

from typing import Any

from anyio.to_thread import run_sync
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from planish.app.pictures import Pictures
from planish.app.strain import SPACE, STRAINS, mesh_lines, sheet_run

COLOURS = ("thickness", "warp")
"""Maps that the sheet in space is coloured by after the one that stands for it, where it has them."""


async def flattening(request: Request) -> Response:
    """Pictures of the strain, of the places of the sheet in space, and of what it may be coloured by; null for none."""
    state, layer = request.app.state, request.query_params.get("layer", "")
    if sheet_run(state.session.folder, layer) is None:
        return JSONResponse(None)
    headline = state.session.results.layer(layer).headline
    return JSONResponse(await run_sync(_picture_ids, state.pictures, layer, headline))


async def mesh(request: Request) -> Response:
    """Lines of the mesh, each a list of (u, v) in um, and that they are every n-th."""
    run = sheet_run(request.app.state.session.folder, request.query_params.get("layer", ""))
    lines, every = ([], 1) if run is None else await run_sync(mesh_lines, run)
    return JSONResponse({"lines": lines, "every": every})


def _picture_ids(pictures: Pictures, layer: str, headline: str) -> dict[str, Any]:
    ids = {
        picture.name.rpartition("/")[2]: picture.id
        for picture in pictures
        if picture.plane == "moving" and picture.layer == layer
    }
    names = [n for n in ids if n not in (*SPACE, *STRAINS, "valid") and not n.startswith(("volume_", "presence"))]
    first = [name for name in (headline, *COLOURS) if name in names]
    return {
        "strain": [ids[name] for name in STRAINS if name in ids],
        "space": [ids[name] for name in SPACE],
        "colours": [ids[name] for name in dict.fromkeys([*first, *names])],
    }


ROUTES = [Route("/api/flattening", flattening), Route("/api/mesh", mesh)]
