# pyright: standard
"""Compiled inner loops of the surface search: faces of one column, and presence along the normals.

A column is read from outside to inside. Its model is a blurred staircase: ``air | coating | base`` with steps at the
face ``h`` and the interface ``h + t``,

    g(d) = a + (c - a) P((d - h) / w) + (b - c) P((d - h - t) / w),

with P the normal distribution and w the width of the blur along the column. Without a coating it has one step, and c is
the level outside, which need not be that of the air: ``g(d) = c + (b - c) P((d - h) / w)``.
"""

from math import exp, floor, isfinite, sqrt

import numpy as np
from numba import njit
from scipy.special import ndtr

_ROOT2PI = sqrt(2.0 * np.pi)
_STEPS = 20
_CLOSE = 1e-3  # voxels: a fiftieth of what noise leaves
# The normal distribution from a table, linear between 256 nodes a standard deviation: within 5e-7, and several times
# faster than erf.
_PER_SIGMA = 256
_LAST = 6
_ABREAST = 16  # columns whose means are worked out together
_TABLE = ndtr(np.arange(-_LAST * _PER_SIGMA, _LAST * _PER_SIGMA + 2) / _PER_SIGMA)


@njit(cache=True, nogil=True)
def _normal(x):
    t = (x + _LAST) * _PER_SIGMA
    if t <= 0.0:
        return 0.0
    if t >= 2.0 * _LAST * _PER_SIGMA:
        return 1.0
    i = int(t)
    f = t - i
    return _TABLE[i] * (1.0 - f) + _TABLE[i + 1] * f


@njit(cache=True, nogil=True)
def _bell(x):
    return exp(-0.5 * x * x) / _ROOT2PI


@njit(cache=True, nogil=True)
def _solve4(m, r, n):
    """Solve the symmetric positive system m[:n, :n] x = r[:n] in place by Cholesky; False where it is not positive."""
    for i in range(n):
        for j in range(i + 1):
            s = m[i, j]
            for k in range(j):
                s -= m[i, k] * m[j, k]
            if i == j:
                if s <= 0.0:
                    return False
                m[i, i] = sqrt(s)
            else:
                m[i, j] = s / m[j, j]
    for i in range(n):
        s = r[i]
        for k in range(i):
            s -= m[i, k] * r[k]
        r[i] = s / m[i, i]
    for i in range(n - 1, -1, -1):
        s = r[i]
        for k in range(i + 1, n):
            s -= m[k, i] * r[k]
        r[i] = s / m[i, i]
    return True


@njit(cache=True, nogil=True)
def _evaluate(g, lo, hi, air, noise, w, p, prior, spread, coated, matrix, step):
    """Return the cost at p; set the lower triangle of ``matrix`` and ``step`` to the normal equations there."""
    matrix[:] = 0.0
    step[:] = 0.0
    cost = 0.0
    scale = 1.0 / (noise * noise)
    for d in range(lo, hi + 1):
        x1 = (d - p[0]) / w
        outer, bell1 = _normal(x1), _bell(x1) / w
        if coated:
            x2 = (d - p[0] - p[1]) / w
            inner, bell2 = _normal(x2), _bell(x2) / w
            e = g[d] - (air + (p[2] - air) * outer + (p[3] - p[2]) * inner)
            j1 = -(p[3] - p[2]) * bell2
            j0 = -(p[2] - air) * bell1 + j1
            j2 = outer - inner
            j3 = inner
        else:
            e = g[d] - (p[2] + (p[3] - p[2]) * outer)
            j0 = -(p[3] - p[2]) * bell1
            j1 = 0.0
            j2 = 1.0 - outer
            j3 = outer
        cost += e * e
        step[0] += j0 * e
        step[1] += j1 * e
        step[2] += j2 * e
        step[3] += j3 * e
        matrix[0, 0] += j0 * j0
        matrix[1, 0] += j1 * j0
        matrix[1, 1] += j1 * j1
        matrix[2, 0] += j2 * j0
        matrix[2, 1] += j2 * j1
        matrix[2, 2] += j2 * j2
        matrix[3, 0] += j3 * j0
        matrix[3, 1] += j3 * j1
        matrix[3, 2] += j3 * j2
        matrix[3, 3] += j3 * j3
    cost *= scale
    for i in range(4):
        step[i] *= scale
        for j in range(i + 1):
            matrix[i, j] *= scale
    for i in range(4):
        if spread[i] > 0.0:
            k = 1.0 / (spread[i] * spread[i])
            e = prior[i] - p[i]
            cost += k * e * e
            matrix[i, i] += k
            step[i] += k * e
    for i in range(4):
        if spread[i] < 0.0 or (not coated and i == 1):
            for j in range(4):
                if j <= i:
                    matrix[i, j] = 0.0
                else:
                    matrix[j, i] = 0.0
            matrix[i, i] = 1.0
            step[i] = 0.0
    return cost


