"""What the registration can promise, in words: how it was made, how things lie, what the maps themselves say of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

from planish.report.text import NONE, capital, length, number, typeset

Row = dict[str, Any]

MARKS_ONLY = "registration: marks only"
"""Stands beside every correlation of a run that does not say how its maps were registered."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """What a check says that is no gate.

    Attributes
    ----------
    state : {"agrees", "amber", "grey"}
        Its light: nothing wrong, to be looked at, no answer.
    word : str
        The same for readers who do not see colours.
    name, sentence : str
        What is checked, and what was found.
    meaning : str
        What that means for the numbers of the page.
    """

    state: Literal["agrees", "amber", "grey"]
    word: str
    name: str
    sentence: str
    meaning: str


def registered(results: Row) -> str:
    """Say how the maps of a correlation were registered."""
    kind = str(results.get("registration_kind") or MARKS_ONLY)
    return kind if kind.startswith("registration") else f"registration: {kind}"


def lag_check(told: Row | None, *, first: str, second: str, name: str = "maps against marks") -> Check | None:
    """Say what the lag of two maps means; None where none was looked for.

    Parameters
    ----------
    told : dict or None
        ``sentence``, ``agrees``, ``length_um``, ``se_um``, ``expected_um`` of the lag.
    first, second : str
        What the two maps show, in words.
    name : str
        What is checked.
    """
    if not told:
        return None
    sentence = capital(typeset(str(told.get("sentence", ""))))
    sentence = sentence if sentence.endswith(".") else f"{sentence}."
    agrees = told.get("agrees")
    start = f"The fine patterns of {first} and of {second} were laid on each other without a look at the marks. "
    if agrees is None:
        why = (
            "There is no expected error of the marks to compare it with."
            if told.get("length_um") is not None
            else "It speaks neither for nor against the registration: what is known of its error is what the marks say."
        )
        return Check(
            state="grey", word=" says nothing", name=name, sentence=sentence,
            meaning=f"{start}That gives no answer here. {why}",
        )  # fmt: skip
    if agrees:
        width = math.hypot(*(float(v) for v in told.get("se_um") or ()))
        if width > float(told.get("expected_um") or math.inf):
            end = (
                f"They lie together, but show their place less exactly than the marks do: an error of up to about "
                f"{length(2 * width, 2)} would not be noticed."
            )
        else:
            end = "They lie together as closely as the marks promise: the check finds nothing wrong."
        return Check(state="agrees", word=" agrees", name=name, sentence=sentence, meaning=f"{start}{end}")
    return Check(
        state="amber", word=" to be looked at", name=name, sentence=sentence,
        meaning=(
            f"{start}Until it is settled which of the two it is, a place is known to about "
            f"{length(told.get('length_um'), 2)} and no better."
        ),
    )  # fmt: skip


def lag_rows(told: Row | None) -> list[tuple[str, str]]:
    """Return a lag in numbers, as rows of a table of facts."""
    if not told or told.get("length_um") is None:
        return []
    x, y = (f"{number(v, 2)} ± {number(s, 2)}" for v, s in zip(told["lag_um"], told["se_um"], strict=True))
    rows = [("Lag of the maps (x, y), ± standard error", f"({x}, {y}) µm")]
    fine, coarse = told.get("lags_of_bands_um") or [None, None]
    if told.get("split_um") is not None and fine and coarse:
        parts = [
            NONE if None in part else f"({number(part[0], 2)}, {number(part[1], 2)}) µm" for part in (fine, coarse)
        ]
        rows.append((f"Lag of the texture finer and coarser than {length(told['split_um'])}", " and ".join(parts)))
    return rows


def orientation(results: Row) -> str:
    """Say which side the image shows and where the machine direction lies; empty for runs that do not know."""
    return typeset(str((results.get("orientation") or {}).get("sentence") or ""))


def axis_in_image(
    results: Row, *, moving: str = "the volume", fixed: str = "the image"
) -> tuple[float, str] | None:  # fmt: skip
    """Return the machine direction in the image in degrees, and where it is known from; None where it is not."""
    told = results.get("orientation") or {}
    for key, source in (
        ("md_deg_image", f"given for {fixed}"),
        ("md_deg_image_from_map", f"carried over from {moving}"),
    ):
        if told.get(key) is not None:
            return float(told[key]), source
    return None


def match_sentences(marks: Row | None, refinement: Row | None = None) -> list[str]:
    """Return what is said of the match: the match itself, the design of the marks, the tilt of their holes.

    And of a refinement by the maps themselves, if there was one: what it moved, and a correlation that it has not made.
    """
    told = marks or {}
    parts = [told, *(told.get(key) or {} for key in ("design", "tilt"))]
    found = [part.get("sentence") for part in parts if isinstance(part, dict)]
    if refinement:
        r = refinement["correlation"]
        found.append(
            f"Refined by the maps themselves, in the group 'refined': {refinement['sentence']} {r['sentence']} "
            f"(waves below {refinement['longest_wave_um']:g} um). All other correlations here rest on the marks."
        )
        found += refinement["warnings"]
    return [typeset(str(text)) for text in found if text]
