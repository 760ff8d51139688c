"""Priors of the fit of a column: the edge's profile, and levels and spreads of both sides."""

from __future__ import annotations

from dataclasses import dataclass

from planish.core.frame import Frame
from planish.core.typing import Floats
from planish.surface.columns import Scale

FRINGE_PX = 1.5  # width of a fringe where it is not known better, in voxels


@dataclass(frozen=True, slots=True, kw_only=True)
class Edge:
    """Profile of a sharp edge as the scanner shows it, which a column crosses at a right angle; lengths in voxels."""

    width: float  # standard deviation of the blur
    # Size of the phase-contrast fringe beside it: a share of the edge's step; 0 where there is none.
    fringe: float = 0.0
    # Distance of its undershoot and overshoot from the edge: the standard deviation of the Gaussian whose second
    # derivative it is.
    fringe_width: float = FRINGE_PX

    @property
    def ratio(self) -> float:
        """Width of the blur over that of the fringe."""
        return self.width / self.fringe_width


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """Prior of the layers on one side of a column.

    Attributes
    ----------
    level, spread : (4,)
        Of face, thickness, grey of the coating (or of what lies outside), grey of the base: the value expected, and
        how far a column may differ. Only those of the greys are used.
    coated : bool
    """

    level: Floats
    spread: Floats
    coated: bool

    def brighter(self, factor: float) -> Side:
        """Return the side with a coating whose grey is known: so many times what it was."""
        level, wide = self.level.copy(), self.spread.copy()
        level[2] *= factor
        wide[2] = 1e-3 * level[2]
        return Side(level=level, spread=wide, coated=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Priors:
    """All that the fit of a column needs beside the column."""

    scale: Scale
    noise: float  # standard deviation of what the fit sees in the air
    single_noise: float  # that of a column that is not averaged with its neighbours
    scatter: float  # standard deviation by which the fit takes a sample to differ from its model: the noise or more
    base: float  # level of the base above the air
    edge: Edge  # blur and fringe
    reach: float  # how far outside the expected face the search starts, in voxels
    embedded_level: (
        float  # grey at which a sheet amid other material is separated from it; 0 where air lies beside the sheet
    )
    sides: dict[bool, Side]  # by whether the side lies at the high end of the columns

    @property
    def coated(self) -> tuple[bool, bool]:
        """Tell of the sides at the high and at the low end if they have a coating."""
        return self.sides[True].coated, self.sides[False].coated

    def attrs(self, pitch_um: float, frame: Frame) -> dict[str, float]:
        """Return grey levels (NaN for a coating that is not there), noise, blur and fringe as surfaces carry them."""
        air, polarity, edge = self.scale.air, self.scale.polarity, self.edge
        high, low = (
            float(polarity * side.level[2] + air) if side.coated else float("nan")
            for side in (self.sides[True], self.sides[False])
        )
        top, bottom = (high, low) if frame.top == "high" else (low, high)
        return {
            "grey_air": air, "grey_base": polarity * self.base + air, "grey_coating_top": top,
            "grey_coating_bottom": bottom, "grey_noise": self.noise, "grey_noise_single": self.single_noise,
            "averaged_columns": self.scale.blend, "polarity": polarity,
            "blur_um": edge.width * pitch_um, "fringe": edge.fringe,
            "fringe_um": edge.fringe_width * pitch_um if edge.fringe else 0.0,
        }  # fmt: skip
