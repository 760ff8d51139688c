"""Checks of what files say of themselves: the hand of volume or image, and how it was read."""

from dataclasses import dataclass
from typing import Literal

import xarray as xr

from planish.checks.scan import ScannedSheet
from planish.core.checks import Check, CheckRule
from planish.io.light import LightFacts
from planish.io.orientation import hand_sentence


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageFile:
    """An image as it was read, with what its file says in its attributes."""

    image: xr.DataArray
    light: LightFacts | None = None  # of its white image


def hand_of_volume(rule: CheckRule, scan: ScannedSheet) -> Check | None:
    """Say that the file makes its slices a mirror image of the specimen, or turns them.

    None where it says nothing of the kind.
    """
    advice = (
        "Flip one axis where you export the volume, and map it again; or see by the marks or the"
        " texture which hand it has."
    )
    return _judged_hand(rule, scan.volume, "volume", advice)


def hand_of_image(rule: CheckRule, file: ImageFile) -> Check | None:
    """Say that viewers mirror or turn an image, which planish does not."""
    advice = "Save it as it is shown, without the tag, if the side given is the one it shows."
    return _judged_hand(rule, file.image, "image", advice)


def _judged_hand(
    rule: CheckRule, data: xr.DataArray, subject: Literal["volume", "image"], advice: str
) -> Check | None:
    sentence = hand_sentence(data.attrs, subject)
    if "hand" in data.attrs:
        return rule.check("look", sentence, advice=advice)
    return rule.check("pass", sentence) if sentence else None


def reading(rule: CheckRule, scan: ScannedSheet) -> Check | None:
    """Say what looks wrong in the files of a volume, and what was assumed to read them."""
    attrs = scan.volume.attrs
    doubts: list[str] = attrs.get("doubts", [])
    notes: list[str] = attrs.get("notes", [])
    if doubts:
        # Writers leave out chunks of air, so that what is missing need not be lost.
        return rule.check("unknown", " ".join([*doubts, *notes]))
    return rule.check("pass", " ".join(notes)) if notes else None
