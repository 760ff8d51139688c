# pyright: standard
"""Compiled inner loops on rays.

Where they meet the faces, grey along them, integrals, lengths and layers.

A profile is what lies between its samples too: linear from one to the next. A length is then exact
for such a profile and does not jump by whole samples. A piece of a ray that is not wholly known has
no integral and no length.
"""

import numpy as np

from planish.core._cubic_kernels import cubic_value
from planish.core.jit import njit

_STEPS = 12
_CLOSE_UM = 1e-4
_HALF = 0.5


@njit(cache=True, nogil=True)
def height_at(field, r, c, is_cubic):
    """Height at fractional row and column; NaN beside two missing nodes, or right at one.

    With ``is_cubic`` it is that of cubic convolution where all nodes around are known; bilinear
    elsewhere. A column in which one face was not found has good neighbours as a rule: the plane
    through the other three nodes speaks for it, where they hold half of the weight or more. The
    outermost cells reach one node further than the field, so that a normal at the border, which
    leans outwards by a fraction of the sheet's thickness, still meets its faces. Beyond that NaN.
    """
    rows, cols = field.shape
    if not (-1.0 <= r <= rows and -1.0 <= c <= cols):
        return np.nan
    i = min(max(int(r), 0), rows - 2)
    j = min(max(int(c), 0), cols - 2)
    fr, fc = r - i, c - j
    if is_cubic:
        height = cubic_value(field, i, j, fr, fc)
        if np.isfinite(height):
            return height
    p, q = field[i, j], field[i, j + 1]
    s, t = field[i + 1, j], field[i + 1, j + 1]
    if not np.isfinite(p) and (1 - fr) * (1 - fc) <= _HALF:
        p = q + s - t
    elif not np.isfinite(q) and (1 - fr) * fc <= _HALF:
        q = p + t - s
    elif not np.isfinite(s) and fr * (1 - fc) <= _HALF:
        s = p + t - q
    elif not np.isfinite(t) and fr * fc <= _HALF:
        t = q + s - p
    a = p * (1 - fc) + q * fc
    b = s * (1 - fc) + t * fc
    return a * (1 - fr) + b * fr


@njit(cache=True, nogil=True)
def _meet(surface, node, ray, s0, f0, s1, is_cubic):
    """Distance along a ray at which it meets a surface, um; NaN where none is found.

    node     : (row, column, height) that the ray starts from
    ray      : rows, columns and um of height that it passes in each um
    s0, f0   : a distance, and by how much the surface lies above the ray there
    s1       : another distance, nearer to where they meet
    is_cubic : as for :func:`height_at`
    """
    for _ in range(_STEPS):
        f1 = height_at(surface, node[0] + s1 * ray[0], node[1] + s1 * ray[1], is_cubic)
        f1 -= node[2] + s1 * ray[2]
        if not np.isfinite(f1):
            break
        if abs(f1) < _CLOSE_UM:
            return s1
        # The surface is nearly parallel, so secant steps converge in three or four.
        slope = (f1 - f0) / (s1 - s0) if abs(s1 - s0) > 1e-9 else -ray[2]
        if not (-4.0 < slope < -0.05):
            slope = -ray[2]
        s0, f0 = s1, f1
        s1 = s1 - f1 / slope
    return np.nan


@njit(cache=True, nogil=True)
def along_normals(surface, centre, normal_r, normal_c, normal_h, pitch_r, pitch_c):
    """Signed distance (rows, cols) from a centre surface to another along unit vectors, um.

    NaN where it is not met.

    ``surface`` and ``centre``, (rows, cols): heights in um. ``normal_r``, ``normal_c``,
    ``normal_h``, (rows, cols): the unit vectors along rows, columns and height. Pitches in um.
    """
    rows, cols = centre.shape
    out = np.full((rows, cols), np.nan)
    for i in range(rows):
        for j in range(cols):
            nh = normal_h[i, j]
            f0 = surface[i, j] - centre[i, j]
            if not (np.isfinite(f0) and np.isfinite(nh)):
                continue
            node = (float(i), float(j), centre[i, j])
            ray = (normal_r[i, j] / pitch_r, normal_c[i, j] / pitch_c, nh)
            s = _meet(surface, node, ray, 0.0, f0, f0 * nh, False)
            # On the steps of labels the curved surface is not met by all: there it stays at that.
            closer = _meet(surface, node, ray, 0.0, f0, s, True)
            out[i, j] = closer if np.isfinite(closer) else s
    return out


