"""The sheet itself: a second one, delamination, fold, tear, dust, holes not through, few voxels;
marks; options."""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy import ndimage

from benchmarks.wrong.case import eight_bits
from benchmarks.wrong.geometry import image_of_another, pixel
from benchmarks.wrong.kinds import both, enter, kind, told


def _axes(case):
    """Places of the columns along y and x, in um."""
    return (np.arange(n) * case.right.voxel_um for n in case.volume.shape[1:])


def _taller(case, voxels, rng):
    """More air above the sheet."""
    case.volume = np.concatenate([case.volume, case.air((voxels, *case.volume.shape[1:]), rng)])


def _second(case, rng, gap_um, where=None):
    """The same sheet once more above itself, a gap apart; in some columns where that is given."""
    right = case.right
    thick = float(np.median(right.faces[0] - right.faces[3])) + gap_um
    up = max(1, round(thick / right.voxel_um))
    _taller(case, up, rng)
    copy = np.full_like(case.volume, 0)
    copy[up:] = case.volume[:-up]
    if where is not None:
        copy = np.where(where[None], copy, 0)
    case.volume = np.maximum(case.volume, copy)


_GAP = "um apart"
kind("second-sheet", "the same sheet a second time, touching", grave=True, size=(-3, 1, _GAP))(
    _second
)
kind("second-sheet-near", "the same sheet a second time, 5-15 um apart", size=(5, 15, _GAP))(
    _second
)


kind(
    "second-uncoated",
    "two uncoated sheets pressed together",
    hidden="no face between them",
    coated=False,
    size=(-4, -1, _GAP),
)(_second)


@kind("fold", "a strip at the edge folded over the sheet")
def _fold(case, rng):
    y, x = case.volume.shape[1:]
    width = int(rng.uniform(0.12, 0.25) * x)
    where = np.zeros((y, x), dtype=bool)
    where[:, x - 2 * width : x - width] = True
    _second(case, rng, rng.uniform(-2, 3), where)
    beyond = case.volume[:, :, x - width :]
    beyond[...] = case.air(beyond.shape, rng)


@kind("delamination", "the base split over a patch of 0.25-0.5 mm, 10-30 um open")
def _split(case, rng):
    right = case.right
    y, x = _axes(case)
    at, radius = rng.uniform(350, 700, 2), rng.uniform(250, 500)
    open_um = rng.uniform(10, 30)
    bump = open_um * np.clip(
        1.2 - np.hypot((y - at[0])[:, None], (x - at[1])[None, :]) / radius, 0, 1
    )
    bump = np.minimum(bump, 0.8 * open_um) / right.voxel_um
    _taller(case, int(open_um / right.voxel_um) + 2, rng)
    middle = right.columns[..., 2] / right.voxel_um
    z = np.arange(case.volume.shape[0])[:, None, None]
    # Each voxel is taken from another height of its column, and what opens is air.
    source = np.clip(
        np.where(z > middle, z - bump, z).astype(float), 0, case.volume.shape[0] - 1.001
    )
    low = source.astype(np.intp)
    lower, upper = (
        np.take_along_axis(case.volume, k, axis=0).astype(np.float32) for k in (low, low + 1)
    )
    empty = (z > middle) & (z < middle + bump)
    case.store(
        np.where(empty, case.air(empty.shape, rng), lower + (source - low) * (upper - lower))
    )

    def back(places):
        moved = places.copy()
        own, base = (
            ndimage.map_coordinates(field, places[:, 1:].T, order=1, mode="nearest")
            for field in (bump, middle)
        )
        moved[:, 0] -= np.where(places[:, 0] > base, np.minimum(own, places[:, 0] - base), 0.0)
        return moved

    case.back.append(back)
    case.note = f"{open_um:.0f} um open"


@kind("dust", "30-80 grains of 20-40 um a mm2 stick to the coating", size=(30, 80, "grains a mm2"))
def _dust(case, rng, density):
    """Bright blobs on the top face, as dense as the coating."""
    right = case.right
    n, rows, cols = case.volume.shape
    voxel = right.voxel_um
    grey = case.volume.astype(np.float32)
    z = np.arange(n)[:, None, None] * voxel
    for _ in range(int(density * rows * cols * voxel**2 * 1e-6)):
        i, j = int(rng.integers(5, rows - 5)), int(rng.integers(5, cols - 5))
        radius = float(rng.uniform(9, 22))
        reach = int(radius / voxel) + 2
        box = (slice(max(i - reach, 0), i + reach), slice(max(j - reach, 0), j + reach))
        y, x = (axis[s] for axis, s in zip(_axes(case), box, strict=True))
        flat = np.hypot((y - i * voxel)[:, None], (x - j * voxel)[None, :])
        middle = right.faces[0][box] + 0.7 * radius
        inside = np.clip((radius - np.hypot(flat[None], z - middle[None])) / voxel + 0.5, 0, 1)
        part = grey[:, *box]
        part[...] = np.maximum(part, part + inside * (right.grey[2] - part))
    case.store(grey)


