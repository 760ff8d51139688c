"""A dry run of a stage program: what would be fired, where, for how long, and whether it is safe to start.

The program is read as text and knows nothing of the pattern it came from; whatever is not in the dialect is refused.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import MarkError

Array = NDArray[np.float64]

_WORD = re.compile(r"([A-Z])\s*([+-]?(?:\d+\.?\d*|\.\d+))")
_COMMANDS = {
    "G": {0: "XYF", 1: "XYF", 4: "P", 21: "", 90: ""},
    "M": {2: "", 3: "S", 5: "", 30: "", 64: "P", 65: "P"},
}
_KNOWN = "G0, G1, G4, G21, G90, M2, M3, M5, M30, M64, M65 with X, Y, F, P, S"
_SAME_UM = 1.0  # two shots so close together go through one hole


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What the stage can do, and what would be a fire rather than a hole.

    Attributes
    ----------
    range_um : (x0, y0, x1, y1)
        Range of the stage.
    pulse_s : float
        Longest pulse.
    """

    range_um: tuple[float, float, float, float] = (0.0, 0.0, 100_000.0, 100_000.0)
    pulse_s: float = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class DryRun:
    """What a program does.

    Attributes
    ----------
    fired_um : (n, 2)
        Positions of the shots in the order in which they are fired.
    pulse_s : (n,)
        How long the laser is on at each.
    path_um : (m, 2)
        Corners of the path, from the first position the program names.
    least_pause_s : float
        Shortest time that the laser is off between two shots; NaN for a single shot.
    time_s : float
        Moves at the speed of the program and all waits; the stage's acceleration adds to it.
    """

    fired_um: Array
    pulse_s: Array
    path_um: Array
    least_pause_s: float
    time_s: float

    @property
    def length_um(self) -> float:
        """Length of the path."""
        return float(np.sum(np.hypot(*np.diff(self.path_um, axis=0).T)))

    def sentence(self) -> str:
        """Say it in a line."""
        pulses = f"{1000 * self.pulse_s.min():g}"
        if np.ptp(self.pulse_s) > 1e-9:
            pulses += f" to {1000 * self.pulse_s.max():g}"
        return (
            f"{len(self.fired_um)} shots of {pulses} ms, path {self.length_um / 1000:.1f} mm, {self.time_s:.1f} s "
            "without the stage's acceleration"
        )


def dry_run(program: str, limits: Limits | None = None) -> DryRun:
    """Run a stage program without a stage.

    Parameters
    ----------
    program : str
        The text of the program, in the dialect of :mod:`planish.marks.design.gcode`.
    limits : Limits, optional

    Raises
    ------
    MarkError
        If a word is not known, a move leaves the stage's range or is made with the laser on, the laser stays on at the
        end, a pulse is too long or has no length, or the program does not end; the message names the line.
    """
    state = _State(limits or Limits())
    for number, line in enumerate(program.splitlines(), 1):
        text = re.sub(r"\([^()]*\)", " ", line.partition(";")[0]).strip().upper()
        if not text or text == "%":
            continue
        if state.ended:
            raise _fault(number, line, "the program goes on after its end; remove what follows M2")
        try:
            state.take(_words(text))
        except MarkError as error:
            raise _fault(number, line, str(error)) from error
    return state.result()


