"""What two layers on one grid say by their own texture: side, specimen, and where they lie."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import xarray as xr

from planish.analyze.lag import LagNumbers, texture_lag
from planish.analyze.texture import Relation, Textures, relate, textures, unexplained
from planish.core.bands import any_finite, rms_of, thinned
from planish.core.checks import CORRELATION, POSITION, Check
from planish.core.errors import SizeError
from planish.core.facts import Side
from planish.core.grid import Grid

NAME = "side and specimen"
Z_RELATED, Z_CLEAR = 4.5, 3.0
"""|z| above which two textures go together, and below which they do not."""

SIDES: tuple[Side, Side] = ("top", "bottom")
"""The two sides of a sheet."""
_OF_A_SPECIMEN = (POSITION, CORRELATION)
"""Where nothing says that both show one specimen, a pixel may have no place in it."""
_OF_SIDES = ("coating_top", "coating_bottom", "topography_top", "topography_bottom", CORRELATION)
_NO_WORD = "nothing beside the marks says that both show one specimen"
_ONE = "so both show one specimen"
_TURN = (
    "Top and bottom are exchanged: turn the stack (--top; a volume numbered against the usual sense needs --mirror), "
    "or give --image-side {side} if the image shows that side."
)

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


@dataclass(frozen=True, slots=True)
class SideFound:
    """The check, and the side whose texture the image has; None where that cannot be told."""

    check: Check
    side: Side | None = None


def image_of_sheet(texture: Textures, *, coated: Iterable[Side], side: Side, is_given: bool, image: str) -> SideFound:
    """Judge which face of a sheet goes with an image.

    Parameters
    ----------
    texture : Textures
        The sheet's maps by their names, and ``image``.
    coated : iterable of {"top", "bottom"}
        Sides on which a coating is seen.
    side : {"top", "bottom"}
        Side that the image shows as given or, where ``is_given`` is False, as assumed.
    image : str
        What the sentence calls the image.

    Notes
    -----
    Brightness may rise or fall with the coating, so ``|r|`` counts. Both faces share the base, and light goes through
    thin paper: what the other coating explains is taken off first (partial correlation). A face is the one if its
    ``|z|`` is above 4.5 and that of the other below 3, or smaller by 3 standard deviations of the difference.
    """
    if "image" not in texture.maps:
        text = f"Specimen: inconclusive, because the sheet and the {image} share no field."
        return SideFound(_check("unknown", text, None))
    measured: list[Side] = [k for k in coated if f"coating_{k}" in texture.maps]
    names: dict[Side, list[str]] = {k: [f"coating_{k}"] for k in measured}
    coatings = _faces(texture, names)
    words = f"The {side} side was {'given' if is_given else 'assumed (--image-side not given)'}"
    other: Side = "bottom" if side == "top" else "top"
    shown = f"the coating of the {side} side ({coatings[side]})" if side in coatings else ""
    shown_other = f"that of the {other} side ({coatings[other]})" if other in coatings else ""
    if side in coatings and _stands_out(coatings[side], coatings.get(other)):
        end = f"{_than(coatings[other])} {shown_other}" if shown_other else f"; no coating is seen on the {other} side"
        text = f"The {image} goes with {shown}{end}. {words}."
        return SideFound(_check("pass", text, coatings[side]), side)
    if other in coatings and _stands_out(coatings[other], coatings.get(side)):
        if side in coatings:
            text = f"The {image} goes with the coating of the {other} side ({coatings[other]}){_than(coatings[side])} "
            text += f"that of the {side} side ({coatings[side]}). {words}."
            advice = _TURN.format(side=other)
            return SideFound(_check("fail", text, coatings[other], advice=advice, figures=_OF_SIDES), other)
        text = f"The {image} goes with the coating of the {other} side ({coatings[other]}), and none is seen on the "
        text += f"{side} side. {words}."
        advice = f"{_TURN.format(side=other)} Light that goes through the sheet may show it as well."
        return SideFound(_check("look", text, coatings[other], advice=advice, figures=_OF_SIDES), other)
    if any(abs(k.z) > Z_RELATED for k in coatings.values()):
        text = f"Side: inconclusive, because the {image} goes with both coatings, {shown} and {shown_other}, {_ONE}."
        return SideFound(_check("unknown", text, max(coatings.values(), key=lambda k: abs(k.z))))
    return _by_the_rest(texture, coatings, side, words, image)


def _by_the_rest(
    texture: Textures, coatings: Mapping[Side, Relation], side: Side, words: str, image: str
) -> SideFound:  # fmt: skip
    """No coating goes with the image: what slopes of the faces under light from one side say, and the thickness."""
    other: Side = "bottom" if side == "top" else "top"
    for k in SIDES:
        if f"topography_{k}" in texture.maps:
            texture = texture.with_slopes(f"topography_{k}")
    slopes = _faces(texture, {k: [f"topography_{k}_{way}" for way in "xy"] for k in SIDES})
    tried = "; ".join(f"coating of the {k} side {relation}" for k, relation in coatings.items())
    rivals: dict[Side, Side] = {side: other, other: side}
    for face, rival in rivals.items():
        if face in slopes and _stands_out(slopes[face], slopes.get(rival)):
            text = f"The {image} goes with the slopes of the {face} face, as light from one side shows them "
            text += f"({slopes[face]}), not with the coatings ({tried}). " if tried else f"({slopes[face]}). "
            if face == side:
                return SideFound(_check("pass", f"{text}{words}.", slopes[face]), face)
            advice = _TURN.format(side=face)
            return SideFound(_check("look", f"{text}{words}.", slopes[face], advice=advice, figures=_OF_SIDES), face)
    plain = {
        k: relate(m, texture.maps["image"], texture.known, texture.pixel_um)
        for k, m in texture.maps.items() if k in ("thickness", "base_thickness", f"topography_{side}")
    }  # fmt: skip
    plain |= {f"slopes of the {k} face": relation for k, relation in slopes.items()}
    best = max(plain, key=lambda k: abs(plain[k].z), default=None)
    if best is not None and abs(plain[best].z) > Z_RELATED:
        rest = f"it goes with the {best.replace('_', ' ')} of the sheet ({plain[best]}), {_ONE}"
    else:
        rest = _NO_WORD
    if coatings and side in coatings:
        text = f"The {image} goes with no coating ({tried}; {Z_RELATED} is needed), and {rest}."
        advice = "Compare map and image by eye: is it this specimen, this place, and a side that shows its coating?"
        strongest = max(coatings.values(), key=lambda k: abs(k.z))
        figures = _OF_A_SPECIMEN if rest == _NO_WORD else (CORRELATION,)
        return SideFound(_check("look", text, strongest, advice=advice, figures=figures))
    text = f"Side: inconclusive, because no coating is seen on the {side} side; {rest}."
    return SideFound(_check("unknown", text, plain[best] if best else None))


def two_images(texture: Textures, names: tuple[str, str]) -> Check:
    """Judge whether two images, ``image`` and ``other image``, show one specimen by their texture, with either sign."""
    if not {"image", "other image"} <= texture.maps.keys():
        text = f"Specimen: inconclusive, because {names[0]} and {names[1]} share no field."
        return _check("unknown", text, None)
    r = relate(texture.maps["image"], texture.maps["other image"], texture.known, texture.pixel_um)
    if abs(r.z) > Z_RELATED:
        return _check("pass", f"The textures of {names[0]} and {names[1]} go together ({r}), {_ONE}.", r)
    text = f"The textures of {names[0]} and {names[1]} do not go together ({r}; {Z_RELATED} is needed): {_NO_WORD}."
    advice = "Compare both by eye: are they one specimen, one side, and is one of them a mirror image?"
    return _check("look", text, r, advice=advice, figures=_OF_A_SPECIMEN)


def two_sheets(texture: Textures, names: tuple[str, str], *, coated: Iterable[Side]) -> Check:
    """Judge whether two sheets are one specimen with the same side up.

    ``texture`` holds the maps of the first by their names, those of the second as ``other NAME``; ``coated`` are the
    sides on which both show a coating. The same quantity is compared, so r has to be positive.
    """

    def r(a: str, b: str) -> Relation | None:
        if a not in texture.maps or f"other {b}" not in texture.maps:
            return None
        return relate(texture.maps[a], texture.maps[f"other {b}"], texture.known, texture.pixel_um)

    sides = [f"coating_{k}" for k in coated]
    same = _mean([r(k, k) for k in sides])
    cross = _mean([r(*sides), r(*reversed(sides))]) if len(sides) == len(SIDES) else None
    whole = r("thickness", "thickness")
    a, b = names
    if same is not None and same.z > Z_RELATED and _stands_out(same, cross):
        end = f", not crosswise ({cross})" if cross else ""
        return _check("pass", f"The coatings of {a} and {b} go together side by side ({same}){end}, {_ONE}.", same)
    if same is not None and cross is not None and cross.z > Z_RELATED and _stands_out(cross, same):
        text = f"The coatings of {a} and {b} go together crosswise ({cross}), not side by side ({same})."
        advice = "Top and bottom of one of the two are exchanged. Check --top, and whether its slices are numbered "
        advice += "against the usual sense."
        return _check("fail", text, cross, advice=advice, figures=_OF_SIDES)
    if whole is not None and whole.z > Z_RELATED:
        why = "the coatings do not tell the sides apart" if same else "no coating is seen in both"
        text = f"Side: inconclusive, because {why}; the thicknesses of {a} and {b} go together ({whole}), {_ONE}."
        return _check("unknown", text, whole)
    tried = "; ".join(f"{k} {v}" for k, v in (("coatings", same), ("thickness", whole)) if v is not None)
    if not tried:
        return _check("unknown", f"Specimen: inconclusive, because {a} and {b} have no map in common.", None)
    text = f"No map of {a} goes with that of {b} ({tried}; {Z_RELATED} is needed): {_NO_WORD}."
    advice = "Either they are not the same piece of paper, or they do not lie on each other, or one is measured badly."
    return _check("look", text, same or whole, advice=advice, figures=_OF_A_SPECIMEN)


def _check(
    state: str, text: str, relation: Relation | None, *, advice: str = "", figures: tuple[str, ...] = ()
) -> Check:  # fmt: skip
    value = math.nan if relation is None else relation.z
    return Check.model_validate({
        "name": NAME, "state": state, "sentence": text, "value": value, "limit": Z_RELATED, "units": "z",
        "advice": advice, "figures": figures,
    })  # fmt: skip


def _stands_out(face: Relation, rival: Relation | None) -> bool:
    """Whether a face goes with the image, and the other one does not, or clearly less."""
    if not abs(face.z) > Z_RELATED:
        return False
    return rival is None or abs(rival.z) < Z_CLEAR or abs(face.part) - abs(rival.part) > Z_CLEAR * math.hypot(
        face.part_se, rival.part_se)  # fmt: skip


def _than(other: Relation) -> str:
    return ", not with" if abs(other.z) < Z_CLEAR else ", more than with"


def _faces(texture: Textures, names: Mapping[Side, list[str]]) -> dict[Side, Relation]:
    """Partial correlation of each face with the image; of several maps of a face that which stands out most."""
    image, out = texture.maps["image"], dict[Side, Relation]()
    for side, names_of_side in names.items():
        best: Relation | None = None
        for k, name in enumerate(names_of_side):
            if name not in texture.maps:
                continue
            a, b = texture.maps[name], image
            for rival in (maps[k] for of, maps in names.items() if of != side):
                if rival in texture.maps:
                    a, b = unexplained(a, texture.maps[rival]), unexplained(b, texture.maps[rival])
            r = relate(a, b, texture.known, texture.pixel_um, of=image)
            if best is None or abs(r.z) > abs(best.z):
                best = r
        if best is not None:
            out[side] = best
    return out


def _mean(relations: Iterable[Relation | None]) -> Relation | None:
    """Mean of correlations of maps that go together or not as one."""
    relations_known = [k for k in relations if k is not None]
    if not relations_known:
        return None
    n = len(relations_known)
    r, sd = sum(k.r for k in relations_known) / n, math.sqrt(sum(k.sd**2 for k in relations_known)) / n
    return Relation(r, sd, r, sd)


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
    a: xr.Dataset, b: xr.Dataset, names: tuple[str, str], *, side: Side = "top", is_given: bool = True
) -> TextureFound:  # fmt: skip
    """Compare two layers on one grid by their own texture.

    ``side`` is that of the sheet which an image of the two shows, given or assumed.
    """
    if "thickness" in b and "thickness" not in a:
        a, b, names = b, a, (names[1], names[0])
    valid, one_sheet = a["valid"].values & b["valid"].values, "thickness" in a and "thickness" not in b
    first, second = ({k: d[k] for k in _MAPS if k in d and any_finite(d[k], valid)} for d in (a, b))
    image = {k: m for k, m in second.items() if k == "image"}  # none where the two have no valid pixel in common
    maps = first | (image if one_sheet else {f"other {k}": m for k, m in second.items()})
    try:
        texture = textures(maps, valid, Grid.of(a).pixel_um)
    except SizeError as error:
        text = f"Specimen and position by texture: inconclusive. {error.text}"
        return TextureFound(None, (Check(name="side and specimen", state="unknown", sentence=text),))
    coated_sides = [_coated(d) for d in (a, b) if "thickness" in d]
    coated: list[Side] = [k for k in SIDES if all(k in sides for sides in coated_sides)]
    if one_sheet:
        judged = image_of_sheet(texture, coated=coated, side=side, is_given=is_given, image=names[1])
        check, compared = judged.check, _by_face(texture, judged.side or side, coated)
    elif coated_sides:
        check = two_sheets(texture, names, coated=coated)
        name = next((f"coating_{k}" for k in coated), "thickness")
        compared = _Compared(texture, [name], 0, f"other {name}")
    else:
        check, compared = two_images(texture, names), _Compared(texture, ["image"], 0, "other image")
    if any("reach_um" in d["image"].attrs for d in (a, b) if "image" in d):
        # The texture that would show the side is gone, so that none goes with the coating is no evidence.
        return TextureFound(None, (_SIDE_UNKNOWN if check.state == "look" else check, _WITHOUT_SCREEN))
    moved = next((d["expected_error"] for d in (a, b) if "expected_error" in d), None)
    expected_um = None if moved is None else rms_of(moved, valid)
    short = min(n * um for n, um in zip(texture.known.shape, texture.pixel_um, strict=True))
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


def _by_face(texture: Textures, side: Side, coated: list[Side]) -> _Compared:
    """What an image of a face follows: its coating, or thickness and height, and slopes under light from one side."""
    face = f"topography_{side}"
    first = [f"coating_{side}"] if side in coated else ["thickness", *([face] if face in texture.maps else [])]
    if face not in texture.maps:
        return _Compared(texture, first, 0, "image")
    return _Compared(texture.with_slopes(face), [*first, f"{face}_x", f"{face}_y"], 2, "image")


def _coated(sheet: xr.Dataset) -> list[Side]:
    """Sides on which a coating is measured in most of a sheet, and thicker than its error."""
    sides: list[Side] = []
    for side in SIDES:
        name = f"coating_{side}"
        errors = [sheet[k] for k in (f"{name}_se",) if k in sheet]
        use, *values = thinned(sheet["valid"], sheet[name], *errors)[1]
        coat, *errors_of = (v[use & np.isfinite(v)] for v in values)
        limit = _SEEN * float(np.median(errors_of[0])) if errors_of and errors_of[0].size else 0.0
        if coat.size and coat.size >= _SEEN_SHARE * np.count_nonzero(use) and float(np.median(coat)) > limit:
            sides.append(side)
    return sides
