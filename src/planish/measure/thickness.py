"""Thicknesses: the fitted ones with their standard errors, the coating read from the ray itself, and envelopes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planish.core.errors import CannotMeasure
from planish.core.options import Params, option
from planish.measure.faces import PROPERTIES
from planish.measure.registry import Measured, Sheet, Side, ray_property, sheet_property

if TYPE_CHECKING:
    from planish.measure.greys import Greys
    from planish.measure.params import MeasureParams
    from planish.measure.rays import Array, Rays


class Options(Params):
    """Options of thicknesses along the ray and between envelopes."""

    gap_um: float = option(6.0, ge=0, cli=None, help="A gap in the coating that is shorter does not end the layer.")
    envelope_radius_um: float = option(
        250.0, gt=0, cli=None, help="Radius of the ball that rolls over both faces, for thickness_envelope."
    )


def errors(sheet: Sheet, side: Side) -> tuple[Array, Array, Array]:
    """Standard errors of the face, the coating and the interface of one side, along the sheet's rays."""
    from planish.measure.rays import oblique_factor
    from planish.measure.uncertainty import layer_errors

    f = sheet.frame
    layer = np.abs(f.faces[side] - f.faces[f"interface_{side}"])
    # A vertical distance is longer than a normal one, and so is its error.
    oblique = oblique_factor(f.slopes(slice(0, f.status.shape[0])), f.params.rays)
    found = layer_errors(layer / oblique, f.greys, sheet.noise_um, side)
    return found[0] * oblique, found[1] * oblique, found[2] * oblique


def _has_coating(_params: MeasureParams, greys: Greys, side: Side) -> None:
    greys.need_coating(side, f"Coating thickness, {side} side,")


@sheet_property("coating_{side}", units="um", long_name=PROPERTIES["coating_top"].replace("top", "{side}"))
def coating(sheet: Sheet, side: Side) -> Measured:
    """P-01: face to interface; 0 is possible. SE from the Fisher matrix of the fitted staircase (layer_errors)."""
    f = sheet.frame
    if not f.greys.coated(side):
        return Measured(values=np.full(f.status.shape, np.nan))
    outwards = 1.0 if side == "top" else -1.0
    return Measured(values=outwards * (f.faces[side] - f.faces[f"interface_{side}"]), se=errors(sheet, side)[1])


@sheet_property("base_thickness", units="um", long_name=PROPERTIES["base_thickness"])
def base_thickness(sheet: Sheet) -> Measured:
    """P-04: s_TI - s_BI; SE: the root of the summed squares of both interfaces'."""
    f = sheet.frame
    se = np.hypot(errors(sheet, "top")[2], errors(sheet, "bottom")[2])
    return Measured(values=f.faces["interface_top"] - f.faces["interface_bottom"], se=se)


@sheet_property("thickness", units="um", long_name=PROPERTIES["thickness"])
def thickness(sheet: Sheet) -> Measured:
    """P-05: s_T - s_B; SE: the root of the summed squares of both faces'."""
    f = sheet.frame
    se = np.hypot(errors(sheet, "top")[0], errors(sheet, "bottom")[0])
    return Measured(values=f.faces["top"] - f.faces["bottom"], se=se)


@sheet_property(
    "thickness_envelope", units="um", long_name="Sheet thickness between rolling balls",
    support_um=lambda params: 2 * params.envelope_radius_um,
)  # fmt: skip
def thickness_envelope(sheet: Sheet) -> Measured:
    """P-05 with envelopes: a ball of ``envelope_radius_um`` rolls over either face and bridges what it cannot enter.

    The ball is taken as the paraboloid x^2 / (2 R), which it is to H / (2 R) of its height at a depth H; the places of
    the faces on the rays are the height field. No standard error: an envelope rests on few points.
    """
    f = sheet.frame
    top = envelope(np.where(sheet.valid, f.faces["top"], np.nan), f.pitch_um, f.params.envelope_radius_um)
    bottom = envelope(np.where(sheet.valid, -f.faces["bottom"], np.nan), f.pitch_um, f.params.envelope_radius_um)
    return Measured(values=top + bottom)


def envelope(height: Array, pitch_um: tuple[float, float], radius_um: float) -> Array:
    """Closing of a height field by a paraboloid: the lowest a ball can come from above.

    Parameters
    ----------
    height : (rows, cols)
        um, outwards; NaN where unknown: the ball may dip there.
    pitch_um : (float, float)
    radius_um : float

    Returns
    -------
    (rows, cols)
        um; NaN where ``height`` is.
    """
    from planish.measure import _envelope_kernels

    if not np.isfinite(height).any():
        raise CannotMeasure("An envelope needs a face, and none is known. Look at the surfaces in the report.")
    rises = tuple(p * p / (2 * radius_um) for p in pitch_um)
    dilated = -_envelope_kernels.lowest(np.where(np.isfinite(height), -height, np.inf), *rises)
    return np.where(np.isfinite(height), _envelope_kernels.lowest(dilated, *rises), np.nan)


def _layer(rays: Rays, side: Side) -> tuple[Array, Array, Array]:
    """Return t_sum, t_env and the standard error of both of the coating of one side."""
    from planish.measure import _ray_kernels
    from planish.measure.uncertainty import layer_errors

    def work() -> tuple[Array, Array, Array]:
        greys = rays.greys
        coat = greys.coating(side)
        face, other = (rays.top, rays.interface_bottom) if side == "top" else (rays.bottom, rays.interface_top)
        summed, outer, ends = _ray_kernels.layers(
            rays.grey, float(rays.s_um[0]), rays.step_um, face, -1.0 if side == "top" else 1.0,
            0.5 * (coat + greys.base), greys.polarity, rays.oblique * (2.5 * greys.blur_um + rays.voxel_um),
            rays.params.gap_um, other,
        )  # fmt: skip
        of_face = rays.oblique * layer_errors(outer / rays.oblique, greys, rays.noise_um, side)[0]
        se = np.hypot(of_face, np.sqrt(np.maximum(ends, 1)) * rays.crossing_se(coat - greys.base))
        return summed, outer, se

    return rays.once(f"layer_{side}", work)


@ray_property("coating_{side}_sum", units="um", long_name="Coating on the ray, {side} side", check=_has_coating)
def coating_sum(rays: Rays, side: Side) -> Measured:
    """P-01 by labels (A-16): summed length of coating in the outermost connected layer.

    Coating is what lies beyond half way between base and coating. The layer begins at the fitted face, whose blurred
    flank counts, and ends at the first gap longer than ``gap_um``. The half-way rule makes a layer thinner than two
    blurs too thin or loses it; ``coating_top`` does not. SE: sqrt(SE_face^2 + n (sqrt(2 pi) w sigma / C)^2), n ends of
    the layer inside, w blur, sigma noise, C contrast between coating and base.
    """
    summed, _, se = _layer(rays, side)
    return Measured(values=summed, se=se)


@ray_property("coating_{side}_envelope", units="um", long_name="Coating with its gaps, {side} side", check=_has_coating)
def coating_envelope(rays: Rays, side: Side) -> Measured:
    """t_env of A-16: from the face to the inner end of the same layer, gaps included; SE as :func:`coating_sum`."""
    _, outer, se = _layer(rays, side)
    return Measured(values=outer, se=se)
