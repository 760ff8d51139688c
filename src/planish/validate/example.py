"""One specimen of a certificate as maps: what the image showed, and how far off each pixel is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planish.core.area import area_mean
from planish.core.grid import pitch
from planish.pipeline import Run
from planish.synthetic import InstrumentFiles, Specimen
from planish.validate.image_errors import make_pixels
from planish.validate.truth import pixel_thickness

Array = NDArray[np.float64]

_MOST_PIXELS = 1200  # along the longer side: more than a picture on a page can show


@dataclass(frozen=True, slots=True, kw_only=True)
class Example:
    """Maps (rows, cols) of one specimen on the image's pixels, NaN where nothing is valid.

    Attributes
    ----------
    seed : int
    pixel_um : (float, float)
        Pitch of rows and columns.
    image : Array
        Grey values.
    away_um : Array
        Error of a pixel in the sheet.
    name : str
        Property of the other two: ``coating_top``, or ``thickness`` of a paper without coating.
    found_um, error_um : Array
        The property as measured, and measured minus true.
    """

    seed: int
    pixel_um: tuple[float, float]
    image: Array
    away_um: Array
    name: str
    found_um: Array
    error_um: Array


def make_example(specimen: Specimen, files: InstrumentFiles, run: Run, seed: int) -> Example | None:
    """Maps of a linked run, as means over larger pixels where there are many; None without an image."""
    if "linked" not in run.groups:
        return None
    linked, pixels = run.groups["linked"], make_pixels(specimen, files, run.groups)
    name = str(run.results["headline"])
    found = np.where(pixels.valid, np.asarray(linked[name].values, dtype=np.float64), np.nan)
    true = pixel_thickness(specimen.sheet, name, pixels.u, pixels.v, pixels.offsets)
    away = np.hypot(pixels.found[..., 0] - pixels.u, pixels.found[..., 1] - pixels.v)
    factor = max(1.0, max(found.shape) / _MOST_PIXELS)

    def smaller(values: Array) -> Array:
        return area_mean(np.asarray(values, dtype=np.float64), (factor, factor)) if factor > 1 else values

    rows, cols = pitch(linked)
    return Example(
        seed=seed,
        pixel_um=(factor * rows, factor * cols),
        image=smaller(np.asarray(linked["image"].values, dtype=np.float64)),
        away_um=smaller(away),
        name=name,
        found_um=smaller(found),
        error_um=smaller(found - true),
    )
