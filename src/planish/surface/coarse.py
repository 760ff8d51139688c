"""Where the sheet is, roughly: block means, one connected slab, and how far it reaches in each block column."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.errors import VolumeError

Array = NDArray[np.float64]

CORE = (0.35, 0.65)  # share of the way through the sheet that counts as its core
_SECOND_SHEET = 0.25  # share of the largest piece's area above which a second piece counts as another sheet
_LEAVES = 0.5  # share of columns that may run out of the volume
_LEAST_COVER = 0.02
_GREY_RANGE = "Choose one by its grey values with --sheet-grey LOW,HIGH, or crop the volume."


@dataclass(frozen=True, slots=True, kw_only=True)
class CoarseSheet:
    """Extent of the sheet in each block column, in voxels of depth, NaN where there is none.

    Attributes
    ----------
    low, high : (block rows, block cols)
        First and last depth index, interpolated to the threshold.
    block : int
        Edge of a block in voxels.
    """

    low: Array
    high: Array
    block: int


def coarse_sheet(blocks: NDArray[np.float32], inside: NDArray[np.bool_], threshold: float, block: int) -> CoarseSheet:
    """Keep the largest connected slab of ``inside`` and measure its extent.

    Raises
    ------
    VolumeError
        If there is no slab, more than one, or if it fills the volume from end to end.
    """
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
    others = [int(k) + 1 for k in order[1:6] if cover[k] > _SECOND_SHEET * cover[largest - 1]]
    if others:
        shares = ", ".join(f"{100 * cover[k - 1] / labels[..., 0].size:.0f} %" for k in (largest, *others))
        raise VolumeError(
            f"The volume shows {1 + len(others)} separate sheets (they cover {shares} of the columns). {_GREY_RANGE}"
        )
    mask = labels == largest
    touches_low, touches_high = mask[..., 0].mean() / area, mask[..., -1].mean() / area
    if max(touches_low, touches_high) > _LEAVES:
        end = "low" if touches_low >= touches_high else "high"
        raise VolumeError(
            f"Material reaches the {end} end of the axis through the sheet in "
            f"{100 * max(touches_low, touches_high):.0f} % of the columns: the sheet leaves the volume "
            f"there, or several "
            f"sheets lie behind each other. {_GREY_RANGE}"
        )
    filled = mask.sum(axis=-1)
    first = np.argmax(mask, axis=-1)
    last = mask.shape[-1] - 1 - np.argmax(mask[..., ::-1], axis=-1)
    some = filled > 0
    gappy = np.median(filled[some] / (last - first + 1)[some])
    if gappy < 0.4:
        raise VolumeError(
            f"Along the axis through the sheet the material has gaps: half of the columns are filled by less than "
            f"{100 * gappy:.0f} % between their first and last voxel, so several sheets lie behind each "
            f"other. {_GREY_RANGE}"
        )
    low = np.where(some, first.astype(float), np.nan)
    high = np.where(some, last.astype(float), np.nan)
    # A sheet that touches the end of its column is cut there: its face is not in the volume.
    low[some & (first == 0)] = np.nan
    high[some & (last == mask.shape[-1] - 1)] = np.nan
    return CoarseSheet(
        low=_subvoxel(blocks, low, -1, threshold), high=_subvoxel(blocks, high, +1, threshold), block=block
    )


def to_columns(field: Array, block: int, shape: tuple[int, int]) -> Array:
    """Interpolate a block map to single columns; NaN where the nearest block is NaN."""
    known = np.isfinite(field)
    if not known.any():
        return np.full(shape, np.nan)
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    filled = field[tuple(nearest)]
    r, c = ((np.arange(n) - 0.5 * (block - 1)) / block for n in shape)
    grid = np.meshgrid(np.clip(r, 0, field.shape[0] - 1), np.clip(c, 0, field.shape[1] - 1), indexing="ij")
    values = ndimage.map_coordinates(filled, grid, order=1, mode="nearest")
    seen = ndimage.map_coordinates(known.astype(np.uint8), grid, order=0, mode="nearest")
    return np.where(seen > 0, values, np.nan)


def _cover(labels: NDArray[np.integer], count: int) -> NDArray[np.int64]:
    """Count the columns in which each object appears."""
    cover = np.zeros(count + 1, dtype=np.int64)
    for row in labels:
        ordered = np.sort(row, axis=-1)
        fresh = np.ones(ordered.shape, dtype=bool)
        fresh[..., 1:] = ordered[..., 1:] != ordered[..., :-1]
        cover += np.bincount(ordered[fresh], minlength=count + 1)
    return cover[1:]


def _subvoxel(blocks: NDArray[np.float32], index: Array, outward: int, threshold: float) -> Array:
    """Move each boundary index outwards to where the grey crosses the threshold."""
    known = np.isfinite(index)
    here = np.where(known, index, 0).astype(int)
    there = np.clip(here + outward, 0, blocks.shape[-1] - 1)
    a = np.take_along_axis(blocks, here[..., None], axis=-1)[..., 0].astype(float)
    b = np.take_along_axis(blocks, there[..., None], axis=-1)[..., 0].astype(float)
    share = np.clip((a - threshold) / np.where(np.abs(a - b) > 1e-12, a - b, 1.0), 0.0, 1.0)
    return np.where(known, index + outward * share, np.nan)
