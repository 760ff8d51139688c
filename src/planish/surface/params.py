"""What can be chosen in the surface search."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceParams:
    """Choices of the surface search; lengths in um.

    Attributes
    ----------
    sheet_grey : (float, float) or None
        Grey range of the sheet, where it has to be told from other material. The faces then lie where the grey has
        fallen half way from the sheet's own level to that of the air.
    cutoff_um : float
        Wavelength of the centre surface that passes by half. Hirn et al. (2009) call their centre line a smoothed mean
        of the faces and give no number; 400 um is the cut-off of a Gaussian of 75 um.
    rim_um : float
        Zone around holes and gaps that is kept out of the centre surface and of all properties: the laser burns it.
    step : int
        Width of a measured column in voxels: 1 measures every column of voxels, 3 the means of 3 x 3.
    threads : int or None
        Columns are independent; the result does not depend on it.
    """

    sheet_grey: tuple[float, float] | None = None
    cutoff_um: float = 400.0
    rim_um: float = 100.0
    step: int = 1
    threads: int | None = None
