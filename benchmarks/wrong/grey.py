"""Grey values: clipped, rescaled, compressed, blurred, noisy, shaded, with the artefacts of a scanner."""

from __future__ import annotations

import io
from functools import partial

import numpy as np
from PIL import Image
from scipy import ndimage

from benchmarks.wrong.kinds import enter, kind


def _clipped(change):
    """A grey between base and coating, or a little above the coating's mean, at which a scale ends."""

    def clip(case, rng):
        _, base, coating = case.right.grey
        level = float(base + rng.uniform(0.35, 0.95) * (coating - base))
        case.note = f"at {level:.0f}"
        change(case, rng, level)

    return clip


def _contrast(case):
    return case.right.grey[2] - case.right.grey[0]


def _unrounded(case, rng):
    return case.volume + rng.uniform(-0.5, 0.5, case.volume.shape)


def _eight(case, _, level):
    case.volume = np.minimum(case.volume, np.uint8(level))


def _window(case, _, level):
    low = 0.5 * case.right.grey[0]
    case.store(255.0 * (case.volume.astype(float) - low) / (level - low))


def _twelve(case, rng, level):
    case.volume = np.clip(np.rint(_unrounded(case, rng) * 4095 / level), 0, 4095).astype(np.uint16)


def _float(case, rng, level):
    case.volume = (np.minimum(_unrounded(case, rng), level) / 255.0).astype(np.float32)


enter("clipped", "grey clipped between base and coating, 8 bits", _clipped(_eight))
enter("clipped-rescaled", "the same, stretched to 0-255", _clipped(_window))
enter("clipped-12-bit", "12-bit data in 16 bits, clipped at 4095", _clipped(_twelve))
enter("clipped-float", "floats clipped at a level", _clipped(_float))


@kind("gamma", "gamma of 0.45 or 2.2")
def _gamma(case, rng):
    power = float(rng.choice([0.45, 2.2]))
    case.store(255.0 * (case.volume / 255.0) ** power)
    case.note = f"{power:g}"


def _rescale(case, _, axis):
    v = np.moveaxis(case.volume.astype(np.float32), axis, 0)
    low, high = (np.percentile(v.reshape(len(v), -1), share, axis=1)[:, None, None] for share in (0.3, 99.7))
    case.store(np.moveaxis(255.0 * (v - low) / np.maximum(high - low, 1), 0, axis))


for _axis in (0, 1):
    enter(
        f"rescaled-slices-{'zy'[_axis]}", f"every slice along {'zy'[_axis]} rescaled to 8 bits by its own range",
        partial(_rescale, axis=_axis),
    )  # fmt: skip


@kind("jpeg", "slices along z or y as JPEG of quality 10-35")
def _jpeg(case, rng):
    axis, quality = int(rng.integers(0, 2)), int(rng.integers(10, 36))
    slices = []
    for plane in np.moveaxis(case.volume, axis, 0):
        file = io.BytesIO()
        Image.fromarray(np.ascontiguousarray(plane)).save(file, "JPEG", quality=quality)
        slices.append(np.asarray(Image.open(file)))
    case.volume = np.moveaxis(np.stack(slices), 0, axis)
    case.note = f"quality {quality} along {'zyx'[axis]}"


@kind("blurred-twice", "blurred by another 1.5-2.5 voxels", size=(1.5, 2.5, "voxels"))
def _blurred(case, _, sigma):
    case.store(ndimage.gaussian_filter(case.volume.astype(np.float32), sigma))


@kind("median-filter", "median of 5 x 5 x 5 voxels")
def _median(case, _):
    for size in ((5, 1, 1), (1, 5, 1), (1, 1, 5)):  # one axis after the other: much the same, and quick
        case.volume = ndimage.median_filter(case.volume, size=size)


@kind("noise", "strong noise: 20-40 % of the contrast", size=(0.2, 0.4, "of the contrast"))
def _noise(case, rng, size):
    case.store(case.volume + size * _contrast(case) * rng.standard_normal(case.volume.shape))


@kind("rings", "strong rings about the axis of rotation")
def _rings(case, rng):
    z, _, x = case.volume.shape
    r = np.hypot(np.arange(z)[:, None] - 0.5 * z, np.arange(x)[None, :] - 0.5 * x)
    plane = np.zeros(r.shape)
    for _ in range(12):
        at = rng.uniform(3, 0.45 * x)
        plane += rng.choice([-1, 1]) * rng.uniform(0.1, 0.25) * np.exp(-0.5 * ((r - at) / rng.uniform(0.7, 2)) ** 2)
    case.store(case.volume + _contrast(case) * plane[:, None, :])


