"""The table of kinds of wrong input: a name, what was done, and a function that does it to a right case."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.wrong.case import Case

Change = Callable[[Case, np.random.Generator], None]


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of input; ``grave`` ones ought to fail, ``hidden`` ones cannot be told and are counted apart.

    ``answer`` is the check whose ``unknown`` is about this fault: it says why it cannot be told.
    """

    name: str
    title: str
    change: Change
    grave: bool = False
    hidden: str = ""
    answer: str = ""
    order: dict[str, Any] = field(default_factory=dict[str, Any])


KINDS: dict[str, Kind] = {}


def kind(
    name: str, title: str, *, grave: bool = False, hidden: str = "", answer: str = "", **order: Any
) -> Callable[[Change], Change]:  # fmt: skip
    """Enter a function into the table."""

    def enter(change: Change) -> Change:
        KINDS[name] = Kind(
            name=name, title=title, change=change, grave=grave, hidden=hidden, answer=answer, order=order
        )
        return change

    return enter


def enter(name: str, title: str, change: Change, **more: Any) -> None:
    """Enter a function that was made elsewhere."""
    kind(name, title, **more)(change)
