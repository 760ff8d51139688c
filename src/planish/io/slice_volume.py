"""Read volumes as folders of slices: TIFF, PNG, BMP or JPEG, with or without a scanner's log."""

import math
import sys
from collections.abc import Callable
from functools import partial
from io import SEEK_CUR, BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from PIL import Image
from tifffile import PHOTOMETRIC

from planish.core.errors import SizeError, VolumeError
from planish.core.memory import EAGER_BYTES
from planish.core.numbers import agree
from planish.core.threads import map_threads
from planish.core.typing import Array, DType, Entries, Shape
from planish.io.formats import LoadedVolume, Place, check_type, colour_attrs, grey_of
from planish.io.guard import check_memory, memory_limit, reading
from planish.io.lazy import PagedArray, Values, stored_array, supported_type, widened
from planish.io.orientation import tag_orientation
from planish.io.picture import PLUGINS, DecodedPicture, kind_of, load_picture
from planish.io.scan_log import check_extent, ordered_slices, read_scan
from planish.io.tiff import open_series, size_words
from planish.io.tiff_volume import TiffPages


class SliceHeader(NamedTuple):
    """What is known of a slice that is not decoded."""

    key: tuple[Any, ...]  # format, size and type: the same for slices that are alike
    dtype: DType  # in a TIFF file; uint8 for any other, whose values are never read as they lie
    offset: int | None = None  # from where the values lie as they are
    strip_rows: int = sys.maxsize  # what is decoded at once, if it is not all


def load(place: Place, channel: str | None, memory_bytes: int | None) -> LoadedVolume:
    """Read a folder of slices at once where it fits, otherwise slice by slice on demand."""
    scan = read_scan(place.path)
    order = ordered_slices(place.path, scan)
    values, first = load_pictures(order.files, channel=channel, memory_bytes=memory_bytes)
    attrs: Entries = colour_attrs(channel, place.path, in_colour=first.in_colour)
    stated = first.stated
    notes = (*order.notes, *first.notes)
    doubts = order.doubts
    if scan is not None:
        stated = (*scan.stated, *stated)
        notes = (*scan.notes, *notes)
        extent_doubts = check_extent(scan.log, values.shape)
        doubts = (*doubts, *scan.doubts, *extent_doubts)
        attrs["nrecon"] = scan.log.details
        if scan.log.window is not None:
            attrs["attenuation_window"] = [*scan.log.window]
    return LoadedVolume(
        values=values,
        stated=stated,
        files=order.files,
        bits=first.bits,
        attrs=attrs,
        doubts=doubts,
        notes=notes,
        orientations=tag_orientation(first.orientation),
    )


def slice_files(folder: Path) -> list[Path]:
    """Slices of a folder in their order."""
    return ordered_slices(folder, read_scan(folder)).files


def load_pictures(
    files: list[Path], *, channel: str | None, memory_bytes: int | None, photographs: bool = False
) -> tuple[Values, DecodedPicture]:
    """Grey values of pictures that are alike, dims (picture, y, x), and the first picture.

    What does not fit into the memory, or can be read where it lies, stays in the files. Photographs
    of sections are compared with each other several times, so they are only left there where they
    do not fit.
    """
    folder = files[0].parent
    limit = memory_limit(memory_bytes)
    load_one = partial(load_picture, is_slice=not photographs, memory_bytes=limit)
    first = load_one(files[0])
    colour_attrs(channel, folder, in_colour=first.in_colour)
    grey = _grey_values(first, files[0], channel)
    dtype = supported_type(grey.dtype)
    shape = (len(files), *grey.shape)
    is_decoded = photographs or _slice_header(files[0]).offset is None
    eager_bytes = limit if is_decoded else min(limit, EAGER_BYTES)
    if math.prod(shape) * dtype.itemsize <= eager_bytes:
        values = np.empty(shape, dtype)
        values[0] = grey

        def read(i: int) -> None:
            picture = load_one(files[i])
            _check_same(picture, first, file=files[i], first_file=files[0])
            values[i] = _grey_values(picture, files[i], channel)

        map_threads(read, range(1, len(files)))
        return values, first
    # Threads decode photographs while others are compared.
    needed_bytes = 4 * first.values.nbytes if photographs else 2 * grey.nbytes
    check_memory(folder, needed_bytes=needed_bytes, limit_bytes=limit)
    rows = partial(_slice_rows, load_one, files, channel, grey.shape)
    return _left_in_files(files, first, load_one, dtype, rows), first


def _left_in_files(
    files: list[Path],
    first: DecodedPicture,
    load_one: Callable[[Path], DecodedPicture],
    dtype: DType,
    rows: Callable[[int, int, int], Array],
) -> Values:
    """Values of pictures like the first, read where they lie, by strips, or by `rows`.

    ``load_one`` decodes a file, ``rows(picture, start, stop)`` some rows of one by decoding all of
    it; ``dtype`` is that of the grey values.
    """
    header = _slice_header(files[0])
    shape = (len(files), *first.values.shape[:2])
    planes: list[tuple[Path, int]] = []
    strip_rows = header.strip_rows
    for file in files:
        file_header = _slice_header(file)
        strip_rows = max(strip_rows, file_header.strip_rows)
        if file_header.key != header.key:
            _check_same(load_one(file), first, file=file, first_file=files[0])
        has_same_type = file_header.dtype == header.dtype and first.values.ndim == 2
        if has_same_type and file_header.offset is not None:
            planes.append((file, file_header.offset))
    if len(planes) == len(files):
        return widened(stored_array(planes, shape, header.dtype))
    if strip_rows < shape[1]:
        rows = partial(_strip_rows, files, shape[1:])
    return PagedArray(files[0].parent, shape, dtype, strip_rows, rows)


