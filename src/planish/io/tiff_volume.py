"""Read volumes in one TIFF file.

They are mapped where they lie there as they are, otherwise decoded by strips or tiles.
"""

import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tifffile import PHOTOMETRIC, TiffFrame, TiffPage, TiffPageSeries

from planish.core.errors import FileError, VolumeError
from planish.io.axes import LEAST_SLICES, slices_note
from planish.io.formats import ADVICE, LoadedVolume, Place, check_type, colour_attrs, grey_of
from planish.io.guard import check_memory, memory_limit, reading
from planish.io.lazy import (
    Change,
    FileArray,
    PagedArray,
    StoredArray,
    Values,
    ViewArray,
    is_small,
    mapped,
    stored_planes,
)
from planish.io.orientation import tag_orientation
from planish.io.picture import kind_of
from planish.io.sizes import stated_by_tiff
from planish.io.tiff import (
    JPEG_COMPRESSIONS,
    damaged,
    has_rgb,
    long_axes,
    map_or_decode,
    notes_on_reading,
    open_series,
    shape_words,
    turn_white,
)

# Letters for an axis of slices: declared as such, or pages without a declared meaning.
SLICE_AXES = "ZIQ"
MEANINGS = {"C": "channels", "T": "time points", "S": "colour samples"}


def load(place: Place, channel: str | None, memory_bytes: int | None) -> LoadedVolume:
    """Read a TIFF stack in one file."""
    path = place.path
    kind = kind_of(path)
    if kind != "tiff":
        raise VolumeError(
            f"{path.name} is one {kind.upper()} picture. Give a TIFF stack or a folder of slices."
        )
    with open_series(path, error=VolumeError, advice=ADVICE) as (tif, series):
        axes, notes = _volume_axes(series, path)
        page = series.keyframe
        orientation = tag_orientation(page.tags.valueof(274, default=1))
        check_type(series.dtype, path)
        if page.photometric == PHOTOMETRIC.PALETTE and not tif.is_imagej:
            # A palette may only spread grey values over the range, in order.
            palette = (
                np.zeros((3, 2))
                if page.colormap is None
                else np.asarray(page.colormap).astype(np.int64)
            )
            if not (np.all(palette == palette[0]) and np.all(np.diff(palette[0]) > 0)):
                raise VolumeError(f"{path.name} has a colour palette. {ADVICE}")
        change: Change | None = partial(grey_of, channel=channel) if "S" in axes else None
        if page.photometric == PHOTOMETRIC.MINISWHITE:
            change = partial(turn_white, path=path, bits=page.bitspersample)
        return LoadedVolume(
            attrs=colour_attrs(channel, path, in_colour="S" in axes),
            values=_series_values(series, path, axes, change, memory_limit(memory_bytes)),
            stated=stated_by_tiff(tif, page, path),
            files=[path],
            bits=int(page.bitspersample),
            notes=(*notes, *notes_on_reading(tif, page, path)),
            orientations=[] if orientation is None else [orientation],
        )


def _series_values(
    series: TiffPageSeries, path: Path, axes: str, change: Change | None, limit_bytes: int
) -> Values:
    frame = series.keyframe
    # As long_axes: axes of length 1 may have the same letter as the slices.
    shape = tuple(n for n, a in zip(series.shape, series.axes, strict=True) if n > 1 or a in "YX")
    stored_dtype = series.dtype.newbyteorder(frame.parent.byteorder)
    array: FileArray | None = None
    with reading(path):
        offset = series.dataoffset
        pages = [page for page in series if page is not None] if offset is None else []
        if offset is not None:
            if change is None:
                return mapped(path, shape, stored_dtype, offset=offset)
            array = stored_planes(path, shape, stored_dtype, offset=offset)
        # One page for each slice, and one plane in each page.
        elif (
            1 in (frame.planarconfig, frame.samplesperpixel)
            and frame.imagedepth == 1
            and len(pages) == shape[0]
        ):
            if frame.is_final and all(map(_is_joined, pages)):
                array = StoredArray(
                    [(path, page.dataoffsets[0]) for page in pages], shape, stored_dtype
                )
            elif not frame.is_subsampled:
                array = TiffPages(path, series)
    if array is None or (
        isinstance(array, TiffPages) and "S" not in axes and is_small(array, limit_bytes)
    ):
        values = map_or_decode(series, path, memory_bytes=limit_bytes).reshape(shape)
        if change is None or "S" not in axes:
            return values
        check_memory(
            path, needed_bytes=values.nbytes + math.prod(shape) // 3, limit_bytes=limit_bytes
        )
        return np.stack(
            [change(np.moveaxis(plane, 0, -1) if axes[1] == "S" else plane) for plane in values]
        )
    axis_order = (0, 2, 3) if axes[1] == "S" else (0, 1, 2)
    return array if change is None else ViewArray(array, axis_order, change)


