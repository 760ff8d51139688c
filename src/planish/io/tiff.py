"""TIFF files, checked before they are decoded, then mapped or decoded whole: never short, never filled up."""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tifffile import TiffFile, TiffFrame, TiffPage, TiffPageSeries

from planish.core.errors import FileError, InputError
from planish.io.guard import check_blown_up, check_memory, reading, size_of_file
from planish.io.tiff_chain import check_chain, damaged

WHITE_IS_ZERO = 0
BLACK_IS_ZERO = 1
RGB = 2
PALETTE = 3
YCBCR = 6

LAYOUT_NUMBERS = (
    "imagewidth", "imagelength", "imagedepth", "tilewidth", "tilelength", "tiledepth", "rowsperstrip", "bitspersample",
    "samplesperpixel", "sampleformat", "compression", "photometric", "planarconfig", "predictor", "fillorder",
)  # fmt: skip
"""Attributes of a page on which the position and meaning of every pixel depend."""

JPEG_COMPRESSIONS = frozenset({6, 7, 34892, 33007})


@contextmanager
def open_tiff(path: Path) -> Generator[TiffFile]:
    """Open a TIFF file whose chain of pages is whole."""
    pages = check_chain(path)
    with reading(path):
        tif = TiffFile(path, _multifile=False)
    try:
        with reading(path):
            found = len(tif.pages)
        if found != pages:
            raise damaged(path, f"{pages} pages are chained, {found} can be read")
        yield tif
    finally:
        tif.close()


def only_series(tif: TiffFile, path: Path, *, error: type[InputError], advice: str) -> TiffPageSeries:
    """Return the one series of equal pages, leaving thumbnails aside."""
    with reading(path):
        every = list(tif.series)
        check_declared_images(tif, path)
    full = [s for s in every if not s.keyframe.is_reduced] or every
    if not full:
        raise damaged(path, "it holds no image")
    if len(full) > 1:
        first, other = full[0], full[1]
        with reading(path):
            odd = next((page.index + 1 for page in other if page is not None), 0)
        raise error(
            f"{path.name} holds {len(full)} different images: {shape_words(first)} from page 1 on, "
            f"{shape_words(other)} at page {odd}. {advice}"
        )
    return full[0]


def check_declared_images(tif: TiffFile, path: Path) -> None:
    """Compare the number of images that ImageJ wrote with the bytes and pages that are there.

    ImageJ stores all slices behind one page table, so a cut file has a whole chain.
    """
    meta: Any = tif.imagej_metadata
    images = meta.get("images", 1) if meta else 1
    page = tif.pages.first
    if not isinstance(images, int) or images <= max(1, len(tif.pages)) or not page.dataoffsets:
        return
    if page.dataoffsets[0] + images * page.nbytes > tif.filehandle.size or not page.is_contiguous:
        raise damaged(
            path, f"{images} images are declared, the file has {len(tif.pages)} pages and {tif.filehandle.size} bytes"
        )


def check_data(series: TiffPageSeries, path: Path) -> None:
    """Check that all data of a series are in the file, as far as the page tables show."""
    size = size_of_file(path)
    key = series.keyframe
    check_numbers(key, path)
    if series.size == 0 or key.dtype is None or series.dtype.itemsize == 0:
        raise damaged(path, f"its image is {' x '.join(map(str, series.shape)) or 'without extent'} pixels")
    if key.bitspersample not in range(1, 65):
        raise damaged(path, f"its pixels have {key.bitspersample} bits")
    with reading(path):
        offset = series.dataoffset
        pages: list[TiffPage | TiffFrame | None] = [key] if offset is not None else list(series)
    if offset is not None and offset + series.nbytes > size:
        raise damaged(path, f"the image ends at byte {offset + series.nbytes}, the file has {size}")
    if len(pages) * math.prod(key.shape) != series.size and offset is None:
        raise damaged(path, f"{series.size} pixels are declared, its pages hold {len(pages) * math.prod(key.shape)}")
    with reading(path):
        segments = math.prod(key.chunked)
    needed = stored_bytes_if_uncompressed(key)
    total = 0
    for number, page in enumerate(pages, start=1):
        if page is None:
            raise FileError(
                f"{path.name}: image {number} of {len(pages)} is declared but not in this file. "
                "Export all slices into one file."
            )
        total += check_page_data(page, path, number=number, segments=segments, needed=needed, size=size)
    if key.compression != 1:
        check_blown_up(path, decoded_bytes=series.nbytes, stored_bytes=total)


