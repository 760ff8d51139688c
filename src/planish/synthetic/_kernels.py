# pyright: standard
"""Compiled inner loops of the synthetic specimen: the warp and its inverse, voxels, fibres.

A warp travels as one flat array ``w`` and one table ``curve`` (see
:meth:`planish.synthetic.params.Warp.packed`): ``w = [cos a, sin a, psi, k, phase, p0, dp, x0, y0,
z0, bump, bump_u, bump_v, bump_r, tilt, curl, curl_p, curl_width]``; ``curve[i] = (X, Z, X', Z')``
of the profile curve at arc length ``p0 + i * dp``.
"""

from math import cos, exp, floor, sin, sqrt, tanh

import numpy as np

from planish.core.jit import njit

_MAX_STEPS = 25
_SINGLE = 9  # fields of a node that are not layers of the base
_CLOSE_UM = 1e-3  # the step after it is smaller by the curvature times the distance, a twentieth


@njit(cache=True, nogil=True)
def _hermite(curve, i, k, f, h):
    """Cubic Hermite between exact values and exact tangents: error below 1e-8 um at 2 um steps.

    Column ``k`` of the curve, whose tangents are column ``k + 2``, a share ``f`` of a step ``h``
    beyond row ``i``.
    """
    a = curve[i]
    b = curve[i + 1]
    h00 = (1 + 2 * f) * (1 - f) * (1 - f)
    h10 = f * (1 - f) * (1 - f)
    h01 = f * f * (3 - 2 * f)
    h11 = f * f * (f - 1)
    return h00 * a[k] + h10 * h * a[k + 2] + h01 * b[k] + h11 * h * b[k + 2]


@njit(cache=True, nogil=True)
def _normal(ux, uy, uz, vx, vy, vz):
    """Normal to two tangents, and its length."""
    nx = uy * vz - uz * vy
    ny = uz * vx - ux * vz
    nz = ux * vy - uy * vx
    return nx, ny, nz, sqrt(nx * nx + ny * ny + nz * nz)


@njit(cache=True, nogil=True)
def frame_at(w, curve, u, v):
    """Return m (3), m_u (3), m_v (3) of the centre surface at (u, v), as nine scalars.

    Along the profile lies p, along the rulings q; (X, Z) of the profile at p is turned by the angle
    a about z, and the bump is added to z. The tangents are exact.
    """
    ca = w[0]
    sa = w[1]
    p = u * ca + v * sa
    q = -u * sa + v * ca
    h = w[6]
    t = (p - w[5]) / h
    i = int(floor(t))
    i = min(max(i, 0), curve.shape[0] - 2)
    big_x = _hermite(curve, i, 0, t - i, h)
    big_z = _hermite(curve, i, 1, t - i, h)
    psi = w[14] + w[2] * sin(w[3] * p + w[4])
    if w[15] != 0.0:
        past_curl = (p - w[16]) / (2.0 * w[17])
        psi += 0.5 * w[15] * (1.0 + tanh(past_curl))
    c = cos(psi)
    s = sin(psi)
    du = u - w[11]
    dv = v - w[12]
    bump = 0.0
    if w[10] != 0.0:
        exponent = -(du * du + dv * dv) / (2 * w[13] * w[13])
        bump = w[10] * exp(exponent)
    bu = -bump * du / (w[13] * w[13])
    bv = -bump * dv / (w[13] * w[13])
    return (
        big_x * ca - q * sa + w[7],
        big_x * sa + q * ca + w[8],
        big_z + w[9] + bump,
        ca * c * ca + sa * sa,
        sa * c * ca - ca * sa,
        s * ca + bu,
        ca * c * sa - sa * ca,
        sa * c * sa + ca * ca,
        s * sa + bv,
    )


@njit(cache=True, nogil=True)
def invert(w, curve, x, y, z, u, v):
    """Return (u, v, s) with m(u, v) + s n(u, v) = (x, y, z), from the guess (u, v).

    By Gauss and Newton's steps in the tangent plane: what is left of the point there is brought to
    0, and its distance along the normal n is s.
    """
    s = 0.0
    for _ in range(_MAX_STEPS):
        mx, my, mz, ux, uy, uz, vx, vy, vz = frame_at(w, curve, u, v)
        dx = x - mx
        dy = y - my
        dz = z - mz
        g11 = ux * ux + uy * uy + uz * uz
        g12 = ux * vx + uy * vy + uz * vz
        g22 = vx * vx + vy * vy + vz * vz
        r1 = dx * ux + dy * uy + dz * uz
        r2 = dx * vx + dy * vy + dz * vz
        det = g11 * g22 - g12 * g12
        du = (g22 * r1 - g12 * r2) / det
        dv = (g11 * r2 - g12 * r1) / det
        u += du
        v += dv
        nx, ny, nz, n = _normal(ux, uy, uz, vx, vy, vz)
        s = (dx * nx + dy * ny + dz * nz) / n
        if abs(du) + abs(dv) < _CLOSE_UM:
            break
    return u, v, s


