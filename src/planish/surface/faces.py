"""Both faces and interfaces of every column, tile by tile."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.grid import filled
from planish.core.robust import mad_sd
from planish.core.tiles import Engine, Tile
from planish.core.typing import Bools, Floats
from planish.surface import _fit_kernels
from planish.surface.columns import Columns, Guide, Priors, join_tiles, oriented

_SPIKE_UM = 3.0
_FLOATS = 3.0  # voxels outside the coarse sheet: two of air and one for its own inaccuracy
_PROUD_UM = 6.0  # it stands out by so much
_PLATE_UM = 100.0  # as wide as a floating particle may be
_MOST_OF = 0.8
_NARROW_UM = 15.0  # an attached particle is narrower


@dataclass(frozen=True, slots=True, kw_only=True)
class Faces:
    """Heights in um of the faces and of the interfaces below them, (rows, cols); NaN where nothing was found.

    ``stuck`` (rows, cols): columns below an attached particle; ``particles``: how many particles were removed.
    """

    high: Floats
    low: Floats
    interface_high: Floats
    interface_low: Floats
    stuck: Bools
    particles: int


@dataclass(frozen=True, slots=True, kw_only=True)
class FitJob:
    """Job of a tile's fit, with the guide of the tile and its halo."""

    columns: Columns
    guide: Guide
    priors: Priors
    again: Floats | None = None  # (2, rows, cols): only columns with a number here, and next to it


def find_faces(columns: Columns, guide: Guide, priors: Priors, engine: Engine, particles: int = 0) -> Faces:
    """Fit every column from both ends; ``particles`` float in the air beside the sheet."""
    shape = columns.shape[:2]

    def job(tile: Tile) -> FitJob:
        return FitJob(columns=columns, guide=guide.part(priors.scale.grown(tile, shape)), priors=priors)

    depths = join_tiles(engine.map("faces", _fit_tile, job, columns.tiles(engine)), np.empty((4, *shape)))
    particles += _below_particles(depths, fit_job=job, columns=columns, guide=guide, priors=priors, engine=engine)
    return faces_from_depths(depths, columns, priors.coated, cleaned=True, particles=particles)


def faces_from_depths(
    depths: Floats, columns: Columns, coated: tuple[bool, bool], *, cleaned: bool = False, particles: int = 0
) -> Faces:
    """Turn depths into heights.

    ``depths`` (4, rows, cols): depth of the face and thickness of the coating, counted from the high end, then from the
    low end, in voxels; ``coated`` in the same order. ``cleaned``: take off spikes and attached particles;
    ``particles`` were removed before.
    """
    shape, depth_um, step = columns.shape[:2], columns.depth_um, columns.pitch[2]
    first, last = float(depth_um[0]), columns.shape[2] - 1
    stuck = np.zeros(shape, dtype=bool)
    heights: list[Floats] = []
    for high, (outer, thickness) in zip((True, False), (depths[:2], depths[2:]), strict=True):
        if cleaned:
            is_finite = np.isfinite(outer)
            if is_finite.any():
                # Columns whose face stands far off its neighbours' are dust, or fits that went astray.
                off = np.abs(outer - ndimage.median_filter(filled(outer), size=5, mode="nearest"))
                limit = max(8.0 * mad_sd(off[is_finite]) + 1.0, _SPIKE_UM / step, 3.0)
                outer = np.where(is_finite & (off <= limit), outer, np.nan)
            narrow = _narrow(-outer, columns.pitch)
            particles += int(ndimage.label(narrow, np.ones((3, 3)))[1])
            stuck |= narrow
            outer = np.where(narrow, np.nan, outer)
        inner = np.where(np.isfinite(outer), outer + thickness, np.nan)
        if not coated[0 if high else 1]:
            inner = np.full(shape, np.nan)
        heights += [first + step * (last - d) if high else first + step * d for d in (outer, inner)]
    return Faces(
        high=heights[0], interface_high=heights[1], low=heights[2], interface_low=heights[3], stuck=stuck,
        particles=particles,
    )  # fmt: skip


