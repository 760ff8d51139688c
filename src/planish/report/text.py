"""How numbers and units are written: digits that mean something, real minus signs, typeset units."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any

from planish.core.facts import is_known

if TYPE_CHECKING:
    import xarray as xr
    from jinja2 import Template

NONE = "–"
_UNITS = {"um": "µm", "um2": "µm²", "g/m2": "g/m²", "g/cm3": "g/cm³", "1/mm2": "1/mm²", "deg": "°", "1": ""}
REGISTERED = "registration: marks only"

"""Stands beside every correlation: how its maps were registered."""
HOLES = "holes and rims"
"""What the mask of valid pixels leaves out where no regions were declared."""
_SPACE = "\u202f"  # narrow, and no line break: between a number and its unit, and between thousands
_MICROMETRES, _DEGREES = re.compile(r" um\b"), re.compile(r" deg\b")


def number(value: float | None, digits: int = 3) -> str:
    r"""Write a number with so many significant digits, and a dash where there is none.

    Digits before the decimal point are never rounded away.

    Examples
    --------
    >>> number(0.83793), number(-12.04), number(56782.4), number(None)
    ('0.838', '−12.0', '56\u202f782', '–')
    """
    if value is None or not math.isfinite(value):
        return NONE
    if value == 0:
        return "0"
    size = math.floor(math.log10(abs(value)))
    if size < -4:
        mantissa = f"{value / 10.0**size:.{max(digits - 1, 0)}f}"
        return _signed(f"{mantissa}·10") + _superscript(size)
    # Rounding may add a digit: 0.9996 to three digits is 1.00.
    rounded = round(value, max(digits - 1 - size, 0))
    size = math.floor(math.log10(abs(rounded))) if rounded else size
    return _signed(f"{rounded:,.{max(digits - 1 - size, 0)}f}")


def fixed(value: float | None, decimals: int) -> str:
    """Write a number with so many decimals, and a dash where there is none."""
    if value is None or not math.isfinite(value):
        return NONE
    return _signed(f"{round(value, decimals) + 0.0:,.{decimals}f}")  # no minus sign on a zero


def beside(value: float | None, spread: float | None) -> str:
    r"""Write a number with the decimals that two significant digits of its spread have.

    Examples
    --------
    >>> beside(2.49817, 0.0722), beside(1234.5, 87.0), beside(1.5, None)
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
    return NONE if share is None or not math.isfinite(share) else f"{number(100 * share, digits)}{_SPACE}%"


def unit(name: str) -> str:
    """Typeset a unit that is ASCII in attributes; the unit of plain numbers is nothing."""
    return _UNITS.get(name, name)


def with_unit(value: float, units: str) -> str:
    """Write a limit with its unit, without zeros that say nothing; a share in percent."""
    if units == "share":
        value, units = 100 * value, "%"
    return f"{value:.4g}{_SPACE}{unit(units)}".replace("-", "−").rstrip(_SPACE)


def length(value_um: float | None, digits: int = 3) -> str:
    """Write a length in µm, from 1000 µm on in mm."""
    if value_um is None or not math.isfinite(value_um):
        return NONE
    if abs(value_um) >= 1000:
        return f"{number(value_um / 1000, digits)}{_SPACE}mm"
    return f"{number(value_um, digits)}{_SPACE}µm"


def plain(value_um: float) -> str:
    """Write a round length (a scale bar's, a pixel's) without trailing zeros."""
    value, name = (value_um / 1000, "mm") if abs(value_um) >= 1000 else (value_um, "µm")
    return f"{value:.6g}{_SPACE}{name}"


def in_words(title: str) -> str:
    """Put a title into a sentence: what follows a comma goes into brackets.

    Examples
    --------
    >>> in_words("Coating thickness, top side")
    'coating thickness (top side)'
    """
    head, comma, tail = title.partition(", ")
    head = head[:1].lower() + head[1:]
    return f"{head} ({tail})" if comma else head


def capital(text: str) -> str:
    """Begin a text with a capital letter and leave the rest as it is."""
    return f"{text[:1].upper()}{text[1:]}"


def typeset(text: str) -> str:
    r"""Write a sentence of the program's, whose units are ASCII, with the report's units.

    Examples
    --------
    >>> typeset("lag 2.1 um at 30 deg, maximum 3 um.")
    'lag 2.1\u202fµm at 30°, maximum 3\u202fµm.'
    """
    return _DEGREES.sub("°", _MICROMETRES.sub(f"{_SPACE}µm", text))


def with_article(layer: str) -> str:
    """Put a layer into a sentence: those without a name of their own are called by what they are."""
    return f"the {layer}" if layer in ("volume", "image", "sheet") else layer


def template(package: str, name: str) -> Template:
    """Return a template of a package, which may use those of the report and its filters."""
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    loader = ChoiceLoader([PackageLoader(package), PackageLoader("planish.report")])
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters.update(_FILTERS)
    return environment.get_template(name)


_FILTERS: dict[str, Any] = {"is_known": is_known, "length_um": length, "limit": with_unit} | {
    f.__name__: f for f in (capital, count, fixed, in_words, number, percent, typeset, unit, with_article)
}
"""How templates write numbers and words."""


def left_out(regions: object) -> str:
    """Name what the mask of valid pixels leaves out; ``regions`` is empty where none were declared."""
    return "holes, rims and declared regions" if regions else HOLES


def title_of(data: xr.DataArray) -> str:
    """Return the title of a map."""
    return str(data.attrs.get("long_name", data.name))


def unit_of(data: xr.DataArray) -> str:
    """Return the typeset unit of a map."""
    return unit(str(data.attrs.get("units", "um")))


def label_of(data: xr.DataArray) -> str:
    """Return the title of a map with its unit."""
    units = unit_of(data)
    return f"{title_of(data)} / {units}" if units else title_of(data)


def _signed(text: str) -> str:
    return text.replace(",", _SPACE).replace("-", "−")


def _superscript(value: int) -> str:
    return str(value).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
