"""Checks of the slices: names of their faults, how grave they are, and which figures they concern."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence

from planish.checks.slices import Fault, find_faults
from planish.checks.windows import Window
from planish.core.checks import CORRELATION, POSITION, PROPERTIES, Check
from planish.core.frame import Axis

_NAMED = 4  # faults that a sentence names
_ADVICE = {
    "order": "Check the numbers of the files: sort them, and read the stack again.",
    "repeated": "Take the copies out of the stack, or put the right slices in their place.",
    "filled": "Put the measured slices in their place if there are any.",
    "foreign": "Look at these slices; put the right ones in their place, or read the stack without them.",
    "jump": "Compare the number of slices with the scanner's log; give the missing ones or map either part alone.",
}


def slice_checks(windows: Iterable[Window], *, through: Axis, assembled: Collection[Axis] = ()) -> tuple[Check, ...]:
    """Judge the slices along every axis; those along ``assembled`` axes were put together by planish, or are labels.

    Returns
    -------
    tuple of Check
        One for each axis: ``fail`` where slices are not in their order, ``look`` where some are repeated, filled,
        foreign, empty or missing. ``value`` is the number of slices, or breaks, that are concerned.
    """
    return tuple(
        axis_check(w.axis, find_faults(w, assembled=w.axis in assembled), slices=len(w.blocks), through=through)
        for w in windows
    )


def axis_check(axis: Axis, faults: Sequence[Fault], *, slices: int, through: Axis) -> Check:
    """Judge the faults along one axis."""
    name = f"slices along {axis}"
    if not faults:
        return Check(
            name=name, state="pass", value=0.0, limit=0.0, units="slices",
            sentence=f"None of {slices} slices along {axis} is seen to be exchanged, repeated, filled or missing.",
        )  # fmt: skip
    kinds = {f.kind for f in faults}
    order = [f for f in faults if f.kind in ("exchanged", "moved")]
    listed = order or faults
    sentences = [_sentence(f, axis) for f in listed[:_NAMED]]
    if len(listed) > _NAMED:
        sentences.append(f"{len(listed) - _NAMED} more such places.")
    if len(listed) < len(faults):
        unlisted = len(faults) - len(listed)
        sentences.append(f"{unlisted} other {'fault' if unlisted == 1 else 'faults'} along the same axis.")
    figures = {CORRELATION}
    if order or axis == through or kinds & {"filled", "foreign", "empty"}:
        figures.add(PROPERTIES)
    if order or axis == through or kinds & {"repeated", "jump"}:  # heights that are wrong displace on every slope
        figures.add(POSITION)
    advice = _ADVICE["order" if order else _advice_of(faults)]
    count = sum(1 if f.kind == "jump" else f.count for f in faults)
    return Check(
        name=name, state="fail" if order else "look", value=float(count),
        limit=0.0, units="slices", sentence=" ".join(sentences) + " Slices count from 0.", advice=advice,
        figures=tuple(sorted(figures)),
    )  # fmt: skip


def _advice_of(faults: Sequence[Fault]) -> str:
    kinds = [f.kind for f in faults]
    most = max(dict.fromkeys(kinds), key=kinds.count)
    return "foreign" if most == "empty" else most


def _sentence(f: Fault, axis: Axis) -> str:
    which = f"Slices {f.first}-{f.last}" if f.count > 1 else f"Slice {f.first}"
    several = f.count > 1
    match f.kind:
        case "exchanged":
            return f"Slices {f.first} and {f.last} along {axis} are exchanged."
        case "moved":
            return (
                f"Slices along {axis} are not in order: slice {f.first} does not follow {f.first - 1}, "
                f"and slice {f.other} fits there."
            )
        case "repeated":
            assert f.other is not None
            # Slices that all repeat one slice have no room for as many others.
            source = f"{f.other}-{f.other + f.count - 1}" if several and f.first - f.other >= f.count else f"{f.other}"
            return f"{which} along {axis} {'are copies' if several else 'is a copy'} of {source}."
        case "filled":
            return f"{which} along {axis} {'are means' if several else 'is the mean'} of the neighbours, not measured."
        case "foreign":
            return f"{which} along {axis} does not fit between its neighbours."
        case "empty":
            return f"{which} along {axis} {'show' if several else 'shows'} nothing, while the neighbours do."
        case "jump":
            far = "several" if math.isnan(f.steps) else f"some {max(round(f.steps), 1)}"
            return (
                f"Between slices {f.first} and {f.last} along {axis} the specimen changes as if {far} "
                f"{'slice was' if far == 'some 1' else 'slices were'} missing."
            )
