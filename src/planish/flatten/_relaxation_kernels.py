# pyright: standard
"""Compiled passes of the dynamic relaxation of Hirn et al. (2009), section 2.3.2.

All arrays have a frame of one missing node around the mesh, so that no loop asks whether a
neighbour exists. ``x``, ``v``, ``f`` (2, rows + 2, cols + 2) are positions, velocities and forces,
0 where there is no node. ``rest`` and ``stiff`` (4, rows + 2, cols + 2) are lengths and constants
of the springs from a node to the right, downwards, and along both diagonals of the cell that it
opens; a missing spring has the constant 0. ``side`` (4, rows + 2, cols + 2) weighs the differences
to the neighbours right, left, below, above: a half, 1 if the opposite is missing, 0 if it is.

Loops over rows are without branches and sums, to be vectorised: sums and maxima are collected by
column first.
"""

from math import sqrt

import numpy as np

from planish.core.jit import njit

_TINY = 1e-200  # a spring of no length has no direction: it pulls nowhere instead of to infinity


# By numpy's rules a division is not watched for zero; the watch would keep the loop from being
# vectorised.
@njit(cache=True, nogil=True, error_model="numpy")
def _pull(ax, ay, bx, by, rest, stiff, tx, ty, energy):
    """Set (tx, ty) to the force of springs on their ends a, and add k (l - L)^2 to energy (Eqs.

    1 and 2).
    """
    for j in range(rest.size - 1):
        dx = bx[j] - ax[j]
        dy = by[j] - ay[j]
        length = sqrt(max(dx * dx + dy * dy, _TINY))
        stretch = length - rest[j]
        tension = stiff[j] * stretch
        energy[j] += tension * stretch
        tension /= length
        tx[j] = tension * dx
        ty[j] = tension * dy


@njit(cache=True, nogil=True)
def set_force(x, rest, stiff, f):
    """Set f to the springs' forces at x.

    Return the energy, sum of k (l - L)^2 (Eq. 1), and the largest force. Each row computes the
    springs that it holds; those to the next row are kept for it in ``pulls``.
    """
    rows, cols = x.shape[1], x.shape[2]
    pulls = np.zeros((2, 4, 2, cols))
    energy = np.zeros(cols)
    largest = np.zeros(cols)
    for i in range(1, rows - 1):
        here, above = pulls[i % 2], pulls[1 - i % 2]
        # One call for all: each would be compiled into this function once more.
        for family in range(4):
            at = 1 if family == 3 else 0
            to = 1 if family == 0 or family == 2 else 0
            row = i if family == 0 else i + 1
            ax, ay = x[0, i, at:], x[1, i, at:]
            bx, by = x[0, row, to:], x[1, row, to:]
            tx, ty = here[family, 0], here[family, 1]
            _pull(ax, ay, bx, by, rest[family, i], stiff[family, i], tx, ty, energy)
        for axis in range(2):
            out = f[axis, i]
            right, down = here[0, axis], here[1, axis]
            falling, rising = here[2, axis], here[3, axis]
            down_, falling_, rising_ = above[1, axis], above[2, axis], above[3, axis]
            for j in range(1, cols - 1):
                out[j] = (right[j] - right[j - 1]) + (down[j] - down_[j])
                out[j] += (falling[j] - falling_[j - 1]) + (rising[j - 1] - rising_[j])
        fx, fy = f[0, i], f[1, i]
        for j in range(cols):
            square = fx[j] * fx[j] + fy[j] * fy[j]
            largest[j] = max(largest[j], square)
    return energy.sum(), sqrt(largest.max())


@njit(cache=True, nogil=True)
def mix(v, keep, f, push, side, out):
    """Set out to keep v + push f.

    These are velocities after a step: ``keep`` is what damping leaves of them, ``push`` the time in
    which the force acts. Return the largest Frobenius norm of the gradient, the largest length, and
    the sum of the lengths.
    """
    rows, cols = v.shape[1], v.shape[2]
    steep = np.zeros(cols)
    fastest = np.zeros(cols)
    total = np.zeros(cols)
    for i in range(1, rows):
        if i < rows - 1:
            for axis in range(2):
                to, one, two = out[axis, i], v[axis, i], f[axis, i]
                for j in range(cols):
                    to[j] = keep * one[j] + push * two[j]
            ox, oy = out[0, i], out[1, i]
            for j in range(cols):
                square = ox[j] * ox[j] + oy[j] * oy[j]
                fastest[j] = max(fastest[j], square)
                total[j] += sqrt(square)
        if i > 1:  # the row above now has both of its neighbours
            _steepen(out, side, i - 1, steep)
    return sqrt(steep.max()), sqrt(fastest.max()), total.sum()


@njit(cache=True, nogil=True)
def _steepen(v, side, i, steep):
    """Raise steep to the squared norm of the gradient of v in row i.

    The gradient is a (2, 2) matrix: of both components of v, along x (across) and y (down).
    """
    ax, x, bx = v[0, i - 1], v[0, i], v[0, i + 1]
    ay, y, by = v[1, i - 1], v[1, i], v[1, i + 1]
    right, left = side[0, i], side[1, i]
    below, above = side[2, i], side[3, i]
    for j in range(1, x.size - 1):
        xx = right[j] * (x[j + 1] - x[j]) + left[j] * (x[j] - x[j - 1])
        yx = right[j] * (y[j + 1] - y[j]) + left[j] * (y[j] - y[j - 1])
        xy = below[j] * (bx[j] - x[j]) + above[j] * (x[j] - ax[j])
        yy = below[j] * (by[j] - y[j]) + above[j] * (y[j] - ay[j])
        square = (xx * xx + yx * yx) + (xy * xy + yy * yy)
        steep[j] = max(steep[j], square)
