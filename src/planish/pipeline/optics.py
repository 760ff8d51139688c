"""What light makes of a coating: Kubelka and Munk's curve, spread in the paper, uneven print; all only on request."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.analyze import (
    CorrelateParams,
    LightSpread,
    correlate_spread,
    fit_kubelka_munk,
    independent_points,
    print_mottle,
)
from planish.core.area import AreaMeans, area_mean
from planish.core.bands import band_of, bands
from planish.core.errors import PlanishError
from planish.core.grid import Grid
from planish.results import CoatingCurve, LayerMottle

Array = NDArray[np.float64]

_EVEN = 1e-3  # of a ratio of two maps, up to which it counts as one number
_MOTTLE_CELL_UM = 15.0  # means over up to so much keep 0.99 of the shortest waves of the mottle


def density_of(measured: xr.Dataset, name: str) -> float | None:
    """Density in g/cm3 that turns a coating into its weight: as named, or as weighed; None where the run has neither.

    1 um of 1 g/cm3 is 1 g/m2, so it is the ratio of two maps of the sheet.
    """
    other = name.replace("coating_", "coat_weight_")
    if other == name or other not in measured or name not in measured:
        return None
    coating, weight = measured[name].values, measured[other].values
    known = np.isfinite(coating) & np.isfinite(weight) & (coating > 0)
    if not known.any():
        return None
    ratio = weight[known].astype(np.float64) / coating[known]
    middle = float(np.median(ratio))
    # A weight by absorption is another measurement: no one number leads to it.
    return float(f"{middle:.6g}") if np.percentile(np.abs(ratio - middle), 99) < _EVEN * middle else None


def light_of(
    x: Array, y: Array, params: CorrelateParams, *, cell_um: tuple[float, float], point_um: float,
    density: float | None, in_grams: bool,
) -> dict[str, Any]:  # fmt: skip
    """What a study asks of the light over a coating ``x``, as part of the evidence; ``in_grams``: ``x`` is g/m2."""
    found: dict[str, Any] = {"density_g_cm3": density}
    small = point_um < max(cell_um) * (1 - 1e-9)
    why = f"Points of {point_um:g} um are smaller than the means that stand for the pixels. Give larger ones."
    if (ratio := params.kubelka_munk) is not None:
        factor, known = (point_um / cell_um[0], point_um / cell_um[1]), np.isfinite(x) & np.isfinite(y)
        found["kubelka_munk"] = CoatingCurve(point_um=point_um, ratio=ratio, silence=why) if small else \
            kubelka_munk_of(
                (area_mean(np.where(known, x, np.nan), factor), area_mean(np.where(known, y, np.nan), factor)),
                point_um=point_um, ratio=ratio, density=1.0 if in_grams else density,
            )  # fmt: skip
    if (width_um := params.light_spread_um) is not None:
        found["light_spread"] = LightSpread(width_um=width_um, point_um=point_um, silence=why) if small else \
            correlate_spread(x, y, cell_um=cell_um, point_um=point_um, width_um=width_um)  # fmt: skip
    return found


def kubelka_munk_of(
    points: tuple[Array, Array], *, point_um: float, ratio: float, density: float | None
) -> CoatingCurve:  # fmt: skip
    """Fit the curve to reflectance over a coating at the larger points, or say why there is none.

    ``density`` (g/cm3) turns the coating from um into g/m2, 1 where it is a weight already; None for lengths.
    """
    weight, x, y = density is not None, points[0] * (density or 1.0), points[1]
    try:
        count = independent_points(x, y, pixel_um=point_um)
        curve = fit_kubelka_munk(
            x, y, n_eff=count.n_eff, n_eff_level=count.n_eff_level, absorption_over_scattering=ratio, weight=weight
        )
    except PlanishError as error:
        return CoatingCurve(point_um=point_um, ratio=ratio, weight=weight, silence=error.text)
    return CoatingCurve.holding(curve, point_um=point_um)


def mottle_of(name: str, data: xr.Dataset, *, quantity: str) -> LayerMottle:
    """How uneven an image is over its valid pixels, or why that cannot be said; ``quantity`` names its values."""
    grid = Grid.of(data)
    factor = max(1, int(_MOTTLE_CELL_UM / max(grid.pixel_um)))
    means = AreaMeans(grid.shape, (factor, factor))
    for rows in bands(grid.shape[0]):
        image = band_of(data["image"], rows)
        means.add(rows.start, band_of(data["valid"], rows) & np.isfinite(image), image)
    cell_um = grid.pixel_um[0] * factor, grid.pixel_um[1] * factor
    try:
        mottle = print_mottle(means.means()[0], pixel_um=cell_um, quantity=quantity)
    except PlanishError as error:
        return LayerMottle(layer=name, silence=error.text)
    return LayerMottle.holding(mottle, layer=name)