def _below_particles(
    depths: Floats, *, fit_job: Callable[[Tile], FitJob], columns: Columns, guide: Guide, priors: Priors, engine: Engine
) -> int:
    """Look again, below it, where the face was found on something that floats above the sheet; count what was."""
    # The coarse sheet is one connected object; what is found far outside it hangs on nothing. Where the gap is so
    # narrow that the coarse search saw one object, a plate with a step all around is tried too. Such plates are counted
    # here; what floats farther away was counted by the coarse search.
    if priors.embedded_level:
        return 0
    shape, depth = columns.shape[:2], columns.shape[2]
    floating = np.zeros((2, *shape), dtype=bool)
    expected = np.empty((2, *shape))
    plates: list[NDArray[np.int32]] = []
    for k, high in enumerate((True, False)):
        expected[k] = guide.faces(depth, high=high)[0]
        plate, opened = _plates(-depths[2 * k], columns.pitch)
        plates.append(plate)
        expected[k] = np.where(plate > 0, -opened, expected[k])
        with np.errstate(invalid="ignore"):
            floating[k] = (expected[k] - depths[2 * k] > _FLOATS / guide.tilt) | (plate > 0)
    tiles = [t for t in columns.tiles(engine) if floating[:, t.rows, t.cols].any()]

    def job(tile: Tile) -> FitJob:
        return replace(fit_job(tile), again=np.where(floating, expected, np.nan)[:, tile.rows, tile.cols])

    below = join_tiles(engine.map("faces_below", _fit_tile, job, tiles), np.full((4, *shape), np.nan))
    count = 0
    for k, plate in enumerate(plates):
        better = floating[k] & np.isfinite(below[2 * k])
        # A plate floats when there is a face below most of it.
        index = np.arange(1, int(plate.max()) + 1)
        if index.size:
            share = _share(better, plate)
            count += int(np.count_nonzero(share > _MOST_OF))
            better &= (plate == 0) | np.isin(plate, index[share > _MOST_OF])
            depths[2 * k][np.isin(plate, index[share > _MOST_OF]) & ~better] = np.nan
        for n in (2 * k, 2 * k + 1):
            depths[n][better] = below[n][better]
    return count


def _plates(outward: Floats, pitch: tuple[float, float, float]) -> tuple[NDArray[np.int32], Floats]:
    """Label what stands three voxels out of the face with a step all around, and give the face without it."""
    is_finite = np.isfinite(outward)
    if not is_finite.any():
        return np.zeros(outward.shape, np.int32), outward
    whole = filled(outward)
    size = int(_PLATE_UM / pitch[0]) + 2, int(_PLATE_UM / pitch[1]) + 2
    opened = _opened(whole, size)
    hat = whole - opened
    labels, count = ndimage.label(is_finite & (hat > max(_FLOATS - 0.5, 8.0 * mad_sd(hat[is_finite]))))
    if not count:
        return np.asarray(labels, np.int32), opened
    # A bump, or a fibre that lies on others with its ends, has no step all around.
    grown = ndimage.grey_dilation(labels, size=(9, 9))
    ring = np.where((labels == 0) & is_finite, grown, 0)
    index = np.arange(1, count + 1)
    alone = _share(hat < 1.5, ring, count) > _MOST_OF
    return np.where(np.isin(labels, index[alone]), labels, 0).astype(np.int32), opened


def _opened(height: Floats, size: tuple[int, int]) -> Floats:
    """Opening of a face that goes on beyond its border with the slope it has there."""
    pad = [(min(n, m - 1),) * 2 for n, m in zip(size, height.shape, strict=True)]
    wide = np.pad(height, pad, mode="reflect", reflect_type="odd")
    inner = tuple(slice(a, n - a) for (a, _), n in zip(pad, wide.shape, strict=True))
    return ndimage.grey_opening(wide, size=size)[inner]


def _share(mask: Bools, labels: NDArray[np.integer], count: int = 0) -> Floats:
    """Share of each label's columns, 1 to the last, in which ``mask`` is set."""
    flat = labels.ravel()
    number = np.bincount(flat, minlength=count + 1)[1:]
    return np.bincount(flat, weights=mask.ravel(), minlength=count + 1)[1:] / np.maximum(number, 1)


def _fit_tile(fit: FitJob, tile: Tile) -> Floats:
    """Face and coating thickness seen from the high end, then from the low end, in voxels, (4, rows, cols)."""
    columns, priors = fit.columns, fit.priors
    edge = priors.edge
    grey = oriented(columns, tile, fit.guide, priors.scale)
    outside = priors.scale.grown(tile, columns.shape[:2])
    guide = fit.guide.part(tile.within(outside))
    tilt = np.ascontiguousarray(guide.tilt)
    out = np.empty((4, *tile.shape))
    result = np.empty((5, *tile.shape))
    for k, high in enumerate((True, False)):
        outer, other = (np.ascontiguousarray(a) for a in guide.faces(grey.shape[2], high=high))
        side = priors.sides[high]
        embedded_level = priors.embedded_level
        if fit.again is not None:
            outer, embedded_level = np.ascontiguousarray(fit.again[k]), 0.5 * priors.base
        _fit_kernels.fit_faces(
            grey, outer, other, tilt, 0.0, edge.width, priors.scatter, side.level, side.spread, side.coated,
            priors.reach, result, 0.0, embedded_level, edge.fringe or None, edge.ratio, high,
        )  # fmt: skip
        out[2 * k : 2 * k + 2] = result[:2]
    return out


def _narrow(outward: Floats, pitch: tuple[float, float, float]) -> Bools:
    """Columns that stand out of the face by more than its roughness, in places narrower than a particle may be."""
    is_finite = np.isfinite(outward)
    if not is_finite.any():
        return np.zeros(outward.shape, dtype=bool)
    whole = filled(outward)
    size = max(int(_NARROW_UM / pitch[0]), 1) + 1, max(int(_NARROW_UM / pitch[1]), 1) + 1
    hat = whole - _opened(whole, size)
    limit = max(8.0 * mad_sd(hat[is_finite]) + 1.0, _PROUD_UM / pitch[2], 3.0)
    return is_finite & (hat > limit)
