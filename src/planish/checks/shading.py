"""Change of the grey of the base from one border of the sheet to the other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planish.checks.greys import Greys
from planish.checks.sheets import Core
from planish.core.checks import PROPERTIES, Check
from planish.core.frame import Axis

SHADED = 0.15  # of base - air: change of the base's grey across the sheet
_NOTABLE = 9.0  # times the standard error of a mean: range of a fitted parabola that chance does not make
_LEAST_TILES, _LEAST_PLACES = 20, 4  # of all, and different ones along an axis


def shading_check(core: Core, grey: NDArray[np.float32], greys: Greys, *, through: Axis) -> Check:
    """Judge whether the base has one grey from one border of the sheet to the other.

    ``grey`` (points,) of the core, NaN where it was not read. Along each axis of the sheet a parabola is fitted to the
    tiles' grey.
    """
    name, contrast = "grey across the sheet", abs(greys.base - greys.air)
    grey_in_tiles = np.where(core.is_base[..., None], grey.reshape(core.shape), np.nan)
    points = core.points.reshape(*core.shape, 3)
    tiles = np.any(np.isfinite(grey_in_tiles).all(axis=2), axis=1)
    if np.count_nonzero(tiles) < _LEAST_TILES or not contrast > 0:
        sentence = f"The base is seen in {np.count_nonzero(tiles)} tiles only, too few to follow its grey."
        return Check(name=name, state="unknown", sentence=sentence, figures=(PROPERTIES,))
    level = np.nanmedian(grey_in_tiles[tiles], axis=(1, 2))
    share, limit, along = 0.0, SHADED, ""
    for k, axis in enumerate("zyx"):
        if axis == through:
            continue
        place = np.nanmean(np.where(core.is_base[tiles], points[tiles, :, 0, k], np.nan), axis=1)
        if np.unique(place).size < _LEAST_PLACES:
            continue
        fit = np.polynomial.Polynomial.fit(place, level, 2)
        change = float(np.ptp(fit(fit.linspace(41)[0]))) / contrast
        chance = _NOTABLE * float(np.std(level - fit(place))) / contrast / np.sqrt(level.size)
        if not along or change - max(SHADED, chance) > share - limit:
            share, limit, along = change, max(SHADED, chance), axis
    return Check.at_most(
        name, share, look=limit, units="share", figures=(PROPERTIES,),
        sentence=f"Along {along}, the grey of the base changes by {100 * share:.2g} % of its contrast to the air.",
        advice="The beam or the light faded, or the scan is shaded. Correct it by a flat field, or scan again.",
    )  # fmt: skip
