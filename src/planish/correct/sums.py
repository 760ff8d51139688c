"""One pass over the slices across the axis: means on parts of circles, and the greys of the sheet at each radius.

All sums are whole numbers. They do not depend on the order in which slices are read, nor on threads or memory.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.threads import thread_pool
from planish.core.typing import Floats
from planish.correct.levels import Levels, missing, smoothed
from planish.correct.turning import SECTORS, Turning

Counts = NDArray[np.int64]
Slice = NDArray[Any]

AIR, BASE, BRIGHT = 0, 1, 2
MATERIALS = ("air", "base", "coating")

UNIT = 1024  # whole numbers to the contrast between air and sheet
GREYS = np.linspace(-0.5, 2.5, 301)  # borders of the histogram's greys, in contrasts above air
COARSE = 48  # radii of the histogram

QUARTERS = 4  # parts of the turn of the histogram
DEPTHS = np.array([0, 5, 6, 7, 8, 10, 13, 18])
"""Depths below a face in voxels, from which on each class of the histogram begins."""

_BLOCKS, _LEAST_BLOCK = 8, 24  # parts of the axis, and the fewest slices of one
_INSIDE_PX = 3  # from a face: so far reaches its blur
_NEAR_AIR = 0.15  # contrasts by which the smoothed air may be off
_MOST = 2**29  # voxels that are looked at
_DEEPEST = 24  # voxels; deeper, a material does not change with the depth
_LEAST_LAYER = 32  # voxels of a material at one depth, for its mean grey
_GROUP = 16  # slices that are worked on together


@dataclass(frozen=True, slots=True, kw_only=True)
class Sums:
    """Sums of one pass; greys are in units of contrast / :data:`UNIT`."""

    count: Counts  # (block, sector, material, bin): voxels on each part of a circle
    total: Counts  # and the sum of their grey, less the mean grey of their material and depth in the same slice
    histogram: Counts  # (block, quarter of the turn, COARSE, depth, grey): voxels inside the sheet
    level: Counts  # (material, 2): number of voxels, and the sum of their grey above air
    blocks: Floats  # (block,): middle of each block along the axis, in slices
    slices: int  # that were looked at


def slices_of(
    volume: xr.DataArray, turning: Turning, *, most: int | None = None, memory_bytes: int
) -> Iterator[tuple[int, Slice]]:
    """Give (number, slice across the axis) in order; every so many where the volume is large."""
    length, rows, cols = turning.shape
    stride = max(1, -(-length * rows * cols // _MOST)) if most is None else max(1, length // most)
    numbers = range(stride // 2, length, stride)
    # A slab is in memory, and the one after it while that is read.
    at_once = max(1, min(int(memory_bytes / (3 * rows * cols * volume.dtype.itemsize)), len(numbers)))
    for start in range(0, len(numbers), at_once):
        part = numbers[start : start + at_once]
        slab = volume.isel({turning.axis: slice(part[0], part[-1] + 1, stride)}).values
        slab = np.transpose(slab, turning.order)
        for k, number in enumerate(part):
            yield number, np.ascontiguousarray(slab[k])


def take_sums(slices: Iterator[tuple[int, Slice]], turning: Turning, levels: Levels, *, threads: int) -> Sums:
    """Add up all slices."""
    length = turning.shape[0]
    blocks = int(np.clip(length // _LEAST_BLOCK, 1, _BLOCKS))
    middles = (np.arange(blocks) + 0.5) * length / blocks - 0.5
    places = [np.arange(n) for n in turning.shape[1:]]
    radius, sectors = turning.radius_um(*places), turning.sectors(*places)
    bins = (radius / turning.step_um).astype(np.int64)
    coarse = np.minimum((radius / turning.farthest_um * COARSE).astype(np.int64), COARSE - 1)
    count = np.zeros((middles.size, SECTORS, len(MATERIALS), turning.bins), np.int64)
    total = np.zeros_like(count)
    histogram = np.zeros((middles.size, QUARTERS, COARSE, DEPTHS.size, GREYS.size - 1), np.int64)
    quarters = sectors * QUARTERS // SECTORS
    level = np.zeros((len(MATERIALS), 2), np.int64)
    done = 0

    def classify(numbered: tuple[int, Slice]) -> tuple[int, Counts, NDArray[np.uint8], Counts]:
        return numbered[0], *_classify(numbered[1], levels)

    with thread_pool(threads) as pool:
        while group := list(islice(slices, _GROUP)):
            for number, grey, kind, depth in pool.map(classify, group):
                k = min(int(number * middles.size / length), middles.size - 1)
                _add_to_rings(grey, kind, depth, bins, sectors, count[k], total[k], level)
                _add_to_histogram(grey, kind, depth, quarters, coarse, histogram[k])
                done += 1
    return Sums(count=count, total=total, histogram=histogram, blocks=middles, level=level, slices=done)


def _add_to_rings(
    grey: Counts, kind: NDArray[np.uint8], depth: Counts, bins: Counts, sectors: Counts,
    count: Counts, total: Counts, level: Counts,
) -> None:  # fmt: skip
    """Add the voxels of a slice to their circles, less the mean of their material at their depth in this slice.

    Near the axis a circle runs along the layers of a sheet. A layer is as bright as it is everywhere at its depth, and
    so leaves nothing; a ring does. Sums of whole numbers are exact in double precision.
    """
    is_classified = kind > 0
    greys, material = grey[is_classified], kind[is_classified].astype(np.int64) - 1
    deepest = _DEEPEST + 1
    layer = material * deepest + depth[is_classified]
    n = np.bincount(layer, minlength=len(MATERIALS) * deepest)
    sums = np.bincount(layer, greys, len(MATERIALS) * deepest)
    level[:, 0] += n.reshape(-1, deepest).sum(axis=1)
    level[:, 1] += sums.reshape(-1, deepest).sum(axis=1).astype(np.int64)
    enough = n[layer] >= _LEAST_LAYER
    mean = np.rint(sums / np.maximum(n, 1)).astype(np.int64)
    cells = np.ravel_multi_index((sectors[is_classified], material, bins[is_classified]), count.shape)[enough]
    count += np.bincount(cells, minlength=count.size).reshape(count.shape)
    more = np.bincount(cells, (greys - mean[layer])[enough], count.size)
    total += more.astype(np.int64).reshape(count.shape)


def _add_to_histogram(
    grey: Counts, kind: NDArray[np.uint8], depth: Counts, quarters: Counts, coarse: Counts, histogram: Counts
) -> None:
    """Count the voxels of a slice inside the sheet by quarter of the turn, radius, depth and grey."""
    fine = np.clip(((grey / UNIT - GREYS[0]) / (GREYS[1] - GREYS[0])).astype(np.int64), 0, GREYS.size - 2)
    deep = np.searchsorted(DEPTHS, depth, side="right") - 1
    cells = np.ravel_multi_index((quarters, coarse, deep, fine), histogram.shape)[kind > 1 + AIR]
    histogram += np.bincount(cells, minlength=histogram.size).reshape(histogram.shape)


def _classify(plane: Slice, levels: Levels) -> tuple[Counts, NDArray[np.uint8], Counts]:
    """Grey above air in whole numbers, material of each voxel well inside one, and its depth below the face.

    The material comes from the smoothed slice and with wide limits: a ring of some per cent does not choose its voxels.
    """
    smooth, empty = smoothed(plane), missing(plane, levels.padding)
    solid = (smooth > levels.split) & ~empty
    air = (np.abs(smooth - levels.air) < _NEAR_AIR * levels.contrast) & ~empty
    depth = np.zeros(plane.shape, np.int64)
    kind = np.zeros(plane.shape, np.uint8)
    for mask in (solid,) if levels.air_cut else (solid, air):
        deep = np.asarray(ndimage.distance_transform_cdt(mask, "chessboard"), np.int64)
        if mask.all():
            deep[:] = _DEEPEST
        inside = deep > _INSIDE_PX
        depth[inside] = np.minimum(deep[inside], _DEEPEST)
        kind[inside] = 1 + AIR if mask is air else np.where(smooth[inside] > levels.middle, 1 + BRIGHT, 1 + BASE)
    share = (np.nan_to_num(plane.astype(np.float64), posinf=0.0, neginf=0.0) - levels.air) / levels.contrast
    grey = np.rint(np.clip(share, GREYS[0], GREYS[-1]) * UNIT).astype(np.int64)
    return grey, kind, depth
