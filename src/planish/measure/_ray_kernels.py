# pyright: standard
"""Compiled inner loops on rays: grey values along them, integrals, lengths and layers.

A profile is what lies between its samples too: linear from one to the next. A length is then exact for such a profile
and does not jump by whole samples. A piece of a ray that is not wholly known has no integral and no length.
"""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def resample_rays(block, corner, first, wide, depth, step_r, step_c, step_d, wanted, low, ds, padding, padded, out):
    """Trilinear grey along rays through a part of the volume.

    Parameters
    ----------
    block : (rows, cols, depth)
        Part of the volume.
    corner : (3,) int
        Index in the volume of the block's first voxel.
    first : int
        Row of the sheet that the first row of rays belongs to.
    wide : int
        Voxels along the edge of a column; its ray starts in the middle of them.
    depth : (ray rows, cols)
        Index along the axis through the sheet at which a ray has s = 0.
    step_r, step_c, step_d : (ray rows, cols)
        Voxels per um along the ray.
    wanted : (ray rows, cols) bool
    low, ds : int, float
        Sample k lies at s = (low + k) ds, um.
    padding, padded : float, bool
        Value of what lies outside the field of view, where there is one.
    out : (ray rows, cols, samples)
        Set; NaN outside the block, and beside what is missing.
    """
    rows, cols, count = out.shape
    height, width, deep = block.shape
    middle = 0.5 * (wide - 1)
    for i in range(rows):
        for j in range(cols):
            at_r, at_c = wide * (first + i) + middle, wide * j + middle
            if not wanted[i, j]:
                out[i, j, :] = np.nan
                continue
            sr, sc, sd, d0 = step_r[i, j], step_c[i, j], step_d[i, j], depth[i, j]
            # A ray whose two ends lie well inside the block needs no look at its border on the way.
            sure = True
            for k in (0, count - 1):
                s = (low + k) * ds
                r, c, d = at_r + s * sr - corner[0], at_c + s * sc - corner[1], d0 + s * sd - corner[2]
                sure = sure and 0.0 <= r < height - 1.001 and 0.0 <= c < width - 1.001 and 0.0 <= d < deep - 1.001
            for k in range(count):
                s = (low + k) * ds
                # Coordinates are those of the whole volume: rounding must not depend on the block.
                r, c, d = at_r + s * sr, at_c + s * sc, d0 + s * sd
                if sure:
                    r0, c0, d0i = int(r), int(c), int(d)
                else:
                    r0, c0, d0i = int(np.floor(r)), int(np.floor(c)), int(np.floor(d))
                fr, fc, fd = r - r0, c - c0, d - d0i
                r0, c0, d0i = r0 - corner[0], c0 - corner[1], d0i - corner[2]
                r1, c1, d1 = r0 + (fr > 0), c0 + (fc > 0), d0i + (fd > 0)
                if not sure and (
                    r0 < 0 or c0 < 0 or d0i < 0 or r1 >= height or c1 >= width or d1 >= deep
                ):  # fmt: skip
                    out[i, j, k] = np.nan
                    continue
                a, b = float(block[r0, c0, d0i]), float(block[r0, c0, d1])
                e, f = float(block[r0, c1, d0i]), float(block[r0, c1, d1])
                p, q = float(block[r1, c0, d0i]), float(block[r1, c0, d1])
                u, v = float(block[r1, c1, d0i]), float(block[r1, c1, d1])
                if padded and (
                    a == padding or b == padding or e == padding or f == padding
                    or p == padding or q == padding or u == padding or v == padding
                ):  # fmt: skip
                    out[i, j, k] = np.nan
                    continue
                near = (a * (1 - fd) + b * fd) * (1 - fc) + (e * (1 - fd) + f * fd) * fc
                far = (p * (1 - fd) + q * fd) * (1 - fc) + (u * (1 - fd) + v * fd) * fc
                value = near * (1 - fr) + far * fr
                out[i, j, k] = value if np.isfinite(value) else np.nan


@njit(cache=True, nogil=True)
def _integral(g, x0, x1):
    """Integral of one profile between two places in samples."""
    if not (x0 >= 0 and x1 <= g.size - 1):
        return np.nan
    total = 0.0
    if x1 <= x0:
        return total
    k = int(x0)
    while k < x1:
        a, b = max(x0 - k, 0.0), min(x1 - k, 1.0)
        if b > a:
            g0 = float(g[k])
            g1 = float(g[k + 1]) if k + 1 < g.size else g0
            total += (b - a) * (g0 + (g1 - g0) * 0.5 * (a + b))
        k += 1
    return total


@njit(cache=True, nogil=True)
def _length(g, x0, x1, least, most):
    """Length in samples on which least <= g <= most between two places; the number of its ends on the way."""
    if not (x0 >= 0 and x1 <= g.size - 1):
        return np.nan, 0
    total = 0.0
    ends = 0
    if x1 <= x0:
        return total, ends
    k = int(x0)
    while k < x1:
        a, b = max(x0 - k, 0.0), min(x1 - k, 1.0)
        if b > a:
            g0 = float(g[k])
            g1 = float(g[k + 1]) if k + 1 < g.size else g0
            v0, v1 = g0 + (g1 - g0) * a, g0 + (g1 - g0) * b
            if not (np.isfinite(v0) and np.isfinite(v1)):
                return np.nan, 0
            lo, hi = min(v0, v1), max(v0, v1)
            if hi == lo:
                if least <= lo <= most:
                    total += b - a
            else:
                total += (b - a) * max(min(hi, most) - max(lo, least), 0.0) / (hi - lo)
                ends += int(lo < least <= hi) + int(lo <= most < hi)
        k += 1
    return total, ends


