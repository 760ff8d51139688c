# pyright: standard
"""Compiled inner loops of resampling: which quad covers a pixel, and what stands there."""

import numpy as np
from numba import njit

_EDGE = 1e-9


@njit(cache=True, nogil=True)
def locate(px, py, rows_out, cols_out):
    """Find, for every pixel of a regular grid, the place in a quad mesh that lies on it.

    Parameters
    ----------
    px, py : (rows, cols)
        Position of the mesh's nodes in pixels of the target (column, row); NaN where there is none.
    rows_out, cols_out : int
        Shape of the target; pixel i has its centre at i.

    Returns
    -------
    (2, rows_out, cols_out)
        Fractional row and column in the mesh; NaN where no quad lies. A quad is cut into two triangles along its first
        diagonal; within a triangle the place is linear (barycentric). Where quads overlap the first one stays and the
        pixel is counted.
    int
        Number of pixels covered by more than one quad.
    """
    out = np.full((2, rows_out, cols_out), np.nan)
    twice = 0
    rows, cols = px.shape
    cx = np.empty(4)
    cy = np.empty(4)
    # Corners in order (0,0) (0,1) (1,1) (1,0); triangles 0-1-2 and 0-2-3.
    for i in range(rows - 1):
        for j in range(cols - 1):
            cx[0], cy[0] = px[i, j], py[i, j]
            cx[1], cy[1] = px[i, j + 1], py[i, j + 1]
            cx[2], cy[2] = px[i + 1, j + 1], py[i + 1, j + 1]
            cx[3], cy[3] = px[i + 1, j], py[i + 1, j]
            lo_x = min(cx[0], cx[1], cx[2], cx[3])
            hi_x = max(cx[0], cx[1], cx[2], cx[3])
            lo_y = min(cy[0], cy[1], cy[2], cy[3])
            hi_y = max(cy[0], cy[1], cy[2], cy[3])
            if not (np.isfinite(lo_x + hi_x + lo_y + hi_y)):
                continue
            if np.isnan(cx[0] + cx[1] + cx[2] + cx[3] + cy[0] + cy[1] + cy[2] + cy[3]):
                continue
            if hi_x < 0 or hi_y < 0 or lo_x > cols_out - 1 or lo_y > rows_out - 1:
                continue
            for y in range(max(int(np.ceil(lo_y)), 0), min(int(np.floor(hi_y)), rows_out - 1) + 1):
                for x in range(max(int(np.ceil(lo_x)), 0), min(int(np.floor(hi_x)), cols_out - 1) + 1):
                    for t in range(2):
                        b = 1 + t
                        c = 2 + t
                        det = (cx[b] - cx[0]) * (cy[c] - cy[0]) - (cx[c] - cx[0]) * (cy[b] - cy[0])
                        if det == 0.0:
                            continue
                        wb = ((x - cx[0]) * (cy[c] - cy[0]) - (cx[c] - cx[0]) * (y - cy[0])) / det
                        wc = ((cx[b] - cx[0]) * (y - cy[0]) - (x - cx[0]) * (cy[b] - cy[0])) / det
                        if wb < -_EDGE or wc < -_EDGE or wb + wc > 1 + _EDGE:
                            continue
                        if t == 0:
                            r, s = wc, wb + wc  # corners 1 = (0, 1), 2 = (1, 1)
                        else:
                            r, s = wb + wc, wb  # corners 2 = (1, 1), 3 = (1, 0)
                        if np.isnan(out[0, y, x]):
                            out[0, y, x] = i + r
                            out[1, y, x] = j + s
                        elif abs(out[0, y, x] - i - r) > 1e-6 or abs(out[1, y, x] - j - s) > 1e-6:
                            twice += 1
                        break
    return out, twice


@njit(cache=True, nogil=True)
def sample(field, place, out):
    """Set out (n) to the bilinear value of field (rows, cols) at place (2, n); NaN where a corner in use is NaN."""
    rows, cols = field.shape
    for n in range(place.shape[1]):
        r, c = place[0, n], place[1, n]
        out[n] = np.nan
        if not (0.0 <= r <= rows - 1 and 0.0 <= c <= cols - 1):
            continue
        i, j = min(int(r), rows - 2), min(int(c), cols - 2)
        fr, fc = r - i, c - j
        value = 0.0
        # A corner without weight may be missing: a node on the border of the sheet keeps its own value.
        if (1 - fr) * (1 - fc) > 0:
            value += (1 - fr) * (1 - fc) * field[i, j]
        if (1 - fr) * fc > 0:
            value += (1 - fr) * fc * field[i, j + 1]
        if fr * (1 - fc) > 0:
            value += fr * (1 - fc) * field[i + 1, j]
        if fr * fc > 0:
            value += fr * fc * field[i + 1, j + 1]
        out[n] = value
