"""Grey values: clipped, rescaled, compressed, blurred, noisy, shaded, with the artefacts of a scanner."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from benchmarks.wrong.case import Case
from benchmarks.wrong.kinds import kind

Array = NDArray[np.float64]


def _stored(case: Case, values: NDArray[np.floating]) -> None:
    case.volume = np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _sheet_level(case: Case, rng: np.random.Generator) -> float:
    """A grey between base and coating, or a little above the coating's mean, at which a scale ends."""
    _, base, coating = case.right.grey
    return float(base + rng.uniform(0.35, 0.95) * (coating - base))


@kind("clipped", "grey clipped between base and coating, 8 bits")
def _clipped(case: Case, rng: np.random.Generator) -> None:
    level = _sheet_level(case, rng)
    case.volume = np.minimum(case.volume, np.uint8(level))
    case.note = f"at {level:.0f}"


@kind("clipped-rescaled", "the same, stretched to 0-255")
def _window(case: Case, rng: np.random.Generator) -> None:
    level, low = _sheet_level(case, rng), 0.5 * case.right.grey[0]
    _stored(case, 255.0 * (case.volume.astype(float) - low) / (level - low))
    case.note = f"{low:.0f} to {level:.0f}"


@kind("clipped-12-bit", "12-bit data in 16 bits, clipped at 4095")
def _twelve(case: Case, rng: np.random.Generator) -> None:
    level = _sheet_level(case, rng)
    fine = case.volume + rng.uniform(-0.5, 0.5, case.volume.shape)
    case.volume = np.clip(np.rint(fine * 4095 / level), 0, 4095).astype(np.uint16)
    case.note = f"at {level:.0f}"


@kind("clipped-float", "floats clipped at a level")
def _float(case: Case, rng: np.random.Generator) -> None:
    level = _sheet_level(case, rng)
    fine = case.volume + rng.uniform(-0.5, 0.5, case.volume.shape)
    case.volume = (np.minimum(fine, level) / 255.0).astype(np.float32)
    case.note = f"at {level:.0f}"


def _air(case: Case, rng: np.random.Generator) -> None:
    low = case.right.grey[0] + rng.uniform(0, 0.3) * (case.right.grey[1] - case.right.grey[0])
    _stored(case, 255.0 * (case.volume.astype(float) - low) / (250.0 - low))


@kind("gamma", "gamma of 0.45 or 2.2")
def _gamma(case: Case, rng: np.random.Generator) -> None:
    power = float(rng.choice([0.45, 2.2]))
    _stored(case, 255.0 * (case.volume / 255.0) ** power)
    case.note = f"{power:g}"


@kind("rescaled-slices-z", "every slice along z rescaled to 8 bits by its own range")
def _slices_z(case: Case, _: np.random.Generator) -> None:
    _rescale(case, 0)


@kind("rescaled-slices-y", "every slice along y rescaled to 8 bits by its own range")
def _slices_y(case: Case, _: np.random.Generator) -> None:
    _rescale(case, 1)


def _rescale(case: Case, axis: int) -> None:
    v = np.moveaxis(case.volume.astype(np.float32), axis, 0)
    flat = v.reshape(len(v), -1)
    low, high = np.percentile(flat, 0.3, axis=1), np.percentile(flat, 99.7, axis=1)
    v = 255.0 * (v - low[:, None, None]) / np.maximum(high - low, 1)[:, None, None]
    _stored(case, np.moveaxis(v, 0, axis))


@kind("jpeg", "slices along z or y as JPEG of quality 10-35")
def _jpeg(case: Case, rng: np.random.Generator) -> None:
    axis, quality = int(rng.integers(0, 2)), int(rng.integers(10, 36))
    slices: list[NDArray[np.uint8]] = []
    for plane in np.moveaxis(case.volume, axis, 0):
        file = io.BytesIO()
        Image.fromarray(np.ascontiguousarray(plane)).save(file, "JPEG", quality=quality)
        slices.append(np.asarray(Image.open(file)))
    case.volume = np.moveaxis(np.stack(slices), 0, axis)
    case.note = f"quality {quality} along {'zyx'[axis]}"


@kind("blurred-twice", "blurred by another 1.5-2.5 voxels")
def _blurred(case: Case, rng: np.random.Generator) -> None:
    sigma = float(rng.uniform(1.5, 2.5))
    _stored(case, ndimage.gaussian_filter(case.volume.astype(np.float32), sigma))
    case.note = f"sigma {sigma:.1f}"


@kind("median-filter", "median of 5 x 5 x 5 voxels")
def _median(case: Case, _: np.random.Generator) -> None:
    v = case.volume
    for axis in range(3):  # one axis after the other: much the same, and quick
        size = [1, 1, 1]
        size[axis] = 5
        v = ndimage.median_filter(v, size=tuple(size))
    case.volume = v


@kind("noise", "strong noise: 20-40 % of the contrast")
def _noise(case: Case, rng: np.random.Generator) -> None:
    size = float(rng.uniform(0.2, 0.4)) * (case.right.grey[2] - case.right.grey[0])
    _stored(case, case.volume + size * rng.standard_normal(case.volume.shape))
    case.note = f"sd {size:.0f}"


@kind("rings", "strong rings about the axis of rotation")
def _rings(case: Case, rng: np.random.Generator) -> None:
    z, _, x = case.volume.shape
    r = np.hypot(np.arange(z)[:, None] - 0.5 * z, np.arange(x)[None, :] - 0.5 * x)
    plane = np.zeros(r.shape)
    for _ in range(12):
        at = rng.uniform(3, 0.45 * x)
        plane += rng.choice([-1, 1]) * rng.uniform(0.1, 0.25) * np.exp(-0.5 * ((r - at) / rng.uniform(0.7, 2)) ** 2)
    _stored(case, case.volume + (case.right.grey[2] - case.right.grey[0]) * plane[:, None, :])


