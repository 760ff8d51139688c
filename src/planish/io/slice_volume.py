"""Volumes as folders of slices: TIFF, PNG, BMP or JPEG, with the log of NRecon or without it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import BmpImagePlugin, JpegImagePlugin, PngImagePlugin

from planish.core.errors import FileError, SizeError, VolumeError
from planish.io.colour import colour_attrs, grey_of, refuse_channel
from planish.io.formats import Place
from planish.io.guard import check_memory, default_memory_limit, reading, size_of_file
from planish.io.lazy import EAGER_BYTES, PagedArray
from planish.io.loaded import LoadedVolume, check_type, supported_type
from planish.io.nrecon import Scan, check_count, check_extent, read_scan, scan_attrs, slices_of
from planish.io.picture import Picture, kind_of, load_picture
from planish.io.sizes import agree
from planish.io.slices import list_slices
from planish.io.tiff import BLACK_IS_ZERO, check_data, only_series, open_tiff, size_words
from planish.io.tiff_chain import damaged


def load(place: Place, *, channel: str | None, memory_bytes: int | None) -> LoadedVolume:
    """Read a folder of slices: at once where it fits, otherwise slice by slice when they are asked for."""
    folder = place.path
    scan = read_scan(folder)
    files = slice_files(folder, scan)
    values, first = load_pictures(files, channel=channel, memory_bytes=memory_bytes)
    if scan is not None:
        check_count(scan, folder, len(files))
        check_extent(scan, files[0], *values.shape[1:])
    return LoadedVolume(
        values=values,
        stated=first.stated if scan is None else (scan.stated, *first.stated),
        full_scale=None if values.dtype.kind == "f" else first.full_scale,
        file_bytes=sum(size_of_file(file) for file in files),
        attrs={**({} if scan is None else scan_attrs(scan)), **(colour_attrs(channel) if first.in_colour else {})},
    )


def slice_files(folder: Path, scan: Scan | None) -> list[Path]:
    """Slices of a folder in their order, as the log names them or in the order of their numbers."""
    files = (None if scan is None else slices_of(scan, folder)) or list_slices(folder)
    if len(files) < 2:
        raise VolumeError(f"{folder.name} holds one slice only, {files[0].name}. Needed are all slices of the volume.")
    return files


def load_pictures(
    files: list[Path], *, channel: str | None, memory_bytes: int | None, photographs: bool = False
) -> tuple[NDArray[Any] | PagedArray, Picture]:
    """Grey values of pictures that are alike, dims (picture, y, x), and the first picture.

    What does not fit into the memory, or can be read where it lies, stays in the files. Photographs of sections are
    compared with each other several times, so they are only left there where they do not fit.
    """
    folder = files[0].parent
    first = load_picture(files[0], memory_bytes=memory_bytes)
    if not first.in_colour:
        refuse_channel(channel, folder)
    grey = grey_values(first, files[0], channel)
    dtype = supported_type(grey.dtype)
    shape = (len(files), *grey.shape)
    limit = default_memory_limit() if memory_bytes is None else memory_bytes
    head = Head(files[0])
    in_place = head.offset is not None and not photographs
    if len(files) * grey.size * dtype.itemsize <= (min(limit, EAGER_BYTES) if in_place else limit):
        values = np.empty(shape, dtype)
        for i, file in enumerate(files):
            picture = first if i == 0 else load_picture(file, memory_bytes=memory_bytes)
            check_same(picture, first, file=file, first_file=files[0])
            values[i] = grey_values(picture, file, channel)
        return values, first
    # Threads decode photographs while others are compared.
    check_memory(folder, needed_bytes=4 * first.values.nbytes if photographs else 2 * grey.nbytes, limit_bytes=limit)
    offsets: list[int | None] = []
    for file in files:
        other = Head(file)
        if other.kind != head.kind:
            check_same(load_picture(file, memory_bytes=limit), first, file=file, first_file=files[0])
        offsets.append(other.offset if other.stored == head.stored else None)
    pages = SliceFiles(files, offsets, head.stored, channel if first.in_colour else None, first, grey.shape)
    return PagedArray(pages, shape, dtype, folder), first


def grey_values(picture: Picture, file: Path, channel: str | None) -> NDArray[Any]:
    """Grey values of a picture in its own type; colour becomes luminance where no channel is chosen."""
    check_type(picture.values.dtype, file)
    if picture.values.ndim == 2:
        return picture.values
    if picture.colour == "grey":
        return picture.values[..., 0]
    if picture.colour == "rgb":
        return grey_of(picture.values, channel=channel or "luminance")
    raise VolumeError(
        f"{file.name} is neither grey nor red, green and blue: {size_words(picture.values.shape[:2])} pixels with "
        f"{picture.values.shape[2]} samples. Export all pictures in grey."
    )


def check_same(picture: Picture, first: Picture, *, file: Path, first_file: Path) -> None:
    """Refuse a picture that differs from the first in colour, size, type or pixel size."""
    check_type(picture.values.dtype, file)
    if picture.colour != first.colour:
        raise VolumeError(
            f"{file.name} is {picture.colour}, {first_file.name} is {first.colour}. All of them need the same: export "
            "them again."
        )
    if picture.values.shape[:2] != first.values.shape[:2]:
        raise VolumeError(
            f"{file.name} is {size_words(picture.values.shape[:2])} pixels, {first_file.name} is "
            f"{size_words(first.values.shape[:2])}. All slices need the same size: export them again or remove the odd "
            "one."
        )
    if picture.values.dtype != first.values.dtype:
        raise VolumeError(
            f"{file.name} has {picture.values.dtype} values, {first_file.name} has {first.values.dtype}. "
            "All slices need the same type: export them again or remove the odd one."
        )
    for one, other in zip(picture.stated, first.stated, strict=False):
        for a, b in zip(one.um, other.um, strict=True):
            if a is not None and b is not None and not agree(a, b):
                raise SizeError(
                    f"{file.name} states a pixel size of {a:g} um, {first_file.name} one of {b:g} um. "
                    "All slices need the same: remove the wrong slices or their resolution tags."
                )


class Head:
    """What is known of a slice before it is decoded.

    Attributes
    ----------
    kind : tuple
        Format, size and type; slices with the same kind decode to the same shape and type.
    offset : int or None
        Where the values lie in the file as they are.
    stored : dtype
        Their type there.
    """

    def __init__(self, file: Path) -> None:
        self.offset: int | None = None
        self.stored = np.dtype(np.uint8)
        name = kind_of(file)
        if name != "tiff":
            plugin = {"png": PngImagePlugin.PngImageFile, "jpeg": JpegImagePlugin.JpegImageFile}
            with reading(file), file.open("rb") as opened:
                image = plugin.get(name, BmpImagePlugin.BmpImageFile)(opened)
                self.kind: tuple[Any, ...] = (name, image.size, image.mode, image.info.get("dpi"))
            return
        with open_tiff(file) as tif:
            series = only_series(tif, file, error=FileError, advice="One picture is needed: save it alone.")
            check_data(series, file)
            page = series.keyframe
            with reading(file):
                resolution = tuple(page.tags.valueof(code) for code in (282, 283, 296))
                meta = (page.photometric, page.bitspersample, page.compression, resolution)
                self.kind = (name, series.shape, series.axes, str(series.dtype), *meta)
                if page.photometric == BLACK_IS_ZERO:
                    self.offset = series.dataoffset
                self.stored = series.dtype.newbyteorder(tif.byteorder)


class SliceFiles:
    """Slices as the pages of a volume: rows are read where they lie in the files as they are, others decoded whole."""

    def __init__(
        self, files: list[Path], offsets: list[int | None], stored: np.dtype[Any], channel: str | None, first: Picture,
        extent: tuple[int, ...],
    ) -> None:  # fmt: skip
        self.files, self.offsets, self.stored, self.channel, self.extent = files, offsets, stored, channel, extent
        self.in_place = first.values.ndim == 2 and all(offset is not None for offset in offsets)
        self.unit_rows = 1 if self.in_place else extent[0]

    def rows(self, page: int, start: int, stop: int) -> NDArray[Any]:
        """Read rows of a slice, or decode the whole slice."""
        file, offset = self.files[page], self.offsets[page]
        if self.in_place and offset is not None:
            row_bytes = self.extent[1] * self.stored.itemsize
            with file.open("rb") as opened:
                opened.seek(offset + start * row_bytes)
                data = opened.read((stop - start) * row_bytes)
            if len(data) < (stop - start) * row_bytes:
                raise damaged(file, f"it ends before row {stop}")
            return np.frombuffer(data, self.stored).reshape(stop - start, self.extent[1])
        grey = grey_values(load_picture(file), file, self.channel)
        if grey.shape != self.extent:
            raise VolumeError(
                f"{file.name} is {size_words(grey.shape)} pixels, {size_words(self.extent)} when the folder was "
                "opened. Leave the slices alone while planish reads them."
            )
        return grey[start:stop]
