"""How much of a map is no noise, from two half measurements.

These are the odd and the even rows of its columns.

Columns are measured one by one, so both halves are there without measuring anything twice.
Thicknesses and half thicknesses are taken from the faces of each column itself: along normals,
which cross from column to column, neighbouring rows would share their noise.
"""

import math

import numpy as np

from planish.analyze.compared_maps import ComparedMaps
from planish.analyze.correlation import correlate
from planish.analyze.sheet_columns import SheetColumns
from planish.core.area import area_mean, square_px
from planish.core.bands import bands
from planish.core.errors import CannotMeasure, PlanishError
from planish.core.facts import NULL, DescribedModel, Interval, Value
from planish.core.typing import Array, Bools, Entries, Floats, Ints, Pair, Pixel, pair_of


class Reliability(DescribedModel):
    """Share of a map's variance that a second measurement would show again, at one point size."""

    layer: str = ""
    """Name of the layer."""
    map: str = ""
    """Name of the map."""
    point_um: float
    """Edge of a point."""
    n: int | None = None
    """Points that are known in both halves."""
    halves_r: Value = NULL
    """Correlation of both halves."""
    value: Value = NULL
    """Share of the variance of the map that both halves show: an upper bound."""
    interval: Interval = NULL
    """Its 95 % interval."""
    n_eff: Value = NULL
    """Independent points."""
    shared: str | None = None
    """What both halves share, which makes it an upper bound."""
    reason: str | None = None
    """Why there is none."""


def split_reliability(
    first: Array,
    second: Array,
    *,
    pixel_um: Pixel,
    point_um: float | None = None,
) -> Reliability:
    """Tell the reliability of a map from two halves of its measurement.

    It is an upper bound where both share errors, as neighbouring slices of one scan do.

    Parameters
    ----------
    first, second : ndarray, shape (rows, cols)
        The map of the odd and of the even slices, or of two half scans, on one grid; NaN is
        missing.
    pixel_um, point_um
        As of :func:`planish.correlate`.

    Returns
    -------
    Reliability

    Raises
    ------
    InputError, SizeError
        As :func:`planish.correlate`.
    CannotMeasure
        If fewer than 3 points are valid in both, or one is constant.

    References
    ----------
    Spearman (1910), Brit. J. Psychol. 3, 271, doi:10.1111/j.2044-8295.1910.tb00206.x.
    Brown (1910), Brit. J. Psychol. 3, 296, doi:10.1111/j.2044-8295.1910.tb00207.x.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> thickness, odd, even = rng.normal(size=(3, 60, 80))
    >>> halves = split_reliability(thickness + odd, thickness + even, pixel_um=10.0)
    >>> round(halves.halves_r, 1), round(halves.value, 1)
    (0.5, 0.7)
    """
    row = correlate(first, second, pixel_um=pixel_um, point_um=point_um)
    if math.isnan(row.r):
        raise CannotMeasure(
            f"The halves have no correlation. {' '.join(row.warnings)} Give two maps that vary."
        )
    low, high = row.interval
    return Reliability(
        point_um=row.point_um,
        n=row.n,
        halves_r=row.r,
        value=_of_both(row.r),
        interval=(_of_both(low), _of_both(high)),
        n_eff=row.n_eff,
    )


def _of_both(r: float) -> float:
    """Reliability of the mean of two measurements that correlate with r.

    A share of variance is not below 0.
    """
    return 0.0 if r <= 0 else 2 * r / (1 + r)


