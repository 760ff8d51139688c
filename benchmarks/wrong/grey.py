"""Grey values: clipped, rescaled, compressed, blurred, noisy, shaded, with the artefacts of a
scanner."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image
from scipy import ndimage

from benchmarks.wrong.kinds import enter, kind


def _clipped(change):
    """A grey between base and coating, or a little above the coating's mean, at which a scale
    ends."""

    def clip(case, rng):
        _, base, coating = case.right.grey
        level = float(base + rng.uniform(0.35, 0.95) * (coating - base))
        case.note = f"at {level:.0f}"
        change(case, rng, level)

    return clip


def _contrast(case):
    return case.right.grey[2] - case.right.grey[0]


def _eight(case, _, level):
    case.volume = np.minimum(case.volume, np.uint8(level))


def _window(case, _, level):
    low = 0.5 * case.right.grey[0]
    case.store(255.0 * (case.volume.astype(float) - low) / (level - low))


enter("clipped", "grey clipped between base and coating, 8 bits", _clipped(_eight))
enter("clipped-rescaled", "the same, stretched to 0-255", _clipped(_window))


@kind("gamma", "gamma of 0.45 or 2.2")
def _gamma(case, rng):
    power = float(rng.choice([0.45, 2.2]))
    case.store(255.0 * (case.volume / 255.0) ** power)
    case.note = f"{power:g}"


def _rescale(case, _):
    v = case.volume.astype(np.float32)
    low, high = (
        np.percentile(v.reshape(len(v), -1), share, axis=1)[:, None, None] for share in (0.3, 99.7)
    )
    case.store(255.0 * (v - low) / np.maximum(high - low, 1))


enter("rescaled-slices-z", "every slice along z rescaled to 8 bits by its own range", _rescale)


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
        plane += (
            rng.choice([-1, 1])
            * rng.uniform(0.1, 0.25)
            * np.exp(-0.5 * ((r - at) / rng.uniform(0.7, 2)) ** 2)
        )
    case.store(case.volume + _contrast(case) * plane[:, None, :])


def _from_middle(shape):
    """Squared distance from the middle, 1 in the corners."""
    y, x = (np.linspace(-1, 1, n) for n in shape)
    return (y[:, None] ** 2 + x[None, :] ** 2) / 2


@kind("cupping", "cupping of 15-35 %", size=(0.15, 0.35, "of the grey"))
def _cupping(case, _, size):
    air = case.right.grey[0]
    case.store(
        air + (case.volume - air) * (1 - size * (1 - _from_middle(case.volume.shape[1:])))[None]
    )


@kind(
    "stitched-grey",
    "two scans of another brightness stitched, 10-30 %",
    size=(0.1, 0.3, "of the grey"),
)
def _step(case, _, size):
    n = case.volume.shape[1]
    case.store(case.volume * np.where(np.arange(n) < n // 2, 1.0, 1 - size)[None, :, None])


@kind(
    "streaks",
    "streaks along the plane of the sheet, 10-20 % of the contrast",
    size=(0.1, 0.2, "of the contrast"),
)
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


def _barrel(case, rng):
    k = float(rng.choice([-1, 1]) * rng.uniform(0.03, 0.06))
    middle = 0.5 * (np.array(case.image.shape) - 1)
    half = float(np.hypot(*middle))

    def back(at):
        off = (at - middle) / half
        return middle + half * off * (1 + k * np.sum(off**2, axis=-1, keepdims=True))

    at = back(np.moveaxis(np.indices(case.image.shape).astype(float), 0, -1))
    case.image = ndimage.map_coordinates(
        case.image, np.moveaxis(at, -1, 0), order=1, mode="nearest"
    )
    case.image_back.append(back)
    case.note = f"{100 * k:.0f} %"


enter("image-barrel", "a lens that distorts by 3-6 %", _barrel)
