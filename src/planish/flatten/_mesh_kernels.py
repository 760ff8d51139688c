# pyright: standard
"""Run compiled passes for the levels of a mesh, in the padded arrays of ``_kernels``.

They are for lengths, springs, places and folds.
"""

import math

import numpy as np

from planish.core.jit import njit
from planish.flatten._kernels import FAR, GONE, least_area

_SETTINGS = {"nogil": True, "cache": True, "error_model": "numpy", "fastmath": {"contract", "nsz"}}
_INNER = {**_SETTINGS, "forceinline": True}
_INNER_SUMS = {**_INNER, "fastmath": {"contract", "nsz", "reassoc"}}
# A spring is straightened by the curvatures at its two ends where these agree this well: |a - b| <=
# share |a + b|.
_AGREE = 0.5
# Differences of curvature that would change a rest length by less than this share do not count as
# disagreement.
_FAINT = 1e-6


@njit(**_INNER)
def _load(points, scale, i, row, n):
    """Copy row i of ``points`` (rows, n, 3), scaled, to ``row`` (3, n + 2).

    X is NaN beyond it or where not finite.
    """
    row[:] = np.nan
    if 0 <= i < points.shape[0]:
        for j in range(n):
            x, y, z = points[i, j, 0], points[i, j, 1], points[i, j, 2]
            row[0, j + 1] = scale * (x + (y - y) + (z - z))
            row[1, j + 1] = scale * y
            row[2, j + 1] = scale * z


@njit(**_INNER)
def _dot(ax, ay, az, bx, by, bz):
    return ax * bx + ay * by + az * bz


@njit(**_INNER)
def _chords(a, b, aj, bj, out, n):
    """Distance of the places a[:, j + aj] and b[:, j + bj] for j = 1 ... n.

    0 where one is missing.
    """
    ax, ay, az = a[0], a[1], a[2]
    bx, by, bz = b[0], b[1], b[2]
    for j in range(1, n + 1):
        dx = bx[j + bj] - ax[j + aj]
        dy = by[j + bj] - ay[j + aj]
        dz = bz[j + bj] - az[j + aj]
        long = math.sqrt(_dot(dx, dy, dz, dx, dy, dz))
        # Two nodes on one spot are tied by a spring of no length; 0 itself means that there is no
        # spring.
        long = 1e-200 if long <= 1e-200 else long
        out[j] = long if long < GONE else 0.0


@njit(**_INNER)
def _bend(a, b, c, out, n):
    """Normal second differences (curvature x step²) at row b, 4 directions, to ``out`` (4, n + 2).

    ``a``, ``b`` and ``c`` (3, n + 2) are the rows of points above, at and below. Directions as of
    the families of springs: along the row, down the column, falling and rising. NaN beside gaps.
    """
    ax, ay, az = a[0], a[1], a[2]
    bx, by, bz = b[0], b[1], b[2]
    cx, cy, cz = c[0], c[1], c[2]
    o0, o1, o2, o3 = out[0], out[1], out[2], out[3]
    for j in range(1, n + 1):
        i, k = j - 1, j + 1
        x, y, z = bx[j], by[j], bz[j]
        # Neighbours as seen from the node: left, right, up, down, and the diagonal ones.
        lx, ly, lz = bx[i] - x, by[i] - y, bz[i] - z
        rx, ry, rz = bx[k] - x, by[k] - y, bz[k] - z
        ux, uy, uz = ax[j] - x, ay[j] - y, az[j] - z
        dx, dy, dz = cx[j] - x, cy[j] - y, cz[j] - z
        # Tangents, one-sided where a neighbour is missing.
        px = _minus(rx, lx, rx, lx)
        py = _minus(ry, ly, rx, lx)
        pz = _minus(rz, lz, rx, lx)
        qx = _minus(dx, ux, dx, ux)
        qy = _minus(dy, uy, dx, ux)
        qz = _minus(dz, uz, dx, ux)
        nx = py * qz - pz * qy
        ny = pz * qx - px * qz
        nz = px * qy - py * qx
        unit = 1.0 / math.sqrt(_dot(nx, ny, nz, nx, ny, nz) + 1e-300)
        nx, ny, nz = nx * unit, ny * unit, nz * unit
        o0[j] = nx * (rx + lx) + ny * (ry + ly) + nz * (rz + lz)
        o1[j] = _dot(nx, ny, nz, dx + ux, dy + uy, dz + uz)
        x, y, z = 2 * x, 2 * y, 2 * z
        o2[j] = _dot(nx, ny, nz, cx[k] + ax[i] - x, cy[k] + ay[i] - y, cz[k] + az[i] - z)
        o3[j] = _dot(nx, ny, nz, cx[i] + ax[k] - x, cy[i] + ay[k] - y, cz[i] + az[k] - z)


