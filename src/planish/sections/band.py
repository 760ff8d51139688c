"""Course of the sheet in a stack of sections.

It is a smooth surface through the sheet's middle, and the grey levels on both sides.

It straightens the band in which neighbours are compared; smooth, it lends neighbours no difference
of its own.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import (
    distance_transform_edt,
    gaussian_filter,
    gaussian_filter1d,
    label,
    median_filter,
)

from planish.core.errors import VolumeError
from planish.core.lazy import LazyArray
from planish.core.robust import mad_sd, otsu_borders
from planish.core.threads import map_threads
from planish.core.typing import Array, Bools, Floats, Pair, Shape2D, Singles
from planish.sections.network import slow_part

Stack = Array | LazyArray
"""Sections (section, row, col): an array, or photographs that are decoded when they are asked
for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetBand:
    """Course of the sheet."""

    #: (sections, blocks): middle of the sheet, in pixels along the rows; smooth along both axes.
    row: Floats
    at_col: Floats  #: (blocks,): middle column of each block, in pixels.
    #: (sections,): by how many rows the sheet lies off the smooth surface in this section: a first
    #: guess of its shift.
    jump: Floats
    half_um: float  #: Half the sheet's thickness across the rows, in um.
    background: Floats  #: (sections,): rough grey level off the sheet.
    contrast: Floats  #: (sections,): that of the sheet less that of the background.

    def heights(self, section: int, cols: int) -> Singles:
        """Row of the sheet in each of ``cols`` columns of a section, in pixels."""
        rows = np.interp(np.arange(cols), self.at_col, self.row[section])
        return rows.astype(np.float32)


