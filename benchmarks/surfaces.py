"""Warped sheets for the flattening benchmarks: developable ones with their flat truth, smooth
bumps, and rough ones."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline


def developable(rows, cols, *, angle=0.0, slope=1.0, waves=1.5):
    """Cylinder over a sine with slopes up to ``slope``; ``angle`` turns its rulings away from the
    rows' normal.

    Returns points (rows, cols, 3) at pitch 1 in x and y, and their true flat places (rows, cols,
    2).
    """
    size = max(rows, cols)
    k = 2 * np.pi * waves / size
    y, x = np.mgrid[:rows, :cols].astype(float)
    c, s = np.cos(angle), np.sin(angle)
    t, w = c * x + s * y, -s * x + c * y
    fine = np.linspace(-2.0 * size, 2.0 * size, 200_001)
    speed = np.sqrt(1 + (slope * np.cos(k * fine)) ** 2)
    # Simpson's rule between the nodes: the truth is good to 1e-12.
    middle = np.sqrt(1 + (slope * np.cos(k * 0.5 * (fine[1:] + fine[:-1]))) ** 2)
    arc = np.concatenate(
        [[0.0], np.cumsum((speed[1:] + speed[:-1] + 4 * middle) * np.diff(fine) / 6)]
    )
    a = CubicSpline(fine, arc)(t)
    points = np.stack([x, y, slope / k * np.sin(k * t)], axis=-1)
    return points, np.stack([c * a - s * w, s * a + c * w], axis=-1)


def smooth(rows, cols, *, seed=0, stretch=0.015):
    """Bumps of 1.5 to 5 waves a side; the springs of the projection are ``stretch`` too short in
    the mean."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:rows, :cols].astype(np.float64)
    z = np.zeros((rows, cols))
    size = max(rows, cols)
    for _ in range(6):
        length = size / rng.uniform(1.5, 5)
        turn, phase, k = rng.uniform(0, np.pi), rng.uniform(0, 2 * np.pi), 2 * np.pi / length
        # Products of a wave along each axis: no sum of cylinders.
        z += length * (
            np.sin(k * np.cos(turn) * x[0] + phase)
            * np.cos(k * np.sin(turn) * y[:, :1] + 1.7 * phase)
        )
    square = np.mean(np.diff(z[:: max(1, rows // 200)], axis=1) ** 2)
    square = 0.5 * (square + np.mean(np.diff(z[:, :: max(1, cols // 200)], axis=0) ** 2))
    z *= np.sqrt(2 * stretch / square)
    return np.stack([x, y, z], axis=-1)


def roughness(rows, cols, *, slope=0.2, seed=1, shortest=2.0, longest=10.0, tile=1024):
    """Heights with equal power at all waves of 2 to 10 nodes and the given RMS slope (central
    differences).

    Larger sheets repeat a tile, which costs less than making them.
    """
    n, m = min(rows, tile), min(cols, tile)
    rng = np.random.default_rng(seed)
    f = np.hypot(np.fft.fftfreq(n)[:, None], np.fft.rfftfreq(m)[None])
    z = np.fft.irfft2(
        np.fft.rfft2(rng.normal(size=(n, m))) * ((f >= 1 / longest) & (f <= 1 / shortest)), s=(n, m)
    )
    z *= slope / np.sqrt(np.mean(np.gradient(z, axis=0) ** 2 + np.gradient(z, axis=1) ** 2))
    return np.tile(z, (-(-rows // n), -(-cols // m)))[:rows, :cols]


def rough(rows, cols, *, slope=0.2, seed=1):
    """``smooth`` with ``roughness``."""
    points = smooth(rows, cols)
    points[..., 2] += roughness(rows, cols, slope=slope, seed=seed)
    return points


def misplaced(uv, truth):
    """Root mean square distance of ``uv`` from ``truth`` after turning and shifting, over the nodes
    known in uv."""
    there = np.isfinite(uv).all(axis=-1) & np.isfinite(truth).all(axis=-1)
    a, b = uv[there], truth[there]
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    angle = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return float(np.sqrt(np.mean(np.sum((a @ turn - b) ** 2, axis=1))))
