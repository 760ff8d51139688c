"""Layers linked: registered by their marks, brought onto the reference's pixels in one step, compared in pairs.

The sheets themselves are never registered in space; their flat maps are (Hirn et al. 2009, section 3.4).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish import __version__
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
from planish.compute import Compute, Progress
from planish.core.bands import thinned
from planish.core.checks import Check
from planish.core.facts import Side
from planish.core.sources import hash_sources
from planish.core.transform import Similarity
from planish.io import read_image
from planish.io.map_store import HeldMaps, map_tiles
from planish.io.params import HOW_IMAGES_ARE_READ
from planish.marks.regions import Regions
from planish.pipeline.compare import comparison_rows, correlate_layers
from planish.pipeline.compared import compared_image, reach_um
from planish.pipeline.evidence import evidence_of
from planish.pipeline.facts import Link, input_file, layer_facts, linked_area, parameters, versions
from planish.pipeline.halves import Columns
from planish.pipeline.layers import Layer
from planish.pipeline.onto import Away, bring, hole_circles
from planish.pipeline.optics import mottle_of
from planish.pipeline.refinement import refine_link
from planish.pipeline.regions import region_facts, regions_on
from planish.pipeline.registration import Registration, check_marks, register_layers
from planish.pipeline.run import Run, open_sheet
from planish.pipeline.sheet import changed, map_layer
from planish.pipeline.texture import texture_of
from planish.register import Chain
from planish.resample import SheetOnto
from planish.results import LayerFacts, Results
from planish.study import LayerParams, Study

Array = NDArray[np.float64]

LINKED = "linked"
"""Name of the group that holds a sheet and an image on the image's pixels."""

_RIM_UM = 100.0  # around holes of images, where no sheet says otherwise


def link_study(
    study: Study, *, compute: Compute, progress: Progress, kept: Path | None = None,
    mapped: dict[str, Layer] | None = None, near: Mapping[str, Layer] | None = None, sink: HeldMaps | None = None,
) -> Run:  # fmt: skip
    """Register layers to the last one, bring all onto its pixels, and correlate them in pairs.

    ``sink`` takes the maps on those pixels: in memory where not given. ``kept`` is the folder for the results of single
    tiles of volumes that are mapped; ``mapped`` holds the sheets of volumes that need not be mapped again, and is given
    those that were mapped, whatever becomes of the link; ``near`` holds sheets of the same volumes whose surfaces are
    the same.
    """
    mapped = {} if mapped is None else mapped
    layers = _open_layers(study, mapped, near or {}, compute=compute, progress=progress, kept=kept)
    reference = layers[-1]
    regions = regions_on(study.correlate.regions, reference.grid)
    links = _registered(layers, study, progress)
    progress("link", f"{' x '.join(map(str, reference.grid.shape))} pixels of the {reference.name}")
    parts = {
        one.name: (
            one.groups if one.compared is None else one.compared,
            links[one.name].chain if one.name in links else None,
        )
        for one in layers
    }
    sink, away = sink or HeldMaps(), Away.of(_circles(layers, links), regions)
    maps = bring(parts, away, reference.grid, sink, together=LINKED if study.is_sheet_on_image else None)
    progress("correlate", f"{len(maps) * (len(maps) - 1) // 2} pairs of layers")
    return _gathered(study, layers, links, maps, away, sink)


def _open_layers(
    study: Study, mapped: dict[str, Layer], near: Mapping[str, Layer], *, compute: Compute, progress: Progress,
    kept: Path | None,
) -> list[Layer]:  # fmt: skip
    """Read all layers of a study and map its volumes, into ``mapped``.

    Volumes come last: what is wrong with images, runs, marks and regions should not cost their time.
    """
    found: dict[str, Layer] = {}
    for params in study.layers:
        if params.kind != "volume":
            progress("read", Path(params.path).name)
            found[params.name] = _read_image(params) if params.image is not None else _read_run(params, study)
    names = [layer.name for layer in study.layers]
    for k, params in enumerate(study.layers[:-1]):
        to = names[k + 1] if study.chain else names[-1]
        check_marks(found.get(params.name, params.name), found.get(to, to), study, params.marks)
    regions = regions_on(study.correlate.regions, found[names[-1]].grid) if names[-1] in found else None
    for name, layer in found.items():
        found[name] = _as_compared(layer, regions if name == names[-1] else None)
    for params in study.layers:
        name = params.name
        if params.kind == "volume" and name not in mapped:
            mapped[name] = map_layer(
                params, compute=compute, progress=progress, kept=kept and kept / name, before=near.get(name)
            )
    return [mapped[name] if name in mapped else found[name] for name in names]


def _read_image(params: LayerParams) -> Layer:
    assert params.image is not None
    image = read_image(params.path, **params.image.model_dump(include=HOW_IMAGES_ARE_READ))
    pixel = tuple(float(v) for v in image.attrs["pixel_um"])
    used = changed(params, image=changed(params.image, pixel_um=pixel))
    return Layer(params=used, source=input_file(image, params.path), image=image, md_deg=params.image.md_deg)