@kind("closed-holes", "half of the holes closed by fibres in the scan")
def _closed(case, rng):
    right = case.right
    z = np.arange(case.volume.shape[0])[:, None, None] * right.voxel_um
    inside = (z > right.faces[3]) & (z < right.faces[1])
    grey = eight_bits(right.grey[1] + right.noise * rng.standard_normal(case.volume.shape))
    holes = [at for at in right.holes if rng.random() < 0.5]
    for u, v in holes:
        near = (
            np.hypot(right.columns[..., 0] - u, right.columns[..., 1] - v) < 1.05 * right.radius_um
        )
        case.volume = np.where(inside & near, grey, case.volume)
    case.note = f"{len(holes)} of {len(right.holes)}"


enter(
    "uncoated-wrong-specimen",
    "uncoated, an image of another specimen of the same program",
    partial(image_of_another, coated=False),
    coated=False,
    large=True,
    answer="side and specimen",
)


@kind("few-voxels", "two to four voxels through the sheet")
def _few(case, rng):
    thick = float(np.median(case.right.faces[0] - case.right.faces[3])) / case.right.voxel_um
    factor = max(2, round(thick / int(rng.integers(2, 5))))
    n, rows, cols = case.volume.shape
    grey = case.volume[: n // factor * factor].astype(np.float32)
    case.store(grey.reshape(-1, factor, rows, cols).mean(axis=1))
    z, y, x = case.voxel_um
    case.voxel_um = (z * factor, y, x)
    scale = np.array([factor, 1, 1])
    case.back.append(lambda places: places * scale + 0.5 * (scale - 1))
    case.note = f"{thick / factor:.1f} voxels"


# --- marks by hand and options --------------------------------------------------------------------


def _by_hand(case, rng, sd_um=2.0):
    right = case.right
    volume = right.points(right.holes)
    image = right.image_of(right.holes)
    rows, cols = right.volume.shape[1:]
    inside = np.all(
        (volume[:, :2] > 20) & (volume[:, :2] < right.voxel_um * np.array([cols, rows]) - 20),
        axis=1,
    )
    pairs = np.concatenate([volume, image], axis=1)[inside]
    pairs[:, 3:] += rng.normal(0, sd_um, (len(pairs), 2))
    pairs[:, :2] += rng.normal(0, sd_um, (len(pairs), 2))
    case.pairs = pairs
    return pairs


@kind("marks-one-off", "marks by hand, one of them 40-120 um off")
def _one_off(case, rng):
    pairs = _by_hand(case, rng)
    away, around = rng.uniform(40, 120), rng.uniform(0, 2 * np.pi)
    pairs[int(rng.integers(len(pairs))), 3:] += away * np.array([np.cos(around), np.sin(around)])
    case.note = f"{away:.0f} um of {len(pairs)}"


@kind("marks-exchanged", "marks by hand, two of them exchanged")
def _exchanged(case, rng):
    pairs = _by_hand(case, rng)
    a, b = rng.choice(len(pairs), 2, replace=False)
    pairs[[a, b], 3:] = pairs[[b, a], 3:]


@kind("marks-in-pixels", "marks by hand, the image's in pixels instead of um")
def _in_pixels(case, rng):
    pairs = _by_hand(case, rng)
    pairs[:, 3:] /= case.right.pixel_um


@kind(
    "marks-shifted",
    "marks by hand, all of the image 1.5-4 pixels off by another origin",
    hidden="no mark can see it",
)
def _shifted(case, rng):
    pairs = _by_hand(case, rng, 0.5)
    shift = rng.uniform(1.5, 4) * case.right.pixel_um
    pairs[:, 3:] += shift
    case.note = f"{1.41 * shift:.0f} um"


enter(
    "rigid-on-stretched",
    "--model rigid, pixel size of the image wrong by 1.5 %",
    both(pixel(0.985, 1.015), told("registration", model="rigid")),
)
