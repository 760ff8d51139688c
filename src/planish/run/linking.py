"""Link layers by their marks and compare them in pairs.

Registered layers are brought onto the reference's pixels in one step.

The sheets themselves are never registered in space; their flat maps are (Hirn et al. 2009, section
3.4).
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from planish.analyze.image_values import compared_image, reach_um
from planish.io import read_image
from planish.io.map_store import StoredMaps
from planish.marks.regions import Regions
from planish.register import Chain
from planish.run.compute import Progress
from planish.run.facts import input_file
from planish.run.gathering import LINKED, LinkedLayers, gather_link
from planish.run.layers import Layer, LayerHoles
from planish.run.overlay import ValidMask, hole_circles, resample_layers
from planish.run.regions import regions_on
from planish.run.registration import Link, Registration, check_marks, register_layers
from planish.run.run import Run, open_sheet
from planish.run.study import Study, changed
from planish.run.texture_registration import register_layers_by_texture, uses_texture


class LinkInputs(NamedTuple):
    """What a link holds before its volumes are mapped: images and runs, regions, and holes.

    Regions are in um of the reference where this is one of the layers, otherwise as they were read.
    """

    layers: dict[str, Layer]
    regions: Regions | None
    holes: LayerHoles


def link_layers(
    study: Study,
    link_inputs: LinkInputs,
    sheets: Mapping[str, Layer],
    progress: Progress,
    sink: StoredMaps,
) -> Run:
    """Register layers, ``sheets`` of volumes among them, to the last one.

    Bring all onto its pixels and correlate.
    """
    layers_by_name, regions, holes = (
        {**sheets, **link_inputs.layers},
        link_inputs.regions,
        link_inputs.holes,
    )
    layers = [layers_by_name[params.name] for params in study.layers]
    reference = layers[-1]
    if reference.params.kind == "volume" and regions is not None:
        regions = regions_on(regions, reference.grid, study.correlate.regions)
    registrations, links = dict[str, Registration](), dict[str, Link]()
    next_of = [k + 1 if study.chain else len(layers) - 1 for k in range(len(layers) - 1)]
    for k, k_fixed in enumerate(next_of):
        layer, fixed = layers[k], layers[k_fixed]
        progress("register", f"{layer.name} to {fixed.name}")
        register = (
            register_layers_by_texture
            if uses_texture(layer, fixed, holes, study)
            else register_layers
        )
        registration = registrations[layer.name] = register(layer, fixed, holes, study)
        is_of_sheet = (
            layer.kind != fixed.kind
            and registration.source == "texture"
            and not study.registration.mirror
        )
        for image_k in (k, k_fixed) if is_of_sheet and registration.fit.mirrored else ():
            if layers[image_k].kind == "image" and layers[image_k].side_given is None:
                layers[image_k] = replace(layers[image_k], side_found="bottom")
    for k, k_fixed in enumerate(next_of):
        path = layers[k:] if study.chain else [layers[k], layers[k_fixed]]
        chain = Chain(fits=tuple(registrations[layer.name].fit for layer in path[:-1]))
        links[layers[k].name] = Link(path, registrations[layers[k].name], chain)
    reference = layers[-1]
    chains = {name: link.chain for name, link in links.items()}
    progress("link", f"{' x '.join(map(str, reference.grid.shape))} pixels of the {reference.name}")
    rims_um = [
        float(layer.groups["surfaces"].attrs["rim_um"]) for layer in layers if layer.kind == "sheet"
    ]
    # Around holes of images by themselves 100 um.
    rim_um = max(rims_um, default=100.0) + max(reach_um(layer.params.image) for layer in layers)
    circles = [
        hole_circles(
            link.registration.marks, plane, rim_um, chain=chains.get(layer.name), image=layer.image
        )
        for link in links.values()
        for plane, layer in zip(("moving", "fixed"), link.path, strict=False)
    ]
    mask = ValidMask(np.concatenate(circles), regions)
    sources = {layer.name: (layer.shown, chains.get(layer.name)) for layer in layers}
    joint_group = LINKED if study.is_sheet_on_image else None
    maps = resample_layers(sources, mask, reference.grid, sink, joint_group=joint_group)
    progress("correlate", f"{len(maps) * (len(maps) - 1) // 2} pairs of layers")
    return gather_link(LinkedLayers(study, layers, links, holes, maps, mask, sink))


def read_inputs(study: Study, regions: Regions | None, progress: Progress) -> LinkInputs:
    """Read the images and runs of a link and check its marks.

    ``regions`` are laid on a reference that is one of them.
    """
    layers, holes = dict[str, Layer](), LayerHoles(study.holes)
    for params in study.layers:
        if params.kind == "volume":
            continue
        progress("read", Path(params.path).name)
        if params.image is None:
            sheet = open_sheet(params.path)
            md_deg = sheet.md_deg if params.md_deg is None else params.md_deg
            if study.is_sheet_on_image and sheet.params.volume is not None:
                # The study of the run becomes part of this one: the volume linked to the image has
                # the same bytes.
                params = changed(
                    sheet.params, name=params.name, marks=params.marks, volume={"md_deg": md_deg}
                )
            layers[params.name] = replace(sheet, params=params, md_deg=md_deg)
            continue
        image = read_image(params.path, **params.image.how)
        sized_params = changed(
            params, image={"pixel_um": tuple(float(v) for v in image.attrs["pixel_um"])}
        )
        source = input_file(image, params.path)
        layers[params.name] = Layer(
            params=sized_params, source=source, image=image, md_deg=params.image.md_deg
        )
    names = [params.name for params in study.layers]
    for k, params in enumerate(study.layers[:-1]):
        fixed_name = names[k + 1] if study.chain else names[-1]
        marks = params.marks or study.registration.marks
        pair = layers.get(params.name, params.name), layers.get(fixed_name, fixed_name)
        check_marks(*pair, holes, marks, needed=study.registration.by == "holes")
    reference = layers.get(names[-1])
    if reference is not None and regions is not None:
        regions = regions_on(regions, reference.grid, study.correlate.regions)
    for name, layer in layers.items():
        if layer.image is not None and layer.params.image is not None:
            # Artefacts that are declared on an image do not reach their neighbours.
            image_regions = (
                regions if layer is reference and layer.params.image.screen_um is not None else None
            )
            is_compared = None if image_regions is None else ~image_regions.inside(layer.grid)
            layers[name] = replace(
                layer, compared=compared_image(layer.image, layer.params.image, mask=is_compared)
            )
    return LinkInputs(layers, regions, holes)
