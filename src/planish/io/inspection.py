"""Inspection of the values of a volume or an image: their distribution, and what looks wrong."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import Any, NamedTuple

import imagecodecs
import numpy as np
from numpy.typing import NDArray

from planish.core.files import write_whole
from planish.core.memory import EAGER_BYTES, SAMPLE_BYTES, SAMPLE_VALUES
from planish.core.typing import Ints
from planish.io.lazy import Values
from planish.io.slice_volume import first_few

PERCENTILES = (1, 5, 25, 50, 75, 95, 99)


def inspect_values(
    values: Values, full_scale: int | None, warnings: list[str], *, dims: tuple[str, ...]
) -> dict[str, Any]:
    """Shape, type and distribution of the values; what looks wrong is added to `warnings`."""
    n_planes = values.shape[0]
    plane_numbers = [*range(n_planes)]
    if values.ndim > 2 and values.nbytes > EAGER_BYTES:  # evenly spread ones, where reading all would take long
        n_sampled = max(8, SAMPLE_BYTES // (values.nbytes // n_planes))
        if n_sampled < n_planes:
            plane_numbers = [int(n) for n in np.linspace(0, n_planes - 1, n_sampled).round()]
    share = len(plane_numbers) / n_planes
    stride = max(1, math.ceil((math.prod(values.shape) * share / SAMPLE_VALUES) ** (1 / values.ndim)))
    low, high, n_values, n_finite, n_bottom, n_saturated = math.inf, -math.inf, 0, 0, 0, 0
    constant_numbers, copy_numbers = list[int](), list[int]()
    samples, digests = list[NDArray[Any]](), set[bytes]()
    for index, number in enumerate(plane_numbers):
        plane = np.asarray(values[number])
        finite_values = plane if plane.dtype.kind != "f" else plane[np.isfinite(plane)]
        n_values, n_finite = n_values + plane.size, n_finite + finite_values.size
        plane_low = plane_high = math.nan
        if finite_values.size:
            plane_low, plane_high = float(finite_values.min()), float(finite_values.max())
            low, high = min(low, plane_low), max(high, plane_high)
        if full_scale is not None:
            n_saturated += int(np.count_nonzero(plane == full_scale))
            n_bottom += int(np.count_nonzero(plane == 0))
        if index % stride == 0:
            sample = plane[(slice(None, None, stride),) * plane.ndim].ravel()
            samples.append(sample[np.isfinite(sample)])
        # Slices with fewer pixels may well be alike, or of one grey.
        if plane.ndim == 2 and plane.size >= 1000:
            digest = hashlib.blake2b(np.ascontiguousarray(plane).data, digest_size=16).digest()
            if not plane_low < plane_high:
                constant_numbers.append(number)
            elif digest in digests:
                copy_numbers.append(number)
            digests.add(digest)
    facts: dict[str, Any] = declared_facts(values, dims) | {
        "nan_share": 1 - n_finite / n_values,
        "saturated_share": n_saturated / n_values,
        "bottom_share": n_bottom / n_values,
        "sampled": None if len(plane_numbers) == n_planes else f"{len(plane_numbers)} of {n_planes} slices",
    }
    if not n_finite:
        warnings.append("There is no number in it, all values are missing.")
        facts["percentiles"] = dict.fromkeys(map(str, PERCENTILES))
    else:
        sample = np.sort(np.concatenate(samples))
        if not sample.size:  # the grid met no number
            planes = (np.asarray(values[number]) for number in plane_numbers)
            sample = np.sort(np.concatenate([plane[np.isfinite(plane)] for plane in planes]))
        facts["percentiles"] = {str(p): float(np.percentile(sample, p)) for p in PERCENTILES}
        facts |= {"min": low, "max": high}
        n_levels = int(np.count_nonzero(np.diff(sample)) + 1)
        if low == high:
            warnings.append(f"All values are {low:g}.")
        elif values.dtype.kind in "ui" and n_levels < 16:
            warnings.append(f"It has {n_levels} grey levels only. Is it a segmentation? planish needs the grey values.")
    if facts["nan_share"] > 0:
        warnings.append(f"{100 * facts['nan_share']:.3g} % of the values are missing (NaN or infinite).")
    if low == high:
        return facts
    # Above this share of values at the end of the range, grey levels were lost.
    if facts["saturated_share"] > 0.001:
        cut_text = f"are at {full_scale}, the largest the file can store: grey levels were cut there."
        warnings.append(f"{100 * facts['saturated_share']:.3g} % of the values {cut_text}")
    if constant_numbers:
        warnings.append(
            f"{len(constant_numbers)} slices have one grey value only (black or empty), z "
            f"{first_few(constant_numbers)}: the scan ended there, or files were damaged."
        )
    if copy_numbers:
        place_text = f"as a slice before them, z {first_few(copy_numbers)}: were they copied to fill gaps?"
        warnings.append(f"{len(copy_numbers)} slices hold the same values {place_text}")
    return facts


def declared_facts(values: Values, dims: tuple[str, ...]) -> dict[str, Any]:
    """Give the facts without those of the values, which are None."""
    value_keys = ("min", "max", "percentiles", "nan_share", "saturated_share", "bottom_share")
    header_facts = {"dims": list(dims), "shape": list(values.shape), "dtype": str(values.dtype)}
    return header_facts | dict.fromkeys(value_keys) | {"sampled": "none"}


_SIDE = 480  # pixels along the longer side of a section
_SHADES = " ░▒▓█"
_HIGH_AS_WIDE = 2.1  # height of a letter in widths
Grey = NDArray[np.uint8]


class Section(NamedTuple):
    """A section through the middle: the axes down and across it, grey from 0 to 255, and voxels in one of its steps."""

    down: str
    across: str
    grey: Grey
    step: tuple[int, int]


def middle_sections(values: Values) -> list[Section]:
    """Sections (z, x), (z, y) and (y, x) through the middle of a volume (z, y, x), or an image (y, x) itself.

    Of a volume in slices, at most 96 of them are read.
    """
    if len(values.shape) == 2:
        return [_section("y", "x", np.asarray(values), (1, 1))]
    depth, rows, cols = values.shape
    stride = -(-depth // 96)
    planes = (np.asarray(values[k]) for k in range(0, depth, stride))
    along_x, along_y = zip(*((p[rows // 2].copy(), p[:, cols // 2].copy()) for p in planes), strict=True)
    return [
        _section("z", "x", np.stack(along_x), (stride, 1)),
        _section("z", "y", np.stack(along_y), (stride, 1)),
        _section("y", "x", np.asarray(values[depth // 2]), (1, 1)),
    ]


def best_section(sections: list[Section], through: str | None) -> Section:
    """The section in which a sheet shows as a line: across its normal, and first the one that reads down the normal."""
    candidates = [s for s in sections if through in (s.down, s.across)]
    return next((s for s in candidates if s.down == through), (candidates or sections)[0])


def write_picture(sections: list[Section], path: Path) -> None:
    """Write sections side by side as a PNG, all on one scale, with voxels as squares.

    Raises
    ------
    FileError
        If the file is there already or cannot be written.
    ResourceError
        If the disk is full.
    """
    scale = _SIDE / max(n * k for s in sections for n, k in zip(s.grey.shape, s.step, strict=True))
    pictures = [_resized(s, scale) for s in sections]
    max_rows = max(map(len, pictures))
    padded = [np.pad(grey, ((0, max_rows - len(grey)), (0, 8)), constant_values=255) for grey in pictures]
    write_whole(path, bytes(imagecodecs.png_encode(np.ascontiguousarray(np.hstack(padded)[:, :-8]))))


def as_text(section: Section) -> list[str]:
    """A section in shades of letters, at most 72 wide and 18 high; the last line names its axes."""
    rows, cols = (n * k for n, k in zip(section.grey.shape, section.step, strict=True))
    scale = min(72 / cols, 18 * _HIGH_AS_WIDE / rows)
    grey = _resized(section, scale, squeeze=_HIGH_AS_WIDE)
    shade = np.minimum(grey.astype(int) * len(_SHADES) // 256, len(_SHADES) - 1)
    lines = ["".join(_SHADES[k] for k in row) for row in shade]
    return [*lines, f"middle of the volume: {section.down} down, {section.across} across"]


def _section(down: str, across: str, plane: NDArray[Any], step: tuple[int, int]) -> Section:
    """Thin a plane out, and spread its grey over 0 to 255."""
    strides = [max(1, -(-n * k // _SIDE) // k) for n, k in zip(plane.shape, step, strict=True)]
    plane = plane[:: strides[0], :: strides[1]].astype(np.float64)
    finite_values = plane[np.isfinite(plane)]
    low, high = np.percentile(finite_values, [1, 99]) if finite_values.size else (0.0, 1.0)
    grey = np.clip((plane - low) / max(high - low, 1e-300), 0.0, 1.0)
    step = (step[0] * strides[0], step[1] * strides[1])
    return Section(down, across, (255 * np.nan_to_num(grey)).astype(np.uint8), step)


def _resized(section: Section, scale: float, *, squeeze: float = 1.0) -> Grey:
    """The nearest pixels, so many per voxel; rows are squeezed for letters, which are higher than wide."""
    nearest_indices: list[Ints] = []
    for n, step, pixels_per_voxel in zip(section.grey.shape, section.step, (scale / squeeze, scale), strict=True):
        n_pixels = max(1, round(n * step * pixels_per_voxel))
        nearest_indices.append(np.minimum(((np.arange(n_pixels) + 0.5) * n / n_pixels).astype(np.intp), n - 1))
    return section.grey[np.ix_(*nearest_indices)]
