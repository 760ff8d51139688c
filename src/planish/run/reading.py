"""Read what a link holds before its volumes are mapped, and check its marks.

Volumes come last: what is wrong with images, runs, marks and regions should not cost their time.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from planish.analyze.image_values import compared_image
from planish.checks import ImageFile, run_checks
from planish.io.light import read_corrected
from planish.io.sizes import PIXEL, with_advice
from planish.marks.regions import Regions
from planish.register import need_holes
from planish.run.compute import Progress
from planish.run.facts import input_file
from planish.run.holes import HoleSearch
from planish.run.layers import Layers, MappedLayer
from planish.run.marks_registration import read_given
from planish.run.regions import regions_on
from planish.run.run import open_sheet
from planish.run.study import GivenLayer, Study, changed


class Inputs(NamedTuple):
    """Images and runs by name, declared regions, and the search for holes.

    Regions are in um of the reference where this is one of the layers, otherwise as they were read.
    """

    layers: Layers
    regions: Regions | None
    holes: HoleSearch


def read_inputs(study: Study, regions: Regions | None, progress: Progress) -> Inputs:
    """Read the images and runs of a study and check its marks.

    ``regions`` are laid on a reference that is one of them.
    """
    layers = Layers()
    for params in study.layers:
        if params.kind == "volume":
            continue
        progress("read", Path(params.path).name)
        if params.kind == "run":
            layers[params.name] = _read_run(params, study)
        else:
            layers[params.name] = layer = _read_image(params)
            if layer.source.size_doubt:  # before what needs the right size
                progress("look", with_advice(layer.source.size_doubt, PIXEL))
    holes = HoleSearch(study.holes)
    _check_marks(study, layers, holes)
    reference = layers.get(study.layers[-1].name)
    if reference is not None and regions is not None:
        regions = regions_on(regions, reference.grid, study.correlate.regions)
    for name, layer in layers.items():
        # Artefacts that are declared on an image do not reach their neighbours.
        layers[name] = _as_compared(layer, regions if layer is reference else None)
    return Inputs(layers, regions, holes)


def _read_run(params: GivenLayer, study: Study) -> MappedLayer:
    """The sheet of a run; a machine direction that is given now goes before that of the run."""
    sheet = open_sheet(params.path)
    md_deg = sheet.md_deg if params.md_deg is None else params.md_deg
    if study.is_sheet_on_image and sheet.params.volume is not None:
        # The study of the run becomes part of this one: the volume linked to the image has the
        # same bytes.
        params = changed(
            sheet.params, name=params.name, marks=params.marks, volume={"md_deg": md_deg}
        )
    return replace(sheet, params=params, md_deg=md_deg)


def _read_image(params: GivenLayer) -> MappedLayer:
    assert params.image is not None
    image, corrected = read_corrected(params.image)
    pixel_um = tuple(map(float, image.attrs["pixel_um"]))
    checks = run_checks(ImageFile(image=image, light=corrected and corrected.facts))
    return MappedLayer(
        checks=tuple(checks),
        params=changed(params, image={"pixel_um": pixel_um}),
        source=input_file(image, params.path),
        image=image,
        corrected=corrected,
        md_deg=params.image.md_deg,
    )


def _check_marks(study: Study, layers: Mapping[str, MappedLayer], holes: HoleSearch) -> None:
    """Refuse marks of no use, and images with too few holes where the texture cannot help."""
    # A volume, which is not mapped yet, is a name.
    sources = [layers.get(params.name, params.name) for params in study.layers]
    for k, k_fixed in enumerate(study.next_layers):
        path = study.layers[k].marks or study.registration.marks
        if path is not None:
            read_given(path, sources[k], sources[k_fixed])
        elif study.registration.by == "holes":
            for image in (sources[k], sources[k_fixed]):
                if not isinstance(image, str) and image.kind == "image":
                    need_holes(holes.of(image, image), study.holes.hole_um)


def _as_compared(layer: MappedLayer, regions: Regions | None) -> MappedLayer:
    """The layer with its image as it is compared; a sheet as it is."""
    params = layer.params.image
    if layer.image is None or params is None:
        return layer
    is_compared = None
    if regions is not None and params.screen_um is not None:
        is_compared = ~regions.inside(layer.grid)
    image = layer.image if layer.corrected is None else layer.corrected.valid
    return replace(layer, compared=compared_image(image, params, mask=is_compared))
