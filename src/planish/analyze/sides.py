"""What two layers on one grid say by their own texture: side, specimen, and where they lie."""

import math
from collections.abc import Iterable, Mapping
from itertools import repeat
from typing import Any, NamedTuple, TypeGuard

import numpy as np
import xarray as xr

from planish.analyze import lag
from planish.analyze.lag import LagNumbers
from planish.core.bands import any_finite, rms_of, thinned
from planish.core.checks import CORRELATION, POSITION, Check, State
from planish.core.errors import SizeError
from planish.core.facts import SIDES, Side
from planish.core.grid import Grid, shorter_side_um
from planish.core.numbers import capital, with_article
from planish.core.older_names import height_map
from planish.core.typing import Bools, Texts, pair_of
from planish.measure.registry import HEIGHTS
from planish.register.by_texture.rotations import FALSE
from planish.texture.textures import Relation, Textures, relate, textures, unexplained

NAME = "side and specimen"
Z_RELATED, Z_CLEAR = 4.5, 3.0
"""|z| above which two textures go together, and below which they do not."""

_OF_A_SPECIMEN = (POSITION, CORRELATION)
"""Where nothing says that both show one specimen, a pixel may have no place in it."""
_OF_SIDES = (
    *("coating_top", "coating_bottom", *HEIGHTS, "half_thickness_top", "half_thickness_bottom"),
    CORRELATION,
)
_NO_WORD = "nothing beside the marks says that both show one specimen"
_ONE = "so both show one specimen"
_OPPOSITE: dict[Side, Side] = {"top": "bottom", "bottom": "top"}
_TURN = (
    "Turn the stack (`top`; a volume numbered against the usual sense needs `mirror=True`), or give"
    " `image_side={side}` if the image shows that side."
)

_TILE_UM = 1000.0
_MAPS = ("coating_top", "coating_bottom", "thickness", "base_thickness")


class SideFound(NamedTuple):
    """The check, and the side whose texture the image has; None where that cannot be told."""

    check: Check
    side: Side | None = None


def image_of_sheet(
    texture: Textures, *, coated: Iterable[Side], side: Side, is_given: bool, image: str
) -> SideFound:
    """Judge which face of a sheet goes with an image.

    Parameters
    ----------
    texture : Textures; the sheet's maps by their names, and ``image``
    coated : iterable of {"top", "bottom"}; sides on which a coating is seen
    side : {"top", "bottom"}; side that the image shows as given or, where ``is_given`` is False, as
    assumed
    image : str; what the sentence calls the image

    Notes
    -----
    Brightness may rise or fall with the coating, so ``|r|`` counts. Both faces share the base, and
    light goes through thin paper: what the other coating explains is taken off first (partial
    correlation). A face is the one if its ``|z|`` is above 4.5 and that of the other below 3, or
    smaller by 3 standard deviations of the difference.
    """
    image = with_article(image)
    if "image" not in texture.maps:
        text = f"Specimen: inconclusive, because the sheet and {image} share no field."
        return SideFound(_check("unknown", text))
    coatings = _faces(texture, {k: [f"coating_{k}"] for k in coated})
    origin = "given" if is_given else "assumed"
    side_text = f"The {side} side was {origin}"
    other = _OPPOSITE[side]
    side_coating = coatings.get(side)
    other_coating = coatings.get(other)
    if _stands_out(side_coating, other_coating):
        rival_text = f"; no coating is seen on the {other} side"
        if other_coating is not None:
            rival_text = _compared_with(other_coating, other)
        text = (
            f"{capital(image)} correlates with the coating of the {side} side"
            f" ({side_coating}){rival_text}. {side_text}."
        )
        return _showing(side, side, text, side_coating)
    if _stands_out(other_coating, side_coating):
        text = f"{capital(image)} correlates with the coating of the {other} side ({other_coating})"
        if side_coating is not None:
            text += f"{_compared_with(side_coating, side)}. {side_text}."
            return _showing(other, side, text, other_coating, state="fail")
        text += f", and none is seen on the {side} side. {side_text}."
        hint = " Light that goes through the sheet may show it as well."
        return _showing(other, side, text, other_coating, hint=hint)
    strongest_coating = _strongest(coatings.values())
    if strongest_coating is not None and abs(strongest_coating.z) > Z_RELATED:
        text = (
            f"Side: inconclusive, because {image} correlates with both coatings, the coating of the"
            f" {side} side ({side_coating}) and that of the {other} side ({other_coating}), {_ONE}."
        )
        return SideFound(_check("unknown", text, strongest_coating))
    return _by_slopes_and_thickness(texture, coatings, side, side_text, image)