def check_numbers(page: TiffPage, path: Path) -> None:
    """Refuse a page whose layout is not given in whole numbers, as damaged tags may have any type."""
    for name in LAYOUT_NUMBERS:
        value: Any = getattr(page, name)
        if not isinstance(value, int):
            raise damaged(path, f"its {name} is {str(value)[:40]!r}, which is no number")


def check_page_data(
    page: TiffPage | TiffFrame, path: Path, *, number: int, segments: int, needed: int | None, size: int
) -> int:
    """Check the strips or tiles of one page; return their bytes."""
    offsets, counts = page.dataoffsets, page.databytecounts
    if len(offsets) < segments or len(counts) < segments:
        raise damaged(
            path, f"data missing: page {number} has {min(len(offsets), len(counts))} of {segments} strips or tiles"
        )
    for offset, count in zip(offsets, counts, strict=False):
        if offset == 0 or count == 0:
            raise damaged(path, f"data missing: a strip or tile of page {number} is empty")
        if offset < 8 or offset + count > size:
            raise damaged(path, f"data of page {number} end at byte {offset + count}, the file has {size}")
    total = sum(counts)
    if needed is not None and total < needed:
        raise damaged(path, f"data missing: page {number} has {total} bytes of {needed}")
    return total


def stored_bytes_if_uncompressed(page: TiffPage) -> int | None:
    """Bytes that the strips of an uncompressed page must have; None if it is compressed."""
    if page.compression != 1 or page.is_subsampled:
        return None
    row_bits = page.imagewidth * page.bitspersample * (page.samplesperpixel if page.planarconfig == 1 else 1)
    rows = page.imagelength * page.imagedepth * (1 if page.planarconfig == 1 else page.samplesperpixel)
    return rows * math.ceil(row_bits / 8)


def map_or_decode(series: TiffPageSeries, path: Path, *, memory_bytes: int | None) -> NDArray[Any]:
    """Return the values of a checked series, mapped from the file where they lie there as they are."""
    with reading(path):
        offset = series.dataoffset
        turned = series.keyframe.photometric == WHITE_IS_ZERO
        native = series.dtype.newbyteorder(series.keyframe.parent.byteorder) == series.dtype.newbyteorder("=")
        if offset is not None and native and not turned:
            return np.memmap(path, dtype=series.dtype, mode="r", offset=offset, shape=series.shape)
    check_memory(path, needed_bytes=series.nbytes, limit_bytes=memory_bytes)
    with reading(path):
        values = np.empty(series.shape, series.dtype.newbyteorder("="))
        decoded = series.asarray(out=values)
    if decoded.shape != values.shape:
        raise damaged(path, f"its data decode to {decoded.shape}, not {values.shape}")
    return turn_white(values, path, bits=series.keyframe.bitspersample) if turned else values


def turn_white(values: NDArray[Any], path: Path, *, bits: int) -> NDArray[Any]:
    """Make black zero, in place."""
    if values.dtype.kind == "b":
        return np.logical_not(values, out=values)
    if values.dtype.kind != "u":
        raise FileError(
            f"{path.name} stores white as 0 in {values.dtype} values, whose range is not defined. "
            "Export it with black as 0."
        )
    return np.subtract(values.dtype.type(2**bits - 1), values, out=values)


def shape_words(series: TiffPageSeries) -> str:
    """Write shape, axes and type, for example ``45 x 300 x 128 (ZYX) uint8``."""
    return f"{size_words(series.shape)} ({series.axes}) {series.dtype}"


def size_words(shape: Sequence[int]) -> str:
    """Write a shape, for example ``300 x 128``."""
    return " x ".join(map(str, shape))
