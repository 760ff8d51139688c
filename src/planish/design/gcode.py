"""The pattern for machines.

A stage program in a dialect of G-code (docs/marks.md), its dry run, a drawing for CAD.
"""

import math
import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from planish.core.errors import MarkError
from planish.core.typing import Floats, Ints, Pair
from planish.design.params import StageParams
from planish.design.pattern import CORNERS, Pattern, size_text

Groups = list[tuple[int, Any]]
# Colour numbers: 1 red, 3 green, 5 blue, 7 black or white, 8 grey.
_LAYER_COLOURS = {"HOLES": 1, "BURNT": 8, "FIELD": 3, "VIEW": 8, "NUMBERS": 7, "ORIGIN": 5}
_DXF_HEAD = """\
999
planish hole pattern, {name}: mm, x right, y up as the laser sees the sheet
  0
SECTION
  2
HEADER
  9
$ACADVER
  1
AC1009
  9
$EXTMIN
{lowest}  9
$EXTMAX
{highest}  0
ENDSEC
  0
SECTION
  2
TABLES
  0
TABLE
  2
LTYPE
 70
1
  0
LTYPE
  2
CONTINUOUS
 70
64
  3
Solid line
 72
65
 73
0
 40
0.0
  0
ENDTAB
  0
TABLE
  2
LAYER
 70
{count}
"""


def stage_program(pattern: Pattern, stage: StageParams | None = None) -> str:
    """Write the program that burns a pattern on a short path from the stage's origin and back.

    Parameters
    ----------
    pattern : Pattern; its holes, in um
    stage : StageParams, optional; codes and speed of the machine

    Returns
    -------
    str; the text of the program, positions in mm
    """
    stage = stage or StageParams()
    on, off, codes_text = "M64 P0", "M65 P0", "M64 P0, M65 P0"
    if stage.pulse_code == "m3":
        on, off, codes_text = "M3", "M5", "M3 and M5"
    if stage.power is not None:
        on = f"M3 S{_plain(stage.power, 3)}"
    points, origin = pattern.points_um, pattern.origin_um
    home_move = _move(*origin)
    lines = [
        f"; planish stage program, {ascii_only(pattern.name)}",
        f"; {len(points)} holes, layout {pattern.layout}, seed {pattern.seed}",
        "; positions in mm, absolute, x to the right and y up as the laser sees the sheet",
        (
            f"; origin {home_move.removeprefix('G0 ')}, lower left corner of what is used:"
            f" {size_text(pattern.view_um)} mm"
        ),
        f"; field {size_text(pattern.field_um)} mm, without holes",
        (
            f"; hole {pattern.diameter_um:g} um, pulse {pattern.pulse_s:g} s, pause"
            f" {pattern.pause_s:g} s; G4 P is in seconds"
        ),
        f"; speed {stage.speed_mm_min:g} mm/min; laser: {codes_text}",
        (
            "; try it with the laser off first: a controller that takes P as milliseconds fires too"
            " short"
        ),
        "G21",
        "G90",
        f"F{_plain(stage.speed_mm_min, 3)}",
        off,
        home_move,
    ]
    pulse_lines = [on, f"G4 P{_plain(pattern.pulse_s, 6)}", off]
    if pattern.pause_s > 0:
        pulse_lines.append(f"G4 P{_plain(pattern.pause_s, 6)}")
    for k in short_route(points, origin):
        lines += [f"; hole {pattern.labels[k]}", _move(*points[k]), *pulse_lines]
    return "\n".join([*lines, "; back to the origin", home_move, "M2"]) + "\n"


