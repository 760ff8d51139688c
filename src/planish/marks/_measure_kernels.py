# pyright: standard
"""Round holes measured at places where they may be: numpy and numba only, arrays in, arrays out.

Images and ``sign`` as in `_edge_kernels`.
"""

import numpy as np

from planish.core.jit import njit
from planish.marks._edge_kernels import first_crossings, fit_outline, half_level_edges, innermost_edges, levels, waves
from planish.marks._rim_kernels import ENOUGH, OUTWARDS, closed_path, edge_worth, floor_middle, polar_rises, rim_radius

# Columns of the results.
X, Y, RADIUS, HALF_DIFFERENCE, COV_XX, COV_YY, COV_XY, COVERAGE, STEP, INSIDE = range(10)
OUTSIDE, TEXTURE, ROUGHNESS, FLATNESS, UNEVENNESS, FAR_STEP, LOW_WAVES, HIGH_WAVES, BURNT, ALIKE = range(10, 20)
DOUBT_X, DOUBT_Y = 20, 21
COLUMNS = 22

# Least step of another edge inside the rim, share of the whole step; sd of a centre where either of two closed edges
# may be the rim, share of what their centres are apart; the same for the floor's centre, which the wall moves less.
LEAST_INNER, EITHER, FLOOR = 0.06, 0.6, 1.3
# How far the middle of a floor usually is from that of its rim, as holes are tilted: share of the radius, and pixels.
# Less is usual where the step at the rim has a first wave above this share of the whole step, as uneven char makes it.
USUAL, EXACT, ONE_SIDED = (0.045, 0.3), (0.0105, 0.15), 0.1
# Another edge inside the strongest is the rim where this share of the rays has it, it is smaller by this share of the
# radius, and on this share of the rays the two are apart by this share of the radius: what lies between is char.
CLOSED, SMALLER, PART, APART = 0.9, 0.05, 0.25, 0.08
RAYS = 96
# Orders of an outline, and whether what was found is followed: written in the call, each would be a type of its own,
# and be compiled once more.
_ONE, _TWO, _STAY, _FOLLOW = np.int64(1), np.int64(2), np.bool_(False), np.bool_(True)


@njit(cache=True, nogil=True)
def measure(image, px, py, xs, ys, sign, low, high, least, contrast):
    """Measure a round hole at each candidate place.

    ``xs, ys`` (n,) in um; ``low, high`` the range of radii in um; a step below ``least`` (n,), or below ``contrast``
    (n,) times the texture around, is not measured. Returns ``(n, COLUMNS)``: centre, radius, half the difference of the
    half axes, covariance of the centre for waves of the rim of amplitude 1, share of the rim found, step at the
    rim, levels inside and outside times ``sign``, robust standard deviation of the sheet around, rms of the rim about
    the ellipse, rise of the floor towards the rim, unevenness of the floor, step over a wider distance, variances of
    the waves around the rim, long and short ones, and how far the sheet just outside the rim is from the sheet around
    (the last column is left to others). Lengths in um. NaN rows where there is no hole.
    """
    pixel = max(px, py)
    out = np.full((xs.size, COLUMNS), np.nan)
    dt, near = max(0.5 * pixel, 0.5), max(1.2 * pixel, 6.0)
    for h in range(xs.size):
        cx, cy, radius, scale = _circle(image, px, py, xs[h], ys[h], sign, low, high, least[h], contrast[h])
        if radius != radius:
            continue
        search = max(0.15 * radius, 2 * pixel, 10.0, min(3 * scale, 0.3 * radius))
        ok, x, y, fit, weight, inverse, radii, steps, far_steps, nears = _refined(
            image, px, py, cx, cy, sign, np.full(RAYS, radius), search, dt, 0.35, _STAY
        )
        if not ok or not (0.5 * low < fit[0] < 1.5 * high):
            continue
        # The strongest edge, but where another one goes round inside: then that around is the end of the char.
        cx, cy, model, inner, around = _closed_rims(image, px, py, cx, cy, sign, radius, low)
        closed = _refined(image, px, py, cx, cy, sign, model, near, dt, 0.35, _FOLLOW)
        if closed[0] and closed[3][0] > 0.5 * low and _is_inside(closed[1:5], closed[6], x, y, fit, radii):
            _, x, y, fit, weight, inverse, radii, steps, far_steps, nears = closed
        _describe(out[h], image, px, py, x, y, sign, radii, fit, weight, inverse)
        out[h, STEP], out[h, FAR_STEP] = np.nanmedian(steps), np.nanmedian(far_steps)
        out[h, BURNT] = out[h, OUTSIDE] - np.nanmedian(nears)
        _set_doubt(out[h], image, px, py, sign, x, y, steps)
        if around == 0.0:
            continue
        # Another closed edge inside: the rim of a hole with a scorched ring around, or that of the other face.
        ok, x2, y2, fit, weight, inverse, radii, _, _, _ = _refined(
            image, px, py, cx, cy, around * sign, inner, near, dt, LEAST_INNER, _FOLLOW
        )
        if ok and fit[0] > 0.5 * low and fit[0] < out[h, RADIUS] and np.sum(weight > 0) > 0.6 * RAYS:
            # Of two that rise either may be the rim; where the grey falls, char is darker than the hole.
            if around < 0.0:
                _outline(out[h], x2, y2, radii, fit, weight, inverse)
                x2, y2 = x, y
            _set_doubt(out[h], image, px, py, sign, x2, y2, steps)
    return out


