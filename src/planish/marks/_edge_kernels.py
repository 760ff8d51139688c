# pyright: standard
"""Edges and grey levels along the rays of a round hole, and the outline fitted to them.

Numpy and numba only, arrays in, arrays out. Images are float32 ``(y, x)`` with NaN where there is
no data; the centre of pixel ``(i, j)`` is ``(j * px, i * py)`` um. ``sign`` is +1 for holes darker
than the sheet, -1 for lighter ones.
"""

import numpy as np

from planish.core.jit import njit


@njit(cache=True, nogil=True)
def sample(image, x, y):
    """Bilinear value at column ``x`` and row ``y``.

    NaN outside the pixel centres or beside missing data.
    """
    rows, columns = image.shape
    if x < 0.0 or y < 0.0 or x > columns - 1 or y > rows - 1:
        return np.nan
    j = min(int(x), columns - 2)
    i = min(int(y), rows - 2)
    u = x - j
    v = y - i
    upper = image[i, j] * (1 - u) + image[i, j + 1] * u
    lower = image[i + 1, j] * (1 - u) + image[i + 1, j + 1] * u
    return upper * (1 - v) + lower * v


@njit(cache=True, nogil=True)
def along(image, start, step, t):
    """Bilinear value at ``t`` steps from a start, both of columns and rows."""
    return sample(image, start[0] + step[0] * t, start[1] + step[1] * t)


@njit(cache=True, nogil=True)
def ray(k, rays, step, px, py):
    """Give the columns and rows of the image that a step along ray ``k`` of so many takes."""
    angle = 2 * np.pi * k / rays
    return np.cos(angle) * step / px, np.sin(angle) * step / py


@njit(cache=True, nogil=True)
def rise(sums, t, reach):
    """Give the sum of the samples after ``t``, as far as it reaches, less that of those before.

    Sample ``t`` sits on the edge and counts for neither side. ``sums`` are running sums from 0 on.
    """
    return sums[t + reach + 1] - sums[t + 1] - sums[t] + sums[t - reach]


@njit(cache=True, nogil=True)
def innermost_edges(image, px, py, sign, cx, cy, low, high, dt, window, rays):  # noqa: C901, PLR0912
    """Return the radius of the innermost strong edge on each ray (NaN where there is none).

    The mean of the grey over ``window`` um beyond a radius is compared with that before it, at
    radii from ``low`` to ``high`` um in steps of ``dt``. Strong is what rises by half of the usual
    highest rise of a ray, which is returned as well; it is 0 where fewer than half of the rays lie
    in the image.
    """
    count = int((high + window) / dt) + 2
    reach = max(1, int(round(window / dt)))
    first = max(reach, int(low / dt))
    rises = np.full((rays, count), np.nan)
    peaks = np.empty(rays)
    valid = 0
    sums = np.empty(count + 1)
    radii = np.full(rays, np.nan)
    centre = cx / px, cy / py
    for k in range(rays):
        step = ray(k, rays, dt, px, py)
        sums[0] = 0.0
        last = count
        for t in range(count):
            value = along(image, centre, step, t)
            if value != value:
                last = t
                break
            sums[t + 1] = sums[t] + sign * value
        peak = -np.inf
        for t in range(first, last - reach):
            rises[k, t] = rise(sums, t, reach) / reach
            peak = max(peak, rises[k, t])
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
            if rises[k, t] >= strong:
                top = t
                for s in range(t + 1, min(count - reach, t + 2 * reach + 1)):
                    if rises[k, s] > rises[k, top]:
                        top = s
                    elif rises[k, s] < 0.8 * rises[k, top]:
                        break
                radii[k] = top * dt
                break
    return radii, strong


@njit(cache=True, nogil=True)
def _level(image, centre, step, start, stop, dt):
    """Mean along a ray between two radii; NaN if a sample is missing."""
    count = max(1, int(round((stop - start) / dt)) + 1)
    total = 0.0
    for s in range(count):
        t = start + (stop - start) * s / max(1, count - 1)
        total += along(image, centre, step, t)
    return total / count


@njit(cache=True, nogil=True)
def _plateaus(image, centre, step, edge, gap, width, dt):
    """Mean levels inside and outside an edge, ``gap`` away from it and over a ``width``."""
    start = max(0.0, edge - gap - width)
    inner = _level(image, centre, step, start, max(0.0, edge - gap), dt)
    return inner, _level(image, centre, step, edge + gap, edge + gap + width, dt)


