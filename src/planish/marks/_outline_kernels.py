# pyright: standard
"""A round outline fitted to radii at equal angles: numpy and numba only, arrays in, arrays out."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def _solve(matrix, right):
    """Solve a small symmetric positive system by Gauss elimination; returns zeros where it is singular."""
    n = matrix.shape[0]
    a = np.empty((n, n + right.shape[1]))
    for r in range(n):  # element by element: an assignment of slices takes seconds to compile
        for k in range(n):
            a[r, k] = matrix[r, k]
        for k in range(right.shape[1]):
            a[r, n + k] = right[r, k]
    for c in range(n):
        best = c
        for r in range(c + 1, n):
            if abs(a[r, c]) > abs(a[best, c]):
                best = r
        if abs(a[best, c]) < 1e-12:
            return np.zeros(right.shape)
        if best != c:
            for k in range(a.shape[1]):
                a[c, k], a[best, k] = a[best, k], a[c, k]
        for r in range(n):
            if r != c:
                f = a[r, c] / a[c, c]
                for k in range(c, a.shape[1]):
                    a[r, k] -= f * a[c, k]
    out = np.empty(right.shape)
    for c in range(n):
        for k in range(right.shape[1]):
            out[c, k] = a[c, n + k] / a[c, c]
    return out


@njit(cache=True, nogil=True)
def fit_outline(radii, order, least_scale):
    """Fit ``r0 + a cos + b sin (+ c cos 2 + d sin 2)`` to radii at equal angles, with Tukey weights.

    NaN radii are left out. Returns coefficients ``(2 order + 1,)``, weights ``(n,)``, the robust scale, and the inverse
    normal matrix. All weights are zero if fewer than a third of the radii are there.
    """
    n, terms = radii.shape[0], 2 * order + 1
    weight = np.zeros(n)
    coefficients = np.zeros(terms)
    inverse = np.zeros((terms, terms))
    there = 0
    for k in range(n):
        if radii[k] == radii[k]:
            there += 1
    if 3 * there < n:
        return coefficients, weight, np.inf, inverse
    values = np.empty(there)
    there = 0
    for k in range(n):
        if radii[k] == radii[k]:
            values[there] = radii[k]
            there += 1
    basis = np.empty((n, terms))
    for k in range(n):
        angle = 2 * np.pi * k / n
        basis[k, 0] = 1.0
        for o in range(1, order + 1):
            basis[k, 2 * o - 1] = np.cos(o * angle)
            basis[k, 2 * o] = np.sin(o * angle)
    coefficients[0] = np.median(values)
    scale = 0.0
    errors = np.empty(there)
    for turn in range(8):
        there = 0
        for k in range(n):
            if radii[k] == radii[k]:
                model = 0.0
                for c in range(terms):
                    model += coefficients[c] * basis[k, c]
                errors[there] = abs(radii[k] - model)
                there += 1
        scale = max(1.4826 * np.median(errors), least_scale)
        matrix = np.zeros((terms, terms))
        right = np.zeros((terms, 1 + terms))
        total = 0.0
        for k in range(n):
            weight[k] = 0.0
            if radii[k] == radii[k]:
                model = 0.0
                for c in range(terms):
                    model += coefficients[c] * basis[k, c]
                u = (radii[k] - model) / (4.685 * scale)
                if abs(u) < 1.0:
                    weight[k] = (1 - u * u) ** 2
                    total += weight[k]
                    for c in range(terms):
                        right[c, 0] += weight[k] * basis[k, c] * radii[k]
                        for e in range(terms):
                            matrix[c, e] += weight[k] * basis[k, c] * basis[k, e]
        if total < 0.2 * n:
            weight[:] = 0.0
            return coefficients, weight, np.inf, inverse
        for c in range(terms):
            right[c, 1 + c] = 1.0
        solution = _solve(matrix, right)
        change = abs(solution[0, 0] - coefficients[0])
        for c in range(terms):
            coefficients[c] = solution[c, 0]
            for e in range(terms):
                inverse[c, e] = solution[c, 1 + e]
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
