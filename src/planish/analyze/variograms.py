"""How a map varies with distance.

Its noise from pixel to pixel, its spread, and how far its texture reaches.
"""

import math
from operator import itemgetter

import numpy as np
from scipy import optimize

from planish.analyze.compared_maps import ComparedMaps
from planish.analyze.correlation import check_varying, valid_pixels
from planish.core.errors import CannotMeasure, PlanishError
from planish.core.facts import NULL, DescribedModel, Value
from planish.core.grid import shorter_side_um
from planish.core.typing import Array, Bools, Entries, Floats, Pair, Pixel, TwoFields
from planish.texture.covariance import Lags

_LEAST_RINGS = 4  # for a model of three numbers


class Variogram(DescribedModel):
    """How a map varies with distance.

    Half of the mean square difference of two points of it, by their distance.
    """

    layer: str = ""
    """Name of the layer."""
    map: str = ""
    """Name of the map."""
    units: str = "1"
    """Of the values."""
    cell_um: Pair
    """What the map was averaged over first, along y and x."""
    nugget: float
    """Variance that neighbouring cells do not share, in the map's units squared."""
    sill: float
    """Variance of the map."""
    range_um: Value
    """Distance at which the covariance has fallen to 1/e; none where it does not, or all is
    nugget."""
    md_deg: Value = NULL
    """Machine direction on the reference, where the run knows it."""
    range_along_um: Value = NULL
    """The range within 22.5 degrees of the machine direction."""
    range_across_um: Value = NULL
    """The same across it."""
    ratio: Value = NULL
    """Range along over range across."""
    distances_um: tuple[float, ...]
    """Middle of each class of distances."""
    values: tuple[float, ...]
    """At each distance, in the map's units squared."""


def variogram(a: Array, *, pixel_um: Pixel, md_deg: float | None = None) -> Variogram:
    """Variogram of a map with nugget, sill and ranges.

    Parameters
    ----------
    a : ndarray, shape (rows, cols); NaN is missing
    pixel_um
        As of :func:`planish.correlate`.
    md_deg : float, optional; machine direction, deg clockwise on the screen from the x axis

    Returns
    -------
    Variogram

    Raises
    ------
    InputError, SizeError
        As :func:`planish.correlate`.
    CannotMeasure
        If the map is constant, or the field holds fewer than 4 rings of distance.

    Notes
    -----
    From the covariances at all lags up to half of the shorter side, in rings one pixel wide. The
    nugget is what a covariance ``c exp(-(h / l)^k)``, k from 1 to 2, fitted from the first ring to
    where 0.3 is left, leaves of the sill; a texture that is rougher than the exponential one counts
    as nugget in part. The range is read off the covariances themselves. Waves longer than a fifth
    of the field make sill and range smaller than they are.

    Examples
    --------
    >>> a = np.random.default_rng(0).normal(size=(60, 80))
    >>> smooth = sum(np.roll(a, k, axis=1) for k in range(8)) / 8
    >>> curve = variogram(smooth, pixel_um=10.0)
    >>> round(curve.sill, 2), 10 < curve.range_um < 80
    (0.12, True)
    """
    return variogram_of(a, Lags(*valid_pixels(a, a, pixel_um)), md_deg)


def variogram_of(a: Array, lags: Lags, md_deg: float | None) -> Variogram:
    """The same from the lags of a mask of known pixels, which several maps may share.

    Map (rows, cols); machine direction clockwise from the x axis, None where it is not known.
    """
    check_varying(lags.is_valid, a=a)
    products = lags.own_products(a)
    # What the mean took is known from the lags that are used, and put back at all lags.
    covariances = lags.covariance(products, lags.until_zero(products))
    sill = covariances[0, 0]
    mean_took = sill - products[0, 0] / lags.n
    products = products + mean_took * lags.pairs
    distance, covariance = _by_ring(lags, products, lags.inside)
    if distance.size < _LEAST_RINGS:
        raise CannotMeasure(
            f"Half of the field holds {distance.size} rings of distance, {_LEAST_RINGS} are needed."
            " Give a larger map."
        )
    shared = min(_at_zero(distance, covariance, max(lags.pixel_um)), sill)
    of_directions: Entries = {}
    if md_deg is not None:
        down_um, across_um = lags.lag_um
        from_md = np.degrees(np.arctan2(down_um[:, None], across_um)) - md_deg
        ranges_um: list[float] = []
        for from_axis in (from_md, from_md - 90):
            rings = _by_ring(lags, products, _is_near_axis(from_axis))
            ranges_um.append(_range(*rings, shared))
        along_um, across_um = ranges_um
        of_directions = {"md_deg": md_deg, "range_along_um": along_um, "range_across_um": across_um}
        if np.isfinite(ranges_um).all():
            of_directions["ratio"] = along_um / across_um
    values = sill - covariance
    return Variogram(
        cell_um=lags.pixel_um,
        nugget=sill - shared,
        sill=sill,
        range_um=_range(distance, covariance, shared),
        distances_um=tuple(distance.tolist()),
        values=tuple(values.tolist()),
        **of_directions,
    )


