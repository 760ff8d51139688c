"""Linear grey: the curve that a picture is coded with, undone, and what its file says of it.

In: tags of a file, and values with a full scale. Out: a :class:`Tone`, and values in linear grey
on the same scale.

IEC 61966-2-1 (sRGB); PNG, W3C recommendation (gAMA, sRGB, iCCP).
"""

from collections.abc import Mapping
from contextlib import suppress
from io import BytesIO
from typing import Any, Literal, NamedTuple

import numpy as np
from PIL import ImageCms

from planish.core.errors import InputError
from planish.io.params import HIGHEST_GAMMA
from planish.io.resolution import names_of, writer_of

Gamma = Literal["srgb"] | float
COLOUR_SPACE = 40961  # tag of Exif; 1 is sRGB


class Tone(NamedTuple):
    """What a file states of how its grey came about."""

    camera: str = ""  # maker and model
    curve: str = ""  # of its grey, in words; empty where none is stated
    is_linear: bool = False  # that curve, by its exponent or the name of its profile
    is_scan: bool = False  # by the name of what wrote it


def tone_of(tags: Mapping[int, Any], colour_space: Any, info: Mapping[Any, Any]) -> Tone:
    """Read what a file states: its tags, the colour space of its Exif, and its other parts.

    The first curve counts of: ICC profile, sRGB, gAMA, Exif, JPEG.
    """
    curve = ""
    profile = info.get("icc_profile") or tags.get(34675)
    if profile:
        curve = f"an ICC profile, {_profile_name(bytes(profile))}"
    elif "srgb" in info:
        curve = "sRGB, in a chunk of PNG"
    elif info.get("gamma"):
        curve = f"an exponent of {1 / float(info['gamma']):.3g}, in the chunk gAMA of PNG"
    elif colour_space == 1:
        curve = "sRGB, in Exif"
    elif "jfif" in info:
        curve = "sRGB, as JPEG has it"
    is_linear = "linear" in curve.casefold() or curve.startswith("an exponent of 1,")
    camera = names_of(tags, (271, 272))
    return Tone(camera, curve, is_linear, is_scan=writer_of(tags, ()).is_scanner)


def _profile_name(profile: bytes) -> str:
    with suppress(ImageCms.PyCMSError, OSError):
        return ImageCms.getProfileDescription(ImageCms.ImageCmsProfile(BytesIO(profile))).strip()
    return "without a name"


def linear_grey(values: Any, gamma: Gamma | None, full_scale: int | None) -> Any:
    """Undo the curve that values are coded with; they stay on their scale.

    InputError where the scale has no end, or `gamma` is neither a curve nor an exponent.
    """
    if gamma is None or gamma == 1:
        return values
    is_exponent = isinstance(gamma, int | float) and 1 <= gamma <= HIGHEST_GAMMA
    if gamma != "srgb" and not is_exponent:
        raise InputError(
            f"`gamma={gamma}` is no curve. Give srgb, or an exponent from 1 to"
            f" {HIGHEST_GAMMA:g}, such as 2.2."
        )
    if full_scale is None:
        raise InputError(
            "`gamma` is for pictures in whole numbers; real numbers have no white that their curve"
            " ends at. Leave it out, or give the picture in 8 or 16 bits."
        )
    share = np.asarray(values, np.float32) / np.float32(full_scale)
    if gamma == "srgb":
        toe = share / np.float32(12.92)
        share = np.where(share <= 0.04045, toe, ((share + 0.055) / 1.055) ** 2.4)
    else:
        share = np.sign(share) * np.abs(share) ** gamma
    return share * np.float32(full_scale)
