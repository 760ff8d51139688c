# pyright: standard
"""Compiled passes of the multigrid solver over a padded grid of springs.

Every array is padded by one and may be wider than the grid: node (i, j) is at [1 + i, 1 + j]. Unit:
the mean pitch.

- ``xy`` (2, rows + 2, width) float64: places in the plane. Where there is no node both are ``FAR``:
  in float32 the square of a distance to it overflows to infinity, so that such a spring pulls
  nowhere without being asked for.
- ``rest`` (4, ...) float64: rest lengths of the springs (i, j)-(i, j + 1), (i, j)-(i + 1, j), (i,
  j)-(i + 1, j + 1) and (i, j + 1)-(i + 1, j), in this order and at [1 + i, 1 + j]; 0 where there is
  no spring.
- ``stiff`` (4, ...) float32: their stiffness; with a single row that stands for all of them where
  every spring has 1.
- ``near`` (2, ...) float32: ``xy`` once more, for the directions in the preconditioner, which need
  no more digits.
- ``move``, ``force`` (2, ...) float32: a correction of the places, and what it has to balance.
- ``ease`` (...) float32: one over the largest eigenvalue of a node's own 2 x 2 stiffness, 0 where
  there is no node.

A pass works on the rows r0 <= i < r1 of the padded arrays and writes to these alone; what it writes
does not depend on how the rows are shared among threads. Each pair of rows is visited once: the
springs' scalars go to row buffers, then the nodes collect them. ``fastmath`` is limited to
contracting and to the sign of zero, which leaves infinities alone.
"""

import math

import numpy as np

from planish.core.jit import njit

FAR = 1e30
GONE = 1e29
_NONE = np.float32(0.0)
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_TINY = np.float32(1e-30)
_FAINT = np.float32(1e-12)
# Kinds of start of ``smooth``, and the first row; numbers written in a call are types: the callee
# is compiled again.
_NEW = np.int64(0)
_CORRECTED = np.int64(1)
_FIRST = np.int64(1)
_SETTINGS = {"nogil": True, "cache": True, "error_model": "numpy", "fastmath": {"contract", "nsz"}}
_SUMS = {**_SETTINGS, "fastmath": {"contract", "nsz", "reassoc"}}
# A loop is vectorised only where its row buffers are seen to overlap nothing: inside the function
# that made them.
_INNER = {**_SETTINGS, "forceinline": True}
_INNER_SUMS = {**_SUMS, "forceinline": True}


@njit(**_INNER)
def _of_springs(values, i):
    """Row i of the four families of springs; the only one where one row stands for all."""
    s = min(i, values.shape[1] - 1)
    return values[0, s], values[1, s], values[2, s], values[3, s]


@njit(**_INNER)
def _square(dx, dy):
    return dx * dx + dy * dy + _TINY


@njit(**_INNER)
def _pull(k, dx, dy, du, dv):
    return k * (dx * du + dy * dv) / _square(dx, dy)


@njit(**_INNER)
def _pulls(x, y, i, stiff, ua, va, ub, vb, t0, t1, t2, t3, n):
    """Set t to k d.(du) / |d|^2 for the springs within row i and between the rows i and i + 1.

    ``ua, va`` and ``ub, vb`` are a correction of both rows, d a spring's vector at the places ``x,
    y`` and du how the correction changes it; ``t0`` to ``t3`` belong to the four families.
    """
    xa, ya = x[i], y[i]
    xb, yb = x[i + 1], y[i + 1]
    k0, k1, k2, k3 = _of_springs(stiff, i)
    for j in range(n):
        a, b, u, v = xa[j], ya[j], ua[j], va[j]
        c, d, w, z = xb[j], yb[j], ub[j], vb[j]
        e, f, p, q = xa[j + 1], ya[j + 1], ua[j + 1], va[j + 1]
        t0[j] = _pull(k0[j], e - a, f - b, p - u, q - v)
        t1[j] = _pull(k1[j], c - a, d - b, w - u, z - v)
        t2[j] = _pull(k2[j], xb[j + 1] - a, yb[j + 1] - b, ub[j + 1] - u, vb[j + 1] - v)
        t3[j] = _pull(k3[j], c - e, d - f, w - p, z - q)


