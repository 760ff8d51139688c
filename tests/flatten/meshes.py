"""Flat meshes, middles of pixels, and how far a flattened one lies from what it should be."""

import numpy as np


def grid(rows, cols, pitch=1.0):
    v, u = np.mgrid[0:rows, 0:cols] * pitch
    return np.stack([u, v], axis=-1)


def middles(pixels):
    """Middles of the pixels of a grid, u and v."""
    return np.stack(np.meshgrid(pixels.x_um, pixels.y_um), axis=-1)


def in_space(uv, turn=0.0):
    """A plane of points, turned out of the horizontal by an angle about x."""
    return np.stack([uv[..., 0], np.cos(turn) * uv[..., 1], np.sin(turn) * uv[..., 1]], axis=-1)


def on_cylinder(uv, radius, angle=0.0):
    """Isometric: arcs across the rulings, which stand at an angle to the grid; exactly unrolled by
    ``uv``."""
    c, s = np.cos(angle), np.sin(angle)
    along, across = c * uv[..., 0] + s * uv[..., 1], c * uv[..., 1] - s * uv[..., 0]
    x = radius * np.sin(along / radius)
    return np.stack(
        [c * x - s * across, s * x + c * across, radius * np.cos(along / radius)], axis=-1
    )


def on_sphere(uv, radius):
    """Lengths along radii from the origin of ``uv`` and all angles there are kept."""
    angle = np.linalg.norm(uv, axis=-1, keepdims=True) / radius
    return np.concatenate([uv * np.sinc(angle / np.pi), radius * np.cos(angle)], axis=-1)


def distances(uv, truth):
    """Of each node that has one from its true place, after the best turn and shift."""
    known = np.isfinite(truth[..., 0])
    a, b = (places[known] @ [1, 1j] for places in (uv, truth))
    a, b = a - a.mean(), b - b.mean()
    turn = np.vdot(a, b)
    return np.abs(a * turn / abs(turn) - b)
