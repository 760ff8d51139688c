"""The pattern for machines: a stage program, on a short path, and a drawing for CAD.

The stage program is a small dialect of G-code that most controllers of stages and lasers read.

::

    ; text      a comment to the end of the line
    G21 G90     millimetres, absolute positions: required before the first move
    Fnumber     speed along the path in mm/min
    G0 Xn Yn    move there, laser off (G1 is read too)
    M3 [Sn]     laser on; with --pulse-code m64: M64 P0, a digital output at once
    G4 Pn       wait n seconds
    M5          laser off; with --pulse-code m64: M65 P0
    M2          end (M30 is read too)

The drawing for CAD: DXF of AutoCAD Release 12, plain text, in millimetres.

Every value is two lines, a group code and the value: 0 the kind of an entity, 8 its layer, 10, 20 and 30 a point, 40 a
radius or the height of text, 1 text, 2 a name, 6 a line type, 62 a colour, 70 flags, 9 a variable of the header.
Release 12 has no unit of its own; a comment (999) and the drawing's extents say what is meant.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planish.marks.design.params import StageParams
from planish.marks.design.pattern import Pattern

Ints = NDArray[np.intp]
Groups = list[tuple[int, Any]]

# Name, colour number: 1 red, 3 green, 5 blue, 7 black or white, 8 grey.
_LAYERS = (("HOLES", 1), ("BURNT", 8), ("FIELD", 3), ("VIEW", 8), ("NUMBERS", 7), ("ORIGIN", 5))


def stage_program(pattern: Pattern, stage: StageParams | None = None) -> str:
    """Write the program that burns a pattern, on a short path from the stage's origin and back to it."""
    stage = stage or StageParams()
    is_m3 = stage.pulse_code == "m3"
    on, off, words = ("M3", "M5", "M3 and M5") if is_m3 else ("M64 P0", "M65 P0", "M64 P0, M65 P0")
    if stage.power is not None:
        on = f"M3 S{_plain(stage.power, 3)}"
    points, origin = pattern.points_um, pattern.origin_um
    used, field = (" x ".join(f"{side / 1000:g}" for side in size) for size in (pattern.view_um, pattern.field_um))
    home = _move(*origin)
    lines = [
        f"; planish stage program, {ascii_only(pattern.name)}",
        f"; {len(points)} holes, layout {pattern.layout}, seed {pattern.seed}",
        "; positions in mm, absolute, x to the right and y up as the laser sees the sheet",
        f"; origin {home.removeprefix('G0 ')}, lower left corner of what is used: {used} mm",
        f"; field {field} mm, without holes",
        f"; hole {pattern.diameter_um:g} um, pulse {pattern.pulse_s:g} s, pause {pattern.pause_s:g} s; "
        "G4 P is in seconds",
        f"; speed {stage.speed_mm_min:g} mm/min; laser: {words}",
        "; try it with the laser off first: a controller that takes P as milliseconds fires too short",
        "G21",
        "G90",
        f"F{_plain(stage.speed_mm_min, 3)}",
        off,
        home,
    ]
    pause = [f"G4 P{_plain(pattern.pause_s, 6)}"] if pattern.pause_s > 0 else []
    for k in short_route(points, origin):
        pulse = [on, f"G4 P{_plain(pattern.pulse_s, 6)}", off]
        lines += [f"; hole {pattern.labels[k]}", _move(*points[k]), *pulse, *pause]
    return "\n".join([*lines, "; back to the origin", home, "M2"]) + "\n"


def short_route(points_um: ArrayLike, start_um: tuple[float, float]) -> Ints:
    """Sort the points (n, 2) into a short path that begins and ends at ``start_um``.

    The path is built to the nearest open point each time, then stretches of it are turned round as long as that
    shortens it (2-opt). Same points, same order.
    """
    places = np.vstack([start_um, np.asarray(points_um, dtype=np.float64).reshape(-1, 2)])
    distances = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
    open_distances = distances.copy()
    open_distances[:, 0] = np.inf
    tour = np.zeros(len(places), dtype=np.intp)
    for k in range(1, len(places)):
        tour[k] = np.argmin(open_distances[tour[k - 1]])
        open_distances[:, tour[k]] = np.inf
    n = len(tour)
    is_shorter = n > 3
    while is_shorter:
        is_shorter = False
        for i in range(n - 1):
            # Turn round what lies between i + 1 and j: two stretches are replaced.
            j = np.arange(i + 1, n)
            ends = tour[(j + 1) % n]
            gain = distances[tour[i], tour[i + 1]] + distances[tour[j], ends]
            gain = gain - distances[tour[i], tour[j]] - distances[tour[i + 1], ends]
            best = int(np.argmax(gain))
            if gain[best] > 1e-6:
                tour[i + 1 : i + 2 + best] = tour[i + 1 : i + 2 + best][::-1]
                is_shorter = True
    return tour[1:] - 1


