"""A second maker of specimens, on purpose unlike planish.synthetic: another bend, another texture,
another image.

The sheet is part of a cone, which unrolls exactly and has closed formulas both ways; its
thicknesses are noise with a power law; a voxel takes the exact share of its volume that lies below
each face (a plane cutting a box).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from benchmarks.wrong.truth import LARGE_UM, SIZE_UM, Right, heights, layer

Floats = NDArray[np.float64]
_GRID_UM = 4.0  # of the fields of thickness
_BEYOND_UM = 500.0
# Share of the normal along an axis, below which the box counts as that wide: no division by 0.
_LEAST = 0.03


def turned(angle):
    """The matrix of a rotation in a plane."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


@dataclass(frozen=True, kw_only=True)
class Cone:
    """Material (u, v, s) to space and back; ``turn`` (3, 3) brings the cone's own axes to space,
    ``middle`` the origin.

    ``rho_um`` is the distance of the origin from the apex, ``half_rad`` the angle between axis and
    surface.
    """

    rho_um: float
    half_rad: float
    convex: bool
    along_rad: float
    turn: Floats
    middle: Floats

    def _frame(self):
        """Place of the origin, and the axes (3, 3) along the ray, across it, and out of the cone,
        as rows."""
        s, c = np.sin(self.half_rad), np.cos(self.half_rad)
        return self.rho_um * np.array([s, 0, c]), np.array([[s, 0, c], [0, 1, 0], [c, 0, -s]])

    def material(self, points):
        """(u, v, s) of points (..., 3)."""
        sign = 1.0 if self.convex else -1.0
        local = (points - self.middle) @ self.turn
        a, b, c = local[..., 0], sign * local[..., 1], sign * local[..., 2]
        origin, axes = self._frame()
        p = [origin[k] + a * axes[0, k] + b * axes[1, k] + c * axes[2, k] for k in range(3)]
        sin, cos = np.sin(self.half_rad), np.cos(self.half_rad)
        r = np.hypot(p[0], p[1])
        rho, angle = r * sin + p[2] * cos, np.arctan2(p[1], p[0]) * sin
        flat = (
            np.stack([rho * np.cos(angle) - self.rho_um, sign * rho * np.sin(angle)], axis=-1)
            @ turned(self.along_rad).T
        )
        return np.concatenate([flat, (sign * (r * cos - p[2] * sin))[..., None]], axis=-1)

    def points(self, uv, s=0.0):
        """Points (..., 3) of material (u, v, s)."""
        sign = 1.0 if self.convex else -1.0
        flat = uv @ turned(self.along_rad)
        first, second = flat[..., 0] + self.rho_um, sign * flat[..., 1]
        sin, cos = np.sin(self.half_rad), np.cos(self.half_rad)
        rho, angle = np.hypot(first, second), np.arctan2(second, first) / sin
        out = sign * np.asarray(s)
        r, h = rho * sin + out * cos, rho * cos - out * sin
        origin, axes = self._frame()
        p = np.stack([r * np.cos(angle), r * np.sin(angle), h], axis=-1) - origin
        local = p @ axes.T
        local = local * np.array([1.0, sign, sign])
        return local @ self.turn.T + self.middle

    def centre(self, y, x):
        """(u, v, z) of the sheet's middle over the columns (y, x), by Newton's method along z."""
        xs, ys = np.meshgrid(x, y)
        z = np.full(xs.shape, self.middle[2])
        for _ in range(8):
            at = np.stack([xs, ys, z], axis=-1)
            s = self.material(at)[..., 2]
            rise = (self.material(at + np.array([0, 0, 0.5]))[..., 2] - s) / 0.5
            z = z - s / rise
        uv = self.material(np.stack([xs, ys, z], axis=-1))[..., :2]
        return np.concatenate([uv, z[..., None]], axis=-1)


@dataclass(frozen=True, kw_only=True)
class Fields:
    """Four faces (4, rows, cols) over the material, from ``low`` (u, v) on."""

    low: Floats
    faces: Floats
    tint: Floats

    def at(self, field, u, v):
        """Bilinear value at (u, v); NaN where that is."""
        places = np.stack([(v - self.low[1]) / _GRID_UM, (u - self.low[0]) / _GRID_UM])
        found = ndimage.map_coordinates(field, np.nan_to_num(places), order=1, mode="nearest")
        return np.where(np.isfinite(u) & np.isfinite(v), found, np.nan)

    def thickness(self, name, u, v):
        """True thickness by name."""
        return self.at(layer(self.faces, name), u, v)


@dataclass(frozen=True, kw_only=True)
class Pose:
    """From (u, v) to the image (x, y), an affine map, and back."""

    linear: Floats
    shift: Floats

    def __call__(self, uv):
        return np.asarray(uv) @ self.linear.T + self.shift

    @cached_property
    def back(self):
        """Inverse of the linear part."""
        return np.linalg.inv(self.linear)

    def inverse(self, xy):
        """From the image to the sheet."""
        return (np.asarray(xy) - self.shift) @ self.back.T


