"""Inspection of the values of a volume or an image: their distribution, and what looks wrong."""

import hashlib
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import imagecodecs
import numpy as np
from numpy.typing import NDArray

from planish.core.files import write_whole
from planish.core.memory import EAGER_BYTES, SAMPLE_BYTES, SAMPLE_VALUES
from planish.core.text import first_few
from planish.core.typing import Array, Entries, Ints, Shape2D, Texts
from planish.io.lazy import Values

PERCENTILES = (1, 5, 25, 50, 75, 95, 99)


@dataclass(kw_only=True)
class _Totals:
    """What the values of some planes are."""

    low: float = math.inf
    high: float = -math.inf
    n_values: int = 0
    n_finite: int = 0
    n_bottom: int = 0
    n_saturated: int = 0
    constant_numbers: list[int] = field(default_factory=list)  # of planes
    copy_numbers: list[int] = field(default_factory=list)
    sample: Array = field(default_factory=lambda: np.empty(0))  # finite, sorted

    def add(self, plane: Array, full_scale: int | None) -> bool:
        """Count the values of a plane; True if it has several grey values."""
        finite_values = plane
        if plane.dtype.kind == "f":
            finite_values = plane[np.isfinite(plane)]
        self.n_values += plane.size
        self.n_finite += finite_values.size
        if full_scale is not None:
            self.n_saturated += int(np.count_nonzero(plane == full_scale))
            self.n_bottom += int(np.count_nonzero(plane == 0))
        if not finite_values.size:
            return False
        low = float(finite_values.min())
        high = float(finite_values.max())
        self.low = min(self.low, low)
        self.high = max(self.high, high)
        return low < high


