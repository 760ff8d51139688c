"""The maps of a run that its page shows, on one grid, thinned out where they would make it too large."""

from __future__ import annotations

import base64
import math
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.area import halved
from planish.core.checks import POSITION, concerned, trust_of
from planish.core.errors import InputError
from planish.core.facts import Trust
from planish.core.grid import Grid
from planish.core.typing import Floats
from planish.exports.run_contents import IMAGE
from planish.io.map_store import overviews_of
from planish.io.run_folder import read_group
from planish.report.colours import Scale, colours_of
from planish.report.text import title_of, unit_of
from planish.results import LayerFacts, Results
from planish.run.run import MAPS, Run

Codes = NDArray[np.unsignedinteger[Any]]

_LEVEL = 6  # a higher one takes five times as long and saves 2 %


@dataclass(frozen=True, slots=True, kw_only=True)
class Packed:
    """A packed map.

    Attributes
    ----------
    text : str
        The differences of the codes, deflated, in base64.
    shape : (rows, cols)
    bits : {8, 16}
    order : {1, 2}
        Differences along the rows, or along the rows and then down the columns.
    low, step : float
        Value of code 2, and from one code to the next.
    beyond : int
        Values outside of the range.
    exact : bool
        Whether every value is that of its code, as with the whole numbers of a camera.
    """

    text: str
    shape: tuple[int, int]
    bits: int
    order: int
    low: float
    step: float
    beyond: int
    exact: bool

    @property
    def error(self) -> float:
        """Largest difference of a value from that of its code."""
        return 0.0 if self.exact else self.step / 2

    def spec(self) -> dict[str, Any]:
        """Give what the script needs to unpack it."""
        return {
            "rows": self.shape[0], "cols": self.shape[1], "bits": self.bits, "order": self.order, "low": self.low,
            "step": self.step,
        }  # fmt: skip


def packed(values: NDArray[Any], *, bits: int = 8) -> Packed:
    """Pack a map (rows, cols); NaN is missing.

    Eight bits leave 252 steps over the range of the values, sixteen 65 532. Where the outermost 0.05 % at an end would
    take a third of them, these are only known to lie beyond. Where all values lie a whole number of steps apart and
    there are codes enough, nothing is lost.
    """
    data = np.asarray(values, dtype=np.float64)
    finite = data[np.isfinite(data)]
    low, high = _range(finite)
    most = 2**bits - 1
    spacing = _spacing(finite, most - 3)
    step = spacing or (high - low) / (most - 3)
    low = float(finite.min()) if spacing else low
    step_counts = np.rint((np.where(np.isfinite(data), data, low) - low) / step)
    shown = np.clip(step_counts, -1, most - 2) + 2
    codes = np.where(np.isfinite(data), shown, 0).astype(np.uint8 if bits == 8 else np.uint16)
    order, text = min(((k, _deflated(codes, k)) for k in (1, 2)), key=lambda candidate: len(candidate[1]))
    return Packed(
        text=base64.b64encode(text).decode("ascii"), shape=(data.shape[0], data.shape[1]), bits=bits, order=order,
        low=low, step=step, beyond=int(np.count_nonzero((codes == 1) | (codes == most))), exact=spacing is not None,
    )  # fmt: skip


def _range(finite: Floats) -> tuple[float, float]:
    if not finite.size:
        return 0.0, 1.0
    least, most = float(finite.min()), float(finite.max())
    # Single values far off would take the digits: of them 0.05 % may lie beyond either end.
    low, high = map(float, np.percentile(finite, [0.05, 99.95]))
    if high > low and most - least > 1.5 * (high - low):
        least, most = low, high
    tiny = 1e-9 * max(abs(least), abs(most), 1e-300)
    return (least, most) if most - least > tiny else (least - 0.5, least + 0.5)


