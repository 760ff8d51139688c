"""Thicknesses: the fitted ones with their standard errors, the coating read from the ray itself, and envelopes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planish.core.options import Params, option
from planish.core.typing import Floats
from planish.measure.registry import PROPERTIES, SIDES, Measured, Sheet, Side, ray_property, sheet_property

if TYPE_CHECKING:
    from planish.measure.greys import Greys
    from planish.measure.params import MeasureParams
    from planish.measure.rays import Rays


class Options(Params):
    """Options of thicknesses along the ray and between envelopes."""

    gap_um: float = option(6.0, ge=0, cli=None, help="A gap in the coating that is shorter does not end the layer.")
    envelope_radius_um: float = option(
        250.0, gt=0, cli=None, help="Radius of the ball that rolls over both faces, for thickness_envelope."
    )


def errors(sheet: Sheet, name: str) -> Floats:
    """Standard errors of a thickness along the sheet's rays."""
    from planish.measure.uncertainty import thickness_errors

    f = sheet.frame
    slope = f.slopes()
    # A vertical distance is longer than a normal one, and so is its error.
    oblique = f.oblique(slope)
    layers: dict[Side, Floats] = {k: np.abs(f.faces[k] - f.faces[f"interface_{k}"]) / oblique for k in SIDES}
    cosine = 1 / np.sqrt(1 + np.sum(slope**2, axis=-1))
    return thickness_errors(layers, f.greys, f.shared, cosine=cosine)[name] * oblique


def _has_coating(_params: MeasureParams, greys: Greys, side: Side) -> None:
    greys.need_coating(side, f"Coating thickness, {side} side,")


@sheet_property("coating_{side}", units="um", long_name=PROPERTIES["coating_top"].replace("top", "{side}"))
def coating(sheet: Sheet, side: Side) -> Measured:
    """P-01: face to interface; 0 is possible. SE from the Fisher matrix of the fitted staircase (thickness_errors)."""
    f = sheet.frame
    if not f.greys.coated(side):
        return Measured(values=np.full(f.status.shape, np.nan))
    outwards = 1.0 if side == "top" else -1.0
    return Measured(
        values=outwards * (f.faces[side] - f.faces[f"interface_{side}"]), se=errors(sheet, f"coating_{side}")
    )


def _needs_both_coatings(_params: MeasureParams, greys: Greys) -> None:
    for side in SIDES:
        greys.need_coating(side, "The difference of both coatings")


def difference(sheet: Sheet, name: str) -> Measured:
    """Top less bottom of a property; SE: the root of the summed squares of both."""
    top, bottom = (sheet.maps[f"{name}_{side}"] for side in SIDES)
    return Measured(values=top.values - bottom.values, se=np.hypot(top.se, bottom.se))


@sheet_property("coating_difference", units="um", long_name="Coating, top less bottom", check=_needs_both_coatings,
                after=("coating_top", "coating_bottom"))  # fmt: skip
def coating_difference(sheet: Sheet) -> Measured:
    """P-14: t_T - t_B on the same ray; SE: the root of the summed squares of both."""
    return difference(sheet, "coating")


@sheet_property("base_thickness", units="um", long_name=PROPERTIES["base_thickness"])
def base_thickness(sheet: Sheet) -> Measured:
    """P-04: s_TI - s_BI; SE: the root of the summed squares of both interfaces'."""
    f = sheet.frame
    se = errors(sheet, "base_thickness")
    return Measured(values=f.faces["interface_top"] - f.faces["interface_bottom"], se=se)


@sheet_property("thickness", units="um", long_name=PROPERTIES["thickness"])
def thickness(sheet: Sheet) -> Measured:
    """P-05: s_T - s_B; SE: the root of the summed squares of both faces'."""
    f = sheet.frame
    return Measured(values=f.faces["top"] - f.faces["bottom"], se=errors(sheet, "thickness"))


@sheet_property(
    "thickness_envelope", units="um", long_name="Sheet thickness between rolling balls",
    support_um=lambda params: 2 * params.envelope_radius_um,
)  # fmt: skip
def thickness_envelope(sheet: Sheet) -> Measured:
    """P-05 with envelopes: a ball of ``envelope_radius_um`` rolls over either face and bridges what it cannot enter.

    The ball is taken as the paraboloid x^2 / (2 R), which it is to H / (2 R) of its height at a depth H; the places of
    the faces on the rays are the height field. No standard error: an envelope rests on few points.
    """
    from planish.core._envelope_kernels import rolled

    f = sheet.frame
    faces = (np.where(sheet.valid, face, np.nan) for face in (f.faces["top"], -f.faces["bottom"]))
    top, bottom = (rolled(face, f.pitch_um, f.params.envelope_radius_um) for face in faces)
    return Measured(values=top + bottom)


def _layer(rays: Rays, side: Side) -> tuple[Floats, Floats, Floats]:
    """Return t_sum, t_env and the standard error of both of the coating of one side."""
    from planish.measure import _ray_kernels
    from planish.measure.uncertainty import layer_errors

    def work() -> tuple[Floats, Floats, Floats]:
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

    return rays.cached(f"layer_{side}", work)


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
