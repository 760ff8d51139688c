"""Meaning of the grey values in one volume: the levels that the surface search learnt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planish.core.errors import CannotMeasure, SurfaceError

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
    polarity: float  # +1 where the sheet is brighter than the air, -1 where it is darker
    blur_um: float  # standard deviation of the blur across the faces
    padding: float  # value outside the field of view; NaN where there is none
    single_noise: float = float("nan")  # that of a column before it is averaged with its neighbours
    averaged: float = 0.0  # standard deviation of the Gaussian over neighbouring columns that the fit saw, in columns

    @classmethod
    def of(cls, surfaces: xr.Dataset) -> Greys:
        """Read the levels from the surfaces' attributes; SurfaceError if they are not there."""
        attrs = surfaces.attrs
        named = {name: f"grey_{name}" for name in ("air", "base", "coating_top", "coating_bottom", "noise")}
        named |= {"polarity": "polarity", "blur_um": "blur_um"}
        lacking = [key for key in named.values() if key not in attrs]
        if lacking:
            raise SurfaceError(f"The surfaces lack {', '.join(lacking)}. Make them with 'planish surface'.")
        levels = {name: float(attrs[key]) for name, key in named.items()}
        more = {"padding": np.nan, "grey_noise_single": levels["noise"], "averaged_columns": 0.0}
        padding, single, averaged = (float(attrs.get(key, default)) for key, default in more.items())
        return cls(**levels, padding=padding, single_noise=single, averaged=averaged)

    def coating(self, side: str) -> float:
        """Level of the coating of ``top`` or ``bottom``."""
        return self.coating_top if side == "top" else self.coating_bottom

    def coated(self, side: str) -> bool:
        """Tell if that side has a coating."""
        return bool(np.isfinite(self.coating(side)))

    def need_coating(self, side: str, subject: str) -> float:
        """Level of the coating; CannotMeasure if that side has none."""
        level = self.coating(side)
        if not np.isfinite(level):
            raise CannotMeasure(f"{subject} needs a coating on the {side} side, and none was seen there. Leave it out.")
        return level

    def need_absorption(self, subject: str) -> None:
        """Refuse grey values that are no X-ray absorption: those of a sheet darker than what surrounds it."""
        if self.polarity < 0:
            raise CannotMeasure(
                f"{subject} is read from X-ray absorption, and this sheet is darker than what surrounds it, as in "
                "photographs of sections in resin. Use a property that needs lengths only, with a density."
            )
