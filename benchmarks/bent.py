"""Bent sheets whose every length is known, as height fields: general cylinders, cones, and what a
scan finds of them.

Nothing here is that of planish's own specimens but the formulas that must be: a cylinder's profile
is any curve given by its angle over arc length, a cone any curve on a sphere around its apex.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy import ndimage

from planish.core.frame import Frame
from planish.core.status import Status, status_flags
from planish.core.typing import Floats
from planish.surface import SurfaceParams
from planish.surface.assemble import alternative_surfaces, centre_surface

PITCH_UM = 8.0  # of the columns
_RIM_UM = 100.0
_FACES = ("top", "interface_top", "interface_bottom", "bottom")


Surface = Callable[[Floats], Floats]
"""A surface that keeps its lengths: (u, v) in the plane (..., 2) to points in space (..., 3)."""


def waves(rng, at):
    """One to three waves of 1.6 to 9 mm."""
    return sum(
        rng.uniform(0.4, 1.0)
        * np.sin(2 * np.pi * at / rng.uniform(1600, 9000) + rng.uniform(0, 6.28))
        for _ in range(int(rng.integers(1, 4)))
    )


@dataclass(frozen=True)
class Cylinder:
    """Rolled along a direction: its profile turns by a sum of waves of arc length."""

    turn: float
    at: Floats
    curve: Floats  # (n, 2)

    @classmethod
    def drawn(cls, rng, slope):
        """Draw a profile whose steepest slope is ``slope``."""
        at = np.arange(-9000.0, 9001.0)
        angle = waves(rng, at) + rng.uniform(-0.3, 0.3)
        angle *= np.arctan(slope) / np.abs(angle[7500:-7500]).max()
        steps = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        # Simpson's rule with the middle of each step from a finer evaluation of the same smooth
        # function.
        curve = np.concatenate(
            [np.zeros((1, 2)), np.cumsum(0.5 * (steps[1:] + steps[:-1]), axis=0)]
        )
        return cls(turn=rng.uniform(0, np.pi), at=at, curve=curve - curve[at.size // 2])

    def __call__(self, uv):
        c, s = np.cos(self.turn), np.sin(self.turn)
        p, q = uv[..., 0] * c + uv[..., 1] * s, -uv[..., 0] * s + uv[..., 1] * c
        x, z = (np.interp(p, self.at, self.curve[:, k]) for k in range(2))
        return np.stack([x * c - q * s, x * s + q * c, z], axis=-1)


@dataclass(frozen=True)
class Cone:
    """Straight lines from an apex far outside the field: the distance from it and the angle between
    lines are kept."""

    apex: float
    turn: float
    at: Floats
    lines: Floats  # (n, 3) unit vectors over the angle between them

    @classmethod
    def drawn(cls, rng, slope):
        """Draw a cone whose steepest slope is about ``slope``."""
        apex = rng.uniform(5000, 15000)
        theta = np.linspace(-0.9, 0.9, 36001)
        beta = waves(rng, theta * apex)
        steep = np.gradient(beta, theta)
        beta *= slope / np.abs(steep[np.abs(theta) * apex < 1500]).max()
        beta -= beta[theta.size // 2]
        lines = np.stack(
            [np.cos(beta) * np.cos(theta), np.cos(beta) * np.sin(theta), np.sin(beta)], axis=1
        )
        at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(lines, axis=0), axis=1))])
        return cls(apex=apex, turn=rng.uniform(0, 2 * np.pi), at=at - at[at.size // 2], lines=lines)

    def __call__(self, uv):
        c, s = np.cos(self.turn), np.sin(self.turn)
        p, q = uv[..., 0] * c + uv[..., 1] * s + self.apex, -uv[..., 0] * s + uv[..., 1] * c
        along, angle = np.hypot(p, q), np.arctan2(q, p)
        x, y, z = (along * np.interp(angle, self.at, self.lines[:, k]) for k in range(3))
        x = x - self.apex
        return np.stack([x * c - y * s, x * s + y * c, z], axis=-1)


def tangents(surface, uv, step=4.0):
    """Derivatives by u and v and the unit normal, each (..., 3)."""
    by = [
        (surface(uv + d) - surface(uv - d)) / (2 * step)
        for d in (np.array([step, 0.0]), np.array([0.0, step]))
    ]
    normal = np.cross(by[0], by[1])
    return by[0], by[1], normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def material(surface, points):
    """(u, v, s) with surface(u, v) + s normal = points (..., 3)."""
    uv = points[..., :2].copy()
    for _ in range(12):
        by_u, by_v, _ = tangents(surface, uv)
        uv += _solved(by_u, by_v, points - surface(uv))
    _, _, normal = tangents(surface, uv)
    return np.concatenate(
        [uv, np.sum((points - surface(uv)) * normal, axis=-1, keepdims=True)], axis=-1
    )


def _solved(by_u, by_v, off):
    a, b, c = (np.sum(p * q, axis=-1) for p, q in ((by_u, by_u), (by_u, by_v), (by_v, by_v)))
    e, f = np.sum(by_u * off, axis=-1), np.sum(by_v * off, axis=-1)
    return np.stack([c * e - b * f, a * f - b * e], axis=-1) / (a * c - b * b)[..., None]


@dataclass(frozen=True)
class Bent:
    """A drawn sheet, what is found of its faces, and its holes' places in the plane."""

    surface: Surface
    surfaces: xr.Dataset
    # The same, with the true neutral surface smoothed in place of the middle of the base.
    known: xr.Dataset
    columns: Floats  # (n, 2): x and y of the columns over the holes' middles on the centre surface
    holes: Floats  # (n, 2)

    @classmethod
    def drawn(cls, rng, slope, holes):
        """Draw a sheet with a neutral surface anywhere between stiffness ratios of 0 and 3."""
        surface = (Cylinder if rng.random() < 0.6 else Cone).drawn(rng, slope)
        height = float(np.sqrt(max(3.2, 0.3 * holes) / 1.3)) * 1000
        y, x = (
            np.arange(-height / 2, height / 2, PITCH_UM),
            np.arange(-0.65 * height, 0.65 * height, PITCH_UM),
        )
        places = np.stack(np.meshgrid(x, y), axis=-1)
        base, top, bottom = rng.uniform(45, 65), rng.uniform(8, 20), rng.uniform(8, 20)
        ratio = rng.uniform(0, 3)
        above = (
            0.5
            * ratio
            * (top * (base + top) - bottom * (base + bottom))
            / (base + ratio * (top + bottom))
        )
        fields = _Fields(rng, surface, height)
        half, own = 0.5 * fields(base, 4.0), fields(0.0, 2.0)
        layers = [half + own, -half + own]
        layers = [
            layers[0] + fields(top, 4.0),
            layers[0],
            layers[1],
            layers[1] - fields(bottom, 4.0),
        ]
        uv, heights = places.copy(), {}
        for name, layer in zip(_FACES, layers, strict=True):
            uv, heights[name] = fields.under(places, uv, layer - above)
            sd = 0.3 if "face" not in name else 0.6
            heights[name] = heights[name] + sd * _noise(rng, y.size, x.size, 1.2)
        where = _scattered(rng, holes, height)
        thickness = float(base + top + bottom)
        found = _found(heights, y, x, where, thickness)
        neutral = fields.under(places, uv, np.zeros(layers[0].shape))[1]
        known = _found(
            heights | {"interface_top": neutral, "interface_bottom": neutral},
            y,
            x,
            where,
            thickness,
        )
        at = np.concatenate([where, _height_at(found, where)[:, None]], axis=1)
        return cls(surface, found, known, where, material(surface, at)[:, :2])


