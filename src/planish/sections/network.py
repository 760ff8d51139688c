"""Find one place for every section from the offsets between pairs.

It also gives the slow part of their course, which is the specimen's own.
"""

import itertools
import math

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from planish.core.robust import mad_sd
from planish.core.typing import Floats, Ints

LEAST_SHARE = 0.05  # a pair with less than this share of its weight is refused
_ORDER = 4
"""Of the derivative that is held down.

With 3 a wave of 600 um and 48 um height is bent by 0.5 um at the ends of the series, with 4 by 0.1
um.
"""


_HALF = 1.0 / np.sqrt(0.5) - 1.0
"""(1 - H)^2 = 1/2 of the smoother applied twice, H = 1 / (1 + l w^8), so l w^8 = 1 / _HALF at the
cut-off."""


def solve_places(
    first: Ints, second: Ints, offset: Floats, sigma: Floats, n: int
) -> tuple[Floats, Floats]:
    """Find the places whose differences are the offsets.

    ``offset`` (pairs,) is the place of the second section of a pair less that of the first, which
    comes before it, and ``sigma`` its standard deviation, in any one unit. The places (n,) are
    known up to a constant in each connected part; the second array (pairs,) is the share of its
    weight that each pair kept: 1 for a good one, near 0 for an outlier. Least squares with Cauchy's
    weights, iterated; the scale is the median of the residuals over their sigma.
    """
    trust = 1.0 / sigma**2
    weight_shares = np.ones(first.size)
    place = np.zeros(n)
    if first.size == 0:
        return place, weight_shares
    reach = int(np.max(second - first))
    for _ in range(25):
        w = trust * weight_shares
        # Upper band of the normal matrix: its last row is the diagonal.
        band = np.zeros((reach + 1, n))
        np.add.at(band[reach], first, w)
        np.add.at(band[reach], second, w)
        above_diagonal = reach - (second - first)
        np.add.at(band, (above_diagonal, second), -w)
        # Weight of the prior "where the stage put it", against the pairs: settles what they leave
        # open.
        band[reach] += 1e-7 * float(np.median(trust))
        right_side = np.zeros(n)
        np.add.at(right_side, second, w * offset)
        np.add.at(right_side, first, -w * offset)
        place = np.asarray(solveh_banded(band, right_side), np.float64)
        residual = np.abs(offset - (place[second] - place[first])) / sigma
        scale = max(mad_sd(residual, 0.0), 1.0)
        # 95 % as good as least squares where nothing is wrong (Holland and Welsch 1977).
        weight_shares = 1.0 / (1.0 + (residual / (2.385 * scale)) ** 2)
    return place, weight_shares


def section_components(first: Ints, second: Ints, n: int) -> list[Ints]:
    """Sections that pairs tie to each other, each part in order; those too small are left out."""
    ones = np.ones(first.size)
    adjacency = coo_array((ones, (first, second)), shape=(n, n))
    labels: NDArray[np.int32] = connected_components(adjacency, directed=False)[1]
    sizes = np.bincount(labels, minlength=1)
    # With fewer sections, slow and quick parts cannot be separated.
    large = np.flatnonzero(sizes >= min(6, n))
    return [np.flatnonzero(labels == k) for k in large]


def quick_places(
    places: Floats, away_um: Floats, components: list[Ints], *, cutoff_um: float
) -> Floats:
    """Take the slow part off places (sections, axes), in each part by itself.

    0 for sections in none.
    """
    quick = np.zeros_like(places)
    for component in components:
        at_um = away_um[component]
        for axis in range(places.shape[1]):
            course = places[component, axis]
            quick[component, axis] = quick_part(at_um, course, cutoff_um=cutoff_um)
    return quick


def slow_part(
    at_um: Floats, values: Floats, *, cutoff_um: float, weights: Floats | None = None
) -> Floats:
    """Low-pass a series at uneven places; slopes and curvature pass unchanged, up to the ends.

    Places increase; values are finite where the weight is not 0. Of the wavelength ``cutoff_um``
    half the amplitude passes; of one twice as long 99.99 % do, of one half as long 2 %. Whittaker's
    smoother with a penalty on the fourth derivative (Eilers 2003, Anal. Chem. 75, 3631), applied
    again to what it left. Divided differences at the true places make it, so a gap neither shifts
    nor bends anything.
    """
    n = values.size
    weights = np.ones(n) if weights is None else weights
    if n < _ORDER + 2:
        return values.copy()
    steps_um = np.diff(at_um)
    pitch = float(np.median(steps_um))
    # Two sections at almost one place would make the fourth derivative between them infinite.
    steps = np.maximum(steps_um / pitch, 0.25)
    x = np.concatenate([[0.0], np.cumsum(steps)])  # pitches
    cutoff_over_two_pi = cutoff_um / pitch / (2.0 * np.pi)
    stiffness = cutoff_over_two_pi ** (2 * _ORDER) / _HALF
    # A row for the derivative at each run of five places: their factors in it.
    rows = n - _ORDER
    coefficients = np.full((_ORDER + 1, rows), float(math.factorial(_ORDER)))
    for k, m in itertools.permutations(range(_ORDER + 1), 2):
        coefficients[k] /= x[k : rows + k] - x[m : rows + m]
    length = (x[_ORDER:] - x[:-_ORDER]) / _ORDER
    # Upper band of the matrix: the last row is the diagonal, the d-th before it the d-th above the
    # diagonal.
    band = np.zeros((_ORDER + 1, n))
    for k, m in itertools.combinations_with_replacement(range(_ORDER + 1), 2):
        products = stiffness * length * coefficients[k] * coefficients[m]
        band[_ORDER - (m - k), m : rows + m] += products
    # A weight that is 0 everywhere would leave the system without a solution.
    positive_weights = np.maximum(weights, 1e-9)
    band[_ORDER] += positive_weights
    clean = np.where(weights > 0, values, 0.0)
    first: Floats = solveh_banded(band, positive_weights * clean)
    residual = np.where(weights > 0, clean - first, 0.0)
    second: Floats = solveh_banded(band, positive_weights * residual)
    return first + second


def quick_part(at_um: Floats, values: Floats, *, cutoff_um: float) -> Floats:
    """High-pass a series: what :func:`slow_part` leaves; arguments as there."""
    return values - slow_part(at_um, values, cutoff_um=cutoff_um)
