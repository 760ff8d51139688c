"""The maps of a run that its page shows, on one grid, thinned out where they would make it too large."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.app.exploring.packing import Packed, packed
from planish.core.checks import POSITION, concerned
from planish.core.errors import InputError
from planish.core.grid import Grid
from planish.core.overviews import halved
from planish.core.results import LayerFacts, Results, Trust
from planish.io.map_store import OVERVIEWS
from planish.io.run_folder import read_group
from planish.pipeline.checks import trust_of
from planish.pipeline.run import MAPS
from planish.pipeline.taken import IMAGE, Taken
from planish.report.colours import Scale
from planish.report.maps import colours_of
from planish.report.text import title_of, unit_of

BUDGET = 6_000_000
"""Letters that all maps may take."""

_MOST_PIXELS = 1_500_000  # of a map: what a browser colours anew in some milliseconds
_NOT_SHOWN = ("volume_", "projected_", "presence", "error_")  # beginnings of names
_PLACES = ("u", "v")
_LEAST_STEPS = 100  # of the values between the limits of the colours
_SPAN = (0.05, 99.95)  # per cent of the values that the scatter spans


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """One map of the page.

    Attributes
    ----------
    layer, name, title, units : str
        ``units`` typeset.
    packed : Packed
    scale : Scale
        Colours and their limits, those of the report.
    span : (float, float)
        What the scatter spans.
    group : int
        Which of the masks of valid pixels is its own.
    trust : Trust
        What the checks leave of it, by those in ``why``.
    """

    layer: str
    name: str
    title: str
    units: str
    packed: Packed
    scale: Scale
    span: tuple[float, float]
    group: int
    trust: Trust
    why: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Group:
    """What the maps of one layer, or of a sheet and an image, have in common.

    Attributes
    ----------
    valid : Packed or None
        Where pixels count.
    places : dict of Packed
        Places in the volume by axis; empty of an image.
    sheet : str
        Name of the sheet, empty where there is none.
    """

    valid: Packed | None
    places: dict[str, Packed]
    sheet: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapsOfPage:
    """All maps, their common grid, and how often it was halved; ``headline`` are the values that lead, NaN outside."""

    maps: tuple[Shown, ...]
    groups: tuple[Group, ...]
    grid: Grid
    halvings: int
    headline: NDArray[np.float32]

    @property
    def titles(self) -> dict[tuple[str, str], str]:
        """Titles by layer and name."""
        return {(one.layer, one.name): one.title for one in self.maps}

    def letters(self) -> int:
        """Size of all that is packed."""
        more = [p for group in self.groups for p in (group.valid, *group.places.values()) if p is not None]
        return sum(len(one.text) for one in (*(shown.packed for shown in self.maps), *more))


def maps_of(taken: Taken) -> MapsOfPage:
    """Read and pack the maps of a run, halved until they fit into the budget.

    Raises
    ------
    InputError
        If the run holds no maps.
    """
    wanted = _wanted(taken)
    shape = next(iter(_sizes(taken, wanted)))
    most = min(
        _MOST_PIXELS, 2 * BUDGET // max(1, sum(len(names) for _, names in wanted))
    )  # two pixels a letter at best
    halvings = max(0, math.ceil(math.log(shape[0] * shape[1] / most, 4)))
    while (found := _packed(taken, wanted, halvings)).letters() > BUDGET:
        halvings += 1
    return found


def _wanted(taken: Taken) -> list[tuple[str, list[str]]]:
    """Groups and the names of their maps: the headline of each first, then what it is compared with."""
    results, groups = taken.results, taken.groups
    names = ["linked"] if "linked" in groups else [f"layers/{one.name}" for one in results.layers]
    names = [name for name in names if name in groups] or [name for name in ("maps",) if name in groups]
    if not names:
        raise InputError(f"The run holds no maps to show; it holds {', '.join(groups) or 'nothing'}.")
    out: list[tuple[str, list[str]]] = []
    for name in names:
        data = taken.group(name)
        known = [str(k) for k, v in data.data_vars.items() if v.ndim == 2 and v.dtype.kind == "f"]
        maps = [k for k in known if not k.startswith(_NOT_SHOWN) and k not in _PLACES and not k.endswith("_se")]
        first = [layer.headline for layer in results.layers if name in ("linked", "maps", f"layers/{layer.name}")]
        listed = [k for layer in results.layers if layer.sheet for k in layer.sheet.properties]
        order = {k: at for at, k in reversed([*enumerate([*first, *listed])])}
        out.append((name, sorted(maps, key=lambda k: (order.get(k, len(order)), k))))
    return out


def _sizes(taken: Taken, wanted: list[tuple[str, list[str]]]) -> Iterator[tuple[int, int]]:
    for name, _ in wanted:
        data = taken.group(name)
        yield Grid.of(data).shape


def _packed(taken: Taken, wanted: list[tuple[str, list[str]]], halvings: int) -> MapsOfPage:
    results = taken.results
    maps: list[Shown] = []
    groups: list[Group] = []
    grid, headline = None, None
    for at, (name, names) in enumerate(wanted):
        places = [f"volume_{axis}" for axis in "xyz"]
        there = taken.group(name)
        placed = all(place in there for place in places)
        data = _smaller(taken, name, [*names, *(places if placed else []), *(["valid"] if "valid" in there else [])],
                        halvings)  # fmt: skip
        grid = grid or Grid.of(data)
        valid = data["valid"].values.astype(bool) if "valid" in data else None
        groups.append(Group(
            valid=None if valid is None else packed(np.where(valid, 1.0, np.nan)),
            places={axis: packed(data[f"volume_{axis}"].values, bits=16) for axis in "xyz"} if placed else {},
            sheet=_sheet_of(results, name).name if placed else "",
        ))  # fmt: skip
        for key in names:
            layer = _layer_of(results, name, key)
            one = data[key].rename(key)
            values = one.values
            counted = values[np.isfinite(values) & (True if valid is None else valid)].astype(np.float64)
            if headline is None:
                headline = np.where(True if valid is None else valid, values, np.nan).astype(np.float32)
            maps.append(_shown(one, counted, layer, results, at))
    assert grid is not None
    assert headline is not None
    lead = [one for one in maps if one.name == _layer_of(results, wanted[one.group][0], one.name).headline]
    rest = [one for one in maps if one not in lead]
    return MapsOfPage(maps=(*lead, *rest), groups=tuple(groups), grid=grid, halvings=halvings, headline=headline)


def _shown(data: xr.DataArray, counted: NDArray[np.float64], layer: LayerFacts, results: Results, group: int) -> Shown:
    name = str(data.name)
    figure = POSITION if name == "expected_error" else name
    found = concerned(results.checks, (layer.name,), (figure,))
    scale = colours_of(data, counted)
    pack = packed(data.values)
    if (scale.high - scale.low) / pack.step < _LEAST_STEPS:  # single values, such as holes, take most of them
        pack = packed(data.values, bits=16)
    span = tuple(float(v) for v in np.percentile(counted, _SPAN)) if counted.size else (0.0, 1.0)
    return Shown(
        layer=layer.name, name=name, title=title_of(data), units=unit_of(data), packed=pack, scale=scale,
        span=(span[0], span[-1]) if span[0] < span[-1] else (span[0] - 0.5, span[0] + 0.5),
        group=group, trust=trust_of(results.checks, (layer.name,), (figure,)),
        why=tuple(check.name for check in found if check.state in ("fail", "look")),
    )  # fmt: skip


def _smaller(taken: Taken, name: str, names: list[str], halvings: int) -> xr.Dataset:
    """Maps of a group, halved so often: from the store's own smaller copies as far as it has them."""
    k, data = halvings, None
    while k and data is None:
        held = taken.folder is not None and not taken.all_held
        if held and (taken.folder / MAPS / OVERVIEWS / name / str(k)).is_dir():  # type: ignore[operator]
            data = read_group(taken.folder / MAPS, f"{OVERVIEWS}/{name}/{k}", names)  # type: ignore[operator]
        else:
            k -= 1
    data = (taken.group(name)[names] if data is None else data).load()
    for _ in range(halvings - k):
        data = halved(data)
    return data


def _layer_of(results: Results, group: str, name: str) -> LayerFacts:
    """The layer that a map of a group is of."""
    if group.startswith("layers/"):
        return results.layer(group.removeprefix("layers/"))
    kind = "image" if name == IMAGE else "sheet"
    return next(layer for layer in results.layers if layer.kind == kind)


def _sheet_of(results: Results, group: str) -> LayerFacts:
    return _layer_of(results, group, "")


def extra(one: Shown) -> dict[str, Any]:
    """What the script needs of a map, beside its values."""
    digits = max(0, min(6, math.ceil(-math.log10(one.packed.step))))
    return {
        "title": one.title, "layer": one.layer, "units": one.units, "digits": digits, "error": one.packed.error,
        "range": [one.scale.low, one.scale.high], "colours": one.scale.colours, "span": list(one.span),
        "group": one.group, "trust": one.trust, "why": list(one.why),
    }  # fmt: skip
