"""Volumes in one TIFF file: classic, BigTIFF, ImageJ, OME; mapped where they lie there as they are.

Otherwise rows of pages are decoded strip by strip or tile by tile, while the file is otherwise closed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tifffile import PHOTOMETRIC, TiffFrame, TiffPage, TiffPageSeries

from planish.core.errors import FileError, VolumeError
from planish.io.formats import ADVICE, LoadedVolume, Place, check_type, colour_attrs, grey_of
from planish.io.guard import check_memory, reading
from planish.io.lazy import ChangedArray, PagedArray, StoredArray, Values, is_small, mapped, transposed
from planish.io.picture import kind_of
from planish.io.sizes import stated_by_tiff
from planish.io.tiff import (
    JPEG_COMPRESSIONS,
    damaged,
    has_rgb,
    long_axes,
    map_or_decode,
    open_series,
    shape_words,
    stored_rows,
    turn_white,
)

SLICE_AXES = "ZIQ"  # letters for an axis of slices: declared as such, or pages without a declared meaning
MEANINGS = {"C": "channels", "T": "time points", "S": "colour samples"}


def load(place: Place, channel: str | None, memory_bytes: int | None) -> LoadedVolume:
    """Read a TIFF stack in one file."""
    path = place.path
    kind = kind_of(path)
    if kind != "tiff":
        raise VolumeError(
            f"{path.name} is one {kind.upper()} picture, not a volume. Give a TIFF stack or a folder of slices."
        )
    with open_series(path, error=VolumeError, advice=ADVICE) as (tif, series):
        axes = _volume_axes(series, path)
        page = series.keyframe
        check_type(series.dtype, path)
        if page.photometric == PHOTOMETRIC.PALETTE and not tif.is_imagej and not _is_grey_ramp(page.colormap):
            raise VolumeError(f"{path.name} has a colour palette. {ADVICE}")
        return LoadedVolume(
            attrs=colour_attrs(channel, path, in_colour="S" in axes),
            values=_series_values(series, path, axes, channel=channel, memory_bytes=memory_bytes),
            stated=stated_by_tiff(tif, page, path),
            files=[path],
            bits=int(page.bitspersample),
        )


def _series_values(
    series: TiffPageSeries, path: Path, axes: str, *, channel: str | None, memory_bytes: int | None
) -> Values:
    """Return the values of a checked series: mapped, left in its pages, or decoded."""
    key = series.keyframe
    shape = tuple(n for n, axis in zip(series.shape, series.axes, strict=True) if axis in axes)
    colour = partial(grey_of, channel=channel) if "S" in axes else None
    white = key.photometric == PHOTOMETRIC.MINISWHITE
    with reading(path):
        offset = series.dataoffset
        stored = series.dtype.newbyteorder(key.parent.byteorder)
        # One page for each slice, and one plane in each page.
        paged = offset is None and key.imagedepth == 1 and not key.is_subsampled and len(series) == shape[0]
        paged = paged and (key.planarconfig == 1 or key.samplesperpixel == 1)
        paged = paged and all(type(p) in (TiffPage, TiffFrame) for p in series)
    if offset is not None and colour is None and not white:
        return mapped(path, shape, stored, offset=offset)
    if offset is not None and colour is not None:
        order = (0, 2, 3, 1) if axes[1] == "S" else (0, 1, 2, 3)
        inner = transposed(StoredArray(path, shape, stored, offset=offset), order)
        return ChangedArray(inner, colour, inner.dtype)
    if offset is not None and series.dtype.kind == "u":
        inner = StoredArray(path, shape, stored, offset=offset)
        return ChangedArray(inner, partial(turn_white, path=path, bits=key.bitspersample), inner.dtype)
    if paged:
        with reading(path):
            array = TiffPages(path, series, colour)
        if colour is not None or not is_small(array, memory_bytes=memory_bytes):
            return array
    whole = map_or_decode(series, path, memory_bytes=memory_bytes).reshape(shape)
    if colour is None:
        return whole
    check_memory(path, needed_bytes=whole.nbytes + math.prod(shape) // 3, limit_bytes=memory_bytes)
    return np.stack([colour(np.moveaxis(p, 0, -1) if axes[1] == "S" else p) for p in whole])


def _volume_axes(series: TiffPageSeries, path: Path) -> str:
    """Return the axes of a stack that are longer than 1: slices, y and x, and the samples of a stack in colour."""
    axes = long_axes(series)
    sizes = dict(zip(series.axes, series.shape, strict=True))
    grey = axes.replace("S", "")
    # The samples of a pixel may be red, green and blue, with or without further ones.
    is_rgb = axes.find("S") in (1, 3) and sizes["S"] in (3, 4) and has_rgb(series.keyframe)
    if len(grey) == 3 and grey[0] in SLICE_AXES and grey[1:] == "YX" and (axes == grey or is_rgb):
        return axes
    # ImageJ and tifffile file a stack of unnamed pages as channels; nothing has so many channels, so these are slices.
    if axes == "CYX" and sizes["C"] >= 16:
        return axes
    further = {a: n for a, n in sizes.items() if n > 1 and a in MEANINGS}
    if further:
        content = " and ".join(f"{n} {MEANINGS[a]}" for a, n in further.items())
        hint = (
            ADVICE
            if any(a in SLICE_AXES for a in axes) or "S" in further
            else f"If these are the slices, say so in the file (ImageJ: Image > Properties). Otherwise: {ADVICE}"
        )
        raise VolumeError(f"{path.name} has {content}: {shape_words(series)}. {hint}")
    if axes == "YX":
        raise VolumeError(
            f"{path.name} has one page, not a stack: {shape_words(series)}. Give all slices, in one file or one folder."
        )
    raise VolumeError(f"{path.name} is not a volume with the axes z, y, x: {shape_words(series)}. {ADVICE}")


def _is_grey_ramp(colormap: NDArray[Any] | None) -> bool:
    """True if a palette only spreads grey values over the range, in order."""
    if colormap is None:
        return False
    red, green, blue = np.asarray(colormap).astype(np.int64)
    return bool(np.array_equal(red, green) and np.array_equal(red, blue) and np.all(np.diff(red) > 0))


class TiffPages(PagedArray):
    """Pages of one series that was checked and is still open, each with one plane of pixels.

    ``change`` turns the pixels of some rows, with their samples, into grey.
    """

    def __init__(
        self, path: Path, series: TiffPageSeries, change: Callable[[NDArray[Any]], NDArray[Any]] | None = None
    ) -> None:
        key = series.keyframe
        pages = [page for page in series if page is not None]
        jpeg = key.compression in JPEG_COMPRESSIONS
        tables = ({"jpegtables": page.jpegtables, "jpegheader": key.jpegheader} if jpeg else {} for page in pages)
        self._segments = [(p.dataoffsets, p.databytecounts, t) for p, t in zip(pages, tables, strict=True)]
        self._decode: Any = key.decode
        self._change, self._samples, self._bits = change, key.samplesperpixel, key.bitspersample
        dtype = np.dtype(key.dtype)
        self._stored = dtype.newbyteorder(key.parent.byteorder)
        self._white = key.photometric == PHOTOMETRIC.MINISWHITE
        self._strip_rows = key.tilelength if key.is_tiled else min(key.rowsperstrip, key.imagelength)
        self._across = -(-key.imagewidth // key.tilewidth) if key.is_tiled else 1
        self._plain = (
            key.compression == 1
            and not key.is_tiled
            and key.predictor == 1
            and key.fillorder == 1
            and key.bitspersample == 8 * dtype.itemsize
            and not key.is_subsampled
        )
        shape = (len(pages), key.imagelength, key.imagewidth)
        super().__init__(path, shape, dtype.newbyteorder("="), 1 if self._plain else self._strip_rows)

    def __reduce__(self) -> tuple[Any, ...]:
        """Open the file again in another process."""
        return _open_pages, (self.path, self._change)

    def rows(self, page: int, start: int, stop: int) -> NDArray[Any]:
        """Decode rows of a page, dims (y, x)."""
        values = np.empty((stop - start, self.shape[2], self._samples), self.dtype)
        offsets, counts, tables = self._segments[page]
        row = 0
        with self.path.open("rb") as file:
            while self._plain and row < len(values):
                strip, inside = divmod(start + row, self._strip_rows)
                part = values[row : row + self._strip_rows - inside]
                offset = offsets[strip] + inside * values[0].size * self._stored.itemsize
                part[...] = stored_rows(file, self.path, offset, part.shape, self._stored)
                row += len(part)
            first, last = start // self._strip_rows, -(-stop // self._strip_rows)
            for index in () if self._plain else range(first * self._across, last * self._across):
                file.seek(offsets[index])
                data = file.read(counts[index])
                if len(data) < counts[index]:
                    raise damaged(self.path, f"data of page {page + 1} are missing")
                part, (_, _, y, x, _), (_, height, width, _) = self._decode(data, index, _fullsize=False, **tables)
                if part is None:
                    raise damaged(self.path, f"a strip or tile of page {page + 1} is empty")
                height, width = min(height, stop - y), min(width, self.shape[2] - x)
                values[y - start : y - start + height, x : x + width] = part[0, :height, :width]
        values = turn_white(values, path=self.path, bits=self._bits, out=values) if self._white else values
        return self._change(values) if self._change is not None else values[..., 0]


def _open_pages(path: Path, change: Callable[[NDArray[Any]], NDArray[Any]] | None) -> TiffPages:
    with open_series(path, error=FileError, advice="Copy it again.") as (_, series), reading(path):
        return TiffPages(path, series, change)
