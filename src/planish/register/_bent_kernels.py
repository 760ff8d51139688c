# pyright: standard
"""Compiled sums of thin-plate kernels: no table of distances, one logarithm a point and node."""

import numpy as np

from planish.core.jit import njit


@njit(cache=True, nogil=True)
def add_thin_plate(at, nodes, bend, out):
    """Add ``sum_i r_i**2 log(r_i) bend_i`` at points ``at`` (n, 2) to ``out`` (n, 2).

    R_i: distance from node i.
    """
    for k in range(at.shape[0]):
        x = at[k, 0]
        y = at[k, 1]
        u = 0.0
        v = 0.0
        for i in range(nodes.shape[0]):
            dx = x - nodes[i, 0]
            dy = y - nodes[i, 1]
            square = dx * dx + dy * dy
            if square > 0.0:
                value = 0.5 * square * np.log(square)
                u += value * bend[i, 0]
                v += value * bend[i, 1]
            elif square != square:
                u = v = np.nan
        out[k, 0] += u
        out[k, 1] += v
