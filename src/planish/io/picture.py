"""Read one 2D picture out of a TIFF, PNG, JPEG or BMP file.

Its stored values, what they mean, and its pixel size.
"""

from collections.abc import Mapping, Sequence
from io import BytesIO
from numbers import Real
from pathlib import Path
from typing import Any, Literal, NamedTuple

import imagecodecs
import numpy as np
from PIL import BmpImagePlugin, Image, ImageFile, JpegImagePlugin, PngImagePlugin
from tifffile import PHOTOMETRIC, TiffPage, TiffPageSeries

from planish.core.errors import FileError
from planish.core.typing import Array, DType, Texts
from planish.io.formats import HEAD_BYTES, PICTURES, TIFF, format_by_bytes
from planish.io.guard import check_blown_up, check_memory, head_of, reading
from planish.io.resolution import UNIT_OF_TAG, Writer, writer_of
from planish.io.sizes import Stated, stated_by_tiff, stated_density
from planish.io.tiff import (
    PICTURE_ADVICE,
    has_rgb,
    long_axes,
    long_shape,
    map_or_decode,
    mapped_from,
    notes_on_reading,
    open_series,
    shape_words,
)
from planish.io.tone import COLOUR_SPACE, Tone, tone_of

PLUGINS: dict[str, type[ImageFile.ImageFile]] = {
    "png": PngImagePlugin.PngImageFile,
    "jpeg": JpegImagePlugin.JpegImageFile,
    "bmp": BmpImagePlugin.BmpImageFile,
}

NO_DATA = 42113  # tag of GDAL, with the number of pixels that are missing
PICTURE_AXES = frozenset({"YX", "YXS", "SYX", "CYX"})
Colour = Literal["grey", "rgb", "other"]


class DecodedPicture(NamedTuple):
    """A decoded picture."""

    values: Array  # dims (y, x) or (y, x, sample), as stored; palettes are looked up
    # Meaning of the samples: the first is grey, the first three are red, green, blue, or neither.
    colour: Colour
    bits: int  # of a sample, if it is a whole number
    # Size along z (which a slice of a stack may know), y, x in the metadata.
    stated: tuple[Stated, ...]
    orientation: int  # the tag, 1 to 8; values stay as stored, whatever it says
    notes: Texts = ()  # what was assumed, in sentences
    tone: Tone = Tone()  # what the file states of its grey

    @property
    def in_colour(self) -> bool:
        """True if it has red, green and blue."""
        return self.values.ndim == 3 and self.colour == "rgb"


def kind_of(path: Path) -> str:
    """``tiff``, ``png``, ``jpeg`` or ``bmp``, by the first bytes, whatever the name says."""
    # Here, so that a look at a file waits for no table of other files.
    if path.is_dir():
        from planish.io.other_files import folder_contents

        raise FileError(
            f"{path.name} is not a file but a folder: {folder_contents(path)[0]}. Give one image"
            " file."
        )
    file_format = format_by_bytes(head_of(path, HEAD_BYTES))
    if file_format is None or file_format not in (TIFF, *PICTURES):
        from planish.io.other_files import refusal

        raise refusal(path)
    return file_format.name.lower()


def load_picture(
    path: Path, *, memory_bytes: int | None = None, decode: bool = True, is_slice: bool = False
) -> DecodedPicture:
    """Decode a picture, or give its shape and type alone (``decode`` is False).

    With shape and type alone, all values are one 0 that takes no memory. Of a slice of a volume
    (``is_slice``), the colours in which ImageJ shows it are no values, and pixels that GDAL calls
    missing stay numbers.
    """
    if kind_of(path) != "tiff":
        return _load_raster(path, memory_bytes=memory_bytes, decode=decode)
    with open_series(path) as (tif, series):
        axes = long_axes(series)
        if axes not in PICTURE_AXES:
            raise FileError(
                f"{path.name} is not one picture but {shape_words(series)}. {PICTURE_ADVICE}"
            )
        page = series.keyframe
        values = _series_values(series, path, memory_bytes=memory_bytes, decode=decode)
        bits = int(page.bitspersample)
        with reading(path):
            is_looked_up = page.photometric == PHOTOMETRIC.PALETTE and len(axes) == 2
            if is_looked_up and not (is_slice and tif.is_imagej):
                values, colour = _look_up(values, np.asarray(page.colormap))
                bits = 8 * values.itemsize
            else:
                colour = _colour_of(page, axes, values.shape[-1])
            orientation = _orientation_of(page.tags.valueof(274, default=1))
            values = _with_gaps(values, page, is_image=decode and not is_slice)
            tone = _tone_of_page(page)
        stated = stated_by_tiff(tif, page, path)
        notes = notes_on_reading(tif, page, path) if is_slice else ()
        return DecodedPicture(values, colour, bits, stated, orientation, notes, tone)


