# pyright: standard
"""Compiled inner loops of the fit.

They give the blurred staircase of one column, and the faces of a slab of columns.

A column is read from outside to inside. Its model is a blurred staircase: ``air | coating | base``
with steps at the face ``h`` and the interface ``h + t``,

    g(d) = a + (c - a) P((d - h) / w) + (b - c) P((d - h - t) / w),

with P the normal distribution and w the width of the blur along the column. Without a coating it
has one step, and c is the level outside, which need not be that of the air: ``g(d) = c + (b - c)
P((d - h) / w)``.

A phase-contrast fringe of size f and ``ratio`` r = w / (its own width) adds the second derivative
of a blurred edge: P(x) becomes ``P(x) + f y N(y)`` with ``y = r x`` and N the normal density: an
undershoot outside, an overshoot inside.
"""

from math import exp, floor, isfinite, sqrt

import numpy as np
from scipy.special import ndtr

from planish.core.jit import njit

_ROOT2PI = sqrt(2.0 * np.pi)
_STEPS = 20
_CLOSE = 5e-3  # voxels: a tenth of what noise leaves; the step after it is far smaller
# The normal distribution, linear between 256 nodes a standard deviation: within 5e-7, several times
# faster than erf.
_PER_SIGMA = 256
_LAST = 6
_TABLE = ndtr(np.arange(-_LAST * _PER_SIGMA, _LAST * _PER_SIGMA + 2) / _PER_SIGMA)


@njit(cache=True, nogil=True, inline="always")
def _step(x):
    """Return the normal distribution and its density.

    The density is the table's slope there, bent as the density is between nodes.
    """
    t = (x + _LAST) * _PER_SIGMA
    if t <= 0.0:
        return 0.0, 0.0
    if t >= 2.0 * _LAST * _PER_SIGMA:
        return 1.0, 0.0
    i = int(t)
    share = t - i
    rise = _TABLE[i + 1] - _TABLE[i]
    return _TABLE[i] + share * rise, rise * (_PER_SIGMA - x * (share - 0.5))


@njit(cache=True, nogil=True)
def _bell(x):
    return exp(-0.5 * x * x) / _ROOT2PI


@njit(cache=True, nogil=True, inline="always")
def _edge(x, per_voxel, fringe, ratio):
    """Return the blurred edge with its fringe, x widths from it, and its slope in a voxel.

    ``per_voxel``: widths of the blur in a voxel.
    """
    value, slope = _step(x)
    slope *= per_voxel
    if fringe is not None:
        y = ratio * x
        part = fringe * _bell(y)
        value += y * part
        slope += ratio * (1.0 - y * y) * part * per_voxel
    return value, slope


