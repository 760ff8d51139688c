"""Two-sidedness: what the top has more than the bottom, and whether both vary together (P-14)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planish.core.errors import CannotMeasure
from planish.measure.registry import SIDES, Measured, Sheet, sheet_property

if TYPE_CHECKING:
    import xarray as xr

    from planish.measure.greys import Greys
    from planish.measure.params import MeasureParams
    from planish.measure.rays import Array


def _both(_params: MeasureParams, greys: Greys) -> None:
    for side in SIDES:
        greys.need_coating(side, "The difference of both coatings")


def _difference(top: Measured, bottom: Measured) -> Measured:
    se = None if top.se is None or bottom.se is None else np.hypot(top.se, bottom.se)
    return Measured(values=top.values - bottom.values, se=se)


@sheet_property("coating_difference", units="um", long_name="Coating, top less bottom", check=_both,
                after=("coating_top", "coating_bottom"))  # fmt: skip
def coating_difference(sheet: Sheet) -> Measured:
    """P-14: t_T - t_B on the same ray; SE: the root of the summed squares of both."""
    return _difference(sheet.maps["coating_top"], sheet.maps["coating_bottom"])


@sheet_property("topography_difference", units="um", long_name="Topography, top less bottom",
                after=("topography_top", "topography_bottom"))  # fmt: skip
def topography_difference(sheet: Sheet) -> Measured:
    """P-14: outward height of the top face less that of the bottom face on the same ray; SE as above.

    Both are measured from the centre surface, the smoothed mean of the faces, so that its mean is near 0 by
    construction; what is left is roughness that only one side has, and form below the centre surface's cut-off.
    """
    return _difference(sheet.maps["topography_top"], sheet.maps["topography_bottom"])


def two_sidedness(maps: xr.Dataset) -> dict[str, float]:
    """Numbers of the two sides, from maps on the same rays: nothing has to be mirrored.

    Parameters
    ----------
    maps : Dataset
        With ``coating_top`` and ``coating_bottom``, or ``topography_top`` and ``topography_bottom``, or both pairs.

    Returns
    -------
    dict
        For each pair ``<pair>_difference_um`` (mean, top less bottom), ``<pair>_sd_ratio`` (top over bottom) and
        ``<pair>_correlation`` (Pearson's r of top and bottom; outward heights correlate negatively where the sheet as a
        whole bends, positively where it is thick and thin), ``<pair>_n``.

    Raises
    ------
    CannotMeasure
        If there is no pair.
    """
    out: dict[str, float] = {}
    for pair in ("coating", "topography"):
        if not (f"{pair}_top" in maps and f"{pair}_bottom" in maps):
            continue
        top, bottom = (maps[f"{pair}_{side}"].values.astype(np.float64) for side in ("top", "bottom"))
        known = np.isfinite(top) & np.isfinite(bottom)
        if np.count_nonzero(known) < 3:
            continue
        a: Array = top[known]
        b: Array = bottom[known]
        sd = float(a.std()), float(b.std())
        out[f"{pair}_difference_um"] = float(a.mean() - b.mean())
        out[f"{pair}_sd_ratio"] = sd[0] / sd[1] if sd[1] > 0 else float("nan")
        out[f"{pair}_correlation"] = float(np.corrcoef(a, b)[0, 1]) if min(sd) > 0 else float("nan")
        out[f"{pair}_n"] = int(a.size)
    if not out:
        raise CannotMeasure(
            "Two-sidedness needs coating_top and coating_bottom, or topography_top and topography_bottom, known on the "
            "same rays. Measure them."
        )
    return out