def _by_slopes_and_thickness(
    texture: Textures, coatings: Mapping[Side, Relation], side: Side, side_text: str, image: str
) -> SideFound:
    """State what face slopes and the thickness say where no coating goes with the image.

    The slopes are those of the faces under light from one side. ``coatings`` are the relations that
    were tried, ``side_text`` says where ``side`` comes from, ``image`` names the image.
    """
    heights: dict[Side, str] = {k: height_map(k, texture.maps) for k in SIDES}
    for name in heights.values():
        if name in texture.maps:
            texture = texture.with_slopes(name)
    names: dict[Side, list[str]] = {k: [f"{name}_x", f"{name}_y"] for k, name in heights.items()}
    slopes = _faces(texture, names)
    tried_text = "; ".join(f"coating of the {k} side {r}" for k, r in coatings.items())
    for face in (side, _OPPOSITE[side]):
        shown = slopes.get(face)
        if not _stands_out(shown, slopes.get(_OPPOSITE[face])):
            continue
        not_coatings_text = ""
        if tried_text:
            not_coatings_text = f", not with the coatings ({tried_text})"
        text = (
            f"{capital(image)} correlates with the slopes of the {face} face, as light from one"
            f" side shows them ({shown}){not_coatings_text}. {side_text}."
        )
        return _showing(face, side, text, shown)
    return SideFound(_without_side(texture, coatings, slopes, side, tried_text, image))


def _without_side(
    texture: Textures,
    coatings: Mapping[Side, Relation],
    slopes: Mapping[Side, Relation],
    side: Side,
    tried_text: str,
    image: str,
) -> Check:
    """Judge whether thickness, heights or slopes say that both show one specimen.

    The side is not told by them. Where the sheet has a coating on it, that its coating does not
    show asks for a look.
    """
    names = ("thickness", "base_thickness", height_map(side, texture.maps))
    relations = {k: _relation(texture, k, "image") for k in texture.maps if k in names}
    relations |= {f"slopes of the {k} face": relation for k, relation in slopes.items()}
    best_map = max(relations, key=lambda k: abs(relations[k].z), default="")
    best = relations.get(best_map)
    specimen_text = _NO_WORD
    figures = _OF_A_SPECIMEN
    if best is not None and abs(best.z) > Z_RELATED:
        map_text = best_map.replace("_", " ")
        specimen_text = f"it correlates with the {map_text} ({best}), {_ONE}"
        figures = (CORRELATION,)
    if side not in coatings:
        text = (
            f"Side: inconclusive, because no coating is seen on the {side} side; {specimen_text}."
        )
        return _check("unknown", text, best)
    text = (
        f"{capital(image)} correlates with no coating ({tried_text}; needed: {Z_RELATED}), and"
        f" {specimen_text}."
    )
    advice = (
        "Compare map and image by eye: is it this specimen, this place, and a side that shows"
        " its coating?"
    )
    return _check("look", text, _strongest(coatings.values()), advice=advice, figures=figures)


def two_images(texture: Textures, names: tuple[str, str]) -> Check:
    """Judge by their texture whether ``image`` and ``other image`` show one specimen.

    Parameters
    ----------
    texture : Textures; both images, whose textures may go together with either sign
    names : (str, str); what the sentence calls them

    Returns
    -------
    Check
    """
    a, b = names
    if not {"image", "other image"} <= texture.maps.keys():
        return _check("unknown", f"Specimen: inconclusive, because {a} and {b} share no field.")
    r = _relation(texture, "image", "other image")
    if abs(r.z) > Z_RELATED:
        return _check("pass", f"The textures of {a} and {b} go together ({r}), {_ONE}.", r)
    text = (
        f"The textures of {a} and {b} do not go together ({r}; {Z_RELATED} is needed): {_NO_WORD}."
    )
    advice = (
        "Compare both by eye: are they one specimen, one side, and is one of them a mirror image?"
    )
    return _check("look", text, r, advice=advice, figures=_OF_A_SPECIMEN)


