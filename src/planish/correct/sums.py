"""Whole-number sums over slices across the axis of rotation, which depend on no order.

Greys, circles, histograms.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.errors import InputError, SizeError, VolumeError
from planish.core.frame import Axis, Frame
from planish.core.labelled import read_box
from planish.core.robust import MAD_TO_SD, mad_sd, otsu_borders
from planish.core.threads import thread_pool
from planish.core.typing import Array, Bools, Floats, Ints, Pair, Singles

_WINDOW = 9


class Levels(NamedTuple):
    """Greys of a volume."""

    air: float
    sheet: float  # of the brightest material that is common: coating where there is one, or base
    split: float  # between air and sheet
    middle: float  # between base and coating; infinite where there is one material only
    padding: float  # of voxels that hold nothing; NaN for none
    air_cut: bool  # whether the export has cut off the air's noise, so that its mean is biased

    @property
    def contrast(self) -> float:
        """Grey between air and sheet."""
        return self.sheet - self.air


def smoothed(plane: Array) -> Singles:
    """Smooth a slice; what is not finite counts as 0 and has to be masked."""
    # Then a single voxel shows its material in spite of the noise.
    filled = np.nan_to_num(plane.astype(np.float32), posinf=0.0, neginf=0.0)
    return ndimage.gaussian_filter(filled, 1.5)


def missing(plane: Array, padding: float) -> Bools:
    """Voxels of a slice that hold nothing, and those too near to them to be smoothed."""
    is_empty = ~np.isfinite(plane)
    if np.isfinite(padding):
        is_empty |= _without_specks(plane == padding)
    return ndimage.maximum_filter(is_empty, 9) if is_empty.any() else is_empty


def find_levels(slices: list[Array], radius: Floats) -> Levels | None:
    """Find the greys in some slices (rows, cols); None where no sheet stands out from the air.

    ``radius`` (rows, cols) is the distance from the axis of rotation, in any unit. The air counts
    as cut off where 5 to 80 % of its voxels have the lowest grey there is.
    """
    finite_slices = [s for s in slices if np.isfinite(s).any()]
    lowest = min((float(np.nanmin(s)) for s in finite_slices), default=np.nan)
    padding = _padding(slices, lowest, radius)
    greys: list[Singles] = []
    are_lowest: list[Bools] = []
    for s in slices:
        is_there = ~missing(s, padding)
        greys.append(smoothed(s)[is_there])
        are_lowest.append(s[is_there] == lowest)
    all_greys = np.concatenate(greys)
    levels = _estimate_levels(all_greys)
    if levels is None:
        return None
    is_dark = all_greys < levels.split
    n_dark = np.count_nonzero(is_dark)
    n_cut = np.count_nonzero(is_dark & np.concatenate(are_lowest))
    cut_share = n_cut / max(n_dark, 1)
    # Where all of the air has the same value it has no noise: nothing was cut off.
    return levels._replace(padding=padding, air_cut=0.05 < cut_share < 0.8)


def _padding(slices: list[Array], lowest: float, radius: Floats) -> float:
    """Value of the corners outside the scanner's circle.

    The lowest one, everywhere outside and nowhere inside.
    """
    frequency = np.mean([_without_specks(s == lowest) for s in slices], axis=0)
    share = float(frequency.mean())
    if share < 0.01:  # of all voxels: so much padding at least
        return float("nan")
    # So many of the voxels that are farthest out.
    is_outside = radius > np.quantile(radius, 1.0 - share)
    share_outside = frequency[is_outside].mean()
    share_inside = frequency[~is_outside].mean()
    is_padding = share_outside > 0.9 and share_inside < 0.1 * share
    return lowest if is_padding else float("nan")


def _without_specks(mask: Bools) -> Bools:
    """Mask without the single voxels that noise has cut off.

    Nearly all of a neighbourhood has to be in it.
    """
    local_share = ndimage.uniform_filter(mask.astype(np.float32), _WINDOW)
    return mask & (ndimage.maximum_filter(local_share, _WINDOW) > 0.95)


def _estimate_levels(greys: Singles) -> Levels | None:
    """Read the levels off the histogram of smoothed greys.

    None where no sheet stands out from the air. Otsu's thresholds part three classes: air, base and
    what is brighter. Where the third is no material of its own, its border is infinite.
    """
    if greys.size < 1000:
        return None
    lowest, highest = map(float, np.percentile(greys, [0.02, 99.98]))
    if not highest > lowest:
        return None
    bin_counts, bin_edges = np.histogram(greys, 160, (lowest, highest))
    bin_sums = bin_counts * np.arange(bin_counts.size)
    borders = otsu_borders(bin_counts, bin_sums, 3)
    split, middle = bin_edges[list(borders)].tolist()
    dark_greys = greys[greys <= split]
    sheet_greys = greys[greys > split]
    # The mean of what lies near the median.
    dark_deviations = np.abs(dark_greys - float(np.median(dark_greys)))
    air_reach = max(3 * MAD_TO_SD * float(np.median(dark_deviations)), 1e-6)
    air_greys = dark_greys[dark_deviations <= air_reach]
    air = float(np.mean(air_greys, dtype=np.float64))
    base_greys = sheet_greys[sheet_greys <= middle]
    bright_greys = sheet_greys[sheet_greys > middle]
    if not bright_greys.size or not base_greys.size:
        return None
    base_level = float(np.median(base_greys))
    bright_level = float(np.median(bright_greys))
    # A second material stands out from the base by so much of its own contrast.
    if bright_level - base_level < 0.25 * (base_level - air):
        middle = np.inf
        base_level = float(np.median(sheet_greys))
        bright_level = base_level
    # Scatters of the smoothed air.
    if bright_level - air < max(6.0 * mad_sd(dark_greys, air), 1e-9):
        return None
    # The lower border lies half way: a border between classes is drawn towards the wider one.
    split = 0.5 * (air + base_level)
    return Levels(air, bright_level, split, middle, padding=np.nan, air_cut=False)


SECTORS = 16  # parts of a turn: a ring shows in all of them, a structure of the sheet does not
_LEAST_PLANE, _LEAST_LENGTH = 24, 8


class Turning(NamedTuple):
    """The axis of rotation.

    ``centre_um`` and ``pitch_um`` are its place and the voxel size along the two other axes, in
    array order; ``shape`` are the voxels along the axis of rotation and along the two others.
    """

    axis: Axis
    centre_um: Pair
    pitch_um: Pair
    shape: tuple[int, int, int]

    @property
    def plane(self) -> tuple[Axis, Axis]:
        """The two axes across the axis of rotation, in array order."""
        frame = Frame(through=self.axis)
        return frame.rows, frame.cols

    @property
    def order(self) -> tuple[int, int, int]:
        """Axes of the array (z, y, x) in the order axis of rotation, plane."""
        a, b, c = ("zyx".index(name) for name in (self.axis, *self.plane))
        return a, b, c

    @property
    def step_um(self) -> float:
        """Width of a bin of the radius.

        Half a voxel, so that a ring of one voxel keeps its height.
        """
        return 0.5 * min(self.pitch_um)

    @property
    def bins(self) -> int:
        """Number of bins of the radius."""
        return int(np.ceil(self.farthest_um / self.step_um)) + 1

    @property
    def coarse_um(self) -> Floats:
        """Middles of the histogram's radii."""
        return (np.arange(COARSE) + 0.5) * self.farthest_um / COARSE

    def coarse_bins(self, radius_um: Array) -> NDArray[np.int64]:
        """Numbers of the histogram's radii."""
        bins = radius_um / self.farthest_um * COARSE
        return np.minimum(bins.astype(np.int64), COARSE - 1)

    @property
    def farthest_um(self) -> float:
        """Largest radius in the field."""
        extent_um = np.subtract(self.shape[1:], 1) * self.pitch_um
        reaches_um = np.maximum(np.abs(self.centre_um), np.abs(extent_um - self.centre_um))
        return math.hypot(*reaches_um)

    def offsets_um(self, rows: Ints, cols: Ints) -> tuple[Floats, Floats]:
        """Distances (rows, 1) and (1, cols) from the axis along the two others."""
        row_um, col_um = self.pitch_um
        row_centre_um, col_centre_um = self.centre_um
        r = rows.astype(np.float64) * row_um - row_centre_um
        c = cols.astype(np.float64) * col_um - col_centre_um
        return r[:, None], c[None, :]


