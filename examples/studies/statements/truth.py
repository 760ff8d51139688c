"""How much of r² is lost to uneven light, and how much to the measurement.

The true coating of a synthetic specimen and the share of the light that its lens leaves lie beside
its image. Both are taken on the run's own points: the same pixels, the same mask, the same image.
Where the run has divided the image by that of a white sheet, the light is put on again instead.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tifffile

import planish as pl

from .common import known, of_image, pitch


class Correlations(NamedTuple):
    """Correlations with an image, over the same points."""

    measured: float  # of the coating that the run measured
    true: float  # of the true coating
    in_other_light: float  # of it, with the uneven light off, or put on again after a white image


def with_truth(run: pl.Run) -> Correlations | None:
    """Correlations of one run; None where nobody knows the truth."""
    image_params = run.study.layers[-1].image
    if image_params is None:
        return None
    folder = Path(image_params.path).parent / "truth"
    if not folder.is_dir():
        return None
    linked, row = run.groups["linked"], of_image(run)
    measured, image = (known(linked, name) for name in ("coating_top", "image"))
    true = np.where(np.isfinite(measured), tifffile.imread(folder / "coating_top.tif"), np.nan)
    light = tifffile.imread(folder / "light.tif")
    other_image = image / light
    if image_params.white is not None:
        other_image = image * light
    size = {"pixel_um": pitch(linked), "point_um": row.point_um}
    return Correlations(
        row.r, pl.correlate(true, image, **size).r, pl.correlate(true, other_image, **size).r
    )


def sentence(runs: Iterable[pl.Run], of: str = "") -> str:
    """Say what r² light and measurement take; nothing where nobody knows the truth.

    Several runs are pooled by Fisher's z.
    """
    runs = list(runs)
    correlations = [with_truth(run) for run in runs]
    if not correlations or None in correlations:
        return ""
    z = np.arctanh(np.array(correlations))
    has_white = runs[0].study.layers[-1].image.white is not None
    return said(Correlations(*np.tanh(z.mean(axis=0))), of, has_white=has_white)


def said(r: Correlations, of: str = "", *, has_white: bool = False) -> str:
    """The same of correlations that are known."""
    measured, true, in_other_light = (math.copysign(one**2, one) for one in r)
    other, cause = "in even light", "uneven light"
    if has_white:
        other, cause = "without the white image", "the white image"
    by_light, by_measurement = (round(d, 3) + 0.0 for d in (true - in_other_light, measured - true))
    return (
        f" On the same points{of}, r² is {measured:.3f} as measured, {true:.3f} of the true"
        f" coating, and {in_other_light:.3f} of the true coating {other}: {cause} changes"
        f" it by {by_light:+.3f}, the measurement by {by_measurement:+.3f}."
    )
