# pyright: standard
"""Compiled inner loops: sums over parts of circles, and the correction of a block."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def add_to_rings(grey, kind, depth, bins, sectors, count, total, level):
    """Add the voxels of a slice to their circles, less the mean of their material at their depth in this slice.

    Near the axis a circle runs along the layers of a sheet. A layer is as bright as it is everywhere at its depth, and
    so leaves nothing; a ring does.

    Parameters
    ----------
    grey : (p, q) int64
        Grey above air in thousandths or so of the contrast: whole numbers, whose sums do not depend on their order.
    kind : (p, q) uint8
        0 where a voxel does not count, otherwise 1 + the material.
    depth : (p, q) int64
        Below the face, in voxels.
    bins, sectors : (p, q) int64
    count, total : (sector, material, bin) int64
        Added to.
    level : (material, 2) int64
        Number of voxels and sum of their grey; added to.
    """
    rows, cols = grey.shape
    deepest = 0
    for i in range(rows):
        for j in range(cols):
            deepest = max(deepest, depth[i, j])
    n = np.zeros((level.shape[0], deepest + 1), np.int64)
    mean = np.zeros((level.shape[0], deepest + 1), np.int64)
    for i in range(rows):
        for j in range(cols):
            k = kind[i, j]
            if k:
                n[k - 1, depth[i, j]] += 1
                mean[k - 1, depth[i, j]] += grey[i, j]
    for k in range(level.shape[0]):
        for d in range(deepest + 1):
            level[k, 0] += n[k, d]
            level[k, 1] += mean[k, d]
            if n[k, d]:
                mean[k, d] = int(np.rint(mean[k, d] / n[k, d]))
    for i in range(rows):
        for j in range(cols):
            k = kind[i, j]
            if k and n[k - 1, depth[i, j]] >= 32:
                count[sectors[i, j], k - 1, bins[i, j]] += 1
                total[sectors[i, j], k - 1, bins[i, j]] += grey[i, j] - mean[k - 1, depth[i, j]]


@njit(cache=True, nogil=True)
def add_to_histogram(grey, kind, depth, bins, quarters, count):
    """Add the voxels inside the sheet to the histogram (quarter, radius, depth, grey) int64."""
    rows, cols = grey.shape
    for i in range(rows):
        for j in range(cols):
            if kind[i, j] > 1:
                count[quarters[i, j], bins[i, j], depth[i, j], grey[i, j]] += 1


@njit(cache=True, nogil=True)
def corrected(values, out, tables, at, cup, air, missing, low, high, whole):
    """Correct a block into ``out`` and return how many of its voxels had to be clipped.

    Parameters
    ----------
    values, out : (a, p, q)
        The first axis is the axis of rotation.
    tables : (a, bins)
        Grey to take off at a radius, for each slice.
    at : (p, q)
        Radius in bins, counted from the middle of the first.
    cup : (p, q)
        Factor on what is above ``air``.
    missing : float
        Value that stays as it is; NaN for none.
    low, high : float
        Range of the type.
    whole : bool
        Whether values are rounded.
    """
    clipped = 0
    last = tables.shape[1] - 1
    for k in range(values.shape[0]):
        for i in range(values.shape[1]):
            for j in range(values.shape[2]):
                v = np.float64(values[k, i, j])
                if v == missing or not np.isfinite(v):
                    out[k, i, j] = values[k, i, j]
                    continue
                x = min(max(at[i, j], 0.0), np.float64(last))
                b = min(int(x), last - 1)
                f = x - b
                ring = tables[k, b] * (1.0 - f) + tables[k, b + 1] * f
                v = air + (v - ring - air) / cup[i, j]
                if whole:
                    v = np.rint(v)
                if v < low:
                    v = low
                    clipped += 1
                elif v > high:
                    v = high
                    clipped += 1
                out[k, i, j] = v
    return clipped