def inspect_values(
    values: Values, full_scale: int | None, warnings: list[str], *, dims: Texts
) -> Entries:
    """Shape, type and distribution of the values; what looks wrong is added to `warnings`.

    ``full_scale``: the largest value that can be stored; None for floating point.
    """
    n_planes = values.shape[0]
    plane_numbers = [*range(n_planes)]
    sampled_text = None
    # Evenly spread ones, where reading all would take long.
    if values.ndim > 2 and values.nbytes > EAGER_BYTES:
        n_sampled = max(8, SAMPLE_BYTES // (values.nbytes // n_planes))
        if n_sampled < n_planes:
            spread = np.linspace(0, n_planes - 1, n_sampled).round()
            plane_numbers = [*map(int, spread)]
            sampled_text = f"{n_sampled} of {n_planes} slices"
    totals = _look(values, plane_numbers, full_scale)
    facts: Entries = declared_facts(values, dims) | {
        "nan_share": 1 - totals.n_finite / totals.n_values,
        "saturated_share": totals.n_saturated / totals.n_values,
        "bottom_share": totals.n_bottom / totals.n_values,
        "sampled": sampled_text,
        "percentiles": dict.fromkeys(map(str, PERCENTILES)),
    }
    if totals.n_finite:
        for p in PERCENTILES:
            value = float(np.percentile(totals.sample, p))
            facts["percentiles"][str(p)] = value
        facts |= {"min": totals.low, "max": totals.high}
    warnings += _what_looks_wrong(totals, facts, full_scale, is_whole=values.dtype.kind in "ui")
    return facts


def _what_looks_wrong(
    totals: _Totals, facts: Entries, full_scale: int | None, *, is_whole: bool
) -> list[str]:
    """Say what looks wrong in values, whole numbers or not, with their shares among the facts."""
    warnings: list[str] = []
    # The sample is sorted: each step in it is another level.
    n_levels = int(np.count_nonzero(np.diff(totals.sample)) + 1)
    if not totals.n_finite:
        warnings.append("There is no number in it, all values are missing.")
    elif totals.low == totals.high:
        warnings.append(f"All values are {totals.low:g}.")
    elif is_whole and n_levels < 16:
        warnings.append(
            f"It has {n_levels} grey levels only. Is it a segmentation? planish needs the grey"
            " values."
        )
    if facts["nan_share"] > 0:
        missing_text = f"{100 * facts['nan_share']:.3g} % of the values are missing"
        warnings.append(f"{missing_text} (NaN or infinite).")
    if totals.low == totals.high:
        return warnings
    # Above this share of values at the end of the range, grey levels were lost.
    if facts["saturated_share"] > 0.001:
        warnings.append(
            f"{100 * facts['saturated_share']:.3g} % of the values are at {full_scale}, the largest"
            " the file can store: grey levels were cut there."
        )
    if totals.constant_numbers:
        warnings.append(
            f"{len(totals.constant_numbers)} slices have one grey value only (black or empty), z"
            f" {first_few(totals.constant_numbers)}: look at them, and leave out what shows no"
            " sheet."
        )
    if totals.copy_numbers:
        warnings.append(
            f"{len(totals.copy_numbers)} slices hold the same values as a slice before them, z"
            f" {first_few(totals.copy_numbers)}: were they copied to fill gaps?"
        )
    return warnings


def _look(values: Values, plane_numbers: list[int], full_scale: int | None) -> _Totals:
    """Read planes one by one, and note what their values are.

    Of an image (y, x) they are its rows.
    """
    share = len(plane_numbers) / values.shape[0]
    n_values = math.prod(values.shape) * share
    # One value in so many along each axis goes into the sample.
    excess = n_values / SAMPLE_VALUES
    stride = max(1, math.ceil(excess ** (1 / values.ndim)))
    totals = _Totals()
    samples = list[Array]()
    digests = set[bytes]()
    for index, number in enumerate(plane_numbers):
        plane = np.asarray(values[number])
        has_greys = totals.add(plane, full_scale)
        if index % stride == 0:
            samples.append(_finite_sample(plane, stride))
        # Slices with fewer pixels may well be alike, or of one grey.
        if plane.ndim == 2 and plane.size >= 1000:
            pixels = np.ascontiguousarray(plane).data
            digest = hashlib.blake2b(pixels, digest_size=16).digest()
            if not has_greys:
                totals.constant_numbers.append(number)
            elif digest in digests:
                totals.copy_numbers.append(number)
            digests.add(digest)
    totals.sample = np.sort(np.concatenate(samples))
    if totals.n_finite and not totals.sample.size:  # the grid met no number
        planes = [_finite_sample(np.asarray(values[number]), 1) for number in plane_numbers]
        totals.sample = np.sort(np.concatenate(planes))
    return totals


def _finite_sample(plane: Array, stride: int) -> Array:
    """Finite values of a plane, one in so many along each axis."""
    sample = plane[(slice(None, None, stride),) * plane.ndim].ravel()
    return sample[np.isfinite(sample)]


def declared_facts(values: Values, dims: Texts) -> Entries:
    """Give the facts without those of the values, which are None."""
    value_keys = ("min", "max", "percentiles", "nan_share", "saturated_share", "bottom_share")
    return {
        "dims": list(dims),
        "shape": list(values.shape),
        "dtype": str(values.dtype),
        **dict.fromkeys(value_keys),
        "sampled": "none",
    }


_SIDE = 480  # pixels along the longer side of a section
_SHADES = " ░▒▓█"
_HIGH_AS_WIDE = 2.1  # height of a letter in widths
Grey = NDArray[np.uint8]


class Section(NamedTuple):
    """A section through the middle.

    The axes down and across it, grey from 0 to 255, and voxels in one of its steps.
    """

    down: str
    across: str
    grey: Grey
    step: Shape2D


def middle_sections(values: Values) -> list[Section]:
    """Middle sections (z, x), (z, y), (y, x) of a volume (z, y, x), of at most 96 slices.

    Or an image (y, x) itself.
    """
    if len(values.shape) == 2:
        return [_section("y", "x", np.asarray(values))]
    depth, rows, cols = values.shape
    stride = -(-depth // 96)
    along_x: list[Array] = []
    along_y: list[Array] = []
    for k in range(0, depth, stride):
        plane = np.asarray(values[k])
        along_x.append(plane[rows // 2].copy())
        along_y.append(plane[:, cols // 2].copy())
    down_x = _section("z", "x", np.stack(along_x), (stride, 1))
    down_y = _section("z", "y", np.stack(along_y), (stride, 1))
    middle_plane = np.asarray(values[depth // 2])
    return [down_x, down_y, _section("y", "x", middle_plane)]


def best_section(sections: list[Section], through: str | None) -> Section:
    """Give the section in which a sheet shows as a line.

    It lies across the sheet's normal, and the one that reads down the normal comes first.

    Parameters
    ----------
    sections : list of Section
        Those of one volume.
    through : str, optional
        Axis of the normal; the first section is given where it is not known.
    """
    reading_down = [section for section in sections if section.down == through]
    reading_across = [section for section in sections if section.across == through]
    return [*reading_down, *reading_across, *sections][0]


def write_picture(sections: list[Section], path: Path) -> None:
    """Write sections side by side as a PNG, all on one scale, with voxels as squares.

    Parameters
    ----------
    sections : list of Section
        Such as those of :func:`middle_sections`.
    path : Path
        File to make.

    Raises
    ------
    FileError
        If the file is there already or cannot be written.
    ResourceError
        If the disk is full.
    """
    sides = [np.multiply(section.grey.shape, section.step) for section in sections]
    scale = _SIDE / int(np.max(sides))
    pictures = [_resized(section, scale) for section in sections]
    max_rows = max(map(len, pictures))
    # White below the lower ones, and 8 pixels of it between them.
    padded: list[Grey] = []
    for grey in pictures:
        margins = ((0, max_rows - len(grey)), (0, 8))
        padded.append(np.pad(grey, margins, constant_values=255))
    row = np.ascontiguousarray(np.hstack(padded)[:, :-8])
    write_whole(path, bytes(imagecodecs.png_encode(row)))


def as_text(section: Section) -> list[str]:
    """A section in shades of letters, at most 72 wide and 18 high; the last line names its axes."""
    rows, cols = np.multiply(section.grey.shape, section.step).tolist()
    scale = min(72 / cols, 18 * _HIGH_AS_WIDE / rows)
    grey = _resized(section, scale, squeeze=_HIGH_AS_WIDE)
    shade_numbers = grey.astype(int) * len(_SHADES) // 256
    lines = ["".join(row) for row in np.array([*_SHADES])[shade_numbers]]
    return [*lines, f"middle of the volume: {section.down} down, {section.across} across"]


def _section(down: str, across: str, plane: Array, step: Shape2D = (1, 1)) -> Section:
    """A section of at most about `_SIDE` steps, from the 1st to the 99th percentile of its grey.

    ``step``: voxels from one row, and one column, of the plane to the next. Rows and columns are
    picked, not averaged. NaN becomes 0; infinite values become the darkest or the lightest grey.
    """
    down_step, across_step = step
    rows, cols = plane.shape
    row_stride = max(1, -(-rows * down_step // _SIDE) // down_step)
    col_stride = max(1, -(-cols * across_step // _SIDE) // across_step)
    plane = plane[::row_stride, ::col_stride].astype(np.float64)
    finite_values = plane[np.isfinite(plane)]
    low, high = (0.0, 1.0)
    if finite_values.size:
        low, high = np.percentile(finite_values, [1, 99])
    share = np.clip((plane - low) / max(high - low, 1e-300), 0.0, 1.0)
    grey = (255 * np.nan_to_num(share)).astype(np.uint8)
    return Section(down, across, grey, (down_step * row_stride, across_step * col_stride))


def _resized(section: Section, scale: float, *, squeeze: float = 1.0) -> Grey:
    """The nearest pixels, so many per voxel.

    Rows are squeezed for letters, which are higher than wide.
    """
    nearest_indices: list[Ints] = []
    scales = (scale / squeeze, scale)
    for n, step, per_voxel in zip(section.grey.shape, section.step, scales, strict=True):
        n_pixels = max(1, round(n * step * per_voxel))
        nearest = (np.arange(n_pixels) + 0.5) * n / n_pixels
        nearest_indices.append(np.minimum(nearest.astype(np.intp), n - 1))
    return section.grey[np.ix_(*nearest_indices)]
