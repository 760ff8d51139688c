"""The stage program: a small dialect of G-code that most controllers of stages and lasers read.

::

    ; text      a comment to the end of the line
    G21 G90     millimetres, absolute positions: required before the first move
    Fnumber     speed along the path in mm/min
    G0 Xn Yn    move there, laser off (G1 is read too)
    M3 [Sn]     laser on; with --pulse-code m64: M64 P0, a digital output at once
    G4 Pn       wait n seconds
    M5          laser off; with --pulse-code m64: M65 P0
    M2          end (M30 is read too)
"""

from __future__ import annotations

from planish.marks.design.params import StageParams
from planish.marks.design.pattern import Pattern
from planish.marks.design.route import short_route

DECIMALS = 6  # of a millimetre: positions are exact to 0.0005 um


def stage_program(pattern: Pattern, stage: StageParams | None = None) -> str:
    """Write the program that burns a pattern, on a short path from the stage's origin and back to it."""
    stage = stage or StageParams()
    on, off = ("M3", "M5") if stage.pulse_code == "m3" else ("M64 P0", "M65 P0")
    if stage.power is not None:
        on = f"M3 S{_plain(stage.power, 3)}"
    points, burn, labels = pattern.points_um, pattern.burn, pattern.labels
    lines = [
        *(f"; {text}" for text in _head(pattern, stage)),
        "G21",
        "G90",
        f"F{_plain(stage.speed_mm_min, 3)}",
        off,
        _move(*pattern.origin_um),
    ]
    for k in short_route(points, pattern.origin_um):
        lines += [f"; hole {labels[k]}", _move(points[k][0], points[k][1]), on, f"G4 P{_plain(burn.pulse_s, 6)}", off]
        if burn.pause_s > 0:
            lines.append(f"G4 P{_plain(burn.pause_s, 6)}")
    lines += ["; back to the origin", _move(*pattern.origin_um), "M2"]
    return "\n".join(lines) + "\n"


def _head(pattern: Pattern, stage: StageParams) -> list[str]:
    low, view, burn = pattern.origin_um, pattern.view_um, pattern.burn
    used = " x ".join(f"{side / 1000:g}" for side in view)
    name = "".join(c if c.isascii() and c.isprintable() else "?" for c in pattern.name)
    return [
        f"planish stage program, {name}",
        f"{len(pattern.positions_um)} holes, layout {pattern.layout}, seed {pattern.seed}",
        "positions in mm, absolute, x to the right and y up as the laser sees the sheet",
        f"origin X{_mm(low[0])} Y{_mm(low[1])}, lower left corner of what is used: {used} mm",
        f"field {pattern.field_um[0] / 1000:g} x {pattern.field_um[1] / 1000:g} mm, without holes",
        f"hole {burn.diameter_um:g} um, pulse {burn.pulse_s:g} s, pause {burn.pause_s:g} s; G4 P is in seconds",
        f"speed {stage.speed_mm_min:g} mm/min; laser: {'M3 and M5' if stage.pulse_code == 'm3' else 'M64 P0, M65 P0'}",
        "try it with the laser off first: a controller that takes P as milliseconds fires too short",
    ]


def _move(x_um: float, y_um: float) -> str:
    return f"G0 X{_mm(x_um)} Y{_mm(y_um)}"


def _mm(value_um: float) -> str:
    """Millimetres with three to six decimals."""
    text = f"{value_um / 1000:.{DECIMALS}f}".rstrip("0")
    whole, _, part = text.partition(".")
    whole = "0" if whole == "-0" and not part else whole
    return f"{whole}.{part.ljust(3, '0')}"


def _plain(value: float, decimals: int) -> str:
    """Write a number without an exponent."""
    return f"{value:.{decimals}f}".rstrip("0").rstrip(".") or "0"
