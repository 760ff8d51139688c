"""The registration of two layers by the texture that both show, without a hole: searched, and fitted to tiles."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr

from planish.analyze.texture import Textures, textures
from planish.analyze.texture_search import BAND_UM, FALSE, PlaceSearch, search_place, tile_places, tuned_place
from planish.core.area import common_means
from planish.core.errors import CannotRegister, InputError
from planish.core.facts import Side
from planish.core.grid import Grid
from planish.core.options import params_of
from planish.core.transform import Similarity
from planish.core.typing import Array, Bools, Floats
from planish.marks.exchange.model import join_holes
from planish.register import RegistrationParams, fit_pairs, need_holes
from planish.run.layers import Layer, LayerHoles
from planish.run.registration import Registration, with_residuals
from planish.run.study import Study

_SEARCH_UM, _FINE_UM = 20.0, 8.0  # pixels: at 36 um a weak texture is at chance
_TUNED_UM = 25.0  # by which the search may be off at the corners of the map
_LEAST_TILES = 4


class _Layer(NamedTuple):
    """Maps of a layer that may show in an image, each (rows, cols), where they may be looked at, and their pixels."""

    maps: dict[str, Array]
    faces: dict[str, Array]  # heights of the faces
    valid: Bools
    grid: Grid

    @classmethod
    def of(cls, layer: xr.Dataset | xr.DataArray, side: Side = "top") -> _Layer:
        """Take the maps that may show in an image of a side, or an image."""
        if isinstance(layer, xr.DataArray):
            return cls({"image": layer.values}, {}, np.isfinite(layer.values), Grid.of(layer))
        names = (f"coating_{side}", "base_thickness", "thickness")
        maps = {name: layer[name].values for name in names if name in layer and np.isfinite(layer[name].values).any()}
        if not maps:
            raise InputError("The maps hold no thickness whose texture could be searched. Measure one (--property).")
        valid = layer["valid"].values if "valid" in layer else np.isfinite(layer["thickness"].values)
        faces = {name: layer[name].values for name in (f"topography_{side}",) if name in layer}
        return cls(maps, faces, valid, Grid.of(layer))

    def texture(self, pixel_um: float, face: str = "") -> tuple[Textures, Floats]:
        """Textures on pixels of about a size, with the slopes of a face; the middle in um of the first pixel."""
        factors = [max(int(pixel_um / p + 1e-6), 1) for p in self.grid.pixel_um]
        shown: dict[str, Floats] = {}
        for name, values in (self.maps | {face: self.faces[face]} if face else self.maps).items():
            known = np.where(self.valid, values, np.nan).astype(np.float64)
            shown[name] = common_means([known], (factors[0], factors[1]), masks=[self.valid])[0]
        coarse_um = [f * p for f, p in zip(factors, self.grid.pixel_um, strict=True)]
        is_known = np.any([np.isfinite(m) for m in shown.values()], axis=0)
        first = [0.5 * (c - p) for c, p in zip(coarse_um, self.grid.pixel_um, strict=True)]
        found = textures(shown, is_known, (coarse_um[0], coarse_um[1]), band_um=BAND_UM)
        return found.with_slopes(face) if face else found, np.array(self.grid.origin_um) + first[::-1]


def register_texture(
    moving: xr.Dataset | xr.DataArray,
    fixed: xr.DataArray,
    *,
    params: RegistrationParams | None = None,
    mirrored: bool = False,
    holes: tuple[xr.Dataset, xr.Dataset] | None = None,
) -> Registration:
    """Find a sheet in an image by the texture that both show, without any hole, and fit the transformation.

    Parameters
    ----------
    moving : Dataset (v, u) or DataArray (y, x)
        Flat maps of :func:`planish.resample_maps`, or an image of :func:`planish.read_image`.
    fixed : DataArray (y, x)
        The image in which the sheet lies, at any rotation, with 40 % of the map or more in it.
    params : RegistrationParams, optional
        ``scale_tolerance`` limits the scale, ``model`` is fitted to the tiles; with ``mirror`` the other hand is tried
        as well.
    mirrored : bool
        Whether the layers see each other mirrored, as an image of the bottom and a flat map do.
    holes : (Dataset, Dataset), optional
        Laser holes of both layers, of :func:`planish.find_holes`, that are masked and have no part in the fit.

    Returns
    -------
    Registration
        Its marks are tiles of the map: places with covariances, without a diameter.

    Raises
    ------
    CannotRegister
        If no place stands out so far that an unrelated image would reach it in fewer than 4 of 10 000 cases, or too
        few tiles by themselves show where they lie.
    InputError
        If the maps hold no thickness.

    Notes
    -----
    Coatings and thicknesses are band-passed (18 to 150 um) and correlated with the image at all rotations and shifts,
    either sign, in pixels of 20 um; the best place is tuned and tiles are placed in pixels of 8 um.
    """
    fit_params = params_of(RegistrationParams, params, "pl.register_texture")
    layers = _Layer.of(moving, "bottom" if mirrored else "top"), _Layer.of(fixed)
    (moving_texture, moving_first), (fixed_texture, fixed_first) = (layer.texture(_SEARCH_UM) for layer in layers)
    if not (moving_texture.known.any() and fixed_texture.known.any()):
        raise CannotRegister("A layer shows no texture: it is empty, or none of it is valid. Check both files.")
    search = search_place(
        moving_texture, fixed_texture, mirrored=None if fit_params.mirror else mirrored,
        scale_tolerance=fit_params.scale_tolerance,
    )  # fmt: skip
    if not search.is_sure:
        raise CannotRegister(_undecided(search, fixed_first, moving_texture))
    best = search.best
    place = _moved(best.place, moving_first, fixed_first)
    face = next(iter(layers[0].faces), "")
    moving_texture, moving_first = layers[0].texture(_FINE_UM, face)
    fixed_texture, fixed_first = layers[1].texture(_FINE_UM)
    place = _moved(place, -moving_first, -fixed_first)
    light = (f"{face}_x", f"{face}_y") if face else ()
    place = tuned_place(moving_texture, fixed_texture, best.name, place, reach_um=_TUNED_UM, light=light)
    tiles = tile_places(moving_texture, fixed_texture, best.name, place, light=light)
    if len(tiles.moving_um) < _LEAST_TILES:
        raise CannotRegister(
            f"The texture shows the place of the sheet, but {len(tiles.moving_um)} parts of it by themselves, and "
            f"{_LEAST_TILES} are needed to say how well. Image or scan a larger field, or give pairs of points "
            "(--marks)."
        )
    count, no_error = len(tiles.moving_um), np.zeros_like(tiles.covariance_um2)
    sides = (
        _tiles(tiles.moving_um + moving_first, no_error, holes[0] if holes else None, "sheet"),
        _tiles(tiles.fixed_um + fixed_first, tiles.covariance_um2, holes[1] if holes else None, "image"),
    )
    rows = np.arange(count)
    fit = fit_pairs(*(side.isel(mark=rows) for side in sides), params=fit_params, mirrored=place.mirrored)
    marks = join_holes(*sides, np.stack([rows, rows], axis=1), [f"tile {k + 1}" for k in rows])
    is_tile = np.arange(marks.sizes["mark"]) < count
    for side in ("moving", "fixed"):
        marks[f"{side}_source"] = marks[f"{side}_source"].copy(data=np.where(is_tile, "tile", "detected"))
    return Registration(
        fit=fit, marks=with_residuals(marks, fit), source="texture", sentence=_decided(search, tiles.r, count),
        false_probability=search.false_probability,
    )  # fmt: skip


def uses_texture(layer: Layer, fixed: Layer, holes: LayerHoles, study: Study) -> bool:
    """Whether two layers are registered by their texture: where that is asked for, or holes are too few to match."""
    params = study.registration
    if layer.params.marks or params.marks:
        return False
    if params.by != "auto" or params.design:
        return params.by == "texture"
    return any(holes.of(*pair).sizes["mark"] < 3 for pair in ((layer, fixed), (fixed, layer)))


def register_layers_by_texture(layer: Layer, fixed: Layer, holes: LayerHoles, study: Study) -> Registration:
    """Register one layer of a link to another one by the texture of both; what holes there are is masked."""
    pair = holes.of(layer, fixed), holes.of(fixed, layer)
    try:
        if fixed.image is None:
            raise CannotRegister(
                f"The texture is searched in an image, and {fixed.name} is a sheet. Give the image as the last layer, "
                "or marks (--marks)."
            )
        moving, image = layer.groups["maps"] if layer.image is None else layer.shown, fixed.shown
        assert isinstance(moving, xr.Dataset | xr.DataArray)
        assert isinstance(image, xr.DataArray)
        is_mirrored = layer.side != fixed.side
        return register_texture(moving, image, params=study.registration, mirrored=is_mirrored, holes=pair)
    except CannotRegister as error:
        for layer_holes in pair if study.registration.by == "auto" else ():
            try:
                need_holes(layer_holes, holes.params.hole_um)
            except CannotRegister as too_few:
                raise CannotRegister(f"{too_few.text} {error.text}") from error
        raise


def _tiles(um: Floats, covariance_um2: Floats, holes: xr.Dataset | None, layer: str) -> xr.Dataset:
    """Tiles as marks of a layer, and the holes of it after them."""
    columns = {"x": um[:, 0], "y": um[:, 1], "diameter": np.full(len(um), np.nan)}
    columns |= {f"cov_{axes}": covariance_um2[:, j, k] for axes, j, k in (("xx", 0, 0), ("xy", 0, 1), ("yy", 1, 1))}
    tiles = xr.Dataset({name: ("mark", values) for name, values in columns.items()})
    if holes is not None:
        tiles = xr.concat([tiles, holes[[*columns]]], dim="mark")
    return tiles.assign_attrs(layer=layer)


def _moved(place: Similarity, moving_first: Floats, fixed_first: Floats) -> Similarity:
    """A place between textures, between layers in which their first pixels lie elsewhere."""
    x, y = (place(-moving_first) + fixed_first).tolist()
    return replace(place, shift_um=(x, y))


def _decided(search: PlaceSearch, r: float, tiles: int) -> str:
    best = search.best
    probability = f"below {1e-6:g}" if search.false_probability < 1e-6 else f"{search.false_probability:.1g}"
    return (
        f"Found by texture: {best.name.replace('_', ' ')} and image go together at one place (r = {r:.2f}; "
        f"{best.z:.0f} standard deviations of chance, the next best place {search.candidates[1].z:.1f}; probability of "
        f"a false link {probability}). {tiles} tiles give the place."
    )


def _undecided(search: PlaceSearch, fixed_first: Floats, moving: Textures) -> str:
    middle = 0.5 * np.array(moving.known.shape[::-1]) * moving.pixel_um[::-1]
    places = [
        f"turned by {np.rad2deg(c.place.rotation_rad) % 360:.0f} degrees about ({x:.0f}, {y:.0f}) um: {c.z:.1f}"
        for c in search.candidates[:3] for x, y in [(c.place(middle) + fixed_first).tolist()]
    ]  # fmt: skip
    return (
        f"No place of the sheet in the image stands out by its texture: an unrelated image reaches the best one with a "
        f"probability of {search.false_probability:.2g}, and {FALSE:g} is allowed. Best places, in standard deviations "
        f"of chance: {'; '.join(places)}. Is it this piece of paper, this side (--image-side, --mirror), and are the "
        "pixel sizes right? A larger field helps, and so do marks (--marks)."
    )