def _series_values(
    series: TiffPageSeries, path: Path, *, memory_bytes: int | None, decode: bool
) -> Array:
    """Values of a picture, its samples on the last axis; zeros where they are not decoded."""
    values = constant_zeros(series.shape, series.dtype)
    if decode:
        values = map_or_decode(series, path, memory_bytes=memory_bytes)
    values = values.reshape(long_shape(series))
    if long_axes(series) in ("SYX", "CYX"):
        values = np.moveaxis(values, 0, -1)
    if values.dtype.kind not in "buif":
        raise FileError(
            f"{path.name} has {values.dtype} values. Export it with integer or real values."
        )
    return values


def _orientation_of(tag: object) -> int:
    return tag if isinstance(tag, int) else 1


def _colour_of(page: TiffPage, axes: str, n_samples: int) -> Colour:
    """Meaning of the samples of a page."""
    if len(axes) == 2:
        return "grey"
    if "S" in axes and has_rgb(page):
        return "rgb" if n_samples >= 3 else "other"
    is_grey = page.photometric in {PHOTOMETRIC.MINISWHITE, PHOTOMETRIC.MINISBLACK}
    if is_grey and "S" in axes and n_samples == 2:
        return "grey"
    return "other"


def _look_up(values: Array, colormap: Array) -> tuple[Array, Colour]:
    """Entries of a palette by their 16-bit colours, or 8-bit where nothing is lost.

    Grey stays grey.
    """
    if np.all(colormap % 257 == 0):
        colormap = (colormap // 257).astype(np.uint8)
    entry = values.astype(np.intp)
    if (colormap == colormap[0]).all():
        return colormap[0][entry], "grey"
    return np.moveaxis(colormap[:, entry], 0, -1), "rgb"


def _tone_of_page(page: TiffPage) -> Tone:
    photo: Any = page.tags.valueof(34665, default={})
    tags = {tag: page.tags.valueof(tag) for tag in (271, 272, 305, 34675)}
    return tone_of(tags, photo.get("ColorSpace"), {})


def _with_gaps(values: Array, page: TiffPage, *, is_image: bool) -> Array:
    """Values of an image with NaN where GDAL says that there is none."""
    if not is_image or NO_DATA not in page.tags:
        return values
    missing = float(page.tags.valueof(NO_DATA))
    return np.where(values == missing, np.nan, values)


def is_mapped(path: Path) -> bool:
    """True if windows of a picture are read from its file without decoding all of it."""
    if kind_of(path) != "tiff":
        return False
    with open_series(path) as (_, series):
        palette = series.keyframe.photometric == PHOTOMETRIC.PALETTE
        return mapped_from(series) is not None and not palette


def constant_zeros(shape: Sequence[int], dtype: DType) -> Array:
    """An array of any size in no memory; all its values are the same 0."""
    return np.broadcast_to(np.zeros((), dtype.newbyteorder("=")), tuple(shape))


def is_picture(series: TiffPageSeries) -> bool:
    """True if a series is one picture, with up to four samples or channels a pixel."""
    axes = long_axes(series)
    lengths = dict(zip(series.axes, series.shape, strict=True))
    n_pixels = lengths.get("Y", 1) * lengths.get("X", 1)
    return axes in PICTURE_AXES and (len(axes) == 2 or series.size <= 4 * n_pixels)


def _load_raster(path: Path, *, memory_bytes: int | None, decode: bool) -> DecodedPicture:
    """Decode a PNG, JPEG or BMP file by the classes of Pillow, or give its shape and type alone.

    Pillow's limit of pixels, a global, does not apply then.
    """
    kind = kind_of(path)
    with reading(path):
        data = path.read_bytes()
        if kind == "png":  # the checksum of every part; decoders pass over some of them
            PLUGINS[kind](BytesIO(data)).verify()
        image = PLUGINS[kind](BytesIO(data))
    # Bytes of the header: bits of a sample, and the type: colour, or grey or colour with alpha.
    is_16_bit = kind == "png" and data[24] == 16 and data[25] in (2, 4, 6)
    n_bands = 3 if image.mode == "P" else len(image.getbands())
    needed_bytes = image.width * image.height * n_bands * (1 + is_16_bit)
    check_blown_up(path, decoded_bytes=needed_bytes, stored_bytes=len(data))
    if decode:
        check_memory(path, needed_bytes=needed_bytes, limit_bytes=memory_bytes)
    with reading(path):
        # Pillow decodes a PNG to look for the tag behind its pixels.
        exif = image.getexif() if decode or kind != "png" else Image.Exif()
        orientation = _orientation_of(exif.get(274, 1))
        photo = exif.get_ifd(34665)
        # PNG has the program (tag 305) among its texts.
        tags = {305: image.info.get("Software"), **exif}
        writer = writer_of(tags, photo)
        tone = tone_of(exif, photo.get(COLOUR_SPACE), image.info)
        if decode:
            values = _raster_values(image, data, is_16_bit=is_16_bit)
        else:
            values = _raster_zeros(image, is_16_bit=is_16_bit)
    colour = _raster_colour(image.mode, values)
    bits = 16 if image.mode == "I" else 8 * values.itemsize
    stated = _stated_by_raster(kind, image.info.get("dpi"), exif, writer)
    return DecodedPicture(values, colour, bits, stated, orientation, tone=tone)


def _raster_colour(mode: str, values: Array) -> Colour:
    """Meaning of the samples of a raster, by the mode in which Pillow has it."""
    if mode not in {"1", "L", "LA", "I", "I;16", "F", "P", "PA", "RGB", "RGBA"}:
        return "other"
    if values.ndim == 3 and values.shape[-1] >= 3:
        return "rgb"
    return "grey"


def _stated_by_raster(
    kind: str, dpi: Any, exif: Mapping[int, Any], writer: Writer
) -> tuple[Stated, ...]:
    """Pixel size by the resolution of the format, and by that of Exif."""
    # Along x, y in the file.
    density = (None, None)
    if isinstance(dpi, tuple) and len(dpi) == 2:
        density = dpi[1::-1]
    stated = stated_density(f"the {kind.upper()} resolution", density, "inch", writer)
    exif_unit = UNIT_OF_TAG.get(exif.get(296, 2), "")
    exif_density = [_real(exif.get(tag)) for tag in (283, 282)]
    # Programs that change one of the two resolutions may leave the other.
    if None in (*stated.um[1:], *exif_density):
        return (stated,)
    return stated, stated_density("the Exif resolution", exif_density, exif_unit, writer)


def _raster_values(image: Image.Image, data: bytes, *, is_16_bit: bool) -> Array:
    """Values of a raster as stored, those of a palette by their colours, or grey where all are."""
    image.load()
    if is_16_bit:  # Pillow cuts 16-bit colour to 8 bits
        return np.asarray(imagecodecs.png_decode(data))
    if image.mode not in {"P", "PA"}:
        return np.asarray(image)
    colours = np.asarray(image.convert("RGB"))
    if np.all(colours == colours[..., :1]):
        return colours[..., 0].copy()
    return colours


def _raster_zeros(image: Image.Image, *, is_16_bit: bool) -> Array:
    """Zeros of the shape and type that a raster has when it is decoded."""
    mode_types = {
        "1": "bool",
        "I": "int32",
        "I;16": "uint16",
        "I;16B": "uint16",
        "F": "float32",
    }
    dtype = np.dtype("uint16" if is_16_bit else mode_types.get(image.mode, "uint8"))
    n_bands = len(image.getbands())
    samples = (n_bands,) if n_bands > 1 else ()
    return constant_zeros((image.height, image.width, *samples), dtype)


def _real(value: object) -> float | None:
    if isinstance(value, Real):
        return float(value)
    return None