@njit(cache=True, nogil=True)
def _is_inside(closed, closed_radii, x, y, fit, radii):
    """Return whether a closed outline lies inside another one, away from it on a good part of its rays."""
    x2, y2, fit2, weight2 = closed
    away = 0
    for k in range(RAYS):
        # As far as a shift of the centre goes, the two are compared on the same ray.
        angle = 2 * np.pi * k / RAYS
        shift = (x2 - x) * np.cos(angle) + (y2 - y) * np.sin(angle)
        away += radii[k] - (closed_radii[k] + shift) > APART * fit[0]
    return fit2[0] < (1 - SMALLER) * fit[0] and away > PART * RAYS and np.sum(weight2 > 0) > CLOSED * RAYS


@njit(cache=True, nogil=True)
def _refined(image, px, py, cx, cy, sign, model, search, dt, share, follow):
    """Return the outline at half level near a modelled one, with its centre, weights and steps; whether there is one.

    Steps below a ``share`` of the median are left out. With ``follow`` what was found is followed, so that a rough rim
    needs no wide search, in which lies another edge.
    """
    pixel = max(px, py)
    fit, weight, inverse = np.zeros(5), np.zeros(RAYS), np.zeros((5, 5))
    radii, steps, far_steps, nears = np.empty(RAYS), np.empty(RAYS), np.empty(RAYS), np.empty(RAYS)
    radius = np.mean(model)
    for _turn in range(3):
        radii, steps, far_steps, nears = half_level_edges(image, px, py, cx, cy, sign, model, search, dt, pixel)
        step = np.nanmedian(steps)
        for k in range(RAYS):
            if not (steps[k] >= share * step):
                radii[k] = np.nan
        fit, weight, scale, inverse = fit_outline(radii, _TWO, 0.3 + 0.1 * pixel)
        if np.sum(weight) == 0.0 or np.hypot(fit[1], fit[2]) > 0.5 * radius:
            return False, cx, cy, fit, weight, inverse, radii, steps, far_steps, nears
        cx, cy, radius = cx + fit[1], cy + fit[2], fit[0]
        if not follow:
            search = max(1.2 * pixel, 6.0, 4 * scale)
        model = np.empty(RAYS)
        for k in range(RAYS):
            angle = 2 * np.pi * k / RAYS
            model[k] = fit[0] + fit[3] * np.cos(2 * angle) + fit[4] * np.sin(2 * angle)
            if follow and weight[k] > 0.0:
                model[k] = radii[k] - fit[1] * np.cos(angle) - fit[2] * np.sin(angle)
    return True, cx, cy, fit, weight, inverse, radii, steps, far_steps, nears


