"""Slices out of order, twice, missing, filled, foreign: along z, y and x, at drawn places and in drawn numbers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from benchmarks.wrong.case import Case, Places
from benchmarks.wrong.kinds import Change, enter
from benchmarks.wrong.specimens import Draw, drawn

Array = NDArray[np.float64]
Order = NDArray[np.intp]


def _span(case: Case, axis: int) -> tuple[int, int]:
    """First and last slice that hold much of the sheet."""
    if axis:
        n = case.volume.shape[axis]
        return int(0.15 * n), int(0.85 * n)
    heights = case.right.faces[:, ::8, ::8] / case.right.voxel_um
    return int(np.percentile(heights[3], 20)), int(np.percentile(heights[0], 80))


def traced_order(order: Order, axis: int) -> Places:
    """Places along one axis, by the order that the slices were taken in; linear between neighbours that were such."""

    def back(places: Array) -> Array:
        at = np.clip(places[:, axis], 0, order.size - 1)
        low = np.minimum(at.astype(int), order.size - 2)
        near = np.rint(at).astype(int)
        neighbours = np.abs(order[low + 1] - order[low]) == 1
        between = order[low] + (at - low) * (order[low + 1] - order[low])
        moved = places.copy()
        moved[:, axis] = np.where(neighbours, between, order[near] + (at - near))
        return moved

    return back


def reorder(case: Case, order: Order, axis: int) -> None:
    """Take the slices along one axis in another order."""
    case.volume = np.take(case.volume, order, axis=axis)
    case.back.append(traced_order(order, axis))


def exchanged(axis: int) -> Change:
    """Some pairs of neighbouring slices exchanged."""

    def change(case: Case, rng: np.random.Generator) -> None:
        low, high = _span(case, axis)
        count = int(rng.integers(1, 6))
        order = np.arange(case.volume.shape[axis])
        for k in rng.choice(np.arange(low, high - 1, 3), min(count, (high - low) // 3), replace=False):
            order[[k, k + 1]] = order[[k + 1, k]]
        reorder(case, order, axis)
        case.note = f"{count} pairs"

    return change


def repeated(axis: int) -> Change:
    """Some slices once more behind themselves, so that the stack becomes longer."""

    def change(case: Case, rng: np.random.Generator) -> None:
        low, high = _span(case, axis)
        count = int(rng.integers(2, 8))
        at = int(rng.integers(low, max(low + 1, high - count)))
        n = case.volume.shape[axis]
        reorder(case, np.concatenate([np.arange(at + count), np.arange(at, n)]), axis)
        case.note = f"{count} slices"

    return change


def missing(axis: int) -> Change:
    """Some slices left out."""

    def change(case: Case, rng: np.random.Generator) -> None:
        low, high = _span(case, axis)
        count = int(rng.integers(2, 8))
        at = int(rng.integers(low, max(low + 1, high - count)))
        reorder(case, np.delete(np.arange(case.volume.shape[axis]), np.s_[at : at + count]), axis)
        case.note = f"{count} slices"

    return change


def frozen(axis: int) -> Change:
    """A slice in place of those behind it, as a stage that stuck leaves them."""

    def change(case: Case, rng: np.random.Generator) -> None:
        low, high = _span(case, axis)
        count = int(rng.integers(2, 8))
        at = int(rng.integers(low, max(low + 1, high - count)))
        order = np.arange(case.volume.shape[axis])
        order[at : at + count] = at
        case.volume = np.take(case.volume, order, axis=axis)  # the places stay: what lies there is not what is shown
        case.note = f"{count} slices"

    return change


def filled(axis: int) -> Change:
    """Some slices made from those beside them."""

    def change(case: Case, rng: np.random.Generator) -> None:
        low, high = _span(case, axis)
        count = int(rng.integers(2, 8))
        at = int(rng.integers(low, max(low + 1, high - count)))
        volume = np.moveaxis(case.volume.copy(), axis, 0)
        first, last = volume[at - 1].astype(float), volume[at + count].astype(float)
        for k in range(count):
            share = (k + 1) / (count + 1)
            volume[at + k] = np.rint((1 - share) * first + share * last).astype(volume.dtype)
        case.volume = np.moveaxis(volume, 0, axis)
        case.note = f"{count} slices"

    return change


def blocks(axis: int) -> Change:
    """Two blocks of slices exchanged."""

    def change(case: Case, rng: np.random.Generator) -> None:
        low, high = _span(case, axis)
        count = int(rng.integers(4, max(5, min(30, (high - low) // 3))))
        first = int(rng.integers(low, max(low + 1, high - 2 * count - 1)))
        second = int(rng.integers(first + count, max(first + count + 1, high - count)))
        n = np.arange(case.volume.shape[axis])
        one, two = n[first : first + count], n[second : second + count]
        order = np.concatenate([n[:first], two, n[first + count : second], one, n[second + count :]])
        reorder(case, order, axis)
        case.note = f"{count} slices each"

    return change


def reversed_run(axis: int) -> Change:
    """A run of slices in the reverse order."""

    def change(case: Case, rng: np.random.Generator) -> None:
        low, high = _span(case, axis)
        count = int(rng.integers(3, max(4, min(40, (high - low) // 2))))
        at = int(rng.integers(low, max(low + 1, high - count)))
        order = np.arange(case.volume.shape[axis])
        order[at : at + count] = order[at : at + count][::-1].copy()
        reorder(case, order, axis)
        case.note = f"{count} slices"

    return change


def foreign(axis: int) -> Change:
    """One to three files of another scan in the series."""

    def change(case: Case, rng: np.random.Generator) -> None:
        other = drawn(Draw(maker=case.right.maker, seed=case.right.seed + 1)).volume
        low, high = _span(case, axis)
        count = int(rng.integers(1, 4))
        at = int(rng.integers(low, max(low + 1, high - count)))
        volume = np.moveaxis(case.volume.copy(), axis, 0)
        there = np.moveaxis(other, axis, 0)
        for k in range(at, at + count):
            plane = there[min(k, len(there) - 1)]
            volume[k] = np.pad(plane, [(0, max(0, n - m)) for n, m in zip(volume.shape[1:], plane.shape, strict=True)],
                               mode="edge")[: volume.shape[1], : volume.shape[2]]  # fmt: skip
        case.volume = np.moveaxis(volume, 0, axis)
        case.note = f"{count} slices"

    return change


def interlaced(case: Case, rng: np.random.Generator) -> None:
    """Files sorted by name where numbers have no leading zeros: 1, 10, 11, ..., 2, 20, ..."""
    axis = int(rng.integers(1, 3))
    n = case.volume.shape[axis]
    reorder(case, np.array(sorted(range(n), key=str)), axis)
    case.note = f"along {'zyx'[axis]}"


def halved(case: Case, rng: np.random.Generator) -> None:
    """Every second slice of a part is missing: the disk was full, the series thinned."""
    axis = int(rng.integers(1, 3))
    n = case.volume.shape[axis]
    half = n // 2
    order = np.concatenate([np.arange(half), np.arange(half, n, 2)])
    reorder(case, order, axis)
    case.note = f"second half along {'zyx'[axis]}"


def _same(_: Case, __: np.random.Generator) -> None:
    """Nothing."""


def _along_either(make: Callable[[int], Change]) -> Change:
    """Along y or x, as it is drawn."""

    def change(case: Case, rng: np.random.Generator) -> None:
        axis = int(rng.integers(1, 3))
        make(axis)(case, rng)
        case.note += f" along {'zyx'[axis]}"

    return change


for _name, _title, _make, _grave in (
    ("exchanged", "1-5 pairs of neighbouring slices along {} exchanged", exchanged, True),
    ("blocks", "two blocks of slices along {} exchanged", blocks, True),
    ("reversed", "a run of slices along {} in the reverse order", reversed_run, True),
    ("repeated", "2-7 slices along {} twice", repeated, False),
    ("missing", "2-7 slices along {} missing", missing, False),
    ("filled", "2-7 slices along {} made of their neighbours", filled, False),
    ("frozen", "2-7 slices along {} show the one before them", frozen, False),
    ("foreign", "1-3 files of another scan along {}", foreign, False),
):
    enter(f"{_name}-z", _title.format("z"), _make(0), grave=_grave)
    enter(f"{_name}-xy", _title.format("y or x"), _along_either(_make), grave=_grave)
enter("sorted-as-text", "files in the order 1, 10, 11, ..., 2, 20, ...", interlaced)
enter("thinned", "every second slice missing in half of the stack", halved)
enter("right", "nothing wrong", _same)
