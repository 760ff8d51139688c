"""The sheet itself: a second one, delamination, fold, tear, dust, holes not through, few voxels; marks; options."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks.wrong.case import Case
from benchmarks.wrong.geometry import mirror_image
from benchmarks.wrong.kinds import kind
from benchmarks.wrong.specimens import Draw, drawn

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def _air(case: Case, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    return np.asarray(case.right.grey[0] + case.right.noise * rng.standard_normal(shape))


def _stored(case: Case, values: NDArray[np.floating]) -> None:
    case.volume = np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _taller(case: Case, voxels: int, rng: np.random.Generator) -> None:
    """More air above the sheet."""
    more = _air(case, (voxels, *case.volume.shape[1:]), rng)
    case.volume = np.concatenate([case.volume, np.clip(np.rint(more), 0, 255).astype(np.uint8)])


def _second(case: Case, rng: np.random.Generator, gap_um: float, where: Mask | None = None) -> None:
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


@kind("second-sheet", "the same sheet a second time, touching", grave=True)
def _touching(case: Case, rng: np.random.Generator) -> None:
    _second(case, rng, float(rng.uniform(-3, 1)))


@kind("second-sheet-near", "the same sheet a second time, 5-15 um apart")
def _near(case: Case, rng: np.random.Generator) -> None:
    _second(case, rng, float(rng.uniform(5, 15)))


@kind("second-sheet-part", "a second sheet touching over a third of the field")
def _part(case: Case, rng: np.random.Generator) -> None:
    x = np.arange(case.volume.shape[2])[None, :] + np.zeros((case.volume.shape[1], 1))
    width = case.volume.shape[2]
    _second(case, rng, float(rng.uniform(-3, 1)), x > rng.uniform(0.55, 0.7) * width)


@kind("second-uncoated", "two uncoated sheets pressed together", hidden="no face between them", coated=False)
def _uncoated(case: Case, rng: np.random.Generator) -> None:
    _second(case, rng, float(rng.uniform(-4, -1)))


@kind("fold", "a strip at the edge folded over the sheet")
def _fold(case: Case, rng: np.random.Generator) -> None:
    y, x = case.volume.shape[1:]
    width = int(rng.uniform(0.12, 0.25) * x)
    where = np.zeros((y, x), dtype=bool)
    where[:, x - 2 * width : x - width] = True
    _second(case, rng, float(rng.uniform(-2, 3)), where)
    beyond = case.volume[:, :, x - width :]
    beyond[...] = np.clip(np.rint(_air(case, beyond.shape, rng)), 0, 255).astype(np.uint8)


@kind("overlap", "a scrap of 0.3-0.6 mm lies on the sheet")
def _scrap(case: Case, rng: np.random.Generator) -> None:
    y, x = (np.arange(n) * case.right.voxel_um for n in case.volume.shape[1:])
    at, half = rng.uniform(300, 700, 2), rng.uniform(150, 300, 2)
    where = (np.abs(y - at[0]) < half[0])[:, None] & (np.abs(x - at[1]) < half[1])[None, :]
    _second(case, rng, float(rng.uniform(-2, 2)), where)


def _columnwise(case: Case, source: Array, empty: Mask, rng: np.random.Generator) -> None:
    """Take each voxel from another height of its column; ``empty`` ones become air."""
    z = np.clip(source, 0, case.volume.shape[0] - 1.001)
    low = z.astype(np.intp)
    lower = np.take_along_axis(case.volume, low, axis=0).astype(np.float32)
    upper = np.take_along_axis(case.volume, low + 1, axis=0).astype(np.float32)
    _stored(case, np.where(empty, _air(case, empty.shape, rng), lower + (z - low) * (upper - lower)))


@kind("delamination", "the base split over a patch of 0.25-0.5 mm, 10-30 um open")
def _split(case: Case, rng: np.random.Generator) -> None:
    right = case.right
    y, x = (np.arange(n) * right.voxel_um for n in case.volume.shape[1:])
    at, radius = rng.uniform(350, 700, 2), float(rng.uniform(250, 500))
    open_um = float(rng.uniform(10, 30))
    bump = open_um * np.clip(1.2 - np.hypot((y - at[0])[:, None], (x - at[1])[None, :]) / radius, 0, 1)
    bump = np.minimum(bump, 0.8 * open_um) / right.voxel_um
    _taller(case, int(open_um / right.voxel_um) + 2, rng)
    middle = (right.columns[..., 2] / right.voxel_um)[None]
    z = np.arange(case.volume.shape[0])[:, None, None]
    empty = (z > middle) & (z < middle + bump[None])
    _columnwise(case, np.where(z > middle, z - bump[None], z).astype(float), empty, rng)

    def back(places: Array) -> Array:
        moved = places.copy()
        own = ndimage.map_coordinates(bump, places[:, 1:].T, order=1, mode="nearest")
        base = ndimage.map_coordinates(middle[0], places[:, 1:].T, order=1, mode="nearest")
        moved[:, 0] -= np.where(places[:, 0] > base, np.minimum(own, places[:, 0] - base), 0.0)
        return moved

    case.back.append(back)
    case.note = f"{open_um:.0f} um open"


@kind("tear", "torn: 30-80 um open, one side 10-40 um higher")
def _tear(case: Case, rng: np.random.Generator) -> None:
    right = case.right
    voxel = right.voxel_um
    wide, rise = float(rng.uniform(30, 80)) / voxel, float(rng.uniform(10, 40)) / voxel
    _, rows, cols = case.volume.shape
    edge = rng.uniform(0.35, 0.65) * cols + ndimage.gaussian_filter1d(rng.standard_normal(rows), 6) * 25
    _taller(case, int(rise) + 2, rng)
    z, y, x = np.indices(case.volume.shape, dtype=np.float32)
    beyond = x > edge[None, :, None] + wide
    gap = (x > edge[None, :, None]) & ~beyond
    moved = ndimage.map_coordinates(
        case.volume.astype(np.float32),
        [np.where(beyond, z - rise, z), y, np.where(beyond, x - wide, x)], order=1, mode="nearest",
    )  # fmt: skip
    _stored(case, np.where(gap, _air(case, gap.shape, rng), moved))

    def back(places: Array) -> Array:
        done = places.copy()
        past = places[:, 2] > np.interp(places[:, 1], np.arange(rows), edge) + 0.5 * wide
        done[past] -= [rise, 0.0, wide]
        return done

    case.back.append(back)
    case.note = f"{wide * voxel:.0f} um open, {rise * voxel:.0f} um higher"


def _stuck(case: Case, count: int, length_um: float, rng: np.random.Generator) -> None:
    """Bright blobs or hairs on the top face, as dense as the coating."""
    right = case.right
    n, rows, cols = case.volume.shape
    grey = case.volume.astype(np.float32)
    z = np.arange(n)[:, None, None] * right.voxel_um
    for _ in range(count):
        i, j = int(rng.integers(5, rows - 5)), int(rng.integers(5, cols - 5))
        radius = float(rng.uniform(9, 22)) if not length_um else float(rng.uniform(5, 9))
        around, length = float(rng.uniform(0, np.pi)), length_um * rng.uniform(0.5, 1.5)
        reach = int((radius + 0.5 * length) / right.voxel_um) + 2
        box = (slice(max(i - reach, 0), i + reach), slice(max(j - reach, 0), j + reach))
        y, x = (np.arange(n)[s] * right.voxel_um for n, s in zip((rows, cols), box, strict=True))
        dy, dx = (y - i * right.voxel_um)[:, None], (x - j * right.voxel_um)[None, :]
        along = np.clip(dx * np.cos(around) + dy * np.sin(around), -0.5 * length, 0.5 * length)
        flat = np.hypot(dx - along * np.cos(around), dy - along * np.sin(around))
        middle = right.faces[0][box] + 0.7 * radius
        inside = np.clip((radius - np.hypot(flat[None], z - middle[None])) / right.voxel_um + 0.5, 0, 1)
        part = grey[:, *box]
        part[...] = np.maximum(part, part + inside * (right.grey[2] - part))
    _stored(case, grey)


@kind("dust", "30-80 grains of 20-40 um a mm2 stick to the coating")
def _dust(case: Case, rng: np.random.Generator) -> None:
    area = np.prod(case.right.volume.shape[1:]) * case.right.voxel_um**2 * 1e-6
    count = int(rng.uniform(30, 80) * area)
    _stuck(case, count, 0.0, rng)
    case.note = f"{count} grains"


@kind("hairs", "4-10 hairs of 0.2-0.6 mm on the coating")
def _hairs(case: Case, rng: np.random.Generator) -> None:
    count = int(rng.integers(4, 11))
    _stuck(case, count, 400.0, rng)
    case.note = f"{count} hairs"


def _plug(case: Case, rng: np.random.Generator, share: float, low: bool) -> None:
    """Fill a share of the holes with base, the lower half or all of it."""
    right = case.right
    z = np.arange(case.volume.shape[0])[:, None, None] * right.voxel_um
    bottom, top = right.faces[3], right.faces[1]
    middle = right.columns[..., 2]
    inside = (z > bottom[None]) & (z < (middle if low else top)[None])
    grey = right.grey[1] + right.noise * rng.standard_normal(case.volume.shape)
    holes = [at for at in right.holes if rng.random() < share]
    for at in holes:
        near = np.hypot(right.columns[..., 0] - at[0], right.columns[..., 1] - at[1]) < 1.05 * right.radius_um
        case.volume = np.where(inside & near[None], np.clip(np.rint(grey), 0, 255).astype(np.uint8), case.volume)
    case.note = f"{len(holes)} of {len(right.holes)}"


@kind("half-cut", "all holes cut through the upper half of the sheet only")
def _half(case: Case, rng: np.random.Generator) -> None:
    _plug(case, rng, 1.0, low=True)


@kind("closed-holes", "half of the holes closed by fibres in the scan")
def _closed(case: Case, rng: np.random.Generator) -> None:
    _plug(case, rng, 0.5, low=False)


def _bulge(case: Case, rng: np.random.Generator) -> None:
    right = case.right
    y, x = (np.arange(n) * right.voxel_um for n in case.volume.shape[1:])
    at = rng.uniform(400, 700, 2)
    size = float(rng.uniform(15, 40)) / right.voxel_um
    bump = size * np.exp(-0.5 * ((y - at[0])[:, None] ** 2 + (x - at[1])[None, :] ** 2) / 150.0**2)
    _taller(case, int(size) + 2, rng)
    z = np.arange(case.volume.shape[0])[:, None, None]
    _columnwise(case, z - bump[None], np.zeros(case.volume.shape, dtype=bool), rng)

    def back(places: Array) -> Array:
        moved = places.copy()
        moved[:, 0] -= ndimage.map_coordinates(bump, places[:, 1:].T, order=1, mode="nearest")
        return moved

    case.back.append(back)


@kind("uncoated-wrong-specimen", "uncoated, an image of another specimen of the same program", coated=False, large=True,
      answer="side and specimen")  # fmt: skip
def _uncoated_other(case: Case, _: np.random.Generator) -> None:
    own = case.right
    other = drawn(Draw(maker=own.maker, seed=own.seed + 1000, large=True, coated=False, program=own.seed, slope=0.2))
    case.image, case.shown, case.pixel_um = other.image, other, (other.pixel_um,) * 2
    case.by_nature = ("position", "correlation")


@kind("uncoated-spacing-z", "uncoated, spacing along z half or 50 % too large, bent", coated=False, slope=0.4,
      answer="scale through the sheet")  # fmt: skip
def _uncoated_spacing(case: Case, rng: np.random.Generator) -> None:
    z, y, x = case.voxel_um
    case.voxel_um = (z * float(rng.choice([0.5, 1.5])), y, x)


def _binned(case: Case, axes: tuple[int, ...], factor: int) -> None:
    volume = case.volume.astype(np.float32)
    for axis in axes:
        n = volume.shape[axis] // factor * factor
        parts = np.moveaxis(volume, axis, 0)[:n].reshape(-1, factor, *np.delete(volume.shape, axis)).mean(axis=1)
        volume = np.moveaxis(parts, 0, axis)
    _stored(case, volume)
    case.voxel_um = tuple(v * (factor if k in axes else 1) for k, v in enumerate(case.voxel_um))  # type: ignore[assignment]
    scale = np.array([factor if k in axes else 1 for k in range(3)])
    case.back.append(lambda places: places * scale + 0.5 * (scale - 1))


@kind("few-voxels", "two to four voxels through the sheet")
def _few(case: Case, rng: np.random.Generator) -> None:
    thick = float(np.median(case.right.faces[0] - case.right.faces[3])) / case.right.voxel_um
    want = int(rng.integers(2, 5))
    factor = max(2, round(thick / want))
    _binned(case, (0,), factor)
    case.note = f"{thick / factor:.1f} voxels"


# --- marks by hand and options ------------------------------------------------------------------------------------


def _by_hand(case: Case, rng: np.random.Generator, sd_um: float = 2.0) -> Array:
    right = case.right
    volume = right.points(right.holes)
    image = right.image_of(right.holes)
    rows, cols = right.volume.shape[1:]
    inside = np.all((volume[:, :2] > 20) & (volume[:, :2] < right.voxel_um * np.array([cols, rows]) - 20), axis=1)
    pairs = np.concatenate([volume, image], axis=1)[inside]
    pairs[:, 3:] += rng.normal(0, sd_um, (len(pairs), 2))
    pairs[:, :2] += rng.normal(0, sd_um, (len(pairs), 2))
    case.pairs = pairs
    return pairs


@kind("marks-one-off", "marks by hand, one of them 40-120 um off")
def _one_off(case: Case, rng: np.random.Generator) -> None:
    pairs = _by_hand(case, rng)
    away, around = float(rng.uniform(40, 120)), rng.uniform(0, 2 * np.pi)
    pairs[int(rng.integers(len(pairs))), 3:] += away * np.array([np.cos(around), np.sin(around)])
    case.note = f"{away:.0f} um of {len(pairs)}"


@kind("marks-exchanged", "marks by hand, two of them exchanged")
def _exchanged(case: Case, rng: np.random.Generator) -> None:
    pairs = _by_hand(case, rng)
    a, b = rng.choice(len(pairs), 2, replace=False)
    pairs[[a, b], 3:] = pairs[[b, a], 3:]


@kind("marks-in-pixels", "marks by hand, the image's in pixels instead of um")
def _in_pixels(case: Case, rng: np.random.Generator) -> None:
    pairs = _by_hand(case, rng)
    pairs[:, 3:] /= case.right.pixel_um


def _both_in_pixels(case: Case, rng: np.random.Generator) -> None:
    pairs = _by_hand(case, rng)
    pairs[:, 3:] /= case.right.pixel_um
    pairs[:, :3] /= case.right.voxel_um


@kind(
    "marks-shifted", "marks by hand, all of the image 1.5-4 pixels off by another origin", hidden="no mark can see it"
)
def _shifted(case: Case, rng: np.random.Generator) -> None:
    pairs = _by_hand(case, rng, 0.5)
    shift = float(rng.uniform(1.5, 4)) * case.right.pixel_um
    pairs[:, 3:] += shift
    case.note = f"{1.41 * shift:.0f} um"


@kind("marks-sloppy", "marks by hand, each 10-25 um off")
def _sloppy(case: Case, rng: np.random.Generator) -> None:
    size = float(rng.uniform(10, 25))
    _by_hand(case, rng, size)
    case.note = f"{size:.0f} um"


def _corner(case: Case, rng: np.random.Generator) -> None:
    pairs = _by_hand(case, rng)
    first = pairs[int(rng.integers(len(pairs)))]
    near = np.argsort(np.hypot(*(pairs[:, :2] - first[:2]).T))[:4]
    case.pairs = pairs[near]


@kind("marks-mirrored", "marks by hand in an image that was mirrored afterwards", large=True)
def _marks_mirrored(case: Case, rng: np.random.Generator) -> None:
    _by_hand(case, rng)
    mirror_image(case)
    case.image_back.clear()  # what a pixel shows was not what was marked
    n = case.image.shape[1]
    case.image_back.append(lambda at: np.stack([at[:, 0], n - 1 - at[:, 1]], axis=1))


@kind("cutoff-short", "--cutoff-um 120-300")
def _short(case: Case, rng: np.random.Generator) -> None:
    cutoff = float(rng.choice([120.0, 150.0, 250.0, 280.0, 300.0]))
    case.option("surface", cutoff_um=cutoff)
    case.note = f"{cutoff:g} um"


@kind("cutoff-long", "--cutoff-um 1500-4000 on a bent sheet", steep=True)
def _long(case: Case, rng: np.random.Generator) -> None:
    cutoff = float(rng.choice([1500.0, 2500.0, 4000.0]))
    case.option("surface", cutoff_um=cutoff)
    case.note = f"{cutoff:g} um"


@kind("rigid-on-stretched", "--model rigid, pixel size of the image wrong by 1.5 %")
def _rigid(case: Case, rng: np.random.Generator) -> None:
    factor = float(rng.choice([0.985, 1.015]))
    case.pixel_um = (case.pixel_um[0] * factor, case.pixel_um[1] * factor)
    case.option("registration", model="rigid")
