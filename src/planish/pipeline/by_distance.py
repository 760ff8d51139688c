"""How the two maps of a correlation vary with distance: each alone, moved against each other, and measured twice."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.analyze import bland_altman, deming, independent_points, ring_correlation
from planish.analyze.correlograms import CorrelogramProfiles, correlogram_of
from planish.analyze.covariance import Lags
from planish.analyze.rings import RingCorrelation
from planish.analyze.variograms import variogram_of
from planish.core.errors import PlanishError
from planish.results import MapVariogram, Twice

Array = NDArray[np.float64]

REACH_UM = 500.0
"""Of the correlogram, along either axis."""


def variograms_of(
    maps: tuple[Array, Array], lags: Lags, names: tuple[tuple[str, str, str], ...], md_deg: float | None
) -> Iterator[MapVariogram]:
    """Variograms of two maps on one mask; ``names`` are layer, map and units of each.

    Nothing of a map that the field is too small for.
    """
    for values, (layer, name, units) in zip(maps, names, strict=True):
        try:
            curve = variogram_of(values, lags, md_deg).curve(units=units, cell_um=lags.pixel_um, md_deg=md_deg)
        except PlanishError:
            continue
        yield MapVariogram.holding(curve, layer=layer, map=name)


def correlogram_facts(maps: tuple[Array, Array], lags: Lags) -> CorrelogramProfiles | None:
    """Correlogram of two maps on one mask, with its profiles through lag 0; None where there are too few lags."""
    try:
        return correlogram_of(maps, (lags.known, lags.known), lags, reach_um=REACH_UM).profiles(lags.pixel_um)
    except PlanishError:
        return None


def measured_twice(
    maps: tuple[Array, Array], lags: Lags, points: tuple[Array, Array], *, point_um: float, units: str,
    error_ratio: float | None = None,
) -> Twice:  # fmt: skip
    """Two measurements of one quantity: rings of waves over the cells, bias and limits over the larger points.

    ``error_ratio``, variance of the errors of the second over that of the first, gives the line between both.
    """
    try:
        rings = ring_correlation(*maps, mask=lags.known, pixel_um=lags.pixel_um)
    except PlanishError as error:
        rings = RingCorrelation(sentence=error.text)
    try:
        agreement = bland_altman(*points, pixel_um=point_um)
    except PlanishError:
        return Twice.holding(rings, units=units)
    line: dict[str, Any] = {} if error_ratio is None else {"error_ratio": error_ratio}
    if error_ratio is not None:
        try:
            count = independent_points(*points, pixel_um=point_um)
            fit = deming(*points, error_ratio=error_ratio, n_eff=count.n_eff)
        except PlanishError:
            pass
        else:
            line |= {"error_slope": fit.slope, "error_intercept": fit.intercept, "error_interval": fit.interval}
    return Twice.holding(rings, agreement, point_um=point_um, units=units, **line)
