"""Presence of material in three layers of the sheet: the maps in which holes are found."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planish.core.tiles import Engine, Tile
from planish.core.typing import Floats
from planish.surface import _kernels
from planish.surface.columns import Columns, join_tiles

_FROM, _TO, _STEPS = 0.1, 0.42, 7  # of the thickness, and places between; the bottom's layer mirrors the top's
_INNER = _FROM + (_TO - _FROM) / (_STEPS - 1)  # the centre's layer reaches to the second place of either neighbour

LAYERS = {"presence": (_FROM, _TO), "presence_centre": (-_INNER, _INNER), "presence_bottom": (-_TO, -_FROM)}
"""First and last place of each layer in shares of the thickness, from the centre surface towards the top."""

TITLES = {
    "presence": "Material below the top face",
    "presence_centre": "Material around the centre surface",
    "presence_bottom": "Material above the bottom face",
}


_TileJob = tuple[
    Columns, list[Floats], float, tuple[float, float]
]  # depth and normals are those of the tile, in voxels


def find_presence(
    columns: Columns, centre: Floats, thickness: float, up: float, levels: tuple[float, float], engine: Engine
) -> dict[str, Floats]:
    """Share of material in three layers of the sheet, along the true normals, of every column; 0 to 1.

    ``centre``: height of the centre surface, um; ``up``: +1 where heights grow towards the top; ``levels``: grey of air
    and base. Returns a map (rows, cols) for each of ``LAYERS``; NaN where there is no centre surface or the normal
    leaves the volume. The voxels are read once for all layers. The bottom's layer mirrors the top's: with the other
    side on top, the two maps change places to the last bit.
    """
    pitch = columns.pitch
    slope = [np.gradient(centre, p, axis=i) for i, p in enumerate(pitch[:2])]
    length = np.sqrt(1 + slope[0] ** 2 + slope[1] ** 2)
    normals = (-up * slope[0] / length / pitch[0], -up * slope[1] / length / pitch[1], up / length / pitch[2])
    depth = (centre - float(columns.depth_um[0])) / pitch[2]

    def job(tile: Tile) -> _TileJob:
        return columns, [field[tile.rows, tile.cols] for field in (depth, *normals)], thickness, levels

    parts = engine.map("layers", _tile_presence, job, columns.tiles(engine))
    return dict(zip(LAYERS, join_tiles(parts, np.full((len(LAYERS), *columns.shape[:2]), np.nan)), strict=True))


def _places() -> tuple[Floats, NDArray[np.int64]]:
    """Places along the normal in shares of the thickness, and which of them each layer is the mean of."""
    outer = np.linspace(_FROM, _TO, _STEPS)
    # The centre's layer takes the two places of either neighbour that lie in it, and three of its own.
    inner = np.array([0.0, 2 * outer[0] - outer[1]])
    places = np.concatenate([outer, -outer, inner, -inner[1:]])
    top = np.arange(_STEPS)
    centre = np.array([0, 1, _STEPS, _STEPS + 1, *range(2 * _STEPS, places.size)])
    return places, np.stack([top, centre, top + _STEPS]).astype(np.int64)


def _tile_presence(job: _TileJob, tile: Tile) -> Floats:
    """Give the presence in a tile, (layers, rows, cols)."""
    columns, fields, thickness, levels = job
    whole = columns.shape
    out = np.full((len(LAYERS), *tile.shape), np.nan)
    depth, rows, cols, along = (np.ascontiguousarray(a) for a in fields)
    is_sheet = np.isfinite(depth) & np.isfinite(along)
    if not is_sheet.any():
        return out
    places, layers = _places()
    offsets = places * thickness
    # Only what the normals pass through is read.
    ends = [depth[is_sheet] + s * along[is_sheet] for s in (offsets.min(), offsets.max())]
    low, high = min(float(e.min()) for e in ends), max(float(e.max()) for e in ends)
    if high < 0 or low > whole[2] - 1:
        return out
    first = min(max(int(np.floor(low)), 0), whole[2] - 2)
    lead = [int(np.ceil(np.abs(offsets).max() * float(np.abs(n[is_sheet]).max()))) + 1 for n in (rows, cols)]
    outside = tile.grown(lead[0], lead[1], whole[:2])
    inner = tile.within(outside)
    grey = columns.grey(outside, depth=slice(first, min(int(np.ceil(high)) + 2, whole[2])))
    _kernels.presence(
        grey, first, whole[2], inner.r0, inner.c0, depth, rows, cols, along, offsets, layers, *levels, out
    )
    return out
