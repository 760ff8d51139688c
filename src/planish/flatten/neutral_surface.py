"""The places of the sheet in the plane if another surface were the neutral one, which stays unstrained."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.frame import Frame
from planish.core.grid import filled
from planish.core.typing import Floats
from planish.flatten.relax import Rest, relax_grid
from planish.flatten.sheet import sheet_mesh

_MOST_NODES = (
    40_000  # the moves hold nothing shorter than the cut-off: 16 000 nodes or 160 000 give the same to 0.01 um
)


def flat_moves(
    surfaces: xr.Dataset, others: Mapping[str, NDArray[np.floating]], *, neutral: NDArray[np.floating] | float = 0.0,
    rest: Rest = "arc",
) -> xr.Dataset:  # fmt: skip
    """Moves of every place of the sheet in the plane when other surfaces are flattened instead of the neutral one.

    All are flattened on one mesh, coarser than that of the maps: what the mesh itself does is the same for all.

    Parameters
    ----------
    surfaces : Dataset, dims (y, x), in um
        ``centre`` and the frame in its attributes.
    others : mapping of (y, x) arrays
        Height of each other surface over the centre surface, in um.
    neutral : (y, x) or 0
        The same of the surface that was flattened.
    rest : {"arc", "chord"}
        As for the flattening itself.

    Returns
    -------
    Dataset, dims (y, x), in um
        On the nodes of the mesh, ``NAME_u`` and ``NAME_v`` of each; beside the sheet those of the nearest node.
        A shift and a turn of the whole sheet have no meaning.
    """
    is_sheet = np.isfinite(surfaces["centre"].values)
    y, x = surfaces["y"].values, surfaces["x"].values
    area = float(np.count_nonzero(is_sheet)) * abs((y[1] - y[0]) * (x[1] - x[0]))
    mesh = sheet_mesh(surfaces, max(float(np.sqrt(area / _MOST_NODES)), 4 * abs(y[1] - y[0])))
    base = np.broadcast_to(np.asarray(neutral, dtype=np.float64), is_sheet.shape)

    def flattened(offset: NDArray[np.floating]) -> Floats:
        return relax_grid(mesh.raised(offset), rest=rest, weights=mesh.weights).uv

    start = flattened(base)
    flip = -1.0 if Frame.of(surfaces).mirrored else 1.0
    moves: dict[str, tuple[tuple[str, str], Floats, dict[str, str]]] = {}
    for name, other in others.items():
        move = flattened(other) - start
        for k, (axis, sign) in enumerate((("u", flip), ("v", 1.0))):
            moves[f"{name}_{axis}"] = (("y", "x"), filled(sign * move[..., k]), {"units": "um"})
    return xr.Dataset(moves, {"y": mesh.y_um, "x": mesh.x_um})
