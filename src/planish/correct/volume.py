"""Entry point: inspect a volume and return it corrected, without holding it in memory."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from planish.core.errors import InputError
from planish.core.labelled import computed
from planish.core.lazy import Where
from planish.core.typing import Array, Floats, Ints
from planish.correct.cupping import factor, find_cupping, middle_factor
from planish.correct.params import CorrectionRecord, CorrectParams, Cupping, Trends
from planish.correct.rings import RingFit, find_rings, remaining_rings
from planish.correct.sums import (
    Levels,
    NumberedSlice,
    Sums,
    Turning,
    find_levels,
    make_turning,
    slices_of,
    take_sums,
)

Progress = Callable[[str, str], None]


class Change(NamedTuple):
    """The change of a voxel: grey taken off at its radius, then a factor on what is above air.

    ``blocks`` are the middles of the blocks along the axis, ``mean_factor`` is that of the cupping
    over the sheet.
    """

    turning: Turning
    levels: Levels
    rings: RingFit | None
    cupping: Cupping | None
    blocks: Floats
    mean_factor: float

    def apply(
        self,
        values: Array,
        along: Ints,
        rows: Ints,
        cols: Ints,
    ) -> tuple[Array, int]:
        """Correct a block (along, rows, cols) with its places in the array.

        Return it and how many were clipped. ``along`` are the numbers of its slices along the axis
        of rotation, ``rows`` and ``cols`` those of its voxels along the two other axes. Padding and
        voxels that are not finite stay as they are.
        """
        radius = np.hypot(*self.turning.offsets_um(rows, cols))
        cupping_factor = np.ones(radius.shape)
        if self.cupping is not None:
            share = radius / self.cupping.reach_um
            cupping_factor = factor(self.cupping.powers, share) / self.mean_factor
        last = self.turning.bins - 1
        bin_position = np.clip(radius / self.turning.step_um - 0.5, 0.0, last)
        lower_bin = np.minimum(bin_position.astype(np.intp), last - 1)
        weight = bin_position - lower_bin
        tables = np.zeros((len(values), self.turning.bins))
        if self.rings is not None:
            tables = self.levels.contrast * self.rings.tables(self.blocks, along)
        is_integer = values.dtype.kind in "ui"
        air = self.levels.air
        limits = np.iinfo(values.dtype) if is_integer else np.finfo(values.dtype)
        out = np.empty_like(values)
        clipped = 0
        for k, plane in enumerate(values):
            grey = plane.astype(np.float64)
            table = tables[k]
            ring = table[lower_bin] * (1.0 - weight) + table[lower_bin + 1] * weight
            corrected = air + (grey - ring - air) / cupping_factor
            corrected = np.rint(corrected) if is_integer else corrected
            limited = np.clip(corrected, float(limits.min), float(limits.max))
            is_empty = (grey == self.levels.padding) | ~np.isfinite(grey)
            clipped += np.count_nonzero((limited != corrected) & ~is_empty)
            out[k] = np.where(is_empty, plane, limited)
        return out, int(clipped)


def _read_corrected(volume: xr.Variable, change: Change, where: Where) -> Array:
    """Read a part of a volume and correct it; a voxel does not depend on the part."""
    axis_order = change.turning.order
    spans = [where[axis] for axis in axis_order]
    places = (np.arange(span.start, span.stop, span.step) for span in spans)
    values = np.transpose(volume[where].values, axis_order)
    out, _ = change.apply(values, *places)
    return np.transpose(out, np.argsort(axis_order))


@dataclass(frozen=True, slots=True, kw_only=True)
class Corrected:
    """A corrected volume, and what was done to it."""

    #: (z, y, x), of the same type; the one that was given where nothing had to be changed; its
    #: attribute ``corrections`` holds the record.
    volume: xr.DataArray
    record: CorrectionRecord
    turning: Turning
    before: Sums | None = None  #: for the figure; None where no sheet stands out
    after: Sums | None = None  #: as ``before``
    change: Change | None = None


def correct_volume(
    volume: xr.DataArray,
    *,
    params: CorrectParams,
    memory_bytes: int = 2**30,
    progress: Progress | None = None,
) -> Corrected:
    """Find rings and cupping of a micro-CT volume and correct them.

    Parameters
    ----------
    volume : DataArray, dims (z, y, x), with the voxel size in ``attrs["voxel_um"]``
        Read in slabs across the axis of rotation; it need not fit into memory.
    params : CorrectParams; what is corrected, and where the axis of rotation stands
    memory_bytes : int; what the slabs may take
    progress : callable, optional; called with what is done and how far it is

    Returns
    -------
    Corrected

    Raises
    ------
    VolumeError
        If the volume is too small along an axis.
    InputError
        If the centre lies far outside the field, nothing is asked for, or the volume was made from
        sections.
    SizeError
        If the volume has no voxel size.

    Notes
    -----
    The sheet has to be lighter than the air. Rings are additive and the same all around; their
    height may vary slowly along the axis. The factor of the cupping is taken relative to its mean
    over the sheet, so that the sheet's mean grey stays; it says nothing about which radius shows
    the true grey.
    """
    if not params.asked:
        raise InputError(
            "Neither rings nor cupping is asked for. Give `correct_rings`, `correct_cupping` or"
            " both."
        )
    if volume.attrs.get("sections") is not None:
        raise InputError(
            "The volume was made from photographs of sections, which have neither rings nor"
            " cupping. Leave out `correct_rings` and `correct_cupping`."
        )
    axis = params.axis
    turning = make_turning(volume, axis, params.centre_um)
    length = turning.shape[0]
    rows, cols = (np.arange(n) for n in turning.shape[1:])
    record = CorrectionRecord(
        axis=axis, centre_um=turning.centre_um, asked=params.asked, length=length
    )
    slices = partial(slices_of, volume, turning, memory_bytes=memory_bytes)
    # A first look at some slices.
    first_slices = [plane for _, plane in slices(max_slices=24)]
    radius_um = np.hypot(*turning.offsets_um(rows, cols))
    levels = find_levels(first_slices, radius_um)
    if levels is None:
        sentences = ("No sheet stands out from the air: nothing was corrected.",)
        record = record.model_copy(update={"sentences": sentences})
        return _corrected(volume, record, turning)
    record = record.model_copy(update={"air": levels.air, "sheet": levels.sheet})

    def sums(slices: Iterator[NumberedSlice], task_text: str) -> Sums:
        if progress is not None:
            progress(task_text, f"{length} slices across {axis}")
        return take_sums(slices, turning, levels)

    before = sums(slices(), "rings and cupping")
    change, record = _find_change(before, turning, levels, record)
    if not record.changes:
        record = record.model_copy(update={"trends": _trends_with(record, record.trends)})
        return _corrected(volume, record, turning, before=before)
    clipped = [0, 0]  # voxels that left the range of their type, and all

    def changed() -> Iterator[NumberedSlice]:
        for number, values in slices():
            out, n = change.apply(values[None], np.array([number]), rows, cols)
            clipped[0] += n
            clipped[1] += out.size
            yield number, out[0]

    after = sums(changed(), "what is left")
    rings_after = find_rings(after, turning, levels.contrast)
    trends_after = find_cupping(after, turning, levels, rings_after.mean)[1]
    rings = remaining_rings(change.rings, rings_after) if change.rings else ()
    trends = _trends_with(record, trends_after)
    share = clipped[0] / clipped[1]
    record = record.model_copy(update={"rings": rings, "trends": trends, "clipped": share})
    corrected = computed(volume, partial(_read_corrected, volume.variable, change))
    return _corrected(corrected, record, turning, before=before, after=after, change=change)


def _trends_with(record: CorrectionRecord, trends_after: Trends) -> Trends:
    """The trends of a record with the losses that are there after the correction."""
    losses = {trend.material: trend.before for trend in trends_after}
    trends: Trends = ()
    for trend in record.trends:
        after = losses.get(trend.material)
        trends += (trend.model_copy(update={"after": after}),)
    return trends


def _corrected(
    volume: xr.DataArray, record: CorrectionRecord, turning: Turning, **more: Any
) -> Corrected:
    """A volume with its record among its attributes, and what else is known."""
    volume = volume.assign_attrs(corrections=record.to_json())
    return Corrected(volume=volume, record=record, turning=turning, **more)


def _find_change(
    sums_before: Sums, turning: Turning, levels: Levels, record: CorrectionRecord
) -> tuple[Change, CorrectionRecord]:
    """Find rings and cupping, and take into the record what was asked for.

    Both are always found: the trend of the sheet is measured without the rings. What was not asked
    for is not part of the change.
    """
    sentences: list[str] = []
    ring_fit = find_rings(sums_before, turning, levels.contrast)
    cupping, trends, cupping_text = find_cupping(sums_before, turning, levels, ring_fit.mean)
    if "rings" in record.asked:
        record = record.model_copy(update={"rings": ring_fit.rings, "ring_limit": ring_fit.limit})
        limit_text = (
            f"one of {100 * ring_fit.limit:.1f} % of the sheet's contrast would have been found"
        )
        sentence = f"Rings: no rings above noise ({limit_text}), nothing was corrected."
        if ring_fit.rings:
            highest_percent = 100 * max(abs(r.share) for r in ring_fit.rings)
            sentence = (
                f"Rings: {len(ring_fit.rings)} corrected, the highest {highest_percent:.1f} % of"
                " the contrast."
            )
        sentences.append(sentence)
    if "cupping" in record.asked:
        sentences.append(cupping_text)
    else:
        cupping = None
    facts = {"slices": sums_before.slices, "cupping": cupping, "trends": trends}
    record = record.model_copy(update=facts | {"sentences": tuple(sentences)})
    rings = ring_fit if record.rings else None
    mean_factor = 1.0 if cupping is None else middle_factor(sums_before, turning, cupping)
    change = Change(turning, levels, rings, cupping, sums_before.blocks, mean_factor)
    return change, record