@kind("cupping", "cupping of 15-35 %")
def _cupping(case: Case, rng: np.random.Generator) -> None:
    _, y, x = case.volume.shape
    size = float(rng.uniform(0.15, 0.35))
    r2 = (np.linspace(-1, 1, y)[:, None] ** 2 + np.linspace(-1, 1, x)[None, :] ** 2) / 2
    air = case.right.grey[0]
    _stored(case, air + (case.volume - air) * (1 - size * (1 - r2))[None])
    case.note = f"{100 * size:.0f} %"


@kind("beam-drift", "the beam fades by 15-40 % over the slices along y")
def _beam(case: Case, rng: np.random.Generator) -> None:
    size = float(rng.uniform(0.15, 0.4))
    _stored(case, case.volume * (1 - size * np.linspace(0, 1, case.volume.shape[1]))[None, :, None])
    case.note = f"{100 * size:.0f} %"


@kind("stitched-grey", "two scans of another brightness stitched, 10-30 %")
def _step(case: Case, rng: np.random.Generator) -> None:
    size = float(rng.uniform(0.1, 0.3))
    half = case.volume.shape[1] // 2
    _stored(case, case.volume * np.where(np.arange(case.volume.shape[1]) < half, 1.0, 1 - size)[None, :, None])
    case.note = f"{100 * size:.0f} %"


@kind("streaks", "streaks along the plane of the sheet, 10-20 % of the contrast")
def _streaks(case: Case, rng: np.random.Generator) -> None:
    size = float(rng.uniform(0.1, 0.2)) * (case.right.grey[2] - case.right.grey[0])
    lines = ndimage.gaussian_filter(rng.standard_normal(case.volume.shape[:2]), (0.7, 6))
    _stored(case, case.volume + size / lines.std() * lines[:, :, None])


def _black(case: Case, rng: np.random.Generator) -> None:
    n = case.volume.shape[1]
    at = int(rng.uniform(0.1, 0.65) * n)
    case.volume = case.volume.copy()
    case.volume[:, at : at + n // 4] = 0


@kind("image-blurred", "the image out of focus by 15-30 um")
def _defocus(case: Case, rng: np.random.Generator) -> None:
    sigma = float(rng.uniform(15, 30))
    case.image = ndimage.gaussian_filter(case.image, sigma / case.pixel_um[0])
    case.note = f"sigma {sigma:.0f} um"


@kind("image-saturated", "the image saturated over most of the sheet")
def _saturated(case: Case, rng: np.random.Generator) -> None:
    level = float(np.percentile(case.image, rng.uniform(25, 50)))
    case.image = np.minimum(case.image / level, 1.0)


@kind("image-vignetting", "the image 2-4 times darker in its corners")
def _vignetting(case: Case, rng: np.random.Generator) -> None:
    h, w = case.image.shape
    r2 = (np.linspace(-1, 1, h)[:, None] ** 2 + np.linspace(-1, 1, w)[None, :] ** 2) / 2
    case.image = case.image / (1 + rng.uniform(1, 3) * r2)


def _image_jpeg(case: Case, rng: np.random.Generator) -> None:
    quality = int(rng.integers(5, 16))
    file = io.BytesIO()
    Image.fromarray(np.rint(255 * case.image).astype(np.uint8)).save(file, "JPEG", quality=quality)
    case.image = np.asarray(Image.open(file)) / 255.0
    case.note = f"quality {quality}"


@kind("image-stretched", "the image stretched by 1-2 % along one axis")
def _stretched(case: Case, rng: np.random.Generator) -> None:
    factor, axis = float(rng.uniform(1.01, 1.02)), int(rng.integers(0, 2))
    n = case.image.shape[axis]
    at = np.arange(n) / factor
    case.image = ndimage.map_coordinates(
        case.image, np.meshgrid(*(at if k == axis else np.arange(case.image.shape[k]) for k in (0, 1)), indexing="ij"),
        order=1,
    )  # fmt: skip
    case.image_back.append(lambda places: places / np.where(np.arange(2) == axis, factor, 1.0))
    case.note = f"{100 * (factor - 1):.1f} %"


@kind("image-stitched", "two tiles of the image with a step of 15-40 um")
def _tiles(case: Case, rng: np.random.Generator) -> None:
    step = float(rng.choice([-1, 1]) * rng.uniform(15, 40)) / case.pixel_um[0]
    half = case.image.shape[1] // 2
    moved = ndimage.shift(case.image, (step, 0.0), order=1, mode="nearest")
    case.image = np.concatenate([case.image[:, :half], moved[:, half:]], axis=1)
    case.image_back.append(
        lambda at: np.stack([at[:, 0] - np.where(at[:, 1] >= half, step, 0.0), at[:, 1]], axis=1)
    )  # fmt: skip
    case.note = f"{step * case.pixel_um[0]:.0f} um"


@kind("image-barrel", "a lens that distorts by 3-6 %")
def _barrel(case: Case, rng: np.random.Generator) -> None:
    k = float(rng.choice([-1, 1]) * rng.uniform(0.03, 0.06))
    middle = 0.5 * (np.array(case.image.shape) - 1)
    half = float(np.hypot(*middle))

    def back(at: Array) -> Array:
        off = (at - middle) / half
        return middle + half * off * (1 + k * np.sum(off**2, axis=-1, keepdims=True))

    at = back(np.moveaxis(np.indices(case.image.shape).astype(float), 0, -1))
    case.image = ndimage.map_coordinates(case.image, np.moveaxis(at, -1, 0), order=1, mode="nearest")
    case.image_back.append(back)
    case.note = f"{100 * k:.0f} %"
