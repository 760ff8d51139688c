"""How slices differ from their neighbours, gathered along all three axes in one pass over parts of a volume.

Each axis is looked at through a window: all slices along it, some 300 x 300 voxels of each.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.checks import _kernels
from planish.core.frame import Axis
from planish.core.threads import map_threads

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Places = NDArray[np.signedinteger[Any]]
Sums = tuple[Array, Array, NDArray[np.float32]]

BLOCK = 5  # voxels along the edge of a block mean
_COLUMNS = 90_000  # voxels of a slice that are looked at
_EDGE = 300  # voxels along the edge of a window, more where it is narrow the other way
_EVERY = 3  # voxels: of every third one along each axis, the grey is kept for a histogram
_PIECE = 8e6  # bytes of a piece of a window


@dataclass(frozen=True, slots=True, kw_only=True)
class Window:
    """Slices ``first`` and on along an axis, and what was summed over the same part of each of them.

    Attributes
    ----------
    axis : {"z", "y", "x"}
    first : int
        Number of the first slice in the volume, from 0.
    square, product : (slices - 1,), (slices - 2,)
        Means over voxels of u_k² and of u_k u_k+1, where u_k is the difference of slices k + 1 and k.
    blocks : (slices, blocks)
        Means of 5 x 5 voxels.
    """

    axis: Axis
    first: int
    square: Array
    product: Array
    blocks: NDArray[np.float32]


def window_of(values: NDArray[Any], axis: Axis = "z", first: int = 0) -> Window:
    """Sum up slices that are in memory, (slices, rows, cols)."""
    part = np.ascontiguousarray(values, dtype=np.float32)
    sums = _sums(part)
    voxels = part.shape[1] * part.shape[2]
    return Window(axis=axis, first=first, square=sums[0] / voxels, product=sums[1] / voxels, blocks=sums[2])


class Gathered(NamedTuple):
    """What one pass over the windows gave."""

    windows: tuple[Window, ...]
    sample: NDArray[Any]  # greys as stored, of a part of the voxels around the sheet
    grey: NDArray[np.float32]  # (points,): at the places asked for, NaN for those outside of all windows


def gather(
    volume: xr.DataArray, *, through: Axis, sheet: tuple[int, int], points: Places | None = None, missing: float = 0.0,
    threads: int | None = None,
) -> Gathered:  # fmt: skip
    """Look at a volume along its three axes.

    Parameters
    ----------
    volume : DataArray, dims (z, y, x)
        May be lazy: parts are read along z, whole chunks of the file where it has some.
    through : {"z", "y", "x"}
        Axis through the sheet.
    sheet : (int, int)
        First and last slice along it that hold the sheet.
    points : (n, 3) of int, optional
        Voxels (z, y, x) whose grey is asked for.
    missing : float
        Takes the place of NaN.
    threads : int, optional
        The sums do not depend on it.
    """
    axes: tuple[Axis, ...] = ("z", "y", "x")
    places: dict[Axis, dict[str, slice]] = {axis: _place(volume, axis, through, sheet) for axis in axes}
    points = np.empty((0, 3), np.int32) if points is None else points
    taken = _taken(points, places)
    reach = slice(min(p["z"].start for p in places.values()), max(p["z"].stop for p in places.values()))

    def read(piece: slice) -> list[_Part | None]:
        found: list[_Part | None] = []
        for axis in axes:
            place = places[axis]
            inside = slice(max(piece.start, place["z"].start), min(piece.stop, place["z"].stop))
            if inside.stop <= inside.start:
                found.append(None)
                continue
            chosen = (taken == axes.index(axis)) & (points[:, 0] >= inside.start) & (points[:, 0] < inside.stop)
            # Pairs across the border between two pieces belong to the second one.
            before = min(2, inside.start - place["z"].start) if axis == "z" else 0
            whole = place | {"z": slice(inside.start - before, inside.stop)}
            parts: list[_Part] = []
            tail: NDArray[Any] | None = None
            for cut in [whole[axis]] if axis == "z" else _cuts(volume, whole, axis):
                raw = np.asarray(volume.isel(whole | {axis: cut}).values)
                k = axes.index(axis)
                which = np.flatnonzero(chosen & (points[:, k] >= cut.start) & (points[:, k] < cut.stop))
                first = [(cut if name == axis else whole[name]).start for name in axes]
                z, y, x = (points[which] - first).T
                grey = raw[z, y, x].astype(np.float32)
                sample = raw[::_EVERY, ::_EVERY, ::_EVERY].ravel() if axis != through else raw[:0].ravel()
                if tail is not None:
                    before = tail.shape[k]
                    raw = np.concatenate([tail, raw], axis=k)
                parts.append(_Part(_part_sums(raw, axis, before, missing), sample, which, grey))
                tail = raw.take(range(max(raw.shape[k] - 2, 0), raw.shape[k]), axis=k)
            found.append(_Part.joined(parts))
        return found

    pieces = map_threads(read, _pieces(volume, places, reach), number=threads)
    grey = np.full(len(points), np.nan, np.float32)
    samples: list[NDArray[Any]] = []
    sums: list[list[Sums]] = [[] for _ in axes]
    while pieces:  # a piece goes as soon as it is used
        for known, one in zip(sums, pieces.pop(0), strict=True):
            if one is not None:
                known.append(one.sums)
                samples.append(one.sample)
                grey[one.which] = one.grey
    sample = np.concatenate(samples)
    samples.clear()
    windows = tuple(_joined(axis, places[axis], known) for axis, known in zip(axes, sums, strict=True))
    return Gathered(windows=windows, sample=sample, grey=grey)


class _Part(NamedTuple):
    """What is kept of a part of a window: sums, some greys, and the greys of the points ``which``."""

    sums: Sums
    sample: NDArray[Any]
    which: Index
    grey: NDArray[np.float32]

    @classmethod
    def joined(cls, parts: list[_Part]) -> _Part:
        """Parts that follow each other along the axis of their window."""
        if len(parts) == 1:
            return parts[0]
        square, product, blocks = zip(*(part.sums for part in parts), strict=True)
        return cls(
            sums=(np.concatenate(square), np.concatenate(product), np.concatenate(blocks)),
            sample=np.concatenate([part.sample for part in parts]),
            which=np.concatenate([part.which for part in parts]),
            grey=np.concatenate([part.grey for part in parts]),
        )


def _cuts(volume: xr.DataArray, place: dict[str, slice], axis: Axis) -> list[slice]:
    """Cut a piece along its axis, too, where the chunks of the file make it long along z."""
    chunks = volume.encoding.get("chunks")
    unit = int(chunks["zyx".index(axis)]) if chunks else 1
    slice_voxels = int(np.prod([s.stop - s.start for k, s in place.items() if k != axis]))
    size = max(int(_PIECE / (4 * slice_voxels)) // unit, 1) * unit
    start, stop = place[axis].start, place[axis].stop
    return [slice(k, min(k + size, stop)) for k in range(start, stop, size)]


def _taken(points: Places, places: dict[Axis, dict[str, slice]]) -> NDArray[np.int8]:
    """Number of the axis in whose window each point is read; -1 for none."""
    taken = np.full(len(points), -1, np.int8)
    for i, place in enumerate(places.values()):
        inside = np.ones(len(points), bool)
        for k, name in enumerate("zyx"):
            inside &= (points[:, k] >= place[name].start) & (points[:, k] < place[name].stop)
        taken[inside] = i
    return taken


def _place(volume: xr.DataArray, axis: Axis, through: Axis, sheet: tuple[int, int]) -> dict[str, slice]:
    """Part of the volume that an axis is looked at in: all slices along it that hold the sheet."""
    size = {k: int(n) for k, n in volume.sizes.items()}
    around = slice(max(sheet[0] - 4, 0), min(sheet[1] + 5, size[through]))
    across = [k for k in ("z", "y", "x") if k not in (axis, through)]
    edge = _EDGE if axis == through else int(np.clip(_COLUMNS // (around.stop - around.start), 60, 2 * _EDGE))
    place = {k: _middle(size[k], edge) for k in across}
    return place | {through: around} | ({} if axis == through else {axis: slice(0, size[axis])})


def _middle(n: int, edge: int) -> slice:
    edge = min(edge, n) // BLOCK * BLOCK or n
    return slice((n - edge) // 2, (n - edge) // 2 + edge)


def _pieces(volume: xr.DataArray, places: dict[Axis, dict[str, slice]], reach: slice) -> list[slice]:
    """Cut along z: blocks are whole, chunks of the file are read once where memory allows."""
    largest = max(np.prod([s.stop - s.start for k, s in p.items() if k != "z"]) for p in places.values())
    chunks = volume.encoding.get("chunks")
    unit = int(np.lcm(BLOCK, chunks[0])) if chunks else BLOCK
    size = max(int(_PIECE / (4 * largest)) // unit, 1) * unit
    size = size if size <= 40 * BLOCK else 8 * BLOCK
    return [slice(k, min(k + size, reach.stop)) for k in range(reach.start, reach.stop, size)]


def _part_sums(raw: NDArray[Any], axis: Axis, before: int, missing: float) -> Sums:
    """Sums of a part (z, y, x) of a window."""
    values = np.ascontiguousarray(np.moveaxis(raw, "zyx".index(axis), 0), dtype=np.float32)
    sums = _sums(values, before)
    if np.isfinite(sums[0]).all() and np.isfinite(sums[2]).all():
        return sums
    return _sums(np.nan_to_num(values, nan=missing, posinf=missing, neginf=missing), before)


def _sums(part: NDArray[np.float32], before: int = 0) -> Sums:
    """Sums over pairs of slices, and block means; the first slices belong to the part before."""
    n, rows, cols = part.shape
    edge = min(BLOCK, rows, cols)
    square, product = np.zeros(max(n - 1, 0)), np.zeros(max(n - 2, 0))
    sums = np.zeros((n - before, rows // edge, cols // edge))
    _kernels.add_slices(part, edge, before, square, product, sums)
    return square[max(before - 1, 0) :], product, (sums / edge**2).reshape(n - before, -1).astype(np.float32)


def _joined(axis: Axis, place: dict[str, slice], known: list[Sums]) -> Window:
    """Join the parts of a window, which are taken out of ``known``."""
    voxels = np.prod([s.stop - s.start for k, s in place.items() if k != axis])
    if axis == "z":
        square, product = (np.concatenate([p[i] for p in known]) for i in range(2))
    else:
        square, product = (np.sum([p[i] for p in known], axis=0) for i in range(2))
    along = 0 if axis == "z" else 1
    shape = list(known[0][2].shape)
    shape[along] = sum(p[2].shape[along] for p in known)
    blocks, at = np.empty(shape, dtype=np.float32), 0
    while known:
        part = known.pop(0)[2]  # a part goes as soon as it is copied
        blocks[(slice(None),) * along + (slice(at, at + part.shape[along]),)] = part
        at += part.shape[along]
    return Window(
        axis=axis, first=place[axis].start, square=square / voxels, product=product / voxels, blocks=blocks
    )  # fmt: skip