@njit(cache=True, nogil=True)
def half_level_edges(image, px, py, sign, cx, cy, model, search):  # noqa: C901, PLR0912
    """Give half-level radius, step, wider step and level outside of each ray, or NaN.

    They lie within ``search`` of the model.

    ``model`` (n,) and ``search`` are in um, as the radii are. Levels and steps are those of the
    plateaus on both sides of the edge; the wider step leaves more of the edge out. The half level
    is half way between the two.
    """
    rays = model.shape[0]
    radii = np.full(rays, np.nan)
    steps = np.full(rays, np.nan)
    far_steps = np.full(rays, np.nan)
    nears = np.full(rays, np.nan)
    pixel = max(px, py)
    dt = max(0.5 * pixel, 0.5)
    gap = max(4.0, 0.9 * pixel)  # from the edge to where the plateaus begin
    # Over which a plateau is averaged; well under the width of the char.
    width = max(7.0, 0.8 * pixel)
    reach = max(1, int(round(max(5.0, pixel) / dt)))
    centre = cx / px, cy / py
    for k in range(rays):
        step = ray(k, rays, 1.0, px, py)
        start = max(0.0, model[k] - search - reach * dt)
        # A model that bends to the other side of its centre has no edge there.
        count = max(0, int((model[k] + search + reach * dt - start) / dt) + 2)
        values = np.empty(count)
        sums = np.zeros(count + 1)
        rises = np.zeros(count)
        for t in range(count):
            r = start + t * dt
            values[t] = sign * along(image, centre, step, r)
            sums[t + 1] = sums[t] + values[t]
        if not np.isfinite(sums[count]):
            continue
        best = -np.inf
        top = -1
        for t in range(reach, count - reach):
            rises[t] = rise(sums, t, reach)
            best = max(best, rises[t])
        if best <= 0.0:
            continue
        # Narrow char lies within the window: the first strong edge is the hole's, even if the
        # char's own is stronger. The edge of the tapered wall at the other face is weaker than two
        # thirds.
        for t in range(reach, count - reach):
            if rises[t] >= 0.65 * best:
                top = t
                while top + 1 < count - reach and rises[top + 1] >= rises[top]:
                    top += 1
                break
        edge = start + top * dt
        inner, outer = _plateaus(image, centre, step, edge, gap, width, dt)
        inner = sign * inner
        outer = sign * outer
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
            nears[k] = outer
            far_gap = 18.0 + 0.5 * pixel
            inner, outer = _plateaus(image, centre, step, edge, far_gap, width, dt)
            far_steps[k] = sign * (outer - inner)
    return radii, steps, far_steps, nears


@njit(cache=True, nogil=True)
def first_crossings(image, px, py, sign, cx, cy, level, reach, dt, rays):
    """Return the radius where the grey first rises through a level on each ray.

    NaN where it does not.

    ``level`` is a grey times ``sign``; ``reach`` and ``dt`` are the farthest radius and the step
    along a ray, in um.
    """
    radii = np.full(rays, np.nan)
    count = int(reach / dt) + 1
    for k in range(rays):
        sx, sy = ray(k, rays, 1.0, px, py)
        before = sign * sample(image, cx / px, cy / py)
        for t in range(1, count):
            after = sign * sample(image, cx / px + sx * t * dt, cy / py + sy * t * dt)
            if after != after:
                break
            if before < level <= after:
                radii[k] = (t - 1 + (level - before) / (after - before)) * dt
                break
            before = after
    return radii


