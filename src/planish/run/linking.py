"""Layers linked: registered by their marks, brought onto the reference's pixels in one step, compared in pairs.

The sheets themselves are never registered in space; their flat maps are (Hirn et al. 2009, section 3.4).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from planish.analyze.image_values import compared_image, reach_um
from planish.core.typing import Floats
from planish.io import read_image
from planish.io.map_store import HeldMaps
from planish.io.params import HOW_IMAGES_ARE_READ
from planish.marks.regions import Regions
from planish.register import Chain
from planish.run.compute import Compute, Progress
from planish.run.gathering import LINKED, LinkedLayers, gather_link
from planish.run.layers import Layer, LayerHoles, MappedSheets
from planish.run.overlay import ValidMask, hole_circles, resample_layers
from planish.run.regions import regions_on
from planish.run.registration import Link, check_marks, register_layers
from planish.run.run import Run, open_sheet
from planish.run.sheet import map_layer
from planish.run.study import LayerParams, Study, changed
from planish.run.summaries import input_file

_RIM_UM = 100.0  # around holes of images, where no sheet says otherwise


def link_study(
    study: Study, sheets: MappedSheets, *, compute: Compute, progress: Progress, tiles: Path | None = None,
    sink: HeldMaps | None = None,
) -> Run:  # fmt: skip
    """Register layers to the last one, bring all onto its pixels, and correlate them in pairs.

    ``sheets`` holds those of volumes that need not be mapped again, and is given those that were mapped, whatever
    becomes of the link. ``tiles`` is the folder for the results of single tiles of volumes that are mapped; ``sink``
    takes the maps on the reference's pixels: in memory where not given.
    """
    sink, holes = sink or HeldMaps(), LayerHoles(study.holes)
    # Volumes come last: what is wrong with images, runs, marks and regions should not cost their time.
    layers_read, regions = _read_layers(study, holes, progress)
    for params in study.layers:
        if params.kind == "volume" and params.name not in sheets.by_name():
            folder, similar = tiles and tiles / params.name, sheets.similar.get(params.name)
            sheets.add(map_layer(params, compute=compute, progress=progress, tiles=folder, before=similar))
    layers = [(sheets.by_name() | layers_read)[params.name] for params in study.layers]
    reference = layers[-1]
    if reference.params.kind == "volume":
        regions = regions_on(study.correlate.regions, reference.grid)
    links = _register(layers, holes, study, progress)
    progress("link", f"{' x '.join(map(str, reference.grid.shape))} pixels of the {reference.name}")
    chains = {name: link.chain for name, link in links.items()}
    mask = ValidMask.of(_hole_circles(layers, links, chains), regions)
    parts = {layer.name: (layer.shown, chains.get(layer.name)) for layer in layers}
    maps = resample_layers(parts, mask, reference.grid, sink, together=LINKED if study.is_sheet_on_image else None)
    progress("correlate", f"{len(maps) * (len(maps) - 1) // 2} pairs of layers")
    return gather_link(
        LinkedLayers(study=study, layers=layers, links=links, holes=holes, maps=maps, mask=mask, sink=sink)
    )


def _read_layers(study: Study, holes: LayerHoles, progress: Progress) -> tuple[dict[str, Layer], Regions | None]:
    """Read the images and runs of a study, check its marks, and lay its regions on a reference that is one of them."""
    layers: dict[str, Layer] = {}
    for params in study.layers:
        if params.kind != "volume":
            progress("read", Path(params.path).name)
            layers[params.name] = _read_run(params, study) if params.image is None else _read_image(params)
    names = [params.name for params in study.layers]
    for k, params in enumerate(study.layers[:-1]):
        to = names[k + 1] if study.chain else names[-1]
        marks = params.marks or study.registration.marks
        check_marks(layers.get(params.name, params.name), layers.get(to, to), holes, marks)
    reference = layers.get(names[-1])
    regions = None if reference is None else regions_on(study.correlate.regions, reference.grid)
    for name, layer in layers.items():
        if layer.image is not None and layer.params.image is not None:
            # Artefacts that are declared on an image do not reach their neighbours.
            declared = regions if layer is reference and layer.params.image.screen_um is not None else None
            mask = None if declared is None else ~declared.inside(layer.grid)
            layers[name] = replace(layer, compared=compared_image(layer.image, layer.params.image, mask=mask))
    return layers, regions


def _read_image(params: LayerParams) -> Layer:
    assert params.image is not None
    image = read_image(params.path, **params.image.model_dump(include=HOW_IMAGES_ARE_READ))
    pixel = tuple(float(v) for v in image.attrs["pixel_um"])
    used = changed(params, image=changed(params.image, pixel_um=pixel))
    return Layer(params=used, source=input_file(image, params.path), image=image, md_deg=params.image.md_deg)


def _read_run(params: LayerParams, study: Study) -> Layer:
    sheet = open_sheet(params.path)
    md_deg = sheet.md_deg if params.md_deg is None else params.md_deg
    if study.is_sheet_on_image and sheet.params.volume is not None:
        # The study of the run becomes part of this one: the volume linked to the image has the same bytes.
        volume = changed(sheet.params.volume, md_deg=md_deg)
        params = changed(sheet.params, name=params.name, marks=params.marks, volume=volume)
    return replace(sheet, params=params, md_deg=md_deg)


def _register(layers: list[Layer], holes: LayerHoles, study: Study, progress: Progress) -> dict[str, Link]:
    """Register every layer but the last one, and compose the chains."""
    paths = [layers[k:] if study.chain else [layers[k], layers[-1]] for k in range(len(layers) - 1)]
    registrations = {}
    for layer, to, *_ in paths:
        progress("register", f"{layer.name} to {to.name}")
        registrations[layer.name] = register_layers(layer, to, holes, study)
    return {
        path[0].name: Link(
            path, registrations[path[0].name], Chain(fits=tuple(registrations[m.name].fit for m in path[:-1]))
        )
        for path in paths
    }


def _hole_circles(layers: list[Layer], links: dict[str, Link], chains: dict[str, Chain]) -> list[Floats]:
    """All holes of all layers on the reference."""
    rims = [float(layer.groups["surfaces"].attrs["rim_um"]) for layer in layers if layer.kind == "sheet"]
    rim_um = max(rims, default=_RIM_UM) + max(reach_um(layer.params.image) for layer in layers)
    return [
        hole_circles(link.registration.marks, side, rim_um, chain=chains.get(layer.name), image=layer.image)
        for link in links.values()
        for side, layer in zip(("moving", "fixed"), link.path, strict=False)
    ]
