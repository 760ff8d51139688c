"""Put the numbers, checks and groups of a run together.

They are of one mapped sheet, or of layers on the pixels of a reference.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from itertools import combinations
from typing import Any

import numpy as np
import xarray as xr

from planish import __version__
from planish.analyze.compare import comparison_rows, correlate_layers
from planish.analyze.correlation_evidence import EvidenceFacts, correlation_diagnostics
from planish.analyze.mottle import mottle_of
from planish.analyze.refinement import RefinementFacts, held_out_r, refine_link
from planish.analyze.sheet_columns import SheetColumns
from planish.analyze.sides import TextureFound, found_by_texture, holes_and_texture, texture_of
from planish.checks import (
    DetectedHoles,
    HolesOnSheet,
    RegisteredLayer,
    RegisteredSheet,
    SheetImage,
    TextureChecks,
    apply_checks,
    for_layers,
    run_checks,
)
from planish.core.bands import read_bands, thinned
from planish.core.checks import Check
from planish.core.facts import Side
from planish.core.source_hash import hash_sources
from planish.core.transform import Similarity
from planish.io.map_store import StoredMaps, map_tiles
from planish.register.refinement import Refinement
from planish.resample import SheetOnto, resample_image
from planish.results import LayerFacts, Results
from planish.run.facts import layer_facts, linked_area
from planish.run.layers import Layer, LayerHoles
from planish.run.overlay import ValidMask
from planish.run.regions import region_facts
from planish.run.registration import Link
from planish.run.run import Run
from planish.run.study import Study, changed, to_dict, with_paths

LINKED = "linked"
"""Name of the group that holds a sheet and an image on the image's pixels."""

Textures = dict[tuple[str, str], TextureFound]


@dataclass(frozen=True, slots=True, eq=False)
class LinkedLayers:
    """Layers registered to the last one, the reference, with their maps on its pixels."""

    study: Study
    layers: list[Layer]
    links: dict[str, Link]
    holes: LayerHoles
    maps: dict[str, xr.Dataset]
    mask: ValidMask
    sink: StoredMaps

    @property
    def reference(self) -> Layer:
        """The layer that all others were brought to."""
        return self.layers[-1]


def gather_sheet(sheet: Layer, study: Study) -> Run:
    """The run of one mapped sheet."""
    assert sheet.facts is not None
    study = changed(study, layers=(sheet.params,), correlate={"regions": None})
    # The coating of the top stands for it, or the thickness where there is none.
    headline = "coating_top" if "coating_top" in sheet.facts.properties else "thickness"
    facts = LayerFacts(
        name=sheet.name, kind="sheet", source=sheet.source, headline=headline, sheet=sheet.facts
    )
    results = _results(study, [facts], for_layers(sheet.checks, sheet.name))
    return Run(study=study, results=results, groups=sheet.groups, unchanged=sheet.unchanged)


def _results(
    study: Study,
    layers: Iterable[LayerFacts],
    checks: Iterable[Check],
    *,
    by_this_code: bool = True,
    **fields: Any,
) -> Results:
    libraries = ("numpy", "scipy", "numba", "xarray", "zarr", "tifffile")
    results = Results(
        planish=__version__,
        code=hash_sources() if by_this_code else "",
        layers=tuple(layers),
        checks=tuple(checks),
        versions={name: version(name) for name in libraries},
        # Paths say where files lie and not what was done.
        parameters=to_dict(with_paths(study, lambda _: None)),
        **fields,
    )
    return apply_checks(results)