@njit(**_INNER)
def _minus(a, b, has_a, has_b):
    """A - b, either counting as 0 where its ``has`` is NaN."""
    a = a if has_a == has_a else 0.0
    b = b if has_b == has_b else 0.0
    return a - b


@njit(**_INNER_SUMS)
def _mend(above, here, below, spare, n):  # noqa: C901
    """Give the bends ``here`` (4, n + 2), or in ``spare`` a copy with missing ones filled in.

    A missing bend is the mean of those around it.

    In a row without gaps only the outermost may be missing, for which the other end of each spring
    stands in.
    """
    total = 0.0
    for family in range(4):
        b = here[family]
        for j in range(2, n):
            total += b[j]
    if total == total and n > 3:
        return here
    for family in range(4):
        b, o = here[family], spare[family]
        o[0] = o[n + 1] = np.nan
        for j in range(1, n + 1):
            o[j] = b[j]
            if b[j] == b[j]:
                continue
            mean, count = 0.0, 0
            for k in range(j - 1, j + 2):
                if 1 <= k <= n:
                    for c in (above[family, k], b[k], below[family, k]):
                        if c == c:
                            mean += c
                            count += 1
            o[j] = mean / count if count > 0 else np.nan
    return spare


@njit(**_INNER_SUMS)
def _arcs(p, q, pj, qj, out, n):
    """Lengthen the chords ``out`` to arcs by the bends p[j + pj], q[j + qj] at their ends.

    A chord L gets a b / (24 L) more, a and b being the bends at its ends; one that is missing is
    that of the other end. Counts those left alone because a and b disagree.
    """
    left = 0.0
    for j in range(1, n + 1):
        a, b = p[j + pj], q[j + qj]
        a = a if a == a else b
        b = b if b == b else a
        long = out[j]
        fits = abs(a - b) <= _AGREE * abs(a + b)
        more = a * b / (24.0 * long)
        more = more if fits else 0.0
        more = more if long > 0.0 else 0.0
        out[j] = long + more
        doubt = 0.0 if max(a * a, b * b) <= 24.0 * _FAINT * long * long else 1.0
        doubt = 0.0 if fits else doubt
        left += doubt if long > 0.0 else 0.0
    return left


@njit(**_SETTINGS)
def rest_lengths(points, scale, arc, rest, counts, r0, r1):
    """Set ``rest`` for ``points`` (rows, n, 3), NaN where missing.

    ``counts`` (rows + 2, 2): springs, of them straight.

    With ``arc`` a chord L becomes L + (k L^2)^2 / (24 L) by the normal curvature k, the product of
    those at both ends; where they disagree the surface is rough at the mesh's scale, its curvature
    unknown, and the chord stays.
    """
    n = points.shape[1]
    # Row i of the padded arrays is row i - 1 of the points, and its springs lead to row i of them.
    # Rings of rows: the points up to i + 2, their bends up to i + 1, and the mended bends up to i.
    rows = np.empty((8, 3, n + 2))
    bends = np.full((4, 4, n + 2), np.nan)
    mended = np.empty((2, 4, n + 2))
    p = q = mended[0]
    for i in range(r0 - 5, r1):
        _load(points, scale, i + 2, rows[(i + 2) % 8], n)
        before, after = bends[(i - 1) % 4], bends[(i + 1) % 4]
        if arc and i >= r0 - 3:
            _bend(rows[i % 8], rows[(i + 1) % 8], rows[(i + 2) % 8], after, n)
        if arc and i >= r0 - 1:
            p = q
            q = _mend(before, bends[i % 4], after, mended[i % 2], n)
        if i < r0:
            continue
        here, there = rows[(i - 1) % 8], rows[i % 8]
        left = 0.0
        # One call for all: each would be compiled into this function once more.
        for family in range(4):
            at, to = 1 if family == 3 else 0, 1 if family == 0 or family == 2 else 0
            lengths = rest[family, i]
            _chords(here, here if family == 0 else there, at, to, lengths, n)
            if arc:
                far_bends = p if family == 0 else q
                left += _arcs(p[family], far_bends[family], at, to, lengths, n)
        springs = 0
        for family in range(4):
            for j in range(1, n + 1):
                springs += 1 if rest[family, i, j] > 0.0 else 0
        counts[i, 0], counts[i, 1] = springs, left


