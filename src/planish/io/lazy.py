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

from planish.core.lazy import LazyArray, Where, lengths
from planish.core.memory import DECODED_BYTES, EAGER_BYTES
from planish.core.threads import map_threads
from planish.core.typing import Array, DType, Shape
from planish.io.guard import check_memory, memory_limit, reading
from planish.io.tiff import damaged


class FileArray(LazyArray):
    """An array in a file, of which ``piece_bytes`` are decoded at least, however small the part."""

    piece_bytes: int = 0
    is_whole: bool = False  # whether all of it is decoded for any part

    def __init__(
        self,
        path: Path,
        shape: Shape,
        stored_dtype: DType,
        read: Callable[[Where], Array],
    ) -> None:
        super().__init__(shape, stored_dtype.newbyteorder("="), read)
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
        super().__init__(path, shape, dtype, self._read_pages)
        self.unit_rows = min(unit_rows, shape[1])
        self.rows = rows
        self.piece_bytes = self.unit_rows * math.prod(shape[2:]) * dtype.itemsize
        self.whole_slices = unit_rows >= shape[1]
        self._strip = lru_cache(max(DECODED_BYTES // self.piece_bytes, 1))(self._decoded)

    def __reduce__(self) -> tuple[Any, ...]:
        """Another process decodes anew."""
        return PagedArray, (self.path, self.shape, self.dtype, self.unit_rows, self.rows)

    def _read_pages(self, where: Where) -> Array:
        """Read a part page by page; ``where`` is along pages, rows, and what lies in a row."""
        pages, rows, *across = where
        first_strip = rows.start // self.unit_rows
        end_strip = -(-rows.stop // self.unit_rows)
        first_row = first_strip * self.unit_rows
        within = (slice(rows.start - first_row, rows.stop - first_row, rows.step), *across)
        values = np.empty(lengths(where), self.dtype)
        for i, page in enumerate(range(pages.start, pages.stop, pages.step)):
            if self.unit_rows == 1:  # nothing more than asked for is decoded, and nothing kept
                page_rows = self.rows(page, rows.start, rows.stop)
            else:
                strips = [self._strip(page, k) for k in range(first_strip, end_strip)]
                page_rows = strips[0] if len(strips) == 1 else np.concatenate(strips)
            values[i] = page_rows[within]
        return values

    def _decoded(self, page: int, number: int) -> Array:
        first_row = number * self.unit_rows
        end_row = min(first_row + self.unit_rows, self.shape[1])
        return self.rows(page, first_row, end_row)


def stored_array(
    planes: Sequence[tuple[Path, int]], shape: Shape, stored_dtype: DType
) -> FileArray:
    """Planes that lie in files as they are, in any byte order.

    Open only while read: mapped they would use memory.
    """
    read = partial(_read_planes, planes, shape, stored_dtype)
    return FileArray(planes[0][0], shape, stored_dtype, read)


def _read_planes(
    stored_planes: Sequence[tuple[Path, int]], shape: Shape, stored_dtype: DType, where: Where
) -> Array:
    """Read whole rows, plane by plane, and keep a part of them.

    ``stored_planes``: file and first byte of each plane; ``shape`` is that of the whole array.
    """
    planes, rows, *across = where
    values = np.empty(lengths(where), stored_dtype.newbyteorder("="))
    rows_shape = (rows.stop - rows.start, *shape[2:])
    n_values = math.prod(rows_shape)
    skip_bytes = rows.start * math.prod(shape[2:]) * stored_dtype.itemsize
    for i, (path, offset) in enumerate(stored_planes[planes]):
        first_byte = offset + skip_bytes
        row_values = np.fromfile(path, stored_dtype, n_values, offset=first_byte)
        if row_values.size < n_values:
            raise damaged(path, f"it ends within the rows at byte {first_byte}")
        within = (slice(None, None, rows.step), *across)
        values[i] = row_values.reshape(rows_shape)[within]
    return values


def stored_planes(path: Path, shape: Shape, stored_dtype: DType, *, offset: int) -> FileArray:
    """An array whose planes lie in a file one after the other."""
    plane_bytes = math.prod(shape[1:]) * stored_dtype.itemsize
    planes = [(path, offset + k * plane_bytes) for k in range(shape[0])]
    return stored_array(planes, shape, stored_dtype)


def unmapped(array: Values) -> Values:
    """The values of a mapped file, read part by part; anything else as it is."""
    if not isinstance(array, np.memmap) or array.filename is None:
        return array
    # A part or a turned view of a mapped file still carries its name and offset, but lies elsewhere
    # in it.
    if not array.flags.c_contiguous:
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


def whole_array(path: Path, shape: Shape, dtype: DType, decode: Callable[[], Array]) -> FileArray:
    """Values that can only be decoded all at once, and so never stay in their file."""
    array = FileArray(path, shape, dtype, partial(_part_of_decoded, decode))
    array.is_whole = array.whole_slices = True
    array.piece_bytes = array.nbytes
    return array


def _part_of_decoded(decode: Callable[[], Array], where: Where) -> Array:
    return decode()[where]


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
        shape = tuple(inner.shape[axis] for axis in order)
        super().__init__(inner.path, shape, dtype or inner.dtype, self._read_view)
        self.inner = inner
        self.order = tuple(order)
        self.change = change
        if inner.chunks is not None:
            self.chunks = tuple(inner.chunks[axis] for axis in order)
        self.piece_bytes = inner.piece_bytes
        self.whole_slices = inner.whole_slices
        self.is_whole = inner.is_whole

    def _read_view(self, where: Where) -> Array:
        """Read a part, turn it and change its values."""
        inner_slices = [slice(0, n, 1) for n in self.inner.shape]
        for axis_slice, axis in zip(where, self.order, strict=True):
            inner_slices[axis] = axis_slice
        part = self.inner.read(tuple(inner_slices))
        turned = np.moveaxis(part, self.order, range(len(self.order)))
        changed = np.asarray(self.change(turned), self.dtype)
        return changed.reshape(lengths(where))


def reordered(values: Values, order: Sequence[int]) -> Values:
    """Values with their axes in another order, wherever they lie."""
    if not isinstance(values, FileArray):
        return values.transpose(order)
    if [*order] == [*range(values.ndim)]:
        return values
    return ViewArray(values, order)


def supported_type(dtype: DType) -> DType:
    """Widen float16, in which the kernels cannot compute, to float32; other types stay."""
    if dtype == np.float16:
        return np.dtype(np.float32)
    return dtype


def decode_if_small(array: Values, *, memory_bytes: int | None) -> Values:
    """Read a `FileArray` at once where it is small; a large one stays in its file.

    An array in memory or mapped stays as it is, but a mapped file that is larger than
    ``memory_bytes`` becomes a `FileArray`, which is read in parts. Small is what :func:`is_small`
    says for ``memory_bytes``, None for three quarters of the memory available. Float16 becomes
    float32.
    """
    limit = memory_limit(memory_bytes)
    array = unmapped(array) if array.nbytes > limit else array
    if not isinstance(array, FileArray):
        return array.astype(supported_type(array.dtype), copy=False)
    array = widened(array)
    if not is_small(array, limit):
        check_memory(array.path, needed_bytes=array.piece_bytes, limit_bytes=limit)
        return array
    if array.is_whole:
        with array.guarded():
            return array.read(tuple(slice(0, n, 1) for n in array.shape))
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
    if dtype == array.dtype:
        return array
    return ViewArray(array, range(array.ndim), dtype=dtype)


def is_small(array: FileArray, limit: int) -> bool:
    """True if an array is read at once where ``limit`` bytes may be filled."""
    return array.nbytes <= (limit if array.whole_slices else min(limit, EAGER_BYTES))
