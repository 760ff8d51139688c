"""TIFF files, checked before they are decoded, then mapped or decoded whole: never short, never filled up.

Libraries stop where the chain of pages leads out of a file that was cut, or in a circle; here both are errors.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tifffile import PHOTOMETRIC, TiffFile, TiffFrame, TiffPage, TiffPageSeries

from planish.core.errors import FileError, InputError
from planish.io.guard import check_blown_up, check_memory, reading, size_of_file

JPEG_COMPRESSIONS = frozenset({6, 7, 34892, 33007})

# Attributes of a page on which the position and meaning of every pixel depend.
LAYOUT_NUMBERS = (
    "imagewidth", "imagelength", "imagedepth", "tilewidth", "tilelength", "tiledepth", "rowsperstrip", "bitspersample",
    "samplesperpixel", "sampleformat", "compression", "photometric", "planarconfig", "predictor", "fillorder",
)  # fmt: skip

MOST_PAGES = 100_000  # no scan has more slices; a chain this long is damage

# Bytes of one value, by TIFF type.
TYPE_BYTES = {
    1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8,
}  # fmt: skip

# Size, type, layout and position of the image data, and the description: what is read must be inside the file.
NEEDED_TAGS = frozenset({256, 257, 258, 259, 262, 270, 273, 277, 278, 279, 322, 323, 324, 325, 339})


@contextmanager
def open_series(path: Path, *, error: type[InputError], advice: str) -> Generator[tuple[TiffFile, TiffPageSeries]]:
    """Open a TIFF file and give its one series of equal pages, thumbnails left aside, with all data in the file."""
    pages = _count_pages(path)
    with reading(path):
        tif = TiffFile(path, _multifile=False)
    with tif:
        with reading(path):
            if len(tif.pages) != pages:
                raise damaged(path, f"{pages} pages are chained, {len(tif.pages)} can be read")
            _check_declared_images(tif, path)
            every = list(tif.series)
            full = [s for s in every if not s.keyframe.is_reduced] or every
            if not full:
                raise damaged(path, "it holds no image")
            series = first = full[0]
            if len(full) > 1:  # slices may be written one by one, each as an image of its own
                if not all(len(s.pages) == 1 and s.ndim == 2 and s.keyframe.hash == first.keyframe.hash for s in full):
                    odd = next((s for s in full[1:] if s.shape != first.shape), full[1])
                    odd_page = next((page.index + 1 for page in odd if page is not None), 0)
                    raise error(
                        f"{path.name} holds {len(full)} different images: {shape_words(first)} from page 1 on, "
                        f"{shape_words(odd)} at page {odd_page}. {advice}"
                    )
                shape, slices = (len(full), *first.shape), [s.pages[0] for s in full]
                series = TiffPageSeries(slices, shape, first.dtype, "IYX", kind="uniform")
            _check_data(series, path)
        yield tif, series


def is_tiff(head: bytes) -> bool:
    """True if a file that begins with these bytes is a TIFF file."""
    return head[:4] in {b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"}


def _count_pages(path: Path) -> int:
    size = size_of_file(path)
    offsets: set[int] = set()
    with reading(path), path.open("rb") as file:
        head = file.read(16)
        if not is_tiff(head):
            raise FileError(f"{path.name} is not a TIFF file. Export it as TIFF.")
        order = "<" if head[:2] == b"II" else ">"
        widths, first = ("QHHQQ", 16) if head[2:4] in {b"+\0", b"\0+"} else ("HHHII", 8)
        if len(head) < first:
            raise damaged(path, "it ends within its header")
        count, tag, pointer = (struct.Struct(order + part) for part in (widths[0], widths[1:4], widths[4]))
        offset: int = pointer.unpack(head[first // 2 : first])[0]
        while offset:
            page = f"page {len(offsets) + 1}"
            if offset in offsets:
                raise damaged(path, f"{page} of its chain is one of the pages before it")
            if len(offsets) == MOST_PAGES:
                raise damaged(path, f"it claims more than {MOST_PAGES} pages")
            offsets.add(offset)
            if not first <= offset <= size - count.size:
                raise damaged(path, f"{page} should begin at byte {offset}, the file has {size}")
            file.seek(offset)
            tags = count.unpack(file.read(count.size))[0]
            if not 0 < tags <= 4096:
                raise damaged(path, f"{page} claims {tags} tags")
            step = tag.size + pointer.size
            table = file.read(tags * step + pointer.size)
            if len(table) != tags * step + pointer.size:
                raise damaged(path, f"the file ends within the table of {page}")
            for start in range(0, tags * step, step):
                code, kind, values = tag.unpack_from(table, start)
                length = values * TYPE_BYTES.get(kind, 0)
                if code not in NEEDED_TAGS:
                    continue
                if length == 0:
                    raise damaged(path, f"tag {code} of {page} has no value")
                # Values that are short enough stand in the table itself.
                if length > pointer.size and pointer.unpack_from(table, start + tag.size)[0] + length > size:
                    raise damaged(path, f"tag {code} of {page} lies outside the file of {size} bytes")
            offset = pointer.unpack_from(table, tags * step)[0]
    if not offsets:
        raise damaged(path, "it holds no page")
    return len(offsets)


def damaged(path: Path, fault: str) -> FileError:
    """One message for all kinds of damage: found, and what to do."""
    return FileError(f"{path.name} is cut off or damaged: {fault}. Copy or export it again.")


def _check_declared_images(tif: TiffFile, path: Path) -> None:
    """Compare the images that are declared with what is there, before a list of them is made.

    A file of ImageJ that was cut still has its one table of pages.
    """
    first, pages = tif.pages.first, len(tif.pages)
    for tag in re.findall(r"<(?:\w+:)?Pixels\b[^>]*>", tif.ome_metadata or ""):
        sizes = {k: int(n) for k, n in re.findall(r"\bSize([ZCTYX])\s*=\s*[\"'](\d{1,18})[\"']", tag)}
        planes = math.prod(sizes.get(k, 1) for k in "ZCT")
        rows, columns = sizes.get("Y", 1), sizes.get("X", 1)
        if planes > MOST_PAGES or rows > 10 * first.imagelength or columns > 10 * first.imagewidth:
            declared = f"its OME metadata declare {size_words([*sizes.values()])} values"
            raise damaged(path, f"{declared}, the file has {pages} pages of {size_words(first.shape)}")
    meta: Any = tif.imagej_metadata
    images = meta.get("images", 1) if meta else 1
    if not isinstance(images, int) or images <= max(1, pages) or not first.dataoffsets:
        return
    if first.dataoffsets[0] + images * first.nbytes > tif.filehandle.size or not first.is_contiguous:
        size = tif.filehandle.size
        raise damaged(path, f"{images} images are declared, the file has {pages} pages and {size} bytes")


def _check_data(series: TiffPageSeries, path: Path) -> None:
    """Check that all data of a series are in the file, as far as the page tables show."""
    size, key = size_of_file(path), series.keyframe
    for name in LAYOUT_NUMBERS:  # damaged tags may have any type
        number: Any = getattr(key, name)
        if not isinstance(number, int):
            raise damaged(path, f"its {name} is {str(number)[:40]!r}, which is no number")
    if series.size == 0 or key.dtype is None or series.dtype.itemsize == 0:
        raise damaged(path, f"its image is {size_words(series.shape) or 'without extent'} pixels")
    if key.bitspersample not in range(1, 65):
        raise damaged(path, f"its pixels have {key.bitspersample} bits")
    offset = series.dataoffset
    pages: list[TiffPage | TiffFrame | None] = [key] if offset is not None else list(series)
    if offset is not None and offset + series.nbytes > size:
        raise damaged(path, f"the image ends at byte {offset + series.nbytes}, the file has {size}")
    pixels = len(pages) * math.prod(key.shape)
    if pixels != series.size and offset is None:
        raise damaged(path, f"{series.size} pixels are declared, its pages hold {pixels}")
    segments, needed, total = math.prod(key.chunked), 0, 0
    if key.compression == 1 and not key.is_subsampled:  # bytes that the strips of a page must have
        samples, planes = (key.samplesperpixel, 1) if key.planarconfig == 1 else (1, key.samplesperpixel)
        row_bytes = math.ceil(key.imagewidth * key.bitspersample * samples / 8)
        needed = key.imagelength * key.imagedepth * planes * row_bytes
    for number, page in enumerate(pages, start=1):
        if page is None:
            raise FileError(
                f"{path.name}: image {number} of {len(pages)} is declared but not in this file. Export all into one."
            )
        offsets, counts = page.dataoffsets, page.databytecounts
        missing = f"data missing: page {number} has"
        if min(len(offsets), len(counts)) < segments:
            raise damaged(path, f"{missing} {min(len(offsets), len(counts))} of {segments} strips or tiles")
        for start, count in zip(offsets, counts, strict=False):
            if start == 0 or count == 0:
                raise damaged(path, f"{missing} an empty strip or tile")
            if start < 8 or start + count > size:
                raise damaged(path, f"data of page {number} end at byte {start + count}, the file has {size}")
        if sum(counts) < needed:
            raise damaged(path, f"{missing} {sum(counts)} bytes of {needed}")
        total += sum(counts)
    if key.compression != 1:
        check_blown_up(path, decoded_bytes=series.nbytes, stored_bytes=total)


def map_or_decode(series: TiffPageSeries, path: Path, *, memory_bytes: int | None) -> NDArray[Any]:
    """Return the values of a checked series, mapped from the file where they lie there as they are."""
    with reading(path):
        if (offset := mapped_from(series)) is not None:
            return np.memmap(path, dtype=series.dtype, mode="r", offset=offset, shape=series.shape)
        check_memory(path, needed_bytes=series.nbytes, limit_bytes=memory_bytes)
        values = np.empty(series.shape, series.dtype.newbyteorder("="))
        decoded = series.asarray(out=values)
    if decoded.shape != values.shape:
        raise damaged(path, f"its data decode to {decoded.shape}, not {values.shape}")
    if series.keyframe.photometric == PHOTOMETRIC.MINISWHITE:
        turn_white(values, path=path, bits=series.keyframe.bitspersample, out=values)
    return values


def mapped_from(series: TiffPageSeries) -> int | None:
    """Byte of the file from which the values lie there as they are; None where they have to be decoded."""
    turned = series.keyframe.photometric == PHOTOMETRIC.MINISWHITE
    native = series.dtype.newbyteorder(series.keyframe.parent.byteorder) == series.dtype.newbyteorder("=")
    return series.dataoffset if native and not turned else None


def turn_white(values: NDArray[Any], *, path: Path, bits: int, out: NDArray[Any] | None = None) -> NDArray[Any]:
    """Make black zero."""
    if values.dtype.kind == "b":
        return np.logical_not(values, out=out)
    if values.dtype.kind != "u":
        raise FileError(
            f"{path.name} stores white as 0 in {values.dtype} values, whose range is not defined. "
            "Export it with black as 0."
        )
    return np.subtract(values.dtype.type(2**bits - 1), values, out=out)


def has_rgb(page: TiffPage) -> bool:
    """True if the first samples of a page are red, green and blue."""
    return page.photometric == PHOTOMETRIC.RGB or (
        page.photometric == PHOTOMETRIC.YCBCR and page.compression in JPEG_COMPRESSIONS
    )


def long_axes(series: TiffPageSeries) -> str:
    """Letters of y and x and of all other axes longer than 1."""
    return "".join(a for a, n in zip(series.axes, series.shape, strict=True) if n > 1 or a in "YX")


def shape_words(series: TiffPageSeries) -> str:
    """Write shape, axes and type, for example ``45 x 300 x 128 (ZYX) uint8``."""
    return f"{size_words(series.shape)} ({series.axes}) {series.dtype}"


def size_words(shape: Sequence[int]) -> str:
    """Write a shape, for example ``300 x 128``."""
    return " x ".join(map(str, shape))
