"""Read volumes in one TIFF file.

They are mapped where they lie there as they are, otherwise decoded by strips or tiles.
"""

import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tifffile import PHOTOMETRIC, TiffFrame, TiffPage, TiffPageSeries

from planish.core.errors import VolumeError
from planish.core.typing import Array, DType, Entries, Shape, Texts
from planish.io.axes import may_be_slices, slices_note
from planish.io.formats import ADVICE, LoadedVolume, Place, check_type, colour_attrs, grey_of
from planish.io.guard import check_memory, memory_limit, reading
from planish.io.lazy import (
    Change,
    FileArray,
    PagedArray,
    Values,
    ViewArray,
    is_small,
    mapped,
    stored_array,
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
    long_shape,
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
        check_type(series.dtype, path)
        if page.photometric == PHOTOMETRIC.PALETTE and not (tif.is_imagej or _is_grey_ramp(page)):
            raise VolumeError(f"{path.name} has a colour palette. {ADVICE}")
        in_colour = "S" in axes
        bits = int(page.bitspersample)
        change: Change | None = partial(grey_of, channel=channel) if in_colour else None
        if page.photometric == PHOTOMETRIC.MINISWHITE:
            change = partial(turn_white, path=path, bits=bits)
        attrs = colour_attrs(channel, path, in_colour=in_colour)
        return LoadedVolume(
            values=_series_values(series, path, axes, change, memory_limit(memory_bytes)),
            stated=stated_by_tiff(tif, page, path),
            files=[path],
            bits=bits,
            attrs=attrs,
            notes=notes + notes_on_reading(tif, page, path),
            orientations=tag_orientation(page.tags.valueof(274)),
        )


def _is_grey_ramp(page: TiffPage) -> bool:
    """True if a palette only spreads grey values over the range, in order."""
    if page.colormap is None:
        return False
    palette = np.asarray(page.colormap).astype(np.int64)
    is_grey = np.all(palette == palette[0])
    return bool(is_grey and np.all(np.diff(palette[0]) > 0))


def _series_values(
    series: TiffPageSeries, path: Path, axes: str, change: Change | None, limit_bytes: int
) -> Values:
    """Values of a stack: mapped, read page by page, or decoded at once where nothing else works.

    ``axes``: its letters longer than 1, slices first, with S for the samples of a pixel, which
    ``change`` turns into grey; None where the values are grey as they are stored.
    """
    shape = long_shape(series)
    stored_dtype = series.dtype.newbyteorder(series.keyframe.parent.byteorder)
    array: FileArray | None = None
    with reading(path):
        offset = series.dataoffset
        if offset is None:
            array = _paged(series, path, shape, stored_dtype, limit_bytes)
        elif change is None:
            return mapped(path, shape, stored_dtype, offset=offset)
        else:
            array = stored_planes(path, shape, stored_dtype, offset=offset)
    samples_first = axes[1] == "S"
    if array is not None:
        axis_order = (0, 2, 3) if samples_first else (0, 1, 2)
        if change is None:
            return array
        return ViewArray(array, axis_order, change)
    values = map_or_decode(series, path, memory_bytes=limit_bytes).reshape(shape)
    if change is None or "S" not in axes:
        return values
    needed_bytes = values.nbytes + math.prod(shape) // 3  # with the grey of three samples
    check_memory(path, needed_bytes=needed_bytes, limit_bytes=limit_bytes)
    if samples_first:
        values = np.moveaxis(values, 1, -1)
    return np.stack([change(plane) for plane in values])


def _paged(
    series: TiffPageSeries,
    path: Path,
    shape: Shape,
    stored_dtype: DType,
    limit_bytes: int,
) -> FileArray | None:
    """An array of one page for each slice, with one plane in each.

    None where they are not so, and where grey pages that have to be decoded are small.
    """
    frame = series.keyframe
    pages = [*filter(None, series)]
    has_one_plane = 1 in (frame.planarconfig, frame.samplesperpixel) and frame.imagedepth == 1
    if not has_one_plane or len(pages) != shape[0]:
        return None
    if frame.is_final and all(map(_is_joined, pages)):
        planes = [(path, page.dataoffsets[0]) for page in pages]
        return stored_array(planes, shape, stored_dtype)
    if frame.is_subsampled:
        return None
    tiff_pages = TiffPages(path, series)
    is_grey = "S" not in long_axes(series)
    return None if is_grey and is_small(tiff_pages, limit_bytes) else tiff_pages


def _is_joined(page: TiffPage | TiffFrame) -> bool:
    """True if the strips of a page lie one behind the other."""
    segments = zip(page.dataoffsets, page.databytecounts, strict=False)
    ends = [start + n_bytes for start, n_bytes in segments]
    return ends[:-1] == list(page.dataoffsets[1:])


def _volume_axes(series: TiffPageSeries, path: Path) -> tuple[str, Texts]:
    """Return the axes of a stack that are longer than 1, and what was assumed of them.

    Slices, y and x, and the samples of a stack in colour.
    """
    axes = long_axes(series)
    lengths = dict(zip(series.axes, series.shape, strict=True))
    grey_axes = axes.replace("S", "")
    # The samples of a pixel may be red, green and blue, with or without further ones.
    is_rgb = axes.find("S") in (1, 3) and lengths["S"] in (3, 4) and has_rgb(series.keyframe)
    has_planes = len(grey_axes) == 3 and grey_axes[1:] == "YX"
    if has_planes and (axes == grey_axes or is_rgb):
        letter = grey_axes[0]
        if letter in SLICE_AXES:
            return axes, ()
        folded_letter = letter.casefold()
        # Programs file a stack of unnamed pages as channels or time points.
        if may_be_slices(folded_letter, lengths[letter]):
            return axes, (slices_note(lengths[letter], folded_letter),)
    raise VolumeError(f"{path.name} {_fault_of_axes(axes, lengths, shape_words(series))}")


def _fault_of_axes(axes: str, lengths: dict[str, int], shape_text: str) -> str:
    """Say why a series is no volume, and what to do."""
    further_axes = {a: n for a, n in lengths.items() if n > 1 and a in MEANINGS}
    if further_axes:
        content_text = " and ".join(f"{n} {MEANINGS[a]}" for a, n in further_axes.items())
        hint_text = ""
        if not set(axes) & {"S", *SLICE_AXES}:
            hint_text = (
                "If these are the slices, say so in the file (ImageJ: Image > Properties)."
                " Otherwise: "
            )
        return f"has {content_text}: {shape_text}. {hint_text}{ADVICE}"
    if axes == "YX":
        return f"has one page, not a stack: {shape_text}. Give all slices, in one file or folder."
    return f"is not a volume with the axes z, y, x: {shape_text}. {ADVICE}"


class TiffPages(PagedArray):
    """Pages of one checked series that is still open, each with one plane of pixels as stored."""

    def __init__(self, path: Path, series: TiffPageSeries) -> None:
        """Note where the strips or tiles of each page lie, so that threads read them at once."""
        key = series.keyframe
        self._segments: list[tuple[Any, Any, Entries]] = []
        for page in filter(None, series):
            tables = {}
            if key.compression in JPEG_COMPRESSIONS:
                tables = {"jpegtables": page.jpegtables, "jpegheader": key.jpegheader}
            self._segments.append((page.dataoffsets, page.databytecounts, tables))
        self._decode: Any = key.decode
        self._across = 1
        strip_rows = key.rowsperstrip
        if key.is_tiled:
            self._across = -(-key.imagewidth // key.tilewidth)
            strip_rows = key.tilelength
        shape = (len(self._segments), *key.shape)
        dtype = np.dtype(key.dtype)
        super().__init__(path, shape, dtype, strip_rows, self._decoded_rows)

    def __reduce__(self) -> tuple[Any, ...]:
        """Open the file again in another process."""
        return _open_pages, (self.path,)

    def _decoded_rows(self, page: int, start: int, stop: int) -> Array:
        """Rows of a page, which begin with a strip or a row of tiles.

        Shape (rows, cols), or with the samples of a pixel (rows, cols, samples).
        """
        shape = (stop - start, *self.shape[2:])
        values = np.empty(shape, self.dtype)
        pixels = values.reshape(*values.shape[:2], -1)
        offsets, byte_counts, tables = self._segments[page]
        first_row = start // self.unit_rows
        end_row = -(-stop // self.unit_rows)
        with self.path.open("rb") as file:
            for index in range(first_row * self._across, end_row * self._across):
                file.seek(offsets[index])
                data = file.read(byte_counts[index])
                if len(data) < byte_counts[index]:
                    raise damaged(self.path, f"data of page {page + 1} are missing")
                segment, place, size = self._decode(data, index, _fullsize=False, **tables)
                if segment is None:
                    raise damaged(self.path, f"a strip or tile of page {page + 1} is empty")
                # Of the page; at its edges a tile may reach beyond.
                _, _, row, col, _ = place
                height = min(size[1], stop - row)
                width = min(size[2], self.shape[2] - col)
                rows = slice(row - start, row - start + height)
                pixels[rows, col : col + width] = segment[0, :height, :width]
        return values


def _open_pages(path: Path) -> TiffPages:
    with open_series(path, advice="Copy it again.") as (_, series), reading(path):
        return TiffPages(path, series)