@njit(**_INNER)
def _lines(rest, stiff, family, i, total, length, n):
    long = rest[family, i]
    k = stiff[family, min(i, stiff.shape[1] - 1)]
    for j in range(1, n + 1):
        total[j] += k[j] if long[j] > 0.0 else 0.0
        length[j] += k[j] * long[j]


@njit(**_SETTINGS)
def coarsen(rest, stiff, coarse_rest, coarse_stiff, n, coarse_n, r0, r1):  # noqa: C901
    """Springs of the mesh of every second node, for the rows r0 <= i < r1 of its padded arrays.

    A coarse spring has the stiffness with which the fine ones near it resist an even stretch (each
    fine spring is shared out to the coarse ones around it by linear interpolation), so that borders
    and holes keep the strength that they have on the fine mesh, and twice their mean rest length.
    """
    last = rest.shape[1] - 2
    b = np.zeros((4, rest.shape[2] + 2))
    total, length, side_total, side_length = b[0], b[1], b[2], b[3]
    for i in range(r0, r1):
        y = 2 * i - 1
        for family in range(4):
            b[:] = 0.0
            if y <= last:
                _lines(rest, stiff, family, y, total, length, n)
            if family == 0:
                if 1 <= y - 1 <= last:
                    _lines(rest, stiff, family, y - 1, side_total, side_length, n)
                if y + 1 <= last:
                    _lines(rest, stiff, family, y + 1, side_total, side_length, n)
                for j in range(1, n + 1):
                    total[j] += 0.5 * side_total[j]
                    length[j] += 0.5 * side_length[j]
            elif y + 1 <= last:
                _lines(rest, stiff, family, y + 1, total, length, n)
            long, k = coarse_rest[family, i], coarse_stiff[family, i]
            for j in range(1, coarse_n + 1):
                x = 2 * j - 1
                if family == 1:
                    t = total[x] + 0.5 * (total[x - 1] + total[x + 1])
                    s = length[x] + 0.5 * (length[x - 1] + length[x + 1])
                else:
                    t = total[x] + total[x + 1]
                    s = length[x] + length[x + 1]
                k[j] = 0.25 * t
                long[j] = 2.0 * s / t if t > 0.0 else 0.0


@njit(**_SETTINGS)
def _between(a, b, c, d):
    """Interpolate the value half-way from b to c.

    a and d are the values before and after them, GONE or more where there is none. Cubic where a
    and d are known, quadratic with one of them, else linear.
    """
    if b >= GONE:
        return c
    if c >= GONE:
        return b
    if a < GONE and d < GONE:
        return 0.5625 * (b + c) - 0.0625 * (a + d)
    if a < GONE:
        return 0.75 * b + 0.375 * c - 0.125 * a
    if d < GONE:
        return 0.375 * b + 0.75 * c - 0.125 * d
    return 0.5 * (b + c)


@njit(**_INNER)
def _line(coarse, i, line, coarse_n):
    """Set ``line`` to the coarse places along the fine row i.

    ``coarse`` (rows + 2, width) is one coordinate; odd fine rows lie on a coarse one, even ones
    half-way between two.
    """
    last = coarse.shape[0] - 2
    up = (i - 1) // 2 + 1
    if i % 2 == 1:
        b = coarse[up]
        for j in range(1, coarse_n + 1):
            line[j] = b[j]
        return
    a = coarse[max(up - 1, 0)]
    b = coarse[up]
    c = coarse[up + 1]
    d = coarse[min(up + 2, last + 1)]
    for j in range(1, coarse_n + 1):
        line[j] = _between(a[j], b[j], c[j], d[j])


