"""Entry point: inspect a volume and return it corrected, without holding it in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import InputError
from planish.core.lazy import LazyArray, Where, replaced
from planish.core.threads import count_threads
from planish.correct import _kernels
from planish.correct.cupping import factor, find_cupping, middle_factor
from planish.correct.levels import Levels, find_levels
from planish.correct.params import CorrectParams
from planish.correct.record import Corrections, Cupping, Trend
from planish.correct.rings import Rings, find_rings, left_over
from planish.correct.sums import Slice, Sums, slices_of, take_sums
from planish.correct.turning import Turning, make_turning

Array = NDArray[np.float64]
Progress = Callable[[str, str], None]

_LOOK = 24  # slices of the first look


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """What is done to a voxel: grey taken off at its radius, then a factor on what is above air.

    Attributes
    ----------
    turning : Turning
    levels : Levels
    rings : Rings or None
    cupping : Cupping or None
    blocks : (block,) float64
        Middles of the blocks along the axis.
    mean_factor : float
        Of the cupping, over the sheet.
    """

    turning: Turning
    levels: Levels
    rings: Rings | None
    cupping: Cupping | None
    blocks: Array
    mean_factor: float

    def apply(
        self, values: NDArray[Any], along: NDArray[np.intp], rows: NDArray[np.intp], cols: NDArray[np.intp]
    ) -> tuple[NDArray[Any], int]:
        """Correct a block (along, rows, cols) with its places in the array; return it and how many were clipped."""
        turning = self.turning
        radius = turning.radius_um(rows, cols)
        tables = np.zeros((along.size, turning.bins))
        if self.rings is not None:
            tables = self.levels.contrast * self.rings.tables(self.blocks, along)
        cup = np.ones(radius.shape)
        if self.cupping is not None:
            cup = factor(self.cupping.powers, radius / self.cupping.reach_um) / self.mean_factor
        whole = values.dtype.kind in "ui"
        limits = np.iinfo(values.dtype) if whole else np.finfo(values.dtype)
        out = np.empty_like(values)
        clipped = _kernels.corrected(
            values, out, tables, radius / turning.step_um - 0.5, cup, self.levels.air, self.levels.padding,
            float(limits.min), float(limits.max), whole,
        )  # fmt: skip
        return out, int(clipped)


class CorrectedArray(LazyArray):
    """A volume whose parts are corrected when they are read; a voxel does not depend on the part.

    Parameters
    ----------
    inner : DataArray, dims (z, y, x)
    change : Change
    """

    def __init__(self, inner: xr.DataArray, change: Change) -> None:
        self.inner, self.change = inner.variable, change
        self.shape, self.dtype = inner.shape, inner.dtype

    def read(self, where: Where) -> NDArray[Any]:
        """Read a part and correct it."""
        order = self.change.turning.order
        places = [np.arange(w.start, w.stop, w.step) for w in where]
        values = np.transpose(self.inner[where].values, order)
        out, _ = self.change.apply(values, *(places[axis] for axis in order))
        return np.transpose(out, np.argsort(order))


@dataclass(frozen=True, slots=True, kw_only=True)
class Corrected:
    """A corrected volume, and what was done to it.

    Attributes
    ----------
    volume : DataArray, dims (z, y, x)
        Of the same type; the one that was given where nothing had to be changed. Its attribute ``corrections`` holds
        the record.
    record : Corrections
    turning : Turning
    before, after : Sums or None
        For the figure; None where no sheet stands out.
    change : Change or None
    """

    volume: xr.DataArray
    record: Corrections
    turning: Turning
    before: Sums | None = None
    after: Sums | None = None
    change: Change | None = None


def correct_volume(
    volume: xr.DataArray, *, params: CorrectParams, memory_bytes: int = 2**30, threads: int | None = None,
    progress: Progress | None = None,
) -> Corrected:  # fmt: skip
    """Find rings and cupping of a micro-CT volume and correct them.

    Parameters
    ----------
    volume : DataArray, dims (z, y, x), with the voxel size in ``attrs["voxel_um"]``
        Read in slabs across the axis of rotation; it need not fit into memory.
    params : CorrectParams
        What is corrected, and where the axis of rotation stands.
    memory_bytes : int
        What the slabs may take.
    threads : int, optional
        No result depends on it.
    progress : callable, optional
        Called with what is done and how far it is.

    Returns
    -------
    Corrected

    Raises
    ------
    VolumeError
        If the volume is too small along an axis.
    InputError
        If the centre lies far outside the field, nothing is asked for, or the volume was made from sections.
    SizeError
        If the volume has no voxel size.

    Notes
    -----
    The sheet has to be brighter than the air. Rings are additive and the same all around; their height may vary slowly
    along the axis. The factor of the cupping is taken relative to its mean over the sheet, so that the sheet's mean
    grey stays; it says nothing about which radius shows the true grey.
    """
    if not params.asked:
        raise InputError("Neither rings nor cupping is asked for. Give --correct-rings, --correct-cupping or both.")
    if volume.attrs.get("sections") is not None:
        raise InputError(
            "The volume was made from photographs of sections, which have neither rings nor cupping. Leave out "
            "--correct-rings and --correct-cupping."
        )
    turning = make_turning(volume, params.axis, params.centre_um)
    threads = count_threads(threads)
    report = progress or _silent
    record = Corrections(axis=params.axis, centre_um=turning.centre_um, asked=params.asked, length=turning.shape[0])
    look = [values for _, values in slices_of(volume, turning, most=_LOOK, memory_bytes=memory_bytes)]
    rows, cols = np.arange(turning.shape[1]), np.arange(turning.shape[2])
    levels = find_levels(look, turning.radius_um(rows, cols))
    if levels is None:
        nothing = "No sheet stands out from the air: nothing was corrected."
        return _finished(volume, turning, replace(record, sentences=(nothing,)))
    record = replace(record, air=levels.air, sheet=levels.sheet)

    def sums(slices: Iterator[tuple[int, Slice]], what: str) -> Sums:
        report(what, f"{turning.shape[0]} slices across {params.axis}")
        return take_sums(slices, turning, levels, threads=threads)

    before = sums(slices_of(volume, turning, memory_bytes=memory_bytes), "rings and cupping")
    change, record = _decide(before, turning, levels, record)
    if not record.changes:
        trends = tuple(replace(t, after=t.before) for t in record.trends)
        return _finished(volume, turning, replace(record, trends=trends), before=before)
    clipped = [0, 0]

    def changed() -> Iterator[tuple[int, Slice]]:
        for number, values in slices_of(volume, turning, memory_bytes=memory_bytes):
            out, n = change.apply(values[None], np.array([number]), rows, cols)
            clipped[0] += n
            clipped[1] += out.size
            yield number, out[0]

    after = sums(changed(), "what is left")
    rest = find_rings(after, turning, levels.contrast)
    record = replace(
        record,
        rings=() if change.rings is None else left_over(change.rings, rest),
        trends=_after(record.trends, find_cupping(after, turning, levels, rest.mean)[1]),
        clipped=clipped[0] / clipped[1],
    )
    return _finished(volume, turning, record, before=before, after=after, change=change)


def _decide(before: Sums, turning: Turning, levels: Levels, record: Corrections) -> tuple[Change, Corrections]:
    """Find what has to be changed."""
    sentences: list[str] = []
    record = replace(record, slices=before.slices)
    found, mean_factor = None, 1.0
    rings = find_rings(before, turning, levels.contrast)
    if "rings" in record.asked:
        if rings.found:
            highest = max(abs(r.share) for r in rings.found)
            sentences.append(f"Rings: {len(rings.found)} corrected, the highest {100 * highest:.1f} % of the contrast.")
        else:
            limit = f"one of {100 * rings.limit:.1f} % of the sheet's contrast would have been found"
            sentences.append(f"Rings: no rings above noise ({limit}), nothing was corrected.")
        record = replace(record, rings=rings.found, ring_limit=rings.limit)
    cupping, trends, sentence = find_cupping(before, turning, levels, rings.mean)
    if "cupping" in record.asked:
        sentences.append(sentence)
        found = cupping
        mean_factor = middle_factor(before, turning, cupping) if cupping is not None else 1.0
    record = replace(record, cupping=found, trends=trends, sentences=tuple(sentences))
    change = Change(
        turning=turning, levels=levels, rings=rings if record.rings else None, cupping=found,
        blocks=before.blocks, mean_factor=mean_factor,
    )  # fmt: skip
    return change, record


def _after(before: tuple[Trend, ...], after: tuple[Trend, ...]) -> tuple[Trend, ...]:
    left = {t.material: t.before for t in after}
    return tuple(replace(t, after=left.get(t.material)) for t in before)


def _finished(
    volume: xr.DataArray, turning: Turning, record: Corrections, *, before: Sums | None = None,
    after: Sums | None = None, change: Change | None = None,
) -> Corrected:  # fmt: skip
    out = volume
    if change is not None:
        out = replaced(volume, CorrectedArray(volume, change))
    out = out.assign_attrs(corrections=record.to_json())
    return Corrected(volume=out, record=record, turning=turning, before=before, after=after, change=change)


def _silent(_what: str, _how_far: str) -> None:
    """Report nothing."""