@njit(cache=True, nogil=True)
def resample_rays(
    block, corner, first, wide, depth, step_r, step_c, step_d, wanted, low, ds, padding, out
):
    """Trilinear grey along rays through a part of the volume; ``wanted`` ones only.

    block           : (rows, cols, depth), the part of the volume
    corner          : (3,) int, index in the volume of the block's first voxel
    first           : row of the sheet that the first row of rays belongs to
    wide            : voxels along the edge of a column; its ray starts in the middle of them
    depth           : (ray rows, cols), index along the axis through the sheet at which a ray has s
    = 0
    step_r, _c, _d  : (ray rows, cols), voxels per um along the ray
    wanted          : (ray rows, cols) bool
    low, ds         : sample k lies at s = (low + k) ds, um; low is an int
    padding         : value of what lies outside the field of view; NaN where there is none
    out             : (ray rows, cols, samples) of NaN, which stays outside the block and beside
    what is missing
    """
    rows, cols, count = out.shape
    height, width, deep = block.shape
    middle = 0.5 * (wide - 1)
    for i in range(rows):
        at_r = wide * (first + i) + middle
        for j in range(cols):
            if not wanted[i, j]:
                continue
            at_c = wide * j + middle
            sr = step_r[i, j]
            sc = step_c[i, j]
            sd = step_d[i, j]
            for k in range(count):
                s = (low + k) * ds
                # Coordinates are those of the whole volume: rounding must not depend on the block.
                r0, r1, fr = _beside(at_r + s * sr, corner[0])
                c0, c1, fc = _beside(at_c + s * sc, corner[1])
                d0, d1, fd = _beside(depth[i, j] + s * sd, corner[2])
                if r0 < 0 or c0 < 0 or d0 < 0 or r1 >= height or c1 >= width or d1 >= deep:
                    continue
                a = _seen(block[r0, c0, d0], padding)
                b = _seen(block[r0, c0, d1], padding)
                e = _seen(block[r0, c1, d0], padding)
                f = _seen(block[r0, c1, d1], padding)
                p = _seen(block[r1, c0, d0], padding)
                q = _seen(block[r1, c0, d1], padding)
                u = _seen(block[r1, c1, d0], padding)
                v = _seen(block[r1, c1, d1], padding)
                near = (a * (1 - fd) + b * fd) * (1 - fc) + (e * (1 - fd) + f * fd) * fc
                far = (p * (1 - fd) + q * fd) * (1 - fc) + (u * (1 - fd) + v * fd) * fc
                value = near * (1 - fr) + far * fr
                if np.isfinite(value):
                    out[i, j, k] = value


@njit(cache=True, nogil=True)
def _beside(place, corner):
    """Indices in a block of the voxels before and after a place, and its share of the way."""
    before = int(np.floor(place))
    share = place - before
    before -= corner
    return before, before + (share > 0), share


@njit(cache=True, nogil=True)
def _seen(grey, padding):
    """Grey of a voxel as a float; NaN outside the field of view."""
    return np.nan if grey == padding else float(grey)


@njit(cache=True, nogil=True)
def _piece(g, x0, x1, least, most):
    """Integrate a profile g (samples,) between two places x0 <= x1, in samples.

    Also gives the length on which least <= g <= most, in samples, and how many ends of it lie on
    the way: places at which the profile passes one of the two levels. NaN, NaN and 0 where a place
    lies outside the profile, or a sample on the way is not known.
    """
    if not (x0 >= 0 and x1 <= g.size - 1):
        return np.nan, np.nan, 0
    total = length = 0.0
    ends = 0
    k = int(x0)
    while k < x1 and x0 < x1:
        a = max(x0 - k, 0.0)
        b = min(x1 - k, 1.0)
        if b > a:
            g0 = float(g[k])
            g1 = float(g[k + 1]) if k + 1 < g.size else g0
            total += (b - a) * (g0 + (g1 - g0) * 0.5 * (a + b))
            v0 = g0 + (g1 - g0) * a
            v1 = g0 + (g1 - g0) * b
            if not (np.isfinite(v0) and np.isfinite(v1)):
                return np.nan, np.nan, 0
            lo = min(v0, v1)
            hi = max(v0, v1)
            if hi == lo:
                if least <= lo <= most:
                    length += b - a
            else:
                length += (b - a) * max(min(hi, most) - max(lo, least), 0.0) / (hi - lo)
                ends += int(lo < least <= hi) + int(lo <= most < hi)
        k += 1
    return total, length, ends