def _as_compared(layer: Layer, regions: Regions | None) -> Layer:
    """An image with its values as they are compared; artefacts declared on it do not reach their neighbours."""
    if layer.image is None or layer.params.image is None:
        return layer
    mask = None if regions is None or layer.params.image.screen_um is None else ~regions.inside(layer.grid)
    return replace(layer, compared=compared_image(layer.image, layer.params.image, mask=mask))


def _read_run(params: LayerParams, study: Study) -> Layer:
    sheet = open_sheet(params.path)
    md_deg = sheet.md_deg if params.md_deg is None else params.md_deg
    name = params.name
    if study.is_sheet_on_image and sheet.params.volume is not None:
        # The study of the run becomes part of this one: the volume linked to the image has the same bytes.
        volume = changed(sheet.params.volume, md_deg=md_deg)
        params = changed(sheet.params, name=name, marks=params.marks, volume=volume)
    return replace(sheet, params=params, md_deg=md_deg)


def _registered(layers: list[Layer], study: Study, progress: Progress) -> dict[str, Link]:
    """Register every layer but the last one, and compose the chains."""
    found: dict[str, Registration] = {}
    for k, layer in enumerate(layers[:-1]):
        to = layers[k + 1] if study.chain else layers[-1]
        progress("register", f"{layer.name} to {to.name}")
        found[layer.name] = register_layers(layer, to, study)
    links: dict[str, Link] = {}
    for k, layer in enumerate(layers[:-1]):
        path = layers[k:] if study.chain else [layer, layers[-1]]
        chain = Chain(fits=tuple(found[at.name].fit for at in path[:-1]))
        links[layer.name] = Link(path, found[layer.name], chain)
    return links


def _circles(layers: list[Layer], links: dict[str, Link]) -> list[Array]:
    """All holes of all layers on the reference."""
    rims = [float(layer.groups["surfaces"].attrs["rim_um"]) for layer in layers if layer.kind == "sheet"]
    rim_um = max(rims, default=_RIM_UM) + max(reach_um(layer.params.image) for layer in layers)
    found: list[Array] = []
    for link in links.values():
        for side, layer in zip(("moving", "fixed"), link.path, strict=False):
            chain = links[layer.name].chain if layer.name in links else None
            found.append(hole_circles(link.registration.marks, side, rim_um, chain=chain, image=layer.image))
    return found


def _gathered(
    study: Study, layers: list[Layer], links: dict[str, Link], maps: dict[str, xr.Dataset], away: Away, sink: HeldMaps
) -> Run:
    """Correlations, results, checks and groups of a link."""
    reference, point_um = layers[-1], study.correlate.point_um
    pairs = list(combinations(layers, 2))
    rows = [row for a, b in pairs for row in correlate_layers(a.name, b.name, maps, point_um)]
    textures = {(a.name, b.name): texture_of(
        maps[a.name], maps[b.name], (a.name, b.name), side=_side_of(a, b), given=_side_given(a, b)
    ) for a, b in pairs if a.kind != b.kind or a.side == b.side}  # fmt: skip
    facts = [
        layer_facts(
            layer, maps[layer.name], links.get(layer.name), _side_of(layer, reference), lag, study.correlate.headline
        )
        for layer in layers
        for found in [textures.get((layer.name, reference.name))]
        for lag in [found.lag if found else None]
    ]
    checks = [check for layer, own in zip(layers, facts, strict=True) for check in _checks(layer, own, links, study)]
    for name, one in links.items():
        if one.path[0].kind == "sheet" and one.path[1] is reference and one.registration.source == "found":
            moved = HolesOnSheet(sheet=maps[name], marks=one.registration.marks, layer=name, reference=reference.name)
            checks += run_checks(moved, name, reference.name)
    if any(layer.kind == "sheet" for layer in layers):
        images = [layer.name for layer in layers if layer.kind == "image"]
        checks += [check for name in images for check in run_checks(_greys_of(name, maps), name)]
    for (a, b), found in textures.items():
        # Where two layers lie is judged where one of them is the reference.
        checks += run_checks(TextureChecks(*(found.checks if b == reference.name else found.checks[:1])), a, b)
    groups = {f"layers/{name}": data for name, data in maps.items()}
    declared = study.correlate.headline is not None
    columns, md_deg = _columns(layers, links), _machine_direction(reference, facts)
    led = [
        evidence_of(
            maps, one, facts[-1], point_um=point_um, declared=declared, beside=study.correlate.beside, columns=columns,
            md_deg=md_deg, params=study.correlate,
        ) for one in facts[:-1] if one.headline in maps[one.name]
    ]  # fmt: skip
    more: dict[str, Any] = {"evidence": tuple(one for one in led if one is not None)}
    if study.correlate.mottle:
        more["mottle"] = tuple(
            mottle_of(one.name, maps[one.name], quantity=one.image.quantity) for one in facts if one.image is not None
        )
    if study.is_sheet_on_image:
        sheet, link = layers[0], links[layers[0].name]
        linked = sink.group(LINKED)
        groups = sheet.groups | {LINKED: linked}
        more["linked"] = linked_area(linked, away)
        checks += run_checks(more["linked"], sheet.name, reference.name)
        more["comparison"] = tuple(
            comparison_rows(
                linked, sheet.groups, link.registration.fit, name=facts[0].headline, point_um=point_um, away=away
            )
        )
        if study.registration.refine is not None:
            transform, more["refinement"] = refine_link(
                linked, facts[0].headline, reference.grid, link.registration.fit, study.registration.refine
            )
            # Beside the marks' own: nothing that the page correlates was fitted to what it is correlated with.
            moved = SheetOnto(sheet.groups["surfaces"], sheet.groups["flat"], transform=transform)
            for tile in map_tiles(reference.grid.shape):
                sink.add("refined", reference.grid, tile, moved.on(reference.grid.part(tile.rows, tile.cols)))
            groups["refined"] = sink.group("refined")
    if away.regions is not None:
        more["regions"] = region_facts(away.regions, reference.grid)
    groups |= sink.overviews()
    study = changed(study, layers=tuple(layer.params for layer in layers))
    code = hash_sources() if all(layer.by_this_code for layer in layers) else ""
    results = Results(
        planish=__version__, code=code, versions=versions(), layers=tuple(facts), chain=study.chain,
        correlations=tuple(rows), checks=tuple(checks), parameters=parameters(study), **more,
    )  # fmt: skip
    return Run(
        study=study, results=apply_checks(results), groups=groups,
        registrations={name: link.registration for name, link in links.items()}, regions=away.regions,
        unchanged=layers[0].unchanged if study.is_sheet_on_image else {},
        sheets={} if study.is_sheet_on_image else {
            layer.name: layer for layer in layers if layer.params.kind == "volume"
        },
    )  # fmt: skip