def make_turning(volume: xr.DataArray, axis: Axis, centre_um: Pair | None) -> Turning:
    """Place the axis of rotation; in the middle of the field where ``centre_um`` is None.

    ``centre_um`` is its place along the two other axes, in array order, from the first voxel. A
    volume too small, or an axis farther outside than half of the field, is refused.
    """
    if "voxel_um" not in volume.attrs:
        raise SizeError(
            "The volume has no voxel size ('voxel_um'). Read it with read_volume, which asks for"
            " one."
        )
    voxel_um = map(float, volume.attrs["voxel_um"])
    size = dict(zip("zyx", voxel_um, strict=True))
    frame = Frame(through=axis)
    a, b = frame.rows, frame.cols
    length, rows, cols = (volume.sizes[name] for name in (axis, a, b))
    pitch = (size[a], size[b])
    if length < _LEAST_LENGTH:
        raise VolumeError(
            f"The volume has {length} voxel(s) along {axis}, the axis of rotation; at least"
            f" {_LEAST_LENGTH} are needed to separate a ring from the sheet. Give the whole stack,"
            " or another axis with `rotation_axis`."
        )
    if min(rows, cols) < _LEAST_PLANE:
        raise VolumeError(
            f"The volume has {rows} x {cols} voxels along {a} and {b}, across the axis of"
            f" rotation; at least {_LEAST_PLANE} are needed. Give the whole stack, or another"
            " `rotation_axis`."
        )
    height_um = (rows - 1) * size[a]
    width_um = (cols - 1) * size[b]
    centre = centre_um or (0.5 * height_um, 0.5 * width_um)
    for name, position_um, end_um in zip((a, b), centre, (height_um, width_um), strict=True):
        # An axis further outside is taken for a mistake.
        if not -0.5 * end_um <= position_um <= 1.5 * end_um:
            raise InputError(
                f"The axis of rotation would stand at {name} = {position_um:g} um; the field runs"
                f" from 0 to {end_um:g} um. Give `rotation_centre_um` as {a},{b} in um from the"
                " first voxel."
            )
    return Turning(axis=axis, centre_um=centre, pitch_um=pitch, shape=(length, rows, cols))


