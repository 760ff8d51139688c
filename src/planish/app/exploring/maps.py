"""The maps of a run that its page shows, on one grid.

They are thinned out where they would make the page too large.
"""

import base64
import math
import re
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
from planish.core.typing import Array, Entries, Floats, Pair, Shape2D, Singles, Texts
from planish.exports.run_contents import IMAGE
from planish.io.map_groups import read_group
from planish.io.map_store import overviews_of
from planish.report.colours import Scale, colours_of
from planish.report.text import as_compared, title_of, unit_of
from planish.results import LayerFacts, Results
from planish.run.named_maps import EXPLAINED, OCTAVES
from planish.run.run import MAPS, Run

Codes = NDArray[np.unsignedinteger[Any]]
_ZLIB_LEVEL = 6  # a higher one takes five times as long and saves 2 %


@dataclass(frozen=True, slots=True, kw_only=True)
class Packed:
    """A packed map."""

    text: str  # the differences of the codes, deflated, in base64
    shape: Shape2D
    bits: int  # 8 or 16
    order: int  # differences along the rows (1), or along the rows and then down the columns (2)
    low: float  # value of code 2
    step: float  # from one code to the next
    beyond: int  # values outside of the range
    exact: bool  # whether every value is that of its code, as with the whole numbers of a camera

    @property
    def error(self) -> float:
        """Largest difference of a value from that of its code."""
        return 0.0 if self.exact else self.step / 2

    def spec(self) -> Entries:
        """Give what the script needs to unpack it."""
        return {
            "rows": self.shape[0],
            "cols": self.shape[1],
            "bits": self.bits,
            "order": self.order,
            "low": self.low,
            "step": self.step,
        }


def packed(values: Array, *, bits: int = 8) -> Packed:
    """Pack a map (rows, cols); NaN is missing.

    Eight bits leave 252 steps over the range of the values, sixteen 65 532. Where the outermost
    0.05 % at an end would take a third of them, these are only known to lie beyond. Whole multiples
    of a step lose nothing if codes suffice.
    """
    numbers = np.asarray(values, np.float64)
    finite = numbers[np.isfinite(numbers)]
    low, high = _range(finite)
    # Code 0 is missing, 1 and the last are beyond the range on either side.
    last_code = 2**bits - 1
    spacing = _spacing(finite, last_code - 3)
    step = spacing or (high - low) / (last_code - 3)
    low = float(finite.min()) if spacing else low
    nearest = np.rint((numbers - low) / step)
    clipped = np.clip(nearest, -1, last_code - 2) + 2
    dtype = np.uint8 if bits == 8 else np.uint16
    codes = np.where(np.isfinite(numbers), clipped, 0).astype(dtype)
    deflated_by = {order: _deflated(codes, order) for order in (1, 2)}
    order = min(deflated_by, key=lambda order: len(deflated_by[order]))
    return Packed(
        text=base64.b64encode(deflated_by[order]).decode("ascii"),
        shape=(codes.shape[0], codes.shape[1]),
        bits=bits,
        order=order,
        low=low,
        step=step,
        beyond=int(((codes == 1) | (codes == last_code)).sum()),
        exact=spacing is not None,
    )


def _range(finite: Floats) -> Pair:
    """Smallest and largest value, or what all but few lie between; never the same number twice."""
    if not finite.size:
        return 0.0, 1.0
    minimum = float(finite.min())
    maximum = float(finite.max())
    # Single values far off would take the digits: of them 0.05 % may lie beyond either end.
    low, high = map(float, np.percentile(finite, [0.05, 99.95]))
    if high > low and maximum - minimum > 1.5 * (high - low):
        minimum = low
        maximum = high
    tolerance = 1e-9 * max(abs(minimum), abs(maximum), 1e-300)
    if maximum - minimum > tolerance:
        return minimum, maximum
    return minimum - 0.5, minimum + 0.5


def _spacing(finite: Floats, max_steps: int) -> float | None:
    """The step that all values lie a whole number of apart, where so few of them span the range.

    Else None.
    """
    unique = np.unique(finite)
    if unique.size < 2:
        return None
    differences = np.diff(unique)
    step = float(differences.min())
    if (unique[-1] - unique[0]) / step > max_steps:
        return None
    step_counts = differences / step
    if np.abs(step_counts - np.rint(step_counts)).max() < 1e-6:
        return step
    return None


