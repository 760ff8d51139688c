"""Porosity of the base: the share of void on the ray between the interfaces, and its profile through the depth."""

from __future__ import annotations

import numpy as np

from planish.core.errors import CannotMeasure
from planish.measure.greys import Greys
from planish.measure.options import RayOptions
from planish.measure.rays import Array, Rays
from planish.measure.registry import Measured, ray_property


def void_level(greys: Greys, options: RayOptions) -> float:
    """Level between void and solid: given, or half way between air and base (or solid, where that is given)."""
    if options.void_grey is not None:
        return options.void_grey
    return 0.5 * (greys.air + (greys.base if options.solid_grey is None else options.solid_grey))


def _solid(options: RayOptions, greys: Greys) -> None:
    if options.solid_grey is not None and not (options.solid_grey - greys.base) * greys.polarity > 0:
        raise CannotMeasure(
            f"solid_grey is {options.solid_grey:g}, the base's mean grey {greys.base:.4g} and the air's "
            f"{greys.air:.4g}: a solid without voids lies beyond the base. Correct solid_grey."
        )


@ray_property("porosity", units="1", long_name="Porosity of the base", check=_solid)
def porosity(rays: Rays) -> Measured:
    """P-10: share of void on the ray inside the base, its blurred edges (``edge_um``) left out.

    With ``solid_grey``: 1 - mean grey above the air / (solid - air). It sees pores smaller than a voxel and is not
    biased by noise. SE: sqrt(noise / L) / (solid - air), L the length on the ray. Without: the share beyond
    ``void_grey``; pores below two voxels are lost, and noise makes voids where the base is faint. SE:
    sqrt(n) sqrt(2 pi) w sigma / (base - air) / L with n ends of voids, each as uncertain as one crossing.
    """
    return share_of_void(rays, *rays.core)


def share_of_void(rays: Rays, lower: Array, upper: Array) -> Measured:
    """Porosity between any two places of each ray; NaN where they are less than a step apart."""
    greys, solid = rays.greys, rays.options.solid_grey
    length = upper - lower
    long = length >= rays.step_um
    with np.errstate(divide="ignore", invalid="ignore"):
        if solid is not None:
            contrast = solid - greys.air
            values = 1 - rays.integral(lower, upper) / length / contrast
            se = rays.integral_se(length) / length / abs(contrast)
        else:
            matter, ends = rays.beyond(lower, upper, void_level(greys, rays.options))
            values = 1 - matter / length
            se = np.sqrt(np.maximum(ends, 1)) * rays.crossing_se(greys.base - greys.air) / length
    return Measured(values=np.where(long, values, np.nan), se=np.where(long, se, np.nan))
