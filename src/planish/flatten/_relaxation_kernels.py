# pyright: standard
"""Compiled steps of the dynamic relaxation of Hirn et al. (2009), section 2.3.2.

All arrays have a frame of one missing node around the mesh, so that no loop asks whether a neighbour exists. ``x``,
``v``, ``f`` (2, rows + 2, cols + 2) are positions, velocities and forces, 0 where there is no node. ``rest`` and
``stiff`` (4, rows + 2, cols + 2) are lengths and constants of the springs from a node to the right, downwards, and
along both diagonals of the cell that it opens; a missing spring has the constant 0. ``side`` (4, rows + 2, cols + 2)
weighs the differences to the neighbours right, left, below and above: a half each, one where the opposite neighbour is
missing, nothing at a missing node.

Rows are worked through one after another in loops without branches and without sums over a row, which would keep them
from being vectorised: sums and maxima are collected by column first.
"""

from math import inf, isfinite, sqrt

import numpy as np
from numba import njit

_TINY = 1e-200  # a spring of no length has no direction: it pulls nowhere instead of to infinity

# What happens in a step, and how a block of steps ends.
SYMPLECTIC, RK4, EULER = 0, 1, 2
SCALE, FEEDBACK, FIXED = 0, 1, 2
FIRST, SUSTAINED, RESIDUAL = 0, 1, 2
GOING, RESTED, NOT_FINITE = 0, 1, 2

# Places in the array of the state.
DT, C, GRADIENT, TIME, LOW, ARMED, SIZE = 0, 1, 2, 3, 4, 5, 6


# By numpy's rules a division is not watched for zero; the watch would keep the loop from being vectorised.
@njit(cache=True, nogil=True, error_model="numpy")
def _pull(ax, ay, bx, by, rest, stiff, n, tx, ty, energy):
    """Set (tx, ty) to the force of n springs on their ends a, and add k (l - L)^2 to energy (Eqs. 1 and 2)."""
    for j in range(n):
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

    Returns
    -------
    float
        Energy: sum of k (l - L)^2 over all springs (Eq. 1).
    float
        Largest force on a node.
    """
    rows, cols = x.shape[1], x.shape[2]
    n = cols - 1
    pulls = np.zeros((2, 4, 2, cols))
    energy = np.zeros(cols)
    largest = np.zeros(cols)
    for i in range(1, rows - 1):
        here, above = pulls[i % 2], pulls[1 - i % 2]
        for family in range(4):  # one call for all: each would be compiled into this function once more
            at, to, row = 1 if family == 3 else 0, 1 if family == 0 or family == 2 else 0, i if family == 0 else i + 1
            _pull(x[0, i, at:], x[1, i, at:], x[0, row, to:], x[1, row, to:], rest[family, i], stiff[family, i], n,
                  here[family, 0], here[family, 1], energy)  # fmt: skip
        for axis in range(2):
            out = f[axis, i]
            right, down, falling, rising = here[0, axis], here[1, axis], here[2, axis], here[3, axis]
            down_, falling_, rising_ = above[1, axis], above[2, axis], above[3, axis]
            for j in range(1, n):
                out[j] = (right[j] - right[j - 1]) + (down[j] - down_[j])
                out[j] += (falling[j] - falling_[j - 1]) + (rising[j - 1] - rising_[j])
        fx, fy = f[0, i], f[1, i]
        for j in range(cols):
            largest[j] = max(largest[j], fx[j] * fx[j] + fy[j] * fy[j])
    return energy.sum(), sqrt(largest.max())


@njit(cache=True, nogil=True)
def mix(v, keep, f, push, side, out):
    """Set out to keep v + push f, and measure it.

    Returns
    -------
    float
        Largest Frobenius norm of the (2, 2) gradient in the mesh's own rows and columns.
    float
        Largest length of a node's vector.
    float
        Sum of the lengths.
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
            _steepen(out[0, i - 2], out[0, i - 1], out[0, i], out[1, i - 2], out[1, i - 1], out[1, i],
                     side[0, i - 1], side[1, i - 1], side[2, i - 1], side[3, i - 1], steep)  # fmt: skip
    return sqrt(steep.max()), sqrt(fastest.max()), total.sum()


@njit(cache=True, nogil=True)
def _steepen(ax, x, bx, ay, y, by, right, left, below, above, steep):
    """Raise steep to the squared norm of the gradient in the row (x, y) between the rows a and b."""
    for j in range(1, x.size - 1):
        xx = right[j] * (x[j + 1] - x[j]) + left[j] * (x[j] - x[j - 1])
        yx = right[j] * (y[j + 1] - y[j]) + left[j] * (y[j] - y[j - 1])
        xy = below[j] * (bx[j] - x[j]) + above[j] * (x[j] - ax[j])
        yy = below[j] * (by[j] - y[j]) + above[j] * (y[j] - ay[j])
        steep[j] = max(steep[j], (xx * xx + yx * yx) + (xy * xy + yy * yy))


