"""What can be chosen in the surface search."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceParams:
    """Choices of the surface search; lengths in um.

    Attributes
    ----------
    sheet_grey : (float, float) or None
        Grey range of the sheet, where it has to be told from other material. The faces then lie where the grey has
        fallen half way from the sheet's own level to that of the air.
    seed_um : (float, float, float) or None
        A point (z, y, x) inside the sheet, where there are several objects. What lies beside the chosen one need not
        be air: its faces lie where the grey has fallen half way to that of the gap.
    coating_grey : float or None
        Grey of the coating where it is known. It is needed only where a coating is nowhere thicker than the blur: grey
        and thickness of such a layer cannot be told apart. Learnt from the volume where not given.
    fringe : "auto", "off" or float
        Phase-contrast fringe beside every edge, as a share of the edge's step. "auto" learns its size and width where
        the air beside the faces is darker than farther away; a number is its size, with a width of 1.5 voxels.
    cutoff_um : float
        Wavelength of the centre surface that passes by half. Hirn et al. (2009) call their centre line a smoothed mean
        of the faces and give no number; 400 um is the cut-off of a Gaussian of 75 um.
    rim_um : float
        Zone around holes and gaps that is kept out of the centre surface and of all properties: the laser burns it.
    envelope_um : float or None
        Radius of a ball that rolls over both faces; ``top_envelope`` and ``bottom_envelope`` are then found beside the
        faces. The usual radii are 50 to 250 um; loose fibres decide which.
    method : {"profile", "paper"}
        How faces are found. "profile" fits the blurred profile of every column. "paper" does as Hirn et al. (2009):
        slice by slice (row by row of the maps), with thresholds, outermost boundaries, and a centre line that is
        smoothed along the slice only.
    step : int
        Width of a measured column in voxels: 1 measures every column of voxels, 3 the means of 3 x 3.
    threads : int or None
        Columns are independent; the result does not depend on it.
    """

    sheet_grey: tuple[float, float] | None = None
    seed_um: tuple[float, float, float] | None = None
    coating_grey: float | None = None
    fringe: Literal["auto", "off"] | float = "auto"
    cutoff_um: float = 400.0
    rim_um: float = 100.0
    envelope_um: float | None = None
    method: Literal["profile", "paper"] = "profile"
    step: int = 1
    threads: int | None = None
