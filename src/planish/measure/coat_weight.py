"""Coat weight: thickness times a density, or what the coating adds to the base's absorption."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import CannotMeasure
from planish.measure.greys import Greys
from planish.measure.options import RayOptions
from planish.measure.rays import Rays
from planish.measure.registry import Measured, Sheet, ray_property, sheet_property
from planish.measure.uncertainty import layer_errors

Side = Literal["top", "bottom"]
_BEYOND = 3.0  # blurs outside the face and inside the interface: 99.9 % of the light of a step


def _density(side: Side) -> Callable[[RayOptions, Greys], None]:
    def check(options: RayOptions, greys: Greys) -> None:
        greys.need_coating(side, f"Coat weight, {side} side,")
        options.densities.need(f"Coat weight, {side} side,", f"coat_weight_{side}_g_m2", "coating_g_cm3")
        if options.coat_weight_from == "attenuation":
            greys.need_absorption(f"Coat weight, {side} side,")

    return check


def _absorbing(side: Side) -> Callable[[RayOptions, Greys], None]:
    def check(_options: RayOptions, greys: Greys) -> None:
        greys.need_coating(side, f"Coating by absorption, {side} side,")
        greys.need_absorption(f"Coating by absorption, {side} side,")

    return check


def excess(rays: Rays, side: Side) -> Measured:
    """Thickness of a layer of the coating's own grey that absorbs as much as this one, um.

    The integral of the grey above the base's level, from three blurs outside the face to three blurs inside the
    interface, over the contrast between coating and base; outside the face the air's level takes the base's place. A
    blur moves grey along the ray but does not change its integral, so that thin layers count in full.

    SE: sqrt(noise * L + ((base - air) SE_face)^2) / (coating - base), L the length of the integral.
    """
    greys = rays.greys
    out = _BEYOND * greys.blur_um * rays.lean
    coat, base = greys.coating(side) - greys.air, greys.base - greys.air
    if side == "top":
        lower, upper = rays.interface_top - out, rays.top + out
        under = rays.top - lower
    else:
        lower, upper = rays.bottom - out, rays.interface_bottom + out
        under = upper - rays.bottom
    integral = rays.integral(lower, upper) - base * under
    face = rays.lean * layer_errors((under - out) / rays.lean, greys, rays.noise_um, side)[0]
    se = np.hypot(rays.integral_se(upper - lower), base * face) / abs(coat - base)
    return Measured(values=integral / (coat - base), se=se)


@ray_property("coating_absorption_top", units="um", long_name="Coating by absorption, top side",
              check=_absorbing("top"))  # fmt: skip
def coating_absorption_top(rays: Rays) -> Measured:
    """P-02, what does not care about blur; see :func:`excess`."""
    return excess(rays, "top")


@ray_property("coating_absorption_bottom", units="um", long_name="Coating by absorption, bottom side",
              check=_absorbing("bottom"))  # fmt: skip
def coating_absorption_bottom(rays: Rays) -> Measured:
    """P-02, bottom side."""
    return excess(rays, "bottom")


def scaled(layer: Measured, valid: NDArray[np.bool_], density: float | None, weighed: float | None) -> Measured:
    """Mass in g/m2 of layers in um: density times thickness, or scaled so that the mean is the weighed one.

    SE: the layer's, times the same factor; the error of the density or of the weighing is common to the whole map and
    not part of it.
    """
    if weighed is not None:
        mean = float(np.mean(layer.values[valid & np.isfinite(layer.values)], dtype=np.float64))
        if not mean > 0:
            raise CannotMeasure(
                f"The mean coating is {mean:.3g} um thick; a weighed {weighed:g} g/m2 cannot be spread over it. Check "
                "the side, and the surfaces in the report."
            )
        factor = weighed / mean
    else:
        assert density is not None, "checked before anything was read"
        factor = density
    return Measured(values=layer.values * factor, se=None if layer.se is None else layer.se * abs(factor))


def _weight(sheet: Sheet, side: Side) -> Measured:
    options = sheet.frame.options
    layer = sheet.maps[f"coating_{side}" if options.coat_weight_from == "thickness" else f"coating_absorption_{side}"]
    known = options.densities
    return scaled(layer, sheet.valid, known.coating_g_cm3, known.get(f"coat_weight_{side}_g_m2"))


def _layer_of(side: Side) -> Callable[[RayOptions, Greys], tuple[str, ...]]:
    def names(options: RayOptions, _greys: Greys) -> tuple[str, ...]:
        return (f"coating_{side}" if options.coat_weight_from == "thickness" else f"coating_absorption_{side}",)

    return names


@sheet_property("coat_weight_top", units="g/m2", long_name="Coat weight, top side", check=_density("top"),
                after=_layer_of("top"))  # fmt: skip
def coat_weight_top(sheet: Sheet) -> Measured:
    """P-02: w = w_mean t / t_mean where the coat weight was weighed, rho t where the density is known (A-23)."""
    return _weight(sheet, "top")


@sheet_property("coat_weight_bottom", units="g/m2", long_name="Coat weight, bottom side", check=_density("bottom"),
                after=_layer_of("bottom"))  # fmt: skip
def coat_weight_bottom(sheet: Sheet) -> Measured:
    """P-02, bottom side."""
    return _weight(sheet, "bottom")
