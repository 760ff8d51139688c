# pyright: standard
"""Area means and radial edges of round holes: numpy and numba only, arrays in, arrays out.

Images are float32 ``(y, x)`` with NaN where there is no data; pixel ``(i, j)`` has its centre at
``(j * px, i * py)`` um. ``sign`` is +1 for holes darker than the sheet, -1 for brighter ones.
"""

from __future__ import annotations

import numpy as np
from numba import njit

# Columns of the result of `measure`.
X, Y, RADIUS, HALF_DIFFERENCE, COV_XX, COV_YY, COV_XY, COVERAGE, STEP, INSIDE, OUTSIDE, TEXTURE, ROUGHNESS, FLATNESS = (
    range(14)
)
UNEVENNESS, FAR_STEP, LOW_WAVES, HIGH_WAVES, STANDING = range(14, 19)
COLUMNS = 19

RAYS = 96


@njit(cache=True)
def area_mean(image, fy, fx):
    """Return means over blocks of ``fy x fx`` pixels, float32; NaN where less than half a block has data."""
    rows, columns = image.shape[0] // fy, image.shape[1] // fx
    out = np.empty((rows, columns), np.float32)
    for i in range(rows):
        for j in range(columns):
            total, count = 0.0, 0
            for k in range(i * fy, (i + 1) * fy):
                for m in range(j * fx, (j + 1) * fx):
                    value = image[k, m]
                    if value == value:
                        total += value
                        count += 1
            out[i, j] = total / count if 2 * count >= fy * fx else np.nan
    return out