def short_route(points_um: ArrayLike, start_um: Pair) -> Ints:
    """Sort points into a short path: nearest neighbour, then 2-opt.

    Parameters
    ----------
    points_um : array_like, shape (n, 2), in um
    start_um : (x, y) in um; where the path begins and ends

    Returns
    -------
    array, shape (n,); numbers of the points in the order of the path
    """
    points = np.asarray(points_um, dtype=np.float64).reshape(-1, 2)
    places = np.vstack([start_um, points])
    x, y = places.T
    distances = np.hypot(np.subtract.outer(x, x), np.subtract.outer(y, y))
    open_distances = distances.copy()
    open_distances[:, 0] = np.inf
    tour = np.zeros(len(places), dtype=np.intp)
    for k in range(1, len(places)):
        tour[k] = np.argmin(open_distances[tour[k - 1]])
        open_distances[:, tour[k]] = np.inf
    is_shorter = len(tour) > 3
    while is_shorter:
        is_shorter = False
        for i in range(len(tour) - 1):
            # Turn round what lies between i + 1 and j: two stretches are replaced.
            a = tour[i]
            b = tour[i + 1]
            c = tour[i + 1 :]
            d = np.append(tour[i + 2 :], tour[0])
            before = distances[a, b] + distances[c, d]
            gain = before - distances[a, c] - distances[b, d]
            best = int(np.argmax(gain))
            if gain[best] > 1e-6:
                turned = slice(i + 1, i + 2 + best)
                tour[turned] = tour[turned][::-1]
                is_shorter = True
    return tour[1:] - 1


def ascii_only(text: str) -> str:
    """Return the text with a question mark for what programs and DXF cannot show."""
    return "".join(c if c.isascii() and c.isprintable() else "?" for c in text)


def _move(x_um: float, y_um: float) -> str:
    """Write a position in millimetres with three to six decimals: exact to 0.0005 um."""
    return f"G0 X{_mm(x_um, 3)} Y{_mm(y_um, 3)}"


def _plain(value: float, decimals: int) -> str:
    text = f"{value:.{decimals}f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def pattern_dxf(pattern: Pattern) -> str:
    """Write a pattern as DXF of AutoCAD Release 12 in mm.

    Holes, burnt rims and numbers, the field, the view and the stage's origin.

    Every value is two lines, a group code and the value: 0 the kind of an entity, 8 its layer, 10,
    20 and 30 a point, 40 a radius or the height of text, 1 text, 2 a name, 6 a line type, 62 a
    colour, 70 flags, 9 a variable of the header. Release 12 has no unit of its own; a comment (999)
    and the drawing's extents say what is meant.
    """
    x0, y0 = pattern.origin_um
    width, height = pattern.view_um
    diameter = pattern.diameter_um
    x1, y1 = x0 + width, y0 + height
    lowest = _lines(_point(10, x0, y0))
    highest = _lines(_point(10, x1, y1))
    name = ascii_only(pattern.name)
    groups: Groups = []
    for layer, colour in _LAYER_COLOURS.items():
        groups += [(0, "LAYER"), (2, layer), (70, 64), (62, colour), (6, "CONTINUOUS")]
    groups += [(0, "ENDTAB"), (0, "ENDSEC"), (0, "SECTION"), (2, "ENTITIES")]
    for hole in pattern.holes:
        x, y = hole.x_um, hole.y_um
        groups += _circle("HOLES", x, y, 0.5 * diameter)
        groups += _circle("BURNT", x, y, pattern.burnt_um)
        number_x = x + 0.6 * diameter + pattern.rim_um
        groups += _text("NUMBERS", number_x, y, diameter, hole.label)
    groups += _rectangle("FIELD", pattern.field_low_um, pattern.field_um)
    groups += _rectangle("VIEW", (x0, y0), pattern.view_um)
    # The axes of the stage.
    arm = 3 * diameter
    x_end, y_end = (x0 + arm, y0), (x0, y0 + arm)
    groups += _line("ORIGIN", (x0, y0), x_end)
    groups += _line("ORIGIN", (x0, y0), y_end)
    groups += _text("ORIGIN", *x_end, diameter, "x")
    groups += _text("ORIGIN", *y_end, diameter, "y")
    groups += [(0, "ENDSEC"), (0, "EOF")]
    head = _DXF_HEAD.format(name=name, lowest=lowest, highest=highest, count=len(_LAYER_COLOURS))
    return head + _lines(groups)


