"""Whole-number sums over slices across the axis of rotation, which depend on no order: greys, circles, histograms."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.errors import InputError, SizeError, VolumeError
from planish.core.frame import Axis, Frame
from planish.core.lazy import read_box
from planish.core.robust import MAD_TO_SD, mad_sd, otsu_borders
from planish.core.threads import thread_pool
from planish.core.typing import Bools, Floats

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


def smoothed(plane: NDArray[Any]) -> NDArray[np.float32]:
    """Smooth a slice; what is not finite counts as 0 and has to be masked."""
    # Then a single voxel shows its material in spite of the noise.
    return ndimage.gaussian_filter(np.nan_to_num(plane.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0), 1.5)


def missing(plane: NDArray[Any], padding: float) -> Bools:
    """Voxels of a slice that hold nothing, and those too near to them to be smoothed."""
    empty = ~np.isfinite(plane) if plane.dtype.kind == "f" else np.zeros(plane.shape, bool)
    if np.isfinite(padding):
        empty |= _without_specks(plane == padding)
    return ndimage.maximum_filter(empty, 9) if empty.any() else empty


def find_levels(slices: list[NDArray[Any]], radius: Floats) -> Levels | None:
    """Find the greys in some slices; None where no sheet stands out from the air."""
    lowest = min((float(np.nanmin(s)) for s in slices if np.isfinite(s).any()), default=float("nan"))
    padding = _padding(slices, lowest, radius)
    levels = _estimate_levels(np.concatenate([smoothed(s)[~missing(s, padding)] for s in slices]))
    if levels is None:
        return None
    dark = cut = 0
    for s in slices:
        below = (smoothed(s) < levels.split) & ~missing(s, padding)
        dark += np.count_nonzero(below)
        cut += np.count_nonzero(below & (s == lowest))
    # Where all of the air has the same value it has no noise: nothing was cut off.
    return levels._replace(padding=padding, air_cut=0.05 < cut / max(dark, 1) < 0.8)


def _padding(slices: list[NDArray[Any]], lowest: float, radius: Floats) -> float:
    """Value of the corners outside the scanner's circle: the lowest one, everywhere outside and nowhere inside."""
    spike = np.mean([_without_specks(s == lowest) for s in slices], axis=0)
    share = float(spike.mean())
    if share < 0.01:  # of all voxels: so much padding at least
        return float("nan")
    outside = radius > np.quantile(radius, 1.0 - share)
    return lowest if spike[outside].mean() > 0.9 and spike[~outside].mean() < 0.1 * share else float("nan")


def _without_specks(mask: Bools) -> Bools:
    """Mask without the single voxels that noise has cut off: nearly all of a neighbourhood has to be in it."""
    share = ndimage.uniform_filter(mask.astype(np.float32), _WINDOW)
    return mask & (ndimage.maximum_filter(share, _WINDOW) > 0.95)


def _estimate_levels(greys: NDArray[np.float32]) -> Levels | None:
    """Read the levels off the histogram of smoothed greys; None where no sheet stands out from the air."""
    if greys.size < 1000:
        return None
    low, high = (float(q) for q in np.percentile(greys, [0.02, 99.98]))
    if not high > low:
        return None
    count, edges = np.histogram(greys, 160, (low, high))
    number, total = (
        np.concatenate([[0.0], np.cumsum(n.astype(np.float64))]) for n in (count, count * np.arange(count.size))
    )
    split, middle = (float(edges[k]) for k in otsu_borders(number, total, 3))
    dark, sheet = greys[greys <= split], greys[greys > split]
    # The mean of what lies near the median.
    median = float(np.median(dark))
    reach = max(3 * MAD_TO_SD * float(np.median(np.abs(dark - median))), 1e-6)
    air = float(np.mean(dark[np.abs(dark - median) <= reach], dtype=np.float64))
    base, bright = sheet[sheet <= middle], sheet[sheet > middle]
    if not bright.size or not base.size:
        return None
    lower, level = float(np.median(base)), float(np.median(bright))
    # A second material stands out from the base by so much of its own contrast.
    if level - lower < 0.25 * (lower - air):
        middle, lower = np.inf, float(np.median(sheet))
        level = lower
    if level - air < max(6.0 * mad_sd(dark, air), 1e-9):  # scatters of the smoothed air
        return None
    # The lower border lies half way: a border between classes is drawn towards the wider one.
    return Levels(air=air, sheet=level, split=0.5 * (air + lower), middle=middle, padding=np.nan, air_cut=False)


SECTORS = 16  # parts of a full turn that are compared: a ring shows in all of them, a structure of the sheet does not

_LEAST_PLANE, _LEAST_LENGTH = 24, 8


