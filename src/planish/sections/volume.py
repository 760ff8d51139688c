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
    stack, real = series.stack, series.stack.dtype.kind == "f"
    n = stack.shape[0]
    used_sections = np.arange(n) if alignment is None else np.flatnonzero(alignment.aligned)
    if used_sections.size < 2:
        raise VolumeError(
            f"{used_sections.size} of {n} sections could be aligned, two are needed. Check that"
            " they show one sheet, in order."
        )
    missing = np.rint(np.diff(series.away_um[used_sections]) / series.pitch_um).astype(int) - 1
    gaps = np.flatnonzero(missing > _MOST_MISSING)
    if gaps.size and not real:
        used_um = series.positions_um[used_sections]
        named = ", ".join(
            f"{missing[k]} between {used_um[k]:g} and {used_um[k + 1]:g} um" for k in gaps[:5]
        )
        more = f" and {gaps.size - 5} more" if gaps.size > 5 else ""
        raise VolumeError(
            f"Sections are missing or could not be aligned: {named}{more}. At most {_MOST_MISSING}"
            " in a row can be interpolated: add the sections, or split the series there and treat"
            " each part as a volume of its own."
        )
    planes = _place_planes(series, used_sections, gaps, alignment, gains)
    values: Array | Planes = planes
    if isinstance(stack, np.ndarray):
        values = np.empty(planes.shape, stack.dtype)
        map_threads(planes.fill, range(planes.shape[0]), values)
    voxel = (series.pitch_um, *map(float, series.pixel_um))
    volume_attrs: Entries = {
        "units": "1",
        "long_name": "Grey value",
        "voxel_um": list(voxel),
        "voxel_um_source": "given",
        "full_scale": None if real else int(np.iinfo(stack.dtype).max),
        **(attrs or {}),
        "sections": int(used_sections.size),
        "sections_missing": int(np.maximum(missing, 0).sum()),
        "first_position_um": float(series.positions_um[used_sections[0]]),
    }
    if alignment is not None:
        volume_attrs["jitter_left_um"] = [float(v) for v in alignment.jitter_left_um]
    return labelled(values, "zyx", voxel, name="volume", attrs=volume_attrs)


def _place_planes(
    series: SectionSeries,
    used_sections: Ints,
    gaps: Ints,
    alignment: Alignment | None,
    gains: Gains | None,
) -> Planes:
    """Place the planes of a regular grid between the sections that are used.

    Those in one of the gaps are empty.
    """
    places_um, pitch_um, n = series.away_um[used_sections], series.pitch_um, series.stack.shape[0]
    planes_um = places_um[0] + pitch_um * np.arange(
        int(np.ptp(places_um) / pitch_um + 0.5 * _ON_SECTION) + 1
    )
    last_index, tolerance_um = used_sections.size - 1, _ON_SECTION * pitch_um
    before = np.clip(
        np.searchsorted(places_um, planes_um + tolerance_um, side="right") - 1, 0, last_index
    )
    after = np.minimum(before + 1, last_index)
    spacing_um = np.where(after > before, places_um[after] - places_um[before], 1.0)
    weight = np.clip((planes_um - places_um[before]) / spacing_um, 0.0, 1.0)
    weight[np.abs(planes_um - places_um[before]) <= tolerance_um] = 0.0
    weight[np.abs(planes_um - places_um[after]) <= tolerance_um] = 1.0
    weight[after == before] = 0.0
    poses = np.zeros((n, 4))  # as the kernels take them: pixels, and pixels per pixel
    if alignment is not None:
        poses[:, :2] = alignment.shift_um / np.asarray(series.pixel_um)
        poses[:, 2] = alignment.rotation_rad * series.pixel_um[1] / series.pixel_um[0]
        poses[:, 3] = alignment.rotation_rad * series.pixel_um[0] / series.pixel_um[1]
    return Planes(
        stack=series.stack,
        before=used_sections[before],
        after=used_sections[after],
        weight=weight,
        empty=(weight > 0) & (weight < 1) & np.isin(before, gaps),
        poses=poses,
        grades=(
            np.tile([1.0, 0.0], (n, 1))
            if gains is None
            else np.stack([gains.gain, gains.offset], axis=1)
        ),
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
        """Compute plane ``k`` into ``out`` (rows, cols)."""
        if self.empty[k]:
            out[...] = np.nan
            return
        pair_indices = [int(self.before[k]), int(self.after[k])]
        first = self.stack[pair_indices[0]]
        second = first if pair_indices[0] == pair_indices[1] else self.stack[pair_indices[1]]
        is_integer, low, high = self.dtype.kind != "f", -np.inf, np.inf
        if is_integer:
            low = float(np.iinfo(self.dtype).min)
            high = float(np.iinfo(self.dtype).max)
        poses, grades = self.poses[pair_indices], self.grades[pair_indices]
        interpolate(first, second, float(self.weight[k]), poses, grades, low, high, is_integer, out)

    def read(self, where: Where) -> Array:
        """Compute a part."""
        plane = np.empty(self.shape[1:], self.dtype)
        plane_numbers = range(where[0].start, where[0].stop, where[0].step)
        block = np.empty((len(plane_numbers), *plane[where[1:]].shape), self.dtype)
        for i, k in enumerate(plane_numbers):
            self.fill(k, plane)
            block[i] = plane[where[1:]]
        return block
