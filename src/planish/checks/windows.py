"""Differences of slices from their neighbours along all axes.

Taken in windows of some 300 x 300 voxels, in one pass.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.checks import _kernels
from planish.core.frame import Axis
from planish.core.labelled import chunks_of
from planish.core.memory import WINDOW_BYTES
from planish.core.threads import map_threads
from planish.core.typing import Array, Floats, Ints

Index = Ints
Places = NDArray[np.signedinteger[Any]]
Box = dict[str, slice]
Sums = tuple[Floats, Floats, NDArray[np.float32]]
BLOCK = 5  # voxels along the edge of a block mean
_EDGE = 300  # voxels along the edge of a window, more where it is narrow the other way


@dataclass(frozen=True, slots=True, kw_only=True)
class Window:
    """Slices along an axis, and what was summed over the same part of each.

    U_k is slice k + 1 less slice k.
    """

    axis: Axis
    first: int  # number of the first slice in the volume, from 0
    square: Floats  # (slices - 1,): means over voxels of u_k²
    product: Floats  # (slices - 2,): and of u_k u_k+1
    blocks: NDArray[np.float32]  # (slices, rows, cols): means of 5 x 5 voxels


class WindowReading(NamedTuple):
    """Sums and greys that one pass over the windows gave."""

    windows: tuple[Window, ...]
    sample: Array  # greys as stored, of a part of the voxels around the sheet
    # (points,): at the places asked for, NaN for those outside of all windows.
    grey: NDArray[np.float32]


def read_windows(
    volume: xr.DataArray,
    *,
    through: Axis,
    sheet_slices: tuple[int, int],
    points: Places | None = None,
    fill_grey: float = 0.0,
    threads: int | None = None,
) -> WindowReading:
    """Read a window along each of a volume's three axes (z, y, x).

    A lazy volume is read in parts along z, whole chunks of the file where it has some; the sums do
    not depend on ``threads``. ``sheet_slices``: first and last along ``through`` that hold the
    sheet. ``points``: (n, 3) of int, voxels (z, y, x) whose grey is asked for. ``fill_grey`` takes
    the place of NaN.
    """
    axes: tuple[Axis, ...] = ("z", "y", "x")
    boxes: dict[Axis, Box] = {axis: _place(volume, axis, through, sheet_slices) for axis in axes}
    if points is None:
        points = np.empty((0, 3), np.int32)
    in_order = list(boxes.values())
    wanted = _by_window(points, boxes)

    def read(piece: slice, axis: Axis) -> _Part | None:
        indices, z = wanted[axis]
        first, stop = np.searchsorted(z, [piece.start, piece.stop])
        in_piece = indices[first:stop]
        is_sampled = axis != through
        return _read_part(
            volume, axis, boxes[axis], piece, points, in_piece, fill_grey, is_sampled=is_sampled
        )

    jobs = [*product(_pieces(volume, in_order), axes)]
    parts = map_threads(read, *zip(*jobs, strict=True), number=threads)
    grey = np.full(len(points), np.nan, np.float32)
    samples: list[Array] = []
    sums: dict[Axis, list[Sums]] = {axis: [] for axis in axes}
    for _, axis in jobs:
        part = parts.pop(0)  # it goes as soon as it is used
        if part is not None:
            sums[axis].append(part.sums)
            samples.append(part.sample)
            grey[part.indices] = part.grey
    sample = np.concatenate(samples)
    samples.clear()
    windows = tuple(_joined(axis, boxes[axis], sums[axis]) for axis in axes)
    return WindowReading(windows=windows, sample=sample, grey=grey)


def _by_window(points: Places, boxes: dict[Axis, Box]) -> dict[Axis, tuple[Index, Places]]:
    """Indices of the points (n, 3) in the window along each axis, ordered by z, and their z.

    Those in several belong to the last one.
    """
    columns = np.ascontiguousarray(points.T)
    window_number = np.full(len(points), -1, np.int8)  # of each point; -1 outside of all
    for i, box in enumerate(boxes.values()):
        is_inside = np.ones(len(points), bool)
        parts = (box["z"], box["y"], box["x"])
        for places, part in zip(columns, parts, strict=True):
            is_inside &= (places >= part.start) & (places < part.stop)
        window_number[is_inside] = i
    by_axis: dict[Axis, tuple[Index, Places]] = {}
    for i, axis in enumerate(boxes):
        indices = np.flatnonzero(window_number == i)
        z = columns[0, indices]
        by_z = np.argsort(z, kind="stable")
        by_axis[axis] = indices[by_z], z[by_z]
    return by_axis


class _Part(NamedTuple):
    """Part of a window: its sums, some of its greys, and the greys of the points ``indices``."""

    sums: Sums
    sample: Array
    indices: Index
    grey: NDArray[np.float32]


def _read_part(
    volume: xr.DataArray,
    axis: Axis,
    window_box: Box,
    piece: slice,
    points: Places,
    wanted: Index,
    fill_grey: float,
    *,
    is_sampled: bool,
) -> _Part | None:
    """Read the slices ``piece`` along z of a window at ``window_box``, with the points ``wanted``.

    None if outside. Across another axis a piece that is long along z is read in cuts along that
    axis. Two slices before a part are read, or kept, with it: sums are over pairs and triples, and
    those across a border belong to the part behind it.
    """
    window_z = window_box["z"]
    start = max(piece.start, window_z.start)
    stop = min(piece.stop, window_z.stop)
    if stop <= start:
        return None
    places = points[wanted]
    n_before = 0  # slices of the part before
    if axis == "z":
        n_before = min(2, start - window_z.start)
    piece_box = window_box | {"z": slice(start - n_before, stop)}
    k = "zyx".index(axis)
    edge = _block_edge(window_box, axis)
    parts: list[_Part] = []
    last_slices: Array | None = None
    for cut in _cuts(volume, piece_box, axis):
        cut_box = piece_box | {axis: cut}
        greys = np.asarray(volume.isel(cut_box).values)
        along_axis = places[:, k]
        is_here = (along_axis >= cut.start) & (along_axis < cut.stop)
        indices = wanted[is_here]
        first_voxel = [cut_box[name].start for name in "zyx"]
        starts = np.array(first_voxel, places.dtype)
        z, y, x = (places[is_here] - starts).T
        grey = greys[z, y, x].astype(np.float32)
        sampled = greys[::3, ::3, ::3] if is_sampled else greys[:0]  # for a histogram
        sample = sampled.ravel()
        if last_slices is not None:
            n_before = last_slices.shape[k]
            greys = np.concatenate([last_slices, greys], axis=k)
        cut_sums = _part_sums(greys, axis, n_before, fill_grey, edge)
        parts.append(_Part(cut_sums, sample, indices, grey))
        n = greys.shape[k]
        last_slices = greys.take(range(max(n - 2, 0), n), axis=k)
    if len(parts) == 1:
        return parts[0]
    sums, *greys_of_parts = zip(*parts, strict=True)
    square, product, blocks = map(np.concatenate, zip(*sums, strict=True))
    return _Part((square, product, blocks), *map(np.concatenate, greys_of_parts))


def _cuts(volume: xr.DataArray, piece_box: Box, axis: Axis) -> list[slice]:
    """Cut a piece along its axis, too, where the chunks of the file make it long along z."""
    if axis == "z":
        return [piece_box[axis]]
    chunk = chunks_of(volume)["zyx".index(axis)]
    slice_bytes = 4 * _voxels_of_slice(piece_box, axis)
    size = max(int(WINDOW_BYTES / slice_bytes) // chunk, 1) * chunk
    return _cut(piece_box[axis].start, piece_box[axis].stop, size)


def _cut(start: int, stop: int, size: int) -> list[slice]:
    """Slices of a size from start to stop; the last one may be smaller."""
    return [slice(k, min(k + size, stop)) for k in range(start, stop, size)]


def _place(volume: xr.DataArray, axis: Axis, through: Axis, sheet_slices: tuple[int, int]) -> Box:
    """Place of the window along an axis, as slices of z, y and x.

    It holds all slices along that axis, the sheet with four slices beside it along ``through``,
    and the middle of the volume along what is left.
    """
    first, last = sheet_slices
    low = max(first - 4, 0)
    high = min(last + 5, volume.sizes[through])
    # Some 90 000 voxels of a slice are looked at.
    widest = _EDGE
    if axis != through:
        widest = int(np.clip(90_000 // (high - low), 60, 2 * _EDGE))
    window_box: Box = {}
    for k, n in zip("zyx", volume.shape, strict=True):
        edge = min(widest, n) // BLOCK * BLOCK or n  # whole blocks, or all that there is
        start = (n - edge) // 2
        window_box[k] = slice(start, start + edge)
    window_box[axis] = slice(0, volume.sizes[axis])
    window_box[through] = slice(low, high)
    return window_box


def _pieces(volume: xr.DataArray, boxes: Sequence[Box]) -> list[slice]:
    """Cut along z: blocks are whole, chunks of the file are read once where memory allows.

    The cuts are shared by all windows.
    """
    largest = max(_voxels_of_slice(box, "z") for box in boxes)
    z_chunk, *other_chunks = chunks_of(volume)
    unit = math.lcm(BLOCK, z_chunk)
    size = max(int(WINDOW_BYTES / (4 * largest)) // unit, 1) * unit
    least_bytes = 4 * unit * max(other_chunks) * 2 * _EDGE  # once it is cut along another axis, too
    if size > 40 * BLOCK and least_bytes >= 12 * WINDOW_BYTES:
        size = 8 * BLOCK
    start = min(box["z"].start for box in boxes)
    stop = max(box["z"].stop for box in boxes)
    return _cut(start, stop, size)


def _voxels_of_slice(box: Box, axis: Axis) -> int:
    """Voxels of one slice of a window across an axis."""
    return math.prod(part.stop - part.start for k, part in box.items() if k != axis)


def _block_edge(window_box: Box, axis: Axis) -> int:
    """Voxels along the edge of a block: fewer where the whole window is narrower."""
    return min(BLOCK, *(part.stop - part.start for k, part in window_box.items() if k != axis))


def _part_sums(greys: Array, axis: Axis, n_before: int, fill_grey: float, edge: int) -> Sums:
    """Sums over greys (z, y, x) along an axis; what is not finite counts as ``fill_grey``."""
    along_first = np.moveaxis(greys, "zyx".index(axis), 0)
    slices = np.ascontiguousarray(along_first, dtype=np.float32)
    sums = _sums(slices, n_before, edge)
    square, _, blocks = sums
    if np.isfinite(square).all() and np.isfinite(blocks).all():
        return sums
    filled = np.nan_to_num(slices, nan=fill_grey, posinf=fill_grey, neginf=fill_grey)
    return _sums(filled, n_before, edge)


def _sums(part: NDArray[np.float32], n_before: int, edge: int) -> Sums:
    """Sums over pairs of slices, and means of whole blocks.

    The first ``n_before`` slices belong to the part before.
    """
    n, rows, cols = part.shape
    square = np.zeros(max(n - 1, 0))
    product = np.zeros(max(n - 2, 0))
    sums = np.zeros((n - n_before, rows // edge, cols // edge))
    _kernels.add_slices(part, edge, n_before, square, product, sums)
    blocks = (sums / edge**2).astype(np.float32)
    return square[max(n_before - 1, 0) :], product, blocks


def _joined(axis: Axis, window_box: Box, sums: list[Sums]) -> Window:
    """Join the sums of the parts of a window, which are taken out of ``sums`` to free the memory.

    Sums become means over the voxels of a slice.
    """
    voxels = _voxels_of_slice(window_box, axis)
    squares, products, parts = map(list, zip(*sums, strict=True))
    sums.clear()
    # Parts follow each other along z: slices of a window along z, and else rows of its slices.
    if axis == "z":
        square = np.concatenate(squares)
        product = np.concatenate(products)
        z_index = 0
    else:
        square = np.sum(squares, axis=0)
        product = np.sum(products, axis=0)
        z_index = 1
    shape = list(parts[0].shape)
    shape[z_index] = sum(part.shape[z_index] for part in parts)
    blocks = np.empty(shape, dtype=np.float32)
    along_z = np.moveaxis(blocks, z_index, 0)
    n_copied = 0
    while parts:
        part = np.moveaxis(parts.pop(0), z_index, 0)  # it goes as soon as it is copied
        along_z[n_copied : n_copied + len(part)] = part
        n_copied += len(part)
    return Window(
        axis=axis,
        first=window_box[axis].start,
        square=square / voxels,
        product=product / voxels,
        blocks=blocks,
    )