def two_sheets(texture: Textures, names: tuple[str, str], *, coated: Iterable[Side]) -> Check:
    """Judge whether two sheets are one specimen with the same side up.

    Parameters
    ----------
    texture : Textures
        Maps of the first sheet by their names, those of the second as ``other NAME``. The same
        quantity is compared, so r has to be positive.
    names : (str, str); what the sentence calls the sheets
    coated : iterable of {"top", "bottom"}; sides on which both show a coating

    Returns
    -------
    Check
    """
    coatings = [f"coating_{k}" for k in coated]
    same = _mean_relation(texture, zip(coatings, coatings, strict=True))
    cross = None
    if len(coatings) == len(SIDES):
        cross = _mean_relation(texture, zip(coatings, reversed(coatings), strict=True))
    a, b = names
    if _is_related(same) and _stands_out(same, cross):
        end = f", not crosswise ({cross})" if cross else ""
        text = f"The coatings of {a} and {b} go together side by side ({same}){end}, {_ONE}."
        return _check("pass", text, same)
    if same is not None and _is_related(cross) and _stands_out(cross, same):
        return _check(
            "fail",
            f"The coatings of {a} and {b} go together crosswise ({cross}), not side by side"
            f" ({same}).",
            cross,
            advice="Top and bottom of one of the two are exchanged.",
            remedy="Check `top`, and whether its slices are numbered against the usual sense.",
            figures=_OF_SIDES,
        )
    return _by_thickness(names, same, _mean_relation(texture, [("thickness", "thickness")]))


def _by_thickness(
    names: tuple[str, str], coatings: Relation | None, thickness: Relation | None
) -> Check:
    """The check of two sheets whose coatings do not go together.

    The relations are the mean one of equal coatings and that of the thicknesses, None where a map
    is not in both.
    """
    a, b = names
    if _is_related(thickness):
        why = "the coatings do not tell the sides apart"
        if coatings is None:
            why = "no coating is seen in both"
        text = (
            f"Side: inconclusive, because {why}; the thicknesses of {a} and {b} go together"
            f" ({thickness}), {_ONE}."
        )
        return _check("unknown", text, thickness)
    relations = (("coatings", coatings), ("thickness", thickness))
    tried = [f"{name} {relation}" for name, relation in relations if relation is not None]
    if not tried:
        return _check(
            "unknown", f"Specimen: inconclusive, because {a} and {b} have no map in common."
        )
    text = (
        f"No map of {a} correlates with that of {b} ({'; '.join(tried)}; {Z_RELATED} is needed):"
        f" {_NO_WORD}."
    )
    advice = (
        "Either they are not the same piece of paper, or they are not aligned, or one is badly"
        " measured."
    )
    return _check("look", text, coatings or thickness, advice=advice, figures=_OF_A_SPECIMEN)


def _check(state: State, text: str, relation: Relation | None = None, **fields: Any) -> Check:
    """A check by the z of a relation, with the fields that it has besides."""
    z = None if relation is None else relation.z
    return Check(
        name=NAME, state=state, sentence=text, value=z, limit=Z_RELATED, units="z", **fields
    )


def _showing(
    face: Side,
    side: Side,
    text: str,
    relation: Relation | None,
    *,
    state: State = "look",
    hint: str = "",
) -> SideFound:
    """The check of an image that shows a face; ``state`` is of one that is not the side given."""
    if face == side:
        return SideFound(_check("pass", text, relation), face)
    advice = f"Top and bottom are exchanged.{hint}"
    remedy = _TURN.format(side=face)
    check = _check(state, text, relation, advice=advice, remedy=remedy, figures=_OF_SIDES)
    return SideFound(check, face)


def _relation(texture: Textures, first: str, second: str) -> Relation:
    return relate(texture.maps[first], texture.maps[second], texture.known, texture.pixel_um)


def _is_related(relation: Relation | None) -> TypeGuard[Relation]:
    """Whether one quantity of two sheets goes together."""
    return relation is not None and relation.z > Z_RELATED


def _stands_out(face: Relation | None, rival: Relation | None) -> bool:
    """Whether a face goes with the image, and the other one does not, or clearly less."""
    if face is None or not abs(face.z) > Z_RELATED:
        return False
    if rival is None or abs(rival.z) < Z_CLEAR:
        return True
    scatter = math.hypot(face.part_se, rival.part_se)
    return abs(face.part) - abs(rival.part) > Z_CLEAR * scatter


