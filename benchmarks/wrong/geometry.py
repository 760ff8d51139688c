"""Sizes, hands, sides and places: spacing, pixel size, mirrored stacks, drift, stitched scans, other specimens."""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy import ndimage

from benchmarks.wrong.case import Array, Case
from benchmarks.wrong.kinds import Change, Rng, along_either, both, enter, kind, told
from benchmarks.wrong.specimens import Draw, drawn

MIRROR = told("registration", mirror=True)
_GRAVE = {"grave": True, "large": True}
_SCALE = "scale through the sheet"


def spacing(factors: tuple[float, ...], *axes: int) -> Change:
    """The voxel's size along some axes stated wrongly."""

    def change(case, rng):
        factor = float(rng.choice(factors))
        case.voxel_um = tuple(factor * v if k in axes else v for k, v in enumerate(case.voxel_um))
        case.note = f"times {factor:g}"

    return change


def pixel(*factors: float) -> Change:
    """The image's pixel size stated wrongly."""

    def change(case, rng):
        factor = float(rng.choice(factors))
        case.pixel_um = tuple(v * factor for v in case.pixel_um)
        case.note = f"times {factor:g}"

    return change


def flipped(axis: int) -> Change:
    """The volume turned round along an axis."""

    def change(case, _):
        n = case.volume.shape[axis]
        case.volume = np.flip(case.volume, axis)

        def back(places):
            moved = places.copy()
            moved[:, axis] = n - 1 - moved[:, axis]
            return moved

        case.back.append(back)

    return change


def mirror_image(case: Case, _: Rng) -> None:
    """Turn the image round, left to right."""
    n = case.image.shape[1]
    case.image = case.image[:, ::-1]
    case.image_back.append(lambda at: np.stack([at[:, 0], n - 1 - at[:, 1]], axis=1))


def bottom_image(case: Case, rng: Rng) -> None:
    """An image of the other side: mirrored, and as bright as the bottom coating makes it."""
    right = case.right
    u, v = right.uv[..., 0], right.uv[..., 1]
    top, bottom = (right.thickness(f"coating_{side}", u, v) for side in ("top", "bottom"))
    # What the top coating did is taken off by regression, and the same of the bottom one put on.
    known = case.image > 0.6 * np.median(case.image)
    gain = np.polyfit(top[known], case.image[known], 1)[0]
    image = case.image + np.where(known, gain * ((bottom - bottom.mean()) - (top - top.mean())), 0.0)
    case.image = np.clip(image, 0, 1)
    case.side = "bottom"
    mirror_image(case, rng)


def image_of_another(case: Case, _: Rng, *, coated: bool = True) -> None:
    """An image of another specimen that was burnt by the same program."""
    own = case.right
    other = drawn(Draw(maker=own.maker, seed=own.seed + 1000, large=True, coated=coated, program=own.seed, slope=0.2))
    case.image, case.shown, case.pixel_um = other.image, other, (other.pixel_um,) * 2
    case.by_nature = ("position", "correlation")
    case.note = "image of another"


def two_images(case: Case, rng: Rng) -> None:
    """An image of the specimen itself in place of its volume, and one of another specimen."""
    case.first = case.right.image
    image_of_another(case, rng)


enter("hand", "slices numbered against the usual sense: top and bottom exchanged", flipped(0), **_GRAVE)
enter(
    "turned-mirror", "the sheet upside down in the scanner, given --mirror: sides exchanged",
    both(flipped(0), flipped(1), MIRROR), **_GRAVE,
)  # fmt: skip
enter("top-low", "--top low where the top lies at the high end, image of the top", told("volume", top="low"))
enter("top-low-mirror", "--top low and --mirror where neither is so", both(told("volume", top="low"), MIRROR), **_GRAVE)
enter("bottom-as-top", "an image of the bottom, given as the top", bottom_image)
enter("bottom-mirror", "an image of the bottom, given as the top with --mirror", both(bottom_image, MIRROR), **_GRAVE)
enter(
    "top-as-bottom-mirror", "an image of the top, given as the bottom with --mirror",
    both(told("image", side="bottom"), MIRROR), **_GRAVE,
)  # fmt: skip
enter(
    "bottom-flipped", "an image of the bottom, turned back by software, given as the top",
    both(bottom_image, mirror_image), **_GRAVE,
)  # fmt: skip
enter("image-mirrored", "the image is mirrored", mirror_image)
enter("other-specimen", "an image of another specimen with the same laser program", image_of_another, **_GRAVE)
enter("two-images", "two images of different specimens with the same laser program", two_images, large=True)


def moved_slices(case: Case, shift: Array, along: int, axis: int) -> None:
    """Shift each slice along ``axis`` by some voxels ``along`` another axis."""
    volume = np.moveaxis(case.volume, (axis, along), (0, 1))
    out = np.empty_like(volume)
    for k, s in enumerate(shift):
        moved = ndimage.shift(volume[k].astype(np.float32), (s, 0), order=1, mode="nearest")
        out[k] = np.rint(moved).astype(volume.dtype) if volume.dtype.kind == "u" else moved
    case.volume = np.ascontiguousarray(np.moveaxis(out, (0, 1), (axis, along)))

    def back(places):
        done = places.copy()
        done[:, along] -= np.interp(places[:, axis], np.arange(shift.size), shift)
        return done

    case.back.append(back)


