"""Check TIFF files before they are decoded, then map them or decode them whole.

They are never short, never filled up.

Libraries stop where the chain of pages leads out of a file that was cut, or in a circle; here both
are errors.
"""

import math
import re
import struct
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from tifffile import PHOTOMETRIC, TIFF, TiffFile, TiffFrame, TiffPage, TiffPageSeries

from planish.core.errors import FileError, InputError
from planish.core.typing import Array, Shape, Texts
from planish.io.guard import check_blown_up, check_memory, open_bytes, reading, size_of_file

JPEG_COMPRESSIONS = frozenset({6, 7, 34892, 33007})
LAYOUT_NUMBERS = (  # Attributes of a page on which the position and meaning of every pixel depend.
    "imagewidth",
    "imagelength",
    "imagedepth",
    "tilewidth",
    "tilelength",
    "tiledepth",
    "rowsperstrip",
    "bitspersample",
    "samplesperpixel",
    "sampleformat",
    "compression",
    "photometric",
    "planarconfig",
    "predictor",
    "fillorder",
)

PICTURE_ADVICE = "One picture is needed: save it alone."
MOST_PAGES = 100_000  # no scan has more slices; a chain this long is damage
# Bytes of one value, by TIFF type.
TYPE_BYTES = {code: struct.calcsize(f"={form}") for code, form in TIFF.DATA_FORMATS.items()}

# Size, type, layout and position of the image data, and the description: what is read must be
# inside the file.
NEEDED_TAGS = frozenset({256, 257, 258, 259, 262, 270, 273, 277, 278, 279, 322, 323, 324, 325, 339})


@contextmanager
def open_series(
    path: Path,
    *,
    error: type[InputError] = FileError,
    advice: str = PICTURE_ADVICE,
    has_data: bool = True,
) -> Generator[tuple[TiffFile, TiffPageSeries]]:
    """Open a TIFF file and give its one series of equal pages.

    Thumbnails are left aside. With ``has_data`` all of its data are in the file.
    """
    n_pages = _count_pages(path)
    with reading(path):
        tif = TiffFile(path, _multifile=False)
    with tif:
        with reading(path):
            if len(tif.pages) != n_pages:
                raise damaged(path, f"{n_pages} pages are chained, {len(tif.pages)} can be read")
            _check_declared_images(tif, path)
            all_series = _declared_series(tif)
            full_series = [s for s in all_series if not s.keyframe.is_reduced] or all_series
            if not full_series:
                raise damaged(path, "it holds no image")
            series, fault_text = _as_one(full_series)
            if fault_text:
                raise error(f"{path.name} holds {fault_text}. {advice}")
            if has_data:
                _check_data(series, path)
        yield tif, series


def _as_one(all_series: list[TiffPageSeries]) -> tuple[TiffPageSeries, str]:
    """Slices that were written one by one, each as an image of its own, as one series.

    Given with it is its fault: images that differ; empty where there is none.
    """
    first = all_series[0]
    if len(all_series) == 1:
        return first, ""
    # Pages, axes, and what tells layouts of pages apart.
    layouts = {(len(s.pages), s.ndim, s.keyframe.hash) for s in all_series}
    if layouts == {(1, 2, first.keyframe.hash)}:
        shape = (len(all_series), *first.shape)
        pages = [s.pages[0] for s in all_series]
        return TiffPageSeries(pages, shape, first.dtype, "IYX", kind="uniform"), ""
    odd = next((s for s in all_series if s.shape != first.shape), all_series[1])
    odd_page = next((page.index + 1 for page in odd if page is not None), 0)
    return first, (
        f"{len(all_series)} different images: {shape_words(first)} from page 1 on,"
        f" {shape_words(odd)} at page {odd_page}"
    )