@njit(cache=True, nogil=True)
def frames(w, curve, u, v):
    """Centre surface points (n, 3) and unit normals (n, 3) at the coordinates u, v (n,)."""
    points = np.empty((u.size, 3))
    normals = np.empty((u.size, 3))
    for i in range(u.size):
        mx, my, mz, ux, uy, uz, vx, vy, vz = frame_at(w, curve, u[i], v[i])
        nx, ny, nz, n = _normal(ux, uy, uz, vx, vy, vz)
        points[i] = mx, my, mz
        normals[i] = nx / n, ny / n, nz / n
    return points, normals


@njit(cache=True, nogil=True)
def materials(w, curve, points):
    """Material coordinates (n, 3) as (u, v, s) of the points in space (n, 3) as (x, y, z)."""
    out = np.empty((points.shape[0], 3))
    for i in range(points.shape[0]):
        x, y, z = points[i]
        out[i] = invert(w, curve, x, y, z, x - w[7], y - w[8])
    return out


@njit(cache=True, nogil=True)
def columns(w, curve, ys, xs):
    """Ground truth (rows, cols, 3) as (u, v, z) below each column at (ys[i], xs[j]).

    The point of the centre surface with these x and y, by Newton's steps, and its height z.
    """
    out = np.empty((ys.size, xs.size, 3))
    for i in range(ys.size):
        for j in range(xs.size):
            # The guess does not come from a neighbour: a column gives the same bytes whatever tile
            # it lies in.
            u = xs[j] - w[7]
            v = ys[i] - w[8]
            for _ in range(_MAX_STEPS):
                mx, my, _mz, ux, uy, _uz, vx, vy, _vz = frame_at(w, curve, u, v)
                dx = xs[j] - mx
                dy = ys[i] - my
                det = ux * vy - uy * vx
                du = (vy * dx - vx * dy) / det
                dv = (ux * dy - uy * dx) / det
                u += du
                v += dv
                if abs(du) + abs(dv) < _CLOSE_UM:
                    break
            out[i, j] = u, v, frame_at(w, curve, u, v)[2]
    return out


@njit(cache=True, nogil=True)
def paint(
    slab,
    w,
    curve,
    ys,
    xs,
    first,
    step,
    moved,
    middle,
    under,
    half_um,
    fields,
    origin,
    pitch,
    grey,
    structure,
    structure_low,
    cell,
    film,
):
    """Fill slab (rows, cols, depth) with what the unblurred sheet adds to the grey of air.

    Around the sheet, nothing is added.

    With ``z = (first + k) * step``, x', z' counted from ``middle`` (x, z), and ``moved`` (3, rows)
    = (shift_x, shift_z, turn), the voxel (i, j, k) shows the point
    ``(xs[j] + shift_x[i] - turn[i] * z', ys[i], z + shift_z[i] + turn[i] * x')``.
    ``fields`` (fr, fc, n): s_T, s_TI, s_BI, s_B, the distances to the rim at both faces, the
    coating's burn and
    density, the width of a crack over the top face (below the bottom one where negative), then the
    density of a slab
    through its depth; ``origin`` (u, v) of their first node; ``under`` (rows, cols, 3): material
    below each column, a
    first guess; ``grey`` of base, coating and crack, less that of air.
    Each boundary is averaged over ``step`` along the normal, the width of a voxel. ``structure``
    (fr, fc, cells), where
    it has cells, is the density of the base instead, in hundredths, from ``structure_low`` um on in
    cells of ``cell``;
    below ``film`` um it has no holes.
    """
    has_cells = structure.shape[2] > 0
    structure_high = structure_low + cell * structure.shape[2] if has_cells else -1e9
    depth_voxels = slab.shape[2]
    last_row = fields.shape[0] - 1.000001
    last_col = fields.shape[1] - 1.000001
    layers = fields.shape[2] - _SINGLE
    at = np.empty(_SINGLE)
    for i in range(ys.size):
        shift_x = moved[0, i]
        shift_z = moved[1, i]
        turn = moved[2, i]
        for j in range(xs.size):
            lift = shift_z + turn * (xs[j] - middle[0])
            u, v, z_below = under[i, j]
            zc = z_below - lift
            k0 = max(int(floor((zc - half_um) / step)) - first, 0)
            k1 = min(int(floor((zc + half_um) / step)) + 1 - first, depth_voxels - 1)
            du, dv, ddu, ddv = 0.0, 0.0, 0.0, 0.0
            for k in range(k0, k1 + 1):
                z = (first + k) * step
                x = xs[j] + shift_x - turn * (z - middle[1])
                # Up a column the material moves by nearly the same step again and again: one
                # correction is enough.
                u0, v0, du0, dv0 = u, v, du, dv
                u, v, s = invert(w, curve, x, ys[i], z + lift, u + du + ddu, v + dv + ddv)
                du, dv = (u - u0, v - v0) if k > k0 else (0.0, 0.0)
                ddu, ddv = (du - du0, dv - dv0) if k > k0 + 1 else (0.0, 0.0)
                fx = min(max((u - origin[0]) / pitch, 0.0), last_col)
                fy = min(max((v - origin[1]) / pitch, 0.0), last_row)
                c = int(fx)
                r = int(fy)
                fx -= c
                fy -= r
                top = _bilinear(fields, r, c, fy, fx, 0)
                low = _bilinear(fields, r, c, fy, fx, 3)
                crack = _bilinear(fields, r, c, fy, fx, 8)
                high = max(top + max(crack, 0.0), structure_high)
                deepest = min(low, structure_low) if has_cells else low
                if s > high + step or s < deepest + min(crack, 0.0) - step:
                    continue
                for n in range(_SINGLE):
                    at[n] = _bilinear(fields, r, c, fy, fx, n)
                inner_top = at[1]
                inner_low = at[2]
                through = min(max((top - s) / max(top - low, 1e-6), 0.0), 1.0)
                rim = at[4] * (1 - through) + at[5] * through
                solid = _ramp(rim / step)
                in_sheet = _ramp((top - s) / step) * _ramp((s - low) / step)
                in_base = _ramp((inner_top - s) / step) * _ramp((s - inner_low) / step)
                outside = s - top if crack > 0.0 else low - s
                in_crack = 0.0
                if crack != 0.0:
                    in_crack = _ramp(outside / step) * _ramp((abs(crack) - outside) / step)
                coat_share = max(in_sheet - in_base, 0.0)
                coat = coat_share * grey[1] * (at[6] * at[7])
                if has_cells:
                    fibre = 0.0
                    if coat_share < 1.0:
                        height = (s - structure_low) / cell
                        half = 0.5 * step / cell
                        low_cell = height - half
                        high_cell = height + half
                        density = _cells_between(structure, r, c, fy, fx, low_cell, high_cell)
                        fibre = (1.0 - coat_share) * density
                    value = fibre * grey[0] + coat + in_crack * grey[2]
                    if s >= film:  # a film has no holes
                        value *= solid
                    slab[i, j, k] = value
                    continue
                relative_depth = (s - inner_low) / max(inner_top - inner_low, 1e-6)
                depth = min(max(relative_depth, 0.0), 1.0) * (layers - 1)
                layer = min(int(depth), layers - 2)
                f = depth - layer
                under_it = _bilinear(fields, r, c, fy, fx, _SINGLE + layer)
                above_it = _bilinear(fields, r, c, fy, fx, _SINGLE + 1 + layer)
                density = under_it * (1 - f) + above_it * f
                value = in_base * grey[0] * density + coat
                slab[i, j, k] = (value + in_crack * grey[2]) * solid


