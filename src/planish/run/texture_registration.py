"""Register two layers by the texture that both show, without holes.

The registration is searched, and fitted to tiles.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
import xarray as xr

from planish.core.errors import CannotRegister, InputError
from planish.core.facts import Side
from planish.core.options import params_of
from planish.core.transform import Similarity
from planish.core.typing import Floats, Ints, Pair
from planish.marks.exchange.model import join_holes, paired, points_of
from planish.register import RegistrationParams, fit_pairs, need_holes
from planish.register.by_texture.place import TilePlaces, clearest_maps, tile_places, tuned_place
from planish.register.by_texture.search import FALSE, Names, Near, PlaceSearch, search_place
from planish.run.holes import HoleSearch
from planish.run.layers import MappedLayer
from planish.run.marks_registration import register_by_marks
from planish.run.registration import Registration, with_residuals
from planish.run.study import Study
from planish.run.texture_layer import TextureLayer

_SEARCH_UM, _FINE_UM = 20.0, 8.0  # pixels: at 36 um a weak texture is at chance
_SEARCHED_UM = 5000.0  # of the middle of a sheet: it says enough
_TUNED_UM = 25.0  # by which the search may be off at the corners of the map
_AROUND_UM = 200.0  # of the image around the sheet
# By which a hole of the sheet may lie off that of the image, at a rotation between two of the
# search.
_HOLE_UM = 60.0
_NEAR_UM = 500.0  # of a place that was given without a radius
# Of an image whose pixel size is hardly known: between two sizes that are tried.
_SCALE_GUESS = 1.15
_GUESS_TOLERANCE = 0.08
_LEAST_TILES = 4
_ABOUT_THICKNESS = (
    " The thickness leads, so the image may be one of transmitted light, or of a side without"
    " coating."
)
_FEW_HOLES = 2  # that fix no place, and narrow the search


class FoundPlace(NamedTuple):
    """A place of the moving layer in the fixed one that chance may reach as well."""

    place: Similarity
    middle_um: Pair  # of the moving layer, in the fixed one
    z: float  # standard deviations of chance

    @property
    def sentence(self) -> str:
        """Turn, middle and height."""
        turn_deg, (x, y) = math.degrees(self.place.rotation_rad) % 360, self.middle_um
        return f"turned by {turn_deg:.0f} degrees about ({x:.0f}, {y:.0f}) um: {self.z:.1f}"


class Undecided(CannotRegister):
    """No place of a sheet stands out by its texture; ``places`` are the best."""

    def __init__(self, text: str, places: Sequence[FoundPlace] = ()) -> None:
        super().__init__(text)
        self.places = places


def register_texture(
    moving: xr.Dataset | xr.DataArray,
    fixed: xr.Dataset | xr.DataArray,
    *,
    params: RegistrationParams | None = None,
    mirrored: bool | None = False,
    holes: tuple[xr.Dataset, xr.Dataset] | None = None,
    place: Similarity | None = None,
) -> Registration:
    """Find a sheet in an image by the texture that both show, and fit the transformation.

    This works without any hole.

    Parameters
    ----------
    moving, fixed : Dataset (v, u) or DataArray (y, x)
        Flat maps of :func:`planish.resample_maps`, or an image of :func:`planish.read_image`. The
        smaller one lies in the larger one at any rotation, with 40 % of it or more.
    params : RegistrationParams, optional
        ``near`` limits the place and ``scale_tolerance`` the scale, ``model`` is fitted to the
        tiles; with ``mirror`` the other hand is tried as well.
    mirrored : bool or None
        Whether the layers see each other mirrored, as an image of the bottom and a flat map do.
        None tries an image of either side.
    holes : (Dataset, Dataset), optional
        Laser holes of both layers, of :func:`planish.find_holes`. They are masked and have no part
        in the fit; where there are 1 or 2 in both, the places that put one onto another are
        searched first.
    place : Similarity, optional
        From the moving to the fixed layer, right to some 25 um: nothing is searched, and no
        probability is stated.

    Returns
    -------
    Registration
        Its marks are tiles of the map: places with covariances, without a diameter.

    Raises
    ------
    Undecided
        If no place stands out so far that an unrelated image would reach it in fewer than 4 of 10
        000 cases, or two places are nearly alike.
    CannotRegister
        If too few tiles by themselves show where they lie.
    InputError
        If the maps hold no thickness.

    Notes
    -----
    Coatings and thicknesses are band-passed (18 to 150 um) and correlated with the image at all
    rotations and shifts, either sign, in pixels of 20 um; the best place is tuned and tiles are
    placed in pixels of 8 um. Of two sheets the same map is compared.
    """
    fit_params = params_of(RegistrationParams, params, "pl.register_texture")
    if place is not None:
        is_bottom = place.mirrored if mirrored is None else mirrored
        layers = _Layers.of(moving, fixed, "bottom" if is_bottom else "top", holes)
        tiles = _tiles_near(layers, place.inverse if layers.swapped else place, off_um=_TUNED_UM)
        search = None
    else:
        layers, found = _searched_sides(moving, fixed, fit_params, mirrored, holes)
        if not (search := found.search).is_sure:
            raise _undecided(found, layers)
        tiles = _tiles_near(
            layers, found.place, scaled=found.scaled, names=search.best.names, off_um=_TUNED_UM
        )
    if len(tiles.moving_um) < _LEAST_TILES:
        raise CannotRegister(
            f"{len(tiles.moving_um)} parts of the sheet show by themselves where they lie about its"
            f" place, and {_LEAST_TILES} are needed to say how well that is known. Image or scan a"
            " larger field, or give pairs of points (`marks`)."
        )
    registration = _fitted(layers, tiles, holes, np.empty((0, 2), dtype=np.intp), fit_params)
    if search is None:
        return replace(
            registration,
            sentence=f"The place was given; {len(tiles.moving_um)} tiles of the texture show it.",
        )
    return replace(
        registration, sentence=_decided(search, tiles), false_probability=search.false_probability
    )


def uses_texture(layer: MappedLayer, fixed: MappedLayer, holes: HoleSearch, study: Study) -> bool:
    """Tell whether two layers are registered by their texture.

    They are where that is asked for, or holes are too few to match.
    """
    params = study.registration
    if layer.params.marks or params.marks:
        return False
    if params.by != "auto" or params.design:
        return params.by in ("texture", "both")
    return any(holes.of(*pair).sizes["mark"] < 3 for pair in ((layer, fixed), (fixed, layer)))


def register_by_texture(
    layer: MappedLayer, fixed: MappedLayer, holes: HoleSearch, study: Study
) -> Registration:
    """Register one layer of a link to another one by the texture of both.

    What holes there are is masked.
    """
    pair, params = (holes.of(layer, fixed), holes.of(fixed, layer)), study.registration
    moving, image = (of.groups["maps"] if of.image is None else of.shown for of in (layer, fixed))
    assert isinstance(moving, xr.Dataset | xr.DataArray)
    assert isinstance(image, xr.Dataset | xr.DataArray)
    is_mirrored = layer.side != fixed.side
    if params.by == "both":
        known = register_by_marks(layer, fixed, holes, study)
        return _with_tiles(known, moving, image, params, pair, "bottom" if is_mirrored else "top")
    knows_side = layer.kind == fixed.kind or any(
        of.side_given for of in (layer, fixed) if of.kind == "image"
    )
    try:
        hand = is_mirrored if knows_side else None
        return register_texture(moving, image, params=params, mirrored=hand, holes=pair)
    except CannotRegister as error:
        for layer_holes in pair if params.by == "auto" else ():
            try:
                need_holes(layer_holes, holes.params.hole_um)
            except CannotRegister as too_few:
                raise CannotRegister(f"{too_few.text} {error.text}") from error
        raise


class _Layers(NamedTuple):
    """Two layers, a sheet before an image; ``swapped`` where the first one is the fixed one."""

    a: TextureLayer
    b: TextureLayer
    swapped: bool

    @classmethod
    def of(
        cls,
        moving: xr.Dataset | xr.DataArray,
        fixed: xr.Dataset | xr.DataArray,
        side: Side,
        holes: tuple[xr.Dataset, xr.Dataset] | None,
    ) -> _Layers:
        moving_holes, fixed_holes = holes or (None, None)
        first, second = (
            TextureLayer.of(moving, side, moving_holes),
            TextureLayer.of(fixed, side, fixed_holes),
        )
        is_swapped = second.is_sheet and not first.is_sheet
        return cls(second, first, is_swapped) if is_swapped else cls(first, second, is_swapped)


class _Found(NamedTuple):
    """A search, and the place from the first to the second layer.

    It also says by what the second layer is larger than stated.
    """

    search: PlaceSearch
    place: Similarity
    scaled: float
    places: tuple[Similarity, ...]  # of all candidates, from the moving to the fixed layer


def _searched_sides(
    moving: xr.Dataset | xr.DataArray,
    fixed: xr.Dataset | xr.DataArray,
    params: RegistrationParams,
    mirrored: bool | None,
    holes: tuple[xr.Dataset, xr.Dataset] | None,
) -> tuple[_Layers, _Found]:
    """Search by the maps of one side or of either, where holes say so first.

    Stop where the place is sure.
    """
    tried: list[tuple[_Layers, _Found]] = []
    for is_bottom in (False, True) if mirrored is None else (mirrored,):
        layers = _Layers.of(moving, fixed, "bottom" if is_bottom else "top", holes)
        for near in _nears(layers, params, holes):
            hand = None if params.mirror else is_bottom
            tried.append((layers, _searched(layers, params, mirrored=hand, near=near)))
            if tried[-1][1].search.is_sure:
                return tried[-1]
    return min(tried, key=lambda t: t[1].search.false_probability)


def _nears(
    layers: _Layers, params: RegistrationParams, holes: tuple[xr.Dataset, xr.Dataset] | None
) -> Iterator[Sequence[Near]]:
    """Say where to look, one after the other.

    The order is about a given place, where a hole lies on a hole, everywhere.
    """
    if params.near is not None:
        x, y, *radius = params.near
        radius_um = radius[0] if radius else _NEAR_UM
        if radius_um <= 0:
            raise InputError(
                f"The radius of `near` is {radius_um:g} um. Give one above 0, such as {_NEAR_UM:g}."
            )
        if layers.swapped:  # the middle of the second layer lies there in the first one
            mx, my = layers.b.middle_um.tolist()
            yield [Near(fixed_um=(mx, my), radius_um=radius_um, moving_um=(x, y))]
        else:
            yield [Near(fixed_um=(x, y), radius_um=radius_um)]
        return
    if holes is not None and all(1 <= h.sizes["mark"] <= _FEW_HOLES for h in holes):
        places = [np.stack([h["x"].values, h["y"].values], axis=1).tolist() for h in holes]
        first, second = reversed(places) if layers.swapped else places
        yield [
            Near(fixed_um=(b[0], b[1]), radius_um=_HOLE_UM, moving_um=(a[0], a[1]))
            for a, b in product(first, second)
        ]
    yield ()


def _searched(
    layers: _Layers, params: RegistrationParams, *, mirrored: bool | None, near: Sequence[Near]
) -> _Found:
    """Search the smaller layer in the larger one.

    The second layer is tried at all sizes that the tolerance allows.
    """
    half = 0.5 * _SEARCHED_UM
    a = layers.a.part(layers.a.middle_um - half, layers.a.middle_um + half)
    (a_texture, a_first), best = a.texture(_SEARCH_UM), None
    tolerance = min(params.scale_tolerance, _GUESS_TOLERANCE)
    beyond = math.log((1.0 + params.scale_tolerance) / (1.0 + _GUESS_TOLERANCE))
    count = max(math.ceil(beyond / math.log(_SCALE_GUESS)), 0)
    guesses = sorted(
        (_SCALE_GUESS**k for k in range(-count, count + 1)), key=lambda g: abs(math.log(g))
    )
    for guess in guesses:
        b = layers.b.scaled(guess)
        b_texture, b_first = b.texture(_SEARCH_UM)
        if not (a_texture.known.any() and b_texture.known.any()):
            raise CannotRegister(
                "A layer shows no texture: it is empty, or none of it is valid. Check both files."
            )
        places = [_of_textures(n, a, a_first, b_first, guess) for n in near]
        if b_texture.area_um2 < a_texture.area_um2:
            inverse = [
                Near(fixed_um=n.moving_um or (0, 0), radius_um=n.radius_um, moving_um=n.fixed_um)
                for n in places
            ]
            found = search_place(
                b_texture, a_texture, mirrored=mirrored, scale_tolerance=tolerance, near=inverse
            )
            search = found.inverse
        else:
            search = search_place(
                a_texture, b_texture, mirrored=mirrored, scale_tolerance=tolerance, near=places
            )
        search = replace(
            search, false_probability=min(len(guesses) * search.false_probability, 1.0)
        )
        places_um = [_moved(c.place, a_first, b_first) for c in search.candidates]
        if best is None or search.false_probability < best.search.false_probability:
            fixed_places = tuple(
                _between_layers(p, guess, swapped=layers.swapped) for p in places_um
            )
            best = _Found(search, places_um[0], guess, fixed_places)
        if best.search.is_sure:
            break
    assert best is not None
    return best


def _between_layers(place: Similarity, scaled: float, *, swapped: bool) -> Similarity:
    """Give a place of the first layer in the second one from the moving to the fixed layer.

    The second layer is ``scaled``; the moving and the fixed layer are taken as they are.
    """
    if swapped:
        return replace(place.inverse, scale=place.inverse.scale * scaled)
    x, y = place.shift_um
    return replace(place, scale=place.scale / scaled, shift_um=(x / scaled, y / scaled))


def _of_textures(
    near: Near, a: TextureLayer, a_first: Floats, b_first: Floats, guess: float
) -> Near:
    """A rough place between layers, between their textures, whose first pixels lie elsewhere."""
    middle = a.middle_um if near.moving_um is None else np.array(near.moving_um)
    (ax, ay), (bx, by) = (
        (middle - a_first).tolist(),
        (guess * np.array(near.fixed_um) - b_first).tolist(),
    )
    return Near(fixed_um=(bx, by), radius_um=guess * near.radius_um, moving_um=(ax, ay))


def _tiles_near(
    layers: _Layers,
    place: Similarity,
    *,
    scaled: float = 1.0,
    names: Names | None = None,
    off_um: float = 0.0,
) -> TilePlaces:
    """Tune a place of the first layer in the second one, ``scaled``, by as much as it may be off.

    Tiles are then found there.

    Their places and covariances are those in the second layer as it is.
    """
    a, b = layers.a, layers.b.scaled(scaled)
    seen = place(a.corners_um)
    b = b.part(seen.min(axis=0) - _AROUND_UM, seen.max(axis=0) + _AROUND_UM)
    if not all(b.grid.shape):
        raise CannotRegister(
            "The other layer shows no texture at this place: it lies beside it. Give another place."
        )
    has_light = not b.is_sheet
    (moving, moving_first), (fixed, fixed_first) = (
        a.texture(_FINE_UM, slopes=has_light),
        b.texture(_FINE_UM),
    )
    light = tuple(name for name in a.light if has_light and name in moving.maps)
    place = _moved(place, -moving_first, -fixed_first)
    names = names or clearest_maps(moving, fixed, place)
    # Two sheets are compared map by map; an image shows the other maps, too.
    beside = tuple(k for k in a.maps if has_light and k in moving.maps and k != names[0])
    if off_um:
        place = tuned_place(moving, fixed, names, place, reach_um=off_um, beside=(*beside, *light))
    tiles = tile_places(moving, fixed, names, place, beside=beside, light=light)
    return tiles._replace(
        moving_um=tiles.moving_um + moving_first,
        fixed_um=(tiles.fixed_um + fixed_first) / scaled,
        covariance_um2=tiles.covariance_um2 / scaled**2,
        shared_um2=tiles.shared_um2 / scaled**2,
    )


def _fitted(
    layers: _Layers,
    tiles: TilePlaces,
    holes: tuple[xr.Dataset, xr.Dataset] | None,
    pairs: Ints,
    params: RegistrationParams,
) -> Registration:
    """Fit the transformation to tiles and to holes of the moving and the fixed layer.

    The holes are taken by ``pairs`` of their rows.
    """
    count, (a_holes, b_holes) = len(tiles.moving_um), holes or (None, None)
    if layers.swapped:
        a_holes, b_holes = b_holes, a_holes
    sides = [
        _marks(tiles.moving_um, np.zeros_like(tiles.covariance_um2), a_holes, layers.a),
        _marks(tiles.fixed_um, tiles.covariance_um2, b_holes, layers.b),
    ]
    if layers.swapped:
        sides.reverse()
    rows = np.concatenate([np.stack([np.arange(count)] * 2, axis=1), pairs + count])
    used = [side.isel(mark=rows[:, k]) for k, side in enumerate(sides)]
    fit = fit_pairs(used[0], used[1], params=params, mirrored=tiles.place.mirrored)
    labels = [f"tile {k + 1}" for k in range(count)] + [f"{k + 1}" for k in range(len(pairs))]
    marks = join_holes(sides[0], sides[1], rows, labels)
    for k, side in enumerate(("moving", "fixed")):
        sources = np.full(marks.sizes["mark"], "detected", dtype=object)
        sources[: len(rows)][rows[:, k] < count] = "tile"
        marks[f"{side}_source"] = marks[f"{side}_source"].copy(data=sources)
    # Holes show what all tiles share.
    fit = (
        fit if len(pairs) else replace(fit, shared_um=math.sqrt(float(np.trace(tiles.shared_um2))))
    )
    return Registration(fit=fit, marks=with_residuals(marks, fit), source="texture")


def _with_tiles(
    known: Registration,
    moving: xr.Dataset | xr.DataArray,
    fixed: xr.Dataset | xr.DataArray,
    params: RegistrationParams,
    holes: tuple[xr.Dataset, xr.Dataset],
    side: Side,
) -> Registration:
    """Fit holes and tiles in one, and say how far apart both lie.

    The tiles are those that are found at the place by holes.
    """
    layers = _Layers.of(moving, fixed, side, holes)
    place = known.fit.transform.similarity
    tiles = _tiles_near(layers, place.inverse if layers.swapped else place)
    if len(tiles.moving_um) < _LEAST_TILES:
        raise CannotRegister(
            f"{len(tiles.moving_um)} parts of the texture show where they lie, and {_LEAST_TILES}"
            " are needed beside the holes. Link by the holes alone (`by=holes`)."
        )
    is_paired = paired(known.marks)
    pairs = np.stack(
        [
            np.array(
                [
                    int(np.argmin(np.hypot(h["x"].values - x, h["y"].values - y)))
                    for x, y in points_of(known.marks, layer)[is_paired].tolist()
                ]
            )
            for h, layer in zip(holes, ("moving", "fixed"), strict=True)
        ],
        axis=1,
    )
    pairs = pairs[known.fit.weights > 0]
    alone = _fitted(layers, tiles, None, np.empty((0, 2), dtype=np.intp), params).fit
    middle = TextureLayer.of(moving, side).middle_um
    apart_um = float(np.linalg.norm(alone(middle) - known.fit(middle)))
    expected_um = math.hypot(*(float(f.expected_error_um(middle)) for f in (alone, known.fit)))
    count = len(tiles.moving_um)
    # An error that tiles share does not get smaller with their number.
    tiles = tiles._replace(covariance_um2=tiles.covariance_um2 + count * tiles.shared_um2)
    sentence = f"{known.sentence or ''} {count} tiles of the texture are fitted with the holes."
    return replace(
        _fitted(layers, tiles, holes, pairs, params),
        source="both",
        apart_um=(apart_um, expected_um),
        sentence=sentence.strip(),
        second_best=known.second_best,
        design=known.design,
        tilt=known.tilt,
    )


def _marks(
    um: Floats, covariance_um2: Floats, holes: xr.Dataset | None, layer: TextureLayer
) -> xr.Dataset:
    columns = {"x": um[:, 0], "y": um[:, 1], "diameter": np.full(len(um), np.nan)}
    columns |= {
        f"cov_{axes}": covariance_um2[:, j, k]
        for axes, j, k in (("xx", 0, 0), ("xy", 0, 1), ("yy", 1, 1))
    }
    tiles = xr.Dataset({name: ("mark", values) for name, values in columns.items()})
    if holes is not None:
        tiles = xr.concat([tiles, holes[[*columns]]], dim="mark")
    return tiles.assign_attrs(layer="sheet" if layer.is_sheet else "image")


def _moved(place: Similarity, moving_first: Floats, fixed_first: Floats) -> Similarity:
    """A place between textures, between layers in which their first pixels lie elsewhere."""
    x, y = (place(-moving_first) + fixed_first).tolist()
    return replace(place, shift_um=(x, y))


def _decided(search: PlaceSearch, tiles: TilePlaces) -> str:
    best = search.best
    probability = (
        f"below {1e-6:g}" if search.false_probability < 1e-6 else f"{search.false_probability:.1g}"
    )
    next_best = (
        f", the next best place {search.candidates[1].z:.1f}" if len(search.candidates) > 1 else ""
    )
    thickness_leads = "image" in best.names and "thickness" in _title(best.names)
    return (
        f"Found by texture: {_title(best.names)} go together at one place (r = {tiles.r:.2f};"
        f" {best.z:.0f} standard deviations of chance{next_best};"
        f" probability of a false link {probability})."
        f" {len(tiles.moving_um)} tiles give the place."
        f"{_ABOUT_THICKNESS if thickness_leads else ''}"
    )


def _title(names: Names) -> str:
    a, b = (name.replace("_", " ") for name in names)
    return (
        f"{a} and {b}" if a != b else f"the maps of {a} of both" if a != "image" else "both images"
    )


def _undecided(found: _Found, layers: _Layers) -> Undecided:
    search, middle_um = found.search, (layers.b if layers.swapped else layers.a).middle_um
    places = tuple(
        FoundPlace(place, (float(x), float(y)), candidate.z)
        for candidate, place in zip(search.candidates, found.places, strict=True)
        for x, y in (place(middle_um),)
    )
    text = (
        "Best places, in standard deviations of chance:"
        f" {'; '.join(place.sentence for place in places[:3])}."
    )
    if search.has_rival and search.false_probability <= FALSE:
        return Undecided(
            f"Two places of the sheet in the image are nearly alike. {text} A pattern that repeats,"
            " such as a screen or wire marks, looks like that: take it off the image"
            " (`screen_um`), say about where the sheet lies (`near`), or give marks (`marks`).",
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
