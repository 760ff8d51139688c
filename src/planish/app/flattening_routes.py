"""Routes of the flattening: the lines of the mesh in the plane."""

from __future__ import annotations

from anyio.to_thread import run_sync
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from planish.app.session import Session
from planish.app.strain import mesh_lines


async def mesh(request: Request) -> Response:
    """Lines of the mesh, each a list of (u, v) in um, and that they are every n-th."""
    session: Session = request.app.state.session
    lines, every = await run_sync(mesh_lines, session.sheet_folder)
    return JSONResponse({"lines": lines, "every": every})


ROUTES = [Route("/api/mesh", mesh)]
