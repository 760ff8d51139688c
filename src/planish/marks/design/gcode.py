"""The stage program: a small dialect of G-code that most controllers of stages and lasers read, on a short path.

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

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planish.marks.design.params import StageParams
from planish.marks.design.pattern import Pattern

Ints = NDArray[np.intp]


def stage_program(pattern: Pattern, stage: StageParams | None = None) -> str:
    """Write the program that burns a pattern, on a short path from the stage's origin and back to it."""
    stage = stage or StageParams()
    on, off = ("M3", "M5") if stage.pulse_code == "m3" else ("M64 P0", "M65 P0")
    words = "M3 and M5" if stage.pulse_code == "m3" else "M64 P0, M65 P0"
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
    """Order of the points (n, 2) on a short path that begins and ends at ``start_um``.

    The path is built to the nearest point left each time, then stretches of it are turned round as long as that
    shortens it (2-opt). Same points, same order.
    """
    places = np.vstack([start_um, np.asarray(points_um, dtype=np.float64).reshape(-1, 2)])
    apart = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
    left = apart.copy()
    left[:, 0] = np.inf
    tour = np.zeros(len(places), dtype=np.intp)
    for k in range(1, len(places)):
        tour[k] = np.argmin(left[tour[k - 1]])
        left[:, tour[k]] = np.inf
    n = len(tour)
    shorter = n > 3
    while shorter:
        shorter = False
        for i in range(n - 1):
            # Turn round what lies between i + 1 and j: two stretches are replaced.
            j = np.arange(i + 1, n)
            ends = tour[(j + 1) % n]
            gain = apart[tour[i], tour[i + 1]] + apart[tour[j], ends]
            gain = gain - apart[tour[i], tour[j]] - apart[tour[i + 1], ends]
            best = int(np.argmax(gain))
            if gain[best] > 1e-6:
                tour[i + 1 : i + 2 + best] = tour[i + 1 : i + 2 + best][::-1]
                shorter = True
    return tour[1:] - 1


def path_um(points_um: ArrayLike, order: Ints, start_um: tuple[float, float]) -> float:
    """Length of the path from ``start_um`` through the points in this order and back."""
    path = np.vstack([start_um, np.asarray(points_um, dtype=np.float64)[order], start_um])
    return float(np.sum(np.hypot(*np.diff(path, axis=0).T)))


def ascii_only(text: str) -> str:
    """Text with a question mark for what programs and DXF cannot show."""
    return "".join(c if c.isascii() and c.isprintable() else "?" for c in text)


def _move(x_um: float, y_um: float) -> str:
    """Position in millimetres with three to six decimals: exact to 0.0005 um."""
    x, y = (_plain(value / 1000, 6).partition(".") for value in (x_um, y_um))
    return f"G0 X{x[0]}.{x[2].ljust(3, '0')} Y{y[0]}.{y[2].ljust(3, '0')}"


def _plain(value: float, decimals: int) -> str:
    """Write a number without an exponent."""
    text = f"{value:.{decimals}f}".rstrip("0").rstrip(".")
    return "0" if text in ("", "-0") else text
