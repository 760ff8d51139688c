"""Refuse what can be refused before anything is read.

That is names, numbers that an option needs, and images beyond the memory.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import xarray as xr

from planish.analyze.leading_map import leading_map
from planish.analyze.params import CorrelateParams
from planish.core.axial import refuse_axial
from planish.core.errors import InputError, ResourceError
from planish.core.memory import enough_gb
from planish.core.older_names import renamed
from planish.design import read_pattern
from planish.io.info import LINK_BYTES, PIXEL_BYTES
from planish.io.params import ImageParams
from planish.io.picture import load_picture
from planish.marks.regions import Regions, read_regions
from planish.measure import PROPERTIES, check_maps, possible_maps, registered
from planish.measure.registry import SUMS
from planish.run.compute import Compute
from planish.run.sheet import asked_corrections
from planish.run.study import GivenLayer, Study

# Bytes a pixel: refining holds image and map in double precision, filtered, several times; without
# a folder, all linked maps are held; beside an image, its values as compared and, while a screen is
# taken off, two means and their weights.
_REFINED_BYTES = 120
_HELD_BYTES = 130
_COMPARED_BYTES = 24
# White and dark, each with its error and the means that are tried, and what they make of the image.
_LIGHT_BYTES = 64


def check_request(study: Study, compute: Compute, *, held: bool = False) -> Regions | None:
    """Raise what no volume can change, and give the regions that were read.

    ``held``: the results stay in memory.

    CannotMeasure names further maps that are unknown or lack a number, InputError what needs other
    maps, layers or references, FileError a file that cannot be read, and ResourceError an image
    beyond the memory.
    """
    for layer in study.layers:
        if layer.kind == "volume":
            is_labels = layer.surface.labels is not None
            check_maps(layer.properties, labels=is_labels)
            asked_corrections(layer)
            names = {*PROPERTIES, *layer.properties.maps}
            maps = sorted(names) if is_labels else sorted(possible_maps(layer.properties))
            headline = study.correlate.headline
            _check_names("headline", () if headline is None else (headline,), maps)
            _check_names("beside", study.correlate.beside, maps)
    _check_beside(study)
    _check_light(study)
    if study.registration.design is not None:
        read_pattern(study.registration.design)
    regions = None if study.correlate.regions is None else read_regions(study.correlate.regions)
    bytes_per_pixel = PIXEL_BYTES if study.registration.refine is None else _REFINED_BYTES
    bytes_per_pixel += _HELD_BYTES * held
    for layer in study.layers:
        if layer.image is not None:
            _check_memory(layer, layer.image, bytes_per_pixel, compute)
    return regions


def _check_names(parameter: str, names: Iterable[str], maps: Sequence[str]) -> None:
    """Raise InputError for names of maps that there will not be."""
    absent = sorted({*names}.difference(maps))
    if absent:
        raise InputError(
            f"`{parameter}={', '.join(absent)}`: there will be no such map. Give some of "
            f"{', '.join(maps)}, or ask for it with `property` as well."
            + "".join(map(renamed, absent))
        )


def _check_memory(
    layer: GivenLayer, image: ImageParams, pixel_bytes: int, compute: Compute
) -> None:
    """Raise ResourceError for an image that takes more than the memory."""
    rows, cols = load_picture(Path(layer.path), decode=False).values.shape[:2]
    if image.dark_grey is not None or image.screen_um or image.white:
        pixel_bytes += _COMPARED_BYTES
    if image.white is not None:
        pixel_bytes += _LIGHT_BYTES
    needed_bytes = pixel_bytes * rows * cols + LINK_BYTES
    if needed_bytes > compute.memory:
        raise ResourceError(
            f"The {layer.name} of {rows * cols / 1e6:.0f} million pixels takes"
            f" {needed_bytes / 1e9:.1f} GB of memory, {compute.memory / 1e9:.1f} GB are"
            f" allowed. Give more with `memory={enough_gb(needed_bytes)}GB`, or crop or"
            " bin it."
        )


def _check_beside(study: Study) -> None:
    """Raise InputError where the maps to stand beside hold one twice, or parts and their sum.

    Also where one of them, or the map that is to lead, has no r.
    """
    names = study.correlate.beside
    declared = study.correlate.headline
    for name in (declared, *names):
        refuse_axial(registered().get(str(name)))
    if not names:
        return
    sides = [layer.image.side for layer in study.layers if layer.image is not None]
    side = "bottom" if "bottom" in sides else "top"
    expected_names = ("thickness", f"coating_{side}", declared or "thickness")
    measured = (("y", "x"), np.ones((1, 1)))
    headline = leading_map(xr.Dataset(dict.fromkeys(expected_names, measured)), side, declared)
    repeated = sorted({name for name in names if (headline, *names).count(name) > 1})
    if repeated:
        raise InputError(
            f"`beside={', '.join(repeated)}`: the map leads already, or stands there twice. Leave"
            " it out of `beside`."
        )
    for total, *summands in SUMS:
        if {total, *summands} <= {headline, *names}:
            raise InputError(
                f"`beside={', '.join(names)}`: {total} follows from {', '.join(summands)}. With"
                f" {headline}, which leads, all of them are given, and nothing is left to"
                " correlate. Leave one of them out."
            )


def _check_reflectance(image: ImageParams) -> None:
    """Raise InputError where an image holds no reflectance, as `kubelka_munk` needs it."""
    if image.white is not None and image.white_exposure is None:
        raise InputError(
            "`kubelka_munk` needs reflectance, and its level is not known. Give `white_exposure`,"
            " 1 where image and `white` were exposed alike, or leave `kubelka_munk` out."
        )
    if image.white is None and image.dark_grey is None:
        raise InputError(
            "`kubelka_munk` needs reflectance, and the image holds uncalibrated grey values. Give"
            " `white` and `dark`, pictures of a white sheet and without light, with"
            " `white_exposure`; or `dark_grey` and `white_grey`, two known greys; or leave it out."
        )


def _check_light(study: Study) -> None:
    """Raise InputError where an option needs an image, references or volumes the study lacks."""
    correlate = study.correlate
    reference = study.layers[-1].image
    images = [layer.image for layer in study.layers if layer.image is not None]
    n_sheets = len(study.layers) - len(images)
    _check_optics(correlate, reference if n_sheets else None)
    is_screened = any(image.screen_um is not None for image in images)
    if is_screened and study.registration.refine is not None:
        raise InputError(
            "`refine` aligns the fine texture of both layers, which `screen_um` takes off the"
            " image. Leave one of them out."
        )
    if correlate.mottle and not images:
        raise InputError("`mottle`: no layer is an image. Link one, or leave it out.")
    if correlate.error_ratio is not None and (reference is not None or n_sheets < 2):
        raise InputError(
            "`error_ratio` is for two measurements of one quantity: the last layer and another one"
            " have to be volumes or runs. Leave it out."
        )


def _check_optics(correlate: CorrelateParams, reference: ImageParams | None) -> None:
    """Raise InputError for options of light without the image, or the coating, that they need."""
    options = {"kubelka_munk": correlate.kubelka_munk, "light_spread_um": correlate.light_spread_um}
    optics = " and ".join(f"`{name}`" for name, value in options.items() if value is not None)
    if reference is None:
        if optics or correlate.light is not None:
            raise InputError(
                f"{optics or '`light`'}: no image stands last, to which a map of a sheet is"
                " compared. Link a volume or a run to an image, or leave it out."
            )
    elif optics and not (correlate.headline or "coating").startswith("coat"):
        raise InputError(
            f"{optics}: {correlate.headline} leads, which is no coating. Leave `headline` out,"
            " or name a coating."
        )
    elif correlate.kubelka_munk is not None:
        _check_reflectance(reference)
