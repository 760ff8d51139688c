"""Slow and obvious twins of the kernels: what the fast code is compared with."""

import numpy as np
from scipy import optimize, special
from scipy.interpolate import LinearNDInterpolator


def area_mean(values, factor, least=0.5):
    """Mean over cells, pixel by pixel, each pixel weighted with its overlap."""
    rows, cols = (int(n / f + 1e-9) for n, f in zip(values.shape, factor, strict=True))
    out = np.full((rows, cols), np.nan)
    for r in range(rows):
        for c in range(cols):
            total = weight = 0.0
            for i in range(values.shape[0]):
                for j in range(values.shape[1]):
                    h = min(i + 1, (r + 1) * factor[0]) - max(i, r * factor[0])
                    w = min(j + 1, (c + 1) * factor[1]) - max(j, c * factor[1])
                    if h > 0 and w > 0 and np.isfinite(values[i, j]):
                        total += h * w * values[i, j]
                        weight += h * w
            if weight >= least * factor[0] * factor[1] - 1e-9:
                out[r, c] = total / weight
    return out


def staircase(d, params, width, air, coated=True):
    """Blurred profile air-coating-base at the depths d."""
    h, t, c, b = params

    def step(x):
        return special.ndtr(x / width)

    if coated:
        return air + (c - air) * step(d - h) + (b - c) * step(d - h - t)
    return c + (b - c) * step(d - h)


def fit_staircase(g, start, width, air, noise, prior, spread, coated=True):
    """Least squares of the staircase with priors by scipy."""

    def residuals(p):
        model = staircase(np.arange(g.size), p, width, air, coated)
        ties = [(p[i] - prior[i]) / spread[i] for i in range(4) if spread[i] > 0]
        return np.concatenate([(g - model) / noise, ties])

    low = [-np.inf, 0.0, -np.inf, -np.inf]
    return optimize.least_squares(
        residuals, start, bounds=(low, np.inf), xtol=1e-12, ftol=1e-12, gtol=1e-12
    ).x


def twice_smoothed(height, pitch, cutoff, nodes):
    """Gaussian regression applied twice, at a few nodes: fit, then fit what is left and add it."""
    first = np.array(
        [
            [paraboloid_at(height, pitch, cutoff, i, j) for j in range(height.shape[1])]
            for i in range(height.shape[0])
        ]
    )
    return [first[i, j] + paraboloid_at(height - first, pitch, cutoff, i, j) for i, j in nodes]


def paraboloid_at(height, pitch, cutoff, row, col, gamma=0.887):
    """Gaussian regression of second order at one node, by weighted least squares over all nodes."""
    y, x = np.mgrid[0 : height.shape[0], 0 : height.shape[1]].astype(float)
    y, x = (y - row) * pitch[0], (x - col) * pitch[1]
    weight = np.exp(-np.pi * (x * x + y * y) / (gamma * cutoff) ** 2)
    known = np.isfinite(height)
    terms = np.stack([np.ones_like(x), y, x, y * y, y * x, x * x], axis=-1)[known]
    root = np.sqrt(weight[known])
    return np.linalg.lstsq(terms * root[:, None], height[known] * root, rcond=None)[0][0]


def distance_along_normal(surface, centre, normals, pitch, i, j):
    """Signed distance from one node to a surface along its normal, by root bracketing."""
    nr, nc, nh = (n[i, j] for n in normals)

    def gap(s):
        height = cubic_between(surface, i + s * nr / pitch[0], j + s * nc / pitch[1])
        return height.item() - (centre[i, j] + s * nh)

    return optimize.brentq(gap, 0.0, 40.0, xtol=1e-9)


def resample_delaunay(uv, field, points):
    """The mode of Hirn et al.

    (2009): triangulate the moved points anew, then linear within the triangles.
    """
    known = np.isfinite(uv).all(axis=-1) & np.isfinite(field)
    return LinearNDInterpolator(uv[known], field[known])(points)


def springs(points):
    """All springs of a grid as tuples (node, node, rest length), by loops."""
    rows, cols = points.shape[:2]
    out = []
    for i in range(rows):
        for j in range(cols):
            for di, dj in ((0, 1), (1, 0), (1, 1), (1, -1)):
                k, m = i + di, j + dj
                if (
                    0 <= k < rows
                    and 0 <= m < cols
                    and np.isfinite(points[i, j]).all()
                    and np.isfinite(points[k, m]).all()
                ):
                    out.append(((i, j), (k, m), float(np.linalg.norm(points[k, m] - points[i, j]))))
    return out


