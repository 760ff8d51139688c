"""Void and filler in the base: their share on the ray between the interfaces, and their mass."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planish.core.errors import CannotMeasure
from planish.core.options import Params, option
from planish.core.typing import Floats
from planish.measure.greys import Greys
from planish.measure.masses import Densities
from planish.measure.options import Common
from planish.measure.registry import SIDES, Measured, Sheet, ray_property, sheet_property

if TYPE_CHECKING:
    from planish.measure.rays import Rays


class Options(Params):
    """Options of porosity and filler."""

    solid_grey: float | None = option(
        None,
        help=(
            "Grey of fibre wall without voids: porosity is then what the mean grey lacks to it,"
            " which sees pores too small to be resolved."
        ),
    )
    void_grey: float | None = option(
        None,
        cli=None,
        help="Level between void and solid; half way between air and base where not given.",
    )
    filler_grey: float | None = option(
        None,
        cli=None,
        help="Level between fibres and filler; half way between base and coating where not given.",
    )


LEVELS = ("solid_grey", "void_grey")
"""Options that tell voids from walls; maps of voids state them."""


def void_level(greys: Greys, params: Options) -> float:
    """Give the level between void and solid.

    It is given, or half way between air and base (or solid, where that is given).
    """
    if params.void_grey is not None:
        return params.void_grey
    matter = greys.base if params.solid_grey is None else params.solid_grey
    return 0.5 * (greys.air + matter)


def _solid(params: Options, greys: Greys) -> None:
    if params.solid_grey is None:
        return
    if not (params.solid_grey - greys.base) * greys.polarity > 0:
        raise CannotMeasure(
            f"solid_grey is {params.solid_grey:g}, the base's mean grey {greys.base:.4g} and the"
            f" air's {greys.air:.4g}: a solid without voids lies beyond the base. Correct"
            " solid_grey."
        )


@ray_property(
    "porosity",
    units="1",
    long_name="Porosity of the base",
    check=_solid,
    stated=LEVELS,
    when=lambda params, _greys: params.solid_grey is not None or params.void_grey is not None,
)
def porosity(rays: Rays) -> Measured:
    """P-10: share of void on the ray inside the base, its blurred edges (``edge_um``) left out.

    With ``solid_grey``: 1 - mean grey above the air / (solid - air). It sees pores smaller than a
    voxel and is not biased by noise. SE: sqrt(noise / L) / (solid - air), L the length on the ray.
    Without: the share beyond ``void_grey``; pores below two voxels are lost, and noise makes voids
    where the base is faint. SE: sqrt(n) sqrt(2 pi) w sigma / (base - air) / L with n ends of voids,
    each as uncertain as one crossing. A level that no wall's grey stands behind makes it doubtful.
    """
    return share_of_void(rays, *rays.core)


def share_of_void(rays: Rays, lower: Floats, upper: Floats) -> Measured:
    """Share of void on each ray between two places (rows, cols), um from the centre surface.

    NaN where they are less than a step apart. :func:`porosity` explains both ways.
    """
    greys = rays.greys
    options = rays.params.of(Options)
    if options.solid_grey is None:
        level = void_level(greys, options)
        matter = _share_beyond(rays, lower, upper, level, greys.base - greys.air)
        return Measured(values=1 - matter.values, se=matter.se)
    length = rays.span(lower, upper)
    contrast = options.solid_grey - greys.air
    solid_share = rays.integral(lower, upper) / length / contrast
    se = rays.integral_se(length) / length / abs(contrast)
    return Measured(values=1 - solid_share, se=se)


def _share_beyond(
    rays: Rays, lower: Floats, upper: Floats, level: float, contrast: float
) -> Measured:
    """Share of what lies beyond a level between two places of each ray (rows, cols), um.

    NaN where they are less than a step apart. ``contrast``: step of grey at an end of such a
    piece, which says how sure the end is.
    """
    beyond, ends = rays.beyond(lower, upper, level)
    length = rays.span(lower, upper)
    return Measured(values=beyond / length, se=rays.crossings_se(ends, contrast) / length)


def filler_level(params: Common, greys: Greys) -> float:
    """Level between fibres and filler.

    CannotMeasure where there is neither one nor a coating to tell it from.
    """
    filler_grey = params.of(Options).filler_grey
    if filler_grey is not None:
        return filler_grey
    coats = [greys.coating(side) for side in SIDES if greys.coated(side)]
    if not coats:
        raise CannotMeasure(
            "Filler needs the grey level from which on the base counts as filler: there is no"
            " coating to tell it from. Give filler_grey in [properties] of a study file."
        )
    return 0.5 * (greys.base + float(np.mean(coats)))


@ray_property(
    "filler",
    units="1",
    long_name="Filler in the base",
    check=filler_level,
    stated=("filler_grey",),
    when=lambda params, _greys: params.filler_grey is not None,
)
def filler(rays: Rays) -> Measured:
    """P-11: share of bright matter on the ray inside the base.

    The base's edges (``edge_um``) are left out, and what is bright from there on without a gap:
    that is coating which has run in. Grains smaller than a voxel are faint and are lost. SE:
    sqrt(n) sqrt(2 pi) w sigma / (2 (level - base)) / L with n ends of grains: a grain's step is
    taken to be twice that from the base to the level.
    """
    from planish.core.grid import first_and_last

    lower, upper = rays.core
    level = np.float32(filler_level(rays.params, rays.greys))
    is_within = rays.between(lower, upper)
    is_bright = rays.greys.polarity * (rays.grey - level) > 0
    is_dark = is_within & ~is_bright
    first_within, last_within = first_and_last(is_within)
    first_dark, last_dark = first_and_last(is_dark)
    # An end that is dark already, or a ray that is bright throughout, stays as it is, between two
    # samples.
    has_dark = is_dark.any(axis=-1)
    starts_bright = has_dark & (first_within != first_dark)
    stops_bright = has_dark & (last_within != last_dark)
    start = np.where(starts_bright, rays.s_um[first_dark], lower)
    stop = np.where(stops_bright, rays.s_um[last_dark], upper)
    return share_of_filler(rays, start, stop)


def share_of_filler(rays: Rays, lower: Floats, upper: Floats) -> Measured:
    """Share of bright matter on each ray between two places (rows, cols)."""
    level = filler_level(rays.params, rays.greys)
    return _share_beyond(rays, lower, upper, level, 2 * (level - rays.greys.base))


def _weighable(params: Common, greys: Greys) -> None:
    params.of(Densities).need("Filler", "filler_g_cm3")
    filler_level(params, greys)


@sheet_property(
    "filler_weight",
    units="g/m2",
    long_name="Filler",
    check=_weighable,
    after=("filler", "base_thickness"),
)
def filler_weight(sheet: Sheet) -> Measured:
    """P-11: share of filler times base thickness times the filler's density.

    SE: the share's, likewise.
    """
    density = sheet.params.of(Densities).need("Filler", "filler_g_cm3")
    mass = sheet.maps["base_thickness"].values * density
    share = sheet.maps["filler"]
    return Measured(values=share.values * mass, se=share.se * mass)
