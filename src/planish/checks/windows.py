"""How slices differ from their neighbours, gathered along all three axes in one pass over parts of a volume.

Each axis is looked at through a window: all slices along it, some 300 x 300 voxels of each.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.checks import _kernels
from planish.core.frame import Axis
from planish.core.threads import map_threads

Array = NDArray[np.float64]

BLOCK = 5  # voxels along the edge of a block mean
_COLUMNS = 90_000  # voxels of a slice that are looked at
_EDGE = 300  # voxels along the edge of a window, more where it is narrow the other way
_PIECE = 24e6  # bytes of a piece of a window


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
    return Window(axis=axis, first=first, square=sums[0] / voxels, product=sums[1] / voxels, blocks=_block_means(part))


def gather(
    volume: xr.DataArray, *, through: Axis, sheet: tuple[int, int], missing: float = 0.0, threads: int | None = None
) -> tuple[Window, ...]:
    """Look at a volume along its three axes.

    Parameters
    ----------
    volume : DataArray, dims (z, y, x)
        May be lazy: parts are read along z, whole chunks of the file where it has some.
    through : {"z", "y", "x"}
        Axis through the sheet.
    sheet : (int, int)
        First and last slice along it that hold the sheet.
    missing : float
        Takes the place of NaN.
    threads : int, optional
        The sums do not depend on it.
    """
    axes: tuple[Axis, ...] = ("z", "y", "x")
    places: dict[Axis, dict[str, slice]] = {axis: _place(volume, axis, through, sheet) for axis in axes}
    reach = slice(min(p["z"].start for p in places.values()), max(p["z"].stop for p in places.values()))
    pieces = _pieces(volume, places, reach)

    def read(piece: slice) -> list[tuple[Array, Array, NDArray[np.float32]] | None]:
        return [_piece_sums(volume, axis, places[axis], piece, missing) for axis in axes]

    found = map_threads(read, pieces, number=threads)
    return tuple(_joined(axis, places[axis], [f[i] for f in found]) for i, axis in enumerate(axes))


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


def _piece_sums(
    volume: xr.DataArray, axis: Axis, place: dict[str, slice], piece: slice, missing: float
) -> tuple[Array, Array, NDArray[np.float32]] | None:
    """Sums of the part of a window that lies in a piece."""
    z = place["z"]
    inside = slice(max(piece.start, z.start), min(piece.stop, z.stop))
    if inside.stop <= inside.start:
        return None
    # Pairs across the border between two pieces belong to the second one.
    before = min(2, inside.start - z.start) if axis == "z" else 0
    part = volume.isel(place | {"z": slice(inside.start - before, inside.stop)})
    order = [part.get_axis_num(k) for k in (axis, *(k for k in "zyx" if k != axis))]
    values = np.ascontiguousarray(part.values.transpose(order), dtype=np.float32)
    if not np.isfinite(values.sum()):
        values = np.nan_to_num(values, nan=missing, posinf=missing, neginf=missing)
    square, product = _sums(values)
    return (square[max(before - 1, 0) :] if before else square), product, _block_means(values[before:])


def _sums(part: NDArray[np.float32]) -> tuple[Array, Array]:
    n = len(part)
    square, product = np.zeros(max(n - 1, 0)), np.zeros(max(n - 2, 0))
    if n > 1:
        _kernels.add_pairs(part, square, product if n > 2 else np.zeros(1))
    return square, product


def _block_means(part: NDArray[np.float32]) -> NDArray[np.float32]:
    """Means of blocks of each slice, (slices, blocks); what is left over at the far ends is left out."""
    n, rows, cols = part.shape
    edges = min(BLOCK, rows), min(BLOCK, cols)
    counts = rows // edges[0], cols // edges[1]
    whole = part[:, : counts[0] * edges[0], : counts[1] * edges[1]]
    return whole.reshape(n, counts[0], edges[0], counts[1], edges[1]).mean(axis=(2, 4)).reshape(n, -1)


def _joined(
    axis: Axis, place: dict[str, slice], parts: list[tuple[Array, Array, NDArray[np.float32]] | None]
) -> Window:
    known = [p for p in parts if p is not None]
    voxels = np.prod([s.stop - s.start for k, s in place.items() if k != axis])
    if axis == "z":
        square, product = (np.concatenate([p[i] for p in known]) for i in range(2))
    else:
        square, product = (np.sum([p[i] for p in known], axis=0) for i in range(2))
    blocks = np.concatenate([p[2] for p in known], axis=0 if axis == "z" else 1)
    return Window(
        axis=axis, first=place[axis].start, square=square / voxels, product=product / voxels, blocks=blocks
    )  # fmt: skip
