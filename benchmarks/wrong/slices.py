"""Slices out of order, twice, missing, filled, foreign: along z, y and x, at drawn places and in
drawn numbers."""

from __future__ import annotations

from functools import partial

import numpy as np

from benchmarks.wrong.kinds import along_either, enter
from benchmarks.wrong.specimens import Draw, drawn


def _span(case, axis):
    """First and last slice that hold much of the sheet."""
    if axis:
        n = case.volume.shape[axis]
        return int(0.15 * n), int(0.85 * n)
    heights = case.right.faces[:, ::8, ::8] / case.right.voxel_um
    return int(np.percentile(heights[3], 20)), int(np.percentile(heights[0], 80))


def _some(case, rng, axis, least=2, most=8):
    """A drawn number of neighbouring slices of the sheet."""
    low, high = _span(case, axis)
    count = int(rng.integers(least, most))
    at = int(rng.integers(low, max(low + 1, high - count)))
    case.note = f"{count} slices"
    return slice(at, at + count)


def traced_order(order, axis):
    """Places along one axis, by the order that the slices were taken in; linear between neighbours
    that were such."""

    def back(places):
        at = np.clip(places[:, axis], 0, order.size - 1)
        low = np.minimum(at.astype(int), order.size - 2)
        near = np.rint(at).astype(int)
        steps = order[low + 1] - order[low]
        moved = places.copy()
        moved[:, axis] = np.where(
            np.abs(steps) == 1, order[low] + (at - low) * steps, order[near] + (at - near)
        )
        return moved

    return back


def reorder(case, order, axis):
    """Take the slices along one axis in another order."""
    case.volume = np.take(case.volume, order, axis=axis)
    case.back.append(traced_order(order, axis))


def exchanged(case, rng, axis):
    """Some pairs of neighbouring slices exchanged."""
    low, high = _span(case, axis)
    count = int(rng.integers(1, 6))
    order = np.arange(case.volume.shape[axis])
    for k in rng.choice(np.arange(low, high - 1, 3), min(count, (high - low) // 3), replace=False):
        order[[k, k + 1]] = order[[k + 1, k]]
    reorder(case, order, axis)
    case.note = f"{count} pairs"


def reversed_run(case, rng, axis):
    """A run of slices in the reverse order."""
    low, high = _span(case, axis)
    run = _some(case, rng, axis, 3, max(4, min(40, (high - low) // 2)))
    order = np.arange(case.volume.shape[axis])
    order[run] = order[run][::-1].copy()
    reorder(case, order, axis)


def missing(case, rng, axis):
    """Some slices left out."""
    reorder(case, np.delete(np.arange(case.volume.shape[axis]), _some(case, rng, axis)), axis)


def filled(case, rng, axis):
    """Some slices made from those beside them."""
    run = _some(case, rng, axis)
    volume = np.moveaxis(case.volume.copy(), axis, 0)
    first, last = volume[run.start - 1].astype(float), volume[run.stop].astype(float)
    count = run.stop - run.start
    for k in range(count):
        share = (k + 1) / (count + 1)
        volume[run.start + k] = np.rint((1 - share) * first + share * last).astype(volume.dtype)
    case.volume = np.moveaxis(volume, 0, axis)


def foreign(case, rng, axis):
    """One to three files of another scan in the series."""
    run = _some(case, rng, axis, 1, 4)
    there = np.moveaxis(
        drawn(Draw(maker=case.right.maker, seed=case.right.seed + 1)).volume, axis, 0
    )
    volume = np.moveaxis(case.volume.copy(), axis, 0)
    rows, cols = volume.shape[1:]
    for k in range(run.start, run.stop):
        plane = there[min(k, len(there) - 1)]
        beyond = [(0, max(0, n - m)) for n, m in zip((rows, cols), plane.shape, strict=True)]
        volume[k] = np.pad(plane, beyond, mode="edge")[:rows, :cols]
    case.volume = np.moveaxis(volume, 0, axis)


def interlaced(case, _, axis):
    """Files sorted by name where numbers have no leading zeros: 1, 10, 11, ..., 2, 20, ..."""
    reorder(case, np.array(sorted(range(case.volume.shape[axis]), key=str)), axis)


for _name, _title, _change, _grave in (
    ("exchanged", "1-5 pairs of neighbouring slices along {} exchanged", exchanged, True),
    ("reversed", "a run of slices along {} in the reverse order", reversed_run, True),
    ("missing", "2-7 slices along {} missing", missing, False),
    ("filled", "2-7 slices along {} made of their neighbours", filled, False),
    ("foreign", "1-3 files of another scan along {}", foreign, False),
):
    enter(f"{_name}-z", _title.format("z"), partial(_change, axis=0), grave=_grave)
    enter(f"{_name}-xy", _title.format("y or x"), along_either(_change), grave=_grave)
enter("sorted-as-text", "files in the order 1, 10, 11, ..., 2, 20, ...", along_either(interlaced))
enter("right", "nothing wrong", lambda *_: None)