def _deflated(codes: Codes, order: int) -> bytes:
    """Differences of codes (rows, cols) along the rows, and with ``order`` 2 down the columns too.

    Without sign they wrap around, which the sums of the script undo.
    """
    row_differences = codes.copy()
    row_differences[:, 1:] -= codes[:, :-1]
    differences = row_differences.copy()
    if order == 2:
        differences[1:] -= row_differences[:-1]
    if differences.dtype == np.uint8:
        return zlib.compress(differences.tobytes(), _ZLIB_LEVEL)
    # Small differences of either sign have a high byte of 0, and all high bytes stand together.
    signed = differences.view(np.int16)
    zigzag = ((signed << 1) ^ (signed >> 15)).view(np.uint16)
    low_bytes = (zigzag & 255).astype(np.uint8)
    high_bytes = (zigzag >> 8).astype(np.uint8)
    return zlib.compress(low_bytes.tobytes() + high_bytes.tobytes(), _ZLIB_LEVEL)


BUDGET = 6_000_000
"""Letters that all maps may take."""

_MAX_PIXELS = 1_500_000  # of a map: what a browser colours anew in some milliseconds


@dataclass(frozen=True, slots=True, kw_only=True)
class PageMap:
    """One map of the page."""

    layer: str
    name: str
    title: str
    units: str  # typeset
    packed: Packed
    scale: Scale  # colours and their limits, those of the report
    scatter_limits: Pair  # what the scatter spans
    group_index: int  # which of the masks of valid pixels is its own
    trust: Trust  # what the checks leave of it
    check_names: Texts  # those that doubt it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Group:
    """What the maps of one layer, or of a sheet and an image, have in common."""

    valid: Packed | None  # where pixels count
    coordinates: dict[str, Packed]  # places in the volume by axis; empty of an image
    sheet: str  # name of the sheet, empty where there is none


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapsOfPage:
    """All maps, their common grid, and how often it was halved.

    ``headline`` are the values that lead, NaN outside.
    """

    maps: tuple[PageMap, ...]
    groups: tuple[Group, ...]
    grid: Grid
    halvings: int
    headline: Singles

    def letters(self) -> int:
        """Size of all that is packed."""
        grids = [m.packed for m in self.maps]
        for group in self.groups:
            grids += group.coordinates.values()
            if group.valid is not None:
                grids.append(group.valid)
        return sum(len(grid.text) for grid in grids)


MapNames = list[tuple[str, list[str]]]  # groups of a run, and their maps


