"""Register two layers by the texture that both show, without holes.

The registration is searched, and fitted to tiles.
"""

import math
from dataclasses import replace

import numpy as np
import xarray as xr

from planish.core.arrays import check_dataset, check_image
from planish.core.errors import CannotRegister
from planish.core.facts import Side
from planish.core.grid import centres_of
from planish.core.options import params_of
from planish.core.transform import Similarity
from planish.core.typing import Floats, Ints
from planish.marks.exchange.model import join_holes, paired, points_of
from planish.register import RegistrationParams, fit_pairs, need_holes
from planish.register.by_texture.place import TilePlaces
from planish.register.by_texture.planes import PlanePair, TexturedPlane, in_unit
from planish.register.by_texture.rotations import Names, PlaceSearch
from planish.register.by_texture.search import TUNED_UM, find_places, tiles_near
from planish.run.holes import HoleSearch
from planish.run.layers import MappedLayer
from planish.run.marks_registration import register_by_marks
from planish.run.registration import Registration, with_residuals
from planish.run.study import Study

_LEAST_TILES = 4
_NO_PAIRS = np.empty((0, 2), dtype=np.intp)
HolePair = tuple[xr.Dataset, xr.Dataset]  # laser holes of the moving and the fixed layer


def register_texture(
    moving: xr.Dataset | xr.DataArray,
    fixed: xr.Dataset | xr.DataArray,
    *,
    params: RegistrationParams | None = None,
    mirrored: bool | None = False,
    holes: HolePair | None = None,
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
    placed in pixels of 8 um. These are lengths of paper; where a layer has another size, all of
    them are in proportion to the coarser pixel. Of two sheets the same map is compared.
    """
    calls = ("pl.register_texture({}, fixed)", "pl.register_texture(moving, {})")
    for layer, call in zip((moving, fixed), calls, strict=True):
        if isinstance(layer, xr.Dataset):
            source = "pl.resample_maps(measured, flat)"
            check_dataset(layer, expected="maps", source=source, call_format=call)
        else:
            check_image(layer, call)
    fit_params = params_of(RegistrationParams, params, "pl.register_texture")
    if place is not None:
        is_bottom = place.mirrored if mirrored is None else mirrored
        layers = PlanePair.of(moving, fixed, "bottom" if is_bottom else "top", holes)
        start = _start(place, layers)
        search, names, scaled = None, None, 1.0
    else:
        layers, textured = find_places(moving, fixed, fit_params, mirrored, holes)
        search, start, scaled = textured.search, textured.place, textured.scaled
        names = search.best.names
    strain = fit_params.scale_tolerance
    tiles = tiles_near(layers, start, scaled=scaled, names=names, off_um=TUNED_UM, strain=strain)
    n_tiles = len(tiles.moving_um)
    if n_tiles < _LEAST_TILES:
        raise CannotRegister(
            f"{n_tiles} parts of the sheet show by themselves where they lie about its"
            f" place, and {_LEAST_TILES} are needed to say how well that is known. Image or scan a"
            " larger field, or give pairs of points (`marks`)."
        )
    registration = _fitted(layers, tiles, fit_params, holes)
    if search is None:
        sentence = f"The place was given; {n_tiles} tiles of the texture show it."
        return replace(registration, sentence=sentence)
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
    hole_sets = (holes.of(layer, fixed), holes.of(fixed, layer))
    return any(marks.sizes["mark"] < 3 for marks in hole_sets)


def _start(place: Similarity, layers: PlanePair) -> Similarity:
    """A place of the moving layer as the search has it: from its first plane, in its unit."""
    return in_unit(place.inverse if layers.swapped else place, layers.unit_um)


def register_by_texture(
    layer: MappedLayer, fixed: MappedLayer, holes: HoleSearch, study: Study
) -> Registration:
    """Register one layer of a link to another one by the texture of both.

    What holes there are is masked, and fitted with the texture where both are asked for. Where
    planish chose the texture by itself since holes are few, and it fails, the message says so too.
    """
    pair = (holes.of(layer, fixed), holes.of(fixed, layer))
    params = study.registration
    moving = _textured(layer)
    image = _textured(fixed)
    is_mirrored = layer.side != fixed.side
    if params.by == "both":
        by_holes = register_by_marks(layer, fixed, holes, study)
        side = "bottom" if is_mirrored else "top"
        return _with_tiles(by_holes, moving, image, params, pair, side)
    knows_side = layer.kind == fixed.kind or layer.side_given or fixed.side_given
    hand = is_mirrored if knows_side else None
    try:
        return register_texture(moving, image, params=params, mirrored=hand, holes=pair)
    except CannotRegister as error:
        if params.by != "auto":
            raise
        for layer_holes in pair:
            try:
                need_holes(layer_holes, holes.params.hole_um)
            except CannotRegister as too_few:
                raise CannotRegister(f"{too_few.text} {error.text}") from error
        raise


def _textured(layer: MappedLayer) -> xr.Dataset | xr.DataArray:
    """The flat maps of a sheet, or an image as it is compared."""
    shown = layer.groups["maps"] if layer.image is None else layer.shown
    assert isinstance(shown, xr.Dataset | xr.DataArray)
    return shown


def _fitted(
    layers: PlanePair,
    tiles: TilePlaces,
    params: RegistrationParams,
    holes: HolePair | None = None,
    pairs: Ints = _NO_PAIRS,
) -> Registration:
    """Fit the transformation to tiles and to holes of the moving and the fixed layer.

    The holes are taken by ``pairs`` (n, 2) of their rows; others are marks without a partner.
    Planes a and b of ``layers`` are the sheet and the image; of two sheets or two images, the
    moving and the fixed layer. ``swapped``: the moving layer is b.
    """
    count = len(tiles.moving_um)
    a_holes, b_holes = holes or (None, None)
    if layers.swapped:
        a_holes, b_holes = b_holes, a_holes
    no_covariance = np.zeros_like(tiles.covariance_um2)
    moving = _marks(tiles.moving_um, no_covariance, a_holes, layers.a)
    fixed = _marks(tiles.fixed_um, tiles.covariance_um2, b_holes, layers.b)
    if layers.swapped:
        moving, fixed = fixed, moving
    numbers = np.arange(count)
    tile_rows = np.stack([numbers, numbers], axis=1)
    rows = np.concatenate([tile_rows, pairs + count])
    moving_marks = moving.isel(mark=rows[:, 0])
    fixed_marks = fixed.isel(mark=rows[:, 1])
    fit = fit_pairs(moving_marks, fixed_marks, params=params, mirrored=tiles.place.mirrored)
    labels = [f"tile {k + 1}" for k in range(count)]
    labels += [f"{k + 1}" for k in range(len(pairs))]
    marks = join_holes(moving, fixed, rows, labels)
    for k, side in enumerate(("moving", "fixed")):
        sources = np.full(marks.sizes["mark"], "detected", dtype=object)
        sources[: len(rows)][rows[:, k] < count] = "tile"
        marks[f"{side}_source"] = marks[f"{side}_source"].copy(data=sources)
    if not len(pairs):  # holes show what all tiles share
        shared_um2 = float(np.trace(tiles.shared_um2))
        fit = replace(fit, shared_um=math.sqrt(shared_um2))
    return Registration(fit=fit, marks=with_residuals(marks, fit), source="texture")


def _with_tiles(
    by_holes: Registration,
    moving: xr.Dataset | xr.DataArray,
    fixed: xr.Dataset | xr.DataArray,
    params: RegistrationParams,
    holes: HolePair,
    side: Side,
) -> Registration:
    """Fit holes and tiles in one, and say how far apart both lie.

    The tiles are those that are found at the place by holes. Both places are compared in the
    middle of the moving layer; what is expected of their distance is the error of both.

    ``by_holes.fit.weights`` has one entry for each paired mark, in the order of the marks, 0 for
    one that is left out. ``side`` is the side of the sheet that the image shows: bottom where the
    layers see each other mirrored.
    """
    layers = PlanePair.of(moving, fixed, side, holes)
    start = _start(by_holes.fit.transform.similarity, layers)
    tiles = tiles_near(layers, start, strain=params.scale_tolerance)
    count = len(tiles.moving_um)
    if count < _LEAST_TILES:
        raise CannotRegister(
            f"{count} parts of the texture show where they lie, and {_LEAST_TILES}"
            " are needed beside the holes. Link by the holes alone (`by=holes`)."
        )
    is_paired = paired(by_holes.marks)
    rows: list[Ints] = []
    for layer_holes, side_name in zip(holes, ("moving", "fixed"), strict=True):
        xy = points_of(by_holes.marks, side_name)[is_paired]
        offsets_um = centres_of(layer_holes) - xy[:, None]
        rows.append(np.argmin(np.linalg.norm(offsets_um, axis=2), axis=1))
    pairs = np.stack(rows, axis=1)[by_holes.fit.weights > 0]
    fits = (_fitted(layers, tiles, params).fit, by_holes.fit)
    middle = TexturedPlane.of(moving, side).middle_um
    by_tiles_um, by_holes_um = (fit(middle) for fit in fits)
    apart_um = float(np.linalg.norm(by_tiles_um - by_holes_um))
    errors_um = [float(fit.expected_error_um(middle)) for fit in fits]
    expected_um = math.hypot(*errors_um)
    # An error that tiles share does not get smaller with their number.
    tiles = tiles._replace(covariance_um2=tiles.covariance_um2 + count * tiles.shared_um2)
    sentence = f"{by_holes.sentence or ''} {count} tiles of the texture are fitted with the holes."
    return replace(
        _fitted(layers, tiles, params, holes, pairs),
        source="both",
        apart_um=(apart_um, expected_um),
        sentence=sentence.strip(),
        second_best=by_holes.second_best,
        design=by_holes.design,
        tilt=by_holes.tilt,
    )


def _marks(
    um: Floats, covariance_um2: Floats, holes: xr.Dataset | None, layer: TexturedPlane
) -> xr.Dataset:
    """Tiles of a layer, places (n, 2) with covariances (n, 2, 2), as marks; then its holes."""
    columns = {
        "x": um[:, 0],
        "y": um[:, 1],
        "diameter": np.full(len(um), np.nan),
        "cov_xx": covariance_um2[:, 0, 0],
        "cov_xy": covariance_um2[:, 0, 1],
        "cov_yy": covariance_um2[:, 1, 1],
    }
    tiles = xr.Dataset({name: ("mark", values) for name, values in columns.items()})
    if holes is not None:
        tiles = xr.concat([tiles, holes[[*columns]]], dim="mark")
    return tiles.assign_attrs(layer="sheet" if layer.is_sheet else "image")


def _decided(search: PlaceSearch, tiles: TilePlaces) -> str:
    """Say which maps gave the place, how far it stands out, and how many tiles show it."""
    best = search.best
    title = _title(best.names)
    probability = f"{search.false_probability:.1g}"
    if search.false_probability < 1e-6:
        probability = "below 1e-06"
    next_best = ""
    if len(search.candidates) > 1:
        next_best = f", the next best place {search.candidates[1].z:.1f}"
    about_thickness = ""
    if "image" in best.names and "thickness" in title:
        about_thickness = (
            " The thickness leads, so the image may be one of transmitted light, or of a side"
            " without coating."
        )
    return (
        f"Found by texture: {title} go together at one place (r = {tiles.r:.2f};"
        f" {best.z:.0f} standard deviations of chance{next_best};"
        f" probability of a false link {probability})."
        f" {len(tiles.moving_um)} tiles give the place.{about_thickness}"
    )


def _title(names: Names) -> str:
    a, b = (name.replace("_", " ") for name in names)
    if a != b:
        return f"{a} and {b}"
    return "both images" if a == "image" else f"the maps of {a} of both"