@njit(**_INNER)
def _collect(x, i, t0, t1, t2, t3, p1, p2, p3, out, n):
    """Sum of t times the difference of one coordinate to the eight neighbours, for row i.

    ``x`` is that coordinate of all nodes; ``t0`` to ``t3`` are of the springs that row i holds,
    ``p1`` to ``p3`` of those that the row above holds. Sets ``out`` (n + 2,), one component of
    minus the stiffness times the correction.
    """
    above = x[i - 1]
    here = x[i]
    below = x[i + 1]
    for j in range(1, n + 1):
        a = here[j]
        total = t0[j] * (here[j + 1] - a)
        total += t0[j - 1] * (here[j - 1] - a)
        total += t1[j] * (below[j] - a)
        total += p1[j] * (above[j] - a)
        total += t2[j] * (below[j + 1] - a)
        total += p2[j - 1] * (above[j - 1] - a)
        total += t3[j - 1] * (below[j - 1] - a)
        total += p3[j] * (above[j + 1] - a)
        out[j] = total


@njit(**_INNER_SUMS)
def _strain(dx, dy, rest, k):
    """Give k (1 - L / l) and k (l - L)^2.

    1 / l comes from single precision by one step of Newton's method, which doubles its 24 bits (to
    an error of some 1e-14) and spares the square root and the division, the slowest part of the
    pass.
    """
    square = dx * dx + dy * dy + 1e-30
    guess = np.float64(_ONE / np.sqrt(np.float32(square)))
    inverse = guess * (1.5 - 0.5 * square * guess * guess)
    strain = 1.0 - rest * inverse
    strain = strain if rest > 0.0 else 0.0
    stretch = strain * square * inverse
    return k * strain, k * stretch * stretch


@njit(**_INNER_SUMS)
def _tension(dx, dy, rest, k):
    """Give the pull of a spring, k (1 - L / l) d, and k (l - L)^2."""
    t, energy = _strain(dx, dy, rest, k)
    return t * dx, t * dy, energy


@njit(**_SUMS)
def forces(xy, rest, stiff, force, sums, n, r0, r1):
    """Set ``force`` to minus half the gradient of the spring energy.

    ``sums`` (rows + 2, 2) is set to the energy by rows. ``n`` are the columns of the grid, ``r0``
    to ``r1`` the rows of the padded arrays to work on. Each spring is computed once, by the row
    that holds it; what it does to the row below is passed on.
    """
    x, y = xy[0], xy[1]
    width = xy.shape[2]
    # Pulls of the springs to the right, down, down right, and (from the right neighbour) down left;
    # and what the row above has passed on. In arrays of their own, see _INNER.
    hx = np.zeros(width, np.float32)
    hy = np.zeros(width, np.float32)
    vx = np.zeros(width, np.float32)
    vy = np.zeros(width, np.float32)
    dx = np.zeros(width, np.float32)
    dy = np.zeros(width, np.float32)
    sx = np.zeros(width, np.float32)
    sy = np.zeros(width, np.float32)
    px = np.zeros(width, np.float32)
    py = np.zeros(width, np.float32)
    for i in range(r0 - 1, r1):
        xa, ya = x[i], y[i]
        xb, yb = x[i + 1], y[i + 1]
        l0, l1, l2, l3 = _of_springs(rest, i)
        k0, k1, k2, k3 = _of_springs(stiff, i)
        energy = 0.0
        for j in range(n + 1):
            a, b = xa[j], ya[j]
            hx[j], hy[j], e = _tension(xa[j + 1] - a, ya[j + 1] - b, l0[j], k0[j])
            energy += e
            vx[j], vy[j], e = _tension(xb[j] - a, yb[j] - b, l1[j], k1[j])
            energy += e
            dx[j], dy[j], e = _tension(xb[j + 1] - a, yb[j + 1] - b, l2[j], k2[j])
            energy += e
            sx[j], sy[j], e = _tension(xb[j] - xa[j + 1], yb[j] - ya[j + 1], l3[j], k3[j])
            energy += e
        if i >= r0:
            sums[i, 0] = energy
            f, g = force[0, i], force[1, i]
            for j in range(1, n + 1):
                f[j] = hx[j] - hx[j - 1] + vx[j] + dx[j] + sx[j - 1] - px[j]
                g[j] = hy[j] - hy[j - 1] + vy[j] + dy[j] + sy[j - 1] - py[j]
        for j in range(1, n + 1):
            px[j] = vx[j] + dx[j - 1] + sx[j]
            py[j] = vy[j] + dy[j - 1] + sy[j]