def make(order):
    """Draw one specimen."""
    rng = np.random.default_rng([11, order.seed])
    size = LARGE_UM if order.large else SIZE_UM
    voxel = rng.uniform(4.4, 5.4)
    coats = rng.uniform(12, 24, 2) if order.coated else np.zeros(2)
    base = rng.uniform(50, 80)
    cone = _bend(order, rng, size, 0.5 * base + float(coats.max()))
    fields = _fields(rng, size, base, coats)
    program = order.seed if order.program is None else order.program
    radius = np.random.default_rng([13, program]).uniform(58, 75)
    count = order.holes or (11 if order.large else 7)
    holes = _pattern(np.random.default_rng([12, program]), size, count, radius)
    holes = holes + rng.normal(0, 2.0, holes.shape)
    shape = (round(size[1] / voxel), round(size[0] / voxel))
    columns = cone.centre(voxel * np.arange(shape[0]), voxel * np.arange(shape[1]))
    air = 1.25 * (0.5 * base + float(coats.max())) + 55.0
    deep = float(columns[..., 2].min()) - air
    cone = replace(cone, middle=cone.middle - [0.0, 0.0, deep])
    columns[..., 2] -= deep
    depth = int(np.ceil((float(columns[..., 2].max()) + air) / voxel)) + 1
    grey = (rng.uniform(25, 60), rng.uniform(85, 110), rng.uniform(160, 205))
    noise = rng.uniform(0.02, 0.05) * (grey[2] - grey[0])
    volume = _scan(cone, fields, (holes, radius), (depth, *shape), voxel, columns, grey, noise, rng)
    pixel = rng.uniform(4.0, 5.5)
    pose, frame = _pose(rng, columns, pixel)
    y, x = np.indices(frame) * pixel
    uv = pose.inverse(np.stack([x, y], axis=-1))
    image = _photograph(fields, (holes, radius), uv, pixel, rng)
    return Right(
        maker="second",
        seed=order.seed,
        volume=volume,
        voxel_um=voxel,
        grey=grey,
        noise=noise,
        image=image,
        pixel_um=pixel,
        holes=holes,
        radius_um=radius,
        material=cone.material,
        points=cone.points,
        thickness=fields.thickness,
        image_of=pose,
        pixels=lambda: uv,
        columns=columns,
        faces=heights(columns, voxel, fields.faces, fields.at),
        note=f"base {base:.0f}, coating {coats[0]:.0f}, voxel {voxel:.2f}",
    )


def _bend(order, rng, size, thick):
    slope = (
        order.slope
        if order.slope is not None
        else rng.uniform(0.6, 1.0)
        if order.steep
        else rng.uniform(0.08, 0.4)
    )
    radius = max(0.5 * float(np.hypot(*size)) * 0.85 / np.sin(np.arctan(slope)), 4 * thick)
    rho = rng.uniform(4.0, 9.0) * max(size)
    around, tilt = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(-4, 4, 2))
    turn = np.eye(3)
    for angle, axes in zip((around, *tilt), ((0, 1), (1, 2), (0, 2)), strict=True):
        lean = np.eye(3)
        lean[np.ix_(axes, axes)] = turned(angle)
        turn = lean @ turn
    return Cone(
        rho_um=rho,
        half_rad=float(np.arctan(radius / rho)),
        convex=bool(rng.random() < 0.5),
        along_rad=float(around),
        turn=turn,
        middle=np.array([0.5 * size[0], 0.5 * size[1], 0.0]),
    )


def _fields(rng, size, base, coats):
    half = 0.75 * np.array(size) + _BEYOND_UM
    shape = tuple(int(n) for n in 2 * half[::-1] / _GRID_UM)
    loose = [_power(shape, rng, 25.0, 900.0, 1.3) for _ in range(6)]
    thickness = base + 3.5 * loose[0]
    bend = 2.5 * loose[1]  # of both faces of the base
    upper, lower = bend + 0.5 * thickness, bend - 0.5 * thickness
    coating = [
        (
            np.maximum(mean + sd * k - 0.35 * (inner - inner.mean()) * sign, 0.0)
            if mean
            else np.zeros(shape)
        )
        for mean, sd, k, inner, sign in zip(
            coats,
            rng.uniform(2.2, 3.6, 2),
            (loose[2], loose[3]),
            (upper, lower),
            (1, -1),
            strict=True,
        )
    ]
    return Fields(
        low=-half,
        faces=np.stack([upper + coating[0], upper, lower, lower - coating[1]]),
        tint=loose[4],
    )


