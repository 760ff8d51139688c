"""What two layers on one grid say by their own texture: whether they belong together, and where they lie."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.analyze import (
    SIDES,
    LagNumbers,
    Textures,
    image_of_sheet,
    texture_lag,
    textures,
    two_images,
    two_sheets,
)
from planish.core.bands import any_finite, rms_of, thinned
from planish.core.checks import CORRELATION, POSITION, Check
from planish.core.errors import SizeError
from planish.core.facts import Side
from planish.core.grid import Grid

Array = NDArray[np.float64]

_REACH_UM, _TILE_UM = 150.0, 1000.0
_SEEN_SHARE, _SEEN = 0.5, 3.0  # of the valid pixels; standard errors
_MAPS = ("coating_top", "coating_bottom", "thickness", "base_thickness", "topography_top", "topography_bottom", "image")

_WITHOUT_SCREEN = Check(
    name="position by texture", state="unknown", figures=(POSITION,),
    sentence="Image-based check: not made, because the fine texture that it aligns was taken off with the screen.",
)  # fmt: skip

_SIDE_UNKNOWN = Check(
    name="side and specimen", state="unknown",
    sentence="Side and specimen: inconclusive, because the fine texture that would show it was taken off with the "
    "screen.",
)  # fmt: skip


class TextureFound(NamedTuple):
    """Where the texture of two layers puts them, None where there are too few pixels; and what was judged."""

    lag: LagNumbers | None
    checks: tuple[Check, ...]


class _Compared(NamedTuple):
    """Maps that another map is registered by: the first, what it may need beside it, and the other one."""

    found: Textures
    first: list[str]
    slopes: int
    last: str


def texture_of(
    a: xr.Dataset, b: xr.Dataset, names: tuple[str, str], *, side: Side = "top", given: bool = True
) -> TextureFound:  # fmt: skip
    """Compare two layers on one grid by their own texture.

    ``side`` is that of the sheet which an image of the two shows, ``given`` or assumed.
    """
    if "thickness" in b and "thickness" not in a:
        a, b, names = b, a, (names[1], names[0])
    valid, one_sheet = a["valid"].values & b["valid"].values, "thickness" in a and "thickness" not in b
    first, second = ({k: d[k] for k in _MAPS if k in d and any_finite(d[k], valid)} for d in (a, b))
    image = {k: m for k, m in second.items() if k == "image"}  # none where the two have no valid pixel in common
    maps = first | (image if one_sheet else {f"other {k}": m for k, m in second.items()})
    try:
        found = textures(maps, valid, Grid.of(a).pixel_um)
    except SizeError as error:
        text = f"Specimen and position by texture: inconclusive. {error.text}"
        return TextureFound(None, (Check(name="side and specimen", state="unknown", sentence=text),))
    seen = [_coated(d) for d in (a, b) if "thickness" in d]
    coated: list[Side] = [k for k in SIDES if all(k in sides for sides in seen)]
    if one_sheet:
        judged = image_of_sheet(found, coated=coated, side=side, given=given, image=names[1])
        check, compared = judged.check, _by_face(found, judged.side or side, coated)
    elif seen:
        check = two_sheets(found, names, coated=coated)
        name = next((f"coating_{k}" for k in coated), "thickness")
        compared = _Compared(found, [name], 0, f"other {name}")
    else:
        check, compared = two_images(found, names), _Compared(found, ["image"], 0, "other image")
    if any("reach_um" in d["image"].attrs for d in (a, b) if "image" in d):
        # The texture that would show the side is gone, so that none goes with the coating is no evidence.
        return TextureFound(None, (_SIDE_UNKNOWN if check.state == "look" else check, _WITHOUT_SCREEN))
    moved = next((d["expected_error"] for d in (a, b) if "expected_error" in d), None)
    expected_um = None if moved is None else rms_of(moved, valid)
    short = min(n * um for n, um in zip(found.known.shape, found.pixel_um, strict=True))
    try:
        lag = texture_lag(
            *compared[:2], compared.last, slopes=compared.slopes, reach_um=min(_REACH_UM, short / 4),
            tiles_um=_TILE_UM if short >= 2 * _TILE_UM else None,
        )  # fmt: skip
    except SizeError:
        return TextureFound(None, (check,))
    if lag.distinct and check.state == "look" and set(check.figures) <= {POSITION, CORRELATION}:
        text = f"{check.sentence} Moved by {lag.length_um:.0f} um they do go together (position by texture)."
        check = check.model_copy(update={"sentence": text})
    return TextureFound(lag.numbers(compared.first[0], expected_um), (check, lag.check(expected_um)))


def _by_face(found: Textures, side: Side, coated: list[Side]) -> _Compared:
    """What an image of a face follows: its coating, or thickness and height, and slopes under light from one side."""
    face = f"topography_{side}"
    first = [f"coating_{side}"] if side in coated else ["thickness", *([face] if face in found.maps else [])]
    if face not in found.maps:
        return _Compared(found, first, 0, "image")
    return _Compared(found.with_slopes(face), [*first, f"{face}_x", f"{face}_y"], 2, "image")


def _coated(sheet: xr.Dataset) -> list[Side]:
    """Sides on which a coating is measured in most of a sheet, and thicker than its error."""
    found: list[Side] = []
    for side in SIDES:
        name = f"coating_{side}"
        errors = [sheet[k] for k in (f"{name}_se",) if k in sheet]
        use, *values = thinned(sheet["valid"], sheet[name], *errors)[1]
        known, *own = (v[use & np.isfinite(v)] for v in values)
        limit = _SEEN * float(np.median(own[0])) if own and own[0].size else 0.0
        if known.size and known.size >= _SEEN_SHARE * np.count_nonzero(use) and float(np.median(known)) > limit:
            found.append(side)
    return found