def half_points(
    columns: SheetColumns,
    name: str,
    is_valid: Bools,
    *,
    origin_um: Pair,
    cell_um: Pair,
    point_um: float,
) -> tuple[Floats, Floats, bool]:
    """Means of a map over the points of a reference, of the odd and the even rows of its columns.

    ``is_valid`` (rows, cols) are the cells of the reference that count, ``cell_um`` (y, x) large;
    ``origin_um`` is the outer corner of the first one (x, y), where the points begin. Means are NaN
    where less than half of a point counts, or the halves have no column in it. Also says whether no
    column's value holds anything of its neighbours.
    """
    ones = np.where(is_valid, 1.0, np.nan)
    enough = np.isfinite(area_mean(ones, square_px(point_um, cell_um)))
    # Of all cells, or of all whole points.
    sides_um = np.multiply(is_valid.shape, cell_um), np.multiply(enough.shape, point_um)
    height_um, width_um = np.minimum(*sides_um)
    # From the flat sheet (u, v) to (x, y) of the reference, from the outer corner on.
    turn = columns.similarity.matrix()
    shift_um = np.subtract(columns.similarity.shift_um, origin_um)
    n_columns = np.zeros(enough.size)
    totals = np.zeros((2, enough.size))
    alone = True
    for rows in bands(columns.measured.sizes["y"]):
        # Two rows more on either side, for the slopes beside and the means between rows; an even
        # number of them.
        before = min(rows.start, 2)
        first = rows.start - before
        part = columns.part(slice(first, rows.stop + 2))
        # The map by columns, and whether each value is of its column alone.
        values, alone = part.values(name)
        of_band = slice(before, rows.stop - first)
        half_maps = [_half(values, parity) for parity in (1, 0)]
        halves = [half_map[of_band].ravel() for half_map in half_maps]
        u, v = (part.flat[axis].values[of_band].ravel() for axis in "uv")
        x = turn[0, 0] * u + turn[0, 1] * v + shift_um[0]
        y = turn[1, 0] * u + turn[1, 1] * v + shift_um[1]
        use = np.isfinite(halves[0] + halves[1])
        use &= (y >= 0) & (y < height_um)
        use &= (x >= 0) & (x < width_um)
        cell_rows = _index(y[use], cell_um[0])
        cell_cols = _index(x[use], cell_um[1])
        use[use] = is_valid[cell_rows, cell_cols]
        first_of_row = _index(y[use], point_um) * enough.shape[1]
        ids = first_of_row + _index(x[use], point_um)
        n_columns += np.bincount(ids, minlength=enough.size)
        for total, half in zip(totals, halves, strict=True):
            total += np.bincount(ids, weights=half[use], minlength=enough.size)
    is_counted = enough & (n_columns > 0).reshape(enough.shape)
    means = (totals / np.maximum(n_columns, 1)).reshape(2, *is_counted.shape)
    odd, even = np.where(is_counted, means, np.nan)
    return odd, even, alone


def _index(places_um: Floats, step_um: float) -> Ints:
    return (places_um / step_um).astype(np.intp)


def _half(values: Floats, first: int) -> Floats:
    """Every second row from ``first`` on.

    Rows between hold the mean of their neighbours, NaN where one is missing.

    So both halves are known at the same places: the mean place of every second row in a point
    differs by up to a row from that of the others, and texture would look like noise.
    """
    half = np.full(values.shape, np.nan)
    half[first::2] = values[first::2]
    rows_of_half = half[first::2]
    between = 0.5 * (rows_of_half[:-1] + rows_of_half[1:])
    half[first + 1 : -1 : 2] = between
    return half


def row_difference(values: Floats) -> Floats:
    """Half the difference of the odd and the even rows of a map, each as it is between its rows.

    It holds the noise of the map and, of waves longer than some rows, nothing else.
    """
    return 0.5 * (_half(values, 1) - _half(values, 0))


def reliability_of(pair: ComparedMaps, layer: str, name: str) -> Reliability:
    """How much of a map two halves of its measurement show alike, or why that cannot be said.

    At the larger points of the pair, whose grid begins at the outer corner of the first pixel.
    """
    columns = pair.columns[layer]
    point_um = pair.point_um
    half_pixels_um = np.divide(pair.grid.pixel_um[::-1], 2)
    corner_um = pair_of(np.subtract(pair.grid.origin_um, half_pixels_um))
    sizes: Entries = {"origin_um": corner_um, "cell_um": pair.cell_um, "point_um": point_um}
    try:
        odd, even, alone = half_points(columns, name, pair.lags.is_valid, **sizes)
        reliability = split_reliability(odd, even, pixel_um=point_um)
    except PlanishError as error:
        return Reliability(layer=layer, map=name, point_um=point_um, reason=error.text)
    shared = columns.shared(alone=alone)
    return Reliability.holding(reliability, layer=layer, map=name, shared=shared)
