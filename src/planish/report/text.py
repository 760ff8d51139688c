"""What the pages of runs, series and certificates share.

That is templates with their filters, titles and units of maps.
"""

from __future__ import annotations

import os
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

from planish.core import numbers
from planish.core.facts import is_known
from planish.core.source_hash import hash_sources
from planish.core.typing import Entries
from planish.measure.registry import NEGATIVE_CONTROLS

if TYPE_CHECKING:
    import xarray as xr
    from jinja2 import Template

    from planish.results import Results

TwoTexts = tuple[str, str]  # such as titles, units or layers of two maps, in their order

# Stands beside every correlation: how its maps were registered.
REGISTERED = "registration: marks only"
BY_TEXTURE = "registration: the texture of both maps"
BY_BOTH = "registration: marks and the texture of both maps"
LIGHT_OFF = "a quadratic field of light taken off the image, as declared"
HOLES = "holes and rims"  # what the mask of valid pixels leaves out where no regions were declared


class Basis(NamedTuple):
    """What figures rest on, in words: what the mask leaves out, and what registered the maps."""

    excluded: str = HOLES
    registered: str = REGISTERED


def registered_by(results: Results) -> str:
    """Say what registered the maps of a run: marks, or the texture that is compared as well."""
    sources = {layer.registration.source for layer in results.layers if layer.registration}
    if "texture" in sources:
        return BY_TEXTURE
    if "both" in sources:
        return BY_BOTH
    return REGISTERED


def stated_of(results: Results) -> str:
    """Say what registered the maps and, where it was declared, that a field of light is off."""
    light_text = f"; {LIGHT_OFF}" if results.is_light_off else ""
    return registered_by(results) + light_text


@cache
def template(package: str, name: str) -> Template:
    """Return a template of a package, which may use those of the report and its filters."""
    import jinja2
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    from planish.core.jit import cache_folder

    # What is compiled of a template depends on the environment that is made here.
    folder = cache_folder(os.environ.get("NUMBA_CACHE_DIR", ""))
    compiled = None  # kept in memory alone where there is no folder to write to
    if folder:
        file_format = f"{jinja2.__version__}-{hash_sources('text.py')}-%s"
        compiled = jinja2.FileSystemBytecodeCache(folder, file_format)
    loader = ChoiceLoader([PackageLoader(package), PackageLoader("planish.report")])
    environment = Environment(
        loader=loader,
        bytecode_cache=compiled,
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    filter_names = (
        "capital",
        "count",
        "fixed",
        "in_words",
        "number",
        "percent",
        "typeset",
        "unit",
        "with_article",
    )
    filters: Entries = {name: getattr(numbers, name) for name in filter_names}
    filters |= {"length_um": numbers.length, "limit": numbers.with_unit, "is_known": is_known}
    environment.filters.update(filters)
    return environment.get_template(name)


def left_out(regions: object) -> str:
    """Name what the mask of valid pixels leaves out.

    ``regions`` is empty where none were declared.
    """
    return "holes, rims and declared regions" if regions else HOLES


def title_of(data: xr.DataArray) -> str:
    """Return the title of a map."""
    return str(data.attrs.get("long_name", data.name))


def as_compared(title: str, name: str) -> str:
    """Return the title of a map as it stands beside an r: a negative control is called one."""
    return f"{title} (negative control)" if name in NEGATIVE_CONTROLS else title


def unit_of(data: xr.DataArray) -> str:
    """Return the typeset unit of a map."""
    return numbers.unit(str(data.attrs.get("units", "um")))


def label_of(data: xr.DataArray) -> str:
    """Return the title of a map with its unit."""
    return numbers.axis_label(title_of(data), unit_of(data))