def _strongest(relations: Iterable[Relation]) -> Relation | None:
    return max(relations, key=lambda relation: abs(relation.z), default=None)


def _compared_with(relation: Relation, side: Side) -> str:
    """The end of a sentence: how the coating of the other side compares."""
    start = ", not with" if abs(relation.z) < Z_CLEAR else ", more than with"
    return f"{start} that of the {side} side ({relation})"


def _faces(texture: Textures, names: Mapping[Side, list[str]]) -> dict[Side, Relation]:
    """Partial correlation of each face with the image, by its side.

    ``names`` are the maps of each face, such as its slopes along x and y, in the same order on both
    sides. Of several maps of a face that which stands out most is taken; a face without any of its
    maps is left out.
    """
    strongest_relations: dict[Side, Relation] = {}
    for side, names_of_side in names.items():
        rival_names = names.get(_OPPOSITE[side], repeat(""))
        relations: list[Relation] = []
        for name, rival_name in zip(names_of_side, rival_names, strict=False):
            if name in texture.maps:
                relations.append(_face_relation(texture, name, rival_name))
        strongest = _strongest(relations)
        if strongest is not None:
            strongest_relations[side] = strongest
    return strongest_relations


def _face_relation(texture: Textures, name: str, rival_name: str) -> Relation:
    """Correlation of a map of a face with the image, freed of that of the other face."""
    image = texture.maps["image"]
    face = texture.maps[name]
    shown = image
    rival = texture.maps.get(rival_name)
    if rival is not None:
        face = unexplained(face, rival)
        shown = unexplained(image, rival)
    return relate(face, shown, texture.known, texture.pixel_um, of=image)


def _mean_relation(texture: Textures, pairs: Iterable[tuple[str, str]]) -> Relation | None:
    """Mean relation of maps of the first sheet and maps of the second; None where none is known.

    ``pairs`` name them; in the texture those of the second sheet are ``other NAME``. Deviations of
    several pairs are taken for independent.
    """
    measured = [(name, f"other {other}") for name, other in pairs]
    measured = [pair for pair in measured if texture.maps.keys() >= {*pair}]
    if not measured:
        return None
    relations = [_relation(texture, *pair) for pair in measured]
    n = len(relations)
    r = sum(relation.r for relation in relations) / n
    sd = math.hypot(*(relation.sd for relation in relations)) / n
    return Relation(r, sd, r, sd)  # no partial r beside it: the same twice


class TextureFound(NamedTuple):
    """Where the texture of two layers puts them, None where there are too few pixels.

    And what was judged.
    """

    lag: LagNumbers | None
    checks: tuple[Check, ...]


def texture_of(
    a: xr.Dataset,
    b: xr.Dataset,
    names: tuple[str, str],
    *,
    side: Side = "top",
    is_given: bool = True,
    unit_um: float = 1.0,
) -> TextureFound:
    """Compare two layers on one grid by their own texture.

    Parameters
    ----------
    a, b : Dataset, dims (y, x); sheets or images, with ``valid``
    names : (str, str); what the sentences call them
    side : {"top", "bottom"}
        Side of the sheet that an image shows, given or, where ``is_given`` is False, assumed.
    unit_um : float, in um; unit of the waves, tiles and reaches that are stated for paper

    Returns
    -------
    TextureFound
    """
    if "thickness" in b and "thickness" not in a:
        a, b = b, a
        names = (names[1], names[0])
    valid = a["valid"].values & b["valid"].values
    pixel = pair_of(np.divide(Grid.of(a).pixel_um, unit_um))
    try:
        texture = textures(_maps_of_pair(a, b, valid), valid, pixel)
    except SizeError as error:
        text = f"Specimen and position by texture: inconclusive. {error.text}"
        return TextureFound(None, (Check(name=NAME, state="unknown", sentence=text),))
    judged = _judged_layers(texture, a, b, names, side, is_given=is_given)
    check = judged.check
    if _lost_its_screen(a) or _lost_its_screen(b):
        return _without_screen(check)
    expected_um = _expected_um(a, b, valid)
    texture = judged.texture
    short = shorter_side_um(texture.known.shape, texture.pixel_um)
    tiles_um = None
    if short >= 2 * _TILE_UM:
        tiles_um = _TILE_UM
    source_maps = [*judged.source_maps, *judged.slopes]
    try:
        offset = lag.texture_lag(
            texture,
            source_maps,
            judged.target_map,
            slopes=len(judged.slopes),
            reach_um=min(150.0, short / 4),
            tiles_um=tiles_um,
        )
    except SizeError:
        return TextureFound(None, (check,))
    offset = offset.scaled(unit_um)
    if offset.distinct:
        check = _moved(check, offset.length_um)
    numbers = offset.numbers(source_maps[0], expected_um)
    return TextureFound(numbers, (check, offset.check(expected_um)))