def _slice_rows(
    load_one: Callable[[Path], DecodedPicture],
    files: list[Path],
    channel: str | None,
    shape: Shape,
    page: int,
    start: int,
    stop: int,
) -> Array:
    """Some rows of a picture, of which all is decoded; ``shape`` is what it had when opened."""
    file = files[page]
    grey = _grey_values(load_one(file), file, channel)
    _check_unchanged(file, grey.shape, shape)
    return grey[start:stop]


def _strip_rows(
    files: list[Path],
    shape: Shape,
    page: int,
    start: int,
    stop: int,
) -> Array:
    """Decode the strips of a grey TIFF slice in which some rows lie."""
    with open_series(files[page]) as (_, series):
        _check_unchanged(files[page], series.keyframe.shape, shape)
        values = TiffPages(files[page], series)[0:1, start:stop]
    return values[0].astype(supported_type(values.dtype), copy=False)


def _check_unchanged(file: Path, shape: Shape, opened_shape: Shape) -> None:
    if shape != opened_shape:
        raise VolumeError(
            f"{file.name} is {size_words(shape)} pixels, {size_words(opened_shape)} when the folder"
            " was opened. Leave the slices alone while planish reads them."
        )


def _slice_header(file: Path) -> SliceHeader:
    """What is known of a slice by its header: of a TIFF file also where its values lie."""
    format_name = kind_of(file)
    if format_name != "tiff":
        with reading(file), file.open("rb") as stream:
            if format_name == "png":
                stream = _png_without_pixels(stream)
            image = PLUGINS[format_name](stream)
            # Pillow's own PNG class decodes the pixels to look for tags behind them.
            orientation = Image.Image.getexif(image).get(274, 1)
            resolution = image.info.get("dpi")
            key = (format_name, image.size, image.mode, resolution, orientation)
            return SliceHeader(key, np.dtype(np.uint8))
    with open_series(file) as (tif, series), reading(file):
        page = series.keyframe
        # Along x and y, and its unit.
        resolution = tuple(map(page.tags.valueof, (282, 283, 296)))
        orientation = page.tags.valueof(274, default=1)
        page_facts = (page.photometric, page.bitspersample, page.compression, resolution)
        shape_facts = (series.shape, series.axes, str(series.dtype))
        key = (format_name, *shape_facts, *page_facts, orientation)
        dtype = series.dtype.newbyteorder(tif.byteorder)
        if page.photometric != PHOTOMETRIC.MINISBLACK:
            return SliceHeader(key, dtype)
        if series.dataoffset is not None or page.ndim != 2:
            return SliceHeader(key, dtype, series.dataoffset)
        strip_rows = page.tilelength if page.is_tiled else page.rowsperstrip
        return SliceHeader(key, dtype, strip_rows=strip_rows)


def _png_without_pixels(stream: BinaryIO) -> BytesIO:
    """Copy a PNG file but for its pixels: tags may stand before and behind them."""
    parts = [stream.read(8)]  # the signature
    while head := stream.read(8):
        n_bytes = int.from_bytes(head[:4], "big") + 4  # with a checksum
        if head[4:] == b"IDAT":
            stream.seek(n_bytes, SEEK_CUR)
        else:
            parts += [head, stream.read(n_bytes)]
    return BytesIO(b"".join(parts))


def _grey_values(picture: DecodedPicture, file: Path, channel: str | None) -> Array:
    """Grey values of a picture in its own type.

    Colour becomes luminance where no channel is chosen.
    """
    check_type(picture.values.dtype, file)
    if picture.values.ndim == 2:
        return picture.values
    if picture.colour == "grey":
        return picture.values[..., 0]
    if picture.colour == "rgb":
        return grey_of(picture.values, channel=channel)
    raise VolumeError(
        f"{file.name} is neither grey nor red, green and blue:"
        f" {size_words(picture.values.shape[:2])} pixels with {picture.values.shape[2]} samples."
        " Export all pictures in grey."
    )


def _check_same(
    picture: DecodedPicture, first: DecodedPicture, *, file: Path, first_file: Path
) -> None:
    """Refuse a picture of another colour, size, type, orientation or pixel size than the first."""
    check_type(picture.values.dtype, file)
    features = (("is", "colour"), ("is", "size"), ("has", "type"))
    for (verb, feature), kind, first_kind in zip(
        features, _kind(picture), _kind(first), strict=True
    ):
        if kind != first_kind:
            raise VolumeError(
                f"{file.name} {verb} {kind}, {first_file.name} {verb} {first_kind}. All slices need"
                f" the same {feature}: export them again or remove the odd one."
            )
    if picture.orientation != first.orientation:
        raise VolumeError(
            f"{file.name} has the orientation tag {picture.orientation}, {first_file.name}"
            f" {first.orientation}. All slices need the same: export them again or remove the odd"
            " one."
        )
    for stated, first_stated in zip(picture.stated, first.stated, strict=False):
        for a, b in zip(stated.um, first_stated.um, strict=True):
            if a is not None and b is not None and not agree(a, b):
                raise SizeError(
                    f"{file.name} states a pixel size of {a:g} um, {first_file.name} one of {b:g}"
                    " um. All slices need the same: remove the wrong slices or their resolution"
                    " tags."
                )


def _kind(picture: DecodedPicture) -> tuple[str, str, str]:
    """Colour, size and type of a picture, in words."""
    size_text = size_words(picture.values.shape[:2])
    return picture.colour, f"{size_text} pixels", f"{picture.values.dtype} values"