@dataclass
class _State:
    limits: Limits
    place: tuple[float | None, float | None] = (None, None)
    speed: float | None = None
    metric: bool = False
    absolute: bool = False
    ended: bool = False
    motion: int | None = None
    on: str = ""  # the command that switched the laser on
    lit_s: float = 0.0
    clock_s: float = 0.0
    off_at_s: float | None = None
    path: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    fired: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    pulses: list[float] = field(default_factory=list[float])
    pauses: list[float] = field(default_factory=list[float])

    def take(self, words: list[tuple[str, float]]) -> None:
        """Carry out one line."""
        commands = [(letter, _whole(letter, value)) for letter, value in words if letter in _COMMANDS]
        values = {letter: value for letter, value in words if letter not in _COMMANDS}
        if len(values) + len(commands) != len(words):
            raise MarkError("a letter is given twice")
        if sum((letter, code) not in (("G", 21), ("G", 90)) for letter, code in commands) > 1:
            raise MarkError("two commands stand in one line; give each a line of its own")
        allowed = "".join(_COMMANDS[letter][code] for letter, code in commands)
        if not commands:
            allowed = "XYF" if self.motion is not None else "F"
        foreign = [letter for letter in values if letter not in allowed]
        if foreign:
            raise MarkError(f"{foreign[0]} has no meaning here")
        if "F" in values:
            if values["F"] <= 0:
                raise MarkError("the speed F is not positive")
            self.speed = values["F"]
        for letter, code in commands:
            self._command(letter, code, values)
        if not commands and ("X" in values or "Y" in values):
            self._move(values)

    def _command(self, letter: str, code: int, values: dict[str, float]) -> None:
        match letter, code:
            case "G", 21:
                self.metric = True
            case "G", 90:
                self.absolute = True
            case "G", (0 | 1):
                self.motion = code
                if "X" in values or "Y" in values:
                    self._move(values)
                elif "F" not in values:
                    raise MarkError("a move without a position")
            case "G", _:
                self._wait(values)
            case "M", (3 | 64):
                self._switch_on(f"M{code}", values)
            case "M", (5 | 65):
                self._switch_off(f"M{code}", values)
            case _:
                if self.on:
                    raise MarkError("the program ends with the laser on; switch it off before")
                self.ended = True

    def _move(self, values: dict[str, float]) -> None:
        if not (self.metric and self.absolute):
            raise MarkError("a move before G21 (millimetres) and G90 (absolute positions)")
        if self.on:
            raise MarkError("a move with the laser on; it would cut the sheet")
        here = self.place
        there = tuple(
            1000 * values[letter] if letter in values else old for letter, old in zip("XY", here, strict=True)
        )
        for letter, value, low, high in zip(
            "XY", there, self.limits.range_um[:2], self.limits.range_um[2:], strict=True
        ):
            if value is not None and not low - 1e-3 <= value <= high + 1e-3:
                raise MarkError(
                    f"{letter} {value / 1000:g} mm is out of the stage's range, {low / 1000:g} to {high / 1000:g} mm; "
                    "move the origin or give the stage's own range"
                )
        self.place = (there[0], there[1])
        x, y = self.place
        if x is None or y is None:
            return
        if here[0] is not None and here[1] is not None:
            if self.speed is None:
                raise MarkError("a move before a speed F")
            self.clock_s += 60 * math.hypot(x - here[0], y - here[1]) / 1000 / self.speed
        self.path.append((x, y))

    def _wait(self, values: dict[str, float]) -> None:
        if values.get("P", -1.0) < 0:
            raise MarkError("G4 needs a time P in seconds")
        self.clock_s += values["P"]
        if self.on:
            self.lit_s += values["P"]
            if self.lit_s > self.limits.pulse_s + 1e-12:
                raise MarkError(
                    f"a pulse of {self.lit_s:g} s is longer than {self.limits.pulse_s:g} s and would burn the sheet; P "
                    "is in seconds"
                )

    def _switch_on(self, code: str, values: dict[str, float]) -> None:
        x, y = self.place
        if x is None or y is None:
            raise MarkError("the laser fires before both X and Y are known")
        if code == "M64" and "P" not in values:
            raise MarkError("M64 needs the number P of the output")
        if self.on:
            raise MarkError("the laser is on already")
        if any(math.hypot(x - a, y - b) < _SAME_UM for a, b in self.fired):
            raise MarkError(f"a second shot at X {x / 1000:g} Y {y / 1000:g} mm")
        self.on, self.lit_s = code, 0.0
        if self.off_at_s is not None:
            self.pauses.append(self.clock_s - self.off_at_s)
        self.fired.append((x, y))

    def _switch_off(self, code: str, values: dict[str, float]) -> None:
        if code == "M65" and "P" not in values:
            raise MarkError("M65 needs the number P of the output")
        if not self.on:
            return  # a program may make sure that the laser is off
        if {"M3": "M5", "M64": "M65"}[self.on] != code:
            raise MarkError(f"{code} does not switch off what {self.on} switched on")
        if self.lit_s <= 0:
            raise MarkError("a pulse without a length; put G4 P between on and off")
        self.on = ""
        self.off_at_s = self.clock_s
        self.pulses.append(self.lit_s)

    def result(self) -> DryRun:
        """Return what was done, if the program is whole."""
        if self.on:
            raise MarkError("The program stops with the laser on. Add the command that switches it off, and M2.")
        if not self.ended:
            raise MarkError("The program has no end, M2 or M30; it may have been cut off. Write it again.")
        if not self.fired:
            raise MarkError("The program fires no shot. Give a stage program of 'planish marks design'.")
        return DryRun(
            fired_um=np.array(self.fired),
            pulse_s=np.array(self.pulses),
            path_um=np.array(self.path),
            least_pause_s=min(self.pauses, default=math.nan),
            time_s=self.clock_s,
        )


def _words(text: str) -> list[tuple[str, float]]:
    """Split a line into letters and numbers."""
    words: list[tuple[str, float]] = []
    at = 0
    while at < len(text):
        found = _WORD.match(text, at)
        if found is None:
            raise MarkError(f"{text[at : at + 20]!r} is not in the dialect ({_KNOWN})")
        if found[1] != "N":  # the number of a line
            words.append((found[1], float(found[2])))
        at = found.end()
        at += len(text[at:]) - len(text[at:].lstrip())
    return words


def _whole(letter: str, value: float) -> int:
    if value != int(value) or int(value) not in _COMMANDS[letter]:
        raise MarkError(f"{letter}{value:g} is not known; the dialect has {_KNOWN}")
    return int(value)


def _fault(number: int, line: str, what: str) -> MarkError:
    return MarkError(f"Line {number} of the program ({line.strip()[:60]!r}) is refused: {what}.")