def _expected_um(a: xr.Dataset, b: xr.Dataset, valid: Bools) -> float | None:
    """Expected error of the registration, rms over the map; None where neither layer states it."""
    for layer in (a, b):
        if "expected_error" in layer:
            return rms_of(layer["expected_error"], valid)
    return None


class _Judged(NamedTuple):
    """The check of side and specimen, and the maps whose lag says where both layers lie."""

    check: Check
    texture: Textures
    source_maps: list[str]
    target_map: str
    slopes: Texts = ()


def _judged_layers(
    texture: Textures,
    a: xr.Dataset,
    b: xr.Dataset,
    names: tuple[str, str],
    side: Side,
    *,
    is_given: bool,
) -> _Judged:
    """Judge two images, two sheets, or a sheet and an image, which comes second.

    ``texture`` holds the maps of both layers on the pixels that count; ``names`` are what sentences
    call the layers, ``side`` is the one that an image shows, as given or as assumed.
    """
    if "thickness" not in a:
        return _Judged(two_images(texture, names), texture, ["image"], "other image")
    coated = _coated(a)
    if "thickness" in b:
        coated_of_b = _coated(b)
        coated_in_both: list[Side] = [k for k in coated if k in coated_of_b]
        source_map = "thickness"
        if coated_in_both:
            source_map = f"coating_{coated_in_both[0]}"
        check = two_sheets(texture, names, coated=coated_in_both)
        return _Judged(check, texture, [source_map], f"other {source_map}")
    _, image = names
    check, face = image_of_sheet(texture, coated=coated, side=side, is_given=is_given, image=image)
    return _Judged(check, *_shown_of(texture, face or side, coated))


def _moved(check: Check, length_um: float) -> Check:
    """Say of maps that do not go together where they lie that they do when they are moved."""
    if check.state != "look" or not set(check.figures) <= {POSITION, CORRELATION}:
        return check
    text = f"Moved by {length_um:.3g} um they do go together (position by texture)."
    return check.model_copy(update={"sentence": f"{check.sentence} {text}"})


def _shown_of(
    texture: Textures, face: Side, coated: Iterable[Side]
) -> tuple[Textures, list[str], str, Texts]:
    """The maps that an image of a face follows, the image, and the slopes that side light shows.

    As the fields of :class:`_Judged` but for the check. The image follows the coating, or thickness
    and height where the face has no coating or light goes through the sheet; the slopes of the
    height along x and y are added to the texture. No slopes where the sheet has no map of heights.
    """
    heights = height_map(face, texture.maps)
    coating = f"coating_{face}"
    is_of_coating = face in coated and not _goes_through(texture, coating)
    source_maps = [coating] if is_of_coating else ["thickness"]
    if heights not in texture.maps:
        return texture, source_maps, "image", ()
    if not is_of_coating:
        source_maps.append(heights)
    slopes = (f"{heights}_x", f"{heights}_y")
    return texture.with_slopes(heights), source_maps, "image", slopes


def _lost_its_screen(layer: xr.Dataset) -> bool:
    """Whether a layer is an image whose print screen was taken off."""
    return "image" in layer and "reach_um" in layer["image"].attrs


def _without_screen(check: Check) -> TextureFound:
    """What is left to say of an image whose fine texture went with its print screen."""
    screen_text = "was taken off with the screen."
    # The texture that would show the side is gone: that none goes is no evidence.
    if check.state == "look":
        text = (
            "Side and specimen: inconclusive, because the fine texture that would show it"
            f" {screen_text}"
        )
        check = Check(name=NAME, state="unknown", sentence=text)
    text = f"Image-based check: not made, because the fine texture that it aligns {screen_text}"
    return TextureFound(None, (check, lag.inconclusive(text)))