@njit(cache=True, nogil=True)
def _solve4(m, r, n):
    """Solve the symmetric positive system m[:n, :n] x = r[:n] in place by Cholesky.

    False where it is not positive.
    """
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
def evaluate(
    g, lo, hi, air, noise, w, p, prior, spread, coated, matrix, step, fringe, ratio, wall, depth
):
    """Return the cost at p = (h, t, c, b): squared misfits over the noise, and over the priors.

    Set the lower triangle of ``matrix`` (4, 4) and ``step`` (4,) to the normal equations there. The
    arguments are those of :func:`fit_column`.
    """
    # Sums in variables of their own stay in registers.
    cost = s0 = s1 = s2 = s3 = 0.0
    m00 = m10 = m11 = m20 = m21 = m22 = m30 = m31 = m32 = m33 = 0.0
    scale = 1.0 / (noise * noise)
    face = p[0]
    inside = face + p[1]
    coat = p[2]
    base = p[3]
    per_voxel = 1.0 / w
    for d in range(lo, hi + 1):
        outer, bell = _edge((d - face) * per_voxel, per_voxel, fringe, ratio)
        if coated:
            j3, inner = _edge((d - inside) * per_voxel, per_voxel, fringe, ratio)
            e = g[d] - (air + (coat - air) * outer + (base + wall - coat) * j3)
            j1 = -(base + wall - coat) * inner
            if wall > 0.0:
                below, bell_below = _step((d - inside - depth) * per_voxel)
                e += wall * below
                j1 += wall * bell_below * per_voxel
            j0 = -(coat - air) * bell + j1
            j2 = outer - j3
        else:
            e = g[d] - (coat + (base - coat) * outer)
            j0 = -(base - coat) * bell
            j1 = 0.0
            j2 = 1.0 - outer
            j3 = outer
        cost += e * e
        s0 += j0 * e
        s1 += j1 * e
        s2 += j2 * e
        s3 += j3 * e
        m00 += j0 * j0
        m10 += j1 * j0
        m11 += j1 * j1
        m20 += j2 * j0
        m21 += j2 * j1
        m22 += j2 * j2
        m30 += j3 * j0
        m31 += j3 * j1
        m32 += j3 * j2
        m33 += j3 * j3
    cost *= scale
    step[0] = scale * s0
    step[1] = scale * s1
    step[2] = scale * s2
    step[3] = scale * s3
    matrix[0, 0] = scale * m00
    matrix[1, 0] = scale * m10
    matrix[1, 1] = scale * m11
    matrix[2, 0] = scale * m20
    matrix[2, 1] = scale * m21
    matrix[2, 2] = scale * m22
    matrix[3, 0] = scale * m30
    matrix[3, 1] = scale * m31
    matrix[3, 2] = scale * m32
    matrix[3, 3] = scale * m33
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
                matrix[max(i, j), min(i, j)] = 0.0
            matrix[i, i] = 1.0
            step[i] = 0.0
    return cost


@njit(cache=True, nogil=True)
def fit_column(  # noqa: C901
    g,
    lo,
    hi,
    air,
    noise,
    w,
    p,
    prior,
    spread,
    coated,
    matrix,
    step,
    fringe=None,
    ratio=1.0,
    wall=0.0,
    depth=0.0,
):
    """Fit p = (h, t, c, b) to g[lo:hi+1] by Levenberg-Marquardt; return the cost per sample.

    ``g`` (depth,), read from outside; ``air`` and ``noise``: level of the air and what a sample
    differs by from its model; ``w``: width of the blur along the column, in voxels. ``p`` (4,)
    holds the start and is set to the fit. ``prior`` and ``spread`` (4): Gaussian prior on p; a
    spread of 0 means none, below 0 holds the value fixed. Without a coating (``coated``) t is left
    as it is. ``matrix`` (4, 4) and ``step`` (4,) are room to work in. ``fringe`` (None: none),
    ``ratio``, ``wall`` and ``depth``, here along the column, are as for :func:`fit_faces`.
    """
    damping = 1e-3
    old = np.empty((6, 4))  # matrix, step and p before a trial
    problem = (
        g,
        lo,
        hi,
        air,
        noise,
        w,
        p,
        prior,
        spread,
        coated,
        matrix,
        step,
        fringe,
        ratio,
        wall,
        depth,
    )
    cost = evaluate(*problem)
    for _ in range(_STEPS):
        for i in range(4):
            for j in range(i + 1):
                old[i, j] = matrix[i, j]
            old[4, i], old[5, i] = step[i], p[i]
            matrix[i, i] *= 1.0 + damping
            matrix[i, i] += 1e-12
        if not _solve4(matrix, step, 4):
            break
        move = max(abs(step[0]), abs(step[1]))
        step[0] = min(max(step[0], -1.5 * w), 1.5 * w)
        step[1] = min(max(step[1], -2.0 * w), 2.0 * w)
        for i in range(4):
            p[i] += step[i]
        p[1] = max(p[1], 0.0)
        new = evaluate(*problem)
        if new <= cost:
            cost = new
            damping *= 0.1
            if move < _CLOSE:
                break
        else:
            for i in range(4):
                for j in range(i + 1):
                    matrix[i, j] = old[i, j]
                step[i], p[i] = old[4, i], old[5, i]
            damping *= 10.0
            if damping > 1e7:
                break
    return cost / (hi - lo + 1)