def _is_near_axis(angle_deg: Floats) -> Bools:
    """Whether directions lie within 22.5 degrees of an axis."""
    return np.abs((angle_deg + 90) % 180 - 90) <= 22.5 + 1e-9


def _by_ring(lags: Lags, products: Floats, is_used: Bools) -> TwoFields:
    """Mean distance and covariance of rings one pixel wide, up to half of the shorter side.

    ``products`` are the sums over all pairs at a lag, ``is_used`` the lags that count, both in the
    order of ``lags.pairs``. Lag 0 and rings without pairs are left out.
    """
    step = max(lags.pixel_um)
    ring = np.rint(lags.distance_um / step).astype(np.intp)
    side_um = shorter_side_um(lags.is_valid.shape, lags.pixel_um)
    is_counted = is_used & lags.inside & (lags.pairs > 0)
    is_counted &= ring >= 1
    is_counted &= lags.distance_um <= side_um / 2
    ring_numbers = ring[is_counted]
    maps = np.stack([lags.pairs, lags.pairs * lags.distance_um, products])
    counted = maps[:, is_counted]
    sums = np.array([np.bincount(ring_numbers, weights=row) for row in counted])
    pairs, distance_sums, totals = sums[:, sums[0] > 0]
    return distance_sums / pairs, totals / pairs


def _at_zero(distance: Floats, covariance: Floats, step: float) -> float:
    """Covariance towards distance 0: the variance that neighbours share.

    0 where they share nothing. ``distance`` and ``covariance`` are those of the rings from the
    first on, ``step`` the width of a ring, in um.
    """
    if covariance[0] <= 0:
        return 0.0
    low = np.flatnonzero(covariance < 0.3 * covariance[0])
    until_low = int(low[0]) if low.size else covariance.size
    # Rings that the model is fitted to: at most 40, which hold what lies near distance 0.
    count = min(max(until_low, _LEAST_RINGS), 40)
    h = distance[:count]
    c = covariance[:count] / covariance[0]
    # Each ring counts the same: longer ones have more pairs but scatter more, as a field holds few
    # long waves.

    def off(p: Floats) -> Floats:
        """How far the covariances by the model, over that of the first ring, are off."""
        return p[0] * np.exp(-((h / math.exp(p[1])) ** p[2])) - c

    farthest = h[-1]
    likely_reach = max(farthest / 2, step)
    start = np.array([1.1, math.log(likely_reach), 1.3])
    # Share at distance 0, log of the reach, and exponent: from the exponential to the Gaussian
    # covariance.
    least = [0.0, math.log(step / 20), 1.0]
    most = [np.inf, math.log(1e3 * farthest), 2.0]
    fit = optimize.least_squares(off, start, bounds=(least, most))
    return fit.x[0] * covariance[0]


def _range(distance: Floats, covariance: Floats, shared: float) -> float:
    """Distance at which the covariance first falls below 1/e of what neighbours share.

    NaN where they share nothing, infinite where it does not fall so far.
    """
    if not shared > 0:
        return math.nan
    h = np.concatenate([[0.0], distance])
    c = np.concatenate([[1.0], covariance / shared])
    limit = math.exp(-1)
    below = np.flatnonzero(c < limit)
    if not below.size:
        return math.inf
    bracket = slice(below[0] - 1, below[0] + 1)  # over which -c rises
    return np.interp(-limit, -c[bracket], h[bracket])


def answer_variograms(pair: ComparedMaps) -> Entries:
    """Variograms of both maps on their one mask.

    Nothing of a map that the field is too small for. Of the rings up to 60 are kept, closer to each
    other at short distances.
    """
    curves: list[Variogram] = []
    fields = (pair.x, pair.y)
    maps = zip(fields, (pair.a, pair.b), pair.units, strict=True)
    for values, (layer, name), units in maps:
        try:
            curve = variogram_of(values, pair.lags, pair.md_deg)
        except PlanishError:
            continue
        rings = np.geomspace(1, len(curve.values), 60).round()
        numbers = np.unique(rings.astype(np.intp))
        thinned = itemgetter(*(numbers - 1))
        distances_um = thinned(curve.distances_um)
        row = Variogram.holding(
            curve,
            layer=layer,
            map=name,
            units=units,
            distances_um=distances_um,
            values=thinned(curve.values),
        )
        curves.append(row)
    return {"variograms": tuple(curves)}
