"""Arrays that stay in their files, of which only the part that is asked for is read.

Nothing that was read stays in memory, except the last few slices of formats that decode whole slices.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from planish.core.lazy import LazyArray, Where
from planish.io.guard import check_memory, default_memory_limit, reading

EAGER_BYTES = 2**30
"""Up to this size what can be read in parts is read at once: it then never waits for the disk again."""

CACHE_BYTES = 256 * 2**20
"""Decoded slices that are kept, because the next part often lies in the same ones."""


class FileArray(LazyArray):
    """An array in a file.

    Attributes
    ----------
    path : Path
        For the messages.
    piece_bytes : int
        What is decoded at least, however small the part.
    whole_slices : bool
        Whether a few rows of a slice cost as much as all of them.
    chunks : tuple of int or None
        What is decoded together, where the file is chunked.
    """

    path: Path
    piece_bytes: int
    whole_slices: bool = False
    chunks: tuple[int, ...] | None = None

    def guarded(self) -> AbstractContextManager[None]:
        """Turn what a decoder raises into a FileError."""
        return reading(self.path)


class Pages(Protocol):
    """Pages that are decoded in strips of `unit_rows` rows; 1 where single rows can be read without loss."""

    unit_rows: int

    def rows(self, page: int, start: int, stop: int) -> NDArray[Any]:
        """Decode rows of a page; start and stop lie on borders of strips or at the end of the page."""
        ...


class PagedArray(FileArray):
    """A volume stored page by page."""

    def __init__(self, pages: Pages, shape: tuple[int, int, int], dtype: np.dtype[Any], path: Path) -> None:
        self.pages, self.shape, self.dtype, self.path = pages, shape, dtype, path
        self.piece_bytes = min(pages.unit_rows, shape[1]) * shape[2] * dtype.itemsize
        self.whole_slices = pages.unit_rows >= shape[1]
        self._forget()

    def _forget(self) -> None:
        self._kept: OrderedDict[tuple[int, int], NDArray[Any]] = OrderedDict()
        self._kept_bytes = 0
        self._lock = threading.Lock()

    def __getstate__(self) -> dict[str, Any]:
        """What another process needs; it decodes anew."""
        return {key: value for key, value in vars(self).items() if key not in {"_kept", "_kept_bytes", "_lock"}}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Begin with nothing decoded."""
        vars(self).update(state)
        self._forget()

    def read(self, where: Where) -> NDArray[Any]:
        """Read a part page by page."""
        pages, rows, columns = where
        numbers = range(pages.start, pages.stop, pages.step)
        height = len(range(rows.start, rows.stop, rows.step))
        values = np.empty((len(numbers), height, len(range(columns.start, columns.stop, columns.step))), self.dtype)
        for i, page in enumerate(numbers):
            values[i] = self._rows(page, rows)[:, columns]
        return values

    def _rows(self, page: int, rows: slice) -> NDArray[Any]:
        last = range(rows.start, rows.stop, rows.step)[-1] + 1
        unit = self.pages.unit_rows
        if unit == 1:
            return self.pages.rows(page, rows.start, last)[:: rows.step]
        first = rows.start // unit
        strips = [self._strip(page, k) for k in range(first, (last - 1) // unit + 1)]
        block = strips[0] if len(strips) == 1 else np.concatenate(strips)
        return block[rows.start - first * unit : last - first * unit : rows.step]

    def _strip(self, page: int, number: int) -> NDArray[Any]:
        """Decode a strip, or take it from those kept."""
        key = (page, number)
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        unit = self.pages.unit_rows
        strip = self.pages.rows(page, number * unit, min((number + 1) * unit, self.shape[1]))
        with self._lock:
            if key not in self._kept:
                self._kept[key] = strip
                self._kept_bytes += strip.nbytes
                while self._kept_bytes > CACHE_BYTES and len(self._kept) > 1:
                    self._kept_bytes -= self._kept.popitem(last=False)[1].nbytes
        return strip


class MappedArray(FileArray):
    """Values that lie in a file as they are, in whatever byte order; the file is open only while it is read."""

    piece_bytes = 0

    def __init__(self, path: Path, shape: tuple[int, ...], stored: np.dtype[Any], *, offset: int) -> None:
        self.path, self.shape, self.stored, self.offset = path, shape, stored, offset
        self.dtype = stored.newbyteorder("=")

    def read(self, where: Where) -> NDArray[Any]:
        """Map the file and copy a part."""
        mapped = np.memmap(self.path, self.stored, mode="r", offset=self.offset, shape=self.shape)
        return np.asarray(mapped[where], self.dtype)


def mapped(path: Path, shape: tuple[int, ...], stored: np.dtype[Any], *, offset: int) -> NDArray[Any] | FileArray:
    """Map values that lie in a file as they are; a memmap where the machine has their byte order."""
    if stored == stored.newbyteorder("=") and stored != np.float16:
        with reading(path):
            return np.memmap(path, stored, mode="r", offset=offset, shape=shape)
    return MappedArray(path, shape, stored, offset=offset)


class ChangedArray(FileArray):
    """An array whose parts pass a function that changes each value for itself.

    Parameters
    ----------
    inner : FileArray
        May have a further last axis, the samples of a pixel, which `change` takes away.
    change : callable
        From a part of `inner` to that part of the array; can be pickled.
    """

    def __init__(
        self,
        inner: FileArray,
        change: Callable[[NDArray[Any]], NDArray[Any]],
        *,
        dtype: np.dtype[Any],
        path: Path,
    ) -> None:
        self.inner, self.change, self.dtype, self.path = inner, change, dtype, path
        self.shape = inner.shape[:3]
        self.chunks = None if inner.chunks is None else inner.chunks[:3]
        self.piece_bytes, self.whole_slices = inner.piece_bytes, inner.whole_slices

    def read(self, where: Where) -> NDArray[Any]:
        """Read a part and change its values."""
        samples = [slice(0, n, 1) for n in self.inner.shape[3:]]
        return np.asarray(self.change(self.inner.read((*where, *samples))), self.dtype)


class TurnedArray(FileArray):
    """An array with its axes in another order, without those of length 1 that are left out of `order`."""

    def __init__(self, inner: FileArray, order: Sequence[int]) -> None:
        self.inner, self.order = inner, tuple(order)
        self.shape = tuple(inner.shape[axis] for axis in order)
        self.chunks = None if inner.chunks is None else tuple(inner.chunks[axis] for axis in order)
        self.dtype, self.path = inner.dtype, inner.path
        self.piece_bytes, self.whole_slices = inner.piece_bytes, inner.whole_slices

    def read(self, where: Where) -> NDArray[Any]:
        """Read a part and turn it."""
        inside = [slice(0, 1, 1)] * len(self.inner.shape)
        for part, axis in zip(where, self.order, strict=True):
            inside[axis] = part
        left_out = [axis for axis in range(len(inside)) if axis not in self.order]
        return np.transpose(self.inner.read(tuple(inside)), (*self.order, *left_out)).reshape(
            [len(range(s.start, s.stop, s.step)) for s in where]
        )


def turned(inner: FileArray, order: Sequence[int]) -> FileArray:
    """Return the array itself where the order is its own."""
    return inner if tuple(order) == tuple(range(len(inner.shape))) else TurnedArray(inner, order)


def as_supported(array: FileArray | NDArray[Any], path: Path) -> FileArray | NDArray[Any]:
    """Widen float16, in which the kernels cannot compute, to float32; other types stay."""
    if array.dtype != np.float16:
        return array
    wide = np.dtype(np.float32)
    return (
        ChangedArray(array, np.asarray, dtype=wide, path=path) if isinstance(array, FileArray) else array.astype(wide)
    )


def settle(array: FileArray | NDArray[Any], path: Path, *, memory_bytes: int | None) -> FileArray | NDArray[Any]:
    """Read an array at once where it is small, and leave it in its file otherwise."""
    if not isinstance(array, FileArray):
        return array
    if is_small(array, memory_bytes=memory_bytes):
        return array[...]
    check_memory(path, needed_bytes=array.piece_bytes, limit_bytes=memory_bytes)
    return array


def is_small(array: FileArray, *, memory_bytes: int | None) -> bool:
    """Whether an array is read at once."""
    limit = default_memory_limit() if memory_bytes is None else memory_bytes
    return array.nbytes <= (limit if array.whole_slices else min(limit, EAGER_BYTES))
