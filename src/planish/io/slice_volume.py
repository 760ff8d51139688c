"""Volumes as folders of slices: TIFF, PNG, BMP or JPEG, with the log of NRecon or without it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tifffile import PHOTOMETRIC

from planish.core.arrays import agree
from planish.core.errors import FileError, SizeError, VolumeError
from planish.io.formats import LoadedVolume, Place, check_type, colour_attrs, grey_of
from planish.io.guard import check_memory, default_memory_limit, reading
from planish.io.lazy import EAGER_BYTES, PagedArray, supported_type
from planish.io.picture import ADVICE, PLUGINS, DecodedPicture, kind_of, load_picture
from planish.io.slices import Scan, list_slices, named_slices, read_scan
from planish.io.tiff import open_series, size_words, stored_rows


def load(place: Place, channel: str | None, memory_bytes: int | None) -> LoadedVolume:
    """Read a folder of slices: at once where it fits, otherwise slice by slice when they are asked for."""
    scan = read_scan(place.path)
    files = slice_files(place.path, scan)
    values, first = load_pictures(files, channel=channel, memory_bytes=memory_bytes)
    attrs: dict[str, Any] = colour_attrs(channel, place.path, in_colour=first.in_colour)
    stated = first.stated
    if scan is not None:
        if any(wanted not in (None, n) for wanted, n in zip(scan.extent, values.shape[1:], strict=True)):
            raise VolumeError(
                f"{files[0].name} is {size_words(values.shape[1:])} pixels, {scan.log.name} states {scan.extent[0]} x "
                f"{scan.extent[1]}. If the slices were cropped, move the log elsewhere and give --voxel-um."
            )
        attrs |= {"nrecon": scan.details} | ({} if scan.window is None else {"attenuation_window": list(scan.window)})
        stated = (scan.stated, *stated)
    return LoadedVolume(values=values, stated=stated, files=files, bits=first.bits, attrs=attrs)


def slice_files(folder: Path, scan: Scan | None) -> list[Path]:
    """Slices of a folder in their order, as the log names them or in the order of their numbers."""
    files = list_slices(folder) if scan is None or scan.prefix is None else named_slices(scan, folder)
    if scan is not None and scan.count not in (None, len(files)):
        raise VolumeError(
            f"{scan.log.name} states {scan.count} sections, {folder.name} holds {len(files)}. Add the missing slices, "
            "or move the log elsewhere and give --voxel-um."
        )
    if len(files) < 2:
        raise VolumeError(f"{folder.name} holds one slice only, {files[0].name}. Needed are all slices of the volume.")
    return files


def load_pictures(
    files: list[Path], *, channel: str | None, memory_bytes: int | None, photographs: bool = False
) -> tuple[NDArray[Any] | PagedArray, DecodedPicture]:
    """Grey values of pictures that are alike, dims (picture, y, x), and the first picture.

    What does not fit into the memory, or can be read where it lies, stays in the files. Photographs of sections are
    compared with each other several times, so they are only left there where they do not fit.
    """
    folder = files[0].parent
    first = load_picture(files[0], memory_bytes=memory_bytes)
    colour_attrs(channel, folder, in_colour=first.in_colour)
    grey = _grey_values(first, files[0], channel)
    dtype = supported_type(grey.dtype)
    limit = default_memory_limit() if memory_bytes is None else memory_bytes
    kind, stored, offset = _slice_header(files[0])
    eager = limit if photographs or offset is None else min(limit, EAGER_BYTES)
    if len(files) * grey.size * dtype.itemsize <= eager:
        values = np.empty((len(files), *grey.shape), dtype)
        values[0] = grey
        for i, file in enumerate(files[1:], start=1):
            picture = load_picture(file, memory_bytes=memory_bytes)
            _check_same(picture, first, file=file, first_file=files[0])
            values[i] = _grey_values(picture, file, channel)
        return values, first
    # Threads decode photographs while others are compared.
    check_memory(folder, needed_bytes=4 * first.values.nbytes if photographs else 2 * grey.nbytes, limit_bytes=limit)
    offsets: list[int] = []
    for file in files:
        its_kind, its_stored, its_offset = _slice_header(file)
        if its_kind != kind:
            _check_same(load_picture(file, memory_bytes=limit), first, file=file, first_file=files[0])
        if its_offset is not None and its_stored == stored and grey.ndim == first.values.ndim:
            offsets.append(its_offset)
    return SliceFiles(files, offsets, stored, channel, (grey.shape[0], grey.shape[1]), dtype), first


class SliceFiles(PagedArray):
    """Slices as the pages of a volume: rows are read where they lie in the files as they are, others decoded whole.

    ``offsets`` are where the values of the type ``stored`` lie in the files as they are; slices are read in place if
    there is one for every file.
    """

    def __init__(
        self, files: list[Path], offsets: list[int], stored: np.dtype[Any], channel: str | None,
        extent: tuple[int, int], dtype: np.dtype[Any],
    ) -> None:  # fmt: skip
        self.files, self.offsets, self.stored, self.channel, self.extent = files, offsets, stored, channel, extent
        self.in_place = len(offsets) == len(files)
        unit_rows = 1 if self.in_place else extent[0]
        super().__init__(files[0].parent, (len(files), *extent), dtype, unit_rows)

    def __reduce__(self) -> tuple[Any, ...]:
        """Another process decodes anew."""
        return SliceFiles, (self.files, self.offsets, self.stored, self.channel, self.extent, self.dtype)

    def rows(self, page: int, start: int, stop: int) -> NDArray[Any]:
        """Read rows of a slice, or decode the whole slice."""
        file = self.files[page]
        if self.in_place:
            offset = self.offsets[page] + start * self.extent[1] * self.stored.itemsize
            with file.open("rb") as opened:
                return stored_rows(opened, file, offset, (stop - start, self.extent[1]), self.stored)
        grey = _grey_values(load_picture(file), file, self.channel)
        if grey.shape != self.extent:
            raise VolumeError(
                f"{file.name} is {size_words(grey.shape)} pixels, {size_words(self.extent)} when the folder was "
                "opened. Leave the slices alone while planish reads them."
            )
        return grey[start:stop]


def _slice_header(file: Path) -> tuple[tuple[Any, ...], np.dtype[Any], int | None]:
    """Read the header of a slice, which is not decoded.

    Format, size and type, which slices that decode alike share; the type in the file, and where in it the values lie
    as they are, if they do.
    """
    name = kind_of(file)
    if name != "tiff":
        with reading(file), file.open("rb") as opened:
            image = PLUGINS[name](opened)
            return (name, image.size, image.mode, image.info.get("dpi")), np.dtype(np.uint8), None
    with open_series(file, error=FileError, advice=ADVICE) as (tif, series), reading(file):
        page = series.keyframe
        resolution = tuple(page.tags.valueof(code) for code in (282, 283, 296))
        meta = (page.photometric, page.bitspersample, page.compression, resolution)
        kind = (name, series.shape, series.axes, str(series.dtype), *meta)
        offset = series.dataoffset if page.photometric == PHOTOMETRIC.MINISBLACK else None
        return kind, series.dtype.newbyteorder(tif.byteorder), offset


def _grey_values(picture: DecodedPicture, file: Path, channel: str | None) -> NDArray[Any]:
    """Grey values of a picture in its own type; colour becomes luminance where no channel is chosen."""
    check_type(picture.values.dtype, file)
    if picture.values.ndim == 2:
        return picture.values
    if picture.colour == "grey":
        return picture.values[..., 0]
    if picture.colour == "rgb":
        return grey_of(picture.values, channel=channel)
    raise VolumeError(
        f"{file.name} is neither grey nor red, green and blue: {size_words(picture.values.shape[:2])} pixels with "
        f"{picture.values.shape[2]} samples. Export all pictures in grey."
    )


def _check_same(picture: DecodedPicture, first: DecodedPicture, *, file: Path, first_file: Path) -> None:
    check_type(picture.values.dtype, file)
    facts = [
        (p.colour, f"{size_words(p.values.shape[:2])} pixels", f"{p.values.dtype} values") for p in (picture, first)
    ]
    for verb, feature, a, b in zip(("is", "is", "has"), ("colour", "size", "type"), *facts, strict=True):
        if a != b:
            raise VolumeError(
                f"{file.name} {verb} {a}, {first_file.name} {verb} {b}. All slices need the same {feature}: export "
                "them again or remove the odd one."
            )
    for stated, first_stated in zip(picture.stated, first.stated, strict=False):
        for a, b in zip(stated.um, first_stated.um, strict=True):
            if a is not None and b is not None and not agree(a, b):
                raise SizeError(
                    f"{file.name} states a pixel size of {a:g} um, {first_file.name} one of {b:g} um. "
                    "All slices need the same: remove the wrong slices or their resolution tags."
                )
