"""Images on another grid: warped by any transformation, of any size, piece by piece.

The transformation may be any function of points. Where pixels become smaller the values are interpolated, where they
become larger they are averaged, and labels are taken as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import CannotRegister, InputError, ResourceError, SizeError
from planish.core.grid import Grid
from planish.core.threads import count_threads, map_threads
from planish.core.tiles import Tile, tiles_of
from planish.resample._warp_kernels import average, interpolate, take
from planish.resample.patches import Patches, find_patches

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Pair = tuple[float, float]
WarpMethod = Literal["auto", "bilinear", "area", "nearest"]

LARGER = 1.1
"""Length of a pixel's longer side in source pixels from which on "auto" averages. A calibration that is a few percent
off does not change the method in the middle of an image."""

_TILE = (512, 4096)  # target pixels that are worked on together, always the same ones; whole blocks of the patches
_WINDOW = 16 * 2**20  # bytes of the source that are read at once
_SCRATCH = 8 * 2**20  # bytes a thread takes beside the tile and the window
_MOST_SIDE = 2**22  # of the source: places are counted in 2^-40 of a pixel
_MOST_UNDER = 2**26  # source pixels under one pixel
_LOOKS = 17  # points per side of the target at which the transformation is looked at first
_SINGULAR = 1e-6  # of the square of the longest side of a cell of these: an area below that is none


class Source(Protocol):
    """An image that may stay in its file: what is cut out of it becomes an array."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Rows and columns, and channels where there are some."""
        ...

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the values."""
        ...

    def __getitem__(self, key: Any, /) -> Any:
        """Cut out rows and columns."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Warped:
    """An image on another grid.

    Attributes
    ----------
    values : (rows, cols) or (rows, cols, channels), type of the source
        NaN, or the fill value for whole numbers, where not valid.
    valid : (rows, cols) bool
        Pixels that have a value.
    """

    values: NDArray[Any]
    valid: Flags


