# pyright: standard
"""Compiled inner loops of the surface search beside the fit: following a sheet, presence, means."""

from math import floor, isfinite

import numpy as np

from planish.core.jit import njit

_ABREAST = 16  # columns whose means are worked out together
_ONE = np.float32(1.0)
_HALF = np.float32(0.5)


@njit(cache=True, nogil=True)
def follow(inside, row, col, start, stop, most, low, high, merged):  # noqa: C901, PLR0912
    """Follow a sheet from the run of one column to overlapping runs of its neighbours.

    ``row``, ``col``, ``start``, ``stop`` are the column of the seed and the first and last index of
    its run in ``inside``, (rows, cols, depth) bool. ``low`` and ``high``, (rows, cols) int64, are
    set to the first and last index of the run; they come as -1. A run longer than ``most`` belongs
    to two sheets that touch, or to one that folds back: it is marked in ``merged``, (rows, cols)
    bool, and not followed.
    """
    rows, cols, depth = inside.shape
    queue = np.empty((rows * cols, 2), dtype=np.int64)
    queue[0, 0], queue[0, 1] = row, col
    low[row, col], high[row, col] = start, stop
    first, last = 0, 1
    while first < last:
        i, j = queue[first]
        first += 1
        a, b = low[i, j], high[i, j]
        for side in range(4):
            r = i + (side == 0) - (side == 1)
            c = j + (side == 2) - (side == 3)
            if r < 0 or c < 0 or r >= rows or c >= cols or low[r, c] >= 0:
                continue
            best, d = 0, a
            best_a = best_b = -1
            while d <= b:
                if not inside[r, c, d]:
                    d += 1
                    continue
                begin, end = d, d
                while begin > 0 and inside[r, c, begin - 1]:
                    begin -= 1
                while end < depth - 1 and inside[r, c, end + 1]:
                    end += 1
                overlap = min(end, b) - max(begin, a) + 1
                if overlap > best:
                    best, best_a, best_b = overlap, begin, end
                d = end + 1
            if best == 0:
                continue
            long = best_b - best_a + 1 > most
            if merged[i, j] and not long:
                continue  # which of the two sheets it is stays open
            merged[r, c] = long
            low[r, c], high[r, c] = best_a, best_b
            queue[last, 0], queue[last, 1] = r, c
            last += 1
    for i in range(rows):
        for j in range(cols):
            if merged[i, j]:
                low[i, j] = high[i, j] = -1


@njit(cache=True, nogil=True)
def blend(grey, slope, weights, down, right, out):
    """Average neighbouring columns along rows or columns, each moved in depth by the sheet's slope.

    Without the move a sheet at 40 degrees would be blurred by 0.8 voxels a column. Between voxels
    Keys' cubic is used: it passes parabolas, and so adds nothing to the width of an edge.

    grey, out   : (rows, cols, depth) float32
    slope       : (rows, cols), rise of the sheet from one column to the next in this direction, in
    voxels
    weights     : (n,) float32, of the column itself and of its neighbours on either side; the
    border's column stands
                  for those beyond it
    down, right : 1, 0 or 0, 1
    """
    rows, cols, depth = grey.shape
    reach = len(weights) - 1
    for r in range(rows):
        for c in range(cols):
            total = out[r, c]
            total[:] = 0.0
            for i in range(-reach, reach + 1):
                rr = min(max(r + down * i, 0), rows - 1)
                cc = min(max(c + right * i, 0), cols - 1)
                beside = grey[rr, cc]
                weight = weights[abs(i)]
                move = slope[r, c] * (rr - r + cc - c)
                k = int(floor(move + 0.5))
                f = np.float32(move - k)  # -0.5 to 0.5 about voxel k
                if abs(f) < 0.01:
                    a = min(max(-k, 0), depth)
                    b = max(min(depth - k, depth), a)
                    for d in range(a, b):
                        total[d] += weight * beside[d + k]
                else:
                    if f < 0:
                        k -= 1
                        f += _ONE
                    w0 = weight * f * (f * (_ONE - _HALF * f) - _HALF)
                    w1 = weight * (_ONE + f * f * (np.float32(1.5) * f - np.float32(2.5)))
                    w2 = weight * f * (_HALF + f * (np.float32(2.0) - np.float32(1.5) * f))
                    w3 = weight * f * f * (_HALF * f - _HALF)
                    a = min(max(1 - k, 0), depth)
                    b = max(min(depth - 2 - k, depth), a)
                    for d in range(a, b):
                        total[d] += (
                            w0 * beside[d + k - 1]
                            + w1 * beside[d + k]
                            + w2 * beside[d + k + 1]
                            + w3 * beside[d + k + 2]
                        )
                for d in range(a):
                    total[d] += weight * beside[min(max(d + k, 0), depth - 1)]
                for d in range(b, depth):
                    total[d] += weight * beside[min(max(d + k, 0), depth - 1)]


