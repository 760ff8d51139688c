# pyright: standard
"""Two-point hypotheses, tried exhaustively: numpy and numba only, arrays in, arrays out.

Marks are complex numbers ``x + 1j y`` in um; ``a`` is the smaller set, ``b`` the larger. A hypothesis says that marks
``i, j`` of ``a`` are marks ``k, q`` of ``b``, which fixes ``w = alpha z + beta``. Refined, it may also stretch the
sheet a little more one way than the other: ``w = alpha z + gamma conj(z) + beta``.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def mark_raster(b, reach, most):
    """Return which cells of a raster lie within ``reach`` of a mark of ``b``, roughly: ``x0, y0, size, near``.

    ``near`` is (rows, columns) uint8, with at most about ``most`` cells; its border is 0.
    """
    x0, x1 = b.real.min() - reach, b.real.max() + reach
    y0, y1 = b.imag.min() - reach, b.imag.max() + reach
    size = max(reach / 3.0, np.sqrt((x1 - x0) * (y1 - y0) / most), max(x1 - x0, y1 - y0) / 20000.0)
    x0, y0 = x0 - 2.0 * size, y0 - 2.0 * size
    columns, rows = int((x1 - x0) / size) + 3, int((y1 - y0) / size) + 3
    near = np.zeros((rows, columns), np.uint8)
    # A cell counts where its middle does, or a little beyond, so that no cell with a good place is lost.
    limit = (reach + 0.5 * size) ** 2
    steps = int(reach / size) + 2
    for t in range(b.size):
        column, row = int((b[t].real - x0) / size), int((b[t].imag - y0) / size)
        for r in range(max(0, row - steps), min(rows, row + steps + 1)):
            for c in range(max(0, column - steps), min(columns, column + steps + 1)):
                dx = x0 + (c + 0.5) * size - b[t].real
                dy = y0 + (r + 0.5) * size - b[t].imag
                if dx * dx + dy * dy <= limit:
                    near[r, c] = 1
    return x0, y0, size, near


@njit(cache=True, nogil=True)
def count_near(a, b, base, first, start, target, raster, share):
    """Return ``(h,)`` uint16: how many marks of ``a`` land near a mark of ``b`` under each hypothesis.

    ``base (p, 2)`` are pairs of ``a``; its row ``p`` is laid on rows ``first[p]`` on of ``target (t, 2)``, pairs of
    ``b``, either way round, giving the hypotheses ``start[p]`` up to ``start[p + 1]``. Counts that cannot reach
    ``share`` of the best so far are left unfinished.
    """
    x0, y0, size, near = raster
    rows, columns = near.shape
    flat = near.ravel()
    last_x, last_y = columns - 0.5, rows - 0.5
    n = a.size
    counts = np.zeros(start[-1], np.uint16)
    best = 0
    for p in range(base.shape[0]):
        za, zb = a[base[p, 0]], a[base[p, 1]]
        inverse = 1.0 / (zb - za)
        for h in range(start[p], start[p + 1]):
            half = (h - start[p]) // 2
            turned = (h - start[p]) % 2
            wa, wb = b[target[first[p] + half, turned]], b[target[first[p] + half, 1 - turned]]
            alpha = (wb - wa) * inverse
            beta = 0.5 * (wa + wb) - alpha * 0.5 * (za + zb)
            ar, ai = alpha.real / size, alpha.imag / size
            br, bi = (beta.real - x0) / size, (beta.imag - y0) / size
            count = 0
            spare = n - int(share * best)
            for s in range(n):
                x = ar * a[s].real - ai * a[s].imag + br
                y = ai * a[s].real + ar * a[s].imag + bi
                # The raster's border is empty, so what falls outside may be counted there; a branch would be slower.
                x, y = min(max(x, 0.0), last_x), min(max(y, 0.0), last_y)
                count += int(flat[np.uint64(int(y) * columns + int(x))])
                if s - count >= spare:
                    break
            counts[h] = min(count, 65535)
            best = max(best, count)
    return counts


@njit(cache=True, nogil=True)
def build_cells(b, reach):
    """Return a raster whose cells list the marks within reach: ``x0, y0, size, rows, columns, start, index``."""
    x0, x1 = b.real.min(), b.real.max()
    y0, y1 = b.imag.min(), b.imag.max()
    # Never more than about a million cells, however large the field.
    size = max(reach, np.sqrt((x1 - x0 + 4 * reach) * (y1 - y0 + 4 * reach) / 1e6), max(x1 - x0, y1 - y0) / 1e5)
    x0, y0 = x0 - 2 * size, y0 - 2 * size
    columns, rows = int((x1 - x0) / size) + 3, int((y1 - y0) / size) + 3
    start = np.zeros(rows * columns + 1, np.int64)
    for t in range(b.size):
        column, row = int((b[t].real - x0) / size), int((b[t].imag - y0) / size)
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                start[(row + dr) * columns + column + dc + 1] += 1
    start = np.cumsum(start)
    place = start.copy()
    index = np.empty(start[-1], np.int32)
    for t in range(b.size):
        column, row = int((b[t].real - x0) / size), int((b[t].imag - y0) / size)
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                cell = (row + dr) * columns + column + dc
                index[place[cell]] = t
                place[cell] += 1
    return x0, y0, size, rows, columns, start, index


@njit(cache=True, nogil=True)
def _nearest(w, b, square, cells):
    """Return the mark of ``b`` nearest to ``w`` and its squared distance, at most ``square``; or -1."""
    x0, y0, size, rows, columns, start, index = cells
    best = -1
    fx, fy = (w.real - x0) / size, (w.imag - y0) / size
    if fx < 0.0 or fy < 0.0 or fx >= columns or fy >= rows:
        return best, square
    cell = int(fy) * columns + int(fx)
    for s in range(start[cell], start[cell + 1]):
        t = index[s]
        d = (b[t].real - w.real) ** 2 + (b[t].imag - w.imag) ** 2
        if d <= square:
            best, square = t, d
    return best, square


@njit(cache=True, nogil=True)
def _assign(a, b, alpha, gamma, beta, reach, cells, partner, squares, owner):
    """Give each mark of ``a`` the nearest mark of ``b`` within ``reach``, each once; return how many have one."""
    owner[:] = -1
    partner[:] = -1
    squares[:] = np.inf
    count = 0
    for s in range(a.size):
        w = alpha * a[s] + gamma * a[s].conjugate() + beta
        t, d = _nearest(w, b, reach * reach, cells)
        if t < 0:
            continue
        if owner[t] >= 0:
            if squares[owner[t]] <= d:
                continue
            partner[owner[t]] = -1
            squares[owner[t]] = np.inf
            count -= 1
        owner[t] = s
        partner[s] = t
        squares[s] = d
        count += 1
    return count


@njit(cache=True, nogil=True)
def _fit(a, b, partner, squares, soft, ridge):
    """Return ``alpha, gamma, beta`` and the weighted sum of squares about the middle; ``ridge`` holds gamma small."""
    total, zm, wm = 0.0, 0j, 0j
    for s in range(a.size):
        if partner[s] >= 0:
            weight = 1.0 / (1.0 + squares[s] / soft)
            total += weight
            zm += weight * a[s]
            wm += weight * b[partner[s]]
    zm, wm = zm / total, wm / total
    power, twist, along, across = 0.0, 0j, 0j, 0j
    for s in range(a.size):
        if partner[s] >= 0:
            weight = 1.0 / (1.0 + squares[s] / soft)
            z, w = a[s] - zm, b[partner[s]] - wm
            power += weight * (z.real**2 + z.imag**2)
            twist += weight * z * z
            along += weight * z.conjugate() * w
            across += weight * z * w
    alpha, gamma = 0j, 0j
    if power > 0.0:
        if ridge < np.inf:
            det = power * (power + ridge) - twist.real**2 - twist.imag**2
            alpha = ((power + ridge) * along - twist.conjugate() * across) / det
            gamma = (power * across - twist * along) / det
        else:
            alpha = along / power
    return alpha, gamma, wm - alpha * zm - gamma * zm.conjugate(), power


@njit(cache=True, nogil=True)
def refine(seeds, a, b, reaches, soft, ridge, cells):
    """Refit each hypothesis to the marks that agree with it, once for each reach, and say which agree in the end.

    ``seeds (h, 4)`` are ``i, j, k, q``; ``reaches (r,)`` in um, the last of which holds; ``soft`` in um2 is the squared
    distance at which a mark counts half; ``ridge`` in um2 is what holds the stretch small. Three marks are fitted
    without stretch.

    Returns ``partner (h, n)`` int32 with -1 where there is none, ``squares (h, n)`` squared distances in um2, and
    ``alpha, gamma, beta (h,)``, ``power (h,)`` in um2, ``code (h,)``, which is the same for the same partners.
    """
    n, total = a.size, seeds.shape[0]
    partner = np.full((total, n), -1, np.int32)
    squares = np.full((total, n), np.inf)
    alphas, gammas, betas = (
        np.empty(total, np.complex128),
        np.zeros(total, np.complex128),
        np.zeros(total, np.complex128),
    )
    powers = np.zeros(total)
    codes = np.zeros(total, np.int64)
    owner = np.empty(b.size, np.int32)
    for h in range(total):
        za, zb, wa, wb = a[seeds[h, 0]], a[seeds[h, 1]], b[seeds[h, 2]], b[seeds[h, 3]]
        alpha = (wb - wa) / (zb - za)
        gamma = 0j
        beta = 0.5 * (wa + wb) - alpha * 0.5 * (za + zb)
        power = 0.0
        for turn in range(reaches.size):
            count = _assign(a, b, alpha, gamma, beta, reaches[turn], cells, partner[h], squares[h], owner)
            if turn == reaches.size - 1 or count < 2:
                break
            alpha, gamma, beta, power = _fit(
                a, b, partner[h], squares[h], soft if turn > 0 else np.inf, ridge if count > 3 else np.inf
            )
            if power == 0.0:
                break
        alphas[h], gammas[h], betas[h], powers[h] = alpha, gamma, beta, power
        code = 0
        for s in range(n):
            code = (code * 1_000_003 + int(partner[h, s]) + 2) % 1_000_000_000_039
        codes[h] = code
    return partner, squares, alphas, gammas, betas, powers, codes