class _Fields:
    """Smooth random fields of the plane, and the columns that stand on a face."""

    def __init__(self, rng, surface, height):
        self.rng, self.surface = rng, surface
        self.n = int(2.4 * height / PITCH_UM)

    def __call__(self, mean, sd):
        fine, wide = (
            _noise(self.rng, self.n, self.n, 25 / PITCH_UM),
            _noise(self.rng, self.n, self.n, 300 / PITCH_UM),
        )
        return mean + sd * (0.85 * fine + 0.5 * wide)

    def under(self, places, start, field):
        """(u, v) and height of the face ``field`` over the neutral surface at the columns
        ``places`` (..., 2)."""
        uv = start.copy()
        for _ in range(8):
            by_u, by_v, normal = tangents(self.surface, uv)
            at = self.surface(uv) + self._at(field, uv)[..., None] * normal
            uv += np.linalg.solve(
                np.stack([by_u[..., :2], by_v[..., :2]], axis=-1), (places - at[..., :2])[..., None]
            )[..., 0]
        return uv, at[..., 2]

    def _at(self, field, uv):
        index = np.moveaxis(uv[..., ::-1] / PITCH_UM + self.n / 2, -1, 0)
        return ndimage.map_coordinates(field, index, order=1, mode="nearest")


def _noise(rng, rows, cols, sigma):
    made = ndimage.gaussian_filter(rng.standard_normal((rows, cols)), sigma)
    return made / made.std()


def _scattered(rng, count, height):
    """Places (n, 2) of holes, far enough apart, away from the border; most of the field is between
    them."""
    found = []
    apart = 420.0
    while len(found) < count:
        for _ in range(400):
            at = rng.uniform(-1, 1, 2) * (np.array([0.65, 0.5]) * height - 170)
            if all(np.hypot(*(at - other)) > apart for other in found):
                found.append(at)
                break
        else:
            apart *= 0.93
    return np.array(found)


def _found(heights, y, x, holes, thickness):
    """Surfaces as planish finds them: rims left out, the centre surface carried across."""
    away = np.min([np.hypot(x[None, :] - h[0], y[:, None] - h[1]) for h in holes], axis=0)
    rim = away < 90.0 + _RIM_UM
    known = {name: np.where(rim, np.nan, h) for name, h in heights.items()}
    middle = 0.5 * (known["top"] + known["bottom"])
    params, whole, pitch = SurfaceParams(), np.ones(rim.shape, dtype=bool), (PITCH_UM, PITCH_UM)
    centre, _ = centre_surface(middle, whole, pitch, params)
    between = 0.5 * (known["interface_top"] + known["interface_bottom"]) - middle
    others = alternative_surfaces(between, middle, centre, whole, pitch, params)
    data = known | {"centre": centre} | {name: values for name, (values, _) in others.items()}
    status = np.where(rim, Status.RIM, Status.MEASURED).astype(np.uint8)
    fields = {name: (("y", "x"), values) for name, values in data.items()}
    return xr.Dataset(
        {**fields, "status": (("y", "x"), status, status_flags())},
        {"y": y, "x": x},
        Frame().attrs() | {"thickness_um": thickness, "rim_um": _RIM_UM},
    )


def _height_at(surfaces, where):
    index = [
        (where[:, 1] - surfaces["y"].values[0]) / PITCH_UM,
        (where[:, 0] - surfaces["x"].values[0]) / PITCH_UM,
    ]
    return ndimage.map_coordinates(surfaces["centre"].values, index, order=1)