Counts = NDArray[np.int64]
Slice = NDArray[Any]
NumberedSlice = tuple[int, Slice]
Labels = NDArray[np.uint8]  # 0, or one more than the number of the material
AIR, BASE, BRIGHT = 0, 1, 2
MATERIALS = ("air", "base", "coating")
UNIT = 1024  # whole numbers to the contrast between air and sheet
GREYS = np.linspace(-0.5, 2.5, 301)  # borders of the histogram's greys, in contrasts above air
GREY_STEP = GREYS[1] - GREYS[0]
COARSE = 48  # radii of the histogram
QUARTERS = 4  # parts of the turn of the histogram
DEPTHS = np.array([0, 5, 6, 7, 8, 10, 13, 18])
"""Depths below a face in voxels, from which on each class of the histogram begins."""

_BLOCKS, _LEAST_BLOCK = 8, 24  # parts of the axis, and the fewest slices of one
_MOST = 2**29  # voxels that are looked at
_DEEPEST = 24  # voxels; deeper, a material does not change with the depth


@dataclass(frozen=True, slots=True, kw_only=True)
class Sums:
    """Sums of one pass; greys are in units of contrast / :data:`UNIT`."""

    count: Counts  # (block, sector, material, bin): voxels on each part of a circle
    total: Counts  # and their grey, less the mean of their material and depth in the slice
    histogram: Counts  # (block, quarter of the turn, COARSE, depth, grey): voxels inside the sheet
    level: Counts  # (material, 2): number of voxels, and the sum of their grey above air
    blocks: Floats  # (block,): middle of each block along the axis, in slices
    slices: int  # that were looked at


