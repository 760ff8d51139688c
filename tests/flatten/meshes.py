"""Flat meshes, and how far a flattened one lies from what it should be."""

import numpy as np


def grid(rows, cols, pitch=1.0):
    v, u = np.mgrid[0:rows, 0:cols] * pitch
    return np.stack([u, v], axis=-1)


def in_space(uv, turn=0.0):
    """A plane of points, turned out of the horizontal by an angle about x."""
    return np.stack([uv[..., 0], np.cos(turn) * uv[..., 1], np.sin(turn) * uv[..., 1]], axis=-1)


def distances(uv, truth):
    """Of each node that has one from its true place, after the best turn and shift."""
    known = np.isfinite(truth[..., 0])
    a, b = (places[known] @ [1, 1j] for places in (uv, truth))
    a, b = a - a.mean(), b - b.mean()
    turn = np.vdot(a, b)
    return np.abs(a * turn / abs(turn) - b)
