# pyright: standard
"""Closed outlines around a hole: of several edges on a ray, one all the way round.

Images as in `_edge_kernels`.
"""

import numpy as np

from planish.core.jit import njit
from planish.marks._edge_kernels import along, ray, rise

# A step of this share of the whole one makes a rim as good as any; the innermost of those is taken,
# where going out by a radius costs as much as this share of the rays without an edge. A rim lies in
# a band of this share of the radius.
ENOUGH, OUTWARDS, BAND = 0.22, 0.5, 0.12
# What a step sideways costs, of the worth of an edge, and how many a ray may make.
SIDEWAYS, MOST_STEPS = 0.1, 1


@njit(cache=True, nogil=True)
def polar_rises(image, px, py, sign, cx, cy, dt, count, reach, rays):
    """Give the rise (rays, count) of the mean outside a radius (of ``dt``) over that inside.

    The means are over ``reach`` samples; the rise may be NaN.

    The centre is ``cx, cy`` in um; ``dt`` is the step along a ray, in um.
    """
    rises = np.full((rays, count), np.nan)
    sums = np.empty(count + 1)
    centre = cx / px, cy / py
    for k in range(rays):
        step = ray(k, rays, dt, px, py)
        sums[0] = 0.0
        for t in range(count):
            sums[t + 1] = sums[t] + sign * along(image, centre, step, t)
        for t in range(reach, count - reach):
            rises[k, t] = rise(sums, t, reach) / reach
    return rises


@njit(cache=True, nogil=True)
def edge_worth(rises, step):
    """Give the worth of each place (rays, count), up to 1 at a rise of ``step``.

    Maxima along a ray and places beside them have worth, all else has 0.
    """
    rays, count = rises.shape
    worth = np.zeros((rays, count))
    for k in range(rays):
        for t in range(1, count - 1):
            here = rises[k, t]
            if here > 0.0 and here >= rises[k, t - 1] and here >= rises[k, t + 1]:
                value = min(here / step, 1.0) if step != 0.0 else 1.0  # of saturated paper
                for s in range(t - 1, t + 2):
                    worth[k, s] = max(worth[k, s], value)
    return worth


@njit(cache=True, nogil=True)
def rim_radius(worth, first, last, least_band, outwards):
    """Return the radius (index) in a range in whose band most rays have an edge.

    Also its half band and the share of these rays.

    ``first`` and ``last`` are the range, ``least_band`` is half of the narrowest band, all in steps
    along a ray; going out by a step costs ``outwards`` of the rays.
    """
    rays, count = worth.shape
    best = -np.inf
    at = -1
    half = 0
    for t in range(first, min(last, count - 1) + 1):
        band = max(least_band, int(round(BAND * t)))
        total = 0.0
        for k in range(rays):
            top = 0.0
            for s in range(max(0, t - band), min(count, t + band + 1)):
                top = max(top, worth[k, s])
            total += top
        if total / rays - outwards * t > best:
            best = total / rays - outwards * t
            at = t
            half = band
    return at, half, best + outwards * at


