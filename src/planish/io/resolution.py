"""Pixel sizes from pixels per inch or cm, and which of these nobody measured."""

import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from planish.core.units import unit_um

# What Exif and screens have where nothing is known: no statement of a size.
UNKNOWN_DPI = (72, 96)
# Defaults as well, but a scanner may mean them. Matplotlib writes 100, cameras of Canon and
# Panasonic 180, Lightroom 240, Photoshop and cameras of Nikon 300, those of Sony 350; dialogs of
# export and of printing offer 150, 200, 400 and 600.
DEFAULT_DPI = (100, 150, 180, 200, 240, 300, 350, 400, 600)
ROUNDING_DPI = 1.0  # of whole pixels per cm
# In the names of flat-bed scanners and of their programs, whose resolution is one.
SCANNERS = ("scan", "silverfast", "perfection")
UNIT_OF_TAG = {2: "inch", 3: "cm"}  # by tag 296, of TIFF and of Exif
_NAME_TAGS = (271, 272, 305)  # maker, model, program
_EXPOSURE_TAGS = {33434, 33437, "ExposureTime", "FNumber"}  # by number, and as tifffile has them


class Writer(NamedTuple):
    """What wrote a picture, by its tags."""

    name: str = ""  # maker, model and program
    is_camera: bool = False  # with an exposure or an aperture

    @property
    def is_scanner(self) -> bool:
        """Whether it is a flat-bed scanner or a program of one, by its name."""
        return any(word in self.name.casefold() for word in SCANNERS)


def writer_of(tags: Mapping[int, Any], photo_tags: Iterable[Any]) -> Writer:
    """Read what wrote a picture from its tags and from those that Exif has of a photograph."""
    return Writer(names_of(tags, _NAME_TAGS), not _EXPOSURE_TAGS.isdisjoint(photo_tags))


def names_of(tags: Mapping[int, Any], codes: Iterable[int]) -> str:
    """Join the texts of some tags, each once."""
    texts = filter(None, map(tags.get, codes))
    names = [str(text).strip("\0 ") for text in texts]
    return " ".join(dict.fromkeys(names))


def from_density(per_unit: float | None, unit: str) -> float | None:
    """Pixel size (um) from pixels per unit of length.

    None for 1 per unit and 72 or 96 an inch, which mean unknown.
    """
    unit_length = unit_um(unit)
    if per_unit is None or unit_length is None or per_unit == 1 or not 0 < per_unit < math.inf:
        return None
    pixel_um = unit_length / per_unit
    return None if _is_one_of(UNKNOWN_DPI, pixel_um) else pixel_um


def reason_of_none(per_unit: float, unit: str) -> str:
    """Say why a resolution is no size."""
    if unit_um(unit) is None:
        return f"{per_unit:g} without a unit of length"
    return f"{per_unit:.4g} per {unit} says nothing of the size"


def doubt_of(pixel_um: float, writer: Writer) -> str:
    """Say why a size from a resolution may be nobody's measurement; nothing where it is one."""
    if writer.is_scanner:
        return ""
    origin_text = f"{pixel_um:.4g} um a pixel is {25400.0 / pixel_um:.4g} dpi"
    by_text = f" ({writer.name})" if writer.name else ""
    if writer.is_camera:
        return f"{origin_text}, written by a camera{by_text}, which knows no size of what it shows."
    if _is_one_of(DEFAULT_DPI, pixel_um):
        return f"{origin_text}, which cameras and editors write by default{by_text}."
    return ""


def _is_one_of(resolutions: Iterable[float], pixel_um: float) -> bool:
    return any(abs(25400.0 / pixel_um - dpi) <= ROUNDING_DPI for dpi in resolutions)
