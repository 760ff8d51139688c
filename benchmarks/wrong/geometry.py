"""Sizes, hands, sides and places: spacing, pixel size, mirrored stacks, drift, stitched scans,
other specimens."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from benchmarks.wrong.kinds import along_either, both, enter, kind, told
from benchmarks.wrong.specimens import Draw, drawn

MIRROR = told("registration", mirror=True)
_GRAVE = {"grave": True, "large": True}
_SCALE = "scale through the sheet"


def spacing(factors, *axes):
    """The voxel's size along some axes stated wrongly."""

    def change(case, rng):
        factor = float(rng.choice(factors))
        case.voxel_um = tuple(factor * v if k in axes else v for k, v in enumerate(case.voxel_um))
        case.note = f"times {factor:g}"

    return change


def pixel(*factors):
    """The image's pixel size stated wrongly."""

    def change(case, rng):
        factor = float(rng.choice(factors))
        case.pixel_um = tuple(v * factor for v in case.pixel_um)
        case.note = f"times {factor:g}"

    return change


def flipped(axis):
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


def mirror_image(case, _):
    """Turn the image round, left to right."""
    n = case.image.shape[1]
    case.image = case.image[:, ::-1]
    case.image_back.append(lambda at: np.stack([at[:, 0], n - 1 - at[:, 1]], axis=1))


def bottom_image(case, rng):
    """An image of the other side: mirrored, and as bright as the bottom coating makes it."""
    right = case.right
    u, v = right.uv[..., 0], right.uv[..., 1]
    top, bottom = (right.thickness(f"coating_{side}", u, v) for side in ("top", "bottom"))
    # What the top coating did is taken off by regression, and the same of the bottom one put on.
    known = case.image > 0.6 * np.median(case.image)
    gain = np.polyfit(top[known], case.image[known], 1)[0]
    image = case.image + np.where(
        known, gain * ((bottom - bottom.mean()) - (top - top.mean())), 0.0
    )
    case.image = np.clip(image, 0, 1)
    case.side = "bottom"
    mirror_image(case, rng)


def image_of_another(case, _, *, coated=True):
    """An image of another specimen that was burnt by the same program."""
    own = case.right
    other = drawn(
        Draw(
            maker=own.maker,
            seed=own.seed + 1000,
            large=True,
            coated=coated,
            program=own.seed,
            slope=0.2,
        )
    )
    case.image, case.shown, case.pixel_um = other.image, other, (other.pixel_um,) * 2
    case.by_nature = ("position", "correlation")
    case.note = "image of another"


enter(
    "hand",
    "slices numbered against the usual sense: top and bottom exchanged",
    flipped(0),
    **_GRAVE,
)
enter(
    "top-low-mirror",
    "--top low and --mirror where neither is so",
    both(told("volume", top="low"), MIRROR),
    **_GRAVE,
)
enter("bottom-as-top", "an image of the bottom, given as the top", bottom_image)
enter(
    "bottom-flipped",
    "an image of the bottom, turned back by software, given as the top",
    both(bottom_image, mirror_image),
    **_GRAVE,
)
enter("image-mirrored", "the image is mirrored", mirror_image)
enter(
    "other-specimen",
    "an image of another specimen with the same laser program",
    image_of_another,
    **_GRAVE,
)


def moved_slices(case, shift, along, axis):
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


@kind(
    "drift-lateral",
    "lateral drift that grows over the slices along y, 2-8 voxels",
    size=(2, 8, "voxels"),
)
def _drift(case, _, size):
    moved_slices(case, size * np.linspace(0, 1, case.volume.shape[1]) ** 2, 2, 1)


@kind(
    "drift-height",
    "drift through the sheet over the slices along y, 3-12 voxels, curved",
    size=(3, 12, "voxels"),
)
def _drift_height(case, _, size):
    moved_slices(case, size * np.linspace(-1, 1, case.volume.shape[1]) ** 3, 0, 1)


@kind("jitter", "every slice along y shifted at random, 1-3 voxels", size=(1, 3, "voxels"))
def _jitter(case, rng, size):
    shift = size * rng.standard_normal(case.volume.shape[1])
    moved_slices(case, shift, int(rng.choice([0, 2])), 1)


def stitched(case, rng):
    """Two scans put together with a step."""
    n = case.volume.shape[1]
    size = float(rng.choice([-1, 1]) * rng.uniform(1.5, 6))
    moved_slices(case, np.where(np.arange(n) < n * rng.uniform(0.35, 0.65), 0.0, size), 2, 1)
    case.note = f"{size:.1f} voxels"


enter("stitched-lateral", "two scans stitched with a step across the seam's direction", stitched)


@kind(
    "sheared",
    "the stack is sheared: each slice along z shifted as the stage leans, 10-25 degrees",
    size=(10, 25, "deg"),
)
def _sheared(case, _, angle):
    n = case.volume.shape[0]
    moved_slices(case, np.tan(np.deg2rad(angle)) * (np.arange(n) - 0.5 * n), 1, 0)


def in_plane(*factors):
    """The spacing along y or x stated wrongly."""
    return along_either(lambda case, rng, axis: spacing(factors, axis)(case, rng))


_TENTH, HALF = (0.9, 1.1), (0.5, 1.5)
enter(
    "spacing-z-10",
    "spacing along z wrong by 10 %, flat",
    spacing(_TENTH, 0),
    hidden="needs 26 degrees",
    answer=_SCALE,
)
enter(
    "spacing-z-50",
    "spacing along z half or 50 % too large",
    spacing(HALF, 0),
    grave=True,
    answer=_SCALE,
)
enter("spacing-xy-10", "spacing along y or x wrong by 10 %", in_plane(*_TENTH))
enter(
    "spacing-z-10-steep",
    "spacing along z wrong by 10 %, 30-45 deg",
    spacing(_TENTH, 0),
    steep=True,
    large=True,
)
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
