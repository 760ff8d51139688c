"""Sheets and images on the pixels of a reference, each brought there in one step.

What is near a hole is masked.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from planish.analyze.image_values import reach_um
from planish.analyze.leading_map import leading_map
from planish.analyze.light_field import fit_light
from planish.analyze.quadratic_field import QuadraticField
from planish.core.area import common_means
from planish.core.arrays import check_dataset, check_image
from planish.core.errors import CannotRegister, InputError, MarkError
from planish.core.grid import Grid, centres_of, check_same_grid
from planish.core.threads import read_ahead
from planish.core.tiles import Tile
from planish.core.typing import Bools, Floats
from planish.io.map_store import StoredMaps, map_tiles
from planish.marks import cut_holes, hole_mask
from planish.marks.exchange import about_layer, holes_of
from planish.marks.regions import Regions
from planish.register import Chain
from planish.resample import SheetOnto, image_attrs, resample_image
from planish.resample import resample_maps as flat_maps
from planish.run.compute import Progress
from planish.run.layers import Datasets, Link, LinkedLayer, MappedLayer, Shown
from planish.run.position_error import PositionErrors, add_place_errors
from planish.run.regions import regions_on
from planish.run.registration import Registration
from planish.run.study import Study

LINKED = "linked"
"""Name of the group that holds a sheet and an image on the image's pixels."""

_IMAGE_RIM_UM = 100.0  # around the holes of images that are linked without a sheet


@dataclass(frozen=True, slots=True, eq=False)
class ValidMask:
    """Tell which pixels lie outside ``circles`` and ``regions``.

    ``circles`` (n, 3: x, y, radius) are holes with their rims; all is in um.
    """

    circles: Floats
    regions: Regions | None = None

    def __call__(self, part: Grid) -> Bools:
        """Say it of some pixels."""
        centres_um, radii_um = self.circles[:, :2], self.circles[:, 2]
        is_allowed = ~hole_mask(part, centres_um, radii_um)
        return is_allowed if self.regions is None else is_allowed & ~self.regions.inside(part)

    @property
    def sentence(self) -> str:
        """What a valid pixel is."""
        outside_text = ", outside of declared regions" if self.regions else ""
        return f"Measured, and away from holes and their rims{outside_text}"


def moved_by(shown: Shown, transform: Any) -> Callable[[Grid], xr.Dataset]:
    """Give the function from pixels of the reference to a layer's maps there.

    Parameters
    ----------
    shown : DataArray or mapping of Dataset
        An image, or the groups of a sheet.
    transform : callable
        From the layer to the reference, with its ``similarity``.
    """
    if isinstance(shown, xr.DataArray):
        return partial(resample_image, shown, transform=transform, must_meet=False)
    return SheetOnto(shown["surfaces"], shown["flat"], transform=transform).on


def _on_tiles(
    layer_data: Shown, chain: Chain | None, grid: Grid, reference: Shown
) -> Callable[[Tile], xr.Dataset]:
    """Give the function from a tile of a reference to a layer's maps there.

    The maps have errors where a chain moved the layer to the ``reference``, whose pixels are those
    of ``grid``. Without a chain the layer is the reference itself.
    """
    if chain is None:
        maps = _unmoved(layer_data)
        return lambda tile: maps.isel(y=tile.rows, x=tile.cols)
    images = [shown for shown in (layer_data, reference) if isinstance(shown, xr.DataArray)]
    is_scan = any(image.attrs.get("is_scan") for image in images)
    sheet = None if isinstance(layer_data, xr.DataArray) else layer_data
    fixed_sheet = None if isinstance(reference, xr.DataArray) else reference
    errors = PositionErrors(sheet, chain, grid, fixed_sheet, is_scan=is_scan)
    on_part = moved_by(layer_data, chain)

    def moved(tile: Tile) -> xr.Dataset:
        # With the pixels beside the tile, so that slopes do not depend on where tiles end.
        grown = tile.grown(1, 1, grid.shape)
        part = grid.part(grown.rows, grown.cols)
        maps = on_part(part)
        maps = maps.assign(errors.on(part, _where_shown(maps).values))
        maps = add_place_errors(maps, grid.pixel_um)
        inner = tile.within(grown)
        return maps.isel(y=inner.rows, x=inner.cols)

    return moved


