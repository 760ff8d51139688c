"""The maps of a run, or of a Dataset, by the names that questions give them."""

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import xarray as xr

from planish.analyze.params import ExplainParams, ScalesParams
from planish.analyze.shared_errors import bare_name
from planish.core.arrays import check_dataset
from planish.core.checks import trust_of
from planish.core.errors import InputError
from planish.core.facts import Trust
from planish.core.options import Params
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


NamedMaps = dict[str, NamedMap]
"""Maps by their names, as choices list them."""


def maps_of(run: Run) -> NamedMaps:
    """All maps of a run by name; by LAYER.MAP, and by MAP where one layer has it."""
    maps: NamedMaps = {}
    for layer, group in run.layers.items():
        for name, values in group.items():
            maps[f"{layer}.{name}"] = NamedMap(values=values, layer=layer, group=group)
    if maps:
        counts = Counter(map(bare_name, maps))
        single = [key for key in maps if counts[bare_name(key)] == 1]
        return {bare_name(key): maps[key] for key in single} | maps
    layers = run.results.layers
    group = run.groups[LINKED if LINKED in run.groups else "maps"]
    for name, values in group.items():
        layer = layers[-1 if name == "image" else 0].name
        maps[str(name)] = NamedMap(values=values, layer=layer, group=group)
    return maps


def maps_of_dataset(data: xr.Dataset, verb: str) -> NamedMaps:
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


def named(maps: NamedMaps, name: str) -> NamedMap:
    """The map of a name; InputError where there is none."""
    if name in maps:
        return maps[name]
    raise InputError(f"There is no map {name!r}. There are {', '.join(choices(maps))}.")


def trust_of_maps(run: Run, maps: Iterable[NamedMap], *figures: str) -> Trust:
    """What the checks of a run leave of an answer about some of its maps, and of other figures."""
    maps = list(maps)
    names = [str(m.values.name) for m in maps]
    return trust_of(run.results.checks, {m.layer for m in maps}, [*names, *figures])


def is_declared(declared: ExplainParams | ScalesParams, params: Params) -> bool | None:
    """Whether a study declared this very question; None where it declares none."""
    return declared == params if declared.is_declared else None


def with_answer(run: Run, groups: Mapping[str, xr.Dataset] | None = None, **answer: object) -> Run:
    """The same run with what its study asks in its results, and with the maps of that.

    Parameters
    ----------
    run : Run
    groups : mapping of name to Dataset, optional
        Maps of the answer.
    **answer
        Fields of the results.
    """
    results = run.results.model_copy(update=answer)
    if not groups:
        return replace(run, results=results)
    return replace(run, results=results, groups={**run.groups, **groups})


def choices(maps: NamedMaps) -> list[str]:
    """Names of the maps that can be asked for."""
    return [key for key in maps if not _NO_PROPERTY.match(bare_name(key))]


def _on_known_axes(data: xr.Dataset) -> xr.Dataset:
    """The same maps with axes (v, u) where theirs have other names than planish's own."""
    for values in data.data_vars.values():
        if values.ndim == 2 and values.dims not in (("y", "x"), ("v", "u")):
            return data.rename({values.dims[0]: "v", values.dims[1]: "u"})
    return data