class Turning(NamedTuple):
    """The axis of rotation.

    ``centre_um`` and ``pitch_um`` are its place and the voxel size along the two other axes, in array order; ``shape``
    are the voxels along the axis of rotation and along the two others.
    """

    axis: Axis
    centre_um: tuple[float, float]
    pitch_um: tuple[float, float]
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
        """Width of a bin of the radius: half a voxel, so that a ring of one voxel keeps its height."""
        return 0.5 * min(self.pitch_um)

    @property
    def bins(self) -> int:
        """Number of bins of the radius."""
        return int(np.ceil(self.farthest_um / self.step_um)) + 1

    @property
    def farthest_um(self) -> float:
        """Largest radius in the field."""
        along = zip(self.centre_um, self.shape[1:], self.pitch_um, strict=True)
        return math.hypot(*(max(abs(c), abs((n - 1) * p - c)) for c, n, p in along))

    def offsets_um(self, rows: NDArray[np.intp], cols: NDArray[np.intp]) -> tuple[Floats, Floats]:
        """Distances (rows, 1) and (1, cols) from the axis along the two others."""
        r = rows.astype(np.float64) * self.pitch_um[0] - self.centre_um[0]
        c = cols.astype(np.float64) * self.pitch_um[1] - self.centre_um[1]
        return r[:, None], c[None, :]


def make_turning(volume: xr.DataArray, axis: Axis, centre_um: tuple[float, float] | None) -> Turning:
    """Place the axis of rotation; in the middle of the field where ``centre_um`` is None."""
    if "voxel_um" not in volume.attrs:
        raise SizeError("The volume has no voxel size ('voxel_um'). Read it with read_volume, which asks for one.")
    size = dict(zip("zyx", map(float, volume.attrs["voxel_um"]), strict=True))
    frame = Frame(through=axis)
    a, b = frame.rows, frame.cols
    shape, pitch = (volume.sizes[axis], volume.sizes[a], volume.sizes[b]), (size[a], size[b])
    if shape[0] < _LEAST_LENGTH:
        raise VolumeError(
            f"The volume has {shape[0]} voxel(s) along {axis}, the axis of rotation; at least {_LEAST_LENGTH} are "
            "needed to separate a ring from the sheet. Give the whole stack, or another axis with --rotation-axis."
        )
    if min(shape[1:]) < _LEAST_PLANE:
        raise VolumeError(
            f"The volume has {shape[1]} x {shape[2]} voxels along {a} and {b}, across the axis of rotation; at least "
            f"{_LEAST_PLANE} are needed. Give the whole stack, or another --rotation-axis."
        )
    ends = ((shape[1] - 1) * pitch[0], (shape[2] - 1) * pitch[1])
    centre = (0.5 * ends[0], 0.5 * ends[1]) if centre_um is None else centre_um
    for name, position, end in zip((a, b), centre, ends, strict=True):
        # An axis further outside is taken for a mistake.
        if not -0.5 * end <= position <= 1.5 * end:
            raise InputError(
                f"The axis of rotation would stand at {name} = {position:g} um; the field runs from 0 to {end:g} um. "
                f"Give --rotation-centre-um as {a},{b} in um from the first voxel."
            )
    return Turning(axis=axis, centre_um=centre, pitch_um=pitch, shape=shape)


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
_MOST = 2**29  # voxels that are looked at
_DEEPEST = 24  # voxels; deeper, a material does not change with the depth


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
        box = {turning.axis: slice(part[0], part[-1] + 1, stride), **dict.fromkeys(turning.plane, slice(None))}
        slab = read_box(volume, box)
        for k, number in enumerate(part):
            yield number, np.ascontiguousarray(slab[k])


