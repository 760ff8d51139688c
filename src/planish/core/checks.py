"""One check of a result: what was found, against which limit, what it means for which figures, and what to do."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, Self

from pydantic import Field

from planish.core.facts import Facts, Number

State = Literal["pass", "look", "fail", "unknown"]
"""``look``: the figures are doubtful; ``fail``: they are wrong and withheld; ``unknown``: nothing can be said."""

PROPERTIES = "properties"
POSITION = "position"
CORRELATION = "correlation"
"""Figures beside single maps: all maps of a sheet, the place of a pixel, all that is computed from linked layers."""


class Check(Facts):
    """Result of one check.

    A stage that knows one layer only leaves ``layers`` empty.
    """

    name: str = Field(description="Short and unique in a run, as 'slices along z'.")
    state: State = Field(description="pass, look, fail or unknown.")
    sentence: str = Field(description="What was found; with unknown, why nothing can be said.")
    value: Number = Field(default=None, description="What was compared.")
    limit: Number = Field(default=None, description="The limit that the state was judged by.")
    units: str = Field(default="", description="Of value and limit; 'share' for a part of 1.")
    advice: str = Field(default="", description="What to do; empty where nothing has to be done.")
    figures: tuple[str, ...] = Field(
        default=(), description="What it concerns: names of maps, or properties, position, correlation."
    )
    layers: tuple[str, ...] = Field(default=(), description="Layers that it is about.")

    @classmethod
    def at_most(
        cls, name: str, value: float, *, look: float | None = None, fail: float | None = None, sentence: str,
        units: str = "", advice: str = "", figures: tuple[str, ...] = (),
    ) -> Self:  # fmt: skip
        """Judge a value that should be small; advice is dropped where it passes. NaN passes nothing and is a look."""
        state, limit = _judged(value, look, fail)
        return cls(
            name=name, state=state, sentence=sentence, value=float(value), limit=limit, units=units, figures=figures,
            advice="" if state == "pass" else advice,
        )  # fmt: skip

    @classmethod
    def at_least(
        cls, name: str, value: float, *, look: float | None = None, fail: float | None = None, sentence: str,
        units: str = "", advice: str = "", figures: tuple[str, ...] = (),
    ) -> Self:  # fmt: skip
        """Judge a value that should be large."""
        state, limit = _judged(-value, *(None if k is None else -k for k in (look, fail)))
        return cls(
            name=name, state=state, sentence=sentence, value=float(value), limit=None if limit is None else -limit,
            units=units, figures=figures, advice="" if state == "pass" else advice,
        )  # fmt: skip


def concerned(checks: Iterable[Check], layers: Iterable[str], figures: Iterable[str]) -> list[Check]:
    """The checks about one of ``layers`` that concern one of ``figures``; ``properties`` are all maps of a sheet."""
    wanted, names = {*figures}, {*layers}
    if wanted - {POSITION, CORRELATION}:
        wanted.add(PROPERTIES)
    return [c for c in checks if wanted & {*c.figures} and (not c.layers or names & {*c.layers})]


def _judged(value: float, look: float | None, fail: float | None) -> tuple[State, float | None]:
    """State of a value that should be small, and the limit that decided."""
    if fail is not None and value > fail:
        return "fail", fail
    if look is not None and not value <= look:
        return "look", look
    return "pass", look if look is not None else fail
