"""The pattern as a drawing for CAD: DXF of AutoCAD Release 12, plain text, in millimetres.

Every value is two lines, a group code and the value: 0 the kind of an entity, 8 its layer, 10, 20 and 30 a point, 40 a
radius or the height of text, 1 text, 2 a name, 6 a line type, 62 a colour, 70 flags, 9 a variable of the header.
Release 12 has no unit of its own; a comment (999) and the drawing's extents say what is meant.
"""

from __future__ import annotations

from planish.marks.design.pattern import Pattern

# Name, colour number: 1 red, 3 green, 5 blue, 7 black or white, 8 grey.
_LAYERS = (("HOLES", 1), ("BURNT", 8), ("FIELD", 3), ("VIEW", 8), ("NUMBERS", 7), ("ORIGIN", 5))
Pair = tuple[int, str]


def pattern_dxf(pattern: Pattern) -> str:
    """Write the holes, their burnt rims and numbers, the field, the view and the stage's origin."""
    pairs: list[Pair] = [
        (999, f"planish hole pattern, {_ascii(pattern.name)}: mm, x right, y up as the laser sees the sheet"),
        *_header(pattern),
        *_tables(),
        (0, "SECTION"),
        (2, "ENTITIES"),
    ]
    burn = pattern.burn
    for label, (x, y) in zip(pattern.labels, pattern.positions_um, strict=True):
        pairs += _circle("HOLES", x, y, 0.5 * burn.diameter_um)
        pairs += _circle("BURNT", x, y, 0.5 * burn.diameter_um + burn.rim_um)
        pairs += _text("NUMBERS", x + 0.6 * burn.diameter_um + burn.rim_um, y, burn.diameter_um, label)
    pairs += _rectangle("FIELD", pattern.field_low_um, pattern.field_um)
    pairs += _rectangle("VIEW", pattern.origin_um, pattern.view_um)
    x, y = pattern.origin_um
    arm = 3 * burn.diameter_um
    pairs += _line("ORIGIN", (x, y), (x + arm, y)) + _line("ORIGIN", (x, y), (x, y + arm))
    pairs += _text("ORIGIN", x + arm, y, burn.diameter_um, "x") + _text("ORIGIN", x, y + arm, burn.diameter_um, "y")
    pairs += [(0, "ENDSEC"), (0, "EOF")]
    return "".join(f"{code:3d}\n{value}\n" for code, value in pairs)


def _header(pattern: Pattern) -> list[Pair]:
    (x, y), (width, height) = pattern.origin_um, pattern.view_um
    return [
        (0, "SECTION"),
        (2, "HEADER"),
        (9, "$ACADVER"),
        (1, "AC1009"),
        (9, "$EXTMIN"),
        *_point(10, x, y),
        (9, "$EXTMAX"),
        *_point(10, x + width, y + height),
        (0, "ENDSEC"),
    ]


def _tables() -> list[Pair]:
    pairs: list[Pair] = [
        (0, "SECTION"), (2, "TABLES"),
        (0, "TABLE"), (2, "LTYPE"), (70, "1"),
        (0, "LTYPE"), (2, "CONTINUOUS"), (70, "64"), (3, "Solid line"), (72, "65"), (73, "0"), (40, "0.0"),
        (0, "ENDTAB"),
        (0, "TABLE"), (2, "LAYER"), (70, str(len(_LAYERS))),
    ]  # fmt: skip
    for name, colour in _LAYERS:
        pairs += [(0, "LAYER"), (2, name), (70, "64"), (62, str(colour)), (6, "CONTINUOUS")]
    return [*pairs, (0, "ENDTAB"), (0, "ENDSEC")]


def _circle(layer: str, x_um: float, y_um: float, radius_um: float) -> list[Pair]:
    return [(0, "CIRCLE"), (8, layer), *_point(10, x_um, y_um), (40, _mm(radius_um))]


def _line(layer: str, start: tuple[float, float], end: tuple[float, float]) -> list[Pair]:
    return [(0, "LINE"), (8, layer), *_point(10, *start), *_point(11, *end)]


def _text(layer: str, x_um: float, y_um: float, height_um: float, text: str) -> list[Pair]:
    return [(0, "TEXT"), (8, layer), *_point(10, x_um, y_um), (40, _mm(height_um)), (1, _ascii(text))]


def _rectangle(layer: str, low: tuple[float, float], size: tuple[float, float]) -> list[Pair]:
    x, y, right, top = low[0], low[1], low[0] + size[0], low[1] + size[1]
    corners = [(x, y), (right, y), (right, top), (x, top)]
    return [
        pair for a, b in zip(corners, [*corners[1:], corners[0]], strict=True) for pair in _line(layer, a, b)
    ]  # fmt: skip


def _point(code: int, x_um: float, y_um: float) -> list[Pair]:
    return [(code, _mm(x_um)), (code + 10, _mm(y_um)), (code + 20, "0.0")]


def _mm(value_um: float) -> str:
    text = f"{value_um / 1000:.6f}".rstrip("0")
    return text + "0" if text.endswith(".") else text


def _ascii(text: str) -> str:
    """Keep what Release 12 can show."""
    return "".join(c if c.isascii() and c.isprintable() else "?" for c in text)