def maps_of(run: Run) -> MapsOfPage:
    """Read and pack the maps of a run, halved until they fit into the budget.

    InputError where it holds none.
    """
    map_names = _map_names(run)
    shape = Grid.of(run.groups[map_names[0][0]]).shape
    n_maps = sum(len(names) for _, names in map_names)
    max_pixels = min(_MAX_PIXELS, 2 * BUDGET // max(1, n_maps))  # two pixels a letter at best
    halvings = max(0, math.ceil(math.log(shape[0] * shape[1] / max_pixels, 4)))
    while (maps := _packed_maps(run, map_names, halvings)).letters() > BUDGET:
        halvings += 1
    return maps


def _group_names(run: Run) -> list[str]:
    """Groups whose maps are shown: what was linked, or was mapped, and what a model made of it."""
    names = [f"layers/{layer.name}" for layer in run.results.layers]
    if "linked" in run.groups:
        names = ["linked"]
    elif "maps" in run.groups and not any(name in run.groups for name in names):
        names = ["maps"]
    names = [name for name in (*names, EXPLAINED, OCTAVES) if name in run.groups]
    if not names:
        raise InputError(
            f"The run holds no maps to show; it holds {', '.join(run.groups) or 'nothing'}."
        )
    return names


def _map_names(run: Run) -> MapNames:
    """Groups and the names of their maps: each headline first, then what it is compared with."""
    layers = run.results.layers
    properties = [name for layer in layers if layer.sheet for name in layer.sheet.properties]
    map_names: MapNames = []
    for group in _group_names(run):
        of_all = group in ("linked", "maps")
        headlines = [x.headline for x in layers if of_all or group == f"layers/{x.name}"]
        order = [*headlines, *properties]
        last = len({*order})
        names = [str(name) for name, data in run.groups[group].items() if _is_shown(data)]
        ranks = {name: order.index(name) if name in order else last for name in names}
        map_names.append((group, sorted(names, key=lambda name: (ranks[name], name))))
    return map_names


_HIDDEN = re.compile("volume_|projected_|presence|error_|[uv]$|.*_se$")


def _is_shown(data: xr.DataArray) -> bool:
    return data.ndim == 2 and data.dtype.kind == "f" and not _HIDDEN.match(str(data.name))


def _packed_maps(run: Run, map_names: MapNames, halvings: int) -> MapsOfPage:
    """Pack the maps of all groups, those that lead first."""
    results = run.results
    maps: list[PageMap] = []
    groups: list[Group] = []
    grid = headline = None
    for group_index, (group, names) in enumerate(map_names):
        extra_names = [f"volume_{axis}" for axis in "xyz"] + ["valid"]
        extra_names = [name for name in extra_names if name in run.groups[group]]
        dataset = _halved_maps(run, group, names + extra_names, halvings)
        grid = grid or Grid.of(dataset)
        is_valid = np.True_
        valid = None
        if "valid" in dataset:
            is_valid = dataset["valid"].values.astype(bool)
            valid = packed(np.where(is_valid, 1.0, np.nan))
        coordinates: dict[str, Packed] = {}
        sheet = ""
        if "volume_x" in dataset:
            sheet = _layer_of_map(results, group, "").name
            for axis in "xyz":
                coordinates[axis] = packed(dataset[f"volume_{axis}"].values, bits=16)
        groups.append(Group(valid=valid, coordinates=coordinates, sheet=sheet))
        for name in names:
            layer = _layer_of_map(results, group, name)
            layer_map = dataset[name].rename(name)
            values = layer_map.values
            valid_values = values[np.isfinite(values) & is_valid].astype(np.float64)
            if headline is None:
                headline = np.where(is_valid, values, np.nan).astype(np.float32)
            maps.append(_packed_map(layer_map, valid_values, layer, results, group_index))
    assert grid is not None
    assert headline is not None
    maps.sort(key=lambda m: m.name != results.layer(m.layer).headline)
    return MapsOfPage(
        maps=tuple(maps), groups=tuple(groups), grid=grid, halvings=halvings, headline=headline
    )


def _packed_map(
    data: xr.DataArray, valid_values: Floats, layer: LayerFacts, results: Results, group_index: int
) -> PageMap:
    """Pack a map, with its colours, its title, and what the checks say of it.

    ``valid_values`` are those that count; ``group_index`` is the number of the map's group.
    """
    name = str(data.name)
    title = as_compared(title_of(data), name) if results.is_link else title_of(data)
    figure = POSITION if name == "expected_error" else name
    checks = concerned(results.checks, (layer.name,), (figure,))
    scale = colours_of(data, valid_values)
    packed_map = packed(data.values)
    # Single values, such as holes, may take most steps, with few between the limits of the colours.
    if (scale.high - scale.low) / packed_map.step < 100:
        packed_map = packed(data.values, bits=16)
    # Per cent of the values that the scatter spans.
    low = 0.0
    high = 1.0
    if valid_values.size:
        low, high = map(float, np.percentile(valid_values, (0.05, 99.95)))
    return PageMap(
        layer=layer.name,
        name=name,
        title=title,
        units=unit_of(data),
        packed=packed_map,
        scale=scale,
        scatter_limits=(low, high) if low < high else (low - 0.5, low + 0.5),
        group_index=group_index,
        trust=trust_of(results.checks, (layer.name,), (figure,)),
        check_names=tuple(check.name for check in checks if check.state in ("fail", "look")),
    )


def _halved_maps(run: Run, group: str, names: list[str], halvings: int) -> xr.Dataset:
    """Maps of a group, halved so often: from the store's smaller copies as far as it has them."""
    assert run.folder is not None
    store = run.folder / MAPS
    overviews = overviews_of(store, group)[:halvings]
    if overviews:
        maps = read_group(store, overviews[-1], names)
    else:
        maps = run.groups[group][names].compute()
    for _ in range(halvings - len(overviews)):
        maps = halved(maps)
    return maps


def _layer_of_map(results: Results, group: str, map_name: str) -> LayerFacts:
    if group.startswith("layers/"):
        return results.layer(group.removeprefix("layers/"))
    kind = "image" if map_name == IMAGE else "sheet"
    return next(layer for layer in results.layers if layer.kind == kind)


def map_spec(m: PageMap) -> Entries:
    """Give what the script needs of a map, beside its values."""
    digits = max(0, min(6, math.ceil(-math.log10(m.packed.step))))
    return {
        "title": m.title,
        "layer": m.layer,
        "units": m.units,
        "digits": digits,
        "error": m.packed.error,
        "range": [m.scale.low, m.scale.high],
        "colours": m.scale.colours,
        "span": list(m.scatter_limits),
        "group": m.group_index,
        "trust": m.trust,
        "why": list(m.check_names),
    }