@njit(cache=True, nogil=True)
def _closed_rims(image, px, py, cx, cy, sign, radius, low):
    """Return a centre, the radii of the closed rim about it, those of another one inside, and the sign of that.

    The sign is 1 where the other edge rises as the rim does, -1 where it falls, and 0 where there is none.
    """
    pixel = max(px, py)
    dt = max(0.5 * pixel, 2.5)
    reach = max(1, int(round(max(14.0, 1.4 * pixel) / dt)))
    inside, spread, _, outside, _ = levels(image, px, py, cx, cy, sign, radius, pixel)
    total = outside - inside
    x, y = floor_middle(image, px, py, cx, cy, sign, radius, inside, max(3 * spread, 0.1 * total))
    count = int((radius + np.hypot(x - cx, y - cy) + 0.3 * radius) / dt) + 2 * reach
    band = max(1, int(round(1.5 * pixel / dt)))
    first = max(reach, int(0.5 * low / dt))
    rises = polar_rises(image, px, py, x, y, sign, dt, count, reach, RAYS)
    # Not beyond the circle of the innermost strong edges: a hole that is half closed has char all the way round.
    last = min(count - reach, int(1.1 * radius / dt) + 1)
    at, half, _ = rim_radius(edge_worth(rises, ENOUGH * total), first, last, band, OUTWARDS * dt / radius)
    path = closed_path(edge_worth(rises, ENOUGH * total), max(0, at - half), at + half)
    model = path * dt
    weak = max(LEAST_INNER * total, 2.5 * spread)
    # A ring darker than what the hole shows: the rim is where the grey falls.
    last = int(np.min(path)) - reach
    if last > first:
        worth = edge_worth(-rises, weak)
        at, half, share = rim_radius(worth, first, last - band, band, 0.0)
        if share > 0.7:
            return x, y, model, closed_path(worth, max(0, at - half), min(at + half, last)) * dt, -1.0
    # Weaker edges inside, where there are any.
    worth = edge_worth(rises, weak)
    for k in range(RAYS):
        for t in range(count):
            worth[k, t] = worth[k, t] - OUTWARDS * dt * t / radius if t < path[k] + 2 else -np.inf
    within = closed_path(worth, min(first, int(np.min(path))), int(np.max(path)) + 1)
    inside_by = np.sum(path - within >= reach)
    return x, y, model, within * dt, 1.0 if inside_by > 0.1 * RAYS else 0.0


@njit(cache=True, nogil=True)
def _circle(image, px, py, cx, cy, sign, low, high, least, contrast):
    """Return centre, radius and scatter of the circle through the innermost strong edges; NaN if there is none."""
    pixel = max(px, py)
    window = max(14.0, 1.4 * pixel)
    radius, scale = np.nan, 0.0
    for turn in range(4):
        rays = 36 if turn == 0 else 64
        radii, _strong = innermost_edges(
            image, px, py, cx, cy, sign, 0.5 * low, 1.25 * high, max(0.7 * pixel, 2.5), window, rays
        )
        fit, weight, scale, _ = fit_outline(radii, _ONE, 0.5)
        strongly = 0.0
        for k in range(rays):
            strongly += weight[k] > 0.0
        radius = fit[0]
        if strongly < 0.5 * rays or scale > 0.3 * radius or not (0.6 * low < radius < 1.4 * high):
            return cx, cy, np.nan, scale
        shift = np.hypot(fit[1], fit[2])
        if shift > radius:
            return cx, cy, np.nan, scale
        cx, cy = cx + fit[1], cy + fit[2]
        if turn == 0:
            # Most places are mottle; the levels show it long before the rim is known.
            inside, spread, flatness, outside, texture = levels(image, px, py, cx, cy, sign, radius, pixel)
            total = outside - inside
            if total < max(least, contrast * texture) or spread > 0.35 * total or flatness > 0.4 * total:
                return cx, cy, np.nan, scale
        if turn > 0 and shift < 0.1 * pixel:
            break
    return cx, cy, radius, scale