def _entity(kind: str, layer: str, *groups: tuple[int, Any]) -> Groups:
    return [(0, kind), (8, layer), *groups]


def _circle(layer: str, x_um: float, y_um: float, radius_um: float) -> Groups:
    place = _point(10, x_um, y_um)
    return _entity("CIRCLE", layer, *place, (40, _mm(radius_um)))


def _line(layer: str, start: Pair | Floats, end: Pair | Floats) -> Groups:
    return _entity("LINE", layer, *_point(10, *start), *_point(11, *end))


def _rectangle(layer: str, low_um: Pair | Floats, size_um: Pair | Floats) -> Groups:
    """The four sides of a rectangle, counter-clockwise from its lower left corner."""
    corners = low_um + CORNERS * size_um
    groups: Groups = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        groups += _line(layer, start, end)
    return groups


def _lines(groups: Groups) -> str:
    return "".join(f"{code:3d}\n{value}\n" for code, value in groups)


def _text(layer: str, x_um: float, y_um: float, height_um: float, text: str) -> Groups:
    place = _point(10, x_um, y_um)
    return _entity("TEXT", layer, *place, (40, _mm(height_um)), (1, ascii_only(text)))


def _point(code: int, x_um: float, y_um: float) -> Groups:
    return [(code, _mm(x_um)), (code + 10, _mm(y_um)), (code + 20, "0.0")]


def _mm(value_um: float, least: int = 1) -> str:
    whole, _, part = _plain(value_um / 1000, 6).partition(".")
    return f"{whole}.{part.ljust(least, '0')}"


_WORD = re.compile(r"\s*([A-Z])\s*([+-]?(?:\d+\.?\d*|\.\d+))\s*")
_COMMANDS = {  # Commands, and the words that may stand beside them.
    "G0": "XYF",
    "G1": "XYF",
    "G4": "P",
    "G21": "",
    "G90": "",
    "M2": "",
    "M3": "S",
    "M5": "",
    "M30": "",
    "M64": "P",
    "M65": "P",
}
_KNOWN = f"{', '.join(_COMMANDS)} with X, Y, F, P, S"
_OFF = {"M3": "M5", "M64": "M65"}


@dataclass(frozen=True, slots=True, kw_only=True)
class DryRun:
    """Shots, path and times of a program."""

    fired_um: Floats  #: (n, 2): positions of the shots in the order in which they are fired.
    pulse_s: Floats  #: (n,): how long the laser is on at each.
    path_um: Floats  #: (m, 2): corners of the path, from the first position the program names.
    #: Shortest time that the laser is off between two shots; NaN for a single shot.
    least_pause_s: float
    #: Moves at the speed of the program and all waits; the stage's acceleration adds to it.
    time_s: float

    @property
    def length_um(self) -> float:
        """Length of the path."""
        steps_um = np.diff(self.path_um, axis=0)
        return float(np.sum(np.hypot(*steps_um.T)))

    def sentence(self) -> str:
        """Write the dry run in a line."""
        pulses = f"{1000 * self.pulse_s.min():g}"
        if np.ptp(self.pulse_s) > 1e-9:
            pulses += f" to {1000 * self.pulse_s.max():g}"
        return (
            f"{len(self.fired_um)} shots of {pulses} ms, path {self.length_um / 1000:.1f} mm,"
            f" {self.time_s:.1f} s without the stage's acceleration"
        )


