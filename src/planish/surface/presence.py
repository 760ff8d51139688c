"""Where there is material below the top face: what holes are found in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planish.core.tiles import Engine, Tile
from planish.surface import _kernels
from planish.surface.columns import Columns

Array = NDArray[np.float64]

_FROM, _TO, _STEPS = 0.1, 0.42, 7  # of the thickness, from the centre surface towards the top


@dataclass(frozen=True, slots=True, kw_only=True)
class _Look:
    """What a tile needs: depth of the centre and normals in voxels, of its own columns."""

    columns: Columns
    depth: Array
    normals: tuple[Array, Array, Array]
    offsets: Array
    low: float
    high: float


def find_presence(
    columns: Columns, centre: Array, thickness: float, up: float, levels: tuple[float, float], engine: Engine
) -> Array:
    """Share of material in the upper third of the sheet, along the true normals, of every column; 0 to 1.

    Parameters
    ----------
    columns : Columns
    centre : (rows, cols)
        Height of the centre surface, um.
    thickness : float
        Of the sheet, um.
    up : float
        +1 where heights grow towards the top.
    levels : (float, float)
        Grey of the air and of the base.
    engine : Engine

    Returns
    -------
    (rows, cols)
        NaN where there is no centre surface or the normal leaves the volume.
    """
    shape, pitch = columns.shape[:2], columns.pitch
    slope = [np.gradient(centre, p, axis=i) for i, p in enumerate(pitch[:2])]
    length = np.sqrt(1 + slope[0] ** 2 + slope[1] ** 2)
    normals = (-up * slope[0] / length / pitch[0], -up * slope[1] / length / pitch[1], up / length / pitch[2])
    depth = (centre - float(columns.depth_um[0])) / pitch[2]
    air, base = levels

    def job(tile: Tile) -> _Look:
        at = tile.rows, tile.cols
        return _Look(
            columns=columns, depth=depth[at], normals=(normals[0][at], normals[1][at], normals[2][at]),
            offsets=np.linspace(_FROM, _TO, _STEPS) * thickness, low=air, high=base,
        )  # fmt: skip

    out = np.full(shape, np.nan)
    for tile, part in engine.map("presence", _look, job, columns.tiles(engine)):
        out[tile.rows, tile.cols] = part
    return out


def _look(look: _Look, tile: Tile) -> Array:
    whole = look.columns.shape
    out = np.full(tile.shape, np.nan)
    depth, rows, cols, along = (np.ascontiguousarray(a) for a in (look.depth, *look.normals))
    known = np.isfinite(depth) & np.isfinite(along)
    if not known.any():
        return out
    # Only what the normals pass through is read.
    ends = [depth[known] + s * along[known] for s in look.offsets[[0, -1]]]
    low, high = min(float(e.min()) for e in ends), max(float(e.max()) for e in ends)
    if high < 0 or low > whole[2] - 1:
        return out
    first = min(max(int(np.floor(low)), 0), whole[2] - 2)
    part = slice(first, min(int(np.ceil(high)) + 2, whole[2]))
    farthest = float(np.abs(look.offsets).max())
    lead = [int(np.ceil(farthest * float(np.abs(n[known]).max()))) + 1 for n in (rows, cols)]
    outside = tile.grown(lead[0], lead[1], whole[:2])
    inner = tile.within(outside)
    grey = look.columns.grey(outside, depth=part)
    _kernels.presence(
        grey, first, whole[2], inner.r0, inner.c0, depth, rows, cols, along, look.offsets, look.low, look.high, out
    )
    return out
