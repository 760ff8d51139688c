"""Options of the flattening."""

from __future__ import annotations

from typing import Literal

from planish.core.options import Params, option


class FlattenParams(Params):
    """Options of the flattening and of the flat maps."""

    mesh_um: float | None = option(None, gt=0, help="Pitch of the spring mesh; four columns or more where not given.")
    method: Literal["multigrid", "relaxation"] = option("multigrid", help="Solver.")
    rest: Literal["arc", "chord"] = option("arc", help="Rest lengths.")
    map_um: float | None = option(None, gt=0, help="Pixel of the flat maps; the pitch of the columns where not given.")
    most_nodes: int = option(4_000_000, cli=None, help="Most nodes.")
    doubt: float = option(0.2, cli=None, help="Weight of bridged places.")
