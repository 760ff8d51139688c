# pyright: standard
"""A round outline fitted to radii at equal angles: numpy and numba only, arrays in, arrays out."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def fit_outline(radii, order, least_scale):
    """Fit ``r0 + a cos + b sin (+ c cos 2 + d sin 2)`` to radii at equal angles, with Tukey weights.

    NaN radii are left out. Returns coefficients ``(2 order + 1,)``, weights ``(n,)``, the robust scale, and the inverse
    normal matrix. All weights are zero if fewer than a third of the radii are there.
    """
    n, terms = radii.shape[0], 2 * order + 1
    weight, error = np.zeros(n), np.empty(n)
    coefficients = np.zeros(terms)
    inverse = np.zeros((terms, terms))
    if 3 * np.sum(np.isfinite(radii)) < n:
        return coefficients, weight, np.inf, inverse
    basis = np.ones((n, terms))
    for k in range(n):
        for o in range(1, order + 1):
            basis[k, 2 * o - 1] = np.cos(o * (2 * np.pi * k / n))
            basis[k, 2 * o] = np.sin(o * (2 * np.pi * k / n))
    coefficients[0] = np.nanmedian(radii)
    scale = 0.0
    for turn in range(8):
        for k in range(n):
            model = 0.0
            for c in range(terms):
                model += coefficients[c] * basis[k, c]
            error[k] = radii[k] - model
        scale = max(1.4826 * np.nanmedian(np.abs(error)), least_scale)
        # Normal matrix, right side and unit matrix.
        system = np.zeros((terms, 2 * terms + 1))
        total = 0.0
        for k in range(n):
            u = error[k] / (4.685 * scale)
            weight[k] = (1 - u * u) ** 2 if abs(u) < 1.0 else 0.0
            if weight[k] > 0.0:
                total += weight[k]
                for c in range(terms):
                    system[c, terms] += weight[k] * basis[k, c] * radii[k]
                    for e in range(terms):
                        system[c, e] += weight[k] * basis[k, c] * basis[k, e]
        if total < 0.2 * n:
            weight[:] = 0.0
            return coefficients, weight, np.inf, inverse
        # Gauss and Jordan without a search for pivots: with so much weight the matrix is positive definite.
        for c in range(terms):
            system[c, terms + 1 + c] = 1.0
        for c in range(terms):
            for r in range(terms):
                f = system[r, c] / system[c, c]
                if r != c:
                    for k in range(c, 2 * terms + 1):
                        system[r, k] -= f * system[c, k]
        change = abs(system[0, terms] / system[0, 0] - coefficients[0])
        for c in range(terms):
            coefficients[c] = system[c, terms] / system[c, c]
            for e in range(terms):
                inverse[c, e] = system[c, terms + 1 + e] / system[c, c]
        if turn > 1 and change < 1e-4 * scale:
            break
    return coefficients, weight, scale, inverse


@njit(cache=True, nogil=True)
def waves(error, weight):
    """Return the variances of one amplitude of the waves around a rim: of the third and fourth, of the fifth to eighth.

    ``error`` (n,) at equal angles, counted where ``weight`` is not 0.
    """
    rays = error.shape[0]
    low, high = 0.0, 0.0
    for order in range(3, 9):
        a, b, n = 0.0, 0.0, 0
        for k in range(rays):
            if weight[k] > 0.0:
                angle = 2 * np.pi * order * k / rays
                a += error[k] * np.cos(angle)
                b += error[k] * np.sin(angle)
                n += 1
        # Missing rays take as much from the sum as from the variance of a rough rim.
        power = 0.5 * (a * a + b * b) * 4 / (max(n, 1) * rays)
        if order < 5:
            low += power / 2
        else:
            high += power / 4
    return low, high