def _unmoved(shown: Shown) -> xr.Dataset:
    """The maps of a reference on its own pixels."""
    if isinstance(shown, xr.DataArray):
        image = (("y", "x"), shown.values, image_attrs(shown))
        return xr.Dataset({"image": image}, coords=Grid.of(shown).coords)
    maps = shown["maps"].rename({"v": "y", "u": "x"})
    names = map(str, maps.data_vars)
    dropped_prefixes = ("projected_", "presence", "valid")
    return maps.drop_vars([name for name in names if name.startswith(dropped_prefixes)])


def _where_shown(maps: xr.Dataset) -> xr.DataArray:
    """A map that is finite where a layer is shown."""
    return maps["image" if "image" in maps else "u"]


@dataclass(frozen=True, slots=True, eq=False)
class Overlay:
    """Layers on the pixels of the last one, the reference."""

    layers: tuple[LinkedLayer, ...]
    mask: ValidMask
    store: StoredMaps  # that holds the maps
    light: QuadraticField | None = None  # that was taken off the image of the reference

    @property
    def reference(self) -> LinkedLayer:
        """The layer that all others were brought to."""
        return self.layers[-1]

    @property
    def grid(self) -> Grid:
        """The pixels of the reference."""
        return self.reference.layer.grid

    @property
    def maps(self) -> Datasets:
        """The maps of each layer."""
        return {linked.name: linked.maps for linked in self.layers}


def overlay_layers(
    study: Study,
    layers: Sequence[MappedLayer],
    links: Mapping[str, Link],
    regions: Regions | None,
    store: StoredMaps,
    progress: Progress,
) -> Overlay:
    """Bring registered layers onto the reference's pixels in one step, and mask holes and regions.

    ``regions`` are in um of the reference, or as they were read where this is a volume. ``links``
    are those of all layers but the reference, by name.
    """
    reference = layers[-1]
    if reference.params.kind == "volume" and regions is not None:
        regions = regions_on(regions, reference.grid, study.correlate.regions)
    progress("link", f"{' x '.join(map(str, reference.grid.shape))} pixels of the {reference.name}")
    chains = {name: link.chain for name, link in links.items()}
    mask = ValidMask(_circles_of_links(layers, links, chains), regions)
    sources = {layer.name: (layer.shown, chains.get(layer.name)) for layer in layers}
    if study.correlate.light is not None and isinstance(reference.shown, xr.DataArray):
        image = reference.shown
        title = f"{image.attrs.get('long_name', 'Image')}, smooth light off"
        sources[reference.name] = (image.assign_attrs(long_name=title), None)
    joint_group = LINKED if study.is_sheet_on_image else None
    maps = resample_layers(sources, mask, reference.grid, store, joint_group=joint_group)
    linked = [LinkedLayer(layer, links.get(layer.name), maps[layer.name]) for layer in layers]
    return Overlay(tuple(linked), mask, store)


def take_light_off(study: Study, overlay: Overlay) -> Overlay:
    """Take a field of light off the reference's image, fitted with the map of the sheet that leads.

    Raises
    ------
    CannotMeasure
        If there are too few points for the field.
    InputError
        If a point is smaller than a pixel.
    """
    sheet = next(linked for linked in overlay.layers if linked.kind == "sheet")
    reference, grid = overlay.reference, overlay.grid
    name = leading_map(sheet.maps, reference.layer.side, study.correlate.headline)
    point_um, (row_um, col_um) = study.correlate.point_um, grid.pixel_um
    if point_um < max(row_um, col_um):
        raise InputError(
            f"`light`: points of {point_um:g} um are smaller than the image's pixels of"
            f" {max(row_um, col_um):g} um, over which no field is fitted. Give larger ones with"
            " `point_um`, or leave it out."
        )
    maps = (sheet.maps[name], reference.maps["image"])
    masks = (sheet.maps["valid"], reference.maps["valid"])
    points = common_means(maps, (point_um / row_um, point_um / col_um), masks=masks)
    light = fit_light(points[0], points[1], grid, point_um)
    group = LINKED if study.is_sheet_on_image else f"layers/{reference.name}"
    for tile in map_tiles(grid.shape):
        on_tile = reference.maps[["image"]].isel(y=tile.rows, x=tile.cols)
        image = on_tile.load()
        field = light.on(grid.part(tile.rows, tile.cols))
        image = image.assign(image=image["image"] - field.astype(np.float32))
        overlay.store.add(group, grid, tile, image)
    return replace(overlay, light=light)


