"""Sizes, hands, sides and places: spacing, pixel size, mirrored stacks, drift, stitched scans, other specimens."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks.wrong.case import Case
from benchmarks.wrong.kinds import Change, enter, kind
from benchmarks.wrong.specimens import Draw, drawn

Array = NDArray[np.float64]
ALL = ("position", "correlation")
_SCALE = "scale through the sheet"


def spacing(axis: int, factors: tuple[float, ...]) -> Change:
    """The voxel's size along one axis stated wrongly."""

    def change(case: Case, rng: np.random.Generator) -> None:
        factor = float(rng.choice(factors))
        size = list(case.voxel_um)
        size[axis] *= factor
        case.voxel_um = (size[0], size[1], size[2])
        case.note = f"times {factor:g}"

    return change


def _all_axes(case: Case, rng: np.random.Generator) -> None:
    factor = float(rng.choice([0.9, 1.1, 0.5, 2.0]))
    z, y, x = (factor * v for v in case.voxel_um)
    case.voxel_um = (z, y, x)
    case.note = f"times {factor:g}"


def pixel(factors: tuple[float, ...], *, both: bool = True) -> Change:
    """The image's pixel size stated wrongly, along both axes or one."""

    def change(case: Case, rng: np.random.Generator) -> None:
        factor = float(rng.choice(factors))
        y, x = case.pixel_um
        case.pixel_um = (y * factor if both else y, x * factor)
        case.note = f"times {factor:g}"

    return change


def flipped(case: Case, axis: int) -> None:
    """Turn the volume round along an axis."""
    n = case.volume.shape[axis]
    case.volume = np.flip(case.volume, axis)

    def back(places: Array) -> Array:
        moved = places.copy()
        moved[:, axis] = n - 1 - moved[:, axis]
        return moved

    case.back.append(back)


def mirror_image(case: Case) -> None:
    """Turn the image round, left to right."""
    n = case.image.shape[1]
    case.image = case.image[:, ::-1]
    case.image_back.append(lambda at: np.stack([at[:, 0], n - 1 - at[:, 1]], axis=1))


def bottom_image(case: Case) -> None:
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
    mirror_image(case)


@kind("hand", "slices numbered against the usual sense: top and bottom exchanged", grave=True, large=True)
def _hand(case: Case, _: np.random.Generator) -> None:
    flipped(case, 0)


@kind("turned-mirror", "the sheet upside down in the scanner, given --mirror: sides exchanged", grave=True, large=True)
def _turned(case: Case, _: np.random.Generator) -> None:
    flipped(case, 0)
    flipped(case, 1)
    case.option("registration", mirror=True)


@kind("top-low", "--top low where the top lies at the high end, image of the top")
def _top_low(case: Case, _: np.random.Generator) -> None:
    case.option("volume", top="low")


@kind("top-low-mirror", "--top low and --mirror where neither is so", grave=True, large=True)
def _top_low_mirror(case: Case, _: np.random.Generator) -> None:
    case.option("volume", top="low")
    case.option("registration", mirror=True)


@kind("bottom-as-top", "an image of the bottom, given as the top")
def _bottom(case: Case, _: np.random.Generator) -> None:
    bottom_image(case)


@kind("bottom-mirror", "an image of the bottom, given as the top with --mirror", grave=True, large=True)
def _bottom_mirror(case: Case, _: np.random.Generator) -> None:
    bottom_image(case)
    case.option("registration", mirror=True)


@kind("top-as-bottom-mirror", "an image of the top, given as the bottom with --mirror", grave=True, large=True)
def _top_as_bottom(case: Case, _: np.random.Generator) -> None:
    case.option("image", side="bottom")
    case.option("registration", mirror=True)


@kind("bottom-flipped", "an image of the bottom, turned back by software, given as the top", grave=True, large=True)
def _bottom_flipped(case: Case, _: np.random.Generator) -> None:
    bottom_image(case)
    mirror_image(case)


@kind("image-mirrored", "the image is mirrored")
def _image_mirrored(case: Case, _: np.random.Generator) -> None:
    mirror_image(case)


def _image_mirror_given(case: Case, _: np.random.Generator) -> None:
    mirror_image(case)
    case.option("registration", mirror=True)