def _power(shape, rng, least, most, power):
    """Noise between two wavelengths in um whose amplitude goes with wavelength to a power; mean 0,
    sd 1."""
    fy, fx = fft.fftfreq(shape[0], _GRID_UM), fft.rfftfreq(shape[1], _GRID_UM)
    f = np.maximum(np.hypot(fy[:, None], fx[None, :]), 1 / most)
    weight = f**-power * np.exp(-((f * least) ** 2))
    weight[0, 0] = 0.0
    field = fft.irfft2(fft.rfft2(rng.standard_normal(shape)) * weight, shape)
    return field / field.std()


def _pattern(rng, size, count, radius):
    """Holes far from each other and inside the field, (u, v) about its middle."""
    half = 0.5 * np.array(size) - radius - 70.0
    for apart in np.linspace(3.4, 2.4, 6) * radius:
        found = []
        for _ in range(3000):
            point = rng.uniform(-half, half)
            if all(np.hypot(*(point - other)) > apart + 60 for other in found):
                found.append(point)
            if len(found) == count:
                return np.array(found)
    raise ValueError(f"{count} holes do not fit")


def _below(distance, normal, voxel):
    """Share of a cubic voxel that lies below a plane ``distance`` above its middle along the unit
    ``normal``.

    The sum over the corners of the cube of a box on one side of a plane: +-(d)^3 / (6 a b c).
    """
    sides = np.maximum(np.abs(normal), _LEAST) * voxel
    total = np.zeros(distance.shape)
    for corner in range(8):
        signs = [1.0 if corner >> k & 1 else -1.0 for k in range(3)]
        d = distance + 0.5 * sum(sign * sides[..., k] for k, sign in enumerate(signs))
        total += np.prod(signs) * np.maximum(d, 0.0) ** 3
    return np.clip(total / (6 * sides.prod(axis=-1)), 0.0, 1.0)


def _scan(cone, fields, burnt, shape, voxel, columns, grey, noise, rng):
    slopes = np.gradient(columns[..., 2], voxel)
    normal = np.stack([-slopes[1], -slopes[0], np.ones(shape[1:])], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    reach = (float(np.abs(fields.faces).max()) + 2 * voxel) / normal[..., 2]
    net = ndimage.gaussian_filter(rng.standard_normal(shape).astype(np.float32), (1.0, 1.6, 1.6))
    net *= 0.15 / net.std()
    volume = np.zeros(shape, dtype=np.float32)
    for k in range(shape[0]):
        rows, cols = np.nonzero(np.abs(k * voxel - columns[..., 2]) < reach)
        if not rows.size:
            continue
        u, v, s = np.moveaxis(
            cone.material(np.stack([cols, rows, np.full(rows.size, k)], axis=-1) * voxel), -1, 0
        )
        own = normal[rows, cols]
        parts = [_below(fields.at(face, u, v) - s, own, voxel) for face in fields.faces]
        top, base, bottom = (parts[i] - parts[i + 1] for i in range(3))
        whole = _away(burnt, u, v, voxel)
        shine = (grey[1] - grey[0]) * (1 + net[k, rows, cols]) * base + (grey[2] - grey[0]) * (
            top + bottom
        )
        volume[k, rows, cols] = whole * shine
    volume = ndimage.gaussian_filter(volume, rng.uniform(0.45, 0.65))
    grain = ndimage.gaussian_filter(rng.standard_normal(shape).astype(np.float32), 0.5)
    volume += grey[0] + noise / grain.std() * grain
    return np.clip(np.rint(volume), 0, 255).astype(np.uint8)


def _away(burnt, u, v, step):
    """1 on the sheet, 0 in a hole, between them over one step."""
    holes, radius = burnt
    share = np.ones(u.shape)
    for at in holes:
        share = np.minimum(
            share, np.clip((np.hypot(u - at[0], v - at[1]) - radius) / step + 0.5, 0, 1)
        )
    return share


def _pose(rng, columns, pixel):
    angle, scale = np.deg2rad(rng.uniform(-10, 10)), 1 + rng.uniform(-0.006, 0.006)
    linear = scale * turned(angle)
    corners = columns[..., :2].reshape(-1, 2) @ linear.T
    low, high = corners.min(axis=0), corners.max(axis=0)
    shift = -low + rng.uniform(20, 60, 2)
    frame = (high - low + shift - (-low) + 40.0) / pixel
    return Pose(linear=linear, shift=shift), (int(frame[1]), int(frame[0]))


def _photograph(fields, burnt, uv, pixel, rng):
    u, v = uv[..., 0], uv[..., 1]
    coating = fields.thickness("coating_top", u, v)
    light = 0.62 + 0.012 * (coating - coating.mean()) + 0.012 * fields.at(fields.tint, u, v)
    whole = _away(burnt, u, v, pixel)
    image = ndimage.gaussian_filter(0.12 + (light - 0.12) * whole, 0.7)
    return np.clip(image + 0.006 * rng.standard_normal(u.shape), 0, 1)
