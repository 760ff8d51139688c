"""Grey levels of a sheet, as its surfaces carry them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from planish.core.errors import CannotMeasure, SurfaceError
from planish.core.facts import SIDES, Side
from planish.core.typing import Floats

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True, slots=True, kw_only=True)
class Greys:
    """Grey levels, noise and blur."""

    air: float
    base: float
    coating_top: float  # NaN where that side has no coating
    coating_bottom: float
    noise: float  # standard deviation of one voxel
    polarity: float  # +1 where the sheet is lighter than the air, -1 where it is darker
    # Standard deviation of the blur across the faces; that of a voxel where it is not known.
    blur_um: float
    padding: float  # value outside the field of view; NaN where there is none
    single_noise: float = float("nan")  # that of a column before it is averaged with its neighbours
    # Variance of the integral over one um of the base's grey, from walls and pores; grey^2 um.
    texture_um: float = 0.0
    # Standard deviation of the Gaussian over neighbouring columns that the fit saw, in columns.
    averaged: float = 0.0
    # Of each coated side, um: thickness of the coating, and the errors that the fit was found to
    # make of its face, its thickness and its interface; (4, classes of thickness).
    fit_errors: Mapping[Side, Floats] = field(default_factory=dict)

    @classmethod
    def of(cls, surfaces: xr.Dataset) -> Greys:
        """Read the levels from the surfaces' attributes; SurfaceError if they are not there.

        Older surfaces lack some of the others, which then have the values of the class.
        """
        from planish.core.grid import blur_reach_um

        attrs = surfaces.attrs
        levels = ("air", "base", "coating_top", "coating_bottom", "noise")
        keys = {name: f"grey_{name}" for name in levels} | {"polarity": "polarity"}
        if lacking := [key for key in (*keys.values(), "blur_um") if key not in attrs]:
            raise SurfaceError(
                f"The surfaces lack {', '.join(lacking)}. Make them with 'planish surface'."
            )
        fit_errors: dict[Side, Floats] = {}
        for side in SIDES:
            if f"fit_errors_{side}_um" in attrs:
                fit_errors[side] = np.reshape(attrs[f"fit_errors_{side}_um"], (4, -1))
        stated = {name: float(attrs[key]) for name, key in keys.items()}
        return cls(
            **stated,
            fit_errors=fit_errors,
            blur_um=blur_reach_um(attrs),
            padding=float(attrs.get("padding", np.nan)),
            averaged=float(attrs.get("averaged_columns", 0.0)),
            texture_um=float(attrs.get("base_texture_um", 0.0)),
            single_noise=float(attrs.get("grey_noise_single", attrs["grey_noise"])),
        )

    def coating(self, side: Side) -> float:
        """Level of the coating of ``top`` or ``bottom``."""
        return self.coating_top if side == "top" else self.coating_bottom

    def coated(self, side: Side) -> bool:
        """Tell if that side has a coating."""
        return bool(np.isfinite(self.coating(side)))

    def need_coating(self, side: Side, subject: str) -> None:
        """CannotMeasure if that side has no coating."""
        if not self.coated(side):
            raise CannotMeasure(
                f"{subject} needs a coating on the {side} side, and none was seen there. Leave it"
                " out."
            )

    def need_absorption(self, subject: str) -> None:
        """Refuse grey values that are no X-ray absorption.

        Those of a sheet darker than what surrounds it.
        """
        if self.polarity < 0:
            raise CannotMeasure(
                f"{subject} is read from X-ray absorption, and this sheet is darker than what"
                " surrounds it. Use a property that needs lengths only, with a density."
            )


FWHM = float(np.sqrt(8 * np.log(2.0)))
"""Full width at half maximum of a Gaussian over its standard deviation."""
