"""Flatten the sheet again, with another neutral surface or another spacing through the sheet."""

import math
from collections.abc import Mapping
from contextlib import suppress

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator

from planish.core.errors import CannotFlatten
from planish.core.frame import Frame
from planish.core.grid import filled, pitch
from planish.core.typing import Floats, Ints
from planish.flatten.relax import Rest, relax_grid
from planish.flatten.sheet import node_weights, sheet_mesh

# The moves hold nothing shorter than the cut-off: 16 000 nodes or 160 000 give the same to 0.01 um.
_MOST_NODES = 40_000


def flat_moves(
    surfaces: xr.Dataset,
    others: Mapping[str, NDArray[np.floating]],
    *,
    neutral: NDArray[np.floating] | float = 0.0,
    rest: Rest = "arc",
) -> xr.Dataset:
    """Give the moves in the plane of every place of the sheet when other surfaces are flattened.

    They are flattened instead of the neutral one.

    All are flattened on one mesh, coarser than that of the maps: what the mesh itself does is the
    same for all.

    Parameters
    ----------
    surfaces : Dataset, dims (y, x), in um; ``centre`` and the frame in its attributes
    others : mapping of (y, x) arrays; height of each other surface over the centre surface, in um
    neutral : (y, x) or 0; the same of the surface that was flattened
    rest : {"arc", "chord"}, as for the flattening itself

    Returns
    -------
    Dataset, dims (y, x), in um
        On the nodes of the mesh, ``NAME_u`` and ``NAME_v`` of each; beside the sheet those of the
        nearest node. A shift and a turn of the whole sheet have no meaning.
    """
    centre = surfaces["centre"].values
    row_um, col_um = pitch(surfaces)
    area_um2 = np.isfinite(centre).sum() * abs(row_um * col_um)
    mesh_um = max(math.sqrt(area_um2 / _MOST_NODES), 4 * abs(row_um))
    mesh = sheet_mesh(surfaces, mesh_um)
    neutral_offset = np.broadcast_to(np.asarray(neutral, dtype=np.float64), centre.shape)
    sheets = [mesh.raised(offset) for offset in (neutral_offset, *others.values())]
    neutral_flat, *other_flats = (relax_grid(m, rest=rest, weights=mesh.weights) for m in sheets)
    u_sign = -1.0 if Frame.of(surfaces).mirrored else 1.0
    moves = xr.Dataset(coords={"y": mesh.y_um, "x": mesh.x_um})
    for name, other_flat in zip(others, other_flats, strict=True):
        move_u, move_v = np.moveaxis(other_flat.uv - neutral_flat.uv, -1, 0)
        moves[f"{name}_u"] = ("y", "x"), filled(u_sign * move_u), {"units": "um"}
        moves[f"{name}_v"] = ("y", "x"), filled(move_v), {"units": "um"}
    return moves


def places_when_scaled(
    surfaces: xr.Dataset, flat: xr.Dataset, points: Floats, *, mesh_um: float | None = None
) -> tuple[Floats, Floats]:
    """Flatten the centre surface again with scaled heights, and carry points of the sheet along.

    Parameters
    ----------
    surfaces : Dataset, dims (y, x), in um
        ``centre`` and the frame in its attributes; ``status`` if there is one.
    flat : Dataset, dims (y, x), in um
        ``u``, ``v`` of the columns at scale 1, as :func:`planish.flatten_sheet` gives them.
    points : (n, 2), in um; places ``(u, v)`` in the flat sheet
    mesh_um : float, optional; pitch of the mesh; where not given, some 5000 nodes, 50 um apart at
    most

    Returns
    -------
    scales : (k,)
        Factors on the heights, 1 among them. Those at which the sheet cannot be flattened are left
        out.
    places : (k, n, 2), in um
        At scale 1 they are the points; NaN for points beside the sheet. Each is turned and shifted
        as a whole.

    Notes
    -----
    Only differences of two flattenings of the same coarse mesh are used, so that its own error
    cancels.
    """
    row_um, col_um = pitch(surfaces)
    centre = surfaces["centre"].values
    is_sheet = np.isfinite(flat["u"].values) & np.isfinite(centre)
    area_um2 = is_sheet.sum() * row_um * col_um
    # The moves are differences of two flattenings, smooth over the 400 um of the centre surface:
    # 5000 nodes, or what is 50 um apart, but 100 000 at most.
    usual_um = min(50.0, math.sqrt(area_um2 / 5_000))
    wanted_um = mesh_um or max(usual_um, math.sqrt(area_um2 / 100_000))
    rows = _even_indices(len(is_sheet), row_um / wanted_um)
    cols = _even_indices(is_sheet.shape[1], col_um / wanted_um)
    mesh_nodes = np.ix_(rows, cols)
    is_node = is_sheet[mesh_nodes]
    height = np.where(is_node, centre[mesh_nodes], np.nan)
    x, y = surfaces["x"].values, surfaces["y"].values
    across, down = np.meshgrid(x[cols], y[rows])
    weights = node_weights(surfaces, rows, cols)
    uv_by_scale: dict[float, Floats] = {}
    for scale in (0.4, 0.55, 0.75, 1.0, 1.25, 1.5, 1.8, 2.15, 2.5):
        with suppress(CannotFlatten):
            points_um = np.stack([across, down, scale * height], axis=-1)
            uv = relax_grid(points_um, weights=weights).uv[is_node]
            if np.isfinite(uv).all():
                uv_by_scale[scale] = uv
    if 1.0 not in uv_by_scale:
        return np.ones(1), points[None].copy()
    all_uv = np.stack(list(uv_by_scale.values()), axis=1)
    moves = all_uv - uv_by_scale[1.0][:, None]
    if Frame.of(surfaces).mirrored:
        moves[..., 0] *= -1.0
    node_u, node_v = (flat[name].values[mesh_nodes][is_node] for name in "uv")
    # (nodes, scales * 2), and of the points likewise.
    columns = moves.reshape(len(moves), -1)
    interpolate = LinearNDInterpolator(np.stack([node_u, node_v], axis=1), columns)
    shifts = interpolate(points).reshape(len(points), -1, 2)
    scales = np.array(list(uv_by_scale))
    return scales, points + np.moveaxis(shifts, 1, 0)


def _even_indices(n: int, share: float) -> Ints:
    """Some of n indices, three or more, both ends among them, ``1 / share`` apart."""
    count = max(3, round((n - 1) * share) + 1)
    indices = np.linspace(0, n - 1, count).round()
    return np.unique(indices.astype(np.intp))
