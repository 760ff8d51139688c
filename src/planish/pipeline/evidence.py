"""What stands beside the correlation that leads: at which scale, from where the grid begins, and what could be seen."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.analyze import (
    PairAtSizes,
    ceiling,
    coherence,
    independent_points,
    of_short_waves,
    origins,
    size_curve,
    straight_or_curved,
)
from planish.core.bands import band_of, bands, thinned
from planish.core.errors import PlanishError
from planish.core.grid import Grid
from planish.core.results import BandFacts, CurveFacts, EvidenceFacts, LayerFacts, SizeFacts

Array = NDArray[np.float64]

CELLS = 2**16
"""Of a map, by which the independent points of a correlation are counted and its scales are told."""


def evidence_of(
    maps: Mapping[str, xr.Dataset], a: LayerFacts, b: LayerFacts, *, point_um: float, declared: bool
) -> EvidenceFacts | None:  # fmt: skip
    """Tell at which scales the maps that stand for two layers go together; None where they share too little.

    ``declared`` says whether the study named the map before r was looked at. Maps of more than 65 536 pixels are
    averaged to larger ones first.
    """
    first, second = maps[a.name], maps[b.name]
    grid = Grid.of(first)
    pair = PairAtSizes(grid.shape, pixel_um=grid.pixel_um, point_um=None, most_cells=CELLS)
    for rows in bands(grid.shape[0]):
        use = band_of(first["valid"], rows) & band_of(second["valid"], rows)
        pair.add(rows.start, np.where(use, band_of(first[a.headline], rows), np.nan), band_of(second[b.headline], rows))
    (x, y), cell_um = pair.cells()
    known = np.isfinite(x) & np.isfinite(y)
    if np.count_nonzero(known) < 3 or not (np.ptp(x[known]) > 0 and np.ptp(y[known]) > 0):
        return None
    found: dict[str, Any] = {}
    curve = size_curve(x, y, pixel_um=cell_um)
    found["sizes"] = tuple(
        SizeFacts.of(row, point_um=row.support_um, band=band) for row, band in zip(curve.rows, curve.band, strict=True)
    )
    # A field that is too small for one of these says nothing of it, and the rest stands.
    try:
        of_waves = coherence(x, y, pixel_um=cell_um)
        found["bands"] = tuple(BandFacts.of(band) for band in of_waves.bands)
        found["resolution_per_um"] = of_waves.resolution_per_um
    except PlanishError:
        pass
    if point_um >= max(cell_um):
        try:
            spread = origins(x, y, pixel_um=cell_um, point_um=point_um)
            found["origins"] = (spread.least, spread.r, spread.largest)
        except PlanishError:
            pass
        if "thickness" in first and "image" in second:
            found["curve"] = _curve(x, y, cell_um, point_um)
        short, longest = of_short_waves(x, y, pixel_um=cell_um, point_um=point_um)
        found["short_waves"] = SizeFacts.of(short, point_um=point_um)
        found["short_waves_um"] = longest
    if (errors := _errors(first, second)) is not None:
        size = point_um if point_um >= max(cell_um) else None
        most = ceiling(x, error_um=errors, mask=known, pixel_um=cell_um, point_um=size)
        found |= {"ceiling": most.r, "ceiling_sentence": most.sentence}
    return EvidenceFacts(a=a.name, a_map=a.headline, b=b.name, b_map=b.headline, declared=declared, **found)


def _curve(x: Array, y: Array, cell_um: tuple[float, float], point_um: float) -> CurveFacts | None:
    """Whether an image bends over a property, at the larger points; None where too few points are independent."""
    pair = PairAtSizes((x.shape[0], x.shape[1]), pixel_um=cell_um, point_um=point_um, most_cells=0)
    pair.add(0, x, y)
    p, q = pair.points()
    try:
        count = independent_points(p, q, pixel_um=point_um)
        bent = straight_or_curved(p, q, n_eff=count.n_eff, n_eff_square=count.n_eff_square)
    except PlanishError:
        return None
    return CurveFacts.of(bent, point_um=point_um)


def _errors(*layers: xr.Dataset) -> Array | None:
    """Expected errors of the places of all layers together, at some pixels; None where one is not known."""
    known = [data["expected_error"] for data in layers if "expected_error" in data]
    squares = [np.asarray(thinned(data)[1][0], dtype=np.float64) ** 2 for data in known]
    total = np.sqrt(sum(squares)) if squares else np.full(1, math.nan)
    total = total[np.isfinite(total)]
    return np.quantile(total, np.linspace(0, 1, 65)) if total.size else None
