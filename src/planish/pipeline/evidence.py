"""What stands beside the correlation that leads: at which scale, from where the grid begins, and what could be seen."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.analyze import (
    CorrelateParams,
    PairAtSizes,
    Partial,
    SizeRow,
    ceiling,
    coherence,
    commonality,
    independent_points,
    of_short_waves,
    origins,
    partial,
    region_difference,
    second_opinion,
    size_curve,
    straight_or_curved,
)
from planish.analyze.covariance import Lags
from planish.core.area import AreaMeans
from planish.core.bands import band_of, bands, thinned
from planish.core.errors import InputError, PlanishError
from planish.core.grid import Grid
from planish.pipeline.by_distance import correlogram_facts, measured_twice, variograms_of
from planish.pipeline.halves import Columns, noise_ceiling, reliability_of
from planish.pipeline.optics import density_of, light_of
from planish.results import EvidenceFacts, ImageCurve, LayerFacts, ThinRegion

Array = NDArray[np.float64]

THIN_UM = (2.0, 5.0, 10.0)
CELLS = 2**16
"""Of a map, by which the independent points of a correlation are counted and its scales are told."""


def evidence_of(
    maps: Mapping[str, xr.Dataset], a: LayerFacts, b: LayerFacts, *, point_um: float, declared: bool,
    beside: tuple[str, ...] = (), columns: Mapping[str, Columns] | None = None, md_deg: float | None = None,
    params: CorrelateParams | None = None,
) -> EvidenceFacts | None:  # fmt: skip
    """Tell at which scales the maps that stand for two layers go together; None where they share too little.

    ``declared`` says whether the study named the map before r was looked at. Maps of more than 65 536 pixels are
    averaged to larger ones first. ``beside`` names maps of a sheet whose part is taken off for a partial correlation.
    ``columns`` are those of each sheet, for its reliability; ``md_deg`` is the machine direction on the reference;
    ``params`` hold what is told of light only where it is asked for.

    Raises
    ------
    InputError
        If a sheet lacks a map that is to stand beside.
    """
    first, second = maps[a.name], maps[b.name]
    grid = Grid.of(first)
    twice = a.kind == b.kind == "sheet" and a.headline == b.headline
    pair = PairAtSizes(
        grid.shape, pixel_um=grid.pixel_um, point_um=point_um if twice else None, most_cells=CELLS
    )  # fmt: skip
    for rows in bands(grid.shape[0]):
        use = band_of(first["valid"], rows) & band_of(second["valid"], rows)
        pair.add(rows.start, np.where(use, band_of(first[a.headline], rows), np.nan), band_of(second[b.headline], rows))
    (x, y), cell_um = pair.cells()
    known = np.isfinite(x) & np.isfinite(y)
    if np.count_nonzero(known) < 3 or not (np.ptp(x[known]) > 0 and np.ptp(y[known]) > 0):
        return None
    found: dict[str, Any] = {}
    found["sizes"] = size_curve(x, y, pixel_um=cell_um).saved
    # A field that is too small for one of these says nothing of it, and the rest stands.
    try:
        of_waves = coherence(x, y, pixel_um=cell_um)
        found["bands"] = of_waves.bands
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
        found["second_opinion"] = second_opinion(x, y, pixel_um=cell_um, point_um=point_um)
        short, longest = of_short_waves(x, y, pixel_um=cell_um, point_um=point_um)
        found["short_waves"] = SizeRow.of(short)
        found["short_waves_um"] = longest
    if a.headline.startswith("coating_") and "image" in second:
        found["thin"] = tuple(_thin(x, y, cell_um))
    if (errors := _errors(first, second)) is not None:
        size = point_um if point_um >= max(cell_um) else None
        most = ceiling(x, error_um=errors, mask=known, pixel_um=cell_um, point_um=size)
        found |= {"ceiling": most.r, "ceiling_sentence": most.sentence}
    lags = Lags(known, cell_um)
    units = [str(of[m.headline].attrs.get("units", "1")) for of, m in ((first, a), (second, b))]
    names = (a.name, a.headline, units[0]), (b.name, b.headline, units[1])
    found["variograms"] = tuple(variograms_of((x, y), lags, names, md_deg))
    found["correlogram"] = correlogram_facts((x, y), lags)
    params = params or CorrelateParams()
    if twice:
        found["twice"] = measured_twice(
            (x, y), lags, pair.points(), point_um=point_um, units=units[0], error_ratio=params.error_ratio
        )
    if a.headline.startswith("coat") and "image" in second:
        sheet = columns.get(a.name) if columns else None
        found |= light_of(
            x, y, params, cell_um=cell_um, point_um=point_um, in_grams=units[0] == "g/m2",
            density=None if sheet is None else density_of(sheet.measured, a.headline),
        )  # fmt: skip
    if columns and point_um >= max(cell_um):
        corner = grid.origin_um[0] - grid.pixel_um[1] / 2, grid.origin_um[1] - grid.pixel_um[0] / 2
        halves = tuple(
            reliability_of(
                columns[m.name], m.name, m.headline, known, origin_um=corner, cell_um=cell_um, point_um=point_um
            ) for m in (a, b) if m.name in columns
        )  # fmt: skip
        found |= {"reliability": halves} | noise_ceiling(halves, found.get("ceiling"))
    if beside and a.kind == "sheet":
        found |= _beside(first, second, (a.headline, b.headline), beside, grid, point_um)
    return EvidenceFacts(a=a.name, a_map=a.headline, b=b.name, b_map=b.headline, declared=declared, **found)


def _thin(x: Array, y: Array, cell_um: tuple[float, float]) -> Iterator[ThinRegion]:
    """Compare the image inside and outside of thin regions, for the limits that some pixels are below."""
    known = np.isfinite(x) & np.isfinite(y)
    for limit in THIN_UM:
        try:
            apart = region_difference(y, np.where(known, x, np.inf) < limit, mask=known, pixel_um=cell_um)
        except PlanishError:
            continue
        yield ThinRegion.holding(apart, thinner_than_um=limit)


def _curve(x: Array, y: Array, cell_um: tuple[float, float], point_um: float) -> ImageCurve | None:
    """Whether an image bends over a property, at the larger points; None where too few points are independent."""
    pair = PairAtSizes((x.shape[0], x.shape[1]), pixel_um=cell_um, point_um=point_um, most_cells=0)
    pair.add(0, x, y)
    p, q = pair.points()
    try:
        count = independent_points(p, q, pixel_um=point_um)
        bent = straight_or_curved(p, q, n_eff=count.n_eff, n_eff_square=count.n_eff_square)
    except PlanishError:
        return None
    return ImageCurve.holding(bent, point_um=point_um)


def _beside(
    first: xr.Dataset, second: xr.Dataset, pair: tuple[str, str], beside: tuple[str, ...], grid: Grid, point_um: float
) -> dict[str, Any]:
    """Partial correlation and commonality over the larger points, which are averaged over what is valid in all."""
    if lacking := [name for name in beside if name not in first]:
        raise InputError(
            f"The sheet has no map {', '.join(lacking)} to stand beside. Leave it out of --beside, or measure it."
        )
    factor = (point_um / grid.pixel_um[0], point_um / grid.pixel_um[1])
    if min(factor) < 1 - 1e-9:
        why = f"Points of {point_um:g} um are smaller than a pixel. Give larger ones with --point-um."
        return {"partial": Partial(given=beside, point_um=point_um, silence=why)}
    names = (pair[0], *beside)
    means = AreaMeans(grid.shape, factor)
    for rows in bands(grid.shape[0]):
        maps = [band_of(first[name], rows) for name in names] + [band_of(second[pair[1]], rows)]
        use = band_of(first["valid"], rows) & band_of(second["valid"], rows)
        means.add(rows.start, np.logical_and.reduce([use, *map(np.isfinite, maps)]), *maps)
    *sheet, image = means.means()
    known = np.isfinite(image)  # all maps count where all are known
    n = int(np.count_nonzero(known))
    flat = [name for name, m in zip(names, sheet, strict=True) if n < 3 or not np.ptp(m[known]) > 0]
    if flat:
        why = f"Over {n} points that are valid in all maps, {', '.join(flat)} does not vary."
        return {"partial": Partial(given=beside, point_um=point_um, n=n, silence=why)}
    try:
        left = partial(sheet[0], image, sheet[1:], pixel_um=point_um)
        shares = commonality(image, dict(zip(names, sheet, strict=True)))
    except PlanishError as error:  # nothing is left: the rest of the run stands
        return {"partial": Partial(given=beside, point_um=point_um, silence=error.text)}
    row = Partial(
        given=beside, point_um=point_um, n=left.n, r=left.r, n_eff=left.n_eff, interval=left.interval
    )  # fmt: skip
    return {"partial": row, "commonality": shares}


def _errors(*layers: xr.Dataset) -> Array | None:
    """Expected errors of the places of all layers together, at some pixels; None where one is not known."""
    known = [data["expected_error"] for data in layers if "expected_error" in data]
    squares = [np.asarray(thinned(data)[1][0], dtype=np.float64) ** 2 for data in known]
    total = np.sqrt(sum(squares)) if squares else np.full(1, math.nan)
    total = total[np.isfinite(total)]
    return np.quantile(total, np.linspace(0, 1, 65)) if total.size else None