@njit(cache=True, nogil=True, error_model="numpy")
def trilinear(flat, shape, first, deep, r, c, d, fr, fc):
    """Give the value of a flat slab at the indices r + fr, c + fc and d - first.

    Its shape is (rows, cols, depth); the value is NaN outside.

    The slab holds a part of columns that are ``deep`` voxels long. r and c are whole; shares of a
    voxel come apart from them, because the place in a tile must not round them.
    """
    rows, cols, depth = shape
    step_r = floor(fr)
    step_c = floor(fc)
    i = r + int(step_r)
    j = c + int(step_c)
    fr -= step_r
    fc -= step_c
    if i == rows - 1 and fr == 0.0:
        i, fr = i - 1, 1.0
    if j == cols - 1 and fc == 0.0:
        j, fc = j - 1, 1.0
    if not (0 <= i < rows - 1 and 0 <= j < cols - 1 and 0.0 <= d <= deep - 1):
        return np.nan
    k = min(int(d), deep - 2)
    fd = d - k
    k -= first
    if not 0 <= k < depth - 1:
        return np.nan
    # Unsigned, numba does not look for indices that count from the end.
    p = np.uint64((i * cols + j) * depth + k)
    right = np.uint64(depth)
    one = np.uint64(1)
    q = p + np.uint64(cols * depth)
    a = (flat[p] * (1 - fd) + flat[p + one] * fd) * (1 - fc)
    a += (flat[p + right] * (1 - fd) + flat[p + right + one] * fd) * fc
    b = (flat[q] * (1 - fd) + flat[q + one] * fd) * (1 - fc)
    b += (flat[q + right] * (1 - fd) + flat[q + right + one] * fd) * fc
    return a * (1 - fr) + b * fr


@njit(cache=True, nogil=True, error_model="numpy")
def presence(
    slab,
    first,
    deep,
    lead_r,
    lead_c,
    centre,
    normal_r,
    normal_c,
    normal_d,
    offsets,
    layers,
    air,
    base,
    out,
):
    """Give the share of material along each normal, layer by layer.

    It is the mean of (g - air) / (base - air), cut to 0..1.

    slab           : (rows + halo, cols + halo, depth) float32, contiguous; carries ``lead_r`` more
                     rows and ``lead_c`` more columns before the first of the maps
    first, deep    : depth index of its first voxel, and length of the whole columns
    centre, normal : (rows, cols), height of the centre surface and the normal, per um, all in
                     voxels
    offsets        : (n,), distances from the centre surface along the normal, in um
    layers         : (m, k) int64, which of the offsets each layer is the mean of
    out            : (m, rows, cols), set; NaN where the normal leaves the slab
    """
    rows, cols = centre.shape
    flat = slab.reshape(-1)
    share = np.empty(offsets.size)
    for i in range(rows):
        for j in range(cols):
            c = centre[i, j]
            nr = normal_r[i, j]
            nc = normal_c[i, j]
            nd = normal_d[i, j]
            for n in range(offsets.size):
                d = c + offsets[n] * nd
                g = np.nan
                if isfinite(d):
                    fr = offsets[n] * nr
                    fc = offsets[n] * nc
                    g = trilinear(flat, slab.shape, first, deep, lead_r + i, lead_c + j, d, fr, fc)
                material = min(max((g - air) / (base - air), 0.0), 1.0)
                share[n] = material if isfinite(g) else np.nan
            for m in range(layers.shape[0]):
                total, count = 0.0, 0
                for n in range(layers.shape[1]):
                    part = share[layers[m, n]]
                    if isfinite(part):
                        total += part
                        count += 1
                out[m, i, j] = total / count if count > 0 else np.nan