@njit(cache=True, nogil=True)
def measure_floors(image, px, py, xs, ys, sign, radius, floor, depth, shares):
    """Measure the outline of a hole's floor about each place of `middles_of_floors`: where the grey leaves its level.

    What is printed over a rim may hide its edge, and never the floor. ``radius``, ``floor`` (times ``sign``) and
    ``depth`` are those of the image's other holes. Of the levels, ``shares`` of the step from the floor to the sheet,
    that with the roundest outline is taken. Returns ``(n, COLUMNS)`` as `measure` does, without steps at the rim.
    """
    pixel = max(px, py)
    dt = max(0.25 * pixel, 0.5)
    out = np.full((xs.size, COLUMNS), np.nan)
    row = np.empty(COLUMNS)
    for h in range(xs.size):
        x, y = xs[h], ys[h]
        best = np.inf
        model = np.empty(RAYS)
        for share in shares:
            cx, cy = x, y
            fit, weight, inverse, radii = (np.zeros(5), np.zeros(RAYS), np.zeros((5, 5)), np.empty(RAYS))
            found = True
            for turn in range(6):
                radii = first_crossings(image, px, py, cx, cy, sign, floor + share * depth, 1.6 * radius, dt, RAYS)
                fit, weight, _, inverse = fit_outline(radii, _ONE if turn < 2 else _TWO, 0.3 + 0.1 * pixel)
                cx, cy = cx + fit[1], cy + fit[2]
                if np.sum(weight) == 0.0 or np.hypot(cx - x, cy - y) > 0.6 * radius:
                    found = False
                    break
                if turn > 2 and np.hypot(fit[1], fit[2]) < 0.05 * pixel:
                    break
            if found:
                _describe(row, image, px, py, cx, cy, sign, radii, fit, weight, inverse)
                # About the circle, not the ellipse: a blot beside a hole makes an ellipse of both.
                wave = 0.5 * row[HALF_DIFFERENCE] * row[HALF_DIFFERENCE]
                poor = np.sqrt(row[ROUGHNESS] ** 2 + wave) / row[RADIUS] - row[COVERAGE]
                if poor < best:
                    best = poor
                    out[h] = row
                    for k in range(RAYS):
                        angle = 4 * np.pi * k / RAYS
                        model[k] = fit[0] + fit[3] * np.cos(angle) + fit[4] * np.sin(angle)
        if best < np.inf:
            search = max(1.2 * pixel, 6.0)
            _, steps, _, nears = half_level_edges(
                image, px, py, out[h, X], out[h, Y], sign, model, search, max(0.5 * pixel, 0.5), pixel
            )
            out[h, BURNT] = out[h, OUTSIDE] - np.nanmedian(nears)
            _set_doubt(out[h], image, px, py, sign, out[h, X], out[h, Y], steps)
    return out


@njit(cache=True, nogil=True)
def middles_of_floors(image, px, py, xs, ys, sign, radius, level):
    """Return centroids (n, 2) of what is below a level within a radius, followed until they rest; NaN if too little."""
    out = np.full((xs.size, 2), np.nan)
    for h in range(xs.size):
        x, y = xs[h], ys[h]
        for _turn in range(6):
            total, tx, ty = 0, 0.0, 0.0
            i0, i1 = (max(int((y - radius) / py) + 1, 0), min(int((y + radius) / py) + 1, image.shape[0]))
            j0, j1 = (max(int((x - radius) / px) + 1, 0), min(int((x + radius) / px) + 1, image.shape[1]))
            for i in range(i0, i1):
                for j in range(j0, j1):
                    if sign * image[i, j] < level and np.hypot(j * px - x, i * py - y) <= radius:
                        total += 1
                        tx += j * px
                        ty += i * py
            # A hole fills a third of the circle even where the place is poor, or its wall is wide.
            if 3 * total * px * py < np.pi * radius * radius:
                x, y = np.nan, np.nan
                break
            shift = np.hypot(tx / total - x, ty / total - y)
            x, y = tx / total, ty / total
            if shift < 0.2 * max(px, py):
                break
        out[h] = x, y
    return out


