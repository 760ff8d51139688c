"""A dry run of a stage program: what would be fired, where, for how long, and whether it is safe to start.

The program is read as text and knows nothing of the pattern it came from; whatever is not in the dialect is refused.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from planish.core.errors import MarkError
from planish.core.typing import Floats
from planish.marks.design.params import StageParams

_WORD = re.compile(r"\s*([A-Z])\s*([+-]?(?:\d+\.?\d*|\.\d+))\s*")
# Commands, and the words that may stand beside them.
_COMMANDS = {
    "G0": "XYF", "G1": "XYF", "G4": "P", "G21": "", "G90": "",
    "M2": "", "M3": "S", "M5": "", "M30": "", "M64": "P", "M65": "P",
}  # fmt: skip
_KNOWN = f"{', '.join(_COMMANDS)} with X, Y, F, P, S"
_OFF = {"M3": "M5", "M64": "M65"}
_SAME_UM = 1.0  # two shots so close together go through one hole


@dataclass(frozen=True, slots=True, kw_only=True)
class DryRun:
    """Shots, path and times of a program.

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

    fired_um: Floats
    pulse_s: Floats
    path_um: Floats
    least_pause_s: float
    time_s: float

    @property
    def length_um(self) -> float:
        """Length of the path."""
        return float(np.sum(np.hypot(*np.diff(self.path_um, axis=0).T)))

    def sentence(self) -> str:
        """Write the dry run in a line."""
        pulses = f"{1000 * self.pulse_s.min():g}"
        if np.ptp(self.pulse_s) > 1e-9:
            pulses += f" to {1000 * self.pulse_s.max():g}"
        return (
            f"{len(self.fired_um)} shots of {pulses} ms, path {self.length_um / 1000:.1f} mm, {self.time_s:.1f} s "
            "without the stage's acceleration"
        )


def dry_run(program: str, stage: StageParams | None = None, *, pulse_s: float = 0.05) -> DryRun:
    """Run a stage program without a stage.

    Parameters
    ----------
    program : str
        The text of the program, in the dialect of :mod:`planish.marks.design.gcode`.
    stage : StageParams, optional
        Its range counts.
    pulse_s : float
        Longest pulse: what would be a fire rather than a hole.

    Raises
    ------
    MarkError
        If a word is not known, a move leaves the stage's range or is made with the laser on, the laser stays on at the
        end, a pulse is too long or has no length, or the program does not end; the message names the line.
    """
    machine = _Machine((stage or StageParams()).range_um, pulse_s)
    for number, line in enumerate(program.splitlines(), 1):
        text = re.sub(r"\([^()]*\)", " ", line.partition(";")[0]).strip().upper()
        if not text or text == "%":
            continue
        try:
            machine.run_line(text)
        except MarkError as error:
            raise MarkError(
                f"Line {number} of the program ({line.strip()[:60]!r}) is refused: {error.text}."
            ) from error
    return machine.dry_run()


