"""Masses: coat weight, grammage and apparent density.

From lengths or absorption, densities and what was weighed.

The user gives densities and weighed masses; their own error is common to a map, and no part of its
standard error.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np

from planish.core.errors import CannotMeasure
from planish.core.options import Params, option, option_names
from planish.core.typing import Floats, Texts
from planish.measure.greys import FWHM, Greys
from planish.measure.lengths import smoothed
from planish.measure.options import Common
from planish.measure.registry import SIDES, Measured, Sheet, Side, ray_property, sheet_property

if TYPE_CHECKING:
    from planish.measure.rays import Rays


def _blur_margin_um(rays: Rays) -> Floats:
    """Three blurs along the rays, outside a face and inside an interface.

    They hold 99.9 % of the light of a step.
    """
    return 3.0 * rays.greys.blur_um * rays.oblique


_known = partial(option, None, gt=0, lt=1e4)  # a density or mass, where it is known


class Densities(Params):
    """Densities and masses that are known from elsewhere; all of them may be missing."""

    coating_g_cm3: float | None = _known(
        cli="--coating-density",
        metavar="G/CM3",
        help=(
            "Density of the coating with its voids, for coat weight; 1.6 is usual for ground"
            " calcium carbonate."
        ),
    )
    base_g_cm3: float | None = _known(
        cli="--base-density",
        metavar="G/CM3",
        help="Density of the base as it lies in the sheet, for grammage.",
    )
    filler_g_cm3: float | None = _known(
        cli=None,
        help="Density of the filler's grains without voids; calcium carbonate 2.7.",
    )
    grammage_g_m2: float | None = _known(
        cli="--grammage", metavar="G/M2", help="Weighed mass of the sheet."
    )
    coat_weight_top_g_m2: float | None = _known(
        cli="--coat-weight-top",
        metavar="G/M2",
        help="Weighed mass of the top coating.",
    )
    coat_weight_bottom_g_m2: float | None = _known(
        cli="--coat-weight-bottom",
        metavar="G/M2",
        help="Weighed mass of the bottom coating.",
    )

    def coat_weight(self, side: Side) -> float | None:
        """Weighed mass of the coating of one side."""
        return self.coat_weight_top_g_m2 if side == "top" else self.coat_weight_bottom_g_m2

    def need(self, quantity: str, *names: str) -> float:
        """Return the first of ``names`` that is known; CannotMeasure if none is."""
        for name in names:
            if (number := getattr(self, name)) is not None:
                return number
        lacking_text = "neither is" if len(names) > 1 else "that is not"
        raise CannotMeasure(
            f"{quantity} in grams needs {option_names(Densities, *names)}, and {lacking_text}"
            f" given. Give it, or leave {quantity.lower()} out."
        )

    def known(self) -> dict[str, float]:
        """Return those that are known, for the attributes of a dataset."""
        return self.model_dump(include={*Densities.model_fields}, exclude_none=True)


class Options(Densities):
    """Options of the masses: what is known from elsewhere, and how they are measured."""

    coat_weight_from: Literal["thickness", "attenuation"] = option(
        "thickness",
        cli=None,
        help=(
            "Thickness times density, or the grey that the coating adds to the base's: the second"
            " ignores the blur."
        ),
    )
    density_support_um: float = option(
        100.0,
        gt=0,
        cli=None,
        help=(
            "Full width at half maximum of the Gaussian that grammage and thickness are averaged"
            " with."
        ),
    )


def _in_grams(
    layer: Measured, sheet: Sheet, quantity_text: str, weighed_g_m2: float | None, density: str
) -> Measured:
    """Turn a layer in um into g/m2, by its weighed mass or else by the option ``density``, g/cm3.

    ``quantity_text`` names it in messages. 1 um of 1 g/cm3 weighs 1 g/m2.
    """
    if weighed_g_m2 is None:
        return layer.times(sheet.params.of(Options).need(quantity_text, density))
    mean_um = sheet.mean(layer.values)
    if not mean_um > 0:
        raise CannotMeasure(
            f"{quantity_text} is {mean_um:.3g} um in the mean; {weighed_g_m2:g} g/m2 cannot be"
            " spread over it. Check the side, and the surfaces and grey levels in the report."
        )
    return layer.times(weighed_g_m2 / mean_um)


def _coating_absorbs(_params: Common, greys: Greys, side: Side) -> None:
    greys.need_coating(side, f"Coating by absorption, {side} side,")
    greys.need_absorption(f"Coating by absorption, {side} side,")


def coating_absorption(rays: Rays, side: Side) -> Measured:
    """P-02: thickness of a layer of the coating's own grey that absorbs as much as this one.

    The integral of the grey above the base's level, from three blurs outside the face to three
    blurs inside the interface, over the contrast between coating and base; outside the face the
    air's level takes the base's place. A blur moves grey along the ray but does not change its
    integral, so that thin layers count in full.

    SE: sqrt(noise * L + ((base - air) SE_face)^2) / (coating - base), L the length of the integral.
    """
    from planish.measure.uncertainty import face_errors

    greys = rays.greys
    margin_um = _blur_margin_um(rays)
    base_contrast = greys.base - greys.air
    contrast = (greys.coating(side) - greys.air) - base_contrast
    if side == "top":
        lower = rays.interface_top - margin_um
        upper = rays.top + margin_um
        length_from_face = rays.top - lower
    else:
        lower = rays.bottom - margin_um
        upper = rays.interface_bottom + margin_um
        length_from_face = upper - rays.bottom
    excess = rays.integral(lower, upper) - base_contrast * length_from_face
    # Without the margin it is the thickness of the coating.
    face_se = face_errors(rays, length_from_face - margin_um, side)
    se = np.hypot(rays.integral_se(upper - lower), base_contrast * face_se)
    return Measured(values=excess / contrast, se=se / abs(contrast))


ray_property(
    "coating_absorption_{side}",
    units="um",
    long_name="Coating by absorption, {side} side",
    check=_coating_absorbs,
)(coating_absorption)


def _weight_given(params: Options, greys: Greys, side: Side) -> bool:
    return greys.coated(side) and bool(params.coating_g_cm3 or params.coat_weight(side))


def _weight_check(params: Options, greys: Greys, side: Side) -> None:
    greys.need_coating(side, f"Coat weight, {side} side,")
    params.need(f"Coat weight, {side} side,", f"coat_weight_{side}_g_m2", "coating_g_cm3")
    if params.coat_weight_from == "attenuation":
        greys.need_absorption(f"Coat weight, {side} side,")


def _layer(params: Options, _greys: Greys, side: Side) -> Texts:
    if params.coat_weight_from == "thickness":
        return (f"coating_{side}",)
    return (f"coating_absorption_{side}",)


@sheet_property(
    "coat_weight_{side}",
    units="g/m2",
    long_name="Coat weight, {side} side",
    check=_weight_check,
    after=_layer,
    when=_weight_given,
)
def coat_weight(sheet: Sheet, side: Side) -> Measured:
    """P-02: mass of the coating over its area, from the weighed mean or from the density.

    A-23: it is w = w_mean t / t_mean where the coat weight was weighed, and rho t where the density
    is known.

    SE: the layer's, times the same factor.
    """
    params = sheet.params.of(Options)
    (layer,) = _layer(params, sheet.frame.greys, side)
    quantity_text = f"Coat weight, {side} side,"
    weighed_g_m2 = params.coat_weight(side)
    return _in_grams(sheet.maps[layer], sheet, quantity_text, weighed_g_m2, "coating_g_cm3")


def _absorbs(_params: Common, greys: Greys) -> None:
    greys.need_absorption("Absorption of the sheet")


def _absorption(rays: Rays) -> Measured:
    """Length of base that absorbs as much as the whole ray.

    It is the integral above the air, divided by base - air.

    From three blurs outside the one face to three outside the other. SE: sqrt(noise L) / (base -
    air).
    """
    margin_um = _blur_margin_um(rays)
    contrast = rays.greys.base - rays.greys.air
    lower = rays.bottom - margin_um
    upper = rays.top + margin_um
    se = rays.integral_se(upper - lower) / abs(contrast)
    return Measured(values=rays.integral(lower, upper) / contrast, se=se)


ray_property("absorption", units="um", long_name="Absorption of the sheet", check=_absorbs)(
    _absorption
)


@ray_property("absorption_base", units="um", long_name="Absorption of the base", check=_absorbs)
def absorption_base(rays: Rays) -> Measured:
    """Length of base that absorbs as much as the ray without its coatings.

    What the coated sides absorb is taken off as (coating's excess + base's level) over each layer;
    what remains is the base. SE: sqrt(noise L) / (base - air) and those of the layers, as
    independent.
    """
    greys = rays.greys
    sheet_absorption = _absorption(rays)
    base_um = sheet_absorption.values
    variance = sheet_absorption.se**2
    base_contrast = greys.base - greys.air
    for side in filter(greys.coated, SIDES):
        layer = coating_absorption(rays, side)
        # By how much a um of coating absorbs more than a um of base does, in um of base.
        share = (greys.coating(side) - greys.air) / base_contrast - 1
        base_um = base_um - layer.values * share - _coating_um(rays, side)
        variance = variance + (layer.se * share) ** 2
    return Measured(values=base_um, se=np.sqrt(variance))


def _coating_um(rays: Rays, side: Side) -> Floats:
    """Length of the coating of one side on each ray (rows, cols)."""
    if side == "top":
        return rays.top - rays.interface_top
    return rays.interface_bottom - rays.bottom


def _check(params: Options, greys: Greys) -> None:
    greys.need_absorption("Grammage")
    if params.grammage_g_m2 is not None:
        return
    params.need("Grammage", "grammage_g_m2", "base_g_cm3")
    for side in filter(greys.coated, SIDES):
        params.need(
            f"Grammage with a coating on the {side} side",
            f"coat_weight_{side}_g_m2",
            "coating_g_cm3",
        )


def _has_masses(params: Options, greys: Greys) -> bool:
    is_bare = not any(map(greys.coated, SIDES))
    has_densities = params.base_g_cm3 is not None and (is_bare or params.coating_g_cm3 is not None)
    return params.grammage_g_m2 is not None or has_densities


def _sources(params: Options, greys: Greys) -> Texts:
    coated_sides: list[Side] = [side for side in SIDES if greys.coated(side)]
    is_separable = params.coating_g_cm3 or None not in map(params.coat_weight, coated_sides)
    if not coated_sides or (params.grammage_g_m2 is not None and not is_separable):
        return ("absorption",)
    return ("absorption_base", *(f"coating_absorption_{side}" for side in coated_sides))


@sheet_property(
    "grammage", units="g/m2", long_name="Grammage", check=_check, after=_sources, when=_has_masses
)
def grammage(sheet: Sheet) -> Measured:
    """P-08: absorption along the ray, scaled so that its mean is the weighed grammage.

    Where coat weights or densities are known, each material is scaled on its own: coatings to their
    coat weight (or density), the base to what remains of the grammage (or to its density). Without
    them one factor serves both, although a coating absorbs more per gram than fibres do: local
    grammage then follows the coating too strongly. SE: each part's times its factor, as
    independent.
    """
    params = sheet.params.of(Options)
    greys = sheet.frame.greys
    maps = sheet.maps
    base_g_m2 = params.grammage_g_m2  # less the coatings below; None: the base's density is given
    if "absorption" in _sources(params, greys):
        return _in_grams(maps["absorption"], sheet, "Grammage", base_g_m2, "base_g_cm3")
    layers: list[Measured] = []
    for side in filter(greys.coated, SIDES):
        layer = maps[f"coating_absorption_{side}"]
        quantity_text = f"Grammage with a coating on the {side} side"
        weighed_g_m2 = params.coat_weight(side)
        layers.append(_in_grams(layer, sheet, quantity_text, weighed_g_m2, "coating_g_cm3"))
    if base_g_m2 is not None:
        coats_g_m2 = sum(sheet.mean(layer.values) for layer in layers)
        if not base_g_m2 > coats_g_m2:
            raise CannotMeasure(
                f"The coatings weigh {coats_g_m2:.4g} g/m2 and the whole sheet {base_g_m2:g} g/m2:"
                " nothing is left for the base. Check `grammage` and the coat weights."
            )
        base_g_m2 -= coats_g_m2
    layers.append(_in_grams(maps["absorption_base"], sheet, "Grammage", base_g_m2, "base_g_cm3"))
    values = np.sum([layer.values for layer in layers], axis=0)
    variance = np.sum([np.square(layer.se) for layer in layers], axis=0)
    return Measured(values=values, se=np.sqrt(variance))


@sheet_property(
    "apparent_density",
    units="g/cm3",
    long_name="Apparent density",
    check=_check,
    after=("grammage", "thickness"),
    support_um=lambda params: params.density_support_um,
    when=_has_masses,
)
def apparent_density(sheet: Sheet) -> Measured:
    """P-09: grammage over thickness, both averaged with the same Gaussian first.

    SE: rho sqrt((SE_w / w)^2 + (SE_t / t)^2), each SE times pitch / (2 sqrt(pi) sigma) for the
    average over rays whose noise is independent; noise that neighbours share makes it larger.
    """
    f = sheet.frame
    sigma = f.params.of(Options).density_support_um / FWHM
    pitch_um = float(np.sqrt(np.prod(f.pitch_um)))
    noise_share = min(1.0, pitch_um / (2 * np.sqrt(np.pi) * sigma))
    mass = sheet.maps["grammage"]
    thickness = sheet.maps["thickness"]
    # Both means are of the same rays.
    is_measured = sheet.valid & np.isfinite(mass.values + thickness.values)
    masked = (np.where(is_measured, m.values, np.nan) for m in (mass, thickness))
    w, t = (smoothed(values, f.pitch_um, sigma) for values in masked)
    relative_se = np.sqrt((mass.se / w) ** 2 + (thickness.se / t) ** 2) * noise_share
    density = np.where(is_measured, w / t, np.nan)
    return Measured(values=density, se=np.abs(density) * relative_se)
