"""Compare layers on the pixels of a reference: r, what stands beside it, and their textures."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import xarray as xr

from planish.analyze import CorrelateParams
from planish.analyze.compare import ComparisonRow, CorrelationRow, comparison_rows, correlate_layers
from planish.analyze.correlation_evidence import EvidenceFacts, correlation_diagnostics
from planish.analyze.leading_map import leading_pair
from planish.analyze.mottle import Mottle, mottle_of
from planish.analyze.refinement import RefinementFacts, held_out_r, refine_link
from planish.analyze.sheet_columns import SheetColumns
from planish.analyze.sides import TextureFound, texture_of
from planish.core.arrays import check_dataset
from planish.core.bands import read_bands
from planish.core.errors import InputError
from planish.core.facts import Side
from planish.core.grid import Grid
from planish.core.older_names import height_map
from planish.core.options import params_of
from planish.core.transform import Similarity
from planish.core.typing import Bools, Floats, Window
from planish.io.map_store import map_tiles
from planish.marks.regions import read_regions
from planish.results import LayerFacts, LinkedArea
from planish.run.compute import Progress
from planish.run.facts import layer_facts, linked_area
from planish.run.layers import LinkedLayer
from planish.run.overlay import LINKED, Overlay, moved_by, split_linked
from planish.run.regions import regions_on
from planish.run.study import Study
from planish.texture.length_unit import length_unit_um

FactsOfLayers = tuple[LayerFacts, ...]
Textures = dict[tuple[str, str], TextureFound]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison:
    """What linked layers say of each other, as it goes into the results of a run."""

    layers: FactsOfLayers
    textures: Textures  # of pairs of layers that show one side of the sheet
    correlations: tuple[CorrelationRow, ...]
    evidence: tuple[EvidenceFacts, ...]
    mottle: tuple[Mottle, ...]
    area: LinkedArea | None  # of one sheet on one image
    registrations: tuple[ComparisonRow, ...]  # the same, by the registrations of the paper
    refinement: RefinementFacts | None
    refined: xr.Dataset | None  # the moving layer where the refined registration brings it


def compare_layers(study: Study, overlay: Overlay, progress: Progress) -> Comparison:
    """Compare linked layers in pairs, and the maps that lead with all that stands beside r.

    Textures are compared of a sheet and an image, and of two layers that show one side.
    """
    pairs = [*combinations(overlay.layers, 2)]
    progress("correlate", f"{len(pairs)} pairs of layers")
    correlations: list[CorrelationRow] = []
    textures: Textures = {}
    point_um = study.correlate.point_um
    for a, b in pairs:
        is_light_off = overlay.light is not None and b is overlay.reference
        correlations += correlate_layers(
            a.name, b.name, overlay.maps, point_um, light_off=is_light_off
        )
        if a.kind != b.kind or a.layer.side == b.layer.side:
            textures[a.name, b.name] = _texture_of_pair(a, b)
    facts = _facts_of_layers(study, overlay, textures)
    area = None
    registrations = tuple[ComparisonRow, ...]()
    if study.is_sheet_on_image:
        area = linked_area(overlay.store.group(LINKED), overlay.mask)
        registrations = _compare_registrations(study, overlay, facts[0].headline)
    mottle: list[Mottle] = []
    for layer in facts:
        if study.correlate.mottle and layer.image is not None:
            maps = overlay.maps[layer.name]
            mottle.append(mottle_of(layer.name, maps, quantity=layer.image.quantity))
    refined, refinement = None, None
    if study.registration.refine is not None:
        refined, refinement = _refine(study, overlay, facts)
    return Comparison(
        layers=facts,
        textures=textures,
        correlations=tuple(correlations),
        evidence=_evidence(study, overlay, facts),
        mottle=tuple(mottle),
        area=area,
        registrations=registrations,
        refinement=refinement,
        refined=refined,
    )


def _texture_of_pair(a: LinkedLayer, b: LinkedLayer) -> TextureFound:
    """What the textures of two layers say of the side that shows, and of their place."""
    images = [linked.layer for linked in (a, b) if linked.kind == "image"]
    is_given = all(image.side_given is not None for image in images)
    unit_um = length_unit_um(a.layer.grid, b.layer.grid)
    side = _side_of(a, b)
    names = (a.name, b.name)
    return texture_of(a.maps, b.maps, names, side=side, is_given=is_given, unit_um=unit_um)


def _side_of(a: LinkedLayer, b: LinkedLayer) -> Side:
    return "bottom" if "bottom" in (a.layer.side, b.layer.side) else "top"


def _facts_of_layers(study: Study, overlay: Overlay, textures: Textures) -> FactsOfLayers:
    """What each layer is; of those placed by texture, with r that their place was not tuned on.

    ``textures`` are of pairs of layers by name; how far a layer lies beside the reference (its lag)
    comes from there, None where the two were not compared.
    """
    reference = overlay.reference
    facts = dict[str, LayerFacts]()
    headline = study.correlate.headline
    for linked in overlay.layers:
        texture = textures.get((linked.name, reference.name))
        lag = None if texture is None else texture.lag
        side = _side_of(linked, reference)
        facts[linked.name] = layer_facts(linked, side=side, lag=lag, headline=headline)
    return tuple(_with_held_out(linked, facts, overlay) for linked in overlay.layers)


def _with_held_out(
    linked: LinkedLayer, facts: Mapping[str, LayerFacts], overlay: Overlay
) -> LayerFacts:
    """A layer with the r that its place, found by texture, was not tuned on.

    It is that of the two maps that lead, within the rows and columns that hold valid pixels; beside
    an image the heights of the face that it shows are given, whose light a place may be tuned on.
    """
    layer = facts[linked.name]
    registration = layer.registration
    if registration is None or registration.source not in ("texture", "both"):
        return layer
    fixed_layer = facts[registration.path[-1]]
    sheet, fixed = overlay.maps[layer.name], overlay.maps[fixed_layer.name]
    name, fixed_name = leading_pair(layer.headline, fixed_layer.headline, sheet, fixed)
    window = _bounds(sheet["valid"])
    valid = sheet["valid"][window].values & fixed["valid"][window].values
    if not valid.any():
        return layer
    values = _in_window(sheet[name], window)
    fixed_values = _in_window(fixed[fixed_name], window)
    face = height_map(overlay.reference.layer.side, sheet)
    heights = None
    if face in sheet and fixed_name == "image":
        heights = _in_window(sheet[face], window)
    unit_um = length_unit_um(linked.layer.grid, overlay.grid)
    held_out = held_out_r(values, fixed_values, heights, valid, overlay.grid.pixel_um, unit_um)
    judged = registration.model_copy(update={"held_out": held_out})
    return layer.model_copy(update={"registration": judged})


def _in_window(values: xr.DataArray, window: Window) -> Floats:
    """Values of a map within rows and columns."""
    return values[window].values.astype(np.float64)


def _bounds(valid: xr.DataArray) -> Window:
    """Rows and columns that hold all valid pixels; none where there are none."""
    in_rows = np.zeros(valid.shape[0], dtype=bool)
    in_cols = np.zeros(valid.shape[1], dtype=bool)
    for rows, (is_valid,) in read_bands(valid):
        in_rows[rows] = is_valid.any(axis=1)
        in_cols |= is_valid.any(axis=0)
    return _bound(in_rows), _bound(in_cols)


def _bound(is_in: Bools) -> slice:
    """From the first to the last place that is in; empty where none is."""
    places = np.flatnonzero(is_in).tolist()
    if not places:
        return slice(0, 0)
    return slice(places[0], places[-1] + 1)


def _evidence(study: Study, overlay: Overlay, facts: FactsOfLayers) -> tuple[EvidenceFacts, ...]:
    """What stands beside the correlation of each layer with the reference, by the maps that lead.

    Not where they share too little. Columns of the sheets, where their noise is known, and the
    machine direction on the reference go with it.
    """
    *moving, reference = facts
    sheets = [linked for linked in overlay.layers if linked.kind == "sheet"]
    columns = {linked.name: _columns_of(linked) for linked in sheets}
    md_deg = _machine_direction(overlay, facts)
    fixed_map = (reference.name, reference.headline)
    evidence: list[EvidenceFacts | None] = []
    for layer in moving:
        if layer.headline in overlay.maps[layer.name]:
            diagnostics = correlation_diagnostics(
                overlay.maps,
                (layer.name, layer.headline),
                fixed_map,
                params=study.correlate,
                columns=columns,
                md_deg=md_deg,
                light=overlay.light,
            )
            evidence.append(diagnostics)
    return tuple(filter(None, evidence))


def _columns_of(linked: LinkedLayer) -> SheetColumns:
    """Columns of a sheet, and how they come to the reference; gaps between sections are filled."""
    groups = linked.layer.groups
    similarity = Similarity() if linked.link is None else linked.link.chain.similarity
    has_gaps = "sections" in groups and bool(groups["sections"].attrs["missing"])
    return SheetColumns(
        measured=groups["surfaces"],
        flat=groups["flat"],
        similarity=similarity,
        interpolated=has_gaps,
    )


def _machine_direction(overlay: Overlay, facts: FactsOfLayers) -> float | None:
    """Machine direction on the reference: as it was given there, or as marks carry it over.

    Degrees clockwise on screen from x; None where no layer has one.
    """
    reference = overlay.reference.layer
    if reference.md_deg is not None:
        return reference.md_deg
    for layer in facts:
        registration = layer.registration
        if registration is not None and registration.to == reference.name:
            carried_deg = registration.orientation.md_deg_fixed_from_moving
            if carried_deg is not None:
                return carried_deg
    return None


def _compare_registrations(
    study: Study, overlay: Overlay, headline: str
) -> tuple[ComparisonRow, ...]:
    """The leading correlation of a sheet and an image by each registration of the paper."""
    sheet = overlay.layers[0]
    assert sheet.link is not None
    rows = comparison_rows(
        overlay.store.group(LINKED),
        sheet.layer.groups,
        sheet.link.registration.fit,
        name=headline,
        point_um=study.correlate.point_um,
        away=overlay.mask,
        light_off=overlay.light is not None,
    )
    return tuple(rows)


def _refine(
    study: Study, overlay: Overlay, facts: FactsOfLayers
) -> tuple[xr.Dataset, RefinementFacts]:
    """The first of two layers where the maps of both bring it.

    It stands beside that of the marks: nothing that the page correlates was fitted to what it is
    correlated with.
    """
    moving, reference = overlay.layers
    model, grid = study.registration.refine, overlay.grid
    assert moving.link is not None
    assert model is not None
    maps, fixed_maps = moving.maps, reference.maps
    headline, fixed_headline = (layer.headline for layer in facts)
    name, fixed_name = leading_pair(headline, fixed_headline, maps, fixed_maps)
    is_valid = maps["valid"].values & fixed_maps["valid"].values
    unit_um = length_unit_um(moving.layer.grid, grid)
    fit = moving.link.registration.fit
    transform, refinement = refine_link(
        maps[name], fixed_maps[fixed_name], is_valid, grid, fit, model, unit_um
    )
    on_part = moved_by(moving.layer.shown, transform)
    for tile in map_tiles(grid.shape):
        refined = on_part(grid.part(tile.rows, tile.cols))
        overlay.store.add("refined", grid, tile, refined)
    return overlay.store.group("refined"), refinement


def correlate_maps(
    linked: xr.Dataset,
    *,
    params: CorrelateParams | None = None,
    names: tuple[str, str] = ("sheet", "image"),
) -> tuple[CorrelationRow, ...]:
    """Correlate every property with the image, per pixel and over larger points.

    Parameters
    ----------
    linked : Dataset (y, x)
        Linked maps of :func:`planish.resample_maps`.
    params : CorrelateParams, optional
    names : (str, str)
        What the rows call the two layers.

    Returns
    -------
    tuple of CorrelationRow
        As ``results.correlations`` of a run.

    Raises
    ------
    FileError, InputError
        If ``params.regions`` are of no use, or come after a screen was taken off the image.
    """
    check_dataset(
        linked,
        "image",
        "valid",
        expected="linked maps",
        call_format="pl.correlate_maps({})",
        source="pl.resample_maps(measured, flat, onto=image, registration=registration)",
    )
    params = params_of(CorrelateParams, params, "pl.correlate_maps")
    if params.regions is not None:
        grid = Grid.of(linked)
        regions = regions_on(read_regions(params.regions), grid, params.regions)
        if "reach_um" in linked["image"].attrs:
            raise InputError(
                "A screen was taken off the image before the regions were known, and what they hold"
                " has reached their neighbours. Give `regions` to 'planish link' instead."
            )
        valid_bands: list[Bools] = []
        for rows, (is_valid,) in read_bands(linked["valid"]):
            valid_bands.append(is_valid & ~regions.inside(grid.part(rows)))
        is_valid = np.concatenate(valid_bands)
        linked = linked.assign(valid=(("y", "x"), is_valid))
    return tuple(correlate_layers(*names, split_linked(linked, *names), params.point_um))
