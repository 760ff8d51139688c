"""The table of kinds of wrong input: a name, what was done, and a function that does it to a right
case."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.wrong.case import Case


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of input; ``grave`` ones ought to fail, ``hidden`` ones cannot be told and are counted
    apart.

    ``answer`` is the check whose ``unknown`` is about this fault: it says why it cannot be told.
    """

    name: str
    title: str
    change: Callable[[Case, np.random.Generator], object]
    grave: bool = False
    hidden: str = ""
    answer: str = ""
    order: dict[str, Any] = field(default_factory=dict)


KINDS = {}


def enter(name, title, change, *, grave=False, hidden="", answer="", **order):
    """Enter a function into the table."""
    KINDS[name] = Kind(
        name=name,
        title=title,
        change=change,
        grave=grave,
        hidden=hidden,
        answer=answer,
        order=order,
    )


def kind(name, title, *, size=None, **more):
    """Enter the function below; with ``size``, a range and its unit, it is given a strength from
    there."""

    def entered(change):
        enter(name, title, sized(change, *size) if size else change, **more)
        return change

    return entered


def sized(change, low, high, unit):
    """A change of a strength that is drawn evenly, and noted."""

    def strong(case, rng):
        size = rng.uniform(low, high)
        case.note = f"{size:.3g} {unit}"
        change(case, rng, size)

    return strong


def both(*changes):
    """One change after the other."""

    def in_turn(case, rng):
        for change in changes:
            change(case, rng)

    return in_turn


def told(group, **values):
    """Something said on the command line."""
    return lambda case, _: case.option(group, **values)


def along_either(change):
    """Along y or x, as it is drawn."""

    def along(case, rng):
        axis = int(rng.integers(1, 3))
        change(case, rng, axis)
        case.note += f" along {'zyx'[axis]}"

    return along
