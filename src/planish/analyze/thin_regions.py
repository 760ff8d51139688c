"""How a map differs inside and outside of regions, such as those where a coating is thin."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from planish.analyze.correlation import LEAST_CLAIMED, on_one_grid
from planish.analyze.covariance import Lags, covariance_of
from planish.analyze.distributions import student_quantile
from planish.core.errors import CannotMeasure, PlanishError
from planish.core.facts import Interval, ResultModel, Value, is_known
from planish.core.numbers import number, percent, plain
from planish.core.typing import Bools

if TYPE_CHECKING:
    from planish.analyze.diagnostics import ComparedMaps, EvidenceFacts, PairWords

THIN_UM = (2.0, 5.0, 10.0)
_LEAST = 3
_QUANTILE = 0.975


class RegionDifference(ResultModel):
    """Mean of a map inside of regions minus that outside."""

    share: float = Field(description="Share of the pixels where it is thinner.")
    difference: float = Field(description="Mean of the image there less that elsewhere.")
    interval: Interval = Field(description="In which the difference lies with 95 %.")
    n_eff: Value = Field(description="Independent points of the thin regions.")


def region_difference(
    values: NDArray[Any], inside: Bools, *, mask: Bools | None = None,
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
    is_valid = np.isfinite(values) if mask is None else np.isfinite(values) & mask
    within, outside = is_valid & inside, is_valid & ~inside
    count = int(np.count_nonzero(within)), int(np.count_nonzero(outside))
    if min(count) < _LEAST:
        raise CannotMeasure(
            f"{count[0]} valid pixels lie inside of the regions and {count[1]} outside, {_LEAST} are needed on either "
            "side. Give another limit."
        )
    share = count[0] / sum(count)
    means = float(values[within].mean()), float(values[outside].mean())
    added = np.zeros(is_valid.shape)
    added[within] = (values[within] - means[0]) / share
    added[outside] = -(values[outside] - means[1]) / (1 - share)
    difference = means[0] - means[1]
    covariance, variance = covariance_of(added, Lags(is_valid, pixel))
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


class _ThinnerThan(ResultModel):
    thinner_than_um: float = Field(description="Limit of the coating's thickness.")


class ThinRegion(RegionDifference, _ThinnerThan):
    """Mean of the image where the coating is thinner than a limit, minus that elsewhere."""


def answer_thin(pair: ComparedMaps) -> dict[str, Any]:
    """The image inside and outside of thin regions of the coating, for the limits that some pixels are below."""
    if not (pair.a[1].startswith("coating_") and "image" in pair.layers[1]):
        return {}
    counted, regions = pair.lags.is_valid, list[ThinRegion]()
    for limit in THIN_UM:
        try:
            difference = region_difference(
                pair.y, np.where(counted, pair.x, np.inf) < limit, mask=counted, pixel_um=pair.cell_um
            )
        except PlanishError:
            continue
        regions.append(ThinRegion.holding(difference, thinner_than_um=limit))
    return {"thin": tuple(regions)}


def say_thin(evidence: EvidenceFacts, words: PairWords) -> Iterator[str]:
    """How the image differs where the coating is thin."""
    for thin in evidence.thin:
        if is_known(thin.interval):
            low, high = (number(v, 3) for v in thin.interval)
            where = (
                f"Where the coating is below {plain(thin.thinner_than_um)} ({percent(thin.share, 2)} of the valid area)"
            )
            yield (f"{where} the mean {words.image} differs by {number(thin.difference, 3)} (95 %: {low} to {high}).")
