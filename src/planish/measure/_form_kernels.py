# pyright: standard
"""Compiled inner loop of the form of a face: local paraboloids over the sheet."""

import numpy as np

from planish.core.jit import njit

_TERMS = 6


@njit(cache=True, nogil=True)
def normal_equations(i, place, normal, weight, distance, reach, width_um, shape):
    """Matrices (cols, 6, 6) and right sides (cols, 6, k) of paraboloids about the nodes of row i.

    A paraboloid is fitted, with the weights exp(-pi (r / width_um)^2), to what lies ``distance``
    (rows, cols, k) above the nodes around its own along their unit vectors ``normal`` (rows, cols,
    3), um. It is fitted along the normal of its node, over lengths in the sheet, which are exact to
    third order where it is bent to a cylinder; the first of its terms is its height there.

    ``place`` (rows, cols, 3) um, of the nodes. ``weight`` (rows, cols): 0 where nothing is known.
    ``reach``: nodes along rows and columns. ``shape``: 1 for the places of points, 0 for lengths
    that the sheet carries, whose own shape is then left out.
    """
    rows, cols, kinds = distance.shape
    matrix = np.zeros((cols, _TERMS, _TERMS))
    right = np.zeros((cols, _TERMS, kinds))
    term = np.ones(_TERMS)
    for j in range(cols):
        n0, n1, n2 = normal[i, j]
        scale = 1 / (np.hypot(n1, n2) * width_um)
        upper = max(i - reach[0], 0)
        lower = min(i + reach[0] + 1, rows)
        left = max(j - reach[1], 0)
        right_end = min(j + reach[1] + 1, cols)
        for k in range(upper, lower):
            for m in range(left, right_end):
                if weight[k, m] == 0:
                    continue
                m0, m1, m2 = normal[k, m]
                d0 = place[k, m, 0] - place[i, j, 0]
                d1 = place[k, m, 1] - place[i, j, 1]
                d2 = place[k, m, 2] - place[i, j, 2]
                up = d0 * n0 + d1 * n1 + d2 * n2
                level = m0 * n0 + m1 * n1 + m2 * n2
                # The chord's part in the tangent plane is shorter than the way in the sheet.
                short = up / 3
                x = ((d1 - short * m1) * n2 - (d2 - short * m2) * n1) * scale
                y = (d0 - short * m0 - (up - short * level) * n0) * scale
                square = x * x + y * y
                # The weight there is 0.0009; it is not a number about a node outside the sheet.
                if not square < 2.25:
                    continue
                term[1:] = x, y, x * x, x * y, y * y
                w = weight[k, m] * np.exp(-np.pi * square)
                for p in range(_TERMS):
                    share = w * term[p]
                    for q in range(_TERMS):
                        matrix[j, p, q] += share * term[q]
                    for kind in range(kinds):
                        height = shape * up + level * distance[k, m, kind]
                        right[j, p, kind] += share * height
    return matrix, right
