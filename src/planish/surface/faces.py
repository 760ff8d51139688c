"""Both faces and interfaces of every column, tile by tile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.tiles import Engine, Tile
from planish.surface import _kernels
from planish.surface.columns import Columns
from planish.surface.learn import Learnt
from planish.surface.levels import spread
from planish.surface.oriented import Guide, oriented

Array = NDArray[np.float64]

_SPIKE_UM = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Faces:
    """Heights in um of the faces and of the interfaces below them, (rows, cols); NaN where nothing was found."""

    high: Array
    low: Array
    interface_high: Array
    interface_low: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fit:
    """What a tile's fit needs: the guide of the tile with its halo."""

    columns: Columns
    guide: Guide
    learnt: Learnt


def find_faces(columns: Columns, guide: Guide, learnt: Learnt, engine: Engine) -> Faces:
    """Fit every column from both ends."""
    shape = columns.shape[:2]
    found = np.empty((4, *shape))

    def job(tile: Tile) -> _Fit:
        return _Fit(columns=columns, guide=guide.part(learnt.scale.grown(tile, shape)), learnt=learnt)

    for tile, part in engine.map("faces", _fit_tile, job, columns.tiles(engine)):
        found[:, tile.rows, tile.cols] = part
    depth_um, step = columns.depth_um, columns.pitch[2]
    first, last = float(depth_um[0]), columns.shape[2] - 1
    heights: list[Array] = []
    for high, (outer, thickness) in zip((True, False), (found[:2], found[2:]), strict=True):
        outer = _without_spikes(outer, step)
        inner = np.where(np.isfinite(outer), outer + thickness, np.nan)
        if not learnt.side(high=high).coated:
            inner = np.full(shape, np.nan)
        heights += [first + step * (last - d) if high else first + step * d for d in (outer, inner)]
    return Faces(high=heights[0], interface_high=heights[1], low=heights[2], interface_low=heights[3])


def _fit_tile(fit: _Fit, tile: Tile) -> Array:
    """Face and coating thickness seen from the high end, then from the low end, in voxels, (4, rows, cols)."""
    columns, learnt = fit.columns, fit.learnt
    grey = oriented(columns, tile, fit.guide, learnt.scale)
    outside = learnt.scale.grown(tile, columns.shape[:2])
    guide = fit.guide.part(tile.within(outside))
    tilt = np.ascontiguousarray(guide.tilt)
    out = np.empty((4, *tile.shape))
    result = np.empty((5, *tile.shape))
    for k, high in enumerate((True, False)):
        outer, other = (np.ascontiguousarray(a) for a in guide.faces(grey.shape[2], high=high))
        side = learnt.side(high=high)
        _kernels.fit_faces(
            np.ascontiguousarray(grey[:, :, ::-1]) if high else grey, outer, other, tilt, 0.0, learnt.width,
            learnt.noise, side.level, side.spread, side.coated, learnt.reach, result,
        )  # fmt: skip
        out[2 * k : 2 * k + 2] = result[:2]
    return out


def _without_spikes(height: Array, step: float) -> Array:
    """Drop columns whose face stands far off its neighbours': dust, and fits that went astray."""
    known = np.isfinite(height)
    if not known.any():
        return height
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    around = ndimage.median_filter(height[tuple(nearest)], size=5, mode="nearest")
    off = np.abs(height - around)
    limit = max(8.0 * spread(off[known]) + 1.0, _SPIKE_UM / step, 3.0)
    return np.where(known & (off <= limit), height, np.nan)