def _circles_of_links(
    layers: Sequence[MappedLayer], links: Mapping[str, Link], chains: Mapping[str, Chain]
) -> Floats:
    """Holes of all layers with their rims, on the reference: (n, 3: x, y, radius in um).

    A rim is as wide as the widest that a sheet leaves out. Marks of each link are those of a layer
    and of the next one on its path, each brought on by the chain from there; the reference has
    none.
    """
    sheets = [layer.groups["surfaces"] for layer in layers if layer.kind == "sheet"]
    rims_um = [float(sheet.attrs["rim_um"]) for sheet in sheets]
    rim_um = max(rims_um, default=_IMAGE_RIM_UM)
    # What was done to an image carries the grey of a hole farther.
    rim_um += max(reach_um(layer.params.image) for layer in layers)
    circles: list[Floats] = []
    for link in links.values():
        marks = link.registration.marks
        for plane, layer in zip(("moving", "fixed"), link.path, strict=False):
            chain = chains.get(layer.name)
            circles_of_layer = hole_circles(marks, plane, rim_um, chain=chain, image=layer.image)
            circles.append(circles_of_layer)
    return np.concatenate(circles)


def resample_layers(
    layer_sources: Mapping[str, tuple[Shown, Chain | None]],
    mask: ValidMask,
    grid: Grid,
    sink: StoredMaps,
    *,
    joint_group: str | None = None,
) -> Datasets:
    """Bring sheets and images onto a grid, tile by tile, and mark what is valid there.

    Put into ``sink`` are all maps of each sheet, or ``image``, ``valid``, and ``expected_error`` of
    what was moved with its shares: as ``layers/NAME``, or one sheet and image as one group
    ``joint_group``. Returns the maps of each layer. ``layer_sources`` are the layers by name, the
    reference last, each with the chain that leads there; None for the reference. CannotRegister
    where a layer lies beside the reference altogether.
    """
    reference, _ = [*layer_sources.values()][-1]
    tile_readers = {
        name: _on_tiles(*source, grid, reference) for name, source in layer_sources.items()
    }
    absent = [name for name, (_, chain) in layer_sources.items() if chain is not None]
    valid_attrs = {"long_name": mask.sentence}

    def bring(tile: Tile) -> Datasets:
        is_allowed = mask(grid.part(tile.rows, tile.cols))
        maps = Datasets()
        for name, read_tile in tile_readers.items():
            data = read_tile(tile)
            measured = data["thickness" if "thickness" in data else "image"].values
            is_valid = np.isfinite(measured) & is_allowed
            maps[name] = data.assign(valid=(("y", "x"), is_valid, valid_attrs))
        return maps

    tiles = map_tiles(grid.shape)
    for tile, maps in zip(tiles, read_ahead(bring, tiles), strict=True):
        absent = [name for name in absent if not np.isfinite(_where_shown(maps[name])).any()]
        if joint_group is None:
            for name, data in maps.items():
                sink.add(f"layers/{name}", grid, tile, data)
        else:
            sheet, image = maps.values()
            valid = sheet["valid"] & image["valid"]
            joint = sheet.assign(image=image["image"], valid=valid)
            sink.add(joint_group, grid, tile, joint)
    if absent:
        raise CannotRegister(
            f"The layer {absent[0]} does not meet the reference: by its marks it lies beside it."
            " Check the marks."
        )
    if joint_group is None:
        return {name: sink.group(f"layers/{name}") for name in layer_sources}
    sheet_name, image_name = layer_sources
    return split_linked(sink.group(joint_group), sheet_name, image_name)


def split_linked(linked: xr.Dataset, sheet: str, image: str) -> Datasets:
    """Linked maps as those of the sheet and of the image, by what these are called."""
    return {sheet: linked.drop_vars("image"), image: linked[["image", "valid"]]}


def measured_holes(marks: xr.Dataset, side: str) -> xr.Dataset:
    """The marks that have a diameter in a layer; a tile of texture has none, and is no hole."""
    name = f"{side}_diameter"
    if name not in marks:
        marks = marks.assign({name: np.nan * marks[f"{side}_x"]})
    return marks.dropna("mark", subset=[name])


def hole_circles(
    marks: xr.Dataset,
    side: str,
    rim_um: float,
    *,
    chain: Chain | None = None,
    image: xr.DataArray | None = None,
) -> Floats:
    """Circles (n, 3: x, y, radius in um) around all holes of one layer, on the reference.

    ``chain`` leads from another layer to the reference; of the layer's own ``image``, holes at the
    border are included.
    """
    holes = holes_of(measured_holes(marks, side), side)
    hole_sets = [holes] if image is None else [holes, cut_holes(image, holes)]
    centres_um = np.concatenate([centres_of(h) for h in hole_sets])
    radii_um = 0.5 * np.concatenate([h["diameter"].values for h in hole_sets])
    if chain is not None:
        centres_um = chain(centres_um)
        radii_um = radii_um * chain.similarity.scale
    circles = np.column_stack([centres_um, radii_um + rim_um])
    return circles[np.isfinite(circles).all(axis=1)]