@kind("drift-lateral", "lateral drift that grows over the slices along y, 2-8 voxels", size=(2, 8, "voxels"))
def _drift(case, _, size):
    moved_slices(case, size * np.linspace(0, 1, case.volume.shape[1]) ** 2, 2, 1)


@kind(
    "drift-height", "drift through the sheet over the slices along y, 3-12 voxels, curved", size=(3, 12, "voxels")
)  # fmt: skip
def _drift_height(case, _, size):
    moved_slices(case, size * np.linspace(-1, 1, case.volume.shape[1]) ** 3, 0, 1)


@kind("drift-z", "lateral drift over the slices along z, 3-10 voxels through the stack", size=(3, 10, "voxels"))
def _drift_z(case, _, size):
    moved_slices(case, size * np.linspace(-0.5, 0.5, case.volume.shape[0]), 2, 0)


@kind("jitter", "every slice along y shifted at random, 1-3 voxels", size=(1, 3, "voxels"))
def _jitter(case, rng, size):
    shift = size * rng.standard_normal(case.volume.shape[1])
    moved_slices(case, shift, int(rng.choice([0, 2])), 1)


def stitched(case: Case, rng: Rng, along: int) -> None:
    """Two scans put together with a step."""
    n = case.volume.shape[1]
    size = float(rng.choice([-1, 1]) * rng.uniform(1.5, 6))
    moved_slices(case, np.where(np.arange(n) < n * rng.uniform(0.35, 0.65), 0.0, size), along, 1)
    case.note = f"{size:.1f} voxels"


for _name, _words, _along in (("lateral", "across the seam's direction", 2), ("height", "through the sheet", 0)):
    enter(f"stitched-{_name}", f"two scans stitched with a step {_words}", partial(stitched, along=_along))


@kind("tilted", "stage tilted by 6-14 degrees", size=(6, 14, "deg"), slope=0.12)
def _tilted(case, rng, angle):
    n, m = case.volume.shape[0], case.volume.shape[2]
    rise = int(np.tan(np.deg2rad(angle)) * m) + 4
    tall = case.air((n + rise, *case.volume.shape[1:]), rng)
    tall[rise // 2 : rise // 2 + n] = case.volume
    case.store(
        ndimage.rotate(tall.astype(np.float32), angle, axes=(0, 2), reshape=False, order=1, cval=case.right.grey[0])
    )
    c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    middle = 0.5 * (np.array(tall.shape) - 1)

    def back(places):
        off = places - middle
        moved = places.copy()
        moved[:, 0] = middle[0] + c * off[:, 0] + s * off[:, 2] - rise // 2
        moved[:, 2] = middle[2] - s * off[:, 0] + c * off[:, 2]
        return moved

    case.back.append(back)


@kind(
    "sheared", "the stack is sheared: each slice along z shifted as the stage leans, 10-25 degrees",
    size=(10, 25, "deg"),
)  # fmt: skip
def _sheared(case, _, angle):
    n = case.volume.shape[0]
    moved_slices(case, np.tan(np.deg2rad(angle)) * (np.arange(n) - 0.5 * n), 1, 0)


def in_plane(*factors: float) -> Change:
    """The spacing along y or x stated wrongly."""
    return along_either(lambda case, rng, axis: spacing(factors, axis)(case, rng))


_TENTH, HALF = (0.9, 1.1), (0.5, 1.5)
enter(
    "spacing-z-10", "spacing along z wrong by 10 %, flat", spacing(_TENTH, 0), hidden="needs 26 degrees", answer=_SCALE
)
enter("spacing-z-50", "spacing along z half or 50 % too large", spacing(HALF, 0), grave=True, answer=_SCALE)
enter("spacing-xy-10", "spacing along y or x wrong by 10 %", in_plane(*_TENTH))
enter("spacing-xy-50", "spacing along y or x half or 50 % too large", in_plane(*HALF))
enter("spacing-z-10-steep", "spacing along z wrong by 10 %, 30-45 deg", spacing(_TENTH, 0), steep=True, large=True)
enter(
    "spacing-z-50-steep", "spacing along z half or 50 % too large, 30-45 deg", spacing(HALF, 0), grave=True, steep=True
)
enter("spacing-all", "voxel size wrong along all axes", spacing((0.9, 1.1, 0.5, 2.0), 0, 1, 2))
enter("pixel-2", "pixel size of the image wrong by 2 %", pixel(0.98, 1.02))
enter("pixel-10", "pixel size of the image wrong by 10 % or 50 %", pixel(0.9, 1.1, 1.5))
enter("in-mm", "sizes of the volume in mm, read as um", spacing((1e-3,), 0, 1, 2))


@kind("cropped-z", "the sheet leaves the volume at its top or bottom")
def _cropped(case, rng):
    top = rng.random() < 0.5
    heights = case.right.faces[0 if top else 3] / case.right.voxel_um
    at = int(np.percentile(heights, rng.uniform(75, 95) if top else rng.uniform(5, 25)))
    case.volume = case.volume[:at] if top else case.volume[at:]
    if not top:
        case.back.append(lambda places: places + np.array([at, 0, 0]))
    case.note = "top" if top else "bottom"
