"""What two layers on one grid say by their own texture: side, specimen, and where they lie."""

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr

from planish.analyze import lag
from planish.analyze.lag import LagNumbers
from planish.core.bands import any_finite, rms_of, thinned
from planish.core.checks import CORRELATION, POSITION, Check, State
from planish.core.errors import SizeError
from planish.core.facts import SIDES, Side
from planish.core.grid import Grid
from planish.core.numbers import capital, with_article
from planish.core.older_names import height_map
from planish.core.typing import Bools
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
_EXCHANGED = "Top and bottom are exchanged."
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
        return SideFound(
            _check(
                "unknown", f"Specimen: inconclusive, because the sheet and {image} share no field."
            )
        )
    coatings = _faces(texture, {k: [f"coating_{k}"] for k in coated})
    side_text = f"The {side} side was {'given' if is_given else 'assumed'}"
    other: Side = "bottom" if side == "top" else "top"
    side_coating = coatings.get(side)
    other_coating = coatings.get(other)
    if side_coating is not None and _stands_out(side_coating, other_coating):
        end = f"; no coating is seen on the {other} side"
        if other_coating is not None:
            end = f"{_preposition(other_coating)} that of the {other} side ({other_coating})"
        text = (
            f"{capital(image)} correlates with the coating of the {side} side"
            f" ({side_coating}){end}. {side_text}."
        )
        return SideFound(_check("pass", text, side_coating), side)
    if other_coating is not None and _stands_out(other_coating, side_coating):
        text = f"{capital(image)} correlates with the coating of the {other} side ({other_coating})"
        advice = _EXCHANGED
        remedy = _TURN.format(side=other)
        if side_coating is not None:
            text += (
                f"{_preposition(side_coating)} that of the {side} side ({side_coating})."
                f" {side_text}."
            )
            return SideFound(
                _check(
                    "fail", text, other_coating, advice=advice, remedy=remedy, figures=_OF_SIDES
                ),
                other,
            )
        text += f", and none is seen on the {side} side. {side_text}."
        advice += " Light that goes through the sheet may show it as well."
        return SideFound(
            _check("look", text, other_coating, advice=advice, remedy=remedy, figures=_OF_SIDES),
            other,
        )
    strongest_coating = max(coatings.values(), key=lambda k: abs(k.z), default=None)
    if strongest_coating is not None and abs(strongest_coating.z) > Z_RELATED:
        text = (
            f"Side: inconclusive, because {image} correlates with both coatings, the coating of the"
            f" {side} side "
        )
        text += f"({side_coating}) and that of the {other} side ({other_coating}), {_ONE}."
        return SideFound(_check("unknown", text, strongest_coating))
    return _by_slopes_and_thickness(texture, coatings, side, side_text, image)


def _by_slopes_and_thickness(
    texture: Textures, coatings: Mapping[Side, Relation], side: Side, side_text: str, image: str
) -> SideFound:
    """State what face slopes and the thickness say where no coating goes with the image.

    The slopes are those of the faces under light from one side.
    """
    heights = {k: height_map(k, texture.maps) for k in SIDES}
    for name in heights.values():
        if name in texture.maps:
            texture = texture.with_slopes(name)
    slopes = _faces(texture, {k: [f"{heights[k]}_{way}" for way in "xy"] for k in SIDES})
    tried_text = "; ".join(
        f"coating of the {k} side {relation}" for k, relation in coatings.items()
    )
    rivals: dict[Side, Side] = {"top": "bottom", "bottom": "top"}
    for face in (side, rivals[side]):
        if face in slopes and _stands_out(slopes[face], slopes.get(rivals[face])):
            not_coatings_text = f", not with the coatings ({tried_text})" if tried_text else ""
            text = (
                f"{capital(image)} correlates with the slopes of the {face} face, as light from one"
                " side shows them "
            )
            text += f"({slopes[face]}){not_coatings_text}. {side_text}."
            if face == side:
                return SideFound(_check("pass", text, slopes[face]), face)
            advice = _EXCHANGED
            remedy = _TURN.format(side=face)
            return SideFound(
                _check("look", text, slopes[face], advice=advice, remedy=remedy, figures=_OF_SIDES),
                face,
            )
    relations = {
        k: relate(m, texture.maps["image"], texture.known, texture.pixel_um)
        for k, m in texture.maps.items()
        if k in ("thickness", "base_thickness", heights[side])
    }
    relations |= {f"slopes of the {k} face": relation for k, relation in slopes.items()}
    best_map = max(relations, key=lambda k: abs(relations[k].z), default=None)
    specimen_text, figures = _NO_WORD, _OF_A_SPECIMEN
    if best_map is not None and abs(relations[best_map].z) > Z_RELATED:
        specimen_text = (
            f"it correlates with the {best_map.replace('_', ' ')} ({relations[best_map]}), {_ONE}"
        )
        figures = (CORRELATION,)
    if side in coatings:
        text = (
            f"{capital(image)} correlates with no coating ({tried_text}; needed: {Z_RELATED}), and"
            f" {specimen_text}."
        )
        advice = (
            "Compare map and image by eye: is it this specimen, this place, and a side that shows"
            " its coating?"
        )
        strongest_coating = max(coatings.values(), key=lambda k: abs(k.z))
        return SideFound(_check("look", text, strongest_coating, advice=advice, figures=figures))
    text = f"Side: inconclusive, because no coating is seen on the {side} side; {specimen_text}."
    return SideFound(_check("unknown", text, relations[best_map] if best_map else None))


