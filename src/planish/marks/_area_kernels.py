# pyright: standard
"""Area means, Gaussian means and maxima of images: numpy and numba only, arrays in, arrays out.

Images are float32 ``(y, x)`` with NaN where there is no data.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
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
    low, high, part = (np.empty(columns, np.int64), np.empty(columns, np.int64), np.empty(columns, np.float32))
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