@njit(cache=True, nogil=True)
def levels(image, px, py, sign, cx, cy, radius):
    """Give inside level, its spread, flatness, outside level and texture around a fitted circle.

    ``radius`` in um; levels are greys times ``sign``. Inside is the median of the core, its spread
    a robust standard deviation, flatness the rise from the middle to near the wall; outside and
    texture are median and robust standard deviation beyond the char, NaN where little of it is in
    the image.
    """
    rays = 32
    rings = 8
    pixel = max(px, py)
    core = np.empty(rays * rings)
    wall = np.empty(rays)
    outside = np.empty(rays * rings)
    centre = cx / px, cy / py
    for k in range(rays):
        step = ray(k + 0.5, rays, 1.0, px, py)
        for s in range(rings):
            # Equal areas: radii go with the square root.
            r = 0.65 * radius * np.sqrt((s + 0.5) / rings)
            core[k * rings + s] = sign * along(image, centre, step, r)
            r = radius + 45.0 + pixel + (0.7 * radius) * (s + 0.5) / rings
            outside[k * rings + s] = sign * along(image, centre, step, r)
        r = min(0.75 * radius, radius - 1.2 * pixel)
        wall[k] = sign * along(image, centre, step, r)
    inside = np.nanmedian(core)
    spread = 1.4826 * np.nanmedian(np.abs(core - inside))
    around = outside[np.isfinite(outside)]
    if around.size < rays * rings // 3:
        return inside, spread, np.nan, np.nan, np.nan
    level = np.median(around)
    texture = 1.4826 * np.median(np.abs(around - level))
    total = 0.0
    count = 0
    for k in range(rays):
        for s in range(rings // 4):
            value = core[k * rings + s]
            if value == value:
                total += value
                count += 1
    middle = total / count if count else np.nan
    return inside, spread, np.nanmedian(wall) - middle, level, texture


@njit(cache=True, nogil=True)
def fit_outline(radii, order, least_scale):  # noqa: C901, PLR0912
    """Fit ``r0 + a cos + b sin (+ c cos 2 + d sin 2)`` to radii at equal angles.

    The fit uses Tukey weights.

    NaN radii are left out. Returns coefficients ``(2 order + 1,)``, weights ``(n,)``, the robust
    scale, and the inverse normal matrix. All weights are zero if fewer than a third of the radii
    are there.
    """
    n = radii.shape[0]
    terms = 2 * order + 1
    weight = np.zeros(n)
    error = np.empty(n)
    coefficients = np.zeros(terms)
    inverse = np.zeros((terms, terms))
    if 3 * np.sum(np.isfinite(radii)) < n:
        return coefficients, weight, np.inf, inverse
    basis = np.ones((n, terms))
    for k in range(n):
        for o in range(1, order + 1):
            basis[k, 2 * o - 1] = np.cos(o * (2 * np.pi * k / n))
            basis[k, 2 * o] = np.sin(o * (2 * np.pi * k / n))
    coefficients[0] = np.nanmedian(radii)
    scale = 0.0
    for turn in range(8):
        for k in range(n):
            model = 0.0
            for c in range(terms):
                model += coefficients[c] * basis[k, c]
            error[k] = radii[k] - model
        scale = max(1.4826 * np.nanmedian(np.abs(error)), least_scale)
        # Normal matrix, right side and unit matrix.
        system = np.zeros((terms, 2 * terms + 1))
        total = 0.0
        for k in range(n):
            u = error[k] / (4.685 * scale)
            weight[k] = (1 - u * u) ** 2 if abs(u) < 1.0 else 0.0
            if weight[k] > 0.0:
                total += weight[k]
                for c in range(terms):
                    system[c, terms] += weight[k] * basis[k, c] * radii[k]
                    for e in range(terms):
                        system[c, e] += weight[k] * basis[k, c] * basis[k, e]
        if total < 0.2 * n:
            weight[:] = 0.0
            return coefficients, weight, np.inf, inverse
        # Gauss and Jordan without a search for pivots: with so much weight the matrix is positive
        # definite.
        for c in range(terms):
            system[c, terms + 1 + c] = 1.0
        for c in range(terms):
            for r in range(terms):
                f = system[r, c] / system[c, c]
                if r != c:
                    for k in range(c, 2 * terms + 1):
                        system[r, k] -= f * system[c, k]
        change = abs(system[0, terms] / system[0, 0] - coefficients[0])
        for c in range(terms):
            coefficients[c] = system[c, terms] / system[c, c]
            for e in range(terms):
                inverse[c, e] = system[c, terms + 1 + e] / system[c, c]
        if turn > 1 and change < 1e-4 * scale:
            break
    return coefficients, weight, scale, inverse


@njit(cache=True, nogil=True)
def waves(error, weight):
    """Variances of one amplitude of waves of ``error`` where ``weight`` is not 0: third and fourth.

    Fifth to eighth.

    ``error`` (n,) holds what a fit leaves on rays at equal angles, in um.
    """
    rays = error.shape[0]
    low = 0.0
    high = 0.0
    for order in range(3, 9):
        a = 0.0
        b = 0.0
        n = 0
        for k in range(rays):
            if weight[k] > 0.0:
                angle = 2 * np.pi * order * k / rays
                a += error[k] * np.cos(angle)
                b += error[k] * np.sin(angle)
                n += 1
        # Missing rays take as much from the sum as from the variance of a rough rim.
        power = 0.5 * (a * a + b * b) * 4 / (max(n, 1) * rays)
        if order < 5:
            low += power / 2
        else:
            high += power / 4
    return low, high
