"""What can be chosen about properties along rays, each with its unit and its reason."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Literal

from planish.core.errors import CannotMeasure
from planish.measure.densities import Densities


@dataclass(frozen=True, slots=True, kw_only=True)
class RayOptions:
    """Choices of the properties; lengths in um, grey levels in the volume's own values.

    Attributes
    ----------
    densities : Densities
        Densities and weighed masses.
    void_grey : float or None
        Level between void and solid; half way between air and base where not given.
    solid_grey : float or None
        Level of the solid without voids. Where given, porosity is what the mean grey lacks to it, which sees pores
        that are too small to be resolved; where not, the share of the ray beyond ``void_grey``.
    filler_grey : float or None
        Level between fibres and filler; half way between base and coating where not given.
    ink_grey : (float, float) or None
        Range of the ink.
    ink_reach_um : float or None
        Depth below the top face to which ink is looked for; half the sheet where not given.
    edge_um : float or None
        Left out of the base at both of its ends, where the blur mixes it with what lies beside; twice the blur's
        standard deviation where not given.
    gap_um : float
        A gap in the coating that is shorter does not end the layer.
    coat_weight_from : {"thickness", "attenuation"}
        Thickness times density, or the grey that the coating adds to the base's: the second does not care about blur.
    envelope_radius_um : float
        Of the ball that rolls over both faces.
    s_filter_um, l_filter_um : float
        Cut-offs of the topography's filters.
    density_support_um : float
        Full width at half maximum of the Gaussian that grammage and thickness are averaged with before one is divided
        by the other.
    pore_limit_um : float
        Largest pore that is told from a larger one.
    orientation_sigma_um : float or None
        Scale of the gradients; one voxel where not given.
    orientation_rho_um : float
        Scale over which directions are gathered: one or two fibre widths.
    """

    densities: Densities = field(default_factory=Densities)
    void_grey: float | None = None
    solid_grey: float | None = None
    filler_grey: float | None = None
    ink_grey: tuple[float, float] | None = None
    ink_reach_um: float | None = None
    edge_um: float | None = None
    gap_um: float = 6.0
    coat_weight_from: Literal["thickness", "attenuation"] = "thickness"
    envelope_radius_um: float = 250.0
    s_filter_um: float = 5.0
    l_filter_um: float = 800.0
    density_support_um: float = 100.0
    pore_limit_um: float = 40.0
    orientation_sigma_um: float | None = None
    orientation_rho_um: float = 40.0

    def __post_init__(self) -> None:
        """Refuse lengths that are none."""
        for name, value in asdict(self).items():
            if name.endswith("_um") and value is not None:
                least = 0.0 if name in ("edge_um", "gap_um") else 1e-9
                if not least <= value < 1e6:
                    raise CannotMeasure(f"{name} is {value:g} um; it must be a positive length. Correct it.")
        if self.ink_grey is not None and not self.ink_grey[0] < self.ink_grey[1]:
            raise CannotMeasure(
                f"ink_grey runs from {self.ink_grey[0]:g} to {self.ink_grey[1]:g}; the first must be the smaller one."
            )