def _spacing(finite: Floats, most: int) -> float | None:
    """The step that all values lie a whole number of apart, where so few of them span the range; else None."""
    values = np.unique(finite)
    if values.size < 2:
        return None
    steps = np.diff(values)
    step = float(steps.min())
    if (values[-1] - values[0]) / step > most:
        return None
    whole = steps / step
    return step if np.abs(whole - np.rint(whole)).max() < 1e-6 else None


def _deflated(codes: Codes, order: int) -> bytes:
    """Deflate differences along the rows and, of second order, of those down the columns."""
    along = codes.copy()
    along[:, 1:] -= codes[:, :-1]
    differences = along.copy()
    if order == 2:
        differences[1:] -= along[:-1]
    if differences.dtype == np.uint8:
        return zlib.compress(differences.tobytes(), _LEVEL)
    # Small differences of either sign have a high byte of 0, and all high bytes stand together.
    signed = differences.view(np.int16)
    folded = ((signed << 1) ^ (signed >> 15)).view(np.uint16)
    return zlib.compress((folded & 255).astype(np.uint8).tobytes() + (folded >> 8).astype(np.uint8).tobytes(), _LEVEL)


BUDGET = 6_000_000
"""Letters that all maps may take."""

_MOST_PIXELS = 1_500_000  # of a map: what a browser colours anew in some milliseconds


@dataclass(frozen=True, slots=True, kw_only=True)
class PageMap:
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

    maps: tuple[PageMap, ...]
    groups: tuple[Group, ...]
    grid: Grid
    halvings: int
    headline: NDArray[np.float32]

    @property
    def titles(self) -> dict[tuple[str, str], str]:
        """Titles by layer and name."""
        return {(shown.layer, shown.name): shown.title for shown in self.maps}

    def letters(self) -> int:
        """Size of all that is packed."""
        more = [p for group in self.groups for p in (group.valid, *group.places.values()) if p is not None]
        return sum(len(codes.text) for codes in (*(shown.packed for shown in self.maps), *more))


