"""The registration refined by the maps themselves, and a correlation that this has not made too large."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from planish.analyze import cross_fitted, in_band, searched_null
from planish.core.errors import CannotMeasure
from planish.core.grid import Grid
from planish.core.transform import Similarity
from planish.register import Chain, FittedTransform, Refined, RefineOptions, refine
from planish.register.refinement import Refinement
from planish.results import RefinementFacts

Array = NDArray[np.float64]

_COARSEST_UM = 1000.0  # slower variations are taken off both maps: they make tiles and guards as large as they are
_SURROGATES = 19


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RefinedTransform:
    """The transformation of the marks, followed by its refinement by the maps."""

    marks: Chain
    refined: Refined

    def __call__(self, points: ArrayLike) -> Array:
        """Take points ``(..., 2)`` of the sheet to the reference, in um."""
        return self.refined(self.marks(points))

    @property
    def similarity(self) -> Similarity:
        """That of the marks: the refinement is close to the identity."""
        return self.marks.similarity


def refine_link(
    linked: xr.Dataset, headline: str, grid: Grid, fit: FittedTransform, model: Refinement
) -> tuple[RefinedTransform, RefinementFacts]:
    """Refine a link by its headline property and the image, and correlate without the bias of that.

    What the refinement changed stands beside r over tiles that it has not seen; where the map is too small for such
    tiles, beside r after the search and what the search reaches on unrelated maps.

    Raises
    ------
    CannotRegister
        If SimpleITK is missing, or the refinement folds the map or leaves what the marks allow.
    """
    pixel, valid = grid.pixel_um, linked["valid"].values
    a, b = (_detail(linked[name].values, valid, pixel) for name in (headline, "image"))
    options = RefineOptions(model=model)
    found = refine(a, b, valid, pixel_um=pixel, fit=fit, options=options)

    def tune(other: Array, look: NDArray[np.bool_]) -> Array:
        return refine(other, b, look, pixel_um=pixel, fit=fit, options=replace(options, bounded=False)).image_at(
            b, pixel
        )

    try:
        of_r = cross_fitted(a, b, tune, valid=valid, pixel_um=pixel)
    except CannotMeasure:
        of_r = searched_null(a, tune, valid=valid, surrogates=_SURROGATES)
    facts = RefinementFacts(
        model=found.model, metric=found.metric, property=headline, moved_rms_um=found.moved_um[0],
        moved_most_um=found.moved_um[1], share_of_expected_error=found.share, area=found.area, strain=found.strain,
        warnings=found.warnings, sentence=found.sentence, longest_wave_um=_COARSEST_UM, correlation=of_r.saved,
    )  # fmt: skip
    return RefinedTransform(marks=Chain(fits=(fit,)), refined=found), facts


def _detail(values: Array, valid: NDArray[np.bool_], pixel_um: tuple[float, float]) -> Array:
    """A map without its slow variations; NaN where it is not valid."""
    known = valid & np.isfinite(values)
    return np.where(known, in_band(values.astype(np.float64), known, pixel_um, (None, _COARSEST_UM)), np.nan)
