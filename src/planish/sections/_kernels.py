# pyright: standard
"""Compiled inner loops of the section stage: the straightened band, pairs of bands, and resampling.

Places in a section are in pixels (row, col), pixel i has its centre at i. The pose of a section is
``(row, col, row per col, col per row)``: what belongs at (r, c) is found at

    (r + pose[0] + pose[2] (c - middle), c + pose[1] - pose[3] (r - middle)).
"""

from math import floor

import numpy as np

from planish.core.jit import njit

_SETTINGS = {"nogil": True, "cache": True, "error_model": "numpy"}
# Sums may be taken in any order, so that they run several at a time; NaN stays NaN.
_SUMS = {**_SETTINGS, "fastmath": {"contract", "nsz", "reassoc"}}


@njit(**_SETTINGS)
def straighten(section, height, first, rows, cols, pose, out):
    """Sample the band along the sheet: out[k, b] is the mean over rows x cols samples.

    NaN outside the section.

    height[c] is the row of the sheet in column c; the first sample lies ``first`` pixels from it.
    ``out`` has to come filled with zeros.
    """
    high, wide = section.shape
    middle_r, middle_c = 0.5 * (high - 1), 0.5 * (wide - 1)
    share = np.float32(1.0 / (rows * cols))
    for k in range(out.shape[0]):
        for s in range(k * rows, (k + 1) * rows):
            for b in range(out.shape[1]):
                total = np.float32(0.0)
                for c in range(b * cols, (b + 1) * cols):
                    r = height[c] + first + s
                    y = r + pose[0] + pose[2] * (c - middle_c)
                    x = c + pose[1] - pose[3] * (r - middle_r)
                    i = int(floor(y))
                    j = int(floor(x))
                    if i < 0 or j < 0 or i >= high - 1 or j >= wide - 1:
                        total = np.float32(np.nan)
                    else:
                        p = np.float32(y - i)
                        q = np.float32(x - j)
                        a0 = np.float32(section[i, j])
                        a1 = np.float32(section[i, j + 1])
                        b0 = np.float32(section[i + 1, j])
                        b1 = np.float32(section[i + 1, j + 1])
                        low = a0 + q * (a1 - a0)
                        total += low + p * (b0 + q * (b1 - b0) - low)
                out[k, b] += share * total


@njit(**_SUMS)
def smooth(values, down, across, line, out):
    """Weight every value with its neighbours.

    ``values`` and ``out`` (rows, cols). ``down`` acts along the rows' axis, ``across`` along the
    other, both an odd number of weights; both are clamped at the borders. ``line`` is scratch for a
    row with its margins.
    """
    rows, cols = values.shape
    far, wide = down.size // 2, across.size // 2
    for k in range(rows):
        padded = line[: cols + 2 * wide]
        padded[:] = 0.0
        for n in range(down.size):
            source = values[min(max(k + n - far, 0), rows - 1)]
            weight = down[n]
            for c in range(cols):
                padded[wide + c] += weight * source[c]
        for c in range(wide):
            padded[c] = padded[wide]
            padded[wide + cols + c] = padded[wide + cols - 1]
        target = out[k]
        target[:] = 0.0
        for n in range(across.size):
            weight = across[n]
            for c in range(cols):
                target[c] += weight * padded[c + n]