@dataclass(frozen=True, eq=False)
class SectionSeries:
    """Photographs of serial sections, in order.

    Raises
    ------
    VolumeError
        If the stack is none, or positions are not monotonic; of :attr:`band` if no sheet is found.
    """

    #: (section, row, col), of any integer or real type; NaN is missing; the sheet is a band along
    #: the columns.
    stack: Stack
    #: (sections,), true places along the cut, monotonic; missing sections are gaps.
    positions_um: Floats
    pixel_um: Pair  #: (row, col)

    def __post_init__(self) -> None:
        """Check dims, types and numbers."""
        stack, positions = self.stack, self.positions_um
        if stack.ndim != 3 or stack.dtype.kind not in "uif" or min(stack.shape) < 2:
            raise VolumeError(
                f"The sections have the shape {' x '.join(map(str, stack.shape))} and type"
                f" {stack.dtype}. Needed are grey values, (sections, rows, cols), with at least two"
                " of each."
            )
        if positions.shape != stack.shape[:1]:
            raise VolumeError(
                f"There are {stack.shape[0]} sections and {positions.size} positions. Each section"
                " needs one."
            )
        if not all(0 < um < np.inf for um in self.pixel_um):
            pixel = "{:g} x {:g}".format(*self.pixel_um)
            raise VolumeError(f"A pixel of {pixel} um is none. Give its size (row, col) in um.")
        if wrong := np.flatnonzero(~(np.diff(self.away_um) > 0)).tolist():
            i = wrong[0]
            raise VolumeError(
                f"The sections {i + 1} and {i + 2} lie at {positions[i]:g} and {positions[i + 1]:g}"
                " um. Positions have to be monotonic: correct the cut counter or put the sections"
                " in order."
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
    def band(self) -> SheetBand:
        """Course of the sheet.

        Block means of 5 x 80 um are separated by Otsu's threshold (1979, IEEE Trans. SMC 9, 62) on
        the difference to the section's background; the largest connected part is the sheet. A
        column of blocks counts where the sheet's thickness is within a factor of two of the median.
        """
        n, rows, cols = self.stack.shape
        row_um, col_um = self.pixel_um
        block_rows = max(1, min(round(5.0 / row_um), rows // 16))
        block_cols = max(1, min(round(80.0 / col_um), cols // 8))

        def means(i: int) -> Singles:
            return block_means(self.stack[i], block_rows, block_cols)

        blocks = np.stack(map_threads(means, range(n)))
        # Rows at each end that are taken to be background.
        _, n_down, n_across = blocks.shape
        margin = max(1, int(0.15 * n_down))
        inner_rows = np.s_[margin : n_down - margin]
        ends = np.delete(blocks, inner_rows, axis=1)
        background = _row_medians(ends.reshape(n, -1))
        is_sheet, weight = _find_sheet(blocks, background)
        thickness = is_sheet.sum(axis=1)
        typical = float(np.median(thickness[thickness > 0]))
        weight_sum = weight.sum(axis=1)
        is_sound = (thickness >= 0.5 * typical) & (thickness <= 2.0 * typical)
        is_sound &= weight_sum > 0
        if not is_sound.any():
            raise VolumeError(
                "No sheet of an even thickness found in the sections. Check the files and the pixel"
                " size."
            )
        moment = (weight * np.arange(n_down)[:, None]).sum(axis=1)
        middle = np.full(moment.shape, np.nan)
        np.divide(moment, weight_sum, out=middle, where=is_sound)
        middle_row = (middle + 0.5) * block_rows - 0.5
        smooth_row = _smooth_surface(middle_row, self.away_um)
        jump = np.nan_to_num(_row_medians(middle_row - smooth_row))
        sheet_greys = np.where(is_sheet, blocks, np.nan)
        contrast = _row_medians(sheet_greys.reshape(n, -1)) - background
        median_contrast = float(np.nanmedian(contrast))
        # A section without a sheet has no contrast of its own; a drift of colour is far less than a
        # factor of two.
        is_plausible = np.abs(contrast - median_contrast) < 0.5 * abs(median_contrast)
        is_known = np.isfinite(background)
        return SheetBand(
            row=smooth_row,
            at_col=np.arange(n_across) * block_cols + 0.5 * (block_cols - 1),
            jump=jump,
            half_um=0.5 * typical * block_rows * row_um,
            background=np.where(is_known, background, np.nanmedian(background)),
            contrast=np.where(is_plausible, contrast, median_contrast),
        )


def _find_sheet(blocks: Singles, background: Floats) -> tuple[Bools, Floats]:
    """Blocks (sections, rows, cols) in which the sheet lies, and how far they are from resin.

    The latter in grey, 0 off the sheet. ``background`` (sections,) is the grey of the resin.
    """
    difference = np.abs(blocks - background[:, None, None])
    difference[~np.isfinite(difference)] = 0.0
    smoothed_difference: Floats = gaussian_filter(difference, 1.0)
    sample = smoothed_difference[:: max(1, len(blocks) // 200)].ravel()
    bin_counts, bin_edges = np.histogram(sample, 512)
    bin_sums = bin_counts * (0.5 * (bin_edges[1:] + bin_edges[:-1]))
    (border,) = otsu_borders(bin_counts, bin_sums, classes=2)
    labels, n_labels = label(smoothed_difference > float(bin_edges[border]))
    if n_labels == 0:
        raise VolumeError(
            "No sheet found in the sections: all grey levels are alike. Check the files."
        )
    sizes = np.bincount(labels.ravel())
    is_sheet = labels == 1 + np.argmax(sizes[1:])
    return is_sheet, np.where(is_sheet, difference, 0.0)


def block_means(section: Array, rows: int, cols: int) -> Singles:
    """Means of blocks of rows x cols pixels.

    NaN where a block holds a NaN, and what is left over is left out.
    """
    n_down = section.shape[0] // rows
    n_across = section.shape[1] // cols
    width = n_across * cols
    interior = section[: n_down * rows, :width].reshape(n_down, rows, width)
    row_sums = interior.sum(axis=1, dtype=np.float32).reshape(n_down, n_across, cols)
    total = row_sums.sum(axis=2, dtype=np.float64)
    return (total / (rows * cols)).astype(np.float32)


def _row_medians(values: Array) -> Floats:
    """Median of the finite values of each row; NaN where there is none."""
    medians = np.full(len(values), np.nan)
    for k, row in enumerate(values):
        finite = row[np.isfinite(row)]
        if finite.size:
            medians[k] = np.median(finite)
    return medians


def _smooth_surface(middle_row: Floats, away_um: Floats) -> Floats:
    """Smooth the sheet's middle (sections, blocks) along both axes and fill it where it is NaN.

    In pixels along the rows. Along the cut waves shorter than 30 sections are taken off, along the
    columns a Gaussian of one block is laid over.
    """
    is_valid = np.isfinite(middle_row)
    nearest_indices: Array = distance_transform_edt(
        ~is_valid, return_distances=False, return_indices=True
    )
    nearest_row = middle_row[tuple(nearest_indices)]
    filled_row = median_filter(nearest_row, size=(1, 3), mode="nearest")
    # Weight of a place where the sheet was not found, against 1.
    weights = np.where(is_valid, 1.0, 1e-3)
    cutoff_um = 30.0 * float(np.median(np.diff(away_um)))  # shortest wave of the surface
    rows = zip(filled_row.T, weights.T, strict=True)
    courses = [slow_part(away_um, y, cutoff_um=cutoff_um, weights=w) for y, w in rows]
    surface = np.stack(courses, axis=1)
    return gaussian_filter1d(surface, 1.0, axis=1, mode="nearest")


_MOST = 50_000  # pixels for a level: the noise of a pixel is divided by 200


@dataclass(frozen=True, slots=True, kw_only=True)
class Gains:
    """Corrections that make the grey levels of all sections equal: gain x grey + offset."""

    gain: Floats  #: (sections,); 1 where the levels could not be measured.
    offset: Floats  #: (sections,); 0 where the levels could not be measured.
    measured: Bools  #: (sections,).


def normalise_sections(series: SectionSeries) -> Gains:
    """Find gain and offset of each section from two anchors; one section at a time is looked at.

    Returns
    -------
    Gains
        They bring both anchors to their medians over all sections.

    Raises
    ------
    VolumeError
        If no sheet is found.

    Notes
    -----
    The anchors are the mode of the background and the middle of the sheet's core; both are the mean
    of the crowd around the median, iterated, which is surer than the median. What limits the gain
    is the sheet: its fibres go up and down together by their standard deviation over the root of
    the number of flocs in the core, some 0.3 % of the contrast in 8 mm, and this, like a slow
    change of the sheet's own material, is taken for a drift of colour.
    """
    band, pixel = series.band, series.pixel_um[0]
    n, rows, cols = series.stack.shape
    # The core lies away from the faces and their coatings, the background beyond the faces.
    near = 0.7 * band.half_um / pixel
    far = (band.half_um + 30.0) / pixel
    inside = 2 * near * cols
    outside = max(1.0, rows - 2 * far) * cols
    step = (max(1, round(inside / _MOST)), max(1, round(outside / _MOST)))

    def levels(i: int) -> Pair:
        height = band.heights(i, cols) + np.float32(band.jump[i])
        inner, outer = core_and_background(series.stack[i], height, near, far, step)
        return _crowd_mean(outer), _crowd_mean(inner)

    anchors = np.array(map_threads(levels, range(n)), np.float64)
    background, material = anchors.T
    contrast = material - background
    typical = float(np.nanmedian(contrast)) if np.isfinite(contrast).any() else np.nan
    # A gain farther from 1 is no drift of colour but another thing in the picture.
    measured = np.abs(contrast - typical) <= 0.3 * abs(typical)
    level = float(np.median(background[measured])) if measured.any() else 0.0
    gain = np.ones(n)
    gain[measured] = typical / contrast[measured]
    offset = np.zeros(n)
    offset[measured] = level - gain[measured] * background[measured]
    return Gains(gain=gain, offset=offset, measured=measured)


def core_and_background(
    section: Array,
    height: Singles,
    near_px: float,
    far_px: float,
    strides: Shape2D,
) -> tuple[Singles, Singles]:
    """Grey levels of the sheet's core and of the background.

    height[c] is the row of the sheet: pixels within ``near_px`` of it are the core, of which every
    strides[0]-th is taken; those beyond ``far_px`` are the background, of which every strides[1]-th
    is.
    """
    row = np.arange(section.shape[0])[:, None]
    sheet_row = height.astype(np.float64)
    is_core = (row >= sheet_row - near_px) & (row <= sheet_row + near_px)
    is_background = (row <= sheet_row - far_px) | (row >= sheet_row + far_px)
    core_stride, background_stride = strides
    core = section[is_core][::core_stride]
    background = section[is_background][::background_stride]
    return _first_numbers(core), _first_numbers(background)


def _first_numbers(samples: Array) -> Singles:
    """Enough of the samples, without those that are missing."""
    greys = samples.astype(np.float32)
    return greys[~np.isnan(greys)][: 2 * _MOST]


def _crowd_mean(greys: Singles) -> float:
    """Value around which most of the data lie, by iteration from the median.

    NaN for a few pixels.
    """
    if greys.size < 50:
        return np.nan
    values = greys.astype(np.float64)
    crowd_mean = float(np.median(values))
    sd = mad_sd(values)
    for _ in range(6 if sd > 0 else 0):
        is_of_crowd = np.abs(values - crowd_mean) <= 2.0 * sd
        crowd_mean = float(values[is_of_crowd].mean())
    return crowd_mean
