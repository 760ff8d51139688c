"""How a map differs inside and outside of regions, such as those where a coating is thin."""

import math
from contextlib import suppress

import numpy as np

from planish.analyze.compared_maps import ComparedMaps
from planish.analyze.correlation import LEAST, LEAST_CLAIMED, on_one_grid, valid_pixels
from planish.analyze.distributions import around, t_95
from planish.core.errors import CannotMeasure, PlanishError
from planish.core.facts import NULL, DescribedModel, Interval, Value
from planish.core.typing import Array, Bools, Entries, Pixel
from planish.texture.covariance import Lags, scatter_of

THIN_UM = (2.0, 5.0, 10.0)


class RegionDifference(DescribedModel):
    """Mean of a map inside of regions minus that outside."""

    thinner_than_um: Value = NULL
    """Limit of the coating's thickness."""
    share: float
    """Share of the pixels where it is thinner."""
    difference: float
    """Mean of the image there less that elsewhere."""
    interval: Interval
    """95 % interval of the difference."""
    n_eff: Value
    """Independent points of the thin regions."""


def region_difference(values: Array, inside: Bools, *, pixel_um: Pixel) -> RegionDifference:
    """Compare a map inside and outside of regions.

    Parameters
    ----------
    values : ndarray, shape (rows, cols); NaN is missing
    inside : ndarray of bool, shape (rows, cols)
    pixel_um
        As of :func:`planish.correlate`.

    Returns
    -------
    RegionDifference

    Raises
    ------
    InputError, SizeError
        As :func:`planish.correlate`.
    CannotMeasure
        If fewer than 3 valid pixels lie inside, or outside.

    Notes
    -----
    What each pixel adds to the difference is a map of its own, whose mean has the variance that its
    covariances by lag give: a region is one event, however many pixels it has.

    Examples
    --------
    >>> image = np.random.default_rng(0).normal(size=(60, 80))
    >>> thin = np.zeros((60, 80), dtype=bool)
    >>> thin[10:30, 20:40] = True
    >>> row = region_difference(image - 2.0 * thin, thin, pixel_um=10.0)
    >>> round(row.share, 3), round(row.difference)
    (0.083, -2)
    """
    is_valid, pixel = valid_pixels(values, values, pixel_um)
    on_one_grid(values, inside, pixel, inside)
    is_inside = is_valid & inside
    is_outside = is_valid & ~inside
    values_inside = values[is_inside]
    values_outside = values[is_outside]
    n_inside = values_inside.size
    n = n_inside + values_outside.size
    if min(n_inside, values_outside.size) < LEAST:
        raise CannotMeasure(
            f"{n_inside} valid pixels lie inside of the regions and {values_outside.size} outside,"
            f" {LEAST} are needed on either side. Give another limit."
        )
    share = n_inside / n
    mean_inside = values_inside.mean()
    mean_outside = values_outside.mean()
    difference = mean_inside - mean_outside
    contributions = np.zeros(is_valid.shape)
    contributions[is_inside] = (values_inside - mean_inside) / share
    contributions[is_outside] = (mean_outside - values_outside) / (1 - share)
    variance, n_eff = scatter_of(contributions, Lags(is_valid, pixel))
    width = math.nan
    if not variance > 0:
        width = 0.0
        n_eff = float(n)
    elif n_eff >= LEAST_CLAIMED:
        width = t_95(n_eff - 1) * math.sqrt(variance / n_eff)
    interval = around(difference, width)
    return RegionDifference(share=share, difference=difference, interval=interval, n_eff=n_eff)


def answer_thin(pair: ComparedMaps) -> Entries:
    """Compare the image inside and outside of thin regions of the coating.

    This is done for each limit of ``THIN_UM`` with enough pixels below and above it; a pixel
    without a coating thickness is in neither. Nothing where the pair is no coating on an image.
    """
    if not (pair.a[1].startswith("coating_") and "image" in pair.layers[1]):
        return {}
    coating_um = np.where(pair.lags.is_valid, pair.x, np.inf)
    differences: list[RegionDifference] = []
    for limit_um in THIN_UM:
        with suppress(PlanishError):
            row = region_difference(pair.y, coating_um < limit_um, pixel_um=pair.cell_um)
            differences.append(RegionDifference.holding(row, thinner_than_um=limit_um))
    return {"thin": tuple(differences)}
