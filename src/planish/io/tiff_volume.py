"""Volumes in one TIFF file: classic, BigTIFF, ImageJ, OME; mapped where they lie there as they are."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tifffile import TiffPageSeries

from planish.core.errors import VolumeError
from planish.io.colour import colour_attrs, refuse_channel, to_grey
from planish.io.formats import Place
from planish.io.guard import check_memory, reading, size_of_file
from planish.io.lazy import (
    ChangedArray,
    FileArray,
    MappedArray,
    PagedArray,
    as_supported,
    is_small,
    mapped,
    settle,
    turned,
)
from planish.io.loaded import ADVICE, LoadedVolume, check_type
from planish.io.picture import kind_of, long_axes
from planish.io.tiff import (
    JPEG_COMPRESSIONS,
    PALETTE,
    RGB,
    WHITE_IS_ZERO,
    YCBCR,
    check_data,
    map_or_decode,
    only_series,
    open_tiff,
    shape_words,
    turn_white,
)
from planish.io.tiff_pages import TiffPages, can_page
from planish.io.tiff_sizes import stated_by_tiff

SLICE_AXES = "ZIQ"
"""Letters for an axis of slices: declared as such, or pages without a declared meaning."""

MANY_CHANNELS = 16
MEANINGS = {"C": "channels", "T": "time points", "S": "colour samples"}


def load(place: Place, *, channel: str | None, memory_bytes: int | None) -> LoadedVolume:
    """Read a TIFF stack in one file."""
    path = place.path
    kind = kind_of(path)
    if kind != "tiff":
        raise VolumeError(
            f"{path.name} is one {kind.upper()} picture, not a volume. Give a TIFF stack or a folder of slices."
        )
    with open_tiff(path) as tif:
        series = only_series(tif, path, error=VolumeError, advice=ADVICE)
        check_data(series, path)
        axes = volume_axes(series, path)
        page = series.keyframe
        check_type(series.dtype, path)
        if page.photometric == PALETTE and not tif.is_imagej and not is_grey_ramp(page.colormap):
            raise VolumeError(f"{path.name} has a colour palette. {ADVICE}")
        if "S" not in axes:
            refuse_channel(channel, path)
        stated = stated_by_tiff(tif, page, path)
        array = stack(series, path, axes, channel=channel, memory_bytes=memory_bytes)
        bits = int(page.bitspersample)
        values = settle(as_supported(array, path), path, memory_bytes=memory_bytes)
    return LoadedVolume(
        values=values,
        stated=stated,
        full_scale=None if values.dtype.kind == "f" else min(2**bits - 1, int(np.iinfo(values.dtype).max)),
        file_bytes=size_of_file(path),
        attrs=colour_attrs(channel) if "S" in axes else {},
    )


def stack(
    series: TiffPageSeries, path: Path, axes: str, *, channel: str | None, memory_bytes: int | None
) -> NDArray[Any] | FileArray:
    """Return the values of a checked series: mapped, left in its pages, or decoded."""
    shape = tuple(n for n, axis in zip(series.shape, series.axes, strict=True) if axis in axes)
    colour = to_grey(channel) if "S" in axes else None
    white = series.keyframe.photometric == WHITE_IS_ZERO
    with reading(path):
        offset = series.dataoffset
        stored = series.dtype.newbyteorder(series.keyframe.parent.byteorder)
        paged = offset is None and can_page(series, shape[0])
    if offset is not None and colour is None and not white:
        return mapped(path, shape, stored, offset=offset)
    if offset is not None and colour is not None:
        order = (0, 2, 3, 1) if axes[1] == "S" else (0, 1, 2, 3)
        inner = turned(MappedArray(path, shape, stored, offset=offset), order)
        return ChangedArray(inner, colour, dtype=inner.dtype, path=path)
    if offset is not None and series.dtype.kind == "u":
        inner = MappedArray(path, shape, stored, offset=offset)
        bits = series.keyframe.bitspersample
        return ChangedArray(inner, BlackIsZero(path, bits), dtype=inner.dtype, path=path)
    if paged:
        zyx = (shape[0], series.keyframe.imagelength, series.keyframe.imagewidth)
        with reading(path):
            pages = TiffPages(path, series, change=colour)
        array = PagedArray(pages, zyx, series.dtype.newbyteorder("="), path)
        if colour is not None or not is_small(array, memory_bytes=memory_bytes):
            return array
    whole = map_or_decode(series, path, memory_bytes=memory_bytes).reshape(shape)
    if colour is None:
        return whole
    check_memory(path, needed_bytes=whole.nbytes + math.prod(shape) // 3, limit_bytes=memory_bytes)
    return np.stack([colour(np.moveaxis(p, 0, -1) if axes[1] == "S" else p) for p in whole])


class BlackIsZero:
    """Turns grey values round; can be sent to another process."""

    def __init__(self, path: Path, bits: int) -> None:
        self.path, self.bits = path, bits

    def __call__(self, values: NDArray[Any]) -> NDArray[Any]:
        """Turn a copy round."""
        return turn_white(np.array(values), self.path, bits=self.bits)


def volume_axes(series: TiffPageSeries, path: Path) -> str:
    """Return the axes of a stack that are longer than 1: slices, y and x, and the samples of a stack in colour."""
    axes = long_axes(series)
    grey = axes.replace("S", "")
    if len(grey) == 3 and grey[0] in SLICE_AXES and grey[1:] == "YX" and (axes == grey or is_rgb(series)):
        return axes
    # ImageJ and tifffile file a stack of unnamed pages as channels; nothing has so many channels, so these are slices.
    if len(axes) == 3 and axes[0] == "C" and axes[1:] == "YX" and series.shape[series.axes.index("C")] >= MANY_CHANNELS:
        return axes
    further = {a: n for a, n in zip(series.axes, series.shape, strict=True) if n > 1 and a in MEANINGS}
    if further:
        found = " and ".join(f"{n} {MEANINGS[a]}" for a, n in further.items())
        hint = (
            ADVICE
            if any(a in SLICE_AXES for a in axes) or "S" in further
            else f"If these are the slices, say so in the file (ImageJ: Image > Properties). Otherwise: {ADVICE}"
        )
        raise VolumeError(f"{path.name} has {found}: {shape_words(series)}. {hint}")
    if axes == "YX":
        raise VolumeError(
            f"{path.name} has one page, not a stack: {shape_words(series)}. Give all slices, in one file or one folder."
        )
    raise VolumeError(f"{path.name} is not a volume with the axes z, y, x: {shape_words(series)}. {ADVICE}")


def is_rgb(series: TiffPageSeries) -> bool:
    """Whether the samples of a pixel are red, green and blue, with or without further ones."""
    axes = long_axes(series)
    samples = series.shape[series.axes.index("S")]
    page = series.keyframe
    colours = page.photometric == RGB or (page.photometric == YCBCR and page.compression in JPEG_COMPRESSIONS)
    return colours and samples in (3, 4) and axes.index("S") in (1, 3)


def is_grey_ramp(colormap: NDArray[Any] | None) -> bool:
    """Whether a palette only spreads grey values over the range, in order."""
    if colormap is None:
        return False
    red, green, blue = np.asarray(colormap).astype(np.int64)
    return bool(np.array_equal(red, green) and np.array_equal(red, blue) and np.all(np.diff(red) > 0))
