"""A first look at a volume or an image: its middle sections, small, as a picture and as text for a terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import imagecodecs
import numpy as np
from numpy.typing import NDArray

from planish.core.files import write_whole
from planish.io.inspection import Values

_SIDE = 480  # pixels along the longer side of a section
_SLICES = 96  # that are read of a file for the two sections across them
_GAP = 8
_SHADES = " ░▒▓█"
_HIGH_AS_WIDE = 2.1  # height of a letter in widths
_WIDE, _HIGH = 72, 18  # letters
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
    every = -(-depth // _SLICES)
    planes = (np.asarray(values[k]) for k in range(0, depth, every))
    along_x, along_y = zip(*((p[rows // 2].copy(), p[:, cols // 2].copy()) for p in planes), strict=True)
    return [
        _section("z", "x", np.stack(along_x), (every, 1)),
        _section("z", "y", np.stack(along_y), (every, 1)),
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
    shown = [_resized(s, scale) for s in sections]
    out = np.full((max(p.shape[0] for p in shown), sum(p.shape[1] + _GAP for p in shown) - _GAP), 255, np.uint8)
    col = 0
    for part in shown:
        out[: part.shape[0], col : col + part.shape[1]] = part
        col += part.shape[1] + _GAP
    write_whole(path, bytes(imagecodecs.png_encode(out)))


def as_text(section: Section) -> list[str]:
    """A section in shades of letters, at most 72 wide and 18 high; the last line names its axes."""
    rows, cols = (n * k for n, k in zip(section.grey.shape, section.step, strict=True))
    scale = min(_WIDE / cols, _HIGH * _HIGH_AS_WIDE / rows)
    grey = _resized(section, scale, squeeze=_HIGH_AS_WIDE)
    shade = np.minimum(grey.astype(int) * len(_SHADES) // 256, len(_SHADES) - 1)
    lines = ["".join(_SHADES[k] for k in row) for row in shade]
    return [*lines, f"middle of the volume: {section.down} down, {section.across} across"]


def _section(down: str, across: str, plane: NDArray[Any], step: tuple[int, int]) -> Section:
    """Thin a plane out, and spread its grey over 0 to 255."""
    thin = [max(1, -(-n * k // _SIDE) // k) for n, k in zip(plane.shape, step, strict=True)]
    plane = plane[:: thin[0], :: thin[1]].astype(np.float64)
    finite = plane[np.isfinite(plane)]
    low, high = np.percentile(finite, [1, 99]) if finite.size else (0.0, 1.0)
    grey = np.clip((plane - low) / max(high - low, 1e-300), 0.0, 1.0)
    step = (step[0] * thin[0], step[1] * thin[1])
    return Section(down, across, (255 * np.nan_to_num(grey)).astype(np.uint8), step)


def _resized(section: Section, scale: float, *, squeeze: float = 1.0) -> Grey:
    """The nearest pixels, so many per voxel; rows are squeezed for letters, which are higher than wide."""
    nearest: list[NDArray[np.intp]] = []
    for n, step, per in zip(section.grey.shape, section.step, (scale / squeeze, scale), strict=True):
        count = max(1, round(n * step * per))
        nearest.append(np.minimum(((np.arange(count) + 0.5) * n / count).astype(np.intp), n - 1))
    return section.grey[np.ix_(*nearest)]