@njit(cache=True, nogil=True)
def integrals(grey, s0, ds, lower, upper):
    """Integral of the grey between two places on each ray.

    Parameters
    ----------
    grey : (rows, cols, samples)
    s0, ds : float
        First sample and step, um.
    lower, upper : (rows, cols)
        um.

    Returns
    -------
    (rows, cols)
        Grey times um; 0 where upper lies below lower, NaN where the ray is not known in between.
    """
    rows, cols, _ = grey.shape
    out = np.empty((rows, cols))
    for i in range(rows):
        for j in range(cols):
            out[i, j] = ds * _integral(grey[i, j], (lower[i, j] - s0) / ds, (upper[i, j] - s0) / ds)
    return out


@njit(cache=True, nogil=True)
def lengths(grey, s0, ds, lower, upper, least, most):
    """Length in um with least <= grey <= most between two places on each ray, and the number of its ends there."""
    rows, cols, _ = grey.shape
    out = np.empty((rows, cols))
    ends = np.zeros((rows, cols), dtype=np.int32)
    for i in range(rows):
        for j in range(cols):
            length, n = _length(grey[i, j], (lower[i, j] - s0) / ds, (upper[i, j] - s0) / ds, least, most)
            out[i, j] = ds * length
            ends[i, j] = n
    return out, ends


@njit(cache=True, nogil=True)
def layers(grey, s0, ds, face, inward, level, polarity, reach, gap, limit):
    """Outermost connected layer of what lies beyond a grey level, from the face inwards.

    Parameters
    ----------
    grey : (rows, cols, samples)
    face : (rows, cols)
        Place of the face, um.
    inward : float
        -1 from the top, +1 from the bottom.
    level, polarity : float
        The layer is where polarity (grey - level) > 0.
    reach : (rows, cols)
        um below the face within which the layer must begin.
    gap : float
        um: a shorter gap does not end the layer.
    limit : (rows, cols)
        Place on the ray at which the search ends, um.

    Returns
    -------
    summed, envelope : (rows, cols)
        Summed length and distance from the face to the layer's inner end, um; the blurred flank between the face and
        the first crossing counts as layer. 0 where it does not begin.
    ends : (rows, cols)
        Crossings inside the layer.
    """
    rows, cols, count = grey.shape
    summed, envelope = np.empty((rows, cols)), np.empty((rows, cols))
    ends = np.zeros((rows, cols), dtype=np.int32)
    for i in range(rows):
        for j in range(cols):
            summed[i, j] = envelope[i, j] = np.nan
            x = (face[i, j] - s0) / ds
            stop = abs(limit[i, j] - face[i, j]) / ds
            if not (0 <= x <= count - 1 and stop >= 0):
                continue
            g = grey[i, j]
            # Depth below the face, in samples, at the samples next to it and beyond.
            k = int(np.floor(x)) if inward < 0 else int(np.ceil(x))
            step = -1 if inward < 0 else 1
            inside = True  # the flank below the face
            begun = False
            total, last, n = 0.0, 0.0, 0
            since = 0.0  # depth at which the present piece began
            before = polarity * (float(g[k]) - level)
            if before > 0:
                begun = True
            whole = np.isfinite(before)
            while whole:
                at = abs(k - x)
                following = k + step
                if following < 0 or following >= count or at >= stop:
                    if inside and begun:
                        total += min(at, stop) - since
                        last = min(at, stop)
                    break
                value = polarity * (float(g[following]) - level)
                if not np.isfinite(value):
                    whole = False
                    break
                if not begun:
                    if value > 0:
                        begun = True
                    elif at * ds > reach[i, j]:
                        break
                elif inside and value <= 0:
                    end = at + before / (before - value)
                    total += end - since
                    last = end
                    inside = False
                    n += 1
                elif not inside:
                    if value > 0:
                        start = at + before / (before - value)
                        if (start - last) * ds > gap:
                            break
                        inside = True
                        since = start
                        n += 1
                    elif (at - last) * ds > gap:
                        break
                before = value
                k = following
            if whole:
                summed[i, j] = ds * total
                envelope[i, j] = ds * last
                ends[i, j] = n
    return summed, envelope, ends


@njit(cache=True, nogil=True)
def depths_of_shares(grey, s0, ds, face, limit, least, most, shares):
    """Depth below the face within which given shares of a phase's length lie.

    Parameters
    ----------
    face, limit : (rows, cols)
        From the face down to the limit, um; the limit lies below.
    least, most : float
        The phase's grey range.
    shares : (n,)
        Of the length between face and limit, ascending.

    Returns
    -------
    depth : (n, rows, cols)
        um; NaN where there is no such phase.
    total : (rows, cols)
        Length of the phase, um.
    """
    rows, cols, _ = grey.shape
    depth = np.full((shares.size, rows, cols), np.nan)
    total = np.empty((rows, cols))
    for i in range(rows):
        for j in range(cols):
            g = grey[i, j]
            x1, x0 = (face[i, j] - s0) / ds, (limit[i, j] - s0) / ds
            whole, _n = _length(g, x0, x1, least, most)
            total[i, j] = whole * ds
            if not whole > 0:
                continue
            done = 0.0
            at = x1
            q = 0
            while q < shares.size and at > x0:
                below = max(np.ceil(at) - 1.0, x0)
                piece, _n = _length(g, below, at, least, most)
                while q < shares.size and done + piece >= shares[q] * whole * (1 - 1e-12):
                    # Inside the piece by bisection: its length is monotone.
                    low, high = below, at
                    for _ in range(30):
                        middle = 0.5 * (low + high)
                        part, _n = _length(g, middle, at, least, most)
                        if done + part >= shares[q] * whole * (1 - 1e-12):
                            low = middle
                        else:
                            high = middle
                    depth[q, i, j] = (x1 - low) * ds
                    q += 1
                done += piece
                at = below
    return depth, total