@njit(cache=True, nogil=True)
def outermost(g, start, stop, level):
    """Find the first index in [start, stop] from which the lightly smoothed g stays above level.

    It stays there for two samples; without such an index the result is -1.
    """
    for d in range(max(start, 1), min(stop, g.size - 3) + 1):
        here = 0.25 * g[d - 1] + 0.5 * g[d] + 0.25 * g[d + 1]
        then = 0.25 * g[d] + 0.5 * g[d + 1] + 0.25 * g[d + 2]
        if here > level and then > level:
            return d
    return -1


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
def _guess(g, d0, air, w, middle, prior, coated):
    """Where the fit starts: depth of the face next to sample d0, and thickness of the coating.

    The face where the grey passes half of its rise. The coating ends where the lightly smoothed
    grey, once it was as light as coating, falls below half way between coating and base; it is
    sought down to ``middle``.
    """
    depth = g.size
    # Half height between the air and what lies just inside, so that a coating does not pull the
    # start outwards.
    inside = g[d0]
    for d in range(d0, min(d0 + int(2.5 * w) + 2, depth)):
        inside = max(inside, g[d])
    half = 0.5 * (air + inside)
    h0 = float(d0)
    for d in range(d0 - 1, min(d0 + int(3 * w) + 3, depth - 1)):
        if d >= 0 and g[d] <= half < g[d + 1]:
            h0 = d + (half - g[d]) / (g[d + 1] - g[d])
            break
    if not coated:
        return h0, 0.0
    mid = 0.5 * (prior[2] + prior[3])
    d = int(h0 + 0.5 * w) + 1
    seen = False
    while d < min(int(middle), depth - 2):
        if 0.25 * g[d - 1] + 0.5 * g[d] + 0.25 * g[d + 1] > mid:
            seen = True
        elif seen or d - h0 > 2.5 * w:
            break
        d += 1
    return h0, max(d - 0.5 - h0, 0.7 * w) if seen else 0.7 * w


@njit(cache=True, nogil=True)
def is_finite(g, lo, hi):
    """Whether all of g[lo:hi+1] is finite."""
    finite = True
    for d in range(lo, hi + 1):
        finite = finite and isfinite(g[d])
    return finite