def take_sums(slices: Iterator[tuple[int, Slice]], turning: Turning, levels: Levels, *, threads: int) -> Sums:
    """Add up all slices."""
    length = turning.shape[0]
    blocks = int(np.clip(length // _LEAST_BLOCK, 1, _BLOCKS))
    offsets = turning.offsets_um(*(np.arange(n) for n in turning.shape[1:]))
    radius = np.hypot(*offsets)
    # Parts of the turn begin at the axes of the array.
    sectors = np.minimum((np.arctan2(*offsets) / (2 * np.pi) % 1.0 * SECTORS).astype(np.int64), SECTORS - 1)
    bins = (radius / turning.step_um).astype(np.int64)
    coarse = np.minimum((radius / turning.farthest_um * COARSE).astype(np.int64), COARSE - 1)
    count = np.zeros((blocks, SECTORS, len(MATERIALS), turning.bins), np.int64)
    total = np.zeros_like(count)
    histogram = np.zeros((blocks, QUARTERS, COARSE, DEPTHS.size, GREYS.size - 1), np.int64)
    quarters = sectors * QUARTERS // SECTORS
    level = np.zeros((len(MATERIALS), 2), np.int64)
    done = 0
    with thread_pool(threads) as pool:
        while group := list(islice(slices, 16)):  # slices that are worked on together
            for number, grey, kind, depth in pool.map(partial(_classify, levels=levels), group):
                k = min(int(number * blocks / length), blocks - 1)
                _add_to_rings(grey, kind, depth, bins, sectors, count[k], total[k], level)
                _add_to_histogram(grey, kind, depth, quarters, coarse, histogram[k])
                done += 1
    middles = (np.arange(blocks) + 0.5) * length / blocks - 0.5
    return Sums(count=count, total=total, histogram=histogram, blocks=middles, level=level, slices=done)


def _add_to_histogram(
    grey: Counts, kind: NDArray[np.uint8], depth: Counts, quarters: Counts, coarse: Counts, histogram: Counts
) -> None:
    """Count the voxels of a slice inside the sheet by quarter of the turn, radius, depth and grey."""
    fine = np.clip(((grey / UNIT - GREYS[0]) / (GREYS[1] - GREYS[0])).astype(np.int64), 0, GREYS.size - 2)
    deep = np.searchsorted(DEPTHS, depth, side="right") - 1
    cells = np.ravel_multi_index((quarters, coarse, deep, fine), histogram.shape)[kind > 1 + AIR]
    histogram += np.bincount(cells, minlength=histogram.size).reshape(histogram.shape)


def _add_to_rings(
    grey: Counts,
    kind: NDArray[np.uint8],
    depth: Counts,
    bins: Counts,
    sectors: Counts,
    count: Counts,
    total: Counts,
    level: Counts,
) -> None:
    """Add the voxels of a slice to their circles, less the mean of their material at their depth in this slice."""
    # Near the axis a circle runs along the layers of a sheet. A layer is as bright as it is everywhere at its depth,
    # and so leaves nothing; a ring does. Sums of whole numbers are exact in double precision.
    is_classified = kind > 0
    greys, material = grey[is_classified], kind[is_classified].astype(np.int64) - 1
    deepest = _DEEPEST + 1
    layer, layers = material * deepest + depth[is_classified], len(MATERIALS) * deepest
    n, sums = np.bincount(layer, minlength=layers), np.bincount(layer, greys, layers)
    level[:, 0] += n.reshape(-1, deepest).sum(axis=1)
    level[:, 1] += sums.reshape(-1, deepest).sum(axis=1).astype(np.int64)
    enough = n[layer] >= 32  # voxels of a material at one depth, for its mean grey
    mean = np.rint(sums / np.maximum(n, 1)).astype(np.int64)
    cells = np.ravel_multi_index((sectors[is_classified], material, bins[is_classified]), count.shape)[enough]
    count += np.bincount(cells, minlength=count.size).reshape(count.shape)
    more = np.bincount(cells, (greys - mean[layer])[enough], count.size)
    total += more.astype(np.int64).reshape(count.shape)


def _classify(numbered: tuple[int, Slice], levels: Levels) -> tuple[int, Counts, NDArray[np.uint8], Counts]:
    """Number, grey above air in whole numbers, material of each voxel well inside one, and its depth below the face."""
    # The material comes from the smoothed slice, with wide limits: a ring of some per cent does not choose its voxels.
    number, plane = numbered
    smooth, empty = smoothed(plane), missing(plane, levels.padding)
    solid = (smooth > levels.split) & ~empty
    air = (np.abs(smooth - levels.air) < 0.15 * levels.contrast) & ~empty  # by so much it may be off
    depth = np.zeros(plane.shape, np.int64)
    kind = np.zeros(plane.shape, np.uint8)
    for mask in (solid,) if levels.air_cut else (solid, air):
        deep = np.asarray(ndimage.distance_transform_cdt(mask, "chessboard"), np.int64)
        if mask.all():
            deep[:] = _DEEPEST
        inside = deep > 3  # from a face: so far reaches its blur
        depth[inside] = np.minimum(deep[inside], _DEEPEST)
        kind[inside] = 1 + AIR if mask is air else np.where(smooth[inside] > levels.middle, 1 + BRIGHT, 1 + BASE)
    share = (np.nan_to_num(plane.astype(np.float64), posinf=0.0, neginf=0.0) - levels.air) / levels.contrast
    grey = np.rint(np.clip(share, GREYS[0], GREYS[-1]) * UNIT).astype(np.int64)
    return number, grey, kind, depth