@kind("other-specimen", "an image of another specimen with the same laser program", grave=True, large=True)
def _other(case: Case, _: np.random.Generator) -> None:
    own = case.right
    other = drawn(Draw(maker=own.maker, seed=own.seed + 1000, large=True, program=own.seed, slope=0.2))
    case.image, case.shown, case.pixel_um = other.image, other, (other.pixel_um,) * 2
    case.by_nature = ALL
    case.note = "image of another"


@kind("two-images", "two images of different specimens with the same laser program", large=True)
def _two_images(case: Case, rng: np.random.Generator) -> None:
    _other(case, rng)
    case.first = case.right.image


def moved_slices(case: Case, shift: Array, along: int, axis: int) -> None:
    """Shift each slice along ``axis`` by some voxels ``along`` another axis."""
    volume = np.moveaxis(case.volume, (axis, along), (0, 1))
    out = np.empty_like(volume)
    for k, s in enumerate(shift):
        moved = ndimage.shift(volume[k].astype(np.float32), (s, 0), order=1, mode="nearest")
        out[k] = np.rint(moved).astype(volume.dtype) if volume.dtype.kind == "u" else moved
    case.volume = np.ascontiguousarray(np.moveaxis(out, (0, 1), (axis, along)))

    def back(places: Array) -> Array:
        done = places.copy()
        done[:, along] -= np.interp(places[:, axis], np.arange(shift.size), shift)
        return done

    case.back.append(back)


@kind("drift-lateral", "lateral drift that grows over the slices along y, 2-8 voxels")
def _drift(case: Case, rng: np.random.Generator) -> None:
    n, size = case.volume.shape[1], float(rng.uniform(2, 8))
    moved_slices(case, size * np.linspace(0, 1, n) ** 2, 2, 1)
    case.note = f"{size:.1f} voxels"


@kind("drift-height", "drift through the sheet over the slices along y, 3-12 voxels, curved")
def _drift_height(case: Case, rng: np.random.Generator) -> None:
    n, size = case.volume.shape[1], float(rng.uniform(3, 12))
    moved_slices(case, size * np.linspace(-1, 1, n) ** 3, 0, 1)
    case.note = f"{size:.1f} voxels"


@kind("drift-z", "lateral drift over the slices along z, 3-10 voxels through the stack")
def _drift_z(case: Case, rng: np.random.Generator) -> None:
    n, size = case.volume.shape[0], float(rng.uniform(3, 10))
    moved_slices(case, size * np.linspace(-0.5, 0.5, n), 2, 0)
    case.note = f"{size:.1f} voxels"


@kind("jitter", "every slice along y shifted at random, 1-3 voxels")
def _jitter(case: Case, rng: np.random.Generator) -> None:
    size = float(rng.uniform(1, 3))
    moved_slices(case, size * rng.standard_normal(case.volume.shape[1]), int(rng.choice([0, 2])), 1)
    case.note = f"{size:.1f} voxels"


def stitched(along: int) -> Change:
    """Two scans put together with a step."""

    def change(case: Case, rng: np.random.Generator) -> None:
        n = case.volume.shape[1]
        size = float(rng.choice([-1, 1]) * rng.uniform(1.5, 6))
        moved_slices(case, np.where(np.arange(n) < n * rng.uniform(0.35, 0.65), 0.0, size), along, 1)
        case.note = f"{size:.1f} voxels"

    return change


enter("stitched-lateral", "two scans stitched with a step across the seam's direction", stitched(2))
enter("stitched-height", "two scans stitched with a step through the sheet", stitched(0))


def _overlap(case: Case, rng: np.random.Generator) -> None:
    from benchmarks.wrong.slices import reorder

    n, count = case.volume.shape[1], int(rng.integers(4, 13))
    at = int(rng.uniform(0.35, 0.65) * n)
    reorder(case, np.concatenate([np.arange(at + count), np.arange(at, n)]), 1)
    case.note = f"{count} slices"