@njit(**_INNER)
def _add(t, dx, dy, axx, axy, ayy):
    # In this order: where there is no node t is 0 and the square of d would overflow.
    return axx + (t * dx) * dx, axy + (t * dx) * dy, ayy + (t * dy) * dy


@njit(**_SETTINGS)
def prepare(near, stiff, ease, n, r0, r1):
    """Set ``ease`` for the places ``near``; a node that no spring holds gets 0.

    It is one over the larger eigenvalue of the sum of k d d' / |d|^2 over the eight springs of a
    node.
    """
    x, y = near[0], near[1]
    b = np.zeros((8, near.shape[2]), dtype=np.float32)
    t0, t1, t2, t3 = b[0], b[1], b[2], b[3]
    p1, p2, p3, out = b[4], b[5], b[6], b[7]
    for i in range(r0 - 1, r1):
        xb, yb = x[i], y[i]
        xc, yc = x[i + 1], y[i + 1]
        k0, k1, k2, k3 = _of_springs(stiff, i)
        for j in range(n + 1):  # stiffness over squared length
            u, v = xb[j], yb[j]
            t0[j] = k0[j] / _square(xb[j + 1] - u, yb[j + 1] - v)
            t1[j] = k1[j] / _square(xc[j] - u, yc[j] - v)
            t2[j] = k2[j] / _square(xc[j + 1] - u, yc[j + 1] - v)
            t3[j] = k3[j] / _square(xc[j] - xb[j + 1], yc[j] - yb[j + 1])
        if i >= r0:
            xa, ya = x[i - 1], y[i - 1]
            for j in range(1, n + 1):
                left, right = j - 1, j + 1
                u, v = xb[j], yb[j]
                a, c, d = _add(t0[j], xb[right] - u, yb[right] - v, _NONE, _NONE, _NONE)
                a, c, d = _add(t0[left], xb[left] - u, yb[left] - v, a, c, d)
                a, c, d = _add(t1[j], xc[j] - u, yc[j] - v, a, c, d)
                a, c, d = _add(p1[j], xa[j] - u, ya[j] - v, a, c, d)
                a, c, d = _add(t2[j], xc[right] - u, yc[right] - v, a, c, d)
                a, c, d = _add(p2[left], xa[left] - u, ya[left] - v, a, c, d)
                a, c, d = _add(t3[left], xc[left] - u, yc[left] - v, a, c, d)
                a, c, d = _add(p3[j], xa[right] - u, ya[right] - v, a, c, d)
                half = _HALF * (a - d)
                largest = _HALF * (a + d) + math.sqrt(half * half + c * c)
                soft = _ONE / (largest + _TINY)
                out[j] = soft if largest > _FAINT else _NONE
            row = ease[i]
            for j in range(1, n + 1):
                row[j] = out[j]
        t1, p1 = p1, t1
        t2, p2 = p2, t2
        t3, p3 = p3, t3