@njit(**_SETTINGS)
def interpolate(coarse, xy, near, n, coarse_n, r0, r1):
    """Fine places from every second node, cubic along rows and columns.

    ``coarse`` (2, ...) are the places of the coarse mesh; ``xy`` and its copy ``near`` are set.
    Where the fine mesh has gaps, FAR ones are the caller's.
    """
    for c in range(2):
        line = np.full(coarse_n + 3, FAR)
        for i in range(r0, r1):
            _line(coarse[c], i, line, coarse_n)
            place, short = xy[c, i], near[c, i]
            for j in range((n + 1) // 2):
                place[2 * j + 1] = line[j + 1]
            for j in range(n // 2):
                place[2 * j + 2] = _between(line[j], line[j + 1], line[j + 2], line[j + 3])
            for j in range(1, n + 1):
                short[j] = place[j]


@njit(**_SETTINGS)
def moments(target, scale, xy, sums, r0, r1):
    """Sum over the nodes, by rows, for the turn that lays ``xy`` on ``target``.

    ``xy`` is laid on the first two of ``target`` (rows, n, 2 or 3).

    ``sums`` (rows + 2, 7): count, u, v, p, q, u p + v q, u q - v p for places (u, v) and targets
    (p, q).
    """
    n = target.shape[1]
    for i in range(r0, r1):
        count = su = sv = sp = sq = dot = cross = 0.0
        for j in range(n):
            u, v = xy[0, i, j + 1], xy[1, i, j + 1]
            p, q = scale * target[i - 1, j, 0], scale * target[i - 1, j, 1]
            if u < GONE and p == p and q == q:
                count += 1.0
                su += u
                sv += v
                sp += p
                sq += q
                dot += u * p + v * q
                cross += u * q - v * p
        sums[i, 0], sums[i, 1], sums[i, 2], sums[i, 3] = count, su, sv, sp
        sums[i, 4], sums[i, 5], sums[i, 6] = sq, dot, cross


@njit(**_SETTINGS)
def lay_down(xy, cos, sin, shift_u, shift_v, scale, n, r0, r1):
    """Turn, shift and scale the places; NaN where there is no node."""
    for i in range(r0, r1):
        x, y = xy[0, i], xy[1, i]
        for j in range(1, n + 1):
            u, v = x[j], y[j]
            gone = np.nan if u >= GONE else 0.0
            x[j] = scale * (cos * u - sin * v + shift_u) + gone
            y[j] = scale * (sin * u + cos * v + shift_v) + gone


@njit(**_INNER)
def _moved(xy, move, share, by, i, j):
    step = by * share[i, j]
    u = xy[0, i, j] + step * move[0, i, j]
    v = xy[1, i, j] + step * move[1, i, j]
    return u, v


@njit(**_INNER)
def _least_area(side, xy, move, share, by, i, j):
    """Smaller of the doubled areas of the triangles of a moved cell, with the sign of ``side``."""
    ax, ay = _moved(xy, move, share, by, i, j)
    bx, by_ = _moved(xy, move, share, by, i, j + 1)
    cx, cy = _moved(xy, move, share, by, i + 1, j + 1)
    dx, dy = _moved(xy, move, share, by, i + 1, j)
    return least_area(side, bx - ax, by_ - ay, cx - ax, cy - ay, dx - ax, dy - ay)


@njit(**_SETTINGS)
def hold_open(xy, rest, move, share, floor, side, n, r0, r1):
    """Halve ``share`` (rows + 2, width) at nodes whose cells would close.

    Give how many cells were found closing.

    A cell closes if a triangle's doubled area falls below ``floor`` times the product of the cell's
    rest lengths and below what it was. Serial over the rows of cells given, because neighbours
    share nodes.
    """
    found = 0
    for i in range(r0, r1):
        for j in range(1, n):
            if not (rest[2, i, j] > 0.0 and rest[3, i, j] > 0.0):
                continue
            least = _least_area(side, xy, move, share, np.float32(1.0), i, j)
            if least >= floor * 0.5 * rest[2, i, j] * rest[3, i, j]:
                continue
            if least < _least_area(side, xy, move, share, np.float32(0.0), i, j):
                found += 1
                for k in range(i, i + 2):
                    share[k, j] *= 0.5
                    share[k, j + 1] *= 0.5
    return found
