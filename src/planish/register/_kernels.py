# pyright: standard
"""Two-point hypotheses, tried exhaustively: numpy and numba only, arrays in, arrays out.

Marks are complex numbers ``x + 1j y`` in um; ``a`` is the smaller set, ``b`` the larger. A
hypothesis says that marks ``i, j`` of ``a`` are marks ``k, q`` of ``b``, which fixes ``w = alpha z
+ beta``. Refined, it may also stretch the sheet a little more in one direction than in the other:
``w = alpha z + gamma conj(z) + beta``.
"""

import numpy as np

from planish.core.jit import njit


@njit(cache=True, nogil=True)
def count_near(a, b, base, first, start, target, raster, share):
    """Count the marks of ``a`` that land near a mark of ``b`` under each hypothesis.

    Returns ``(h,)`` uint16.

    ``base (p, 2)`` are pairs of ``a``; its row ``p`` is laid on rows ``first[p]`` on of ``target
    (t, 2)``, pairs of ``b``, either end first, giving the hypotheses ``start[p]`` up to ``start[p +
    1]``. Counts that cannot reach ``share`` of the best so far are left unfinished.
    """
    x0, y0, size, near = raster
    rows, columns = near.shape
    flat = near.ravel()
    last_x = columns - 0.5
    last_y = rows - 0.5
    n = a.size
    counts = np.zeros(start[-1], np.uint16)
    best = 0
    for p in range(base.shape[0]):
        za = a[base[p, 0]]
        zb = a[base[p, 1]]
        inverse = 1.0 / (zb - za)
        for h in range(start[p], start[p + 1]):
            half = (h - start[p]) // 2
            turned = (h - start[p]) % 2
            pair = target[first[p] + half]
            wa = b[pair[turned]]
            wb = b[pair[1 - turned]]
            alpha = (wb - wa) * inverse
            beta = 0.5 * (wa + wb) - alpha * 0.5 * (za + zb)
            ar = alpha.real / size
            ai = alpha.imag / size
            br = (beta.real - x0) / size
            bi = (beta.imag - y0) / size
            count = 0
            spare = n - int(share * best)
            for s in range(n):
                x = ar * a[s].real - ai * a[s].imag + br
                y = ai * a[s].real + ar * a[s].imag + bi
                # The raster's border is empty, so what falls outside may be counted there; a branch
                # would be slower.
                x = min(max(x, 0.0), last_x)
                y = min(max(y, 0.0), last_y)
                count += int(flat[np.uint64(int(y) * columns + int(x))])
                if s - count >= spare:
                    break
            counts[h] = min(count, 65535)
            best = max(best, count)
    return counts


@njit(cache=True, nogil=True)
def refine(seeds, a, b, reaches, soft, ridge, raster, start, index):  # noqa: C901, PLR0912
    """Refit each hypothesis to the marks that agree with it, and find which agree in the end.

    Each is refitted once for each reach.

    Parameters
    ----------
    seeds : (h, 4); ``i, j, k, q``
    a, b : (n,) and (m,), complex, in um; marks of either side
    reaches : (r,), in um; the last holds
    soft : float, in um2; squared distance at which a mark counts half
    ridge : float, in um2; holds the stretch small; three marks are fitted without stretch
    raster : ``x0, y0, size, rows, columns`` of cells
    start, index : marks within reach of a cell are ``index[start[cell]:start[cell + 1]]``

    Returns
    -------
    partner : (h, n), int32; -1 where there is none
    squares : (h, n), in um2; squared distances
    alpha, gamma, beta : (h,)
    power : (h,), in um2
    """
    n = a.size
    total = seeds.shape[0]
    x0, y0, size, rows, columns = raster
    partner = np.full((total, n), -1, np.int32)
    squares = np.full((total, n), np.inf)
    factors = np.zeros((3, total), np.complex128)
    powers = np.zeros(total)
    owner = np.empty(b.size, np.int32)
    for h in range(total):
        mine = partner[h]
        off = squares[h]
        za = a[seeds[h, 0]]
        zb = a[seeds[h, 1]]
        wa = b[seeds[h, 2]]
        wb = b[seeds[h, 3]]
        alpha = (wb - wa) / (zb - za)
        gamma = 0j
        beta = 0.5 * (wa + wb) - alpha * 0.5 * (za + zb)
        power = 0.0
        for turn in range(reaches.size):
            # Each mark of a gets the nearest mark of b within reach, each of those once.
            owner[:] = -1
            mine[:] = -1
            off[:] = np.inf
            count = 0
            for s in range(n):
                w = alpha * a[s] + gamma * a[s].conjugate() + beta
                fx = (w.real - x0) / size
                fy = (w.imag - y0) / size
                if fx < 0.0 or fy < 0.0 or fx >= columns or fy >= rows:
                    continue
                cell = int(fy) * columns + int(fx)
                t = -1
                d = reaches[turn] ** 2
                for place in range(start[cell], start[cell + 1]):
                    other = b[index[place]] - w
                    apart = other.real**2 + other.imag**2
                    if apart <= d:
                        t = index[place]
                        d = apart
                if t < 0:
                    continue
                if owner[t] >= 0:
                    if off[owner[t]] <= d:
                        continue
                    mine[owner[t]] = -1
                    off[owner[t]] = np.inf
                    count -= 1
                owner[t] = s
                mine[s] = t
                off[s] = d
                count += 1
            if turn == reaches.size - 1 or count < 2:
                break
            weight = np.zeros(n)
            sums = 0.0
            zm = 0j
            wm = 0j
            for s in range(n):
                if mine[s] >= 0:
                    weight[s] = 1.0 / (1.0 + off[s] / soft) if turn > 0 else 1.0
                    sums += weight[s]
                    zm += weight[s] * a[s]
                    wm += weight[s] * b[mine[s]]
            zm = zm / sums
            wm = wm / sums
            power = 0.0
            twist = 0j
            along = 0j
            across = 0j
            for s in range(n):
                if mine[s] >= 0:
                    z = a[s] - zm
                    w = b[mine[s]] - wm
                    power += weight[s] * (z.real**2 + z.imag**2)
                    twist += weight[s] * z * z
                    along += weight[s] * z.conjugate() * w
                    across += weight[s] * z * w
            alpha = 0j
            gamma = 0j
            if power > 0.0:
                alpha = along / power
                if count > 3:
                    det = power * (power + ridge) - twist.real**2 - twist.imag**2
                    alpha = ((power + ridge) * along - twist.conjugate() * across) / det
                    gamma = (power * across - twist * along) / det
            beta = wm - alpha * zm - gamma * zm.conjugate()
            if power == 0.0:
                break
        factors[0, h] = alpha
        factors[1, h] = gamma
        factors[2, h] = beta
        powers[h] = power
    return partner, squares, factors[0], factors[1], factors[2], powers
