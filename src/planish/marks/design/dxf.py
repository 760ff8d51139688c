"""The pattern as a drawing for CAD: DXF of AutoCAD Release 12, plain text, in millimetres.

Every value is two lines, a group code and the value: 0 the kind of an entity, 8 its layer, 10, 20 and 30 a point, 40 a
radius or the height of text, 1 text, 2 a name, 6 a line type, 62 a colour, 70 flags, 9 a variable of the header.
Release 12 has no unit of its own; a comment (999) and the drawing's extents say what is meant.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from planish.marks.design.gcode import ascii_only
from planish.marks.design.pattern import Pattern

# Name, colour number: 1 red, 3 green, 5 blue, 7 black or white, 8 grey.
_LAYERS = (("HOLES", 1), ("BURNT", 8), ("FIELD", 3), ("VIEW", 8), ("NUMBERS", 7), ("ORIGIN", 5))
Groups = list[tuple[int, Any]]


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
        groups += _lines(layer, (x, y), (x + w, y), (x + w, y + h), (x, y + h), (x, y))
    arm = 3 * diameter
    groups += _lines("ORIGIN", (x0, y0), (x0 + arm, y0)) + _lines("ORIGIN", (x0, y0), (x0, y0 + arm))
    groups += _text("ORIGIN", x0 + arm, y0, diameter, "x") + _text("ORIGIN", x0, y0 + arm, diameter, "y")
    groups += [(0, "ENDSEC"), (0, "EOF")]
    return "".join(f"{code:3d}\n{value}\n" for code, value in groups)


def _lines(layer: str, *corners: tuple[float, float]) -> Groups:
    groups: Groups = []
    for start, end in pairwise(corners):
        groups += [(0, "LINE"), (8, layer), *_point(10, *start), *_point(11, *end)]
    return groups


def _text(layer: str, x_um: float, y_um: float, height_um: float, text: str) -> Groups:
    return [(0, "TEXT"), (8, layer), *_point(10, x_um, y_um), (40, _mm(height_um)), (1, ascii_only(text))]


def _point(code: int, x_um: float, y_um: float) -> Groups:
    return [(code, _mm(x_um)), (code + 10, _mm(y_um)), (code + 20, "0.0")]


def _mm(value_um: float) -> str:
    text = f"{value_um / 1000:.6f}".rstrip("0")
    return text + "0" if text.endswith(".") else text
