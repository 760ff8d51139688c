# pyright: standard
"""Compiled inner loop of the measurement: where the normals of the centre surface meet another surface."""

import numpy as np
from numba import njit

_STEPS = 12
_CLOSE_UM = 1e-4
_HALF = 0.5


@njit(cache=True, nogil=True)
def height_at(field, r, c):
    """Bilinear height at fractional row and column; NaN beside two missing nodes, or right at one.

    A column in which one face was not found has good neighbours as a rule: the plane through the other three nodes
    speaks for it, where they hold half of the weight or more. The outermost cells reach one node further than the
    field, so that a normal at the border, which leans outwards by a fraction of the sheet's thickness, still meets its
    faces. Beyond that NaN.
    """
    rows, cols = field.shape
    if not (-1.0 <= r <= rows and -1.0 <= c <= cols):
        return np.nan
    i, j = min(max(int(r), 0), rows - 2), min(max(int(c), 0), cols - 2)
    fr, fc = r - i, c - j
    p, q, s, t = field[i, j], field[i, j + 1], field[i + 1, j], field[i + 1, j + 1]
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
def along_normals(surface, centre, normal_r, normal_c, normal_h, pitch_r, pitch_c, first):
    """Signed distance from the centre surface to ``surface`` along the normals.

    Parameters
    ----------
    surface, centre : (rows, cols)
        Heights in um.
    normal_r, normal_c, normal_h : (some rows, cols)
        Unit normals along rows, columns and height, or other unit vectors, of the rows from ``first`` on.
    pitch_r, pitch_c : float
        um.
    first : int
        The row of the surfaces that the first row of the normals belongs to.

    Returns
    -------
    (some rows, cols)
        um; NaN where the normal meets no surface.
    """
    rows, cols = normal_h.shape
    out = np.full((rows, cols), np.nan)
    for k in range(rows):
        i = k + first
        for j in range(cols):
            h0, nr, nc, nh = centre[i, j], normal_r[k, j], normal_c[k, j], normal_h[k, j]
            # Secant steps on f(s) = surface - point; the surface is nearly parallel, so they converge in three or four.
            s0 = 0.0
            f0 = surface[i, j] - h0
            if not (np.isfinite(f0) and np.isfinite(nh)):
                continue
            s1 = f0 * nh
            for _ in range(_STEPS):
                f1 = height_at(surface, i + s1 * nr / pitch_r, j + s1 * nc / pitch_c) - (h0 + s1 * nh)
                if not np.isfinite(f1):
                    break
                if abs(f1) < _CLOSE_UM:
                    out[k, j] = s1
                    break
                slope = (f1 - f0) / (s1 - s0) if abs(s1 - s0) > 1e-9 else -nh
                if not (-4.0 < slope < -0.05):
                    slope = -nh
                s0, f0 = s1, f1
                s1 = s1 - f1 / slope
    return out
