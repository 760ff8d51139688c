# pyright: standard
"""Cubic convolution, compiled: values between the nodes of a lattice from four by four of them.

A straight line between two nodes takes a fifth off a wave that is four nodes long, cubic
convolution 6 %. It is exact for polynomials of the second degree (Keys 1981,
doi:10.1109/TASSP.1981.1163711).
"""

import numpy as np

from planish.core.jit import njit


@njit(cache=True, nogil=True)
def cubic_weights(share):
    """Weights of four nodes in a row, for a place between the second and the third.

    ``share``: how much of the way to the third it lies. The weights sum to 1.
    """
    rest = 1.0 - share
    first = -0.5 * share * rest**2
    second = 1.0 + share**2 * (1.5 * share - 2.5)
    third = 1.0 + rest**2 * (1.5 * rest - 2.5)
    fourth = -0.5 * rest * share**2
    return first, second, third, fourth


@njit(cache=True, nogil=True)
def cubic_value(field, row, col, row_share, col_share):
    """Value of a field (rows, cols) between its nodes.

    ``row``, ``col``             : the node before the place
    ``row_share``, ``col_share`` : the place's share of the way to the next node, 0 to 1

    NaN where one of the four by four nodes around the place is missing, infinite or beyond the
    field's border. The value never leaves the range of these nodes: a coating beside a bare spot
    does not become thinner than nothing.
    """
    rows, cols = field.shape
    if row < 1 or col < 1 or row > rows - 3 or col > cols - 3:
        return np.nan
    row_weights = cubic_weights(row_share)
    col_weights = cubic_weights(col_share)
    total = 0.0
    lowest = np.inf
    highest = -np.inf
    for k in range(4):
        in_row = 0.0
        for m in range(4):
            node = field[row - 1 + k, col - 1 + m]
            lowest = min(lowest, node)
            highest = max(highest, node)
            in_row += col_weights[m] * node
        total += row_weights[k] * in_row
    if not np.isfinite(total):
        return np.nan
    return min(max(total, lowest), highest)
