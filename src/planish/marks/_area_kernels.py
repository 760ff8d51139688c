# pyright: standard
"""The Gaussian mean of an image: numpy and numba only, arrays in, arrays out."""

from __future__ import annotations

import numpy as np
from numba import njit


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
        middle = image[i]
        for j in range(columns):
            line[j] = down[ry] * middle[j]
        for k in range(1, ry + 1):
            above, below, w = (image[max(i - k, 0)], image[min(i + k, rows - 1)], down[ry + k])
            for j in range(columns):
                line[j] += w * (above[j] + below[j])
        for j in range(columns + 2 * rx):
            wide[j] = line[min(max(j - rx, 0), columns - 1)]
        mean = out[i]
        w = along[rx]
        for j in range(columns):
            mean[j] = w * line[j]
        for k in range(1, rx + 1):
            left, right, w = wide[rx - k :], wide[rx + k :], along[rx + k]
            for j in range(columns):
                mean[j] += w * (left[j] + right[j])
    return out