@njit(cache=True, nogil=True)
def block_sums(voxels, wide, corner, sums, bad, holds):
    """Sums over blocks of columns, in the order in which the voxels lie in memory.

    voxels : (a, b, c), as they lie in memory, the last axis without jumps; one of the axes is the
             depth
    wide   : voxels of a block along each axis, 1 along the depth. The last block of an axis takes
             what is left over
    corner : value that may be the padding; NaN where there is none
    sums, bad, holds : (blocks along a, b, c), zeros before; ``sums`` not finite where a voxel is
    not, ``bad`` how many
                       voxels are not finite, ``holds`` whether a voxel has the value of the corner
    """
    last = np.array([n - 1 for n in sums.shape])
    total = np.empty(voxels.shape[2])
    lost = np.empty_like(total)
    seen = np.empty_like(total)
    for p in range(sums.shape[0]):
        end_i = voxels.shape[0] if p == last[0] else (p + 1) * wide[0]
        for i in range(p * wide[0], end_i):
            for q in range(sums.shape[1]):
                total[:] = 0.0
                lost[:] = 0.0
                seen[:] = 0.0
                end_j = voxels.shape[1] if q == last[1] else (q + 1) * wide[1]
                for j in range(q * wide[1], end_j):
                    row = voxels[i, j]
                    for k in range(row.size):
                        value = np.float64(row[k])
                        total[k] += value
                        lost[k] += 0.0 if isfinite(value) else 1.0
                        seen[k] += 1.0 if value == corner else 0.0
                for r in range(sums.shape[2]):
                    end_k = voxels.shape[2] if r == last[2] else (r + 1) * wide[2]
                    for k in range(r * wide[2], end_k):
                        sums[p, q, r] += total[k]
                        bad[p, q, r] += lost[k]
                        holds[p, q, r] |= seen[k] > 0.0


@njit(cache=True, nogil=True)
def mean_columns(voxels, step, slope_r, slope_c, missing, out):  # noqa: C901, PLR0912
    """Average ``step`` x ``step`` columns of voxels, each moved in depth by the sheet's slope.

    ``voxels``: (rows * step, cols * step, depth). ``slope_r``, ``slope_c``: (rows, cols), rise of
    the sheet in voxels of depth, from one voxel row and column to the next. ``missing``: value that
    counts as missing; NaN: none. ``out``: (rows, cols, depth) float32, set; NaN where a voxel is
    missing. Beyond the ends of a column its last voxel counts.
    """
    rows, cols, depth = out.shape
    share = np.float32(1.0 / (step * step))
    middle = 0.5 * (step - 1)
    some = missing == missing  # NaN: nothing is missing but NaN itself
    total = np.empty((depth, _ABREAST * step), dtype=np.float32)
    shift = np.empty(_ABREAST * step, dtype=np.int64)
    for i in range(rows):
        for first in range(0, cols, _ABREAST):
            # Some columns at a time: voxels lie side by side either along the row or along the
            # depth, and this way both are read without jumping.
            count = min(_ABREAST, cols - first)
            wide = count * step
            total[:] = 0.0
            for a in range(step):
                low, high = 0, 0
                for m in range(wide):
                    j = first + m // step
                    move = slope_r[i, j] * (a - middle) + slope_c[i, j] * (m % step - middle)
                    shift[m] = int(floor(move + 0.5)) if isfinite(move) else 0
                    low = min(low, shift[m])
                    high = max(high, shift[m])
                row = voxels[i * step + a, first * step : first * step + wide]
                for d in range(depth):
                    if some or d + low < 0 or d + high > depth - 1:
                        for m in range(wide):
                            value = row[m, min(max(d + shift[m], 0), depth - 1)]
                            is_missing = some and value == missing
                            total[d, m] += np.float32(np.nan) if is_missing else np.float32(value)
                    elif low == high:  # all alike: many columns at once
                        for m in range(wide):
                            total[d, m] += np.float32(row[m, d])
                    else:
                        for m in range(wide):
                            total[d, m] += np.float32(row[m, np.uint64(d + shift[m])])
            for n in range(count):
                for d in range(depth):
                    part = np.float32(0.0)
                    for m in range(n * step, (n + 1) * step):
                        part += total[d, m]
                    out[i, first + n, d] = part * share