@njit(cache=True, nogil=True)
def fit_column(g, lo, hi, air, noise, w, p, prior, spread, coated, matrix, step):
    """Fit p = (h, t, c, b) to g[lo:hi+1] by Levenberg-Marquardt; return the cost per sample.

    ``prior`` and ``spread`` (4): Gaussian prior on p; a spread of 0 means none, below 0 holds the value fixed.
    Without a coating t is left as it is.
    """
    damping = 1e-3
    old = np.empty(4)
    cost = _evaluate(g, lo, hi, air, noise, w, p, prior, spread, coated, matrix, step)
    for _ in range(_STEPS):
        for i in range(4):
            matrix[i, i] *= 1.0 + damping
            matrix[i, i] += 1e-12
            old[i] = p[i]
        if not _solve4(matrix, step, 4):
            break
        move = max(abs(step[0]), abs(step[1]))
        step[0] = min(max(step[0], -1.5 * w), 1.5 * w)
        step[1] = min(max(step[1], -2.0 * w), 2.0 * w)
        for i in range(4):
            p[i] += step[i]
        p[1] = max(p[1], 0.0)
        new = _evaluate(g, lo, hi, air, noise, w, p, prior, spread, coated, matrix, step)
        if new <= cost:
            cost = new
            damping *= 0.1
            if move < _CLOSE:
                break
        else:
            for i in range(4):
                p[i] = old[i]
            damping *= 10.0
            if damping > 1e7:
                break
            _evaluate(g, lo, hi, air, noise, w, p, prior, spread, coated, matrix, step)
    return cost / (hi - lo + 1)


@njit(cache=True, nogil=True)
def outermost(g, start, stop, level):
    """First index in [start, stop] from which the lightly smoothed g stays above level for two samples, or -1."""
    for d in range(max(start, 1), min(stop, g.size - 3) + 1):
        here = 0.25 * g[d - 1] + 0.5 * g[d] + 0.25 * g[d + 1]
        then = 0.25 * g[d] + 0.5 * g[d + 1] + 0.25 * g[d + 2]
        if here > level and then > level:
            return d
    return -1


