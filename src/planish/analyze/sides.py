"""Which side of a sheet an image shows, and whether anything beside the marks says that two layers are one specimen."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from planish.analyze.texture import Relation, Textures, apart, relate
from planish.core.checks import CORRELATION, POSITION, Check
from planish.core.facts import Side

NAME = "side and specimen"
GOES, STAYS = 4.5, 3.0
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


@dataclass(frozen=True, slots=True)
class SideFound:
    """The check, and the side whose texture the image has; None where that cannot be told."""

    check: Check
    side: Side | None = None


def image_of_sheet(found: Textures, *, coated: Iterable[Side], side: Side, given: bool, image: str) -> SideFound:
    """Judge which face of a sheet goes with an image.

    Parameters
    ----------
    found : Textures
        The sheet's maps by their names, and ``image``.
    coated : iterable of {"top", "bottom"}
        Sides on which a coating is seen.
    side : {"top", "bottom"}
        Side that the image shows as given or, where ``given`` is False, as assumed.
    image : str
        What the sentence calls the image.

    Notes
    -----
    Brightness may rise or fall with the coating, so ``|r|`` counts. Both faces share the base, and light goes through
    thin paper: what the other coating explains is taken off first (partial correlation). A face is the one if its
    ``|z|`` is above 4.5 and that of the other below 3, or smaller by 3 standard deviations of the difference.
    """
    if "image" not in found.maps:
        text = f"Specimen: inconclusive, because the sheet and the {image} share no field."
        return SideFound(_check("unknown", text, None))
    seen: list[Side] = [k for k in coated if f"coating_{k}" in found.maps]
    names: dict[Side, list[str]] = {k: [f"coating_{k}"] for k in seen}
    coatings = _faces(found, names)
    words = f"The {side} side was {'given' if given else 'assumed (--image-side not given)'}"
    other: Side = "bottom" if side == "top" else "top"
    shown = f"the coating of the {side} side ({coatings[side]})" if side in coatings else ""
    rest = f"that of the {other} side ({coatings[other]})" if other in coatings else ""
    if side in coatings and _stands_out(coatings[side], coatings.get(other)):
        end = f"{_than(coatings[other])} {rest}" if rest else f"; no coating is seen on the {other} side"
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
    if any(abs(k.z) > GOES for k in coatings.values()):
        text = f"Side: inconclusive, because the {image} goes with both coatings, {shown} and {rest}, {_ONE}."
        return SideFound(_check("unknown", text, max(coatings.values(), key=lambda k: abs(k.z))))
    return _by_the_rest(found, coatings, side, words, image)


def _by_the_rest(
    found: Textures, coatings: Mapping[Side, Relation], side: Side, words: str, image: str
) -> SideFound:  # fmt: skip
    """No coating goes with the image: what slopes of the faces under light from one side say, and the thickness."""
    other: Side = "bottom" if side == "top" else "top"
    for k in SIDES:
        if f"topography_{k}" in found.maps:
            found = found.with_slopes(f"topography_{k}")
    slopes = _faces(found, {k: [f"topography_{k}_{way}" for way in "xy"] for k in SIDES})
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
    plain = {k: relate(found.maps[k], found.maps["image"], found.known, found.pixel_um) for k in found.maps if k in (
        "thickness", "base_thickness", f"topography_{side}")}  # fmt: skip
    plain |= {f"slopes of the {k} face": relation for k, relation in slopes.items()}
    best = max(plain, key=lambda k: abs(plain[k].z), default=None)
    if best is not None and abs(plain[best].z) > GOES:
        rest = f"it goes with the {best.replace('_', ' ')} of the sheet ({plain[best]}), {_ONE}"
    else:
        rest = _NO_WORD
    if coatings and side in coatings:
        text = f"The {image} goes with no coating ({tried}; {GOES} is needed), and {rest}."
        advice = "Compare map and image by eye: is it this specimen, this place, and a side that shows its coating?"
        one = max(coatings.values(), key=lambda k: abs(k.z))
        figures = _OF_A_SPECIMEN if rest == _NO_WORD else (CORRELATION,)
        return SideFound(_check("look", text, one, advice=advice, figures=figures))
    text = f"Side: inconclusive, because no coating is seen on the {side} side; {rest}."
    return SideFound(_check("unknown", text, plain[best] if best else None))


def two_images(found: Textures, names: tuple[str, str]) -> Check:
    """Judge whether two images, ``image`` and ``other image``, show one specimen by their texture, with either sign."""
    if not {"image", "other image"} <= found.maps.keys():
        text = f"Specimen: inconclusive, because {names[0]} and {names[1]} share no field."
        return _check("unknown", text, None)
    r = relate(found.maps["image"], found.maps["other image"], found.known, found.pixel_um)
    if abs(r.z) > GOES:
        return _check("pass", f"The textures of {names[0]} and {names[1]} go together ({r}), {_ONE}.", r)
    text = f"The textures of {names[0]} and {names[1]} do not go together ({r}; {GOES} is needed): {_NO_WORD}."
    advice = "Compare both by eye: are they one specimen, one side, and is one of them a mirror image?"
    return _check("look", text, r, advice=advice, figures=_OF_A_SPECIMEN)


def two_sheets(found: Textures, names: tuple[str, str], *, coated: Iterable[Side]) -> Check:
    """Judge whether two sheets are one specimen with the same side up.

    ``found`` holds the maps of the first by their names, those of the second as ``other NAME``; ``coated`` are the
    sides on which both show a coating. The same quantity is compared, so r has to be positive.
    """

    def r(a: str, b: str) -> Relation | None:
        if a not in found.maps or f"other {b}" not in found.maps:
            return None
        return relate(found.maps[a], found.maps[f"other {b}"], found.known, found.pixel_um)

    sides = [f"coating_{k}" for k in coated]
    same = _mean([r(k, k) for k in sides])
    cross = _mean([r(*sides), r(*reversed(sides))]) if len(sides) == len(SIDES) else None
    whole = r("thickness", "thickness")
    a, b = names
    if same is not None and same.z > GOES and _stands_out(same, cross):
        end = f", not crosswise ({cross})" if cross else ""
        return _check("pass", f"The coatings of {a} and {b} go together side by side ({same}){end}, {_ONE}.", same)
    if same is not None and cross is not None and cross.z > GOES and _stands_out(cross, same):
        text = f"The coatings of {a} and {b} go together crosswise ({cross}), not side by side ({same})."
        advice = "Top and bottom of one of the two are exchanged. Check --top, and whether its slices are numbered "
        advice += "against the usual sense."
        return _check("fail", text, cross, advice=advice, figures=_OF_SIDES)
    if whole is not None and whole.z > GOES:
        why = "the coatings do not tell the sides apart" if same else "no coating is seen in both"
        text = f"Side: inconclusive, because {why}; the thicknesses of {a} and {b} go together ({whole}), {_ONE}."
        return _check("unknown", text, whole)
    tried = "; ".join(f"{k} {v}" for k, v in (("coatings", same), ("thickness", whole)) if v is not None)
    if not tried:
        return _check("unknown", f"Specimen: inconclusive, because {a} and {b} have no map in common.", None)
    text = f"No map of {a} goes with that of {b} ({tried}; {GOES} is needed): {_NO_WORD}."
    advice = "Either they are not the same piece of paper, or they do not lie on each other, or one is measured badly."
    return _check("look", text, same or whole, advice=advice, figures=_OF_A_SPECIMEN)


def _check(
    state: str, text: str, relation: Relation | None, *, advice: str = "", figures: tuple[str, ...] = ()
) -> Check:  # fmt: skip
    value = math.nan if relation is None else relation.z
    return Check.model_validate({
        "name": NAME, "state": state, "sentence": text, "value": value, "limit": GOES, "units": "z", "advice": advice,
        "figures": figures,
    })  # fmt: skip


def _stands_out(one: Relation, other: Relation | None) -> bool:
    """Whether a face goes with the image, and the other one does not, or clearly less."""
    if not abs(one.z) > GOES:
        return False
    return other is None or abs(other.z) < STAYS or abs(one.part) - abs(other.part) > STAYS * math.hypot(
        one.part_se, other.part_se)  # fmt: skip


def _than(other: Relation) -> str:
    return ", not with" if abs(other.z) < STAYS else ", more than with"


def _faces(found: Textures, names: Mapping[Side, list[str]]) -> dict[Side, Relation]:
    """Partial correlation of each face with the image; of several maps of a face that which stands out most."""
    image, out = found.maps["image"], dict[Side, Relation]()
    for side, own in names.items():
        best: Relation | None = None
        for k, name in enumerate(own):
            if name not in found.maps:
                continue
            a, b = found.maps[name], image
            for rival in (maps[k] for of, maps in names.items() if of != side):
                if rival in found.maps:
                    a, b = apart(a, found.maps[rival]), apart(b, found.maps[rival])
            r = relate(a, b, found.known, found.pixel_um, of=image)
            if best is None or abs(r.z) > abs(best.z):
                best = r
        if best is not None:
            out[side] = best
    return out


def _mean(relations: Iterable[Relation | None]) -> Relation | None:
    """Mean of correlations of maps that go together or not as one."""
    known = [k for k in relations if k is not None]
    if not known:
        return None
    n = len(known)
    r, sd = sum(k.r for k in known) / n, math.sqrt(sum(k.sd**2 for k in known)) / n
    return Relation(r, sd, r, sd)
