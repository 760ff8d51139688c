"""Arrays that stay in their files, of which only the part that is asked for is read.

A few decoded slices stay.
"""

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from planish.core.lazy import LazyArray, Where
from planish.core.memory import DECODED_BYTES, EAGER_BYTES
from planish.core.threads import map_threads
from planish.core.typing import Array, DType, Shape
from planish.io.guard import check_memory, memory_limit, reading
from planish.io.tiff import damaged


class FileArray(LazyArray):
    """An array in a file, of which ``piece_bytes`` are decoded at least, however small the part."""

    piece_bytes: int = 0

    def __init__(
        self,
        path: Path,
        shape: Shape,
        dtype: DType,
        read: Callable[[Where], Array],
    ) -> None:
        super().__init__(shape, dtype, read)
        self.path = path  # for the messages

    def guarded(self) -> AbstractContextManager[None]:
        """Turn what a decoder raises into a FileError."""
        return reading(self.path)


Values = Array | FileArray  # values in memory, mapped, or left in their file
Change = Callable[[Array], Array]


class PagedArray(FileArray):
    """A volume of pages in strips of `unit_rows`, the last kept decoded.

    ``rows(page, start, stop)`` decodes strips.
    """

    def __init__(
        self,
        path: Path,
        shape: Shape,
        dtype: DType,
        unit_rows: int,
        rows: Callable[[int, int, int], Array],
    ) -> None:
        self.path, self.shape, self.dtype, self.unit_rows, self.rows = (
            path,
            shape,
            dtype,
            unit_rows,
            rows,
        )
        self.piece_bytes = min(unit_rows, shape[1]) * math.prod(shape[2:]) * dtype.itemsize
        self.whole_slices = unit_rows >= shape[1]
        self._strip = lru_cache(max(DECODED_BYTES // self.piece_bytes, 1))(self._decoded)

    def __reduce__(self) -> tuple[Any, ...]:
        """Another process decodes anew."""
        return PagedArray, (self.path, self.shape, self.dtype, self.unit_rows, self.rows)

    def read(self, where: Where) -> Array:
        """Read a part page by page."""
        pages, rows, *across = where
        first_strip, end_strip = rows.start // self.unit_rows, -(-rows.stop // self.unit_rows)
        first_row = first_strip * self.unit_rows
        values = np.empty(lengths(where), self.dtype)
        for i, page in enumerate(range(pages.start, pages.stop, pages.step)):
            if self.unit_rows == 1:
                page_rows = self.rows(page, rows.start, rows.stop)
            else:
                strips = [self._strip(page, k) for k in range(first_strip, end_strip)]
                page_rows = strips[0] if len(strips) == 1 else np.concatenate(strips)
            values[i] = page_rows[
                (slice(rows.start - first_row, rows.stop - first_row, rows.step), *across)
            ]
        return values

    def _decoded(self, page: int, number: int) -> Array:
        return self.rows(
            page, number * self.unit_rows, min((number + 1) * self.unit_rows, self.shape[1])
        )


class StoredArray(FileArray):
    """Planes that lie in files as they are, in any byte order.

    Open only while read: mapped they would use memory.
    """

    def __init__(
        self,
        planes: Sequence[tuple[Path, int]],
        shape: Shape,
        stored_dtype: DType,
    ) -> None:
        self.planes, self.shape, self.stored_dtype = planes, shape, stored_dtype
        self.path = planes[0][0]
        self.dtype = stored_dtype.newbyteorder("=")

    def read(self, where: Where) -> Array:
        """Read whole rows, plane by plane, and keep a part of them."""
        planes, rows, *across = where
        values = np.empty(lengths(where), self.dtype)
        rows_shape = (rows.stop - rows.start, *self.shape[2:])
        skip_bytes = rows.start * math.prod(self.shape[2:]) * self.stored_dtype.itemsize
        for i, k in enumerate(range(planes.start, planes.stop, planes.step)):
            path, offset = self.planes[k]
            plane_values = np.fromfile(
                path, self.stored_dtype, math.prod(rows_shape), offset=offset + skip_bytes
            )
            if plane_values.size < math.prod(rows_shape):
                raise damaged(path, f"it ends within the rows at byte {offset + skip_bytes}")
            values[i] = plane_values.reshape(rows_shape)[(slice(None, None, rows.step), *across)]
        return values


def stored_planes(path: Path, shape: Shape, stored_dtype: DType, *, offset: int) -> StoredArray:
    """An array whose planes lie in a file one after the other."""
    plane_bytes = math.prod(shape[1:]) * stored_dtype.itemsize
    return StoredArray(
        [(path, offset + k * plane_bytes) for k in range(shape[0])], shape, stored_dtype
    )


def lengths(where: Where) -> list[int]:
    """Places along each axis of a part."""
    return [len(range(s.start, s.stop, s.step)) for s in where]


def unmapped(array: Values) -> Values:
    """The values of a mapped file, read part by part; anything else as it is."""
    # A part or a turned view of a mapped file still carries its name and offset, but lies elsewhere
    # in it.
    if not isinstance(array, np.memmap) or array.filename is None or not array.flags.c_contiguous:
        return array
    return stored_planes(Path(array.filename), array.shape, array.dtype, offset=array.offset)


def mapped(path: Path, shape: Shape, stored_dtype: DType, *, offset: int) -> Values:
    """Map values that lie in a file as they are.

    A memmap where the machine has their byte order.
    """
    if stored_dtype == stored_dtype.newbyteorder("=") and stored_dtype != np.float16:
        with reading(path):
            return np.memmap(path, stored_dtype, mode="r", offset=offset, shape=shape)
    return stored_planes(path, shape, stored_dtype, offset=offset)


class WholeArray(FileArray):
    """Values that can only be decoded all at once, and so never stay in their file."""

    whole_slices = True

    def __init__(
        self,
        path: Path,
        shape: Shape,
        dtype: DType,
        decode: Callable[[], Array],
    ) -> None:
        self.path, self.shape, self.dtype, self.decode = path, shape, dtype, decode
        self.piece_bytes = self.nbytes

    def read(self, where: Where) -> Array:
        """Decode everything and take a part."""
        return self.decode()[where]

    def in_order(self, order: Sequence[int]) -> "WholeArray":
        """The same with its axes in another order."""
        if tuple(order) == tuple(range(self.ndim)):
            return self
        shape = tuple(self.shape[axis] for axis in order)
        return WholeArray(self.path, shape, self.dtype, partial(_turned, self.decode, tuple(order)))


def _turned(decode: Callable[[], Array], order: Sequence[int]) -> Array:
    return decode().transpose(order)


class ViewArray(FileArray):
    """An array with its axes in another order.

    Its parts pass a function that changes each value for itself.

    Axes left out of `order` are of length 1, or the samples of a pixel, which ``change`` takes
    away; it can be pickled.
    """

    def __init__(
        self,
        inner: FileArray,
        order: Sequence[int],
        change: Change = np.asarray,
        dtype: DType | None = None,
    ) -> None:
        self.inner = inner
        self.order = tuple(order)
        self.change = change
        self.path = inner.path
        self.shape = tuple(inner.shape[axis] for axis in order)
        self.dtype = dtype or inner.dtype
        self.chunks = None if inner.chunks is None else tuple(inner.chunks[axis] for axis in order)
        self.piece_bytes, self.whole_slices = inner.piece_bytes, inner.whole_slices

    def read(self, where: Where) -> Array:
        """Read a part, turn it and change its values."""
        inner_slices = [slice(0, n, 1) for n in self.inner.shape]
        for axis_slice, axis in zip(where, self.order, strict=True):
            inner_slices[axis] = axis_slice
        turned = np.moveaxis(
            self.inner.read(tuple(inner_slices)), self.order, range(len(self.order))
        )
        return np.asarray(self.change(turned), self.dtype).reshape(lengths(where))


def transposed(inner: FileArray, order: Sequence[int]) -> FileArray:
    """Return the array itself where the order is its own."""
    return inner if tuple(order) == tuple(range(inner.ndim)) else ViewArray(inner, order)


def reordered(values: Values, order: Sequence[int]) -> Values:
    """Values with their axes in another order, wherever they lie."""
    if isinstance(values, WholeArray):
        return values.in_order(order)
    if isinstance(values, FileArray):
        return transposed(values, order)
    return values.transpose(order)


def supported_type(dtype: DType) -> DType:
    """Widen float16, in which the kernels cannot compute, to float32; other types stay."""
    return np.dtype(np.float32) if dtype == np.float16 else dtype


def read_if_small(array: Values, *, memory_bytes: int | None) -> Values:
    """Read an array at once where it is small, and leave it in its file otherwise.

    Float16 becomes float32.
    """
    limit = memory_limit(memory_bytes)
    array = unmapped(array) if array.nbytes > limit else array
    if not isinstance(array, FileArray):
        return array.astype(supported_type(array.dtype), copy=False)
    array = widened(array)
    if not is_small(array, limit):
        check_memory(array.path, needed_bytes=array.piece_bytes, limit_bytes=limit)
        return array
    if isinstance(array, WholeArray):
        with array.guarded():
            return array.decode()
    values = np.empty(array.shape, array.dtype)
    chunk = (array.chunks or (1,))[0]
    # Whole chunks; parts enough for all threads.
    step = chunk * max(array.shape[0] // (16 * chunk), 1)

    def read(start: int) -> None:
        values[start : start + step] = array[start : start + step]

    map_threads(read, range(0, array.shape[0], step))
    return values


def widened(array: FileArray) -> FileArray:
    """An array whose values the kernels can compute with."""
    dtype = supported_type(array.dtype)
    return array if dtype == array.dtype else ViewArray(array, range(array.ndim), dtype=dtype)


def is_small(array: FileArray, limit: int) -> bool:
    """True if an array is read at once where ``limit`` bytes may be filled."""
    return array.nbytes <= (limit if array.whole_slices else min(limit, EAGER_BYTES))
