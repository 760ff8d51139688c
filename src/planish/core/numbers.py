"""Numbers and units in sentences: digits that mean something, real minus signs, typeset units.

Sizes that agree.
"""

import math
import re

from planish.core.facts import Pair, is_known
from planish.core.text import plain_numbers

NONE = "–"
_UNITS = {
    "um": "µm",
    "um2": "µm²",
    "g/m2": "g/m²",
    "g/cm3": "g/cm³",
    "1/mm2": "1/mm²",
    "deg": "°",
    "1": "",
}
_SPACE = "\u202f"  # narrow, and no line break: between a number and its unit, and between thousands
_NARROW_WIDTH = 0.02  # width of an interval of r, below which two decimals hide it
_MICROMETRES = re.compile(r" um\b")
_DEGREES = re.compile(r" deg\b")
_MINUS = re.compile(r"(?<=[ (])-(?=\d)")
_ASCII_FORMS = {
    "−": "-",
    _SPACE: " ",
    "–": "-",
    "≤": "<=",
    "≥": ">=",
    "µm": "um",
    "±": "+-",
    "²": "2",
}
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
MOST_DECIMALS = 5
TOLERANCE = 0.01  # sizes that differ by more than this share are different sizes; less is rounding


def agree(first: float, second: float) -> bool:
    """Return True if two sizes are the same within :data:`TOLERANCE`."""
    return abs(first - second) <= TOLERANCE * min(first, second)


def number(value: float | None, digits: int = 3) -> str:
    r"""Write a number with so many significant digits, and all before the decimal point.

    A dash where there is none.

    >>> number(0.83793), number(-12.04), number(56782.4), number(None)
    ('0.838', '−12.0', '56\u202f782', '–')
    """
    if value is None or not math.isfinite(value):
        return NONE
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if exponent < -4:
        mantissa = f"{value / 10.0**exponent:.{max(digits - 1, 0)}f}"
        return _signed(f"{mantissa}·10") + str(exponent).translate(_SUPERSCRIPTS)
    # Rounding may add a digit: 0.9996 to three digits is 1.00.
    rounded = round(value, max(digits - 1 - exponent, 0))
    exponent = math.floor(math.log10(abs(rounded))) if rounded else exponent
    return _signed(f"{rounded:,.{max(digits - 1 - exponent, 0)}f}")


def fixed(value: float | None, decimals: int) -> str:
    """Write a number with so many decimals, and a dash where there is none."""
    if value is None or not math.isfinite(value):
        return NONE
    return _signed(f"{round(value, decimals) + 0.0:,.{decimals}f}")  # no minus sign on a zero


def to_spread(value: float | None, spread: float | None) -> str:
    r"""Write a number with the decimals that two significant digits of its spread have.

    >>> to_spread(2.49817, 0.0722), to_spread(1234.5, 87.0), to_spread(1.5, None)
    ('2.498', '1\u202f234', '1.50')
    """
    if not spread or not math.isfinite(spread):
        return number(value)
    return fixed(value, max(1 - math.floor(math.log10(abs(spread))), 0))


def count(value: int | None) -> str:
    """Write a whole number with thin spaces between thousands."""
    return NONE if value is None else _signed(f"{value:,d}")


def percent(share: float | None, digits: int = 3) -> str:
    """Write a share as per cent."""
    if share is None or not math.isfinite(share):
        return NONE
    return f"{number(100 * share, digits)}{_SPACE}%"


def unit(name: str) -> str:
    """Typeset a unit that is ASCII in attributes; the unit of plain numbers is nothing."""
    return _UNITS.get(name, name)


def plain(value_um: float) -> str:
    """Write a round length (a scale bar's, a pixel's) without trailing zeros."""
    value, symbol = (value_um / 1000, "mm") if abs(value_um) >= 1000 else (value_um, "µm")
    return f"{value:.6g}{_SPACE}{symbol}"


def length(value_um: float | None, digits: int = 3) -> str:
    """Write a length in µm, from 1000 µm on in mm."""
    if value_um is None or not math.isfinite(value_um):
        return NONE
    value, symbol = (value_um / 1000, "mm") if abs(value_um) >= 1000 else (value_um, "µm")
    return f"{number(value, digits)}{_SPACE}{symbol}"


def with_unit(value: float, units: str) -> str:
    """Write a limit with its unit, without zeros that say nothing; a share in percent."""
    if units == "share":
        value = 100 * value
        units = "%"
    unit_text = unit(units).replace("1/", "per ")
    return f"{plain_numbers(f'{value:.4g}')}{_SPACE}{unit_text}".replace("-", "−").rstrip(_SPACE)


def axis_label(title: str, units: str) -> str:
    """Write a title, such as that of an axis, with its unit."""
    return f"{title} / {units}" if units else title


def interval_text(limits: Pair | None, decimals: int = 2) -> str:
    """Write both ends of an interval; a dash where there is none."""
    if limits is not None and is_known(limits):
        return " to ".join(fixed(end, decimals) for end in limits)
    return NONE


def numbers_text(ends: Pair, digits: int = 3) -> str:
    """Write both ends of an interval as :func:`number` does; a dash where there is none."""
    if is_known(ends):
        return " to ".join(number(end, digits) for end in ends)
    return NONE


def with_article(layer: str) -> str:
    """Put a layer into a sentence.

    Layers without a name of their own are called by what they are.
    """
    if layer in ("volume", "image", "sheet"):
        return f"the {layer}"
    return layer


def limits_text(limits: Pair, decimals: int = 2) -> str:
    """Write the ends of a 95 % interval; nothing where there is none."""
    return f"95 %: {interval_text(limits, decimals)}" if is_known(limits) else ""


def typeset(text: str) -> str:
    r"""Write a sentence of the program's, whose units are ASCII, with the report's units.

    >>> typeset("lag 2.1 um at 30 deg, maximum 3 um.")
    'lag 2.1\u202fµm at 30°, maximum 3\u202fµm.'
    """
    return _MINUS.sub("−", _DEGREES.sub("°", _MICROMETRES.sub(f"{_SPACE}µm", plain_numbers(text))))


def in_words(title: str) -> str:
    """Put a title into a sentence: what follows a comma goes into brackets.

    >>> in_words("Coating thickness, top side")
    'coating thickness (top side)'
    """
    head, comma, tail = title.partition(", ")
    head = head[:1].lower() + head[1:]
    return f"{head} ({tail})" if comma else head


def capital(text: str) -> str:
    """Begin a text with a capital letter and leave the rest as it is."""
    return f"{text[:1].upper()}{text[1:]}"


def decimals_of_r(limits: Pair | None) -> int:
    """Decimals of an r within limits: two, and more where they are close to each other."""
    if limits is None or not is_known(limits):
        return 2
    width = limits[1] - limits[0]
    if 0 < width < _NARROW_WIDTH:
        return min(max(2, 1 - math.floor(math.log10(width))), MOST_DECIMALS)
    return 2


def in_ascii(text: str) -> str:
    """Write typeset numbers and units as a terminal or a script takes them."""
    for typeset_form, ascii_form in _ASCII_FORMS.items():
        text = text.replace(typeset_form, ascii_form)
    return text


def round_step(value: float, *, above: bool = False) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above ``value``.

    Or the smallest that is not below.
    """
    power = 10.0 ** math.floor(math.log10(value))
    if above:
        return power * next(k for k in (1, 2, 5, 10) if k * power >= value * (1 - 1e-9))
    return power * max(k for k in (1, 2, 5) if k * power <= value * (1 + 1e-9))


def _signed(text: str) -> str:
    return text.replace(",", _SPACE).replace("-", "−")
