# pyright: standard
"""Compiled crossings of a polygon's border with the rows of a grid."""

import numpy as np

from planish.core.jit import njit


@njit(cache=True, nogil=True)
def flip_crossings(ring, y, x, odd):
    """Flip ``odd`` (rows, cols + 1) where the border ``ring`` (n, 2: x, y) crosses a row.

    A crossing is noted in the first column that does not lie left of it. A row crosses an edge from
    its upper end, which counts, to its lower end, which does not: a point that two edges share
    counts once.
    """
    for k in range(ring.shape[0]):
        xa = ring[k - 1, 0]
        ya = ring[k - 1, 1]
        xb = ring[k, 0]
        yb = ring[k, 1]
        if ya > yb:
            xa, ya, xb, yb = xb, yb, xa, ya
        for i in range(np.searchsorted(y, ya), np.searchsorted(y, yb)):
            # The product first: it is exact for places with few digits, and so is a crossing in a
            # pixel's centre.
            at = xa + (y[i] - ya) * (xb - xa) / (yb - ya)
            j = np.searchsorted(x, at)
            odd[i, j] = not odd[i, j]
