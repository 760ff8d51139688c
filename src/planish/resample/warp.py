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
_FAST = ("uint8", "uint16", "float32", "float64")


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
    share : (rows, cols) float32, or None
        Share of a pixel's area that lies on known pixels of the source; 0 or 1 where it was not averaged.
    """

    values: NDArray[Any]
    valid: Flags
    share: NDArray[np.float32] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Work:
    """What a tile needs to know."""

    source: Source
    pixel: Pair
    to_source: Callable[[Floats], Floats]
    target_pixel: Pair
    origin: Pair
    method: WarpMethod
    valid: Source | None
    fill: int
    window_bytes: int

    def mapping(self, points: Floats) -> Floats:
        """Places in source pixels of points (..., 2) in target pixels."""
        at = points * (self.target_pixel[1], self.target_pixel[0]) + self.origin
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
    def dtype(self) -> np.dtype[Any]:
        """Type of the result: the source's, in the byte order of the machine."""
        return self.source.dtype.newbyteorder("=")


def warp_image(
    source: Source, source_pixel_um: float | Pair, to_source: Callable[[Floats], Floats], shape: tuple[int, int],
    pixel_um: float | Pair, *, origin_um: Pair = (0.0, 0.0), method: WarpMethod = "auto", valid: Source | None = None,
    fill: int = 0, share: bool = False, memory_bytes: int = 2**31, threads: int | None = None,
    out: NDArray[Any] | None = None, out_valid: Flags | None = None,
) -> Warped:  # fmt: skip
    """Warp an image by a transformation.

    Parameters
    ----------
    source : (rows, cols) or (rows, cols, channels)
        Truth values, whole or real numbers; what is not finite is missing. An array, a memory map, or anything that has
        a shape and a type and can be cut as an array can. The middle of its first pixel is (0, 0) um.
    source_pixel_um : float or (float, float)
        Pitch of its rows and columns.
    to_source : callable
        Takes points (..., 2), (x, y) in um, of the target to the source: the ``inverse`` of a transformation that takes
        the source to the target. NaN where there is none. It is asked about few points, from several threads.
    shape : (int, int)
        Rows and columns of the target.
    pixel_um : float or (float, float)
        Pitch of its rows and columns.
    origin_um : (float, float)
        (x, y) of the middle of its first pixel.
    method : {"auto", "bilinear", "area", "nearest"}
        Bilinear at the pixel's middle; the mean over the pixel's area; the value of the pixel in which the middle lies,
        for labels. ``auto`` averages where the longer side of a pixel is more than 1.1 source pixels long, and is
        bilinear elsewhere; it decides patch by patch. Truth values are taken as labels.
    valid : (rows, cols), optional
        Source pixels that count.
    fill : int
        What stands where a whole number is not valid.
    share : bool
        Whether to return the share of each pixel's area that is known.
    memory_bytes : int
        What may be taken beside the source and what is given as ``out`` and ``out_valid``.
    threads : int, optional
        All processors, at most 8, where not given, and no more than fit into the memory.
    out, out_valid : array, optional
        Where to write values (type of the source) and validity (bool); memory maps for what does not fit.

    Returns
    -------
    Warped
        The same bytes whatever the memory and the number of threads.

    Raises
    ------
    CannotRegister
        The target does not meet the source, or the transformation makes a line of it.
    SizeError
        A pixel size or the grid is impossible.
    InputError
        Arrays of other shapes or types than are needed.
    ResourceError
        It does not fit into the memory.

    Notes
    -----
    Places in the source are right to 0.01 source pixels, and exact for affine transformations. A pixel's area is the
    quadrilateral between the images of its four corners, and every source pixel counts with the part of it that lies
    inside: nothing is sampled, and of whole images the sums are kept. A pixel is valid where at least half of its area
    is known. Between the middles of source pixels, a bilinear value is known where all pixels that have weight are, as
    in :func:`planish.resample.resample`: it ends at the middles of the outermost pixels, half a pixel before the area
    does. In several channels what is missing in one is missing in all.

    Rounding leaves 1e-13 of the largest value nearby in a mean: say where values are that stand for missing ones.
    """
    pixel, target_pixel = _pair(source_pixel_um, "source"), _pair(pixel_um, "target")
    _check(source, shape, origin_um, method, valid, fill)
    full = (*shape, *source.shape[2:])
    needed = shape[0] * shape[1] * (4 * share + (out_valid is None))
    needed += 0 if out is not None else int(np.prod(full)) * source.dtype.itemsize
    dtype = source.dtype.newbyteorder("=")
    _check_out(out, full, dtype, "out")
    _check_out(out_valid, shape, np.dtype(bool), "out_valid")
    count, window = _budget(source, share, needed, memory_bytes, threads)
    chosen: WarpMethod = "nearest" if method == "auto" and source.dtype.kind == "b" else method
    work = _Work(
        source=source, pixel=pixel, to_source=to_source, target_pixel=target_pixel, origin=origin_um,
        method=chosen, valid=valid, fill=fill, window_bytes=window,
    )  # fmt: skip
    _look(work, shape)
    warped = Warped(
        values=np.empty(full, dtype=dtype) if out is None else out,
        valid=np.empty(shape, dtype=np.bool_) if out_valid is None else out_valid,
        share=np.empty(shape, dtype=np.float32) if share else None,
    )
    tiles = tiles_of(shape, _TILE)
    one = partial(_warp_tile, work, warped)
    if not any(map_threads(one, tiles, number=min(count, len(tiles)))):
        raise _apart(work, shape)
    return warped


