"""How the two maps of a correlation vary with distance: each alone, moved against each other, and measured twice."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.analyze import bland_altman, deming, independent_points, ring_correlation
from planish.analyze.correlograms import Correlogram, correlogram_of
from planish.analyze.covariance import Lags
from planish.analyze.variograms import variogram_of
from planish.core.errors import PlanishError
from planish.results import CorrelogramFacts, LagProfile, RingFacts, TwiceFacts, VariogramFacts

Array = NDArray[np.float64]

REACH_UM = 500.0
"""Of the correlogram, along either axis."""
_MOST = 60  # distances of a variogram
_STEPS = 40  # lags of a profile to either side


def variograms_of(
    maps: tuple[Array, Array], lags: Lags, names: tuple[tuple[str, str, str], ...], md_deg: float | None
) -> Iterator[VariogramFacts]:
    """Variograms of two maps on one mask; ``names`` are layer, map and units of each.

    Nothing of a map that the field is too small for.
    """
    for values, (layer, name, units) in zip(maps, names, strict=True):
        try:
            found = variogram_of(values, lags, md_deg)
        except PlanishError:
            continue
        far = np.unique(np.geomspace(1, found.lags_um.size, _MOST).round().astype(np.intp)) - 1
        yield VariogramFacts.of(
            found, layer=layer, map=name, units=units, cell_um=lags.pixel_um, md_deg=md_deg,
            distances_um=tuple(found.lags_um[far].tolist()), values=tuple(found.values[far].tolist()),
        )  # fmt: skip


def correlogram_facts(maps: tuple[Array, Array], lags: Lags) -> CorrelogramFacts | None:
    """Correlogram of two maps on one mask, with its profiles through lag 0; None where there are too few lags."""
    try:
        found = correlogram_of(maps, (lags.known, lags.known), lags, reach_um=REACH_UM)
    except PlanishError:
        return None
    row, col = (n // 2 for n in found.r.shape)
    reach = min(float(found.lag_y_um[-1]), float(found.lag_x_um[-1]))
    return CorrelogramFacts.of(
        found, cell_um=lags.pixel_um, reach_um=reach, r_at_zero=float(found.r[row, col]),
        limit_of_any=float(found.band_99_of_any[row, col]),
        along_x=_profile(found, found.lag_x_um, (row, slice(None))),
        along_y=_profile(found, found.lag_y_um, (slice(None), col)),
    )  # fmt: skip


def _profile(found: Correlogram, lags_um: Array, at: Any) -> LagProfile:
    """What lies along one axis, at lag 0 and at most so many lags to either side."""
    step = math.ceil((lags_um.size // 2) / _STEPS)
    some = slice(lags_um.size // 2 % step, None, step)
    r, limit, of_any = (tuple(m[at][some].tolist()) for m in (found.r, found.band_99, found.band_99_of_any))
    return LagProfile(lags_um=tuple(lags_um[some].tolist()), r=r, limit=limit, limit_of_any=of_any)


def measured_twice(
    maps: tuple[Array, Array], lags: Lags, points: tuple[Array, Array], *, point_um: float, units: str,
    error_ratio: float | None = None,
) -> TwiceFacts:  # fmt: skip
    """Two measurements of one quantity: rings of waves over the cells, bias and limits over the larger points.

    ``error_ratio``, variance of the errors of the second over that of the first, gives the line between both.
    """
    found: dict[str, Any] = {"units": units}
    try:
        rings = ring_correlation(*maps, mask=lags.known, pixel_um=lags.pixel_um)
        found |= {
            "rings": tuple(RingFacts.of(ring) for ring in rings.rings), "resolution_um": rings.resolution_um,
            "sentence": rings.sentence,
        }  # fmt: skip
    except PlanishError as error:
        found["sentence"] = error.text
    try:
        apart = bland_altman(*points, pixel_um=point_um)
    except PlanishError:
        return TwiceFacts(**found)
    if error_ratio is not None:
        found["error_ratio"] = error_ratio
        try:
            count = independent_points(*points, pixel_um=point_um)
            line = deming(*points, error_ratio=error_ratio, n_eff=count.n_eff)
        except PlanishError:
            pass
        else:
            found |= {
                "error_slope": line.slope, "error_intercept": line.intercept, "error_interval": line.interval
            }  # fmt: skip
    return TwiceFacts.of(apart, point_um=point_um, **found)
