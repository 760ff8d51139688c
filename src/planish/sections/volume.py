"""Make one regular volume from aligned sections.

Every voxel is interpolated once, missing sections from both sides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from planish.core.errors import VolumeError
from planish.core.labelled import labelled
from planish.core.lazy import LazyArray, Where
from planish.core.threads import map_threads
from planish.core.typing import Array, Bools, Entries, Fields, Floats, Ints
from planish.sections._kernels import interpolate
from planish.sections.align import Alignment
from planish.sections.band import Gains, SectionSeries, Stack
from planish.sections.pairs import in_pixels

_MOST_MISSING = 3  # sections in a row that are interpolated
_ON_SECTION = 1e-3  # of a pitch: a plane so near to a section is that section


def regular_volume(
    series: SectionSeries,
    *,
    alignment: Alignment | None = None,
    gains: Gains | None = None,
    attrs: Fields | None = None,
) -> xr.DataArray:
    """Put aligned sections on a regular grid.

    Parameters
    ----------
    series : SectionSeries
        Integers up to 16 bits or real numbers; others lose digits, for the kernels compute in
        single precision.
    alignment : Alignment, optional
        Corrections; none are made where not given. Sections that could not be aligned count as
        missing.
    gains : Gains, optional
        Corrections of the grey levels.
    attrs : mapping, optional
        What the reader knows: ``voxel_um_source``, ``full_scale``, ``file_name``, ``file_bytes``
        and others.

    Returns
    -------
    DataArray, dims (z, y, x) = (section, row, col)
        Computed plane by plane when it is read, where the stack is no ndarray. In the type of the
        stack. Coordinates in um, voxel i has its centre at i × size; z counts from the first
        section used, and its pitch is the median step of the positions. Attributes as
        `planish.io.read_volume` gives them, with ``sections``, ``sections_missing`` (planes between
        sections more than 1.5 pitches apart), ``first_position_um`` and ``jitter_left_um`` (row,
        col). Pixels that a shift brings in from outside repeat the border.

    Raises
    ------
    VolumeError
        If more than 3 sections in a row are missing from integers; of real numbers
        these planes are NaN.
    """
    stack = series.stack
    is_real = stack.dtype.kind == "f"
    n = stack.shape[0]
    used_sections = np.arange(n) if alignment is None else np.flatnonzero(alignment.aligned)
    if used_sections.size < 2:
        raise VolumeError(
            f"{used_sections.size} of {n} sections could be aligned, two are needed. Check that"
            " they show one sheet, in order."
        )
    # Sections that are missing after each used one, by the distance of the next.
    steps = np.diff(series.away_um[used_sections]) / series.pitch_um
    missing = np.rint(steps).astype(int) - 1
    gaps = np.flatnonzero(missing > _MOST_MISSING)
    if gaps.size and not is_real:
        gaps_text = _gaps_text(series.positions_um[used_sections], missing, gaps)
        raise VolumeError(
            f"Sections are missing or could not be aligned: {gaps_text}. At most {_MOST_MISSING}"
            " in a row can be interpolated: add the sections, or split the series there and treat"
            " each part as a volume of its own."
        )
    planes = _place_planes(series, used_sections, gaps, alignment, gains)
    values: Array | Planes = planes
    if isinstance(stack, np.ndarray):
        values = np.empty(planes.shape, stack.dtype)
        map_threads(planes.fill, range(planes.shape[0]), values)
    voxel = (series.pitch_um, *map(float, series.pixel_um))
    usual_attrs: Entries = {
        "units": "1",
        "long_name": "Grey value",
        "voxel_um": list(voxel),
        "voxel_um_source": "given",
        "full_scale": None if is_real else int(np.iinfo(stack.dtype).max),
    }
    volume_attrs = usual_attrs | dict(attrs or {})
    volume_attrs |= {
        "sections": int(used_sections.size),
        "sections_missing": int(np.maximum(missing, 0).sum()),
        "first_position_um": float(series.positions_um[used_sections[0]]),
    }
    if alignment is not None:
        volume_attrs["jitter_left_um"] = [float(v) for v in alignment.jitter_left_um]
    return labelled(values, "zyx", voxel, name="volume", attrs=volume_attrs)


def _gaps_text(used_um: Floats, missing: Ints, gaps: Ints) -> str:
    """Say how many sections are missing where."""
    texts = [f"{missing[k]} between {used_um[k]:g} and {used_um[k + 1]:g} um" for k in gaps[:5]]
    more_text = f" and {gaps.size - 5} more" if gaps.size > 5 else ""
    return ", ".join(texts) + more_text


def _place_planes(
    series: SectionSeries,
    used_sections: Ints,
    gaps: Ints,
    alignment: Alignment | None,
    gains: Gains | None,
) -> Planes:
    """Place the planes of a regular grid between the sections that are used.

    Those in one of the gaps are empty. ``gaps`` are the numbers of the used sections before them.
    """
    places_um = series.away_um[used_sections]
    pitch_um = series.pitch_um
    n = series.stack.shape[0]
    n_planes = int(np.ptp(places_um) / pitch_um + 0.5 * _ON_SECTION) + 1
    planes_um = places_um[0] + pitch_um * np.arange(n_planes)
    last_index = used_sections.size - 1
    tolerance_um = _ON_SECTION * pitch_um
    n_before = np.searchsorted(places_um, planes_um + tolerance_um, side="right")
    before = np.clip(n_before - 1, 0, last_index)
    after = np.minimum(before + 1, last_index)
    passed_um = planes_um - places_um[before]
    spacing_um = np.where(after > before, places_um[after] - places_um[before], 1.0)
    weight = np.clip(passed_um / spacing_um, 0.0, 1.0)
    weight[np.abs(passed_um) <= tolerance_um] = 0.0
    weight[np.abs(planes_um - places_um[after]) <= tolerance_um] = 1.0
    weight[after == before] = 0.0
    poses = np.zeros((n, 4))
    if alignment is not None:
        poses_um = np.column_stack([alignment.shift_um, alignment.rotation_rad])
        poses = in_pixels(poses_um, series.pixel_um)
    grades = np.tile([1.0, 0.0], (n, 1))
    if gains is not None:
        grades = np.stack([gains.gain, gains.offset], axis=1)
    is_between = (weight > 0) & (weight < 1)
    return Planes(
        stack=series.stack,
        before=used_sections[before],
        after=used_sections[after],
        weight=weight,
        empty=is_between & np.isin(before, gaps),
        poses=poses,
        grades=grades,
    )


@dataclass(kw_only=True, eq=False)
class Planes(LazyArray):
    """The planes of a volume, each interpolated between the sections before and after it.

    ``weight`` is that of the section after it; ``empty`` planes lie in a gap that is too wide;
    ``poses`` (sections, 4) and ``grades`` (sections, 2) are those of the kernels.
    """

    whole_slices = True
    stack: Stack
    before: Ints
    after: Ints
    weight: Floats
    empty: Bools
    poses: Floats
    grades: Floats

    def __post_init__(self) -> None:
        """Take size and type from the sections."""
        self.shape = (self.before.size, *self.stack.shape[1:])
        self.dtype = self.stack.dtype

    def fill(self, k: int, out: Array) -> None:
        """Compute plane ``k`` into ``out`` (rows, cols).

        NaN in a gap, which only real numbers can have.
        """
        if self.empty[k]:
            out[...] = np.nan
            return
        before = int(self.before[k])
        after = int(self.after[k])
        first = self.stack[before]
        second = first if before == after else self.stack[after]
        is_integer = self.dtype.kind != "f"
        low, high = -np.inf, np.inf
        if is_integer:
            limits = np.iinfo(self.dtype)
            low = float(limits.min)
            high = float(limits.max)
        corrections = (self.poses[[before, after]], self.grades[[before, after]])
        weight = float(self.weight[k])
        interpolate(first, second, weight, *corrections, low, high, is_integer, out)

    def read(self, where: Where) -> Array:
        """Compute a part."""
        planes, *window = where
        plane = np.empty(self.shape[1:], self.dtype)
        plane_numbers = range(planes.start, planes.stop, planes.step)
        part = plane[tuple(window)]
        block = np.empty((len(plane_numbers), *part.shape), self.dtype)
        for i, k in enumerate(plane_numbers):
            self.fill(k, plane)
            block[i] = part
        return block