def two_images(texture: Textures, names: tuple[str, str]) -> Check:
    """Judge by their texture whether ``image`` and ``other image`` show one specimen.

    The textures of the two images may go together with either sign.
    """
    if not {"image", "other image"} <= texture.maps.keys():
        return _check(
            "unknown", f"Specimen: inconclusive, because {names[0]} and {names[1]} share no field."
        )
    r = relate(texture.maps["image"], texture.maps["other image"], texture.known, texture.pixel_um)
    if abs(r.z) > Z_RELATED:
        return _check(
            "pass", f"The textures of {names[0]} and {names[1]} go together ({r}), {_ONE}.", r
        )
    text = (
        f"The textures of {names[0]} and {names[1]} do not go together ({r}; {Z_RELATED} is"
        f" needed): {_NO_WORD}."
    )
    advice = (
        "Compare both by eye: are they one specimen, one side, and is one of them a mirror image?"
    )
    return _check("look", text, r, advice=advice, figures=_OF_A_SPECIMEN)


def two_sheets(texture: Textures, names: tuple[str, str], *, coated: Iterable[Side]) -> Check:
    """Judge whether two sheets are one specimen with the same side up.

    ``texture`` holds the maps of the first by their names, those of the second as ``other NAME``;
    ``coated`` are the sides on which both show a coating. The same quantity is compared, so r has
    to be positive.
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
        return _check(
            "pass",
            f"The coatings of {a} and {b} go together side by side ({same}){end}, {_ONE}.",
            same,
        )
    if same is not None and cross is not None and cross.z > Z_RELATED and _stands_out(cross, same):
        text = (
            f"The coatings of {a} and {b} go together crosswise ({cross}), not side by side"
            f" ({same})."
        )
        return _check(
            "fail",
            text,
            cross,
            advice="Top and bottom of one of the two are exchanged.",
            remedy="Check `top`, and whether its slices are numbered against the usual sense.",
            figures=_OF_SIDES,
        )
    if whole is not None and whole.z > Z_RELATED:
        why = "the coatings do not tell the sides apart" if same else "no coating is seen in both"
        text = (
            f"Side: inconclusive, because {why}; the thicknesses of {a} and {b} go together"
            f" ({whole}), {_ONE}."
        )
        return _check("unknown", text, whole)
    tried = "; ".join(
        f"{k} {v}" for k, v in (("coatings", same), ("thickness", whole)) if v is not None
    )
    if not tried:
        return _check(
            "unknown", f"Specimen: inconclusive, because {a} and {b} have no map in common."
        )
    text = (
        f"No map of {a} correlates with that of {b} ({tried}; {Z_RELATED} is needed): {_NO_WORD}."
    )
    advice = (
        "Either they are not the same piece of paper, or they are not aligned, or one is badly"
        " measured."
    )
    return _check("look", text, same or whole, advice=advice, figures=_OF_A_SPECIMEN)


def _check(
    state: State,
    text: str,
    relation: Relation | None = None,
    *,
    advice: str = "",
    remedy: str = "",
    figures: tuple[str, ...] = (),
) -> Check:
    return Check(
        name=NAME,
        state=state,
        sentence=text,
        value=None if relation is None else relation.z,
        limit=Z_RELATED,
        units="z",
        advice=advice,
        remedy=remedy,
        figures=figures,
    )


def _stands_out(face: Relation, rival: Relation | None) -> bool:
    """Whether a face goes with the image, and the other one does not, or clearly less."""
    if not abs(face.z) > Z_RELATED:
        return False
    return (
        rival is None
        or abs(rival.z) < Z_CLEAR
        or abs(face.part) - abs(rival.part) > Z_CLEAR * math.hypot(face.part_se, rival.part_se)
    )


def _preposition(relation: Relation) -> str:
    return ", not with" if abs(relation.z) < Z_CLEAR else ", more than with"


def _faces(texture: Textures, names: Mapping[Side, list[str]]) -> dict[Side, Relation]:
    """Partial correlation of each face with the image.

    Of several maps of a face that which stands out most.
    """
    image = texture.maps["image"]
    strongest_relations = dict[Side, Relation]()
    for side, names_of_side in names.items():
        relations: list[Relation] = []
        for k, name in enumerate(names_of_side):
            if name not in texture.maps:
                continue
            a, b = texture.maps[name], image
            for rival in (
                maps[k] for of, maps in names.items() if of != side and maps[k] in texture.maps
            ):
                a, b = (unexplained(m, texture.maps[rival]) for m in (a, b))
            relations.append(relate(a, b, texture.known, texture.pixel_um, of=image))
        if relations:
            strongest_relations[side] = max(relations, key=lambda r: abs(r.z))
    return strongest_relations


def _mean(relations: Iterable[Relation | None]) -> Relation | None:
    pooled = [relation for relation in relations if relation is not None]
    if not pooled:
        return None
    r = sum(k.r for k in pooled) / len(pooled)
    sd = math.sqrt(sum(k.sd**2 for k in pooled)) / len(pooled)
    return Relation(r, sd, r, sd)


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
    """Compare two layers on one grid by their own texture, its waves in ``unit_um``.

    ``side`` is that of the sheet which an image of the two shows, given or assumed.
    """
    if "thickness" in b and "thickness" not in a:
        a, b, names = b, a, (names[1], names[0])
    valid, one_sheet = (
        a["valid"].values & b["valid"].values,
        "thickness" in a and "thickness" not in b,
    )
    first, second = (_maps_of(d, valid) for d in (a, b))
    # None where the two have no valid pixel in common.
    image = {k: m for k, m in second.items() if k == "image"}
    maps = first | (image if one_sheet else {f"other {k}": m for k, m in second.items()})
    try:
        down, across = Grid.of(a).pixel_um
        texture = textures(maps, valid, (down / unit_um, across / unit_um))
    except SizeError as error:
        text = f"Specimen and position by texture: inconclusive. {error.text}"
        return TextureFound(None, (Check(name=NAME, state="unknown", sentence=text),))
    sheets = [d for d in (a, b) if "thickness" in d]
    coated = _coated_in_all(sheets)
    slope_names: tuple[str, ...] = ()
    if one_sheet:
        target_map = "image"
        check, face = image_of_sheet(
            texture, coated=coated, side=side, is_given=is_given, image=names[1]
        )
        texture, source_maps, slope_names = _shown_of(texture, face or side, coated)
    elif sheets:
        check = two_sheets(texture, names, coated=coated)
        source_maps = [next((f"coating_{k}" for k in coated), "thickness")]
        target_map = f"other {source_maps[0]}"
    else:
        check = two_images(texture, names)
        source_maps = ["image"]
        target_map = "other image"
    if any("reach_um" in d["image"].attrs for d in (a, b) if "image" in d):
        return _without_screen(check)
    error_map = next((d["expected_error"] for d in (a, b) if "expected_error" in d), None)
    expected_um = None if error_map is None else rms_of(error_map, valid)
    short = min(n * um for n, um in zip(texture.known.shape, texture.pixel_um, strict=True))
    try:
        offset = lag.texture_lag(
            texture,
            [*source_maps, *slope_names],
            target_map,
            slopes=len(slope_names),
            reach_um=min(150.0, short / 4),
            tiles_um=_TILE_UM if short >= 2 * _TILE_UM else None,
        ).scaled(unit_um)
    except SizeError:
        return TextureFound(None, (check,))
    if offset.distinct:
        check = _moved(check, offset.length_um)
    return TextureFound(
        offset.numbers(source_maps[0], expected_um), (check, offset.check(expected_um))
    )


def _moved(check: Check, length_um: float) -> Check:
    """Say of maps that do not go together where they lie that they do when they are moved."""
    if check.state != "look" or not set(check.figures) <= {POSITION, CORRELATION}:
        return check
    text = f"Moved by {length_um:.3g} um they do go together (position by texture)."
    return check.model_copy(update={"sentence": f"{check.sentence} {text}"})


def _shown_of(
    texture: Textures, face: Side, coated: Iterable[Side]
) -> tuple[Textures, list[str], tuple[str, ...]]:
    """The maps that an image of a face follows, and the slopes that it shows under side light.

    It follows the coating, or thickness and height; the slopes are added to the texture.
    """
    heights = height_map(face, texture.maps)
    coating = f"coating_{face}"
    is_of_coating = face in coated and not _goes_through(texture, coating)
    source_maps = [coating] if is_of_coating else ["thickness"]
    if heights not in texture.maps:
        return texture, source_maps, ()
    if not is_of_coating:
        source_maps.append(heights)
    return texture.with_slopes(heights), source_maps, (f"{heights}_x", f"{heights}_y")


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
    moved = Check(name=lag.NAME, state="unknown", figures=(POSITION,), sentence=text)
    return TextureFound(None, (check, moved))


def _goes_through(texture: Textures, coating: str) -> bool:
    """Whether an image goes with the thickness clearly better than with a coating.

    In transmitted light or a radiograph it does. With the coating alone, slopes of the face would
    stand for the heights that the coating lacks, and move the peak.
    """
    names = coating, "thickness", "image"
    if not all(name in texture.maps for name in names):
        return False
    of_coating, of_thickness = (
        relate(texture.maps[name], texture.maps["image"], texture.known, texture.pixel_um)
        for name in names[:2]
    )
    return _stands_out(of_thickness, of_coating)


def _maps_of(layer: xr.Dataset, valid: Bools) -> dict[str, xr.DataArray]:
    names = (*_MAPS, *(height_map(side, layer) for side in SIDES), "image")
    return {k: layer[k] for k in names if k in layer and any_finite(layer[k], valid)}


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
    return check, Check(name=lag.NAME, state="unknown", sentence=text, figures=(POSITION,))


def holes_and_texture(apart_um: float, expected_um: float) -> Check:
    """Judge how far apart holes and texture, each fitted by itself, put the middle of a map.

    Both errors are rms.
    """
    limit_um = math.sqrt(-math.log(0.05)) * expected_um
    text = f"Holes and texture, each by itself, put the middle of the map {apart_um:.1f} um apart"
    judged = Check(
        name=lag.NAME,
        state="pass",
        sentence=f"{text}, which both errors allow (up to {limit_um:.1f} um).",
        value=apart_um,
        limit=limit_um,
        units="um",
        figures=(POSITION, CORRELATION),
    )
    if apart_um <= limit_um:
        return judged
    text += f", more than both errors allow ({limit_um:.1f} um)."
    advice = "Light from one side, tilted holes, or marks of another place."
    remedy = "Compare `by=holes` and `by=texture`."
    return judged.model_copy(
        update={"state": "look", "sentence": text, "advice": advice, "remedy": remedy}
    )


def _coated_in_all(sheets: Iterable[xr.Dataset]) -> list[Side]:
    coated_sides = [_coated(sheet) for sheet in sheets]
    return [side for side in SIDES if all(side in sides for sides in coated_sides)]


def _coated(sheet: xr.Dataset) -> list[Side]:
    """Sides with a coating measured in most of a sheet and thicker than 3 standard errors."""
    sides: list[Side] = []
    for side in SIDES:
        name = f"coating_{side}"
        use, *maps = thinned(
            sheet["valid"], *(sheet[k] for k in (name, f"{name}_se") if k in sheet)
        )[1]
        coat_um, *errors = (m[use & np.isfinite(m)] for m in maps)
        limit = 3.0 * float(np.median(errors[0])) if errors and errors[0].size else 0.0
        if (
            coat_um.size
            and coat_um.size >= 0.5 * np.count_nonzero(use)
            and float(np.median(coat_um)) > limit
        ):
            sides.append(side)
    return sides