@dataclass(frozen=True, slots=True, kw_only=True)
class _Work:
    """What a tile needs to know."""

    source: Source
    pixel: Pair
    to_source: Callable[[Floats], Floats]
    grid: Grid
    method: WarpMethod
    valid: Source | None
    fill: int
    window_bytes: int

    def mapping(self, points: Floats) -> Floats:
        """Places in source pixels of points (..., 2) in target pixels."""
        rows, cols = self.grid.pixel_um
        at = points * (cols, rows) + self.grid.origin_um
        found = np.asarray(self.to_source(at), dtype=np.float64)
        if found.shape != at.shape:
            raise InputError(
                f"The transformation gave an array {found.shape} for points {at.shape}. It has to take points "
                "(..., 2) to points of the same shape."
            )
        return found / (self.pixel[1], self.pixel[0])

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns of the source."""
        return self.source.shape[0], self.source.shape[1]

    @property
    def carrier(self) -> np.dtype[Any]:
        """Type of the values in the kernels: real numbers, or whole ones of 64 bits, which those cannot hold."""
        dtype = self.source.dtype.newbyteorder("=")
        whole = self.method == "nearest" and dtype.kind in "iu" and dtype.itemsize == 8
        return dtype if whole else np.dtype(np.float64)


def warp_image(
    image: Source, grid: Grid, to_source: Callable[[Floats], Floats], *, pixel_um: float | Pair = 1.0,
    method: WarpMethod = "auto", valid: Source | None = None, fill: int = 0, memory_bytes: int = 2**31,
) -> Warped:  # fmt: skip
    """Warp an image by a transformation.

    Parameters
    ----------
    image : (rows, cols) or (rows, cols, channels)
        Truth values, whole or real numbers; what is not finite is missing. An array, a memory map, or anything that has
        a shape and a type and can be cut as an array can. The middle of its first pixel is (0, 0) um.
    grid : Grid
        Pixels of the target.
    to_source : callable
        Takes points (..., 2), (x, y) in um, of the target to the image: the ``inverse`` of a transformation that takes
        the image to the target. NaN where there is none. It is called for few points, from several threads.
    pixel_um : float or (float, float)
        Pitch of the image's rows and columns.
    method : {"auto", "bilinear", "area", "nearest"}
        Bilinear at the pixel's middle; the mean over the pixel's area; the value of the pixel in which the middle lies,
        for labels. ``auto`` averages where the longer side of a pixel is more than 1.1 source pixels long, and is
        bilinear elsewhere; it decides patch by patch. Truth values are taken as labels.
    valid : (rows, cols), optional
        Pixels of the image that count.
    fill : int
        What stands where a whole number is not valid.
    memory_bytes : int
        What may be taken beside the image.

    Returns
    -------
    Warped
        The same bytes whatever the memory and the number of threads.

    Raises
    ------
    CannotRegister
        The target does not meet the image, or the transformation makes a line of it.
    SizeError
        A pixel size or the grid is impossible.
    InputError
        Arrays of other shapes or types than are needed.
    ResourceError
        It does not fit into the memory.

    Notes
    -----
    Places in the image are right to 0.01 of its pixels, and exact for affine transformations. A pixel's area is the
    quadrilateral between the images of its four corners, and every source pixel counts with the part of it that lies
    inside: nothing is sampled, and of whole images the sums are kept. A pixel is valid where at least half of its area
    is known. Between the middles of source pixels, a bilinear value is known where all pixels that have weight are, as
    in :func:`planish.resample.resample`: it ends at the middles of the outermost pixels, half a pixel before the area
    does. In several channels what is missing in one is missing in all.

    Rounding leaves 1e-13 of the largest value nearby in a mean: say where values are that stand for missing ones.
    """
    pixel = (pixel_um, pixel_um) if isinstance(pixel_um, int | float) else pixel_um
    _check(image, pixel, grid, method, valid, fill)
    dtype = image.dtype.newbyteorder("=")
    full = (*grid.shape, *image.shape[2:])
    needed = grid.shape[0] * grid.shape[1] + int(np.prod(full)) * dtype.itemsize
    count, window = _budget(image, needed, memory_bytes)
    chosen: WarpMethod = "nearest" if method == "auto" and dtype.kind == "b" else method
    work = _Work(
        source=image, pixel=pixel, to_source=to_source, grid=grid, method=chosen, valid=valid, fill=fill,
        window_bytes=window,
    )  # fmt: skip
    at = _probe(work)
    warped = Warped(values=np.empty(full, dtype=dtype), valid=np.empty(grid.shape, dtype=np.bool_))
    tiles = tiles_of(grid.shape, _TILE)
    if not any(map_threads(partial(_warp_tile, work, warped), tiles, number=min(count, len(tiles)))):
        raise _apart(work, at)
    return warped


def _warp_tile(work: _Work, warped: Warped, tile: Tile) -> bool:
    """Do one tile; whether it meets the source, even if only where that is missing."""
    dtype = warped.values.dtype
    channels = int(np.prod(work.source.shape[2:]))
    values = np.full((channels, *tile.shape), np.nan if dtype.kind == "f" else work.fill, dtype=work.carrier)
    known = np.zeros(tile.shape, dtype=np.uint8)
    missing = False
    patches = find_patches(work.mapping, tile, work.size)
    # Those that are averaged have nothing in common with the others: one kernel each.
    averaged = _averaged(patches, work.method)
    for which in (averaged, ~averaged):
        kernel = average if which is averaged else take if work.method == "nearest" else interpolate
        for group in _groups(patches.some(np.flatnonzero(which)), work):
            missing |= _warp_group(work, kernel, group, values, known, tile)
    if dtype.kind in "iu" and work.method != "nearest":
        np.floor(values + 0.5, out=values, where=known.view(np.bool_))
    for k in range(channels):
        place = (tile.rows, tile.cols) if warped.values.ndim == 2 else (tile.rows, tile.cols, k)
        warped.values[place] = values[k].astype(dtype, copy=False)
    warped.valid[tile.rows, tile.cols] = known.view(np.bool_)
    return missing or bool(known.any())


def _warp_group(
    work: _Work, kernel: Callable[..., None], group: Patches, values: NDArray[Any], known: NDArray[np.uint8], tile: Tile
) -> bool:
    """Read what lies under patches and do them; whether anything of it is missing."""
    (r0, r1), (c0, c1) = _window(group.corners, work.size)
    if r1 <= r0 or c1 <= c0:
        return False
    window = np.asarray(work.source[r0:r1, c0:c1])
    there = np.empty((0, 0), dtype=np.uint8)
    if work.valid is not None:
        there = np.ascontiguousarray(work.valid[r0:r1, c0:c1], dtype=np.bool_).view(np.uint8)
    if window.dtype.kind == "f":
        finite = np.isfinite(window)
        if not finite.all():
            finite = finite if finite.ndim == 2 else finite.all(axis=2)
            there = np.ascontiguousarray(finite & (there > 0) if there.size else finite).view(np.uint8)
    if there.size and there.all():
        there = np.empty((0, 0), dtype=np.uint8)
    for k in range(len(values)):
        plane = np.ascontiguousarray(window if window.ndim == 2 else window[..., k], dtype=work.carrier)
        places = (plane.view(np.float64), r0, c0, there, group.bounds, group.corners)
        kernel(*places, values[k].view(np.float64), known, tile.r0, tile.c0)
    return there.size > 0


def _averaged(patches: Patches, method: WarpMethod) -> Flags:
    """Which patches are averaged."""
    if method != "auto":
        return np.full(len(patches), method == "area")
    across = np.linalg.norm(np.diff(patches.corners, axis=2), axis=-1).max(axis=(1, 2))
    down = np.linalg.norm(np.diff(patches.corners, axis=1), axis=-1).max(axis=(1, 2))
    b = patches.bounds
    return np.maximum(down / (b[:, 1] - b[:, 0]), across / (b[:, 3] - b[:, 2])) > LARGER


def _groups(patches: Patches, work: _Work) -> Generator[Patches]:
    """Part patches until what lies under each part can be read at once."""
    if not len(patches):
        return
    (r0, r1), (c0, c1) = _window(patches.corners, work.size)
    under = max(r1 - r0, 0) * max(c1 - c0, 0)
    if under * work.source.dtype.itemsize * int(np.prod(work.source.shape[2:])) <= work.window_bytes:
        yield patches
        return
    if len(patches) == 1:
        if under > _MOST_UNDER:
            raise ResourceError(
                f"{under:.1e} pixels of the source lie under one pixel. Warp to smaller pixels first, then take means."
            )
        yield patches
        return
    b = patches.bounds
    axis = 0 if np.ptp(b[:, 0]) >= np.ptp(b[:, 2]) else 2
    order = np.argsort(b[:, axis], kind="stable")
    yield from _groups(patches.some(order[: len(order) // 2]), work)
    yield from _groups(patches.some(order[len(order) // 2 :]), work)


def _window(corners: Floats, size: tuple[int, int]) -> tuple[tuple[int, int], tuple[int, int]]:
    """Rows and columns of the source that corners (n, 2, 2, 2) reach, with some more than the kernels look at."""
    low, high = corners.min(axis=(0, 1, 2)), corners.max(axis=(0, 1, 2))
    (c0, r0), (c1, r1) = np.floor(low).astype(int) - 3, np.ceil(high).astype(int) + 4
    return (max(int(r0), 0), min(int(r1), size[0])), (max(int(c0), 0), min(int(c1), size[1]))


def _probe(work: _Work) -> Floats:
    """Places (n, n, 2) of the target in the source; refuse a transformation that makes a line or a point of it."""
    shape = work.grid.shape
    y, x = (np.linspace(-0.5, n - 0.5, _LOOKS) for n in shape)
    at = work.mapping(np.stack(np.broadcast_arrays(x[None, :], y[:, None]), axis=-1))
    # Per pixel: a grid of one row is narrow by right.
    down, across = (at[1:, :-1] - at[:-1, :-1]) / shape[0], (at[:-1, 1:] - at[:-1, :-1]) / shape[1]
    area = np.abs(down[..., 0] * across[..., 1] - down[..., 1] * across[..., 0])
    square = np.maximum(np.sum(down**2, axis=-1), np.sum(across**2, axis=-1))
    known = np.isfinite(area)
    if known.any() and not np.any(area[known] > _SINGULAR * square[known]):
        raise CannotRegister(
            "The transformation is singular: it makes a line or a point of the whole image. Fit it again, with marks "
            "that do not lie on one line."
        )
    return at


def _apart(work: _Work, at: Floats) -> CannotRegister:
    """The error for a target that does not meet the source."""
    at = at[np.isfinite(at).all(axis=-1)] * (work.pixel[1], work.pixel[0])
    where = "nowhere"
    if len(at):
        (a, b), (c, d) = at.min(axis=0), at.max(axis=0)
        where = f"to x {round(a)} to {round(c)}, y {round(b)} to {round(d)} um of the image"
    width, height = (work.size[k] * work.pixel[k] for k in (1, 0))
    return CannotRegister(
        f"The transformation takes the target {where}, which is {width:.0f} um wide and {height:.0f} um high: nothing "
        "overlaps. Check the pixel sizes and the origin, and whether the transformation goes from target to image "
        "(use its inverse if not)."
    )


def _budget(source: Source, arrays: int, memory: int) -> tuple[int, int]:
    """Threads, and bytes of the source that each of them reads at once."""
    channels = int(np.prod(source.shape[2:]))
    tile = _TILE[0] * _TILE[1] * (channels * 8 + 1)
    # Read, then one plane of it as a real number, and what is known of it.
    factor = 1 + (8 + 2) / (source.dtype.itemsize * channels)
    least = tile + _SCRATCH + int(factor * 2**20)
    if arrays + least > memory:
        raise ResourceError(
            f"The warped image needs {(arrays + least) / 1e9:.2f} GB of memory, {memory / 1e9:.2f} GB are allowed. "
            "Allow more, or warp to a smaller or coarser grid."
        )
    count = max(1, min(count_threads(), int((memory - arrays) // least)))
    free = (memory - arrays) // count - tile - _SCRATCH
    return count, max(2**20, min(_WINDOW, int(free / factor)))


def _check(source: Source, pixel: Pair, grid: Grid, method: str, valid: Source | None, fill: int) -> None:
    size, dtype, shape = tuple(source.shape), source.dtype, grid.shape
    faults: list[str] = []
    if len(size) not in (2, 3) or min(size, default=0) < 1:
        faults.append(f"the image has the shape {size}; (rows, cols) or (rows, cols, channels) is needed")
    elif max(size[:2]) > _MOST_SIDE:
        faults.append(f"the image has the shape {size}; {_MOST_SIDE} pixels a side are the most")
    if dtype.kind not in "buif" or dtype.itemsize > 8:
        faults.append(f"the image has {dtype} values; truth values, whole or real numbers are needed")
    elif dtype.kind in "bui":
        low, high = (0, 1) if dtype.kind == "b" else (np.iinfo(dtype.str).min, np.iinfo(dtype.str).max)
        if not low <= fill <= high:
            faults.append(f"the fill value {fill} does not fit into {dtype}")
    if dtype.kind == "b" and method in ("bilinear", "area"):
        faults.append(f"truth values have no {method} mean; use nearest, or convert them to numbers")
    if method not in ("auto", "bilinear", "area", "nearest"):
        faults.append(f"there is no method {method!r}; choose auto, bilinear, area or nearest")
    if valid is not None and tuple(valid.shape) != size[:2]:
        faults.append(
            f"the mask has the shape {tuple(valid.shape)}, the image {size}; their rows and columns must agree"
        )
    if faults:
        raise InputError(f"The image cannot be warped: {'; '.join(faults)}.")
    if min(shape) < 1 or not np.isfinite(grid.origin_um).all():
        raise SizeError(
            f"A grid of {shape[0]} x {shape[1]} pixels cannot be made. Check the pixel size and the origin."
        )
    for whose, (rows, cols) in (("image", pixel), ("target", grid.pixel_um)):
        if not (0 < rows < np.inf and 0 < cols < np.inf):
            raise SizeError(f"The pixel size of the {whose} is {rows:g} x {cols:g} um. Give positive numbers.")
