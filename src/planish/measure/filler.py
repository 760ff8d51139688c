"""Bright filler in the base: its share on the ray, and its mass (P-11)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planish.core.errors import CannotMeasure
from planish.core.options import Params, option
from planish.measure.registry import Measured, Sheet, ray_property, sheet_property

if TYPE_CHECKING:
    from planish.measure.greys import Greys
    from planish.measure.params import MeasureParams
    from planish.measure.rays import Array, Rays


class Options(Params):
    """Options of the filler."""

    filler_grey: float | None = option(
        None, cli=None, help="Level between fibres and filler; half way between base and coating where not given."
    )


def filler_level(greys: Greys, params: MeasureParams) -> float:
    """Level between fibres and filler.

    Raises
    ------
    CannotMeasure
        If it was not given and there is no coating to tell it from.
    """
    if params.filler_grey is not None:
        return params.filler_grey
    coats = [level for level in (greys.coating_top, greys.coating_bottom) if np.isfinite(level)]
    if not coats:
        raise CannotMeasure(
            "Filler needs the grey level from which on the base counts as filler; without a coating there is none to "
            "tell it from. Give filler_grey in [properties]."
        )
    return 0.5 * (greys.base + float(np.mean(coats)))


def _check(params: MeasureParams, greys: Greys) -> None:
    filler_level(greys, params)


@ray_property("filler", units="1", long_name="Filler in the base", check=_check,
              when=lambda params, _greys: params.filler_grey is not None)  # fmt: skip
def filler(rays: Rays) -> Measured:
    """P-11: share of bright matter on the ray inside the base.

    The base's edges (``edge_um``) are left out, and what is bright from there on without a gap: that is coating which
    has run in. Grains smaller than a voxel are faint and are lost. SE: sqrt(n) sqrt(2 pi) w sigma / (level - base) / L
    with n ends of grains.
    """
    return share_of_filler(rays, *rays.core, drop_run_in=True)


def share_of_filler(rays: Rays, lower: Array, upper: Array, *, drop_run_in: bool = False) -> Measured:
    """Share of filler between any two places of each ray."""
    greys = rays.greys
    level = filler_level(greys, rays.params)
    if drop_run_in:
        lower, upper = _inside(rays, lower, upper, level)
    bright, ends = rays.beyond(lower, upper, level)
    length = upper - lower
    long = length >= rays.step_um
    with np.errstate(divide="ignore", invalid="ignore"):
        se = np.sqrt(np.maximum(ends, 1)) * rays.crossing_se(2 * (level - greys.base)) / length
        return Measured(values=np.where(long, bright / length, np.nan), se=np.where(long, se, np.nan))


def _inside(rays: Rays, lower: Array, upper: Array, level: float) -> tuple[Array, Array]:
    """Both ends moved inwards past what is bright there without a gap."""
    beyond = rays.greys.polarity * (rays.grey - np.float32(level)) > 0
    within = rays.between(lower, upper)
    dark = within & ~beyond
    some = dark.any(axis=-1)
    first, last = np.argmax(dark, axis=-1), dark.shape[-1] - 1 - np.argmax(dark[..., ::-1], axis=-1)
    # An end that is dark already stays where it is, between two samples.
    start = np.where(np.argmax(within, axis=-1) == first, lower, rays.s_um[first])
    stop = np.where(dark.shape[-1] - 1 - np.argmax(within[..., ::-1], axis=-1) == last, upper, rays.s_um[last])
    return np.where(some, start, lower), np.where(some, stop, lower)


def _density(params: MeasureParams, greys: Greys) -> None:
    params.need("Filler", "filler_g_cm3")
    filler_level(greys, params)


@sheet_property(
    "filler_weight", units="g/m2", long_name="Filler", check=_density, after=("filler", "base_thickness"),
)  # fmt: skip
def filler_weight(sheet: Sheet) -> Measured:
    """P-11 as a mass: share of filler times base thickness times the filler's density; SE: the share's, likewise."""
    density = sheet.params.need("Filler", "filler_g_cm3")
    share, base = sheet.maps["filler"], sheet.maps["base_thickness"].values
    assert share.se is not None
    return Measured(values=share.values * base * density, se=share.se * base * density)
