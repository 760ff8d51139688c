"""Where the sheet is, roughly: block means, one connected slab, and how far it reaches in each block column."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.errors import VolumeError
from planish.core.typing import Bools, Floats
from planish.surface import _kernels
from planish.surface.centre import interpolate

Blocks = NDArray[np.float32]
"""Means over blocks of columns: (block rows, block cols, depth)."""
CORE = (0.35, 0.65)  # share of the way through the sheet that counts as its core
_SECOND_SHEET = 0.25  # share of the largest piece's area above which a second piece counts as another sheet
_LEAVES = 0.5  # share of columns that may run out of the volume
_LEAST_COVER = 0.02
_CHOOSE = (
    "Choose one by its grey values with --sheet-grey LOW,HIGH, by a point in it with --seed-um Z,Y,X, or crop the "
    "volume."
)
MERGED = 1.6  # times the usual thickness: two sheets that touch, or one that folds back
_SPECK = 8  # blocks; fewer are noise
_NEAR = 3  # voxels: a seed point may lie so far beside its object


@dataclass(frozen=True, slots=True, kw_only=True)
class CoarseSheet:
    """Extent of the sheet in each block column, in voxels of depth, NaN where there is none."""

    low: Floats  # (block rows, block cols): first and last depth index, interpolated to the threshold
    high: Floats
    block: int  # edge of a block in voxels
    leaves: Bools  # (block rows, block cols): where the sheet runs out of the volume
    threshold: float  # grey above the air at which the extent was measured
    # (block rows, block cols): where it touches another sheet or folds back on itself, as far as that is known.
    touching: Bools
    specks: int = 0  # other objects in the air beside the sheet


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """Which object is the sheet."""

    block: int  # edge of a block in voxels
    describe: Callable[[tuple[int, int, int]], str]  # turns such a point into what a user would give as a seed
    # Block row, block column and depth of a point in it; the largest object where not given.
    seed: tuple[int, int, int] | None = None


def search_sheet(blocks: Blocks, inside: Bools, threshold: float, choice: Choice) -> CoarseSheet:
    """Find the sheet at the seed point, or the only one where no seed is given."""
    return (coarse_sheet if choice.seed is None else followed_sheet)(blocks, inside, threshold, choice)


def coarse_sheet(blocks: Blocks, inside: Bools, threshold: float, choice: Choice) -> CoarseSheet:
    """Measure the largest slab of ``inside``; VolumeError for none, for several, and for one from end to end."""
    labels, count = ndimage.label(inside)
    if count == 0:
        raise VolumeError(
            "There is no sheet in the volume: nothing has the grey that was asked for. Check --sheet-grey."
        )
    cover = _cover(labels, count)
    order = np.argsort(cover)[::-1]
    largest = int(order[0]) + 1
    area = cover[largest - 1] / labels[..., 0].size
    if area < _LEAST_COVER:
        raise VolumeError(
            f"There is no sheet in the volume: the largest connected object covers {100 * area:.2g} % of the columns. "
            "Check --through (the axis that runs through the sheet) and --sheet-grey."
        )
    other_labels = [int(k) + 1 for k in order[1:6] if cover[k] > _SECOND_SHEET * cover[largest - 1]]
    if other_labels:
        shares = ", ".join(f"{100 * cover[k - 1] / labels[..., 0].size:.0f} %" for k in (largest, *other_labels))
        points = "; ".join(choice.describe(_inner_point(labels == k)) for k in (largest, *other_labels))
        raise VolumeError(
            f"The volume shows {1 + len(other_labels)} separate sheets (they cover {shares} of the columns). {_CHOOSE} "
            f"Points in them: {points}."
        )
    mask = labels == largest
    touching = {end: mask[..., k].mean() / area for end, k in (("low", 0), ("high", -1))}
    end = max(touching, key=lambda k: touching[k])
    if touching[end] > _LEAVES:
        raise VolumeError(
            f"Material reaches the {end} end of the axis through the sheet in {100 * touching[end]:.0f} % of the "
            f"columns: the sheet leaves the volume there, or several sheets lie behind each other. {_CHOOSE}"
        )
    counts = mask.sum(axis=-1)
    first = np.argmax(mask, axis=-1)
    last = mask.shape[-1] - 1 - np.argmax(mask[..., ::-1], axis=-1)
    is_sheet = counts > 0
    gappy = np.median(counts[is_sheet] / (last - first + 1)[is_sheet])
    if gappy < 0.4:
        raise VolumeError(
            "Along the axis through the sheet the material has gaps: half of the columns are filled by less than "
            f"{100 * gappy:.0f} % between their first and last voxel, so several sheets lie behind each other. "
            f"{_CHOOSE}"
        )
    low, high = _extent(blocks, np.where(is_sheet, first, -1), np.where(is_sheet, last, -1), threshold)
    sizes = np.sum([np.bincount(row.ravel(), minlength=count + 1) for row in labels], axis=0)[1:]
    return CoarseSheet(
        low=low, high=high, block=choice.block, leaves=mask[..., 0] | mask[..., -1], threshold=threshold,
        touching=np.zeros(is_sheet.shape, bool), specks=int(np.count_nonzero(sizes >= _SPECK)) - 1,
    )  # fmt: skip


def followed_sheet(blocks: Blocks, inside: Bools, threshold: float, choice: Choice) -> CoarseSheet:
    """Follow the sheet at the seed point from column to column; VolumeError if there is none."""
    assert choice.seed is not None
    seed = np.asarray(choice.seed)
    corner = np.maximum(seed - _NEAR, 0)
    places = np.argwhere(inside[tuple(slice(int(a), int(k) + _NEAR + 1) for a, k in zip(corner, seed, strict=True))])
    if places.size == 0:
        raise VolumeError(
            f"There is only air at the seed point {choice.describe(choice.seed)} um (z, y, x). Give a point inside the "
            "sheet with --seed-um."
        )
    # The nearest block of material to the seed point.
    row, col, depth = (int(k) for k in places[int(np.argmin(np.sum((places + corner - seed) ** 2, axis=1)))] + corner)
    run = inside[row, col]
    outside = np.flatnonzero(~run)
    start = int(outside[outside < depth].max(initial=-1)) + 1
    stop = int(outside[outside > depth].min(initial=run.size)) - 1
    # The seed's own run says roughly how thick the sheet is, the median of what was found then says it well.
    low = high = np.empty((0, 0), np.int64)
    merged = np.empty((0, 0), np.bool_)
    most = 2.0 * (stop - start + 1) + 2.0
    for _ in range(2):
        low, high = (np.full(run_shape, -1, np.int64) for run_shape in (inside.shape[:2],) * 2)
        merged = np.zeros(inside.shape[:2], np.bool_)
        _kernels.follow(inside, row, col, start, stop, most, low, high, merged)
        most = MERGED * float(np.median((high - low + 1)[low >= 0])) + 1.0
    is_sheet = low >= 0
    if is_sheet.mean() < _LEAST_COVER:
        raise VolumeError(
            f"The object at the seed point {choice.describe((row, col, depth))} um (z, y, x) covers "
            f"{100 * is_sheet.mean():.2g} % of the columns only. Check --through (the axis that runs "
            "through the sheet) and --seed-um."
        )
    leaves = is_sheet & ((low == 0) | (high == inside.shape[2] - 1))
    if np.mean(leaves[is_sheet]) > _LEAVES:
        raise VolumeError(
            f"The object at the seed point {choice.describe((row, col, depth))} um (z, y, x) reaches an end of the "
            f"axis through the sheet in {100 * np.mean(leaves[is_sheet]):.0f} % of its columns. Check --through and "
            "--seed-um."
        )
    first, last = _extent(blocks, low, high, threshold)
    return CoarseSheet(low=first, high=last, block=choice.block, leaves=leaves, threshold=threshold, touching=merged)


def flags_to_columns(field: Bools, block: int, shape: tuple[int, int]) -> Bools:
    """Give every column the flag of its block."""
    r, c = (np.minimum(np.arange(n) // block, m - 1) for n, m in zip(shape, field.shape, strict=True))
    return field[np.ix_(r, c)]


def to_columns(field: Floats, block: int, shape: tuple[int, int]) -> Floats:
    """Interpolate a block map to single columns; NaN where the nearest block is NaN."""
    lines = [
        np.clip((np.arange(n) - 0.5 * (block - 1)) / block, 0, m - 1) for n, m in zip(shape, field.shape, strict=True)
    ]
    return interpolate(field, lines, order=1)


def _inner_point(mask: Bools) -> tuple[int, int, int]:
    """Return a point in the middle of an object."""
    rows, cols = np.nonzero(mask.any(axis=-1))
    k = int(np.argmin((rows - np.median(rows)) ** 2 + (cols - np.median(cols)) ** 2))
    depth = np.flatnonzero(mask[rows[k], cols[k]])
    return int(rows[k]), int(cols[k]), int(depth[depth.size // 2])


def _cover(labels: NDArray[np.integer], count: int) -> NDArray[np.int64]:
    """Count the columns in which each object appears."""
    cover = np.zeros(count + 1, dtype=np.int64)
    for row in labels:
        ordered = np.sort(row, axis=-1)
        fresh = np.ones(ordered.shape, dtype=bool)
        fresh[..., 1:] = ordered[..., 1:] != ordered[..., :-1]
        cover += np.bincount(ordered[fresh], minlength=count + 1)
    return cover[1:]


def _extent(blocks: Blocks, low: NDArray[np.int64], high: NDArray[np.int64], threshold: float) -> tuple[Floats, Floats]:
    """Move first and last index (-1: none) outwards to where the grey crosses the threshold."""
    # A sheet that touches the end of its column is cut there: its face is not in the volume, and that end is NaN.
    ends: list[Floats] = []
    last = blocks.shape[-1] - 1
    for index, outward, end in ((low, -1, 0), (high, 1, last)):
        places = (np.clip(index + step, 0, last)[..., None] for step in (0, outward))
        a, b = (np.take_along_axis(blocks, at, axis=-1)[..., 0].astype(float) for at in places)
        share = np.clip((a - threshold) / np.where(np.abs(a - b) > 1e-12, a - b, 1.0), 0.0, 1.0)
        ends.append(np.where((index >= 0) & (index != end), index + outward * share, np.nan))
    return ends[0], ends[1]
