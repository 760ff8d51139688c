"""Course of the sheet in a stack of sections: a smooth surface through its middle, and the grey levels on both sides.

The surface need not be exact. It straightens the band in which neighbours are compared, and it is smooth from section
to section, so it lends neighbours no difference of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter, gaussian_filter1d, label, median_filter

from planish.core.errors import VolumeError
from planish.core.lazy import LazyArray
from planish.core.threads import map_threads
from planish.core.typing import Bools, Floats
from planish.sections.network import slow_part

_BLOCK_UM = (5.0, 80.0)  # rows, cols of the blocks in which the sheet is looked for
_BORDER = 0.15  # share of the rows at each end that is taken to be background
_SMOOTH_SECTIONS = 30.0  # shortest wave of the surface
_FILLED = 1e-3  # weight of a place where the sheet was not found, against 1


Stack = NDArray[Any] | LazyArray
"""Sections (section, row, col): an array, or photographs that are decoded when they are asked for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Band:
    """Course of the sheet.

    Attributes
    ----------
    row : ndarray (sections, blocks)
        Middle of the sheet, in pixels along the rows; smooth along both axes.
    at_col : ndarray (blocks,)
        Middle column of each block, in pixels.
    jump : ndarray (sections,)
        By how many rows the sheet lies off the smooth surface in this section: a first guess of its shift.
    half_um : float
        Half the sheet's thickness across the rows, in um.
    background, contrast : ndarray (sections,)
        Rough grey level off the sheet, and that of the sheet less that of the background.
    """

    row: Floats
    at_col: Floats
    jump: Floats
    half_um: float
    background: Floats
    contrast: Floats

    def heights(self, section: int, cols: int) -> NDArray[np.float32]:
        """Row of the sheet in each of ``cols`` columns of a section, in pixels."""
        return np.interp(np.arange(cols), self.at_col, self.row[section]).astype(np.float32)


@dataclass(frozen=True, eq=False)
class SectionSeries:
    """Photographs of serial sections, in order.

    Attributes
    ----------
    stack : ndarray or LazyArray, dims (section, row, col)
        Grey values of any integer or real type; NaN is missing. The sheet is a band along the columns.
    positions_um : ndarray (sections,)
        True places along the cut in um, monotonic; missing sections are gaps.
    pixel_um : (row, col)

    Raises
    ------
    VolumeError
        If the stack is none, or positions are not monotonic; of :attr:`band` if no sheet is found.
    """

    stack: Stack
    positions_um: Floats
    pixel_um: tuple[float, float]

    def __post_init__(self) -> None:
        """Check dims, types and numbers."""
        stack, positions = self.stack, self.positions_um
        if stack.ndim != 3 or stack.dtype.kind not in "uif" or min(stack.shape) < 2:
            raise VolumeError(
                f"The sections have the shape {' x '.join(map(str, stack.shape))} and type {stack.dtype}. Needed are "
                "grey values, (sections, rows, cols), with at least two of each."
            )
        if positions.shape != stack.shape[:1]:
            raise VolumeError(
                f"There are {stack.shape[0]} sections and {positions.size} positions. Each section needs one."
            )
        if not all(np.isfinite(p) and p > 0 for p in self.pixel_um):
            pixel = "{:g} x {:g}".format(*self.pixel_um)
            raise VolumeError(f"A pixel of {pixel} um is none. Give its size (row, col) in um.")
        wrong = np.flatnonzero(~(np.diff(self.away_um) > 0))
        if wrong.size:
            i = int(wrong[0])
            raise VolumeError(
                f"The sections {i + 1} and {i + 2} lie at {positions[i]:g} and {positions[i + 1]:g} um. Positions "
                "have to be monotonic: correct the cut counter or put the sections in order."
            )

    @cached_property
    def away_um(self) -> Floats:
        """Distances from the first section, increasing."""
        away = np.asarray(self.positions_um, np.float64) - self.positions_um[0]
        return -away if away[-1] < 0 else away

    @property
    def pitch_um(self) -> float:
        """Median distance of neighbours."""
        return float(np.median(np.diff(self.away_um)))

    @cached_property
    def band(self) -> Band:
        """Course of the sheet."""
        return _find_band(self.stack, self.away_um, self.pixel_um)