@kind("tilted", "stage tilted by 6-14 degrees", slope=0.12)
def _tilted(case: Case, rng: np.random.Generator) -> None:
    angle = float(rng.uniform(6, 14))
    n, m = case.volume.shape[0], case.volume.shape[2]
    rise = int(np.tan(np.deg2rad(angle)) * m) + 4
    air = case.right.grey[0] + case.right.noise * rng.standard_normal((n + rise, *case.volume.shape[1:]))
    tall = np.clip(np.rint(air), 0, 255).astype(np.uint8)
    tall[rise // 2 : rise // 2 + n] = case.volume
    cval = case.right.grey[0]
    turned = ndimage.rotate(tall.astype(np.float32), angle, axes=(0, 2), reshape=False, order=1, cval=cval)
    case.volume = np.clip(np.rint(turned), 0, 255).astype(np.uint8)
    c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    middle = 0.5 * (np.array(tall.shape) - 1)

    def back(places: Array) -> Array:
        off = places - middle
        moved = places.copy()
        moved[:, 0] = middle[0] + c * off[:, 0] + s * off[:, 2] - rise // 2
        moved[:, 2] = middle[2] - s * off[:, 0] + c * off[:, 2]
        return moved

    case.back.append(back)
    case.note = f"{angle:.0f} deg of {n} slices"


@kind("sheared", "the stack is sheared: each slice along z shifted as the stage leans, 10-25 degrees")
def _sheared(case: Case, rng: np.random.Generator) -> None:
    angle = float(rng.uniform(10, 25))
    n = case.volume.shape[0]
    moved_slices(case, np.tan(np.deg2rad(angle)) * (np.arange(n) - 0.5 * n), 1, 0)
    case.note = f"{angle:.0f} deg"


def _in_plane(factors: tuple[float, ...]) -> Change:
    def change(case: Case, rng: np.random.Generator) -> None:
        axis = int(rng.integers(1, 3))
        spacing(axis, factors)(case, rng)
        case.note += f" along {'zyx'[axis]}"

    return change


enter(
    "spacing-z-10",
    "spacing along z wrong by 10 %, flat",
    spacing(0, (0.9, 1.1)),
    hidden="needs 26 degrees",
    answer=_SCALE,
)
enter("spacing-z-50", "spacing along z half or 50 % too large", spacing(0, (0.5, 1.5)), grave=True, answer=_SCALE)
enter("spacing-xy-10", "spacing along y or x wrong by 10 %", _in_plane((0.9, 1.1)))
enter("spacing-xy-50", "spacing along y or x half or 50 % too large", _in_plane((0.5, 1.5)))
enter("spacing-z-10-steep", "spacing along z wrong by 10 %, 30-45 deg", spacing(0, (0.9, 1.1)), steep=True, large=True)
enter("spacing-z-50-steep", "spacing along z half or 50 % too large, 30-45 deg", spacing(0, (0.5, 1.5)), grave=True,
      steep=True)  # fmt: skip
enter("spacing-all", "voxel size wrong along all axes", _all_axes)
enter("pixel-2", "pixel size of the image wrong by 2 %", pixel((0.98, 1.02)))
enter("pixel-10", "pixel size of the image wrong by 10 % or 50 %", pixel((0.9, 1.1, 1.5)))


@kind("in-mm", "sizes of the volume in mm, read as um")
def _in_mm(case: Case, _: np.random.Generator) -> None:
    z, y, x = (1e-3 * v for v in case.voxel_um)
    case.voxel_um = (z, y, x)


@kind("cropped-z", "the sheet leaves the volume at its top or bottom")
def _cropped(case: Case, rng: np.random.Generator) -> None:
    top = rng.random() < 0.5
    heights = case.right.faces[0 if top else 3] / case.right.voxel_um
    at = int(np.percentile(heights, rng.uniform(75, 95) if top else rng.uniform(5, 25)))
    case.volume = case.volume[:at] if top else case.volume[at:]
    if not top:
        case.back.append(lambda places: places + np.array([at, 0, 0]))
    case.note = "top" if top else "bottom"


def _padded(case: Case, rng: np.random.Generator) -> None:
    pads = rng.integers(3, 20, (3, 2))
    case.volume = np.pad(case.volume, pads)
    case.back.append(lambda places: places - pads[:, 0])