@njit(cache=True, nogil=True)
def _describe(row, image, px, py, cx, cy, sign, radii, fit, weight, inverse):
    """Write the figures of a fitted outline into a row; steps at the rim are left out."""
    pixel = max(px, py)
    inside, spread, flatness, outside, texture = levels(image, px, py, cx, cy, sign, fit[0], pixel)
    row[:] = np.nan
    _outline(row, cx, cy, radii, fit, weight, inverse)
    row[INSIDE], row[OUTSIDE], row[TEXTURE] = inside, outside, texture
    row[FLATNESS], row[UNEVENNESS] = flatness, spread


@njit(cache=True, nogil=True)
def _set_doubt(row, image, px, py, sign, x, y, steps):
    """Write what another edge may move the centre by: towards the middle of the floor, or of an outline at ``x, y``.

    The floor lies in the middle of a hole, unless a part of what is around was taken for the hole; so it may be where
    the rim's step is another on one side.
    """
    total = row[OUTSIDE] - row[INSIDE]
    tolerance = max(3 * row[UNEVENNESS], LEAST_INNER * total)
    fx, fy = floor_middle(image, px, py, row[X], row[Y], sign, row[RADIUS], row[INSIDE], tolerance)
    apart = np.hypot(fx - row[X], fy - row[Y])
    a, b, used = 0.0, 0.0, 0
    for k in range(RAYS):
        if steps[k] == steps[k]:
            a += steps[k] * np.cos(2 * np.pi * k / RAYS)
            b += steps[k] * np.sin(2 * np.pi * k / RAYS)
            used += 1
    share, pixels = EXACT if 2 * np.hypot(a, b) > ONE_SIDED * max(used, 1) * total else USUAL
    usual = (share * row[RADIUS]) ** 2 + (pixels * max(px, py)) ** 2
    beyond = FLOOR * np.sqrt(max(apart**2 - usual, 0.0))
    other = EITHER * np.hypot(x - row[X], y - row[Y])
    if other > beyond:
        row[DOUBT_X], row[DOUBT_Y] = EITHER * (x - row[X]), EITHER * (y - row[Y])
    else:
        share = beyond / max(apart, 1e-30)
        row[DOUBT_X], row[DOUBT_Y] = share * (fx - row[X]), share * (fy - row[Y])


@njit(cache=True, nogil=True)
def _outline(row, cx, cy, radii, fit, weight, inverse):
    # Share of the rim that is there; and how rough it is.
    error = np.zeros(RAYS)
    used, squares = 0, 0.0
    for k in range(RAYS):
        if weight[k] > 0.0:
            angle = 2 * np.pi * k / RAYS
            first = fit[0] + fit[1] * np.cos(angle) + fit[2] * np.sin(angle)
            error[k] = radii[k] - (first + fit[3] * np.cos(2 * angle) + fit[4] * np.sin(2 * angle))
            squares += error[k] ** 2
            used += 1
    row[X], row[Y], row[RADIUS], row[HALF_DIFFERENCE] = (cx, cy, fit[0], np.hypot(fit[3], fit[4]))
    # Waves 3 and 4, and 5 to 8 of the rim. The first moves the centre; its size can only be estimated from them.
    row[LOW_WAVES], row[HIGH_WAVES] = waves(error, weight)
    # As if the rays were independent; the waves' own variance is put in once all holes are known.
    variance = RAYS / 2
    row[COV_XX], row[COV_YY] = variance * inverse[1, 1], variance * inverse[2, 2]
    row[COV_XY] = variance * inverse[1, 2]
    row[COVERAGE], row[ROUGHNESS] = used / RAYS, np.sqrt(squares / max(1, used))