def _warp_tile(work: _Work, warped: Warped, tile: Tile) -> bool:
    """Do one tile; whether it meets the source, even if only where that is missing."""
    source, dtype = work.source, work.dtype
    inner = dtype if work.method == "nearest" or dtype.name in _FAST else np.dtype(np.float64)
    blank = np.nan if dtype.kind == "f" else work.fill
    channels = int(np.prod(source.shape[2:]))
    values = np.full((channels, *tile.shape), blank, dtype=inner)
    known = np.zeros(tile.shape, dtype=np.uint8)
    share = np.zeros(tile.shape if warped.share is not None else (0, 0), dtype=np.float32)
    missing = False
    patches = find_patches(work.mapping, tile, work.size)
    # Those that are averaged have nothing in common with the others: one kernel each.
    averaged = _averaged(patches, work.method)
    for which in (averaged, ~averaged):
        kernel = average if which is averaged else take if work.method == "nearest" else interpolate
        for group in _groups(patches.some(np.flatnonzero(which)), work):
            missing |= _warp_group(work, kernel, group, inner, values, known, share, tile)
    rows, cols = tile.rows, tile.cols
    if inner != dtype and dtype.kind in "iu":
        np.rint(values, out=values)
    for k in range(channels):
        place = (rows, cols) if len(source.shape) == 2 else (rows, cols, k)
        warped.values[place] = values[k].astype(dtype, copy=False)
    warped.valid[rows, cols] = known.view(np.bool_)
    if warped.share is not None:
        warped.share[rows, cols] = share
    return missing or bool(known.any())


def _warp_group(
    work: _Work, kernel: Callable[..., None], group: Patches, inner: np.dtype[Any], values: NDArray[Any],
    known: NDArray[np.uint8], share: NDArray[np.float32], tile: Tile,
) -> bool:  # fmt: skip
    """Read what lies under patches and do them; whether anything of it is missing."""
    (r0, r1), (c0, c1) = _window(group.corners, work.size)
    if r1 <= r0 or c1 <= c0:
        return False
    window = np.asarray(work.source[r0:r1, c0:c1])
    there = np.empty((0, 0), dtype=np.uint8)
    if work.valid is not None:
        there = np.asarray(work.valid[r0:r1, c0:c1]).astype(np.bool_).view(np.uint8)
    if window.dtype.kind == "f":
        finite = np.isfinite(window)
        if not finite.all():
            finite = finite if finite.ndim == 2 else finite.all(axis=2)
            there = (finite & (there > 0) if there.size else finite).view(np.uint8)
    if there.size and there.all():
        there = np.empty((0, 0), dtype=np.uint8)
    half = () if kernel is take else (0.5 if inner.kind in "iu" else 0.0,)
    for k in range(len(values)):
        plane = np.array(window if window.ndim == 2 else window[..., k], dtype=inner, order="C")
        out = values[k]
        if kernel is take:
            # Bits, not numbers: one compiled kernel for all types of a size.
            plane, out = (a.view(f"u{inner.itemsize}") for a in (plane, out))
        kernel(plane, r0, c0, there, group.bounds, group.corners, *half, out, known, share, tile.r0, tile.c0)
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


