"""The maps of a run, or of a Dataset, by the names that questions give them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import xarray as xr

from planish.analyze.shared_errors import bare_name
from planish.core.arrays import check_dataset
from planish.core.errors import InputError
from planish.run.overlay import LINKED
from planish.run.run import Run

EXPLAINED, OCTAVES = "explained", "octaves"
"""Groups of a run by what its study asks: residuals of its model, and bands of its maps."""

_NO_PROPERTY = re.compile(
    "valid$|status$|[uv]$|volume_|projected_|presence|expected_error|error_|.*_se$"
)
"""Maps that say where and how sure, and are named in no list of choices."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NamedMap:
    """A map, and the layer and group that it is of."""

    values: xr.DataArray
    layer: str
    group: xr.Dataset


def maps_of(run: Run) -> dict[str, NamedMap]:
    """All maps of a run by name; by LAYER.MAP, and by MAP where one layer has it."""
    reference = run.results.reference.name
    groups = [(f"{layer}.", layer, group) for layer, group in run.layers.items()]
    if not groups:
        name = LINKED if LINKED in run.groups else "maps"
        groups = [("", run.results.layers[0].name, run.groups[name])]
    maps: dict[str, NamedMap] = {}
    for prefix, layer, group in groups:
        for name, values in group.items():
            of_layer = reference if name == "image" and not prefix else layer
            maps[f"{prefix}{name}"] = NamedMap(values=values, layer=of_layer, group=group)
    counts = Counter(bare_name(key) for key in maps)
    return {bare_name(key): m for key, m in maps.items() if counts[bare_name(key)] == 1} | maps


def maps_of_dataset(data: xr.Dataset, verb: str) -> dict[str, NamedMap]:
    """All maps of a Dataset on one grid, by name; errors call ``pl.VERB``."""
    data = _on_known_axes(data)
    check_dataset(
        data,
        expected="maps on one grid",
        call_format=f"pl.{verb}({{}})",
        source="pl.resample_maps(...)",
    )
    if "valid" in data:
        data = data.assign(valid=data["valid"] > 0)  # a missing one is not
    return {str(name): NamedMap(values=m, layer="", group=data) for name, m in data.items()}


def named(maps: Mapping[str, NamedMap], name: str) -> NamedMap:
    """The map of a name; InputError where there is none."""
    if name in maps:
        return maps[name]
    raise InputError(f"There is no map {name!r}. There are {', '.join(choices(maps))}.")


def choices(maps: Mapping[str, NamedMap]) -> list[str]:
    """Names of the maps that can be asked for."""
    return [key for key in maps if not _NO_PROPERTY.match(bare_name(key))]


def _on_known_axes(data: xr.Dataset) -> xr.Dataset:
    """The same maps with axes (v, u) where theirs have other names than planish's own."""
    for values in data.data_vars.values():
        if values.ndim == 2 and values.dims not in (("y", "x"), ("v", "u")):
            return data.rename({values.dims[0]: "v", values.dims[1]: "u"})
    return data