@njit(cache=True, nogil=True)
def _add(base, much, more, out):
    """Set out to base + much more; out may be base."""
    for axis in range(2):
        for i in range(1, base.shape[1] - 1):
            one, two, to = base[axis, i], more[axis, i], out[axis, i]
            for j in range(base.shape[2]):
                to[j] = one[j] + much * two[j]


@njit(cache=True, nogil=True)
def _factors(integrator, dt, c):
    """Return keep and push of v' = keep v + push F."""
    if integrator == EULER:
        return 1.0 - c * dt, dt
    return 1.0 / (1.0 + c * dt), dt / (1.0 + c * dt)


@njit(cache=True, nogil=True)
def _runge_kutta(x, v, f, rest, stiff, dt, c, new):
    """Carry x on by dt with the classical method of fourth order, and v to new; f is the force at x."""
    place, speed, rate = np.zeros_like(x), np.zeros_like(x), np.zeros_like(x)
    x_new = np.zeros_like(x)
    _add(x, 0.0, x, place)
    _add(v, 0.0, v, speed)
    _add(x, 0.0, x, x_new)
    _add(v, 0.0, v, new)
    for stage in range(4):
        if stage > 0:
            set_force(place, rest, stiff, f)
        _add(f, -c, speed, rate)
        weight = dt / 6.0 if stage == 0 or stage == 3 else dt / 3.0
        _add(x_new, weight, speed, x_new)
        _add(new, weight, rate, new)
        reach = dt if stage == 2 else 0.5 * dt
        _add(x, reach, speed, place)
        _add(v, reach, rate, speed)
    _add(x_new, 0.0, x, x)


@njit(cache=True, nogil=True)
def steps(x, v, f, rest, stiff, side, nodes, state, kinds, rule, log):
    """Carry the mesh on by up to len(log) steps; x, v, f and state are changed in place.

    Parameters
    ----------
    nodes : int
        Number of nodes that exist.
    state : (6,)
        Time step, damping, largest velocity gradient, time, time since the mesh was last fast, whether it ever was.
    kinds : (integrator, control, stop)
    rule : (a, b, c_min, dt_max, c_fall, dt_cut, dt_grow, most_move, mean_speed, residual, period)
    log : (steps, 5)
        Filled with dt, c, gradient, mean speed, energy after each step.

    Returns
    -------
    int
        Steps made.
    int
        GOING, RESTED or NOT_FINITE.
    """
    integrator, control, stop = kinds
    a, b, c_min, dt_max, c_fall, dt_cut, dt_grow, most_move, mean_speed, residual, period = rule
    now, new = v, np.zeros_like(v)
    code, done = GOING, 0
    while done < log.shape[0] and code == GOING:
        dt, c, gradient = state[DT], state[C], state[GRADIENT]
        if control != FIXED:
            c = max(c_min, gradient / b, c_fall * c)
        if control == SCALE:
            dt = min(dt_max, a / gradient if gradient > 0.0 else inf)
        elif control == FEEDBACK:
            dt = dt * dt_cut if gradient >= a else min(dt_max, dt * dt_grow)
        keep, push = _factors(integrator, dt, c)
        gradient, fastest, total = mix(now, keep, f, push, side, new)
        if control == SCALE and dt * gradient > a:
            dt = a / gradient
            keep, push = _factors(integrator, dt, c)
            gradient, fastest, total = mix(now, keep, f, push, side, new)
        if control != FIXED and fastest * dt > most_move:
            dt *= most_move / (fastest * dt)
            keep, push = _factors(integrator, dt, c)
            gradient, fastest, total = mix(now, keep, f, push, side, new)
        if integrator == RK4:
            _runge_kutta(x, now, f, rest, stiff, dt, c, new)
            gradient, fastest, total = mix(new, 1.0, f, 0.0, side, new)
        else:
            _add(x, dt, now if integrator == EULER else new, x)
        energy, largest = set_force(x, rest, stiff, f)
        now, new = new, now
        speed = total / nodes
        state[DT], state[C], state[GRADIENT] = dt, c, gradient
        state[TIME] += dt
        log[done, 0], log[done, 1], log[done, 2], log[done, 3], log[done, 4] = dt, c, gradient, speed, energy
        done += 1
        if not isfinite(speed + energy):
            code = NOT_FINITE
        elif speed > mean_speed:
            state[ARMED], state[LOW] = 1.0, 0.0
        else:
            state[LOW] += dt
        # A mesh that has not been fast within a period of its slowest mode will never be.
        armed = state[ARMED] > 0.0 or state[TIME] >= period
        low = state[LOW]
        if code == GOING and (
            (stop == FIRST and armed and low > 0.0)
            or (stop == SUSTAINED and low >= period)
            or (stop == RESIDUAL and largest < residual)
        ):
            code = RESTED
    if done % 2 == 1:
        _add(now, 0.0, now, v)
    return done, code