def maps_of(run: Run) -> MapsOfPage:
    """Read and pack the maps of a run, halved until they fit into the budget.

    Raises
    ------
    InputError
        If the run holds no maps.
    """
    wanted = _map_names(run)
    shape = Grid.of(run.groups[wanted[0][0]]).shape
    count = sum(len(names) for _, names in wanted)
    most = min(_MOST_PIXELS, 2 * BUDGET // max(1, count))  # two pixels a letter at best
    halvings = max(0, math.ceil(math.log(shape[0] * shape[1] / most, 4)))
    while (maps := _packed_maps(run, wanted, halvings)).letters() > BUDGET:
        halvings += 1
    return maps


def _map_names(run: Run) -> list[tuple[str, list[str]]]:
    """Groups and the names of their maps: the headline of each first, then what it is compared with."""
    results, groups = run.results, run.groups
    names = ["linked"] if "linked" in groups else [f"layers/{layer.name}" for layer in results.layers]
    names = [name for name in names if name in groups] or [name for name in ("maps",) if name in groups]
    if not names:
        raise InputError(f"The run holds no maps to show; it holds {', '.join(groups) or 'nothing'}.")
    wanted: list[tuple[str, list[str]]] = []
    for name in names:
        data = groups[name]
        float_maps = [str(k) for k, v in data.data_vars.items() if v.ndim == 2 and v.dtype.kind == "f"]
        hidden = "volume_", "projected_", "presence", "error_"  # beginnings of names
        maps = [k for k in float_maps if not k.startswith(hidden) and k not in ("u", "v") and not k.endswith("_se")]
        first = [layer.headline for layer in results.layers if name in ("linked", "maps", f"layers/{layer.name}")]
        listed = [k for layer in results.layers if layer.sheet for k in layer.sheet.properties]
        order = {k: rank for rank, k in reversed([*enumerate([*first, *listed])])}
        wanted.append((name, sorted(maps, key=lambda k: (order.get(k, len(order)), k))))
    return wanted


def _packed_maps(run: Run, wanted: list[tuple[str, list[str]]], halvings: int) -> MapsOfPage:
    results = run.results
    maps: list[PageMap] = []
    groups: list[Group] = []
    grid, headline = None, None
    for group, (name, names) in enumerate(wanted):
        places = [f"volume_{axis}" for axis in "xyz"]
        stored = run.groups[name]
        placed = all(place in stored for place in places)
        extra_names = [*(places if placed else []), *(["valid"] if "valid" in stored else [])]
        data = _halved_maps(run, name, names + extra_names, halvings)
        grid = grid or Grid.of(data)
        valid = data["valid"].values.astype(bool) if "valid" in data else np.True_
        groups.append(Group(
            valid=packed(np.where(valid, 1.0, np.nan)) if "valid" in data else None,
            places={axis: packed(data[f"volume_{axis}"].values, bits=16) for axis in "xyz"} if placed else {},
            sheet=_layer_of(results, name, "").name if placed else "",
        ))  # fmt: skip
        for key in names:
            layer = _layer_of(results, name, key)
            layer_map = data[key].rename(key)
            values = layer_map.values
            counted = values[np.isfinite(values) & valid].astype(np.float64)
            if headline is None:
                headline = np.where(valid, values, np.nan).astype(np.float32)
            maps.append(_packed_map(layer_map, counted, layer, results, group))
    assert grid is not None
    assert headline is not None
    maps.sort(key=lambda shown: shown.name != _layer_of(results, wanted[shown.group][0], shown.name).headline)
    return MapsOfPage(maps=tuple(maps), groups=tuple(groups), grid=grid, halvings=halvings, headline=headline)


def _packed_map(data: xr.DataArray, counted: Floats, layer: LayerFacts, results: Results, group: int) -> PageMap:
    name = str(data.name)
    figure = POSITION if name == "expected_error" else name
    checks = concerned(results.checks, (layer.name,), (figure,))
    scale = colours_of(data, counted)
    pack = packed(data.values)
    # Single values, such as holes, may take most steps, with few between the limits of the colours.
    if (scale.high - scale.low) / pack.step < 100:
        pack = packed(data.values, bits=16)
    # Per cent of the values that the scatter spans.
    low, high = map(float, np.percentile(counted, (0.05, 99.95))) if counted.size else (0.0, 1.0)
    return PageMap(
        layer=layer.name, name=name, title=title_of(data), units=unit_of(data), packed=pack, scale=scale,
        span=(low, high) if low < high else (low - 0.5, low + 0.5),
        group=group, trust=trust_of(results.checks, (layer.name,), (figure,)),
        why=tuple(check.name for check in checks if check.state in ("fail", "look")),
    )  # fmt: skip


def _halved_maps(run: Run, name: str, names: list[str], halvings: int) -> xr.Dataset:
    """Maps of a group, halved so often: from the store's own smaller copies as far as it has them."""
    assert run.folder is not None
    store = run.folder / MAPS
    copies = overviews_of(store, name)[:halvings]
    data = read_group(store, copies[-1], names) if copies else run.groups[name][names].compute()
    for _ in range(halvings - len(copies)):
        data = halved(data)
    return data


def _layer_of(results: Results, group: str, name: str) -> LayerFacts:
    """The layer that a map of a group is of."""
    if group.startswith("layers/"):
        return results.layer(group.removeprefix("layers/"))
    kind = "image" if name == IMAGE else "sheet"
    return next(layer for layer in results.layers if layer.kind == kind)


def map_spec(shown: PageMap) -> dict[str, Any]:
    """Give what the script needs of a map, beside its values."""
    digits = max(0, min(6, math.ceil(-math.log10(shown.packed.step))))
    return {
        "title": shown.title, "layer": shown.layer, "units": shown.units, "digits": digits, "error": shown.packed.error,
        "range": [shown.scale.low, shown.scale.high], "colours": shown.scale.colours, "span": list(shown.span),
        "group": shown.group, "trust": shown.trust, "why": list(shown.why),
    }  # fmt: skip