@dataclass
class _Machine:
    range_um: tuple[float, float, float, float]
    longest_s: float
    place: dict[str, float] = field(default_factory=dict[str, float])
    speed: float | None = None
    done: set[str] = field(default_factory=set[str])  # commands so far
    moves: bool = False  # whether a position without a command is a move
    on: str = ""  # the command that switched the laser on
    clock_s: float = 0.0
    started_s: float = 0.0  # when the laser was switched on, and how long it has been on
    lit_s: float = 0.0
    path: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    fired: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    switched_s: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    pulses: list[float] = field(default_factory=list[float])

    def run_line(self, text: str) -> None:
        """Carry out one line."""
        if self.done & {"M2", "M30"}:
            raise MarkError("the program goes on after its end; remove what follows M2")
        words = [word for word in _words(text) if word[0] != "N"]  # the number of a line
        commands = [f"{letter}{value:g}" for letter, value in words if letter in "GM"]
        numbers = {letter: value for letter, value in words if letter not in "GM"}
        unknown = [command for command in commands if command not in _COMMANDS]
        if unknown:
            raise MarkError(f"{unknown[0]} is not known; the dialect has {_KNOWN}")
        if len(numbers) + len(commands) != len(words):
            raise MarkError("a letter is given twice")
        if sum(command not in ("G21", "G90") for command in commands) > 1:
            raise MarkError("two commands stand in one line; give each a line of its own")
        allowed = "".join(_COMMANDS[command] for command in commands)
        if not commands:
            allowed = "XYF" if self.moves else "F"
        foreign = [letter for letter in numbers if letter not in allowed]
        if foreign:
            raise MarkError(f"{foreign[0]} has no meaning here")
        if "F" in numbers:
            if numbers["F"] <= 0:
                raise MarkError("the speed F is not positive")
            self.speed = numbers["F"]
        self.done |= set(commands)
        for command in commands or [""]:
            self._command(command, numbers)

    def _command(self, command: str, numbers: dict[str, float]) -> None:
        if command in ("", "G0", "G1"):
            self.moves |= bool(command)
            if numbers.keys() & {"X", "Y"}:
                self._move(numbers)
            elif command and "F" not in numbers:
                raise MarkError("a move without a position")
        elif command == "G4":
            self._wait(numbers.get("P", -1.0))
        elif command in ("M64", "M65") and "P" not in numbers:
            raise MarkError(f"{command} needs the number P of the output")
        elif command in _OFF:
            self._switch_on(command)
        elif command in _OFF.values():
            self._switch_off(command)
        elif command in ("M2", "M30") and self.on:
            raise MarkError("the program ends with the laser on; switch it off before")

    def _move(self, numbers: dict[str, float]) -> None:
        if not {"G21", "G90"} <= self.done:
            raise MarkError("a move before G21 (millimetres) and G90 (absolute positions)")
        if self.on:
            raise MarkError("a move with the laser on; it would cut the sheet")
        self.place |= {letter: 1000 * numbers[letter] for letter in "XY" if letter in numbers}
        for k, letter in enumerate("XY"):
            value, low, high = self.place.get(letter, math.nan), self.range_um[k], self.range_um[k + 2]
            if value < low - 1e-3 or value > high + 1e-3:
                raise MarkError(
                    f"{letter} {value / 1000:g} mm is out of the stage's range, {low / 1000:g} to {high / 1000:g} mm; "
                    "move the origin or give the stage's own range"
                )
        if len(self.place) < 2:
            return
        target = self.place["X"], self.place["Y"]
        if self.path:
            if self.speed is None:
                raise MarkError("a move before a speed F")
            self.clock_s += 60 * math.dist(target, self.path[-1]) / 1000 / self.speed
        self.path.append(target)

    def _wait(self, seconds: float) -> None:
        if seconds < 0:
            raise MarkError("G4 needs a time P in seconds")
        self.clock_s += seconds
        if self.on:
            self.lit_s += seconds
            if self.lit_s > self.longest_s + 1e-12:
                raise MarkError(
                    f"a pulse of {self.lit_s:g} s is longer than {self.longest_s:g} s and would burn the sheet; P is "
                    "in seconds"
                )

    def _switch_on(self, command: str) -> None:
        if not self.path:
            raise MarkError("the laser fires before both X and Y are known")
        if self.on:
            raise MarkError("the laser is on already")
        x, y = self.path[-1]
        if any(math.hypot(x - a, y - b) < _SAME_UM for a, b in self.fired):
            raise MarkError(f"a second shot at X {x / 1000:g} Y {y / 1000:g} mm")
        self.on, self.lit_s, self.started_s = command, 0.0, self.clock_s
        self.fired.append((x, y))

    def _switch_off(self, command: str) -> None:
        if not self.on:
            return  # a program may make sure that the laser is off
        if _OFF[self.on] != command:
            raise MarkError(f"{command} does not switch off what {self.on} switched on")
        if self.lit_s <= 0:
            raise MarkError("a pulse without a length; put G4 P between on and off")
        self.on = ""
        self.switched_s.append((self.started_s, self.clock_s))
        self.pulses.append(self.lit_s)

    def dry_run(self) -> DryRun:
        """Give the dry run, if the program is whole."""
        if self.on:
            raise MarkError("The program stops with the laser on. Add the command that switches it off, and M2.")
        if not self.done & {"M2", "M30"}:
            raise MarkError("The program has no end, M2 or M30; it may have been cut off. Write it again.")
        if not self.fired:
            raise MarkError("The program fires no shot. Give a stage program of 'planish marks design'.")
        pauses = [on - off for (_, off), (on, _) in pairwise(self.switched_s)]
        return DryRun(
            fired_um=np.array(self.fired),
            pulse_s=np.array(self.pulses),
            path_um=np.array(self.path),
            least_pause_s=min(pauses, default=math.nan),
            time_s=self.clock_s,
        )


def _words(text: str) -> list[tuple[str, float]]:
    """Split a line into letters and numbers."""
    if foreign := _WORD.sub("", text):
        raise MarkError(f"{foreign[:20]!r} is not in the dialect ({_KNOWN})")
    return [(letter, float(value)) for letter, value in _WORD.findall(text)]