@njit(cache=True, nogil=True)
def _bilinear(fields, r, c, fy, fx, n):
    """Field n of (rows, cols, fields) at shares fy, fx of a pitch beyond the node (r, c)."""
    top = fields[r, c, n] * (1 - fx) + fields[r, c + 1, n] * fx
    low = fields[r + 1, c, n] * (1 - fx) + fields[r + 1, c + 1, n] * fx
    return top * (1 - fy) + low * fy


@njit(cache=True, nogil=True)
def _cells_between(cells, r, c, fy, fx, low, high):
    """Mean density, 1 of wall, between two heights in cells, over the place of ``_bilinear``."""
    first = max(int(floor(low)), 0)
    last = min(int(floor(high)), cells.shape[2] - 1)
    density_sum = 0.0
    for k in range(first, last + 1):
        overlap = min(high, k + 1.0) - max(low, float(k))
        density_sum += _bilinear(cells, r, c, fy, fx, k) * overlap
    return 0.01 * density_sum / (high - low)


@njit(cache=True, nogil=True)
def _ramp(t):
    """Share of a voxel inside of a face that lies ``t`` voxels outwards of its middle."""
    return min(max(t + 0.5, 0.0), 1.0)


@njit(cache=True, nogil=True)
def lay_fibres(field, starts, angles, lengths, widths, curls):
    """Add fibres (n) of elliptical cross-section to field (rows, cols).

    All lengths in nodes of the field: ``starts`` (n, 2) are (x, y), ``curls`` rad a node. A fibre
    is 1 high along its middle and nothing at its edges; the field keeps the highest of all.
    """
    rows, cols = field.shape
    for n in range(starts.shape[0]):
        half = widths[n] / 2
        steps = int(lengths[n] * 2)
        x = starts[n, 0]
        y = starts[n, 1]
        a = angles[n]
        px = -(10**6)  # the node before
        py = -(10**6)
        for _ in range(steps):
            x += 0.5 * cos(a)
            y += 0.5 * sin(a)
            a += 0.5 * curls[n]
            cx = int(floor(x + 0.5))
            cy = int(floor(y + 0.5))
            if cx == px and cy == py:
                continue
            px = cx
            py = cy
            r = int(half) + 1
            left = max(cx - r, 0)
            right = min(cx + r + 1, cols)
            for i in range(max(cy - r, 0), min(cy + r + 1, rows)):
                for j in range(left, right):
                    d2 = ((i - y) ** 2 + (j - x) ** 2) / (half * half)
                    if d2 < 1:
                        field[i, j] = max(field[i, j], sqrt(1 - d2))