@njit(cache=True, nogil=True)
def follow(inside, row, col, start, stop, most, low, high, merged):
    """Follow a sheet from the run of one column to overlapping runs of its neighbours.

    Parameters
    ----------
    inside : (rows, cols, depth) bool
    row, col, start, stop : int
        Column of the seed and first and last index of its run.
    most : float
        A longer run belongs to two sheets that touch, or to one that folds back: it is marked and not followed.
    low, high : (rows, cols) int64
        Set to the first and last index of the run; they come as -1.
    merged : (rows, cols) bool
        Set where a run is too long.
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
                continue  # which of the two sheets it is cannot be told
            merged[r, c] = long
            low[r, c], high[r, c] = best_a, best_b
            queue[last, 0], queue[last, 1] = r, c
            last += 1
    for i in range(rows):
        for j in range(cols):
            if merged[i, j]:
                low[i, j] = high[i, j] = -1


@njit(cache=True, nogil=True)
def nearest(g, expected, search, level):
    """First index inside the crossing of level that lies nearest to where it is expected, or -1."""
    e = int(floor(expected + 0.5))
    for k in range(int(search) + 2):
        for d in (e - k, e + k):
            if 1 <= d < g.size and g[d - 1] <= level < g[d]:
                return d
    return -1


@njit(cache=True, nogil=True)
def darkest(g, d0, reach, noise):
    """Index of the darkest sample outside d0, before the grey rises again."""
    at = d0
    for d in range(d0 - 1, max(d0 - reach, 0) - 1, -1):
        if g[d] < g[at]:
            at = d
        elif g[d] > g[at] + 3.0 * noise:
            break
    return at


@njit(cache=True, nogil=True)
def fit_faces(
    slab, expected, other, tilt, air, width, noise, prior, spread, coated, search, result, window=0.0, amid=0.0
):
    """Fit the outer face and the interface of every column of a slab, read from outside to inside.

    Parameters
    ----------
    slab : (rows, cols, depth) float32
        Grey, oriented so that the sheet is brighter than the air.
    expected, other : (rows, cols)
        Depth in voxels of this face and of the opposite one, from the coarse search; NaN where there is no sheet.
    tilt : (rows, cols)
        Cosine of the sheet's tilt: the blur along the column is ``width`` / tilt, in voxels.
    air, noise : float
        Level and standard deviation of a voxel.
    prior, spread : (4,)
        Of (h, t, c, b); those of h are not used. c is the coating, or without one the level outside.
    coated : bool
    search : float
        How far outside the expected face the search starts, in voxels.
    result : (5, rows, cols)
        Set to h, t, c, b and cost; NaN where nothing is found.
    window : float
        Width after which the samples that are fitted are chosen, where it is not ``width``: costs of several widths
        can be compared only over the same samples.
    amid : float
        Above 0: the sheet lies amid other material, from which it was told at this grey. The face is then sought next
        to where it is expected, and no sample beyond the darkest one of the gap counts.
    """
    rows, cols, depth = slab.shape
    matrix = np.zeros((4, 4))
    step = np.zeros(4)
    p = np.zeros(4)
    best = np.zeros(4)
    local = spread.copy()
    local[0] = 0.0
    base_level = air + 0.5 * (prior[3] - air)
    for i in range(rows):
        for j in range(cols):
            for n in range(5):
                result[n, i, j] = np.nan
            e = expected[i, j]
            if not isfinite(e):
                continue
            g = slab[i, j]
            w = width / tilt[i, j]
            v = window / tilt[i, j] if window > 0.0 else w
            middle = 0.5 * (e + other[i, j])
            start = int(floor(e - search / tilt[i, j]))
            stop = int(floor(min(e + search / tilt[i, j], middle))) + 1
            d0 = nearest(g, e, search, amid) if amid > 0.0 else outermost(g, start, stop, base_level)
            if d0 < 0:
                continue
            gap = darkest(g, d0, int(4.0 * v) + 2, noise) if amid > 0.0 else 0
            # Half height between the air and what lies just inside, so that a coating does not pull the start outwards.
            inside = g[d0]
            for d in range(d0, min(d0 + int(2.5 * w) + 2, depth)):
                inside = max(inside, g[d])
            half = 0.5 * ((g[gap] if amid > 0.0 else air) + inside)
            h0 = float(d0)
            for d in range(d0 - 1, min(d0 + int(3 * w) + 3, depth - 1)):
                if d >= 0 and g[d] <= half < g[d + 1]:
                    h0 = d + (half - g[d]) / (g[d + 1] - g[d])
                    break
            thick = 0.0
            if coated:
                mid = 0.5 * (prior[2] + prior[3])
                d = int(h0 + 0.5 * w) + 1
                seen = False
                while d < min(int(middle), depth - 2):
                    smooth = 0.25 * g[d - 1] + 0.5 * g[d] + 0.25 * g[d + 1]
                    if smooth > mid:
                        seen = True
                    elif seen or d - h0 > 2.5 * w:
                        break
                    d += 1
                thick = max(d - 0.5 - h0, 0.7 * w) if seen else 0.7 * w
            cost = 1e300
            lo = hi = 0
            for attempt in range(2 if coated else 1):
                p[0], p[1], p[2], p[3] = h0, thick, prior[2], prior[3]
                if attempt == 1:
                    p[1] = 0.5 * w  # a second start, for a coating thinner than the blur
                    if thick > 4 * w:
                        continue
                lo = max(int(floor(h0 - 3.0 * v)), gap)
                hi = min(int(floor(h0 + thick + 3.0 * v)) + 1, depth - 1)
                hi = max(min(hi, int(middle) + 1), min(int(h0 + 2.0 * v) + 2, depth - 1))
                if amid > 0.0:  # few samples are left where the gap is narrow
                    hi = max(hi, min(lo + 5, int(middle) + 1, depth - 1))
                fine = True
                for d in range(lo, hi + 1):
                    fine = fine and isfinite(g[d])
                # Near an end of the column two widths of the blur must be left.
                if not fine or hi - lo < 4 or h0 < 2.0 * v or h0 + thick > depth - 1 - 2.0 * v:
                    continue
                now = fit_column(g, lo, hi, air, noise, w, p, prior, local, coated, matrix, step)
                if now < cost:
                    cost = now
                    best[:] = p
            if cost < 1e299 and lo - 2 <= best[0] <= hi + 2:
                for n in range(4):
                    result[n, i, j] = best[n]
                result[4, i, j] = cost


@njit(cache=True, nogil=True)
def trilinear(slab, first, deep, r, c, d, fr, fc):
    """Value of slab (rows, cols, depth) at the indices r + fr, c + fc and d - first; NaN outside.

    The slab holds a part of columns that are ``deep`` voxels long.

    r and c are whole; shares of a voxel come apart from them, because the place in a tile must not round them.
    """
    rows, cols, depth = slab.shape
    step_r, step_c = floor(fr), floor(fc)
    i, j = r + int(step_r), c + int(step_c)
    fr, fc = fr - step_r, fc - step_c
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
    a = (slab[i, j, k] * (1 - fd) + slab[i, j, k + 1] * fd) * (1 - fc)
    a += (slab[i, j + 1, k] * (1 - fd) + slab[i, j + 1, k + 1] * fd) * fc
    b = (slab[i + 1, j, k] * (1 - fd) + slab[i + 1, j, k + 1] * fd) * (1 - fc)
    b += (slab[i + 1, j + 1, k] * (1 - fd) + slab[i + 1, j + 1, k + 1] * fd) * fc
    return a * (1 - fr) + b * fr


@njit(cache=True, nogil=True)
def presence(slab, first, deep, lead_r, lead_c, centre, normal_r, normal_c, normal_d, offsets, air, base, out):
    """Share of material along each normal: mean of (g - air) / (base - air), cut to 0..1.

    Parameters
    ----------
    slab : (rows + halo, cols + halo, depth) float32
        Carries ``lead_r`` more rows and ``lead_c`` more columns before the first of the maps.
    first, deep : int
        Depth index of its first voxel, and length of the whole columns.
    centre, normal_r, normal_c, normal_d : (rows, cols)
        Height of the centre surface and the normal, per um, all in voxels.
    offsets : (n,)
        Distances from the centre surface along the normal, in um.
    out : (rows, cols)
        Set; NaN where the normal leaves the slab.
    """
    rows, cols = centre.shape
    for i in range(rows):
        for j in range(cols):
            total, count = 0.0, 0
            for n in range(offsets.size):
                s = offsets[n]
                d = centre[i, j] + s * normal_d[i, j]
                if not isfinite(d):
                    continue
                g = trilinear(slab, first, deep, lead_r + i, lead_c + j, d, s * normal_r[i, j], s * normal_c[i, j])
                if isfinite(g):
                    total += min(max((g - air) / (base - air), 0.0), 1.0)
                    count += 1
            out[i, j] = total / count if count > 0 else np.nan


@njit(cache=True, nogil=True)
def mean_columns(voxels, step, slope_r, slope_c, missing, out):
    """Means of ``step`` x ``step`` columns of voxels, each moved along its depth by the sheet's slope.

    Parameters
    ----------
    voxels : (rows * step, cols * step, depth)
    slope_r, slope_c : (rows, cols)
        Rise of the sheet in voxels of depth, from one voxel row and column to the next.
    missing : float
        Value that counts as missing; NaN where there is none.
    out : (rows, cols, depth) float32
        Set; NaN where a voxel is missing. Beyond the ends of a column its last voxel counts.
    """
    rows, cols, depth = out.shape
    share = np.float32(1.0 / (step * step))
    middle = 0.5 * (step - 1)
    some = missing == missing  # NaN: nothing is missing but NaN itself
    total = np.empty((depth, _ABREAST), dtype=np.float32)
    shift = np.empty(_ABREAST * step, dtype=np.int64)
    for i in range(rows):
        for first in range(0, cols, _ABREAST):
            # Some columns at a time: voxels lie side by side either along the row or along the depth, and this way
            # both are read without jumping.
            count = min(_ABREAST, cols - first)
            total[:] = 0.0
            for a in range(step):
                for m in range(count * step):
                    j = first + m // step
                    move = slope_r[i, j] * (a - middle) + slope_c[i, j] * (m % step - middle)
                    shift[m] = int(floor(move + 0.5)) if isfinite(move) else 0
                row = voxels[i * step + a]
                for d in range(depth):
                    m = 0
                    for n in range(count):
                        part = total[d, n]
                        for _ in range(step):
                            value = row[first * step + m, min(max(d + shift[m], 0), depth - 1)]
                            if some and value == missing:
                                part = np.float32(np.nan)
                            part += np.float32(value)
                            m += 1
                        total[d, n] = part
            for n in range(count):
                for d in range(depth):
                    out[i, first + n, d] = total[d, n] * share


@njit(cache=True, nogil=True)
def dilate_rows(height, drop, sign, out):
    """Largest of ``height`` minus ``drop`` of the distance along each row; the smallest plus it where sign is -1."""
    rows, cols = height.shape
    half = drop.size - 1
    for i in range(rows):
        for j in range(cols):
            best = sign * height[i, j]
            for k in range(max(j - half, 0), min(j + half, cols - 1) + 1):
                best = max(best, sign * height[i, k] - drop[abs(k - j)])
            out[i, j] = sign * best


@njit(cache=True, nogil=True)
def crossing(a, b, level):
    """Share of the way from a to b at which level is passed."""
    return min(max((level - a) / (b - a), 0.0), 1.0) if b != a else 0.5


@njit(cache=True, nogil=True)
def outer_boundaries(grey, expected, other, search, paper, coating, face, thickness):
    """Outermost boundary of the sheet, and thickness of the outermost run of coating, in the columns of one slice.

    Parameters
    ----------
    grey : (cols, depth) float32
        Read from outside to inside.
    expected, other, search : (cols,)
        Where the face and the opposite one are expected, and how far outside the search starts, in voxels.
    paper, coating : float
        Thresholds; an infinite one for a side without a coating.
    face, thickness : (cols,)
        Set; left as they are where nothing is found.
    """
    cols, depth = grey.shape
    for j in range(cols):
        if not isfinite(expected[j]):
            continue
        g = grey[j]
        middle = int(0.5 * (expected[j] + other[j]))
        start = max(int(floor(expected[j] - search[j])), 1)
        d = outermost(g, start, min(middle, depth - 3), paper)
        if d < 1:
            continue
        # The smoothed grey passes up to a voxel beside the grey itself.
        while d > 1 and g[d - 1] > paper:
            d -= 1
        while d < depth - 2 and not g[d] > paper:
            d += 1
        face[j] = d - 1 + crossing(g[d - 1], g[d], paper)
        thickness[j] = 0.0
        if not isfinite(coating):
            continue
        first = d
        while first < middle and first - d < 4 and not g[first] > coating:
            first += 1
        if not g[first] > coating:
            continue
        last = first
        while last < min(middle, depth - 2) and g[last + 1] > coating:
            last += 1
        thickness[j] = max(last + crossing(g[last], g[last + 1], coating) - face[j], 0.0)


@njit(cache=True, nogil=True)
def label_boundaries(codes, expected, other, search, face, thickness):
    """Outermost boundary of base or coating, and thickness of the outermost run of coating, of every column.

    Parameters
    ----------
    codes : (rows, cols, depth) uint8
        0 air, 1 base, 2 void, 3 coating; read from outside to inside.
    expected, other, search : (rows, cols)
        Where the face and the opposite one are expected, and how far outside the search starts, in voxels.
    face, thickness : (rows, cols)
        Set; left as they are where nothing is found.
    """
    rows, cols, depth = codes.shape
    for i in range(rows):
        for j in range(cols):
            if not isfinite(expected[i, j]) or not isfinite(other[i, j]):
                continue
            c = codes[i, j]
            stop = min(int(0.5 * (expected[i, j] + other[i, j])), depth - 2)
            d = max(int(floor(expected[i, j] - search[i, j])), 0)
            while d <= stop and (c[d] == 0 or c[d] == 2):
                d += 1
            if d > stop or d == 0:
                continue
            face[i, j] = d - 0.5
            n = d
            while n < depth and c[n] == 3:
                n += 1
            thickness[i, j] = float(n - d)