def _from_middle(shape):
    """Squared distance from the middle, 1 in the corners."""
    y, x = (np.linspace(-1, 1, n) for n in shape)
    return (y[:, None] ** 2 + x[None, :] ** 2) / 2


@kind("cupping", "cupping of 15-35 %", size=(0.15, 0.35, "of the grey"))
def _cupping(case, _, size):
    air = case.right.grey[0]
    case.store(air + (case.volume - air) * (1 - size * (1 - _from_middle(case.volume.shape[1:])))[None])


@kind("beam-drift", "the beam fades by 15-40 % over the slices along y", size=(0.15, 0.4, "of the grey"))
def _beam(case, _, size):
    case.store(case.volume * (1 - size * np.linspace(0, 1, case.volume.shape[1]))[None, :, None])


@kind("stitched-grey", "two scans of another brightness stitched, 10-30 %", size=(0.1, 0.3, "of the grey"))
def _step(case, _, size):
    n = case.volume.shape[1]
    case.store(case.volume * np.where(np.arange(n) < n // 2, 1.0, 1 - size)[None, :, None])


@kind(
    "streaks", "streaks along the plane of the sheet, 10-20 % of the contrast", size=(0.1, 0.2, "of the contrast")
)  # fmt: skip
def _streaks(case, rng, size):
    lines = ndimage.gaussian_filter(rng.standard_normal(case.volume.shape[:2]), (0.7, 6))
    case.store(case.volume + size * _contrast(case) / lines.std() * lines[:, :, None])


@kind("image-blurred", "the image out of focus by 15-30 um", size=(15, 30, "um"))
def _defocus(case, _, sigma):
    case.image = ndimage.gaussian_filter(case.image, sigma / case.pixel_um[0])


@kind("image-saturated", "the image saturated over most of the sheet")
def _saturated(case, rng):
    level = float(np.percentile(case.image, rng.uniform(25, 50)))
    case.image = np.minimum(case.image / level, 1.0)


@kind("image-vignetting", "the image 2-4 times darker in its corners", size=(1, 3, "times"))
def _vignetting(case, _, size):
    case.image = case.image / (1 + size * _from_middle(case.image.shape))


def _stretched(case, rng):
    factor, axis = rng.uniform(1.01, 1.02), int(rng.integers(0, 2))
    factors = np.where(np.arange(2) == axis, factor, 1.0)
    places = np.meshgrid(*(np.arange(n) / f for n, f in zip(case.image.shape, factors, strict=True)), indexing="ij")
    case.image = ndimage.map_coordinates(case.image, places, order=1)
    case.image_back.append(lambda at: at / factors)
    case.note = f"{100 * (factor - 1):.1f} %"


def _tiles(case, rng):
    step = float(rng.choice([-1, 1]) * rng.uniform(15, 40)) / case.pixel_um[0]
    half = case.image.shape[1] // 2
    moved = ndimage.shift(case.image, (step, 0.0), order=1, mode="nearest")
    case.image = np.concatenate([case.image[:, :half], moved[:, half:]], axis=1)
    case.image_back.append(lambda at: np.stack([at[:, 0] - np.where(at[:, 1] >= half, step, 0.0), at[:, 1]], axis=1))
    case.note = f"{step * case.pixel_um[0]:.0f} um"


def _barrel(case, rng):
    k = float(rng.choice([-1, 1]) * rng.uniform(0.03, 0.06))
    middle = 0.5 * (np.array(case.image.shape) - 1)
    half = float(np.hypot(*middle))

    def back(at):
        off = (at - middle) / half
        return middle + half * off * (1 + k * np.sum(off**2, axis=-1, keepdims=True))

    at = back(np.moveaxis(np.indices(case.image.shape).astype(float), 0, -1))
    case.image = ndimage.map_coordinates(case.image, np.moveaxis(at, -1, 0), order=1, mode="nearest")
    case.image_back.append(back)
    case.note = f"{100 * k:.0f} %"


enter("image-stretched", "the image stretched by 1-2 % along one axis", _stretched)
enter("image-stitched", "two tiles of the image with a step of 15-40 um", _tiles)
enter("image-barrel", "a lens that distorts by 3-6 %", _barrel)