class _Voxels(NamedTuple):
    """What the voxels of a slice (rows, cols) are."""

    grey: Counts  # above air, in :data:`UNIT`
    label: Labels  # of those well inside a material
    depth: Counts  # below the face, in voxels


def slices_of(
    volume: xr.DataArray, turning: Turning, *, max_slices: int | None = None, memory_bytes: int
) -> Iterator[NumberedSlice]:
    """Give (number, slice across the axis) in order; every so many where the volume is large.

    About ``max_slices`` of them, or all, but no more voxels than are looked at.
    """
    length, rows, cols = turning.shape
    stride = math.ceil(length * rows * cols / _MOST) if max_slices is None else length // max_slices
    stride = max(1, stride)
    numbers = range(stride // 2, length, stride)
    # A slab is in memory, and the one after it while that is read.
    slice_bytes = rows * cols * volume.dtype.itemsize
    most_slices = int(memory_bytes / (3 * slice_bytes))
    slab_length = max(1, min(most_slices, len(numbers)))
    for start in range(0, len(numbers), slab_length):
        slab_numbers = numbers[start : start + slab_length]
        span = slice(slab_numbers[0], slab_numbers[-1] + 1, stride)
        # In the order in which the slab has its axes.
        box = {turning.axis: span, **dict.fromkeys(turning.plane, slice(None))}
        slab = read_box(volume, box)
        for number, plane in zip(slab_numbers, slab, strict=True):
            yield number, np.ascontiguousarray(plane)


def take_sums(slices: Iterator[NumberedSlice], turning: Turning, levels: Levels) -> Sums:
    """Add up all slices, whose numbers are those along the axis of rotation.

    Each slice is sorted by material and depth below the face, and added to the parts of circles
    (for rings) and to the histogram by radius, depth and grey (for cupping) of its block.
    """
    length, rows, cols = turning.shape
    blocks = int(np.clip(length // _LEAST_BLOCK, 1, _BLOCKS))
    offsets_um = turning.offsets_um(np.arange(rows), np.arange(cols))
    radius = np.hypot(*offsets_um)
    # Parts of the turn begin at the axes of the array.
    turns = np.arctan2(*offsets_um) / (2 * np.pi) % 1.0
    sectors = np.minimum((turns * SECTORS).astype(np.int64), SECTORS - 1)
    radius_bins = (radius / turning.step_um).astype(np.int64)
    coarse_bins = turning.coarse_bins(radius)
    quarters = sectors * QUARTERS // SECTORS
    rings_shape = (blocks, SECTORS, len(MATERIALS), turning.bins)
    histogram_shape = (blocks, QUARTERS, COARSE, DEPTHS.size, GREYS.size - 1)
    sums = Sums(
        count=np.zeros(rings_shape, np.int64),
        total=np.zeros(rings_shape, np.int64),
        histogram=np.zeros(histogram_shape, np.int64),
        level=np.zeros((len(MATERIALS), 2), np.int64),
        blocks=(np.arange(blocks) + 0.5) * length / blocks - 0.5,
        slices=0,
    )
    n_slices = 0
    classify = partial(_classify, levels=levels)
    with thread_pool() as pool:
        while batch := list(islice(slices, 16)):  # slices that are worked on together
            for number, voxels in pool.map(classify, batch):
                k = min(int(number * blocks / length), blocks - 1)
                _add_to_rings(sums, k, voxels, radius_bins, sectors)
                # The voxels inside the sheet by quarter of the turn, radius, depth and grey.
                grey_place = (voxels.grey / UNIT - GREYS[0]) / GREY_STEP
                grey_bins = np.clip(grey_place.astype(np.int64), 0, GREYS.size - 2)
                depths = np.searchsorted(DEPTHS, voxels.depth, side="right") - 1
                bins = (quarters, coarse_bins, depths, grey_bins)
                histogram = sums.histogram[k]
                cells = np.ravel_multi_index(bins, histogram.shape)
                _count(histogram, cells[voxels.label > 1 + AIR])
            n_slices += len(batch)
    return replace(sums, slices=n_slices)


def _count(counts: Counts, cells: Ints) -> None:
    """Add 1 to an array at every number of a cell."""
    counts += np.bincount(cells, minlength=counts.size).reshape(counts.shape)


def _add_to_rings(
    sums: Sums, block: int, voxels: _Voxels, radius_bins: Counts, sectors: Counts
) -> None:
    """Add a slice to the parts of circles, its greys less the mean of their material and depth.

    ``radius_bins`` and ``sectors`` (rows, cols) are the numbers of a voxel's part of a circle. Near
    the axis a circle runs along the layers of a sheet. A layer is as bright as it is everywhere at
    its depth, and so leaves nothing; a ring does.
    """
    # Sums of whole numbers are exact in double precision.
    is_classified = voxels.label > 0
    greys = voxels.grey[is_classified]
    material = voxels.label[is_classified].astype(np.int64) - 1
    n_depths = _DEEPEST + 1
    layer = material * n_depths + voxels.depth[is_classified]
    n_layers = len(MATERIALS) * n_depths
    layer_counts = np.bincount(layer, minlength=n_layers)
    layer_sums = np.bincount(layer, greys, n_layers).astype(np.int64)
    sums.level[:, 0] += layer_counts.reshape(-1, n_depths).sum(axis=1)
    sums.level[:, 1] += layer_sums.reshape(-1, n_depths).sum(axis=1)
    has_enough = layer_counts[layer] >= 32  # voxels of a material at one depth, for its mean grey
    layer_mean = np.rint(layer_sums / np.maximum(layer_counts, 1))
    residuals = greys - layer_mean[layer]
    counts = sums.count[block]
    places = (sectors[is_classified], material, radius_bins[is_classified])
    cells = np.ravel_multi_index(places, counts.shape)[has_enough]
    _count(counts, cells)
    cell_sums = np.bincount(cells, residuals[has_enough], counts.size)
    sums.total[block] += cell_sums.astype(np.int64).reshape(counts.shape)


def _classify(numbered_slice: NumberedSlice, levels: Levels) -> tuple[int, _Voxels]:
    """Number of a slice, and grey, material and depth of its voxels.

    The material comes from the smoothed slice, with wide limits: a ring of some per cent does not
    choose its voxels. Air whose noise the export has cut off is left out.
    """
    number, plane = numbered_slice
    smoothed_plane = smoothed(plane)
    is_missing = missing(plane, levels.padding)
    is_solid = (smoothed_plane > levels.split) & ~is_missing
    # By so much it may be off.
    is_near_air = np.abs(smoothed_plane - levels.air) < 0.15 * levels.contrast
    is_air = is_near_air & ~is_missing
    depth = np.zeros(plane.shape, np.int64)
    label = np.zeros(plane.shape, np.uint8)
    solid_label = np.where(smoothed_plane > levels.middle, 1 + BRIGHT, 1 + BASE)
    for mask in (is_solid,) if levels.air_cut else (is_solid, is_air):
        distance = ndimage.distance_transform_cdt(mask, "chessboard")
        if mask.all():
            distance[:] = _DEEPEST
        is_inside = distance > 3  # from a face: so far reaches its blur
        depth[is_inside] = np.minimum(distance[is_inside], _DEEPEST)
        label[is_inside] = 1 + AIR if mask is is_air else solid_label[is_inside]
    filled = np.nan_to_num(plane.astype(np.float64), posinf=0.0, neginf=0.0)
    contrast_share = (filled - levels.air) / levels.contrast
    units = np.clip(contrast_share, GREYS[0], GREYS[-1]) * UNIT
    grey = np.rint(units).astype(np.int64)
    return number, _Voxels(grey, label, depth)