@njit(cache=True, nogil=True)
def pieces(grey, s0, ds, lower, upper, least, most):
    """Give integral and phase on each ray between ``lower`` and ``upper`` (rows, cols) in um.

    ``grey``: (rows, cols, samples), from ``s0`` in steps of ``ds``, um. Gives, each (rows, cols),
    grey times um, um of the phase with least <= grey <= most, and the number of its ends; 0 where
    upper lies below lower, NaN where unknown.
    """
    rows, cols, _ = grey.shape
    integral = np.empty((rows, cols))
    length = np.empty((rows, cols))
    ends = np.zeros((rows, cols), dtype=np.int32)
    for i in range(rows):
        for j in range(cols):
            x0 = (lower[i, j] - s0) / ds
            x1 = (upper[i, j] - s0) / ds
            total, part, n = _piece(grey[i, j], x0, x1, least, most)
            integral[i, j] = ds * total
            length[i, j] = ds * part
            ends[i, j] = n
    return integral, length, ends


@njit(cache=True, nogil=True)
def layers(grey, s0, ds, face, inward, level, polarity, reach, gap, limit):  # noqa: C901, PLR0912
    """Outermost connected layer of what lies beyond a grey level, from the face inwards.

    grey            : (rows, cols, samples)
    face            : (rows, cols), place of the face, um
    inward          : -1 from the top, +1 from the bottom
    level, polarity : the layer is where polarity (grey - level) > 0
    reach           : (rows, cols), um below the face within which the layer must begin
    gap             : um: a shorter gap does not end the layer
    limit           : (rows, cols), place on the ray at which the search ends, um

    Gives, each (rows, cols), summed length and distance from the face to the layer's inner end, um,
    0 where it does not begin (the blurred flank between the face and the first crossing counts as
    layer), and crossings inside the layer.
    """
    rows, cols, count = grey.shape
    summed = np.empty((rows, cols))
    envelope = np.empty((rows, cols))
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

    The phase, ``least`` <= grey <= ``most``, counts from ``face`` down to ``limit`` (rows, cols),
    um, which lies below; ``shares`` (n,), of its length, ascend. Gives the depths (n, rows, cols)
    in um, NaN where there is no such phase, and the length of the phase, (rows, cols) in um.
    """
    rows, cols, _ = grey.shape
    depth = np.full((shares.size, rows, cols), np.nan)
    total = np.empty((rows, cols))
    for i in range(rows):
        for j in range(cols):
            g = grey[i, j]
            x1 = (face[i, j] - s0) / ds
            x0 = (limit[i, j] - s0) / ds
            _, whole, _n = _piece(g, x0, x1, least, most)
            total[i, j] = whole * ds
            if not whole > 0:
                continue
            done = 0.0
            at = x1
            q = 0
            while q < shares.size and at > x0:
                below = max(np.ceil(at) - 1.0, x0)
                _, piece, _n = _piece(g, below, at, least, most)
                while q < shares.size and done + piece >= shares[q] * whole * (1 - 1e-12):
                    # Inside the piece by bisection: its length is monotone.
                    low, high = below, at
                    for _ in range(30):
                        middle = 0.5 * (low + high)
                        _, part, _n = _piece(g, middle, at, least, most)
                        if done + part >= shares[q] * whole * (1 - 1e-12):
                            low = middle
                        else:
                            high = middle
                    depth[q, i, j] = (x1 - low) * ds
                    q += 1
                done += piece
                at = below
    return depth, total
