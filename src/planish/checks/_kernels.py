# pyright: standard
"""Compiled inner loops of the checks: sums over pairs of neighbouring slices."""

import numpy as np

from planish.core.jit import njit


@njit(cache=True, nogil=True)
def add_slices(part, block, skip, square, product, sums):  # noqa: C901
    """Add what a part of a window, (slices, rows, cols) float32, tells of how slices differ.

    block   : voxels along the edge of a block
    skip    : first slices that belong to the part before
    square  : (slices - 1,), sums of (a[k + 1] - a[k])²; added to
    product : (slices - 2,), sums of (a[k + 1] - a[k]) (a[k + 2] - a[k + 1]); added to
    sums    : (slices - skip, block rows, block cols), over the blocks; added to. What is left over
    at the far ends is
              left out
    """
    slices, rows, cols = part.shape
    across = sums.shape[2]
    # Sums by column first: these loops have no order to keep, so that several columns are worked on
    # at a time.
    for k in range(slices - 1):
        squares = np.zeros(cols, dtype=np.float32)
        products = np.zeros(cols, dtype=np.float32)
        last = k + 2 == slices
        for i in range(rows):
            one, two = part[k, i], part[k + 1, i]
            three = two if last else part[k + 2, i]
            for j in range(cols):
                u = two[j] - one[j]
                squares[j] += u * u
                products[j] += u * (three[j] - two[j])
        for j in range(cols):
            square[k] += squares[j]
        if not last:
            for j in range(cols):
                product[k] += products[j]
    total = np.empty(across * block, dtype=np.float32)
    for k in range(skip, slices):
        for b in range(sums.shape[1]):
            total[:] = 0
            for i in range(b * block, (b + 1) * block):
                row = part[k, i]
                for j in range(total.size):
                    total[j] += row[j]
            for j in range(total.size):
                sums[k - skip, b, j // block] += total[j]
