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
from planish.io.tiff import JPEG_COMPRESSIONS, WHITE_IS_ZERO, only_series, open_tiff, turn_white
from planish.io.tiff_chain import damaged

Change = Callable[[NDArray[Any]], NDArray[Any]]


class TiffPages:
    """Pages of one series, each with one plane of pixels; the pages have been checked.

    Parameters
    ----------
    path : Path
    series : TiffPageSeries
        Of a file that is still open.
    change : callable, optional
        From the pixels of some rows, with their samples, to grey.
    """

    def __init__(self, path: Path, series: TiffPageSeries, *, change: Change | None = None) -> None:
        self.path, self.change = path, change
        self._take(series)

    def _take(self, series: TiffPageSeries) -> None:
        key = series.keyframe
        pages = [page for page in series if page is not None]
        self._segments = [(page.dataoffsets, page.databytecounts) for page in pages]
        self._decode: Any = key.decode
        jpeg = key.compression in JPEG_COMPRESSIONS
        self._jpeg = [(page.jpegtables, key.jpegheader) if jpeg else None for page in pages]
        self._height, self._width, self._samples = key.imagelength, key.imagewidth, key.samplesperpixel
        self._dtype = np.dtype(key.dtype)
        self._stored = self._dtype.newbyteorder(key.parent.byteorder)
        self._bits = key.bitspersample
        self._white = key.photometric == WHITE_IS_ZERO
        self._strip_rows = key.tilelength if key.is_tiled else min(key.rowsperstrip, key.imagelength)
        self._across = -(-key.imagewidth // key.tilewidth) if key.is_tiled else 1
        self._plain = (
            key.compression == 1
            and not key.is_tiled
            and key.predictor == 1
            and key.fillorder == 1
            and key.bitspersample == 8 * self._dtype.itemsize
            and not key.is_subsampled
        )
        self.unit_rows = 1 if self._plain else self._strip_rows

    def __reduce__(self) -> tuple[Any, ...]:
        """Open the file again in another process."""
        return _open_pages, (self.path, self.change)

    def rows(self, page: int, start: int, stop: int) -> NDArray[Any]:
        """Decode rows of a page, dims (y, x)."""
        with self.path.open("rb") as file:
            block = (
                self._plain_rows(file, page, start, stop) if self._plain else self._coded_rows(file, page, start, stop)
            )
        block = turn_white(block, self.path, bits=self._bits) if self._white else block
        return self.change(block) if self.change is not None else block[..., 0]

    def _plain_rows(self, file: BinaryIO, page: int, start: int, stop: int) -> NDArray[Any]:
        """Read uncompressed rows, dims (y, x, sample)."""
        row_bytes = self._width * self._samples * self._dtype.itemsize
        offsets = self._segments[page][0]
        values = np.empty((stop - start, self._width, self._samples), self._dtype)
        row = start
        while row < stop:
            strip, inside = divmod(row, self._strip_rows)
            count = min(stop - row, self._strip_rows - inside)
            file.seek(offsets[strip] + inside * row_bytes)
            data = file.read(count * row_bytes)
            if len(data) < count * row_bytes:
                raise damaged(self.path, f"data of page {page + 1} are missing")
            values[row - start : row - start + count] = np.frombuffer(data, self._stored).reshape(
                count, self._width, self._samples
            )
            row += count
        return values

    def _coded_rows(self, file: BinaryIO, page: int, start: int, stop: int) -> NDArray[Any]:
        """Decode strips or tiles, dims (y, x, sample)."""
        offsets, counts = self._segments[page]
        options: dict[str, Any] = {"_fullsize": False}
        jpeg = self._jpeg[page]
        if jpeg is not None:
            options |= {"jpegtables": jpeg[0], "jpegheader": jpeg[1]}
        values = np.empty((stop - start, self._width, self._samples), self._dtype)
        for index in range(start // self._strip_rows * self._across, -(-stop // self._strip_rows) * self._across):
            file.seek(offsets[index])
            data = file.read(counts[index])
            if len(data) < counts[index]:
                raise damaged(self.path, f"data of page {page + 1} are missing")
            part, (_, _, y, x, _), (_, height, width, _) = self._decode(data, index, **options)
            if part is None:
                raise damaged(self.path, f"a strip or tile of page {page + 1} is empty")
            height, width = min(height, stop - y), min(width, self._width - x)
            values[y - start : y - start + height, x : x + width] = part[0, :height, :width]
        return values


def _open_pages(path: Path, change: Change | None) -> TiffPages:
    """Open a file that was read before."""
    with open_tiff(path) as tif, reading(path):
        return TiffPages(path, only_series(tif, path, error=FileError, advice="Copy it again."), change=change)


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
