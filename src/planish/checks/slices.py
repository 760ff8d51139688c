"""Check of the slices: out of order, repeated, filled, missing or foreign.

It judges by how each differs from its neighbours.

Neighbouring slices of a continuous body are alike, and how much they differ changes slowly from
slice to slice. Every statistic compares a slice with its own neighbourhood, so that none needs a
scale; logarithms are natural. What is wider than some 125 voxels in a slice is taken off first.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planish.checks.greys import level_jump
from planish.checks.scan import ScannedSheet
from planish.checks.windows import Window
from planish.core.checks import CORRELATION, POSITION, PROPERTIES, Check, CheckRule
from planish.core.frame import Axis
from planish.core.typing import Array, Bools, Floats, Ints

Kind = Literal["exchanged", "moved", "repeated", "filled", "foreign", "empty", "jump"]

# Largest values on some 80 axes of right volumes, measured and synthetic: .70, 1.51, 1.06, 1.24,
# .82.
ALIKE, FILLED, EXCHANGED, FOREIGN, JUMP = 1.0, 2.0, 1.2, 2.0, 0.9
# Standard errors by which a statistic stands out as well: matters where a window is small.
_SIGMA = 4.0
# Of the usual spread of a slice's greys: it shows next to nothing; it shows the body.
_EMPTY, _FULL = 0.05, 0.5
_COPY = 0.5  # of the difference of neighbours: that of a slice and its copy with noise of its own
_FITS = 1.3  # times the difference of neighbours: a slice fits there
# Of the usual spread: levels jump by 0.04 of it in right scans, by 0.19 with gains of 3 % a
# section.
_GAINS = 0.08
_AROUND = 5  # slices on either side that show how bright a slice ought to be
_RUN = 10  # slices that are filled, or nearly the same, at most
_FINE = 25  # blocks of 5 voxels: structure that is wider tells nothing of the order
_TINY = 1e-300  # differences of 0 have a ratio and a logarithm, too
_DISORDER = frozenset({"exchanged", "moved"})
_DISPLACING = frozenset({"repeated", "jump"})
_SORT = "Check the numbers of the files: sort them, and read the stack again."
_REPLACE = (
    "Look at these slices; put the right ones in their place, or read the stack without them."
)
_ADVICE: dict[Kind, str] = {
    "exchanged": _SORT,
    "moved": _SORT,
    "repeated": "Take the copies out of the stack, or put the right slices in their place.",
    "filled": "Put the measured slices in their place if there are any.",
    "foreign": _REPLACE,
    "empty": _REPLACE,
    "jump": (
        "Compare the number of slices with the scanner's log; give the missing ones or map either"
        " part alone."
    ),
}
# Of one slice, and of several.
_SENTENCES: dict[Kind, tuple[str, ...]] = {
    "exchanged": ("Slices {f.first} and {f.last} along {axis} are exchanged.",),
    "moved": (
        "Slices along {axis} are not in order: slice {f.first} does not follow {f.previous}, and"
        " slice {f.other} fits there.",
    ),
    "repeated": (
        "Slice {f.first} along {axis} is a copy of {f.sources}.",
        "Slices {f.first}-{f.last} along {axis} are copies of {f.sources}.",
    ),
    "filled": (
        "Slice {f.first} along {axis} is the mean of the neighbours, not measured.",
        "Slices {f.first}-{f.last} along {axis} are means of the neighbours, not measured.",
    ),
    "foreign": ("Slice {f.first} along {axis} does not fit between its neighbours.",),
    "empty": (
        "Slice {f.first} along {axis} shows nothing, while the neighbours do.",
        "Slices {f.first}-{f.last} along {axis} show nothing, while the neighbours do.",
    ),
    "jump": (
        "Between slices {f.first} and {f.last} along {axis} the specimen changes as if"
        " {f.missing} missing.",
    ),
}


@dataclass(frozen=True, slots=True)
class Fault:
    """Slices ``first`` to ``last`` are not what they should be.

    ``other``: of copies, the first slice that they repeat; of a slice that was moved, the slice
    that it is most like, or, where a jump shows it, the one that fits between it and the slice
    before. None for other kinds. A jump lies between its two slices; ``steps`` is the number of
    slices by which the body goes on too far there, NaN where it is not known.

    While the faults are searched, numbers count from the first slice of the `_Stack`;
    `find_faults` turns them into those of the volume.
    """

    kind: Kind
    first: int
    last: int
    other: int | None = None
    steps: float = np.nan

    @property
    def count(self) -> int:
        """Slices that are wrong; a jump counts as one."""
        return 1 if self.kind == "jump" else self.last - self.first + 1

    @property
    def previous(self) -> int:
        """Slice before the first one."""
        return self.first - 1

    @property
    def sources(self) -> str:
        """Name the slices that these repeat."""
        # Slices that all repeat one slice have no room for as many others.
        other = self.other
        if other is None or self.count == 1 or self.first - other < self.count:
            return f"{other}"
        return f"{other}-{other + self.count - 1}"

    @property
    def missing(self) -> str:
        """Say how many slices a jump leaves out."""
        if math.isnan(self.steps):
            return "several slices were"
        count = max(round(self.steps), 1)
        if count == 1:
            return "some 1 slice was"
        return f"some {count} slices were"

    def shifted(self, n: int) -> Fault:
        """Return the same fault where slices are counted from ``n`` slices before."""
        other = None if self.other is None else self.other + n
        return replace(self, first=self.first + n, last=self.last + n, other=other)


def slice_order(rule: CheckRule, scan: ScannedSheet, *, axis: Axis) -> Check:
    """Judge the slices along an axis.

    ``fail`` where out of order, ``look`` where repeated, filled, foreign, empty or missing; the
    value counts these. Of slices out of order the sentence names these faults alone, since others
    may come from them. Along the axis through the sheet brightness changes with the sheet itself.
    """
    window = scan.windows[axis]
    is_through = axis == scan.through
    is_assembled = axis in scan.assembled_axes
    faults = find_faults(window, assembled=is_assembled, levelled=not is_through)
    n_wrong = float(sum(f.count for f in faults))
    make_check = functools.partial(rule.check, value=n_wrong, limit=0.0, units="slices")
    if not faults:
        sentence = (
            f"None of {len(window.blocks)} slices along {axis} is seen to be exchanged, repeated,"
            " filled or missing."
        )
        return make_check("pass", sentence, figures=())
    order_faults = [f for f in faults if f.kind in _DISORDER]
    listed_faults = order_faults or faults
    kinds: list[Kind] = [f.kind for f in listed_faults]
    commonest_kind = max(dict.fromkeys(kinds), key=kinds.count)
    wrong_figures = {POSITION, PROPERTIES}
    # Heights that are wrong displace on every slope.
    if not order_faults and not is_through:
        wrong_figures = {POSITION if kind in _DISPLACING else PROPERTIES for kind in kinds}
    return make_check(
        "fail" if order_faults else "look",
        _sentence(listed_faults, len(faults), axis),
        advice=_ADVICE[commonest_kind],
        figures=(CORRELATION, *sorted(wrong_figures)),
    )


def _sentence(listed_faults: list[Fault], fault_count: int, axis: Axis) -> str:
    """Name the first four of the faults, and count the others.

    ``fault_count`` counts those too that are not listed.
    """
    sentences = [_fault_sentence(f, axis) for f in listed_faults[:4]]
    n_listed = len(listed_faults)
    if n_listed > 4:
        sentences.append(f"{n_listed - 4} more such places.")
    n_unlisted = fault_count - n_listed
    if n_unlisted:
        noun = "fault" if n_unlisted == 1 else "faults"
        sentences.append(f"{n_unlisted} other {noun} along the same axis.")
    return " ".join([*sentences, "Slices count from 0."])


def _fault_sentence(f: Fault, axis: Axis) -> str:
    of_one, *of_several = _SENTENCES[f.kind]
    template = of_one
    if of_several and f.last > f.first:
        template = of_several[0]
    return template.format(f=f, axis=axis)


def find_faults(window: Window, *, assembled: bool, levelled: bool) -> list[Fault]:
    """Find the faults of the slices of a window, in their order, by their numbers in the volume.

    ``assembled``: slices were put together from others, or are labels; only their order is looked
    at. ``levelled``: where slices differ in brightness, each is brought to the contrast of its
    neighbourhood first. Nothing is found at either end, nor a missing slice where the body hardly
    changes along the axis, or in strong noise.
    """
    # Slice by slice: in double precision, all of them would be twice as large as what is looked at.
    slice_sd = np.array([row.std(dtype=np.float64) for row in window.blocks])
    if not slice_sd.any():
        return []
    usual_sd = float(np.median(slice_sd[slice_sd > 0]))
    is_visible = slice_sd > _EMPTY * usual_sd
    visible_slices = np.flatnonzero(is_visible).tolist()
    if len(visible_slices) < 8:
        return []
    first = visible_slices[0]
    shown = slice(first, visible_slices[-1] + 1)
    if levelled and not assembled:
        levelled = level_jump(window) > _GAINS * float(np.median(slice_sd))
    stack = _Stack(window, shown, is_visible[shown], slice_sd[shown], levelled=levelled)
    if np.median(stack.d1) == 0:  # nothing changes along the axis
        return []
    _search(stack, _OF_ASSEMBLED if assembled else _OF_SCANS)
    faults: list[Fault] = []
    for fault in stack.faults:
        if assembled and fault.kind == "jump":
            continue  # between sections there are gaps, which are known
        faults.append(fault.shifted(window.first + first))
    return sorted(faults, key=lambda f: f.first)


class _Stack:
    """The slices of a window from the first to the last that shows anything."""

    def __init__(
        self, window: Window, shown: slice, is_visible: Bools, slice_sd: Floats, *, levelled: bool
    ) -> None:
        """Work out how the slices ``shown`` differ.

        ``is_visible`` and ``slice_sd`` (slices,) tell of each whether it shows anything, and how
        much its greys scatter. Differences are mean squares: ``d1`` (slices - 1,) of neighbours,
        ``d2`` (slices - 2,) of those with one slice between, both over blocks; ``square`` is
        ``d1`` and ``bend`` (slices - 2,) that of a slice from the mean of its neighbours, both
        over voxels, which tell a copy from what is only alike.
        """
        self.stored: Array = window.blocks[shown]  # (slices, rows, cols)
        slices = _levelled(self.stored, slice_sd) if levelled else self.stored
        self.s = _fine_structure(slices)
        self.d1 = _differences(self.s, 1)
        self.d2 = _differences(self.s, 2)
        # Means over voxels: within a block a gain changes next to nothing of how slices differ.
        # What the levelling changes of the blocks is changed of them, too.
        square = window.square[shown.start : shown.stop - 1]
        product = window.product[shown.start : shown.stop - 2]
        self.square = square + self.d1 - _differences(self.stored, 1)
        bend = (square[:-1] + square[1:] - 2 * product) / 4
        self.bend = bend + _bends(self.s) - _bends(self.stored)
        # Whether a slice shows anything; and neither it nor a neighbour has a fault that was found.
        self.is_visible = is_visible
        self.is_good = is_visible.copy()
        self.slice_sd = slice_sd
        self.faults: list[Fault] = []

    def usual_difference(self, k: int) -> float:
        """Give the usual difference of neighbours around slice ``k``."""
        return float(np.median(self.d1[max(k - 5, 0) : k + 6]))

    def differences_from(self, k: int, first: int = 0, stop: int | None = None) -> Floats:
        """Give the difference of every slice from slice ``k``."""
        return np.array([_square(a, self.s[k]) for a in self.s[first:stop]])

    def scatter(self, k: Ints) -> Floats:
        """Relative standard error of ``d1`` at ``k``."""
        fourth_powers: list[float] = []
        for i in k:
            step = np.subtract(self.s[i + 1], self.s[i], dtype=np.float64)
            fourth_powers.append(_square(step**2, 0.0))
        squares = np.maximum(self.d1[k] ** 2, _TINY)
        excess = np.array(fourth_powers) / squares - 1
        return np.sqrt(np.maximum(excess, 0) / self.s[0].size)

    def all_good(self, k: Ints, last: int) -> Bools:
        """Tell for each ``k`` if slices ``k - 1`` to ``k + last`` are all good."""
        are_good = [self.is_good[k + i] for i in range(-1, last + 1)]
        return np.logical_and.reduce(are_good)


def _fine_structure(slices: Array) -> Array:
    """Take off what is wider than fibres and pores.

    A knife or a row of the detector leaves long waves, of another course in each slice, and they
    say nothing about the order of the slices.
    """
    return slices - ndimage.uniform_filter(slices, (1, _FINE, _FINE))


def _levelled(stored: Array, slice_sd: Floats) -> NDArray[np.float32]:
    """Bring each slice to the contrast of its neighbourhood."""
    known_sd = np.maximum(slice_sd, _EMPTY * np.median(slice_sd))
    gain = (_around(slice_sd) / known_sd).astype(np.float32)
    return stored * gain[:, np.newaxis, np.newaxis]


def _around(values: Floats) -> Floats:
    """Mean of values around, without single ones that are unlike the others, and without steps."""
    medians = ndimage.median_filter(values, 2 * _AROUND + 1, mode="nearest")
    return ndimage.uniform_filter1d(medians, _AROUND)


def _bends(s: Array) -> Floats:
    """Mean squared difference of each inner slice from the mean of its neighbours."""
    means = (0.5 * (before + after) for before, after in zip(s, s[2:], strict=False))
    return np.array([*map(_square, means, s[1:])])


def _differences(s: Array, lag: int) -> Floats:
    """Mean squared difference of each slice from that which lies ``lag`` slices behind it."""
    # Slice by slice: temporary arrays as large as the stack cost more than the sums.
    return np.array([*map(_square, s[lag:], s[:-lag])])


def _square(a: Array, b: Array | float) -> float:
    """Mean squared difference of two slices, in double precision; they are stored in single."""
    d = np.subtract(a, b, dtype=np.float64)
    return float(np.vdot(d, d)) / d.size


def _log(differences: Floats) -> Floats:
    return np.log(np.maximum(differences, _TINY))


def _empty(t: _Stack) -> Iterator[Fault]:
    """Slices that show nothing, between such that show the body."""
    # The first and the last slice of a stack show something.
    edges = np.flatnonzero(np.diff(t.is_visible)) + 1
    usual = _FULL * float(np.median(t.slice_sd))
    for first, stop in edges.reshape(-1, 2).tolist():
        if min(t.slice_sd[first - 1], t.slice_sd[stop]) > usual:
            yield Fault("empty", first, stop - 1)


def _foreign(t: _Stack) -> Iterator[Fault]:
    """Slices that differ from both neighbours by more than these from each other.

    Each may be a copy of another slice (``repeated``), fit elsewhere (``moved``; ``other`` is the
    slice that is most like it), or be of another body. Of two copies, one is named.
    """
    indices = np.arange(1, t.d1.size)
    smaller = np.minimum(t.d1[:-1], t.d1[1:])
    ratio = smaller / np.maximum(t.d2, _TINY)
    is_odd = (ratio > FOREIGN) & t.all_good(indices, 1)
    copied: set[int] = set()
    for k in indices[is_odd].tolist():
        differences = t.differences_from(k)
        differences[max(k - 2, 0) : k + 3] = np.inf
        nearest = int(differences.argmin())
        is_copy = np.array_equal(t.stored[k], t.stored[nearest])
        if is_copy and nearest in copied:
            continue
        copied.add(k)
        if is_copy:
            yield Fault("repeated", k, k, other=nearest)
        elif differences[nearest] < _FITS * t.usual_difference(nearest):
            yield Fault("moved", k, k, other=nearest)
        else:
            yield Fault("foreign", k, k)


def _copies(t: _Stack) -> Iterator[Fault]:
    """Slices of which every block mean is that of an earlier one.

    Neighbours at the same distance are one fault. Slices that were found to be copies before, and
    what they repeat, are left alone.
    """
    copied: set[int | None] = set()
    for fault in t.faults:
        if fault.kind == "repeated":
            copied |= {fault.first, fault.other}
    first_indices: dict[bytes, int] = {}  # of the first slice with such bytes
    sources: dict[int, int] = {}  # of a copy: the first slice that it repeats
    for k in np.flatnonzero(t.is_visible).tolist():
        if k not in copied:
            source = first_indices.setdefault(t.stored[k].tobytes(), k)
            if source < k:
                sources[k] = source
    last = -1
    for first, source in sources.items():
        if first <= last:
            continue
        last = first
        # The same slice over and over, or one slice after the other.
        while sources.get(last + 1) in (source, source + last + 1 - first):
            last += 1
        yield Fault("repeated", first, last, other=source)


def _exchanged(t: _Stack) -> Iterator[Fault]:
    """Pairs of neighbours that fit better the other way round.

    Slices k and k + 1 are exchanged where each differs more from its neighbour beyond the pair
    than the other one does from that: `EXCHANGED` times, and more than chance makes.
    """
    k = np.arange(1, t.d1.size - 1)
    before, inside, behind = t.d1[:-2], t.d1[1:-1], t.d1[2:]  # of a pair of neighbours
    crossed = np.maximum(t.d2[:-1], t.d2[1:])
    smaller = np.minimum(before, behind)
    limit = np.maximum(EXCHANGED, 1 + _SIGMA * t.scatter(k))
    ratio = smaller / np.maximum(crossed, _TINY)
    is_exchanged = ratio > limit
    # Where pair after pair is exchanged, the first of one pair is next to the last of the other.
    d3 = _differences(t.s, 3)
    largest = np.max([before, behind, d3], axis=0)
    pairs = np.flatnonzero(inside > limit * largest)
    beside = np.concatenate([pairs - 2, pairs + 2])
    pairs = pairs[np.isin(pairs, beside)]
    is_exchanged |= np.isin(k, pairs) | np.isin(k, pairs + 2)
    is_exchanged &= t.all_good(k, 2)
    last = -1
    for first in k[is_exchanged].tolist():
        if first > last:
            last = first + 1
            yield Fault("exchanged", first, last)


def _dips(curve: Floats, is_good: Bools, slices: int, depth: float) -> list[tuple[int, int]]:
    """Runs (first, last) of a curve that lie by ``depth`` below their neighbours and the median.

    The curve (m,) is of statistics that ``slices`` slices make each: all of those of a run and of
    its neighbours have to be good. The median is that of 12 values on either side.
    """
    dips: list[tuple[int, int]] = []
    k = 1
    while k < curve.size - 1:
        for last in range(k, min(k + _RUN, curve.size - 1)):
            limit = curve[k : last + 1].max() + depth
            if min(curve[k - 1], curve[last + 1]) <= limit:
                continue
            around = curve[max(k - 12, 0) : last + 13]
            all_good = is_good[k - 1 : last + 1 + slices].all()
            if all_good and np.median(around) > limit:
                dips.append((k, last))
                k = last
                break
        k += 1
    return dips


def _near_copies(t: _Stack) -> Iterator[Fault]:
    """Slices that differ so little from the one before as only a copy of it does."""
    for a, b in _dips(_log(t.square), t.is_good, 2, ALIKE):
        yield Fault("repeated", a + 1, b + 1, other=a)


def _filled(t: _Stack) -> Iterator[Fault]:
    """Slices that are the mean of their neighbours, or lie on a straight line between two."""
    for a, b in _dips(_log(t.bend), t.is_good, 3, FILLED):
        across = _square(t.s[b + 2], t.s[a])  # from the slice before them to the one behind
        # Otherwise all of them are copies.
        if across > _COPY * t.usual_difference(a):
            yield Fault("filled", a + 1, b + 1)


def _far_copies(t: _Stack) -> Iterator[Fault]:
    """Blocks of slices that were there before, with noise or compression of their own.

    A jump leads back to them. Slice k, behind a jump, is a copy where some earlier one differs from
    it by less than half of what neighbours do; the copies go on as long as that holds.
    """
    log = _log(t.d1)
    for k in range(2, len(t.s) - 1):
        # A jump may lead back where ln d1 rises above its median; by 64 slices at most.
        around = log[max(k - 6, 0) : k + 5]
        rise = log[k - 1] - np.median(around)
        if rise < 0.25 or not t.is_good[k - 1 : k + 1].all():
            continue
        earliest = max(k - 64, 0)
        differences = t.differences_from(k, earliest, k - 1)
        source = int(differences.argmin()) + earliest
        usual = min(t.usual_difference(k - 1), t.usual_difference(source))
        limit = _COPY * usual
        if differences.min() < limit:
            is_copy = _differences(t.s[source : k + 64], k - source) < limit
            count = int(np.argmin(np.append(is_copy, False)))  # up to the first that is none
            yield Fault("repeated", k, k + count - 1, other=source)


def _jumps(t: _Stack) -> Iterable[Fault]:
    """Places where the body goes on by more than a slice: what is missing, or lies elsewhere.

    A jump lies between slices k and k + 1 where ln d1 rises above that of both pairs beside it.
    """
    log = _log(t.d1)
    k = np.arange(1, t.d1.size - 1)
    limit = np.maximum(JUMP, _SIGMA * t.scatter(k))
    rise = log[k] - np.maximum(log[k - 1], log[k + 1])
    is_jump = (rise > limit) & t.all_good(k, 2)
    faults: list[Fault] = []
    for index in k[is_jump].tolist():
        if not t.is_good[index]:
            continue
        # Of the squared difference: a jump beyond it in the sorted greys is an edge of the sheet,
        # no fault.
        largest_ratio = 0.5 if rise[index - 1] > 1.2 else 0.3
        sorted_slices = [np.sort(t.s[i], axis=None) for i in (index, index + 1)]
        sorted_difference = _square(*sorted_slices)
        if sorted_difference < largest_ratio * t.d1[index]:
            fault = _jump(t, index)
            faults.append(fault)
            t.is_good[fault.first : fault.last + 1] = False
    return faults


def _jump(t: _Stack, k: int) -> Fault:
    """Name the fault at a jump between slices k and k + 1.

    One of them fits elsewhere, or slices are missing. It fits where the slice that is most like it
    (but for its own neighbours) differs from it as neighbours do, and has a place free beside it.

    Whichever of the two it is, the fault ``moved`` names slice k + 1; ``other`` is the slice that
    is most like one of them, and so fits between both. Numbers are those of the stack.
    """
    from_next = t.differences_from(k + 1)
    from_slice = t.differences_from(k)
    from_next[k : k + 4] = np.inf
    from_slice[max(k - 2, 0) : k + 2] = np.inf
    differences = from_next if from_next.min() < from_slice.min() else from_slice
    nearest = int(differences.argmin())
    usual = min(t.usual_difference(k), t.usual_difference(nearest))
    if differences[nearest] < min(_FITS * usual, 0.6 * t.d1[k]):
        # That slice is at an end of the stack, or does not continue a neighbour of its own.
        around = t.d1[max(nearest - 4, 0) : nearest + 4]
        limit = 1.3 * np.median(around)
        is_at_end = nearest in (0, t.d1.size)
        if is_at_end or t.d1[nearest - 1 : nearest + 1].max() > limit:
            return Fault("moved", k + 1, k + 1, other=nearest)
    return Fault("jump", k, k + 1, steps=_missing_steps(t, k))


def _missing_steps(t: _Stack, k: int) -> float:
    """Slices by which the body goes on too far between slices k and k + 1; NaN beyond 20.

    As far apart slices beside the jump must be to differ as much: the lag, between whole ones, at
    which the median difference of 40 slices on either side reaches that of the jump.
    """
    before = t.s[max(k - 40, 0) : k + 1]
    after = t.s[k + 1 : k + 42]
    jump_difference = float(t.d1[k])
    previous_median = 0.0
    for lag in range(1, 21):
        parts = [part for part in (before, after) if len(part) > lag + 2]
        lag_differences = [_differences(part, lag) for part in parts]
        median = float(np.median(np.concatenate(lag_differences))) if parts else 0.0
        if median >= jump_difference:
            beyond = median - jump_difference
            return lag - beyond / max(median - previous_median, _TINY) - 1.0
        previous_median = median
    return np.nan


_OF_SCANS = (_empty, _foreign, _copies, _exchanged, _filled, _near_copies, _far_copies, _jumps)
_OF_ASSEMBLED = (_foreign, _exchanged, _jumps)


def _search(t: _Stack, finders: Iterable[Callable[[_Stack], Iterable[Fault]]]) -> None:
    """Find faults of one kind after the other; beside one no other is looked for."""
    for find_kind in finders:
        for fault in find_kind(t):
            t.faults.append(fault)
            t.is_good[max(fault.first - 1, 0) : fault.last + 2] = False
