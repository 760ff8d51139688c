# pyright: standard
"""Exhaustive two-point hypotheses: numpy and numba only, arrays in, arrays out.

Marks are ``(n, 2)`` float64 in um; ``a`` is the smaller set, ``b`` the larger. A hypothesis says that marks ``i, j`` of
``a`` are marks ``k, l`` of ``b``, which fixes ``w = alpha z + beta`` in complex numbers.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def list_hypotheses(base, b, low, high, slack, a, shortest):
    """Return ``(h, 4)`` int32 rows ``i, j, k, l`` whose lengths agree.

    ``base`` (p, 2) int: pairs of ``a`` to start from. Lengths in ``b`` lie between ``low * length - slack`` and
    ``high * length + slack``; pairs of ``a`` shorter than ``shortest`` are passed over.
    """
    m = b.shape[0]
    count = 0
    out = np.empty((0, 4), np.int32)
    for fill in range(2):
        if fill == 1:
            out = np.empty((count, 4), np.int32)
            count = 0
        for p in range(base.shape[0]):
            i, j = base[p, 0], base[p, 1]
            length = np.hypot(a[j, 0] - a[i, 0], a[j, 1] - a[i, 1])
            if length < shortest:
                continue
            least = (max(0.0, low * length - slack)) ** 2
            most = (high * length + slack) ** 2
            for k in range(m):
                for q in range(k + 1, m):
                    square = (b[q, 0] - b[k, 0]) ** 2 + (b[q, 1] - b[k, 1]) ** 2
                    if least <= square <= most:
                        if fill == 1:
                            out[count, 0], out[count, 1], out[count, 2], out[count, 3] = i, j, k, q
                            out[count + 1, 0], out[count + 1, 1], out[count + 1, 2], out[count + 1, 3] = i, j, q, k
                        count += 2
    return out


@njit(cache=True)
def build_cells(b, tolerance):
    """Return a raster whose cells list the marks of ``b`` within reach: ``origin, size, shape, start, index``."""
    size = tolerance
    x0, y0 = b[0, 0], b[0, 1]
    x1, y1 = x0, y0
    for t in range(b.shape[0]):
        x0, x1 = min(x0, b[t, 0]), max(x1, b[t, 0])
        y0, y1 = min(y0, b[t, 1]), max(y1, b[t, 1])
    # Never more than about a million cells, however large the field.
    size = max(size, np.sqrt((x1 - x0 + 4 * size) * (y1 - y0 + 4 * size) / 1e6), max(x1 - x0, y1 - y0) / 1e5)
    x0, y0 = x0 - 2 * size, y0 - 2 * size
    columns, rows = int((x1 - x0) / size) + 3, int((y1 - y0) / size) + 3
    start = np.zeros(rows * columns + 1, np.int64)
    for t in range(b.shape[0]):
        column, row = int((b[t, 0] - x0) / size), int((b[t, 1] - y0) / size)
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                start[(row + dr) * columns + column + dc + 1] += 1
    start = np.cumsum(start)
    place = start.copy()
    index = np.empty(start[-1], np.int32)
    for t in range(b.shape[0]):
        column, row = int((b[t, 0] - x0) / size), int((b[t, 1] - y0) / size)
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                cell = (row + dr) * columns + column + dc
                index[place[cell]] = t
                place[cell] += 1
    return x0, y0, size, rows, columns, start, index


@njit(cache=True)
def _nearest(x, y, b, reach, x0, y0, size, rows, columns, start, index):
    """Return the mark of ``b`` nearest to ``(x, y)`` within ``reach`` and its squared distance, or -1."""
    best, square = -1, reach * reach
    fx, fy = (x - x0) / size, (y - y0) / size
    if fx < 0.0 or fy < 0.0 or fx >= columns or fy >= rows:
        return best, square
    cell = int(fy) * columns + int(fx)
    for s in range(start[cell], start[cell + 1]):
        t = index[s]
        d = (b[t, 0] - x) ** 2 + (b[t, 1] - y) ** 2
        if d <= square:
            best, square = t, d
    return best, square


@njit(cache=True)
def count_agreements(rows_ijkl, a, b, reach, cells):
    """Return for each hypothesis how many marks of ``a`` land within ``reach`` of a mark of ``b``, each used once."""
    x0, y0, size, rows, columns, start, index = cells
    n = a.shape[0]
    counts = np.zeros(rows_ijkl.shape[0], np.int32)
    stamp = np.full(b.shape[0], -1, np.int64)
    for h in range(rows_ijkl.shape[0]):
        i, j, k, q = rows_ijkl[h]
        za, zb = complex(a[i, 0], a[i, 1]), complex(a[j, 0], a[j, 1])
        wa, wb = complex(b[k, 0], b[k, 1]), complex(b[q, 0], b[q, 1])
        alpha = (wb - wa) / (zb - za)
        beta = 0.5 * (wa + wb) - alpha * 0.5 * (za + zb)
        count = 0
        for s in range(n):
            w = alpha * complex(a[s, 0], a[s, 1]) + beta
            t, _ = _nearest(w.real, w.imag, b, reach, x0, y0, size, rows, columns, start, index)
            if t >= 0 and stamp[t] != h:
                stamp[t] = h
                count += 1
        counts[h] = count
    return counts


@njit(cache=True)
def refine(rows_ijkl, a, b, reach, cells, rounds):
    """Refit each hypothesis to the marks that agree with it, ``rounds`` times.

    Returns ``partner (h, n)`` int32 with -1 where there is none, ``square (h, n)`` squared distances in um2, and
    ``alpha, beta (h,)``.
    """
    x0, y0, size, rows, columns, start, index = cells
    n, m, total = a.shape[0], b.shape[0], rows_ijkl.shape[0]
    partner = np.full((total, n), -1, np.int32)
    squares = np.full((total, n), np.inf)
    alphas = np.empty(total, np.complex128)
    betas = np.empty(total, np.complex128)
    owner = np.empty(m, np.int32)
    for h in range(total):
        i, j, k, q = rows_ijkl[h]
        za, zb = complex(a[i, 0], a[i, 1]), complex(a[j, 0], a[j, 1])
        wa, wb = complex(b[k, 0], b[k, 1]), complex(b[q, 0], b[q, 1])
        alpha = (wb - wa) / (zb - za)
        beta = 0.5 * (wa + wb) - alpha * 0.5 * (za + zb)
        for turn in range(rounds + 1):
            owner[:] = -1
            partner[h, :] = -1
            squares[h, :] = np.inf
            count = 0
            for s in range(n):
                w = alpha * complex(a[s, 0], a[s, 1]) + beta
                t, d = _nearest(w.real, w.imag, b, reach, x0, y0, size, rows, columns, start, index)
                if t < 0:
                    continue
                if owner[t] >= 0:
                    if squares[h, owner[t]] <= d:
                        continue
                    partner[h, owner[t]] = -1
                    squares[h, owner[t]] = np.inf
                    count -= 1
                owner[t] = s
                partner[h, s] = t
                squares[h, s] = d
                count += 1
            if turn == rounds or count < 2:
                break
            zm, wm = 0j, 0j
            for s in range(n):
                if partner[h, s] >= 0:
                    zm += complex(a[s, 0], a[s, 1])
                    wm += complex(b[partner[h, s], 0], b[partner[h, s], 1])
            zm, wm = zm / count, wm / count
            top, bottom = 0j, 0.0
            for s in range(n):
                if partner[h, s] >= 0:
                    z = complex(a[s, 0], a[s, 1]) - zm
                    top += z.conjugate() * (complex(b[partner[h, s], 0], b[partner[h, s], 1]) - wm)
                    bottom += z.real**2 + z.imag**2
            if bottom == 0.0:
                break
            alpha = top / bottom
            beta = wm - alpha * zm
        alphas[h], betas[h] = alpha, beta
    return partner, squares, alphas, betas