def gather_link(linked: LinkedLayers) -> Run:
    """Correlate linked layers in pairs and gather the numbers, checks and groups of their run."""
    study, layers, maps, correlate = (
        linked.study,
        linked.layers,
        linked.maps,
        linked.study.correlate,
    )
    pairs = [*combinations(layers, 2)]
    result_fields: dict[str, Any] = {
        "chain": study.chain,
        "correlations": [
            row
            for a, b in pairs
            for row in correlate_layers(a.name, b.name, maps, correlate.point_um)
        ],
    }
    textures: Textures = {
        (a.name, b.name): texture_of(
            maps[a.name],
            maps[b.name],
            (a.name, b.name),
            side=_side_of(a, b),
            is_given=all(layer.side_given is not None for layer in (a, b) if layer.kind == "image"),
        )
        for a, b in pairs
        if a.kind != b.kind or a.side == b.side
    }
    reference = linked.reference
    lags = {a: texture.lag for (a, b), texture in textures.items() if b == reference.name}
    facts = tuple(
        layer_facts(
            layer,
            maps[layer.name],
            linked.links.get(layer.name),
            _side_of(layer, reference),
            lags.get(layer.name),
            correlate.headline,
        )
        for layer in layers
    )
    by_name = {layer.name: layer for layer in facts}
    facts = tuple(_with_held_out(layer, by_name, linked) for layer in facts)
    checks = [*_checks(linked, facts, textures)]
    result_fields["evidence"] = [*_evidence(linked, facts)]
    if correlate.mottle:
        result_fields["mottle"] = [
            mottle_of(layer.name, maps[layer.name], quantity=layer.image.quantity)
            for layer in facts
            if layer.image is not None
        ]
    is_one_sheet = study.is_sheet_on_image
    groups = {f"layers/{name}": data for name, data in maps.items()}
    if is_one_sheet:
        sheet, linked_maps = layers[0], linked.sink.group(LINKED)
        groups = sheet.groups | {LINKED: linked_maps}
        result_fields["linked"] = linked_area(linked_maps, linked.mask)
        result_fields["comparison"] = comparison_rows(
            linked_maps,
            sheet.groups,
            linked.links[sheet.name].registration.fit,
            name=facts[0].headline,
            point_um=correlate.point_um,
            away=linked.mask,
        )
        checks += run_checks(result_fields["linked"], sheet.name, layers[1].name)
    if study.registration.refine is not None:
        groups["refined"], result_fields["refinement"] = _refined(
            linked, facts, study.registration.refine
        )
    regions = linked.mask.regions
    if regions is not None:
        result_fields["regions"] = region_facts(regions, reference.grid)
    study = changed(study, layers=tuple(layer.params for layer in layers))
    results = _results(
        study,
        facts,
        checks,
        by_this_code=all(layer.by_this_code for layer in layers),
        **result_fields,
    )
    return Run(
        study=study,
        results=results,
        groups=groups | linked.sink.overviews(),
        regions=regions,
        registrations={name: link.registration for name, link in linked.links.items()},
        unchanged=layers[0].unchanged if is_one_sheet else {},
        sheets=(
            {}
            if is_one_sheet
            else {layer.name: layer for layer in layers if layer.params.kind == "volume"}
        ),
    )


def _side_of(a: Layer, b: Layer) -> Side:
    return "bottom" if "bottom" in (a.side, b.side) else "top"


def _evidence(linked: LinkedLayers, facts: tuple[LayerFacts, ...]) -> Iterator[EvidenceFacts]:
    """What stands beside the correlation of each layer with the reference.

    Not where they share too little.
    """
    params, reference = linked.study.correlate, linked.reference
    columns = {
        layer.name: SheetColumns(
            measured=layer.groups["surfaces"],
            flat=layer.groups["flat"],
            similarity=(
                linked.links[layer.name].chain.similarity
                if layer.name in linked.links
                else Similarity()
            ),
            interpolated="sections" in layer.groups
            and bool(layer.groups["sections"].attrs["missing"]),
        )
        for layer in linked.layers
        if layer.kind == "sheet"
    }
    # The machine direction on the reference: as it was given there, or as the marks carry it over.
    md_angles_deg = [reference.md_deg] + [
        r.orientation.md_deg_fixed_from_moving
        for layer in facts
        if (r := layer.registration) and r.to == reference.name
    ]
    md_deg = next((angle_deg for angle_deg in md_angles_deg if angle_deg is not None), None)
    for layer in facts[:-1]:
        if layer.headline in linked.maps[layer.name]:
            evidence = correlation_diagnostics(
                linked.maps,
                (layer.name, layer.headline),
                (facts[-1].name, facts[-1].headline),
                params=params,
                columns=columns,
                md_deg=md_deg,
            )
            if evidence is not None:
                yield evidence


def _refined(
    linked: LinkedLayers, facts: tuple[LayerFacts, ...], model: Refinement
) -> tuple[xr.Dataset, RefinementFacts]:
    """The first of two layers where the maps of both bring it.

    It stands beside that of the marks: nothing that the page correlates was fitted to what it is
    correlated with.
    """
    (layer, reference), grid, sink = linked.layers, linked.reference.grid, linked.sink
    data = linked.maps[layer.name], linked.maps[reference.name]
    moving, fixed = (
        maps[name]
        for maps, name in zip(data, _compared_names(facts[0], facts[1], *data), strict=True)
    )
    valid, fit = (
        data[0]["valid"].values & data[1]["valid"].values,
        linked.links[layer.name].registration.fit,
    )
    transform, refinement = refine_link(moving, fixed, valid, grid, fit, model)
    if isinstance(shown := layer.shown, xr.DataArray):
        on_part = partial(resample_image, shown, transform=transform, must_meet=False)
    else:
        on_part = SheetOnto(shown["surfaces"], shown["flat"], transform=transform).on
    for tile in map_tiles(grid.shape):
        sink.add("refined", grid, tile, on_part(grid.part(tile.rows, tile.cols)))
    return sink.group("refined"), refinement


def _compared_names(
    layer: LayerFacts, reference: LayerFacts, moving: xr.Dataset, fixed: xr.Dataset
) -> list[str]:
    """Give the maps by which two layers are compared.

    They are the headlines; of two sheets, one that both have.
    """
    common_names = [
        name for name in (layer.headline, reference.headline) if name in moving and name in fixed
    ]
    return 2 * common_names[:1] or [layer.headline, reference.headline]


