"""How numbers and units are written: digits that mean something, real minus signs, typeset units."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any

from planish.core.facts import is_known
from planish.core.numbers import NONE as NONE
from planish.core.numbers import beside as beside
from planish.core.numbers import capital as capital
from planish.core.numbers import count as count
from planish.core.numbers import fixed as fixed
from planish.core.numbers import in_words as in_words
from planish.core.numbers import number as number
from planish.core.numbers import percent as percent
from planish.core.numbers import plain as plain
from planish.core.numbers import unit as unit

if TYPE_CHECKING:
    import xarray as xr
    from jinja2 import Template

REGISTERED = "registration: marks only"  # stands beside every correlation: how its maps were registered
HOLES = "holes and rims"  # what the mask of valid pixels leaves out where no regions were declared
_SPACE = "\u202f"  # narrow, and no line break: between a number and its unit, and between thousands
_MICROMETRES, _DEGREES = re.compile(r" um\b"), re.compile(r" deg\b")


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
    writers = (is_known, capital, count, fixed, in_words, number, percent, typeset, unit, with_article)
    filters: dict[str, Any] = {"length_um": length, "limit": with_unit} | {f.__name__: f for f in writers}
    environment.filters.update(filters)
    return environment.get_template(name)


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
    return axis_label(title_of(data), unit_of(data))


def axis_label(title: str, units: str) -> str:
    """Write a title, such as that of an axis, with its unit."""
    return f"{title} / {units}" if units else title