@njit(**_SUMS)
def pair_sums(a, b, x, y, pitch, chunks, limit, trust, sums, shared=0.0):
    """Set sums[chunk] to what the displacement of band b against band a follows from.

    With the gradient g = (row, col, turn) of the mean of both bands and the difference d = b - a,
    the fifteen numbers are the upper triangle of the sum of g g' (6), the sum of g d (3), the sum
    of d d, that of the squares of both around 0.5, all weighted with trust[row] and Tukey's (1 - (d
    / limit[row])^2)^2, 0 where |d| >= limit; then the sum of the weights, and that of trust over
    all samples without NaN. Two more are the row and column entries of the first six once more,
    weighted with the derivative of d Tukey(d) in place of Tukey's weight: what a displacement
    changes the sum of g d by, the change of the weights with it.

    With ``shared`` 1 the first six are instead the sums of g_a g_b', made symmetric: noise, which
    the bands do not share, enlarges g g' and so shortens the displacement, but cancels here.

    x[c] is the place of the column and y[c] that of the sheet's height there, from the middle of
    the section; both and the samples' distances, pitch (row, col), in um.
    """
    rows, cols = a.shape
    half_r = np.float32(0.25 / pitch[0])
    half_c = np.float32(0.25 / pitch[1])
    sums[:] = 0.0
    zero = np.float32(0.0)
    one = np.float32(1.0)
    less = np.float32(shared)
    four = np.float32(4.0)
    five = np.float32(5.0)
    for k in range(1, rows - 1):
        a0, a1, a2 = a[k - 1], a[k], a[k + 1]
        b0, b1, b2 = b[k - 1], b[k], b[k + 1]
        steep = np.float32(1.0 / (limit[k] * limit[k]))
        heavy = np.float32(trust[k])
        off = np.float32((k - 0.5 * (rows - 1)) * pitch[0])
        for chunk in range(chunks):
            s0 = s1 = s2 = s3 = s4 = s5 = t0 = t1 = t2 = dd = ss = used = held = n0 = n1 = zero
            for c in range(
                max(1, cols * chunk // chunks), min(cols - 1, cols * (chunk + 1) // chunks)
            ):
                d = b1[c] - a1[c]
                a_down = a2[c] - a0[c]
                b_down = b2[c] - b0[c]
                a_across = a1[c + 1] - a1[c - 1]
                b_across = b1[c + 1] - b1[c - 1]
                gr = half_r * (a_down + b_down)
                gc = half_c * (a_across + b_across)
                gt = gr * x[c] - gc * (y[c] + off)
                # Half the difference of the gradients: g_a g_b' + g_b g_a' = 2 (g g' - h h').
                hr = half_r * (b_down - a_down)
                hc = half_c * (b_across - a_across)
                ht = hr * x[c] - hc * (y[c] + off)
                sound = d + gr + gc
                w = one if sound == sound else zero
                held += heavy * w
                far = one - steep * d * d
                tilt = heavy * far * (five * far - four) if (w > zero and far > zero) else zero
                w = heavy * far * far if (w > zero and far > zero) else zero
                d = d if w > zero else zero
                gr = gr if w > zero else zero
                gc = gc if w > zero else zero
                gt = gt if w > zero else zero
                hr = hr if w > zero else zero
                hc = hc if w > zero else zero
                ht = ht if w > zero else zero
                v = less * w
                va = a1[c] - np.float32(0.5) if w > zero else zero
                vb = b1[c] - np.float32(0.5) if w > zero else zero
                used += w
                n0 += tilt * (gr * gr - less * hr * hr)
                n1 += tilt * (gc * gc - less * hc * hc)
                s0 += w * gr * gr - v * hr * hr
                s1 += w * gr * gc - v * hr * hc
                s2 += w * gr * gt - v * hr * ht
                s3 += w * gc * gc - v * hc * hc
                s4 += w * gc * gt - v * hc * ht
                s5 += w * gt * gt - v * ht * ht
                t0 += w * gr * d
                t1 += w * gc * d
                t2 += w * gt * d
                dd += w * d * d
                ss += w * (va * va + vb * vb)
            found = sums[chunk]
            values = (s0, s1, s2, s3, s4, s5, t0, t1, t2, dd, ss, used, held, n0, n1)
            for n in range(15):
                found[n] += values[n]


@njit(**_SETTINGS)
def _clamped(value, last):
    """Return the pixel below a place and the share of the next one.

    Places outside are taken to the border.
    """
    value = min(max(value, 0.0), float(last))
    i = min(int(value), max(last - 1, 0))
    return i, np.float32(value - i)


@njit(**_SETTINGS)
def _line(section, r, pose, grade, line):
    """Set line to row r of a corrected section.

    It is found where the pose says, and its grey is made gain x value + offset, ``grade`` being
    both. Bilinear between pixels; places outside take the border.
    """
    high, wide = section.shape
    middle_r, middle_c = 0.5 * (high - 1), 0.5 * (wide - 1)
    gain = np.float32(grade[0])
    offset = np.float32(grade[1])
    shift = pose[1] - pose[3] * (r - middle_r)
    step = int(floor(shift))
    q = np.float32(shift - step)
    y0 = r + pose[0] - pose[2] * middle_c
    # Columns whose neighbours both lie inside; the few others are clamped one by one.
    begin = min(max(0, -step), wide)
    end = max(begin, min(wide, wide - 1 - step))
    # A turn is small: the row changes seldom along the columns, and in between the inner loop has
    # nothing to decide.
    c = begin
    while c < end:
        y = y0 + pose[2] * c
        i, _ = _clamped(y, high - 1)
        stop = end
        if y < 0.0 or y > high - 1:
            stop = c + 1
        elif pose[2] > 0.0:
            stop = min(end, max(c + 1, int((i + 1 - y0) / pose[2])))
        elif pose[2] < 0.0:
            stop = min(end, max(c + 1, int((i - y0) / pose[2])))
        start = np.float32(min(max(y, 0.0), float(high - 1)) - i)
        slope = np.float32(pose[2])
        low = section[i]
        up = section[min(i + 1, high - 1)]
        for n in range(c, stop):
            a0 = np.float32(low[n + step])
            a1 = np.float32(low[n + step + 1])
            b0 = np.float32(up[n + step])
            b1 = np.float32(up[n + step + 1])
            v = a0 + q * (a1 - a0)
            line[n] = v + (start + slope * np.float32(n - c)) * (b0 + q * (b1 - b0) - v)
        c = stop
    for c in range(wide):
        if c < begin or c >= end:
            i, p = _clamped(y0 + pose[2] * c, high - 1)
            j, f = _clamped(c + shift, wide - 1)
            k = min(i + 1, high - 1)
            n = min(j + 1, wide - 1)
            a0 = np.float32(section[i, j])
            a1 = np.float32(section[i, n])
            b0 = np.float32(section[k, j])
            b1 = np.float32(section[k, n])
            v = a0 + f * (a1 - a0)
            line[c] = v + p * (b0 + f * (b1 - b0) - v)
    if gain != 1.0 or offset != 0.0:
        for c in range(wide):
            line[c] = gain * line[c] + offset


@njit(**_SETTINGS)
def interpolate(first, second, share, poses, grades, low, high, is_integer, out):
    """Set out to (1 - share) first + share second, both corrected.

    ``poses`` (2, 4) and ``grades`` (2, 2) are of both sections. Integers are rounded and kept in
    low..high.
    """
    cols = out.shape[1]
    first_line = np.empty(cols, np.float32)
    second_line = np.empty(cols, np.float32)
    t = np.float32(share)
    for r in range(out.shape[0]):
        if share < 1.0:
            _line(first, r, poses[0], grades[0], first_line)
        if share > 0.0:
            _line(second, r, poses[1], grades[1], second_line)
        if share <= 0.0:
            line = first_line
        elif share >= 1.0:
            line = second_line
        else:
            for c in range(cols):
                first_line[c] += t * (second_line[c] - first_line[c])
            line = first_line
        target = out[r]
        if is_integer:
            for c in range(cols):
                target[c] = floor(min(max(line[c], low), high) + np.float32(0.5))
        else:
            for c in range(cols):
                target[c] = line[c]
