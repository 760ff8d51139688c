"""The slow part of a series of sections: what belongs to the specimen and is never corrected."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

Array = NDArray[np.float64]

_ORDER = 4
"""Of the derivative that is held down. With 3 a wave of 600 um and 48 um height is bent by 0.5 um at the ends of the
series, with 4 by 0.1 um."""

_LEAST_STEP = 0.25  # pitches

_HALF = 1.0 / np.sqrt(0.5) - 1.0
"""(1 - H)^2 = 1/2 of the smoother applied twice, H = 1 / (1 + l w^8), so l w^8 = 1 / _HALF at the cut-off."""


def slow_part(at_um: Array, values: Array, *, cutoff_um: float, weights: Array | None = None) -> Array:
    """Low-pass a series at uneven places; slopes and curvature pass unchanged, up to the ends.

    Parameters
    ----------
    at_um : ndarray (n,)
        Places in um, increasing.
    values : ndarray (n,)
        Any unit; finite where the weight is not 0.
    cutoff_um : float
        Wavelength in um of which half the amplitude passes; of one twice as long 99.99 % do,
        of one half as long 2 %.
    weights : ndarray (n,), optional
        0 or more; all 1 where not given.

    Returns
    -------
    ndarray (n,)

    Notes
    -----
    Whittaker's smoother with a penalty on the fourth derivative (Eilers 2003, Anal. Chem. 75, 3631), applied a second
    time to what the first left. The derivative is taken by divided differences at the true places, so a gap neither
    shifts nor bends anything.
    """
    n = values.size
    weights = np.ones(n) if weights is None else weights
    if n < _ORDER + 2:
        return values.copy()
    pitch = float(np.median(np.diff(at_um)))
    # Two sections at almost one place would make the fourth derivative between them infinite.
    x = np.concatenate([[0.0], np.cumsum(np.maximum(np.diff(at_um) / pitch, _LEAST_STEP))])
    stiffness = (cutoff_um / pitch / (2.0 * np.pi)) ** (2 * _ORDER) / _HALF
    rows = n - _ORDER
    coefficients = np.full((_ORDER + 1, rows), float(math.factorial(_ORDER)))
    for k, m in itertools.permutations(range(_ORDER + 1), 2):
        coefficients[k] /= x[k : rows + k] - x[m : rows + m]
    length = (x[_ORDER:] - x[:-_ORDER]) / _ORDER
    # Upper band of the matrix: the last row is the diagonal, the d-th before it the d-th above the diagonal.
    band = np.zeros((_ORDER + 1, n))
    for k in range(_ORDER + 1):
        for m in range(k, _ORDER + 1):
            band[_ORDER - (m - k), m : rows + m] += stiffness * length * coefficients[k] * coefficients[m]
    # A weight that is 0 everywhere would leave the system without a solution.
    held = np.maximum(weights, 1e-9)
    band[_ORDER] += held
    clean = np.where(weights > 0, values, 0.0)
    first: Array = solveh_banded(band, held * clean)
    rest = np.where(weights > 0, clean - first, 0.0)
    second: Array = solveh_banded(band, held * rest)
    return first + second


def quick_part(at_um: Array, values: Array, *, cutoff_um: float) -> Array:
    """High-pass a series: what :func:`slow_part` leaves; arguments as there."""
    return values - slow_part(at_um, values, cutoff_um=cutoff_um)
