"""Volumes as folders of slices: TIFF, PNG, BMP or JPEG, with the log of NRecon or without it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import BmpImagePlugin, JpegImagePlugin, PngImagePlugin

from planish.core.errors import FileError, SizeError, VolumeError
from planish.io.colour import colour_attrs, refuse_channel, to_grey
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

ToGrey = Callable[[NDArray[Any]], NDArray[Any]]


def load(place: Place, *, channel: str | None, memory_bytes: int | None) -> LoadedVolume:
    """Read a folder of slices: at once where it fits, otherwise slice by slice when they are asked for.

    Parameters
    ----------
    place : Place
    channel : str or None
        What is taken of slices in colour.
    memory_bytes : int or None

    Returns
    -------
    LoadedVolume

    Raises
    ------
    FileError, VolumeError, SizeError, InputError, ResourceError
        As :func:`planish.io.read_volume`.
    """
    folder = place.path
    scan = read_scan(folder)
    files = slice_files(folder, scan)
    first = load_picture(files[0], memory_bytes=memory_bytes)
    rgb = first.values.ndim == 3 and first.colour == "rgb"
    colour = to_grey(channel) if rgb else None
    if not rgb:
        refuse_channel(channel, folder)
    grey = grey_slice(first, files[0], colour)
    if scan is not None:
        check_count(scan, folder, len(files))
        check_extent(scan, files[0], *grey.shape)
    dtype = supported_type(grey.dtype)
    shape = (len(files), *grey.shape)
    limit = default_memory_limit() if memory_bytes is None else memory_bytes
    heads = SliceHeads(files[0], colour)
    needed = len(files) * grey.size * dtype.itemsize
    if needed <= (limit if heads.first.offset is None else min(limit, EAGER_BYTES)):
        values: NDArray[Any] | PagedArray = np.empty(shape, dtype)
        for i, file in enumerate(files):
            picture = first if i == 0 else load_picture(file, memory_bytes=memory_bytes)
            values[i] = checked_slice(picture, first, colour, file=file, first_file=files[0])
    else:
        check_memory(folder, needed_bytes=2 * grey.nbytes, limit_bytes=limit)
        offsets = [heads.check(file, first, memory_bytes=limit) for file in files]
        values = PagedArray(SliceFiles(files, offsets, heads.first, colour, grey.shape), shape, dtype, folder)
    return LoadedVolume(
        values=values,
        stated=first.stated if scan is None else (scan.stated, *first.stated),
        full_scale=None if dtype.kind == "f" else first.full_scale,
        file_bytes=sum(size_of_file(file) for file in files),
        attrs={**({} if scan is None else scan_attrs(scan)), **(colour_attrs(channel) if rgb else {})},
    )


def slice_files(folder: Path, scan: Scan | None) -> list[Path]:
    """Slices of a folder in their order, as the log names them or as their numbers tell.

    Raises
    ------
    FileError, VolumeError
        If there are none, one is missing, or they are not one series.
    """
    files = (None if scan is None else slices_of(scan, folder)) or list_slices(folder)
    if len(files) < 2:
        raise VolumeError(f"{folder.name} holds one slice only, {files[0].name}. Needed are all slices of the volume.")
    return files


def grey_slice(picture: Picture, file: Path, colour: ToGrey | None) -> NDArray[Any]:
    """Grey values of a slice.

    Raises
    ------
    VolumeError
        If it is in colour and `colour` is None, or in other samples than red, green and blue.
    """
    check_type(picture.values.dtype, file)
    if picture.values.ndim == 2 and colour is None:
        return picture.values
    if picture.values.ndim == 2:
        raise VolumeError(f"{file.name} is grey, the slice before it is in colour. Export all slices in grey.")
    if picture.colour == "rgb" and colour is not None:
        return colour(picture.values)
    raise VolumeError(
        f"{file.name} is not grey: {size_words(picture.values.shape[:2])} pixels with "
        f"{picture.values.shape[2]} colour samples. Export all slices in grey."
    )


def checked_slice(
    picture: Picture, first: Picture, colour: ToGrey | None, *, file: Path, first_file: Path
) -> NDArray[Any]:
    """Grey values of a slice that is as the first."""
    grey = grey_slice(picture, file, colour)
    check_same(picture, first, file=file, first_file=first_file)
    return grey


def check_same(picture: Picture, first: Picture, *, file: Path, first_file: Path) -> None:
    """Refuse a slice that differs from the first in size, type or pixel size.

    Raises
    ------
    VolumeError
        If size or type differ.
    SizeError
        If the metadata state another pixel size.
    """
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
    """What can be said about a slice before it is decoded.

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


class SliceHeads:
    """Compares the slices of a folder with the first one, without decoding those that are of the same kind."""

    def __init__(self, first_file: Path, colour: ToGrey | None) -> None:
        self.first_file, self.colour, self.first = first_file, colour, Head(first_file)

    def check(self, file: Path, first: Picture, *, memory_bytes: int) -> int | None:
        """Return where the values of a slice lie; None where they have to be decoded."""
        head = Head(file)
        if head.kind != self.first.kind:
            picture = load_picture(file, memory_bytes=memory_bytes)
            checked_slice(picture, first, self.colour, file=file, first_file=self.first_file)
        return head.offset if head.stored == self.first.stored else None


class SliceFiles:
    """Slices as the pages of a volume: rows are read where they lie in the files as they are, others decoded whole."""

    def __init__(
        self, files: list[Path], offsets: list[int | None], head: Head, colour: ToGrey | None, extent: tuple[int, ...]
    ) -> None:
        self.files, self.offsets, self.colour = files, offsets, colour
        self.stored, self.extent = head.stored, extent
        self.in_place = colour is None and all(offset is not None for offset in offsets)
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
        grey = grey_slice(load_picture(file), file, self.colour)
        if grey.shape != self.extent:
            raise VolumeError(
                f"{file.name} is {size_words(grey.shape)} pixels, {size_words(self.extent)} when the folder was "
                "opened. Leave the slices alone while planish reads them."
            )
        return grey[start:stop]