def dry_run(program: str, stage: StageParams | None = None, *, pulse_s: float = 0.05) -> DryRun:
    """Run a stage program without a stage.

    Parameters
    ----------
    program : str; the text of the program
    stage : StageParams, optional; its range counts
    pulse_s : float; longest pulse: what would be a fire rather than a hole

    Raises
    ------
    MarkError
        If a word is not known, a move leaves the stage's range or is made with the laser on, the
        laser stays on at the end, a pulse is too long or has no length, or the program does not
        end; the message names the line.
    """
    machine = _Machine((stage or StageParams()).range_um, pulse_s)
    for number, line in enumerate(program.splitlines(), 1):
        # Comments stand behind a semicolon or in brackets.
        before_comment, _, _ = line.partition(";")
        text = re.sub(r"\([^()]*\)", " ", before_comment).strip().upper()
        if not text or text == "%":
            continue
        try:
            machine.run_line(text)
        except MarkError as error:
            raise MarkError(
                f"Line {number} of the program ({line.strip()[:60]!r}) is refused: {error.text}."
            ) from error
    if machine.on_command:
        raise MarkError(
            "The program stops with the laser on. Add the command that switches it off, and M2."
        )
    if not machine.executed & {"M2", "M30"}:
        raise MarkError(
            "The program has no end, M2 or M30; it may have been cut off. Write it again."
        )
    if not machine.shots_um:
        raise MarkError(
            "The program fires no shot. Give a stage program of 'planish marks design'."
        )
    # Between on and off, and off and on, in turn.
    pauses_s = np.diff(machine.switched_s)[1::2]
    least_pause_s = float(min(pauses_s, default=math.nan))
    return DryRun(
        fired_um=np.array(machine.shots_um),
        pulse_s=np.array(machine.pulses_s),
        path_um=np.array(machine.corners_um),
        least_pause_s=least_pause_s,
        time_s=machine.clock_s,
    )


def _words_of(text: str) -> tuple[list[str], dict[str, float]]:
    """Commands of a line and its other words; MarkError where they are not in the dialect.

    Commands as ``G1`` or ``M64`` in their order; the other words by their letter, such as ``X``, in
    the program's own unit. The number of a line (N) is passed over.
    """
    foreign_text = _WORD.sub("", text)
    if foreign_text:
        raise MarkError(f"{foreign_text[:20]!r} is not in the dialect ({_KNOWN})")
    commands: list[str] = []
    arguments: dict[str, float] = {}
    has_twin = False
    for letter, number in _WORD.findall(text):
        if letter in "GM":
            commands.append(f"{letter}{float(number):g}")
        elif letter != "N":
            has_twin |= letter in arguments
            arguments[letter] = float(number)
    for command in commands:
        if command not in _COMMANDS:
            raise MarkError(f"{command} is not known; the dialect has {_KNOWN}")
    if has_twin:
        raise MarkError("a letter is given twice")
    if sum(command not in ("G21", "G90") for command in commands) > 1:
        raise MarkError("two commands stand in one line; give each a line of its own")
    return commands, arguments