@njit(cache=True, nogil=True)
def block_sums(image, fy, fx):
    """Return the share of every block that has data, and the sum of its values over its size; float32.

    The last blocks may reach beyond the image; what lies there has no data.
    """
    rows, columns = image.shape
    share = np.zeros((-(-rows // fy), -(-columns // fx)), np.float32)
    values = np.zeros(share.shape)
    for i in range(rows):
        for j in range(columns):
            value = image[i, j]
            if value == value:
                share[i // fy, j // fx] += 1
                values[i // fy, j // fx] += value
    return share / np.float32(fy * fx), (values / (fy * fx)).astype(np.float32)


@njit(cache=True, nogil=True)
def stretched(means, rows, columns, fy, fx):
    """Return values of blocks at every pixel, linear between the middles of the blocks; float32."""
    out = np.empty((rows, columns), np.float32)
    low, high, part = np.empty(columns, np.int64), np.empty(columns, np.int64), np.empty(columns, np.float32)
    for j in range(columns):
        place = min(max((j + 0.5) / fx - 0.5, 0.0), means.shape[1] - 1.0)
        low[j] = min(int(place), max(0, means.shape[1] - 2))
        high[j] = min(low[j] + 1, means.shape[1] - 1)
        part[j] = place - low[j]
    for i in range(rows):
        place = min(max((i + 0.5) / fy - 0.5, 0.0), means.shape[0] - 1.0)
        k = min(int(place), max(0, means.shape[0] - 2))
        below = np.float32(place - k)
        line = means[k] * (1 - below) + means[min(k + 1, means.shape[0] - 1)] * below
        for j in range(columns):
            out[i, j] = line[low[j]] + (line[high[j]] - line[low[j]]) * part[j]
    return out


@njit(cache=True, nogil=True)
def gaussian(image, sy, sx):
    """Return the Gaussian mean of a float32 image without gaps; ``sy, sx`` in pixels; the border's values run on."""
    rows, columns = image.shape
    out = np.empty((rows, columns), np.float32)
    ry, rx = max(1, int(3.0 * sy + 0.5)), max(1, int(3.0 * sx + 0.5))
    wy, wx = np.empty(2 * ry + 1), np.empty(2 * rx + 1)
    for k in range(2 * ry + 1):
        wy[k] = np.exp(-0.5 * ((k - ry) / max(sy, 1e-6)) ** 2)
    for k in range(2 * rx + 1):
        wx[k] = np.exp(-0.5 * ((k - rx) / max(sx, 1e-6)) ** 2)
    down, along = (wy / wy.sum()).astype(np.float32), (wx / wx.sum()).astype(np.float32)
    # A row is summed over its neighbours in a buffer that stays in the cache, then along itself.
    wide = np.empty(columns + 2 * rx, np.float32)
    line = np.empty(columns, np.float32)
    for i in range(rows):
        line[:] = down[ry] * image[i]
        for k in range(1, ry + 1):
            above, below, w = image[max(i - k, 0)], image[min(i + k, rows - 1)], down[ry + k]
            for j in range(columns):
                line[j] += w * (above[j] + below[j])
        wide[:rx] = line[0]
        wide[rx : rx + columns] = line
        wide[rx + columns :] = line[columns - 1]
        mean = out[i]
        w = along[rx]
        for j in range(columns):
            mean[j] = w * line[j]
        for k in range(1, rx + 1):
            left, right, w = wide[rx - k :], wide[rx + k :], along[rx + k]
            for j in range(columns):
                mean[j] += w * (left[j] + right[j])
    return out


@njit(cache=True, nogil=True)
def tops(values, sign, least, ry, rx):
    """Return rows ``(row, column, value)`` of what is largest, times sign, within ``+-ry, +-rx`` pixels."""
    rows, columns = values.shape
    found = []
    for i in range(rows):
        for j in range(columns):
            value = sign * values[i, j]
            if not value > least:
                continue
            if j + 1 < columns and sign * values[i, j + 1] > value:
                continue
            top = True
            for k in range(max(i - ry, 0), min(i + ry + 1, rows)):
                for m in range(max(j - rx, 0), min(j + rx + 1, columns)):
                    if sign * values[k, m] > value:
                        top = False
                        break
                if not top:
                    break
            if top:
                found.append((i, j, value))
    out = np.empty((len(found), 3))
    for n in range(len(found)):
        out[n, 0], out[n, 1], out[n, 2] = found[n][0], found[n][1], found[n][2]
    return out


@njit(cache=True)
def _sample(image, x, y):
    """Bilinear value at column ``x`` and row ``y``; NaN outside the pixel centres or beside missing data."""
    rows, columns = image.shape
    if x < 0.0 or y < 0.0 or x > columns - 1 or y > rows - 1:
        return np.nan
    j, i = min(int(x), columns - 2), min(int(y), rows - 2)
    u, v = x - j, y - i
    return (image[i, j] * (1 - u) + image[i, j + 1] * u) * (1 - v) + (
        image[i + 1, j] * (1 - u) + image[i + 1, j + 1] * u
    ) * v


@njit(cache=True)
def _solve(matrix, right):
    """Solve a small symmetric positive system by Gauss elimination; returns zeros where it is singular."""
    n = matrix.shape[0]
    a = np.empty((n, n + right.shape[1]))
    a[:, :n] = matrix
    a[:, n:] = right
    for c in range(n):
        best = c
        for r in range(c + 1, n):
            if abs(a[r, c]) > abs(a[best, c]):
                best = r
        if abs(a[best, c]) < 1e-12:
            return np.zeros(right.shape)
        if best != c:
            for k in range(a.shape[1]):
                a[c, k], a[best, k] = a[best, k], a[c, k]
        for r in range(n):
            if r != c:
                f = a[r, c] / a[c, c]
                for k in range(c, a.shape[1]):
                    a[r, k] -= f * a[c, k]
    out = np.empty(right.shape)
    for c in range(n):
        for k in range(right.shape[1]):
            out[c, k] = a[c, n + k] / a[c, c]
    return out


@njit(cache=True)
def fit_outline(radii, order, least_scale):
    """Fit ``r0 + a cos + b sin (+ c cos 2 + d sin 2)`` to radii at equal angles, with Tukey weights.

    NaN radii are left out. Returns coefficients ``(2 order + 1,)``, weights ``(n,)``, the robust scale, and the inverse
    normal matrix. All weights are zero if fewer than a third of the radii are there.
    """
    n, terms = radii.shape[0], 2 * order + 1
    weight = np.zeros(n)
    coefficients = np.zeros(terms)
    inverse = np.zeros((terms, terms))
    there = 0
    for k in range(n):
        if radii[k] == radii[k]:
            there += 1
    if 3 * there < n:
        return coefficients, weight, np.inf, inverse
    values = np.empty(there)
    there = 0
    for k in range(n):
        if radii[k] == radii[k]:
            values[there] = radii[k]
            there += 1
    basis = np.empty((n, terms))
    for k in range(n):
        angle = 2 * np.pi * k / n
        basis[k, 0] = 1.0
        for o in range(1, order + 1):
            basis[k, 2 * o - 1] = np.cos(o * angle)
            basis[k, 2 * o] = np.sin(o * angle)
    coefficients[0] = np.median(values)
    scale = 0.0
    errors = np.empty(there)
    for turn in range(8):
        there = 0
        for k in range(n):
            if radii[k] == radii[k]:
                model = 0.0
                for c in range(terms):
                    model += coefficients[c] * basis[k, c]
                errors[there] = abs(radii[k] - model)
                there += 1
        scale = max(1.4826 * np.median(errors), least_scale)
        matrix = np.zeros((terms, terms))
        right = np.zeros((terms, 1 + terms))
        total = 0.0
        for k in range(n):
            weight[k] = 0.0
            if radii[k] == radii[k]:
                model = 0.0
                for c in range(terms):
                    model += coefficients[c] * basis[k, c]
                u = (radii[k] - model) / (4.685 * scale)
                if abs(u) < 1.0:
                    weight[k] = (1 - u * u) ** 2
                    total += weight[k]
                    for c in range(terms):
                        right[c, 0] += weight[k] * basis[k, c] * radii[k]
                        for e in range(terms):
                            matrix[c, e] += weight[k] * basis[k, c] * basis[k, e]
        if total < 0.2 * n:
            weight[:] = 0.0
            return coefficients, weight, np.inf, inverse
        for c in range(terms):
            right[c, 1 + c] = 1.0
        solution = _solve(matrix, right)
        change = abs(solution[0, 0] - coefficients[0])
        for c in range(terms):
            coefficients[c] = solution[c, 0]
            for e in range(terms):
                inverse[c, e] = solution[c, 1 + e]
        if turn > 1 and change < 1e-4 * scale:
            break
    return coefficients, weight, scale, inverse


@njit(cache=True)
def _innermost_edges(image, px, py, cx, cy, sign, low, high, dt, window, rays):
    """Return the radius of the innermost strong edge on each ray (NaN where there is none)."""
    count = int((high + window) / dt) + 2
    reach = max(1, int(round(window / dt)))
    first = max(reach, int(low / dt))
    rises = np.full((rays, count), np.nan)
    peaks = np.empty(rays)
    valid = 0
    sums = np.empty(count + 1)
    radii = np.full(rays, np.nan)
    for k in range(rays):
        angle = 2 * np.pi * k / rays
        sx, sy = np.cos(angle) * dt / px, np.sin(angle) * dt / py
        sums[0] = 0.0
        last = count
        for t in range(count):
            value = _sample(image, cx / px + sx * t, cy / py + sy * t)
            if value != value:
                last = t
                break
            sums[t + 1] = sums[t] + sign * value
        peak = -np.inf
        for t in range(first, last - reach):
            # Sample t sits on the edge and counts for neither side.
            rise = (sums[t + reach + 1] - sums[t + 1] - sums[t] + sums[t - reach]) / reach
            rises[k, t] = rise
            peak = max(peak, rise)
        if peak > -np.inf and last >= min(count, int(0.6 * count)):
            peaks[valid] = peak
            valid += 1
    if 2 * valid < rays:
        return radii, 0.0
    strong = 0.5 * np.median(peaks[:valid])
    if strong <= 0.0:
        return radii, 0.0
    for k in range(rays):
        for t in range(first, count - reach):
            rise = rises[k, t]
            if rise >= strong:
                # Climb to the top of this edge.
                top = t
                for s in range(t + 1, min(count - reach, t + 2 * reach + 1)):
                    if rises[k, s] > rises[k, top]:
                        top = s
                    elif rises[k, s] < 0.8 * rises[k, top]:
                        break
                radii[k] = top * dt
                break
    return radii, strong


@njit(cache=True)
def _level(image, x, y, sx, sy, start, stop, dt):
    """Mean along a ray between two radii; NaN if a sample is missing."""
    count = max(1, int(round((stop - start) / dt)) + 1)
    total = 0.0
    for s in range(count):
        t = start + (stop - start) * s / max(1, count - 1)
        total += _sample(image, x + sx * t, y + sy * t)
    return total / count


@njit(cache=True)
def _half_level_edges(image, px, py, cx, cy, sign, model, search, dt, pixel):
    """Return the half-level radius and the step on each ray, within ``search`` of the modelled radii."""
    rays = model.shape[0]
    radii, steps, far_steps = np.full(rays, np.nan), np.full(rays, np.nan), np.full(rays, np.nan)
    gap = max(4.0, 0.9 * pixel)  # from the edge to where the plateaus begin
    width = max(7.0, 0.8 * pixel)  # over which a plateau is averaged; well under the width of the char
    reach = max(1, int(round(max(5.0, pixel) / dt)))
    for k in range(rays):
        angle = 2 * np.pi * k / rays
        x0, y0 = cx / px, cy / py
        sx, sy = np.cos(angle) / px, np.sin(angle) / py
        start = max(0.0, model[k] - search - reach * dt)
        count = int((model[k] + search + reach * dt - start) / dt) + 2
        values = np.empty(count)
        sums = np.zeros(count + 1)
        rises = np.zeros(count)
        for t in range(count):
            r = start + t * dt
            values[t] = sign * _sample(image, x0 + sx * r, y0 + sy * r)
            sums[t + 1] = sums[t] + values[t]
        if not np.isfinite(sums[count]):
            continue
        best, top = -np.inf, -1
        for t in range(reach, count - reach):
            rises[t] = sums[t + reach + 1] - sums[t + 1] - sums[t] + sums[t - reach]
            best = max(best, rises[t])
        if best <= 0.0:
            continue
        # Narrow char lies within the window: the first strong edge is the hole's, even if the char's own is stronger.
        # The edge of the tapered wall at the other face is weaker than two thirds.
        for t in range(reach, count - reach):
            if rises[t] >= 0.65 * best:
                top = t
                while top + 1 < count - reach and rises[top + 1] >= rises[top]:
                    top += 1
                break
        edge = start + top * dt
        inner = sign * _level(image, x0, y0, sx, sy, max(0.0, edge - gap - width), max(0.0, edge - gap), dt)
        outer = sign * _level(image, x0, y0, sx, sy, edge + gap, edge + gap + width, dt)
        if not (outer > inner):
            continue
        half = 0.5 * (inner + outer)
        # The crossing nearest to the steepest place, on a profile smoothed over three samples.
        nearest = np.nan
        for t in range(1, count - 2):
            before = (values[t - 1] + 2 * values[t] + values[t + 1]) / 4
            after = (values[t] + 2 * values[t + 1] + values[t + 2]) / 4
            if before < half <= after:
                r = start + (t + (half - before) / (after - before)) * dt
                if not (abs(r - edge) >= abs(nearest - edge)):
                    nearest = r
        if abs(nearest - edge) <= 1.5 * gap:
            radii[k] = nearest
            steps[k] = outer - inner
            wide = 18.0 + 0.5 * pixel
            far_steps[k] = sign * (
                _level(image, x0, y0, sx, sy, edge + wide, edge + wide + width, dt)
                - _level(image, x0, y0, sx, sy, max(0.0, edge - wide - width), max(0.0, edge - wide), dt)
            )
    return radii, steps, far_steps


@njit(cache=True)
def _levels(image, px, py, cx, cy, sign, radius, pixel):
    """Return inside level, its spread, flatness, outside level and texture around a fitted circle."""
    rays, rings = 32, 8
    core, wall = np.empty(rays * rings), np.empty(rays)
    outside = np.empty(rays * rings)
    for k in range(rays):
        angle = 2 * np.pi * (k + 0.5) / rays
        sx, sy = np.cos(angle) / px, np.sin(angle) / py
        for s in range(rings):
            # Equal areas: radii go with the square root.
            r = 0.65 * radius * np.sqrt((s + 0.5) / rings)
            core[k * rings + s] = sign * _sample(image, cx / px + sx * r, cy / py + sy * r)
            r = radius + 45.0 + pixel + (0.7 * radius) * (s + 0.5) / rings
            outside[k * rings + s] = sign * _sample(image, cx / px + sx * r, cy / py + sy * r)
        r = min(0.75 * radius, radius - 1.2 * pixel)
        wall[k] = sign * _sample(image, cx / px + sx * r, cy / py + sy * r)
    inside = np.nanmedian(core)
    spread = 1.4826 * np.nanmedian(np.abs(core - inside))
    around = outside[np.isfinite(outside)]
    if around.size < rays * rings // 3:
        return inside, spread, np.nan, np.nan, np.nan
    level = np.median(around)
    texture = 1.4826 * np.median(np.abs(around - level))
    total, count = 0.0, 0
    for k in range(rays):
        for s in range(rings // 4):
            value = core[k * rings + s]
            if value == value:
                total += value
                count += 1
    centre = total / count if count else np.nan
    return inside, spread, np.nanmedian(wall) - centre, level, texture


@njit(cache=True)
def measure(image, px, py, xs, ys, sign, low, high, least, contrast):
    """Measure a round hole at each candidate place.

    ``xs, ys`` (n,) in um; ``low, high`` the range of radii in um; a step below ``least``, or below ``contrast`` times
    the texture around, is not looked at closely. Returns ``(n, COLUMNS)``: centre, radius, half the difference between
    the half axes, covariance of the centre for waves of the rim of amplitude 1, share of the rim found, step at the
    rim, levels inside and outside times ``sign``, robust standard deviation of the sheet around, rms of the rim about
    the ellipse, rise of the floor towards the rim, unevenness of the floor, step over a wider distance, and variances
    of the waves around the rim, long and short ones (the last column is left to others). Lengths in um. NaN rows where
    there is no hole.
    """
    pixel = max(px, py)
    out = np.full((xs.size, COLUMNS), np.nan)
    window = max(14.0, 1.4 * pixel)
    for h in range(xs.size):
        cx, cy = xs[h], ys[h]
        found = True
        radius = 0.0
        scale = 0.0
        for turn in range(4):
            rays = 36 if turn == 0 else 64
            radii, _strong = _innermost_edges(
                image, px, py, cx, cy, sign, 0.5 * low, 1.25 * high, max(0.7 * pixel, 2.5), window, rays
            )
            fit, weight, scale, _ = fit_outline(radii, 1, 0.5)
            strongly = 0.0
            for k in range(rays):
                strongly += weight[k] > 0.0
            radius = fit[0]
            if strongly < 0.5 * rays or scale > 0.3 * radius or not (0.6 * low < radius < 1.4 * high):
                found = False
                break
            shift = np.hypot(fit[1], fit[2])
            if shift > radius:
                found = False
                break
            cx, cy = cx + fit[1], cy + fit[2]
            if turn == 0:
                # Most places are mottle; a look at the levels tells, long before the rim is known.
                inside, spread, flatness, outside, texture = _levels(image, px, py, cx, cy, sign, radius, pixel)
                total = outside - inside
                if total < max(least, contrast * texture) or spread > 0.35 * total or flatness > 0.4 * total:
                    found = False
                    break
            if turn > 0 and shift < 0.1 * pixel:
                break
        if not found:
            continue
        model = np.full(RAYS, radius)
        search = max(0.15 * radius, 2 * pixel, 10.0, min(3 * scale, 0.3 * radius))
        dt = max(0.5 * pixel, 0.5)
        radii, steps, far_steps = np.empty(RAYS), np.empty(RAYS), np.empty(RAYS)
        fit, weight = np.zeros(5), np.zeros(RAYS)
        inverse = np.zeros((5, 5))
        for _turn in range(3):
            radii, steps, far_steps = _half_level_edges(image, px, py, cx, cy, sign, model, search, dt, pixel)
            step = np.nanmedian(steps)
            for k in range(RAYS):
                if not (steps[k] >= 0.35 * step):
                    radii[k] = np.nan
            fit, weight, scale, inverse = fit_outline(radii, 2, 0.3 + 0.1 * pixel)
            if np.sum(weight) == 0.0 or np.hypot(fit[1], fit[2]) > 0.5 * radius:
                found = False
                break
            cx, cy, radius = cx + fit[1], cy + fit[2], fit[0]
            for k in range(RAYS):
                angle = 4 * np.pi * k / RAYS
                model[k] = fit[0] + fit[3] * np.cos(angle) + fit[4] * np.sin(angle)
            search = max(1.2 * pixel, 6.0, 4 * scale)
        if not found or not (0.5 * low < radius < 1.5 * high):
            continue
        step = np.nanmedian(steps)
        # Share of the rim that is there; and how rough it is.
        error = np.zeros(RAYS)
        used, squares = 0, 0.0
        for k in range(RAYS):
            if weight[k] > 0.0:
                angle = 2 * np.pi * k / RAYS
                error[k] = radii[k] - (model[k] + fit[1] * np.cos(angle) + fit[2] * np.sin(angle))
                squares += error[k] ** 2
                used += 1
        # Waves around the rim, variance of one amplitude: 3 and 4 to the round, 5 to 8. The first wave is what moves
        # the centre, and its size can only be told from them.
        low_waves, high_waves = 0.0, 0.0
        for order in range(3, 9):
            a, b, n = 0.0, 0.0, 0
            for k in range(RAYS):
                if weight[k] > 0.0:
                    angle = 2 * np.pi * order * k / RAYS
                    a += error[k] * np.cos(angle)
                    b += error[k] * np.sin(angle)
                    n += 1
            # Missing rays take as much from the sum as from the variance of a rough rim.
            power = 0.5 * (a * a + b * b) * 4 / (max(n, 1) * RAYS)
            if order < 5:
                low_waves += power / 2
            else:
                high_waves += power / 4
        # As if the rays were independent; the waves' own variance is put in once all holes are known.
        variance = RAYS / 2
        inside, spread, flatness, outside, texture = _levels(image, px, py, cx, cy, sign, radius, pixel)
        out[h, X], out[h, Y], out[h, RADIUS] = cx, cy, radius
        out[h, HALF_DIFFERENCE] = np.hypot(fit[3], fit[4])
        out[h, LOW_WAVES], out[h, HIGH_WAVES] = low_waves, high_waves
        out[h, COV_XX] = variance * inverse[1, 1]
        out[h, COV_YY] = variance * inverse[2, 2]
        out[h, COV_XY] = variance * inverse[1, 2]
        out[h, COVERAGE] = used / RAYS
        out[h, STEP], out[h, INSIDE], out[h, OUTSIDE], out[h, TEXTURE] = step, inside, outside, texture
        out[h, ROUGHNESS] = np.sqrt(squares / max(1, used))
        out[h, FLATNESS] = flatness
        out[h, UNEVENNESS] = spread
        out[h, FAR_STEP] = np.nanmedian(far_steps)
    return out