@njit(**_INNER)
def _fresh(kind, coarse, u, v, force, ease, first, buffer, i, n):
    """Make row i, held in u and v, ready to be smoothed.

    By ``kind`` it starts from nothing with ``first`` times ease times force (0), takes on the
    correction of the ``coarse`` level, half-way between its nodes by their mean (1), or stays as it
    is (2). ``buffer`` is scratch for a row.
    """
    if kind == 0:
        f, g, d = force[0, i], force[1, i], ease[i]
        for j in range(1, n + 1):
            w = first * d[j]
            u[j] = w * f[j]
            v[j] = w * g[j]
    elif kind == 1:
        up = (i - 1) // 2 + 1
        for c in range(2):
            a, b, fine = coarse[c, up], coarse[c, up + (i - 1) % 2], u if c == 0 else v
            for j in range(1, n // 2 + 3):
                buffer[j] = _HALF * (a[j] + b[j])
            for j in range((n + 1) // 2):
                fine[2 * j + 1] += buffer[j + 1]
            for j in range(n // 2):
                fine[2 * j + 2] += _HALF * (buffer[j + 1] + buffer[j + 2])


@njit(**_SETTINGS)
def smooth(kind, near, stiff, ease, force, coarse, move, edge, first, weight, n, r0, r1):
    """Smooth by ``move`` += weight * ease * (force - H move).

    H is the Gauss-Newton matrix at ``near``.

    ``kind`` 0 starts with move = first * ease * force, 1 adds the interpolated ``coarse`` before, 2
    takes it as it is. ``edge`` (2, 2, width) holds the rows r0 - 1 and r1 of ``move`` as they were
    before any thread began.
    """
    x, y = near[0], near[1]
    b = np.zeros((10, near.shape[2]), dtype=np.float32)
    t0, t1, t2, t3 = b[0], b[1], b[2], b[3]
    p1, p2, p3 = b[4], b[5], b[6]
    gx, gy, buffer = b[7], b[8], b[9]
    # The rows beyond the border belong to other threads (or to the padding): made ready in copies
    # of our own.
    above_u, above_v = edge[0, 0], edge[1, 0]
    ua, va = above_u, above_v
    last = near.shape[1] - 1
    for i in range(r0 - 2, r1):
        if i + 1 < r0:
            ub, vb = above_u, above_v
        elif i + 1 < r1:
            ub, vb = move[0, i + 1], move[1, i + 1]
        else:
            ub, vb = edge[0, 1], edge[1, 1]
        if 0 < i + 1 < last:
            _fresh(kind, coarse, ub, vb, force, ease, first, buffer, i + 1, n)
        if i + 1 >= r0:
            _pulls(x, y, i, stiff, ua, va, ub, vb, t0, t1, t2, t3, n + 1)
            if i >= r0:
                _collect(x, i, t0, t1, t2, t3, p1, p2, p3, gx, n)
                _collect(y, i, t0, t1, t2, t3, p1, p2, p3, gy, n)
                f, g, d = force[0, i], force[1, i], ease[i]
                for j in range(1, n + 1):
                    w = weight * d[j]
                    ua[j] += w * (f[j] + gx[j])
                    va[j] += w * (g[j] + gy[j])
            t1, p1 = p1, t1
            t2, p2 = p2, t2
            t3, p3 = p3, t3
        ua, va = ub, vb


@njit(**_SETTINGS)
def restrict(near, stiff, force, move, coarse_force, n, coarse_n, r0, r1):
    """Set ``coarse_force`` to what ``move`` leaves unbalanced.

    This is done by the transpose of bilinear interpolation: a coarse node gets the rest of its own
    fine node, half of that of the four beside it and a quarter of that of the four diagonal ones.
    ``n`` and ``coarse_n`` are the columns of both grids, ``r0`` to ``r1`` rows of the coarse one.
    """
    x, y = near[0], near[1]
    width = near.shape[2]
    b = np.zeros((9, width), dtype=np.float32)
    t0, t1, t2, t3 = b[0], b[1], b[2], b[3]
    p1, p2, p3 = b[4], b[5], b[6]
    gx, gy = b[7], b[8]
    sum_x = np.zeros(width + 2, np.float32)
    sum_y = np.zeros(width + 2, np.float32)
    rows = near.shape[1] - 2
    # Fine rows of the coarse row r0 - 1 + 1: from the odd one above it to the odd one below.
    start = max(1, 2 * (r0 - 1))
    for i in range(start - 1, min(rows, 2 * (r1 - 1)) + 1):
        ua, va = move[0, i], move[1, i]
        ub, vb = move[0, i + 1], move[1, i + 1]
        _pulls(x, y, i, stiff, ua, va, ub, vb, t0, t1, t2, t3, n + 1)
        if i >= start:
            _collect(x, i, t0, t1, t2, t3, p1, p2, p3, gx, n)
            _collect(y, i, t0, t1, t2, t3, p1, p2, p3, gy, n)
            f, g = force[0, i], force[1, i]
            share = _ONE if i % 2 == 1 else _HALF
            for j in range(1, n + 1):
                gx[j] += f[j]
                gy[j] += g[j]
                sum_x[j] += share * gx[j]
                sum_y[j] += share * gy[j]
            if i % 2 == 0:
                if i // 2 >= r0:
                    _narrow(sum_x, coarse_force[0, i // 2], coarse_n)
                    _narrow(sum_y, coarse_force[1, i // 2], coarse_n)
                for j in range(1, n + 1):
                    sum_x[j] = _HALF * gx[j]
                    sum_y[j] = _HALF * gy[j]
        t1, p1 = p1, t1
        t2, p2 = p2, t2
        t3, p3 = p3, t3
    if rows < 2 * (r1 - 1):
        # The last coarse row lies on the last fine one, or one beyond it.
        _narrow(sum_x, coarse_force[0, r1 - 1], coarse_n)
        _narrow(sum_y, coarse_force[1, r1 - 1], coarse_n)


@njit(**_INNER)
def _narrow(total, coarse, coarse_n):
    coarse[1] = total[1] + _HALF * total[2]
    for j in range(1, coarse_n):
        coarse[j + 1] = total[2 * j + 1] + _HALF * (total[2 * j] + total[2 * j + 2])


@njit(**_SUMS)
def advance(xy, near, move, force, sums, n, r0, r1):
    """Move the nodes by ``move``.

    Both ``xy`` and its copy ``near`` in single precision. ``sums`` (rows + 2, 2) by rows: force
    times move, and move squared.
    """
    for i in range(r0, r1):
        work = square = 0.0
        for c in range(2):
            place, short, step, pull = xy[c, i], near[c, i], move[c, i], force[c, i]
            for j in range(1, n + 1):
                e = float(step[j])
                place[j] += e
                short[j] = place[j]
                work += e * pull[j]
                square += e * e
        sums[i, 0], sums[i, 1] = work, square


@njit(**_INNER)
def least_area(side, px, py, qx, qy, sx, sy):
    """Smaller of the doubled areas of a cell's triangles, with the sign of ``side``.

    From the first corner, p, q and s lead to the others around the cell.
    """
    return min(side * (px * qy - py * qx), side * (qx * sy - qy * sx))


@njit(**_SUMS)
def survey(xy, rest, stiff, side, sums, n, r0, r1):
    """Set ``sums`` (rows + 2, 2) by rows: spring energy, and cells that are not upright.

    A cell with all its springs is upright if the signed areas of its triangles (a, b, c) and (a, c,
    d) have the sign of ``side``, the corners a, b, c, d being (i, j), (i, j + 1), (i + 1, j + 1),
    (i + 1, j).
    """
    x, y = xy[0], xy[1]
    for i in range(r0, r1):
        xa, ya = x[i], y[i]
        xb, yb = x[i + 1], y[i + 1]
        l0, l1, right, left = _of_springs(rest, i)
        k0, k1, k2, k3 = _of_springs(stiff, i)
        energy = 0.0
        down = 0.0
        for j in range(n + 1):
            a, b = xa[j], ya[j]
            px, py = xa[j + 1] - a, ya[j + 1] - b
            qx, qy = xb[j + 1] - a, yb[j + 1] - b
            sx, sy = xb[j] - a, yb[j] - b
            energy += _strain(px, py, l0[j], k0[j])[1]
            energy += _strain(sx, sy, l1[j], k1[j])[1]
            energy += _strain(qx, qy, right[j], k2[j])[1]
            energy += _strain(xb[j] - xa[j + 1], yb[j] - ya[j + 1], left[j], k3[j])[1]
            turned = 0.0 if least_area(side, px, py, qx, qy, sx, sy) > 0.0 else 1.0
            down += turned if min(right[j], left[j]) > 0.0 else 0.0
        sums[i, 0] = energy
        sums[i, 1] = down


@njit(**_SETTINGS)
def descend(
    near, stiff, ease, force, move, alone, cols, last, inverse, row, col, first, second, once
):
    """One V-cycle over levels small enough for one thread: corrects ``move[0]`` for ``force[0]``.

    The first seven are tuples over the levels, finest first. The coarsest level, number ``last``,
    is solved by ``inverse`` (2 nodes, 2 nodes), the nodes standing at [row, col] of its arrays.
    """
    for k in range(last):
        end = near[k].shape[1] - 1
        fixed = near[k], stiff[k], ease[k], force[k]
        smooth(_NEW, *fixed, move[k], move[k], alone[k], first, second, cols[k], _FIRST, end)
        end = near[k + 1].shape[1] - 1
        fine = near[k], stiff[k], force[k], move[k]
        restrict(*fine, force[k + 1], cols[k], cols[k + 1], _FIRST, end)
    f, u = force[last], move[last]
    for a in range(row.size):
        for axis in range(2):
            answers = inverse[2 * a + axis]
            total = 0.0
            for b in range(row.size):
                p, q = f[0, row[b], col[b]], f[1, row[b], col[b]]
                total += answers[2 * b] * p + answers[2 * b + 1] * q
            u[axis, row[a], col[a]] = total
    for k in range(last - 1, -1, -1):
        end = near[k].shape[1] - 1
        fixed = near[k], stiff[k], ease[k], force[k]
        moves = move[k + 1], move[k], alone[k]
        smooth(_CORRECTED, *fixed, *moves, once, once, cols[k], _FIRST, end)