def resample_maps(
    measured: xr.Dataset,
    flat: xr.Dataset,
    *,
    onto: xr.DataArray | None = None,
    registration: Registration | None = None,
    map_um: float | None = None,
) -> xr.Dataset:
    """Bring a sheet's properties onto a regular grid: of the flat sheet, or the pixels of an image.

    Values are interpolated once, from the columns of the volume to the pixels of the result.

    Parameters
    ----------
    measured : Dataset (y, x)
        Of :func:`planish.measure_properties`.
    flat : Dataset (y, x)
        Flat coordinates, of :func:`planish.flatten_sheet`.
    onto : DataArray (y, x), optional
        An image of :func:`planish.read_image`; with ``registration``.
    registration : Registration, optional
        From the flat sheet to the image, of :func:`planish.register_marks`.
    map_um : float, optional
        Pixel of the flat maps; the pitch of the columns where not given.

    Returns
    -------
    Dataset
        Maps (v, u) of the flat sheet; or linked maps (y, x) on the image's pixels: all properties,
        where in the volume each pixel lies, ``image``, ``expected_error`` in um, and ``valid``:
        measured, and away from holes and their rims.

    Raises
    ------
    SurfaceError
        If the two datasets stand on different columns.
    InputError
        If only one of ``onto`` and ``registration`` is given.
    MarkError
        If the registration belongs to another image, or goes from the image to the sheet.
    """
    check_dataset(
        measured,
        "centre",
        expected="measured surfaces",
        source="pl.measure_properties(surfaces, volume=volume)",
        call_format="pl.resample_maps({}, flat)",
    )
    check_dataset(
        flat,
        "u",
        "v",
        expected="flat coordinates",
        source="pl.flatten_sheet(surfaces).flat",
        call_format="pl.resample_maps(measured, {})",
    )
    check_same_grid(measured, flat)
    if onto is None and registration is None:
        return flat_maps(measured, flat, map_um=map_um)
    if onto is None or registration is None:
        raise InputError(
            "onto and registration belong together: give both, or neither for the flat maps."
        )
    check_image(onto, "pl.resample_maps(measured, flat, onto={}, registration=registration)")
    moving_title, fixed_title = (
        about_layer(registration.marks, plane).get("title") for plane in ("moving", "fixed")
    )
    if moving_title == "image" and fixed_title == "sheet":
        raise MarkError(
            "The registration goes from the image to the sheet; needed is one from the sheet to the"
            " image. Write pl.register_marks(pl.find_holes(maps), pl.find_holes(image))."
        )
    grid = Grid.of(onto)
    # Marks beside the image show that the registration belongs to another one, or its pixels have
    # another size.
    fixed_um = registration.fit.fixed
    pixel_um = max(grid.pixel_um)
    low_um = np.array(grid.origin_um) - pixel_um
    last_um = np.array([grid.x_um[-1], grid.y_um[-1]])
    high_um = last_um + pixel_um
    is_outside = ((fixed_um < low_um) | (fixed_um > high_um)).any(axis=1)
    if is_outside.any():
        raise MarkError(
            f"{is_outside.sum()} of {is_outside.size} marks of the registration lie beside the"
            " image. It belongs to another image, or the pixel size is another one: give the image"
            " that was registered."
        )
    chain = Chain(fits=(registration.fit,))
    rim_um = float(measured.attrs["rim_um"]) + float(onto.attrs.get("reach_um", 0.0))
    sheet_circles = hole_circles(registration.marks, "moving", rim_um, chain=chain)
    image_circles = hole_circles(registration.marks, "fixed", rim_um, image=onto)
    mask = ValidMask(np.concatenate([sheet_circles, image_circles]))
    layer_sources: dict[str, tuple[Shown, Chain | None]] = {
        "sheet": ({"surfaces": measured, "flat": flat}, chain),
        "image": (onto, None),
    }
    sink = StoredMaps()
    resample_layers(layer_sources, mask, grid, sink, joint_group=LINKED)
    return sink.group(LINKED)
