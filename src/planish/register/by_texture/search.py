"""Find one layer in another one by the texture that both show, and the places of its tiles.

Both sides of a sheet are tried where its side is not given; rough places first, then all.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np
import xarray as xr

from planish.core.errors import CannotRegister, InputError
from planish.core.grid import centres_of
from planish.core.text import plain_numbers
from planish.core.transform import Similarity
from planish.core.typing import Floats, Pair, pair_of
from planish.register.by_texture.place import (
    TilePlaces,
    clearest_maps,
    shifted_place,
    tile_places,
    tuned_place,
)
from planish.register.by_texture.planes import PlanePair, TexturedPlane, in_unit
from planish.register.by_texture.rotations import (
    BAND_UM,
    FALSE,
    Names,
    Near,
    PlaceSearch,
    search_place,
)
from planish.register.fit import fit_transform
from planish.register.params import RegistrationParams
from planish.texture.textures import Textures

_SEARCH_UM, _FINE_UM = 20.0, 8.0  # pixels: at 36 um a weak texture is at chance
_SEARCHED_UM = 5000.0  # of the middle of a sheet: it says enough
TUNED_UM = 25.0  # by which the search may be off at the corners of the map
_AROUND_UM = 200.0  # of the image around the sheet
# By which a hole of the sheet may lie off that of the image, at a rotation between two of the
# search.
_HOLE_UM = 60.0
_NEAR_UM = 500.0  # of a place that was given without a radius
# Of an image whose pixel size is hardly known: between two sizes that are tried.
_SCALE_GUESS = 1.15
_GUESS_TOLERANCE = 0.08
_LEAST_TILES = 4  # that show how it is strained
_FEW_HOLES = 2  # that fix no place, and narrow the search


class FoundPlace(NamedTuple):
    """A place of the moving layer in the fixed one that chance may reach as well."""

    place: Similarity
    middle_um: Pair  # of the moving layer, in the fixed one
    z: float  # standard deviations of chance

    @property
    def sentence(self) -> str:
        """Turn, middle and height."""
        turn_deg = math.degrees(self.place.rotation_rad) % 360
        x, y = self.middle_um
        middle_text = plain_numbers(f"({x:.4g}, {y:.4g}) um")
        return f"turned by {turn_deg:.0f} degrees about {middle_text}: {self.z:.1f}"


class Undecided(CannotRegister):
    """No place of a sheet stands out by its texture; ``places`` are the best."""

    def __init__(self, text: str, places: Sequence[FoundPlace] = ()) -> None:
        super().__init__(text)
        self.places = places


class Found(NamedTuple):
    """A search, and the place from the first to the second layer.

    It also says by what the second layer is larger than stated.
    """

    search: PlaceSearch
    place: Similarity
    scaled: float
    places: tuple[Similarity, ...]  # of all candidates, from the moving to the fixed layer


def find_places(
    moving: xr.Dataset | xr.DataArray,
    fixed: xr.Dataset | xr.DataArray,
    params: RegistrationParams,
    mirrored: bool | None,
    holes: tuple[xr.Dataset, xr.Dataset] | None,
) -> tuple[PlanePair, Found]:
    """Search by the maps of one side or of either, where holes say so first.

    ``mirrored``: whether the layers see each other mirrored, so that the image shows the bottom of
    the sheet; None: both are tried. ``holes`` are those of both layers. Where no place is sure in
    the unit of paper, search again in that of the pixel; the probability counts both. Stop where
    the place is sure; Undecided where none is.
    """
    tried: list[tuple[PlanePair, Found]] = []
    sides = (False, True) if mirrored is None else (mirrored,)
    for by_pixel, is_bottom in product((False, True), sides):
        side = "bottom" if is_bottom else "top"
        layers = PlanePair.of(moving, fixed, side, holes, by_pixel=by_pixel)
        if by_pixel and layers.unit_um == tried[0][0].unit_um:
            break
        for near in _nears(layers, params, holes):
            hand = None if params.mirror else is_bottom
            result = _searched(layers, params, mirrored=hand, near=near, looks=1 + by_pixel)
            if result.search.is_sure:
                return layers, result
            tried.append((layers, result))
    layers, best = min(tried, key=lambda t: t[1].search.false_probability)
    raise _undecided(best, layers)


def _nears(
    layers: PlanePair, params: RegistrationParams, holes: tuple[xr.Dataset, xr.Dataset] | None
) -> Iterator[Sequence[Near]]:
    """Say where to look, one after the other.

    The order is about a given place, where a hole lies on a hole, everywhere: that is empty.
    """
    if params.near is not None:
        yield [_given_near(layers, params.near)]
        return
    counts = [side.sizes["mark"] for side in holes or ()]
    if holes is not None and all(1 <= count <= _FEW_HOLES for count in counts):
        centres = [map(pair_of, centres_of(side) / layers.unit_um) for side in holes]
        if layers.swapped:
            centres.reverse()
        nears: list[Near] = []
        for a_um, b_um in product(*centres):
            nears.append(Near(fixed_um=b_um, radius_um=_HOLE_UM, moving_um=a_um))
        yield nears
    yield ()


def _given_near(layers: PlanePair, near: Sequence[float]) -> Near:
    """The place that the user gives, ``x, y`` in um, with or without a radius."""
    usual_um = layers.unit_um * _NEAR_UM
    x_um, y_um, radius_um, *_ = *near, usual_um
    if radius_um <= 0:
        raise InputError(
            f"The radius of `near` is {radius_um:g} um. Give one above 0, such as {usual_um:g}."
        )
    x = x_um / layers.unit_um
    y = y_um / layers.unit_um
    radius_um /= layers.unit_um
    if not layers.swapped:
        return Near(fixed_um=(x, y), radius_um=radius_um)
    # The middle of the second layer lies there in the first one.
    middle_um = pair_of(layers.b.middle_um)
    return Near(fixed_um=middle_um, radius_um=radius_um, moving_um=(x, y))


def _searched(
    layers: PlanePair,
    params: RegistrationParams,
    *,
    mirrored: bool | None,
    near: Sequence[Near],
    looks: int,
) -> Found:
    """Search the smaller layer in the larger one.

    The second layer is tried at all sizes that the tolerance allows, in one of so many ``looks``.
    ``mirrored``: whether the layers see each other mirrored; None: both are tried. ``near``: about
    which places; everywhere where empty.
    """
    half = 0.5 * _SEARCHED_UM
    middle_um = layers.a.middle_um
    a = layers.a.part(middle_um - half, middle_um + half)
    a_texture, a_first = a.texture(_SEARCH_UM)
    best = None
    tolerance = min(params.scale_tolerance, _GUESS_TOLERANCE)
    # A search follows the tolerance of a guess; larger ones take guesses beside each other.
    beyond = math.log((1.0 + params.scale_tolerance) / (1.0 + _GUESS_TOLERANCE))
    count = max(math.ceil(beyond / math.log(_SCALE_GUESS)), 0)
    guesses = [_SCALE_GUESS**k for k in range(-count, count + 1)]
    for guess in sorted(guesses, key=lambda g: abs(math.log(g))):
        b = _seen_from(layers.b.scaled(guess), a, near, guess)
        b_texture, b_first = b.texture(_SEARCH_UM)
        if not (a_texture.known.any() and b_texture.known.any()):
            raise CannotRegister(
                "A layer shows no texture: it is empty, or none of it is valid. Check both files."
            )
        places = [_of_textures(n, a, a_first, b_first, guess) for n in near]
        search = _smaller_in_larger(a_texture, b_texture, mirrored, tolerance, places)
        probability = min(looks * len(guesses) * search.false_probability, 1.0)
        if best is None or probability < best.search.false_probability:
            places_um = [_moved(c.place, a_first, b_first) for c in search.candidates]
            between = partial(_between_layers, scaled=guess, swapped=layers.swapped)
            found_places = tuple(map(between, places_um))
            search = replace(search, false_probability=probability)
            best = Found(search, places_um[0], guess, found_places)
        if best.search.is_sure:
            break
    assert best is not None
    return best


def _smaller_in_larger(
    a: Textures, b: Textures, mirrored: bool | None, tolerance: float, near: Sequence[Near]
) -> PlaceSearch:
    """Search for the places of the first layer in the second one, or the other way round.

    Whichever is searched in which, the places are from the first to the second one.
    """
    search = partial(search_place, mirrored=mirrored, scale_tolerance=tolerance)
    if b.area_um2 >= a.area_um2:
        return search(a, b, near=near)
    inverse: list[Near] = []
    for place in near:
        moving_um = place.moving_um or (0, 0)
        inverse.append(replace(place, fixed_um=moving_um, moving_um=place.fixed_um))
    return search(b, a, near=inverse).inverse


def _seen_from(
    b: TexturedPlane, a: TexturedPlane, near: Sequence[Near], guess: float
) -> TexturedPlane:
    """What of a layer a search about places looks at; all where no place is given.

    ``b`` is the layer at a ``guess`` of its size, the places are in it as it is stated; ``a`` is
    the layer that is searched for.
    """
    if not near:
        return b
    fixed_um = guess * np.array([place.fixed_um for place in near])
    arms_um = [a.corners_um - (place.moving_um or a.middle_um) for place in near]
    longest_um = float(np.linalg.norm(arms_um, axis=-1).max())
    arm_um = (1.0 + _GUESS_TOLERANCE) * longest_um
    largest_radius_um = max(place.radius_um for place in near)
    return _part_about(b, fixed_um, guess * largest_radius_um + arm_um)


def _part_about(b: TexturedPlane, places_um: Floats, reach_um: float) -> TexturedPlane:
    """What of a layer lies about places (n, 2), ``(x, y)``, as far as a reach and what is around.

    CannotRegister where nothing of it does.
    """
    margin_um = reach_um + _AROUND_UM
    low_um = places_um.min(axis=0) - margin_um
    part = b.part(low_um, places_um.max(axis=0) + margin_um)
    if not all(part.grid.shape):
        raise CannotRegister(
            "The other layer shows no texture at this place: it lies beside it. Give another place."
        )
    return part


def _between_layers(place: Similarity, scaled: float, *, swapped: bool) -> Similarity:
    """Give a place of the first layer in the second one from the moving to the fixed layer.

    The second layer is ``scaled``; the moving and the fixed layer are taken as they are.
    """
    if swapped:
        return replace(place.inverse, scale=place.inverse.scale * scaled)
    x, y = place.shift_um
    return replace(place, scale=place.scale / scaled, shift_um=(x / scaled, y / scaled))


def _of_textures(
    near: Near, a: TexturedPlane, a_first: Floats, b_first: Floats, guess: float
) -> Near:
    """A rough place between layers, between their textures, whose first pixels lie elsewhere."""
    moving_um = pair_of((near.moving_um or a.middle_um) - a_first)
    fixed_um = pair_of(guess * np.array(near.fixed_um) - b_first)
    return Near(fixed_um=fixed_um, radius_um=guess * near.radius_um, moving_um=moving_um)


def _moved(place: Similarity, moving_first: Floats, fixed_first: Floats) -> Similarity:
    """A place between textures, between layers in which their first pixels lie elsewhere."""
    return replace(place, shift_um=pair_of(place(-moving_first) + fixed_first))


def tiles_near(
    layers: PlanePair,
    place: Similarity,
    *,
    scaled: float = 1.0,
    names: Names | None = None,
    off_um: float = 0.0,
    strain: float,
) -> TilePlaces:
    """Tune a place of the first layer in the second one, ``scaled``, by as much as it may be off.

    Tiles are then found there. ``place`` and ``off_um`` are in the unit of the layers; places and
    covariances of the tiles are in um, in the second layer as it is.
    """
    a = layers.a
    b = _part_about(layers.b.scaled(scaled), place(a.corners_um), 0.0)
    has_light = not b.is_sheet
    moving, moving_first = a.texture(_FINE_UM, slopes=has_light)
    fixed, fixed_first = b.texture(_FINE_UM)
    # The slopes in either half of the wavelengths: their names have one more ending.
    light = tuple(name for name in moving.maps if name.rpartition("_")[0] in a.light)
    place = _moved(place, -moving_first, -fixed_first)
    names = names or clearest_maps(moving, fixed, place)
    # Two sheets are compared map by map; an image shows the other maps, too.
    other_maps = tuple(k for k in a.maps if has_light and k in moving.maps and k != names[0])
    with_light = (*other_maps, *light)
    if off_um:
        reach_um = off_um + BAND_UM[1] / 4
        if light:
            place = shifted_place(
                moving, fixed, names, place, reach_um=reach_um, other_maps=with_light
            )
        place = tuned_place(moving, fixed, names, place, reach_um=off_um, other_maps=with_light)
    tiles_at = partial(tile_places, moving, fixed, names, other_maps=other_maps, light=light)
    tiles = tiles_at(place)
    if not tiles.is_there:
        # Chance may have moved the tiles of a weak pair; then the map goes worse with the image.
        bent_tiles = _bent_tiles(tiles_at, place, strain)
        tiles = max(tiles, bent_tiles, key=lambda t: abs(t.r))
    unit_um = layers.unit_um
    moving_um = unit_um * (tiles.moving_um + moving_first)
    fixed_um = unit_um * (tiles.fixed_um + fixed_first) / scaled
    covariance_um2 = unit_um**2 * tiles.covariance_um2 / scaled**2
    shared_um2 = unit_um**2 * tiles.shared_um2 / scaled**2
    tiles = tiles._replace(moving_um=moving_um, fixed_um=fixed_um)
    return tiles._replace(covariance_um2=covariance_um2, shared_um2=shared_um2)


def _bent_tiles(
    tiles_at: Callable[..., TilePlaces], place: Similarity, strain: float
) -> TilePlaces:
    """Tiles about where rough ones, sought as far off as a strain takes them, have the map."""
    tiles = tiles_at(place, strain=min(strain, _GUESS_TOLERANCE))
    if len(tiles.moving_um) < _LEAST_TILES:
        return tiles
    try:
        fit = fit_transform(
            tiles.moving_um,
            tiles.fixed_um,
            model="auto",
            mirrored=place.mirrored,
            weights=tiles.covariance_um2,
            inspect=False,
        )
    except CannotRegister:  # they fold the map: chance moved them
        return tiles_at(place)
    return tiles_at(fit.transform)


def _undecided(best: Found, layers: PlanePair) -> Undecided:
    """Make the error that names the best places, in um, and what to try."""
    search = best.search
    middle = (layers.b if layers.swapped else layers.a).middle_um
    places: list[FoundPlace] = []
    for candidate, place in zip(search.candidates, best.places, strict=True):
        middle_um = pair_of(layers.unit_um * place(middle))
        place_um = in_unit(place, 1.0 / layers.unit_um)
        places.append(FoundPlace(place_um, middle_um, candidate.z))
    text = (
        "Best places, in standard deviations of chance:"
        f" {'; '.join(place.sentence for place in places[:3])}."
    )
    if search.has_rival and search.false_probability <= FALSE:
        return Undecided(
            f"Two places of the sheet in the image are nearly alike. {text} A pattern that repeats,"
            " such as a screen or wire marks, looks like that: take it off the image"
            " (`screen_um`), or give marks (`marks`). Say about where the sheet lies (`near`) if"
            " they are more than its period apart.",
            places,
        )
    return Undecided(
        "No place of the sheet in the image stands out by its texture: an unrelated image reaches"
        f" the best one with a probability of {search.false_probability:.2g}, and {FALSE:g} is"
        f" allowed. {text} Is it this piece of paper, this side (`image_side`, `mirror=True`), and"
        " are the pixel sizes right (`scale_tolerance`)? A larger field helps, and so do marks"
        " (`marks`) or a rough place that you know from elsewhere (`near`).",
        places,
    )
