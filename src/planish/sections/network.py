"""From the offsets between pairs of sections to one place for every section: robust weighted least squares."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from planish.sections.trend import quick_part

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_ROUNDS = 25
_CAUCHY = 2.385  # 95 % as good as least squares where nothing is wrong (Holland and Welsch 1977)
_HELD = 0.05  # a pair with less than this share of its weight is refused
_TIED = 1e-7  # weight of the prior "where the stage put it", against the pairs: settles what they leave open
_LEAST_PART = 6  # sections tied to each other, below which slow and quick parts cannot be separated


def solve_places(first: Index, second: Index, offset: Array, sigma: Array, n: int) -> tuple[Array, Array]:
    """Find the places whose differences are the offsets.

    Parameters
    ----------
    first, second : ndarray (pairs,)
        Sections, ``first < second``.
    offset, sigma : ndarray (pairs,)
        Place of the second less that of the first, and its standard deviation, in any one unit.
    n : int
        Number of sections.

    Returns
    -------
    place : ndarray (n,)
        Up to a constant in each connected part.
    weight : ndarray (pairs,)
        Share of its weight that each pair kept: 1 for a good one, near 0 for an outlier.

    Notes
    -----
    Least squares with Cauchy's weights, iterated; the scale is the median of the residuals over their sigma.
    """
    trust = 1.0 / sigma**2
    kept = np.ones(first.size)
    place = np.zeros(n)
    if first.size == 0:
        return place, kept
    reach = int(np.max(second - first))
    for _ in range(_ROUNDS):
        w = trust * kept
        band = np.zeros((reach + 1, n))
        np.add.at(band[reach], first, w)
        np.add.at(band[reach], second, w)
        np.add.at(band, (reach - (second - first), second), -w)
        band[reach] += _TIED * float(np.median(trust))
        right = np.zeros(n)
        np.add.at(right, second, w * offset)
        np.add.at(right, first, -w * offset)
        place = np.asarray(solveh_banded(band, right), np.float64)
        residual = np.abs(offset - (place[second] - place[first])) / sigma
        scale = max(1.4826 * float(np.median(residual)), 1.0)
        kept = 1.0 / (1.0 + (residual / (_CAUCHY * scale)) ** 2)
    return place, kept


def held_pairs(kept: Array) -> NDArray[np.bool_]:
    """Which pairs kept enough of their weight on every axis, from (pairs, axes)."""
    return np.min(kept, axis=1) > _HELD


def parts(first: Index, second: Index, n: int) -> list[Index]:
    """Sections that pairs tie to each other, each part in order; those too small are left out."""
    ties = coo_array((np.ones(first.size), (first, second)), shape=(n, n))
    names: NDArray[np.int32] = connected_components(ties, directed=False)[1]
    sizes = np.bincount(names, minlength=1)
    return [np.flatnonzero(names == k) for k in np.flatnonzero(sizes >= min(_LEAST_PART, n))]


def quick_places(place: Array, away_um: Array, groups: list[Index], *, cutoff_um: float) -> Array:
    """Take the slow part off, in each part by itself; 0 for sections in none."""
    quick = np.zeros_like(place)
    for group in groups:
        quick[group] = quick_part(away_um[group], place[group], cutoff_um=cutoff_um)
    return quick