def ascii_only(text: str) -> str:
    """Return the text with a question mark for what programs and DXF cannot show."""
    return "".join(c if c.isascii() and c.isprintable() else "?" for c in text)


def _move(x_um: float, y_um: float) -> str:
    """Write a position in millimetres with three to six decimals: exact to 0.0005 um."""
    return f"G0 X{_mm(x_um, 3)} Y{_mm(y_um, 3)}"


def _plain(value: float, decimals: int) -> str:
    """Write a number without an exponent."""
    text = f"{value:.{decimals}f}".rstrip("0").rstrip(".")
    return "0" if text in ("", "-0") else text


def pattern_dxf(pattern: Pattern) -> str:
    """Write the holes, their burnt rims and numbers, the field, the view and the stage's origin."""
    (x0, y0), (width, height), diameter = pattern.origin_um, pattern.view_um, pattern.diameter_um
    groups: Groups = [
        (999, f"planish hole pattern, {ascii_only(pattern.name)}: mm, x right, y up as the laser sees the sheet"),
        (0, "SECTION"), (2, "HEADER"), (9, "$ACADVER"), (1, "AC1009"), (9, "$EXTMIN"), *_point(10, x0, y0),
        (9, "$EXTMAX"), *_point(10, x0 + width, y0 + height), (0, "ENDSEC"),
        (0, "SECTION"), (2, "TABLES"), (0, "TABLE"), (2, "LTYPE"), (70, 1), (0, "LTYPE"), (2, "CONTINUOUS"), (70, 64),
        (3, "Solid line"), (72, 65), (73, 0), (40, "0.0"), (0, "ENDTAB"),
        (0, "TABLE"), (2, "LAYER"), (70, len(_LAYERS)),
    ]  # fmt: skip
    for name, colour in _LAYERS:
        groups += [(0, "LAYER"), (2, name), (70, 64), (62, colour), (6, "CONTINUOUS")]
    groups += [(0, "ENDTAB"), (0, "ENDSEC"), (0, "SECTION"), (2, "ENTITIES")]
    for label, (x, y) in zip(pattern.labels, pattern.points_um.tolist(), strict=True):
        for layer, radius in (("HOLES", 0.5 * diameter), ("BURNT", pattern.burnt_um)):
            groups += [(0, "CIRCLE"), (8, layer), *_point(10, x, y), (40, _mm(radius))]
        groups += _text("NUMBERS", x + 0.6 * diameter + pattern.rim_um, y, diameter, label)
    for layer, (x, y), (w, h) in (
        ("FIELD", pattern.field_low_um, pattern.field_um),
        ("VIEW", pattern.origin_um, pattern.view_um),
    ):
        groups += _polyline(layer, (x, y), (x + w, y), (x + w, y + h), (x, y + h), (x, y))
    arm = 3 * diameter
    groups += _polyline("ORIGIN", (x0, y0), (x0 + arm, y0)) + _polyline("ORIGIN", (x0, y0), (x0, y0 + arm))
    groups += _text("ORIGIN", x0 + arm, y0, diameter, "x") + _text("ORIGIN", x0, y0 + arm, diameter, "y")
    groups += [(0, "ENDSEC"), (0, "EOF")]
    return "".join(f"{code:3d}\n{value}\n" for code, value in groups)


def _polyline(layer: str, *corners: tuple[float, float]) -> Groups:
    groups: Groups = []
    for start, end in pairwise(corners):
        groups += [(0, "LINE"), (8, layer), *_point(10, *start), *_point(11, *end)]
    return groups


def _text(layer: str, x_um: float, y_um: float, height_um: float, text: str) -> Groups:
    return [(0, "TEXT"), (8, layer), *_point(10, x_um, y_um), (40, _mm(height_um)), (1, ascii_only(text))]


def _point(code: int, x_um: float, y_um: float) -> Groups:
    return [(code, _mm(x_um)), (code + 10, _mm(y_um)), (code + 20, "0.0")]


def _mm(value_um: float, least: int = 1) -> str:
    """Write millimetres with so many to six decimals."""
    whole, _, part = _plain(value_um / 1000, 6).partition(".")
    return f"{whole}.{part.ljust(least, '0')}"
