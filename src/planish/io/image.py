"""The 2D image of the sheet: a picture, one of its channels, and its pixel size."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from planish.core.errors import FileError, InputError, check_choice
from planish.core.facts import SIDES, Side
from planish.core.reflectance import LUMINANCE
from planish.core.typing import Array, Entries, Pair, Singles
from planish.io.formats import COLOURS, full_scale
from planish.io.guard import check_memory, size_of_file
from planish.io.orientation import orientation_attrs, tag_orientation
from planish.io.picture import DecodedPicture, load_picture
from planish.io.sizes import PIXEL, Stated, agreed_size, size_attrs
from planish.io.tone import Gamma, linear_grey

if TYPE_CHECKING:
    import xarray as xr

# Long name of the values of an image without references for dark and white.
GREY = "Grey value, uncalibrated"


def read_image(
    path: str | Path,
    *,
    pixel_um: float | Pair | None = None,
    channel: str = "luminance",
    override_size: bool = False,
    unusual_size: bool = False,
    memory_bytes: int | None = None,
    side: Side | None = None,
    gamma: Gamma | None = None,
) -> xr.DataArray:
    """Read the 2D image of a sheet.

    Parameters
    ----------
    path : path
        TIFF, PNG, JPEG or BMP; grey or colour; one picture.
    pixel_um : float or (y, x), optional
        Pixel size in um; not needed where the metadata state it. Pixels need not be square.
    channel : str
        "luminance", "red", "green", "blue", or the number of a channel, counted from 0.
    override_size : bool
        Whether `pixel_um` is taken although the metadata state another size.
    unusual_size : bool
        Whether a size is taken that paper does not have, from 0.1 nm to 1 mm.
    memory_bytes : int, optional
        Largest decoded size; default: three quarters of the memory available.
    side : {"top", "bottom"}, optional
        Side of the sheet that it shows, which :func:`planish.find_holes` then follows; top is
        assumed where not given.
    gamma : "srgb" or float, optional
        Curve that the values are coded with, or its exponent; it is undone.

    Returns
    -------
    DataArray, dims (y, x), float32
        Coordinates in um, pixel i has its centre at i × size. Attributes: ``units``, ``long_name``,
        ``pixel_um`` (y, x), ``pixel_um_source``, ``channel``, ``stored_dtype``, ``full_scale``
        (largest value the file can store, None for floating point), ``orientation`` (the tag),
        ``hand`` or ``turned`` where it mirrors or turns the image, ``file_name``, ``file_bytes``,
        ``camera``, ``curve``, ``is_linear`` and ``is_scan`` as the file states them, ``side`` and
        ``gamma`` if given; ``size_doubt``, a sentence, where the size may be nobody's measure.

    Raises
    ------
    FileError
        If the file is damaged, of another format, or holds more than one picture.
    SizeError
        If the pixel size is missing, contradictory or impossible.
    InputError
        If the image has no such channel, there is no such side, or `path` is no path.
    ResourceError
        If it does not fit into the memory.

    Notes
    -----
    Values stay as stored where no `gamma` is given (luminance is the weighted sum of the values of
    the colours, each without its curve), alpha is ignored, and an orientation tag turns nothing, it
    is only reported. In TIFF files whose white is zero the values are turned round; palettes are
    looked up.
    """
    from planish.core.arrays import check_path  # here, so that a look at a file waits for no xarray
    from planish.core.labelled import labelled

    path = check_path(path, "the path of a file", "pl.read_image", "pl.image(array, pixel_um=...)")
    if side is not None:
        check_choice("side", side, SIDES)
    picture = load_picture(path, memory_bytes=memory_bytes)
    stated = across(picture.stated)
    size, source = agreed_size(
        stated,
        pixel_um,
        file_name=path.name,
        asked=PIXEL,
        override=override_size,
        unusual=unusual_size,
    )
    height, width = picture.values.shape[:2]
    check_memory(path, needed_bytes=4 * height * width, limit_bytes=memory_bytes)
    values, long_name = pick_channel(picture, channel, file_name=path.name, gamma=gamma)
    tone = picture.tone
    if picture.in_colour and not tone.camera:
        tone = tone._replace(camera="a colour camera")
    attrs: Entries = {
        "units": "1",
        "long_name": long_name,
        **size_attrs(PIXEL, size, source, stated),
        "channel": channel,
        "full_scale": full_scale(picture.values.dtype, picture.bits),
        "stored_dtype": str(picture.values.dtype),
        "orientation": picture.orientation,
        **picture_attrs(picture.orientation),
        "file_name": path.name,
        "file_bytes": size_of_file(path),
        **tone._asdict(),
    }
    if side is not None:
        attrs["side"] = side
    if gamma is not None:
        attrs["gamma"] = gamma
    return labelled(values, PIXEL.axes, size, name="image", attrs=attrs)


def picture_attrs(tag: int) -> Mapping[str, str]:
    """Attributes of an image about its hand, by its orientation tag."""
    return orientation_attrs(tag_orientation(tag))


def across(stated: Sequence[Stated]) -> list[Stated]:
    """Leave out what is stated about z."""
    in_plane: list[Stated] = []
    for s in stated:
        um = s.um[1:]
        note = s.note if None in um else ""
        in_plane.append(s._replace(um=um, note=note, written=s.written[1:]))
    return in_plane


def pick_channel(
    picture: DecodedPicture, channel: str, *, file_name: str, gamma: Gamma | None = None
) -> tuple[Singles, str]:
    """Take one channel as float32, and name it; FileError where no pixel has a number."""
    picked = channel_of(picture, channel, file_name=file_name, gamma=gamma)
    if not np.isfinite(picked[0]).any():
        raise FileError(
            f"{file_name} has no pixel with a number in it, all are missing. Export it again."
        )
    return picked


def channel_of(
    picture: DecodedPicture, channel: str, *, file_name: str, gamma: Gamma | None = None
) -> tuple[Singles, str]:
    """One channel (y, x) as float32, of a whole picture or a window of it, and its long name.

    ``channel`` as in :func:`read_image`. In linear grey where the curve is given that it is coded
    with. What is not finite is NaN. InputError where there is no such channel.
    """
    if gamma is not None:
        scale = full_scale(picture.values.dtype, picture.bits)
        picture = picture._replace(values=linear_grey(picture.values, gamma, scale))
    samples = picture.values
    if picture.values.ndim != 3:
        samples = picture.values[..., np.newaxis]
    n_channels = samples.shape[-1]
    name = channel.strip().casefold()
    if re.fullmatch("[0-9]+", name):
        number = int(name)
        if number >= n_channels:
            counts = ("1 channel", "0")
            if n_channels > 1:
                counts = (f"{n_channels} channels", f"0 to {n_channels - 1}")
            raise InputError(
                f"{file_name} has {counts[0]}, number {name} is not among them. Choose"
                f" {counts[1]} with `channel`."
            )
        return _as_float32(samples[..., number]), f"{GREY}, channel {number}"
    if name not in ("luminance", *COLOURS):
        raise InputError(
            f"{channel!r} is no channel. Choose luminance, red, green, blue or a number with"
            " `channel`."
        )
    if picture.colour == "rgb":
        return _of_colours(samples, name), f"{GREY}, {name}"
    content_text = "is a grey image"
    choice_text = "luminance"
    if picture.colour != "grey":
        content_text = f"has {n_channels} channels that are not red, green, blue"
        choice_text = f"a number from 0 to {n_channels - 1}"
    elif name == "luminance":
        return _as_float32(samples[..., 0]), GREY
    raise InputError(
        f"{file_name} {content_text}, so it has no {name}. Choose {choice_text} with `channel`."
    )


def _of_colours(samples: Array, name: str) -> Singles:
    """One of red, green and blue, or their luminance."""
    if name in COLOURS:
        return _as_float32(samples[..., COLOURS[name]])
    luminance = np.zeros(samples.shape[:2], np.float32)
    for sample, weight in enumerate(LUMINANCE):
        luminance += np.float32(weight) * _as_float32(samples[..., sample])
    return luminance


def _as_float32(values: Array) -> Singles:
    """Convert to a new float32 array in which everything that is no finite number is NaN."""
    with np.errstate(over="ignore"):
        converted = np.array(values, np.float32)
    if values.dtype.kind == "f":
        converted[~np.isfinite(converted)] = np.nan
    return converted
