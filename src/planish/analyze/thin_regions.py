"""How a map differs inside and outside of regions, such as those where a coating is thin."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from planish.analyze.chance import student_quantile
from planish.analyze.correlation import LEAST_CLAIMED, on_one_grid
from planish.analyze.covariance import Lags, covariance_of
from planish.core.errors import CannotMeasure
from planish.core.facts import Facts, Interval, Value

_LEAST = 3
_QUANTILE = 0.975


class RegionDifference(Facts):
    """Mean of a map inside of regions minus that outside."""

    share: float = Field(description="Share of the pixels where it is thinner.")
    difference: float = Field(description="Mean of the image there less that elsewhere.")
    interval: Interval = Field(description="In which the difference lies with 95 %.")
    n_eff: Value = Field(description="Independent points of the thin regions.")


def region_difference(
    values: NDArray[Any], inside: NDArray[np.bool_], *, mask: NDArray[np.bool_] | None = None,
    pixel_um: float | tuple[float, float],
) -> RegionDifference:  # fmt: skip
    """Compare a map inside and outside of regions.

    Parameters
    ----------
    values : ndarray, shape (rows, cols)
        NaN is missing.
    inside : ndarray of bool, shape (rows, cols)
    mask : ndarray of bool, shape (rows, cols), optional
        Pixels that count.
    pixel_um : float or (float, float)
        Along y and x.

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
    What each pixel adds to the difference is a map of its own, whose mean has the variance that its covariances by lag
    give: a region is one event, however many pixels it has.
    """
    pixel = on_one_grid(values, values, mask, pixel_um)
    on_one_grid(values, inside, inside, pixel)
    known = np.isfinite(values) if mask is None else np.isfinite(values) & mask
    there, rest = known & inside, known & ~inside
    count = int(np.count_nonzero(there)), int(np.count_nonzero(rest))
    if min(count) < _LEAST:
        raise CannotMeasure(
            f"{count[0]} valid pixels lie inside of the regions and {count[1]} outside, {_LEAST} are needed on either "
            "side. Give another limit."
        )
    share = count[0] / sum(count)
    means = float(values[there].mean()), float(values[rest].mean())
    added = np.zeros(known.shape)
    added[there] = (values[there] - means[0]) / share
    added[rest] = -(values[rest] - means[1]) / (1 - share)
    difference = means[0] - means[1]
    covariance, variance = covariance_of(added, Lags(known, pixel))
    square = float(covariance[0, 0])
    if not square > 0:
        return RegionDifference(
            share=share, difference=difference, interval=(difference, difference), n_eff=float(sum(count))
        )
    n_eff = min(square / variance, float(sum(count))) if variance > 0 else math.nan
    if not n_eff >= LEAST_CLAIMED:
        return RegionDifference(share=share, difference=difference, interval=(math.nan, math.nan), n_eff=n_eff)
    width = student_quantile(_QUANTILE, n_eff - 1) * math.sqrt(square / n_eff)
    return RegionDifference(
        share=share, difference=difference, interval=(difference - width, difference + width), n_eff=n_eff
    )