def relax(points):
    """Minimum spring energy by scipy's least squares, from the projection."""
    tied = springs(points)
    first = np.array([np.ravel_multi_index(a, points.shape[:2]) for a, _, _ in tied])
    second = np.array([np.ravel_multi_index(b, points.shape[:2]) for _, b, _ in tied])
    rest = np.array([length for _, _, length in tied])

    def stretch(flat):
        uv = flat.reshape(-1, 2)
        return np.linalg.norm(uv[second] - uv[first], axis=1) - rest

    start = points[..., :2].reshape(-1)
    found = optimize.least_squares(stretch, start, method="trf", xtol=1e-15, ftol=1e-15, gtol=1e-12)
    return found.x.reshape(*points.shape[:2], 2), float(2 * found.cost)


def keys(share):
    """Weights of four nodes in a row: Keys's formula (1981) in the distance, a = -1/2."""
    s = np.abs(share - np.array([-1.0, 0.0, 1.0, 2.0]))
    near = 1.5 * s**3 - 2.5 * s**2 + 1.0
    far = -0.5 * s**3 + 2.5 * s**2 - 4.0 * s + 2.0
    return np.where(s <= 1.0, near, far)


def cubic_between(values, row, col):
    """Value of an array (rows, cols, ...) between its nodes by cubic convolution, not below zero
    where none of the four by four around is; NaN where one is missing."""
    i, j = (min(int(place), n - 2) for place, n in zip((row, col), values.shape, strict=False))
    if min(i, j) < 1 or i > values.shape[0] - 3 or j > values.shape[1] - 3:
        return np.full(values.shape[2:], np.nan)
    around = values[i - 1 : i + 3, j - 1 : j + 3]
    if not np.isfinite(around).all():
        return np.full(values.shape[2:], np.nan)
    total = np.tensordot(np.outer(keys(row - i), keys(col - j)), around)
    return np.where((total < 0) & (around.min(axis=(0, 1)) >= 0), 0.0, total)


def cubic_on_quads(uv, field, place, index, point):
    """Value at a point that has a place (row, col) in a triangle of nodes ``index``: cubic
    convolution at that place, less the triangle's slope times the way from the point to where the
    convolution of the coordinates leads."""
    corners, values = (a[index[:, 0], index[:, 1]] for a in (uv, field))
    past = cubic_between(uv, *place) - point
    sides = np.linalg.solve((corners[1:] - corners[0]).T, past)
    if not np.abs(sides).max() <= 1.0:
        return np.nan
    return cubic_between(field, *place) - sides @ (values[1:] - values[0])


def resample_quads(uv, field, points):
    """Triangle by triangle of the quad mesh, all points at once: value, nearest node, and number of
    quads on each."""
    flat = points.reshape(-1, 2)
    rows, cols = uv.shape[:2]
    value, node, place = (
        np.full(len(flat), np.nan),
        np.full(len(flat), -1),
        np.full((len(flat), 2), np.nan),
    )
    quads = np.zeros(len(flat), dtype=int)
    for i in range(rows - 1):
        for j in range(cols - 1):
            if not np.isfinite(uv[i : i + 2, j : j + 2]).all():
                continue
            met = np.zeros(len(flat), dtype=bool)
            for triangle in (((0, 0), (0, 1), (1, 1)), ((0, 0), (1, 1), (1, 0))):
                index = np.array(triangle) + np.array([i, j])
                corners = uv[index[:, 0], index[:, 1]]
                system = np.vstack([corners.T, np.ones(3)])
                if abs(np.linalg.det(system)) < 1e-9:
                    continue
                weights = np.linalg.solve(system, np.column_stack([flat, np.ones(len(flat))]).T).T
                inside = (weights >= -1e-9).all(axis=1) & ~met
                met |= inside
                here = weights @ index
                # A point on a common edge has the same place in both quads and lies on one of them.
                quads += inside & ~(np.abs(here - place).max(axis=1) <= 1e-6)
                first = inside & np.isnan(place[:, 0])
                place[first] = here[first]
                used = np.where(np.abs(weights) > 1e-9, weights, 0.0)
                values = sum(
                    np.where(w != 0, w * field[k, m], 0.0)
                    for w, (k, m) in zip(used.T, index, strict=True)
                )
                value[first] = values[first]
                for k in np.flatnonzero(first):
                    cubic = cubic_on_quads(uv, field, here[k], index, flat[k])
                    if np.isfinite(cubic):
                        value[k] = cubic
                nearest = np.floor(here - (i, j) + 0.5).astype(int) + np.array([i, j])
                node[first] = (nearest[:, 0] * cols + nearest[:, 1])[first]
    return (a.reshape(points.shape[:-1]) for a in (value, node, quads))