def _columns(layers: list[Layer], links: dict[str, Link]) -> dict[str, Columns]:
    """The columns of every sheet, and where they lie on the reference."""
    found: dict[str, Columns] = {}
    for layer in layers:
        if layer.kind == "sheet":
            sections = layer.groups.get("sections")
            found[layer.name] = Columns(
                measured=layer.groups["surfaces"], flat=layer.groups["flat"],
                similarity=links[layer.name].chain.similarity if layer.name in links else Similarity(),
                interpolated=sections is not None and bool(sections.attrs["missing"]),
            )  # fmt: skip
    return found


def _machine_direction(reference: Layer, facts: list[LayerFacts]) -> float | None:
    """Direction on the reference: as it was given there, or as the marks carry it over; None where it is not known."""
    known = [reference.md_deg] + [
        r.orientation.md_deg_fixed_from_moving for one in facts if (r := one.registration) and r.to == reference.name
    ]
    return next((v for v in known if v is not None), None)


def _side_of(a: Layer, b: Layer) -> Side:
    """The side of the sheet that an image of two layers shows."""
    return "bottom" if "bottom" in (a.side, b.side) else "top"


def _side_given(a: Layer, b: Layer) -> bool:
    return all(layer.side_given is not None for layer in (a, b) if layer.kind == "image")


def _greys_of(image: str, maps: Mapping[str, xr.Dataset]) -> SheetImage:
    """A sample of the greys of an image where all layers are valid."""
    _, (grey, *valid) = thinned(maps[image]["image"], *(data["valid"] for data in maps.values()))
    return SheetImage(grey[np.logical_and.reduce(valid)])


def _checks(layer: Layer, facts: LayerFacts, links: dict[str, Link], study: Study) -> Iterator[Check]:
    """Checks of one layer, and of its registration."""
    scaled = list(_scale_checks(layer, links))
    names = {check.name for check in scaled}
    yield from for_layers((check for check in layer.checks if check.name not in names), layer.name)
    yield from scaled
    if facts.registration is None:
        return
    link = links[layer.name]
    to = link.path[1]
    registered = RegisteredLayer(
        layer=layer.name, facts=facts.registration, fit=link.registration.fit, agreement=link.registration.agreement(),
        hole_um=sum(study.holes.hole_um) / 2, pixel_um=max(*layer.grid.pixel_um, *to.grid.pixel_um),
    )  # fmt: skip
    yield from run_checks(registered, layer.name, to.name)
    if link.registration.source == "found":
        for holes in (DetectedHoles(side.name, holes) for side in (layer, to) for holes in side.holes_found):
            yield from run_checks(holes, layer.name, to.name)
    yield from run_checks(facts, layer.name, facts.registration.path[-1])


def _scale_checks(layer: Layer, links: dict[str, Link]) -> Iterator[Check]:
    """The scale through a sheet by its own registration, or by the first one to it."""
    if layer.kind != "sheet":
        return
    for name, link in links.items():
        one, to = link.path[:2]
        if layer.name == name or (layer.name == to.name and layer.name not in links):
            sheet = RegisteredSheet(
                measured=layer.groups["surfaces"], flat=layer.groups["flat"], fit=link.registration.fit,
                is_fixed=layer.name == to.name, either=one.kind == to.kind == "sheet",
            )  # fmt: skip
            yield from run_checks(sheet, one.name, to.name)
            return