def _find_band(stack: Stack, away_um: Floats, pixel_um: tuple[float, float]) -> Band:
    """Find the course of the sheet through a stack of sections.

    Block means of 5 x 80 um are separated by Otsu's threshold (1979, IEEE Trans. SMC 9, 62) on the difference to the
    section's background; the largest connected part is the sheet.
    """
    n, rows, cols = stack.shape
    tall = max(1, min(round(_BLOCK_UM[0] / pixel_um[0]), rows // 16))
    wide = max(1, min(round(_BLOCK_UM[1] / pixel_um[1]), cols // 8))

    def means(i: int) -> NDArray[np.float32]:
        return block_means(stack[i], tall, wide)

    blocks = np.stack(map_threads(means, range(n)))
    border = max(1, int(_BORDER * blocks.shape[1]))
    ends = np.concatenate([blocks[:, :border], blocks[:, -border:]], axis=1).reshape(n, -1)
    background = _row_medians(ends)
    sheet, weight = _find_sheet(blocks, background)
    count = sheet.sum(axis=1)
    usual = float(np.median(count[count > 0]))
    total = weight.sum(axis=1)
    sound = (count >= 0.5 * usual) & (count <= 2.0 * usual) & (total > 0)
    if not sound.any():
        raise VolumeError("No sheet of an even thickness found in the sections. Check the files and the pixel size.")
    at_row = np.arange(blocks.shape[1])[:, None]
    middle = np.where(sound, (weight * at_row).sum(axis=1) / np.where(total > 0, total, 1.0), np.nan)
    middle = (middle + 0.5) * tall - 0.5
    smooth = _smooth_surface(middle, away_um)
    off = np.where(sound, middle - smooth, np.nan)
    jump = np.array([np.nanmedian(row) if np.isfinite(row).any() else 0.0 for row in off])
    return Band(
        row=smooth,
        at_col=np.arange(blocks.shape[2], dtype=np.float64) * wide + 0.5 * (wide - 1),
        jump=jump,
        half_um=0.5 * usual * tall * pixel_um[0],
        background=np.where(np.isfinite(background), background, np.nanmedian(background)),
        contrast=_sheet_contrast(blocks, sheet, background),
    )


def _find_sheet(blocks: NDArray[np.float32], background: Floats) -> tuple[Bools, Floats]:
    """Give the blocks of the sheet as a mask, and their difference to the background, 0 off the sheet."""
    difference = np.abs(blocks - background[:, None, None])
    difference[~np.isfinite(difference)] = 0.0
    smoothed: Floats = gaussian_filter(difference, 1.0)
    sheet = _largest_part(smoothed > _otsu_threshold(smoothed[:: max(1, len(blocks) // 200)].ravel()))
    if sheet is None:
        raise VolumeError("No sheet found in the sections: all grey levels are alike. Check the files.")
    return sheet, np.where(sheet, difference, 0.0)


def _sheet_contrast(blocks: NDArray[np.float32], sheet: Bools, background: Floats) -> Floats:
    """Give the grey level of the sheet less that of the background, of each section."""
    contrast = _row_medians(np.where(sheet, blocks, np.nan).reshape(len(blocks), -1)) - background
    typical = float(np.nanmedian(contrast))
    # A section without a sheet has no contrast of its own; a drift of colour is far less than a factor of two.
    is_fair = np.isfinite(contrast) & (np.abs(contrast - typical) < 0.5 * abs(typical))
    return np.where(is_fair, contrast, typical)


def block_means(section: NDArray[Any], rows: int, cols: int) -> NDArray[np.float32]:
    """Means of blocks of rows x cols pixels; NaN where a block holds a NaN, and what is left over is left out."""
    down, across = section.shape[0] // rows, section.shape[1] // cols
    inner = section[: down * rows, : across * cols].reshape(down, rows, across * cols)
    total = inner.sum(axis=1, dtype=np.float32).reshape(down, across, cols).sum(axis=2, dtype=np.float64)
    return (total / (rows * cols)).astype(np.float32)


def _row_medians(rows: NDArray[np.float32]) -> Floats:
    """Median of the numbers in each row; NaN where there is none."""
    is_valid = np.isfinite(rows)
    return np.array([np.median(v[h]) if h.any() else np.nan for v, h in zip(rows, is_valid, strict=True)], np.float64)


def _otsu_threshold(greys: Floats) -> float:
    """Threshold that separates two groups best: the one with the largest variance between them."""
    counts, edges = np.histogram(greys, 512)
    centres = 0.5 * (edges[1:] + edges[:-1])
    below = np.cumsum(counts)[:-1]
    above = greys.size - below
    mass = np.cumsum(counts * centres)
    low, high = mass[:-1] / np.maximum(below, 1), (mass[-1] - mass[:-1]) / np.maximum(above, 1)
    return float(edges[1 + int(np.argmax(below.astype(np.float64) * above * (high - low) ** 2))])


def _largest_part(mask: Bools) -> Bools | None:
    """Return the largest connected part, None where there is nothing."""
    names: NDArray[Any]
    names, count = label(mask)
    if count == 0:
        return None
    sizes = np.bincount(names.ravel())
    sizes[0] = 0
    return names == int(np.argmax(sizes))


def _smooth_surface(middle: Floats, away_um: Floats) -> Floats:
    """Smooth the middle of the sheet (sections, blocks) along both axes and fill it where it is NaN."""
    is_valid = np.isfinite(middle)
    nearest: NDArray[Any] = distance_transform_edt(~is_valid, return_distances=False, return_indices=True)
    filled = median_filter(middle[tuple(nearest)], size=(1, 3), mode="nearest")
    weights = np.where(is_valid, 1.0, _FILLED)
    cutoff = _SMOOTH_SECTIONS * float(np.median(np.diff(away_um)))
    columns = [
        slow_part(away_um, filled[:, k], cutoff_um=cutoff, weights=weights[:, k]) for k in range(middle.shape[1])
    ]
    return gaussian_filter1d(np.stack(columns, axis=1), 1.0, axis=1, mode="nearest")
