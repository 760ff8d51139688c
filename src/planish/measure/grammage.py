"""Local grammage and apparent density: absorption along the ray, brought to grams by what the user weighed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planish.core.errors import CannotMeasure
from planish.core.options import Params, option
from planish.measure.coat_weight import excess
from planish.measure.registry import SIDES, Measured, Sheet, Side, ray_property, sheet_property
from planish.measure.topography import smoothed

if TYPE_CHECKING:
    from planish.measure.greys import Greys
    from planish.measure.params import MeasureParams
    from planish.measure.rays import Array, Rays

_BEYOND = 3.0  # blurs outside the faces
_FWHM = float(np.sqrt(8 * np.log(2.0)))


class Options(Params):
    """Options of the apparent density."""

    density_support_um: float = option(
        100.0, gt=0, cli=None,
        help="Full width at half maximum of the Gaussian that grammage and thickness are averaged with.",
    )  # fmt: skip


def _absorbs(_params: MeasureParams, greys: Greys) -> None:
    greys.need_absorption("Absorption of the sheet")


@ray_property("absorption", units="um", long_name="Absorption of the sheet", check=_absorbs)
def absorption(rays: Rays) -> Measured:
    """Length of base that absorbs as much as the whole ray: the integral above the air over base - air.

    From three blurs outside the one face to three outside the other. SE: sqrt(noise L) / (base - air).
    """
    out = _BEYOND * rays.greys.blur_um * rays.oblique
    contrast = rays.greys.base - rays.greys.air
    lower, upper = rays.bottom - out, rays.top + out
    return Measured(values=rays.integral(lower, upper) / contrast, se=rays.integral_se(upper - lower) / abs(contrast))


@ray_property("absorption_base", units="um", long_name="Absorption of the base", check=_absorbs)
def absorption_base(rays: Rays) -> Measured:
    """The same without what the coatings add to or take from the base's level.

    What the coated sides absorb is taken off as (coating's excess + base's level) over each layer; what remains is the
    base. SE: sqrt(noise L) / (base - air) and those of the layers, as independent.
    """
    greys = rays.greys
    base = greys.base - greys.air
    whole = absorption.function(rays)
    assert isinstance(whole, Measured)
    assert whole.se is not None
    values, variance = whole.values, whole.se**2
    layers: dict[Side, Array] = {
        "top": rays.top - rays.interface_top, "bottom": rays.interface_bottom - rays.bottom,
    }  # fmt: skip
    for side, thick in layers.items():
        if greys.coated(side):
            layer = excess(rays, side)
            assert layer.se is not None
            share = (greys.coating(side) - greys.air) / base - 1
            values = values - layer.values * share - thick
            variance = variance + (layer.se * share) ** 2
    return Measured(values=values, se=np.sqrt(variance))


def _check(d: MeasureParams, greys: Greys) -> None:
    greys.need_absorption("Grammage")
    if d.grammage_g_m2 is not None:
        return
    d.need("Grammage", "grammage_g_m2", "base_g_cm3")
    for side in SIDES:
        if greys.coated(side):
            d.need(f"Grammage with a coating on the {side} side", f"coat_weight_{side}_g_m2", "coating_g_cm3")


def _given(d: MeasureParams, greys: Greys) -> bool:
    coated = any(greys.coated(side) for side in SIDES)
    return d.grammage_g_m2 is not None or (d.base_g_cm3 is not None and (not coated or d.coating_g_cm3 is not None))


def _made_from(d: MeasureParams, greys: Greys) -> tuple[str, ...]:
    sides = [side for side in SIDES if greys.coated(side)]
    apart = all(d.coating_g_cm3 is not None or d.get(f"coat_weight_{side}_g_m2") is not None for side in sides)
    if not sides or (d.grammage_g_m2 is not None and not apart):
        return ("absorption",)
    return ("absorption_base", *(f"coating_absorption_{side}" for side in sides))


@sheet_property("grammage", units="g/m2", long_name="Grammage", check=_check, after=_made_from, when=_given)
def grammage(sheet: Sheet) -> Measured:
    """P-08: absorption along the ray, scaled so that its mean is the weighed grammage.

    Where coat weights or densities are known, each material is scaled on its own: coatings to their coat weight
    (or density), the base to what remains of the grammage (or to its density). Without them one factor serves both,
    although a coating absorbs more per gram than fibres do: local grammage then follows the coating too strongly.
    SE: each part's times its factor, as independent; the weighing's own error is not part of it.
    """
    d, greys, maps = sheet.params, sheet.frame.greys, sheet.maps
    if "absorption" in _made_from(d, greys):
        whole = maps["absorption"]
        if d.grammage_g_m2 is None:
            return whole.times(d.need("Grammage", "base_g_cm3"))
        return _to_mean(whole, sheet, d.grammage_g_m2)
    parts: list[Measured] = []
    coats = 0.0
    for side in SIDES:
        if not greys.coated(side):
            continue
        layer = maps[f"coating_absorption_{side}"]
        weighed = d.get(f"coat_weight_{side}_g_m2")
        if weighed is None:
            parts.append(layer.times(d.need(f"Grammage with a coating on the {side} side", "coating_g_cm3")))
        else:
            parts.append(_to_mean(layer, sheet, weighed))
        coats += sheet.mean(parts[-1].values)
    base = maps["absorption_base"]
    if d.grammage_g_m2 is None:
        parts.append(base.times(d.need("Grammage", "base_g_cm3")))
    elif d.grammage_g_m2 > coats:
        parts.append(_to_mean(base, sheet, d.grammage_g_m2 - coats))
    else:
        raise CannotMeasure(
            f"The coatings weigh {coats:.4g} g/m2 and the whole sheet {d.grammage_g_m2:g} g/m2: nothing is left for "
            "the base. Check grammage_g_m2 and the coat weights."
        )
    values = np.sum([p.values for p in parts], axis=0)
    return Measured(values=values, se=np.sqrt(np.sum([p.se**2 for p in parts if p.se is not None], axis=0)))


def _to_mean(part: Measured, sheet: Sheet, weighed: float) -> Measured:
    mean = sheet.mean(part.values)
    if not mean > 0:
        raise CannotMeasure(
            f"The mean absorption is {mean:.3g} um of base; {weighed:g} g/m2 cannot be spread over it. Check the grey "
            "levels in the report."
        )
    return part.times(weighed / mean)


@sheet_property(
    "apparent_density", units="g/cm3", long_name="Apparent density", check=_check, after=("grammage", "thickness"),
    support_um=lambda params: params.density_support_um, when=_given,
)  # fmt: skip
def apparent_density(sheet: Sheet) -> Measured:
    """P-09: grammage over thickness, both averaged with the same Gaussian first.

    SE: rho sqrt((SE_w / w)^2 + (SE_t / t)^2), each SE times pitch / (2 sqrt(pi) sigma) for the average over rays whose
    noise is independent; noise that neighbours share makes it larger.
    """
    f = sheet.frame
    sigma = f.params.density_support_um / _FWHM
    left = min(1.0, float(np.sqrt(np.prod(f.pitch_um))) / (2 * np.sqrt(np.pi) * sigma))
    mass, thick = sheet.maps["grammage"], sheet.maps["thickness"]
    # Both means are of the same rays.
    both = sheet.valid & np.isfinite(mass.values) & np.isfinite(thick.values)
    w, t = (smoothed(np.where(both, m.values, np.nan), f.pitch_um, sigma) for m in (mass, thick))
    assert mass.se is not None
    assert thick.se is not None
    relative = np.sqrt((mass.se / w) ** 2 + (thick.se / t) ** 2) * left
    return Measured(values=np.where(both, w / t, np.nan), se=np.abs(w / t) * relative)