def _checks(
    linked: LinkedLayers, facts: tuple[LayerFacts, ...], textures: Textures
) -> Iterator[Check]:
    layers, maps, reference = linked.layers, linked.maps, linked.reference
    for layer, layer_results in zip(layers, facts, strict=True):
        scale_checks = [*_scale_checks(linked, layer)]
        scale_check_names = {check.name for check in scale_checks}
        yield from for_layers(
            (check for check in layer.checks if check.name not in scale_check_names), layer.name
        )
        yield from scale_checks
        if layer_results.registration is not None:
            yield from _registration_checks(linked, layer, layer_results)
    for name, link in linked.links.items():
        moving, fixed = link.path[:2]
        if (
            moving.kind == "sheet"
            and fixed is reference
            and link.registration.source in ("found", "both")
        ):
            holes = HolesOnSheet(
                sheet=maps[name],
                marks=link.registration.marks,
                layer=name,
                reference=reference.name,
            )
            yield from run_checks(holes, name, reference.name)
    for layer in layers if any(layer.kind == "sheet" for layer in layers) else ():
        if layer.kind == "image":  # whether its greys are cut off where all layers are valid
            _, (grey, *valid) = thinned(
                maps[layer.name]["image"], *(data["valid"] for data in maps.values())
            )
            yield from run_checks(SheetImage(grey[np.logical_and.reduce(valid)]), layer.name)
    for (a, b), texture in textures.items():
        # Where two layers lie is judged where one of them is the reference.
        checks = texture.checks if b == reference.name else texture.checks[:1]
        link = linked.links.get(a)
        registration = None if link is None or link.path[1].name != b else link.registration
        if registration is not None and registration.source == "texture":
            checks = found_by_texture(registration.sentence or "", registration.false_probability)
        elif registration is not None and registration.apart_um is not None:
            checks = checks[0], holes_and_texture(*registration.apart_um)
        yield from run_checks(TextureChecks(*checks), a, b)


def _with_held_out(
    layer: LayerFacts, facts: Mapping[str, LayerFacts], linked: LinkedLayers
) -> LayerFacts:
    """What a layer is, with r that its place by texture was not tuned on."""
    if (registration := layer.registration) is None or registration.source not in (
        "texture",
        "both",
    ):
        return layer
    sheet, reference, grid = (
        linked.maps[layer.name],
        linked.maps[registration.path[-1]],
        linked.reference.grid,
    )
    name, fixed_name = _compared_names(layer, facts[registration.path[-1]], sheet, reference)
    seen = _bounds(sheet["valid"])
    valid = sheet["valid"][seen].values & reference["valid"][seen].values
    if not valid.any():
        return layer
    a, b = (data[seen].values.astype(np.float64) for data in (sheet[name], reference[fixed_name]))
    face = f"topography_{linked.reference.side}"
    heights = (
        sheet[face][seen].values.astype(np.float64)
        if face in sheet and fixed_name == "image"
        else None
    )
    held_out = held_out_r(a, b, heights, valid, grid.pixel_um)
    return layer.model_copy(
        update={"registration": registration.model_copy(update={"held_out": held_out})}
    )


def _bounds(valid: xr.DataArray) -> tuple[slice, slice]:
    in_rows, in_cols = np.zeros(valid.shape[0], dtype=bool), np.zeros(valid.shape[1], dtype=bool)
    for rows, (is_valid,) in read_bands(valid):
        in_rows[rows] = is_valid.any(axis=1)
        in_cols |= is_valid.any(axis=0)
    rows, cols = (np.flatnonzero(m).tolist() or [0, -1] for m in (in_rows, in_cols))
    return slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1)


def _registration_checks(linked: LinkedLayers, layer: Layer, facts: LayerFacts) -> Iterator[Check]:
    assert facts.registration is not None
    (_, fixed, *_), registration, _ = linked.links[layer.name]
    registered_layer = RegisteredLayer(
        layer=layer.name,
        facts=facts.registration,
        fit=registration.fit,
        agreement=registration.agreement(),
        hole_um=sum(linked.study.holes.hole_um) / 2,
        pixel_um=max(*layer.grid.pixel_um, *fixed.grid.pixel_um),
    )
    yield from run_checks(registered_layer, layer.name, fixed.name)
    if registration.source in ("found", "both"):
        for searched_layer in (layer, fixed):
            for holes in linked.holes.searched(searched_layer):
                yield from run_checks(
                    DetectedHoles(searched_layer.name, holes), layer.name, fixed.name
                )
    yield from run_checks(facts, layer.name, facts.registration.path[-1])


def _scale_checks(linked: LinkedLayers, layer: Layer) -> Iterator[Check]:
    if layer.kind != "sheet":
        return
    for name, link in linked.links.items():
        moving, fixed = link.path[:2]
        if layer.name == name or (layer.name == fixed.name and layer.name not in linked.links):
            registered_sheet = RegisteredSheet(
                measured=layer.groups["surfaces"],
                flat=layer.groups["flat"],
                fit=link.registration.fit,
                is_fixed=layer.name == fixed.name,
                either=moving.kind == fixed.kind == "sheet",
            )
            yield from run_checks(registered_sheet, moving.name, fixed.name)
            return