@njit(cache=True, nogil=True)
def closed_path(worth, first, last):
    """Find the place on each ray of the closed path of most worth between two radii.

    By dynamic programming, with both radii included.

    ``worth`` (rays, count) is that of `edge_worth`; ``first`` and ``last`` are in steps along a
    ray, as the result (rays,) is. Twice around, so that the path has no end at the first ray.
    """
    rays = worth.shape[0]
    count = min(last, worth.shape[1] - 1) + 1 - first
    worth = worth[:, first : first + count]
    best = worth[0].copy()
    came = np.zeros((2 * rays, count), np.int64)
    after = np.empty(count)
    for k in range(1, 2 * rays):
        for t in range(count):
            after[t] = -np.inf
            for s in range(max(0, t - MOST_STEPS), min(count, t + MOST_STEPS + 1)):
                value = best[s] - SIDEWAYS * abs(t - s)
                if value > after[t]:
                    after[t] = value
                    came[k, t] = s
            after[t] += worth[k % rays, t]
        best, after = after, best
    path = np.zeros(rays, np.int64)
    t = np.argmax(best)
    # The middle of the two turns: its ends do not know where the other is.
    for k in range(2 * rays - 1, rays // 2 - 1, -1):
        if k < rays // 2 + rays:
            path[k % rays] = first + t
        t = came[k, t]
    return path


@njit(cache=True, nogil=True)
def _window(centre, radius, pixel, count):
    """First row (or column) within a radius, and the one behind the last."""
    first = max(int((centre - radius) / pixel) + 1, 0)
    return first, min(int((centre + radius) / pixel) + 1, count)


@njit(cache=True, nogil=True)
def floor_middle(image, px, py, sign, cx, cy, radius, level, tolerance):
    """Return the centroid of what is as dark as the floor within a circle.

    Its centre where that is nothing.

    The circle is ``cx, cy, radius`` in um. As dark is what differs from ``level``, a grey times
    ``sign``, by ``tolerance`` at most.
    """
    total = 0
    tx = 0.0
    ty = 0.0
    i0, i1 = _window(cy, radius, py, image.shape[0])
    j0, j1 = _window(cx, radius, px, image.shape[1])
    for i in range(i0, i1):
        for j in range(j0, j1):
            is_floor = abs(sign * image[i, j] - level) <= tolerance
            if is_floor and np.hypot(j * px - cx, i * py - cy) <= radius:
                total += 1
                tx += j * px
                ty += i * py
    return (tx / total, ty / total) if total > 0 else (cx, cy)


@njit(cache=True, nogil=True)
def darkest_beyond(image, px, py, sign, cx, cy, model, beyond, width):
    """Return the least mean grey, times sign, of the sectors just outside an outline.

    They are ``width`` rays wide and reach from the radii ``model`` (n,) outwards by a share of
    them, ``beyond``, or as far as there are data. Sectors with a ray without a radius or without
    data are left out; NaN if all are.
    """
    rays = model.size
    means = np.full(rays, np.nan)
    centre = cx / px, cy / py
    for k in range(rays):
        if model[k] != model[k]:
            continue
        step = ray(k, rays, 1.0, px, py)
        # A model that bends to the other side of its centre has no length there.
        count = max(0, int(2 * beyond * model[k] / min(px, py))) + 2
        total = 0.0
        used = 0
        for t in range(count):
            r = model[k] * (1.0 + beyond * t / (count - 1))
            value = sign * along(image, centre, step, r)
            if value != value:
                break
            total += value
            used += 1
        if used > 0:
            means[k] = total / used
    darkest = np.nan
    for k in range(rays):
        total = 0.0
        for s in range(width):
            total += means[(k + s) % rays]
        mean = total / width
        if mean == mean and not (mean >= darkest):
            darkest = mean
    return darkest


@njit(cache=True, nogil=True)
def middles_of_floors(image, px, py, xs, ys, sign, radius, level):
    """Return centroids (n, 2) of what is below a level within a radius, followed until they rest.

    NaN if too little.

    ``xs, ys`` (n,) and ``radius`` are in um, ``level`` is a grey times ``sign``.
    """
    out = np.full((xs.size, 2), np.nan)
    for h in range(xs.size):
        x = xs[h]
        y = ys[h]
        for _turn in range(6):
            total = 0
            tx = 0.0
            ty = 0.0
            i0, i1 = _window(y, radius, py, image.shape[0])
            j0, j1 = _window(x, radius, px, image.shape[1])
            for i in range(i0, i1):
                for j in range(j0, j1):
                    is_dark = sign * image[i, j] < level
                    if is_dark and np.hypot(j * px - x, i * py - y) <= radius:
                        total += 1
                        tx += j * px
                        ty += i * py
            # A hole fills a third of the circle even where the place is poor, or its wall is wide.
            if 3 * total * px * py < np.pi * radius * radius:
                x = np.nan
                y = np.nan
                break
            shift = np.hypot(tx / total - x, ty / total - y)
            x = tx / total
            y = ty / total
            if shift < 0.2 * max(px, py):
                break
        out[h] = x, y
    return out