def _look(work: _Work, shape: tuple[int, int]) -> None:
    """Refuse a transformation that makes a line or a point of the target."""
    y, x = (np.linspace(-0.5, n - 0.5, _LOOKS) for n in shape)
    at = work.mapping(np.stack(np.broadcast_arrays(x[None, :], y[:, None]), axis=-1))
    # Per pixel: a grid of one row is narrow by right.
    down, across = (at[1:, :-1] - at[:-1, :-1]) / shape[0], (at[:-1, 1:] - at[:-1, :-1]) / shape[1]
    area = np.abs(down[..., 0] * across[..., 1] - down[..., 1] * across[..., 0])
    square = np.maximum(np.sum(down**2, axis=-1), np.sum(across**2, axis=-1))
    seen = np.isfinite(area)
    if seen.any() and not np.any(area[seen] > _SINGULAR * square[seen]):
        raise CannotRegister(
            "The transformation is singular: it makes a line or a point of the whole image. Fit it again, with marks "
            "that do not lie on one line."
        )


def _apart(work: _Work, shape: tuple[int, int]) -> CannotRegister:
    """The error for a target that does not meet the source."""
    y, x = (np.linspace(-0.5, n - 0.5, _LOOKS) for n in shape)
    at = work.mapping(np.stack(np.broadcast_arrays(x[None, :], y[:, None]), axis=-1)).reshape(-1, 2)
    at = at[np.isfinite(at).all(axis=1)] * (work.pixel[1], work.pixel[0])
    where = "nowhere"
    if len(at):
        (a, b), (c, d) = at.min(axis=0), at.max(axis=0)
        where = f"to x {round(a)} to {round(c)}, y {round(b)} to {round(d)} um of the source"
    width, height = (work.size[k] * work.pixel[k] for k in (1, 0))
    return CannotRegister(
        f"The transformation takes the target {where}, which is {width:.0f} um wide and {height:.0f} um high: nothing "
        "overlaps. Check the pixel sizes and the origin, and whether the transformation goes from target to source "
        "(use its inverse if not)."
    )


def _budget(source: Source, share: bool, arrays: int, memory: int, threads: int | None) -> tuple[int, int]:
    """Threads, and bytes of the source that each of them reads at once."""
    channels = int(np.prod(source.shape[2:]))
    tile = _TILE[0] * _TILE[1] * (channels * max(source.dtype.itemsize, 8) + 1 + 4 * share)
    # Read, then one plane of it as a real number, and what is known of it.
    factor = 1 + (8 + 2) / (source.dtype.itemsize * channels)
    least = tile + _SCRATCH + int(factor * 2**20)
    if arrays + least > memory:
        raise ResourceError(
            f"The warped image needs {(arrays + least) / 1e9:.2f} GB of memory, {memory / 1e9:.2f} GB are allowed. "
            "Allow more, or give memory maps as out and out_valid."
        )
    count = count_threads(threads)
    count = max(1, min(count, int((memory - arrays) // least)))
    free = (memory - arrays) // count - tile - _SCRATCH
    return count, max(2**20, min(_WINDOW, int(free / factor)))


def _pair(pixel_um: float | Pair, whose: str) -> Pair:
    rows, cols = (pixel_um, pixel_um) if isinstance(pixel_um, int | float) else pixel_um
    if not (0 < rows < np.inf and 0 < cols < np.inf):
        raise SizeError(f"The pixel size of the {whose} is {rows:g} x {cols:g} um. Give positive numbers.")
    return float(rows), float(cols)


def _check(
    source: Source, shape: tuple[int, int], origin: Pair, method: str, valid: Source | None, fill: int
) -> None:  # fmt: skip
    size, dtype = tuple(source.shape), source.dtype
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
    if len(shape) != 2 or min(shape) < 1 or not np.isfinite(origin).all():
        raise SizeError(
            f"A grid of shape {shape} from {origin} um cannot be made. Check the pixel size and the origin."
        )


def _check_out(out: NDArray[Any] | None, shape: tuple[int, ...], dtype: np.dtype[Any], name: str) -> None:
    if out is not None and (out.shape != shape or out.dtype != dtype):
        raise InputError(f"{name} has the shape {out.shape} and {out.dtype} values; {shape} and {dtype} are needed.")
