"""Coat weight: thickness times a density, or what the coating adds to the base's absorption."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from planish.core.errors import CannotMeasure
from planish.core.options import Params, option
from planish.measure.registry import Measured, Sheet, Side, ray_property, sheet_property

if TYPE_CHECKING:
    from planish.measure.greys import Greys
    from planish.measure.params import MeasureParams
    from planish.measure.rays import Rays

_BEYOND = 3.0  # blurs outside the face and inside the interface: 99.9 % of the light of a step


class Options(Params):
    """Options of the coat weight."""

    coat_weight_from: Literal["thickness", "attenuation"] = option(
        "thickness", cli=None,
        help="Thickness times density, or the grey that the coating adds to the base's: the second ignores the blur.",
    )  # fmt: skip


def _absorbs(_params: MeasureParams, greys: Greys, side: Side) -> None:
    greys.need_coating(side, f"Coating by absorption, {side} side,")
    greys.need_absorption(f"Coating by absorption, {side} side,")


def excess(rays: Rays, side: Side) -> Measured:
    """Thickness of a layer of the coating's own grey that absorbs as much as this one, um.

    The integral of the grey above the base's level, from three blurs outside the face to three blurs inside the
    interface, over the contrast between coating and base; outside the face the air's level takes the base's place. A
    blur moves grey along the ray but does not change its integral, so that thin layers count in full.

    SE: sqrt(noise * L + ((base - air) SE_face)^2) / (coating - base), L the length of the integral.
    """
    from planish.measure.uncertainty import layer_errors

    greys = rays.greys
    out = _BEYOND * greys.blur_um * rays.oblique
    coat, base = greys.coating(side) - greys.air, greys.base - greys.air
    if side == "top":
        lower, upper = rays.interface_top - out, rays.top + out
        under = rays.top - lower
    else:
        lower, upper = rays.bottom - out, rays.interface_bottom + out
        under = upper - rays.bottom
    integral = rays.integral(lower, upper) - base * under
    face = rays.oblique * layer_errors((under - out) / rays.oblique, greys, rays.noise_um, side)[0]
    se = np.hypot(rays.integral_se(upper - lower), base * face) / abs(coat - base)
    return Measured(values=integral / (coat - base), se=se)


@ray_property("coating_absorption_{side}", units="um", long_name="Coating by absorption, {side} side", check=_absorbs)
def coating_absorption(rays: Rays, side: Side) -> Measured:
    """P-02, what does not care about blur; see :func:`excess`."""
    return excess(rays, side)


def _given(params: MeasureParams, greys: Greys, side: Side) -> bool:
    return greys.coated(side) and bool(params.coating_g_cm3 or params.get(f"coat_weight_{side}_g_m2"))


def _check(params: MeasureParams, greys: Greys, side: Side) -> None:
    greys.need_coating(side, f"Coat weight, {side} side,")
    params.need(f"Coat weight, {side} side,", f"coat_weight_{side}_g_m2", "coating_g_cm3")
    if params.coat_weight_from == "attenuation":
        greys.need_absorption(f"Coat weight, {side} side,")


def _layer(params: MeasureParams, _greys: Greys, side: Side) -> tuple[str, ...]:
    return (f"coating_{side}" if params.coat_weight_from == "thickness" else f"coating_absorption_{side}",)


@sheet_property(
    "coat_weight_{side}", units="g/m2", long_name="Coat weight, {side} side", check=_check, after=_layer, when=_given
)
def coat_weight(sheet: Sheet, side: Side) -> Measured:
    """P-02: w = w_mean t / t_mean where the coat weight was weighed, rho t where the density is known (A-23).

    SE: the layer's, times the same factor; the error of the density or of the weighing is common to the whole map and
    not part of it.
    """
    layer = sheet.maps[_layer(sheet.params, sheet.frame.greys, side)[0]]
    weighed = sheet.params.get(f"coat_weight_{side}_g_m2")
    if weighed is None:
        return layer.times(sheet.params.need("Coat weight", "coating_g_cm3"))
    mean = sheet.mean(layer.values)
    if not mean > 0:
        raise CannotMeasure(
            f"The mean coating is {mean:.3g} um thick; a weighed {weighed:g} g/m2 cannot be spread over it. Check "
            "the side, and the surfaces in the report."
        )
    return layer.times(weighed / mean)