@dataclass
class _Machine:
    """A stage and its laser, which carry out a program line by line."""

    range_um: tuple[float, float, float, float]
    longest_pulse_s: float
    position_um: dict[str, float] = field(default_factory=dict[str, float])
    speed_mm_min: float | None = None
    executed: set[str] = field(default_factory=set[str])  # commands so far
    on_command: str = ""  # the command that switched the laser on
    clock_s: float = 0.0
    laser_on_s: float = 0.0  # how long the laser has been on
    corners_um: list[Pair] = field(default_factory=list[Pair])
    shots_um: list[Pair] = field(default_factory=list[Pair])
    pulses_s: list[float] = field(default_factory=list[float])
    switched_s: list[float] = field(default_factory=list[float])  # on, off, on ...

    def run_line(self, text: str) -> None:
        """Carry out one line, without its comments and in capitals.

        MarkError, whose text continues "is refused:", where it means nothing or is not allowed now.
        """
        if self.executed & {"M2", "M30"}:
            raise MarkError("the program goes on after its end; remove what follows M2")
        commands, arguments = _words_of(text)
        # After the first move a position without a command is one, too.
        has_moved = bool(self.executed & {"G0", "G1"})
        if not commands and has_moved and arguments.keys() & {"X", "Y"}:
            commands = ["G0"]
        allowed_letters = "".join(_COMMANDS[command] for command in commands) if commands else "F"
        for letter in arguments:
            if letter not in allowed_letters:
                raise MarkError(f"{letter} has no meaning here")
        if arguments.get("F", 1.0) <= 0:
            raise MarkError("the speed F is not positive")
        self.speed_mm_min = arguments.get("F", self.speed_mm_min)
        self.executed |= set(commands)
        for command in commands:
            self._command(command, arguments)

    def _command(self, command: str, arguments: dict[str, float]) -> None:
        """Carry out one command; G21 and G90 say only how numbers are meant."""
        if command in ("G0", "G1"):
            self._move(arguments)
        elif command == "G4":
            self._wait(arguments.get("P", -1.0))
        elif command in ("M64", "M65") and "P" not in arguments:
            raise MarkError(f"{command} needs the number P of the output")
        elif command in _OFF:
            self._switch_on(command)
        # a program may make sure that the laser is off.
        elif command in _OFF.values() and self.on_command:
            self._switch_off(command)
        elif command in ("M2", "M30") and self.on_command:
            raise MarkError("the program ends with the laser on; switch it off before")

    def _wait(self, seconds: float) -> None:
        """Let time pass, with the laser as it is; a pulse that becomes too long is refused."""
        if seconds < 0:
            raise MarkError("G4 needs a time P in seconds")
        self.clock_s += seconds
        self.laser_on_s += seconds
        if self.on_command and self.laser_on_s > self.longest_pulse_s + 1e-12:
            raise MarkError(
                f"a pulse of {self.laser_on_s:g} s is longer than {self.longest_pulse_s:g} s"
                " and would burn the sheet; P is in seconds"
            )

    def _switch_on(self, command: str) -> None:
        """Begin a shot where the stage stands.

        The laser must be off, the place known and no hole yet.
        """
        if not self.corners_um:
            raise MarkError("the laser fires before both X and Y are known")
        if self.on_command:
            raise MarkError("the laser is on already")
        x, y = self.corners_um[-1]
        # Two shots so close together go through one hole.
        if any(math.hypot(x - a, y - b) < 1.0 for a, b in self.shots_um):
            raise MarkError(f"a second shot at X {x / 1000:g} Y {y / 1000:g} mm")
        self.on_command = command
        self.laser_on_s = 0.0
        self.switched_s.append(self.clock_s)
        self.shots_um.append((x, y))

    def _switch_off(self, command: str) -> None:
        """End a shot, by the command that belongs to the one that began it."""
        if _OFF[self.on_command] != command:
            raise MarkError(f"{command} does not switch off what {self.on_command} switched on")
        if self.laser_on_s <= 0:
            raise MarkError("a pulse without a length; put G4 P between on and off")
        self.on_command = ""
        self.switched_s.append(self.clock_s)
        self.pulses_s.append(self.laser_on_s)

    def _move(self, arguments: dict[str, float]) -> None:
        """Go to a position, within the stage's range and with the laser off; or set the speed."""
        if not arguments.keys() & {"X", "Y"}:
            if "F" not in arguments:
                raise MarkError("a move without a position")
            return
        if not {"G21", "G90"} <= self.executed:
            raise MarkError("a move before G21 (millimetres) and G90 (absolute positions)")
        if self.on_command:
            raise MarkError("a move with the laser on; it would cut the sheet")
        x0, y0, x1, y1 = self.range_um
        for letter, low, high in (("X", x0, x1), ("Y", y0, y1)):
            target_um = 1000 * arguments.get(letter, math.nan)
            if target_um < low - 1e-3 or target_um > high + 1e-3:
                raise MarkError(
                    f"{letter} {target_um / 1000:g} mm is out of the stage's range, {low / 1000:g}"
                    f" to {high / 1000:g} mm; move the origin or give the stage's own range"
                )
            if letter in arguments:
                self.position_um[letter] = target_um
        if len(self.position_um) == 2:
            self._go((self.position_um["X"], self.position_um["Y"]))

    def _go(self, target: Pair) -> None:
        """Go to a place in um, at the speed of the program; the first one costs no time."""
        if self.corners_um:
            if self.speed_mm_min is None:
                raise MarkError("a move before a speed F")
            distance_um = math.dist(target, self.corners_um[-1])
            self.clock_s += 60 * distance_um / 1000 / self.speed_mm_min
        self.corners_um.append(target)