def _is_joined(page: TiffPage | TiffFrame) -> bool:
    segment_ends = (
        start + count for start, count in zip(page.dataoffsets, page.databytecounts, strict=False)
    )
    return all(end == start for end, start in zip(segment_ends, page.dataoffsets[1:], strict=False))


def _volume_axes(series: TiffPageSeries, path: Path) -> tuple[str, tuple[str, ...]]:
    """Return the axes of a stack that are longer than 1, and what was assumed of them.

    Slices, y and x, and the samples of a stack in colour.
    """
    axes = long_axes(series)
    shape = shape_words(series)
    axis_lengths = dict(zip(series.axes, series.shape, strict=True))
    grey_axes = axes.replace("S", "")
    # The samples of a pixel may be red, green and blue, with or without further ones.
    is_rgb = axes.find("S") in (1, 3) and axis_lengths["S"] in (3, 4) and has_rgb(series.keyframe)
    if (
        len(grey_axes) == 3
        and grey_axes[0] in SLICE_AXES
        and grey_axes[1:] == "YX"
        and (axes == grey_axes or is_rgb)
    ):
        return axes, ()
    # Programs file a stack of unnamed pages as channels or time points.
    is_like_slices = grey_axes[:1] == "T" or axis_lengths.get("C", 0) >= LEAST_SLICES
    if grey_axes in ("TYX", "CYX") and is_like_slices and (axes == grey_axes or is_rgb):
        letter = grey_axes[0].casefold()
        return axes, (slices_note(axis_lengths[grey_axes[0]], letter),)
    if further_axes := {a: n for a, n in axis_lengths.items() if n > 1 and a in MEANINGS}:
        content_text = " and ".join(f"{n} {MEANINGS[a]}" for a, n in further_axes.items())
        hint_text = (
            "If these are the slices, say so in the file (ImageJ: Image > Properties). Otherwise: "
        )
        hint_text = "" if "S" in further_axes or set(axes) & set(SLICE_AXES) else hint_text
        raise VolumeError(f"{path.name} has {content_text}: {shape}. {hint_text}{ADVICE}")
    if axes == "YX":
        raise VolumeError(
            f"{path.name} has one page, not a stack: {shape}. Give all slices, in one file or"
            " folder."
        )
    raise VolumeError(f"{path.name} is not a volume with the axes z, y, x: {shape}. {ADVICE}")


class TiffPages(PagedArray):
    """Pages of one checked series that is still open, each with one plane of pixels as stored."""

    def __init__(self, path: Path, series: TiffPageSeries) -> None:
        key = series.keyframe
        pages = [page for page in series if page is not None]
        jpeg = key.compression in JPEG_COMPRESSIONS
        tables = (
            {"jpegtables": page.jpegtables, "jpegheader": key.jpegheader} if jpeg else {}
            for page in pages
        )
        self._segments = [
            (p.dataoffsets, p.databytecounts, t) for p, t in zip(pages, tables, strict=True)
        ]
        self._decode: Any = key.decode
        self._across = -(-key.imagewidth // key.tilewidth) if key.is_tiled else 1
        strip_rows = key.tilelength if key.is_tiled else min(key.rowsperstrip, key.imagelength)
        shape = (len(pages), *key.shape)
        dtype = np.dtype(key.dtype).newbyteorder("=")
        super().__init__(path, shape, dtype, strip_rows, self._decoded_rows)

    def __reduce__(self) -> tuple[Any, ...]:
        """Open the file again in another process."""
        return _open_pages, (self.path,)

    def _decoded_rows(self, page: int, start: int, stop: int) -> NDArray[Any]:
        values = np.empty((stop - start, *self.shape[2:]), self.dtype)
        pixels = values.reshape(*values.shape[:2], -1)
        offsets, byte_counts, tables = self._segments[page]
        first_row, end_row = start // self.unit_rows, -(-stop // self.unit_rows)
        with self.path.open("rb") as file:
            for index in range(first_row * self._across, end_row * self._across):
                file.seek(offsets[index])
                data = file.read(byte_counts[index])
                if len(data) < byte_counts[index]:
                    raise damaged(self.path, f"data of page {page + 1} are missing")
                segment, (_, _, y, x, _), (_, height, width, _) = self._decode(
                    data, index, _fullsize=False, **tables
                )
                if segment is None:
                    raise damaged(self.path, f"a strip or tile of page {page + 1} is empty")
                height = min(height, stop - y)
                width = min(width, self.shape[2] - x)
                pixels[y - start : y - start + height, x : x + width] = segment[0, :height, :width]
        return values


def _open_pages(path: Path) -> TiffPages:
    with open_series(path, error=FileError, advice="Copy it again.") as (_, series), reading(path):
        return TiffPages(path, series)