def is_tiff(head: bytes) -> bool:
    """True if a file that begins with these bytes is a TIFF file."""
    return head[:4] in {b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"}


def _count_pages(path: Path) -> int:
    """Number of pages of the chain, of which each table of tags and what it names is in the file.

    No library reads a page before.
    """
    file_bytes = size_of_file(path)
    offsets: set[int] = set()
    with open_bytes(path) as file:
        head = file.read(16)
        count, tag, pointer = _table_structs(head, path)
        first_offset = 2 * pointer.size
        # Of the first page; each table of tags ends with the byte of the next one, 0 at the end.
        offset: int = pointer.unpack(head[pointer.size : first_offset])[0]
        while offset:
            page_text = f"page {len(offsets) + 1}"
            if offset in offsets:
                raise damaged(path, f"{page_text} of its chain is one of the pages before it")
            if len(offsets) == MOST_PAGES:
                raise damaged(path, f"it claims more than {MOST_PAGES} pages")
            offsets.add(offset)
            if not first_offset <= offset <= file_bytes - count.size:
                raise damaged(
                    path, f"{page_text} should begin at byte {offset}, the file has {file_bytes}"
                )
            file.seek(offset)
            n_tags = count.unpack(file.read(count.size))[0]
            if not 0 < n_tags <= 4096:
                raise damaged(path, f"{page_text} claims {n_tags} tags")
            tags_bytes = n_tags * (tag.size + pointer.size)
            table = file.read(tags_bytes + pointer.size)
            if len(table) != tags_bytes + pointer.size:
                raise damaged(path, f"the file ends within the table of {page_text}")
            _check_tags(table[:tags_bytes], (tag, pointer), file_bytes, path, page_text)
            offset = pointer.unpack_from(table, tags_bytes)[0]
    if not offsets:
        raise damaged(path, "it holds no page")
    return len(offsets)


def _table_structs(head: bytes, path: Path) -> list[struct.Struct]:
    """Layouts in a table of tags: the number of tags, a tag, and the byte it or a page begins."""
    if not is_tiff(head):
        raise FileError(f"{path.name} is not a TIFF file. Export it as TIFF.")
    is_big = head[2:4] in {b"+\0", b"\0+"}
    codes = ("Q", "HHQ", "Q") if is_big else ("H", "HHI", "I")
    byte_order = "<" if head[:2] == b"II" else ">"
    structs = [struct.Struct(byte_order + code) for code in codes]
    if len(head) < 2 * structs[-1].size:
        raise damaged(path, "it ends within its header")
    return structs


def _check_tags(
    table: bytes,
    entry: tuple[struct.Struct, struct.Struct],
    file_bytes: int,
    path: Path,
    page_text: str,
) -> None:
    """Refuse a page whose needed tags are empty or lie outside the file.

    ``table``: its tags, each as ``entry`` lays it out: code, type and count, then the value or the
    byte where it begins.
    """
    tag, pointer = entry
    for position in range(0, len(table), tag.size + pointer.size):
        code, type_code, n_values = tag.unpack_from(table, position)
        if code not in NEEDED_TAGS:
            continue
        value_bytes = n_values * TYPE_BYTES.get(type_code, 0)
        if value_bytes == 0:
            raise damaged(path, f"tag {code} of {page_text} has no value")
        # Values that are short enough stand in the table itself.
        value_offset = pointer.unpack_from(table, position + tag.size)[0]
        if value_bytes > pointer.size and value_offset + value_bytes > file_bytes:
            raise damaged(
                path, f"tag {code} of {page_text} lies outside the file of {file_bytes} bytes"
            )


def damaged(path: Path, fault: str) -> FileError:
    """One message for all kinds of damage: found, and what to do."""
    return FileError(f"{path.name} is cut off or damaged: {fault}. Copy or export it again.")


def _check_declared_images(tif: TiffFile, path: Path) -> None:
    """Compare the images declared with those there before they are listed.

    A cut file of ImageJ still has its table.
    """
    _check_ome_images(tif, path)
    first = tif.pages.first
    n_pages = len(tif.pages)
    n_images = _imagej_images(tif)
    if n_images > n_pages and first.dataoffsets and not describes_other_images(tif):
        held_bytes = first.dataoffsets[0] + n_images * first.nbytes
        file_bytes = tif.filehandle.size
        if held_bytes > file_bytes or not first.is_contiguous:
            held_text = f"the file has {n_pages} pages and {file_bytes} bytes"
            raise damaged(path, f"{n_images} images are declared, {held_text}")


def _ome_pixels(tif: TiffFile) -> list[str]:
    """Tags of OME metadata that describe the pixels of an image each."""
    return re.findall(r"<(?:\w+:)?Pixels\b[^>]*>", tif.ome_metadata or "")


def _check_ome_images(tif: TiffFile, path: Path) -> None:
    """Refuse OME metadata of more planes than can be, or of planes far larger than the pages."""
    first = tif.pages.first
    for tag in _ome_pixels(tif):
        lengths = re.findall(r"\bSize([ZCTYX])\s*=\s*[\"'](\d{1,18})[\"']", tag)
        sizes = {letter: int(length) for letter, length in lengths}
        n_planes = math.prod(sizes.get(k, 1) for k in "ZCT")
        n_rows = sizes.get("Y", 1)
        n_columns = sizes.get("X", 1)
        is_plane = n_rows <= 10 * first.imagelength and n_columns <= 10 * first.imagewidth
        if n_planes > MOST_PAGES or not is_plane:
            declared_text = f"its OME metadata declare {size_words([*sizes.values()])} values"
            held_text = f"the file has {len(tif.pages)} pages of {size_words(first.shape)}"
            raise damaged(path, f"{declared_text}, {held_text}")


def _imagej_images(tif: TiffFile) -> int:
    meta: Any = tif.imagej_metadata
    n_images = meta.get("images", 1) if meta else 1
    return n_images if isinstance(n_images, int) else 1


def _described_images(tif: TiffFile) -> int:
    """Number of grey images that ImageJ or the one image of OME describes; 1 where none does."""
    pixels = _ome_pixels(tif)
    sizes = re.findall(r"\bSize[ZCT]\s*=\s*[\"'](\d{1,9})[\"']", pixels[0]) if pixels else []
    n_planes = 1
    if len(pixels) == 1:
        n_planes = math.prod(map(int, sizes))
    return max(n_planes, _imagej_images(tif))


def describes_other_images(tif: TiffFile) -> bool:
    """True if the description counts other grey images than the whole pages of a file.

    A slice that was cut out of a stack keeps its description, and so does a stack that grew. Of a
    stack with fewer pages than images, some are lost.
    """
    first: Any = tif.pages.first
    n_pages = len(tif.pages)
    n_images = _described_images(tif)
    if n_images == 1 or not first.dataoffsets or first.samplesperpixel > 1:
        return False
    if n_pages > 1:
        return n_images < n_pages and len({page.hash for page in tif.pages}) == 1
    # ImageJ chains no pages in stacks above 4 GB, but then a part of the next image follows. What
    # follows a slice is a table of tags; pixels may begin at a full page of memory.
    stored_bytes = sum(first.databytecounts) + sum(tag.valuebytecount for tag in first.tags)
    return tif.filehandle.size <= stored_bytes + 2 * 4096


def notes_on_reading(tif: TiffFile, page: TiffPage, path: Path) -> Texts:
    """Say what was assumed of a file: which images are read, and how their values are."""
    notes: list[str] = []
    n_pages = len(tif.pages)
    if describes_other_images(tif) and n_pages == 1:
        notes.append(f"{path.name} describes the stack that it was cut out of; it holds one image.")
    elif describes_other_images(tif):
        n_images = _described_images(tif)
        notes.append(f"{path.name} describes {n_images} images; its {n_pages} pages are read.")
    if page.photometric == PHOTOMETRIC.MINISWHITE:
        notes.append(f"{path.name} stores white as 0; the values are turned, so that black is 0.")
    if page.photometric == PHOTOMETRIC.PALETTE and tif.is_imagej:
        notes.append(f"ImageJ shows {path.name} in false colours; the grey values below are read.")
    return tuple(notes)


def _declared_series(tif: TiffFile) -> list[TiffPageSeries]:
    """Series of a file; each page where the description counts other images."""
    if not describes_other_images(tif):
        return list(tif.series)
    series: list[TiffPageSeries] = []
    for page in list[Any](tif.pages):
        alone = TiffPageSeries([page], page.shape, page.dtype, page.axes, kind="uniform")
        series.append(alone)
    return series


def _check_data(series: TiffPageSeries, path: Path) -> None:
    """Refuse a series whose layout is no number, or whose data are not all in the file."""
    file_bytes = size_of_file(path)
    frame = series.keyframe
    _check_layout(series, path)
    pages = list(series)
    if series.dataoffset is not None:
        pages = [frame]
        end_byte = series.dataoffset + series.nbytes
        if end_byte > file_bytes:
            raise damaged(path, f"the image ends at byte {end_byte}, the file has {file_bytes}")
    elif len(pages) * math.prod(frame.shape) != series.size:
        n_pixels = len(pages) * math.prod(frame.shape)
        raise damaged(path, f"{series.size} pixels are declared, its pages hold {n_pixels}")
    total_bytes = 0
    for number, page in enumerate(pages, start=1):
        if page is None:
            raise FileError(
                f"{path.name}: image {number} of {len(pages)} is declared but not in this file."
                " Export all into one."
            )
        total_bytes += _checked_bytes(page, frame, number, path, file_bytes)
    if frame.compression != 1:
        check_blown_up(path, decoded_bytes=series.nbytes, stored_bytes=total_bytes)


def _check_layout(series: TiffPageSeries, path: Path) -> None:
    """Refuse pages whose layout is no number or that have no values; damaged tags have any type."""
    frame = series.keyframe
    for name in LAYOUT_NUMBERS:
        number: Any = getattr(frame, name)
        if not isinstance(number, int):
            raise damaged(path, f"its {name} is {str(number)[:40]!r}, which is no number")
    if series.size == 0 or frame.dtype is None or series.dtype.itemsize == 0:
        raise damaged(path, f"its image is {size_words(series.shape) or 'without extent'} pixels")
    if frame.bitspersample not in range(1, 65):
        raise damaged(path, f"its pixels have {frame.bitspersample} bits")


def _checked_bytes(
    page: TiffPage | TiffFrame, frame: TiffPage, number: int, path: Path, file_bytes: int
) -> int:
    """Bytes of the strips or tiles of a page, all of which are in the file.

    ``number``: that of the page, from 1; ``frame``: the page whose layout all of them have.
    """
    n_segments = math.prod(frame.chunked)
    missing_text = f"data missing: page {number} has"
    n_complete = min(len(page.dataoffsets), len(page.databytecounts))
    if n_complete < n_segments:
        raise damaged(path, f"{missing_text} {n_complete} of {n_segments} strips or tiles")
    for start, byte_count in zip(page.dataoffsets, page.databytecounts, strict=False):
        if start == 0 or byte_count == 0:
            raise damaged(path, f"{missing_text} an empty strip or tile")
        end_byte = start + byte_count
        if start < 8 or end_byte > file_bytes:  # the header of a file has 8 bytes at least
            raise damaged(
                path, f"data of page {number} end at byte {end_byte}, the file has {file_bytes}"
            )
    stored_bytes = sum(page.databytecounts)
    needed_bytes = _least_bytes(frame)
    if stored_bytes < needed_bytes:
        raise damaged(path, f"{missing_text} {stored_bytes} bytes of {needed_bytes}")
    return stored_bytes


def _least_bytes(frame: TiffPage) -> int:
    """Bytes that the strips of a page must have; 0 where that depends on its pixels."""
    if frame.compression != 1 or frame.is_subsampled:
        return 0
    rows = frame.imagelength * frame.imagedepth
    row_samples = frame.samplesperpixel
    # Samples lie in one plane or each in its own.
    if frame.planarconfig != 1:
        rows *= frame.samplesperpixel
        row_samples = 1
    return rows * math.ceil(frame.imagewidth * frame.bitspersample * row_samples / 8)


def map_or_decode(series: TiffPageSeries, path: Path, *, memory_bytes: int | None) -> Array:
    """Return the values of a checked series, mapped where they lie in the file as they are."""
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
    """Byte of the file from which the values lie there as they are.

    None where they have to be decoded.
    """
    is_turned = series.keyframe.photometric == PHOTOMETRIC.MINISWHITE
    stored_dtype = series.dtype.newbyteorder(series.keyframe.parent.byteorder)
    is_native = stored_dtype == series.dtype.newbyteorder("=")
    return series.dataoffset if is_native and not is_turned else None


def turn_white(values: Array, *, path: Path, bits: int, out: Array | None = None) -> Array:
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
    # JPEG decoders turn its own colour space into red, green and blue.
    if page.photometric == PHOTOMETRIC.YCBCR:
        return page.compression in JPEG_COMPRESSIONS
    return page.photometric == PHOTOMETRIC.RGB


def _long(series: TiffPageSeries) -> list[tuple[str, int]]:
    """Letter and length of y and x and of all other axes longer than 1."""
    axes = zip(series.axes, series.shape, strict=True)
    return [(letter, n) for letter, n in axes if n > 1 or letter in "YX"]


def long_axes(series: TiffPageSeries) -> str:
    """Letters of y and x and of all other axes longer than 1."""
    return "".join(letter for letter, _ in _long(series))


def long_shape(series: TiffPageSeries) -> Shape:
    """Lengths of these axes, of which others of length 1 may have the letter."""
    return tuple(n for _, n in _long(series))


def shape_words(series: TiffPageSeries) -> str:
    """Write shape, axes and type, for example ``45 x 300 x 128 (ZYX) uint8``."""
    return f"{size_words(series.shape)} ({series.axes}) {series.dtype}"


def size_words(shape: Sequence[int]) -> str:
    """Write a shape, for example ``300 x 128``."""
    return " x ".join(map(str, shape))