@njit(cache=True, nogil=True)
def fit_faces(  # noqa: C901, PLR0912
    slab,
    expected,
    other,
    tilt,
    air,
    width,
    noise,
    prior,
    spread,
    coated,
    search,
    result,
    window=0.0,
    amid=0.0,
    fringe=None,
    ratio=1.0,
    reverse=False,
    wall=0.0,
    wall_depth=0.0,
):
    """Fit the outer face and the interface of every column of a slab, read from outside to inside.

    slab          : (rows, cols, depth) float32, grey, oriented so that the sheet is lighter than
                    the air
    expected      : (rows, cols), depth in voxels of this face, and ``other`` of the opposite one,
                    from the coarse search; NaN where there is no sheet
    tilt          : (rows, cols), cosine of the sheet's tilt: the blur along the column is ``width``
                    / tilt, in voxels
    air, noise    : level and standard deviation of a voxel
    prior, spread : (4,), of (h, t, c, b); those of h are not used. c is the coating, or without one
    (not ``coated``)
                    the level outside
    search        : how far outside the expected face the search starts, in voxels; 0: the fit
                    starts at the expected face
    result        : (5, rows, cols), set to h, t, c, b and cost; NaN where nothing is found
    window        : width after which the samples that are fitted are chosen, where it is not
    ``width``: costs of
                    several widths can be compared only over the same samples
    amid          : above 0: the sheet lies amid other material, from which it was separated at this
                    grey. The face is then sought next to where it is expected, and no sample beyond
                    the darkest one of the gap counts
    fringe, ratio : size of the phase-contrast fringe, and width of the blur over that of the
                    fringe. None is compiled apart, which makes the fit of an edge without a fringe
                    as quick as if there were none
    reverse       : whether the slab is read from its far end; ``expected`` and ``other`` are
                    counted from there
    wall          : by how much what lies directly below a coating is lighter than the base, and
    wall_depth    : down to where it is, in voxels at a right angle to the sheet
    """
    rows, cols, depth = slab.shape
    matrix = np.zeros((4, 4))
    step = np.zeros(4)
    p = np.zeros(4)
    best = np.zeros(4)
    g = np.empty(depth, np.float32)
    local = spread.copy()
    local[0] = 0.0
    base_level = air + 0.5 * (prior[3] - air)
    # Where the noise is as strong as half of the base, the coating or a wall passes more.
    if coated:
        base_level = max(base_level, air + min(2.5 * noise, 0.25 * (prior[2] - air)))
    result[:] = np.nan
    for i in range(rows):
        for j in range(cols):
            e = expected[i, j]
            if not isfinite(e):
                continue
            if reverse:
                g[:] = slab[i, j, ::-1]
            else:
                g = slab[i, j]
            w = width / tilt[i, j]
            v = window / tilt[i, j] if window > 0.0 else w
            middle = 0.5 * (e + other[i, j])
            deepest = e + 0.75 * (other[i, j] - e) if coated else middle
            start = int(floor(e - search / tilt[i, j]))
            stop = int(floor(min(e + search / tilt[i, j], middle))) + 1
            if search == 0.0:
                d0 = int(floor(e + 0.5))
            elif amid > 0.0:
                d0 = nearest(g, e, search, amid)
            else:
                d0 = outermost(g, start, stop, base_level)
            if d0 < 0:
                continue
            gap = darkest(g, d0, int(4.0 * v) + 2, noise) if amid > 0.0 else 0
            h0, thick = _guess(g, d0, g[gap] if amid > 0.0 else air, w, deepest, prior, coated)
            cost = 1e300
            lo = hi = 0
            for attempt in range(2 if coated else 1):
                p[0] = h0
                p[1] = thick
                p[2:] = prior[2:]
                if attempt == 1:
                    p[1] = 0.5 * w  # a second start, for a coating thinner than the blur
                    if thick > 4 * w:
                        continue
                lo = max(int(floor(h0 - 3.0 * v)), gap)
                hi = min(int(floor(h0 + thick + 3.0 * v)) + 1, depth - 1)
                least_hi = min(int(h0 + 2.0 * v) + 2, depth - 1)
                hi = max(min(hi, int(deepest) + 1), least_hi)
                if amid > 0.0:  # few samples are left where the gap is narrow
                    hi = max(hi, min(lo + 5, int(middle) + 1, depth - 1))
                # Near an end of the column two widths of the blur must be left.
                near_end = h0 < 2.0 * v or h0 + thick > depth - 1 - 2.0 * v
                if near_end or hi - lo < 4 or not is_finite(g, lo, hi):
                    continue
                local[3] = spread[3]
                problem = (
                    g,
                    lo,
                    hi,
                    air,
                    noise,
                    w,
                    p,
                    prior,
                    local,
                    coated,
                    matrix,
                    step,
                    fringe,
                    ratio,
                )
                now = fit_column(*problem, wall, wall_depth / tilt[i, j])
                if coated and p[3] > 0.5 * (prior[2] + prior[3]):
                    # No base is as bright: this is coating in a valley that the blur dims from the
                    # sides.
                    local[3] = -1.0
                    p[0] = h0
                    p[1] = thick
                    p[2:] = prior[2:]
                    now = fit_column(*problem, wall, wall_depth / tilt[i, j])
                if now < cost:
                    cost = now
                    best[:] = p
            if cost < 1e299 and lo - 2 <= best[0] <= hi + 2:
                for n in range(4):
                    result[n, i, j] = best[n]
                result[4, i, j] = cost
