"""Rows of the pages of a TIFF file, decoded strip by strip or tile by tile while the file is otherwise closed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from tifffile import TiffFrame, TiffPage, TiffPageSeries

from planish.core.errors import FileError
from planish.io.guard import reading
from planish.io.lazy import PagedArray
from planish.io.tiff import JPEG_COMPRESSIONS, WHITE_IS_ZERO, damaged, open_series, stored_rows, turn_white

Change = Callable[[NDArray[Any]], NDArray[Any]]


class TiffPages(PagedArray):
    """Pages of one series, each with one plane of pixels; the pages have been checked.

    Parameters
    ----------
    path : Path
    series : TiffPageSeries
        Of a file that is still open.
    change : callable, optional
        From the pixels of some rows, with their samples, to grey.
    """

    def __init__(self, path: Path, series: TiffPageSeries, change: Change | None = None) -> None:
        key = series.keyframe
        pages = [page for page in series if page is not None]
        jpeg = key.compression in JPEG_COMPRESSIONS
        tables = ({"jpegtables": page.jpegtables, "jpegheader": key.jpegheader} if jpeg else {} for page in pages)
        self._segments = [(p.dataoffsets, p.databytecounts, t) for p, t in zip(pages, tables, strict=True)]
        self._decode: Any = key.decode
        self._change, self._samples, self._bits = change, key.samplesperpixel, key.bitspersample
        own = np.dtype(key.dtype)
        self._stored = own.newbyteorder(key.parent.byteorder)
        self._white = key.photometric == WHITE_IS_ZERO
        self._strip_rows = key.tilelength if key.is_tiled else min(key.rowsperstrip, key.imagelength)
        self._across = -(-key.imagewidth // key.tilewidth) if key.is_tiled else 1
        self._plain = (
            key.compression == 1
            and not key.is_tiled
            and key.predictor == 1
            and key.fillorder == 1
            and key.bitspersample == 8 * own.itemsize
            and not key.is_subsampled
        )
        shape = (len(pages), key.imagelength, key.imagewidth)
        super().__init__(path, shape, own.newbyteorder("="), 1 if self._plain else self._strip_rows)

    def __reduce__(self) -> tuple[Any, ...]:
        """Open the file again in another process."""
        return _open_pages, (self.path, self._change)

    def rows(self, page: int, start: int, stop: int) -> NDArray[Any]:
        """Decode rows of a page, dims (y, x)."""
        values = np.empty((stop - start, self.shape[2], self._samples), self.dtype)
        fill = self._fill_plain if self._plain else self._fill_coded
        with self.path.open("rb") as file:
            fill(file, page, start, values)
        values = turn_white(values, path=self.path, bits=self._bits, out=values) if self._white else values
        return self._change(values) if self._change is not None else values[..., 0]

    def _fill_plain(self, file: BinaryIO, page: int, start: int, values: NDArray[Any]) -> None:
        """Read uncompressed rows, dims (y, x, sample)."""
        row_bytes = values[0].size * self._stored.itemsize
        row = 0
        while row < len(values):
            strip, inside = divmod(start + row, self._strip_rows)
            part = values[row : row + self._strip_rows - inside]
            offset = self._segments[page][0][strip] + inside * row_bytes
            part[...] = stored_rows(file, self.path, offset, part.shape, self._stored)
            row += len(part)

    def _fill_coded(self, file: BinaryIO, page: int, start: int, values: NDArray[Any]) -> None:
        """Decode strips or tiles, dims (y, x, sample)."""
        offsets, counts, tables = self._segments[page]
        stop = start + len(values)
        for index in range(start // self._strip_rows * self._across, -(-stop // self._strip_rows) * self._across):
            file.seek(offsets[index])
            data = file.read(counts[index])
            if len(data) < counts[index]:
                raise damaged(self.path, f"data of page {page + 1} are missing")
            part, (_, _, y, x, _), (_, height, width, _) = self._decode(data, index, _fullsize=False, **tables)
            if part is None:
                raise damaged(self.path, f"a strip or tile of page {page + 1} is empty")
            height, width = min(height, stop - y), min(width, self.shape[2] - x)
            values[y - start : y - start + height, x : x + width] = part[0, :height, :width]


def _open_pages(path: Path, change: Change | None) -> TiffPages:
    with open_series(path, error=FileError, advice="Copy it again.") as (_, series), reading(path):
        return TiffPages(path, series, change)


def can_page(series: TiffPageSeries, pages: int) -> bool:
    """Whether a series has one page for each slice, and one plane in each page."""
    key = series.keyframe
    simple = key.imagedepth == 1 and (key.planarconfig == 1 or key.samplesperpixel == 1)
    return (
        simple
        and not key.is_subsampled
        and len(series) == pages
        and all(type(p) in (TiffPage, TiffFrame) for p in series)
    )
