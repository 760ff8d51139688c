"""Porosity of the base: the share of void on the ray between the interfaces, and its profile through the depth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planish.core.errors import CannotMeasure
from planish.core.options import Params, option
from planish.measure.registry import Measured, ray_property

if TYPE_CHECKING:
    from planish.measure.greys import Greys
    from planish.measure.params import MeasureParams
    from planish.measure.rays import Array, Rays


class Options(Params):
    """Options of the porosity."""

    solid_grey: float | None = option(
        None,
        help="Grey of fibre wall without voids: porosity is then what the mean grey lacks to it, which sees pores too "
        "small to be resolved.",
    )  # fmt: skip
    void_grey: float | None = option(
        None, cli=None, help="Level between void and solid; half way between air and base where not given."
    )


def void_level(greys: Greys, params: MeasureParams) -> float:
    """Level between void and solid: given, or half way between air and base (or solid, where that is given)."""
    if params.void_grey is not None:
        return params.void_grey
    return 0.5 * (greys.air + (greys.base if params.solid_grey is None else params.solid_grey))


def _solid(params: MeasureParams, greys: Greys) -> None:
    if params.solid_grey is not None and not (params.solid_grey - greys.base) * greys.polarity > 0:
        raise CannotMeasure(
            f"solid_grey is {params.solid_grey:g}, the base's mean grey {greys.base:.4g} and the air's "
            f"{greys.air:.4g}: a solid without voids lies beyond the base. Correct solid_grey."
        )


@ray_property("porosity", units="1", long_name="Porosity of the base", check=_solid,
              when=lambda params, _greys: params.solid_grey is not None or params.void_grey is not None)  # fmt: skip
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
    greys, solid = rays.greys, rays.params.solid_grey
    length = upper - lower
    long = length >= rays.step_um
    with np.errstate(divide="ignore", invalid="ignore"):
        if solid is not None:
            contrast = solid - greys.air
            values = 1 - rays.integral(lower, upper) / length / contrast
            se = rays.integral_se(length) / length / abs(contrast)
        else:
            matter, ends = rays.beyond(lower, upper, void_level(greys, rays.params))
            values = 1 - matter / length
            se = np.sqrt(np.maximum(ends, 1)) * rays.crossing_se(greys.base - greys.air) / length
    return Measured(values=np.where(long, values, np.nan), se=np.where(long, se, np.nan))