def _goes_through(texture: Textures, coating: str) -> bool:
    """Whether an image goes with the thickness clearly better than with a coating.

    In transmitted light or a radiograph it does. With the coating alone, slopes of the face would
    stand for the heights that the coating lacks, and move the peak.
    """
    if not {coating, "thickness", "image"} <= texture.maps.keys():
        return False
    of_coating = _relation(texture, coating, "image")
    return _stands_out(_relation(texture, "thickness", "image"), of_coating)


def _maps_of(layer: xr.Dataset, valid: Bools) -> dict[str, xr.DataArray]:
    """Maps of a layer whose texture is compared, where any pixel that counts has a value."""
    heights = [height_map(side, layer) for side in SIDES]
    maps: dict[str, xr.DataArray] = {}
    for name in (*_MAPS, *heights, "image"):
        if name in layer and any_finite(layer[name], valid):
            maps[name] = layer[name]
    return maps


def _maps_of_pair(a: xr.Dataset, b: xr.Dataset, valid: Bools) -> dict[str, xr.DataArray]:
    """Maps of both layers; those of b are ``other`` ones, but for the image of a sheet."""
    maps_of_b = _maps_of(b, valid)
    if "thickness" in a and "thickness" not in b:
        renamed = {k: m for k, m in maps_of_b.items() if k == "image"}
    else:
        renamed = {f"other {k}": m for k, m in maps_of_b.items()}
    return _maps_of(a, valid) | renamed


def found_by_texture(sentence: str, false_probability: float | None) -> tuple[Check, Check]:
    """Judge by the search layers that were registered by their texture.

    What the search made large is no evidence.
    """
    check = _check(
        "unknown",
        "Specimen: inconclusive, because the marks are tiles whose search is not known;"
        f" {_NO_WORD}.",
    )
    if false_probability is not None:
        check = Check(
            name=NAME,
            state="pass",
            sentence=f"{sentence} So both show one specimen.",
            value=false_probability,
            limit=FALSE,
            units="probability",
        )
    text = (
        "Image-based check: not made, because the place was found by the texture that it compares."
    )
    return check, lag.inconclusive(text)


def holes_and_texture(apart_um: float, expected_um: float) -> Check:
    """Judge how far apart holes and texture, each fitted by itself, put the middle of a map.

    ``apart_um`` is the distance between both places, ``expected_um`` the error of it, rms, by the
    errors of both. 95 % of such distances stay below the limit.
    """
    limit_um = lag.ALLOWED * expected_um
    text = f"Holes and texture, each by itself, put the middle of the map {apart_um:.1f} um apart"
    state: State = "pass"
    advice = remedy = ""
    if apart_um <= limit_um:
        text += f", which both errors allow (up to {limit_um:.1f} um)."
    else:
        state = "look"
        text += f", more than both errors allow ({limit_um:.1f} um)."
        advice = "Light from one side, tilted holes, or marks of another place."
        remedy = "Compare `by=holes` and `by=texture`."
    return Check(
        name=lag.NAME,
        state=state,
        sentence=text,
        value=apart_um,
        limit=limit_um,
        units="um",
        advice=advice,
        remedy=remedy,
        figures=(POSITION, CORRELATION),
    )


def _coated(sheet: xr.Dataset) -> list[Side]:
    """Sides with a coating measured in most of a sheet and thicker than 3 standard errors.

    By medians at some pixels; most is half of those that count. A coating whose error is not stated
    only has to be above 0.
    """
    sides: list[Side] = []
    for side in SIDES:
        names = (f"coating_{side}", f"coating_{side}_se")
        measured = [sheet[k] for k in names if k in sheet]
        # At some pixels spread over the sheet.
        use, *maps = thinned(sheet["valid"], *measured)[1]
        coat_um, *errors_um = (m[use & np.isfinite(m)] for m in maps)
        limit_um = 3.0 * sum(np.median(m) for m in errors_um if m.size)
        half_of_sheet = 0.5 * np.count_nonzero(use)
        is_measured = coat_um.size >= max(1, half_of_sheet)
        if is_measured and np.median(coat_um) > limit_um:
            sides.append(side)
    return sides
